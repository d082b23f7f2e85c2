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
from bayes_rs.fits.direction_table import directions
from bayes_rs.fits.fitting import fit
from bayes_rs.fits.job_options import JobOptions
from bayes_rs.fits.plan import CampaignOptions
from bayes_rs.fits.result import FLAGS, UNFITTED, check_result, flag_words, group
from bayes_rs.fits.summarizing import summary
from bayes_rs.fits.words import FAILURES, describe, flag_lines, least_seen
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_writing import scan_text
from bayes_rs.output import output_folder, write_csv, write_netcdf, write_run
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.netcdf_check import check_netcdf

POSTERIOR_FILE = "posterior.nc"


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
    flags : list of str
        One line for each flag that some record has: how many have it, and the first.
    """

    result: xr.DataTree
    table: pd.DataFrame
    n_record: int
    n_fitted: int
    failures: list[str]
    words: list[str]
    flags: list[str]


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
        Noise to use; by default it is made for the wind speeds and directions of the records, and for their own length
        scales if they have such.
    turbulence : str
        Turbulence of the noise, if no file is given.
    noise_method : str
        ``"theory"`` or ``"boxes"``, if no file is given.
    prior, target, sampler, likelihood, nuisances, target_ess, instrument_noise
        As for `fit`; noise that is made for an uncertain length scale spans it. Where the nuisances leave the
        uncertainty of the direction to the records, and these do not say it, it is that of `mean_wind`.
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
        If the folder may not be written, another run is writing it, or input does not belong together.
    """
    from bayes_rs.plot.plots import plot_corner, plot_stresses  # noqa: PLC0415 - matplotlib is slow to load

    asked = JobOptions(
        noise_file=noise_file,
        turbulence=turbulence,
        noise_method=noise_method,
        of_fit=CampaignOptions(
            seed=seed,
            prior=prior,
            target=target,
            sampler=sampler,
            likelihood=likelihood,
            nuisances=nuisances,
            target_ess=target_ess,
            instrument_noise=instrument_noise,
            prob=prob,
            derived=derived,
        ),
    )
    with output_folder(output, overwrite=overwrite) as folder:
        clock = [time.perf_counter()]
        noise, records = asked.noise_and_records(records, scan, asked.given_noise(), say)
        clock.append(time.perf_counter())
        result = fit(records, scan, noise=noise, **asked.of_fit.for_fit())
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
            plot_corner(result, int(fitted[0])).savefig(folder / "corner.png", dpi=130)
        clock.append(time.perf_counter())
        names = ("noise", "sampling", "summary", "figures")
        words = [
            *describe(result.attrs["scan"], result.attrs["sight"], asked.of_fit.of_fit.prior, table),
            *least_seen(directions(result, scan)),
        ]
        write_run(
            folder,
            {
                **versions(),
                "source_files": list(source_files),
                "scan": scan.name,
                "scan_key": scan.key,
                "scan_toml": scan_text(scan),
                "scene": {key: _plain(value) for key, value in result.attrs.items() if key != "noise"},
                "noise": json.loads(result.attrs["noise"]),
                **asked.for_run(noise, records),
                "prior_option": prior,
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
                "words": words,
            },
        )
    failures = [
        f"{_record_name(result, index)}: {flag_words(flags[index])}"
        for index in np.flatnonzero(flags & FAILURES).tolist()
    ]
    told = flag_lines(flags, lambda index: _record_name(result, index))
    return Outcome(result, table, len(flags), len(fitted), failures, words, told)


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
        check_netcdf(path, guarded=True)
        tree = xr.open_datatree(path, engine="h5netcdf")
        loaded = tree.load()
        tree.close()
    except InputError:
        raise
    except UNREADABLE as error:
        raise InputError(f"File {str(path)!r} cannot be read as a result: {error}; run the fit again.") from error
    return check_result(loaded)


def _record_name(result: xr.DataTree, index: int) -> str:
    coords = group(result, "observed_data").coords
    start = f" ({np.datetime_as_string(coords['time'].values[index], unit='m')})" if "time" in coords else ""
    return f"record {index}{start}"


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
