"""Toeplitz matrices of covariances, with the mean or the straight line taken out of rows and columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_choice, check_count
from bayes_rs.errors import InputError

DETRENDING: tuple[str, ...] = ("mean", "linear")
"""What is removed from a record before its variance is taken."""


def toeplitz_inner(
    first: ArrayLike, second: ArrayLike, n_row: int, n_column: int, *, detrend: str = "mean"
) -> FloatArray:
    """Return ⟨P A P, P B P⟩ for Toeplitz matrices A and B, in a time proportional to their size, not its square.

    Parameters
    ----------
    first, second : array_like, shape (..., n_row + n_column - 1)
        The diagonals of A and B: A[i, j] = first[j - i + n_row - 1].
    n_row, n_column : int
        Rows and columns.
    detrend : str
        ``"mean"`` or ``"linear"``: P takes the mean, or the straight line, out of rows and columns.

    Returns
    -------
    inner : ndarray, shape (...)
        Σ_ij (PAP)_ij (PBP)_ij; for A = B the squared Frobenius norm ‖P A P‖².

    Raises
    ------
    InputError
        If the shapes disagree.

    Notes
    -----
    With orthonormal columns Q of what P removes, P = 1 − QQᵀ,

        ⟨PAP, PBP⟩ = ⟨A, B⟩ − ⟨QᵀA, QᵀB⟩ − ⟨AQ, BQ⟩ + ⟨QᵀAQ, QᵀBQ⟩.

    ⟨A, B⟩ weights each diagonal with its length, and QᵀA and AQ are running sums of the diagonals.

    Examples
    --------
    White noise, A = 1: what is left of the trace is the number of samples less one:

    >>> float(toeplitz_inner([0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0], 3, 3).round(12))
    2.0
    """
    check_count(n_row, what="n_row")
    check_count(n_column, what="n_column")
    check_choice(detrend, DETRENDING, what="detrend")
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    n_lag = n_row + n_column - 1
    if a.ndim == 0 or b.ndim == 0 or a.shape[-1] != n_lag or b.shape[-1] != n_lag:
        raise InputError(
            f"Invalid diagonals of shapes {a.shape} and {b.shape}: a matrix of {n_row} rows and {n_column} columns has "
            f"{n_lag} of them."
        )
    lag = np.arange(-(n_row - 1), n_column)
    length = np.minimum(np.minimum(n_row, n_column), np.minimum(n_column - lag, n_row + lag)).astype(np.float64)
    total = np.sum(length * a * b, axis=-1)
    along_rows, along_columns = (
        _projections(a, n_row, n_column, detrend),
        _projections(a[..., ::-1], n_column, n_row, detrend),
    )
    if a is b:
        other_rows, other_columns = along_rows, along_columns
    else:
        other_rows = _projections(b, n_row, n_column, detrend)
        other_columns = _projections(b[..., ::-1], n_column, n_row, detrend)
    removed = _basis(n_column, detrend)
    total -= np.sum(along_rows * other_rows, axis=(-1, -2)) + np.sum(along_columns * other_columns, axis=(-1, -2))
    return np.asarray(total + np.sum((along_rows @ removed) * (other_rows @ removed), axis=(-1, -2)))


def toeplitz_trace(diagonals: ArrayLike, n: int, *, detrend: str = "mean") -> FloatArray:
    """Return tr(P A P) for square Toeplitz matrices; see `toeplitz_inner`.

    Parameters
    ----------
    diagonals : array_like, shape (..., 2n - 1)
        The diagonals of A: A[i, j] = diagonals[j - i + n - 1].
    n : int
        Rows and columns.
    detrend : str
        ``"mean"`` or ``"linear"``.

    Returns
    -------
    trace : ndarray, shape (...)
        tr(P A P) = tr A − tr(QᵀAQ).

    Examples
    --------
    >>> float(toeplitz_trace([0.0, 0.0, 1.0, 0.0, 0.0], 3, detrend="linear").round(12))
    1.0
    """
    a = np.asarray(diagonals, dtype=np.float64)
    inside = _projections(a, n, n, detrend) @ _basis(n, detrend)
    return np.asarray(n * a[..., n - 1] - np.trace(inside, axis1=-2, axis2=-1))


def _basis(n: int, detrend: str) -> FloatArray:
    """Return the orthonormal columns Q that P removes, shape (n, 1) or (n, 2)."""
    columns = [np.full(n, 1.0 / np.sqrt(n))]
    if detrend == "linear" and n > 1:
        line = np.arange(n) - 0.5 * (n - 1)
        columns.append(line / np.linalg.norm(line))
    return np.stack(columns, axis=-1)


def _projections(diagonals: FloatArray, n_row: int, n_column: int, detrend: str) -> FloatArray:
    """Return QᵀA of Toeplitz matrices, shape (..., 1 or 2, n_column), from running sums of the diagonals."""
    sums = _window_sums(diagonals, n_row)
    parts = [sums / np.sqrt(n_row)]
    if detrend == "linear" and n_row > 1:
        lag = np.arange(-(n_row - 1), n_column)
        moments = _window_sums(lag * diagonals, n_row)  # row i = j − lag of column j
        line = np.arange(n_row) - 0.5 * (n_row - 1)
        parts.append(((np.arange(n_column) - 0.5 * (n_row - 1)) * sums - moments) / np.linalg.norm(line))
    return np.stack(parts, axis=-2)


def _window_sums(values: FloatArray, width: int) -> FloatArray:
    """Return the sums over all windows of `width` along the last axis."""
    running = np.cumsum(values, axis=-1)
    sums = running[..., width - 1 :].copy()
    sums[..., 1:] -= running[..., :-width]
    return sums
