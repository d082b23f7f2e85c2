"""Whether the covariances between beams are what the variances' stresses and the model's coherence make them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bayes_rs.fits.columns import N_PAIR, PAIRS_MISFIT, PATTERN, VARIANCES, pattern_columns
from bayes_rs.fits.fit_data import FitData

MOST_MISFIT = 1.1
"""Mean square of what variances leave unexplained of the covariances, over what is expected, that is not believed."""
SAME_FOR_ALL = 100
"""Records whose mean counts in full, and no more: a pattern of a tenth of one record's scatter is let be."""
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
    pattern : float
        Square of the mean of what differs, by pairs of beams, over what is expected of so many records at most: 1 or
        below where the model's coherence holds.
    pattern_probability : float
        Of a pattern as large as that, or larger, at most.
    """

    n_record: int
    misfit: float
    probability: float
    share: float
    pattern: float
    pattern_probability: float

    @property
    def doubted(self) -> bool:
        """Whether the covariances speak against the model's coherence."""
        return self._scatters or self.pattern_probability < _LEVEL

    @property
    def _scatters(self) -> bool:
        return self.misfit > MOST_MISFIT and self.probability < _LEVEL

    def in_words(self) -> str:
        """Say it in one line."""
        verdict = (
            "they speak against the model's coherence: believe what the variances say"
            if self.doubted
            else "they do not speak against the model's coherence"
        )
        same = (
            f", and differ from it in the same way in all of them ({self.pattern:.2f} times what chance does)"
            if self.pattern_probability < _LEVEL
            else ""
        )
        return (
            f"the covariances between beams scatter {self.misfit:.2f} times as expected about what the variances' "
            f"stresses make them ({self.n_record} record{'s' * (self.n_record != 1)}){same}: {verdict}"
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
    pattern, n_pair = _pattern_of(fit)
    return Coherence(
        n_record=len(count),
        misfit=float(square.sum() / count.sum()),
        probability=float(chi2.sf(square.sum(), count.sum())),
        share=float(np.mean(chi2.sf(square, count) < 0.01)),
        pattern=pattern / n_pair if n_pair else np.nan,
        pattern_probability=float(chi2.sf(pattern, n_pair)) if n_pair else np.nan,
    )


def _pattern_of(fit: FitData) -> tuple[float, int]:
    """Return the square of the mean of what differs, times the number of records that count, and the number of pairs.

    See `bayes_rs.fits.information.variances_alone`. Zero and zero where no record has all pairs.
    """
    names = pattern_columns(fit.scan.n_beam)
    total, n_record, of_pair = np.zeros(len(names)), 0, np.zeros(len(names), dtype=np.bool_)
    for piece in fit.source.pieces(PATTERN, names):
        values = piece.to_numpy(dtype=np.float64)
        known = np.isfinite(values).any(axis=1)
        total += np.nan_to_num(values[known]).sum(axis=0)
        n_record += int(known.sum())
        of_pair |= np.isfinite(values).any(axis=0)
    if not n_record:
        return 0.0, 0
    mean = total / n_record
    return float(min(n_record, SAME_FOR_ALL) * mean @ mean), int(of_pair.sum())
