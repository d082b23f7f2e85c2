"""CSV and Parquet files as raw tables that remember where each row stands in the file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bayes_rs.errors import InputError
from bayes_rs.readers.bad_rows import BadRows
from bayes_rs.readers.compressed import UNREADABLE, own_suffix, unreadable
from bayes_rs.readers.csv_careful import careful_pieces
from bayes_rs.readers.csv_fast import NotPlainError, fast_pieces
from bayes_rs.readers.csv_lines import NO_CHARACTER, Lines, last_row_is_cut, lines_of, offset_behind
from bayes_rs.readers.format import FileFormat

CSV_SUFFIXES = (".csv", ".txt", ".tsv")
PARQUET_SUFFIXES = (".parquet", ".pq")
TABLE_SUFFIXES = (*CSV_SUFFIXES, *PARQUET_SUFFIXES)

CAREFUL_ROWS = 50_000
"""Rows that are read carefully, at least, before the fast way is tried again."""
_LONGEST_HEADING = 1000  # characters; a file without a line end is no table
_INDEX = re.compile(r"__index_level_\d+__")  # what pandas calls an index without a name


@dataclass(frozen=True)
class Column:
    """One column of a file, and how to say where an entry of it stands."""

    name: str
    heading: str
    values: pd.Series[Any]
    file: Path
    row_word: str
    first_row: int
    bad: BadRows | None = None
    """Where rows with a bad entry are left out; without it they are refused."""

    def refuse(self, is_bad: NDArray[np.bool_], message: str) -> None:
        """Refuse or leave out the rows of bad entries; the message is about the first, without its end.

        Raises
        ------
        InputError
            If such rows are not to be left out.
        """
        if self.bad is None:
            raise InputError(f"{message}.")
        self.bad.refuse(self.first_row + np.flatnonzero(is_bad), message)

    def where(self, index: int) -> str:
        """Say where entry `index` stands."""
        heading = f"column {self.heading!r}, " if self.row_word != "sample" else f"variable {self.heading!r}, "
        return f"{heading}{self.row_word} {index + self.first_row} of file {str(self.file)!r}"


@dataclass(frozen=True)
class Table:
    """A table file of which so far only the headings were read."""

    file: Path
    headings: tuple[str, ...]
    file_format: FileFormat
    bad: BadRows
    """What is left out of what `pieces` gives."""
    lines: Lines | None = None
    """How it is written, if it is text."""

    @property
    def is_csv(self) -> bool:
        """Whether this is a text file."""
        return self.lines is not None

    def has(self, name: str) -> bool:
        """Say whether the file has what the options call `name`."""
        return self.file_format.column(name) in self.headings

    def pieces(
        self, headings: Sequence[str], *, text: Sequence[str] = (), n_row: int | None = None
    ) -> Iterator[tuple[pd.DataFrame, int]]:
        """Read the columns under `headings`, those in `text` without guessing that they are numbers.

        Gives `n_row` rows at a time, or all at once, each with the number of rows before it. Rows that are left out
        have no entry.
        """
        for heading in headings:
            if self.headings.count(heading) > 1:
                raise InputError(
                    f"File {str(self.file)!r} has {self.headings.count(heading)} columns {heading!r}: "
                    "names must be unique; rename all but one."
                )
        self.bad.reset()
        before = 0
        wanted = list(dict.fromkeys(headings))
        parts = (
            self._parquet_tables(wanted, n_row)
            if self.lines is None
            else self._csv_tables(self.lines, wanted, text, n_row)
        )
        for part in parts:
            if len(part):
                try:
                    frame = _frame(part)
                except pa.ArrowException as error:  # what Arrow holds and pandas does not
                    raise unreadable(self.file, error) from error
                yield frame, before
            before += len(part)
        if before == 0:
            raise InputError(f"File {str(self.file)!r} has headings but no row: give a file with samples.")
        self.bad.check(before)

    def column(self, frame: pd.DataFrame, name: str, heading: str, before: int = 0) -> Column:
        """Take one column out of what `pieces` gave."""
        return Column(name, heading, frame[heading], self.file, self.bad.row_word, self.first_row + before, self.bad)

    @property
    def first_row(self) -> int:
        """What a person counts the first row as."""
        return self.lines.skip + 2 if self.lines else 1

    def missing(self, name: str) -> InputError:
        """Return the error to raise where the column for `name` is not there."""
        heading = self.file_format.column(name)
        return InputError(
            f"File {str(self.file)!r} has no column {heading!r} for {name}: {self.found()}; "
            f"say what the file calls it with columns={{{name!r}: 'its heading'}} (--column {name}=HEADING)."
        )

    def found(self) -> str:
        """List the columns that are there, with a hint where the separator looks wrong."""
        listed = f"its columns are {', '.join(repr(heading[:60]) for heading in self.headings)}"
        if self.lines and any(NO_CHARACTER in heading for heading in self.headings):
            listed += f" (some not valid in the encoding {self.lines.encoding}: give encoding, --encoding, as cp1252)"
        for separator, word in ((";", "';'"), ("\t", "'tab'"), (",", "','")):
            if self.is_csv and len(self.headings) == 1 and separator in self.headings[0]:
                return f"{listed} (is it separated by {word}? then give separator={word}, --separator)"
        return listed

    def _csv_tables(
        self, lines: Lines, headings: list[str], text: Sequence[str], n_row: int | None
    ) -> Iterator[pa.Table]:
        try:
            cut = last_row_is_cut(self.file, lines, last_is_used=self.headings[-1] in headings)
            parts = self._fast_or_careful(lines, headings, text, n_row)
            if not cut:
                yield from parts
                return
            before, last = 0, next(parts, None)
            for part in parts:
                if last is not None:
                    yield last
                    before += len(last)
                last = part
            if last is not None and len(last):
                self.bad.cut = self.first_row + before + len(last) - 1
                nothing = pa.table({name: pa.nulls(1, last.schema.field(name).type) for name in headings})
                yield pa.concat_tables([last.slice(0, len(last) - 1), nothing])
        except InputError:
            raise
        except UNREADABLE as error:
            raise unreadable(self.file, error) from error

    def _fast_or_careful(
        self, lines: Lines, headings: list[str], text: Sequence[str], n_row: int | None
    ) -> Iterator[pa.Table]:
        """Read fast what is plain, carefully what is not, and then try the fast way again, if the place is known."""
        offset: int | None = None
        done, head = 0, lines.skip + 1
        while True:
            try:
                yield from fast_pieces(self.file, lines, self.headings, headings, text=text, n_row=n_row, offset=offset)
            except NotPlainError as error:
                done += error.done
                behind = None
                if n_row:
                    behind = offset_behind(self.file, lines, 0, head, quotes=True) if offset is None else offset
                if behind is not None:
                    behind = offset_behind(self.file, lines, behind, error.done)
            else:
                return
            stretch = -(-CAREFUL_ROWS // n_row) * n_row if n_row and behind is not None else None
            n_read = 0
            for part in careful_pieces(
                self.file, lines, self.headings, headings, self.bad, text=text, n_row=n_row, done=done, offset=behind
            ):
                yield part
                n_read += len(part)
                if n_read == stretch:
                    offset = offset_behind(self.file, lines, behind or 0, n_read)
                    if offset is not None:
                        break
            else:
                return
            done += n_read

    def _parquet_tables(self, headings: list[str], n_row: int | None) -> Iterator[pa.Table]:
        names = {heading.strip(): heading for heading in _parquet_names(self.file)}
        wanted = [names[heading] for heading in headings]
        try:
            with pq.ParquetFile(self.file) as parquet:
                for name in wanted:
                    self._check_plain(parquet.schema_arrow.field(name))
                if n_row is None:
                    yield parquet.read(columns=wanted).select(wanted).rename_columns(headings)
                else:
                    for batch in parquet.iter_batches(n_row, columns=wanted):
                        yield pa.Table.from_batches([batch]).select(wanted).rename_columns(headings)
        except InputError:
            raise
        except (*UNREADABLE, pa.ArrowException) as error:
            raise unreadable(self.file, error) from error

    def _check_plain(self, column: pa.Field[Any]) -> None:
        """Refuse a column whose entries are no single numbers, texts or times."""
        kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
        if pa.types.is_time(kind):
            raise InputError(
                f"Column {column.name!r} of file {str(self.file)!r} holds {column.type}, times of day without a date: "
                "write whole dates and times."
            )
        if pa.types.is_nested(kind) or pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
            raise InputError(
                f"Column {column.name!r} of file {str(self.file)!r} holds {column.type}, and must hold one number, "
                "text or time in each row: write it so."
            )


def open_table(file: Path, file_format: FileFormat, *, skip: int = 0) -> Table:
    """Read the headings of a CSV or Parquet file, which stand below `skip` lines and those that the options skip.

    Raises
    ------
    InputError
        If the file is empty, or is not what its suffix says.
    """
    drop = file_format.bad_rows == "drop"
    if own_suffix(file) in PARQUET_SUFFIXES:
        headings = tuple(name.strip() for name in _parquet_names(file) if not _INDEX.fullmatch(name))
        return Table(file, headings, file_format, BadRows(file, "row", drop))
    try:
        lines, found = _headings(file, lines_of(file, file_format, skip + file_format.skip_rows))
    except UNREADABLE as error:
        raise unreadable(file, error) from error
    if found is None:
        above = f" below the {lines.skip} lines that are skipped" if lines.skip else ""
        raise InputError(f"File {str(file)!r} is empty{above}: give a file with headings and samples.")
    return Table(file, found, file_format, BadRows(file, "line", drop), lines)


def _headings(file: Path, lines: Lines) -> tuple[Lines, tuple[str, ...] | None]:
    """Return the headings of a text file, if it has any, and with how many lines above them, also comments."""
    with lines.opened(file) as of_file:
        for number, line in enumerate(of_file):
            if number >= lines.skip and not (lines.comment and line.lstrip().startswith(lines.comment)):
                found = lines.cells(line.rstrip("\r\n"))
                return replace(lines, skip=number), tuple(heading[:_LONGEST_HEADING] for heading in found)
    return lines, None


def _frame(part: pa.Table) -> pd.DataFrame:
    """Return columns as pandas has them: text as strings of Arrow's, numbers as float64 or as they are."""
    columns: dict[str, Any] = {}
    for name, column in zip(part.column_names, part.columns, strict=True):
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            columns[name] = pd.array(column.cast(pa.string()), dtype=pd.StringDtype("pyarrow"))
        else:
            columns[name] = column.to_pandas()
    return pd.DataFrame(columns, copy=False)


def _parquet_names(file: Path) -> list[str]:
    try:
        return [str(name) for name in pq.read_schema(file).names]
    except (*UNREADABLE, pa.ArrowException) as error:
        raise unreadable(file, error) from error
