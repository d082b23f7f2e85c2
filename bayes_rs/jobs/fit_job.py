"""The main job: records in, a folder of results out."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._version import __version__
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.model import NoiseBank, NoiseModel
from bayes_rs.noise.reading import load_noise
from bayes_rs.output import output_folder, write_csv, write_netcdf, write_run
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.netcdf_check import check_netcdf
from bayes_rs.results.direction_table import direction_words, directions
from bayes_rs.results.fitting import fit
from bayes_rs.results.result import FLAGS, UNFITTED, check_result, flag_words, group
from bayes_rs.results.summarizing import check_summary_options, summary

POSTERIOR_FILE = "posterior.nc"
FAILURES = (
    FLAGS["no_usable_beam"]
    | FLAGS["no_wind"]
    | FLAGS["short_chain"]
    | FLAGS["ensembles_differ"]
    | FLAGS["weights_uneven"]
    | FLAGS["likelihood_failed"]
)
"""Flags that count as a failure of a record; the others are remarks."""


@dataclass(frozen=True)
class Outcome:
    """What came of a fit.

    Parameters
    ----------
    result : DataTree
        The result of `fit`.
    table : DataFrame
        Its summary.
    n_record, n_fitted : int
        Records that went in, and those that have a posterior.
    failures : list of str
        One line for each record that was not fitted or whose chain fell short.
    words : list of str
        What the scan sees, which prior it was, and what the data said beyond the prior.
    """

    result: xr.DataTree
    table: pd.DataFrame
    n_record: int
    n_fitted: int
    failures: list[str]
    words: list[str]


def run_fit(
    records: xr.Dataset,
    scan: Scan,
    output: str | Path,
    *,
    noise_file: str | Path | None = None,
    turbulence: str = "fu-2022",
    noise_method: str = "theory",
    prior: str = "weak",
    target: str = "record",
    sampler: str = "emcee",
    likelihood: str = "log-normal",
    nuisances: Nuisances | None = None,
    target_ess: int = 1000,
    instrument_noise: float | str = 0.0,
    prob: float = 0.9,
    derived: Sequence[str] = (),
    seed: int = 1,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
    source_files: Sequence[str] = (),
) -> Outcome:
    """Fit records and write the folder of results.

    Parameters
    ----------
    records : Dataset
        From `make_records`.
    scan : Scan
        The scan that measured them.
    output : str or Path
        Folder to make, with ``posterior.nc``, ``summary.csv``, ``records.nc``, ``stresses.png``, ``corner.png`` and
        ``run.json``.
    noise_file : str or Path, optional
        Noise to use; by default it is made for the wind speeds and directions of the records.
    turbulence : str
        Turbulence of the noise, if no file is given.
    noise_method : str
        ``"theory"`` or ``"boxes"``, if no file is given.
    prior, target, sampler, likelihood, nuisances, target_ess, instrument_noise
        As for `fit`; noise that is made for an uncertain length scale spans it.
    prob, derived
        As for `summary`.
    seed : int
        Seed of the fit.
    overwrite : bool
        Replace the folder of an earlier run.
    say : callable
        Takes lines that tell what is being done.
    source_files : sequence of str
        Names of the files that the records came from, for ``run.json``.

    Returns
    -------
    outcome : Outcome
        Result, summary and failures.

    Raises
    ------
    InputError
        If the folder may not be written, or input does not belong together.
    """
    from bayes_rs.results.plots import plot_corner, plot_stresses  # noqa: PLC0415 - matplotlib is slow to load

    check_summary_options(prob, derived)
    with output_folder(output, overwrite=overwrite) as folder:
        clock = [time.perf_counter()]
        noise = noise_of_job(
            records,
            scan,
            noise_file=noise_file,
            turbulence=turbulence,
            method=noise_method,
            sonic=target == "sonic",
            nuisances=nuisances,
            say=say,
        )
        clock.append(time.perf_counter())
        result = fit(
            records,
            scan,
            noise=noise,
            seed=seed,
            prior=prior,
            target=target,
            sampler=sampler,
            likelihood=likelihood,
            nuisances=nuisances,
            target_ess=target_ess,
            instrument_noise=instrument_noise,
        )
        clock.append(time.perf_counter())
        write_netcdf(result, folder / POSTERIOR_FILE)
        write_netcdf(records, folder / "records.nc")
        table = summary(result, prob=prob, derived=derived)
        write_csv(table, folder / "summary.csv", index=False, date_format="%Y-%m-%dT%H:%M:%S")
        clock.append(time.perf_counter())
        flags = group(result, "sample_stats")["flag"].values
        fitted = np.flatnonzero((flags & UNFITTED) == 0)
        plot_stresses(result, prob=prob).savefig(folder / "stresses.png", dpi=130)
        if len(fitted):
            plot_corner(result, int(fitted[0])).savefig(folder / "corner.png", dpi=130)  # type: ignore[attr-defined]
        clock.append(time.perf_counter())
        names = ("noise", "sampling", "summary", "figures")
        write_run(
            folder,
            {
                **versions(),
                "source_files": list(source_files),
                "scan": scan.name,
                "scan_key": scan.key,
                "scene": {key: _plain(value) for key, value in result.attrs.items() if key != "noise"},
                "noise": json.loads(result.attrs["noise"]),
                "sampler": sampler,
                "likelihood": likelihood,
                "nuisances": result.attrs["nuisances"],
                "instrument_noise": instrument_noise,
                "n_record": len(flags),
                "n_fitted": len(fitted),
                "flags": {word: int(np.count_nonzero(flags & bit)) for word, bit in FLAGS.items()},
                "seconds": {
                    name: round(end - start, 3) for name, start, end in zip(names, clock, clock[1:], strict=False)
                },
            },
        )
    failures = [
        f"{_record_name(result, index)}: {flag_words(flags[index])}"
        for index in np.flatnonzero(flags & FAILURES).tolist()
    ]
    return Outcome(result, table, len(flags), len(fitted), failures, _words(result, scan, make_prior(prior), table))


def versions() -> dict[str, Any]:
    """Return what `run.json` says of the software."""
    return {
        "bayes_rs": __version__,
        "python": platform.python_version(),
        "packages": {name: version(name) for name in ("emcee", "numpy", "scipy", "xarray")},
    }


def open_result(folder: str | Path) -> xr.DataTree:
    """Read the result from the folder that `run_fit` wrote.

    Parameters
    ----------
    folder : str or Path
        Output folder of a fit.

    Returns
    -------
    result : DataTree
        As `fit` returned it, in memory; the file is closed.

    Raises
    ------
    InputError
        If the folder holds no result, or one that cannot be read.
    """
    path = Path(folder) / POSTERIOR_FILE
    if (Path(folder) / "summary").is_dir() and not path.exists():
        raise InputError(
            f"No full result in {str(folder)!r}: it holds the tables of a long fit; read them with pandas, or fit the "
            "records of interest with --draws full."
        )
    if not path.is_file():
        raise InputError(
            f"No result in {str(folder)!r}: it has no {POSTERIOR_FILE}; give the output folder of bayes-rs fit."
        )
    try:
        check_netcdf(path)
        tree = xr.open_datatree(path, engine="h5netcdf")
        loaded = tree.load()
        tree.close()
    except InputError:
        raise
    except UNREADABLE as error:
        raise InputError(f"File {str(path)!r} cannot be read as a result: {error}; run the fit again.") from error
    return check_result(loaded)


def open_records(path: str | Path, scan: Scan) -> xr.Dataset | None:
    """Read records that were written before; None if the file is something else, such as radial velocities.

    Raises
    ------
    InputError
        If the records were made with another scan.
    """
    file = Path(path)
    if file.suffix not in (".nc", ".nc4") or not file.is_file():
        return None
    try:
        check_netcdf(file)
        dataset = xr.load_dataset(file, engine="h5netcdf")
    except UNREADABLE:
        return None  # the reader of radial velocities says what is wrong with it
    if dataset.get("variance", xr.DataArray()).dims != ("record", "beam"):
        return None
    key = dataset.attrs.get("scan_key", scan.key)
    if key != scan.key:
        raise InputError(
            f"The records in {str(file)!r} were made with another scan, {dataset.attrs.get('scan', '?')!r}, than "
            f"{scan.name!r}: name that scan, with the same options."
        )
    return dataset


def open_record_files(paths: Sequence[str | Path], scan: Scan) -> xr.Dataset | None:
    """Read records that were written before, of one file or several; None if they are something else.

    Raises
    ------
    InputError
        If the records were made with another scan, or those of several files do not go together.
    """
    found: list[xr.Dataset] = []
    for path in paths:
        records = open_records(path, scan)
        if records is None:
            return None
        found.append(records)
    first = found[0]
    for path, records in zip(paths, found, strict=True):
        for what, one, other in (
            ("beams", first["beam"].values.tolist(), records["beam"].values.tolist()),
            ("duration", first.attrs.get("duration"), records.attrs.get("duration")),
        ):
            if one != other:
                raise InputError(
                    f"The records in {str(path)!r} have {what} {other} and those in {str(paths[0])!r} {one}: fit them "
                    "separately."
                )
    if len(found) == 1:
        return first
    joined = xr.concat(
        found,
        dim="record",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    )
    joined = joined.drop_encoding()  # the first file's unit of time need not suit the others
    joined.attrs.pop("records_report", None)  # it is that of the first file
    if "time" in joined.coords and joined.indexes.get("time") is None:
        again = joined["time"].to_series().duplicated().to_numpy()
        if again.any():
            raise InputError(
                f"{np.count_nonzero(again)} records start at the same time as another, the first at "
                f"{joined['time'].values[again][0]}: give every file once, and files that do not overlap."
            )
    return joined


def noise_of_job(
    records: xr.Dataset,
    scan: Scan,
    *,
    noise_file: str | Path | None,
    turbulence: str,
    method: str,
    sonic: bool,
    nuisances: Nuisances | None,
    say: Callable[[str], None],
) -> NoiseModel | NoiseBank:
    """Read the noise, or make it for the records, and say which it is."""
    if noise_file is not None:
        return load_noise(noise_file)
    from bayes_rs.calibration.choice import noise_for_records  # noqa: PLC0415 - not needed with a file
    from bayes_rs.turbulence.mann import load_turbulence  # noqa: PLC0415 - nor this

    flow = load_turbulence(turbulence)
    noise, words = noise_for_records(
        records,
        scan.select(records["beam"].values),
        flow,
        method=method,
        sonic=sonic,
        length_scale=_length_scales(records, nuisances),
    )
    say(words)
    return noise


def _length_scales(records: xr.Dataset, nuisances: Nuisances | None) -> list[float] | None:
    """Return the shortest and longest L that the posterior is averaged over; None if L is certain."""
    if nuisances is None or nuisances.length_scale_log_sd == 0.0:
        return None
    median = records.get("length_scale") if nuisances.length_scale is None else xr.DataArray(nuisances.length_scale)
    if median is None:
        return None  # not certain, but its median is not known: the fit says so
    factors = nuisances.length_scale_nodes()[0]
    return [float(median.min() * factors.min()), float(median.max() * factors.max())]


def _words(result: xr.DataTree, scan: Scan, prior: Prior, table: pd.DataFrame) -> list[str]:
    lines = describe(result.attrs["scan"], result.attrs["sight"], prior, table)
    return lines + _least_seen(result, scan)


def _least_seen(result: xr.DataTree, scan: Scan) -> list[str]:
    """Say along which direction of R the scan sees least, and how far the posterior contracted there."""
    columns = ["weight", "contraction", "contraction_shape", *STRESSES]
    along = directions(result, scan).groupby("direction")[columns].median().dropna()
    if along.empty:
        return []
    unseen = int((along["weight"] == 0.0).sum())
    last = along.sort_values(["weight", "contraction_shape"]).iloc[0]
    which = direction_words(last[list(STRESSES)].to_numpy(dtype=np.float64))
    how = {0: "", 1: " (not at all)"}.get(unseen, f" (one of {unseen} that it does not see)")
    numbers = f"{last['contraction']:.2f}, of the shape {last['contraction_shape']:.2f}"
    return [f"contraction along what the scan sees least, {which}{how}: {numbers}"]


def describe(scan: str, sight: str, prior: Prior, table: pd.DataFrame) -> list[str]:
    """Say what the scan sees, which prior it was, and how much narrower the posterior is than the prior."""
    lines = [f"scan {scan}: {sight}", f"prior {prior.in_words()}"]
    rows = table[table["stress"].isin(STRESSES) & table["mean"].notna()]
    if len(rows):
        prob = float(rows["prob"].iloc[0])
        posterior = (rows["hdi_high"] - rows["hdi_low"]).groupby(rows["stress"]).median().loc[list(STRESSES)]
        for whose, widths in (("the prior", prior.interval_widths(prob)), ("the posterior (median record)", posterior)):
            numbers = ", ".join(f"{name} {width:.3g}" for name, width in zip(STRESSES, widths, strict=True))
            lines.append(f"width of the {100.0 * prob:g} % interval under {whose}, m² s⁻²: {numbers}")
        middle = rows.groupby("stress")[["contraction", "contraction_shape"]].median().loc[list(STRESSES)]
        for column, meaning in (
            ("contraction", "of the stresses"),
            ("contraction_shape", "of their shape, size taken out"),
        ):
            numbers = ", ".join(f"{name} {value:.2f}" for name, value in middle[column].items())
            lines.append(f"contraction against the prior (1: the data decided, 0: the prior did) {meaning}: {numbers}")
    return lines


def _record_name(result: xr.DataTree, index: int) -> str:
    coords = group(result, "observed_data").coords
    start = f" ({np.datetime_as_string(coords['time'].values[index], unit='m')})" if "time" in coords else ""
    return f"record {index}{start}"


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
