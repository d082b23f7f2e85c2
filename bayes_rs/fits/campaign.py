"""The fit of a long campaign: part by part to a folder, with memory that does not grow, and resumable."""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import check_count
from bayes_rs.fits.draw_store import DrawStore, open_draw_store
from bayes_rs.fits.parts import Done, Part, Shared, fit_part
from bayes_rs.fits.plan import (
    CampaignOptions,
    CampaignPlan,
    check_versions,
    plan_campaign,
)
from bayes_rs.fits.result import FLAGS, UNFITTED
from bayes_rs.fits.tables import (
    files_of_part,
    is_whole,
    read_summary,
    read_tables,
    remove_half_written,
    write_table,
)
from bayes_rs.fits.workers import check_client, run_dask, run_processes, run_serial
from bayes_rs.folder_lock import locked
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise import Noise
from bayes_rs.output import prepare_resumable_folder, write_run
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.priors.registry import Prior
from bayes_rs.progress import progress_counter

PRIOR_FILE = "prior.parquet"
"""Draws of the prior, for its outline in the report."""
_PRIOR_ROWS = 2000


@dataclass(frozen=True)
class Campaign:
    """What came of a long fit.

    Parameters
    ----------
    folder : Path
        Where everything is.
    n_record, n_fitted, n_resumed : int
        Records in all, records with a posterior, and records that an earlier, interrupted run had finished.
    flags : dict of str to int
        How many records have each flag.
    seconds : float
        Wall-clock time of this run, s.
    """

    folder: Path
    n_record: int
    n_fitted: int
    n_resumed: int
    flags: dict[str, int]
    seconds: float

    def summary(self) -> pd.DataFrame:
        """Return the summary of all records, with the columns of `bayes_rs.summary`."""
        return read_summary(self.folder)


def fit_campaign(
    records: xr.Dataset,
    scan: Scan,
    output: str | Path,
    *,
    noise: Noise,
    seed: int,
    prior: str | Prior = "weak",
    target: str = "record",
    sampler: str = "auto",
    likelihood: str = "log-normal",
    nuisances: Nuisances | None = None,
    target_ess: int = 1000,
    max_extension: int = 5,
    instrument_noise: float | str = 0.0,
    prob: float = 0.9,
    derived: Sequence[str] = (),
    draws: str = "none",
    workers: int = 1,
    client: Any = None,
    resume: bool = False,
    overwrite: bool = False,
    show_progress: bool | None = None,
) -> Campaign:
    """Fit any number of records, part by part, and write what comes of it to a folder.

    Parameters
    ----------
    records, scan
        As in `fit`.
    output : str or Path
        Folder to write.
    noise, seed, prior, target
        As in `fit`.
    sampler : str
        As in `fit`; by default direct draws, and emcee where those do not do.
    likelihood, nuisances, target_ess, max_extension, instrument_noise
        As in `fit`.
    prob, derived
        As in `summary`.
    draws : str
        ``"float32"`` or ``"float64"``: keep the draws, too, as a Parquet dataset; 49 or 98 kB a record. ``"zarr"``:
        the same in float32 as a Zarr store of one chunk a part, which needs the extra ``zarr``. ``"none"``: do not.
    workers : int
        Number of processes on this machine.
    client : dask.distributed.Client, optional
        A Dask cluster that does the work instead.
    resume : bool
        Go on with a run of the same data and options that was interrupted. What is finished is not done again.
    overwrite : bool
        Replace the folder of an earlier run.
    show_progress : bool, optional
        Progress bar with records per second on stderr; by default only on a terminal.

    Returns
    -------
    campaign : Campaign
        Where the results are, and how many.

    Raises
    ------
    InputError
        If input does not belong together, the folder may not be written, or it holds a run of something else, or one
        that other versions of numpy, scipy or emcee began, or another process writes it.
    MissingExtraError
        If draws are to go to Zarr, and that is not installed.
    WorkerError
        If worker processes die again and again.
    OSError
        If a part cannot be written, as on a full disk.

    Notes
    -----
    The folder holds Parquet datasets, one file for each part and month, in folders such as ``month=2020-09`` if the
    records have times: ``summary`` (the columns of `summary`), ``posterior`` (one row a record: flag, sampler,
    diagnostics, whether it is outside the noise bank, the covariance of the stresses, and the contraction along the
    directions of R, which stand in ``run.json``) and, on request, ``draws`` (one row a draw); pandas reads each, or one
    month of it, as one table. ``prior.parquet`` holds 2000 draws of the prior. The Zarr store ``draws.zarr`` holds
    ``uu`` to ``vw`` (record, draw), NaN for records without a posterior. A part counts only if it is whole. A record
    whose likelihood cannot be calculated is flagged ``likelihood_failed`` and stops nothing. Whatever ends a run, what
    was finished is kept, and a note of the error says how much. All numbers are the same for a seed, whatever the
    number of workers, the order in which they finish, and however often the run was interrupted; they are those of
    `fit`.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> scan, flow = brs.load_scan("2-beam"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=3, seed=1)
    >>> records = brs.make_records(series, scan)
    >>> noise = brs.noise.calibrate(scan, flow, wind_speed=10.0, cache=False)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     campaign = fit_campaign(records, scan, f"{folder}/year", noise=noise, seed=1)
    ...     len(campaign.summary()), campaign.n_fitted
    (18, 3)
    """
    options = CampaignOptions(
        seed=seed,
        prior=prior,
        target=target,
        sampler=sampler,
        likelihood=likelihood,
        nuisances=nuisances,
        target_ess=target_ess,
        max_extension=max_extension,
        instrument_noise=instrument_noise,
        prob=prob,
        derived=derived,
        draws=draws,
    )
    check_workers(workers, client)
    plan = plan_campaign(records, scan, noise, options)
    with locked(output):
        return begin_campaign(
            plan,
            output,
            workers=workers,
            client=client,
            resume=resume,
            overwrite=overwrite,
            show_progress=show_progress,
        )


