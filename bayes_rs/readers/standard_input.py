"""The standard input as a file: a table of text that another program writes."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from bayes_rs.errors import InputError
from bayes_rs.file_options import STANDARD_INPUT
from bayes_rs.readers.compressed import MOST_BYTES

_FILE = "standard-input.csv"
_BLOCK = 1 << 20
_BINARY = {
    b"\x89HDF": "NetCDF-4 or HDF5",
    b"CDF": "NetCDF",
    b"PAR1": "Parquet",
    b"\x1f\x8b": "compressed (gzip)",
    b"BZh": "compressed (bzip2)",
    b"\xfd7zXZ": "compressed (xz)",
    b"\x28\xb5\x2f\xfd": "compressed (zstd)",
    b"PK\x03\x04": "a zip archive",
}
"""First bytes of formats that are no text."""


@contextmanager
def with_standard_input(files: Sequence[str]) -> Iterator[list[str]]:
    """Give files, with a file in place of ``-`` that holds what came on the standard input.

    Parameters
    ----------
    files : sequence of str
        Names, as a user gave them.

    Yields
    ------
    files : list of str
        The same names without ``-``. The input is read once, from its beginning to its end, into a temporary file.

    Raises
    ------
    InputError
        If ``-`` stands there twice, nothing or more than the limit comes, or what comes is no text. An error that
        names the temporary file names the standard input instead.
    """
    if STANDARD_INPUT not in files:
        yield list(files)
        return
    if list(files).count(STANDARD_INPUT) > 1:
        raise InputError("The standard input ('-') is given twice: it can be read once.")
    with tempfile.TemporaryDirectory(prefix="bayes-rs-") as folder:
        place = Path(folder) / _FILE
        _copy(getattr(sys.stdin, "buffer", None), place)
        try:
            yield [str(place) if file == STANDARD_INPUT else file for file in files]
        except InputError as error:
            named = str(error).replace(repr(str(place)), "'-' (the standard input)")
            if named == str(error):
                raise
            raise InputError(named) from error


def _copy(stream: BinaryIO | None, place: Path) -> None:
    total = 0
    with place.open("wb") as out:
        while stream is not None and (block := stream.read(_BLOCK)):
            if total == 0:
                _check_text(block)
            total += len(block)
            if total > MOST_BYTES:
                raise InputError(
                    f"The standard input is longer than {MOST_BYTES} bytes: save it to files, and give these."
                )
            out.write(block)
    if total == 0:
        raise InputError("The standard input ('-') is empty: pipe a table of text into it, or name a file.")


def _check_text(block: bytes) -> None:
    what = next((words for first, words in _BINARY.items() if block.startswith(first)), None)
    if what is None and b"\0" in block and not block.startswith((b"\xff\xfe", b"\xfe\xff")):
        what = "a binary format"
    if what is not None:
        raise InputError(
            f"The standard input is {what}, and only a table of text can be read from there: save it to a file with "
            "the ending of its format, and name that file."
        )
