"""Draws of a long fit as a Zarr store: one chunk a part and stress, so that parts are written apart."""

from __future__ import annotations

import importlib
import os
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs.errors import MissingExtraError
from bayes_rs.geometry.stress import STRESSES

_TYPE = "float32"


@dataclass(frozen=True)
class DrawStore:
    """An open store.

    Parameters
    ----------
    path : Path
        Its folder.
    arrays : dict of str to object
        Its Zarr arrays, by the names of the stresses.
    part_records : int
        Records of a part.
    """

    path: Path
    arrays: Mapping[str, Any]
    part_records: int

    def write(self, index: int, draws: NDArray[np.float32]) -> None:
        """Write the draws of one part, shape (n_record, n_draw, 6); they are on the disk when this returns."""
        first = index * self.part_records
        for number, (name, array) in enumerate(self.arrays.items()):
            array[first : first + len(draws)] = draws[:, :, number]
            with self._chunk(name, index).open("rb") as written:
                os.fsync(written.fileno())

    def has(self, index: int) -> bool:
        """Tell whether the chunks of a part are there and of full length."""
        n_byte = self.part_records * next(iter(self.arrays.values())).shape[1] * np.dtype(_TYPE).itemsize
        files = [self._chunk(name, index) for name in self.arrays]
        return all(file.is_file() and file.stat().st_size == n_byte for file in files)

    def _chunk(self, name: str, index: int) -> Path:
        return self.path / name / "c" / str(index) / "0"


def check_zarr() -> Any:
    """Return the package zarr.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        return importlib.import_module("zarr")  # an optional package
    except ImportError as error:
        raise MissingExtraError('Draws in Zarr need the package zarr: run pip install "bayes_rs[zarr]".') from error


def open_draw_store(
    path: Path, *, time: NDArray[np.datetime64], n_draw: int, part_records: int, attributes: Mapping[str, Any]
) -> DrawStore:
    """Open the store of a run that was interrupted, or make it.

    Parameters
    ----------
    path : Path
        Its folder; what is there and not of this run is replaced.
    time : ndarray of datetime64[ns], shape (n_record,)
        Start of the records; NaT if not known.
    n_draw : int
        Draws of a record.
    part_records : int
        Records of a part.
    attributes : dict
        What tells this run from others.

    Returns
    -------
    store : DrawStore
        With the variables ``uu`` to ``vw`` (record, draw), m² s⁻²; xarray opens it with ``engine="zarr"``.

    Raises
    ------
    MissingExtraError
        If zarr is not installed.
    """
    zarr = check_zarr()
    if not _is_of(zarr, path, attributes):
        if path.exists():
            shutil.rmtree(path)
        _make(zarr, path, time, n_draw, part_records, attributes)
    with zarr.config.set({"array.write_empty_chunks": True}):  # a part without draws is whole, too
        group = zarr.open_group(path, mode="r+", zarr_format=3)
        return DrawStore(path, {name: group[name] for name in STRESSES}, part_records)


def _is_of(zarr: Any, path: Path, attributes: Mapping[str, Any]) -> bool:
    try:
        return dict(zarr.open_group(path, mode="r", zarr_format=3).attrs) == dict(attributes)
    except (OSError, ValueError, KeyError):
        return False


def _make(
    zarr: Any,
    path: Path,
    time: NDArray[np.datetime64],
    n_draw: int,
    part_records: int,
    attributes: Mapping[str, Any],
) -> None:
    group = zarr.open_group(path, mode="w", zarr_format=3)
    for name in STRESSES:
        group.create_array(
            name,
            shape=(len(time), n_draw),
            chunks=(part_records, n_draw),
            dtype=_TYPE,
            dimension_names=("record", "draw"),
            fill_value=np.nan,
            compressors=None,  # draws hardly compress, and so the length of a file tells whether it is whole
            attributes={"units": "m2 s-2"},
        )
    group.create_array("record", data=np.arange(len(time)), dimension_names=("record",))
    if not np.isnat(time).any():
        units = {"units": "nanoseconds since 1970-01-01", "calendar": "proleptic_gregorian"}
        nanoseconds = time.astype("datetime64[ns]").astype(np.int64)
        group.create_array("time", data=nanoseconds, dimension_names=("record",), attributes=units)
    group.attrs.update(dict(attributes))  # last: without them the store is made anew
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zarr warns that other programs may not know consolidated metadata
        zarr.consolidate_metadata(path)
