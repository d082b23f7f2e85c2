"""The one door to NetCDF files: each is looked through first, and then read by the library that looked, by its name."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import UNREADABLE, unreadable
from bayes_rs.readers.netcdf_classic import check_classic_header
from bayes_rs.readers.netcdf_guard import find_fault

SUFFIXES = (".nc", ".nc4", ".netcdf", ".cdf", ".h5")
"""Suffixes of NetCDF files."""
_HDF5 = b"\x89HDF\r\n\x1a\n"


@contextmanager
def open_netcdf(file: Path, *, decode_times: bool = True) -> Iterator[xr.Dataset]:
    """Open a NetCDF file; whatever the libraries raise while it is open says that it is damaged.

    Parameters
    ----------
    file : Path
        The file.
    decode_times : bool
        Whether times are times, or numbers.

    Yields
    ------
    dataset : xarray.Dataset
        Its root; values are read when they are asked for.

    Raises
    ------
    InputError
        If it is no NetCDF file, or damaged: one that kills the library, or keeps it busy for ever, does so in a
        process of its own.
    """
    with _reading(file), xr.open_dataset(file, engine=check_netcdf(file), decode_times=decode_times) as dataset:
        yield dataset


def load_netcdf(
    file: Path, *, content: bytes | None = None, decode_times: bool = True, trusted: bool = False
) -> xr.Dataset:
    """Return the root of a NetCDF file in memory.

    Parameters
    ----------
    file : Path
        The file.
    content : bytes, optional
        Its bytes, where they were read already.
    decode_times : bool
        Whether times are times, or numbers.
    trusted : bool
        That we wrote these very bytes is known: they are not looked through.

    Raises
    ------
    InputError
        As `open_netcdf`.
    """
    with _reading(file):
        engine = "h5netcdf" if trusted else check_netcdf(file)
        source = file if content is None else io.BytesIO(content)
        return xr.load_dataset(source, engine=engine, decode_times=decode_times)


def load_groups(file: Path) -> dict[str, xr.Dataset]:
    """Return all groups of a NetCDF-4 file in memory, by path, with their times as numbers; none of a classic file.

    Raises
    ------
    InputError
        As `open_netcdf`.
    """
    with _reading(file), ExitStack() as opened:
        engine = check_netcdf(file)
        if engine != "h5netcdf":
            return {}
        groups = xr.open_groups(file, decode_times=False, engine=engine)
        for dataset in groups.values():
            opened.callback(dataset.close)
        return {path: dataset.load() for path, dataset in groups.items()}


def check_netcdf(file: Path) -> Literal["h5netcdf", "scipy"]:
    """Refuse a file that would kill a library, keep it busy for ever, or fill the memory.

    Parameters
    ----------
    file : Path
        The file.

    Returns
    -------
    engine : str
        Which of xarray's engines is to read it: the one whose library has looked through it, whatever else is
        installed.

    Raises
    ------
    InputError
        If it is no NetCDF file, the header of a classic one is damaged, or the library hangs, dies, or finds a fault
        in a NetCDF-4 file (`netcdf_walk.find_fault`) in a process of its own.
    """
    try:
        with file.open("rb") as opened:
            magic = opened.read(len(_HDF5))
        if magic == _HDF5:
            fault = find_fault(file)
        elif magic[:3] == b"CDF":
            check_classic_header(file)
            return "scipy"
        else:
            fault = "it has no header of such a file; check that it is complete and not damaged."
    except InputError:
        raise
    except UNREADABLE as error:
        raise unreadable(file, error, as_what=" as NetCDF") from error
    if fault:
        raise InputError(f"File {str(file)!r} cannot be read as NetCDF: {fault}")
    return "h5netcdf"


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
