"""The fit of a long campaign: part by part to a folder, with memory that does not grow, and resumable."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import check_choice, check_count
from bayes_rs._version import __version__
from bayes_rs.campaigns.digest import digest
from bayes_rs.campaigns.draw_store import DrawStore, check_zarr, open_draw_store
from bayes_rs.campaigns.workers import check_client, run_dask, run_processes, run_serial
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.model import NoiseBank, NoiseModel
from bayes_rs.output import RUN_FILE, prepare_resumable_folder, write_run
from bayes_rs.posteriors.batch import Batch, FitOptions, RecordDraws, fit_batch, join_draws
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.posteriors.sampling.chains import N_CHAIN, kept_draws
from bayes_rs.posteriors.sonic import ESS_MARGIN
from bayes_rs.priors.registry import Prior
from bayes_rs.progress import progress_counter
from bayes_rs.results.fitting import batch_size, can_be_fitted, fit_options, flags_after, flags_before, prepare
from bayes_rs.results.result import FLAGS, N_PRIOR_DRAW, PRIOR_SEED, UNFITTED, noise_summary
from bayes_rs.results.summarizing import PriorOutline, check_summary_options, summarize_draws, summary_frame

DRAWS = ("none", "float32", "float64", "zarr")
"""What is kept of the draws."""
MONTH = "month="
"""Begins the name of a folder with the records of one month, as Hive has it."""
_NUMBERS_FROM = ("numpy", "scipy", "emcee")
"""Packages whose version can change a number."""
_FAILED = (NotPositiveDefiniteError, np.linalg.LinAlgError, FloatingPointError)
"""What the likelihood of a record may fail with."""
PART_RECORDS = 128
"""Records of a part: what is lost at most when a run is interrupted, for each worker."""
_PER_RECORD = ("acceptance_rate", "n_step", "pareto_k", "misfit", "sonic_clipped")
_PAIRS = [(i, j) for i in range(len(STRESSES)) for j in range(i, len(STRESSES))]


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


@dataclass(frozen=True)
class _Shared:
    """What every part needs."""

    noise: NoiseModel | NoiseBank
    options: FitOptions
    outline: PriorOutline
    prob: float
    draws: str
    n_beam: int

    @property
    def n_draw(self) -> int:
        """Draws of a record."""
        margin = ESS_MARGIN if self.options.target == "sonic" else 1.0
        return N_CHAIN * kept_draws(int(np.ceil(margin * self.options.target_ess)))


@dataclass(frozen=True)
class _Part:
    """Some records in a row."""

    index: int
    batch: Batch
    record: NDArray[np.int64]
    time: NDArray[np.datetime64]
    flag: NDArray[np.int64]


@dataclass(frozen=True)
class _Done:
    """The tables of one part."""

    index: int
    tables: dict[str, pd.DataFrame]
    draws: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class CampaignPlan:
    """What a long fit does, checked before anything is written.

    Parameters
    ----------
    key : str
        Fingerprint of data, options and versions.
    shared, parts : object
        What all parts need, and the parts.
    run : dict
        What `run.json` says of the options.
    n_record : int
        Number of records.
    datasets : tuple of str
        The Parquet datasets.
    """

    key: str
    shared: _Shared
    parts: list[_Part]
    run: Mapping[str, Any]
    n_record: int
    datasets: tuple[str, ...]


def fit_campaign(
    records: xr.Dataset,
    scan: Scan,
    output: str | Path,
    *,
    noise: NoiseModel | NoiseBank,
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
        that other versions of numpy, scipy or emcee began.
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
    diagnostics, whether it is outside the noise bank, and the covariance of the stresses) and, on request, ``draws``
    (one row a draw); pandas reads each, or one month of it, as one table. The Zarr store ``draws.zarr`` holds ``uu`` to
    ``vw`` (record, draw), NaN for records without a posterior. A part counts only if it is whole. A record whose
    likelihood cannot be calculated is flagged ``likelihood_failed`` and stops nothing. Whatever ends a run, what was
    finished is kept, and a note of the error says how much. All numbers are the same for a seed, whatever the number of
    workers, the order in which they finish, and however often the run was interrupted; they are those of `fit`.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> scan, flow = brs.load_scan("2-beam"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=3, seed=1)
    >>> records = brs.make_records(series, scan)
    >>> noise = brs.calibrate(scan, flow, wind_speed=10.0, cache=False)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     campaign = fit_campaign(records, scan, f"{folder}/year", noise=noise, seed=1)
    ...     len(campaign.summary()), campaign.n_fitted
    (18, 3)
    """
    plan = plan_campaign(
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
        max_extension=max_extension,
        instrument_noise=instrument_noise,
        prob=prob,
        derived=derived,
        draws=draws,
        workers=workers,
        client=client,
    )
    if resume and not overwrite:
        check_versions(output)
    folder = prepare_resumable_folder(output, plan.key, resume=resume, overwrite=overwrite)
    write_run(folder, {"key": plan.key, "finished": False, "packages": number_versions()})
    return run_campaign(plan, folder, workers=workers, client=client, show_progress=show_progress)


