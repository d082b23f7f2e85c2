"""Cholesky factors and triangular systems of very many small matrices: loops over their rows, arrays over the many.

Arrays have the rows of the matrices first and the many last: (d, d, n) for matrices and (d, n) for vectors.
"""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray


def factor(matrix: FloatArray) -> FloatArray:
    """Return the lower Cholesky factors, shape (d, d, …), of symmetric positive definite matrices (d, d, …)."""
    d = len(matrix)
    flat = matrix.reshape(d, d, -1)
    lower = np.zeros(flat.shape)
    for j in range(d):
        column = lower[j:, j]
        np.subtract(flat[j:, j], np.einsum("ikn,kn->in", lower[j:, :j], lower[j, :j]), out=column)
        np.sqrt(column[0], out=column[0])
        column[1:] /= column[0]
    return lower.reshape(matrix.shape)


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


def log_diagonal(lower: FloatArray) -> FloatArray:
    """Return the sum of the logarithms of the diagonals, shape (…)."""
    diagonal = lower[0, 0].copy()
    for i in range(1, len(lower)):
        diagonal *= lower[i, i]
    return np.asarray(np.log(diagonal))
