"""The line simulator: its covariances are those asked for, to rounding; reproducible; honest where none exist."""

import json
import tracemalloc

import numpy as np
import pytest
from scenes import point_scan

from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.simulation import lines
from bayes_rs.simulation.lines import LARGEST_NEGATIVE_PART, LineMaker
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence
from bayes_rs.turbulence.two_point import radial_covariance

SEED = load_turbulence("fu-2022")
ROUNDING = 1e-12  # roots of matrices of a few hundred rows, entries of size 1
SIGMAS = 4.5  # Monte Carlo, some hundred numbers


def slow_covariance(scan, turbulence, wind_speed, n_sample):
    """Return the covariance matrix of all samples, shape (n_beam, n_sample) twice, each from where and when it is."""
    n = scan.line_of_sight
    time = scan.beam_time[:, None] + scan.scan_duration * np.arange(n_sample)
    parcel = (n * scan.focus_distance[:, None])[:, None] - wind_speed * time[..., None] * np.array([1.0, 0.0, 0.0])
    matrix = np.empty((scan.n_beam, n_sample, scan.n_beam, n_sample))
    for a, b in np.ndindex(scan.n_beam, scan.n_beam):
        apart = parcel[b][None] - parcel[a][:, None]
        along = apart[..., 0].reshape(1, -1)
        matrix[a, :, b] = radial_covariance(n[[a]], n[[b]], apart[0, :1, 1:], along, turbulence).reshape(n_sample, -1)
    return matrix


def implied_covariance(maker):
    """Return the covariance matrix of all samples of the records that a maker makes, from its factors."""
    n_beam, n = maker.scan.n_beam, maker.n_sample
    if maker.embedding == "dense":
        return (maker._dense_root @ maker._dense_root).reshape(n_beam, n, n_beam, n)
    root = maker._unpack(maker._root)
    by_lag = np.fft.irfft((root @ root).conj(), n=maker.period, axis=0)  # C_ab(h), h from 0, then from −M/2
    lag = np.subtract.outer(np.arange(n), np.arange(n)).T
    return by_lag[lag].transpose(2, 0, 3, 1)


class TestCovariances:
    @pytest.mark.parametrize("embedding", ["dense", "circulant"])
    def test_of_the_factors_are_those_of_the_parcels_that_are_sampled(self, embedding):
        scan = load_scan("6-beam", yaw_deg=12.0, tilt_deg=4.0)  # beams at six times within a scan
        maker = LineMaker(scan, SEED, wind_speed=8.0, n_sample=40, embedding=embedding)
        slow = slow_covariance(scan, SEED, 8.0, 40)
        assert maker.negative_part < ROUNDING
        np.testing.assert_allclose(implied_covariance(maker), slow, atol=ROUNDING)
        assert np.abs(slow[0, 0, 1] - slow[1, 0, 0]).max() > 0.01  # the test can tell a lag from its opposite

    @pytest.mark.parametrize("embedding", ["dense", "circulant"])
    def test_of_the_records_are_those_of_the_factors(self, embedding):
        scan = point_scan([[-1, 0.4, 0.1], [-1, -0.3, 0.6]], distance=[60.0, 90.0], times=[0.0, 0.7])
        maker = LineMaker(scan, SEED, wind_speed=15.0, n_sample=12, embedding=embedding)
        velocity = maker.make(6000, seed=2).reshape(6000, -1)
        exact = implied_covariance(maker).reshape(24, 24)
        error = np.sqrt((exact**2 + np.outer(np.diag(exact), np.diag(exact))) / len(velocity))
        assert np.abs((velocity.T @ velocity / len(velocity) - exact) / error).max() < SIGMAS
        assert np.abs(velocity.mean(axis=0) / np.sqrt(np.diag(exact) / len(velocity))).max() < SIGMAS

    def test_of_a_beam_at_no_lag_is_the_radial_variance(self):
        scan = load_scan("4-beam")
        exact = implied_covariance(LineMaker(scan, SEED, wind_speed=10.0, n_sample=30))
        n = scan.line_of_sight
        variance = np.einsum("bi,ij,bj->b", n, unpack_stress(SEED.stresses()), n)
        np.testing.assert_allclose(exact[np.arange(4), 0, np.arange(4), 0], variance, rtol=2e-4)  # the table's error

    def test_coincident_beams_measure_the_same(self):
        scan = point_scan([[-1, 0.2, 0.1], [-1, 0.2, 0.1], [-1, 0.2, 0.1]])
        for embedding in ("dense", "circulant"):
            velocity = LineMaker(scan, SEED, wind_speed=10.0, n_sample=50, embedding=embedding).make(3, seed=1)
            np.testing.assert_allclose(velocity[:, 1:], velocity[:, [0, 0]], atol=1e-6)  # the root of rounding

    def test_a_later_beam_on_the_same_line_is_the_same_beam_a_scan_later(self):
        """Ten metres upstream at 10 m/s: what beam 1 sees now, beam 0 sees a second later."""
        scan = point_scan([[-1, 0, 0], [-1, 0, 0]], distance=[100.0, 110.0])
        for embedding, rounding in (
            ("dense", 1e-6),
            ("circulant", 0.02),
        ):  # the root of that at M/2
            velocity = LineMaker(scan, SEED, wind_speed=10.0, n_sample=300, embedding=embedding).make(2, seed=1)
            np.testing.assert_allclose(velocity[:, 0, 1:], velocity[:, 1, :-1], atol=rounding)

    def test_yaw_by_argument_is_yaw_of_the_mounting(self):
        scan = load_scan("4-beam")
        one = LineMaker(scan, SEED, wind_speed=10.0, n_sample=10, yaw=0.3).make(2, seed=1)
        other = LineMaker(scan.with_yaw(0.3), SEED, wind_speed=10.0, n_sample=10).make(2, seed=1)
        np.testing.assert_array_equal(one, other)


