"""Files that are whole or not there: NetCDF that ends with the fingerprint of its content."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.output import write_netcdf

_SEAL = b"\nbayes_rs sha256 "
"""Begins the last bytes of a noise file, which HDF5 passes over: the fingerprint of all bytes before them."""
_SEAL_BYTES = len(_SEAL) + 64


def save_dataset(dataset: xr.Dataset, path: str | Path, *, overwrite: bool) -> None:
    """Write a noise Dataset to a new NetCDF file."""
    file = Path(path)
    if file.exists() and not overwrite:
        raise InputError(f"File {str(file)!r} exists: give another name, or overwrite=True to replace it.")
    try:
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=f".{file.name[:40]}-") as folder:
            part = Path(folder) / "part.nc"
            write_netcdf(dataset, part, encoding=_encoding(dataset))
            with part.open("ab") as written:
                written.write(_seal(part.read_bytes()))
            part.replace(file)
    except OSError as error:
        raise InputError(
            f"Cannot write {str(file)!r}: {error.strerror or error}; give a folder that exists and can be written."
        ) from error


def is_sealed(file: Path) -> bool:
    """Say whether a file ends with the fingerprint of its content, as all do that `save_dataset` wrote.

    Raises
    ------
    InputError
        If the content is not what was written. It must not reach the HDF5 library, which can search a damaged file
        for ever, or find other numbers in it.
    """
    content = file.read_bytes()
    if not content[-_SEAL_BYTES:].startswith(_SEAL):
        return False
    if content[-_SEAL_BYTES:] != _seal(content[:-_SEAL_BYTES]):
        raise InputError(f"Noise file {str(file)!r} is damaged: it was changed since it was written; calibrate again.")
    return True


def _seal(content: bytes) -> bytes:
    return _SEAL + hashlib.sha256(content).hexdigest().encode()


def _encoding(dataset: xr.Dataset) -> dict[str, dict[str, Any]]:
    large = [name for name, item in dataset.variables.items() if item.dtype.kind == "f" and item.nbytes > 4096]
    return {str(name): {"zlib": True, "complevel": 6, "shuffle": True} for name in large}
