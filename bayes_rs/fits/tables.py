"""The Parquet tables of a fit: one file a part and month, each whole, and with the bytes that were written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import cast

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bayes_rs.result_folder import ResultFolder

MONTH = "month="
"""Begins the name of a folder with the records of one month, as Hive has it."""


def part_names(folder: ResultFolder, dataset: str) -> list[str]:
    """Return the files of a Parquet dataset that a folder lists, in the order of the records."""
    found = [name for name in folder.names(f"{dataset}/") if name.endswith(".parquet")]
    return sorted(found, key=lambda name: name.split("/")[::-1])


def read_table(folder: ResultFolder, names: Iterable[str], columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read Parquet files of a folder as one table.

    Parameters
    ----------
    folder : ResultFolder
        The folder.
    names : iterable of str
        Its files, at least one.
    columns : sequence of str, optional
        Columns to read; by default all.

    Returns
    -------
    table : DataFrame
        The rows of all files, one after the other.

    Raises
    ------
    InputError
        If a file is not what was written.

    Notes
    -----
    The bytes that are compared with the fingerprint are those that are read.
    """
    wanted = None if columns is None else list(columns)
    tables = [pq.ParquetFile(pa.BufferReader(folder.read(name))).read(wanted) for name in names]
    return cast("pd.DataFrame", pa.concat_tables(tables).to_pandas())


def names_of_part(dataset: str, index: int, time: NDArray[np.datetime64]) -> list[tuple[str, NDArray[np.bool_]]]:
    """Return the files of the part `index`, one for each month, and which of its records are in each."""
    name = f"part-{index:06d}.parquet"
    if np.isnat(time).any():
        return [(f"{dataset}/{name}", np.ones(len(time), dtype=np.bool_))]
    month = time.astype("datetime64[M]")
    return [(f"{dataset}/{MONTH}{one}/{name}", month == one) for one in np.unique(month)]


def write_table(folder: ResultFolder, name: str, table: pd.DataFrame) -> None:
    """Write a table as Parquet: whole or not at all, and the same bytes for the same table.

    Raises
    ------
    OSError
        If it cannot be written, as on a full disk.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pandas(table, preserve_index=False), sink)
    folder.write_bytes(name, sink.getvalue().to_pybytes())
