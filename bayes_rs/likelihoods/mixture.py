"""A likelihood averaged over a quantity that is not known, such as the length scale."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_rs._validation import FloatArray
from bayes_rs.likelihoods.base import Likelihood


@dataclass(frozen=True)
class MixtureLikelihood(Likelihood):
    """p(y | R) = Σ_j w_j p(y | R, j).

    Parameters
    ----------
    parts : tuple of Likelihood
        p(y | R, j), of the same records and the same data.
    weight : ndarray, shape (n_part,)
        w_j; they sum to 1.

    Notes
    -----
    `expected` and the data's number are those of the middle part. Exact for a quantity that takes these values only;
    for a continuous one as good as the quadrature whose nodes and weights they are.
    """

    parts: tuple[Likelihood, ...]
    weight: FloatArray
    gain: FloatArray = field(init=False)
    offset: FloatArray = field(init=False)
    n_datum: NDArray[np.int64] = field(init=False)
    dof: float = field(init=False)
    place: FloatArray | None = field(init=False)

    def __post_init__(self) -> None:
        """Take what all likelihoods have from the middle part."""
        middle = self.parts[len(self.parts) // 2]
        for name in ("gain", "offset", "n_datum", "dof", "place"):
            object.__setattr__(self, name, getattr(middle, name))

    def log_density(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return the log-likelihood, shape (n_record, n_draw), of stresses (n_record, n_draw, 6)."""
        return np.asarray(logsumexp(self._joint(stress, offset, gradient), axis=0))

    def whitened_residual(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return the parts' residuals, each shortened by the root of the part's probability given the stresses."""
        joint = self._joint(stress, offset, gradient)
        with np.errstate(invalid="ignore"):
            share = np.exp(0.5 * (joint - logsumexp(joint, axis=0)))
        return np.concatenate(
            [
                part.whitened_residual(stress, offset, gradient) * root[..., None]
                for part, root in zip(self.parts, share, strict=True)
            ],
            axis=-1,
        )

    def take(self, records: NDArray[np.int64]) -> MixtureLikelihood:
        """Return the likelihood of some of the records."""
        return MixtureLikelihood(tuple(part.take(records) for part in self.parts), self.weight)

    def records_last(self) -> MixtureLikelihood:
        """Return the same likelihood with arrays that run along the records in memory."""
        return MixtureLikelihood(tuple(part.records_last() for part in self.parts), self.weight)

    def _joint(self, stress: FloatArray, offset: FloatArray | None, gradient: FloatArray | None) -> FloatArray:
        """Return ln w_j + ln p(y | R, j), shape (n_part, n_record, n_draw)."""
        density = np.stack([part.log_density(stress, offset, gradient) for part in self.parts])
        return np.asarray(density + np.log(self.weight)[:, None, None])
