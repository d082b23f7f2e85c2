"""The second generator (`benchmarks/air.py`) against closed forms, and against theory that shares nothing with it."""

from functools import lru_cache

import air
import numpy as np
import pytest
from air import KaimalAir, MannAir, make_files, make_series

import bayes_rs as brs
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.turbulence.one_point import scaled_stresses

QUADRATURE = 3e-3  # of uu; rings of radii, measured at up to 2e-3 where Γ is 5
SIGMAS = 4.5  # of Monte-Carlo standard errors, for a few dozen numbers each
AT_LIDAR = air.Beams(np.zeros((3, 3)), np.eye(3), (None, None, None))
TWO, WIDE_NAME = "2-beam", "6-beam@opening_angle_deg=45"
WIDE = brs.load_scan(WIDE_NAME)
PACKED = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]


def integrated(one):
    """The one-point spectra over all k1, by the trapezoidal rule over ln k1 and k^(-5/3) beyond."""
    k1 = np.geomspace(1e-3, 2e4, 260) / 61.0
    spectra = np.array([one.matrix(float(k), AT_LIDAR).real for k in k1])
    spectra = np.stack([spectra[:, i, j] for i, j in PACKED], axis=-1)
    below = spectra[0] * k1[0]
    beyond = np.array([1.5, 1.5, 1.5, 0.0, 0.0, 0.0]) * spectra[-1] * k1[-1]
    return 2.0 * (np.trapezoid(spectra * k1[:, None], np.log(k1), axis=0) + below + beyond)


def expected_covariance(scan, one, wind_speed):
    """E[v_a(i + h) v_b(i)] of what the generator draws, without drawing, shape (n_lag, n, n)."""
    beams = air._beams(scan, 0.0, 0.0)
    times = np.concatenate([scan.beam_time, np.zeros(3)])
    step, n_long = scan.scan_duration, 2 * int(600.0 / scan.scan_duration)
    factor = air._factor(one, *air._tabulate(one, beams), beams, times, step=step, n_long=n_long, speed=wind_speed)
    spectra = np.einsum("fac,fbc->fab", factor, factor.conj())
    return beams, times, np.fft.irfft(spectra, n=n_long, axis=0) * n_long


@lru_cache(maxsize=4)
def velocities(name, **change):
    """Of 20 records, shape (n_record, n_sample, n_beam), in the same air whatever else changes."""
    scan = brs.load_scan(name)
    series, _ = make_series(scan, MannAir(), n_record=20, wind_speed=10.0, seed=7, **change)
    order = np.argsort(series["beam"].values.reshape(20, -1, scan.n_beam), axis=-1, kind="stable")
    return np.take_along_axis(series["radial_velocity"].values.reshape(20, -1, scan.n_beam), order, axis=-1)


class TestMannAir:
    def test_isotropic_variance_is_the_closed_form(self):
        one = MannAir(0.05, 61.0, 0.0)
        closed = 0.6883439 * 0.05 * 61.0 ** (2.0 / 3.0)
        assert integrated(one) == pytest.approx(closed * np.array([1, 1, 1, 0, 0, 0]), abs=QUADRATURE * closed)
        assert one.stresses() == pytest.approx(closed * np.array([1, 1, 1, 0, 0, 0]))

    @pytest.mark.parametrize("gamma", [0.5, 3.2, 5.0])
    def test_stresses_are_those_of_the_literature(self, gamma):
        own = MannAir(1.0, 61.0, gamma)
        right = np.array(scaled_stresses(gamma)) * 61.0 ** (2.0 / 3.0)
        if gamma == 3.2:
            assert right[0] == pytest.approx(1.7722228 * 61.0 ** (2.0 / 3.0), rel=1e-6)
        assert own.stresses() == pytest.approx(right, abs=QUADRATURE * right[0])
        assert integrated(own) == pytest.approx(right, abs=QUADRATURE * right[0])

    def test_one_point_spectra_are_von_karmans(self):
        length, k1 = 61.0, np.array([1e-3, 0.01, 0.05, 1.0])
        found = np.array([MannAir(0.05, length, 0.0).matrix(float(k), AT_LIDAR) for k in k1])
        beyond = length**-2.0 + k1**2
        along = 9.0 / 55.0 * 0.05 * beyond ** (-5.0 / 6.0)
        across = 3.0 / 110.0 * 0.05 * (3.0 * length**-2.0 + 8.0 * k1**2) * beyond ** (-11.0 / 6.0)
        assert found[:, 0, 0].real == pytest.approx(along, rel=1e-3)
        assert found[:, 1, 1].real == pytest.approx(across, rel=1e-3)
        assert found[:, 2, 2].real == pytest.approx(across, rel=1e-3)

    @pytest.mark.parametrize("gamma", [0.0, 4.0])
    def test_eddies_do_not_diverge(self, gamma):
        k2, k3 = np.array([0.01, -0.1, 2.0]), np.array([0.03, 0.2, -1.0])
        amplitude = MannAir(0.05, 61.0, gamma).amplitude(0.02, k2, k3)
        wave = np.stack([np.full(3, 0.02), k2, k3], axis=-1)
        assert np.einsum("ni,nij->nj", wave, amplitude) == pytest.approx(np.zeros((3, 3)), abs=1e-12 * amplitude.max())


