"""Text files as lines: how they are encoded, where the rows begin, and whether the last one is whole."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bayes_rs.readers.format import FileFormat

NO_CHARACTER = "\ufffd"
"""What stands for bytes that are not valid in the encoding."""
MISSING = frozenset(
    [
        "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN",
        "<NA>", "N/A", "NA", "NULL", "NaN", "None", "n/a", "nan", "null", "",
    ]
)  # fmt: skip
"""What stands for a missing entry in text files, whatever the options say."""

_TAIL = 1 << 16
_LEAST_ROWS = 3


@dataclass(frozen=True)
class Lines:
    """How a text file is written.

    Parameters
    ----------
    encoding : str
        As Python calls it.
    separator, decimal : str
        One character each.
    comment : str or None
        What a line begins with that is no row.
    skip : int
        Lines above the headings.
    """

    encoding: str
    separator: str
    decimal: str
    comment: str | None
    skip: int

    @property
    def is_ascii_like(self) -> bool:
        """Whether ASCII characters are one byte each, as they are in ASCII."""
        return not codecs.lookup(self.encoding).name.startswith(("utf-16", "utf-32"))

    @contextmanager
    def opened(self, file: Path) -> Iterator[Iterator[str]]:
        """Give the lines of a file; bytes that are not valid in the encoding become `NO_CHARACTER`."""
        with file.open(encoding=self.encoding, errors="replace", newline=None) as text:
            yield iter(text)

    def cells(self, line: str) -> list[str]:
        """Return the entries of a line, without spaces around them."""
        if '"' in line:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))]
        parts = line.split() if self.separator == " " else line.split(self.separator)
        return [part.strip() for part in parts]


def lines_of(file: Path, file_format: FileFormat, skip: int) -> Lines:
    """Return how a text file is written; a byte-order mark counts before the option ``encoding``."""
    with file.open("rb") as binary:
        mark = binary.read(4)
    encoding = file_format.encoding or "utf-8-sig"
    if mark.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif mark.startswith(codecs.BOM_UTF8):
        encoding = "utf-8-sig"
    return Lines(encoding, file_format.separator, file_format.decimal, file_format.comment, skip)


def last_row_is_cut(file: Path, lines: Lines, *, last_is_used: bool) -> bool:
    """Say whether the end of a file may have cut its last entry.

    Parameters
    ----------
    file : Path
        The file.
    lines : Lines
        How it is written.
    last_is_used : bool
        Whether the last column is read at all.

    Returns
    -------
    cut : bool
        The last line has no end, and its last entry is used. It is taken for whole if the entry of the lines above all
        have as many decimals, or without decimals as many characters, as the last one.
    """
    with file.open("rb") as binary:
        mark = binary.read(2)
        size = binary.seek(0, 2)
        binary.seek(max(0, size - _TAIL) // 4 * 4)
        tail = binary.read()
    encoding = lines.encoding
    if codecs.lookup(encoding).name == "utf-16":
        encoding = "utf-16-be" if mark == codecs.BOM_UTF16_BE else "utf-16-le"
    text = tail.decode(encoding, errors="replace")
    if not text or text[-1] in "\r\n":
        return False
    *above, last = text.splitlines()
    if "\0" in last:
        return True
    if not last_is_used:
        return False
    above = above[1:] if size > _TAIL else above[lines.skip + 1 :]  # whole lines below the headings
    forms = {_form(lines.cells(line)[-1]) for line in above if line.strip()}
    return len(above) < _LEAST_ROWS or forms != {_form(lines.cells(last)[-1])}


def _form(entry: str) -> tuple[str, int]:
    """Return how many decimals a number has, or how many characters, if it has none."""
    for sign in ".,":
        if sign in entry:
            return "decimals", len(entry) - entry.rindex(sign)
    return "characters", len(entry)
