"""The fit of some records in a row, and its tables: what a worker of a long fit does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import NotPositiveDefiniteError
from bayes_rs.fits.batch import Batch, FitOptions, RecordDraws, fit_batch, join_draws
from bayes_rs.fits.direction_table import contraction_along, direction_rows
from bayes_rs.fits.fitting import batch_size, can_be_fitted, flags_after
from bayes_rs.fits.result import FLAGS
from bayes_rs.fits.summarizing import PriorOutline, summarize_draws, summary_frame
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.sampling.chains import N_CHAIN, kept_draws
from bayes_rs.posteriors.sonic import ESS_MARGIN

ALONG = tuple(f"direction_{number}" for number in range(1, len(STRESSES) + 1))
"""Columns with the contraction along each direction of R; the directions themselves stand in `run.json`."""
ALONG_SHAPE = tuple(f"direction_shape_{number}" for number in range(1, len(STRESSES) + 1))
"""The same of the shape of R."""
_FAILED = (NotPositiveDefiniteError, np.linalg.LinAlgError, FloatingPointError)
"""What the likelihood of a record may fail with."""
_PER_RECORD = ("acceptance_rate", "n_step", "pareto_k", "misfit", "sonic_clipped")
_PAIRS = [(i, j) for i in range(len(STRESSES)) for j in range(i, len(STRESSES))]


@dataclass(frozen=True)
class Shared:
    """What every part needs.

    Parameters
    ----------
    noise : Noise
        Of the records' beams.
    options : FitOptions
        Of the fit.
    outline : PriorOutline
        What contraction compares with.
    vectors : ndarray, shape (6, 6)
        The directions of R, one a row, from `scan_directions`.
    prior_covariances : tuple of ndarray, shape (6, 6)
        From the function of that name.
    prob : float
        Probability of the intervals.
    draws : str
        What is kept of the draws.
    n_beam : int
        Beams of the scan.
    """

    noise: Noise
    options: FitOptions
    outline: PriorOutline
    vectors: FloatArray
    prior_covariances: tuple[FloatArray, FloatArray]
    prob: float
    draws: str
    n_beam: int

    @property
    def n_draw(self) -> int:
        """Draws of a record."""
        margin = ESS_MARGIN if self.options.target == "sonic" else 1.0
        return N_CHAIN * kept_draws(int(np.ceil(margin * self.options.target_ess)))


@dataclass(frozen=True)
class Part:
    """Some records in a row: their place among the parts, data, numbers, starts, and flags before the fit."""

    index: int
    batch: Batch
    record: NDArray[np.int64]
    time: NDArray[np.datetime64]
    flag: NDArray[np.int64]


@dataclass(frozen=True)
class Done:
    """The tables of one part, and its draws (n_record, n_draw, 6) where they go to a Zarr store."""

    index: int
    tables: dict[str, pd.DataFrame]
    draws: NDArray[np.float32] | None = None


def fit_part(shared: Shared, part: Part) -> Done:
    """Fit the records of one part and lay out its tables."""
    fitted = can_be_fitted(part.batch)
    n_record, n_name = len(part.batch), len(STRESSES) + len(shared.outline.derived)
    columns: dict[str, NDArray[np.float64]] = {}
    flag = part.flag.copy()
    covariance = np.full((n_record, len(_PAIRS)), np.nan)
    per_record = {name: np.full(n_record, np.nan) for name in _PER_RECORD}
    along, along_shape = (np.full((n_record, len(STRESSES)), np.nan) for _ in range(2))
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
        along[some], along_shape[some] = contraction_along(
            shared.vectors, flat, part.batch.yaw[some], shared.prior_covariances
        )
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
                **dict(zip(ALONG, along.T, strict=True)),
                **dict(zip(ALONG_SHAPE, along_shape.T, strict=True)),
            }
        ),
    }
    if shared.draws in ("float32", "float64"):
        empty = _draws_table(np.empty((0, 0, len(STRESSES))), np.empty(0, dtype=np.int64), shared.draws)
        tables["draws"] = pd.concat(kept, ignore_index=True) if kept else empty
    return Done(part.index, tables, stored)


def _fit_those_that_can(
    batch: Batch, rows: NDArray[np.int64], shared: Shared
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


def directions_of(rows: pd.DataFrame, run: Mapping[str, Any]) -> pd.DataFrame | None:
    """Return the table of `bayes_rs.directions` of a long fit.

    Parameters
    ----------
    rows : DataFrame
        The table ``posterior``, or some of its rows.
    run : dict
        Content of ``run.json``.

    Returns
    -------
    table : DataFrame or None
        None if the fit is of a version that did not keep it.
    """
    known = run.get("directions")
    if not isinstance(known, dict) or not {*ALONG, *ALONG_SHAPE} <= set(rows.columns):
        return None
    along, along_shape = (rows[list(names)].to_numpy(dtype=np.float64) for names in (ALONG, ALONG_SHAPE))
    weight, vectors = (np.asarray(known[name], dtype=np.float64) for name in ("weight", "vectors"))
    return direction_rows(rows["record"].to_numpy(), weight, vectors, along, along_shape)
