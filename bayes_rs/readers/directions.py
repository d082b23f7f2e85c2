"""Directions that rays have in common: which rays point the same way, and how far they scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

_GRID = 20  # steps of the tolerance; directions nearer than one are compared once


@dataclass(frozen=True)
class CommonDirections:
    """Directions that rays have in common, each linked by steps within a tolerance.

    Parameters
    ----------
    rays : tuple of ndarray of int
        The rays of each direction, by their numbers, upwards.
    direction : ndarray, shape (n, 3)
        Unit vector of each: the mean of its rays'.
    spread_deg : ndarray, shape (n,)
        Largest angle between a ray and that, degrees.
    label : ndarray of int, shape (n_ray,)
        Number of each ray's direction; −1 where it is not known.
    """

    rays: tuple[NDArray[np.int64], ...]
    direction: FloatArray
    spread_deg: FloatArray
    label: NDArray[np.int64]

    @property
    def count(self) -> NDArray[np.int64]:
        """Number of rays of each direction."""
        return np.array([len(one) for one in self.rays], dtype=np.int64)


def common_directions(direction: FloatArray, tolerance_deg: float) -> CommonDirections:
    """Find the directions that rays have in common.

    Parameters
    ----------
    direction : ndarray, shape (n_ray, 3)
        Unit vectors; NaN where not known.
    tolerance_deg : float
        Rays that are closer than this, degrees, have one direction, and so have those that such steps link.
    """
    known = np.flatnonzero(np.isfinite(direction).all(axis=1))
    label = np.full(len(direction), -1, dtype=np.int64)
    if len(known) == 0:
        return CommonDirections((), np.empty((0, 3)), np.empty(0), label)
    reach = 2.0 * np.sin(0.5 * np.deg2rad(min(tolerance_deg, 180.0)))
    cell, at = np.unique(np.round(direction[known] * (_GRID / reach)), axis=0, return_inverse=True)
    centre = _means(direction[known], at.ravel(), len(cell))
    pairs = scipy.spatial.cKDTree(centre).query_pairs(reach, output_type="ndarray")
    links = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cell), len(cell)))
    n_found, of_cell = scipy.sparse.csgraph.connected_components(links, directed=False)
    own = of_cell[at.ravel()].astype(np.int64)
    label[known] = own
    mean = _means(direction[known], own, int(n_found))
    chord = np.zeros(int(n_found))
    np.maximum.at(chord, own, np.linalg.norm(direction[known] - mean[own], axis=1))
    order = np.argsort(own, kind="stable")
    rays = np.split(known[order], np.cumsum(np.bincount(own))[:-1])
    return CommonDirections(tuple(rays), mean, np.rad2deg(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))), label)


def _means(direction: FloatArray, group: NDArray[np.int64], n_group: int) -> FloatArray:
    """Return the unit vector of each group's mean; that of its first ray where the mean is zero."""
    count = np.bincount(group, minlength=n_group)[:, np.newaxis]
    total = np.stack([np.bincount(group, weights=part, minlength=n_group) for part in direction.T], axis=1)
    length = np.linalg.norm(total / count, axis=1, keepdims=True)
    first = direction[np.unique(group, return_index=True)[1]]
    return np.where(length > 0.0, total / count / np.where(length > 0.0, length, 1.0), first)
