"""Rays become samples: which ray looks along which beam of a scan, and which of its gates is that beam's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.rays import Rays, angles_of
from bayes_rs.readers.samples import Samples

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SINGLE_GATE_SHARE = 0.05
"""Share of a beam's focus distance by which the only gate of a ray may be off, if no tolerance is given."""

_SAME = 1e-6  # chord; beams of several planes point the same way to rounding
_ROUNDING = 1e-6  # m; distances are float32 in most files' arithmetic
SAME_GATE = 0.5
"""m; distances closer than this are one gate, that is rounded or moves a little, unless all gates are that close."""
_NEAREST = 1.0  # m
_CLOSE = 0.25
"""Share of the largest step from distance to distance within which distances may be one gate."""


def match_rays(
    rays: Rays, scan: Scan, *, angle_tolerance_deg: float = 1.0, range_tolerance: float | None = None
) -> Samples:
    """Give each ray to the beams of a scan that look along it, and each beam its gate.

    Parameters
    ----------
    rays : Rays
        The rays of one file.
    scan : Scan
        The scan; its directions are the instrument's own, before tilt and yaw, as those of the rays.
    angle_tolerance_deg : float
        Largest angle between a ray and a beam, degrees.
    range_tolerance : float, optional
        Largest difference between a gate and a beam's focus distance, m. By default half the spacing of the gates
        there; of a ray with one gate, a twentieth of the focus distance.

    Returns
    -------
    samples : Samples
        One sample for each ray and beam. Rays of no beam are dropped, and counted as ``rows_without_beam``.

    Raises
    ------
    InputError
        If no ray looks along a beam, no gate is at a beam's focus distance, a ray is nearly as near to a second beam
        (less than twice as far), or two beams would take the same gate.

    Notes
    -----
    Directions are compared as unit vectors: azimuth 0° is 360°, and the azimuth of a vertical ray means nothing. Beams
    with one direction and several focus distances (planes) take a gate each.
    """
    tolerance = check_positive(angle_tolerance_deg, what="angle_tolerance_deg", unit="degrees")
    if range_tolerance is not None:
        check_positive(range_tolerance, what="range_tolerance", unit="m")
    n_ray = len(rays.time)
    no_time = np.isnat(rays.time)
    first_beam = first_of_direction(scan)
    along = _look_along(rays, scan, np.unique(first_beam), tolerance)
    if n_ray and not (along >= 0).any():
        raise InputError(
            f"No ray of file {str(rays.file)!r} looks within {tolerance:g} degrees of a beam of scan {scan.name!r}: "
            f"the file's directions (azimuth, elevation) are {directions_in_words(rays.direction)}, the scan's are "
            f"{directions_in_words(scan.beam_direction)}; give the scan that the file was measured with, or make it "
            "from the file with find_scan."
        )
    ray, beam, gate = [], [], []
    for first in np.unique(along[along >= 0]).tolist():
        index = np.flatnonzero((along == first) & ~no_time)
        beams = np.flatnonzero(first_beam == first)
        found, good = nearest_gates(rays.distance[index], scan.focus_distance[beams], range_tolerance)
        _check_distinct(found, good, rays, index, scan, beams)
        at_ray, at_beam = np.nonzero(good)
        ray.append(index[at_ray])
        beam.append(beams[at_beam])
        gate.append(found[at_ray, at_beam])
    at = tuple(np.concatenate([np.zeros(0, dtype=np.int64), *part]) for part in (ray, beam, gate))
    order = np.lexsort((at[1], at[0]))
    chosen, number, where = at[0][order], scan.beam[at[1][order]], at[2][order]
    if len(chosen) == 0 and (~no_time).any():
        raise InputError(
            f"No gate of file {str(rays.file)!r} is at the distance of a beam of scan {scan.name!r}: the gates are "
            f"{gates_in_words(rays.distance)} and the focus distances "
            f"{_listed(np.unique(scan.focus_distance))} m; give the scan another focus_distance, or a larger "
            "range_tolerance."
        )
    used = np.zeros(n_ray, dtype=bool)
    used[chosen] = True
    no_beam = int((~used & ~no_time).sum())
    counts = {"rows": n_ray, "rows_invalid_value": 0, "rows_dropped": 0, "rows_without_time": 0, "rows_without_beam": 0}
    counts.update(rays.counts)
    counts["rows_dropped"] += int((~used).sum())
    counts["rows_without_time"] += int(no_time.sum())
    counts["rows_without_beam"] += no_beam
    return Samples(
        file=rays.file,
        kind=rays.kind,
        file_format=rays.file_format,
        time=rays.time[chosen],
        beam=number,
        radial_velocity=rays.radial_velocity[chosen, where],
        cnr=None if rays.cnr is None else rays.cnr[chosen, where],
        status=None if rays.status is None else rays.status[chosen, where],
        row=rays.row[chosen],
        row_word=rays.row_word,
        counts=counts,
        facts={
            **rays.facts,
            **facts_of_gates(scan, rays.distance[chosen, where], scan.focus_distance[at[1][order]]),
        },
    )


