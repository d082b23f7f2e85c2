"""The Reynolds stress tensor: the order of its six numbers, packing, rotation, realizability."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, as_numbers
from bayes_rs.errors import InputError

STRESSES: tuple[str, ...] = ("uu", "vv", "ww", "uv", "uw", "vw")
"""The order of the six stresses, everywhere."""

_ROW = np.array([0, 1, 2, 0, 0, 1])
_COLUMN = np.array([0, 1, 2, 1, 2, 2])
_ROUNDING = 1e-9


def pack_stress(tensor: ArrayLike) -> FloatArray:
    """Take the six stresses out of Reynolds stress tensors.

    Parameters
    ----------
    tensor : array_like, shape (..., 3, 3)
        Symmetric tensors, m² s⁻².

    Returns
    -------
    stress : ndarray, shape (..., 6)
        uu, vv, ww, uv, uw, vw, m² s⁻².

    Raises
    ------
    InputError
        If the last two dimensions are not 3 × 3, or a tensor is not symmetric to rounding.

    Examples
    --------
    >>> pack_stress([[1.8, 0.1, -0.4], [0.1, 0.9, 0.0], [-0.4, 0.0, 0.5]])
    array([ 1.8,  0.9,  0.5,  0.1, -0.4,  0. ])
    """
    array = as_numbers(tensor, what="tensor")
    if array.shape[-2:] != (3, 3):
        raise InputError(f"Invalid tensor of shape {array.shape}: the last two dimensions must be 3 and 3.")
    if not np.allclose(array, np.swapaxes(array, -1, -2), rtol=1e-12, atol=1e-12 * np.max(np.abs(array), initial=0.0)):
        raise InputError("Invalid tensor: it must be symmetric, and its off-diagonal entries differ.")
    return array[..., _ROW, _COLUMN]


def unpack_stress(stress: ArrayLike) -> FloatArray:
    """Build Reynolds stress tensors from the six stresses; the inverse of `pack_stress`.

    Parameters
    ----------
    stress : array_like, shape (..., 6)
        uu, vv, ww, uv, uw, vw, m² s⁻².

    Returns
    -------
    tensor : ndarray, shape (..., 3, 3)
        Symmetric tensors, m² s⁻².

    Raises
    ------
    InputError
        If the last dimension is not 6.

    Examples
    --------
    >>> unpack_stress([1.8, 0.9, 0.5, 0.1, -0.4, 0.0])
    array([[ 1.8,  0.1, -0.4],
           [ 0.1,  0.9,  0. ],
           [-0.4,  0. ,  0.5]])
    """
    array = as_numbers(stress, what="stress")
    if array.ndim == 0 or array.shape[-1] != len(STRESSES):
        raise InputError(f"Invalid stress of shape {array.shape}: the last dimension must hold {', '.join(STRESSES)}.")
    tensor = np.empty((*array.shape[:-1], 3, 3))
    tensor[..., _ROW, _COLUMN] = array
    tensor[..., _COLUMN, _ROW] = array
    return tensor


def rotate_stress(stress: ArrayLike, rotation: ArrayLike) -> FloatArray:
    """Express stresses in another frame: R' = Tᵀ R T for row vectors n' = n T.

    Parameters
    ----------
    stress : array_like, shape (..., 6)
        Stresses in the old frame, m² s⁻².
    rotation : array_like, shape (..., 3, 3)
        Rotation T that takes a row vector from the old frame to the new one, as n' = n T.

    Returns
    -------
    stress : ndarray, shape (..., 6)
        Stresses in the new frame, m² s⁻².

    Notes
    -----
    n'·R'n' = n T Tᵀ R T Tᵀ nᵀ = n·R n: a rotation of beams and tensor together changes no radial variance.
    """
    matrix, tensor = as_numbers(rotation, what="rotation"), unpack_stress(stress)
    if matrix.shape[-2:] != (3, 3):
        raise InputError(f"Invalid rotation of shape {matrix.shape}: the last two dimensions must be 3 and 3.")
    rotated = np.swapaxes(matrix, -1, -2) @ tensor @ matrix
    return rotated[..., _ROW, _COLUMN]


def principal_variances(stress: ArrayLike) -> FloatArray:
    """Return the eigenvalues of R, ascending.

    Parameters
    ----------
    stress : array_like, shape (..., 6)
        Stresses, m² s⁻².

    Returns
    -------
    variances : ndarray, shape (..., 3)
        Principal variances, m² s⁻², smallest first. R is realizable if none is negative.

    Examples
    --------
    >>> principal_variances([3.0, 2.0, 1.0, 0.0, 0.0, 0.0])
    array([1., 2., 3.])
    """
    return np.asarray(np.linalg.eigvalsh(unpack_stress(stress)), dtype=np.float64)


def is_realizable(stress: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Tell which tensors are positive semi-definite, to rounding.

    Parameters
    ----------
    stress : array_like, shape (..., 6)
        Stresses, m² s⁻².

    Returns
    -------
    realizable : ndarray of bool, shape (...)
        True where the smallest principal variance is not below zero by more than rounding, 8 ε of the largest.

    Examples
    --------
    >>> is_realizable([[1.0, 1.0, 1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.5, 0.0, 0.0]])
    array([ True, False])
    """
    variances = principal_variances(stress)
    return np.asarray(variances[..., 0] >= -8.0 * np.finfo(np.float64).eps * np.abs(variances[..., 2]))


