"""The one door to NetCDF files: NetCDF-4 is read in a process that may die of it, a classic file after a check."""

from __future__ import annotations

import base64
import json
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import AbstractDataStore, BackendArray
from xarray.core import indexing

from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import UNREADABLE, unreadable
from bayes_rs.readers.netcdf_classic import check_classic_header
from bayes_rs.readers.netcdf_group import Group, decoded
from bayes_rs.readers.netcdf_guard import ask, ask_here
from bayes_rs.readers.netcdf_names import MARKS, NAMES, REQUEST, STANDARD_NAMES
from bayes_rs.readers.netcdf_process import TEXT

SUFFIXES = (".nc", ".nc4", ".netcdf", ".cdf", ".h5")
"""Suffixes of NetCDF files."""
_HDF5 = b"\x89HDF\r\n\x1a\n"


@contextmanager
def open_netcdf(
    file: Path, *, decode_times: bool = True, trusted: bool = False, group: str = "/"
) -> Iterator[xr.Dataset]:
    """Open a NetCDF file; whatever the libraries raise while it is open says that it is damaged.

    Parameters
    ----------
    file : Path
        The file.
    decode_times : bool
        Whether times are times, or numbers.
    trusted : bool
        That nobody but us, or who installed this package, can have written it: it is read by this process.
    group : str
        Path of the group that is wanted; the root by default.

    Yields
    ------
    dataset : xarray.Dataset
        The group; values are read when they are asked for.

    Raises
    ------
    InputError
        If it is no NetCDF file, or damaged: one that kills the HDF5 library, or keeps it busy for ever, does so in a
        process of its own, which is also the one that reads; or if it has no such group.
    """
    with _opened(file, decode_times=decode_times, trusted=trusted) as groups:
        if group not in groups:
            raise InputError(f"File {str(file)!r} has no group {group!r}: it has {', '.join(groups)}.")
        yield groups[group]()


def load_netcdf(file: Path, *, trusted: bool = False, group: str = "/") -> xr.Dataset:
    """Return a group of a NetCDF file in memory, by its path: the root, unless another is named; see `open_netcdf`."""
    with open_netcdf(file, trusted=trusted, group=group) as dataset:
        return dataset.load()


def glance(file: Path, also: Iterable[str] = ()) -> dict[str, Group]:
    """Return what readers of rays use of a NetCDF file, in memory, by one request; see `open_netcdf`.

    Parameters
    ----------
    file : Path
        The file.
    also : iterable of str
        Variables that are in use, too, beside `netcdf_names.NAMES`; a group with one of them holds rays.

    Returns
    -------
    groups : dict of str to Group
        The groups by their paths, the root first. That of the last file is kept: who recognises it, who says what it
        states of itself, and who reads it read it once.
    """
    stat, more = file.stat(), tuple(sorted(set(also) - set(NAMES)))
    key = (str(file.absolute()), stat.st_ino, stat.st_size, stat.st_mtime_ns, more)
    last = _last.kept
    if last is not None and last[0] == key:
        return last[1]
    with _reading(file):
        groups = _glanced(file, (*NAMES, *more), (*MARKS, *more))
    _last.kept = key, groups
    return groups


class _Last(threading.local):
    """The file that a thread has glanced at last, and what it saw."""

    kept: tuple[tuple[Any, ...], dict[str, Group]] | None = None


_last = _Last()


def _glanced(file: Path, wanted: tuple[str, ...], marks: tuple[str, ...]) -> dict[str, Group]:
    if _is_classic(file):
        with xr.open_dataset(file, engine="scipy", decode_times=False) as dataset:
            return {"/": _group_of("/", dataset, wanted, marks)}
    told, content = ask(file, "glance", names=wanted, marks=marks, **REQUEST)
    if told.get("unusual"):
        with _opened(file, decode_times=False) as opened:
            return {path: _group_of(path, group(), wanted, marks) for path, group in opened.items()}
    at = 0
    groups = {}
    for path, about in told["groups"].items():
        variables, attributes = {}, {}
        for name, of in about["variables"].items():
            attributes[name] = _attributes(of)
            if about["has_values"]:
                values = _values_from(memoryview(content)[at : at + of["n_byte"]], of["dtype"], tuple(of["shape"]))
                at += of["n_byte"]
                values = values.astype(str) if of["dtype"] == TEXT else values  # xarray takes long over objects
                variables[name] = decoded(name, xr.Variable(_distinct(of["dims"]), values, attributes[name]))
        groups[path] = Group(path, tuple(about["names"]), variables, attributes, _attributes(about))
    return groups


def _group_of(path: str, dataset: xr.Dataset, wanted: tuple[str, ...], marks: tuple[str, ...]) -> Group:
    """Return what is in use of a group that xarray has opened."""
    names = tuple(str(name) for name in dataset.variables)
    found = [name for name in wanted if name in names]
    has_values = any(name in marks for name in found)
    if has_values and not any(name in REQUEST["among"] for name in found):
        standard = {name: str(dataset.variables[name].attrs.get("standard_name", "")) for name in names}
        found += [name for name in names if name not in found and standard[name] in STANDARD_NAMES]
    return Group(
        path,
        names,
        {name: dataset.variables[name].load() for name in found} if has_values else {},
        {name: {**dataset.variables[name].attrs, **_fills(dataset.variables[name])} for name in found},
        dataset.attrs,
    )