def check_workers(workers: int, client: Any = None) -> None:
    """Check who is to do the work, before any is done.

    Raises
    ------
    InputError
        If there are none, or the client cannot be used.
    """
    check_count(workers, what="workers")
    if client is not None:
        check_client(client)


def begin_campaign(
    plan: CampaignPlan,
    output: str | Path,
    *,
    workers: int,
    client: Any,
    resume: bool,
    overwrite: bool,
    show_progress: bool | None = None,
) -> Campaign:
    """Make the folder of a plan, or find the one that an interrupted run left, and do what is left to do.

    Parameters
    ----------
    plan : CampaignPlan
        From `plan_campaign`.
    output, workers, client, resume, overwrite, show_progress
        As for `fit_campaign`; the caller holds the folder `locked`.

    Returns
    -------
    campaign : Campaign
        Where the results are, and how many.

    Raises
    ------
    InputError
        If the folder may not be written, or it holds a run of something else.
    """
    if resume and not overwrite:
        check_versions(output)
    folder = prepare_resumable_folder(output, plan.key, plan.key_parts, resume=resume, overwrite=overwrite)
    return run_campaign(plan, folder, workers=workers, client=client, show_progress=show_progress)


def run_campaign(
    plan: CampaignPlan, folder: Path, *, workers: int = 1, client: Any = None, show_progress: bool | None = None
) -> Campaign:
    """Do what a plan has left to do in a folder.

    Parameters
    ----------
    plan : CampaignPlan
        From `plan_campaign`.
    folder : Path
        A folder of this plan: nothing of another is in it.
    workers, client, show_progress
        As for `fit_campaign`.

    Returns
    -------
    campaign : Campaign
        Where the results are, and how many.

    Raises
    ------
    WorkerError
        If worker processes die again and again.
    OSError
        If a part cannot be written, as on a full disk.
    """
    began = time.perf_counter()
    write_run(folder, {**plan.run, "finished": False})
    shared, n_record = plan.shared, plan.n_record
    store = _open_draws(plan, folder) if shared.draws == "zarr" else None
    left = [
        part
        for part in plan.parts
        if not all(is_whole(file) for name in plan.datasets for file, _ in _files(folder, name, part))
        or not (store is None or store.has(part.index))
    ]
    n_resumed = n_done = n_record - sum(len(part.batch) for part in left)
    silent = None if show_progress is None else not show_progress
    of_index = {part.index: part for part in left}
    try:
        write_table(pd.DataFrame(plan.prior_draws[:_PRIOR_ROWS], columns=list(STRESSES)), folder / PRIOR_FILE)
        with (
            progress_counter(n_record, "fitting", " records", initial=n_resumed, disable=silent) as bar,
            closing(_run(shared, left, workers, client)) as finished,
        ):
            for done in finished:
                if store is not None and done.draws is not None:
                    store.write(done.index, done.draws)  # before the tables, which say that the part is whole
                for name, table in done.tables.items():
                    _write_files(table, folder, name, of_index[done.index])
                n_done += len(done.tables["posterior"])
                bar.update(len(done.tables["posterior"]))
    except BaseException as error:
        error.add_note(
            f"{n_done} of {n_record} records are finished and kept in {str(folder)!r}: the same call with resume "
            "goes on from there."
        )
        raise
    remove_half_written(folder, plan.datasets)
    row = read_tables(folder, "posterior", ["flag_bits", "outside_noise"])
    flag = row["flag_bits"].to_numpy()
    campaign = Campaign(
        folder,
        n_record,
        int(np.count_nonzero((flag & UNFITTED) == 0)),
        n_resumed,
        {word: int(np.count_nonzero(flag & bit)) for word, bit in FLAGS.items()},
        time.perf_counter() - began,
    )
    counts = {
        "n_fitted": campaign.n_fitted,
        "n_outside_noise": int(np.count_nonzero(row["outside_noise"].to_numpy())),
        "flags": campaign.flags,
        "finished": True,
    }
    write_run(folder, {**plan.run, **counts})
    return campaign


def _run(shared: Shared, parts: list[Part], workers: int, client: Any) -> Generator[Done, None, None]:
    if client is not None:
        return run_dask(fit_part, shared, parts, client)
    if workers == 1 or len(parts) < 2:
        return run_serial(fit_part, shared, parts)
    return run_processes(fit_part, shared, parts, min(workers, len(parts)))


def _open_draws(plan: CampaignPlan, folder: Path) -> DrawStore:
    return open_draw_store(
        folder / "draws.zarr",
        time=np.concatenate([part.time for part in plan.parts]),
        n_draw=plan.shared.n_draw,
        part_records=len(plan.parts[0].record),
        attributes={"key": plan.key},
    )


def _files(folder: Path, dataset: str, part: Part) -> list[tuple[Path, NDArray[np.bool_]]]:
    return files_of_part(folder, dataset, part.index, part.time)


def _write_files(table: pd.DataFrame, folder: Path, dataset: str, part: Part) -> None:
    for file, rows in _files(folder, dataset, part):
        write_table(table if rows.all() else table[table["record"].isin(part.record[rows])], file)
