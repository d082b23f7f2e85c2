"""Long tables: one row per sample, with a time, a beam and a radial velocity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.entries import beams, numbers, times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import Reader
from bayes_rs.readers.samples import Samples
from bayes_rs.readers.table import TABLE_SUFFIXES, Column, Table, open_table

ALSO_STATUS = "quality"


def looks_long(table: Table) -> bool:
    """Say whether a table is long: it has a column for the beam or for the radial velocity."""
    return table.has("beam") or table.has("radial_velocity")


def read_long(file: Path, scan: Scan, file_format: FileFormat) -> Samples:
    """Read a long CSV or Parquet file.

    Raises
    ------
    InputError
        If a column is missing or an entry cannot be used.
    """
    return next(_pieces(file, scan, file_format, None))


def long_pieces(file: Path, scan: Scan, file_format: FileFormat, n_row: int) -> Iterator[Samples]:
    """Read a long CSV or Parquet file, `n_row` rows at a time."""
    return _pieces(file, scan, file_format, n_row)


def _pieces(file: Path, scan: Scan, file_format: FileFormat, n_row: int | None) -> Iterator[Samples]:
    table = open_table(file, file_format)
    heading = {name: file_format.column(name) for name in ("time", "beam", "radial_velocity", "cnr", "status")}
    if "status" not in file_format.columns and not table.has("status") and ALSO_STATUS in table.headings:
        heading["status"] = ALSO_STATUS
    for name in ("time", "beam", "radial_velocity", "cnr", "status"):
        must = name in ("time", "beam", "radial_velocity") or name in file_format.required
        if heading[name] not in table.headings:
            if must:
                raise table.missing(name)
            del heading[name]
    wanted, text = list(dict.fromkeys(heading.values())), [heading["time"], heading["beam"]]
    for frame, before in table.pieces(wanted, text=text, n_row=n_row):
        yield _samples(table, scan, {name: table.column(frame, name, heading[name], before) for name in heading})


def _samples(table: Table, scan: Scan, column: Mapping[str, Column]) -> Samples:
    file_format = table.file_format
    time, invalid = times(column["time"], file_format)
    beam, no_beam, invalid_beam = beams(column["beam"], scan, file_format)
    invalid = invalid | invalid_beam
    value = {}
    for name in ("radial_velocity", "cnr", "status"):
        if name in column:
            value[name], invalid_value = numbers(column[name], file_format)
            invalid = invalid | invalid_value
    no_time = np.isnat(time)
    keep = ~(no_time | no_beam)
    return Samples(
        file=table.file,
        kind="long",
        file_format=file_format,
        time=file_format.to_start(time[keep]),
        beam=beam[keep],
        radial_velocity=file_format.to_away(value["radial_velocity"][keep]),
        cnr=value["cnr"][keep] if "cnr" in value else None,
        status=value["status"][keep] if "status" in value else None,
        row=np.flatnonzero(keep) + column["time"].first_row,
        row_word=column["time"].row_word,
        counts={
            "rows": len(keep),
            "rows_invalid_value": int(invalid.sum()),
            "rows_dropped": int((~keep).sum()),
            "rows_without_time": int(no_time.sum()),
            "rows_without_beam": int(no_beam.sum()),
        },
    )


READER = Reader(
    name="long",
    title="CSV or Parquet table, a row per sample",
    source="this package; docs/formats.md",
    suffixes=TABLE_SUFFIXES,
    recognises=lambda file, _, file_format: looks_long(open_table(file, file_format)),
    read=read_long,
    pieces=long_pieces,
)
