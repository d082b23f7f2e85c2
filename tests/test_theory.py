"""The noise of a record by theory: dense matrices, exact cases, laws, and extremes."""

import numpy as np
import pytest
from scenes import point_scan

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.noise.by_theory import _covariance_error, sample_counts, sonic_moments, theory_noise
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence
from bayes_rs.turbulence.two_point import radial_covariance

SEED = load_turbulence("fu-2022")


def projection(n, detrend):
    columns = np.stack([np.ones(n), np.arange(n)], axis=-1)[:, : 1 if detrend == "mean" else 2]
    basis = np.linalg.qr(columns)[0]
    return np.eye(n) - basis @ basis.T


class TestErrorBound:
    def test_it_is_reached_by_the_worst_error_of_the_allowed_size(self):
        """A change of C along P C P, whose Frobenius norm is that of N² entries of the error each."""
        n, error = 12, 1e-6
        root = np.random.default_rng(8).normal(size=(n, n))
        covariance, take = root @ root.T, projection(n, "mean")
        taken = take @ covariance @ take
        worst = n * error * taken / np.linalg.norm(taken)
        mean = np.trace(taken) / n
        before, after = (
            2.0 * np.linalg.norm(take @ c @ take) ** 2 / (n * mean) ** 2 for c in (covariance, covariance + worst)
        )
        bound = _covariance_error(np.array([[before]]), np.array([mean]), error)
        assert after - before == pytest.approx(bound, rel=1e-5)  # first order in the error


class TestAgainstDense:
    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    def test_six_beams_with_their_timing_and_unequal_counts(self, detrend):
        scan, wind_speed, duration = load_scan("6-beam", yaw_deg=7.0), 8.0, 40.3
        noise = theory_noise(scan, SEED, wind_speed=wind_speed, duration=duration, detrend=detrend)
        n = scan.line_of_sight
        count = sample_counts(scan, duration)
        assert sorted(set(count.tolist())) == [40, 41]
        time = [t + scan.scan_duration * np.arange(c) for t, c in zip(scan.beam_time, count, strict=True)]
        place = n * scan.focus_distance[:, None]
        covariance, mean = np.empty((6, 6)), np.empty(6)
        for a in range(6):
            for b in range(6):
                apart = place[b] - place[a]
                along = apart[0] - wind_speed * (time[b][None, :] - time[a][:, None])
                matrix = radial_covariance(n[[a]], n[[b]], apart[None, 1:], along.reshape(1, -1), SEED)
                matrix = projection(count[a], detrend) @ matrix.reshape(along.shape) @ projection(count[b], detrend)
                covariance[a, b] = 2.0 * np.sum(matrix**2) / (count[a] * count[b])
                if a == b:
                    mean[a] = np.trace(matrix) / count[a]
        np.testing.assert_allclose(noise.covariance[0], covariance / np.outer(mean, mean), rtol=1e-9)
        ensemble = np.einsum("bi,ij,bj->b", n, unpack_stress(SEED.stresses()), n)
        np.testing.assert_allclose(noise.bias[0], mean / ensemble - 1.0, atol=1e-9)


class TestSeedFlow:
    @pytest.mark.parametrize(("direction", "removed"), [([1, 0, 0], 0.1247), ([0, 1, 0], 0.0390), ([0, 0, 1], 0.0164)])
    def test_mean_removal_takes_what_the_one_point_spectra_say(self, direction, removed):
        noise = theory_noise(point_scan([direction], scan_duration=0.25), SEED, wind_speed=10.0)
        np.testing.assert_allclose(noise.bias[0], -removed, atol=1.5e-4)
        log_k = np.arange(-18.0, 5.0, 0.25)
        k1 = np.exp(log_k)
        lost = SEED.spectra(k1)[:, np.flatnonzero(direction)[0]] * np.sinc(k1 * 6000.0 / (2.0 * np.pi)) ** 2
        total = 2.0 * 0.25 * np.sum(k1 * lost) / SEED.stresses()[np.flatnonzero(direction)[0]]
        np.testing.assert_allclose(-noise.bias[0], total, rtol=0.05)  # a coarse sum over an oscillating function

    def test_errors_of_a_quarter_strongly_correlated(self):
        noise = theory_noise(load_scan("6-beam"), SEED, wind_speed=10.0)
        assert np.all((noise.relative_error[0] > 0.2) & (noise.relative_error[0] < 0.3))
        assert np.all((noise.correlation[0] > 0.5) & (noise.correlation[0] <= 1.0 + 1e-12))  # rounding

    def test_linear_detrending_removes_more(self):
        by_mean, by_line = (
            theory_noise(load_scan("6-beam"), SEED, wind_speed=10.0, detrend=how) for how in ("mean", "linear")
        )
        assert np.all(by_line.bias[0] < by_mean.bias[0])
        assert np.all(by_line.relative_error[0] < by_mean.relative_error[0])

    def test_long_records_have_the_integral_of_the_squared_covariance(self):
        scan = point_scan([[1, 0, 0]])
        noise = theory_noise(scan, SEED, wind_speed=10.0, duration=18000.0)
        tau = np.arange(-1800.0, 1801.0)
        covariance = radial_covariance([[1, 0, 0]], [[1, 0, 0]], [[0, 0]], 10.0 * tau[None, :], SEED)[0]
        limit = np.sqrt(2.0 / 18000.0 * np.sum(covariance**2)) / covariance[1800]
        np.testing.assert_allclose(noise.relative_error[0, 0], limit, rtol=0.03)