class TestSampledBeams:
    @pytest.mark.parametrize("name", ["6-beam@opening_angle_deg=45", "pulsed-4-beam", "zx-tm"])
    @pytest.mark.parametrize("one", [MannAir(0.05, 40.0, 2.5), MannAir(0.05, 15.0, 1.0)])
    def test_covariances_are_those_of_the_theory(self, name, one):
        """At all lags, with aliasing, sampling times, probe and the signs of all separations; 15 m and 40 m."""
        scan, wind_speed = brs.load_scan(name), 12.0
        if scan.n_beam > 6:
            scan = scan.select(scan.beam[[0, 1, 12, 30]])
        beams, times, found = expected_covariance(scan, one, wind_speed)
        flow = brs.MannTurbulence(one.dissipation, one.length_scale, one.gamma)
        lags = np.array([-20, -4, -1, 0, 1, 2, 3, 20])
        for first, second in [(0, 0), (0, 1), (1, 0), (0, 2), (3, 1), (0, scan.n_beam - 1)]:  # the last looks along x
            apart = beams.position[second] - beams.position[first]
            along = apart[0] - wind_speed * (times[second] - times[first] - lags * scan.scan_duration)
            right = probed_covariance(
                beams.direction[[first]],
                beams.direction[[second]],
                apart[None, 1:],
                along[None],
                flow,
                probe=scan.probe,
                lengths=scan.probe_length[[first, second]][None],
            )[0]
            assert found[lags, first, second] == pytest.approx(right, abs=3.0 * QUADRATURE * flow.stresses()[0])

    @pytest.mark.parametrize("one", [MannAir(0.05, 61.0, 3.2), KaimalAir()])
    def test_variances_of_series_are_those_of_the_truth(self, one):
        series, truth = make_series(WIDE, one, n_record=300, wind_speed=10.0, seed=5)
        velocity = series["radial_velocity"].values.reshape(300, 600, 6)
        variance = velocity.var(axis=1)[:, np.argsort(series["beam"].values[:6])]
        n = WIDE.line_of_sight
        tensor = tensor_of(truth["stresses_record"][0])
        error = variance.std(axis=0) / np.sqrt(300)
        assert np.abs(variance.mean(axis=0) - np.einsum("bi,ij,bj->b", n, tensor, n)).max() < SIGMAS * error.max()
        sonic = truth["stresses_sonic"]
        error = sonic.std(axis=0) / np.sqrt(300)
        assert (np.abs(sonic.mean(axis=0) - truth["stresses_record"][0]) < SIGMAS * error).all()

    def test_what_a_period_lacks_is_what_its_mean_varies(self):
        _, truth = make_series(WIDE, MannAir(0.05, 61.0, 3.2), n_record=1, wind_speed=10.0, seed=1)
        lacks = 1.0 - truth["stresses_record"][0, :3] / truth["stresses"][:3]
        assert lacks == pytest.approx([0.12, 0.04, 0.02], abs=0.006)  # as docs/targets.md says of this flow

    def test_mean_wind_and_times_are_those_of_the_scan(self):
        scan = brs.load_scan("zx-tm").select([0, 7, 20, 49])
        series, _ = make_series(scan, MannAir(1e-6), n_record=2, wind_speed=[8.0, 12.0], seed=1)
        assert series.sizes["sample"] == 2 * 600 * 4
        seconds = (series["time"].values - series["time"].values[0]) / np.timedelta64(1, "ns") * 1e-9
        beam = np.searchsorted(scan.beam, series["beam"].values)
        assert np.mod(seconds[:40], 1.0) == pytest.approx(scan.beam_time[beam[:40]])
        assert seconds[2400] == pytest.approx(600.0)
        wind = np.where(seconds < 600.0, 8.0, 12.0) * scan.line_of_sight[beam, 0]
        assert series["radial_velocity"].values == pytest.approx(wind, abs=0.05)


