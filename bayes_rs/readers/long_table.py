"""Long tables: one row per sample, with a time, a beam and a radial velocity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.beam_ranges import BeamRanges, match_ranges, no_range
from bayes_rs.readers.entries import beams, numbers, times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_TABLES, Reader
from bayes_rs.readers.samples import ROWS_AT_ONCE, Samples, joined
from bayes_rs.readers.table import TABLE_SUFFIXES, Column, Table, open_table
from bayes_rs.readers.unnamed_ranges import check_one_place, like_ranges

ALSO_STATUS = "quality"
_NAMES = ("time", "beam", "radial_velocity", "cnr", "status", "range")


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
    return joined(_pieces(file, scan, file_format, ROWS_AT_ONCE))


def long_pieces(file: Path, scan: Scan, file_format: FileFormat, n_row: int) -> Iterator[Samples]:
    """Read a long CSV or Parquet file, `n_row` rows at a time."""
    return _pieces(file, scan, file_format, n_row)


def ranges_of_table(file: Path, file_format: FileFormat) -> FloatArray:
    """Return the distinct distances along the beams of a long table, m, in order; empty if no column says them.

    Raises
    ------
    InputError
        If the file is no table, the column was asked for and is not there, or an entry is no number.
    """
    return _ranges(open_table(file, file_format))


def _ranges(table: Table) -> FloatArray:
    heading = table.file_format.column("range")
    if not table.has("range"):
        if "range" in table.file_format.required:
            raise table.missing("range")
        return np.zeros(0)
    found = np.zeros(0)
    for frame, before in table.pieces([heading], n_row=ROWS_AT_ONCE):
        values, _ = numbers(table.column(frame, "range", heading, before), table.file_format)
        found = np.union1d(found, values[np.isfinite(values)])
    return found


def _pieces(file: Path, scan: Scan, file_format: FileFormat, n_row: int) -> Iterator[Samples]:
    table = open_table(file, file_format)
    heading = {name: file_format.column(name) for name in _NAMES}
    if "status" not in file_format.columns and not table.has("status") and ALSO_STATUS in table.headings:
        heading["status"] = ALSO_STATUS
    for name in _NAMES:
        must = name in ("time", "beam", "radial_velocity") or name in file_format.required
        if heading[name] not in table.headings:
            if must:
                raise table.missing(name)
            del heading[name]
    if isinstance(scan, RangedScan) and "range" not in heading:
        raise no_range(file)
    by_range = match_ranges(_ranges(table), scan, file, file_format) if "range" in heading else None
    unused = () if by_range else like_ranges(table.headings, file_format, tuple(heading.values()))
    wanted, text = list(dict.fromkeys([*heading.values(), *unused])), [heading["time"], heading["beam"]]
    known: dict[tuple[str, int], tuple[float, float]] = {}
    for frame, before in table.pieces(wanted, text=text, n_row=n_row):
        column = {name: table.column(frame, name, heading[name], before) for name in heading}
        samples = _samples(table, scan, column, by_range)
        for other in unused:
            values = pd.to_numeric(frame[other], errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
            check_one_place(known, other, samples.beam, values[samples.row - column["time"].first_row], file)
        yield replace(samples, like_ranges=unused)


def _samples(table: Table, scan: Scan, column: Mapping[str, Column], by_range: BeamRanges | None) -> Samples:
    file_format = table.file_format
    time, invalid = times(column["time"], file_format)
    beam, no_beam, invalid_beam = beams(column["beam"], scan, file_format)
    invalid = invalid | invalid_beam
    value = {}
    for name in ("radial_velocity", "cnr", "status", "range"):
        if name in column:
            value[name], invalid_value = numbers(column[name], file_format)
            invalid = invalid | invalid_value
    no_time = np.isnat(time)
    first_row = column["time"].first_row
    left_out = table.bad.mask(first_row, len(time))
    of_bad = table.bad.counts(first_row, len(time))
    keep = ~(no_time | no_beam | left_out)
    counts: dict[str, int] = {}
    facts: dict[str, Any] = dict(table.bad.facts())
    if by_range is not None:
        beam, fits = by_range.beams(beam, value["range"])
        no_range = keep & np.isnan(value["range"])
        counts = {
            "rows_without_range": int(no_range.sum()),
            "rows_of_other_ranges": int((keep & ~no_range & ~fits).sum()),
        }
        facts |= by_range.facts()
        keep &= fits
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
            "rows_dropped": int((~keep).sum()) - sum(counts.values()) - int(left_out.sum()),
            "rows_without_time": int((no_time & ~left_out).sum()),
            "rows_without_beam": int((no_beam & ~left_out).sum()),
            **counts,
            **of_bad,
        },
        facts=facts,
    )


READER = Reader(
    name="long",
    title="CSV or Parquet table, a row per sample",
    source="this package; docs/formats.md",
    suffixes=TABLE_SUFFIXES,
    recognises=lambda file, _, file_format: looks_long(open_table(file, file_format)),
    read=read_long,
    pieces=long_pieces,
    ranges=ranges_of_table,
    uses=(*OF_TABLES, "beam_numbers", "range_tolerance"),
)
