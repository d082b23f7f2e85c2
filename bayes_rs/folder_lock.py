"""One process at a time writes an output folder, by a lock that the system frees with its process."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from bayes_rs.errors import InputError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
"""What the systems say where another process holds the lock."""
_AT = 1 << 30
"""Byte that is locked on Windows, where nobody can read what is locked: far behind the words in the file."""


@contextmanager
def locked(folder: str | Path) -> Iterator[None]:
    """Keep other processes from writing an output folder, as long as the block runs.

    Parameters
    ----------
    folder : str or Path
        The folder, which need not exist. The lock is a hidden file beside it, which is removed at the
        end, but on Windows. The folders above are made, and those of them that hold nothing at the end go again.

    Raises
    ------
    InputError
        If another process writes the folder, or the lock cannot be written.

    Notes
    -----
    The lock is that of the operating system (`flock`, on Windows `LockFile`) on an open file, not the file: it goes
    with its process, however that ends, so that what a killed run leaves hinders nobody. On a network drive it reaches
    as far as the server knows of locks; where there are none, a warning says so.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder, locked(f"{folder}/year"):
    ...     [path.name[:11] for path in Path(folder).iterdir()]
    ['.lock-year-']
    """
    file = _lock_file(Path(folder))
    above = [place for place in file.parents if not place.exists()]
    number = _taken(file, Path(folder))
    try:
        began = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        words = f"process {os.getpid()} on {platform.node() or 'this machine'}, since {began}"
        with suppress(OSError):  # on a full disk the lock holds without words
            os.ftruncate(number, 0)
            os.lseek(number, 0, os.SEEK_SET)
            os.write(number, words.encode("utf-8"))
        yield
    finally:
        _let_go(number, file)
        os.close(number)
        with suppress(OSError):  # the first that holds something
            for place in above:
                place.rmdir()


def _lock_file(folder: Path) -> Path:
    """Return the place of the lock: beside the folder, since that may be replaced, and short enough for any system."""
    name = folder.resolve().name
    stem = f"{name[:40]}-{hashlib.sha256(name.encode('utf-8', 'surrogateescape')).hexdigest()[:8]}"
    return folder.resolve().parent / f".lock-{stem}"


def _taken(file: Path, folder: Path) -> int:
    """Return the number of the open and locked file."""
    while True:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            number = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise InputError(
                f"Cannot write the output folder {str(folder)!r}: {error.strerror or error}; give a folder that can be "
                "written."
            ) from error
        try:
            _lock(number)
        except OSError as error:
            if error.errno in _TAKEN:
                os.lseek(number, 0, os.SEEK_SET)
                words = os.read(number, 1000).decode("utf-8", "replace") or "which just began"
                os.close(number)
                raise InputError(
                    f"Output folder {str(folder)!r} is being written by another run ({words}): wait for its end, stop "
                    "it, or give another name."
                ) from error
            warnings.warn(
                f"The place of {str(folder)!r} knows no locks ({error.strerror or error}): see to it that no other run "
                "writes this folder meanwhile.",
                stacklevel=4,
            )
        if _is_there(file, number):
            return number
        os.close(number)


def _is_there(file: Path, number: int) -> bool:
    """Tell whether an open file still has its name: the run that held the lock may have removed it since."""
    try:
        return os.path.samestat(file.stat(), os.fstat(number))
    except FileNotFoundError:
        return False


def _let_go(number: int, file: Path) -> None:
    if sys.platform == "win32":  # which cannot remove an open file: there the empty lock stays
        with suppress(OSError):  # it was not locked, where the place knows no locks
            os.lseek(number, _AT, os.SEEK_SET)
            msvcrt.locking(number, msvcrt.LK_UNLCK, 1)  # at once: with the file it is freed at some time
    else:
        file.unlink(missing_ok=True)  # while it is locked: who has opened it meanwhile sees that it is gone


def _lock(number: int) -> None:
    if sys.platform == "win32":
        os.lseek(number, _AT, os.SEEK_SET)
        msvcrt.locking(number, msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
