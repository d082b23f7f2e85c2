"""Moments of many pairs of beams from those of some: a smooth function of where the beams are and look."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

_SCALE = 8.0  # of the features, over which values are correlated
_DIRECTION, _LENGTH, _SHIFT = 0.2, 0.5, 0.3  # how features of different kinds compare
_CORE, _CORE_OF_L = 0.25, 1e-3  # of the probe and of L: separations below are told apart evenly
_NUGGET = 1e-7  # of the variance: errors of the values
_FIRST, _MOST = 200, 3200  # pairs that are calculated at first, and at most
_N_TEST, _N_NEAR = 64, 24  # pairs to tell the error: by chance, and evenly in separation for the largest
_MORE = 1.5  # of the pairs, when they do not suffice
_EVENLY = 0.7  # share of the pairs that are chosen evenly in separation, the others by chance
_WORTH = 0.8  # of all pairs: when so many are needed, all are calculated
_SEED = 7
_BLOCK = 50_000  # covariances between pairs at a time: their working arrays stay in the processor's cache


class PairSample(NamedTuple):
    """Values at all pairs, and how good they are.

    Attributes
    ----------
    values : ndarray, shape (n,)
        Calculated or interpolated.
    n_calculated : int
        How many were calculated.
    error : float
        Root of the sum of squared errors over that of squared values, from pairs that did not serve for the
        interpolation; 0 if all were calculated.
    largest_error : float
        Largest of the errors of those and of pairs chosen evenly in separation, times `size`.
    """

    values: FloatArray
    n_calculated: int
    error: float
    largest_error: float


def pair_features(
    first: FloatArray,
    second: FloatArray,
    across: FloatArray,
    along: FloatArray,
    lengths: FloatArray,
    *,
    step: float,
    length_scale: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return coordinates of pairs of beams in which their moments are smooth, and how far they are apart.

    Parameters
    ----------
    first, second : ndarray, shape (n, 3)
        Unit vectors of the two beams.
    across : ndarray, shape (n, 2)
        Separation along y and z, m.
    along : ndarray, shape (n,)
        Separation along the wind of the parcels that are sampled, m.
    lengths : ndarray, shape (n, 2)
        `Probe.length` of the two beams, m.
    step : float
        How far the wind goes in a sampling interval, m.
    length_scale : float
        L, m.

    Returns
    -------
    features : ndarray, shape (n, n_feature)
        Separations, finer where they are short; mean direction and difference of directions; the logarithms of the
        lengths where they are not all the same.
    apart : ndarray, shape (n,)
        Separation, in the unit in which it counts.
    aside : ndarray, shape (n,)
        The same across the wind only: the same at all wind speeds.

    Notes
    -----
    A record samples parcels `step` apart, so that a separation along the wind of a whole number of steps is none: it
    enters as the two coordinates of a circle.
    """
    length = np.sqrt(np.mean(lengths**2, axis=1))
    core = (_CORE * np.minimum(length, 0.5 * length_scale) + _CORE_OF_L * length_scale)[:, np.newaxis]
    turn, radius = 2.0 * np.pi * along / step, step / (2.0 * np.pi)
    separation = np.column_stack([across, radius * np.sin(turn)])
    apart = np.linalg.norm(separation, axis=1, keepdims=True)
    stretched = np.where(apart > 0.0, np.arcsinh(apart / core) / np.where(apart > 0.0, apart, 1.0), 1.0 / core)
    parts = [
        stretched * separation,
        np.arcsinh(radius * (1.0 - np.cos(turn))[:, np.newaxis] / core),
        0.5 * (first + second) / _DIRECTION,
        (second - first) / _DIRECTION,
        _SHIFT * along[:, np.newaxis] / step,
    ]
    if np.ptp(lengths) > 0.0:
        parts.append(np.log(lengths + _CORE_OF_L * length_scale) / _LENGTH)
    aside = np.linalg.norm(across, axis=1, keepdims=True)
    return np.column_stack(parts), np.arcsinh(apart / core)[:, 0], np.arcsinh(aside / core)[:, 0]


