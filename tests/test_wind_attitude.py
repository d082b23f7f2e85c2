"""Attitude: signs, and that a record's own tilt and roll are another scan."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import InputError, Scan, fit, load_scan
from bayes_rs.geometry import design_matrix
from bayes_rs.geometry.attitude import gain_turn, level_direction, roll_matrix
from bayes_rs.geometry.scan import tilt_matrix, yaw_matrix
from bayes_rs.noise.noise import Noise
from bayes_rs.priors import RatioPrior

fit = partial(fit, campaign="off")
"""What one record tells is tested."""

ROUNDING = 1e-12


def with_attitude(records, tilt, roll, yaw=None):
    found = records.assign(
        tilt=("record", np.full(records.sizes["record"], tilt)), roll=("record", np.full(records.sizes["record"], roll))
    )
    return found if yaw is None else found.assign(yaw=("record", np.full(records.sizes["record"], yaw)))


def really_at(name, tilt, roll, yaw, **options):
    """Return a scan whose beams were turned by hand, beam by beam."""
    scan = load_scan(name, **options)
    c, s = np.cos(np.deg2rad(roll)), np.sin(np.deg2rad(roll))
    turned = [[x, c * y - s * z, s * y + c * z] for x, y, z in scan.beam_direction]
    return Scan(
        "turned",
        turned,
        focus_distance=scan.focus_distance,
        beam_time=scan.beam_time,
        scan_duration=scan.scan_duration,
        tilt=np.deg2rad(tilt),
        yaw=np.deg2rad(yaw),
    )


class TestSigns:
    def test_a_positive_roll_raises_the_beams_on_the_right(self):
        right, left = np.array([-1.0, 0.3, 0.0]), np.array([-1.0, -0.3, 0.0])
        roll = roll_matrix(np.deg2rad(10.0))
        assert (right @ roll)[2] > 0.0 > (left @ roll)[2]
        np.testing.assert_allclose(np.cross([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), [0.0, 1.0, 0.0])  # right = ahead × up

    def test_a_roll_leaves_the_axis(self):
        np.testing.assert_allclose(np.array([-1.0, 0.0, 0.0]) @ roll_matrix(0.7), [-1.0, 0.0, 0.0], atol=ROUNDING)

    def test_rotations(self):
        matrix = roll_matrix(np.linspace(-3.0, 3.0, 7))
        np.testing.assert_allclose(
            matrix @ matrix.swapaxes(-1, -2), np.broadcast_to(np.eye(3), (7, 3, 3)), atol=ROUNDING
        )
        np.testing.assert_allclose(np.linalg.det(matrix), 1.0, rtol=ROUNDING)
        np.testing.assert_allclose(roll_matrix(0.3) @ roll_matrix(0.4), roll_matrix(0.7), atol=ROUNDING)

    def test_roll_first_then_tilt(self):
        """Roll is about the lidar's own axis: the axis of a tilted and rolled lidar points where the tilt says."""
        scan = load_scan("staring")
        direction = level_direction(scan, np.deg2rad(5.0), np.deg2rad(40.0))
        np.testing.assert_allclose(direction, [[-np.cos(np.deg2rad(5.0)), 0.0, np.sin(np.deg2rad(5.0))]], atol=ROUNDING)


class TestGain:
    @pytest.mark.parametrize("nominal", [0.0, 5.0])
    @pytest.mark.parametrize(("tilt", "roll", "yaw"), [(2.0, 0.0, 0.0), (0.0, 6.0, 0.0), (-3.0, 8.0, 25.0)])
    def test_turned_gains_are_those_of_the_turned_beams(self, nominal, tilt, roll, yaw):
        scan = load_scan("6-beam", tilt_deg=nominal)
        records = with_attitude(records_of(np.ones((2, 6)), scan), tilt, roll, yaw)
        turn = gain_turn(records, scan)
        assert turn is not None
        found = design_matrix(scan.at_yaw(np.deg2rad(yaw))) @ turn[1]
        np.testing.assert_allclose(found, design_matrix(really_at("6-beam", tilt, roll, yaw)), atol=ROUNDING)

    def test_the_scans_own_attitude_changes_nothing(self):
        scan = load_scan("6-beam", tilt_deg=5.0)
        turn = gain_turn(with_attitude(records_of(np.ones((1, 6)), scan), 5.0, 0.0, 12.0), scan)
        np.testing.assert_allclose(turn, np.eye(6)[None], atol=ROUNDING)

    def test_records_without_a_roll_use_the_scans_attitude(self):
        scan = load_scan("6-beam")
        assert gain_turn(records_of(np.ones((1, 6)), scan).assign(tilt=("record", [9.0])), scan) is None

    def test_tilt_then_yaw_is_the_order_of_the_design(self):
        scan = load_scan("6-beam", tilt_deg=5.0)
        by_hand = scan.beam_direction @ tilt_matrix(scan.tilt) @ yaw_matrix(0.2)
        np.testing.assert_allclose(scan.at_yaw(0.2), by_hand, atol=ROUNDING)

    def test_refuses_an_angle_that_is_not_one(self):
        scan = load_scan("6-beam")
        records = with_attitude(records_of(np.ones((2, 6)), scan), 0.0, np.nan)
        with pytest.raises(InputError, match=r"Invalid roll nan of record 0: it must be a finite angle, degrees"):
            gain_turn(records, scan)


@pytest.mark.parametrize(("name", "banked"), [("6-beam", False), ("50-beam", True)])
def test_fit_uses_the_attitude_of_each_record(name, banked):
    """A lidar that rolled by 12° and tilted by 6°: R comes back with its attitude known, and does not without."""
    options = {"opening_angle_deg": 45.0}
    scan, turned = load_scan(name, **options), really_at(name, 6.0, 12.0, 0.0, **options)
    stress = np.array([[1.2, 0.7, 0.4, 0.1, -0.25, 0.05]])
    rng = np.random.default_rng(8)
    variance = draw_variances(stress, turned, plain_noise(turned, relative_variance=2e-4), rng)
    model = plain_noise(scan, relative_variance=2e-4)
    if banked:  # the way of many beams, reduced beforehand
        model = Noise.join((replace(model, wind_speed=8.0), replace(model, wind_speed=12.0)))
    records = records_of(variance, scan)
    prior = RatioPrior()

    def distance(given):
        found = fit(given, scan, noise=model, seed=1, prior=prior, sampler="direct", target_ess=300)
        table = found.summary()
        return np.abs(table["mean"].to_numpy() - stress[0]) / table["sd"].to_numpy()

    assert (
        distance(with_attitude(records, 6.0, 12.0)).max() < 4.5
    )  # six errors of one posterior, in its standard deviations
    assert distance(records).max() > 6.0
