"""CSV and Parquet files as raw tables that remember where each row stands in the file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import UNREADABLE, plain_suffix, unreadable
from bayes_rs.readers.format import FileFormat

CSV_SUFFIXES = (".csv", ".txt", ".tsv")
PARQUET_SUFFIXES = (".parquet", ".pq")
TABLE_SUFFIXES = (*CSV_SUFFIXES, *PARQUET_SUFFIXES)

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
    skip: int = 0
    """Lines above the headings."""

    @property
    def is_csv(self) -> bool:
        """Whether this is a text file."""
        return plain_suffix(self.file) not in PARQUET_SUFFIXES

    def has(self, name: str) -> bool:
        """Say whether the file has what the options call `name`."""
        return self.file_format.column(name) in self.headings

    def pieces(
        self, headings: Sequence[str], *, text: Sequence[str] = (), n_row: int | None = None
    ) -> Iterator[tuple[pd.DataFrame, int]]:
        """Read the columns under `headings`, those in `text` without guessing that they are numbers.

        Gives `n_row` rows at a time, or all at once, each with the number of rows before it.
        """
        for heading in headings:
            if self.headings.count(heading) > 1:
                raise InputError(
                    f"File {str(self.file)!r} has {self.headings.count(heading)} columns {heading!r}: "
                    "names must be unique; rename all but one."
                )
        before = 0
        for frame in self._csv_frames(text, n_row) if self.is_csv else self._parquet_frames(headings, n_row):
            if len(frame):
                yield pd.DataFrame(frame[list(headings)]).reset_index(drop=True), before
            before += len(frame)
        if before == 0:
            raise InputError(f"File {str(self.file)!r} has headings but no row: give a file with samples.")

    def column(self, frame: pd.DataFrame, name: str, heading: str, before: int = 0) -> Column:
        """Take one column out of what `pieces` gave."""
        row_word, first_row = ("line", 2 + self.skip) if self.is_csv else ("row", 1)
        return Column(name, heading, frame[heading], self.file, row_word, first_row + before)

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
        for separator, word in ((";", "';'"), ("\t", "'tab'"), (",", "','")):
            if self.is_csv and len(self.headings) == 1 and separator in self.headings[0]:
                return f"{listed} (is it separated by {word}? then give separator={word}, --separator)"
        return listed

    def _csv_frames(self, text: Sequence[str], n_row: int | None) -> Iterator[pd.DataFrame]:
        width = len(self.headings)
        as_text: dict[Any, Any] = {index: "str" for index in range(width) if self.headings[index] in text}
        try:
            opened = pd.read_csv(
                self.file,
                header=None,
                names=list(range(width)),
                skiprows=1 + self.skip,
                dtype=as_text,
                low_memory=False,
                chunksize=n_row,
                **_csv_options(self.file_format),
            )
            with nullcontext([opened]) if isinstance(opened, pd.DataFrame) else opened as frames:
                for frame in frames:
                    yield self._with_headings(frame)
        except pd.errors.EmptyDataError:
            return
        except pd.errors.ParserError as error:
            raise InputError(
                f"File {str(self.file)!r} is not a table: {_one_line(error)}; every line must have as many "
                f"entries as the headings ({width}); check the options separator and decimal."
            ) from error
        except InputError:
            raise
        except UNREADABLE as error:
            raise unreadable(self.file, error) from error

    def _with_headings(self, frame: pd.DataFrame) -> pd.DataFrame:
        if not isinstance(frame.index, pd.RangeIndex):
            raise InputError(
                f"File {str(self.file)!r} is not a table: line {2 + self.skip} has more entries than the headings "
                f"({len(self.headings)}); check the options separator and decimal."
            )
        frame.columns = pd.Index(self.headings)
        return frame

    def _parquet_frames(self, headings: Sequence[str], n_row: int | None) -> Iterator[pd.DataFrame]:
        names = {heading.strip(): heading for heading in _parquet_names(self.file)}
        wanted = list(dict.fromkeys(names[heading] for heading in headings))
        try:
            with pq.ParquetFile(self.file) as parquet:
                for name in wanted:
                    self._check_plain(parquet.schema_arrow.field(name))
                if n_row is None:
                    parts: Iterable[pa.Table] = [parquet.read(columns=wanted)]
                else:
                    parts = (pa.Table.from_batches([batch]) for batch in parquet.iter_batches(n_row, columns=wanted))
                for part in parts:
                    frame = part.to_pandas(ignore_metadata=True)
                    yield frame.rename(columns=lambda heading: str(heading).strip())
        except InputError:
            raise
        except (*UNREADABLE, pa.ArrowException) as error:
            raise unreadable(self.file, error) from error

    def _check_plain(self, column: pa.Field[Any]) -> None:
        """Refuse a column whose entries are no single numbers, texts or times."""
        kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
        if pa.types.is_nested(kind) or pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
            raise InputError(
                f"Column {column.name!r} of file {str(self.file)!r} holds {column.type}, and must hold one number, "
                "text or time in each row: write it so."
            )


def open_table(file: Path, file_format: FileFormat, *, skip: int = 0) -> Table:
    """Read the headings of a CSV or Parquet file, which stand below `skip` lines.

    Raises
    ------
    InputError
        If the file is empty, or is not what its suffix says.
    """
    if plain_suffix(file) in PARQUET_SUFFIXES:
        headings = tuple(name.strip() for name in _parquet_names(file) if not _INDEX.fullmatch(name))
        return Table(file, headings, file_format)
    try:
        first = pd.read_csv(
            file,
            header=None,
            nrows=1,
            skiprows=skip,
            dtype=str,
            keep_default_na=False,
            **_csv_options(file_format),
        )
    except pd.errors.EmptyDataError as error:
        raise InputError(f"File {str(file)!r} is empty: give a file with headings and samples.") from error
    except pd.errors.ParserError as error:
        raise InputError(f"File {str(file)!r} is not a table: {_one_line(error)}.") from error
    except UNREADABLE as error:
        raise unreadable(file, error) from error
    return Table(file, tuple(str(heading).strip() for heading in first.iloc[0]), file_format, skip)


def _csv_options(file_format: FileFormat) -> dict[str, Any]:
    return {
        "sep": file_format.separator,
        "decimal": file_format.decimal,
        "encoding": "utf-8-sig",
        "encoding_errors": "replace",
        "skip_blank_lines": False,  # so that a row's number tells its line
        "skipinitialspace": True,
    }


def _parquet_names(file: Path) -> list[str]:
    try:
        return [str(name) for name in pq.read_schema(file).names]
    except (*UNREADABLE, pa.ArrowException) as error:
        raise unreadable(file, error) from error


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())
