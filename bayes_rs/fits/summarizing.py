"""The summary: one row for each record and stress, computed for all records at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.derived import INTENSITIES, with_derived
from bayes_rs.fits.flags import flag_words
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_levels, interval_of_ordered, quantile_of_ordered
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE

COLUMNS: tuple[str, ...] = (
    "record",
    "time",
    "stress",
    "mean",
    "sd",
    "median",
    "low",
    "high",
    "prob",
    "interval",
    "decided",
    "least_squares",
    "least_squares_se",
    "mcse_mean",
    "mcse_sd",
    "mcse_median",
    "mcse_low",
    "mcse_high",
    "ess_bulk",
    "ess_tail",
    "r_hat",
    "flag",
)
DIAGNOSTICS = ("ess_bulk", "ess_tail", "r_hat")
_TOGETHER = 8
"""Records whose moments are calculated together: their draws stay in the cache."""
OF_RECORD = ("decided", "least_squares", "least_squares_se")
"""What is known of a record's stresses whatever the interval."""


def summarize_draws(
    stress: FloatArray,
    derived: Sequence[str],
    wind_speed: FloatArray,
    prob: float,
    interval: str,
    known: dict[str, FloatArray] | None = None,
) -> dict[str, FloatArray]:
    """Summarize draws of many records.

    Parameters
    ----------
    stress : ndarray, shape (n_record, n_chain, n_draw, 6)
        Draws of the stresses, m² s⁻².
    derived : sequence of str
        Derived quantities beside the stresses.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speeds, m/s.
    prob : float
        Probability of the intervals.
    interval : str
        Which intervals, one of `INTERVALS`.
    known : dict of str to ndarray, shape (n_record, 6), optional
        Of the stresses: diagnostics, by the names in `DIAGNOSTICS`, where they are known already, and what there is of
        `OF_RECORD`.

    Returns
    -------
    columns : dict of str to ndarray, shape (n_record, n_quantity)
        The columns of numbers of `COLUMNS`.
    """
    names = tuple(derived)
    n_record, n_stress = len(stress), len(STRESSES)
    values = with_derived(stress, names, wind_speed[:, None, None])
    by_quantity = np.ascontiguousarray(np.moveaxis(values, -1, 1))  # (record, quantity, chain, draw)
    ordered = np.sort(by_quantity.reshape(n_record, values.shape[-1], -1), axis=-1)
    diagnosed = {name: (known or {})[name] for name in DIAGNOSTICS if name in (known or {})}
    fresh = by_quantity[:, n_stress:] if set(DIAGNOSTICS) <= set(diagnosed) else by_quantity
    if fresh.shape[1]:
        found = diagnostics.diagnose(fresh, N_ENSEMBLE)
        for name in DIAGNOSTICS:
            own = getattr(found, name)
            diagnosed[name] = np.concatenate([diagnosed[name], own], axis=1) if fresh is not by_quantity else own
    mean, variance, kurtosis = _moments(ordered)
    low, high = interval_of_ordered(ordered, prob, interval)
    below, above = interval_levels(ordered, prob, interval)
    bulk, tail = diagnosed["ess_bulk"], diagnosed["ess_tail"]
    sd = np.sqrt(variance * ordered.shape[-1] / (ordered.shape[-1] - 1.0))
    return {
        "mean": mean,
        "sd": sd,
        "median": quantile_of_ordered(ordered, 0.5),
        "low": low,
        "high": high,
        **_of_record(known or {}, names, n_record),
        "mcse_mean": sd / np.sqrt(bulk),
        "mcse_sd": 0.5 * sd * np.sqrt(np.maximum(kurtosis - 1.0, 0.0) / bulk),
        "mcse_median": diagnostics.quantile_error(ordered, 0.5, bulk),
        "mcse_low": diagnostics.quantile_error(ordered, below, tail),
        "mcse_high": diagnostics.quantile_error(ordered, above, tail),
        **diagnosed,
    }


def _moments(draws: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means, variances over n and kurtosis, each (n_record, n_quantity), of draws (n_record, n_quantity, n)."""
    mean, square, fourth = draws.mean(axis=-1), np.empty(draws.shape[:-1]), np.empty(draws.shape[:-1])
    for first in range(0, len(draws), _TOGETHER):
        some = slice(first, first + _TOGETHER)
        centred = draws[some] - mean[some, :, None]
        np.square(centred, out=centred)
        square[some] = centred.mean(axis=-1)
        fourth[some] = np.einsum("rqd,rqd->rq", centred, centred)
    with np.errstate(invalid="ignore", divide="ignore"):  # draws that are all equal have no kurtosis
        return mean, square, fourth / (draws.shape[-1] * square**2)


def _of_record(known: dict[str, FloatArray], derived: Sequence[str], n_record: int) -> dict[str, FloatArray]:
    """Return the columns `OF_RECORD`; empty for most derived quantities."""
    found = {name: np.full((n_record, len(STRESSES) + len(derived)), np.nan) for name in OF_RECORD}
    for name, values in known.items():
        if name in OF_RECORD:
            found[name][:, : len(STRESSES)] = values
    for place, name in enumerate(derived, len(STRESSES)):
        if name in INTENSITIES:  # the root of a variance over the wind speed
            found["decided"][:, place] = found["decided"][:, INTENSITIES[name]]
    return found


def summary_frame(
    columns: dict[str, FloatArray],
    *,
    record: NDArray[Any],
    time: NDArray[Any],
    flag: NDArray[np.int64],
    derived: Sequence[str],
    prob: float,
    interval: str,
) -> pd.DataFrame:
    """Lay out the columns of `summarize_draws` as a table, one row for each record and quantity.

    Parameters
    ----------
    columns : dict of str to ndarray, shape (n_record, n_quantity)
        Numbers; columns that are missing are NaN.
    record, time, flag : ndarray, shape (n_record,)
        Number, start and flag of each record.
    derived : sequence of str
        Derived quantities after the stresses.
    prob : float
        Probability of the intervals.
    interval : str
        Which intervals they are, one of `INTERVALS`.

    Returns
    -------
    table : DataFrame
        With the columns of `COLUMNS`.
    """
    names = (*STRESSES, *derived)
    n_record, n_name = len(record), len(names)
    words = {value: flag_words(value) for value in np.unique(flag).tolist()}
    missing = np.full(n_record * n_name, np.nan)
    of_records = {
        "record": np.repeat(record, n_name),
        "time": np.repeat(time, n_name),
        "stress": np.tile(np.array(names, dtype=object), n_record),
        "prob": np.full(n_record * n_name, prob),
        "interval": interval,
        "flag": np.repeat(np.array([words[value] for value in flag.tolist()], dtype=object), n_name),
    }
    return pd.DataFrame(
        {
            name: of_records[name] if name in of_records else columns[name].ravel() if name in columns else missing
            for name in COLUMNS
        }
    )
