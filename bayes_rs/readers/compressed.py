"""Compressed files: unpacked into a temporary file, with a limit on what comes out."""

from __future__ import annotations

import bz2
import errno
import gzip
import lzma
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import pyarrow as pa

from bayes_rs.errors import InputError

COMPRESSIONS = (".gz", ".bz2", ".xz", ".zst", ".zip")
MOST_BYTES = 4 * 1024**3
"""What a compressed file may unpack to; about eighty million rows of text."""

UNREADABLE = (
    OSError,
    EOFError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    ArithmeticError,
    RuntimeError,
    MemoryError,
    AssertionError,
    SyntaxError,
    zlib.error,
    lzma.LZMAError,
    zipfile.BadZipFile,
)
"""What libraries raise for a damaged file."""

NOT_THE_FILE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EMFILE, errno.ENFILE, errno.ENOMEM)
"""What the system fails with whatever the file is."""

_BEGINNINGS = {
    b"PAR1\x15": ".parquet",  # and the first field of its first page or footer: a heading may begin with PAR1
    b"\x89HDF\r\n\x1a\n": ".nc",
    b"CDF\x01": ".nc",
    b"CDF\x02": ".nc",
    b"CDF\x05": ".nc",
}
"""How files begin that are known by it, whatever they are called, and the suffix that they should have."""

_BLOCK = 1 << 20


def plain_suffix(file: Path) -> str:
    """Return the suffix of a file in lower case, without that of its compression."""
    suffixes = [suffix.lower() for suffix in file.suffixes]
    if suffixes and suffixes[-1] in COMPRESSIONS:
        suffixes.pop()
    return suffixes[-1] if suffixes else ""


def own_suffix(file: Path) -> str:
    """Return the suffix that a file should have by how it begins, or its own where that does not tell.

    Parameters
    ----------
    file : Path
        The file, also compressed.
    """
    with suppress(*UNREADABLE):  # whoever reads it says what is wrong
        begins = first_bytes(file, max(map(len, _BEGINNINGS)))
        return next((suffix for first, suffix in _BEGINNINGS.items() if begins.startswith(first)), plain_suffix(file))
    return plain_suffix(file)


def unreadable(file: Path, error: BaseException, *, as_what: str = "") -> InputError:
    """Return the error to raise for a file that a library cannot read.

    Raises
    ------
    OSError
        The same error, if it is not the file's fault, as where the disk is full: it must not count as damaged.
    """
    if isinstance(error, OSError) and error.errno in NOT_THE_FILE:
        raise error
    reason = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
    if isinstance(error, (AttributeError, TypeError, AssertionError)):
        reason = f"the library cannot follow what it says ({reason})"
    reason = "".join(character if character.isprintable() else " " for character in reason)
    return InputError(
        f"File {str(file)!r} cannot be read{as_what}: {reason}; check that it is complete and not damaged."
    )


@contextmanager
def plain_file(file: Path) -> Iterator[Path]:
    """Give the path of a file as it is without compression: its own, or that of a temporary copy.

    Raises
    ------
    InputError
        If the file is damaged, or unpacks to more than the limit.
    """
    if file.suffix.lower() not in COMPRESSIONS:
        yield file
        return
    with tempfile.TemporaryDirectory(prefix="bayes-rs-") as folder:
        plain = Path(folder) / file.name[: -len(file.suffix)]
        try:
            with _open(file) as packed, plain.open("wb") as unpacked:
                total = 0
                while block := packed.read(_BLOCK):
                    total += len(block)
                    if total > MOST_BYTES:
                        break
                    unpacked.write(block)
        except InputError:
            raise
        except UNREADABLE as error:
            raise unreadable(file, error) from error
        if total > MOST_BYTES:
            raise InputError(
                f"File {str(file)!r} unpacks to more than {MOST_BYTES} bytes: unpack it yourself and give the file "
                "that comes out, if it is right."
            )
        yield plain


def first_bytes(file: Path, count: int) -> bytes:
    """Return how a file begins, without its compression; fewer bytes if it has no more."""
    with _open(file) if file.suffix.lower() in COMPRESSIONS else file.open("rb") as stream:
        return bytes(stream.read(count))


@contextmanager
def _open(file: Path) -> Iterator[IO[bytes] | Any]:
    suffix = file.suffix.lower()
    if suffix == ".zip":
        with zipfile.ZipFile(file) as archive:
            names = [entry.filename for entry in archive.infolist() if not entry.is_dir()]
            if len(names) != 1:
                raise InputError(
                    f"File {str(file)!r} holds {len(names)} files: a .zip must hold one; unpack it and give the folder."
                )
            with archive.open(names[0]) as packed:
                yield packed
    elif suffix == ".zst":
        with pa.input_stream(str(file), compression="zstd") as packed:
            yield packed
    else:
        opened: dict[str, Any] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
        with opened[suffix](file, "rb") as packed:
            yield packed