def facts_of_gates(scan: Scan, gates: FloatArray, wanted: FloatArray) -> dict[str, float]:
    """Return how far, at most, a file's gates are from the ranges that they count for, m, if there are several.

    Parameters
    ----------
    scan : Scan
        The scan.
    gates, wanted : ndarray, shape (n,)
        Where gates are, and where the beams are that they were given to, m.
    """
    off = float(np.max(np.abs(gates - wanted), initial=0.0)) if isinstance(scan, RangedScan) else 0.0
    return {"gates_off": round(off, 3)} if off > SAME_GATE else {}


def by_rays(rays: Callable[[Path, FileFormat], Rays]) -> Callable[[Path, Scan, FileFormat], Samples]:
    """Return what reads the samples of a scan's beams from a file of which `rays` gives the rays.

    Parameters
    ----------
    rays : callable
        Returns the rays of a file.

    Returns
    -------
    read : callable
        Takes file, scan and options; raises InputError as `rays` does, and as `match_rays`.
    """

    def read(file: Path, scan: Scan, file_format: FileFormat) -> Samples:
        return match_rays(
            rays(file, file_format),
            scan,
            angle_tolerance_deg=file_format.angle_tolerance_deg,
            range_tolerance=file_format.range_tolerance,
        )

    return read


def directions_in_words(direction: FloatArray, *, most: int = 8) -> str:
    """Return the distinct directions, shape (n, 3), to a tenth of a degree as text, the most frequent first."""
    azimuth, elevation = angles_of(direction[np.isfinite(direction).all(axis=1)])
    tenths = np.stack([np.round(10.0 * azimuth) % 3600, np.round(10.0 * elevation)], axis=-1)
    pairs, count = np.unique(tenths, axis=0, return_counts=True)
    order = np.argsort(-count, kind="stable")
    words = [f"({pairs[i, 0] / 10.0:.1f}, {pairs[i, 1] / 10.0:.1f})" for i in order[:most]]
    more = f" and {len(order) - most} more" if len(order) > most else ""
    return (", ".join(words) or "none") + more


def gates_in_words(distance: FloatArray) -> str:
    """Return the span of gates, m, as text."""
    known = distance[np.isfinite(distance)]
    return f"from {known.min():g} to {known.max():g} m" if known.size else "without a distance"


def nearest_beam(direction: FloatArray, scan: Scan, tolerance_deg: float) -> IntArray:
    """Return for each ray, unit vectors (n_ray, 3), the index of the nearest beam within a tolerance, or −1."""
    known = np.asarray(np.isfinite(direction).all(axis=1))
    chord, nearest = scipy.spatial.cKDTree(scan.beam_direction).query(np.where(known[:, np.newaxis], direction, 0.0))
    inside = known & (chord <= 2.0 * np.sin(0.5 * np.deg2rad(tolerance_deg)))
    return np.where(inside, nearest, -1).astype(np.int64)


def first_of_direction(scan: Scan) -> IntArray:
    """Return for each beam the index of the first beam with its direction."""
    tree = scipy.spatial.cKDTree(scan.beam_direction)
    return np.array([np.min(near) for near in tree.query_ball_point(scan.beam_direction, _SAME)], dtype=np.int64)


def _look_along(rays: Rays, scan: Scan, distinct: IntArray, tolerance: float) -> IntArray:
    """Return for each ray the nearest of the beams `distinct`, or −1 if none is within the tolerance."""
    along = np.full(len(rays.time), -1, dtype=np.int64)
    known = np.flatnonzero(np.isfinite(rays.direction).all(axis=1))
    n_near = min(2, len(distinct))
    found = scipy.spatial.cKDTree(scan.beam_direction[distinct]).query(rays.direction[known], k=[1, 2][:n_near])
    chord, nearest = np.asarray(found[0]), np.asarray(found[1])
    angle = np.rad2deg(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))
    inside = angle[:, 0] <= tolerance
    if n_near == 2:
        unclear = inside & (angle[:, 1] <= tolerance) & (angle[:, 1] < 2.0 * angle[:, 0])
        if unclear.any():
            index = int(np.argmax(unclear))
            at = known[index]
            one, two = scan.beam[distinct[nearest[index]]]
            raise InputError(
                f"Unclear beam of {rays.row_word} {rays.row[at]} of file {str(rays.file)!r}, direction "
                f"{directions_in_words(rays.direction[[at]])}: it looks {angle[index, 0]:.3g} degrees from beam {one} "
                f"and {angle[index, 1]:.3g} degrees from beam {two} of scan {scan.name!r}, both within "
                f"angle_tolerance_deg = {tolerance:g}; give a smaller tolerance, or a scan without beams that close."
            )
    along[known[inside]] = distinct[nearest[inside, 0]]
    return along


