"""Lines of a text file whose layout is its own: where each stands, how many entries it has, and which are whole."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs.errors import InputError
from bayes_rs.readers.bad_rows import BadRows
from bayes_rs.readers.compressed import UNREADABLE, unreadable
from bayes_rs.readers.table import Column

IntArray = NDArray[np.int64]

_MOST_TAIL = 20
"""Lines that are not as the others, at the end of a file, that are dropped: a cut line, a footer."""
_LONGEST_LINE = 1 << 20  # bytes
_NEWLINE, _RETURN, _SPACE = 10, 13, 32


@dataclass(frozen=True)
class PlacedColumn(Column):
    """A column that says for each entry where it stands, because some lines of the file are not in it."""

    rows: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def refuse(self, is_bad: NDArray[np.bool_], message: str) -> None:
        """Refuse or leave out the rows of bad entries; the message is about the first, without its end.

        Raises
        ------
        InputError
            If such rows are not to be left out.
        """
        if self.bad is None:
            raise InputError(f"{message}.")
        self.bad.refuse(self.rows[is_bad], message)

    def where(self, index: int) -> str:
        """Say where entry `index` stands."""
        return f"column {self.heading!r}, {self.row_word} {self.rows[index]} of file {str(self.file)!r}"


@dataclass(frozen=True)
class TextLines:
    """The lines of a file, as bytes without NUL.

    Parameters
    ----------
    file : Path
        The file.
    raw : ndarray of uint8
        All bytes, without those that are zero.
    start, end : ndarray of int, shape (n_line,)
        Where each line begins and ends, without its newline.
    """

    file: Path
    raw: NDArray[np.uint8]
    start: IntArray
    end: IntArray

    def __len__(self) -> int:
        return len(self.start)

    def text(self, index: int) -> str:
        """Return a line as text; bytes stand for the characters of Latin-1, if they are no UTF-8."""
        line = self.raw[self.start[index] : self.end[index]].tobytes()
        try:
            return line.decode("utf-8").strip("\ufeff\r")
        except UnicodeDecodeError:
            return line.decode("latin-1").strip("\r")

    def body(self, index: IntArray) -> bytes:
        """Return the lines `index`, and blank ones between them, as they stand."""
        gaps = np.flatnonzero(np.diff(index) > 1)
        begins, ends = self.start[index[np.append(0, gaps + 1)]], self.end[index[np.append(gaps, len(index) - 1)]]
        parts = [self.raw[begin:end] for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)]
        return b"\n".join(part.tobytes() for part in parts)

    def n_field(self, separator: str) -> IntArray:
        """Return how many entries each line has; none if it is blank."""
        at = np.flatnonzero(self.raw == ord(separator))
        count = np.searchsorted(at, self.end) - np.searchsorted(at, self.start) + 1
        for index in np.flatnonzero(count == 1).tolist():  # as a rule none, or the last
            if not (self.raw[self.start[index] : self.end[index]] > _SPACE).any():
                count[index] = 0
        return count.astype(np.int64)


@dataclass(frozen=True)
class TextRows:
    """The whole lines below a header, as a frame of columns by number, and where each stands."""

    frame: pd.DataFrame
    rows: IntArray
    n_cut: int
    file: Path
    bad: BadRows | None

    def kept(self) -> NDArray[np.bool_]:
        """Say which rows have no bad entry, when all columns have been read.

        Raises
        ------
        InputError
            If more are left out than may be.
        """
        if self.bad is None or not self.bad.rows:
            return np.ones(len(self.rows), dtype=bool)
        self.bad.check(len(self.rows))
        return ~np.isin(self.rows, np.fromiter(self.bad.rows, dtype=np.int64, count=len(self.bad.rows)))

    def counts(self) -> dict[str, int]:
        """Count for the report the rows that are left out, where there are any."""
        found = {"rows_bad": len(self.bad.rows) if self.bad else 0, "rows_cut": self.n_cut}
        return {name: count for name, count in found.items() if count}

    def facts(self) -> dict[str, str]:
        """Name for the report the first bad row, if there is one."""
        return self.bad.facts() if self.bad else {}

    def column(self, name: str, index: int, heading: str | None = None) -> PlacedColumn:
        """Return one column; `heading` is what the file calls it, else its number from 1."""
        own = str(index + 1) if heading is None else heading
        return PlacedColumn(name, own, self.frame[index], self.file, "line", 1, self.bad, self.rows)


def read_lines(file: Path, *, without: Sequence[bytes] = (b"\0",)) -> TextLines:
    """Read a text file, without the characters in `without`.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        held = file.read_bytes()
        for character in without:
            held = held.replace(character, b"")
        raw = np.frombuffer(held, dtype=np.uint8)
    except UNREADABLE as error:
        raise unreadable(file, error) from error
    end = np.flatnonzero(raw == _NEWLINE)
    if len(raw) and (len(end) == 0 or end[-1] != len(raw) - 1):
        end = np.append(end, len(raw))
    start = np.concatenate([[0], end[:-1] + 1]) if len(end) else end
    with_return = (end > start) & (raw[np.maximum(end - 1, 0)] == _RETURN) if len(raw) else np.zeros(0, dtype=bool)
    return TextLines(file, raw, start.astype(np.int64), (end - with_return).astype(np.int64))


