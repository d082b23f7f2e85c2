"""The summary: one row for each record and stress, computed for all records at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs import diagnostics
from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.errors import InputError
from bayes_rs.result import check_result, flag_words, group
from bayes_rs.sampling.chains import N_ENSEMBLE
from bayes_rs.stress import STRESSES, principal_variances

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
    "ess_bulk",
    "ess_tail",
    "r_hat",
    "flag",
)


def turbulence_kinetic_energy(stress: FloatArray) -> FloatArray:
    """Return k = ½(uu + vv + ww), m² s⁻², of stresses (..., 6)."""
    return np.asarray(0.5 * stress[..., :3].sum(axis=-1))


def friction_velocity(stress: FloatArray) -> FloatArray:
    """Return u* = (uw² + vw²)^(1/4), m/s, of stresses (..., 6)."""
    return np.sqrt(np.hypot(stress[..., 4], stress[..., 5]))


def _invariant(order: int) -> Callable[[FloatArray], FloatArray]:
    def of(stress: FloatArray) -> FloatArray:
        variances = principal_variances(stress)
        deviation = variances / variances.sum(axis=-1, keepdims=True) - 1.0 / 3.0
        return np.asarray((deviation**order).sum(axis=-1))

    return of


DERIVED: dict[str, Callable[[FloatArray], FloatArray]] = {
    "tke": turbulence_kinetic_energy,
    "friction_velocity": friction_velocity,
    "anisotropy_2": _invariant(2),
    "anisotropy_3": _invariant(3),
}
"""Derived quantities by name, functions of stresses (..., 6): kinetic energy k (m² s⁻²), friction velocity u* (m/s),
and the invariants b_ij b_ji and b_ij b_jk b_ki of the anisotropy tensor b = R/(2k) − I/3. Turbulence intensity,
"ti", is σ_u/U and needs the wind speed beside the stresses."""


def summary(result: xr.DataTree, *, prob: float = 0.9, derived: Sequence[str] = ()) -> pd.DataFrame:
    """Summarize the posterior of every record.

    Parameters
    ----------
    result : DataTree
        From `fit`, or read from its file.
    prob : float
        Probability of the highest-density intervals.
    derived : sequence of str
        Quantities beside the six stresses: ``"ti"``, ``"tke"``, ``"friction_velocity"``, ``"anisotropy_2"``,
        ``"anisotropy_3"``.

    Returns
    -------
    table : DataFrame
        One row for each record and stress (and derived quantity), with the columns of `COLUMNS`: number and start of
        the record; posterior mean, sd, median and ends of the highest-density interval, m² s⁻² for stresses;
        contraction; effective sample sizes, R-hat, and flags in words. Records that were not fitted have NaN.

    Raises
    ------
    InputError
        If the tree is not a result of `fit`, prob is not between 0 and 1, or a derived quantity is not known.

    Notes
    -----
    contraction = 1 − Var[posterior] / Var[prior]. Near 1 the data decided, near 0 the prior did. A prior that leaves
    the size of the turbulence open makes the contraction of every stress near 1, because any beam tells the size; so
    contraction_shape is the same number for the stress divided by the trace uu + vv + ww, from which the size is gone.
    """
    check_result(result)
    check_summary_options(prob, derived)
    stress = group(result, "posterior")["stress"].transpose("record", "chain", "draw", "component").values
    prior = group(result, "prior")["stress"].values.reshape(-1, len(STRESSES))
    observed = group(result, "observed_data")
    wind_speed = observed["wind_speed"].values
    names = (*STRESSES, *derived)
    fitted = np.flatnonzero(np.isfinite(stress).all(axis=(1, 2, 3)))
    columns = {
        column: np.full((len(stress), len(names)), np.nan)
        for column in COLUMNS
        if column not in ("record", "time", "stress", "prob", "flag")
    }
    for start in range(0, len(fitted), 256):
        chunk = fitted[start : start + 256]
        part = _summarize(stress[chunk], prior, wind_speed[chunk], derived, prob)
        for column, values in part.items():
            columns[column][chunk] = values
    n_record, n_name = len(stress), len(names)
    record = observed["record"].values
    no_time = np.full(n_record, np.datetime64("NaT", "ns"))
    time = observed["time"].values if "time" in observed.coords else no_time
    flags = [flag_words(flag) for flag in group(result, "sample_stats")["flag"].values]
    table = pd.DataFrame(
        {
            "record": np.repeat(record, n_name),
            "time": np.repeat(time, n_name),
            "stress": np.tile(np.array(names, dtype=object), n_record),
            "prob": prob,
            "flag": np.repeat(np.array(flags, dtype=object), n_name),
            **{column: values.ravel() for column, values in columns.items()},
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
    for name in derived:
        check_choice(name, ("ti", *DERIVED), what="derived quantity")


def _summarize(
    stress: FloatArray, prior: FloatArray, wind_speed: FloatArray, derived: Sequence[str], prob: float
) -> dict[str, FloatArray]:
    """Return the summary's columns, each (n_record, n_name), of stresses (n_record, n_chain, n_draw, 6)."""
    values = np.moveaxis(stress, -1, 1)
    prior_values = prior.T
    for name in derived:
        if name == "ti":
            extra = np.sqrt(stress[..., 0]) / wind_speed[:, None, None]
            extra_prior = np.full(len(prior), np.nan)  # the prior says nothing of the wind speed
        else:
            extra, extra_prior = DERIVED[name](stress), DERIVED[name](prior)
        values = np.concatenate([values, extra[:, None]], axis=1)
        prior_values = np.concatenate([prior_values, extra_prior[None]])
    flat = values.reshape(*values.shape[:2], -1)
    low, high = diagnostics.highest_density_interval(flat, prob)
    shape = stress / stress[..., :3].sum(axis=-1, keepdims=True)
    prior_shape = prior / prior[:, :3].sum(axis=1, keepdims=True)
    contraction_shape = np.full(flat.shape[:2], np.nan)
    contraction_shape[:, : len(STRESSES)] = 1.0 - shape.var(axis=(1, 2)) / prior_shape.var(axis=0)
    return {
        "mean": flat.mean(axis=-1),
        "sd": flat.std(axis=-1, ddof=1),
        "median": np.median(flat, axis=-1),
        "hdi_low": low,
        "hdi_high": high,
        "contraction": 1.0 - flat.var(axis=-1) / prior_values.var(axis=1),
        "contraction_shape": contraction_shape,
        "ess_bulk": diagnostics.ess_bulk(values),
        "ess_tail": diagnostics.ess_tail(values),
        "r_hat": diagnostics.r_hat(values, N_ENSEMBLE),
    }