def plan_campaign(
    records: xr.Dataset,
    scan: Scan,
    *,
    noise: NoiseModel | NoiseBank,
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
) -> CampaignPlan:
    """Check all that `fit_campaign` is given, and cut the records into parts.

    Raises
    ------
    InputError
        If input does not belong together.
    MissingExtraError
        If draws are to go to Zarr, and that is not installed.
    """
    check_job_options(prob=prob, derived=derived, draws=draws, workers=workers)
    if client is not None:
        check_client(client)
    options = fit_options(
        prior, target, sampler, likelihood, nuisances, instrument_noise, target_ess, max_extension, seed
    )
    scan, noise, batch = prepare(records, scan, noise, instrument_noise=instrument_noise)
    batch = replace(batch, used=batch.used & np.isfinite(batch.variance))
    parts = _parts(records, batch)
    described = [(part.record, part.time, part.flag) for part in parts]
    key = digest(
        __version__,
        number_versions(),
        scan.key,
        noise,
        batch,
        described,
        options,
        prob,
        derived,
        draws,
        PART_RECORDS,
    )
    outline = PriorOutline(options.prior.draw(N_PRIOR_DRAW, PRIOR_SEED), derived)
    run = {
        "bayes_rs": __version__,
        "packages": number_versions(),
        "key": key,
        "scan": scan.name,
        "scan_key": scan.key,
        "prior": options.prior.in_words(),
        "nuisances": options.nuisances.in_words(),
        "target": target,
        "sampler": sampler,
        "likelihood": likelihood,
        "noise": noise_summary(noise),
        "instrument_noise": instrument_noise if isinstance(instrument_noise, str) else float(instrument_noise),
        "seed": options.seed,
        "target_ess": int(target_ess),
        "max_extension": int(max_extension),
        "prob": float(prob),
        "derived": list(derived),
        "draws": draws,
        "n_record": len(batch),
    }
    tables = ("summary", "posterior", *(("draws",) if draws in ("float32", "float64") else ()))
    return CampaignPlan(key, _Shared(noise, options, outline, prob, draws, scan.n_beam), parts, run, len(batch), tables)


def check_job_options(*, prob: float, derived: Sequence[str], draws: str, workers: int) -> None:
    """Check what `fit_campaign` is given beside the options of `fit`, before any work is done.

    Raises
    ------
    InputError
        If an option is not valid.
    MissingExtraError
        If draws are to go to Zarr, and that is not installed.
    """
    check_summary_options(prob, derived)
    check_choice(draws, DRAWS, what="draws")
    check_count(workers, what="workers")
    if draws == "zarr":
        check_zarr()


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
    shared, n_record = plan.shared, plan.n_record
    store = _open_draws(plan, folder) if shared.draws == "zarr" else None
    left = [
        part
        for part in plan.parts
        if not all(_is_whole(file) for name in plan.datasets for file, _ in _files(folder, name, part))
        or not (store is None or store.has(part.index))
    ]
    n_resumed = n_done = n_record - sum(len(part.batch) for part in left)
    silent = None if show_progress is None else not show_progress
    of_index = {part.index: part for part in left}
    try:
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
    _tidy(folder, plan.datasets)
    rows = [pq.ParquetFile(file).read(["flag_bits", "outside_noise"]) for file in part_files(folder, "posterior")]
    row = pa.concat_tables(rows)
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


