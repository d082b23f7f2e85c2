"""The fit of some records in a row, and its tables: what a worker does."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import NotPositiveDefiniteError
from bayes_rs.fits.batch import Batch, RecordDraws, fit_batch, join_draws
from bayes_rs.fits.columns import (
    ALONG,
    ALONG_SHAPE,
    CORRELATED,
    COVARIANCES,
    PAIRS,
    PATTERN,
    PER_RECORD,
    VARIANCES,
    pattern_columns,
)
from bayes_rs.fits.direction_table import contraction_along, covariances_of
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.flags import FLAGS, flags_after
from bayes_rs.fits.information import variances_alone
from bayes_rs.fits.least_squares_beside import least_squares_of
from bayes_rs.fits.more_draws import by_size, expected_times, monte_carlo_error, times_the_draws, with_draws
from bayes_rs.fits.prepare import can_be_fitted
from bayes_rs.fits.summarizing import summarize_draws, summary_frame
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.decided import PriorRoom, what_data_decided
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling.chains import N_CHAIN, Chains, kept_draws
from bayes_rs.priors.interface import LogRatioPrior
from bayes_rs.processor import processor_kind
from bayes_rs.progress import note_done

_log = logging.getLogger(__name__)
FAILED = (NotPositiveDefiniteError, np.linalg.LinAlgError, FloatingPointError)
"""What the likelihood of a record may fail with."""
_CHUNK = 128
"""Records that are sampled together, at most; memory and how often progress is told, not the result, depend on it. Of
32 each takes 1.1 to 1.25 times the CPU, of 64 up to 1.1 times."""
_CHUNK_SIZE = 128_000
"""Effective draws that are sampled together: where each record has many, progress is told more often."""
_CHUNK_NUMBERS = 4_000_000
"""Entries of the covariances of records that are sampled together: 32 MB an array."""


@dataclass(frozen=True)
class Shared:
    """What every part needs.

    Parameters
    ----------
    noise : Noise
        Of the records' beams.
    options : FitOptions
        Of the fit.
    room : PriorRoom
        What the prior leaves open for the data to decide.
    level : ndarray, shape (n_beam, 6)
        Design matrix of the beams at yaw 0.
    vectors : ndarray, shape (6, 6)
        The directions of R, one a row, from `scan_directions`.
    prior_covariances : tuple of ndarray, shape (6, 6)
        From the function of that name.
    keep_draws : bool
        Whether the draws are kept.
    beam : ndarray of int, shape (n_beam,)
        Numbers of the beams.
    alone : bool
        Whether the records are sampled by their variances alone, too.
    """

    noise: Noise
    options: FitOptions
    room: PriorRoom
    level: FloatArray
    vectors: FloatArray
    prior_covariances: tuple[FloatArray, FloatArray]
    keep_draws: bool
    beam: NDArray[np.int64]
    alone: bool = False


@dataclass(frozen=True)
class Part:
    """Some records in a row: their place among the parts, data, numbers, starts, flags and columns before the fit."""

    index: int
    batch: Batch
    record: NDArray[np.int64]
    time: NDArray[np.datetime64]
    flag: NDArray[np.int64]
    known: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Done:
    """The tables of one part, ``summary``, ``posterior`` and, where draws are kept, ``draws`` and ``predicted``; and
    the kind of processor that made them.
    """

    index: int
    tables: dict[str, pd.DataFrame]
    processor: str = field(default_factory=processor_kind)


def n_kept(options: FitOptions) -> int:
    """Return how many draws of each chain of a record a fit makes."""
    return kept_draws(options.effort.target_ess)


def batch_size(n_beam: int) -> int:
    """Return how many records are sampled together."""
    return int(np.clip(_CHUNK_NUMBERS // n_beam**2, 1, _CHUNK))


def _sampled_together(shared: Shared) -> int:
    """Return how many records are sampled together: fewer where each needs more draws than by default."""
    draws = shared.options.effort.target_ess * expected_times(shared.options)
    return min(batch_size(len(shared.beam)), max(int(_CHUNK_SIZE / draws), 16))


def fit_part(shared: Shared, part: Part) -> Done:
    """Fit the records of one part and lay out its tables."""
    fitted = can_be_fitted(part.batch)
    flag = part.flag.copy()
    found = _Columns(len(part.batch))
    kept: list[tuple[NDArray[np.int64], RecordDraws]] = []
    size, reasons = _sampled_together(shared), list[str]()
    for first in range(0, len(fitted), size):
        wanted = fitted[first : first + size]
        some, draws = _fit_those_that_can(part.batch, wanted, shared, reasons)
        flag[np.setdiff1d(wanted, some)] |= FLAGS["likelihood_failed"]
        if draws is not None:
            after, draws = _to_error(found, some, draws, part.batch, shared)
            flag[some] |= after
            if shared.keep_draws:
                kept.append((part.record[some], replace(draws, noise=None, posterior=None)))
        note_done(len(wanted))
    if reasons:
        _log.warning(
            "Of records %d to %d, %d cannot be fitted: %s",
            *(part.record[0], part.record[-1], len(reasons), reasons[0]),
        )
    tables = {
        "summary": _summary_table(found.summary, part, flag, shared.options),
        "posterior": _posterior_table(found, part, flag),
    }
    if shared.alone:
        tables[VARIANCES] = _summary_table(found.alone, part, flag, shared.options)
        tables[PATTERN] = _pattern_table(found.pattern, part, len(shared.beam))
    if shared.keep_draws:
        tables["draws"] = _joined([_draws_table(*one, shared) for one in kept], shared)
        tables["predicted"] = _joined([_predicted_table(*one, shared) for one in kept], shared, predicted=True)
    return Done(part.index, tables)


def _summary_table(
    columns: dict[str, FloatArray], part: Part, flag: NDArray[np.int64], options: FitOptions
) -> pd.DataFrame:
    return summary_frame(
        columns,
        record=part.record,
        time=part.time,
        flag=flag,
        derived=options.derived,
        prob=options.prob,
        interval=options.interval,
    )


@dataclass
class _Columns:
    """What is known of the records of a part; NaN for those that were not fitted."""

    n_record: int
    summary: dict[str, FloatArray] = field(default_factory=dict)
    alone: dict[str, FloatArray] = field(default_factory=dict)
    numbers: dict[str, FloatArray] = field(default_factory=dict)
    pattern: dict[str, FloatArray] = field(default_factory=dict)
    sampler: NDArray[Any] = field(init=False)
    outside: NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        self.sampler = np.full(self.n_record, "", dtype=object)
        self.outside = np.zeros(self.n_record, dtype=np.bool_)

    def put(self, where: dict[str, FloatArray], rows: NDArray[np.int64], values: Mapping[str, FloatArray]) -> None:
        for name, some in values.items():
            where.setdefault(name, np.full((self.n_record, *some.shape[1:]), np.nan))[rows] = some


def _to_error(
    found: _Columns, rows: NDArray[np.int64], draws: RecordDraws, batch: Batch, shared: Shared
) -> tuple[NDArray[np.int64], RecordDraws]:
    """Enter what the draws of some records tell, and make more of those whose numbers are not as precise as asked.

    Returns the flags of the records and their draws, as many of each as there were before. Draws that are made are all
    of one run, whose number was fixed before it: none is added to those that chose it.
    """
    n_draw, size = draws.chains.stress.shape[2], batch_size(len(shared.beam))
    times = np.ones(len(rows))
    error = _put(found, rows, draws, batch, shared)
    flag = flags_after(draws, shared.options.target_ess)
    while np.any((needed := times_the_draws(error, times, shared.options)) > times):
        for more, places in by_size(needed, times):
            together, wanted = max(1, int(size / more)), replace(shared, options=with_draws(shared.options, more))
            for first in range(0, len(places), together):
                some = places[first : first + together]
                # what could be fitted once can be again; else it keeps the draws that it has
                fitted, again = _fit_those_that_can(batch, rows[some], wanted, [])
                if again is None:
                    continue
                some = some[np.isin(rows[some], fitted)]
                error[some] = _put(found, fitted, again, batch, shared)
                flag[some] = flags_after(again, shared.options.target_ess)
                if shared.keep_draws:
                    others = np.setdiff1d(np.arange(len(rows)), some)
                    order = np.argsort(np.concatenate([others, some]))
                    draws = join_draws([draws.take(others), again.thinned(n_draw)], order)
        times = needed
    if shared.options.monte_carlo_error is not None:
        flag[~(error <= shared.options.monte_carlo_error)] |= FLAGS["short_chain"]
    return flag, draws


def _put(found: _Columns, rows: NDArray[np.int64], draws: RecordDraws, batch: Batch, shared: Shared) -> FloatArray:
    """Enter what the draws of some records tell; return the error of their numbers, as `monte_carlo_error`."""
    chains, some = draws.chains, batch.take(rows)
    decided, learnt = what_data_decided(chains.stress, shared.room, _log_ratios(chains, some, shared))
    beside, error = least_squares_of(some, shared.level, shared.noise, shared.options, draws.noise)
    known = {
        "ess_bulk": chains.ess_bulk,
        "ess_tail": chains.ess_tail,
        "r_hat": chains.r_hat,
        "decided": decided,
        "least_squares": beside,
        "least_squares_se": error,
    }
    options = shared.options
    summary = summarize_draws(
        chains.stress, options.derived, batch.wind_speed[rows], options.prob, options.interval, known
    )
    found.put(found.summary, rows, summary)
    if shared.alone:
        _put_alone(found, rows, known, batch, shared, draws.posterior)
    error = monte_carlo_error(summary)
    flat = chains.stress.reshape(len(rows), -1, len(STRESSES))
    covariances = covariances_of(flat)
    matrix = covariances[0] * (flat.shape[1] / (flat.shape[1] - 1.0))
    along, of_shape = contraction_along(shared.vectors, covariances, batch.yaw[rows], shared.prior_covariances)
    numbers = {
        "stresses_learnt": learnt,
        "acceptance_rate": chains.acceptance,
        "n_step": chains.n_step.astype(np.float64),
        "n_draw": np.full(len(rows), float(flat.shape[1])),
        "mc_error": error,
        "pareto_k": chains.pareto_k,
        "sonic_clipped": draws.clipped,
        **{name: matrix[:, i, j] for name, (i, j) in zip(COVARIANCES, PAIRS, strict=True)},
        **dict(zip(ALONG, along.T, strict=True)),
        **dict(zip(ALONG_SHAPE, of_shape.T, strict=True)),
        **dict(zip(CORRELATED, chains.autocorrelation_time.T, strict=True)),
    }
    found.put(found.numbers, rows, numbers)
    found.sampler[rows] = chains.sampler
    found.outside[rows] = draws.outside
    return error


def _log_ratios(chains: Chains, batch: Batch, shared: Shared) -> tuple[FloatArray, FloatArray] | None:
    """Return the draws as coordinates of logarithms and correlations, and their spread, where the prior has such."""
    prior = batch.prior(shared.options)
    if shared.options.target == "sonic" or not isinstance(prior, LogRatioPrior):
        return None
    return chains.coordinate[..., : prior.n_coordinate], prior.spread


def _put_alone(
    found: _Columns,
    rows: NDArray[np.int64],
    known: dict[str, FloatArray],
    batch: Batch,
    shared: Shared,
    posterior: Posterior | None,
) -> None:
    """Enter what the variances of some records say by themselves, and how well they foretell the covariances."""
    options = shared.options
    some = batch.take(rows)
    draws, misfit, pattern = variances_alone(some, shared.noise, options, posterior)
    chains = draws.chains
    decided, _ = what_data_decided(chains.stress, shared.room, _log_ratios(chains, some, shared))
    diagnosed = {"ess_bulk": chains.ess_bulk, "ess_tail": chains.ess_tail, "r_hat": chains.r_hat, "decided": decided}
    summary = summarize_draws(
        chains.stress,
        options.derived,
        batch.wind_speed[rows],
        options.prob,
        options.interval,
        {**known, **diagnosed},
    )
    found.put(found.alone, rows, summary)
    found.put(found.numbers, rows, misfit)
    found.put(found.pattern, rows, {PATTERN: pattern})


def _pattern_table(columns: dict[str, FloatArray], part: Part, n_beam: int) -> pd.DataFrame:
    """Lay out each record's part of the pattern, one column a datum; NaN where the fit has none."""
    names = pattern_columns(n_beam)
    values = np.full((len(part.batch), len(names)), np.nan)
    if columns:
        values[:, : columns[PATTERN].shape[1]] = columns[PATTERN]
    return pd.DataFrame({"record": part.record, "time": part.time, **dict(zip(names, values.T, strict=True))})


