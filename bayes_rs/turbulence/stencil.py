"""Interpolation on even grids, to fifth order where no other is asked for."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

STENCIL = 6
"""Points that a value is interpolated from."""
_BLOCK = 10_000  # values at a time: their working arrays stay in the processor's cache


def interpolate_rows(values: FloatArray, position: FloatArray) -> FloatArray:
    """Return rows of `values` (n, n_grid) at fractional positions of each row (n, n_position)."""
    count, flat, found = values.shape[1], values.ravel(), np.empty_like(position)
    rows = max(1, _BLOCK // max(position.shape[1], 1))
    for start in range(0, len(values), rows):
        at, weights = _stencil_weights(position[start : start + rows], count, STENCIL)
        at += (count * np.arange(start, start + len(at)))[:, np.newaxis]
        total = np.multiply(weights[0], flat.take(at, mode="clip"), out=found[start : start + rows])
        for weight in weights[1:]:
            at += 1
            total += weight * flat.take(at, mode="clip")
    return found


def stencil(position: FloatArray, count: int, n_point: int = STENCIL) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the `n_point` grid points and their weights at fractional `position`, shapes (n, n_point)."""
    first, weights = _stencil_weights(position, count, n_point)
    return first[:, np.newaxis] + np.arange(n_point), np.stack(weights, axis=-1)


def _stencil_weights(position: FloatArray, count: int, n_point: int) -> tuple[NDArray[np.int64], list[FloatArray]]:
    """Return the first grid point and the Lagrange weights at fractional `position` on a grid of `count` points."""
    first = np.clip(np.floor(position).astype(np.int64) - (n_point // 2 - 1), 0, count - n_point)
    t = position - first.astype(position.dtype)
    distance = [t - point for point in range(n_point)]
    below, above = [distance[0]], [distance[-1]]  # products of the distances to all points before, and after, one
    for point in range(1, n_point - 1):
        below.append(below[-1] * distance[point])
        above.append(above[-1] * distance[n_point - 1 - point])
    numerators = [above[-1], *(below[point - 1] * above[-1 - point] for point in range(1, n_point - 1)), below[-1]]
    return first, [numerator * scale for numerator, scale in zip(numerators, _scales(n_point), strict=True)]


def stretched(separation: FloatArray) -> FloatArray:
    """Return asinh(separation): the grids of this package are even in it."""
    if separation.dtype != np.float32:
        return np.asarray(np.arcsinh(separation))
    far = np.abs(separation)
    size: FloatArray = np.log(far + np.sqrt(far * far + np.float32(1.0)))  # NumPy's own takes ten times as long
    return np.copysign(size, separation)


@cache
def _scales(n_point: int) -> list[float]:
    """Return the scales of Lagrange's polynomials."""
    return [1.0 / math.prod(point - other for other in range(n_point) if other != point) for point in range(n_point)]
