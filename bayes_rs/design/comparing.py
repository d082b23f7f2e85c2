"""Which scan tells most about which stress: credible-interval widths, errors and coverage, side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray, check_choice, check_count, check_positive
from bayes_rs.design.estimators import ESTIMATORS, estimate
from bayes_rs.design.trial_records import even_normals, trial_records
from bayes_rs.errors import InputError
from bayes_rs.fits.fitting import fit
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.progress import progress
from bayes_rs.records.making import make_records
from bayes_rs.simulation.virtual import simulate
from bayes_rs.theory.sonic_theory import sonic_moments
from bayes_rs.turbulence.mann import MannTurbulence

METHODS = ("fast", "full", "both")
TARGETS = ("record", "ensemble")
COLUMNS = (
    "scan",
    "turbulence",
    "prior",
    "data",
    "estimator",
    "stress",
    "truth",
    "width_50",
    "width_90",
    "width_ratio",
    "bias",
    "rmse",
    "bias_median",
    "rmse_median",
    "coverage_50",
    "coverage_90",
    "contraction",
    "contraction_shape",
    "prior_width_90",
    "full_over_fast",
    "rank",
    "sight",
    "n_beam",
    "n_record",
    "seconds",
)


def compare(
    scans: Sequence[str | Scan],
    turbulence: MannTurbulence | Sequence[MannTurbulence],
    *,
    wind_speed: float = 10.0,
    duration: float = 600.0,
    prior: str | Prior | Sequence[str | Prior] = "weak",
    target: str = "record",
    method: str = "fast",
    n_records: int | None = None,
    estimators: Sequence[str] | None = None,
    seed: int = 1,
    show_progress: bool | None = None,
) -> pd.DataFrame:
    """Compare scans by how well they would know the stresses of a turbulence.

    Parameters
    ----------
    scans : sequence of str or Scan
        Scans: names, files, scans, or a name with changes, such as
        ``"6-beam@opening_angle_deg=30,focus_distance=52"``; several focus distances, joined by ``+``, make planes.
    turbulence : MannTurbulence or sequence of MannTurbulence
        The flows.
    wind_speed : float
        Mean wind speed, m/s.
    duration : float
        Length of a record, s.
    prior : str or Prior or sequence of them
        The priors.
    target : str
        Which R: ``"record"`` or ``"ensemble"``, as in `fit`.
    method : str
        ``"fast"``: the variances of records are drawn from the noise model, evenly (a Sobol sequence); their error is
        log-normal by construction. ``"full"``: records are simulated (`simulate` by lines) and treated as measured
        ones. ``"both"``.
    n_records : int, optional
        Records for each scene; by default 128 for fast and 200 for full.
    estimators : sequence of str, optional
        Classic estimators beside the posterior (`estimate`); by default all.
    seed : int
        Same seed, same numbers.
    show_progress : bool, optional
        Progress bar on stderr; by default only on a terminal.

    Returns
    -------
    table : DataFrame
        One row for each scan, turbulence, prior, kind of data, estimator and stress, with the columns of `COLUMNS`:
        expected widths of the central 50 and 90 % intervals, ``width_ratio`` (the 90 % width over the true uu), bias
        and root mean square error of posterior mean and median (or of the classic estimate), shares of intervals that
        hold the truth, contraction against the prior, the prior's own width, rank and unseen directions in words.
        ``full_over_fast`` is the ratio of the 90 % widths where both were asked for. m² s⁻² where not relative.

    Raises
    ------
    InputError
        If a scan, prior, estimator or number is not valid.

    Notes
    -----
    The truth is the turbulence itself, so coverage is that at one R, not on average over the prior: a prior that is
    off pulls it from nominal. Widths and errors are means over records.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> table = brs.compare(["6-beam", "6-beam@opening_angle_deg=45"], brs.load_turbulence("fu-2022"), n_records=16)
    >>> widths = table.query("estimator == 'posterior' and stress == 'vv'")["width_90"]
    >>> bool(widths.iloc[1] < widths.iloc[0])
    True
    """
    check_choice(method, METHODS, what="method of comparison")
    check_choice(target, TARGETS, what="target")
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    if n_records is not None:
        check_count(n_records, what="n_records", minimum=2)
    names = tuple(ESTIMATORS) if estimators is None else tuple(estimators)
    for name in names:
        check_choice(name, tuple(ESTIMATORS), what="estimator")
    loaded = [(scan.name, scan) if isinstance(scan, Scan) else (scan, load_scan(scan)) for scan in scans]
    if not loaded:
        raise InputError("There is no scan to compare: name at least one.")
    flows = [turbulence] if isinstance(turbulence, MannTurbulence) else list(turbulence)
    priors = [make_prior(one) for one in ([prior] if isinstance(prior, (str, Prior)) else prior)]
    kinds = ("fast", "full") if method == "both" else (method,)
    scenes = [(label, scan, flow) for label, scan in loaded for flow in flows]
    rows: list[dict[str, Any]] = []
    silent = None if show_progress is None else not show_progress
    for label, scan, flow in progress(scenes, len(scenes), "comparing", disable=silent):
        noise = theory_noise(scan, flow, wind_speed=wind_speed, duration=duration, yaw=scan.yaw)
        truth = truth_of(scan, flow, wind_speed, duration, target)
        seen = sight(scan)
        about = {
            "scan": label,
            "turbulence": flow.name,
            "rank": seen.rank,
            "sight": seen.in_words(),
            "n_beam": scan.n_beam,
        }
        for kind in kinds:
            began = time.perf_counter()
            count = n_records or (128 if kind == "fast" else 200)
            if kind == "fast":
                records = _drawn_records(scan, noise, truth, target, count, seed)
            else:
                records = _simulated_records(scan, flow, wind_speed, duration, count, seed)
            rows += _classic(records, scan, truth, names, {**about, "data": kind, "n_record": count})
            for one in priors:
                rows += posterior_rows(
                    records, scan, noise, one, target, truth, seed, {**about, "data": kind, "n_record": count}, began
                )
    table = pd.DataFrame(rows).reindex(columns=list(COLUMNS))
    return _with_ratio(table)


def truth_of(scan: Scan, flow: MannTurbulence, wind_speed: float, duration: float, target: str) -> FloatArray:
    """Return the stresses that the fit aims at, shape (6,)."""
    if target == "ensemble":
        return flow.stresses()
    one = scan.select(scan.beam[:1])
    moments = sonic_moments(one, flow, wind_speed=wind_speed, duration=duration, yaw=scan.yaw)
    return np.asarray(moments.mean, dtype=np.float64)


def _drawn_records(scan: Scan, noise: Noise, truth: FloatArray, target: str, count: int, seed: int) -> xr.Dataset:
    """Return records whose variances are log-normal with the noise's moments, drawn evenly."""
    log_covariance = np.log1p(noise.covariance[0])
    values, vectors = np.linalg.eigh(log_covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # eigenvalues below zero are rounding
    # the largest directions take the first, best coordinates of the sequence
    normal = even_normals(count, scan.n_beam, seed)[:, ::-1]
    mean = noise.gain[0] @ truth * (1.0 + (noise.bias[0] if target == "ensemble" else 0.0))
    variance = mean * np.exp(normal @ root.T - 0.5 * np.diag(log_covariance))
    return trial_records(scan, noise, variance)


def _simulated_records(
    scan: Scan, flow: MannTurbulence, wind_speed: float, duration: float, count: int, seed: int
) -> xr.Dataset:
    """Return records of simulated radial velocities; their wind is the one that was simulated."""
    series = simulate(scan, flow, wind_speed=wind_speed, duration=duration, n_records=count, seed=seed)
    records = make_records(series, scan, duration=duration).isel(record=slice(0, count))
    records["wind_speed"] = ("record", np.full(count, wind_speed))
    records["yaw"] = ("record", np.full(count, np.rad2deg(scan.yaw)))
    return records


def posterior_rows(
    records: xr.Dataset,
    scan: Scan,
    noise: Noise,
    prior: Prior,
    target: str,
    truth: FloatArray,
    seed: int,
    about: dict[str, Any],
    began: float,
) -> list[dict[str, Any]]:
    """Fit the records, and measure the posterior against the truth."""
    found = fit(
        records,
        scan,
        noise=noise,
        seed=seed,
        prior=prior,
        target=target,
        sampler="auto",
        draws="float64",
        progress=False,
    )
    stress, of_prior = found.draws(), found.prior_draws
    flat = stress.reshape(len(stress), -1, len(STRESSES))
    levels = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    low90, low50, median, high50, high90 = np.quantile(flat, levels, axis=1)
    mean = flat.mean(axis=1)
    shape, prior_shape = (draws / draws[..., :3].sum(axis=-1, keepdims=True) for draws in (flat, of_prior))
    ends = np.quantile(of_prior, levels[[0, -1]], axis=0)
    seconds = time.perf_counter() - began
    return [
        {
            **about,
            "prior": prior.name,
            "estimator": "posterior",
            "stress": name,
            "truth": truth[i],
            "width_50": np.mean(high50[:, i] - low50[:, i]),
            "width_90": np.mean(high90[:, i] - low90[:, i]),
            "width_ratio": np.mean(high90[:, i] - low90[:, i]) / truth[0],
            "bias": np.mean(mean[:, i] - truth[i]),
            "rmse": np.sqrt(np.mean((mean[:, i] - truth[i]) ** 2)),
            "bias_median": np.mean(median[:, i] - truth[i]),
            "rmse_median": np.sqrt(np.mean((median[:, i] - truth[i]) ** 2)),
            "coverage_50": np.mean((low50[:, i] <= truth[i]) & (truth[i] <= high50[:, i])),
            "coverage_90": np.mean((low90[:, i] <= truth[i]) & (truth[i] <= high90[:, i])),
            "contraction": np.mean(1.0 - flat[..., i].var(axis=1) / of_prior[:, i].var()),
            "contraction_shape": np.mean(1.0 - shape[..., i].var(axis=1) / prior_shape[:, i].var()),
            "prior_width_90": ends[1, i] - ends[0, i],
            "seconds": seconds,
        }
        for i, name in enumerate(STRESSES)
    ]


def _classic(
    records: xr.Dataset, scan: Scan, truth: FloatArray, names: Sequence[str], about: dict[str, Any]
) -> list[dict[str, Any]]:
    """Measure the classic estimators on the same records; stresses that one does not give are left out."""
    rows = []
    for name in names:
        values = estimate(records, scan, method=name)["stress"].transpose("record", "component").values
        for i, stress in enumerate(STRESSES):
            error = values[:, i] - truth[i]
            if np.isfinite(error).any():
                rows.append(
                    {
                        **about,
                        "prior": "",
                        "estimator": name,
                        "stress": stress,
                        "truth": truth[i],
                        "bias": np.nanmean(error),
                        "rmse": np.sqrt(np.nanmean(error**2)),
                    }
                )
    return rows


def _with_ratio(table: pd.DataFrame) -> pd.DataFrame:
    """Fill the ratio of full to fast widths, where there are both."""
    keys = ["scan", "turbulence", "prior", "estimator", "stress"]
    wide = table.pivot_table(index=keys, columns="data", values="width_90", sort=False)
    if {"fast", "full"} <= set(wide.columns):
        ratio = (wide["full"] / wide["fast"]).rename("full_over_fast").reset_index()
        table = table.drop(columns="full_over_fast").merge(ratio, on=keys, how="left")[list(COLUMNS)]
    return table
