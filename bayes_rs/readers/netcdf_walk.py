"""A walk over an HDF5 file, in a process of its own: whatever makes the HDF5 library hang or die does so there.

Run as a script it takes requests and gives answers, a line of JSON each, until its input ends. It imports nothing of
this package, so that it starts in a fraction of a second.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

MOST_BYTES = 1024**3
MOST_RATIO = 2000
"""What a variable may announce, beyond all compression by deflate (1032 to 1)."""
READY = b"{}\n"
"""The answer for a good file, and the first line of the process."""

_MOST_DEPTH = 8
_BLOCK = 10_000
_UNKNOWN = (TypeError, ValueError, ArithmeticError, NotImplementedError)
"""What h5py raises for an entry that it cannot express in Python; readers pass over such."""


class EntryError(Exception):
    """An entry that the library cannot follow; the process may then hold gigabytes, and is not to be used any more."""


def find_fault(file: str) -> str:
    """Say what is wrong with a file; nothing if it can be read.

    What the library finds by following references in the file is read: attributes, indices of chunks, and variables
    whose entries have no fixed length. An error there counts even where no reader needs the entry: the library can take
    seconds and gigabytes of memory before it raises one.

    Parameters
    ----------
    file : str
        Path of an HDF5 file.

    Returns
    -------
    fault : str
        A few words, with what to do.

    Raises
    ------
    OSError
        If the library cannot open it.
    EntryError
        If the library cannot read what it finds by following references.
    """
    with h5py.File(file, "r") as opened:
        fault = _fault_of_group(opened, max(MOST_BYTES, MOST_RATIO * Path(file).stat().st_size), ())
        if not fault:
            try:
                _walk(opened, set())
            except Exception as error:
                raise EntryError(str(error) or type(error).__name__) from error
    return fault


def _fault_of_group(group: h5py.Group, most: int, above: tuple[int, ...]) -> str:
    """Check what a group holds, and the groups in it; `above` are the addresses of those that it is in."""
    address = h5py.h5o.get_info(group.id).addr
    if address in above or len(above) == _MOST_DEPTH:
        return (
            f"its groups hold each other, or are more than {_MOST_DEPTH} deep; "
            "check that it is complete and not damaged."
        )
    for name in group:
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            return f"its {name!r} stands in another file, {link.filename!r}; copy it into one file."
        item = None if isinstance(link, h5py.SoftLink) else group[name]
        if isinstance(item, h5py.Group):
            fault = _fault_of_group(item, most, (*above, address))
            if fault:
                return fault
        elif isinstance(item, h5py.Dataset) and item.size and item.size * item.dtype.itemsize > most:
            return (
                f"its variable {item.name.removeprefix('/')!r} announces {item.size * item.dtype.itemsize} bytes; "
                "check that it is complete and not damaged."
            )
    return ""


def _walk(item: Any, seen: set[int]) -> None:
    """Read what a group or variable says in its attributes, and what it holds; each only once."""
    address = h5py.h5o.get_info(item.id).addr
    if address in seen:
        return
    seen.add(address)
    for name in item.attrs:
        with suppress(*_UNKNOWN):
            _follow(item.attrs[name], item.file)
    if isinstance(item, h5py.Dataset):
        _walk_variable(item)
    elif isinstance(item, h5py.Group):
        for name in item:
            if isinstance(item.get(name, getlink=True), h5py.HardLink):
                _walk(item[name], seen)


def _walk_variable(variable: h5py.Dataset) -> None:
    with suppress(*_UNKNOWN):
        _ = variable.fillvalue
    with suppress(*_UNKNOWN):
        if variable.chunks is not None and variable.size:
            variable.id.get_num_chunks()
            if hasattr(variable.id, "chunk_iter"):  # an h5py may be built with a library that has none
                variable.id.chunk_iter(lambda _: None)
    with suppress(*_UNKNOWN):
        if variable.size and variable.dtype.hasobject:
            for block in _blocks(variable.shape):
                _ = variable[block]


def _blocks(shape: tuple[int, ...]) -> Iterator[Any]:
    """Give parts of a variable that fit into the memory."""
    if not shape:
        yield ()
        return
    step = max(1, _BLOCK // max(1, int(np.prod(shape[1:], dtype=float))))
    for start in range(0, shape[0], step):
        yield slice(start, start + step)


def _follow(value: Any, file: h5py.File) -> None:
    """Look up what references point to."""
    if isinstance(value, h5py.Reference):
        with suppress(Exception):  # also a good file may point to what was taken out of it
            _ = file[value].name
    elif isinstance(value, np.ndarray) and value.dtype.hasobject:
        for entry in value.ravel().tolist():
            _follow(entry, file)


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    try:
        fault = find_fault(request["file"])
    except Exception as error:  # noqa: BLE001 - the asking process raises it
        return {
            "error": str(error) or type(error).__name__,
            "errno": getattr(error, "errno", None),
            "spoilt": isinstance(error, EntryError),
        }
    return {"fault": fault} if fault else {}


def main() -> None:
    """Answer requests until the input ends."""
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # nothing that a library prints gets among the answers
    timed = hasattr(signal, "setitimer")
    if timed:  # the system ends this process where it hangs and who asked is gone
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    os.write(answers, READY)
    for line in sys.stdin.buffer:
        request = json.loads(line)
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 2.0 * request["seconds"] + 1.0)
        answer = _answer(request)
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        os.write(answers, json.dumps(answer).encode() + b"\n")


if __name__ == "__main__":
    main()
