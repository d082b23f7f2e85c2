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
from collections.abc import Callable, Iterator
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
_ONLY_A_DIMENSION = b"This is a netCDF dimension but not a netCDF variable"
_NOT_A_SCALE = "_nc4_non_coord_"
"""Before the name of a variable that has the name of a dimension, but is not its scale."""
_RAW = ("_FillValue", "missing_value")
"""Attributes whose bytes are values, and no text."""
_open: dict[str, h5netcdf.File] = {}


def answer(request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """Answer a request; what the library raises is part of the answer.

    Parameters
    ----------
    request : dict
        ``file``, and what to ``do`` with it: ``look`` at what it holds, ``read`` the variable ``name`` of a ``group``,
        ``close`` it, or ``glance``: all at once, of the variables called ``names`` alone, with the attributes ``attrs``
        and ``more_attrs``, by variable (those of no name are of the others), and ``group_attrs``. Values come from
        groups that have one of the names ``marks``; such a group without any of ``among`` gives the variables whose
        standard name is one of ``standard_names``, too.

    Returns
    -------
    told : dict
        Of a look ``fault``, a few words with what to do, or ``groups``: by path ``attrs`` and ``variables``, these with
        ``dims``, ``shape``, ``dtype`` and ``attrs``. Of an error ``error``, its ``errno``, and whether the process is
        ``spoilt``: a library that was misled may hold gigabytes, or have written where it should not.
        Of a glance, ``groups`` have the ``names`` of all that is in them, too; ``unusual`` in their place says that
        the file must be looked at and read.
    content : bytes
        Of a read, the values; of a glance, those of all variables, one after the other.
    """
    file, opening = request["file"], True
    try:
        if request["do"] == "close":
            _close(file)
            return {}, b""
        if request["do"] == "glance":
            with h5py.File(file, "r") as opened:
                opening = False
                return _glance(opened, request, max(MOST_BYTES, MOST_RATIO * Path(file).stat().st_size))
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


class _UnusualError(Exception):
    """A file has what a glance does not follow: `_fault_of_file` and h5netcdf do."""


def _glance(file: h5py.File, request: dict[str, Any], most: int) -> tuple[dict[str, Any], bytes]:
    """Return what is in use of a file, by the plain HDF5 library: h5netcdf takes twenty times as long to open it."""
    groups: dict[str, Any] = {}
    content: list[bytes] = []
    try:
        _glance_group(h5py.h5g.open(file.id, b"/"), "/", (), request, most, groups, content, {})
    except _UnusualError:
        return {"unusual": True}, b""
    return {"groups": groups}, b"".join(content)


def _glance_group(
    group: h5py.h5g.GroupID,
    path: str,
    above: tuple[int, ...],
    request: dict[str, Any],
    most: int,
    groups: dict[str, Any],
    content: list[bytes],
    scales: dict[int, str],
) -> None:
    """Put what is in use of a group, and of the groups in it, into `groups` and `content`.

    `scales` are the names of the variables of the groups above, by their addresses.
    """
    address = h5py.h5o.get_info(group).addr
    if address in above or len(above) == _MOST_DEPTH:
        raise _UnusualError
    names, inner, at = [], [], dict(scales)
    for raw in group:
        name = raw.decode("utf-8", "surrogateescape")
        if group.links.get_info(raw).type != h5py.h5l.TYPE_HARD or name.startswith(_NOT_A_SCALE):
            raise _UnusualError
        about = h5py.h5o.get_info(group, raw)
        if about.type == h5py.h5o.TYPE_GROUP:
            inner.append(raw)
        elif about.type == h5py.h5o.TYPE_DATASET:
            names.append(name)
            at[about.addr] = name
    wanted = [name for name in request["names"] if name in names]
    with_values = any(name in request["marks"] for name in wanted)
    if with_values and not any(name in request["among"] for name in wanted):
        wanted += [
            name for name in names if name not in wanted and _standard_name(group, name) in request["standard_names"]
        ]
    variables = {}
    for name in wanted:
        asked = [*request["attrs"], *request["more_attrs"].get(name if name in request["names"] else "", ())]
        found = _glanced(group, name, at, asked, most, content if with_values else None)
        if found is None:
            names.remove(name)
        else:
            variables[name] = found
    attributes = _some_attributes(h5py.Group(group), _attribute_names(group), request["group_attrs"])
    groups[path] = {"names": names, "variables": variables, "attrs": attributes, "has_values": with_values}
    for raw in inner:
        own = f"{path.rstrip('/')}/{raw.decode('utf-8', 'surrogateescape')}"
        _glance_group(h5py.h5g.open(group, raw), own, (*above, address), request, most, groups, content, at)


def _standard_name(group: h5py.h5g.GroupID, name: str) -> str:
    dataset = h5py.Dataset(h5py.h5d.open(group, name.encode("utf-8", "surrogateescape")))
    value = dataset.attrs.get("standard_name", "")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _glanced(
    group: h5py.h5g.GroupID,
    name: str,
    at: dict[int, str],
    asked: list[str],
    most: int,
    content: list[bytes] | None,
) -> dict[str, Any] | None:
    """Return what a variable is, and add its values; None if it is only a dimension."""
    number = h5py.h5d.open(group, name.encode("utf-8", "surrogateescape"))
    dtype, space = number.dtype, number.get_space()
    is_text = h5py.check_string_dtype(dtype) is not None and dtype.kind == "O"
    plain = dtype.kind in "iuf" and dtype.metadata is None
    if space.get_simple_extent_type() == h5py.h5s.NULL or not (is_text or plain):
        raise _UnusualError
    dataset, present = h5py.Dataset(number), _attribute_names(number)
    is_scale = "CLASS" in present
    if is_scale and len(number.shape) != 1:
        raise _UnusualError
    if is_scale and "NAME" in present and bytes(dataset.attrs["NAME"]).startswith(_ONLY_A_DIMENSION):
        return None
    shape = number.shape
    if int(np.prod(shape, dtype=np.float64)) * dtype.itemsize > most:
        raise _UnusualError
    attributes = _some_attributes(dataset, present, asked)
    about = {"dims": [name] if is_scale else _dimensions(number, shape, at), "shape": list(shape), "attrs": attributes}
    if is_text:
        values = json.dumps([_told(value) for value in np.ravel(np.asarray(dataset[()], dtype=object))]).encode("ascii")
    else:
        numbers = np.empty(shape, dtype=dtype)
        if content is not None and numbers.size:
            number.read(h5py.h5s.ALL, h5py.h5s.ALL, numbers)
        values = numbers.tobytes()
    if content is not None:
        content.append(values)
    return {**about, "dtype": TEXT if is_text else dtype.str, "n_byte": len(values)}


def _dimensions(number: h5py.h5d.DatasetID, shape: tuple[int, ...], at: dict[int, str]) -> list[str]:
    """Return the names of the dimensions; `at` has those of the scales by their addresses."""
    dims = []
    for axis, size in enumerate(shape):
        scales: list[tuple[int, tuple[int, ...]]] = []
        if h5py.h5ds.get_num_scales(number, axis) == 1:
            h5py.h5ds.iterate(number, axis, _told_to(scales))
        if len(scales) != 1 or scales[0][1] != (size,) or scales[0][0] not in at:
            raise _UnusualError  # no scale, or several; or an unlimited one that is longer than the values
        dims.append(at[scales[0][0]])
    return dims


def _told_to(scales: list[tuple[int, tuple[int, ...]]]) -> Callable[[h5py.h5d.DatasetID], None]:
    def tell(scale: h5py.h5d.DatasetID) -> None:
        scales.append((h5py.h5o.get_info(scale).addr, scale.shape))

    return tell


def _attribute_names(number: h5py.h5d.DatasetID | h5py.h5g.GroupID) -> set[str]:
    names: list[bytes] = []
    h5py.h5a.iterate(number, names.append)
    return {name.decode("utf-8", "surrogateescape") for name in names}


def _some_attributes(item: h5py.Dataset | h5py.Group, present: set[str], asked: list[str]) -> dict[str, Any]:
    attributes = {}
    for name in asked:
        if name not in present:
            continue
        value = item.attrs[name]
        if isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
            value = value[0] if value.shape == (1,) else value
        elif not isinstance(value, (bytes, str, np.number)):
            raise _UnusualError
        attributes[name] = _told(value, raw=name in _RAW)
    return attributes


def main() -> None:
    """Answer requests until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # nothing that a library prints gets among the answers
    if sys.platform != "win32":  # the system ends this process where it hangs and who asked is gone
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    answers.write(READY)
    answers.flush()
    for line in sys.stdin.buffer:
        request = json.loads(line)
        if sys.platform != "win32":
            signal.setitimer(signal.ITIMER_REAL, 2.0 * request["seconds"] + 1.0)
        told, content = answer(request)
        answers.write(json.dumps({**told, "n_byte": len(content)}).encode() + b"\n")
        answers.write(content)
        answers.flush()
        if sys.platform != "win32":
            signal.setitimer(signal.ITIMER_REAL, 0.0)


if __name__ == "__main__":
    main()
