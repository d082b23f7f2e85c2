"""What the output folder of a fit holds, whichever kind it is."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.campaign import PRIOR_FILE
from bayes_rs.fits.direction_table import directions
from bayes_rs.fits.draw_store import check_zarr
from bayes_rs.fits.fit_job import POSTERIOR_FILE, open_result
from bayes_rs.fits.parts import directions_of
from bayes_rs.fits.result import group
from bayes_rs.fits.summarizing import DIAGNOSTICS, summary
from bayes_rs.fits.tables import part_names, read_summary, read_table, read_tables
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.models import preset_names
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.netcdf_check import check_netcdf
from bayes_rs.result_folder import RUN_FILE, ResultFolder, open_result_folder

NUMBERS = ("median", "hdi_low", "hdi_high", "mean", "sd", "contraction", "contraction_shape", *DIAGNOSTICS)
"""Columns of the summary that the page shows."""
_N_PRIOR_SHAPE = 2000


@dataclass(frozen=True)
class FitFolder:
    """What a fit wrote, as arrays over its records.

    Parameters
    ----------
    run : dict
        Content of ``run.json``.
    records : Dataset or None
        The records that were fitted, if the folder keeps them.
    prob : float
        Probability of the intervals.
    record, time, flag, wind_speed : ndarray, shape (n_record,)
        Number, start (NaT if there is none), flag bits, and mean wind speed, m/s (NaN if not known).
    numbers : dict of str to ndarray, shape (n_record, 6)
        `NUMBERS` of the six stresses.
    derived : dict of str to dict
        Median and interval, each of shape (n_record,), of the derived quantities.
    per_record : dict of str to ndarray, shape (n_record,)
        ``pareto_k`` and ``misfit``.
    covariance : ndarray, shape (n_record, 6, 6)
        Posterior covariances of the stresses, m⁴ s⁻⁴.
    draws : callable or None
        Gives so many draws of every record, shape (n_record, n, 6); None if they were not kept.
    prior_shape : ndarray of shape (n, 6), or None
        Draws of R over its trace under the prior; None of tables of an earlier version.
    directions : DataFrame or None
        As from `bayes_rs.directions`; None of a result whose scan, or tables whose directions, were not kept.
    sight, prior, target : str
        In words.
    """

    run: dict[str, Any]
    records: xr.Dataset | None
    prob: float
    record: NDArray[np.int64]
    time: NDArray[np.datetime64]
    flag: NDArray[np.int64]
    wind_speed: FloatArray
    numbers: dict[str, FloatArray]
    derived: dict[str, dict[str, FloatArray]]
    per_record: dict[str, FloatArray]
    covariance: FloatArray
    draws: Callable[[int], FloatArray] | None
    prior_shape: FloatArray | None
    directions: pd.DataFrame | None
    sight: str
    prior: str
    target: str

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """Which records have a posterior, shape (n_record,)."""
        return np.asarray(np.isfinite(self.numbers["mean"]).all(axis=1))


def read_folder(folder: str | Path, *, prob: float | None = None) -> FitFolder:
    """Read the output folder of `run_fit`, `run_long_fit` or `fit_campaign`.

    Parameters
    ----------
    folder : str or Path
        The folder.
    prob : float, optional
        Probability of the intervals; by default that of the folder's summary. Another one needs all draws.

    Returns
    -------
    found : FitFolder
        What it holds.

    Raises
    ------
    InputError
        If it is not such a folder, something in it cannot be read, or it has no draws for another probability.
    """
    path = Path(folder)
    run = _read_run(path)
    if (path / POSTERIOR_FILE).is_file():
        return _of_result(path, run, prob)
    if (path / "summary").is_dir() and (path / "posterior").is_dir():
        return _of_tables(path, run, prob)
    raise InputError(
        f"No fit in {str(path)!r}: it has neither {POSTERIOR_FILE} nor the tables summary and posterior; give the "
        "output folder of bayes-rs fit."
    )


def _of_result(path: Path, run: dict[str, Any], prob: float | None) -> FitFolder:
    result = open_result(path)
    own, derived = _summary_options(path)
    prob = own if prob is None else prob
    table = summary(result, prob=prob, derived=tuple(dict.fromkeys(("ti", *derived))))
    observed, stats = group(result, "observed_data"), group(result, "sample_stats")
    stress = group(result, "posterior")["stress"].transpose("record", "chain", "draw", "component").values
    flat = stress.reshape(len(stress), -1, len(STRESSES))
    prior = group(result, "prior")["stress"].values.reshape(-1, len(STRESSES))[:_N_PRIOR_SHAPE]
    scan = _scan_of(run)
    n_record = len(flat)
    return FitFolder(
        run=run,
        records=_read_records(path, n_record),
        prob=prob,
        record=observed["record"].values,
        time=_times(observed, n_record),
        flag=stats["flag"].values.astype(np.int64),
        wind_speed=observed["wind_speed"].values,
        numbers=_numbers(table, n_record),
        derived=_derived(table),
        per_record={
            name: stats[name].values.astype(np.float64) if name in stats else np.full(n_record, np.nan)
            for name in ("pareto_k", "misfit")
        },
        covariance=np.array([np.cov(draws, rowvar=False) for draws in flat]),
        draws=lambda n: flat[:, _evenly(flat.shape[1], n)],
        prior_shape=_shape(prior),
        directions=None if scan is None else directions(result, scan),
        sight=str(result.attrs["sight"]),
        prior=str(result.attrs["prior"]),
        target=str(result.attrs["target"]),
    )


def _of_tables(path: Path, run: dict[str, Any], prob: float | None) -> FitFolder:
    table, rows = _read_tables(path)
    own = float(table["prob"].iloc[0])
    if prob is not None and prob != own:
        raise InputError(
            f"Invalid prob {prob!r}: the tables in {str(path)!r} hold intervals of {own:g}; leave it out, or fit again "
            "with --prob."
        )
    n_record = len(rows)
    records = _read_records(path, n_record)
    speed = None if records is None else records.get("wind_speed")
    wind_speed = np.full(n_record, np.nan) if speed is None else speed.values.astype(np.float64)
    numbers = _numbers(table, n_record)
    derived = _derived(table)
    if "ti" not in derived and np.isfinite(wind_speed).any():
        speed_or_none = np.where(wind_speed > 0.0, wind_speed, np.nan)
        derived["ti"] = {
            name: np.sqrt(numbers[column][:, 0]) / speed_or_none
            for name, column in (("median", "median"), ("low", "hdi_low"), ("high", "hdi_high"))
        }
    return FitFolder(
        run=run,
        records=records,
        prob=own,
        record=rows["record"].to_numpy(),
        time=rows["time"].to_numpy().astype("datetime64[ns]"),
        flag=rows["flag_bits"].to_numpy().astype(np.int64),
        wind_speed=wind_speed,
        numbers=numbers,
        derived=derived,
        per_record={name: rows[name].to_numpy().astype(np.float64) for name in ("pareto_k", "misfit")},
        covariance=_covariances(rows),
        draws=_stored_draws(path, rows["record"].to_numpy()),
        prior_shape=_prior_shape(path),
        directions=directions_of(rows, run),
        sight=str(run["sight"]) if "sight" in run else _sight_of_preset(run, records),
        prior=str(run.get("prior", "")),
        target=str(run.get("target", "")),
    )


def _read_tables(path: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return summary and posterior of the records that are in both: an interrupted run may have more of one."""
    try:
        table = read_summary(path)
        rows = read_tables(path, "posterior")
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"The tables in {str(path)!r} cannot be read: {error}; resume or repeat the fit.") from error
    table = table[table["record"].isin(rows["record"])]
    rows = rows[rows["record"].isin(table["record"])]
    if not len(rows):
        raise InputError(f"The tables in {str(path)!r} have no record in common: resume or repeat the fit.")
    return table, rows.reset_index(drop=True)


