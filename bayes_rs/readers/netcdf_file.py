"""The one door to NetCDF files: NetCDF-4 is read in a process that may die of it, a classic file after a check."""

from __future__ import annotations

import base64
import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import AbstractDataStore, BackendArray
from xarray.core import indexing

from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import UNREADABLE, unreadable
from bayes_rs.readers.netcdf_classic import check_classic_header
from bayes_rs.readers.netcdf_guard import ask, ask_here
from bayes_rs.readers.netcdf_process import TEXT

SUFFIXES = (".nc", ".nc4", ".netcdf", ".cdf", ".h5")
"""Suffixes of NetCDF files."""
_HDF5 = b"\x89HDF\r\n\x1a\n"


@contextmanager
def open_netcdf(file: Path, *, decode_times: bool = True, trusted: bool = False) -> Iterator[xr.Dataset]:
    """Open a NetCDF file; whatever the libraries raise while it is open says that it is damaged.

    Parameters
    ----------
    file : Path
        The file.
    decode_times : bool
        Whether times are times, or numbers.
    trusted : bool
        That nobody but us, or who installed this package, can have written it: it is read by this process.

    Yields
    ------
    dataset : xarray.Dataset
        Its root; values are read when they are asked for.

    Raises
    ------
    InputError
        If it is no NetCDF file, or damaged: one that kills the HDF5 library, or keeps it busy for ever, does so in a
        process of its own, which is also the one that reads.
    """
    with _opened(file, decode_times=decode_times, trusted=trusted) as groups:
        yield groups["/"]()


@contextmanager
def open_groups(file: Path) -> Iterator[dict[str, xr.Dataset]]:
    """Open all groups of a NetCDF file, by path, with their times as numbers; see `open_netcdf`."""
    with _opened(file, decode_times=False) as groups:
        yield {path: group() for path, group in groups.items()}


def load_netcdf(file: Path, *, trusted: bool = False) -> xr.Dataset:
    """Return the root of a NetCDF file in memory; see `open_netcdf`."""
    with open_netcdf(file, trusted=trusted) as dataset:
        return dataset.load()


class Header(NamedTuple):
    """What the root of a file says of itself.

    Attributes
    ----------
    attrs : dict
        Its attributes.
    variables : dict of str to dict
        The attributes of its variables, by their names.
    """

    attrs: dict[str, Any]
    variables: dict[str, dict[str, Any]]


def header_of(file: Path) -> Header:
    """Return what the root of a NetCDF file says of itself; no value is read. See `open_netcdf`."""
    with _reading(file):
        if _is_classic(file):
            with xr.open_dataset(file, engine="scipy", decode_cf=False) as dataset:
                return Header(dataset.attrs, {str(name): data.attrs for name, data in dataset.variables.items()})
        try:
            told = ask(file, "look")[0]["groups"]["/"]
        finally:
            with suppress(OSError, InputError):  # nothing is lost by it
                ask(file, "close")
        return Header(_attributes(told), {name: _attributes(about) for name, about in told["variables"].items()})


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
        if self.kind != TEXT:
            return np.frombuffer(content, dtype=self.dtype).reshape(self.shape)
        values = np.empty(self.shape, dtype=object)
        values.ravel()[:] = json.loads(content)
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
