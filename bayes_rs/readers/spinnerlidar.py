"""SpinnerLidar: text without headings, a line per sample with the position on the unit sphere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.compressed import UNREADABLE, unreadable
from bayes_rs.readers.entries import numbers, times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_RAYS, Reader
from bayes_rs.readers.rays import Rays
from bayes_rs.readers.samples import Samples
from bayes_rs.readers.sequence import match_sequence
from bayes_rs.readers.table import Column

SUFFIXES = (".txt", ".dat", ".csv")
DEFAULTS = {
    "columns": {"time": "2", "radial_velocity": "3", "sx": "7", "sy": "8", "distance": "9"},
    "positive": "towards",
    "separator": "tab",
    "time_format": "unix",
}
"""Numbers of the columns, from 1, and the sign: a homodyne lidar that faces the wind measures −v."""

_NEEDED = ("time", "radial_velocity", "sx", "sy", "distance")
_LEAST_COLUMNS = 9
_ROUNDING = 1e-3  # sx² + sy² of positions written with three or four decimals


def recognises_spinnerlidar(file: Path, _scan: Scan, file_format: FileFormat) -> bool:
    """Say whether a file has no headings, nine columns of numbers or more, and a position in the unit disc."""
    try:
        with file.open("rb") as opened:
            first = opened.readline(4096).decode("utf-8", errors="replace")
    except UNREADABLE:
        return False
    words = first.strip("\ufeff \r\n").split(file_format.separator)
    try:
        number = [float(word.replace(",", ".") if file_format.decimal == "," else word) for word in words]
        sx, sy, distance = (number[_index(file_format, name)] for name in ("sx", "sy", "distance"))
    except (ValueError, IndexError, InputError):
        return False
    return len(number) >= _LEAST_COLUMNS and _in_disc(sx, sy) and distance > 0.0


def read_spinnerlidar(file: Path, scan: Scan, file_format: FileFormat) -> Samples:
    """Read the samples of a scan's beams from one file; see `spinnerlidar_rays`.

    Raises
    ------
    InputError
        If the file cannot be read, or no sample is along a beam of the scan.
    """
    return match_sequence(
        spinnerlidar_rays(file, file_format),
        scan,
        angle_tolerance_deg=file_format.angle_tolerance_deg,
        range_tolerance=file_format.range_tolerance,
    )


def spinnerlidar_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the samples of one file as rays with one gate, at the focus distance.

    Parameters
    ----------
    file : Path
        Text without headings, separated by tabs (or as the option ``separator`` says).
    file_format : FileFormat
        The reader's options; ``columns`` gives the numbers of the columns, from 1.

    Returns
    -------
    rays : Rays
        Directions (−√(1 − sx² − sy²), sy, sx), in the frame of a nacelle lidar's axis.

    Raises
    ------
    InputError
        If the file has too few columns, an entry is not a number, or a position is outside the unit disc.

    Notes
    -----
    Columns 1 (index), 3 (line-of-sight velocity, m/s), 7 and 8 (sx and sy, the components of the pointing's unit
    vector) and 9 (focus distance, m) are those of the DTU SpinnerLidar's text files as scripts of the University of
    Oldenburg's measurement course read them, which plot x = sz f, y = −sy f and z = sx f: sx is up. That y is to the
    left seen from the lidar, as a right-handed frame has it, is our reading. The scripts do not read column 2; that
    it is the time, in seconds since 1970, is our guess: say what it is with ``columns`` and ``time_format``.

    A homodyne lidar measures the magnitude of the velocity. Facing the wind, the air comes towards the lidar: the
    default ``positive="towards"`` makes the radial velocity −v. For a lidar that looks downwind give ``"away"``.
    Velocities below the lowest that the lidar resolves, or where the wind turns, have no sign and do not belong in
    a variance: exclude them by status, or leave such beams out.

    References
    ----------
    Positions and columns: the scripts to ``SpinnerLidar_Data_1s.txt``, Wind Physics Measurement Project, Carl von
    Ossietzky Universität Oldenburg, as published by its students on GitHub (2018 to 2026).
    """
    frame = _frame(file, file_format)
    named = {name: _index(file_format, name) for name in (*_NEEDED, "cnr", "status") if name in file_format.columns}
    for name in _NEEDED:
        if name not in named:
            raise InputError(f"File {str(file)!r}: give the number of the column of {name} with the option columns.")
    for name, index in named.items():
        if index >= frame.shape[1]:
            raise InputError(
                f"File {str(file)!r} has {frame.shape[1]} columns, and {name} is to be number {index + 1}: check the "
                "options separator and columns."
            )
    column = {name: Column(name, str(index + 1), frame[index], file, "line", 1) for name, index in named.items()}
    time, invalid = times(column["time"], file_format)
    value = {}
    for name in named:
        if name != "time":
            value[name], is_invalid = numbers(column[name], file_format)
            invalid = invalid | is_invalid
    sx, sy = value["sx"], value["sy"]
    outside = ~_in_disc(sx, sy) & np.isfinite(sx) & np.isfinite(sy)
    if outside.any():
        index = int(np.argmax(outside))
        raise InputError(
            f"Invalid position sx = {sx[index]:g}, sy = {sy[index]:g} in line {index + 1} of file {str(file)!r}: it is "
            "outside the unit disc; check which columns they are with the option columns."
        )
    towards_wind = np.sqrt(np.maximum(1.0 - sx**2 - sy**2, 0.0))
    direction = np.stack([-towards_wind, sy, sx], axis=-1)
    return Rays(
        file=file,
        kind="spinnerlidar",
        file_format=file_format,
        time=file_format.to_start(time),
        direction=direction / np.linalg.norm(direction, axis=1, keepdims=True),
        distance=value["distance"][:, np.newaxis],
        radial_velocity=file_format.to_away(value["radial_velocity"])[:, np.newaxis],
        cnr=value["cnr"][:, np.newaxis] if "cnr" in value else None,
        status=value["status"][:, np.newaxis] if "status" in value else None,
        row=1 + np.arange(len(time), dtype=np.int64),
        row_word="line",
        counts={
            "rows": len(time),
            "rows_invalid_value": int(invalid.sum()),
            "rows_dropped": 0,
            "rows_without_time": 0,
            "rows_without_beam": 0,
        },
    )


