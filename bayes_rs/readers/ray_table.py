"""Tables of rays, CSV or Parquet: azimuth, elevation, distance and velocity under any headings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_UNITS
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.entries import numbers
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.headings import Heading, unknown_unit
from bayes_rs.readers.interface import OF_RAYS, OF_TABLES, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.ray_groups import GateRows, check_angles, check_heights, counts_of, rays_of_rows
from bayes_rs.readers.ray_headings import RayColumns, find_ray_columns, looks_like_rays
from bayes_rs.readers.rays import Rays, direction_of
from bayes_rs.readers.row_times import times_of_rays
from bayes_rs.readers.table import TABLE_SUFFIXES, Table, open_table
from bayes_rs.readers.units import factor_to_degrees, factor_to_metres, velocity_unit_of

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

_DEGREE_SIGNS = ("º", "\ufffd")  # also as bytes of another encoding
_MOLAS = {"Azimuth(deg)", "Elevation(deg)", "Distance(m)", "RWS(m/s)", "CNR(dB)", "Craft RWS(m/s)"}


def ray_table_rays(file: Path, file_format: FileFormat, *, kind: str = "rays") -> Rays:
    """Return the rays of one table.

    Parameters
    ----------
    file : Path
        A CSV or Parquet table: a row for each ray and gate, or a row for each ray and a column for each gate.
    file_format : FileFormat
        The reader's options. ``columns`` names ``time``, ``azimuth``, ``elevation``, ``radial_velocity``, ``distance``
        (or ``range``), ``height``, ``gate``, ``cnr`` and ``status``; without it they are looked for by their headings.
    kind : str
        Name of the format.

    Returns
    -------
    rays : Rays
        One for each time and direction; its gates are sorted by distance. Rows without a distance are dropped, and
        counted.

    Raises
    ------
    InputError
        If a column is missing or could be several, a unit is not known, or an entry cannot be used.

    Notes
    -----
    Azimuth counts clockwise from north, elevation from the horizon, in degrees, or in radians if the heading says so. A
    height h is above the lidar and gives the distance h / sin(elevation). Gate n is at (n + ½) ``gate_length``. Of a
    row for each ray, the columns of the gates have one number each in their headings: that of a column of distances, or
    metres along the beam or above the lidar. A unit in a heading counts where nobody gives ``velocity_unit``.
    """
    table = open_table(file, file_format)
    columns = find_ray_columns(table)
    table = replace(table, file_format=_with_unit(columns, file_format, file))
    data = _Data(table, columns)
    return _whole_rays(data, kind) if columns.per_gate else _rays_of_gates(data, kind)


class _Data:
    """The columns of a table that was read, as numbers; and which rows hold an invalid value."""

    def __init__(self, table: Table, columns: RayColumns) -> None:
        self.table, self.columns = table, columns
        every = (*columns.time, columns.azimuth, columns.elevation)
        more = (*columns.radial_velocity, *columns.cnr, *columns.status, *columns.place_columns, *columns.heights)
        wanted = list(dict.fromkeys(heading.own for heading in (*every, *more)))
        (self._frame, _), *_rest = table.pieces(wanted, text=[heading.own for heading in columns.time])
        column, *of_day = (table.column(self._frame, "time", heading.own) for heading in columns.time)
        for other in of_day:
            both = column.values.astype("string").str.strip() + " " + other.values.astype("string").str.strip()
            column = replace(column, heading=f"{column.heading} {other.heading}", values=both)
        self.time, self.invalid = times_of_rays(column, table.file_format)
        self.row = column.first_row + np.arange(len(self._frame), dtype=np.int64)
        self.row_word = column.row_word
        self.azimuth = self._angle("azimuth", columns.azimuth)
        self.elevation = self._angle("elevation", columns.elevation)

    def values(self, name: str, headings: Sequence[Heading]) -> FloatArray | None:
        """Return columns, shape (n_row, n_column); None if there is none."""
        if not headings:
            return None
        block = np.empty((len(self._frame), len(headings)))
        for index, heading in enumerate(headings):
            column = self.table.column(self._frame, name, heading.own)
            block[:, index], is_invalid = numbers(column, self.table.file_format)
            self.invalid = self.invalid | is_invalid
        return block

    def distance(self) -> FloatArray:
        """Return where the gates are along the beams, m, shape (n_row, n_gate)."""
        columns, file = self.columns, self.table.file
        values = self.values(columns.place, columns.place_columns)
        if values is None:
            row = np.array([heading.number for heading in columns.radial_velocity], dtype=np.float64)
            values = np.broadcast_to(row, (len(self.row), len(row)))
        if columns.place == "gate":
            if self.table.file_format.gate_length is None:
                raise InputError(
                    f"File {str(file)!r} numbers its gates (column {columns.place_columns[0].own!r}) and does not say "
                    "how long they are: give gate_length in m (--gate-length), or the column of distances with "
                    "columns={'distance': 'its heading'}."
                )
            return (values + 0.5) * self.table.file_format.gate_length
        for heading in columns.place_columns[:1]:
            values = values * _factor(factor_to_metres, heading, file, "m, km, cm, mm or feet")
        if columns.place == "height":
            rise = np.sin(np.deg2rad(self.elevation))[:, np.newaxis]
            return values / np.where(rise > 0.0, rise, np.nan)
        return values

    def heights(self) -> FloatArray | None:
        """Return heights beside distances, m, shape (n_row, n_gate); None if there are none, or one for all gates."""
        values = self.values("height", self.columns.heights)
        if values is None or len(np.unique(values[np.isfinite(values)])) < 2:
            return None
        return values * _factor(factor_to_metres, self.columns.heights[0], self.table.file, "m, km, cm, mm or feet")

    def left_out(self) -> BoolArray:
        """Say which rows are bad, when all columns have been read."""
        self.table.bad.check(len(self.row))
        return self.table.bad.mask(self.table.first_row, len(self.row))

    def counts(self) -> dict[str, int]:
        """Count the rows that are left out."""
        return self.table.bad.counts(self.table.first_row, len(self.row))

    def _angle(self, name: str, heading: Heading) -> FloatArray:
        factor = _factor(factor_to_degrees, heading, self.table.file, "degrees or radians")
        block = self.values(name, [heading])
        angle = np.zeros(len(self.row)) if block is None else factor * block[:, 0]
        check = (angle, np.zeros_like(angle)) if name == "azimuth" else (np.zeros_like(angle), angle)
        check_angles(*check, self.row, self.row_word, self.table.file)
        return angle


def _rays_of_gates(data: _Data, kind: str) -> Rays:
    """Return the rays of a table with a row for each ray and gate."""

    def one(name: str, headings: Sequence[Heading]) -> FloatArray | None:
        block = data.values(name, headings)
        return None if block is None else block[:, 0]

    columns = data.columns
    velocity = one("radial_velocity", columns.radial_velocity)
    cnr, status, distance = one("cnr", columns.cnr), one("status", columns.status), data.distance()[:, 0]
    place = one("height", columns.place_columns) if columns.place == "height" else None
    heights = data.heights()
    rows = GateRows(
        time=data.time,
        azimuth=data.azimuth,
        elevation=data.elevation,
        distance=distance,
        radial_velocity=np.full(len(distance), np.nan) if velocity is None else velocity,
        cnr=cnr,
        status=status,
        invalid=data.invalid,
        row=data.row,
        place=place,
        height=None if heights is None else heights[:, 0],
    )
    left_out = data.left_out()
    rows = rows.select(~left_out) if left_out.any() else rows
    return rays_of_rows(
        rows,
        data.table.file,
        data.table.file_format,
        kind=kind,
        row_word=data.row_word,
        left_out=data.counts(),
        facts=data.table.bad.facts(),
    )


def _whole_rays(data: _Data, kind: str) -> Rays:
    """Return the rays of a table with a row for each ray."""
    columns, file_format = data.columns, data.table.file_format
    distance = data.distance()
    distance = np.where(distance > 0.0, distance, np.nan)
    order = _order_of_gates(distance)

    def in_order(name: str, headings: Sequence[Heading]) -> FloatArray | None:
        block = data.values(name, headings)
        return None if block is None else np.take_along_axis(block, order, axis=1)

    velocity = in_order("radial_velocity", columns.radial_velocity)
    cnr, status = in_order("cnr", columns.cnr), in_order("status", columns.status)
    heights = data.heights()
    kept = np.flatnonzero(~data.left_out())
    if heights is not None:
        check_heights(
            distance[kept], data.elevation[kept], heights[kept], data.row[kept], data.row_word, data.table.file
        )
    return Rays(
        file=data.table.file,
        kind=kind,
        file_format=file_format,
        time=file_format.to_start(data.time[kept]),
        direction=direction_of(data.azimuth[kept], data.elevation[kept]),
        distance=np.take_along_axis(distance, order, axis=1)[kept],
        radial_velocity=file_format.to_away(np.full(distance.shape, np.nan) if velocity is None else velocity)[kept],
        cnr=None if cnr is None else cnr[kept],
        status=None if status is None else status[kept],
        row=data.row[kept],
        row_word=data.row_word,
        counts=counts_of(len(kept), invalid=int(data.invalid[kept].sum()), left_out=data.counts()),
        facts=data.table.bad.facts(),
    )


def _order_of_gates(distance: FloatArray) -> IntArray:
    """Return the order of the gates of each ray; that of all rays if they agree, so that a missing one stays a hole."""
    nearest = np.where(np.isfinite(distance), distance, np.inf).min(axis=0, initial=np.inf)
    common = np.argsort(nearest, kind="stable")
    farthest = np.maximum.accumulate(np.where(np.isfinite(distance), distance, 0.0)[:, common], axis=1)
    agree = not (distance[:, common] < farthest).any()
    return np.broadcast_to(common, distance.shape) if agree else np.argsort(distance, axis=1, kind="stable")


def _factor(convert: Callable[..., float], heading: Heading, file: Path, allowed: str) -> float:
    """Return by what a column must be multiplied to be in degrees, or in m."""
    try:
        return convert("deg" if heading.unit in _DEGREE_SIGNS else heading.unit, name=heading.own, file=file)
    except InputError:
        raise unknown_unit(file, heading, allowed) from None


def _with_unit(columns: RayColumns, file_format: FileFormat, file: Path) -> FileFormat:
    """Return the options with the velocity's unit of its heading, if nobody gave another."""
    heading = columns.radial_velocity[0]
    if not heading.unit:
        return file_format
    unit = velocity_unit_of(heading.unit)
    if unit is None:
        raise unknown_unit(file, heading, ", ".join(VELOCITY_UNITS))
    if "velocity_unit" in file_format.from_format:
        return replace(file_format, velocity_unit=unit)
    if file_format.velocity_unit != unit:
        raise InputError(
            f"Column {heading.own!r} of file {str(file)!r} says {unit}, and the option velocity_unit "
            f"{file_format.velocity_unit}: leave the option out, or rename the column."
        )
    return file_format


