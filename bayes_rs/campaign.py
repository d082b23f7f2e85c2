"""The fit of a long campaign: part by part to a folder, with memory that does not grow, and resumable."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import check_choice, check_count
from bayes_rs._version import __version__
from bayes_rs.batch import Batch, FitOptions, fit_batch
from bayes_rs.digest import digest
from bayes_rs.errors import InputError
from bayes_rs.fitting import batch_size, can_be_fitted, fit_options, flags_after, flags_before, prepare
from bayes_rs.noise import NoiseBank, NoiseModel
from bayes_rs.nuisance import Nuisances
from bayes_rs.output import prepare_resumable_folder, write_run
from bayes_rs.prior import Prior
from bayes_rs.progress import progress_counter
from bayes_rs.result import FLAGS, N_PRIOR_DRAW, PRIOR_SEED, noise_summary
from bayes_rs.scan import Scan
from bayes_rs.stress import STRESSES
from bayes_rs.summarizing import PriorOutline, check_summary_options, summarize_draws, summary_frame
from bayes_rs.workers import check_client, run_dask, run_processes, run_serial

DRAWS = ("none", "float32", "float64")
"""What is kept of the draws."""
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
    instrument_noise: float = 0.0,
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
        ``"none"``, ``"float32"`` or ``"float64"``: keep the draws, too; 49 or 98 kB a record.
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
        If input does not belong together, the folder may not be written, or it holds a run of something else.
    WorkerError
        If worker processes die again and again.
    OSError
        If a part cannot be written, as on a full disk.

    Notes
    -----
    The folder holds Parquet datasets of one file for each part: ``summary`` (the columns of `summary`), ``posterior``
    (one row a record: flag, sampler, diagnostics, whether it is outside the noise bank, and the covariance of the
    stresses) and, on request, ``draws`` (one row a draw); pandas reads each as one table. A part appears whole or not
    at all. Whatever ends a run, what was finished is kept, and a note of the error says how much. All numbers are the
    same for a seed, whatever the number of workers, the order in which they finish, and however often the run was
    interrupted; they are those of `fit`.

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
    began = time.perf_counter()
    check_summary_options(prob, derived)
    check_choice(draws, DRAWS, what="draws")
    check_count(workers, what="workers")
    if client is not None:
        check_client(client)
    options = fit_options(
        prior, target, sampler, likelihood, nuisances, instrument_noise, target_ess, max_extension, seed
    )
    scan, noise, batch = prepare(records, scan, noise)
    parts = _parts(records, batch)
    described = [(part.record, part.time, part.flag) for part in parts]
    key = digest(__version__, scan.key, noise, batch, described, options, prob, derived, draws, PART_RECORDS)
    folder = prepare_resumable_folder(output, key, resume=resume, overwrite=overwrite)
    datasets = ("summary", "posterior", *(("draws",) if draws != "none" else ()))
    left = [part for part in parts if not all(_is_whole(_file(folder, name, part.index)) for name in datasets)]
    n_resumed = n_done = len(batch) - sum(len(part.batch) for part in left)
    outline = PriorOutline(options.prior.draw(N_PRIOR_DRAW, PRIOR_SEED), derived)
    shared = _Shared(noise, options, outline, prob, draws, scan.n_beam)
    silent = None if show_progress is None else not show_progress
    try:
        with (
            progress_counter(len(batch), "fitting", " records", initial=n_resumed, disable=silent) as bar,
            closing(_run(shared, left, workers, client)) as finished,
        ):
            for done in finished:
                for name, table in done.tables.items():
                    _write(table, _file(folder, name, done.index))
                n_done += len(done.tables["posterior"])
                bar.update(len(done.tables["posterior"]))
    except BaseException as error:
        error.add_note(
            f"{n_done} of {len(batch)} records are finished and kept in {str(folder)!r}: the same call with resume "
            "goes on from there."
        )
        raise
    _tidy(folder, datasets)
    row = pd.read_parquet(folder / "posterior", columns=["flag_bits", "outside_noise"])
    flag = row["flag_bits"].to_numpy()
    unfitted = FLAGS["no_usable_beam"] | FLAGS["no_wind"]
    campaign = Campaign(
        folder,
        len(batch),
        int(np.count_nonzero((flag & unfitted) == 0)),
        n_resumed,
        {word: int(np.count_nonzero(flag & bit)) for word, bit in FLAGS.items()},
        time.perf_counter() - began,
    )
    write_run(
        folder,
        {
            "bayes_rs": __version__,
            "key": key,
            "scan": scan.name,
            "scan_key": scan.key,
            "prior": options.prior.in_words(),
            "nuisances": options.nuisances.in_words(),
            "target": target,
            "sampler": sampler,
            "likelihood": likelihood,
            "noise": noise_summary(noise),
            "instrument_noise": float(instrument_noise),
            "seed": options.seed,
            "target_ess": int(target_ess),
            "max_extension": int(max_extension),
            "prob": float(prob),
            "derived": list(derived),
            "draws": draws,
            "n_record": campaign.n_record,
            "n_fitted": campaign.n_fitted,
            "n_outside_noise": int(np.count_nonzero(row["outside_noise"])),
            "flags": campaign.flags,
            "finished": True,
        },
    )
    return campaign


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
    files = sorted((Path(folder) / "summary").glob("part-*.parquet"))
    if not files:
        raise InputError(f"No summary in {str(folder)!r}: give the output folder of fit_campaign.")
    return pd.concat([pd.read_parquet(file) for file in files], ignore_index=True)


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
    size = min(batch_size(shared.n_beam), 128)
    for first in range(0, len(fitted), size):
        some = fitted[first : first + size]
        draws = fit_batch(part.batch.take(some), shared.noise, shared.options, predict=False)
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
        if shared.draws != "none":
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
    if shared.draws != "none":
        empty = _draws_table(np.empty((0, 0, len(STRESSES))), np.empty(0, dtype=np.int64), shared.draws)
        tables["draws"] = pd.concat(kept, ignore_index=True) if kept else empty
    return _Done(part.index, tables)


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


def _file(folder: Path, dataset: str, index: int) -> Path:
    return folder / dataset / f"part-{index:06d}.parquet"


def _is_whole(file: Path) -> bool:
    """Tell whether a file is there and readable: what cannot be read is done again."""
    try:
        pq.read_metadata(file)
    except (OSError, pa.ArrowInvalid):
        return False
    return True


def _write(table: pd.DataFrame, file: Path) -> None:
    """Write a table that appears whole or not at all."""
    file.parent.mkdir(exist_ok=True)
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
        for leftover in (folder / name).glob(".part-*.parquet.*"):
            leftover.unlink(missing_ok=True)
