"""The summary: one row for each record and stress, computed for all records at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.errors import InputError
from bayes_rs.fits.derived import check_derived, with_derived
from bayes_rs.fits.frames import FRAMES, to_lidar_frame
from bayes_rs.fits.result import check_result, flag_words, group
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE

COLUMNS: tuple[str, ...] = (
    "record",
    "time",
    "stress",
    "mean",
    "sd",
    "median",
    "hdi_low",
    "hdi_high",
    "prob",
    "contraction",
    "contraction_shape",
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
_BATCH = 64
"""Records that are summarized together."""


def summary(
    result: xr.DataTree, *, prob: float = 0.9, derived: Sequence[str] = (), frame: str = "wind"
) -> pd.DataFrame:
    """Summarize the posterior of every record.

    Parameters
    ----------
    result : DataTree
        From `fit`, or read from its file.
    prob : float
        Probability of the highest-density intervals.
    derived : sequence of str
        Quantities beside the six stresses: turbulence intensities ``"ti"`` (σ_u/U), ``"ti_v"``, ``"ti_w"``; ``"tke"``;
        ``"friction_velocity"``; ``"correlation_uv"``, ``"correlation_uw"``, ``"correlation_vw"``; the invariants
        ``"anisotropy_2"``, ``"anisotropy_3"`` and ``"lumley_xi"``, ``"lumley_eta"`` of the anisotropy tensor.
    frame : {"wind", "lidar"}
        Axes of the stresses and of what is derived from them: of the record's mean wind, or of the levelled lidar (x
        against its view, y to its right, z up), by the record's ``yaw``.

    Returns
    -------
    table : DataFrame
        One row for each record and stress (and derived quantity), with the columns of `COLUMNS`: number and start of
        the record; posterior mean, sd, median and ends of the highest-density interval, m² s⁻² for stresses;
        contraction; Monte-Carlo standard errors of mean, sd, median and of the interval's ends; effective sample
        sizes, R-hat, and flags in words. Records that were not fitted have NaN.

    Raises
    ------
    InputError
        If the tree is not a result of `fit`, prob is not between 0 and 1, or a derived quantity or the frame is not
        known.

    Notes
    -----
    contraction = 1 − Var[posterior] / Var[prior]. Near 1 the data decided, near 0 the prior did. A prior that leaves
    the size of the turbulence open makes the contraction of every stress near 1, because any beam tells the size; so
    contraction_shape is the same number for the stress divided by the trace uu + vv + ww, from which the size is gone.

    The Monte-Carlo errors follow from the effective sample sizes: of the mean sd/√n, of the sd ½ sd √((κ − 1)/n) with
    the kurtosis κ, of the median and the ends those of the quantiles at their places. The shortest interval slides a
    little over intervals of the same probability besides, which its ends' errors leave out.
    """
    check_result(result)
    check_summary_options(prob, derived)
    check_choice(frame, FRAMES, what="frame")
    stress = group(result, "posterior")["stress"].transpose("record", "chain", "draw", "component").values
    prior = group(result, "prior")["stress"].values.reshape(-1, len(STRESSES))
    outline = PriorOutline(prior, derived)
    observed = group(result, "observed_data")
    wind_speed = observed["wind_speed"].values
    stats = group(result, "sample_stats")
    known = {name: stats[name].transpose("record", "component").values for name in DIAGNOSTICS if name in stats}
    fitted = np.flatnonzero(np.isfinite(stress).all(axis=(1, 2, 3)))
    columns: dict[str, FloatArray] = {}
    for start in range(0, len(fitted), _BATCH):
        chunk = fitted[start : start + _BATCH]
        in_frame, diagnosed = stress[chunk], {name: values[chunk] for name, values in known.items()}
        if frame == "lidar":
            yaw = np.deg2rad(observed["yaw"].values[chunk])
            in_frame = to_lidar_frame(in_frame, yaw[:, None, None])
            diagnosed = _diagnosed_in_frame(in_frame, diagnosed)
            outline = _outline_in_lidar_frame(prior, derived, yaw)
        part = summarize_draws(in_frame, outline, wind_speed[chunk], prob, diagnosed)
        for column, values in part.items():
            columns.setdefault(column, np.full((len(stress), values.shape[1]), np.nan))[chunk] = values
    no_time = np.full(len(stress), np.datetime64("NaT", "ns"))
    return summary_frame(
        columns,
        record=observed["record"].values,
        time=observed["time"].values if "time" in observed.coords else no_time,
        flag=stats["flag"].values,
        derived=derived,
        prob=prob,
    )


class PriorOutline:
    """Variances of the stresses, and of their shape, under the prior: what contraction compares with.

    Parameters
    ----------
    draws : ndarray, shape (n_draw, 6)
        Draws of the prior.
    derived : sequence of str
        Derived quantities beside the stresses.
    """

    def __init__(self, draws: FloatArray, derived: Sequence[str]) -> None:
        self.derived = tuple(derived)
        self.variance = with_derived(draws, derived).var(axis=0)  # the prior says nothing of the wind speed: TI is NaN
        self.shape_variance = (draws / draws[:, :3].sum(axis=1, keepdims=True)).var(axis=0)


def _outline_in_lidar_frame(draws: FloatArray, derived: Sequence[str], yaw: FloatArray) -> PriorOutline:
    """Return the outline of the prior in the lidar's frame, one row of variances for each wind direction, rad."""
    turned = PriorOutline(draws, derived)
    parts = [PriorOutline(to_lidar_frame(draws, angle), derived) for angle in yaw]
    turned.variance = np.stack([part.variance for part in parts])
    turned.shape_variance = np.stack([part.shape_variance for part in parts])
    return turned


