"""Interpolation to fifth order on even grids."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

STENCIL = 6
"""Points that a value is interpolated from."""
_BLOCK = 10_000  # values at a time: their working arrays stay in the processor's cache
_SCALES = [
    1.0 / math.prod(point - other for other in range(STENCIL) if other != point) for point in range(STENCIL)
]  # of Lagrange's polynomials


def interpolate_rows(values: FloatArray, position: FloatArray) -> FloatArray:
    """Return rows of `values` (n, n_grid) at fractional positions of each row (n, n_position)."""
    count, flat, found = values.shape[1], values.ravel(), np.empty_like(position)
    rows = max(1, _BLOCK // max(position.shape[1], 1))
    for start in range(0, len(values), rows):
        at, weights = _stencil_weights(position[start : start + rows], count)
        at += (count * np.arange(start, start + len(at)))[:, np.newaxis]
        total = np.multiply(weights[0], flat[at], out=found[start : start + rows])
        for weight in weights[1:]:
            at += 1
            total += weight * flat[at]
    return found


def stencil(position: FloatArray, count: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the grid points, shape (n, 6), and weights of the interpolation at fractional `position`."""
    first, weights = _stencil_weights(position, count)
    return first[:, np.newaxis] + np.arange(STENCIL), np.stack(weights, axis=-1)


def _stencil_weights(position: FloatArray, count: int) -> tuple[NDArray[np.int64], list[FloatArray]]:
    """Return the first grid point and the six Lagrange weights at fractional `position` on a grid of `count` points."""
    first = np.clip(np.floor(position).astype(np.int64) - (STENCIL // 2 - 1), 0, count - STENCIL)
    t = position - first
    distance = [t - point for point in range(STENCIL)]
    below, above = [distance[0]], [distance[-1]]  # products of the distances to all points before, and after, one
    for point in range(1, STENCIL - 1):
        below.append(below[-1] * distance[point])
        above.append(above[-1] * distance[STENCIL - 1 - point])
    numerators = [above[-1], *(below[point - 1] * above[-1 - point] for point in range(1, STENCIL - 1)), below[-1]]
    return first, [numerator * scale for numerator, scale in zip(numerators, _SCALES, strict=True)]
