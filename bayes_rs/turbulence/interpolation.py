"""Interpolation between the states of a regular net, and positive semi-definite matrices that are near others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray

_POINTS = 4  # of an axis that a value is interpolated from: third order
_SAME = 1e-9  # coordinates no farther apart are one
_FEW_NUMBERS = 512  # of a state, up to which those of all states are multiplied at once


@dataclass(frozen=True, eq=False)
class StateNet:
    """A regular net: every combination of the coordinates of its axes is one state.

    Parameters
    ----------
    axes : tuple of ndarray
        The coordinates of each axis, ascending.
    number : ndarray of int, shape (len(axes[0]), len(axes[1]), …)
        Which state each point of the net is.

    Examples
    --------
    >>> net = find_net([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0]])
    >>> net.weights([[0.5, 5.0]])[0].round(3)
    array([[ 0.375,  0.75 , -0.125]])
    """

    axes: tuple[FloatArray, ...]
    number: NDArray[np.int64]

    def weights(self, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the weights of the states, and the points after they were moved onto the net.

        Parameters
        ----------
        points : array_like, shape (n, n_axis)
            Where to interpolate.

        Returns
        -------
        weights : ndarray, shape (n, n_state)
            The value at a point is weights @ values; each row sums to one.
        inside : ndarray, shape (n, n_axis)
            The points, those outside the net moved to its nearest edge.

        Notes
        -----
        Along each axis, Lagrange's polynomial through the four nearest coordinates, two on each side (fewer and
        one-sided at the edges, and all where there are fewer than four): continuous everywhere, and exact at the
        states. The weights of several axes multiply.
        """
        where = np.atleast_2d(np.asarray(points, dtype=np.float64))
        inside = np.column_stack([np.clip(where[:, i], axis[0], axis[-1]) for i, axis in enumerate(self.axes)])
        along = [lagrange_weights(axis, inside[:, i]) for i, axis in enumerate(self.axes)]
        on_net = reduce(lambda a, b: np.einsum("ni,nj->nij", a, b).reshape(len(where), -1), along)
        weights = np.empty_like(on_net)
        weights[:, self.number.ravel()] = on_net
        return weights, inside

    def cells(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return in which cell of the net points are, the last axis fastest; those outside are in the nearest.

        Parameters
        ----------
        points : array_like, shape (n, n_axis)
            Where.

        Returns
        -------
        cell : ndarray of int, shape (n,)
            Its number. An axis with one coordinate has one cell.
        """
        where = np.atleast_2d(np.asarray(points, dtype=np.float64))
        sizes = [max(len(axis) - 1, 1) for axis in self.axes]
        at = [
            np.clip(np.searchsorted(axis, where[:, i], side="right") - 1, 0, size - 1)
            for i, (axis, size) in enumerate(zip(self.axes, sizes, strict=True))
        ]
        return np.ravel_multi_index(at, sizes).astype(np.int64)


def find_net(coordinates: ArrayLike) -> StateNet | None:
    """Return the regular net that states form, or None if they form none.

    Parameters
    ----------
    coordinates : array_like, shape (n_state, n_axis)
        Coordinates of each state.

    Returns
    -------
    net : StateNet or None
        None if there is one state only, if two states are the same, or if a combination is missing.

    Examples
    --------
    >>> find_net([[1.0, 0.0], [2.0, 0.0], [1.0, 1.0]]) is None
    True
    """
    table = np.asarray(coordinates, dtype=np.float64)
    axes, places = [], []
    for column in table.T:
        ordered = np.sort(column)
        kept = ordered[np.append(True, np.diff(ordered) > _SAME)]
        axes.append(kept)
        places.append(np.searchsorted(kept, column - 0.5 * _SAME))
    sizes = tuple(len(axis) for axis in axes)
    if len(table) < 2 or len(table) != np.prod(sizes):
        return None
    number = np.full(sizes, -1, dtype=np.int64)
    number[tuple(np.minimum(place, size - 1) for place, size in zip(places, sizes, strict=True))] = np.arange(
        len(table)
    )
    return None if np.any(number < 0) else StateNet(tuple(axes), number)


def spread_and_correlation(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return logarithms of standard deviations, (n_state, n), and correlations, (n_state, n, n), of covariances."""
    spread = np.sqrt(np.maximum(np.einsum("sbb->sb", covariance), np.finfo(np.float64).tiny))
    return np.log(spread), covariance / (spread[:, :, np.newaxis] * spread[:, np.newaxis])


def interpolate_covariance(
    covariance: FloatArray, weights: FloatArray, parts: tuple[FloatArray, FloatArray] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return positive semi-definite matrices between others.

    Parameters
    ----------
    covariance : ndarray, shape (n_state, n, n)
        Covariance matrices of the states.
    weights : ndarray, shape (n_point, n_state)
        Weights of the states, as from `StateNet.weights`.
    parts : tuple of ndarray, optional
        What `spread_and_correlation` makes of the covariances, where it is known.

    Returns
    -------
    between : ndarray, shape (n_point, n, n)
        Interpolated covariance matrices; that of the state itself where one has all the weight.
    negative_part : ndarray, shape (n_point,)
        How far below zero the lowest eigenvalue was before it was set to zero, relative to the largest.

    Notes
    -----
    Logarithms of the variances and correlations are interpolated: K goes as a power of U, which this follows exactly.
    A combination of correlation matrices with weights that are not negative is a correlation matrix. With negative
    weights (third order) it need not be; then the nearest positive semi-definite matrix is taken. Those matrices are a
    convex set and hold the truth, so that the nearest one is no farther from it (Higham 1988,
    doi:10.1016/0024-3795(88)90223-6).
    """
    log_spread, correlation = spread_and_correlation(covariance) if parts is None else parts
    scale = np.exp(combine(weights, log_spread))
    between = combine(weights, correlation)
    between *= scale[:, :, np.newaxis] * scale[:, np.newaxis]
    between = 0.5 * (between + between.swapaxes(-1, -2))
    mixed = np.flatnonzero(np.any(weights < 0.0, axis=1))
    negative_part = np.zeros(len(weights))
    between[mixed], negative_part[mixed] = nearest_semidefinite(between[mixed])
    state = np.argmax(weights, axis=1)
    exact = np.flatnonzero(weights[np.arange(len(weights)), state] == 1.0)
    between[exact] = covariance[state[exact]]
    return between, negative_part


def combine(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Return weights @ values, such that no row depends on the rows beside it, to the last bit.

    Parameters
    ----------
    weights : ndarray, shape (n_point, n_state)
        Weights.
    values : ndarray, shape (n_state, ...)
        Values of the states.

    Returns
    -------
    combined : ndarray, shape (n_point, ...)
        Σ_s weights[:, s] · values[s].
    """
    combined = np.zeros((len(weights), *values.shape[1:]))
    states = np.flatnonzero(weights.any(axis=0))
    many = values[0].size > _FEW_NUMBERS
    if many or len(weights) <= len(states):  # each point by itself, its states one after the other, as below
        for row, own in enumerate(weights):
            some = np.flatnonzero(own)
            if many:
                for state in some:
                    combined[row] += own[state] * values[state]
            elif len(some):
                parts = own[some].reshape(-1, *(1,) * (values.ndim - 1)) * values[some]
                combined[row] += np.add.accumulate(parts)[-1]
        return combined
    for state in states:
        rows, value = np.flatnonzero(weights[:, state]), values[state]
        combined[rows] += weights[rows, state].reshape(-1, *(1,) * value.ndim) * value
    return combined


def nearest_semidefinite(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the positive semi-definite matrices nearest to symmetric ones, in the Frobenius norm.

    Parameters
    ----------
    matrices : ndarray, shape (n_matrix, n, n)
        Symmetric matrices.

    Returns
    -------
    nearest : ndarray, shape (n_matrix, n, n)
        The same, with eigenvalues below zero set to zero; unchanged where there are none.
    negative_part : ndarray, shape (n_matrix,)
        The lowest eigenvalue's depth below zero, relative to the largest.

    Examples
    --------
    >>> import numpy as np
    >>> matrix, below = nearest_semidefinite(np.array([[[1.0, 2.0], [2.0, 1.0]]]))
    >>> matrix[0].round(12), below.round(3)
    (array([[1.5, 1.5],
           [1.5, 1.5]]), array([0.333]))
    """
    nearest = matrices.copy()
    negative_part = np.zeros(len(matrices))
    for index, matrix in enumerate(matrices):
        try:
            np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            pass
        else:  # positive definite, which this tells in a tenth of the time that eigenvalues take
            continue
        lowest = np.linalg.eigvalsh(matrix)
        if lowest[0] < 0.0:
            values, vectors = np.linalg.eigh(matrix)
            kept = (vectors * np.maximum(values, 0.0)) @ vectors.T
            nearest[index] = 0.5 * (kept + kept.T)
            negative_part[index] = -lowest[0] / lowest[-1]
    return nearest, negative_part


def lagrange_weights(axis: NDArray[Any], at: NDArray[Any], n_point: int = _POINTS) -> FloatArray:
    """Return the weights of an axis's ascending coordinates at others, shape (n, len(axis)): of the nearest few."""
    count = min(n_point, len(axis))
    first = np.clip(np.searchsorted(axis, at, side="right") - count // 2, 0, len(axis) - count)
    weights = np.zeros((len(at), len(axis)))
    rows = np.arange(len(at))
    for j in range(count):
        product = np.ones(len(at))
        for k in range(count):
            if k != j:
                product *= (at - axis[first + k]) / (axis[first + j] - axis[first + k])
        weights[rows, first + j] = product
    return weights