class TestKaimalAir:
    def test_spectra_integrate_to_the_stresses(self):
        one = KaimalAir()
        k1 = np.geomspace(1e-8, 1e5, 3000)
        spectra = np.array([one.one_point(float(k)) for k in k1])
        total = 2.0 * np.trapezoid(spectra * k1[:, None, None], np.log(k1), axis=0)
        assert total == pytest.approx(tensor_of(one.stresses()), abs=1e-3)

    def test_coherence_is_davenports(self):
        apart = air.Beams(np.array([[0.0, 0.0, 0.0], [5.0, 3.0, 4.0]]), np.tile([1.0, 0.0, 0.0], (2, 1)), (None, None))
        frequency, wind_speed = 0.1, 10.0
        matrix = KaimalAir().matrix(2.0 * np.pi * frequency / wind_speed, apart)
        iec = np.exp(-12.0 * np.hypot(frequency * 5.0 / wind_speed, 0.12 * 5.0 / 340.2))
        assert np.abs(matrix[0, 1] / matrix[0, 0]) == pytest.approx(iec)

    def test_a_cospectrum_that_cannot_be_is_refused(self):
        with pytest.raises(ValueError, match=r"Invalid uw -2: at k1 = .* its cospectrum is above"):
            KaimalAir(uw=-2.0).one_point(0.01)


