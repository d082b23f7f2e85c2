"""Plain text tables by a columnar parser: typed columns, no Python object for an entry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from bayes_rs.readers.csv_lines import MISSING, Lines

_SPACE, _QUOTE = 32, 34


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
    file: Path, lines: Lines, headings: Sequence[str], wanted: Sequence[str], *, text: Sequence[str], n_row: int | None
) -> Iterator[pa.Table]:
    """Read columns of a plain text table.

    Parameters
    ----------
    file, lines, headings, wanted, text, n_row
        As for `careful_pieces`.

    Yields
    ------
    piece : pyarrow.Table
        As `careful_pieces` gives it.

    Raises
    ------
    NotPlainError
        If a line has another number of entries than the headings or none, an entry of a column of numbers is no plain
        number, or one of a column of text has spaces or quotes around it, or is not valid in UTF-8.
    """
    if lines.comment or not lines.is_ascii_like or lines.separator == " ":
        raise NotPlainError(0)
    names = [str(index) for index in range(len(headings))]
    place = {heading: names[headings.index(heading)] for heading in wanted}
    types = {place[heading]: pa.string() if heading in text else pa.float64() for heading in wanted}
    done = 0
    held: list[pa.RecordBatch] = []
    n_held = 0
    try:
        with pyarrow.csv.open_csv(
            file,
            read_options=pyarrow.csv.ReadOptions(column_names=names, skip_rows=lines.skip + 1),
            parse_options=pyarrow.csv.ParseOptions(delimiter=lines.separator, ignore_empty_lines=False),
            convert_options=pyarrow.csv.ConvertOptions(
                column_types=types,
                include_columns=list(types),
                null_values=sorted(MISSING),
                strings_can_be_null=True,
                decimal_point=lines.decimal,
            ),
        ) as batches:
            for batch in batches:
                if not all(_is_bare(batch.column(place[heading])) for heading in wanted if heading in text):
                    raise NotPlainError(done)
                held.append(batch)
                n_held += batch.num_rows
                while n_row is not None and n_held >= n_row:
                    whole = pa.Table.from_batches(held).rename_columns(list(wanted))
                    yield whole.slice(0, n_row)
                    done += n_row
                    n_held -= n_row
                    held = whole.slice(n_row).rename_columns(list(types)).to_batches()
    except pa.ArrowInvalid as error:
        raise NotPlainError(done) from error
    if n_held:
        yield pa.Table.from_batches(held).rename_columns(list(wanted))


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
