"""The check of the prior's width: what it must find where the data decide, and where they cannot."""

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import STRESSES, InputError, load_scan, prior_sensitivity
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.noise.noise import Noise
from bayes_rs.priors.ratio import WeakPrior


def scene(name, *, relative_variance=0.06, n_record=8, **overrides):
    scan = load_scan(name, **overrides)
    noise = plain_noise(scan, relative_variance=relative_variance)
    rng = np.random.default_rng(1)
    return records_of(draw_variances(WeakPrior().draw(n_record, rng), scan, noise, rng), scan), scan, noise


def test_rows_and_the_factor_one():
    records, scan, noise = scene("6-beam")
    table = prior_sensitivity(records, scan, noise=noise, seed=1, factors=(0.5, 3.0))
    assert table["factor"].tolist() == np.repeat([0.5, 1.0, 3.0], 6).tolist()
    assert table["stress"].tolist() == [*STRESSES] * 3
    plain = table[table["factor"] == 1.0]
    assert (plain["width_ratio"] == 1.0).all()
    assert (plain["shift"] == 0.0).all()


def test_a_staring_lidar_leaves_ww_to_the_prior_and_uu_to_the_data():
    records, scan, noise = scene("staring")
    table = prior_sensitivity(records, scan, noise=noise, seed=1)
    words = table[table["factor"] == 1.0].set_index("stress")["decided_by"]
    assert words["uu"] == "the data"
    assert words["ww"] == "the prior"
    wide = table[table["factor"] == 2.0].set_index("stress")["width_ratio"]
    assert wide["uu"] < 1.1
    assert wide["ww"] > 1.8


def test_nearly_exact_data_decide_everything():
    """Six beams at 45° with errors of 1 % that are independent: the prior's width has no say."""
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    noise = Noise(
        bias=np.zeros(6),
        gain=design_matrix(scan),
        covariance=1e-4 * np.eye(6),
        beam=scan.beam,
        scan_name=scan.name,
        scan_geometry=scan.geometry(),
        wind_speed=10.0,
        yaw=0.0,
        duration=600.0,
        turbulence=plain_noise(scan).turbulence,
        method="given",
    )
    rng = np.random.default_rng(2)
    records = records_of(draw_variances(WeakPrior().draw(6, rng), scan, noise, rng), scan)
    table = prior_sensitivity(records, scan, noise=noise, seed=1)
    assert (table["decided_by"] == "the data").all()


def test_refusals():
    records, scan, noise = scene("6-beam", n_record=2)
    with pytest.raises(InputError, match="Invalid factor -1"):
        prior_sensitivity(records, scan, noise=noise, seed=1, factors=(-1.0,))
    with pytest.raises(InputError, match="Invalid prob 1"):
        prior_sensitivity(records, scan, noise=noise, seed=1, prob=1.0)
    records["flag"][:] = 1
    with pytest.raises(InputError, match="No record could be fitted"):
        prior_sensitivity(records, scan, noise=noise, seed=1)
