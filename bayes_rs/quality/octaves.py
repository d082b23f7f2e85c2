"""The variance of a record by averaging time: what its halves, quarters, … down to its samples add to it."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.quality.samples import BoolArray, IntArray

_SUMS = 8_000_000  # held at a time: 64 MB
MOST_OCTAVES = 12
"""Octaves of a record at most: what is finer than 1/2048 of it is in the last."""


def octave_count(expected: float) -> int:
    """Return into how many octaves a record of so many samples is decomposed.

    Parameters
    ----------
    expected : float
        Samples of a beam in a full record.

    Returns
    -------
    n_octave : int
        The last one's blocks, half as long as those before, hold one sample each.

    Examples
    --------
    >>> octave_count(600.0), octave_count(100.0), octave_count(1.0)
    (10, 7, 1)
    """
    return int(np.clip(np.ceil(np.log2(max(expected, 1.0)) - 1e-9), 1, MOST_OCTAVES))


def octave_variances(
    velocity: FloatArray, group: IntArray, place: FloatArray, n_group: int, n_octave: int
) -> FloatArray:
    r"""Decompose the variance of each group of samples by the length of averaging.

    Parameters
    ----------
    velocity : ndarray, shape (n,)
        Radial velocities, m/s.
    group : ndarray of int, shape (n,)
        Record and beam of each, from 0 on.
    place : ndarray, shape (n,)
        Where in the record each was taken, from 0 to below 1.
    n_group : int
        Number of groups; some may be empty.
    n_octave : int
        Number of octaves.

    Returns
    -------
    energy : ndarray, shape (n_group, n_octave)
        What each octave adds to the variance (divisor N), m² s⁻²; NaN for an empty group.

    Notes
    -----
    With the record cut into 2^l blocks of equal time, the sums V_B and counts n_B of its samples in them, and

    .. math:: S_l = \sum_B V_B^2 / n_B, \qquad e_l = (S_l - S_{l-1}) / N , \quad l = 1 … n_{octave} - 1,

    the last octave is what is left, (Σv² − S_{l−1})/N. It is an analysis of variance, so the octaves sum to the
    variance for any number and place of samples, and none is below zero.

    Examples
    --------
    >>> octave_variances(np.array([1.0, 1.0, -1.0, -1.0]), np.zeros(4, int), np.arange(4) / 4.0, 1, 2)
    array([[1., 0.]])
    """
    count = np.bincount(group, minlength=n_group)
    mean = np.bincount(group, weights=velocity, minlength=n_group) / np.maximum(count, 1)
    deviation = velocity - mean[group]
    n_block = 2 ** (n_octave - 1)
    block = group * n_block + np.minimum((place * n_block).astype(np.int64), n_block - 1)
    total = np.bincount(block, weights=deviation, minlength=n_group * n_block).reshape(n_group, n_block)
    many = np.bincount(block, minlength=n_group * n_block).reshape(n_group, n_block)
    between = np.empty((n_group, n_octave + 1))
    between[:, n_octave] = np.bincount(group, weights=deviation**2, minlength=n_group)
    for level in range(n_octave - 1, -1, -1):
        between[:, level] = np.sum(total**2 / np.maximum(many, 1), axis=1)
        if level:
            total = total[:, 0::2] + total[:, 1::2]
            many = many[:, 0::2] + many[:, 1::2]
    energy = np.maximum(np.diff(between, axis=1), 0.0)  # below zero by rounding only
    return np.asarray(np.where(count[:, np.newaxis] > 0, energy / np.maximum(count, 1)[:, np.newaxis], np.nan))


def record_octaves(
    velocity: FloatArray, group: IntArray, time: IntArray, keep: BoolArray, n_group: int, window: int, n_octave: int
) -> FloatArray:
    """Return the octave variances of the samples that count, shape (n_group, n_octave).

    Parameters
    ----------
    velocity, group, time : ndarray, shape (n,)
        Radial velocities (m/s), record and beam, and times (ns) of all samples.
    keep : ndarray of bool, shape (n,)
        Which count.
    n_group : int
        Number of groups.
    window : int
        Length of a record, ns.
    n_octave : int
        Number of octaves.

    Returns
    -------
    energy : ndarray, shape (n_group, n_octave)
        m² s⁻².
    """
    found = np.full((n_group, n_octave), np.nan)
    n_block = 2 ** (n_octave - 1)
    step = max(_SUMS // n_block, 1)  # groups at a time
    rows = np.flatnonzero(keep)
    edges = np.searchsorted(group[rows], np.arange(0, n_group + step, step))
    for number, first in enumerate(range(0, n_group, step)):
        some = rows[edges[number] : edges[number + 1]]
        size = min(step, n_group - first)
        found[first : first + size] = octave_variances(
            velocity[some], group[some] - first, (time[some] % window) / window, size, n_octave
        )
    return found
