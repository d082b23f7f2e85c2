"""The main job for a long campaign: many records in, a folder of tables out."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from bayes_rs._version import __version__
from bayes_rs.file_options import FileOptions
from bayes_rs.fits.campaign import Campaign, begin_campaign, check_workers, run_campaign
from bayes_rs.fits.digest import digest, digest_parts
from bayes_rs.fits.fit_job import versions
from bayes_rs.fits.job_options import JobOptions
from bayes_rs.fits.parts import ALONG, ALONG_SHAPE, directions_of
from bayes_rs.fits.plan import (
    CampaignOptions,
    CampaignPlan,
    check_versions,
    number_versions,
    plan_campaign,
)
from bayes_rs.fits.result import flag_words
from bayes_rs.fits.tables import read_tables
from bayes_rs.fits.words import FAILURES, describe, flag_lines, least_seen
from bayes_rs.fits.workers import connect
from bayes_rs.folder_lock import locked
from bayes_rs.geometry.scan import Scan
from bayes_rs.output import RUN_FILE, output_file, prepare_resumable_folder, write_csv, write_netcdf, write_run
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.registry import SUFFIXES
from bayes_rs.records.record_store import CHUNK_ROWS, store_records
from bayes_rs.records.report import describe_report

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
    bad_files : dict of str to str
        Files that could not be used, with the reasons.
    flags : list of str
        One line for each flag that some record has: how many have it, and the first.
    """

    campaign: Campaign
    n_record: int
    n_fitted: int
    failures: list[str]
    words: list[str]
    bad_files: dict[str, str] = field(default_factory=dict)
    flags: list[str] = field(default_factory=list)


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
    instrument_noise: float | str = 0.0,
    prob: float = 0.9,
    derived: Sequence[str] = (),
    draws: str = "none",
    workers: int = 1,
    scheduler: str | None = None,
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
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do the work instead.
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
            draws=draws,
        ),
    )
    check_workers(workers)
    clock = [time.perf_counter()]
    noise, records = asked.noise_and_records(records, scan, asked.given_noise(), say)
    clock.append(time.perf_counter())
    with connect(scheduler) as client, locked(output):
        plan = plan_campaign(records, scan, noise, asked.of_fit)
        campaign = begin_campaign(plan, output, workers=workers, client=client, resume=resume, overwrite=overwrite)
        clock.append(time.perf_counter())
        return _finish(
            campaign,
            plan,
            records,
            say,
            **asked.for_run(noise, records),
            source_files=list(source_files),
            workers=workers,
            seconds=_seconds(("noise", "sampling"), clock),
        )


