"""Which scan tells most about which stress: credible-interval widths, errors and coverage, side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.design.compare_options import CompareOptions
from bayes_rs.design.estimators import estimate
from bayes_rs.design.scan_grid import DESIGN, design_of, named_scans
from bayes_rs.design.trial_records import drawn_records, simulated_records
from bayes_rs.errors import InputError
from bayes_rs.fits.fitting import fit
from bayes_rs.geometry.forward import design_matrix, sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_of
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.options import from_plain
from bayes_rs.posteriors.decided import PriorRoom, leading_variance, what_data_decided
from bayes_rs.posteriors.prior_at_size import prior_interval_at_size
from bayes_rs.priors.registry import Prior
from bayes_rs.progress import progress as shown
from bayes_rs.sizes import check_size, check_work
from bayes_rs.theory.pairs import seconds_of_pairs
from bayes_rs.theory.sampling_times import sample_counts
from bayes_rs.theory.sonic_theory import sonic_moments
from bayes_rs.turbulence.mann import MannTurbulence

COLUMNS = (
    "scan",
    *DESIGN,
    "turbulence",
    "prior",
    "data",
    "estimator",
    "stress",
    "truth",
    "interval",
    "width_50",
    "width_90",
    "width_ratio",
    "bias",
    "rmse",
    "bias_median",
    "rmse_median",
    "coverage_50",
    "coverage_90",
    "decided",
    "stresses_learnt",
    "prior_width_90",
    "prior_width_90_at_size",
    "full_over_fast",
    "rank",
    "sight",
    "n_record",
    "seconds",
)
_BYTES_A_RECORD, _BYTES_A_BEAM, _SECONDS_A_RECORD = 5e5, 1e3, 2e-3  # draws and their copies; posterior
ENOUGH = 0.02
"""More beams buy nothing where a width is within this of the width with the most beams."""


def compare(
    scans: str | Path | Scan | Sequence[str | Path | Scan],
    *,
    label: str | Sequence[str] | None = None,
    progress: bool | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Compare scans by how well they would know the stresses of a turbulence.

    Parameters
    ----------
    scans : str or Path or Scan, or sequence of them
        Scans: names, files, scans, or a name with changes, such as
        ``"6-beam@opening_angle_deg=30,focus_distance=52"``. Several values of a change, separated by ``/``, make
        several scans, and of several changes all combinations: ``"6-beam@opening_angle_deg=15/30/45,n_beams=4/6"``.
        Several focus distances joined by ``+`` are the planes of one scan.
    label : str or sequence of str, optional
        What each of `scans` is called in the table and in pictures, in place of its name; a label before a name, as
        ``"wide=6-beam@opening_angle_deg=45"``, does the same. Of several scans made from one name, the label stands for
        what is before the ``@``.
    progress : bool, optional
        Progress bar on stderr; by default only on a terminal.
    **options
        Fields of `CompareOptions`: ``turbulence``, ``prior``, ``wind_speed``, ``duration``, ``target``, ``method``,
        ``n_records``, ``estimators``, ``interval`` and ``seed``.

    Returns
    -------
    table : DataFrame
        One row for each scan, record length, turbulence, prior, kind of data, estimator and stress, with the columns of
        `COLUMNS`: what the scan is (all beams, whether one points along the axis, largest opening angle and focus
        distance, mounting), expected widths of the 50 and 90 % intervals, of the kind ``interval``; ``width_ratio``
        (the 90 % width over the true uu), bias and root mean square error of posterior mean and median (or of the
        classic estimate), shares of intervals that hold the truth, what the data ``decided`` and ``stresses_learnt``
        (as in `Fit.summary`, means over the records), the prior's own width, and its mean width once the record's size
        uu + vv + ww is known (``prior_width_90_at_size``), rank and unseen directions in words. ``full_over_fast`` is
        the ratio of the 90 % widths where both were asked for. m² s⁻² where not relative.

    Raises
    ------
    InputError
        If a scan or an option is not valid.

    Notes
    -----
    The truth is the turbulence itself, so coverage is that at one R, not on average over the prior: a prior that is
    off pulls it from nominal. Widths and errors are means over records. With ``method="fast"`` the errors of the
    variances are log-normal by construction, and those that some R explains are the same for every scan.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> table = brs.compare("6-beam@opening_angle_deg=15/45", n_records=16)
    >>> widths = table.query("estimator == 'posterior' and stress == 'vv'")["width_90"]
    >>> bool(widths.iloc[1] < widths.iloc[0])
    True
    """
    chosen = from_plain(CompareOptions, options, where="the call of compare")
    loaded, flows, priors = named_scans(scans, label), chosen.flows(), chosen.priors()
    cells = list(product(loaded, chosen.durations, flows))
    _check_cells(cells, chosen, len(priors))
    rows: list[dict[str, Any]] = []
    silent = None if progress is None else not progress
    for (name, scan), duration, flow in shown(cells, len(cells), "comparing", disable=silent):
        scene = _Scene.at(name, scan, flow, duration, chosen)
        for kind in chosen.kinds:
            began = time.perf_counter()
            records = scene.records(kind, chosen.count(kind), chosen.seed)
            about = {**scene.about, "data": kind, "n_record": chosen.count(kind)}
            rows += [{**about, **row} for row in _classic_rows(records, scene, chosen.classic)]
            for prior in priors:
                found = _posterior_rows(records, scene, prior, chosen.interval, chosen.seed)
                seconds = time.perf_counter() - began
                rows += [{**about, **row, "seconds": seconds} for row in found]
    return _with_ratio(pd.DataFrame(rows).reindex(columns=list(COLUMNS)))


