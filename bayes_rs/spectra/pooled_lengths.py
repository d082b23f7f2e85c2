"""The length scales of many records, each drawn towards what the others of its wind speed say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.spectra.octave_theory import LENGTHS, length_nodes

PRIOR_MEDIAN = 61.0
"""Median of L a priori, m: that of the flow fu-2022."""
PRIOR_LOG_SD = 0.8
"""Standard deviation of ln L a priori: 95 % from 13 to 290 m."""
_CENTRE_SD, _SPREAD_SD, _SLOPE_SD = 0.7, 0.4, 0.4  # of a, τ and β: 0.7² + 0.4² is 0.8²
_SPREADS = np.array([0.1, 0.18, 0.28, 0.4, 0.55, 0.75, 1.0])
_SLOPES = np.linspace(-0.8, 0.8, 5)
_FINE = 0.1  # of ln L
_MOST_CLASSES = 12
_STRAY, _STRAY_SD = 0.05, 1.2  # share and width of records that are unlike the others
_LIGHT = 1e-5  # of the heaviest hyperparameters: lighter ones are left out
_RECORDS = 2000  # at a time


@dataclass(frozen=True)
class PooledLengths:
    """The length scales of records, and their distribution.

    Parameters
    ----------
    length_scale : ndarray, shape (n_record,)
        Posterior medians, m.
    log_sd : ndarray, shape (n_record,)
        Posterior standard deviations of ln L.
    centre, centre_log_sd : float
        L at the records' mean ln U, m, and the standard deviation of its logarithm.
    spread : float
        Posterior mean of the standard deviation of ln L from record to record.
    slope : float
        Posterior mean of the power of the wind speed that L grows with.
    """

    length_scale: FloatArray
    log_sd: FloatArray
    centre: float
    centre_log_sd: float
    spread: float
    slope: float


def pool_lengths(
    log_density: FloatArray, wind_speed: FloatArray, *, median: float = PRIOR_MEDIAN, log_sd: float = PRIOR_LOG_SD
) -> PooledLengths:
    r"""Return the posterior of ln L of every record of a campaign.

    Parameters
    ----------
    log_density : ndarray, shape (n_record, n_length)
        Log-likelihoods at `length_nodes`.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speeds, m/s; NaN where not known.
    median, log_sd : float
        The prior of L of a single record.

    Returns
    -------
    pooled : PooledLengths
        NaN nowhere: a record without information has the campaign's distribution.

    Notes
    -----
    Of 95 % of the records

    .. math:: \ln L_k \sim N(a + β x_k, τ^2), \qquad x_k = \ln U_k - \overline{\ln U} ,

    the others are broad. The hyperparameters a, β and τ have normal and half-normal priors such that a single record's
    L has the prior that is given, and are summed over a grid: no step is iterated, and nothing is plugged in. Records
    count as independent.

    Examples
    --------
    >>> flat = np.zeros((1, len(length_nodes())))
    >>> alone = pool_lengths(flat, np.array([10.0]))
    >>> bool(abs(np.log(alone.length_scale[0] / 61.0)) < 0.1), bool(0.7 < alone.log_sd[0] < 0.9)
    (True, True)
    """
    coarse = length_nodes()
    first, last = np.log(LENGTHS)
    node = np.linspace(first, last, int(np.ceil((last - first) / _FINE)) + 1)
    x, classes = _classes(wind_speed)
    scale = log_sd / PRIOR_LOG_SD
    centre, slope, spread = (
        axis.ravel()
        for axis in np.meshgrid(node[(node > np.log(6.0)) & (node < np.log(700.0))], _SLOPES, _SPREADS, indexing="ij")
    )
    log_weight = (
        -0.5 * ((centre - np.log(median)) / (_CENTRE_SD * scale)) ** 2
        - 0.5 * (slope / _SLOPE_SD) ** 2
        - 0.5 * (spread / (_SPREAD_SD * scale)) ** 2
        + np.log(np.gradient(_SPREADS))[np.searchsorted(_SPREADS, spread)]
    )
    for records, at in _parts(classes, x):
        likelihood = _fine(log_density[records], coarse, node)
        log_weight = log_weight + np.sum(np.log(likelihood @ _distribution(node, centre + slope * at, spread)), axis=0)
    weight = np.exp(log_weight - log_weight.max())
    kept = weight > _LIGHT
    centre, slope, spread, weight = centre[kept], slope[kept], spread[kept], weight[kept] / weight[kept].sum()
    middle, width = np.empty(len(log_density)), np.empty(len(log_density))
    for records, at in _parts(classes, x):
        likelihood = _fine(log_density[records], coarse, node)
        prior = _distribution(node, centre + slope * at, spread)
        posterior = likelihood * ((weight / (likelihood @ prior)) @ prior.T)
        posterior /= posterior.sum(axis=1, keepdims=True)
        mean = posterior @ node
        width[records] = np.sqrt(np.maximum(posterior @ node**2 - mean**2, 0.0) + _FINE**2 / 12.0)
        middle[records] = _medians(node, posterior)
    mean_centre = float(weight @ centre)
    return PooledLengths(
        np.exp(middle),
        width,
        float(np.exp(mean_centre)),
        float(np.sqrt(weight @ (centre - mean_centre) ** 2 + _FINE**2 / 12.0)),
        float(weight @ spread),
        float(weight @ slope),
    )


def _classes(wind_speed: FloatArray) -> tuple[FloatArray, list[NDArray[np.int64]]]:
    """Return classes of ln U, each with its mean less that of all; records without a wind are in the middle."""
    known = np.isfinite(wind_speed) & (wind_speed > 0.0)
    log_speed = np.log(np.where(known, wind_speed, 1.0))
    middle = float(log_speed[known].mean()) if known.any() else 0.0
    apart = np.where(known, log_speed - middle, 0.0)
    n_class = max(min(_MOST_CLASSES, len(apart) // 10), 1)
    parts = [part for part in np.array_split(np.argsort(apart, kind="stable"), n_class) if len(part)]
    return np.array([apart[part].mean() for part in parts]), parts


def _parts(classes: list[NDArray[np.int64]], x: FloatArray) -> Iterator[tuple[NDArray[np.int64], float]]:
    """Yield some records of one class at a time, and where their class is."""
    for records, at in zip(classes, x, strict=True):
        for first in range(0, len(records), _RECORDS):
            yield records[first : first + _RECORDS], float(at)


def _fine(log_density: FloatArray, coarse: FloatArray, node: FloatArray) -> FloatArray:
    between = scipy.interpolate.CubicSpline(coarse, log_density, axis=1)(node)
    return np.asarray(np.exp(np.clip(between - between.max(axis=1, keepdims=True), -200.0, 0.0)))


def _distribution(node: FloatArray, centre: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the distribution of ln L at nodes for each set of hyperparameters, shape (n_node, n_hyper)."""
    # of one class of wind speeds the slope does not matter: those that are the same are calculated once
    pairs, place = np.unique(centre + 1j * spread, return_inverse=True)

    def normal(width: FloatArray | float) -> FloatArray:
        density = np.exp(-0.5 * ((node[:, np.newaxis] - pairs.real) / width) ** 2)
        return np.asarray(density / density.sum(axis=0))

    found = (1.0 - _STRAY) * normal(pairs.imag) + _STRAY * normal(_STRAY_SD)
    return np.take(found, place.reshape(-1), axis=1)


def _medians(node: FloatArray, posterior: FloatArray) -> FloatArray:
    """Return medians of ln L, between the nodes."""
    below = np.cumsum(posterior, axis=1) - 0.5 * posterior
    return np.array([np.interp(0.5, row, node) for row in below])
