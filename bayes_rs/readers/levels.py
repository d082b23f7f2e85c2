"""At which ranges files are read: those of the scan, those that are asked for, or all that the files have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import ALL_RANGES, FileOptions
from bayes_rs.geometry.ranged_scan import RangedScan, check_one_distance, distances_at, looks_up, short
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.beam_ranges import no_range
from bayes_rs.readers.matching import SAME_GATE, cells_of_gates, check_metres, nearest_beam, nearest_gates
from bayes_rs.readers.one_file import opened_reader

_MOST_FILES = 100
"""Files that are read for the gates of all beams, if some have gates by then."""


def scan_at_ranges(paths: Sequence[Path], scan: Scan, options: FileOptions) -> Scan:
    """Return the scan at the ranges that are to be read: itself, or all its beams at each of several ranges.

    Parameters
    ----------
    paths : sequence of Path
        The files; the first with rays of a beam says which ranges it has.
    scan : Scan
        The scan that they were measured with.
    options : FileOptions
        Its ``range`` and ``height`` count before the ``range`` of the scan's ``[file]`` table.

    Returns
    -------
    scan : Scan
        A `RangedScan` with the files' own gates, those nearest to what is asked for; the scan itself if nothing is
        asked for, or if the scan's own table asks for all ranges and the files tell of none, or of the scan's only.

    Raises
    ------
    InputError
        If ranges are asked for and the files have none, or none at a wanted one, or no ray is of the scan.
    """
    if isinstance(scan, RangedScan):
        return scan
    if options.range is not None and options.height is not None:
        raise InputError("The options range and height are two ways to say one thing: give one of them.")
    asked = options.range is not None or options.height is not None
    wanted = options.range if asked else scan.file_format.get("range")
    if wanted is None and options.height is None:
        return scan
    check_one_distance(scan)
    gates = _gates(paths, scan, options)
    if gates is None:
        if asked:
            raise no_range(paths[0])
        return scan
    if options.height is not None or (wanted == ALL_RANGES and looks_up(scan)):
        distance = _at_heights(gates, scan, options, paths)
    elif wanted == ALL_RANGES:
        distance = _common(gates, np.ones(scan.n_beam), options)
    else:
        goals = np.asarray(wanted, dtype=np.float64)
        distance = _nearest(gates, np.repeat(goals[:, np.newaxis], scan.n_beam, axis=1), goals, "range", options, paths)
    if len(distance) == 0:
        raise InputError(
            f"The beams of scan {scan.name!r} have no gate in common in file {str(paths[0])!r}: "
            f"{_in_words(gates)}; give the scan that the file was measured with, or range (--range)."
        )
    own = len(distance) == 1 and np.allclose(distance[0], scan.focus_distance, rtol=0.0, atol=SAME_GATE)
    return scan if own and not asked else RangedScan.of(scan, distance)


def _gates(paths: Sequence[Path], scan: Scan, options: FileOptions) -> list[FloatArray] | None:
    """Return the gates of each beam, in rising order, m; None if the files tell of none.

    Files are read until each beam has gates: a file may hold the rays of one beam only.
    """
    first: InputError | None = None
    found: list[FloatArray] = [np.zeros(0)] * scan.n_beam
    n_read = 0
    for path in paths:
        try:
            with opened_reader(path, scan, options) as (reader, plain, file_format):
                if reader.rays is None:
                    own = reader.ranges(plain, file_format) if reader.ranges is not None else np.zeros(0)
                    check_metres(own, path)
                    return [_merged(own)] * scan.n_beam if len(own) else None
                rays = reader.rays(plain, file_format)
                of_file = _of_rays(rays.direction, rays.distance, scan, file_format.angle_tolerance_deg)
        except InputError as error:
            if options.on_bad_file == "error":
                raise
            first = first or error
            continue
        found = [known if len(known) else new for known, new in zip(found, of_file, strict=True)]
        if all(len(one) for one in found):
            return found
        n_read += 1
        if n_read >= _MOST_FILES and any(len(one) for one in found):
            break
    if any(len(one) for one in found):
        return _with_absent(found, scan)
    if n_read:
        raise InputError(
            f"No ray of file {str(paths[0])!r} looks along a beam of scan {scan.name!r}: give the scan that it was "
            "measured with, or make it from the file with find_scan (bayes-rs find-scan)."
        )
    if first is not None:
        raise first
    return None


def _of_rays(direction: FloatArray, distance: FloatArray, scan: Scan, tolerance_deg: float) -> list[FloatArray]:
    along = nearest_beam(direction, scan, tolerance_deg)
    return [_merged(distance[along == index].ravel()) for index in range(scan.n_beam)]


def _with_absent(found: list[FloatArray], scan: Scan) -> list[FloatArray]:
    """Return gates of all beams; those without a ray have no sample, and take the place of another beam's gates."""
    rise = scan.level_direction[:, 2] if looks_up(scan) else np.ones(scan.n_beam)
    other = next(index for index, one in enumerate(found) if len(one))
    return [one if len(one) else found[other] * rise[other] / own for one, own in zip(found, rise, strict=True)]


