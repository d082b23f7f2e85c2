"""Toeplitz matrices of covariances, with the mean or the straight line taken out of rows and columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft

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


def toeplitz_gram(diagonals: ArrayLike, n_row: int, n_column: int, *, detrend: str = "mean") -> FloatArray:
    """Return ⟨P A P, P B P⟩ for every two of some Toeplitz matrices; see `toeplitz_inner`.

    Parameters
    ----------
    diagonals : array_like, shape (n, n_row + n_column - 1)
        The diagonals of the matrices.
    n_row, n_column : int
        Rows and columns.
    detrend : str
        ``"mean"`` or ``"linear"``.

    Returns
    -------
    gram : ndarray, shape (n, n)
        Symmetric.

    Examples
    --------
    >>> toeplitz_gram([[0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0, 0.0]], 3, 3).round(12)
    array([[2., 4.],
           [4., 8.]])
    """
    a = np.asarray(diagonals, dtype=np.float64)
    lag = np.arange(-(n_row - 1), n_column)
    length = np.minimum(np.minimum(n_row, n_column), np.minimum(n_column - lag, n_row + lag)).astype(np.float64)
    rows = _projections(a, n_row, n_column, detrend)
    columns = _projections(a[:, ::-1], n_column, n_row, detrend)
    both = (rows @ _basis(n_column, detrend)).reshape(len(a), -1)
    total = (a * length) @ a.T + both @ both.T
    for part in (rows.reshape(len(a), -1), columns.reshape(len(a), -1)):
        total -= part @ part.T
    return np.asarray(0.5 * (total + total.T))


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


def gapped_inner(
    diagonals: ArrayLike, row_present: ArrayLike, column_present: ArrayLike, *, detrend: str = "mean"
) -> FloatArray:
    """Return ‖P A P‖² for Toeplitz matrices A of which only some rows and columns are there.

    Parameters
    ----------
    diagonals : array_like, shape (..., n_row + n_column - 1)
        The diagonals of A: A[i, j] = diagonals[j - i + n_row - 1].
    row_present, column_present : array_like of bool, shapes (..., n_row) and (..., n_column)
        Which rows and columns are there.
    detrend : str
        ``"mean"`` or ``"linear"``: P takes the mean, or the straight line, of what is there out of rows and columns.

    Returns
    -------
    norm : ndarray, shape (...)
        Σ_ij (PAP)²_ij over the rows and columns that are there.

    Raises
    ------
    InputError
        If the shapes disagree.

    Notes
    -----
    With the indicators r and c of the rows and columns, and Q_r and Q_c the orthonormal columns of what P removes, zero
    where nothing is there,

        ‖PAP‖² = rᵀA²c − ‖Q_rᵀA diag c‖² − ‖diag r A Q_c‖² + ‖Q_rᵀA Q_c‖²,

    A² element by element. All products of A with vectors are convolutions, by fast Fourier transforms: N log N each.

    Examples
    --------
    Two of three samples of white noise, their mean removed:

    >>> float(gapped_inner([0.0, 0.0, 1.0, 0.0, 0.0], [True, False, True], [True, False, True]).round(12))
    1.0
    """
    a = np.asarray(diagonals, dtype=np.float64)
    rows, columns = np.asarray(row_present, dtype=np.bool_), np.asarray(column_present, dtype=np.bool_)
    check_choice(detrend, DETRENDING, what="detrend")
    if min(a.ndim, rows.ndim, columns.ndim) == 0 or a.shape[-1] != rows.shape[-1] + columns.shape[-1] - 1:
        raise InputError(
            f"Invalid diagonals of shape {a.shape}: a matrix with row_present of shape {rows.shape} and column_present "
            f"of shape {columns.shape} has one for each row and column, less one."
        )
    there = columns[..., np.newaxis, :].astype(np.float64)
    total = np.sum(rows * _times(a * a, there)[..., 0, :], axis=-1)
    left, right = _gapped_basis(rows, detrend), _gapped_basis(columns, detrend)
    along_rows = rows[..., np.newaxis, :] * _times(a, right)
    along_columns = there * _times(a[..., ::-1], left)
    total -= np.sum(along_rows**2, axis=(-1, -2)) + np.sum(along_columns**2, axis=(-1, -2))
    return np.asarray(total + np.sum((left @ along_rows.swapaxes(-1, -2)) ** 2, axis=(-1, -2)))


def gapped_trace(diagonals: ArrayLike, present: ArrayLike, *, detrend: str = "mean") -> FloatArray:
    """Return tr(P A P) for square Toeplitz matrices of which only some rows and columns are there; see `gapped_inner`.

    Parameters
    ----------
    diagonals : array_like, shape (..., 2n - 1)
        The diagonals of A.
    present : array_like of bool, shape (..., n)
        Which rows, and the same columns, are there.
    detrend : str
        ``"mean"`` or ``"linear"``.

    Returns
    -------
    trace : ndarray, shape (...)
        tr(P A P) = tr A − tr(QᵀAQ).

    Examples
    --------
    >>> float(gapped_trace([0.0, 0.0, 1.0, 0.0, 0.0], [True, False, True]).round(12))
    1.0
    """
    a, there = np.asarray(diagonals, dtype=np.float64), np.asarray(present, dtype=np.bool_)
    basis = _gapped_basis(there, detrend)
    inside = np.sum(basis * _times(a, basis), axis=(-1, -2))
    return np.asarray(np.count_nonzero(there, axis=-1) * a[..., there.shape[-1] - 1] - inside)


def _times(diagonals: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return A @ vector for Toeplitz matrices, shape (..., m, n_row), of vectors of shape (..., m, n_column)."""
    n_lag, n_column = diagonals.shape[-1], vectors.shape[-1]
    size = int(next_fast_len(n_lag + n_column - 1, real=True))
    turned = rfft(diagonals[..., ::-1], size)[..., np.newaxis, :]
    product = irfft(turned * rfft(vectors, size), size)
    return np.asarray(product[..., n_column - 1 : n_lag])


def _gapped_basis(present: NDArray[np.bool_], detrend: str) -> FloatArray:
    """Return the orthonormal vectors that P removes, zero where nothing is there, shape (..., 1 or 2, n)."""
    count = np.maximum(np.count_nonzero(present, axis=-1), 1)[..., np.newaxis]
    vectors = [present / np.sqrt(count)]
    if detrend == "linear":
        place = np.arange(present.shape[-1], dtype=np.float64)
        line = present * (place - np.sum(present * place, axis=-1, keepdims=True) / count)
        length = np.linalg.norm(line, axis=-1, keepdims=True)
        vectors.append(line / np.where(length > 0.0, length, 1.0))
    return np.stack(vectors, axis=-2)


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
