"""The noise of beams with a probe volume in boxes: against exact covariances and the theory."""

from dataclasses import replace

import numpy as np
import pytest
from noise_checks import check_noise
from test_theory_and_simulation import FLOWS, SEED, SIGMAS, box_differences, box_noise, grid_of

from bayes_rs import simulate
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import ContinuousWaveProbe, PulsedProbe
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import pack_stress
from bayes_rs.noise.box_noise import Boxes, noise_from_boxes
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.records.making import make_records
from bayes_rs.simulation.boxes import BoxGrid, BoxMaker
from bayes_rs.simulation.virtual import RecordState, grid_for
from bayes_rs.turbulence.mann import MannTurbulence

PROBES = {
    "continuous-wave": ContinuousWaveProbe(rayleigh_length=6.1),
    "optics": ContinuousWaveProbe(wavelength=1.565e-6, aperture_radius=0.028),
    "pulsed": PulsedProbe(gate_length=30.0),
    "gaussian": PulsedProbe(gate_length=20.0, pulse="gaussian", pulse_length=30.0),
}
WIDE_EDDIES = MannTurbulence(dissipation=0.05, length_scale=100.0, gamma=3.2)  # few grid points for short records


def scan_with(probe, name="6-beam", **options):
    return replace(load_scan(name, **options), probe=PROBES[probe])


class TestCovariance:
    @pytest.mark.parametrize("flow", FLOWS)
    @pytest.mark.parametrize(
        ("probe", "name"), [("continuous-wave", "6-beam"), ("optics", "4-beam"), ("pulsed", "6-beam")]
    )
    def test_is_that_of_the_same_truncated_periodic_flow(self, probe, name, flow):
        """By the formula of Isserlis over the box's own waves, each multiplied by the transfer: no Monte Carlo."""
        turbulence, wind_speed = FLOWS[flow]
        state = RecordState(scan_with(probe, name, opening_angle_deg=30.0), wind_speed, 0.2, 60.0)
        grid = grid_of("short and narrow", turbulence)
        maker = BoxMaker(turbulence, grid)
        exact, expected = box_noise(state, maker)
        np.testing.assert_allclose(state.expected_variance(maker), expected, rtol=1e-9)  # rounding
        noise = noise_from_boxes([state], turbulence, 200, 1, grid=grid)[0]
        assert np.abs((noise.covariance[0] - exact) / noise.standard_error[0]).max() < SIGMAS
        assert noise.details["mean_deviation_sigmas"] < SIGMAS

    def test_points_would_be_caught(self):
        """The test above has power: beams that see 20 m of small eddies are not taken for points."""
        turbulence, wind_speed = FLOWS["small eddies"]
        points = RecordState(load_scan("6-beam", opening_angle_deg=30.0), wind_speed, 0.2, 60.0)
        state = replace(points, scan=replace(points.scan, probe=ContinuousWaveProbe(rayleigh_length=20.0)))
        grid = grid_of("short and narrow", turbulence)
        exact, expected = box_noise(points, BoxMaker(turbulence, grid))
        noise = noise_from_boxes([state], turbulence, 600, 1, grid=grid)[0]
        assert np.abs((noise.covariance[0] - exact) / noise.standard_error[0]).max() > SIGMAS
        assert np.all(state.expected_variance(BoxMaker(turbulence, grid)) < 0.4 * expected)

    def test_states_with_different_probes_share_boxes(self):
        """Also beams that look along the same lines: with another probe they see other velocities."""
        grid = BoxGrid((128, 16, 16), (12.0, 24.0, 24.0))
        scans = [load_scan("6-beam"), *(scan_with(probe) for probe in ("continuous-wave", "optics", "pulsed"))]
        pulse = replace(scans[0], probe=PulsedProbe(gate_length=6.1))  # as long as the continuous wave's
        states = [RecordState(scan, 10.0, 0.1, 60.0) for scan in (*scans, pulse, scans[1])]
        together = noise_from_boxes(states, SEED, 10, 1, grid=grid)
        for state, noise in zip(states, together, strict=True):
            alone = noise_from_boxes([state], SEED, 10, 1, grid=grid)[0]
            np.testing.assert_allclose(noise.covariance[0], alone.covariance[0], rtol=1e-5)  # single precision
            np.testing.assert_array_equal(noise.gain[0], alone.gain[0])
        first, second, third = (model.covariance[0] for model in together[:3])
        assert not np.allclose(first, second, rtol=0.01)
        np.testing.assert_allclose(second, third, rtol=1e-3)  # at 98 m these optics have a Rayleigh length of 6.10 m
        np.testing.assert_array_equal(second, together[5].covariance[0])

    @pytest.mark.long
    @pytest.mark.parametrize("flow", FLOWS)
    def test_how_they_differ_from_an_infinite_domain(self, flow):
        """The last rows of the table in docs/noise.md, whose numbers these are: width 12 L, Rayleigh length 6.1 m."""
        differences = box_differences(12.0, flow, probe=PROBES["continuous-wave"])
        np.testing.assert_allclose(differences, DIFFERENCES[flow], atol=0.0006)


