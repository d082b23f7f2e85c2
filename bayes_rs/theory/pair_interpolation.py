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
_FIRST, _MOST = 200, 3200  # pairs that values are interpolated from at first, and at most
_N_TEST, _N_NEAR = 64, 24  # pairs to tell the error: by chance, and evenly in separation for the largest
_MORE = 1.5  # of the pairs, when they do not suffice
_EVENLY = 0.4  # share of the pairs that are chosen evenly in separation, the others by chance
_WORTH = 0.8  # of all pairs: when so many are needed, all are calculated
_SEED = 7
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
_SINGLE, _LARGEST_ROUNDING = 6e-8, 1e-4  # rounding in single precision, and the most that it may change a value
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
        Largest of the errors of those, of pairs chosen evenly in separation, and of each that served for it if it had
        not, times `size`.
    width_error : float
        Relative error of the interval's width that changes most, if errors of pairs have nothing to do with each other.
    """

    values: FloatArray
    n_calculated: int
    error: float
    largest_error: float
    width_error: float


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
    alike: FloatArray,
    size: FloatArray,
    shares: FloatArray,
    calculate: Callable[[NDArray[np.int64]], FloatArray],
    tolerance: float,
    width_tolerance: float,
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
    alike : ndarray, shape (n,)
        Values that are like those asked for, and known of all pairs: those without probe volumes, or by coarser rules.
    size : ndarray, shape (n,)
        Factors by which errors of the values count.
    shares : ndarray, shape (n, n_width)
        How much widths of intervals change, relatively, with the error of each value, so counted.
    calculate : callable
        Returns the values of the pairs whose numbers it is given.
    tolerance : float
        Largest relative error, in the root of the mean square.
    width_tolerance : float
        Largest relative error of a width, if errors of pairs have nothing to do with each other.

    Returns
    -------
    sample : PairSample
        The values.

    Notes
    -----
    The logarithm of the values, that of their ratio to values that are like them, or the difference from those,
    whichever is best, is the mean of a Gaussian process with Matérn's covariance of order 5/2 in the features, given
    the pairs that are calculated: these are chosen evenly in separation across the wind and by chance, the same at all
    wind speeds, whose lines are then at
    hand. Others, chosen by chance, tell the error. While that is above the tolerance, half as many more are calculated,
    beside those that are; all of them when four in five do not suffice.
    """
    n, scaled = len(apart), features / _SCALE
    chance = np.random.default_rng(_SEED).permutation(n)
    known = np.full(n, np.nan)

    def know(index: NDArray[np.int64]) -> None:
        new = index[np.isnan(known[index])]
        if len(new):
            known[new] = calculate(new)

    ways: tuple[_Ratio | _Difference, ...] = (_Ratio(alike), _Ratio(np.ones(n)), _Difference(alike, size))
    test, count = np.append(chance[:_N_TEST], spread_pairs(apart, _N_NEAR)), _FIRST
    evenly, others = _without(_filling(aside), test), _without(chance, test)
    while count <= min(_WORTH * n, _MOST):
        first = evenly[: int(_EVENLY * count)]
        chosen = np.sort(np.append(first, _without(others, first)[: count - len(first)]))
        know(np.union1d(chosen, test))
        fields = [_Smooth(scaled[chosen], way.told(known, chosen)) for way in ways]
        off = [
            size[test] * (way.value(field.at(scaled[test]), test) - known[test])
            for field, way in zip(fields, ways, strict=True)
        ]
        by_chance = test[:_N_TEST]
        whole = np.sum((size * known)[by_chance] ** 2)
        errors = np.array([np.sqrt(np.sum(one[:_N_TEST] ** 2) / whole) for one in off])
        widths = np.array([_of_widths(shares[by_chance] * one[:_N_TEST, np.newaxis], n) for one in off])
        best = int(np.argmin(np.maximum(errors / tolerance, widths / width_tolerance)))
        if errors[best] <= tolerance and widths[best] <= width_tolerance:
            missing = np.flatnonzero(np.isnan(known))
            known[missing] = ways[best].value(fields[best].at(scaled[missing]), missing)
            others_say = ways[best].value(fields[best].left_out(), chosen)
            largest = float(max(np.max(np.abs(off[best])), np.max(np.abs(size[chosen] * (others_say - known[chosen])))))
            return PairSample(known, n - len(missing), float(errors[best]), largest, float(widths[best]))
        count = int(_MORE * count)
    know(np.arange(n))
    return PairSample(known, n, 0.0, 0.0, 0.0)


