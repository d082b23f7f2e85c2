"""Whether the data beside the variances of beams are what the stresses of these, and the model, make them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bayes_rs.fits.columns import N_PAIR, PAIRS_MISFIT, PATTERN, SAME_FOR_ALL, VARIANCES, pattern_columns
from bayes_rs.fits.fit_data import FitData
from bayes_rs.records.layout import mast_there

MOST_MISFIT = 1.1
"""Mean square of what variances leave unexplained of the other data, over what is expected, that is not believed."""
_LEVEL = 1e-3  # probability of a sum that is as large by chance
_WORDS = {
    "covariances": ("the covariances between beams", "the model's coherence"),
    "mast": ("the stresses of the mast beside", "the mast"),
}


@dataclass(frozen=True)
class Coherence:
    """Whether covariances between beams, and a mast beside, are what the stresses, told by the variances, make them.

    Parameters
    ----------
    data : tuple of str
        What is compared with the variances: ``"covariances"``, ``"mast"``, or both.
    n_record : int
        Records that were compared.
    misfit : float
        Sum of the records' chi-squares over that of their numbers of data: about 1 where the model's coherence holds,
        and the mast measures the same air.
    probability : float
        Of a sum as large as that, if they do.
    share : float
        Share of the records with a probability below 1 %.
    pattern : float
        Square of the mean of what differs, over what is expected of so many records at most: 1 or below if they do.
    pattern_probability : float
        Of a pattern as large as that, or larger, at most.
    flat : bool
        Whether the prior is flat: what the variances leave open is then larger than in any wind, which the data beside
        tell, however right the model is.
    """

    data: tuple[str, ...]
    n_record: int
    misfit: float
    probability: float
    share: float
    pattern: float
    pattern_probability: float
    flat: bool = False

    @property
    def doubted(self) -> bool:
        """Whether the data beside the variances speak against the model's coherence, or against the mast."""
        scatters = self.misfit > MOST_MISFIT and self.probability < _LEVEL
        return scatters or self.pattern_probability < _LEVEL

    def in_words(self) -> str:
        """Say it in one line."""
        what = " and ".join(_WORDS[name][0] for name in self.data)
        against = " or ".join(_WORDS[name][1] for name in self.data)
        same = (
            f", and differ from that in the same way in all of them ({self.pattern:.2f} times what chance does)"
            if self.pattern_probability < _LEVEL
            else ""
        )
        if not self.doubted:
            verdict = f"they do not speak against {against}"
        elif self.flat:
            verdict = f"they speak against the flat prior, or against {against}: fit with prior 'weak' to tell which"
        else:
            verdict = f"they speak against {against}: believe what the variances say"
        return (
            f"{what} scatter {self.misfit:.2f} times as expected about what the variances' "
            f"stresses make them ({self.n_record} record{'s' * (self.n_record != 1)}){same}: {verdict}"
        )


def coherence_of(fit: FitData) -> Coherence | None:
    """Return how the data beside the variances go with these in all records; None for a fit without such data.

    Parameters
    ----------
    fit : FitData
        The fit.
    """
    if VARIANCES not in fit.source.datasets:
        return None
    options = fit.run["settings"]["fit"]
    of_pairs = options.get("information") == "covariances"
    columns: dict[str, Any] = fit.of_records(PAIRS_MISFIT, N_PAIR)
    known = np.isfinite(columns[PAIRS_MISFIT])
    count = columns[N_PAIR][known]
    square = columns[PAIRS_MISFIT][known] * count
    if not len(count):
        return None
    chi2 = scipy.stats.chi2
    pattern, n_datum = _pattern_of(fit)
    beside = mast_there(fit.records)[fit.fitted].any()
    return Coherence(
        data=(*(["covariances"] if of_pairs else []), *(["mast"] if beside else [])),
        n_record=len(count),
        misfit=float(square.sum() / count.sum()),
        probability=float(chi2.sf(square.sum(), count.sum())),
        share=float(np.mean(chi2.sf(square, count) < 0.01)),
        pattern=pattern / n_datum,
        pattern_probability=float(chi2.sf(pattern, n_datum)),
        flat=options.get("prior") == "flat",
    )


def _pattern_of(fit: FitData) -> tuple[float, int]:
    """Return the square of the mean of what differs, times the number of records that count, and the number of data.

    See `bayes_rs.fits.information.variances_alone`.
    """
    names = pattern_columns(fit.scan.n_beam)
    total, n_record, there = np.zeros(len(names)), 0, np.zeros(len(names), dtype=np.bool_)
    for piece in fit.source.pieces(PATTERN, names):
        values = piece.to_numpy(dtype=np.float64)
        fitted = values[np.isfinite(values).any(axis=1)]
        total += np.nan_to_num(fitted).sum(axis=0)
        there |= np.any(np.nan_to_num(fitted) != 0.0, axis=0)  # a datum that no record has is 0 in all
        n_record += len(fitted)
    mean = total / n_record
    return float(min(n_record, SAME_FOR_ALL) * mean @ mean), int(there.sum())
