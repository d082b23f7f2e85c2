"""The main job for a long campaign: many records in, a folder of tables out."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import xarray as xr

from bayes_rs.campaign import Campaign, fit_campaign
from bayes_rs.forward import sight
from bayes_rs.job import FAILURES, describe, noise_of_job, versions
from bayes_rs.nuisance import Nuisances
from bayes_rs.output import RUN_FILE, output_file, write_run
from bayes_rs.prior import make_prior
from bayes_rs.result import flag_words
from bayes_rs.scan import Scan

MOST_FULL = 2000
"""Records up to which a NetCDF file of the whole result is offered: about 0.1 MB each."""
MOST_CSV = 20_000
"""Records up to which the summary is written as CSV, too."""
_LISTED = 20
"""Failures that are listed one by one."""


@dataclass(frozen=True)
class LongOutcome:
    """What came of a long fit.

    Parameters
    ----------
    campaign : Campaign
        Where the tables are, and the counts.
    n_record, n_fitted : int
        Records that went in, and those that have a posterior.
    failures : list of str
        One line for each record that was not fitted or whose chain fell short; of many, the first and their number.
    words : list of str
        What the scan sees, which prior it was, and what the data said beyond the prior.
    """

    campaign: Campaign
    n_record: int
    n_fitted: int
    failures: list[str]
    words: list[str]


def run_long_fit(
    records: xr.Dataset,
    scan: Scan,
    output: str | Path,
    *,
    noise_file: str | Path | None = None,
    turbulence: str = "fu-2022",
    noise_method: str = "theory",
    prior: str = "weak",
    target: str = "record",
    sampler: str = "auto",
    likelihood: str = "log-normal",
    nuisances: Nuisances | None = None,
    target_ess: int = 1000,
    instrument_noise: float = 0.0,
    prob: float = 0.9,
    derived: Sequence[str] = (),
    draws: str = "none",
    workers: int = 1,
    seed: int = 1,
    resume: bool = False,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
    source_files: Sequence[str] = (),
) -> LongOutcome:
    """Fit any number of records and write the folder of results.

    Parameters
    ----------
    records, scan, noise_file, turbulence, noise_method, say, source_files
        As for `run_fit`.
    output : str or Path
        Folder to make, with the Parquet datasets of `fit_campaign`, ``records.nc``, ``run.json`` and, up to 20 000
        records, ``summary.csv``.
    prior, target, sampler, likelihood, nuisances, target_ess, instrument_noise, prob, derived, draws, workers
        As for `fit_campaign`.
    seed : int
        Seed of the fit.
    resume, overwrite : bool
        Go on with an interrupted run, or replace the folder of an earlier one.

    Returns
    -------
    outcome : LongOutcome
        Counts and failures.

    Raises
    ------
    InputError
        If the folder may not be written, or input does not belong together.
    WorkerError
        If worker processes die again and again.
    """
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
    campaign = fit_campaign(
        records,
        scan,
        output,
        noise=noise,
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
        draws=draws,
        workers=workers,
        resume=resume,
        overwrite=overwrite,
    )
    clock.append(time.perf_counter())
    if campaign.n_resumed:
        say(f"{campaign.n_resumed} of {campaign.n_record} records were finished by an earlier run")
    table = campaign.summary()
    with output_file(campaign.folder / "records.nc", overwrite=True) as file:
        records.to_netcdf(file, engine="h5netcdf")
    if campaign.n_record <= MOST_CSV:
        with output_file(campaign.folder / "summary.csv", overwrite=True) as file:
            table.to_csv(file, index=False, date_format="%Y-%m-%dT%H:%M:%S")
    run = json.loads((campaign.folder / RUN_FILE).read_text(encoding="utf-8"))
    seconds = {
        name: round(end - start, 3) for name, start, end in zip(("noise", "sampling"), clock, clock[1:], strict=False)
    }
    more = {"source_files": list(source_files), "n_resumed": campaign.n_resumed, "workers": workers, "seconds": seconds}
    write_run(campaign.folder, {**run, **versions(), **more})
    used = scan.select(records["beam"].values)
    return LongOutcome(
        campaign,
        campaign.n_record,
        campaign.n_fitted,
        _failures(campaign.folder),
        describe(scan.name, sight(used).in_words(), make_prior(prior), table),
    )


def _failures(folder: Path) -> list[str]:
    rows = pd.read_parquet(folder / "posterior", columns=["record", "time", "flag_bits"])
    failed = rows[(rows["flag_bits"].to_numpy() & FAILURES) != 0]
    lines = []
    for row in failed[:_LISTED].itertuples():
        start = "" if pd.isna(row.time) else f" ({row.time:%Y-%m-%dT%H:%M})"
        lines.append(f"record {row.record}{start}: {flag_words(row.flag_bits)}")
    if len(failed) > _LISTED:
        lines.append(f"and {len(failed) - _LISTED} more records: see the column flag of the summary")
    return lines
