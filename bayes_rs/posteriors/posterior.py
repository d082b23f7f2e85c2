"""The posterior of many records at once: prior, nuisances and likelihood as one density of unbounded coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.likelihoods.log_normal import Likelihood
from bayes_rs.posteriors.nuisance import RecordNuisances, Seen
from bayes_rs.priors.registry import Prior


@dataclass(frozen=True)
class Posterior:
    """Density of n_record records over the prior's coordinates, followed by those of the sampled nuisances.

    Parameters
    ----------
    likelihood : Likelihood
        Likelihood of n_record records.
    prior : Prior
        The prior of R: the same for all, or one that `Prior.for_records` made for these.
    nuisances : RecordNuisances
        What else is uncertain; nothing by default.
    """

    likelihood: Likelihood
    prior: Prior
    nuisances: RecordNuisances = field(default_factory=RecordNuisances)

    @property
    def n_record(self) -> int:
        """Number of records."""
        return self.likelihood.n_record

    @property
    def n_coordinate(self) -> int:
        """Number of coordinates of a record."""
        return self.prior.n_coordinate + self.nuisances.n_coordinate

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Return stresses (..., 6), m² s⁻², of coordinates (..., n_coordinate)."""
        return self.prior.stress(coordinate[..., : self.prior.n_coordinate])

    def nuisance_values(self, coordinate: FloatArray) -> dict[str, FloatArray]:
        """Return the sampled nuisances by name, each (n_record, n_draw), of coordinates (n_record, n_draw, n)."""
        return self.nuisances.values(coordinate[..., self.prior.n_coordinate :])

    def seen(self, coordinate: FloatArray) -> Seen:
        """Return what the likelihood takes at coordinates (n_record, n_draw, n)."""
        return self._seen_of(self.stress(coordinate), coordinate)

    def _seen_of(self, stress: FloatArray, coordinate: FloatArray) -> Seen:
        if self.nuisances.n_coordinate == 0:
            return Seen(stress)
        return self.nuisances.apply(stress, coordinate[..., self.prior.n_coordinate :])

    def log_prior(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density of the prior, shape (n_record, n_draw); nuisances are standard normal."""
        density = self.prior.log_density(coordinate[..., : self.prior.n_coordinate])
        if self.nuisances.n_coordinate:
            extra = coordinate[..., self.prior.n_coordinate :]
            density = density - 0.5 * np.sum(extra**2, axis=-1) - 0.5 * extra.shape[-1] * np.log(2.0 * np.pi)
        return density

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-posterior up to a constant of the record, (n_record, n_draw), at (n_record, n_draw, n)."""
        return self.evaluate(coordinate)[0]

    def evaluate(self, coordinate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log-posterior, as `log_density`, and the stresses (n_record, n_draw, 6) that it is of, m² s⁻²."""
        stress = self.stress(coordinate)
        density = self.likelihood.log_density(*self._seen_of(stress, coordinate))
        density += self.log_prior(coordinate)
        return density, stress

    def take(self, records: NDArray[np.int64]) -> Posterior:
        """Return the posterior of some of the records."""
        return Posterior(self.likelihood.take(records), self.prior.take(records), self.nuisances.take(records))
