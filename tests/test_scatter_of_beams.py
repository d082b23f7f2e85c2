"""How beams scatter against each other: no alarm in clean air with probe volumes, nor where white noise is known."""

import numpy as np
import pytest

import bayes_rs as brs
from bayes_rs.alarms.beam_check import _above

WIDE = "6-beam@opening_angle_deg=45,focus_distance=52"


def fitted(scan, seed, n_records, white=0.0):
    series = brs.simulate(scan, "fu-2022", wind_speed=10.0, n_records=n_records, seed=seed)
    noise = white * np.random.default_rng(0).normal(size=series.sizes["sample"])
    series = series.assign(radial_velocity=series["radial_velocity"] + noise)
    return brs.fit(brs.make_records(series, scan), scan, seed=1, draws="none")


def factor(fit):
    return fit.run["beams"]["scatter"]["factor"]


@pytest.mark.parametrize("seed", [23, 25, 29])
def test_no_alarm_in_clean_air_that_a_probe_sees(seed):
    """Before: 1.50, 1.35 and more, for the smallest eigenvalues of K are below the error of its theory."""
    fit = fitted("zx-tm", seed, 12)
    assert factor(fit) < 1.4
    assert not any("scatter against" in line for line in fit.remarks)


@pytest.mark.parametrize("white", [0.0, 0.5, 1.0, 2.0])
def test_white_noise_that_is_known_is_expected(white):
    """Before: 1.2, 2.2, 3.0 and 2.5. The bootstrap's standard deviation is 0.06."""
    fit = fitted("50-beam", 5, 20, white)
    assert factor(fit) == pytest.approx(1.0, abs=0.15)
    assert not any("scatter against" in line for line in fit.remarks)


def test_of_few_beams_too():
    """Before: 0.26, and the word of larger eddies."""
    assert not any("scatter against" in line for line in fitted(WIDE, 5, 20, 1.0).remarks)


def test_directions_below_the_accuracy_are_left_out():
    own = np.diag([1.0, 0.1, 1e-4])
    root, nothing = np.linalg.cholesky(own), np.zeros((3, 1))
    residual = np.array([1.0, 0.1, 1.0])
    square, count = _above(own, root, np.eye(3), np.ones(3, dtype=bool), nothing, residual, 1e-3)
    assert count == 2
    assert square == pytest.approx(1.0 + 0.1)
