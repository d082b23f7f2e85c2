"""How many samples of a beam fit in a record."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import check_choice
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.theory.pairs import check_pairs
from bayes_rs.turbulence.toeplitz import DETRENDING

_ROUNDING = 1e-9  # of a sampling interval: whether the last sample is still inside the record


def samples_that_fit(time: ArrayLike, interval: float) -> NDArray[np.int64]:
    """Return how many samples, the first at once and then one each `interval`, come before `time` is over."""
    return np.asarray(np.ceil(np.asarray(time) / interval - _ROUNDING)).astype(np.int64)


def samples_removed(detrend: str) -> int:
    """Return how many samples' worth of a record a detrending takes out: 1 for the mean, 2 for a line.

    Raises
    ------
    InputError
        If there is no such detrending.
    """
    return 1 + DETRENDING.index(check_choice(detrend, DETRENDING, what="detrend"))


def sample_counts(scan: Scan, duration: float, detrend: str = "mean") -> NDArray[np.int64]:
    """Return how many samples of each beam a record holds, shape (n_beam,).

    Parameters
    ----------
    scan : Scan
        The scan.
    duration : float
        Length of the record, s; it begins with the first beam of a scan.
    detrend : str
        ``"mean"`` or ``"linear"``: what is removed, and so how many samples are needed.

    Returns
    -------
    count : ndarray of int, shape (n_beam,)
        Samples at beam_time + i · scan_duration before the end of the record.

    Raises
    ------
    InputError
        If a beam has no more samples than the detrending takes out, or all have too many for their covariances.
    """
    removed = samples_removed(detrend)
    check_pairs(scan, duration / scan.scan_duration)
    count = samples_that_fit(duration - scan.beam_time, scan.scan_duration)
    for index in np.flatnonzero(count <= removed):
        raise InputError(
            f"Invalid duration {duration:g} s for scan {scan.name!r}: beam {scan.beam[index]} has "
            f"{max(int(count[index]), 0)} samples in a record, and removing the {detrend} leaves nothing of fewer than "
            f"{removed + 1}; make the record longer than {removed + 1} scans of {scan.scan_duration:g} s."
        )
    return count
