"""NetCDF-4 files, read in a process of its own: whatever makes the HDF5 library hang or die does so there.

Run as a script it takes requests and gives answers, a line of JSON each and then the values asked for, until its input
ends. It imports nothing of this package, so that it starts in a fraction of a second.
"""

from __future__ import annotations

import base64
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np

MOST_BYTES = 1024**3
MOST_RATIO = 2000
"""What a variable may announce, beyond all compression by deflate (1032 to 1)."""
READY = b'{"n_byte": 0}\n'
"""The first line of the process."""
TEXT = "text"
"""In place of a dtype: of texts of any length, and of what is neither numbers nor text, which comes as text."""

_MOST_DEPTH = 8
_PLAIN = "biufcS"
_RAW = ("_FillValue", "missing_value")
"""Attributes whose bytes are values, and no text."""
_open: dict[str, h5netcdf.File] = {}


def answer(request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """Answer a request; what the library raises is part of the answer.

    Parameters
    ----------
    request : dict
        ``file``, and what to ``do`` with it: ``look`` at what it holds, ``read`` the variable ``name`` of a ``group``,
        or ``close`` it.

    Returns
    -------
    told : dict
        Of a look ``fault``, a few words with what to do, or ``groups``: by path ``attrs`` and ``variables``, these with
        ``dims``, ``shape``, ``dtype`` and ``attrs``. Of an error ``error``, its ``errno``, and whether the process is
        ``spoilt``: a library that was misled may hold gigabytes, or have written where it should not.
    content : bytes
        Of a read, the values.
    """
    file, opening = request["file"], True
    try:
        if request["do"] == "close":
            _close(file)
            return {}, b""
        if file not in _open:
            if request["do"] == "look" and (fault := _fault_of_file(file)):
                return {"fault": fault}, b""
            opening = False
            _open[file] = h5netcdf.File(file, "r", phony_dims="access")
        opening = False
        if request["do"] == "read":
            group = _open[file] if request["group"] == "/" else _open[file][request["group"]]
            return {}, _values(group.variables[request["name"]])
        return {"groups": dict(_groups(_open[file]))}, b""
    except Exception as error:  # noqa: BLE001 - the asking process raises it
        _close(file)
        said = {"error": str(error) or type(error).__name__, "kind": type(error).__name__}
        return {**said, "errno": getattr(error, "errno", None), "spoilt": not opening}, b""


def _close(file: str) -> None:
    opened = _open.pop(file, None)
    if opened is not None:
        opened.close()


def _fault_of_file(file: str) -> str:
    """Say what keeps a file from being read; nothing if it can be tried."""
    with h5py.File(file, "r") as opened:
        return _fault_of_group(opened, max(MOST_BYTES, MOST_RATIO * Path(file).stat().st_size), ())


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


def _groups(group: h5netcdf.Group) -> Iterator[tuple[str, dict[str, Any]]]:
    """Give what a group holds, and the groups in it, by their paths."""
    variables = {name: _variable(item) for name, item in group.variables.items()}
    yield group.name, {"variables": variables, "attrs": _attributes(group)}
    for inner in group.groups.values():
        yield from _groups(inner)


def _variable(variable: h5netcdf.Variable) -> dict[str, Any]:
    about = {"dims": list(variable.dimensions), "shape": list(variable.shape)}
    return {**about, "dtype": _kind(variable.dtype), "attrs": _attributes(variable)}


def _kind(dtype: np.dtype[Any] | type[str]) -> str:
    return TEXT if isinstance(dtype, type) or dtype.kind not in _PLAIN else dtype.str


def _attributes(item: h5netcdf.Group | h5netcdf.Variable) -> dict[str, Any]:
    return {name: _told(value, raw=name in _RAW) for name, value in item.attrs.items()}


def _told(value: Any, *, raw: bool = False) -> Any:
    """Return an attribute in JSON: texts as they are; numbers with their type, which counts where values are packed."""
    if raw and isinstance(value, bytes):
        return {"bytes": value.decode("latin-1")}
    if isinstance(value, bytes):
        return value.decode("utf-8", "surrogateescape")
    if isinstance(value, list):
        return [_told(entry) for entry in value]
    numbers = np.asarray(value)
    if _kind(numbers.dtype) == TEXT:
        return str(value)
    content = base64.b64encode(numbers.tobytes()).decode("ascii")
    return {"dtype": numbers.dtype.str, "shape": list(numbers.shape), "content": content}


def _values(variable: h5netcdf.Variable) -> bytes:
    """Return the values of a variable: the bytes of its numbers, or its texts in JSON."""
    if _kind(variable.dtype) != TEXT:
        return np.ascontiguousarray(_filled_up(np.asarray(variable[...]), variable.shape)).tobytes()
    values = _filled_up(np.asarray(variable[...], dtype=object), variable.shape)
    return json.dumps([_told(value) for value in np.ravel(values)]).encode("ascii")


def _filled_up(values: np.ndarray[Any, Any], shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Return values in the shape of their dimensions: h5netcdf fills numbers up to an unlimited one, but no texts."""
    if values.shape == shape:
        return values
    full = np.full(shape, "", dtype=values.dtype)
    full[tuple(slice(size) for size in values.shape)] = values
    return full


def main() -> None:
    """Answer requests until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # nothing that a library prints gets among the answers
    timed = hasattr(signal, "setitimer")
    if timed:  # the system ends this process where it hangs and who asked is gone
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    answers.write(READY)
    answers.flush()
    for line in sys.stdin.buffer:
        request = json.loads(line)
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 2.0 * request["seconds"] + 1.0)
        told, content = answer(request)
        answers.write(json.dumps({**told, "n_byte": len(content)}).encode() + b"\n")
        answers.write(content)
        answers.flush()
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


if __name__ == "__main__":
    main()
