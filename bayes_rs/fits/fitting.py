"""The fit: from records to the posterior of R for every record, in memory or part by part into a folder."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.fits.campaign_stage import Campaign, Crew, campaign_in_memory
from bayes_rs.fits.digest import digest
from bayes_rs.fits.fit_data import FitData, MemoryTables
from bayes_rs.fits.fit_folder import open_fit
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions, split_options
from bayes_rs.fits.fit_writing import NOISE_FILE, fit_into
from bayes_rs.fits.log_likelihood import log_likelihood_of
from bayes_rs.fits.noise_choice import fit_inputs, noise_and_records, with_median_length_scale
from bayes_rs.fits.parts import fit_part
from bayes_rs.fits.plan import Plan, plan_fit, with_settings
from bayes_rs.fits.prepare import check_noise_is_less
from bayes_rs.fits.range_job import RangeJob, check_no_noise, fit_ranges, fit_ranges_into
from bayes_rs.fits.settings import Settings
from bayes_rs.fits.workers import check_workers, done_parts
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.options import to_plain
from bayes_rs.priors.registry import Prior
from bayes_rs.processor import note_processor, one_thread, processor_kind
from bayes_rs.progress import progress_counter
from bayes_rs.records.belief import believed
from bayes_rs.records.given import check_are_records, check_starts, warn_of_other_scan
from bayes_rs.records.ranges import scan_of_records


def fit(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    seed: int,
    noise: Noise | str | Path | None = None,
    output: str | Path | None = None,
    workers: int = 1,
    client: Any = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: bool | None = None,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
    **options: Any,
) -> Fit:
    """Sample the posterior of the Reynolds stress tensor of every record.

    Parameters
    ----------
    records : Dataset, dims (record, beam)
        From `make_records`, or (range, record, beam) at several ranges, each of which is fitted by itself:
        ``variance`` (m² s⁻²), ``flag``, and per record ``wind_speed`` (m/s) and ``yaw`` (degree). Where `with_motion`
        gave them a tilt and roll of their own, the beams point as these say. Where nuisances ask for it, also
        ``yaw_sd`` (degree), as from `mean_wind`; by default it is made.
    scan : Scan, str or Path
        The scan that measured them, or its name or file.
    seed : int
        Seed. A record's draws depend on the seed and the record's start, not on the records beside it.
    noise : Noise, str or Path, optional
        Noise of this scan and record length, or its file; by default it is made for the records' own wind speeds,
        directions and length scales. Records that are farther from its states than its reach are flagged
        ``outside_noise``.
    output : str or Path, optional
        Folder to write, part by part, with memory that does not grow; by default the fit stays in memory.
    workers : int
        Number of processes on this machine.
    client : dask.distributed.Client or str, optional
        A Dask cluster that does the work instead, or the address of its scheduler.
    resume : bool
        Go on with a run of the same data and options that was interrupted. What is finished is not done again.
    overwrite : bool
        Replace the folder of an earlier run, once the new one is whole.
    progress : bool, optional
        Progress bar on stderr; by default only on a terminal.
    say : callable
        Takes lines that tell what is being done.
    **options
        Fields of `FitOptions`, such as ``prior``, ``target``, ``sampler``, ``nuisances``, ``instrument_noise``,
        ``prob``, ``derived`` and ``draws``; and, for noise that is made here, ``turbulence``.

    Returns
    -------
    fit : Fit
        The same object for any size, in memory or in a folder. It keeps a copy of the records: what is done to them
        afterwards does not change it. Records that could not be fitted stay in it, flagged.
        Of records at several ranges a `RangedFit`, which holds one for each.

    Raises
    ------
    InputError
        If an option is not known or not valid, records, scan and noise do not belong together, or the folder may not
        be written.
    NoiseMismatchError
        If the noise was made for another scan.
    WorkerError
        If worker processes die again and again.
    OSError
        If a part cannot be written, as on a full disk.

    Notes
    -----
    E[y_b] = g_b·R (+ instrument noise), where g_b·R = n·R n for points, times 1 + bias_b for the ensemble target. By
    default the noise of y is log-normal, with the noise's relative covariance. See `LogNormalLikelihood`, `WeakPrior`
    and `RecordSampler`.

    For the target ``"sonic"``, R of the record is sampled first; the prior, and ``decided`` against it, are those of R.
    Then each draw of R gets one tensor S of the sonic, which scatters about R and together with the beams
    (`SonicFactor`). S is what the draws are, and what ESS and R-hat are of (`draw_sonic`).

    The folder holds ``run.json``, ``records.nc`` and Parquet tables, one file for each part and month, in folders
    such as ``month=2020-09`` if the records have times: ``summary`` (as `Fit.summary`), ``posterior`` (one row for
    each record) and, where draws are kept, ``draws`` and ``predicted`` (one row for each draw); pandas reads each, or
    one month of it, as one table. ``fingerprints.jsonl`` has a fingerprint of every file, which is checked whenever
    one is read. A part counts only if it is whole. A record whose likelihood cannot be calculated is flagged
    ``likelihood_failed`` and stops nothing. All numbers are the same for a seed, in memory or in a folder, whatever
    the number of workers, the order in which they finish, and however often the run was interrupted: bit by bit on
    processors of one kind. Another kind moves medians by up to 3e-6 of their value; where kinds meet in one fit, a
    warning is logged.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=3, seed=1)
    >>> records = brs.make_records(series, "2-beam")
    >>> found = fit(records, "2-beam", seed=1)
    >>> len(found.summary()), found.n_fitted
    (18, 3)
    """
    own, choice = split_options({"seed": seed, **options})
    check_are_records(records, ranges=True)
    check_starts(records, "give every record once, and no two that overlap")
    named = as_scan(scan)
    warn_of_other_scan(records, named)
    used = scan_of_records(records, named)
    check_workers(workers, client)
    given = given_noise(noise)
    if output is None:
        records = records.copy(deep=True).load()  # a folder holds its own; in memory they would stay the caller's
    if isinstance(used, RangedScan):
        check_no_noise(given, used)
        job = RangeJob(records, used, own, choice, {"noise": noise_section(choice, None)})
        if output is None:
            return fit_ranges(job, lambda plan: fit_in_memory(plan, workers, client, progress), say)
        parts = job.key_parts
        with begin_result_folder(
            output, key=digest(parts), key_parts=parts, resume=resume, overwrite=overwrite
        ) as folder:
            fit_ranges_into(folder, job, workers=workers, client=client, progress=progress, say=say)
        return open_fit(output)
    records = believed(records)
    check_noise_is_less([records], own)
    own = with_median_length_scale(own, choice, records, given)
    inputs = fit_inputs(records, given, choice)
    with one_thread():
        found, records = noise_and_records(records, used, given, own, choice, say)
        plan = plan_fit(records, used, found, own, inputs=inputs, in_folder=output is not None)
    if output is None:
        return fit_in_memory(with_settings(plan, noise=to_plain(choice)), workers, client, progress)
    plan = with_settings(plan, noise=noise_section(choice, given))
    with begin_result_folder(
        output, key=plan.key, key_parts=plan.key_parts, resume=resume, overwrite=overwrite
    ) as folder:
        fit_into(folder, plan, workers=workers, client=client, progress=progress, noise=given)
    return open_fit(output)


def noise_section(choice: NoiseOptions, given: Noise | None) -> dict[str, Any]:
    """Return what `run.json` says of the choice of noise: given noise is the file of it in the folder."""
    whole = Settings(noise=choice).with_whole_paths().noise
    return {**to_plain(whole), "noise": None if given is None else NOISE_FILE}


@dataclass(frozen=True)
class _InMemory:
    """The records and the prior's draws of a fit in memory."""

    plan: Plan
    learnt: Campaign

    def records(self) -> xr.Dataset:
        return self.plan.records

    def prior_draws(self) -> FloatArray:
        return self.plan.prior_draws

    def campaign_prior(self) -> Prior | None:
        return self.learnt.prior

    def inputs(self) -> tuple[Noise | None, FitOptions, NoiseOptions]:
        return self.plan.shared.noise, self.plan.shared.options, NoiseOptions()

    def has_log_likelihood(self) -> bool:
        return True

    def log_likelihood(self, fit: FitData) -> xr.Dataset:
        return log_likelihood_of(self.plan.shared, self.plan.parts, fit)


def fit_in_memory(plan: Plan, workers: int, client: Any, progress: bool | None) -> Fit:
    """Fit all parts of a plan, and join them."""
    silent = None if progress is None else not progress
    finished, kinds = [], [processor_kind()]
    with progress_counter(plan.n_record, "fitting", " records", disable=silent) as bar:
        parts: Generator[Any, None, None] = done_parts(fit_part, plan.shared, plan.parts, workers, client)
        for done in parts:
            finished.append(done)
            note_processor(kinds, done.processor)
            bar.update(len(done.tables["posterior"]))
    finished.sort(key=lambda done: done.index)
    tables = MemoryTables({name: [done.tables[name] for done in finished] for name in plan.datasets})
    learnt = campaign_in_memory(plan, tables, Crew(workers, client, silent))
    run = {**plan.run, "campaign": learnt.about, "processors": kinds}
    return Fit(run, plan.scan, tables.with_tables(learnt.tables), _InMemory(plan, learnt))