DIFFERENCES = {"seed": (0.989, 0.998, 0.997, 0.010), "small eddies": (0.997, 1.011, 1.088, 0.027)}


class TestGain:
    @pytest.mark.parametrize("probe", PROBES)
    def test_is_the_theorys(self, probe):
        scan = scan_with(probe, opening_angle_deg=40.0)
        grid = BoxGrid((128, 16, 16), (12.0, 24.0, 24.0))
        noise = noise_from_boxes([RecordState(scan, 10.0, 0.2, 60.0)], SEED, 2, 1, grid=grid)[0]
        theory = theory_noise(scan, SEED, wind_speed=10.0, duration=60.0, yaw=0.2)
        assert not theory.details["probe_as_points"]
        np.testing.assert_allclose(noise.gain[0], theory.gain[0], rtol=1e-12, atol=1e-15)
        assert np.all(noise.gain[0, :, 0] < 0.97 * design_matrix(scan.at_yaw(0.2))[:, 0])

    def test_bias_is_what_a_records_mean_takes(self):
        """As for points, but for the weights of the components: a probe takes no slow eddies."""
        grid = BoxGrid((128, 16, 16), (12.0, 24.0, 24.0))
        states = [RecordState(scan, 10.0, 0.2, 60.0) for scan in (load_scan("6-beam"), scan_with("continuous-wave"))]
        points, probed = noise_from_boxes(states, SEED, 2, 1, grid=grid)
        np.testing.assert_allclose(probed.bias[0], points.bias[0], atol=0.02)
        assert not np.array_equal(probed.bias[0], points.bias[0])

    def test_excess_is_what_the_grid_leaves_out(self):
        """The finer the grid, the nearer the expected variances in boxes to gain · stresses of a record in boxes."""
        state = RecordState(scan_with("continuous-wave"), 10.0, 0.0, 60.0)
        excess = []
        for finer in (1, 2, 4):
            grid = BoxGrid((64 * finer, 12 * finer, 12 * finer), tuple(n / finer for n in (24.0, 30.0, 30.0)))
            noise = noise_from_boxes([state], SEED, 2, 1, grid=grid)[0]
            excess.append(noise.details["probe_excess"])
            record = noise.gain[0] @ pack_stress(state.record_tensor(BoxMaker(SEED, grid)))
            most = np.max(state.expected_variance(BoxMaker(SEED, grid)) / record) - 1.0
            assert excess[-1] == pytest.approx(most, rel=1e-9)
        assert 0.02 < excess[2] < 0.75 * excess[1] < 0.75 * 0.75 * excess[0]

    def test_points_have_none(self):
        noise = calibrate(
            load_scan("2-beam"), WIDE_EDDIES, wind_speed=10.0, duration=60.0, method=Boxes(n_boxes=2), cache=False
        )
        assert "probe_excess" not in noise.details

    def test_noise_passes_the_checker(self, tmp_path):
        scan = load_scan("pulsed-4-beam")
        noise = calibrate(
            scan, WIDE_EDDIES, wind_speed=10.0, duration=60.0, method=Boxes(n_boxes=4), cache=tmp_path / "cache"
        )
        check_noise(noise, scan, tmp_path)
        again = calibrate(
            scan, WIDE_EDDIES, wind_speed=10.0, duration=60.0, method=Boxes(n_boxes=4), cache=tmp_path / "cache"
        )
        np.testing.assert_array_equal(noise.covariance[0], again.covariance[0])


class TestSimulated:
    def test_probe_takes_what_is_expected(self):
        """From the same boxes with and without it: most of the scatter of variances cancels in their ratio."""
        points, flow = load_scan("6-beam", opening_angle_deg=45.0, yaw_deg=25.0), {"wind_speed": 10.0, "duration": 60.0}
        probed, n_records = replace(points, probe=PROBES["optics"]), 80
        maker = None
        variance, expected = [], []
        for scan in (points, probed):
            series = simulate(scan, WIDE_EDDIES, **flow, n_records=n_records, seed=5, method="boxes")
            variance.append(make_records(series, scan, duration=60.0)["variance"].values)
            state = RecordState(scan, 10.0, scan.yaw, 60.0)
            maker = maker or BoxMaker(WIDE_EDDIES, grid_for([state], WIDE_EDDIES))
            expected.append(state.expected_variance(maker))
        ratio = expected[1] / expected[0]
        scatter = (variance[1] - ratio * variance[0]) / expected[0]
        error = scatter.std(axis=0, ddof=1) / np.sqrt(n_records)
        assert np.all(error < 0.01)
        assert np.all(np.abs(scatter.mean(axis=0)) < 4.5 * error)  # Monte Carlo, six beams, skewed
        assert np.all(ratio < 0.9)