def _opened(file: Path, file_format: FileFormat) -> Table | None:
    try:
        return open_table(file, file_format)
    except InputError:
        return None  # the readers of tables say what is wrong with it


def recognises_rays(file: Path, _scan: Scan, file_format: FileFormat) -> bool:
    """Say whether a table has columns for an azimuth, an elevation and a radial velocity."""
    table = _opened(file, file_format)
    return table is not None and looks_like_rays(table)


def recognises_molas(file: Path, _scan: Scan, file_format: FileFormat) -> bool:
    """Say whether the headings are those of a Molas 3D's real-time file."""
    table = _opened(file, file_format)
    return table is not None and set(table.headings) >= _MOLAS and not table.has("beam")


def _reader(name: str, **more: Any) -> Reader:
    def rays(file: Path, file_format: FileFormat) -> Rays:
        return ray_table_rays(file, file_format, kind=name)

    uses = (*OF_TABLES, *OF_RAYS, "gate_length", "gates_by")
    return Reader(name=name, suffixes=TABLE_SUFFIXES, read=by_rays(rays), rays=rays, uses=uses, **more)


MOLAS = _reader(
    "molas",
    title="Molas 3D (Movelaser), real-time CSV",
    source="samples and list of fields of github.com/19bdxx/Doppler-wind-profile-lidar-data",
    recognises=recognises_molas,
    defaults={"positive": "away", "velocity_unit": "m/s"},
)
READER = _reader(
    "rays",
    title="CSV or Parquet table, a row per ray, or per ray and gate",
    source="this package; docs/formats.md",
    recognises=recognises_rays,
    defaults={"positive": "away", "velocity_unit": "m/s"},
    must_say=("positive",),
)
