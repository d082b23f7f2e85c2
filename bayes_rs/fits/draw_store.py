"""Draws of a long fit as a Zarr store: one chunk a part and stress, so that parts are written apart."""

from __future__ import annotations

import importlib
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs.errors import MissingExtraError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.result_folder import ResultFolder

STORE = "draws.zarr"
"""The store, in the folder of results."""
_TYPE = "float32"
_BYTES = "<f4"  # as Zarr writes it, uncompressed


@dataclass(frozen=True)
class DrawStore:
    """An open store.

    Parameters
    ----------
    folder : ResultFolder
        The folder of results that it is in.
    n_draw : int
        Draws of a record.
    part_records : int
        Records of a part.
    """

    folder: ResultFolder
    n_draw: int
    part_records: int

    def write(self, index: int, draws: NDArray[np.float32]) -> None:
        """Write the draws of one part, shape (n_record, n_draw, 6); they are on the disk when this returns."""
        chunk = np.full((self.part_records, self.n_draw, len(STRESSES)), np.nan, dtype=_TYPE)
        chunk[: len(draws)] = draws
        for number, name in enumerate(STRESSES):
            self.folder.write_bytes(_chunk(name, index), chunk[:, :, number].astype(_BYTES).tobytes())

    def has(self, index: int) -> bool:
        """Tell whether the chunks of a part are there, with the bytes that were written."""
        return not any(self.folder.damage(_chunk(name, index)) for name in STRESSES)


def _chunk(name: str, index: int) -> str:
    return f"{STORE}/{name}/c/{index}/0"


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
    folder: ResultFolder, *, time: NDArray[np.datetime64], n_draw: int, part_records: int, attributes: Mapping[str, Any]
) -> DrawStore:
    """Open the store of a run that was interrupted, or make it.

    Parameters
    ----------
    folder : ResultFolder
        The folder of results that it is in; a store in it that is not of this run is replaced.
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
    with tempfile.TemporaryDirectory() as place:
        empty = Path(place) / STORE
        _make(zarr, empty, time, n_draw, part_records, attributes)
        files = {f"{STORE}/{file.relative_to(empty).as_posix()}": file for file in empty.rglob("*") if file.is_file()}
        fresh = {name: file.read_bytes() for name, file in sorted(files.items())}
    if not all(folder.lists(name, content) for name, content in fresh.items()):  # of another run, or none
        for name in folder.names(f"{STORE}/"):
            folder.remove(name)
    for name, content in fresh.items():
        if folder.damage(name):
            folder.write_bytes(name, content)
    return DrawStore(folder, n_draw, part_records)


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
            compressors=None,  # draws hardly compress, and so the bytes of a chunk are those of its numbers
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
