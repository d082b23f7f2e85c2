"""Stationarity: what the parts of a record say about a record, beam by beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bayes_rs._validation import FloatArray
from bayes_rs.quality.groups import group_moments
from bayes_rs.quality.samples import BeamSamples, BoolArray, IntArray

LEAST_PARTS = 4
"""Parts with samples that the test for a trend needs: two degrees of freedom."""


@dataclass(frozen=True)
class Parts:
    """Moments of the M equal parts of each record.

    Parameters
    ----------
    count : ndarray of int, shape (n_record, n_beam, M)
        Samples.
    mean, variance : ndarray, shape (n_record, n_beam, M)
        Mean, m/s, and variance with divisor N about it, m² s⁻²; NaN without samples.
    """

    count: IntArray
    mean: FloatArray
    variance: FloatArray


def parts_of_records(samples: BeamSamples, keep: BoolArray, *, window: int, number: int) -> Parts:
    """Return the moments of the `number` equal parts of each record of `window` nanoseconds."""
    part = (samples.time[keep] % window) * number // window
    group = samples.group[keep] * number + part
    count, mean, variance, _ = group_moments(samples.velocity[keep], group, samples.n_group * number)
    shape = (len(samples.numbers), samples.n_record, number)
    return Parts(
        np.swapaxes(count.reshape(shape), 0, 1),
        np.swapaxes(mean.reshape(shape), 0, 1),
        np.swapaxes(variance.reshape(shape), 0, 1),
    )


def trend(parts: Parts) -> tuple[FloatArray, FloatArray]:
    r"""Test the means of parts for a linear trend.

    Parameters
    ----------
    parts : Parts
        M parts; those without samples are left out.

    Returns
    -------
    change : ndarray, shape (n_record, n_beam)
        What the fitted line changes from a record's start to its end, m/s.
    p_value : ndarray, shape (n_record, n_beam)
        Two-sided; NaN with fewer than `LEAST_PARTS` parts, or if all means are equal.

    Notes
    -----
    Ordinary least squares of the m ≤ M means on time, with t = b/se(b) taken as Student's t with m − 2 degrees of
    freedom. The scatter of the means about the line stands for the integral scale, which is not asked for; it does so
    if parts are long against it. Since they are not quite, stationary turbulence exceeds the level somewhat more often.
    """
    there = parts.count > 0
    m = there.sum(axis=-1)
    place = (np.arange(parts.count.shape[-1]) + 0.5) / parts.count.shape[-1] - 0.5
    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.where(there, place - (np.where(there, place, 0.0).sum(axis=-1) / m)[..., None], 0.0)
        means = np.where(there, parts.mean, 0.0)
        y = np.where(there, parts.mean - (means.sum(axis=-1) / m)[..., None], 0.0)
        squares = (x**2).sum(axis=-1)
        change = (x * y).sum(axis=-1) / squares
        residual = ((y - change[..., None] * x) ** 2).sum(axis=-1)
        t = change / np.sqrt(residual / (m - 2) / squares)
        p_value = np.asarray(2.0 * scipy.stats.t.sf(np.abs(t), np.maximum(m - 2, 1)), dtype=np.float64)
    enough = m >= LEAST_PARTS
    return np.where(enough, change, np.nan), np.where(enough, p_value, np.nan)


def share_between_parts(parts: Parts) -> FloatArray:
    r"""Return the share of a record's variance that lies between the means of its parts.

    Parameters
    ----------
    parts : Parts
        M parts of n_k samples each.

    Returns
    -------
    share : ndarray, shape (n_record, n_beam)
        0 to 1; NaN where the variance is zero or there are no samples.

    Notes
    -----
    .. math:: 1 - \frac{\sum_k n_k s_k^2}{\sum_k n_k s^2} ,

    which is |mean variance of the parts − variance| / variance of Foken and Wichura (1996), for the divisor N and parts
    weighted by their samples: then the difference is the variance between the parts, and never negative.

    References
    ----------
    Foken and Wichura (1996), Agric. For. Meteorol. 78, 83–105, doi:10.1016/0168-1923(95)02248-1.
    """
    n = parts.count
    total = n.sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = n / total[..., None]
        mean = np.where(n > 0, parts.mean, 0.0)
        first = mean[..., :1]
        centre = first + (weight * (mean - first)).sum(axis=-1, keepdims=True)
        between = (weight * (mean - centre) ** 2).sum(axis=-1)
        within = (weight * np.where(n > 0, parts.variance, 0.0)).sum(axis=-1)
        return np.asarray(between / (between + within))


def half_ratio(halves: Parts) -> FloatArray:
    """Return the variance of a record's second half over that of its first.

    Parameters
    ----------
    halves : Parts
        Two parts.

    Returns
    -------
    ratio : ndarray, shape (n_record, n_beam)
        NaN or infinite where a half has no samples or no variance.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(halves.variance[..., 1] / halves.variance[..., 0])


def beam_median(values: FloatArray, used: BoolArray) -> FloatArray:
    """Return the median over the used beams of each record; NaN where there is none. NaN entries are left out."""
    chosen = np.where(used & ~np.isnan(values), values, np.nan)
    some = ~np.isnan(chosen).all(axis=1)
    median = np.full(len(values), np.nan)
    median[some] = np.nanmedian(chosen[some], axis=1)
    return median
