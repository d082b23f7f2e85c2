"""The Parquet tables of a fit: one file a part and month, each whole, and with the bytes that were written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bayes_rs.errors import InputError
from bayes_rs.layouts import check_table
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.result_folder import ResultFolder

ADVICE = "resume the fit to make it again, or, if its list of files knows it so, begin anew with overwrite"
"""What to do with a file of a fit that cannot be used."""
MONTH = "month="
"""Begins the name of a folder with the records of one month, as Hive has it."""


def part_names(folder: ResultFolder, dataset: str) -> list[str]:
    """Return the files of a Parquet dataset that a folder lists, in the order of the records."""
    found = [name for name in folder.names(f"{dataset}/") if name.endswith(".parquet")]
    return sorted(found, key=lambda name: name.split("/")[::-1])


def read_table(folder: ResultFolder, names: Iterable[str], layout: Mapping[str, str]) -> pd.DataFrame:
    """Read Parquet files of a folder as one table.

    Parameters
    ----------
    folder : ResultFolder
        The folder.
    names : iterable of str
        Its files, at least one.
    layout : mapping of str to str
        Columns to read, and what they hold.

    Returns
    -------
    table : DataFrame
        The rows of all files, one after the other.

    Raises
    ------
    InputError
        If a file is not what was written, or not laid out so.

    Notes
    -----
    The bytes that are compared with the fingerprint are those that are read.
    """
    parts = [_read_part(folder.read(name), folder.path / name, layout) for name in names]
    joined = pa.concat_tables(parts, promote_options="permissive")
    del parts
    # the columns of Arrow go as those of pandas come: a table of a million records is in memory once
    return cast("pd.DataFrame", joined.to_pandas(ignore_metadata=True, split_blocks=True, self_destruct=True))


def _read_part(content: bytes, file: Path, layout: Mapping[str, str]) -> pa.Table:
    what = f"File {str(file)!r}"
    try:
        table = pq.ParquetFile(pa.BufferReader(content)).read(list(layout))
        check_table(table, layout, what=what, advice=ADVICE)
        return table.select(list(layout))
    except InputError:
        raise
    except (*UNREADABLE, pa.ArrowException) as error:
        raise InputError(f"{what} cannot be read as Parquet: {str(error).splitlines()[0][:200]}; {ADVICE}.") from error


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