class TestSeeds:
    @pytest.mark.parametrize("embedding", ["dense", "circulant"])
    def test_a_record_is_the_same_however_many_follow(self, embedding):
        maker = LineMaker(load_scan("6-beam"), SEED, wind_speed=10.0, n_sample=50, embedding=embedding)
        many = maker.make(40, seed=7)
        for count in (1, 2, 16, 17, 39):
            np.testing.assert_array_equal(maker.make(count, seed=7), many[:count])

    def test_a_generator_is_a_seed(self):
        maker = LineMaker(load_scan("staring"), SEED, wind_speed=10.0, n_sample=20)
        np.testing.assert_array_equal(maker.make(3, seed=5), maker.make(3, seed=np.random.default_rng(5)))
        rng = np.random.default_rng(5)
        assert not np.array_equal(maker.make(3, seed=rng), maker.make(3, seed=rng))

    def test_other_seeds_and_other_records_are_independent(self):
        maker = LineMaker(load_scan("staring"), SEED, wind_speed=10.0, n_sample=400, embedding="circulant")
        u = np.concatenate([maker.make(300, seed=seed) for seed in (1, 2)]).reshape(2, 300, 400)
        assert abs(np.mean(u[0] * u[1])) < 0.05 * np.mean(u**2)
        assert abs(np.mean(u[0, 1:] * u[0, :-1])) < 0.05 * np.mean(u**2)

    def test_number_of_records(self):
        maker = LineMaker(load_scan("staring"), SEED, wind_speed=10.0, n_sample=2)
        with pytest.raises(InputError, match="Invalid n_records 0"):
            maker.make(0, seed=1)


class TestNegativeParts:
    WIDE = MannTurbulence(dissipation=0.05, length_scale=1000.0, gamma=3.9)  # records of 0.3 L

    def test_a_longer_period_cures_them(self):
        maker = LineMaker(load_scan("6-beam"), self.WIDE, wind_speed=5.0, n_sample=60, embedding="circulant")
        assert maker.period > 4 * maker.n_sample
        assert maker.negative_part < 1e-6
        slow = slow_covariance(load_scan("6-beam"), self.WIDE, 5.0, 60)
        np.testing.assert_allclose(implied_covariance(maker), slow, atol=1e-6 * slow.max())

    def test_what_stays_is_the_variance_that_is_added(self, monkeypatch):
        monkeypatch.setattr(lines, "_LARGEST_PERIOD", 8)
        maker = LineMaker(load_scan("6-beam"), self.WIDE, wind_speed=5.0, n_sample=60, embedding="circulant")
        assert 1e-4 < maker.negative_part < LARGEST_NEGATIVE_PART
        slow, implied = slow_covariance(load_scan("6-beam"), self.WIDE, 5.0, 60), implied_covariance(maker)
        beam = np.arange(6)
        added = (implied - slow)[beam, 0, beam, 0] / slow[beam, 0, beam, 0]
        assert added.max() == pytest.approx(maker.negative_part, rel=1e-6)
        assert np.abs(implied - slow).max() <= maker.negative_part * slow.max() * (1.0 + 1e-9)  # Cauchy and Schwarz

    def test_too_large_is_an_error_that_carries_it(self):
        scan = point_scan([[-1, 0, 0], [-1, 1, 0], [0, 0, 1]], scan_duration=0.02)
        wide = MannTurbulence(dissipation=0.05, length_scale=5000.0, gamma=3.2)
        with pytest.raises(
            NotPositiveDefiniteError, match=r"scan 'points' has eigenvalues below zero that would add 0\.00\d+ of a var"
        ) as caught:
            LineMaker(scan, wide, wind_speed=10.0, n_sample=500, embedding="circulant")
        assert caught.value.smallest_eigenvalue < -LARGEST_NEGATIVE_PART

    def test_dense_stands_in_where_no_period_will_do(self):
        scan = point_scan([[-1, 0, 0], [-1, 1, 0], [-1, 0, 1]], scan_duration=0.02)
        wide = MannTurbulence(dissipation=0.05, length_scale=5000.0, gamma=3.2)
        maker = LineMaker(scan, wide, wind_speed=10.0, n_sample=350)
        assert (maker.embedding, maker.period) == ("dense", 0)
        assert maker.negative_part < 1e-9

    def test_a_covariance_that_belongs_to_no_process_is_refused(self, monkeypatch):
        def box(_first, _second, _across, along, *_rest, **_options):
            return np.where(np.abs(along) < 35.0, 1.0, 0.0)

        monkeypatch.setattr(lines, "probed_covariance", box)
        for embedding in ("dense", "circulant", "auto"):
            with pytest.raises(NotPositiveDefiniteError, match=r"more than the 0\.001 allowed"):
                LineMaker(point_scan([[-1, 0, 0]]), SEED, wind_speed=10.0, n_sample=50, embedding=embedding)


