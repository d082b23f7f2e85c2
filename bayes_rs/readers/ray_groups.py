"""Rows of a table, one for each gate of each ray, put together as rays with all their gates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.contradictions import agree
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.rays import Rays, direction_of

IntArray = NDArray[np.int64]

_ANGLE_LIMIT = 1e6  # degrees; encoders count on over many turns, fill values are far away
_MOST_PADDING = 8  # times the rows; and what is small anyway
_SMALL = 1_000_000


@dataclass(frozen=True)
class GateRows:
    """What rows hold: each is one gate of one ray.

    Parameters
    ----------
    time : ndarray of datetime64[ns], shape (n_row,)
        UTC; NaT where missing.
    azimuth, elevation : ndarray, shape (n_row,)
        Degrees.
    distance : ndarray, shape (n_row,)
        m; NaN where missing.
    radial_velocity : ndarray, shape (n_row,)
        As in the file.
    cnr, status : ndarray, shape (n_row,), optional
    invalid : ndarray of bool, shape (n_row,)
        Which rows hold a mark of a missing value.
    row : ndarray of int, shape (n_row,)
        Where each row stands.
    place : ndarray, shape (n_row,), optional
        What tells the gates of a ray apart, in the order of their distances, such as a height; the distance if not
        given.
    height : ndarray, shape (n_row,), optional
        m, where the file says heights beside distances.
    """

    time: NDArray[np.datetime64]
    azimuth: FloatArray
    elevation: FloatArray
    distance: FloatArray
    radial_velocity: FloatArray
    cnr: FloatArray | None
    status: FloatArray | None
    invalid: NDArray[np.bool_]
    row: IntArray
    place: FloatArray | None = None
    height: FloatArray | None = None

    def select(self, kept: NDArray[np.bool_]) -> GateRows:
        """Return some of the rows."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        values: dict[str, Any] = {name: None if value is None else value[kept] for name, value in given.items()}
        return GateRows(**values)


def rays_of_rows(
    rows: GateRows,
    file: Path,
    file_format: FileFormat,
    *,
    kind: str,
    row_word: str,
    left_out: Mapping[str, int],
    facts: Mapping[str, Any],
    accumulation_time: FloatArray | None = None,
) -> Rays:
    """Return the rays that rows of gates are.

    Parameters
    ----------
    rows : GateRows
        The rows, in any order.
    file, file_format, kind, row_word
        As in `Rays`.
    left_out : mapping of str to int
        Counts of rows that are not among these: ``rows_bad``, ``rows_cut``.
    facts : mapping
        What else the report says of the file.
    accumulation_time : ndarray, shape (n_row,), optional
        s.

    Returns
    -------
    rays : Rays
        One for each time and direction, in the order of their first rows; the gates are sorted by distance. A gate that
        a ray lacks and others have is NaN, so that it is not taken for its neighbour. Where a gate stands there twice,
        the second belongs to another ray. Rows without a distance are dropped, and counted.

    Raises
    ------
    InputError
        If an angle is none, the numbers of gates differ so much that the rows are no rays, or distances and heights
        contradict each other.
    """
    check_angles(rows.azimuth, rows.elevation, rows.row, row_word, file)
    known = np.isfinite(rows.distance) & (rows.distance > 0.0)
    if not known.all():
        left_out = {**left_out, "rows_without_range": int((~known).sum())}
        rows = rows.select(known)
        accumulation_time = None if accumulation_time is None else accumulation_time[known]
    ray, gate, first = ray_and_gate(rows.time, rows.azimuth, rows.elevation, rows.distance)
    n_ray, n_gate = len(first), int(gate.max()) + 1 if len(gate) else 0
    if n_ray * n_gate > _MOST_PADDING * len(ray) + _SMALL:
        raise InputError(
            f"File {str(file)!r} has {n_gate} rows of one time and direction, and {n_ray} times and directions for "
            f"{len(ray)} rows: these are no rays with gates; check which columns are time, azimuth and elevation."
        )
    gate = with_holes(ray, gate, rows.distance if rows.place is None else rows.place, rows.elevation)
    already = n_ray * n_gate == len(ray) and np.array_equal(ray * n_gate + gate, np.arange(len(ray)))

    def spread(values: FloatArray) -> FloatArray:
        if already:
            return values.reshape(n_ray, n_gate)
        filled = np.full((n_ray, n_gate), np.nan)
        filled[ray, gate] = values
        return filled

    if rows.height is not None:
        check_heights(
            spread(rows.distance), rows.elevation[first], spread(rows.height), rows.row[first], row_word, file
        )
    invalid = np.zeros(n_ray, dtype=bool)
    invalid[ray[rows.invalid]] = True
    duration = None if accumulation_time is None else accumulation_time[first]
    return Rays(
        file=file,
        kind=kind,
        file_format=file_format,
        time=file_format.to_start(rows.time[first], duration),
        direction=direction_of(rows.azimuth[first], rows.elevation[first]),
        distance=spread(rows.distance),
        radial_velocity=spread(file_format.to_away(rows.radial_velocity)),
        cnr=None if rows.cnr is None else spread(rows.cnr),
        status=None if rows.status is None else spread(rows.status),
        row=rows.row[first],
        row_word=row_word,
        counts=counts_of(n_ray, invalid=int(invalid.sum()), left_out=left_out),
        facts=facts,
        accumulation_time=duration,
    )