def _check_cells(cells: Sequence[Any], chosen: CompareOptions, n_prior: int) -> None:
    """Refuse a comparison that no memory holds or no one waits for, before the first of its scenes."""
    count = max(chosen.count(kind) for kind in chosen.kinds)
    advice = "choose fewer records or fewer scans."
    seconds = 0.0
    for (_, scan), duration, _ in cells:
        n_sample = int(np.max(sample_counts(scan, duration)))
        check_size(
            f"{count} records of scan {scan.name!r}", count * (_BYTES_A_RECORD + _BYTES_A_BEAM * scan.n_beam), advice
        )
        seconds += seconds_of_pairs(scan, n_sample) + count * n_prior * _SECONDS_A_RECORD
    check_work(f"{len(cells)} scenes of {count} records", seconds, advice)


@dataclass(frozen=True, eq=False)
class _Scene:
    """A scan in a flow: its noise, and the stresses that the fit aims at."""

    scan: Scan
    flow: MannTurbulence
    noise: Noise
    target: str
    truth: FloatArray
    about: dict[str, Any]

    @classmethod
    def at(cls, label: str, scan: Scan, flow: MannTurbulence, duration: float, chosen: CompareOptions) -> _Scene:
        """Return the scene of one cell of the comparison."""
        seen = sight(scan)
        return cls(
            scan,
            flow,
            theory_noise(scan, flow, wind_speed=chosen.wind_speed, duration=duration, yaw=scan.yaw),
            chosen.target,
            truth_of(scan, flow, chosen.wind_speed, duration, chosen.target),
            {
                "scan": label,
                **design_of(scan),
                "duration": duration,
                "turbulence": flow.name,
                "rank": seen.rank,
                "sight": seen.in_words(),
            },
        )

    def records(self, kind: str, count: int, seed: int) -> xr.Dataset:
        """Return records of this kind."""
        noise = self.noise
        if kind == "full":
            return simulated_records(self.scan, self.flow, float(noise.wind_speed[0]), noise.duration, count, seed)
        mean = noise.gain[0] @ self.truth * (1.0 + (noise.bias[0] if self.target == "ensemble" else 0.0))
        return drawn_records(self.scan, noise, mean, self.truth, count, seed)


def truth_of(scan: Scan, flow: MannTurbulence, wind_speed: float, duration: float, target: str) -> FloatArray:
    """Return the stresses that the fit aims at, shape (6,)."""
    if target == "ensemble":
        return flow.stresses()
    one = scan.select(scan.beam[:1])
    moments = sonic_moments(one, flow, wind_speed=wind_speed, duration=duration, yaw=scan.yaw)
    return np.asarray(moments.mean, dtype=np.float64)


