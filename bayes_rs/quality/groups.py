"""Statistics of groups of samples: a group is a beam in a record, or in a part of one."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.quality.samples import BoolArray, IntArray


def group_median(values: FloatArray, group: IntArray) -> FloatArray:
    """Return for each entry the median of its group.

    Parameters
    ----------
    values : ndarray, shape (n,)
        The entries.
    group : ndarray of int, shape (n,)
        The group of each.

    Returns
    -------
    median : ndarray, shape (n,)
        In the unit of the values.
    """
    order = np.lexsort((values, group))
    _, start, inverse, count = np.unique(group[order], return_index=True, return_inverse=True, return_counts=True)
    ranked = values[order]
    median = 0.5 * (ranked[start + (count - 1) // 2] + ranked[start + count // 2])
    result = np.empty_like(values)
    result[order] = median[inverse]
    return result


def group_moments(
    values: FloatArray, group: IntArray, n_group: int
) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
    """Return N, mean, variance (divisor N) and whether all values are equal, of each group.

    Parameters
    ----------
    values : ndarray, shape (n,)
        The entries.
    group : ndarray of int, shape (n,)
        The group of each, from 0 on; sorted.
    n_group : int
        Number of groups; some may be empty.

    Returns
    -------
    count, mean, variance, constant : ndarray, shape (n_group,)
        NaN for the mean and the variance of an empty group.

    Notes
    -----
    Two passes, about the first sample of the group: a large mean costs no digits.
    """
    count = np.bincount(group, minlength=n_group)
    shift = np.zeros(n_group)
    constant = np.zeros(n_group, dtype=bool)
    filled = np.flatnonzero(count)
    if len(filled):
        start = np.flatnonzero(np.diff(group, prepend=-1))
        shift[filled] = values[start]
        constant[filled] = np.minimum.reduceat(values, start) == np.maximum.reduceat(values, start)
    some = np.where(count > 0, count, np.nan)
    mean_deviation = np.bincount(group, weights=values - shift[group], minlength=n_group) / some
    mean = shift + mean_deviation
    deviation = (values - shift[group]) - mean_deviation[group]
    residual = np.bincount(group, weights=deviation, minlength=n_group) / some  # zero but for rounding
    variance = np.bincount(group, weights=deviation**2, minlength=n_group) / some - residual**2
    return count.astype(np.int64), mean, variance, constant