def _read_run(path: Path) -> dict[str, Any]:
    if not path.is_dir():
        raise InputError(f"No folder {str(path)!r}: give the output folder of bayes-rs fit.")
    file = path / RUN_FILE
    if not file.is_file():
        raise InputError(
            f"No fit in {str(path)!r}: it has no {RUN_FILE}; give the output folder of a bayes-rs fit that has ended."
        )
    try:
        run = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"File {str(file)!r} cannot be read: {error}; run the fit again.") from error
    if not isinstance(run, dict):
        raise InputError(f"File {str(file)!r} is not of a fit: it must hold an object; run the fit again.")
    return run


def _read_records(path: Path, n_record: int) -> xr.Dataset | None:
    file = path / "records.nc"
    if not file.is_file():
        return None
    try:
        check_netcdf(file, guarded=True)
        records = xr.load_dataset(file, engine="h5netcdf")
    except InputError:
        raise
    except UNREADABLE as error:
        raise InputError(f"File {str(file)!r} cannot be read: {error}; run the fit again.") from error
    if records.sizes.get("record") != n_record:
        raise InputError(
            f"File {str(file)!r} holds {records.sizes.get('record', 0)} records and the fit {n_record}: it is of "
            "another run; run the fit again."
        )
    return records


def _summary_options(path: Path) -> tuple[float, list[str]]:
    """Return the probability and the derived quantities of the folder's summary."""
    file = path / "summary.csv"
    if not file.is_file():
        return 0.9, []
    try:
        table = pd.read_csv(file, usecols=["stress", "prob"])
    except ValueError as error:
        raise InputError(f"File {str(file)!r} cannot be read as a summary: {error}; run the fit again.") from error
    names = [name for name in table["stress"].unique() if name not in STRESSES]
    return (float(table["prob"].iloc[0]) if len(table) else 0.9), names