def _posterior_table(found: _Columns, part: Part, flag: NDArray[np.int64]) -> pd.DataFrame:
    missing = np.full(found.n_record, np.nan)
    names = (*PER_RECORD, *COVARIANCES, *ALONG, *ALONG_SHAPE, *CORRELATED)
    return pd.DataFrame(
        {
            "record": part.record,
            "time": part.time,
            "flag_bits": flag,
            "sampler": found.sampler,
            "outside_noise": found.outside,
            **{name: part.known.get(name, found.numbers.get(name, missing)) for name in names},
            "beams_words": part.known.get("beams_words", np.full(found.n_record, "", dtype=object)),
        }
    )


def _fit_those_that_can(
    batch: Batch, rows: NDArray[np.int64], shared: Shared, reasons: list[str]
) -> tuple[NDArray[np.int64], RecordDraws | None]:
    """Fit some records of a batch; return those that could be, and their draws; add why the others could not be."""
    try:
        return rows, fit_batch(batch.take(rows), shared.noise, shared.options, predict=shared.keep_draws)
    except FAILED as error:
        if len(rows) == 1:
            reasons.append(str(error))
            return rows[:0], None
    # a record's numbers do not depend on those beside it: halves find the one that fails
    found = [_fit_those_that_can(batch, half, shared, reasons) for half in np.array_split(rows, 2)]
    fitted = [draws for _, draws in found if draws is not None]
    return np.concatenate([some for some, _ in found]), join_draws(fitted) if fitted else None


