"""The Parquet tables of a long fit: one file a part and month, each whole or not there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bayes_rs.errors import InputError

MONTH = "month="
"""Begins the name of a folder with the records of one month, as Hive has it."""


def part_files(folder: str | Path, dataset: str) -> list[Path]:
    """Return the files of a Parquet dataset of a long fit, in the order of the records."""
    return sorted((Path(folder) / dataset).glob("**/part-*.parquet"), key=lambda file: (file.name, file.parent.name))


def read_summary(folder: str | Path) -> pd.DataFrame:
    """Read the summary that `fit_campaign` wrote; of an interrupted run, what is finished.

    Parameters
    ----------
    folder : str or Path
        The output folder.

    Returns
    -------
    table : DataFrame
        With the columns of `bayes_rs.summary`, in the order of the records.

    Raises
    ------
    InputError
        If the folder holds no summary.
    """
    if not part_files(folder, "summary"):
        raise InputError(f"No summary in {str(folder)!r}: give the output folder of fit_campaign.")
    return read_tables(folder, "summary")


def read_tables(folder: str | Path, dataset: str, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read a Parquet dataset of a long fit, or some of its columns, as one table in the order of the records."""
    wanted = None if columns is None else list(columns)
    whole = pa.concat_tables([pq.ParquetFile(file).read(wanted) for file in part_files(folder, dataset)])
    return cast("pd.DataFrame", whole.to_pandas())


def files_of_part(
    folder: Path, dataset: str, index: int, time: NDArray[np.datetime64]
) -> list[tuple[Path, NDArray[np.bool_]]]:
    """Return the files of the part `index`, one for each month, and which of its records are in each."""
    name = f"part-{index:06d}.parquet"
    if np.isnat(time).any():
        return [(folder / dataset / name, np.ones(len(time), dtype=np.bool_))]
    month = time.astype("datetime64[M]")
    return [(folder / dataset / f"{MONTH}{one}" / name, month == one) for one in np.unique(month)]


def is_whole(file: Path) -> bool:
    """Tell whether a file is there and readable: what cannot be read is done again."""
    try:
        pq.read_metadata(file)
    except (OSError, pa.ArrowInvalid):
        return False
    return True


def write_table(table: pd.DataFrame, file: Path) -> None:
    """Write a table that appears whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.{os.getpid()}")  # readers of the folder pass over names with a dot
    try:
        table.to_parquet(part, index=False)
        with part.open("rb") as written:
            os.fsync(written.fileno())  # on the disk before it has its name: a power cut leaves no empty part
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def remove_half_written(folder: Path, datasets: Sequence[str]) -> None:
    """Remove what interrupted runs had half written."""
    for name in datasets:
        for leftover in (folder / name).glob("**/.part-*.parquet.*"):
            leftover.unlink(missing_ok=True)