class TestExtremes:
    @pytest.mark.parametrize("length_scale", [1.0, 61.0, 5000.0])
    @pytest.mark.parametrize("gamma", [0.0, 6.0])
    @pytest.mark.parametrize(("duration", "interval"), [(2.0, 0.02), (7200.0, 20.0), (10.0, 4.0), (600.0, 1.0)])
    def test_finite_and_exact(self, length_scale, gamma, duration, interval):
        """Coincident beams, beams a millimetre apart, 10 s to 2 h, 0.05 to 50 Hz."""
        turbulence = MannTurbulence(dissipation=0.05, length_scale=length_scale, gamma=gamma)
        directions = [[-1, 0, 0], [-1, 1, 0], [0, 0, 1], [-1, 0, 0], [-1, 1e-5, 0]]
        scan = point_scan(directions, distance=100.0, scan_duration=interval)
        maker = LineMaker(scan, turbulence, wind_speed=10.0, n_sample=round(duration / interval))
        assert maker.negative_part < 1e-9
        assert np.all(np.isfinite(maker.make(2, seed=1)))

    def test_a_hundred_beams_closer_than_the_eddies(self):
        """Their matrices are as good as singular."""
        scan = load_scan("spinnerlidar@probe=point")
        maker = LineMaker(scan.select(scan.beam[::4]), SEED, wind_speed=10.0, n_sample=6, embedding="circulant")
        assert maker.negative_part < 1e-9
        assert np.all(maker.make(2, seed=1).var(axis=-1) > 0.0)

    @pytest.mark.slow
    @pytest.mark.long
    def test_four_hundred_beams_for_ten_minutes_in_two_gibibytes(self):
        """About half a minute; numpy reports its arrays to tracemalloc."""
        tracemalloc.start()
        maker = LineMaker(load_scan("spinnerlidar@probe=point"), SEED, wind_speed=10.0, n_sample=300)
        velocity = maker.make(32, seed=1)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2**31
        assert maker.negative_part < 1e-9
        noise = theory_noise(load_scan("spinnerlidar@probe=point"), SEED, wind_speed=10.0)
        expected = (1.0 + noise.bias[0]) * (noise.gain[0] @ SEED.stresses())
        deviation = velocity.var(axis=-1) / expected - 1.0
        assert abs(deviation.mean()) < SIGMAS * np.sqrt(noise.covariance[0].mean() / 32)

    def test_too_large_for_memory(self):
        scan = load_scan("spinnerlidar")
        with pytest.raises(
            InputError, match=r"2000 samples of each of 400 beams of scan 'spinnerlidar' need 2\.4 GiB .* than 1\.5 GiB"
        ):
            LineMaker(scan, SEED, wind_speed=10.0, n_sample=2000)


class TestTruth:
    def test_is_told(self):
        maker = LineMaker(load_scan("6-beam"), SEED, wind_speed=10.0, n_sample=600)
        truth = json.loads(json.dumps(maker.truth()))
        assert truth["method"] == "lines"
        assert (truth["embedding"], truth["period"]) == ("circulant", 1200)
        assert truth["negative_part"] < ROUNDING
        np.testing.assert_allclose(truth["stresses"], SEED.stresses())

    @pytest.mark.parametrize("duration", [600.0, 60.0])
    def test_stresses_of_a_record_are_the_expected_variances(self, duration):
        scan = load_scan("6-beam", opening_angle_deg=45.0, yaw_deg=20.0)
        truth = LineMaker(scan, SEED, wind_speed=10.0, n_sample=round(duration)).truth()
        noise = theory_noise(scan, SEED, wind_speed=10.0, duration=duration)
        expected = (1.0 + noise.bias[0]) * (noise.gain[0] @ SEED.stresses())
        np.testing.assert_allclose(noise.gain[0] @ np.array(truth["stresses_record"]), expected, rtol=1e-6)


class TestErrors:
    def test_unknown_embedding(self):
        with pytest.raises(InputError, match="Unknown embedding 'magic': it must be one of auto, dense, circulant"):
            LineMaker(load_scan("staring"), SEED, wind_speed=10.0, n_sample=5, embedding="magic")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"n_sample": 1}, "Invalid n_sample 1"),
            ({"wind_speed": 0.0}, r"Invalid wind_speed 0\.0 m/s"),
            ({"yaw": np.nan}, "Invalid yaw nan"),
            ({"tolerance": 1e-9}, "Invalid tolerance 1e-09"),
        ],
    )
    def test_numbers(self, change, message):
        with pytest.raises(InputError, match=message):
            LineMaker(load_scan("staring"), SEED, **{"wind_speed": 10.0, "n_sample": 5, **change})
