"""Spikes: samples far from the running median of their beam in their record."""

from __future__ import annotations

import numpy as np
import scipy

from bayes_rs._validation import FloatArray
from bayes_rs.quality.groups import group_median
from bayes_rs.quality.samples import BoolArray, IntArray

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation, of a Gaussian."""


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
