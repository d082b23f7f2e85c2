"""Covariances of beams along the wind that are calculated once, and taken at the separations of every wind speed."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.probe import Probe
from bayes_rs.theory.probed import CORE, LAG_STEP, by_rules, grid_core
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.stencil import STENCIL, interpolate_rows
from bayes_rs.turbulence.two_point import radial_covariance

_COARSE, _COARSE_LAG_STEP = 1e-3, 0.3  # the step of the separations where the tolerance is not below that
_POINTS_LAG_STEP = 0.4  # of points, as in the table of the turbulence
_HALF_STEP = 8  # of the number of those separations on one side
_MOST_KEPT = 4000  # lines of one turbulence and grid
_MANY_POINTS = 5000  # pairs of points: fewer are not worth keeping their lines
_PARTS_KEPT = 8  # of those, of at most 13 MB each
_POINTS: ContextVar[OrderedDict[bytes, Any] | None] = ContextVar("kept lines of points", default=None)


def kept_covariance(
    first: FloatArray,
    second: FloatArray,
    across: FloatArray,
    along: FloatArray,
    turbulence: MannTurbulence,
    *,
    probe: Probe,
    lengths: FloatArray,
    shortest: float,
    tolerance: float = 1e-4,
) -> FloatArray:
    """Return what `probed_covariance` does, from lines along the wind that are kept for other wind speeds.

    Parameters
    ----------
    first, second, across, along, turbulence, probe, lengths, tolerance
        As for `probed_covariance`.
    shortest : float
        The shortest length above zero of all beams of the scan, m; 0 if all are points.

    Returns
    -------
    covariance : ndarray, shape (n, n_lag)
        m² s⁻².

    Notes
    -----
    The covariance of two beams is a function of the separation along the wind; the wind speed says only at which
    separations it is taken. So it is calculated on one grid, even in asinh(x/core), and interpolated for each wind
    speed, which costs a few per cent of it. The grid does not depend on what was asked for before, so that numbers do
    not, either. `many_speeds` forgets them when it ends.
    """
    if not np.any(lengths > 0.0):
        return _of_points(first, second, across, along, turbulence, tolerance)
    core = grid_core(shortest, turbulence)
    step = LAG_STEP if tolerance < _COARSE else _COARSE_LAG_STEP
    half = int(np.ceil(np.arcsinh(np.max(np.abs(along)) / core) / step)) + STENCIL // 2
    half = _HALF_STEP * -(-half // _HALF_STEP)  # most wind speeds have the same
    place = np.arcsinh(along / core) / step + half
    flow = (turbulence.dissipation, turbulence.length_scale, turbulence.gamma)
    kept = _lines(flow, probe, tolerance, core, half)
    names = [row.tobytes() for row in np.concatenate([first, second, across, lengths], axis=1)]
    known = {name: kept[name] for name in names if name in kept}
    new = np.flatnonzero([name not in known for name in names])
    if len(new):
        grid = core * np.sinh(step * np.arange(-half, half + 1))
        lines = by_rules(
            first[new],
            second[new],
            across[new],
            np.broadcast_to(grid, (len(new), len(grid))),
            turbulence,
            probe,
            lengths[new],
            tolerance,
            shortest=shortest,
        )
        if len(new) == len(names) > _MOST_KEPT:
            return interpolate_rows(lines, place)
        if len(kept) + len(new) > _MOST_KEPT:
            kept.clear()
        calculated = {names[index]: line for index, line in zip(new.tolist(), lines, strict=True)}
        kept.update(calculated)
        known.update(calculated)
    return interpolate_rows(np.array([known[name] for name in names]), place)


@contextmanager
def many_speeds() -> Iterator[None]:
    """Have the lines of many pairs of points kept, too, which only many wind speeds are worth; then forget all lines.

    States should come direction by direction.
    """
    token = _POINTS.set(OrderedDict())
    try:
        yield
    finally:
        _POINTS.reset(token)
        _lines.cache_clear()


def _of_points(
    first: FloatArray,
    second: FloatArray,
    across: FloatArray,
    along: FloatArray,
    turbulence: MannTurbulence,
    tolerance: float,
) -> FloatArray:
    """Return covariances of points; of many pairs and at a coarse tolerance from lines, if those are kept."""
    kept = _POINTS.get()
    if kept is None or len(first) < _MANY_POINTS or tolerance < _COARSE:
        return radial_covariance(first, second, across, along, turbulence, tolerance=tolerance)
    core, step = CORE * turbulence.length_scale, _POINTS_LAG_STEP
    half = int(np.ceil(np.arcsinh(np.max(np.abs(along)) / core) / step)) + STENCIL // 2
    half = _HALF_STEP * -(-half // _HALF_STEP)
    which = hashlib.blake2b(repr((turbulence, tolerance, half)).encode())
    for part in (first, second, across):
        which.update(part.tobytes())
    name = which.digest()
    if name not in kept:
        grid = np.broadcast_to(core * np.sinh(step * np.arange(-half, half + 1)), (len(first), 2 * half + 1))
        lines = radial_covariance(first, second, across, grid, turbulence, tolerance=tolerance)
        kept[name] = lines.astype(np.float32)
        if len(kept) > _PARTS_KEPT:
            kept.popitem(last=False)
    place = np.arcsinh((along / core).astype(np.float32)) / np.float32(step) + np.float32(half)
    return interpolate_rows(kept[name], place).astype(np.float64)


@lru_cache(maxsize=64)
def _lines(_flow: tuple[float, ...], _probe: Probe, _tolerance: float, _core: float, _half: int) -> dict[bytes, Any]:
    """Return the kept lines of one turbulence and grid, by what the pairs of beams are."""
    return {}
