"""What the report shows of a fit, as arrays over its records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_prob
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.headline import Headline
from bayes_rs.fits.shape_points import SHAPE_NAMES, ShapePoints, shape_points
from bayes_rs.fits.summarizing import DIAGNOSTICS, OF_RECORD
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.report.campaign_section import CampaignShown, campaign_shown

NUMBERS = ("median", "low", "high", "mean", "sd", *OF_RECORD, *DIAGNOSTICS)
"""Columns of the summary that the page shows."""
_N_PRIOR_SHAPE = 2000
_PER_RECORD = ("pareto_k", "misfit", "stresses_learnt")


@dataclass(frozen=True)
class ReportData:
    """What the page shows of a fit.

    Parameters
    ----------
    run : dict
        Content of ``run.json``.
    records : Dataset
        The records that were fitted.
    prob : float
        Probability of the intervals.
    interval : str
        Which intervals they are: ``"equal-tailed"`` or ``"highest-density"``.
    headline : Headline
        What was found, in three lines.
    record, time, flag, wind_speed : ndarray, shape (n_record,)
        Number, start (NaT if there is none), flag bits, and mean wind speed, m/s (NaN if not known).
    numbers : dict of str to ndarray, shape (n_record, 6)
        `NUMBERS` of the six stresses.
    derived : dict of str to dict
        Median and interval, each of shape (n_record,), of the derived quantities.
    per_record : dict of str to ndarray, shape (n_record,)
        ``pareto_k``, ``misfit`` and ``stresses_learnt``.
    covariance : callable
        Gives the posterior covariances (n, 6, 6) of the stresses of some records, m⁴ s⁻⁴.
    draws : callable or None
        Gives so many draws of every record, shape (n_record, n, 6); None if they were not kept.
    prior_shape : ndarray of shape (n, 6)
        Draws of R over its trace under the prior.
    directions : DataFrame
        As from `Fit.direction_medians`.
    sight, prior, target : str
        In words.
    shape : ShapePoints
        The records' points in Lumley's triangle.
    campaign : CampaignShown or str
        The campaign, or why there is none.
    """

    run: dict[str, Any]
    records: xr.Dataset
    prob: float
    interval: str
    headline: Headline
    record: NDArray[np.int64]
    time: NDArray[np.datetime64]
    flag: NDArray[np.int64]
    wind_speed: FloatArray
    numbers: dict[str, FloatArray]
    derived: dict[str, dict[str, FloatArray]]
    per_record: dict[str, FloatArray]
    covariance: Callable[[NDArray[np.int64]], FloatArray]
    draws: Callable[[int], FloatArray] | None
    prior_shape: FloatArray
    directions: pd.DataFrame
    sight: str
    prior: str
    target: str
    shape: ShapePoints
    campaign: CampaignShown | str = ""

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """Which records have a posterior, shape (n_record,)."""
        return np.asarray(np.isfinite(self.numbers["mean"]).all(axis=1))


def report_data(fit: Fit, *, prob: float | None = None) -> ReportData:
    """Return what the report shows of a fit.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`.
    prob : float, optional
        Probability of the intervals; by default that of the fit. Another one needs the draws.

    Returns
    -------
    found : ReportData
        Arrays over the records.

    Raises
    ------
    InputError
        If the fit kept no draws and another probability is asked for.
    """
    own = fit.settings["fit"]
    if prob is not None and check_prob(prob) != own["prob"] and not fit.has_draws:
        raise InputError(
            f"Invalid prob {prob!r}: the fit kept no draws, and its summary holds intervals of {own['prob']:g}; leave "
            "it out, or fit again with --prob."
        )
    names = tuple(dict.fromkeys(("ti", *own["derived"]))) if fit.has_draws else tuple(own["derived"])
    wind_speed = np.asarray(fit.records["wind_speed"].values, dtype=np.float64)
    shape: ShapePoints | None = None
    if prob in (None, own["prob"]) and not names:  # many records, whose summary is not needed as a whole
        numbers, derived = fit.of_stresses(*NUMBERS), dict[str, dict[str, FloatArray]]()
    else:
        more = SHAPE_NAMES if fit.has_draws else ()
        table = fit.summary(prob=prob, derived=tuple(dict.fromkeys((*names, *more))))
        shape = shape_points(fit, table) if more else None
        table = table[table["stress"].isin((*STRESSES, *names))]
        numbers, derived = _numbers(table, fit.n_record), _derived(table)
    if "ti" not in derived and np.isfinite(wind_speed).any():
        speed = np.where(wind_speed > 0.0, wind_speed, np.nan)
        derived["ti"] = {
            name: np.sqrt(numbers[column][:, 0]) / speed
            for name, column in (("median", "median"), ("low", "low"), ("high", "high"))
        }
    prior = fit.prior_draws[:_N_PRIOR_SHAPE]
    return ReportData(
        run=dict(fit.run),
        records=fit.records,
        prob=own["prob"] if prob is None else prob,
        headline=fit.headline(),
        record=np.arange(fit.n_record),
        time=fit.time,
        flag=fit.flag,
        wind_speed=wind_speed,
        numbers=numbers,
        derived=derived,
        per_record=fit.of_records(*_PER_RECORD),
        covariance=fit.covariance,
        draws=partial(_thinned, fit) if fit.has_draws else None,
        prior_shape=np.asarray(prior / prior[:, :3].sum(axis=1, keepdims=True)),
        directions=fit.direction_medians(),
        sight=str(fit.run["sight"]),
        prior=str(fit.run["prior"]),
        target=str(own["target"]),
        shape=shape_points(fit) if shape is None else shape,
        interval=str(own["interval"]),
        campaign=campaign_shown(fit),
    )


def _numbers(table: pd.DataFrame, n_record: int) -> dict[str, FloatArray]:
    rows = table[table["stress"].isin(STRESSES)]  # six rows a record, in the order of STRESSES
    return {name: rows[name].to_numpy(dtype=np.float64).reshape(n_record, len(STRESSES)) for name in NUMBERS}


def _derived(table: pd.DataFrame) -> dict[str, dict[str, FloatArray]]:
    columns = {"median": "median", "low": "low", "high": "high"}
    return {
        str(name): {ours: rows[theirs].to_numpy(dtype=np.float64) for ours, theirs in columns.items()}
        for name, rows in table.groupby("stress", sort=False)
        if name not in STRESSES
    }


def _thinned(fit: Fit, n: int) -> FloatArray:
    """Return n draws of every record, evenly chosen; NaN for records that were not fitted."""
    found = np.full((fit.n_record, n, len(STRESSES)), np.nan)
    for rows, draws in fit.batches():
        flat = draws.reshape(len(rows), -1, len(STRESSES))
        some = np.linspace(0, flat.shape[1] - 1, min(n, flat.shape[1])).round().astype(np.int64)
        found[rows, : len(some)] = flat[:, some]
    return found
