"""Whether the covariances between beams are what the variances' stresses and the model's coherence make them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bayes_rs.fits.columns import N_PAIR, PAIRS_MISFIT, VARIANCES
from bayes_rs.fits.fit_data import FitData

MOST_MISFIT = 1.1
"""Mean square of what variances leave unexplained of the covariances, over what is expected, that is not believed."""
_LEVEL = 1e-3  # probability of a sum that is as large by chance


@dataclass(frozen=True)
class Coherence:
    """Whether the covariances between beams are what the stresses, told by the variances, and the model make them.

    Parameters
    ----------
    n_record : int
        Records that were compared.
    misfit : float
        Sum of the records' chi-squares over that of their numbers of pairs: about 1 where the model's coherence holds.
    probability : float
        Of a sum as large as that, if it does.
    share : float
        Share of the records with a probability below 1 %.
    """

    n_record: int
    misfit: float
    probability: float
    share: float

    @property
    def doubted(self) -> bool:
        """Whether the covariances speak against the model's coherence."""
        return self.misfit > MOST_MISFIT and self.probability < _LEVEL

    def in_words(self) -> str:
        """Say it in one line."""
        verdict = (
            "they speak against the model's coherence: believe what the variances say"
            if self.doubted
            else "they do not speak against the model's coherence"
        )
        return (
            f"the covariances between beams scatter {self.misfit:.2f} times as expected about what the variances' "
            f"stresses make them ({self.n_record} record{'s' * (self.n_record != 1)}): {verdict}"
        )


def coherence_of(fit: FitData) -> Coherence | None:
    """Return how the covariances of all records go with the variances; None for a fit without them.

    Parameters
    ----------
    fit : FitData
        The fit.
    """
    own = fit.run.get("settings", {}).get("fit", {})
    if own.get("information") != "covariances" or VARIANCES not in fit.source.datasets:
        return None
    columns: dict[str, Any] = fit.of_records(PAIRS_MISFIT, N_PAIR)
    known = np.isfinite(columns[PAIRS_MISFIT])
    count = columns[N_PAIR][known]
    square = columns[PAIRS_MISFIT][known] * count
    if not len(count):
        return None
    chi2 = scipy.stats.chi2
    return Coherence(
        n_record=len(count),
        misfit=float(square.sum() / count.sum()),
        probability=float(chi2.sf(square.sum(), count.sum())),
        share=float(np.mean(chi2.sf(square, count) < 0.01)),
    )