def _in_disc(sx: FloatArray | float, sy: FloatArray | float) -> Any:
    """Say whether positions are in the unit disc; each alone first, so that no square overflows."""
    sx, sy = np.asarray(sx), np.asarray(sy)
    small = (np.abs(sx) < 2.0) & (np.abs(sy) < 2.0)
    return np.where(small, sx, 2.0) ** 2 + np.where(small, sy, 2.0) ** 2 <= 1.0 + _ROUNDING


def _frame(file: Path, file_format: FileFormat) -> pd.DataFrame:
    try:
        return pd.read_csv(
            file,
            header=None,
            sep=file_format.separator,
            decimal=file_format.decimal,
            encoding="utf-8-sig",
            encoding_errors="replace",
            skip_blank_lines=False,
            skipinitialspace=True,
            dtype={_index(file_format, "time"): "str"},
            low_memory=False,
        )
    except pd.errors.EmptyDataError as error:
        raise InputError(f"File {str(file)!r} is empty: give a file with samples.") from error
    except pd.errors.ParserError as error:
        raise InputError(
            f"File {str(file)!r} is not a table: {' '.join(str(error).split())}; every line must have as many entries "
            "as the first; check the options separator and decimal."
        ) from error
    except UNREADABLE as error:
        raise unreadable(file, error) from error


def _index(file_format: FileFormat, name: str) -> int:
    given = file_format.columns.get(name, "")
    if not given.isdecimal() or int(given) < 1:
        raise InputError(
            f"Invalid column {given!r} of {name}: a file without headings needs the number of the column, from 1; "
            f"give columns={{{name!r}: '3'}}."
        )
    return int(given) - 1


READER = Reader(
    name="spinnerlidar",
    title="DTU SpinnerLidar, text without headings",
    source="scripts of the University of Oldenburg's measurement course; columns by the option columns",
    suffixes=SUFFIXES,
    recognises=recognises_spinnerlidar,
    read=read_spinnerlidar,
    rays=spinnerlidar_rays,
    defaults=DEFAULTS,
    uses=(*OF_RAYS, "separator", "decimal", "time_format", "columns"),
)
