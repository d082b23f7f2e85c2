"""The stresses over time: record by record, or in bins where there are too many records for a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.flags import FAILURES
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.report.report_data import ReportData

MOST_RECORDS = 1000
"""Records up to which each has a point of its own."""
MOST_BINS = 1500
_HOUR = 3_600_000.0  # ms
_WIDTHS = (1, 2, 3, 6, 12, 24, 48, 168, 672)  # hours


@dataclass(frozen=True)
class Series:
    """Points along time, each of one record or of all records in a bin.

    Parameters
    ----------
    start : ndarray, shape (n_point,)
        Starts of the points, ms since 1970-01-01 UTC, or the number of the first record.
    width : float
        Their width, in the same unit.
    timed : bool
        Whether the unit is ms.
    binned : bool
        Whether a point is a bin.
    count, n_failed, n_remarked : ndarray, shape (n_point,)
        Records of the point, those whose flag is a failure, and those with another flag.
    median, low, high : ndarray, shape (n_point, 6)
        Posterior median and interval; medians of them in a bin.
    spread_low, spread_high : ndarray, shape (n_point, 6)
        Where nine tenths of a bin's posterior medians are; NaN if not binned.
    priors : ndarray of bool, shape (n_point, 6)
        Whether the stress is mostly the prior's, in more than half of a bin's fitted records.
    room : ndarray, shape (2, n_point, 6)
        Ends of the prior's interval at the size that was found; NaN where they are not known.
    intensity : dict of str to ndarray, shape (n_point,)
        ``median``, ``low``, ``high``, ``spread_low`` and ``spread_high`` of turbulence intensity; empty if it is not
        known of any record.
    """

    start: FloatArray
    width: float
    timed: bool
    binned: bool
    count: NDArray[np.int64]
    n_failed: NDArray[np.int64]
    n_remarked: NDArray[np.int64]
    median: FloatArray
    low: FloatArray
    high: FloatArray
    spread_low: FloatArray
    spread_high: FloatArray
    priors: NDArray[np.bool_]
    room: FloatArray
    intensity: dict[str, FloatArray]


def time_axis(found: ReportData) -> tuple[FloatArray, float, bool]:
    """Return where each record stands, how wide it is, and whether in ms since 1970 or in records.

    Times are used if every record has one and they go forward.
    """
    if len(found.time) and not np.isnat(found.time).any():
        position = found.time.astype(np.int64) / 1e6
        steps = np.diff(position)
        if np.all(steps > 0.0):
            duration = None if found.records is None else found.records.attrs.get("duration")
            if duration is not None:
                return position, 1e3 * float(duration), True
            return position, float(np.median(steps)) if len(steps) else 6e5, True
    return found.record.astype(np.float64), 1.0, False


def make_series(found: ReportData, room: FloatArray | None = None) -> Series:
    """Lay the stresses out along time.

    Parameters
    ----------
    found : ReportData
        From `report_data`.
    room : ndarray, shape (2, n_record, 6), optional
        Ends of the prior's interval at the size of each record, m² s⁻².

    Returns
    -------
    series : Series
        One point a record up to `MOST_RECORDS`; beyond, bins of whole hours on the clock, or of as many records.
    """
    position, width, timed = time_axis(found)
    failed = (found.flag & FAILURES) != 0
    remarked = (found.flag != 0) & ~failed
    median, low, high = (found.numbers[name] for name in ("median", "low", "high"))
    priors = is_priors(found.numbers["decided"])
    if room is None:
        room = np.full((2, *median.shape), np.nan)
    known = found.derived.get("ti", {})
    known = known if known and np.isfinite(known["median"]).any() else {}
    if len(position) <= MOST_RECORDS:
        nothing = np.full(median.shape, np.nan)
        return Series(
            start=position,
            width=width,
            timed=timed,
            binned=False,
            count=np.ones(len(position), dtype=np.int64),
            n_failed=failed.astype(np.int64),
            n_remarked=remarked.astype(np.int64),
            median=median,
            low=low,
            high=high,
            spread_low=nothing,
            spread_high=nothing,
            priors=priors,
            room=room,
            intensity=known,
        )
    bin_width = _bin_width(position, timed=timed)
    bins, index = np.unique(np.floor_divide(position, bin_width), return_inverse=True)
    n_bin, fitted = len(bins), found.fitted
    intensity = {name: _of_bins(known[name][:, None], index, n_bin, 0.5)[:, 0] for name in known}
    for name, share in (("spread_low", 0.05), ("spread_high", 0.95)) if known else ():
        intensity[name] = _of_bins(known["median"][:, None], index, n_bin, share)[:, 0]
    of_priors = [np.bincount(index[fitted], priors[fitted, column], n_bin) for column in range(len(STRESSES))]
    return Series(
        start=np.asarray(bins * bin_width, dtype=np.float64),
        width=bin_width,
        timed=timed,
        binned=True,
        count=np.bincount(index, minlength=n_bin),
        n_failed=np.bincount(index[failed], minlength=n_bin),
        n_remarked=np.bincount(index[remarked], minlength=n_bin),
        median=_of_bins(median, index, n_bin, 0.5),
        low=_of_bins(low, index, n_bin, 0.5),
        high=_of_bins(high, index, n_bin, 0.5),
        spread_low=_of_bins(median, index, n_bin, 0.05),
        spread_high=_of_bins(median, index, n_bin, 0.95),
        priors=2.0 * np.stack(of_priors, axis=1) > np.bincount(index[fitted], minlength=n_bin)[:, None],
        room=np.stack([_of_bins(end, index, n_bin, 0.5) for end in room]),
        intensity=intensity,
    )


def _bin_width(position: FloatArray, *, timed: bool) -> float:
    extent = float(position[-1] - position[0])
    if not timed:
        return float(np.ceil(extent / MOST_BINS))
    for hours in _WIDTHS:
        if extent <= hours * _HOUR * (MOST_BINS - 1):
            return hours * _HOUR
    return float(np.ceil(extent / (168 * _HOUR * (MOST_BINS - 1)))) * 168 * _HOUR


def _of_bins(values: FloatArray, index: NDArray[np.intp], n_bin: int, q: float) -> FloatArray:
    """Return a quantile of the finite values (n_record, 6) in each bin; NaN in a bin without any."""
    found = np.full((n_bin, values.shape[1]), np.nan)
    ends = np.searchsorted(index, np.arange(n_bin + 1))  # positions go forward, so a bin's records stand together
    for number in range(n_bin):
        rows = values[ends[number] : ends[number + 1]]
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows):
            found[number] = np.quantile(rows, q, axis=0)
    return found