def counts_of(n_ray: int, *, invalid: int, left_out: Mapping[str, int]) -> dict[str, int]:
    """Return the counts of a file of rays; `left_out` counts the rows that are none, by what they are called there."""
    return {
        "rows": n_ray + left_out.get("rows_bad", 0) + left_out.get("rows_cut", 0),
        "rows_invalid_value": invalid,
        "rows_dropped": 0,
        "rows_without_time": 0,
        "rows_without_beam": 0,
        **left_out,
    }


def check_angles(azimuth: FloatArray, elevation: FloatArray, row: IntArray, row_word: str, file: Path) -> None:
    """Refuse an angle that is a mark of a missing entry, not an angle."""
    for name, angle in (("azimuth", azimuth), ("elevation", elevation)):
        far = np.abs(angle) > _ANGLE_LIMIT
        if far.any():
            index = int(np.argmax(far))
            raise InputError(
                f"Invalid {name} {angle[index]:g} in {row_word} {row[index]} of file {str(file)!r}: it must be an "
                "angle in degrees; if the number marks a missing entry, give it as the option invalid "
                f"({angle[index]:g})."
            )


def check_heights(
    distance: FloatArray, elevation: FloatArray, height: FloatArray, row: IntArray, row_word: str, file: Path
) -> None:
    """Refuse distances of gates, shape (n_ray, n_gate), that contradict their heights.

    Raises
    ------
    InputError
        If they do. One number may lie between all of them: heights above the ground or the sea agree.
    """
    agreed = agree(distance, elevation, height)
    if agreed.distance is None or agreed.reordered:
        rise = np.sin(np.deg2rad(elevation))[:, np.newaxis]
        off = np.abs(distance * rise - height)
        ray, gate = np.unravel_index(int(np.nanargmax(off)), off.shape)
        raise InputError(
            f"Distances and heights of the gates in file {str(file)!r} contradict each other: in the ray of {row_word} "
            f"{row[ray]}, at an elevation of {elevation[ray]:g} degrees, a gate has the distance "
            f"{distance[ray, gate]:g} m and the height {height[ray, gate]:g} m; say which to believe with "
            "gates_by='distance' or gates_by='height' (--gates-by)."
        )