def run_folder_fit(
    files: str | Path | Sequence[str | Path],
    scan: Scan,
    output: str | Path,
    *,
    reading: Mapping[str, Any] | None = None,
    recording: Mapping[str, Any] | None = None,
    chunk_rows: int | None = None,
    lateness: float | None = None,
    noise_file: str | Path | None = None,
    turbulence: str = "fu-2022",
    noise_method: str = "theory",
    prior: str = "weak",
    target: str = "record",
    sampler: str = "auto",
    likelihood: str = "log-normal",
    nuisances: Nuisances | None = None,
    target_ess: int = 1000,
    instrument_noise: float | str = 0.0,
    prob: float = 0.9,
    derived: Sequence[str] = (),
    draws: str = "none",
    workers: int = 1,
    scheduler: str | None = None,
    seed: int = 1,
    resume: bool = False,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
    show_progress: bool | None = None,
) -> LongOutcome:
    """Fit all records of a folder of radial velocities, of a year, say, with memory that does not grow with its files.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files, folders and patterns, as for `stream`.
    scan : Scan
        The scan they were measured with.
    output : str or Path
        Folder to make, with the Parquet datasets of `fit_campaign`, ``records.nc``, ``run.json`` and, up to 20 000
        records, ``summary.csv``. Its folder ``records`` keeps what was made of the files.
    reading : dict, optional
        Options of `stream`.
    recording : dict, optional
        Options of `make_records`.
    chunk_rows : int, optional
        Rows that are read at a time; memory, not the result, depends on it.
    lateness : float, optional
        As for `stream_records`, s.
    noise_file, turbulence, noise_method
        As for `run_fit`.
    prior, target, sampler, likelihood, nuisances, target_ess, instrument_noise, prob, derived, draws, workers
        As for `fit_campaign`.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do the work instead.
    seed : int
        Seed of the fit.
    resume, overwrite : bool
        Go on with an interrupted run of the same options, or replace the folder of an earlier one. Files that were
        read are not read again; of files that came since, later ones are added, and all records are fitted again.
    say : callable
        Takes lines that tell what is being done.
    show_progress : bool, optional
        Progress bars with the time left on stderr; by default only on a terminal.

    Returns
    -------
    outcome : LongOutcome
        Counts and failures: files and records.

    Raises
    ------
    InputError
        If the folder may not be written, another process writes it, input does not belong together, no file can be
        used, or one that was read before was changed.
    WorkerError
        If worker processes die again and again.

    Notes
    -----
    First the records of all files are made, then the noise for their wind speeds and directions, then they are fitted.
    A file that cannot be read, or that holds anything that cannot be used, counts for nothing; it is named at the end.
    All results are the same however often the run was interrupted, and whatever ``chunk_rows`` and ``workers``.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> scan, flow = brs.load_scan("2-beam"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for hour in range(2):
    ...         some = series.isel(sample=slice(1200 * hour, 1200 * (hour + 1))).to_dataframe().reset_index()
    ...         some[["time", "beam", "radial_velocity"]].to_csv(f"{folder}/{hour}.csv", index=False)
    ...     brs.calibrate(scan, flow, wind_speed=10.0, cache=False).save(f"{folder}/noise.nc")
    ...     outcome = run_folder_fit(f"{folder}/*.csv", scan, f"{folder}/year", noise_file=f"{folder}/noise.nc")
    ...     outcome.n_fitted, len(outcome.campaign.summary())
    (2, 12)
    """
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
            draws=draws,
        ),
    )
    check_workers(workers)
    clock = [time.perf_counter()]
    given = asked.given_noise()
    read, made = dict(reading or {}), dict(recording or {})
    key_parts = digest_parts(
        version=__version__,
        packages=number_versions(),
        scan=scan.key,
        reading_options=read,
        record_options=made,
        lateness=lateness,
        **asked.for_key(given),
    )
    key = digest(key_parts)
    find_files(files, SUFFIXES)  # what is not there is said before a folder is made, or replaced
    with locked(output):
        if resume and not overwrite:
            check_versions(output)
        folder = prepare_resumable_folder(output, key, key_parts, resume=resume, overwrite=overwrite)
        write_run(folder, {"key": key, "key_parts": key_parts, "finished": False, "packages": number_versions()})
        stored = store_records(
            files,
            scan,
            folder / "records",
            reading=FileOptions(**{"on_bad_file": "skip", **read}),
            chunk_rows=chunk_rows or CHUNK_ROWS,
            lateness=lateness,
            show_progress=show_progress,
            **made,
        )
        if stored.n_resumed:
            say(f"{stored.n_resumed} of {stored.n_file} files were read by an earlier run")
        for line in describe_report(stored.records):
            say(line)
        clock.append(time.perf_counter())
        noise, records = asked.noise_and_records(stored.records, scan, given, say)
        clock.append(time.perf_counter())
        with connect(scheduler) as client:
            check_workers(workers, client)
            plan = plan_campaign(records, scan, noise, asked.of_fit)
            _only_of(plan, folder)
            plan = replace(plan, run={**plan.run, "key": key, "key_parts": key_parts})
            campaign = run_campaign(plan, folder, workers=workers, client=client, show_progress=show_progress)
        clock.append(time.perf_counter())
        return _finish(
            campaign,
            plan,
            records,
            say,
            **asked.for_run(noise, records),
            workers=workers,
            seconds=_seconds(("records", "noise", "sampling"), clock),
            n_file=stored.n_file,
            source_files=json.loads(records.attrs.get("source_files", "[]")),
            bad_files=stored.bad_files,
            read_counts=stored.counts,
        )