def _diagnosed_in_frame(stress: FloatArray, known: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the diagnostics of turned draws; weighted draws are worth no more than in the frame they were made in."""
    found = diagnostics.diagnose(np.ascontiguousarray(np.moveaxis(stress, -1, 1)), N_ENSEMBLE)
    bounds = {name: known[name].max(axis=1, keepdims=True) if name in known else np.inf for name in DIAGNOSTICS}
    return {
        "ess_bulk": np.minimum(found.ess_bulk, bounds["ess_bulk"]),
        "ess_tail": np.minimum(found.ess_tail, bounds["ess_tail"]),
        "r_hat": found.r_hat,
    }


def summarize_draws(
    stress: FloatArray,
    prior: PriorOutline,
    wind_speed: FloatArray,
    prob: float,
    known: dict[str, FloatArray] | None = None,
) -> dict[str, FloatArray]:
    """Summarize draws of many records.

    Parameters
    ----------
    stress : ndarray, shape (n_record, n_chain, n_draw, 6)
        Draws of the stresses, m² s⁻².
    prior : PriorOutline
        The prior, and which derived quantities are wanted.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speeds, m/s.
    prob : float
        Probability of the highest-density intervals.
    known : dict of str to ndarray, shape (n_record, 6), optional
        Diagnostics of the stresses, by the names in `DIAGNOSTICS`, where they are known already.

    Returns
    -------
    columns : dict of str to ndarray, shape (n_record, n_quantity)
        The columns of numbers of `COLUMNS`.
    """
    names = prior.derived
    n_record, n_stress = len(stress), len(STRESSES)
    values = with_derived(stress, names, wind_speed[:, None, None])
    by_quantity = np.ascontiguousarray(np.moveaxis(values, -1, 1))  # (record, quantity, chain, draw)
    ordered = np.sort(by_quantity.reshape(n_record, values.shape[-1], -1), axis=-1)
    diagnosed = dict(known or {})
    fresh = by_quantity[:, n_stress:] if set(DIAGNOSTICS) <= set(diagnosed) else by_quantity
    if fresh.shape[1]:
        found = diagnostics.diagnose(fresh, N_ENSEMBLE)
        for name in DIAGNOSTICS:
            own = getattr(found, name)
            diagnosed[name] = np.concatenate([diagnosed[name], own], axis=1) if fresh is not by_quantity else own
    mean = ordered.mean(axis=-1)
    centred = ordered - mean[..., None]
    square = centred * centred
    variance = square.mean(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):  # draws that are all equal have no kurtosis
        kurtosis = np.einsum("rqd,rqd->rq", square, square) / (ordered.shape[-1] * variance**2)
    low, high, share = diagnostics.interval_of_ordered(ordered, prob)
    bulk, tail = diagnosed["ess_bulk"], diagnosed["ess_tail"]
    trace = stress[..., :3].sum(axis=-1, keepdims=True)
    shape = (stress / trace).reshape(n_record, -1, n_stress)
    contraction_shape = np.full(mean.shape, np.nan)
    contraction_shape[:, :n_stress] = 1.0 - shape.var(axis=1) / prior.shape_variance
    sd = np.sqrt(variance * ordered.shape[-1] / (ordered.shape[-1] - 1.0))
    half = np.full(mean.shape, 0.5)
    return {
        "mean": mean,
        "sd": sd,
        "median": np.median(ordered, axis=-1),
        "hdi_low": low,
        "hdi_high": high,
        "contraction": 1.0 - variance / prior.variance,
        "contraction_shape": contraction_shape,
        "mcse_mean": sd / np.sqrt(bulk),
        "mcse_sd": 0.5 * sd * np.sqrt(np.maximum(kurtosis - 1.0, 0.0) / bulk),
        "mcse_median": diagnostics.quantile_error(ordered, half, bulk),
        "mcse_low": diagnostics.quantile_error(ordered, share, tail),
        "mcse_high": diagnostics.quantile_error(ordered, share + prob, tail),
        **diagnosed,
    }


def summary_frame(
    columns: dict[str, FloatArray],
    *,
    record: NDArray[Any],
    time: NDArray[Any],
    flag: NDArray[np.int64],
    derived: Sequence[str],
    prob: float,
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

    Returns
    -------
    table : DataFrame
        With the columns of `COLUMNS`.
    """
    names = (*STRESSES, *derived)
    n_record, n_name = len(record), len(names)
    words = {value: flag_words(value) for value in np.unique(flag).tolist()}
    missing = np.full(n_record * n_name, np.nan)
    table = pd.DataFrame(
        {
            "record": np.repeat(record, n_name),
            "time": np.repeat(time, n_name),
            "stress": np.tile(np.array(names, dtype=object), n_record),
            "prob": prob,
            "flag": np.repeat(np.array([words[value] for value in flag.tolist()], dtype=object), n_name),
            **{
                column: columns[column].ravel() if column in columns else missing
                for column in COLUMNS
                if column not in ("record", "time", "stress", "prob", "flag")
            },
        }
    )
    return table[list(COLUMNS)]


def check_summary_options(prob: float, derived: Sequence[str]) -> None:
    """Refuse options of `summary` that it cannot take, before any work is done for it.

    Raises
    ------
    InputError
        If prob is not between 0 and 1, or a derived quantity is not known.
    """
    if not 0.0 < prob < 1.0:
        raise InputError(f"Invalid prob {prob!r}: it must be between 0 and 1.")
    check_derived(derived)
