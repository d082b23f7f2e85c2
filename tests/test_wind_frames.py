"""Frames: what the beams see does not depend on the axes, and summaries turn as the draws do."""

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import InputError, fit, load_scan
from bayes_rs.fits.frames import to_lidar_frame
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.posteriors.decided import PriorRoom, what_data_decided
from bayes_rs.priors.ratio import WeakPrior


@pytest.fixture(scope="module")
def result():
    scan = load_scan("6-beam", yaw_deg=25.0)
    noise = plain_noise(scan)
    rng = np.random.default_rng(1)
    stress = WeakPrior().draw(3, rng)
    records = records_of(draw_variances(stress, scan, noise, rng), scan, yaw_deg=25.0)
    records["yaw"].values[1] = 0.0
    records["flag"].values[2] = 1
    return scan, fit(records, scan, noise=noise, seed=1, target_ess=400)


@pytest.mark.parametrize("yaw_deg", [0.0, 25.0, -100.0])
def test_no_radial_variance_changes(yaw_deg):
    scan = load_scan("6-beam", tilt_deg=3.0)
    stress = WeakPrior().draw(5, 2)
    yaw = np.deg2rad(yaw_deg)
    turned = to_lidar_frame(stress, np.full(5, yaw))
    in_wind, in_lidar = design_matrix(scan.at_yaw(yaw)), design_matrix(scan.level_direction)
    np.testing.assert_allclose(turned @ in_lidar.T, stress @ in_wind.T, rtol=1e-12)


def test_a_quarter_turn_swaps_the_axes():
    turned = to_lidar_frame(np.array([3.0, 2.0, 1.0, 0.0, 0.5, 0.0]), np.deg2rad(90.0))
    # wind from the right blows to −y: u is −y of the lidar
    np.testing.assert_allclose(turned, [2.0, 3.0, 1.0, 0.0, 0.0, -0.5], atol=1e-12)


def test_draws_and_summary_agree(result):
    _, tree = result
    draws = tree.lidar_frame()
    table = tree.summary(frame="lidar").set_index(["record", "stress"])
    mean = draws.mean(("chain", "draw")).values
    for record in range(2):
        for index, name in enumerate(("uu", "vv", "ww", "uv", "uw", "vw")):
            assert table.loc[(record, name), "mean"] == pytest.approx(mean[record, index], rel=1e-10)
    assert table.loc[2, "mean"].isna().all()


def test_at_no_yaw_both_frames_are_one(result):
    _, tree = result
    in_wind, in_lidar = (tree.summary(frame=frame) for frame in ("wind", "lidar"))
    columns = ["mean", "sd", "low", "high", "decided"]
    one, other = (table[table["record"] == 1][columns].to_numpy() for table in (in_wind, in_lidar))
    np.testing.assert_allclose(one, other, rtol=1e-9)
    # the sampler's own look compares early and late steps, too, which other frames cannot
    r_hat = [table[table["record"] == 1]["r_hat"].to_numpy() for table in (in_wind, in_lidar)]
    np.testing.assert_allclose(r_hat[0], r_hat[1], atol=0.02)
    ess = [table[table["record"] == 1]["ess_bulk"].to_numpy() for table in (in_wind, in_lidar)]
    assert np.all(ess[1] <= ess[0].max())
    assert not np.allclose(*(table[table["record"] == 0]["mean"] for table in (in_wind, in_lidar)), rtol=0.01)


def test_what_the_data_decided_is_against_the_prior_in_the_same_frame(result):
    _, tree = result
    table = tree.summary(frame="lidar", derived=["tke", "ti"]).set_index(["record", "stress"])
    prior = to_lidar_frame(tree["prior/stress"].values.reshape(-1, 6), np.deg2rad(25.0))
    draws = tree.lidar_frame().transpose("record", "chain", "draw", "component").values[:1]
    expected = what_data_decided(draws, PriorRoom.of(prior))[0][0]
    found = [table.loc[(0, name), "decided"] for name in ("uu", "vv", "ww", "uv", "uw", "vw")]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    draws = draws.reshape(-1, 6)
    assert table.loc[(0, "ti"), "mean"] == pytest.approx(np.sqrt(draws[:, 0]).mean() / 10.0, rel=1e-9)
    plain = tree.summary(derived=["tke"]).set_index(["record", "stress"])
    assert table.loc[(0, "tke"), "mean"] == pytest.approx(plain.loc[(0, "tke"), "mean"], rel=1e-9)


def test_refuses_another_frame(result):
    _, found = result
    with pytest.raises(InputError, match=r"Unknown frame 'earth': it must be one of wind, lidar\."):
        found.summary(frame="earth")
