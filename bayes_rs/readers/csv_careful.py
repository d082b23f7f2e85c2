"""Text tables line by line: what is wrong with which line is known; slow, so only for files that are not plain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa

from bayes_rs.readers.bad_rows import BadRows
from bayes_rs.readers.csv_lines import MISSING, NO_CHARACTER, Lines

_AT_ONCE = 100_000
_WORDS = frozenset(("True", "TRUE", "true", "False", "FALSE", "false"))


def careful_pieces(
    file: Path,
    lines: Lines,
    headings: Sequence[str],
    wanted: Sequence[str],
    bad: BadRows,
    *,
    text: Sequence[str],
    n_row: int | None,
    done: int = 0,
) -> Iterator[pa.Table]:
    """Read columns of a text table line by line.

    Parameters
    ----------
    file : Path
        The file.
    lines : Lines
        How it is written.
    headings, wanted, text : sequence of str
        All columns, those to read, and those of them that are to stay text.
    bad : BadRows
        Where lines are refused or left out that are no rows: of another number of entries, with NUL bytes, with bytes
        that are not valid in the encoding in a column that is used, or that repeat the headings.
    n_row : int, optional
        Rows at a time; all if not given.
    done : int
        Rows that were read before and are passed over.

    Yields
    ------
    piece : pyarrow.Table
        The columns, as text or, where all their entries are numbers, as float64. Lines that are left out, comments and
        empty ones are rows without an entry, so that a row's place tells its line.
    """
    width = len(headings)
    places = [headings.index(heading) for heading in wanted]
    columns: list[list[str | None]] = [[] for _ in wanted]
    parts: list[list[pa.Array]] = [[] for _ in wanted]
    n_held = 0
    with lines.opened(file) as of_file:
        head = next(islice(of_file, lines.skip, None), "").strip()
        number = lines.skip + 1 + done
        for line in islice(of_file, done, None):
            number += 1
            row, reason = _entries(line, lines, head, places, width)
            if reason and not line.endswith("\n"):
                bad.cut = number
            elif reason:
                bad.refuse(np.array([number]), f"File {str(file)!r} is not a table: line {number} {reason}")
            for column, cell in zip(columns, row, strict=True):
                column.append(None if cell in MISSING else cell)
            if len(columns[0]) == _AT_ONCE or n_held + len(columns[0]) == n_row:
                n_held += len(columns[0])
                _close(columns, parts)
            if n_held == n_row:
                yield _table(parts, wanted, lines, text)
                n_held = 0
    _close(columns, parts)
    if any(len(part) for part in parts[0]):
        yield _table(parts, wanted, lines, text)


def _entries(line: str, lines: Lines, head: str, places: Sequence[int], width: int) -> tuple[Sequence[str | None], str]:
    """Return the entries in use of a line, none for one that is no row, and why it is bad, if it is."""
    content = line.strip()
    nothing = [None] * len(places)
    if not content or (lines.comment and content.startswith(lines.comment)):
        return nothing, ""
    cells = lines.cells(line.rstrip("\r\n"))
    while len(cells) > width and not cells[-1]:
        cells.pop()
    if len(cells) != width:
        entries = "1 entry" if len(cells) == 1 else f"{len(cells)} entries"
        return nothing, f"has {entries}, and the headings {width}; check the options separator and decimal"
    if content.lstrip("\ufeff") == head:
        return nothing, "is the headings again; put the files together without them"
    row = [cells[place] for place in places]
    if "\0" in line:
        return nothing, "holds NUL bytes; check that the file is not damaged"
    if NO_CHARACTER in line and any(NO_CHARACTER in cell for cell in row):
        return nothing, (
            f"holds bytes that are not valid in the encoding {lines.encoding}; give another encoding (--encoding), "
            "such as cp1252"
        )
    return row, ""


def _close(columns: list[list[str | None]], parts: list[list[pa.Array]]) -> None:
    """Move the entries so far into arrays, which take less memory."""
    for column, part in zip(columns, parts, strict=True):
        part.append(pa.array(column, pa.string()))
        column.clear()


def _table(parts: list[list[pa.Array]], wanted: Sequence[str], lines: Lines, text: Sequence[str]) -> pa.Table:
    found = []
    for heading, part in zip(wanted, parts, strict=True):
        column = pa.chunked_array(part, pa.string())
        found.append(column if heading in text else _typed(column, lines.decimal))
        part.clear()
    return pa.Table.from_arrays(found, names=list(wanted))


def _typed(column: pa.ChunkedArray, decimal: str) -> pa.ChunkedArray:
    """Return a column as numbers or as true and false, if all its entries are such."""
    plain = column
    if decimal == ",":
        if pa.compute.any(pa.compute.match_substring(column, ".")).as_py():
            return column
        plain = pa.compute.replace_substring(column, ",", ".")
    try:
        return plain.cast(pa.float64())
    except pa.ArrowInvalid:
        if column.null_count == 0 and set(pa.compute.unique(column).to_pylist()) <= _WORDS:
            return column.cast(pa.bool_())
        return column