def ray_and_gate(
    time: NDArray[np.datetime64], azimuth: FloatArray, elevation: FloatArray, distance: FloatArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Return for each row the number of its ray and of its gate, and for each ray the index of its first row.

    Examples
    --------
    >>> time = np.array(["2024-01-01"] * 4, dtype="datetime64[ns]")
    >>> ray, gate, first = ray_and_gate(time, np.array([0.0, 0, 9, 0]), np.zeros(4), np.array([90.0, 60, 60, 60]))
    >>> ray.tolist(), gate.tolist(), first.tolist()
    ([0, 0, 1, 2], [1, 0, 0, 0], [0, 2, 3])
    """
    n_row = len(time)
    if n_row == 0:
        nothing = np.zeros(0, dtype=np.int64)
        return nothing, nothing, nothing
    keys = np.stack([time.astype("datetime64[ns]").astype(np.int64), _bits(azimuth), _bits(elevation)])
    changes = np.concatenate([[True], (keys[:, 1:] != keys[:, :-1]).any(axis=0)])
    run = np.cumsum(changes) - 1
    starts = np.flatnonzero(changes)
    of_run = _same(keys[:, starts])
    group = of_run[run]
    in_order = (np.diff(group) > 0) | ((np.diff(group) == 0) & (np.diff(distance, prepend=0.0)[1:] > 0.0))
    if in_order.all():
        first = starts
        return group, np.arange(n_row) - first[group], first
    order = np.lexsort((np.arange(n_row), distance, group))
    same = (np.diff(group[order]) == 0) & (distance[order][1:] == distance[order][:-1])
    twice = _run_index(np.concatenate([[True], ~same]))  # 0 for the first of equal gates, 1 for the second
    again = np.zeros(n_row, dtype=np.int64)
    again[order] = twice
    # the rays in the order of their first rows
    pair = group * (int(again.max()) + 1) + again
    _, at, ray_of_pair = np.unique(pair, return_index=True, return_inverse=True)
    rank = np.empty(len(at), dtype=np.int64)
    rank[np.argsort(at, kind="stable")] = np.arange(len(at))
    ray = rank[ray_of_pair.ravel()]
    order = np.lexsort((distance, ray))
    gate = np.empty(n_row, dtype=np.int64)
    gate[order] = _run_index(np.concatenate([[True], np.diff(ray[order]) > 0]))
    return ray, gate, np.sort(at)


def with_holes(ray: IntArray, gate: IntArray, place: FloatArray, elevation: FloatArray) -> IntArray:
    """Return the numbers of gates with those left out that a ray lacks and other rays of its kind have.

    Rays are of one kind if one of them has all gates that any of them has: all rays of a file, or else those of one
    elevation. Where they are not, gates are numbered without holes.

    Examples
    --------
    >>> ray, gate = np.array([0, 0, 0, 1, 1]), np.array([0, 1, 2, 0, 1])
    >>> with_holes(ray, gate, np.array([50.0, 100, 150, 50, 150]), np.full(5, 75.0)).tolist()
    [0, 1, 2, 0, 2]
    """
    if len(ray) == 0 or (np.bincount(ray) == gate.max() + 1).all():
        return gate
    tenths = np.round(10.0 * np.nan_to_num(elevation))
    for kind in (np.zeros(len(ray), dtype=np.int64), np.unique(tenths, return_inverse=True)[1].ravel()):
        order = np.lexsort((place, kind))
        new_kind = np.append(True, np.diff(kind[order]) > 0)
        new = new_kind | np.append(True, np.diff(place[order]) > 0.0)
        number = np.cumsum(new) - 1
        rank = np.empty(len(ray), dtype=np.int64)
        rank[order] = number - np.maximum.accumulate(np.where(new_kind, number, 0))
        n_place, n_gate = (np.zeros(int(kind.max()) + 1, dtype=np.int64) for _ in range(2))
        np.maximum.at(n_place, kind, rank)
        np.maximum.at(n_gate, kind, gate)
        if (n_place == n_gate).all():
            return rank
    return np.where((n_place == n_gate)[kind], rank, gate)


def _bits(values: FloatArray) -> IntArray:
    """Return numbers as keys that are the same where the numbers are, also where they are NaN."""
    return np.where(np.isnan(values), np.nan, values + 0.0).view(np.int64)


def _same(keys: IntArray) -> IntArray:
    """Number columns of keys in the order of their first appearance, equal ones with one number."""
    order = np.lexsort(keys[::-1])
    new = np.concatenate([[True], (keys[:, order][:, 1:] != keys[:, order][:, :-1]).any(axis=0)])
    label = np.empty(keys.shape[1], dtype=np.int64)
    label[order] = np.cumsum(new) - 1
    first = order[new]  # lexsort is stable: the first of equal ones
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[label]


def _run_index(begins: NDArray[np.bool_]) -> IntArray:
    """Return for each entry how many of its run are before it."""
    index = np.arange(len(begins))
    return index - np.maximum.accumulate(np.where(begins, index, 0))