class TestWhatElseTheAirDoes:
    def pair(self, scan=TWO, **change):
        """Velocities without and with a change, in the same air, shape (n_record, n_sample, n_beam)."""
        return velocities(scan), velocities(scan, **change)

    def test_modulation_leaves_the_stresses_and_makes_the_kurtosis(self):
        series, truth = make_series(TWO, MannAir(), n_record=400, wind_speed=10.0, seed=7, modulation=(0.4, 20.0))
        velocity = series["radial_velocity"].values + 10.0 * np.cos(np.deg2rad(15.0))
        assert np.mean(velocity**4) / np.mean(velocity**2) ** 2 == pytest.approx(3.0 * np.exp(4.0 * 0.4**2), rel=0.08)
        sonic = truth["stresses_sonic"]
        error = sonic.std(axis=0) / 20.0
        assert (np.abs(sonic.mean(axis=0) - truth["stresses_record"][0]) < SIGMAS * error).all()

    def test_modulation_lasts_as_long_as_it_should(self):
        when = np.arange(400.0)[None]
        g = np.log(air._modulation(when, 4000, 0.3, 50.0, np.random.default_rng(1)))[:, 0] + 0.3**2
        assert g.std() == pytest.approx(0.3, rel=0.05)
        assert np.corrcoef(g[:, 100], g[:, 150])[0, 1] == pytest.approx(np.exp(-1.0), abs=SIGMAS * 0.014)

    def test_a_front_adds_what_a_step_adds(self):
        plain, with_front = self.pair(front=3.0)
        added = (with_front - plain).var(axis=1) / np.cos(np.deg2rad(15.0)) ** 2
        assert added.max() == pytest.approx(9.0 / 4.0, rel=0.05)  # at most that of a step in the middle
        share = added / 9.0  # p (1 − p) of a step at p, from 0.09 at 0.1 on
        assert share.min() > 0.08
        assert np.ptp(with_front - plain, axis=1) == pytest.approx(3.0 * np.cos(np.deg2rad(15.0)))

    def test_only_some_records_may_change(self):
        plain, with_front = self.pair(front=3.0, changed_every=3)
        changed = (np.ptp(with_front - plain, axis=1) > 0.0).all(axis=1)
        assert np.array_equal(changed, np.arange(len(plain)) % 3 == 0)

    def test_a_trend_adds_what_a_line_adds(self):
        plain, with_trend = self.pair(trend=2.0)
        added = (with_trend - plain).var(axis=1) / np.cos(np.deg2rad(15.0)) ** 2
        assert added == pytest.approx(np.full((20, 2), 4.0 / 12.0), rel=0.01)

    def test_noise_is_white(self):
        plain, noisy = self.pair(noise=0.5)
        noise = noisy - plain
        assert noise.std() == pytest.approx(0.5, rel=SIGMAS / np.sqrt(2.0 * noise.size))
        assert abs(np.mean(noise[:, 1:] * noise[:, :-1])) < SIGMAS * 0.25 / np.sqrt(noise.size)

    def test_a_wake_is_in_its_sector_alone(self):
        plain, waked = self.pair(WIDE_NAME, wake=(60.0, 120.0, 0.5))
        angle = np.rad2deg(np.arctan2(WIDE.line_of_sight[:, 2], WIDE.line_of_sight[:, 1]))
        cone = np.hypot(*WIDE.line_of_sight[:, 1:].T) > 1e-6
        inside = cone & (angle > 60.0) & (angle < 120.0)
        assert inside.sum() == 1
        assert waked.var(axis=1)[:, inside] == pytest.approx(1.5 * plain.var(axis=1)[:, inside])
        assert waked[:, :, ~inside] == pytest.approx(plain[:, :, ~inside])

    def test_dead_and_swapped_beams(self):
        plain, swapped = self.pair(WIDE_NAME, swapped=((1, 3),))
        assert swapped[:, :, [1, 3, 0]] == pytest.approx(plain[:, :, [3, 1, 0]])
        _, dead = self.pair(WIDE_NAME, dead=(2,))
        assert dead[:, :, 2].std() == pytest.approx(0.05, rel=0.05)
        assert abs(dead[:, :, 2].mean()) < 0.01

    def test_a_lidar_that_points_elsewhere_sees_its_own_wind(self):
        series, _ = make_series(WIDE, MannAir(1e-8), n_record=1, wind_speed=10.0, seed=1, tilt_deg=5.0, yaw_deg=10.0)
        turned = brs.load_scan("6-beam", opening_angle_deg=45.0, tilt_deg=5.0, yaw_deg=10.0)
        wind = 10.0 * turned.line_of_sight[series["beam"].values, 0]
        assert series["radial_velocity"].values == pytest.approx(wind, abs=0.01)

    def test_spread_scatters_the_truth_and_keeps_its_mean(self):
        size = np.linspace(0.5, 2.0, 400)
        _, truth = make_series(TWO, MannAir(), n_record=400, wind_speed=10.0, seed=3, spread=0.3, size=size)
        size = truth["stresses_record"][:, 0] / size
        assert np.log(size).std() == pytest.approx(0.3, rel=0.16)
        error = truth["stresses_sonic"][:, 0] / truth["stresses_record"][:, 0]
        assert error.mean() == pytest.approx(1.0, abs=SIGMAS * error.std() / 20.0)


class TestFiles:
    @pytest.mark.parametrize("kind", ["netcdf", "csv"])
    @pytest.mark.parametrize("name", ["6-beam", "pulsed-4-beam"])
    def test_they_read_as_what_was_made(self, tmp_path, name, kind):
        options = {"n_record": 2, "wind_speed": 10.0, "seed": 4}
        files, _ = make_files(tmp_path, name, MannAir(), kind=kind, **options)
        read, (made, _) = brs.read(files, brs.load_scan(name)), make_series(name, MannAir(), **options)
        assert (read["beam"].values == made["beam"].values).all()
        assert np.abs((read["time"].values - made["time"].values) / np.timedelta64(1, "us")).max() <= 1.0
        assert read["radial_velocity"].values == pytest.approx(made["radial_velocity"].values, abs=1e-4)


def tensor_of(stresses):
    tensor = np.zeros((3, 3))
    for (i, j), value in zip(PACKED, stresses, strict=True):
        tensor[i, j] = tensor[j, i] = value
    return tensor