def number_versions() -> dict[str, str]:
    """Return the versions of the packages whose numbers are in the results."""
    return {name: version(name) for name in _NUMBERS_FROM}


def check_versions(output: str | Path) -> None:
    """Refuse to go on with a run that other versions of the packages began: numbers could differ within one result.

    Raises
    ------
    InputError
        If `run.json` in the folder names other versions.
    """
    try:
        found = json.loads((Path(output) / RUN_FILE).read_text(encoding="utf-8")).get("packages", {})
    except (OSError, ValueError, AttributeError):
        return  # not a folder of ours: `prepare_resumable_folder` says so
    for name, now in number_versions().items():
        if found.get(name, now) != now:
            raise InputError(
                f"Output folder {str(output)!r} is of a run with {name} {found[name]}, and this is {name} {now}, whose "
                f"numbers could differ: go on with {name} {found[name]}, give another name, or overwrite."
            )


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
    files = part_files(folder, "summary")
    if not files:
        raise InputError(f"No summary in {str(folder)!r}: give the output folder of fit_campaign.")
    whole = pa.concat_tables([pq.ParquetFile(file).read() for file in files])
    return cast("pd.DataFrame", whole.to_pandas())


def _parts(records: xr.Dataset, batch: Batch) -> list[_Part]:
    fitted = can_be_fitted(batch)
    flag = flags_before(records, batch.used, fitted)
    n_record = len(batch)
    number = np.arange(n_record)  # as in the result of `fit`
    start = np.full(n_record, np.datetime64("NaT", "ns"))
    if "time" in records.coords:
        start = records["time"].values
        if np.issubdtype(start.dtype, np.datetime64):
            start = start.astype("datetime64[ns]")  # one type for all parts, and for records from any source
    slices = [slice(first, first + PART_RECORDS) for first in range(0, n_record, PART_RECORDS)]
    return [_Part(i, batch.take(rows), number[rows], start[rows], flag[rows]) for i, rows in enumerate(slices)]


def _run(shared: _Shared, parts: list[_Part], workers: int, client: Any) -> Generator[_Done, None, None]:
    if client is not None:
        return run_dask(fit_part, shared, parts, client)
    if workers == 1 or len(parts) < 2:
        return run_serial(fit_part, shared, parts)
    return run_processes(fit_part, shared, parts, min(workers, len(parts)))


def fit_part(shared: _Shared, part: _Part) -> _Done:
    """Fit the records of one part and lay out its tables."""
    fitted = can_be_fitted(part.batch)
    n_record, n_name = len(part.batch), len(STRESSES) + len(shared.outline.derived)
    columns: dict[str, NDArray[np.float64]] = {}
    flag = part.flag.copy()
    covariance = np.full((n_record, len(_PAIRS)), np.nan)
    per_record = {name: np.full(n_record, np.nan) for name in _PER_RECORD}
    sampler = np.full(n_record, "", dtype=object)
    outside = np.zeros(n_record, dtype=np.bool_)
    kept: list[pd.DataFrame] = []
    stored = (
        np.full((n_record, shared.n_draw, len(STRESSES)), np.nan, dtype=np.float32) if shared.draws == "zarr" else None
    )
    size = min(batch_size(shared.n_beam), 128)
    for first in range(0, len(fitted), size):
        some, draws = _fit_those_that_can(part.batch, fitted[first : first + size], shared)
        flag[np.setdiff1d(fitted[first : first + size], some)] |= FLAGS["likelihood_failed"]
        if draws is None:
            continue
        chains = draws.chains
        flag[some] |= flags_after(draws, shared.options.target_ess)
        known = {"ess_bulk": chains.ess_bulk, "ess_tail": chains.ess_tail, "r_hat": chains.r_hat}
        found = summarize_draws(chains.stress, shared.outline, part.batch.wind_speed[some], shared.prob, known)
        for name, values in found.items():
            columns.setdefault(name, np.full((n_record, n_name), np.nan))[some] = values
        flat = chains.stress.reshape(len(some), -1, len(STRESSES))
        centred = flat - flat.mean(axis=1, keepdims=True)
        matrix = centred.swapaxes(-1, -2) @ centred / (flat.shape[1] - 1.0)
        covariance[some] = np.stack([matrix[:, i, j] for i, j in _PAIRS], axis=-1)
        per_record["acceptance_rate"][some] = chains.acceptance
        per_record["n_step"][some] = chains.n_step
        per_record["pareto_k"][some] = chains.pareto_k
        per_record["misfit"][some] = draws.misfit
        per_record["sonic_clipped"][some] = draws.clipped
        sampler[some] = chains.sampler
        outside[some] = draws.outside
        if stored is not None:
            stored[some] = flat
        elif shared.draws != "none":
            kept.append(_draws_table(flat, part.record[some], shared.draws))
    tables = {
        "summary": summary_frame(
            columns,
            record=part.record,
            time=part.time,
            flag=flag,
            derived=shared.outline.derived,
            prob=shared.prob,
        ),
        "posterior": pd.DataFrame(
            {
                "record": part.record,
                "time": part.time,
                "flag_bits": flag,
                "sampler": sampler,
                "outside_noise": outside,
                **per_record,
                **{f"cov_{STRESSES[i]}_{STRESSES[j]}": covariance[:, column] for column, (i, j) in enumerate(_PAIRS)},
            }
        ),
    }
    if shared.draws in ("float32", "float64"):
        empty = _draws_table(np.empty((0, 0, len(STRESSES))), np.empty(0, dtype=np.int64), shared.draws)
        tables["draws"] = pd.concat(kept, ignore_index=True) if kept else empty
    return _Done(part.index, tables, stored)