def first_line(file: Path) -> str:
    """Return the first line of a file as text, for a look at what it is; empty if it cannot be read."""
    try:
        with file.open("rb") as opened:
            return opened.readline(_LONGEST_LINE).replace(b"\0", b"").decode("latin-1").strip("\r\n")
    except UNREADABLE:
        return ""


def whole_rows(
    lines: TextLines,
    *,
    first: int,
    separator: str,
    n_field: Sequence[int],
    columns: Sequence[int],
    text: Sequence[int],
    bad_rows: str | None = None,
) -> TextRows:
    """Read the lines from `first` on, all of which must have as many entries as the format says.

    Parameters
    ----------
    lines : TextLines
        The file.
    first : int
        Index of the first line below the header.
    separator : str
        One character.
    n_field : sequence of int
        Numbers of entries that a whole line may have.
    columns, text : sequence of int
        The columns to read, from 0, and those of them that are kept as text. If the last entry of a line is among
        them, a last line without a newline may be cut within it, and is dropped.
    bad_rows : str, optional
        The option of that name: whether a line of another length, or with a bad entry, is left out. None if the caller
        has no such option.

    Raises
    ------
    InputError
        If no line is whole, or one is not that has whole lines below it. A few at the end are dropped, and counted.
    """
    count = lines.n_field(separator)[first:]
    inked = np.flatnonzero(count > 0)
    good = np.isin(count[inked], n_field)
    wanted = " or ".join(str(number) for number in n_field)
    n_row = int(np.flatnonzero(good)[-1]) + 1 if good.any() else 0
    if n_row == len(good) > 1 and max(columns) + 1 >= count[inked[-1]] and lines.raw[-1] != _NEWLINE:
        n_row -= 1
    if not good[:n_row].any():
        raise InputError(
            f"File {str(lines.file)!r} has no row of {wanted} entries, as its format needs, below line {first}: it is "
            "cut off, or of another format."
        )
    bad = None if bad_rows is None else BadRows(lines.file, "line", bad_rows == "drop")
    long_tail = len(good) - n_row > _MOST_TAIL
    wrong = np.flatnonzero(~good if long_tail else ~good[:n_row])
    if len(wrong):
        index = int(inked[wrong[0]])
        message = (
            f"Line {first + index + 1} of file {str(lines.file)!r} has {count[index]} entries, and must have {wanted}: "
            "correct the line"
        )
        if bad is None:
            raise InputError(f"{message}, or take it out.")
        bad.refuse(first + inked[wrong] + 1, message)
    kept = inked[:n_row][good[:n_row]] + first
    body = lines.body(kept)
    as_text: dict[Any, Any] = dict.fromkeys(text, "str")
    try:
        frame = pd.read_csv(
            io.BytesIO(body),
            sep=separator,
            header=None,
            names=list(range(int(count[kept - first].max()))),
            index_col=False,
            usecols=list(columns),
            dtype=as_text,
            encoding="latin-1",
            quoting=3,
            skipinitialspace=True,
            low_memory=False,
        )
    except (*UNREADABLE, pd.errors.ParserError) as error:
        raise unreadable(lines.file, error, as_what=" as a table") from error
    if len(frame) != len(kept):
        raise InputError(f"File {str(lines.file)!r} has lines that are no rows of a table: check that it is text.")
    return TextRows(frame, kept + 1, 0 if long_tail else len(good) - n_row, lines.file, bad)
