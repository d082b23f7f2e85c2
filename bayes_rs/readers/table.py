"""CSV and Parquet files as raw tables that remember where each row stands in the file."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_rs.errors import InputError
from bayes_rs.readers.format import FileFormat

CSV_SUFFIXES = (".csv", ".txt", ".tsv")
PARQUET_SUFFIXES = (".parquet", ".pq")
COMPRESSIONS = (".gz", ".bz2", ".xz", ".zst", ".zip")


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

    @property
    def is_csv(self) -> bool:
        """Whether this is a text file."""
        return plain_suffix(self.file) not in PARQUET_SUFFIXES

    def has(self, name: str) -> bool:
        """Say whether the file has what the options call `name`."""
        return self.file_format.column(name) in self.headings

    def read(self, headings: Sequence[str], *, text: Sequence[str] = ()) -> pd.DataFrame:
        """Read the columns under `headings`, those in `text` without guessing that they are numbers."""
        for heading in headings:
            if self.headings.count(heading) > 1:
                raise InputError(
                    f"File {str(self.file)!r} has {self.headings.count(heading)} columns {heading!r}: "
                    "names must be unique; rename all but one."
                )
        frame = self._read_csv(text) if self.is_csv else _read_parquet(self.file)
        if len(frame) == 0:
            raise InputError(f"File {str(self.file)!r} has headings but no row: give a file with samples.")
        return pd.DataFrame(frame[list(headings)])

    def column(self, frame: pd.DataFrame, name: str, heading: str) -> Column:
        """Take one column out of what `read` returned."""
        row_word, first_row = ("line", 2) if self.is_csv else ("row", 1)
        return Column(name, heading, frame[heading], self.file, row_word, first_row)

    def missing(self, name: str) -> InputError:
        """Return the error to raise where the column for `name` is not there."""
        heading = self.file_format.column(name)
        return InputError(
            f"File {str(self.file)!r} has no column {heading!r} for {name}: {self.found()}; "
            f"say what the file calls it with columns={{{name!r}: 'its heading'}} (--column {name}=HEADING)."
        )

    def found(self) -> str:
        """List the columns that are there, with a hint where the separator looks wrong."""
        listed = f"its columns are {', '.join(repr(heading) for heading in self.headings)}"
        for separator, word in ((";", "';'"), ("\t", "'tab'"), (",", "','")):
            if self.is_csv and len(self.headings) == 1 and separator in self.headings[0]:
                return f"{listed} (is it separated by {word}? then give separator={word})"
        return listed

    def _read_csv(self, text: Sequence[str]) -> pd.DataFrame:
        width = len(self.headings)
        as_text: dict[Any, Any] = {index: "str" for index in range(width) if self.headings[index] in text}
        try:
            frame: pd.DataFrame = pd.read_csv(
                self.file,
                header=None,
                names=list(range(width)),
                skiprows=1,
                dtype=as_text,
                low_memory=False,
                **_csv_options(self.file_format),
            )
        except pd.errors.EmptyDataError:
            return pd.DataFrame({heading: [] for heading in self.headings})
        except pd.errors.ParserError as error:
            raise InputError(
                f"File {str(self.file)!r} is not a table: {str(error).strip()}; every line must have as many "
                f"entries as the headings ({width}); check the options separator and decimal."
            ) from error
        except (OSError, EOFError, zlib.error) as error:
            raise _unreadable(self.file, error) from error
        if not isinstance(frame.index, pd.RangeIndex):
            raise InputError(
                f"File {str(self.file)!r} is not a table: line 2 has more entries than the headings ({width}); "
                "check the options separator and decimal."
            )
        frame.columns = pd.Index(self.headings)
        return frame


def open_table(file: Path, file_format: FileFormat) -> Table:
    """Read the headings of a CSV or Parquet file.

    Raises
    ------
    InputError
        If the file is empty, or is not what its suffix says.
    """
    if plain_suffix(file) in PARQUET_SUFFIXES:
        return Table(file, tuple(str(heading) for heading in _read_parquet(file).columns), file_format)
    try:
        first = pd.read_csv(file, header=None, nrows=1, dtype=str, keep_default_na=False, **_csv_options(file_format))
    except pd.errors.EmptyDataError as error:
        raise InputError(f"File {str(file)!r} is empty: give a file with headings and samples.") from error
    except pd.errors.ParserError as error:
        raise InputError(f"File {str(file)!r} is not a table: {str(error).strip()}.") from error
    except (OSError, EOFError, zlib.error) as error:
        raise _unreadable(file, error) from error
    return Table(file, tuple(str(heading).strip() for heading in first.iloc[0]), file_format)


def plain_suffix(file: Path) -> str:
    """Return the suffix of a file in lower case, without that of its compression."""
    suffixes = [suffix.lower() for suffix in file.suffixes]
    if suffixes and suffixes[-1] in COMPRESSIONS:
        suffixes.pop()
    return suffixes[-1] if suffixes else ""


def _csv_options(file_format: FileFormat) -> dict[str, Any]:
    return {
        "sep": file_format.separator,
        "decimal": file_format.decimal,
        "encoding": "utf-8-sig",
        "encoding_errors": "replace",
        "skip_blank_lines": False,  # so that a row's number tells its line
        "skipinitialspace": True,
    }


def _read_parquet(file: Path) -> pd.DataFrame:
    try:
        frame = pd.read_parquet(file)
    except (OSError, ValueError) as error:
        raise _unreadable(file, error) from error
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    return frame.rename(columns=lambda heading: str(heading).strip())


def _unreadable(file: Path, error: BaseException) -> InputError:
    reason = str(error).strip().splitlines() or [type(error).__name__]
    return InputError(f"File {str(file)!r} cannot be read: {reason[0]}; check that it is complete and not damaged.")