def _of_widths(changes: FloatArray, count: int) -> float:
    """Return the largest change of a width by `count` errors, from the changes by some of them, drawn by chance."""
    return float(np.max(np.sqrt(count * np.mean(changes**2, axis=0)), initial=0.0))


def spread_pairs(apart: FloatArray, count: int) -> NDArray[np.int64]:
    """Return the numbers of about `count` pairs that are evenly spread over their separations, ascending."""
    return np.unique(_nearest_to(np.linspace(np.min(apart), np.max(apart), count), apart))


def _filling(aside: FloatArray) -> NDArray[np.int64]:
    """Return numbers of pairs in an order of which every beginning is evenly spread over the separations."""
    turn = np.modf(_GOLDEN * np.arange(1, min(len(aside), 4 * _MOST) + 1))[0]  # the next one falls into the largest gap
    found = _nearest_to(np.min(aside) + turn * np.ptp(aside), aside)
    _, first = np.unique(found, return_index=True)
    return found[np.sort(first)]


def _nearest_to(places: FloatArray, separation: FloatArray) -> NDArray[np.int64]:
    order = np.argsort(separation, kind="stable")
    return order[np.clip(np.searchsorted(separation[order], places), 0, len(order) - 1)]


def _without(index: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.int64]:
    rest = np.ones(max(int(np.max(index, initial=-1)), int(np.max(other, initial=-1))) + 1, dtype=bool)
    rest[other] = False
    return index[rest[index]]


class _Ratio(NamedTuple):
    """Values told by the logarithm of their ratio to others."""

    others: FloatArray

    def told(self, values: FloatArray, index: NDArray[np.int64]) -> FloatArray:
        return np.asarray(np.log(values[index] / self.others[index]))

    def value(self, told: FloatArray, index: NDArray[np.int64]) -> FloatArray:
        return np.asarray(self.others[index] * np.exp(told))


class _Difference(NamedTuple):
    """Values told by their difference from others, over the mean size of those."""

    others: FloatArray
    size: FloatArray

    @property
    def unit(self) -> FloatArray:
        return np.asarray(np.sqrt(np.mean((self.size * self.others) ** 2)) / self.size)

    def told(self, values: FloatArray, index: NDArray[np.int64]) -> FloatArray:
        return np.asarray((values - self.others)[index] / self.unit[index])

    def value(self, told: FloatArray, index: NDArray[np.int64]) -> FloatArray:
        # no square of a norm is below zero: this only moves an interpolated one towards what it stands for
        return np.maximum(self.others[index] + told * self.unit[index], 0.0)


class _Smooth:
    """The mean of a Gaussian process, given values at some places."""

    def __init__(self, places: FloatArray, values: FloatArray) -> None:
        self.places, self.values, self.middle = places, values, float(np.mean(values))
        covariance = _matern(places, places)
        covariance[np.diag_indices(len(places))] += _NUGGET
        self.root = scipy.linalg.cholesky(covariance, lower=True)
        self.weights = scipy.linalg.cho_solve((self.root, True), values - self.middle)
        self.single = _SINGLE * np.sum(np.abs(self.weights)) < _LARGEST_ROUNDING

    def left_out(self) -> FloatArray:
        """Return what each value would be told to be by the others: v − w/diag(C⁻¹), with the weights w = C⁻¹v."""
        half = scipy.linalg.solve_triangular(self.root, np.eye(len(self.root)), lower=True)
        return np.asarray(self.values - self.weights / np.sum(half**2, axis=0))

    def at(self, places: FloatArray) -> FloatArray:
        """Return its values at other places."""
        rows = max(1, _BLOCK // len(self.places))
        return np.concatenate(
            [
                self.middle + _matern(places[start : start + rows], self.places, single=self.single) @ self.weights
                for start in range(0, len(places), rows)
            ]
        )


def _matern(one: FloatArray, other: FloatArray, *, single: bool = False) -> FloatArray:
    square = np.column_stack([-10.0 * one, 5.0 * np.sum(one**2, axis=1), np.ones(len(one))]) @ np.vstack(
        [other.T, np.ones(len(other)), 5.0 * np.sum(other**2, axis=1)]
    )  # 5 |a − b|² as one product
    distance = np.maximum(square, 0.0, out=square).astype(np.float32 if single else np.float64, copy=False)
    np.sqrt(distance, out=distance)
    factor = distance * (1.0 / 3.0)
    factor += 1.0
    factor *= distance
    factor += 1.0
    np.negative(distance, out=distance)
    factor *= np.exp(distance, out=distance)
    return np.asarray(factor)
