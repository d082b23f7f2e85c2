"""Coverage on records of simulated turbulence: truths from the prior, noise from boxes that no noise model has seen."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scenes import records_of
from scipy import stats

from bayes_rs import fit, load_scan, load_turbulence
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.models import models_folder
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.noise.file import load_noise
from bayes_rs.priors.registry import WeakPrior

fit = partial(fit, campaign="off")
"""What one record tells is tested."""

SCENES = {
    "4-beam": ("4-beam", {}, "4-beam.nc"),
    "6-beam": ("6-beam", {}, "6-beam.nc"),
    "6-beam-45": ("6-beam", {"opening_angle_deg": 45.0, "focus_distance": 52.0}, "6-beam-45deg-52m.nc"),
    "50-beam": ("50-beam", {}, "50-beam.nc"),
}


@pytest.fixture(scope="module")
def relative_variances():
    """Beam variances over their expectation, made by benchmarks/make_box_records.py."""
    return pd.read_parquet(Path(__file__).parent / "data" / "box_records.parquet")


def ranks(name, relative_variances, noise, scan, seed):
    """Rank of the truth in each posterior, shape (n_record, 6): y = n·R n times what the box did to that beam."""
    relative = relative_variances[[f"{name}/{beam}" for beam in scan.beam]].to_numpy(dtype=np.float64)
    stress = WeakPrior().draw(len(relative), seed)
    records = records_of(relative * (stress @ design_matrix(scan).T), scan)
    result = fit(records, scan, noise=noise, seed=1, target_ess=400)
    draws = result["posterior/stress"].transpose("record", "component", "chain", "draw").values
    return (draws.reshape(len(relative), 6, -1) < stress[:, :, None]).mean(axis=-1)


@pytest.mark.parametrize("method", ["boxes", "theory"])
@pytest.mark.parametrize("name", list(SCENES))
def test_intervals_hold_the_truth_as_often_as_they_say(name, method, relative_variances):
    """The noise is that of one turbulence, not of each truth: a small price, which must stay within sampling error."""
    preset, options, file = SCENES[name]
    scan = load_scan(preset, **options)
    if method == "boxes":
        noise = load_noise(models_folder("noise") / file)
    else:
        noise = calibrate(scan, load_turbulence("fu-2022"), wind_speed=10.0, method="theory")
    rank = ranks(name, relative_variances, noise, scan, seed=31)
    n_record = len(rank)
    for level in (0.5, 0.8, 0.9, 0.95):
        inside = np.count_nonzero(np.abs(rank - 0.5) < 0.5 * level, axis=0)
        # records of one box are nearly, not fully, independent: three quarters of them count
        effective = int(0.75 * n_record)
        scaled = inside * effective / n_record
        assert np.all(scaled >= stats.binom.ppf(5e-6, effective, level))
        assert np.all(scaled <= stats.binom.ppf(1.0 - 5e-6, effective, level))


def test_ignoring_the_correlation_of_the_beams_is_caught(relative_variances):
    """The test has power: fifty beams taken as independent are far too sure of uu."""

    scan = load_scan("50-beam")
    noise = load_noise(models_folder("noise") / "50-beam.nc")
    independent = replace(noise, covariance=np.diag(np.diag(noise.covariance[0])), standard_error=None)
    rank = ranks("50-beam", relative_variances, independent, scan, seed=32)
    inside = np.count_nonzero(np.abs(rank[:, 0] - 0.5) < 0.45)
    assert inside < stats.binom.ppf(1e-6, len(rank), 0.9)