def _fit_those_that_can(
    batch: Batch, rows: NDArray[np.int64], shared: _Shared
) -> tuple[NDArray[np.int64], RecordDraws | None]:
    """Fit some records of a batch; return those that could be, and their draws."""
    try:
        return rows, fit_batch(batch.take(rows), shared.noise, shared.options, predict=False)
    except _FAILED:
        if len(rows) == 1:
            return rows[:0], None
    # a record's numbers do not depend on those beside it: halves find the one that fails
    found = [_fit_those_that_can(batch, half, shared) for half in np.array_split(rows, 2)]
    fitted = [draws for _, draws in found if draws is not None]
    return np.concatenate([some for some, _ in found]), join_draws(fitted) if fitted else None


def _draws_table(flat: NDArray[np.float64], record: NDArray[np.int64], kind: str) -> pd.DataFrame:
    n_record, n_draw, _ = flat.shape
    columns = flat.reshape(-1, len(STRESSES)).astype(kind)
    return pd.DataFrame(
        {
            "record": np.repeat(record, n_draw),
            "draw": np.tile(np.arange(n_draw, dtype=np.int32), n_record),
            **{name: columns[:, index] for index, name in enumerate(STRESSES)},
        }
    )


def _open_draws(plan: CampaignPlan, folder: Path) -> DrawStore:
    return open_draw_store(
        folder / "draws.zarr",
        time=np.concatenate([part.time for part in plan.parts]),
        n_draw=plan.shared.n_draw,
        part_records=PART_RECORDS,
        attributes={"key": plan.key},
    )


def _files(folder: Path, dataset: str, part: _Part) -> list[tuple[Path, NDArray[np.bool_]]]:
    """Return the files of a part, one for each month, and which of its records are in each."""
    name = f"part-{part.index:06d}.parquet"
    if np.isnat(part.time).any():
        return [(folder / dataset / name, np.ones(len(part.time), dtype=np.bool_))]
    month = part.time.astype("datetime64[M]")
    return [(folder / dataset / f"{MONTH}{one}" / name, month == one) for one in np.unique(month)]


def _is_whole(file: Path) -> bool:
    """Tell whether a file is there and readable: what cannot be read is done again."""
    try:
        pq.read_metadata(file)
    except (OSError, pa.ArrowInvalid):
        return False
    return True


def _write_files(table: pd.DataFrame, folder: Path, dataset: str, part: _Part) -> None:
    for file, rows in _files(folder, dataset, part):
        _write(table if rows.all() else table[table["record"].isin(part.record[rows])], file)


def _write(table: pd.DataFrame, file: Path) -> None:
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


def _tidy(folder: Path, datasets: Sequence[str]) -> None:
    """Remove what interrupted runs had half written."""
    for name in datasets:
        for leftover in (folder / name).glob("**/.part-*.parquet.*"):
            leftover.unlink(missing_ok=True)
