"""What a file of rays says twice: distances of gates, and the heights that they are at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

_ROUNDING = 1.0
"""m; instruments write both numbers without decimals."""
_SHARE = 0.001
"""Of the distance; angles are written to some hundredths of a degree."""
_GATE_SHARE = 0.25
"""Of the spacing of the gates: what is nearer is the same gate."""
_MOST_ROWS = 64
"""Distinct rows of distances in one file; a scan has as many as elevations."""


class Agreed(NamedTuple):
    """Distances that agree with the heights.

    Parameters
    ----------
    distance : ndarray or None, shape (n_ray, n_gate)
        m; None if no order of the rows agrees.
    reordered : bool
        Whether rows were given to other rays than in the file.
    worst : tuple of int and int
        If None agrees, the ray and the gate that are furthest off as the file stands.
    """

    distance: FloatArray | None
    reordered: bool
    worst: tuple[int, int] = (0, 0)


def agree(distance: FloatArray, elevation_deg: FloatArray, height: FloatArray) -> Agreed:
    r"""Compare distances of gates with their heights, and put the rows into the order in which they agree.

    Parameters
    ----------
    distance : ndarray, shape (n_ray, n_gate)
        m along the ray.
    elevation_deg : ndarray, shape (n_ray,)
        Degrees above the horizon.
    height : ndarray, shape (n_ray, n_gate)
        m above the lidar, or above anything else: one number may lie between.

    Returns
    -------
    agreed : Agreed
        The distances as they are, if they agree; else those of the same rows in another order, if these do.

    Notes
    -----
    A gate agrees if :math:`|r \sin\varepsilon - h|` is at most a quarter of the spacing of the gates' heights, 1 m for
    rounding, and a thousandth of the distance for that of the angle. Height and elevation belong to a ray by its number
    as its velocity does; rows of distances that agree for every ray once they are sorted, each used as often as it
    is there, are in the wrong order. Nothing else could make all of them agree.
    """
    rise = np.sin(np.deg2rad(elevation_deg))
    known = np.isfinite(distance) & np.isfinite(height) & np.isfinite(rise)[:, np.newaxis]
    if not known.any():
        return Agreed(distance, reordered=False)
    off = distance * rise[:, np.newaxis] - height
    allowed = _allowed(distance, height)
    if _fits(off, allowed, known).all() or _fits(off - np.median(off[known]), allowed, known).all():
        return Agreed(distance, reordered=False)
    sorted_ = _in_order(distance, rise, height, known)
    if sorted_ is not None:
        return Agreed(sorted_, reordered=True)
    ray, gate = np.unravel_index(np.argmax(np.where(known, np.abs(off) - allowed, -np.inf)), off.shape)
    return Agreed(None, reordered=False, worst=(int(ray), int(gate)))


def distance_by_height(height: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return the distances, m, at which rays of an elevation, degrees, are at heights above the lidar, m.

    Rays that do not rise by 3 degrees have none (NaN).
    """
    rise = np.sin(np.deg2rad(elevation_deg))[:, np.newaxis]
    with np.errstate(divide="ignore", invalid="ignore"):
        along: FloatArray = np.where(rise > 0.05, height / rise, np.nan)
    return along


def _allowed(distance: FloatArray, height: FloatArray) -> FloatArray:
    steps = np.abs(np.diff(height, axis=1)) if height.shape[1] > 1 else np.zeros((len(height), 1))
    finite = steps[np.isfinite(steps)]
    spacing = float(np.median(finite)) if finite.size else 0.0
    allowed: FloatArray = _ROUNDING + _GATE_SHARE * spacing + _SHARE * np.abs(distance)
    return allowed


def _fits(off: FloatArray, allowed: FloatArray, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Say of each ray whether all its gates agree."""
    return np.asarray((~known | (np.abs(off) <= allowed)).all(axis=1))


def _in_order(
    distance: FloatArray, rise: FloatArray, height: FloatArray, known: NDArray[np.bool_]
) -> FloatArray | None:
    """Return the rows in the order in which each agrees with its ray's heights; None if there is none."""
    kinds: dict[bytes, list[int]] = {}
    for ray, row in enumerate(distance):
        kinds.setdefault(row.tobytes(), []).append(ray)
    if not 1 < len(kinds) <= _MOST_ROWS:
        return None
    rows = distance[[rays[0] for rays in kinds.values()]]
    count = [len(rays) for rays in kinds.values()]
    misfit = np.full((len(rise), len(rows)), np.inf)
    for index, row in enumerate(rows):
        as_all = np.broadcast_to(row, distance.shape)
        own = known & np.isfinite(as_all)
        off = as_all * rise[:, np.newaxis] - height
        fits = _fits(off, _allowed(as_all, height), own) & own.any(axis=1)
        misfit[fits, index] = np.abs(np.where(own, off, 0.0))[fits].max(axis=1)
    choice = np.argmin(misfit, axis=1)
    if not np.isfinite(misfit[np.arange(len(rise)), choice]).all():
        return None
    if not np.array_equal(np.bincount(choice, minlength=len(rows)), count):
        return None
    return np.asarray(rows[choice])