def first_impossible(stress: ArrayLike) -> tuple[int, str] | None:
    """Return the first row of stresses that no wind has, and what of it is so, in words; None if there is none.

    Parameters
    ----------
    stress : array_like, shape (n, 6)
        Stresses that were measured, m² s⁻²; what is not finite is not known.

    Returns
    -------
    found : tuple of int and str, or None
        The row, and words that follow its name, as ``has uu -1 m² s⁻²: a variance is above zero``.

    Notes
    -----
    Variances are above zero, and a whole tensor is positive definite, to rounding. Of a tensor that is known in part,
    each covariance must be below the root of the product of its two variances. That is enough: for three components
    there are then values of what is missing that make the tensor positive definite.

    Examples
    --------
    >>> first_impossible([[1.0, 1.0, 1.0, 0.9, 0.9, -0.9]])
    (0, 'has the smallest principal variance -0.8 m² s⁻²: its covariances do not go together, which no wind has')
    >>> first_impossible([[1.0, 1.0, 1.0, 0.9, 0.9, np.nan]])
    """
    values = as_numbers(stress, what="stress")
    bad = np.argwhere(values[:, :3] <= 0.0)
    if len(bad):
        row, column = (int(index) for index in bad[0])
        return row, f"has {STRESSES[column]} {values[row, column]:g} m² s⁻²: a variance is above zero"
    known = np.where(np.isfinite(values), values, np.nan)
    root = np.sqrt(known[:, :3])
    for column, (i, j) in enumerate(zip(_ROW[3:], _COLUMN[3:], strict=True), start=3):
        most = root[:, i] * root[:, j]
        beyond = np.flatnonzero(np.abs(known[:, column]) >= most * (1.0 - _ROUNDING))
        if len(beyond):
            row = int(beyond[0])
            return row, (
                f"has {STRESSES[column]} {known[row, column]:g} m² s⁻², beyond the root of {STRESSES[i]} times "
                f"{STRESSES[j]}, {most[row]:g}, which no wind has"
            )
    whole = np.flatnonzero(np.isfinite(known).all(axis=1))
    correlation = np.ones((len(whole), len(STRESSES)))
    correlation[:, 3:] = known[whole, 3:] / (root[whole][:, _ROW[3:]] * root[whole][:, _COLUMN[3:]])
    beyond = whole[principal_variances(correlation)[:, 0] <= _ROUNDING]
    if len(beyond):
        row = int(beyond[0])
        return row, (
            f"has the smallest principal variance {principal_variances(known[row])[0]:.3g} m² s⁻²: its covariances do "
            "not go together, which no wind has"
        )
    return None