def _numbers(table: pd.DataFrame, n_record: int) -> dict[str, FloatArray]:
    rows = table[table["stress"].isin(STRESSES)]  # six rows a record, in the order of STRESSES
    return {name: rows[name].to_numpy(dtype=np.float64).reshape(n_record, len(STRESSES)) for name in NUMBERS}


def _derived(table: pd.DataFrame) -> dict[str, dict[str, FloatArray]]:
    columns = {"median": "median", "low": "hdi_low", "high": "hdi_high"}
    return {
        str(name): {ours: rows[theirs].to_numpy(dtype=np.float64) for ours, theirs in columns.items()}
        for name, rows in table.groupby("stress", sort=False)
        if name not in STRESSES
    }


def _times(observed: xr.Dataset, n_record: int) -> NDArray[np.datetime64]:
    if "time" in observed.coords and np.issubdtype(observed["time"].dtype, np.datetime64):
        return np.asarray(observed["time"].values.astype("datetime64[ns]"))
    return np.full(n_record, np.datetime64("NaT", "ns"))


def _scan_of(run: dict[str, Any]) -> Scan | None:
    """Return the scan of a run; of a version that did not keep it, only one that comes with the package."""
    text = run.get("scan_toml")
    if isinstance(text, str):
        with tempfile.TemporaryDirectory() as place:
            file = Path(place) / "scan.toml"
            file.write_text(text, encoding="utf-8")
            try:
                return load_scan(file)
            except InputError as error:
                raise InputError(f"The scan_toml in {RUN_FILE} cannot be read: {error}") from error
    if run.get("scan") not in preset_names("scans"):
        return None
    scan = load_scan(run["scan"])
    return scan if scan.key == run.get("scan_key") else None


def _sight_of_preset(run: dict[str, Any], records: xr.Dataset | None) -> str:
    """Say what the scan sees where an earlier version did not; empty if the scan is not known."""
    scan = _scan_of(run)
    if scan is not None and records is not None:
        scan = scan.select(records["beam"].values)
    return "" if scan is None else sight(scan).in_words()


def _prior_shape(path: Path) -> FloatArray | None:
    """Return draws of the prior's shape that a long fit kept; None if it is of a version that did not."""
    file = path / PRIOR_FILE
    if not file.is_file():
        return None
    try:
        draws = pd.read_parquet(file, columns=list(STRESSES)).to_numpy(dtype=np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"File {str(file)!r} cannot be read: {error}; resume or repeat the fit.") from error
    return _shape(draws)


def _shape(stress: FloatArray) -> FloatArray:
    return np.asarray(stress / stress[:, :3].sum(axis=1, keepdims=True))


def _covariances(rows: pd.DataFrame) -> FloatArray:
    matrix = np.empty((len(rows), len(STRESSES), len(STRESSES)))
    for i, one in enumerate(STRESSES):
        for j, other in enumerate(STRESSES[i:], start=i):
            matrix[:, i, j] = matrix[:, j, i] = rows[f"cov_{one}_{other}"].to_numpy()
    return matrix


def _evenly(n_all: int, n: int) -> NDArray[np.int64]:
    return np.linspace(0, n_all - 1, min(n, n_all)).round().astype(np.int64)


def _stored_draws(path: Path, record: NDArray[np.int64]) -> Callable[[int], FloatArray] | None:
    """Return how to read the draws of a long fit; None if it kept none, or none that can be read here."""
    folder = open_result_folder(path)
    if part_names(folder, "draws"):
        return lambda n: _draws_of_tables(folder, record, n)
    store = path / "draws.zarr"
    if store.is_dir() and find_spec("zarr") is not None:
        return lambda n: _draws_of_store(store, record, n)
    return None


def _draws_of_tables(folder: ResultFolder, record: NDArray[np.int64], n: int) -> FloatArray:
    found = np.full((len(record), n, len(STRESSES)), np.nan)
    for part in part_names(folder, "draws"):
        table = read_table(folder, [part])
        values = table[list(STRESSES)].to_numpy(dtype=np.float64)
        number = table["record"].to_numpy()
        starts = np.flatnonzero(np.diff(number, prepend=-1))  # a record's draws stand together
        for first, last in pairwise([*starts.tolist(), len(number)]):
            place = int(np.searchsorted(record, number[first]))
            if place < len(record) and record[place] == number[first]:
                some = first + _evenly(last - first, n)
                found[place, : len(some)] = values[some]
    return found


def _draws_of_store(store: Path, record: NDArray[np.int64], n: int) -> FloatArray:
    group = check_zarr().open_group(store, mode="r", zarr_format=3)
    n_draw = group[STRESSES[0]].shape[1]
    some = _evenly(n_draw, n)
    return np.stack([np.asarray(group[name][:], dtype=np.float64)[record][:, some] for name in STRESSES], axis=-1)
