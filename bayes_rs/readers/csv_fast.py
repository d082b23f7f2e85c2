"""Plain text tables by a columnar parser: typed columns, no Python object for an entry."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from bayes_rs.readers.csv_lines import MISSING, SPACES, Lines

_SPACE, _QUOTE, _LINE_END, _RETURN = 32, 34, 10, 13


class NotPlainError(Exception):
    """A table is not as plain as this parser needs it; the rows that were given out before are good.

    Parameters
    ----------
    done : int
        How many these are.
    """

    def __init__(self, done: int) -> None:
        super().__init__(f"not plain after {done} rows")
        self.done = done


def fast_pieces(
    file: Path,
    lines: Lines,
    headings: Sequence[str],
    wanted: Sequence[str],
    *,
    text: Sequence[str],
    n_row: int | None,
    offset: int | None = None,
) -> Iterator[pa.Table]:
    """Read columns of a plain text table.

    Parameters
    ----------
    file, lines, headings, wanted, text, n_row
        As for `careful_pieces`.
    offset : int, optional
        The byte at which to begin; by default below the headings.

    Yields
    ------
    piece : pyarrow.Table
        As `careful_pieces` gives it.

    Raises
    ------
    NotPlainError
        If a line has another number of entries than the headings or none, an entry of a column of numbers is no plain
        number, one of a column of text has quotes within spaces or is not valid in UTF-8, or one goes over several
        lines.
    """
    if lines.comment or not lines.is_ascii_like or lines.separator == " ":
        raise NotPlainError(0)
    names = [str(index) for index in range(len(headings))]
    place = {heading: names[headings.index(heading)] for heading in wanted}
    types = {place[heading]: pa.string() if heading in text else pa.float64() for heading in wanted}
    done = 0
    held: list[pa.RecordBatch] = []
    n_held = 0
    options: dict[str, Any] = {
        "read_options": pyarrow.csv.ReadOptions(column_names=names, skip_rows=0 if offset else lines.skip + 1),
        "parse_options": pyarrow.csv.ParseOptions(delimiter=lines.separator, ignore_empty_lines=False),
        "convert_options": pyarrow.csv.ConvertOptions(
            column_types=types,
            include_columns=list(types),
            null_values=sorted(MISSING),
            strings_can_be_null=True,
            decimal_point=lines.decimal,
        ),
    }
    try:
        with file.open("rb") as of_file:
            of_file.seek(offset or 0)
            watched = _Watched(of_file)
            for batch in pyarrow.csv.open_csv(watched, **options):
                if watched.is_odd:
                    raise NotPlainError(done)
                held.append(_trimmed(batch, [place[heading] for heading in wanted if heading in text], done))
                n_held += batch.num_rows
                while n_row is not None and n_held >= n_row:
                    whole = pa.Table.from_batches(held).rename_columns(list(wanted))
                    yield whole.slice(0, n_row)
                    done += n_row
                    n_held -= n_row
                    held = whole.slice(n_row).rename_columns(list(types)).to_batches()
    except pa.ArrowInvalid as error:
        raise NotPlainError(done) from error
    if watched.is_odd:
        raise NotPlainError(done)
    if n_held:
        yield pa.Table.from_batches(held).rename_columns(list(wanted))


class _Watched(io.RawIOBase):
    """A file that the parser reads, and that looks for quotes that are open at the end of a line.

    Of one that is never closed the parser makes an entry of all that follows, and says nothing.
    """

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file = file
        self._open = 0
        self.is_odd = False

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        block = self._file.read(size)
        if not self.is_odd and (self._open or b'"' in block):
            signs = np.frombuffer(block, dtype=np.uint8)
            count = self._open + np.cumsum(signs == _QUOTE)
            self.is_odd = bool((count[(signs == _LINE_END) | (signs == _RETURN)] % 2).any())
            self._open = int(count[-1]) % 2 if len(count) else self._open
        return block


def _trimmed(batch: pa.RecordBatch, text: Sequence[str], done: int) -> pa.RecordBatch:
    """Return columns of text without spaces around the entries; quotes behind these are not plain."""
    for name in text:
        column = batch.column(name)
        if _is_bare(column):
            continue
        column = pc.utf8_trim(column, characters=SPACES)
        missing = pc.is_in(column, value_set=pa.array(sorted(MISSING)))
        column = pc.if_else(missing, pa.scalar(None, pa.string()), column)
        if not _is_bare(column):
            raise NotPlainError(done)
        batch = batch.set_column(batch.schema.get_field_index(name), name, column)
    return batch


def _is_bare(column: pa.Array) -> bool:
    """Say whether no entry has spaces or quotes around it."""
    offsets = np.frombuffer(column.buffers()[1], dtype=np.int32)[column.offset : column.offset + len(column) + 1]
    data = column.buffers()[2]
    if data is None or offsets[-1] == offsets[0]:
        return True
    of_entry = np.frombuffer(data, dtype=np.uint8)
    begins, ends = offsets[:-1], offsets[1:]
    there = ends > begins
    if not there.all():
        begins, ends = begins[there], ends[there]
    first, last = of_entry[begins], of_entry[ends - 1]
    return not bool(
        (first <= _SPACE).any() or (last <= _SPACE).any() or (first == _QUOTE).any() or (last == _QUOTE).any()
    )
