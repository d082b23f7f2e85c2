"""Cholesky factors and triangular systems of very many small matrices: loops over their rows, arrays over the many.

Arrays have the rows of the matrices first and the many last: (d, d, n) for matrices and (d, n) for vectors.
"""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray


def factor(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the lower Cholesky factors, shape (d, d, m, n), of all sums of matrices (d, d, n) and others (d, d, m).

    What lies above the diagonal is not set.
    """
    d, m, n = len(one), other.shape[-1], one.shape[-1]
    lower = np.empty((d, d, m, n))
    flat = lower.reshape(d, d, m * n)  # the same numbers
    for j in range(d):
        column = lower[j:, j]
        np.add(one[j:, j, None, :], other[j:, j, :, None], out=column)
        if j:
            flat[j:, j] -= np.einsum("ikn,kn->in", flat[j:, :j], flat[j, :j])
        np.sqrt(column[0], out=column[0])
        column[1:] *= 1.0 / column[0]
    return lower


def solve_lower(lower: FloatArray, vector: FloatArray) -> FloatArray:
    """Return x with L x = vector, shape (d, …)."""
    left = np.array(vector, dtype=np.float64)
    for i in range(len(lower)):
        left[i] /= lower[i, i]
        left[i + 1 :] -= lower[i + 1 :, i] * left[i]
    return left


def solve_upper(lower: FloatArray, vector: FloatArray) -> FloatArray:
    """Return x with Lᵀ x = vector, shape (d, …)."""
    left = np.array(vector, dtype=np.float64)
    for i in reversed(range(len(lower))):
        left[i] /= lower[i, i]
        left[:i] -= lower[i, :i] * left[i]
    return left


def times_upper(lower: FloatArray, vector: FloatArray) -> FloatArray:
    """Return Lᵀ vector, shape (d, …)."""
    found = np.empty(vector.shape)
    for i in range(len(lower)):
        np.einsum("k...,k...->...", lower[i:, i], vector[i:], out=found[i])
    return found


def log_diagonal(lower: FloatArray) -> FloatArray:
    """Return the sum of the logarithms of the diagonals, shape (…)."""
    diagonal = lower[0, 0].copy()
    for i in range(1, len(lower)):
        diagonal *= lower[i, i]
    return np.asarray(np.log(diagonal))