def _posterior_rows(records: xr.Dataset, scene: _Scene, prior: Prior, interval: str, seed: int) -> list[dict[str, Any]]:
    """Fit the records, and measure the posterior against the truth."""
    truth = scene.truth
    found = fit(
        records,
        scene.scan,
        noise=scene.noise,
        seed=seed,
        prior=prior,
        target=scene.target,
        sampler="auto",
        draws="float64",
        campaign="off",  # what one record tells is compared
        progress=False,
    )
    stress, of_prior = found.draws(), found.prior_draws
    flat = stress.reshape(len(stress), -1, len(STRESSES))
    by_stress = np.moveaxis(flat, 1, -1)
    (low50, high50), (low90, high90) = (interval_of(by_stress, prob, interval) for prob in (0.5, 0.9))
    median = np.median(flat, axis=1)
    mean = flat.mean(axis=1)
    decided, learnt = what_data_decided(
        stress, PriorRoom.of(of_prior, leading_variance(design_matrix(scene.scan.at_yaw(0.0))))
    )
    own = interval_of(of_prior.T, 0.9, interval)
    size = flat[..., :3].sum(axis=-1)
    at_size = prior_interval_at_size(of_prior, size.mean(axis=1), size.std(axis=1), 0.9, interval)
    measured = {
        "truth": truth,
        "width_50": np.mean(high50 - low50, axis=0),
        "width_90": np.mean(high90 - low90, axis=0),
        "width_ratio": np.mean(high90 - low90, axis=0) / truth[0],
        "bias": np.mean(mean - truth, axis=0),
        "rmse": np.sqrt(np.mean((mean - truth) ** 2, axis=0)),
        "bias_median": np.mean(median - truth, axis=0),
        "rmse_median": np.sqrt(np.mean((median - truth) ** 2, axis=0)),
        "coverage_50": np.mean((low50 <= truth) & (truth <= high50), axis=0),
        "coverage_90": np.mean((low90 <= truth) & (truth <= high90), axis=0),
        "decided": np.mean(decided, axis=0),
        "stresses_learnt": np.full(len(STRESSES), np.mean(learnt)),
        "prior_width_90": own[1] - own[0],
        "prior_width_90_at_size": np.mean(at_size[1] - at_size[0], axis=0),
    }
    of_stress = (dict(zip(measured, values, strict=True)) for values in zip(*measured.values(), strict=True))
    about = {"prior": prior.name, "estimator": "posterior", "interval": interval}
    return [{**about, "stress": name, **values} for name, values in zip(STRESSES, of_stress, strict=True)]


def _classic_rows(records: xr.Dataset, scene: _Scene, names: Sequence[str]) -> list[dict[str, Any]]:
    """Measure the classic estimators on the same records; stresses that one does not give are left out."""
    rows = []
    for name in names:
        values = estimate(records, scene.scan, method=name)["stress"].transpose("record", "component").values
        for stress, found, truth in zip(STRESSES, values.T, scene.truth, strict=True):
            error = found - truth
            if np.isfinite(error).any():
                measured = {"bias": np.nanmean(error), "rmse": np.sqrt(np.nanmean(error**2))}
                rows.append({"prior": "", "estimator": name, "stress": stress, "truth": truth, **measured})
    return rows


def _with_ratio(table: pd.DataFrame) -> pd.DataFrame:
    """Fill the ratio of full to fast widths, where there are both."""
    keys = ["scan", "duration", "turbulence", "prior", "estimator", "stress"]
    wide = table.pivot_table(index=keys, columns="data", values="width_90", sort=False)
    if {"fast", "full"} <= set(wide.columns):
        ratio = (wide["full"] / wide["fast"]).rename("full_over_fast").reset_index()
        table = table.drop(columns="full_over_fast").merge(ratio, on=keys, how="left")[list(COLUMNS)]
    return table


def enough_beams(table: pd.DataFrame, *, within: float = ENOUGH) -> pd.DataFrame:
    """Find the number of beams beyond which more of them buy nothing.

    Parameters
    ----------
    table : DataFrame
        From `compare`, for scans that differ in their number of beams.
    within : float
        How much wider than with the most beams an interval may be, relatively.

    Returns
    -------
    found : DataFrame
        A row for each stress of scans that are alike but for the number of beams, with what they have in common:
        ``enough``, the smallest number of beams from which on all 90 % widths are within `within` of the last, and
        ``most``, the largest number.

    Raises
    ------
    InputError
        If no two scans of the table differ in the number of beams only.

    Examples
    --------
    >>> table = compare("6-beam@n_beams=4/6/20", n_records=16, estimators=())
    >>> enough_beams(table).query("stress == 'uu'")[["enough", "most"]].values.tolist()
    [[6, 20]]
    """
    check_positive(within, what="within", unit="")
    keys = [*(name for name in DESIGN if name != "n_beam"), "turbulence", "prior", "data", "stress"]
    rows: list[dict[str, Any]] = []
    for case, some in table[table["estimator"] == "posterior"].groupby(keys, sort=False):
        ordered = some.sort_values("n_beam")
        width, number = ordered["width_90"].to_numpy(), ordered["n_beam"].to_numpy()
        if len(number) < 2 or len(set(number)) < len(number):
            continue
        wide = np.flatnonzero(width > (1.0 + within) * width[-1])
        first = 0 if len(wide) == 0 else int(wide[-1]) + 1
        rows.append({**dict(zip(keys, case, strict=True)), "enough": int(number[first]), "most": int(number[-1])})
    if not rows:
        raise InputError(
            "No scans of the table differ in their number of beams only: compare several numbers, as "
            "6-beam@n_beams=4/6/8."
        )
    return pd.DataFrame(rows)
