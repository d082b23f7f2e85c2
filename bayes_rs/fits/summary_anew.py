"""The summary of a fit for other intervals, other derived quantities or another frame, from its draws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.fits.derived import check_derived
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.fit_options import check_prob
from bayes_rs.fits.frames import FRAMES, to_lidar_frame
from bayes_rs.fits.summarizing import DIAGNOSTICS, PriorOutline, summarize_draws, summary_frame
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE


def summarize(fit: FitData, prob: float, derived: Sequence[str], frame: str) -> pd.DataFrame:
    """Summarize the draws of a fit anew; see `Fit.summary`."""
    check_prob(prob)
    check_derived(derived)
    check_choice(frame, FRAMES, what="frame")
    records, table = fit.records, fit.table("summary")
    stresses = table[table["stress"].isin(STRESSES)]
    known = {
        name: stresses[name].to_numpy(dtype=np.float64).reshape(fit.n_record, len(STRESSES)) for name in DIAGNOSTICS
    }
    wind_speed = np.asarray(records["wind_speed"].values, dtype=np.float64)
    outline = PriorOutline(fit.prior_draws, derived)
    columns: dict[str, FloatArray] = {}
    for rows, stress in fit.batches():
        diagnosed = {name: values[rows] for name, values in known.items()}
        if frame == "lidar":
            yaw = np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64)[rows])
            stress = to_lidar_frame(stress, yaw[:, None, None])  # noqa: PLW2901 - the same draws, turned
            diagnosed = _diagnosed_in_frame(stress, diagnosed)
            outline = _outline_in_lidar_frame(fit.prior_draws, derived, yaw)
        for column, values in summarize_draws(stress, outline, wind_speed[rows], prob, diagnosed).items():
            columns.setdefault(column, np.full((fit.n_record, values.shape[1]), np.nan))[rows] = values
    return summary_frame(
        columns, record=np.arange(fit.n_record), time=fit.time, flag=fit.flag, derived=derived, prob=prob
    )


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
