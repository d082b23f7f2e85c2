"""Sums over all lags of a record from the covariances at a few of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.turbulence.interpolation import lagrange_weights
from bayes_rs.turbulence.toeplitz import toeplitz_gram, toeplitz_trace

_POINTS = 6  # lags that a covariance between them is interpolated from
_WORTH = 0.75  # of all lags: more nodes than that save nothing


@dataclass(frozen=True, eq=False)
class LagNodes:
    """Lags of a record at which covariances are calculated, and the sums over all lags that follow from them.

    Attributes
    ----------
    lag : ndarray of int, shape (n_node,)
        The lags, in sampling intervals, ascending.
    weights : ndarray, shape (n_node, n_lag)
        Values at all lags are values at the nodes @ weights.
    norm : ndarray, shape (n_node, n_node)
        ‖P A P‖² = values @ norm @ values.
    trace : ndarray, shape (n_node,)
        tr(P A P) = values @ trace; of square matrices only.
    """

    lag: NDArray[np.int64]
    weights: FloatArray
    norm: FloatArray
    trace: FloatArray

    def inner(self, values: FloatArray) -> FloatArray:
        """Return ‖P A P‖² of matrices whose diagonals are `values` (n, n_node) at the nodes, shape (n,)."""
        return np.asarray(np.einsum("ni,ni->n", values @ self.norm, values))


def lag_nodes(n_row: int, n_column: int, centres: tuple[float, float], growth: float, *, detrend: str) -> LagNodes:
    """Choose the lags at which covariances of two beams are calculated.

    Parameters
    ----------
    n_row, n_column : int
        Samples of the first and of the second beam.
    centres : tuple of float
        The least and the largest lag, in sampling intervals, at which the two beams see the same place along the wind.
    growth : float
        Distance of two nodes over their distance from the nearest centre; 0 for all lags.
    detrend : str
        ``"mean"`` or ``"linear"``.

    Returns
    -------
    nodes : LagNodes
        All lags near the centres, where covariances are peaked, and ever fewer beyond.

    Notes
    -----
    At a distance x from the place that both see, a covariance changes over distances of x or of the length scale,
    whichever is longer, so that nodes at distances that grow with x hold it. Between them it is interpolated to fifth
    order. All sums over lags are quadratic or linear in the covariances, and so in those at the nodes.
    """
    first, last = -(n_row - 1), n_column - 1
    every = np.arange(first, last + 1)
    lag = every
    if growth > 0.0:
        near = (int(np.floor(centres[0])), int(np.ceil(centres[1])))
        lag = np.concatenate([near[0] - _growing(near[0] - first, growth)[::-1], np.arange(near[0], near[1] + 1)])
        lag = np.unique(np.clip(np.concatenate([lag, near[1] + _growing(last - near[1], growth)]), first, last))
    if len(lag) > _WORTH * len(every):
        lag = every
    weights = np.eye(len(every)) if lag is every else np.ascontiguousarray(lagrange_weights(lag, every, _POINTS).T)
    norm = toeplitz_gram(weights, n_row, n_column, detrend=detrend)
    trace = toeplitz_trace(weights, n_row, detrend=detrend) if n_row == n_column else np.full(len(lag), np.nan)
    return LagNodes(lag.astype(np.int64), weights, norm, trace)


def _growing(reach: int, growth: float) -> NDArray[np.int64]:
    """Return whole distances from 1 to `reach` whose steps are 1 at first, and then `growth` of the distance."""
    if reach <= 0:
        return np.zeros(0, dtype=np.int64)
    count = int(np.ceil(np.arcsinh(growth * reach) / growth))
    even = np.linspace(0.0, np.arcsinh(growth * reach), count + 1)[1:]
    return np.unique(np.round(np.sinh(even) / growth).astype(np.int64))
