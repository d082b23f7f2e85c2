"""Which windows of time are records: those with samples and short gaps between them; and which the data only touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.quality.belief import BoolArray
from bayes_rs.sizes import check_size

IntArray = NDArray[np.int64]

LONGEST_GAP_DAYS = 30
"""Days without any sample beyond which a gap holds no records."""

_GAP = LONGEST_GAP_DAYS * 86_400_000_000_000  # ns
_MOST_ENTRIES, _FEW_ENTRIES = 100_000_000, 100_000
_BYTES_AN_ENTRY = 500.0  # numbers, octaves, parts and blocks of a beam in a record, and copies
_CUT = 1.5
"""Cycles without a sample at the end of a record after which the data are taken to begin or end within it."""


def record_windows(number: IntArray, window: int, n_beam: int) -> IntArray:
    """Return the windows that are records: all from the first to the last sample, but for those in long gaps.

    Parameters
    ----------
    number : ndarray of int, shape (n,)
        Numbers of windows with samples, counted from 1970 on; in any order, also repeated.
    window : int
        Length of a window, ns.
    n_beam : int
        Number of beams.

    Returns
    -------
    windows : ndarray of int, shape (n_record,)
        Numbers of the records, upwards.

    Raises
    ------
    InputError
        If there are more than memory holds.
    """
    there = np.unique(number[np.diff(number, prepend=number[0] - 1) != 0])
    ends = np.flatnonzero(np.diff(there) > max(_GAP // window, 2))
    first, last = there[np.append(0, ends + 1)], there[np.append(ends, len(there) - 1)]
    n_record = int((last - first + 1).sum())
    if n_record * n_beam > _FEW_ENTRIES:
        begin, end = (str(np.datetime64(int(edge) * window // 10**9, "s")) for edge in (there[0], there[-1]))
        told = f"The series from {begin} to {end} holds {n_record} records of {window / 1e9:g} s"
        if n_record * n_beam > _MOST_ENTRIES:
            raise InputError(
                f"{told}: more than {_MOST_ENTRIES} entries with all beams; check its first and last times, or give a "
                "longer duration."
            )
        check_size(f"{told}, which", n_record * n_beam * _BYTES_AN_ENTRY, "check its times, or give a longer duration.")
    return np.concatenate([np.arange(a, b + 1) for a, b in zip(first.tolist(), last.tolist(), strict=True)])


def is_touched(
    start: NDArray[np.datetime64], begin: FloatArray, end: FloatArray, *, duration: float, cycle: float, share: float
) -> BoolArray:
    """Say which records the data only touch: they begin or end within it, so that no beam can have enough samples.

    Parameters
    ----------
    start : ndarray of datetime64, shape (n_record,)
        Starts of the records.
    begin, end : ndarray, shape (n_record,)
        First and last sample of any beam after the start, s; NaN where there is none.
    duration : float
        Length of a record, s.
    cycle : float
        Time from one sample of a beam to the next, s.
    share : float
        Share of a full record's samples that a beam needs.

    Returns
    -------
    touched : ndarray of bool, shape (n_record,)
        Where the window before (or after) has no sample, the first sample comes late (or the last early) by more than
        1.5 cycles, and the time between is a smaller share of the record than `share`, to one cycle.
    """
    there = np.isfinite(begin)
    step = np.diff(start.astype("datetime64[ns]").astype(np.int64)) / 1e9
    follows = np.isclose(step, duration) & there[1:] & there[:-1]
    opens, closes = np.append(True, ~follows), np.append(~follows, True)
    late, early = opens & (begin > _CUT * cycle), closes & (end + _CUT * cycle < duration)
    covered = np.where(early, end + cycle, duration) - np.where(late, begin, 0.0)
    return np.asarray(there & (late | early) & (covered < share * duration + cycle))
