"""Interpolation to fifth order on even grids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

STENCIL = 6
"""Points that a value is interpolated from."""


def interpolate_rows(values: FloatArray, position: FloatArray) -> FloatArray:
    """Return rows of `values` (n, n_grid) at fractional positions of each row (n, n_position)."""
    first, weights = _stencil_weights(position, values.shape[1])
    offset = first + (values.shape[1] * np.arange(len(values)))[:, np.newaxis]
    flat, total = values.ravel(), np.zeros_like(position)
    for point, weight in enumerate(weights):
        total += weight * flat[offset + point]
    return total


def stencil(position: FloatArray, count: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the grid points, shape (n, 6), and weights of the interpolation at fractional `position`."""
    first, weights = _stencil_weights(position, count)
    return first[:, np.newaxis] + np.arange(STENCIL), np.stack(weights, axis=-1)


def _stencil_weights(position: FloatArray, count: int) -> tuple[NDArray[np.int64], list[FloatArray]]:
    """Return the first grid point and the six Lagrange weights at fractional `position` on a grid of `count` points."""
    first = np.clip(np.floor(position).astype(np.int64) - (STENCIL // 2 - 1), 0, count - STENCIL)
    t = position - first
    factors = [t - j for j in range(STENCIL)]
    weights = []
    for point in range(STENCIL):
        numerator, denominator = np.ones_like(t), 1.0
        for other in range(STENCIL):
            if other != point:
                numerator = numerator * factors[other]
                denominator *= point - other
        weights.append(numerator / denominator)
    return first, weights