def _draws_table(record: NDArray[np.int64], draws: RecordDraws, shared: Shared) -> pd.DataFrame:
    """Lay out draws (n_record, n_chain, n_draw, 6), and those of the nuisances, one row a draw."""
    _, n_chain, n_draw, _ = draws.chains.stress.shape
    kind = shared.options.draws_type
    by_stress = np.moveaxis(draws.chains.stress, -1, 0)  # each in a row in memory, record by record
    return pd.DataFrame(
        {
            **_places(record, n_chain, n_draw),
            **{name: some.astype(kind).reshape(-1) for name, some in zip(STRESSES, by_stress, strict=True)},
            **{name: values.reshape(-1).astype(kind) for name, values in draws.nuisances.items()},
        },
        copy=False,  # all are made here
    )


def _predicted_table(record: NDArray[np.int64], draws: RecordDraws, shared: Shared) -> pd.DataFrame:
    """Lay out predicted variances (n_record, n_chain, n_predicted, n_beam), one row a draw."""
    _, n_chain, n_draw, n_beam = draws.predicted.shape
    by_beam = draws.predicted.reshape(-1, n_beam).T.astype(shared.options.draws_type, order="C")
    beams = {f"beam_{number}": some for number, some in zip(shared.beam.tolist(), by_beam, strict=True)}
    return pd.DataFrame({**_places(record, n_chain, n_draw), **beams}, copy=False)


def _places(record: NDArray[np.int64], n_chain: int, n_draw: int) -> dict[str, NDArray[Any]]:
    return {
        "record": np.repeat(record, n_chain * n_draw),
        "chain": np.tile(np.repeat(np.arange(n_chain, dtype=np.int32), n_draw), len(record)),
        "draw": np.tile(np.arange(n_draw, dtype=np.int32), n_chain * len(record)),
    }


def _joined(tables: list[pd.DataFrame], shared: Shared, *, predicted: bool = False) -> pd.DataFrame:
    """Put tables of draws together; without any, return an empty one with the same columns."""
    if tables:
        return tables[0] if len(tables) == 1 else pd.concat(tables, ignore_index=True)
    more = [f"beam_{number}" for number in shared.beam.tolist()] if predicted else list(STRESSES)
    more += [] if predicted else list(shared.options.nuisances.names)
    return pd.DataFrame(
        {
            **_places(np.empty(0, dtype=np.int64), N_CHAIN, 0),
            **{name: np.empty(0, shared.options.draws_type) for name in more},
        }
    )