def _only_of(plan: CampaignPlan, folder: Path) -> None:
    """Remove the parts of another fit, of fewer files, and say whose parts come now."""
    mark = folder / "records" / "fit-key"
    if not mark.is_file() or mark.read_text(encoding="utf-8") != plan.key:
        for name in ("summary", "posterior", "draws", "draws.zarr"):
            if (folder / name).exists():
                shutil.rmtree(folder / name)
        with output_file(mark, overwrite=True) as file:
            file.write_text(plan.key, encoding="utf-8")


def _finish(
    campaign: Campaign,
    plan: CampaignPlan,
    records: xr.Dataset,
    say: Callable[[str], None],
    *,
    bad_files: Mapping[str, str] | None = None,
    **more: Any,
) -> LongOutcome:
    """Write what belongs to the tables, and say how it went."""
    if campaign.n_resumed:
        say(f"{campaign.n_resumed} of {campaign.n_record} records were finished by an earlier run")
    table = campaign.summary()
    with output_file(campaign.folder / "records.nc", overwrite=True) as file:
        write_netcdf(records, file)
    if campaign.n_record <= MOST_CSV:
        with output_file(campaign.folder / "summary.csv", overwrite=True) as file:
            write_csv(table, file, index=False, date_format="%Y-%m-%dT%H:%M:%S")
    bad = dict(bad_files or {})
    report = json.loads(records.attrs.get("records_report", "{}"))
    late = {name: report[name] for name in ("samples_late", "first_late") if name in report}
    run = json.loads((campaign.folder / RUN_FILE).read_text(encoding="utf-8"))
    posterior = read_tables(campaign.folder, "posterior", ["record", "time", "flag_bits", *ALONG, *ALONG_SHAPE])
    along = directions_of(posterior, run)
    words = [
        *describe(run["scan"], run["sight"], plan.shared.options.prior, table),
        *([] if along is None else least_seen(along)),
    ]
    counts = {"n_resumed": campaign.n_resumed, "bad_files": bad, **late}
    write_run(campaign.folder, {**run, **versions(), **counts, **more, "words": words})
    lines = [f"file {name}: {reason}" for name, reason in bad.items()]
    if late:
        lines.append(
            f"{late['samples_late']} samples came after their record was closed and are not in it, the first of "
            f"{late['first_late']}: sort the files by time, or give a longer lateness"
        )
    return LongOutcome(
        campaign,
        campaign.n_record,
        campaign.n_fitted,
        lines + _failures(posterior),
        words,
        bad,
        flag_lines(posterior["flag_bits"].to_numpy(), lambda index: _record_name(posterior.iloc[index])),
    )


def _seconds(names: Sequence[str], clock: Sequence[float]) -> dict[str, float]:
    return {name: round(end - start, 3) for name, start, end in zip(names, clock, clock[1:], strict=False)}


def _record_name(row: pd.Series[Any]) -> str:
    start = "" if pd.isna(row["time"]) else f" ({row['time']:%Y-%m-%dT%H:%M})"
    return f"record {row['record']}{start}"


def _failures(rows: pd.DataFrame) -> list[str]:
    failed = rows[(rows["flag_bits"].to_numpy() & FAILURES) != 0]
    lines = []
    for _, row in failed[:_LISTED].iterrows():
        lines.append(f"{_record_name(row)}: {flag_words(row['flag_bits'])}")
    if len(failed) > _LISTED:
        lines.append(f"and {len(failed) - _LISTED} more records: see the column flag of the summary")
    return lines