class TestLaws:
    def test_dissipation_has_no_influence(self):
        scan = load_scan("6-beam")
        one = theory_noise(scan, SEED, wind_speed=10.0)
        other = theory_noise(scan, MannTurbulence(dissipation=3.0, length_scale=61.0, gamma=3.2), wind_speed=10.0)
        np.testing.assert_allclose(one.covariance[0], other.covariance[0], rtol=1e-12)
        np.testing.assert_allclose(one.bias[0], other.bias[0], rtol=1e-11)

    def test_only_ratios_of_lengths_count(self):
        scan = load_scan("6-beam")
        one = theory_noise(scan, SEED, wind_speed=10.0)
        twice = MannTurbulence(dissipation=0.05, length_scale=122.0, gamma=3.2)
        other = theory_noise(load_scan("6-beam", focus_distance=196.0), twice, wind_speed=20.0)
        np.testing.assert_allclose(one.covariance[0], other.covariance[0], rtol=1e-9)

    def test_opposite_directions_at_one_point_are_the_same_beam(self):
        scan = point_scan([[1, 0, 0], [1, 0, 0]])
        noise = theory_noise(scan, SEED, wind_speed=10.0)
        np.testing.assert_allclose(noise.covariance[0], noise.covariance[0, 0, 0], rtol=1e-12)

    def test_beams_a_millimetre_apart_are_nearly_the_same_and_ten_kilometres_apart_are_not(self):
        near = point_scan([[-1, 0, 0], [-1, 1e-5, 0]], distance=100.0)
        assert 0.999 < theory_noise(near, SEED, wind_speed=10.0).correlation[0, 0, 1] < 1.0
        far = point_scan([[-1, 1, 0], [-1, -1, 0]], distance=7071.0)
        assert theory_noise(far, SEED, wind_speed=10.0).correlation[0, 0, 1] < 1e-3

    def test_mirror_image_in_the_vertical_plane_along_the_wind(self):
        left, right = (
            theory_noise(point_scan([[-1, s * 0.3, 0.2], [-1, s * 0.1, -0.3]]), SEED, wind_speed=10.0) for s in (1, -1)
        )
        np.testing.assert_allclose(left.covariance[0], right.covariance[0], rtol=1e-12)

    def test_yaw_by_argument_is_yaw_of_the_mounting(self):
        scan = load_scan("4-beam")
        one = theory_noise(scan, SEED, wind_speed=10.0, yaw=0.2)
        other = theory_noise(scan.with_yaw(0.2), SEED, wind_speed=10.0)
        np.testing.assert_array_equal(one.covariance[0], other.covariance[0])
        np.testing.assert_allclose(one.gain[0], other.gain[0])
        assert one.yaw == pytest.approx(0.2)

    def test_equal_pairs_are_computed_once(self):
        directions = [[-1, 0.3, 0.2], [-1, -0.3, 0.2], [-1, 0.3, 0.2]]
        noise = theory_noise(point_scan(directions), SEED, wind_speed=10.0)
        assert noise.details["n_pairs"] == 6
        assert noise.details["n_unique_pairs"] < 6
        np.testing.assert_allclose(noise.covariance[0, 0, 1], noise.covariance[0, 1, 2], rtol=1e-12)

    def test_tolerance_bounds_the_error_of_the_covariance(self):
        scan = load_scan("6-beam")
        rough, fine = (theory_noise(scan, SEED, wind_speed=10.0, tolerance=tolerance) for tolerance in (1e-3, 1e-4))
        error = np.abs(rough.covariance[0] - fine.covariance[0]).max()
        assert error < rough.details["covariance_error"] + fine.details["covariance_error"]
        assert (
            error < 1e-5 * rough.covariance[0].max()
        )  # in practice, since errors of a constant are removed with the mean


