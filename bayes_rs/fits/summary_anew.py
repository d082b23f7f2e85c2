"""The summary of a fit for other intervals, other derived quantities or another frame, from its draws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray, check_choice, check_prob
from bayes_rs.fits.derived import check_derived
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.frames import FRAMES, to_lidar_frame
from bayes_rs.fits.summarizing import DIAGNOSTICS, OF_RECORD, summarize_draws, summary_frame
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import INTERVALS
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.decided import PriorRoom, leading_variance, what_data_decided
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE


def summarize(fit: FitData, prob: float, interval: str, derived: Sequence[str], frame: str) -> pd.DataFrame:
    """Summarize the draws of a fit anew; see `Fit.summary`."""
    check_prob(prob)
    check_choice(interval, tuple(INTERVALS), what="interval")
    check_derived(derived)
    check_choice(frame, FRAMES, what="frame")
    records, table = fit.records, fit.source.read("summary")
    stresses = table[table["stress"].isin(STRESSES)]
    known = {
        name: stresses[name].to_numpy(dtype=np.float64).reshape(fit.n_record, len(STRESSES))
        for name in (*DIAGNOSTICS, *OF_RECORD)
    }
    # what is known is of all draws of a record, of which those that were kept are a part
    share = fit.run["n_chain"] * fit.run["n_draw"] / fit.of_records("n_draw")["n_draw"]
    known |= {name: known[name] * share[:, None] for name in ("ess_bulk", "ess_tail")}
    wind_speed = np.asarray(records["wind_speed"].values, dtype=np.float64)
    columns: dict[str, FloatArray] = {}
    for rows, stress in fit.batches():
        diagnosed = {name: values[rows] for name, values in known.items()}
        if frame == "lidar":
            yaw = np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64)[rows])
            stress = to_lidar_frame(stress, yaw[:, None, None])  # noqa: PLW2901 - the same draws, turned
            diagnosed = _diagnosed_in_frame(stress, diagnosed)
            diagnosed["decided"] = _decided_in_lidar_frame(stress, fit, yaw)
        for column, values in summarize_draws(stress, derived, wind_speed[rows], prob, interval, diagnosed).items():
            columns.setdefault(column, np.full((fit.n_record, values.shape[1]), np.nan))[rows] = values
    return summary_frame(
        columns,
        record=np.arange(fit.n_record),
        time=fit.time,
        flag=fit.flag,
        derived=derived,
        prob=prob,
        interval=interval,
    )


def _decided_in_lidar_frame(stress: FloatArray, fit: FitData, yaw: FloatArray) -> FloatArray:
    """Return what the data decided of turned draws, against the prior turned by the same wind directions, rad."""
    size = leading_variance(design_matrix(fit.scan.at_yaw(0.0)))
    rooms = (PriorRoom.of(to_lidar_frame(fit.prior_draws, angle), size) for angle in yaw)
    found = [what_data_decided(one[None], room)[0] for one, room in zip(stress, rooms, strict=True)]
    return np.concatenate(found)


def _diagnosed_in_frame(stress: FloatArray, known: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the diagnostics of turned draws; weighted draws are worth no more than in the frame they were made in."""
    found = diagnostics.diagnose(np.ascontiguousarray(np.moveaxis(stress, -1, 1)), N_ENSEMBLE)
    bounds = {name: known[name].max(axis=1, keepdims=True) if name in known else np.inf for name in DIAGNOSTICS}
    return {
        "ess_bulk": np.minimum(found.ess_bulk, bounds["ess_bulk"]),
        "ess_tail": np.minimum(found.ess_tail, bounds["ess_tail"]),
        "r_hat": found.r_hat,
    }