def nearest_gates(distance: FloatArray, focus: FloatArray, range_tolerance: float | None) -> tuple[IntArray, BoolArray]:
    """Return the gate nearest to each focus distance, and whether it is near enough, both (n_ray, n_focus).

    Parameters
    ----------
    distance : ndarray, shape (n_ray, n_gate)
        Gates of each ray in order, m; NaN where there is none.
    focus : ndarray, shape (n_focus,)
        Focus distances, m.
    range_tolerance : float, optional
        As for `match_rays`.
    """
    n_ray, n_gate = distance.shape
    gate = np.zeros((n_ray, len(focus)), dtype=np.int64)
    good = np.zeros((n_ray, len(focus)), dtype=bool)
    if n_ray == 0 or n_gate == 0:
        return gate, good
    if n_ray > 1 and np.array_equal(distance, np.broadcast_to(distance[:1], distance.shape), equal_nan=True):
        gate, good = nearest_gates(distance[:1], focus, range_tolerance)  # as a rule all rays have the same gates
        return np.repeat(gate, n_ray, axis=0), np.repeat(good, n_ray, axis=0)
    step = np.full((n_ray, n_gate + 1), np.nan)
    step[:, 1:-1] = np.abs(np.diff(distance, axis=1))
    spacing = np.fmax(step[:, :-1], step[:, 1:])  # the larger of the two steps beside each gate
    row = np.arange(n_ray)
    for column, wanted in enumerate(focus.tolist()):
        off = np.where(np.isfinite(distance), np.abs(distance - wanted), np.inf)
        best = np.argmin(off, axis=1)
        if range_tolerance is None:
            half = 0.5 * spacing[row, best]
            allowed = np.where(np.isfinite(half), half, SINGLE_GATE_SHARE * wanted)
        else:
            allowed = np.full(n_ray, float(range_tolerance))
        gate[:, column], good[:, column] = best, off[row, best] <= allowed + _ROUNDING
    return gate, good


def cells_of_gates(distance: FloatArray) -> IntArray:
    """Return which gate each of some distances is, counted from 0: a gate may be rounded, or move a little.

    Parameters
    ----------
    distance : ndarray, shape (n,)
        Distinct distances, m, in rising order.
    """
    step = np.diff(distance)
    if len(step) == 0:
        return np.zeros(len(distance), dtype=np.int64)
    apart = step > min(SAME_GATE, _CLOSE * step.max())
    if distance[-1] - distance[0] <= SAME_GATE:
        apart[:] = False
    return np.concatenate([[0], np.cumsum(apart)]).astype(np.int64)


def check_metres(gates: FloatArray, file: Path) -> None:
    """Refuse the gates of a file, m, that are all nearer than an instrument measures: they are in another unit.

    Raises
    ------
    InputError
        If they are all less than 1 m away.
    """
    if len(gates) and gates.max() < _NEAREST:
        raise InputError(
            f"The distances of file {str(file)!r} are {_listed(gates)}, and must be in m: they look like km; multiply "
            "them by 1000."
        )


def _check_distinct(gate: IntArray, good: BoolArray, rays: Rays, index: IntArray, scan: Scan, beams: IntArray) -> None:
    """Refuse two beams of one direction that take the same gate of a ray."""
    order = np.argsort(scan.focus_distance[beams])  # so that equal gates are neighbours
    same = (gate[:, order[:-1]] == gate[:, order[1:]]) & good[:, order[:-1]] & good[:, order[1:]]
    if same.any():
        row, pair = (int(i) for i in np.argwhere(same)[0])
        one, two = beams[order[pair]], beams[order[pair + 1]]
        raise InputError(
            f"Beams {scan.beam[one]} and {scan.beam[two]} of scan {scan.name!r}, at {scan.focus_distance[one]:g} and "
            f"{scan.focus_distance[two]:g} m, take the same gate of {rays.row_word} {rays.row[index[row]]} of file "
            f"{str(rays.file)!r}, at {rays.distance[index[row], gate[row, order[pair]]]:g} m: give focus distances "
            "that are further apart, or a smaller range_tolerance."
        )


def _listed(numbers: FloatArray) -> str:
    words = [f"{number:g}" for number in numbers.tolist()]
    return ", ".join(words) if len(words) <= 8 else f"{', '.join(words[:5])} … {words[-1]}"
