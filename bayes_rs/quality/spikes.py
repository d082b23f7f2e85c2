"""Spikes: samples far from the running median of their beam in their record."""

from __future__ import annotations

import numpy as np
import scipy

from bayes_rs._validation import FloatArray
from bayes_rs.quality.groups import group_median
from bayes_rs.quality.samples import BoolArray, IntArray

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation, of a Gaussian."""
FAR = 10.0
"""Robust standard deviations beyond which a sample is far out: twice the usual threshold, where air has no samples."""
RAISED, RAISED_ONE = 0.02, 0.1
"""Spikes are told from where they raise all variances together, or those of one beam, by these shares."""
SPIKES = "lie far outside the others of their beam (spikes, as of low CNR)"
DESPIKE = "despike='median' (--despike median) leaves them out"
"""What is said of samples far out, and what helps."""
_JUMP = 16.0
"""A group whose largest step is below so many mean quiet ones has no sample far out."""


def running_median(velocity: FloatArray, group: IntArray, *, window: int) -> FloatArray:
    """Return the median of the `window` samples of the same group about each sample, mirrored at the group's ends."""
    median = np.empty_like(velocity)
    margin = window // 2
    edges = np.flatnonzero(np.diff(group)) + 1
    for values, out in zip(np.split(velocity, edges), np.split(median, edges), strict=True):
        if len(values) > window:
            out[:] = scipy.ndimage.median_filter(values, size=window, mode="mirror")
        elif len(values):  # mirrored here: SciPy errs on groups shorter than half of the window
            longer = np.pad(values, margin, mode="reflect")
            out[:] = scipy.ndimage.median_filter(longer, size=window)[margin : margin + len(values)]
    return median


def is_far(deviation: FloatArray, group: IntArray, *, threshold: float) -> BoolArray:
    """Say where deviations are beyond k · 1.4826 · MAD of their group; nowhere in a group whose MAD is zero."""
    mad = group_median(deviation, group)
    return np.asarray((deviation > threshold * MAD_TO_SIGMA * mad) & (mad > 0.0))


def is_spike(velocity: FloatArray, group: IntArray, *, window: int, threshold: float) -> BoolArray:
    """Find spikes by the median rule: |v − m| > k · 1.4826 · MAD.

    Parameters
    ----------
    velocity : ndarray, shape (n_sample,)
        Finite radial velocities, m/s, beam after beam and each in time's order.
    group : ndarray of int, shape (n_sample,)
        Record and beam of each sample, as one number: a record does not depend on its neighbours.
    window : int
        Number of samples w of the running median m, odd; mirrored at a record's ends.
    threshold : float
        k.

    Returns
    -------
    spike : ndarray of bool, shape (n_sample,)
        Which samples are spikes.

    Notes
    -----
    m is the median of the w usable samples of the same record and beam about the sample, MAD the median of |v − m| over
    them all. Where MAD is zero (a value that repeats) the rule has no scale and drops nothing.
    """
    return is_far(np.abs(velocity - running_median(velocity, group, window=window)), group, threshold=threshold)


def is_far_out(velocity: FloatArray, group: IntArray, *, window: int) -> BoolArray:
    """Find the samples that are spikes beyond doubt: those of `is_spike` at the threshold `FAR`.

    Parameters
    ----------
    velocity, group, window
        As for `is_spike`.

    Returns
    -------
    far : ndarray of bool, shape (n_sample,)
        Which samples are far outside the others.

    Notes
    -----
    The running median is calculated only of groups that have a step to the next sample 16 times as large as their mean
    quiet one: the mean of the smallest of three steps in a row, of which a single spike makes two.
    """
    far = np.zeros(len(velocity), dtype=bool)
    if len(velocity) < 2:
        return far
    same = group[1:] == group[:-1]
    step = np.where(same, np.abs(np.diff(velocity)), 0.0)
    start = np.flatnonzero(np.concatenate([[True], ~same]))
    length = np.diff(np.append(start, len(velocity)))
    largest = np.maximum.reduceat(np.append(0.0, step), start)
    quiet = np.zeros(len(velocity))
    quiet[3:] = np.minimum(np.minimum(step[:-2], step[1:-1]), step[2:])  # zero where a group begins
    mean = np.add.reduceat(quiet, start) / np.maximum(length - 3, 1)
    rows = np.repeat(largest > _JUMP * mean, length)
    if rows.any():
        far[rows] = is_spike(velocity[rows], group[rows], window=window, threshold=FAR)
    return far


def samples_words(number: int, total: int) -> str:
    """Return a number of samples as a share of all.

    Examples
    --------
    >>> samples_words(9, 1000)
    '0.9 % of samples (9 of 1000)'
    """
    return f"{100.0 * number / total:.2g} % of samples ({number} of {total})"