def _fills(variable: xr.Variable) -> dict[str, Any]:
    return {key: variable.encoding[key] for key in ("_FillValue", "missing_value") if key in variable.encoding}


@contextmanager
def _opened(file: Path, *, decode_times: bool, trusted: bool = False) -> Iterator[dict[str, Callable[[], xr.Dataset]]]:
    """Open a file; give what opens each of its groups, by path."""
    with _reading(file):
        if _is_classic(file):
            with xr.open_dataset(file, engine="scipy", decode_times=decode_times) as dataset:
                yield {"/": lambda: dataset}
            return
        asked = ask_here if trusted else ask
        told, _ = asked(file, "look")
        groups = {path: _Group(file, path, about, asked) for path, about in told["groups"].items()}
        try:
            yield {path: partial(xr.open_dataset, group, decode_times=decode_times) for path, group in groups.items()}
        finally:
            with suppress(OSError, InputError):  # nothing is lost by it
                asked(file, "close")


def _is_classic(file: Path) -> bool:
    """Say whether a file is of the classic format, and not of HDF5.

    Raises
    ------
    InputError
        If it is of neither, or its classic header is damaged.
    """
    with file.open("rb") as opened:
        magic = opened.read(len(_HDF5))
    if magic == _HDF5:
        return False
    if magic[:3] != b"CDF":
        raise InputError(
            f"File {str(file)!r} cannot be read as NetCDF: it has no header of such a file; check that it is complete "
            "and not damaged."
        )
    check_classic_header(file)
    return True


class _Group(AbstractDataStore):
    """A group of a file that another process has open."""

    def __init__(self, file: Path, path: str, told: Mapping[str, Any], asked: Callable[..., Any]) -> None:
        self.file, self.path, self.told, self.asked = file, path, told, asked

    def get_variables(self) -> dict[str, xr.Variable]:
        """Return the variables; their values are read when they are asked for."""
        return {
            name: xr.Variable(
                _distinct(about["dims"]),
                indexing.LazilyIndexedArray(_Values(self, name, about)),
                _attributes(about),
                {"dtype": _dtype(about["dtype"]) if about["dtype"] != TEXT else str},
            )
            for name, about in self.told["variables"].items()
        }

    def get_attrs(self) -> dict[str, Any]:
        """Return the attributes of the group."""
        return _attributes(self.told)

    def close(self) -> None:
        """Do nothing: who opened the file closes it."""


class _Values(BackendArray):
    """The values of a variable, read whole when the first of them is asked for."""

    def __init__(self, group: _Group, name: str, about: Mapping[str, Any]) -> None:
        self.group, self.name = group, name
        self.kind = about["dtype"]
        self.dtype, self.shape = _dtype(self.kind), tuple(about["shape"])
        self._read: NDArray[Any] | None = None  # no cached_property: before Python 3.12 a fork may find it locked

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        """Return some of the values."""
        support = indexing.IndexingSupport.BASIC
        return indexing.explicit_indexing_adapter(key, self.shape, support, lambda plain: self._whole()[plain])

    def _whole(self) -> NDArray[Any]:
        if self._read is None:
            self._read = self._from_file()
        return self._read

    def _from_file(self) -> NDArray[Any]:
        _, content = self.group.asked(self.group.file, "read", group=self.group.path, name=self.name)
        return _values_from(content, self.kind, self.shape)


def _values_from(content: bytes | bytearray | memoryview, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return values as `netcdf_process` hands them over."""
    if kind != TEXT:
        return np.frombuffer(content, dtype=kind).reshape(shape)
    values = np.empty(shape, dtype=object)
    values.ravel()[:] = json.loads(bytes(content))
    return values


def _distinct(dims: list[str]) -> list[str]:
    """Number a dimension that a variable has more than once: xarray goes wrong with such in silence."""
    return [dim if dim not in dims[:index] else f"{dim} ({index + 1})" for index, dim in enumerate(dims)]


def _dtype(kind: str) -> np.dtype[Any]:
    return np.dtype(object if kind == TEXT else kind)


def _attributes(told: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _from_json(value) for key, value in told["attrs"].items()}


def _from_json(value: Any) -> Any:
    """Return an attribute as `netcdf_process` was told it."""
    if not isinstance(value, dict):
        return value
    if "bytes" in value:
        return value["bytes"].encode("latin-1")
    numbers = np.frombuffer(base64.b64decode(value["content"]), dtype=value["dtype"]).reshape(value["shape"])
    return numbers[()]


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", xr.SerializationWarning)
            yield
    except InputError:
        raise
    except UNREADABLE as error:
        raise unreadable(file, error, as_what=" as NetCDF") from error