def _merged(distance: FloatArray) -> FloatArray:
    """Return distances in rising order, those of one gate once, by their mean."""
    values, count = np.unique(np.round(distance[np.isfinite(distance) & (distance > 0.0)], 3), return_counts=True)
    if len(values) == 0:
        return values
    cell = cells_of_gates(values)
    merged = np.bincount(cell, weights=values * count) / np.bincount(cell, weights=count)
    return np.asarray(np.round(merged, 3))


def _at_heights(gates: list[FloatArray], scan: Scan, options: FileOptions, paths: Sequence[Path]) -> FloatArray:
    """Return the gates at heights: those that are wanted, or all that the beams have in common."""
    if options.height is None:
        return _common(gates, scan.level_direction[:, 2], options)
    goals = np.asarray(options.height, dtype=np.float64)
    return _nearest(gates, distances_at(scan, goals), goals, "height", options, paths)


def _common(gates: list[FloatArray], rise: FloatArray, options: FileOptions) -> FloatArray:
    """Return the levels at which all beams have a gate, shape (n, n_beam): those of the beam with fewest gates."""
    fewest = min(range(len(gates)), key=lambda index: len(gates[index]))
    levels = gates[fewest] * rise[fewest]
    columns, good = [], np.ones(len(levels), dtype=bool)
    for own, up in zip(gates, rise, strict=True):
        at, near = nearest_gates(own[np.newaxis], levels / up, options.range_tolerance)
        columns.append(own[at[0]])
        good &= near[0]
    found = np.stack(columns, axis=1)[good]
    rises = np.concatenate([[True], (np.diff(found, axis=0) > 0.0).all(axis=1)]) if len(found) else np.zeros(0, bool)
    return np.asarray(found[rises])


def _nearest(
    gates: list[FloatArray],
    goal: FloatArray,
    names: FloatArray,
    what: str,
    options: FileOptions,
    paths: Sequence[Path],
) -> FloatArray:
    """Return each beam's gates nearest to the wanted distances, shape (n, n_beam)."""
    order = np.argsort(names)
    goal, names = goal[order], names[order]
    columns = []
    for index, own in enumerate(gates):
        at, good = nearest_gates(own[np.newaxis], goal[:, index], options.range_tolerance)
        if not good.all():
            missing = int(np.argmin(good[0]))
            raise InputError(
                f"No gate at {what} {names[missing]:g} m in file {str(paths[0])!r}: {_in_words(gates)}; give another "
                f"{what}, or a larger range_tolerance (--range-tolerance)."
            )
        same = np.flatnonzero(np.diff(at[0]) == 0)
        if len(same):
            one, two = names[same[0]], names[same[0] + 1]
            raise InputError(
                f"The {what}s {one:g} and {two:g} m take the same gate of file {str(paths[0])!r}, at "
                f"{own[at[0][same[0]]]:g} m: {_in_words(gates)}; give one of them."
            )
        columns.append(own[at[0]])
    return np.stack(columns, axis=1)


def _in_words(gates: list[FloatArray]) -> str:
    """Say which gates the beams have."""
    fewest, most = min(gates, key=len), max(gates, key=len)
    words = short(fewest)
    listed = ", ".join(words) if len(words) <= 20 else f"{', '.join(words[:6])} … {', '.join(words[-2:])}"
    other = f", and of another beam {len(most)} up to {most[-1]:g} m" if len(most) != len(fewest) else ""
    return f"its {len(fewest)} gates are at {listed} m along the beam{other}"
