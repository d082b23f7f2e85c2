"""The conclusions of the scanning-pattern study (Fu, Sebastiani, Peña and Mann 2022), each from our own exact numbers.

Least squares with six stresses is linear in the variances, so its scatter follows from the noise by theory without any
Monte Carlo: Cov = A⁺ Σ A⁺ᵀ with Σ = K·E E. The interval widths are those of `compare`, with drawn noise.
"""

import itertools
from functools import cache

import numpy as np
import pytest

from bayes_rs import compare, load_scan, load_turbulence
from bayes_rs.design.scene import truth_of
from bayes_rs.geometry.forward import design_matrix, sight
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.by_theory import theory_noise

FLOW = load_turbulence("fu-2022")
WIND_SPEED = 10.0


@cache
def scatter(name, opening_angle_deg=None, focus_distance=None):
    """Standard deviations of the six least-squares stresses in 10-minute records, by theory."""
    scan = load_scan(
        name,
        opening_angle_deg=opening_angle_deg,
        focus_distance=focus_distance if not isinstance(focus_distance, tuple) else list(focus_distance),
    )
    noise = theory_noise(scan, FLOW, wind_speed=WIND_SPEED)
    expected = noise.gain[0] @ truth_of(scan, FLOW, WIND_SPEED, 600.0, "record")
    inverse = np.linalg.pinv(design_matrix(scan))
    covariance = inverse @ (noise.covariance[0] * np.outer(expected, expected)) @ inverse.T
    return dict(zip(STRESSES, np.sqrt(np.diag(covariance)), strict=True))


@pytest.mark.parametrize("name", ["staring", "2-beam", "4-beam", "5-beam", "50-beam"])
def test_fewer_than_six_beams_or_one_angle_do_not_see_all_six_stresses(name):
    assert sight(load_scan(name)).rank < 6


@pytest.mark.parametrize("name", ["6-beam", "51-beam", "spinnerlidar@probe=point"])
def test_six_beams_with_one_at_another_angle_do(name):
    assert sight(load_scan(name)).rank == 6


def test_a_larger_opening_angle_beats_more_beams():
    """6 beams at 30° against 51 at 15°, both at 98 m: every stress but uu, of which all know about as much."""
    wide, many = scatter("6-beam", 30.0), scatter("51-beam")
    for stress in ("vv", "ww", "uv", "uw", "vw"):
        assert wide[stress] < 0.7 * many[stress]


def test_fifty_one_beams_are_no_better_than_six_at_fifteen_degrees():
    six, many = scatter("6-beam"), scatter("51-beam")
    for stress in STRESSES:
        assert 0.75 < many[stress] / six[stress] < 1.25


def test_farther_focus_is_worse_for_the_stresses_across_the_wind():
    near, middle, far = (scatter("6-beam", 15.0, distance) for distance in (49.0, 98.0, 142.0))
    for stress in ("vv", "ww", "uv", "uw", "vw"):
        assert near[stress] < middle[stress] < far[stress]


def test_the_error_falls_with_the_opening_angle_from_15_to_45_degrees():
    angles = [scatter("6-beam", angle, 52.0) for angle in (15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0)]
    for stress in ("vv", "ww", "uv", "uw", "vw"):
        values = [angle[stress] for angle in angles]
        assert all(one > other for one, other in itertools.pairwise(values))


def test_six_beams_at_45_degrees_beat_the_spinnerlidar():
    """The study's recommendation: 6 beams at 45° and 52 m against 400 within 30°, at 98 m."""
    six, rosette = scatter("6-beam", 45.0, 52.0), scatter("spinnerlidar@probe=point")
    for stress in ("vv", "ww", "uv", "uw", "vw"):
        assert six[stress] < rosette[stress]


def test_several_planes_of_one_cone_do_not_help():
    """The unseen direction stays unseen; with a centre beam, five planes take little from the scatter of one."""
    assert sight(load_scan("50-beam", focus_distance=[49.0, 72.0, 98.0, 121.0, 142.0])).rank == 5
    one, five = scatter("6-beam"), scatter("6-beam", 15.0, (49.0, 72.0, 98.0, 121.0, 142.0))
    assert 0.7 < five["vv"] / one["vv"] < 1.05
    for stress in STRESSES:
        assert five[stress] < 1.1 * one[stress]


def test_all_lidars_get_uu():
    """The 90 % interval of uu is about as wide for all: 128 drawn records have a standard error of 2 %."""
    table = compare(["2-beam", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam"], estimators=())
    widths = table[table["stress"] == "uu"]["width_90"]
    assert widths.max() / widths.min() < 1.12
    biases = table[table["stress"] == "uu"]["bias"] / table["truth"].iloc[0]
    assert biases.abs().max() < 0.1