class TestExtremes:
    @pytest.mark.parametrize("length_scale", [1.0, 5000.0])
    @pytest.mark.parametrize("gamma", [0.0, 6.0])
    @pytest.mark.parametrize(("duration", "interval"), [(10.0, 0.02), (7200.0, 20.0), (10.0, 4.0)])
    def test_finite_and_positive_semi_definite(self, length_scale, gamma, duration, interval):
        turbulence = MannTurbulence(dissipation=0.05, length_scale=length_scale, gamma=gamma)
        scan = point_scan([[-1, 0, 0], [-1, 1, 0], [0, 0, 1], [-1, 0, 0]], scan_duration=interval)
        noise = theory_noise(scan, turbulence, wind_speed=10.0, duration=duration)  # checks the eigenvalues itself
        assert np.all((noise.bias[0] < 0.0) & (noise.bias[0] > -1.0))
        assert noise.details["negative_part"] < 1e-6
        assert np.all(noise.relative_error[0] > 0.0)

    @pytest.mark.parametrize("name", ["51-beam", pytest.param("spinnerlidar@probe=point", marks=pytest.mark.slow)])
    def test_many_beams_that_are_nearly_dependent(self, name):
        noise = theory_noise(load_scan(name), SEED, wind_speed=10.0)
        assert np.linalg.eigvalsh(noise.covariance[0])[0] > 0.0
        assert noise.details["negative_part"] == 0.0


class TestSonic:
    def test_beams_along_the_axes_at_the_sonic_are_the_sonic(self):
        scan = point_scan([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], distance=1e-9)
        moments = sonic_moments(scan, SEED, wind_speed=10.0)
        noise = theory_noise(scan, SEED, wind_speed=10.0)
        record = (1.0 + noise.bias[0]) * SEED.stresses()[:3]
        np.testing.assert_allclose(moments.mean[:3], record, rtol=1e-6)
        beams = noise.covariance[0] * np.outer(record, record)
        np.testing.assert_allclose(moments.covariance[:3, :3], beams, rtol=1e-6)
        np.testing.assert_allclose(moments.cross_covariance, moments.covariance[:3], rtol=1e-5, atol=1e-9)

    def test_a_slanted_beam_at_the_sonic_is_the_projection_of_its_stresses(self):
        scan = point_scan([[-0.6, 0.48, 0.64]], distance=1e-9)
        moments = sonic_moments(scan, SEED, wind_speed=10.0)
        noise = theory_noise(scan, SEED, wind_speed=10.0)
        np.testing.assert_allclose(
            noise.gain[0] @ moments.mean, (1.0 + noise.bias[0]) * (noise.gain[0] @ SEED.stresses()), rtol=1e-6
        )
        np.testing.assert_allclose(moments.cross_covariance, noise.gain[0] @ moments.covariance, rtol=1e-5, atol=1e-7)

    def test_joint_covariance_is_positive_semi_definite(self):
        scan = load_scan("6-beam")
        moments = sonic_moments(scan, SEED, wind_speed=10.0)
        noise = theory_noise(scan, SEED, wind_speed=10.0)
        expected = (1.0 + noise.bias[0]) * (noise.gain[0] @ SEED.stresses())
        beams = noise.covariance[0] * np.outer(expected, expected)
        joint = np.block([[beams, moments.cross_covariance], [moments.cross_covariance.T, moments.covariance]])
        assert np.linalg.eigvalsh(joint)[0] > -1e-9

    def test_what_is_odd_in_v_is_uncorrelated_with_what_is_even(self):
        moments = sonic_moments(load_scan("staring"), SEED, wind_speed=10.0)
        np.testing.assert_allclose(moments.mean[[3, 5]], 0.0, atol=1e-12)
        np.testing.assert_allclose(moments.cross_covariance[:, [3, 5]], 0.0, atol=1e-12)
        np.testing.assert_allclose(moments.covariance[np.ix_([0, 1, 2, 4], [3, 5])], 0.0, atol=1e-12)

    def test_a_sonic_further_from_the_beams_is_less_correlated_with_them(self):
        near, far = (
            sonic_moments(load_scan("staring"), SEED, wind_speed=10.0, position=(-98.0, y, 0.0)) for y in (0.0, 300.0)
        )
        assert far.cross_covariance[0, 0] < 0.1 * near.cross_covariance[0, 0]


class TestErrors:
    def test_record_too_short(self):
        with pytest.raises(InputError, match="beam 0 has 1 samples in a record, and removing the mean leaves nothing"):
            theory_noise(load_scan("staring"), SEED, wind_speed=10.0, duration=0.5)

    def test_two_samples_are_too_few_for_a_line(self):
        with pytest.raises(InputError, match="removing the linear leaves nothing of fewer than 3"):
            theory_noise(load_scan("staring"), SEED, wind_speed=10.0, duration=2.0, detrend="linear")

    def test_unknown_detrending(self):
        with pytest.raises(InputError, match="Unknown detrend 'spline': it must be one of mean, linear"):
            theory_noise(load_scan("staring"), SEED, wind_speed=10.0, detrend="spline")

    @pytest.mark.parametrize("wind_speed", [0.0, -1.0, np.nan])
    def test_wind_speed(self, wind_speed):
        with pytest.raises(InputError, match="Invalid wind_speed"):
            theory_noise(load_scan("staring"), SEED, wind_speed=wind_speed)