def interpolate_pairs(
    features: FloatArray,
    apart: FloatArray,
    aside: FloatArray,
    of_points: FloatArray,
    size: FloatArray,
    calculate: Callable[[NDArray[np.int64]], FloatArray],
    tolerance: float,
) -> PairSample:
    """Return values at all pairs from as many as it takes.

    Parameters
    ----------
    features : ndarray, shape (n, n_feature)
        Where the pairs are.
    apart : ndarray, shape (n,)
        How far apart the beams of each are.
    aside : ndarray, shape (n,)
        The same across the wind only.
    of_points : ndarray, shape (n,)
        The values that the same beams would have without probe volumes.
    size : ndarray, shape (n,)
        Factors by which errors of the values count.
    calculate : callable
        Returns the values of the pairs whose numbers it is given.
    tolerance : float
        Largest relative error, in the root of the mean square.

    Returns
    -------
    sample : PairSample
        The values.

    Notes
    -----
    The logarithm of the values, or of their ratio to those of points, whichever is better, is the mean of a Gaussian
    process with Matérn's covariance of order 5/2 in the features, given the pairs that are calculated: these are chosen
    evenly in separation across the wind and by chance, the same at all wind speeds, whose lines are then at hand.
    Others, chosen by chance, tell the error. While that is above the tolerance, half as many more are calculated; all
    of them when four in five do not suffice.
    """
    n, scaled = len(apart), features / _SCALE
    chance = np.random.default_rng(_SEED).permutation(n)
    known = np.full(n, np.nan)

    def know(index: NDArray[np.int64]) -> None:
        new = index[np.isnan(known[index])]
        if len(new):
            known[new] = calculate(new)

    starts = (of_points, np.ones(n))
    order = np.argsort(aside, kind="stable")
    test, count = np.append(chance[:_N_TEST], spread_pairs(apart, _N_NEAR)), _FIRST
    others = chance[~np.isin(chance, test)]
    while count <= min(_WORTH * n, _MOST):
        evenly = np.setdiff1d(_evenly(aside[order], order, int(_EVENLY * count)), test)
        chosen = np.union1d(evenly, others[: count - len(evenly)])
        know(np.union1d(chosen, test))
        fields = [_Smooth(scaled[chosen], np.log(known[chosen] / start[chosen])) for start in starts]
        off = [
            size[test] * (start[test] * np.exp(field.at(scaled[test])) - known[test])
            for field, start in zip(fields, starts, strict=True)
        ]
        whole = np.sum((size * known)[test[:_N_TEST]] ** 2)
        errors = [float(np.sqrt(np.sum(one[:_N_TEST] ** 2) / whole)) for one in off]
        best = int(np.argmin(errors))
        if errors[best] <= tolerance:
            missing = np.flatnonzero(np.isnan(known))
            known[missing] = starts[best][missing] * np.exp(fields[best].at(scaled[missing]))
            return PairSample(known, n - len(missing), errors[best], float(np.max(np.abs(off[best]))))
        count = int(_MORE * count)
    know(np.arange(n))
    return PairSample(known, n, 0.0, 0.0)


def spread_pairs(apart: FloatArray, count: int) -> NDArray[np.int64]:
    """Return the numbers of about `count` pairs that are evenly spread over their separations, ascending."""
    order = np.argsort(apart, kind="stable")
    return _evenly(apart[order], order, count)


def _evenly(ascending: FloatArray, order: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    even = np.linspace(ascending[0], ascending[-1], count)
    return np.unique(order[np.clip(np.searchsorted(ascending, even), 0, len(order) - 1)])


class _Smooth:
    """The mean of a Gaussian process, given values at some places."""

    def __init__(self, places: FloatArray, values: FloatArray) -> None:
        self.places, self.middle = places, float(np.mean(values))
        covariance = _matern(places, places)
        covariance[np.diag_indices(len(places))] += _NUGGET
        self.weights = scipy.linalg.solve(covariance, values - self.middle, assume_a="pos")

    def at(self, places: FloatArray) -> FloatArray:
        """Return its values at other places."""
        rows = max(1, _BLOCK // len(self.places))
        return np.concatenate(
            [
                self.middle + _matern(places[start : start + rows], self.places) @ self.weights
                for start in range(0, len(places), rows)
            ]
        )


def _matern(one: FloatArray, other: FloatArray) -> FloatArray:
    square = np.sum(one**2, axis=1)[:, np.newaxis] + np.sum(other**2, axis=1) - 2.0 * one @ other.T
    distance = np.sqrt(5.0 * np.maximum(square, 0.0))
    return np.asarray((1.0 + distance + distance**2 / 3.0) * np.exp(-distance))
