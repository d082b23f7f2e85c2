"""Covariances of beams along the wind that are calculated once, and taken at the separations of every wind speed."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.probe import Probe
from bayes_rs.theory.pairs import fingerprints
from bayes_rs.theory.probed import CORE, LAG_STEP, Rules, by_rules, grid_core
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.stencil import STENCIL, interpolate_rows, stretched
from bayes_rs.turbulence.two_point import radial_covariance

_COARSE = 1e-3  # tolerance below which points are not taken from lines, and separations are LAG_STEP apart
_COARSE_LAG_STEP = 0.4  # above: that of the table of the turbulence, which then need not be interpolated for points
_REACH = 2e4  # m: the wind's way in ten minutes at 33 m/s, which every grid reaches to, ...
_REACH_STEP = 3.2  # ... and farther by such steps of asinh(x/core): nearly all wind speeds have the same
_DECIMALS = 9  # of metres and of unit vectors: lines that agree to this are one
_MOST_KEPT = 4000  # lines of one turbulence and grid
_MANY_POINTS = 5000  # pairs of points: fewer are not worth keeping their lines
_PARTS_KEPT = 8  # of those, of at most 13 MB each
_POINTS: ContextVar[OrderedDict[bytes, _PointLines] | None] = ContextVar("kept lines of points", default=None)


class _PointLines(NamedTuple):
    """Lines of pairs of points."""

    flow: tuple[MannTurbulence, float, int]
    mark: NDArray[np.uint64]  # of each line, ascending
    lines: NDArray[np.float32]
    which: NDArray[np.int64]  # line each pair has
    backward: NDArray[np.bool_]  # which pairs run backward in theirs


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
    rules: Rules = "full",
) -> FloatArray:
    """Return what `probed_covariance` does, from lines along the wind that are kept for other wind speeds.

    Parameters
    ----------
    first, second, across, along, turbulence, probe, lengths, tolerance
        As for `probed_covariance`.
    shortest : float
        The shortest length above zero of all beams of the scan, m; 0 if all are points.
    rules : str
        As for `by_rules`.

    Returns
    -------
    covariance : ndarray, shape (n, n_lag)
        m² s⁻².

    Notes
    -----
    The covariance of two beams is a function of the separation along the wind; the wind speed says only at which
    separations it is taken. So it is calculated on one grid, even in asinh(x/core), and interpolated for each wind
    speed, which costs a few per cent of it. Pairs that are mirror images, or one's beams in the other order, have one
    line: of a pattern that is symmetric, so have the directions to the left and to the right. The grid does not depend
    on what was asked for before, so that numbers do not, either. `many_speeds` forgets the lines when it ends.
    """
    if not np.any(lengths > 0.0):
        return _of_points(first, second, across, along, turbulence, tolerance)
    core = grid_core(shortest, turbulence)
    step = LAG_STEP if tolerance < _COARSE else _COARSE_LAG_STEP
    half = _half(along, core, step)
    place = np.arcsinh(along / core) / step + half
    flow = (turbulence.dissipation, turbulence.length_scale, turbulence.gamma)
    kept = _lines(flow, probe, tolerance, core, half, rules)
    kinds, backward = _kinds_of_lines(first, second, across, lengths)
    place = np.where(backward[:, np.newaxis], 2.0 * half - place, place)
    names = [row.tobytes() for row in kinds]
    known = {name: kept[name] for name in names if name in kept}
    missing = {name: index for index, name in enumerate(names) if name not in known}
    if missing:
        new = list(missing.values())
        grid = core * np.sinh(step * np.arange(-half, half + 1))
        lines = by_rules(
            kinds[new, :3],
            kinds[new, 3:6],
            kinds[new, 6:8],
            np.broadcast_to(grid, (len(new), len(grid))),
            turbulence,
            probe,
            kinds[new, 8:],
            tolerance,
            shortest=shortest,
            rules=rules,
        )
        calculated = dict(zip(missing, lines, strict=True))
        if len(new) <= _MOST_KEPT:
            if len(kept) + len(new) > _MOST_KEPT:
                kept.clear()
            kept.update(calculated)
        known.update(calculated)
    return interpolate_rows(np.array([known[name] for name in names]), place)


def _half(along: FloatArray, core: float, step: float) -> int:
    """Return the number of separations of the grid on one side."""
    least, reach = np.arcsinh(np.array([_REACH, max(_REACH, float(np.max(np.abs(along))))]) / core)
    beyond = np.ceil((reach - least) / _REACH_STEP) * _REACH_STEP
    return int(np.ceil((least + beyond) / step)) + STENCIL // 2


def _kinds_of_lines(
    first: FloatArray, second: FloatArray, across: FloatArray, lengths: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return what lines depend on, shape (n, 10), the same for pairs that have one line; and which run backward in it.

    Two pairs have one line if they are mirror images in the x–z plane, or one's beams in the other order; and a
    separation is its opposite: covariances are even.
    """
    mirror = np.array([1.0, -1.0, 1.0])
    best = np.full((len(first), 10), np.inf)
    backward = np.zeros(len(first), dtype=bool)
    for swapped, mirrored, turned in product((False, True), repeat=3):
        a, b = (second, first) if swapped else (first, second)
        own = lengths[:, ::-1] if swapped else lengths
        side = across * ([-1.0, 1.0] if mirrored else [1.0, 1.0]) * (-1.0 if turned else 1.0)
        if mirrored:
            a, b = a * mirror, b * mirror
        kind = np.round(np.concatenate([a, b, side, own], axis=1), _DECIMALS) + 0.0  # no negative zeros
        differ = kind != best
        at = (np.arange(len(kind)), np.argmax(differ, axis=1))
        better = kind[at] < best[at]
        best[better], backward[better] = kind[better], turned
    return best, backward


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
    core, step = CORE * turbulence.length_scale, _COARSE_LAG_STEP
    half = _half(along, core, step)
    flow = (turbulence, tolerance, half)
    which = hashlib.blake2b(repr(flow).encode())
    for part in (first, second, across):
        which.update(part.tobytes())
    name = which.digest()
    if name not in kept:
        kept[name] = _lines_of_points(first, second, across, flow, core * np.sinh(step * np.arange(-half, half + 1)))
        if len(kept) > _PARTS_KEPT:
            kept.popitem(last=False)
    found = kept[name]
    place = stretched((along / core).astype(np.float32)) / np.float32(step) + np.float32(half)
    place = np.where(found.backward[:, np.newaxis], np.float32(2 * half) - place, place)
    lines: NDArray[Any] = found.lines[found.which]
    return interpolate_rows(lines, place).astype(np.float64)


