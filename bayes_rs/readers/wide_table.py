"""Wide tables: one row per time, with one column per beam."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.entries import beam_number, numbers, times, unknown_beam
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_TABLES, Reader
from bayes_rs.readers.samples import ROWS_AT_ONCE, Samples, joined
from bayes_rs.readers.table import TABLE_SUFFIXES, Table, open_table

_HEADING = re.compile(r"(?:(vr|beam|cnr|status|quality)_)?(-?\d+)")
_MEANING = {None: "radial_velocity", "vr": "radial_velocity", "beam": "radial_velocity", "quality": "status"}


def beam_columns(table: Table, scan: Scan) -> dict[str, dict[int, str]]:
    """Find the column of each beam: for radial_velocity, cnr and status, the heading by the scan's beam number.

    Raises
    ------
    InputError
        If a heading names a beam that the scan does not have, or two columns hold the same beam.
    """
    file_format = table.file_format
    own_name = {heading: name for name, heading in file_format.columns.items()}
    found: dict[str, dict[int, str]] = {"radial_velocity": {}, "cnr": {}, "status": {}}
    for heading in table.headings:
        mapped = own_name.get(heading)
        match = _HEADING.fullmatch(mapped if mapped is not None else heading)
        if mapped is None and heading in file_format.beam_numbers:
            meaning, label = "radial_velocity", heading
        elif match is not None:
            meaning, label = _MEANING.get(match[1], match[1]), match[2]
        else:
            continue
        # a name mapped with columns already says the scan's number
        number = int(label) if mapped is not None else beam_number(label, scan, file_format)
        if number is None or number not in scan.beam:
            raise unknown_beam(label, f"column {heading!r} of file {str(table.file)!r}", scan, file_format)
        if number in found[meaning]:
            raise InputError(
                f"File {str(table.file)!r} has two columns for {meaning} of beam {number}, "
                f"{found[meaning][number]!r} and {heading!r}: each beam must have one; remove or rename the other."
            )
        found[meaning][number] = heading
    return found


def looks_wide(table: Table, scan: Scan) -> bool:
    """Say whether a table is wide: it has a column that is a beam's."""
    return bool(beam_columns(table, scan)["radial_velocity"])


def read_wide(file: Path, scan: Scan, file_format: FileFormat) -> Samples:
    """Read a wide CSV or Parquet file.

    Raises
    ------
    InputError
        If there is no column for time or for any beam, or an entry cannot be used.
    """
    return joined(_pieces(file, scan, file_format, ROWS_AT_ONCE))


def wide_pieces(file: Path, scan: Scan, file_format: FileFormat, n_row: int) -> Iterator[Samples]:
    """Read a wide CSV or Parquet file, `n_row` rows at a time."""
    return _pieces(file, scan, file_format, n_row)


def _pieces(file: Path, scan: Scan, file_format: FileFormat, n_row: int) -> Iterator[Samples]:
    table = open_table(file, file_format)
    if not table.has("time"):
        raise table.missing("time")
    found = beam_columns(table, scan)
    for name in sorted(file_format.required - {"time"}):
        if not table.has(name):
            raise table.missing(name)
    if not found["radial_velocity"]:
        raise InputError(
            f"File {str(file)!r} has no column for a beam: {table.found()}; a wide table heads each beam's column with "
            "its number, vr_<number> or beam_<number>; otherwise say which column is which with the option "
            "beam_numbers={'heading in the file': number} (--beam-number HEADING=NUMBER)."
        )
    wanted = [file_format.column("time"), *(heading for part in found.values() for heading in part.values())]
    for frame, before in table.pieces(list(dict.fromkeys(wanted)), text=[file_format.column("time")], n_row=n_row):
        yield _samples(table, found, frame, before)


def _samples(table: Table, found: Mapping[str, Mapping[int, str]], frame: pd.DataFrame, before: int) -> Samples:
    file_format = table.file_format
    number = np.array(list(found["radial_velocity"]), dtype=np.int64)
    time_column = table.column(frame, "time", file_format.column("time"), before)
    time, invalid = times(time_column, file_format)
    value = {}
    for name, headings in found.items():
        block = np.full((len(frame), len(number)), np.nan)
        for index, beam in enumerate(number):
            if int(beam) in headings:
                column = table.column(frame, name, headings[int(beam)], before)
                block[:, index], invalid_value = numbers(column, file_format)
                invalid = invalid | invalid_value
        value[name] = block
    no_time = np.isnat(time)
    left_out = table.bad.mask(time_column.first_row, len(frame))
    keep = ~(no_time | left_out)
    n_row = int(keep.sum())
    return Samples(
        file=table.file,
        kind="wide",
        file_format=file_format,
        time=np.repeat(file_format.to_start(time[keep]), len(number)),
        beam=np.tile(number, n_row),
        radial_velocity=file_format.to_away(value["radial_velocity"][keep].ravel()),
        cnr=value["cnr"][keep].ravel() if found["cnr"] else None,
        status=value["status"][keep].ravel() if found["status"] else None,
        row=np.repeat(np.flatnonzero(keep) + time_column.first_row, len(number)),
        row_word=time_column.row_word,
        counts={
            "rows": len(frame),
            "rows_invalid_value": int(invalid.sum()),
            "rows_dropped": int((no_time & ~left_out).sum()),
            "rows_without_time": int((no_time & ~left_out).sum()),
            "rows_without_beam": 0,
            **table.bad.counts(time_column.first_row, len(frame)),
        },
        facts=table.bad.facts(),
    )


READER = Reader(
    name="wide",
    title="CSV or Parquet table, a row per time and a column per beam",
    source="this package; docs/formats.md",
    suffixes=TABLE_SUFFIXES,
    recognises=lambda file, scan, file_format: looks_wide(open_table(file, file_format), scan),
    read=read_wide,
    pieces=wide_pieces,
    uses=(*OF_TABLES, "beam_numbers"),
)