def _lines_of_points(
    first: FloatArray, second: FloatArray, across: FloatArray, flow: tuple[MannTurbulence, float, int], grid: FloatArray
) -> _PointLines:
    """Return the lines of pairs of points, each calculated once; those of other directions are at hand."""
    turbulence, tolerance, _ = flow
    kinds, backward = _kinds_of_lines(first, second, across, np.zeros((len(first), 2)))
    mark, one, which = np.unique(fingerprints(kinds), return_index=True, return_inverse=True)
    lines, missing = np.empty((len(mark), len(grid)), dtype=np.float32), np.ones(len(mark), dtype=bool)
    for other in (_POINTS.get() or {}).values():
        if other.flow == flow:
            at = np.minimum(np.searchsorted(other.mark, mark), len(other.mark) - 1)
            same = missing & (other.mark[at] == mark)
            lines[same] = other.lines[at[same]]
            missing &= ~same
    if np.any(missing):
        new = kinds[one[missing]]
        along = np.broadcast_to(grid, (len(new), len(grid)))
        lines[missing] = radial_covariance(new[:, :3], new[:, 3:6], new[:, 6:8], along, turbulence, tolerance=tolerance)
    return _PointLines(flow, mark, lines, which.reshape(-1), backward)


@lru_cache(maxsize=64)
def _lines(
    _flow: tuple[float, ...], _probe: Probe, _tolerance: float, _core: float, _half: int, _rules: Rules
) -> dict[bytes, Any]:
    """Return the kept lines of one turbulence and grid, by what the pairs of beams are."""
    return {}
