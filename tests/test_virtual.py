"""The virtual lidar: exact interpolation, frozen turbulence, simulated series."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.geometry.forward import radial_variance
from bayes_rs.geometry.probe import ContinuousWaveProbe, PulsedProbe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.records.making import make_records
from bayes_rs.simulation.boxes import Box, BoxGrid, BoxMaker
from bayes_rs.simulation.virtual import (
    SIMULATORS,
    RecordState,
    beam_lines,
    grid_for,
    interpolation_weights,
    placements,
    sample_lines,
    sample_records,
    simulate,
)
from bayes_rs.turbulence.mann import MannTurbulence

GRID = BoxGrid((64, 12, 10), (5.0, 7.0, 9.0))
SETTINGS = {"wind_speed": 10.0, "duration": 60.0, "n_records": 5, "seed": 3}
ROUNDING = 1e-11  # sums of a few thousand terms of size 1, phases of a few hundred rad
WIDE_EDDIES = MannTurbulence(dissipation=0.05, length_scale=100.0, gamma=3.2)  # few grid points for short records


def one_wave(number, phase, amplitude=(1.0, 1.0, 1.0)):
    """Return a box that holds one Fourier mode, and the same field as a function of position."""
    wave = 2.0 * np.pi * np.array(number) / np.array(GRID.size)

    def field(position):
        return np.array(amplitude) * np.cos(np.asarray(position) @ wave + phase)[..., None]

    axes = [count * np.arange(n) for n, count in zip(GRID.shape, GRID.spacing, strict=True)]
    return Box(np.moveaxis(field(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)), -1, 0), GRID), field


class TestInterpolation:
    @settings(max_examples=50, deadline=None)
    @given(
        st.tuples(st.integers(-31, 31), st.integers(-5, 5), st.integers(-4, 4)),
        st.floats(0.0, 6.0),
        st.floats(0.5, 20.0),
    )
    def test_one_fourier_mode_is_sampled_to_rounding(self, number, phase, wind_speed):
        box, field = one_wave(number, phase, amplitude=(1.0, -0.7, 0.4))
        scan = load_scan("6-beam", yaw_deg=20.0, tilt_deg=3.0)
        state = RecordState(scan, wind_speed, 0.3, 7.0)
        velocity = sample_records(beam_lines(box, state.focus, state.line_of_sight), state, GRID)
        for record in range(len(velocity)):
            for beam in range(scan.n_beam):
                time = scan.beam_time[beam] + scan.scan_duration * (record * state.n_sample + np.arange(state.n_sample))
                position = state.focus[beam] - np.outer(wind_speed * time, [1.0, 0.0, 0.0])  # x − U t
                expected = field(position) @ state.line_of_sight[beam]
                np.testing.assert_allclose(velocity[record, beam], expected, rtol=0.0, atol=ROUNDING)

    def test_shortest_wave_is_a_cosine_about_the_grid(self):
        values = np.cos(np.pi * np.arange(8))
        position = np.linspace(-3.0, 11.0, 57)
        weights = interpolation_weights(position, 8, 1.0)
        np.testing.assert_allclose(weights @ values, np.cos(np.pi * position), atol=1e-13)
        samples = sample_lines(values[None], 8.0, position[:1], 0.25, 57)
        np.testing.assert_allclose(samples[0], np.cos(np.pi * position), atol=1e-12)

    def test_weights_reproduce_a_constant(self):
        weights = interpolation_weights(np.linspace(-50.0, 50.0, 101), 12, 7.0)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-13)

    def test_long_series_stay_exact(self):
        """The chirp's phase grows with the square of the sample's number."""
        line = np.cos(2.0 * np.pi * 5.0 * np.arange(4096) / 4096)
        start, step, count = 3.3, -9.7, 20000
        samples = sample_lines(line[None], 12288.0, [start], step, count)
        expected = np.cos(2.0 * np.pi * 5.0 * (start + step * np.arange(count)) / 12288.0)
        np.testing.assert_allclose(samples[0], expected, atol=1e-9)

    def test_wrong_shape(self):
        with pytest.raises(InputError, match="Invalid line_of_sight of shape"):
            beam_lines(one_wave((1, 0, 0), 0.0)[0], np.zeros((2, 3)), np.zeros((3, 3)))


class TestLaws:
    def test_a_staring_beam_reads_u_along_a_line_backwards(self):
        """Frozen turbulence: what is upstream now comes later; v_r = −u for a beam that looks upwind."""
        rng = np.random.default_rng(1)
        box = Box(rng.normal(size=(3, *GRID.shape)), GRID)
        scan = Scan("staring", [[-1.0, 0.0, 0.0]], [100.0], [0.0], 1.0)
        state = RecordState(scan, GRID.spacing[0], 0.0, 10.0)  # one grid step per sample
        velocity = sample_records(beam_lines(box, state.focus, state.line_of_sight), state, GRID)
        line = box.velocity[0, :, 0, 0]
        first = round(-100.0 / GRID.spacing[0])
        expected = -line[(first - np.arange(velocity.size)) % GRID.shape[0]]
        np.testing.assert_allclose(velocity.ravel(), expected, atol=ROUNDING)

    def test_a_later_beam_time_is_a_later_sample(self):
        box, _ = one_wave((3, 0, 0), 0.4)
        early, late = (Scan("one", [[-1.0, 0.0, 0.0]], [50.0], [time], 1.0) for time in (0.0, 0.5))
        line = beam_lines(box, [[-50.0, 0.0, 0.0]], [[-1.0, 0.0, 0.0]])
        slow = sample_records(line, RecordState(late, 8.0, 0.0, 4.0), GRID)
        fast = sample_lines(line, GRID.size[0], [-50.0], -4.0, 10)  # every half second
        np.testing.assert_allclose(slow[0, 0], fast[0, 1:9:2], atol=ROUNDING)
        assert not np.allclose(sample_records(line, RecordState(early, 8.0, 0.0, 4.0), GRID)[0, 0], slow[0, 0])

    def test_the_box_is_periodic(self):
        box = Box(np.random.default_rng(2).normal(size=(3, *GRID.shape)), GRID)
        direction = load_scan("6-beam").line_of_sight
        focus = 30.0 * direction
        once = beam_lines(box, focus, direction)
        np.testing.assert_allclose(
            beam_lines(box, focus + np.array([0.0, GRID.size[1], -2.0 * GRID.size[2]]), direction), once, atol=ROUNDING
        )

    def test_reversed_directions_reverse_the_velocity(self):
        box = Box(np.random.default_rng(3).normal(size=(3, *GRID.shape)), GRID)
        scan = load_scan("6-beam")
        focus = scan.focus_distance[:, None] * scan.line_of_sight
        np.testing.assert_array_equal(
            beam_lines(box, focus, -scan.line_of_sight), -beam_lines(box, focus, scan.line_of_sight)
        )

    @pytest.mark.parametrize("wind_speed", [4.0, 10.0])
    def test_expected_variance_is_the_slow_double_sum(self, wind_speed):
        """E[y] = R(0) − (1/N²) Σ_i Σ_j R(U Δ (i − j)), R from the spectrum of each beam."""
        maker = BoxMaker(WIDE_EDDIES, BoxGrid((128, 8, 8), (10.0, 60.0, 60.0)))
        state = RecordState(load_scan("6-beam"), wind_speed, 0.4, 50.0)
        lag = wind_speed * np.arange(50)
        lags = np.abs(np.subtract.outer(np.arange(50), np.arange(50)))
        for beam, direction in enumerate(state.line_of_sight):
            power = np.einsum("i,kij,j->k", direction, maker.spectrum, direction)
            covariance = np.cos(np.outer(lag, maker.wave_number)) @ power
            slow = covariance[0] - covariance[lags].mean()
            assert state.expected_variance(maker)[beam] == pytest.approx(slow, rel=1e-10)


WIDTH = 12.0  # of the probes below, m: H falls to a tenth and less at the highest wave numbers of GRID
CLOSED_FORMS = {  # probe, its transfer written out
    "continuous-wave": (ContinuousWaveProbe(rayleigh_length=WIDTH), lambda k: np.exp(-WIDTH * np.abs(k))),
    "triangle": (PulsedProbe(gate_length=WIDTH), lambda k: np.sinc(k * WIDTH / (2.0 * np.pi)) ** 2),
    "gaussian": (
        PulsedProbe(gate_length=WIDTH, pulse="gaussian", pulse_length=20.0),
        lambda k: np.sinc(k * WIDTH / (2.0 * np.pi)) * np.exp(-((20.0 * k) ** 2) / (16.0 * np.log(2.0))),
    ),
}


class TestProbe:
    """A beam sees the weighted mean of n·u along it: each wave is multiplied by the probe's transfer at k·n."""

    scan = load_scan("6-beam", yaw_deg=20.0, tilt_deg=3.0, opening_angle_deg=40.0)
    focus = scan.focus_distance[:, None] * scan.line_of_sight

    @pytest.mark.parametrize("kind", [np.float64, np.float32])
    @pytest.mark.parametrize("probe", [ContinuousWaveProbe(rayleigh_length=1e-15), PulsedProbe(gate_length=1e-12)])
    def test_a_short_one_is_a_point_to_rounding(self, probe, kind):
        box = Box(np.random.default_rng(4).normal(size=(3, *GRID.shape)).astype(kind), GRID)
        points = beam_lines(box, self.focus, self.scan.line_of_sight)
        probed = beam_lines(
            box, self.focus, self.scan.line_of_sight, probe=probe, focus_distance=self.scan.focus_distance
        )
        atol = ROUNDING if kind is np.float64 else 1e-5  # single precision: 60 ε for sums of 1440 waves
        np.testing.assert_allclose(probed, points, rtol=0.0, atol=atol)

    @settings(max_examples=50, deadline=None)
    @given(
        st.sampled_from(sorted(CLOSED_FORMS)),
        st.tuples(st.integers(-31, 31), st.integers(-5, 5), st.integers(-4, 4)),
        st.floats(0.0, 6.0),
    )
    def test_one_fourier_mode_is_multiplied_by_the_transfer(self, name, number, phase):
        box, field = one_wave(number, phase, amplitude=(1.0, -0.7, 0.4))
        probe, transfer = CLOSED_FORMS[name]
        state = RecordState(replace(self.scan, probe=probe), 7.3, 0.3, 7.0)
        wave = 2.0 * np.pi * np.array(number) / np.array(GRID.size)
        lines = beam_lines(box, state.focus, state.line_of_sight, probe=probe, focus_distance=self.scan.focus_distance)
        velocity = sample_records(lines, state, GRID)
        for beam, direction in enumerate(state.line_of_sight):
            time = self.scan.beam_time[beam] + self.scan.scan_duration * np.arange(state.n_sample)
            position = state.focus[beam] - np.outer(7.3 * time, [1.0, 0.0, 0.0])
            expected = field(position) @ direction * transfer(wave @ direction)
            np.testing.assert_allclose(velocity[0, beam], expected, rtol=0.0, atol=ROUNDING)

    def test_is_the_weighted_mean_of_points_along_the_beam(self):
        """All waves at once, the shortest ones too, which are cosines about the grid; the sum over s is slow."""
        box = Box(np.random.default_rng(5).normal(size=(3, *GRID.shape)), GRID)
        probe = PulsedProbe(gate_length=WIDTH)
        node, weight = np.polynomial.legendre.leggauss(24)
        mean = np.zeros((self.scan.n_beam, GRID.shape[0]))
        for half in (-0.5, 0.5):  # the triangle has a corner at its middle
            for s, share in zip(WIDTH * (0.5 * node + half), 0.5 * WIDTH * weight, strict=True):
                place = self.focus + s * self.scan.line_of_sight
                line = beam_lines(box, place, self.scan.line_of_sight)
                along = s * self.scan.line_of_sight[:, 0]
                mean += share * probe.weighting(s, 0.0) * sample_lines(line, GRID.size[0], along, 5.0, GRID.shape[0])
        probed = beam_lines(
            box, self.focus, self.scan.line_of_sight, probe=probe, focus_distance=self.scan.focus_distance
        )
        np.testing.assert_allclose(probed, mean, rtol=0.0, atol=1e-9)  # the rule of 24 nodes
        assert np.std(probed) < 0.7 * np.std(beam_lines(box, self.focus, self.scan.line_of_sight))

    def test_each_beam_has_the_length_of_its_focus_distance(self):
        box = Box(np.random.default_rng(6).normal(size=(3, *GRID.shape)), GRID)
        optics = ContinuousWaveProbe(wavelength=1.565e-6, aperture_radius=0.028)
        direction, focus = self.scan.line_of_sight[[0, 0, 1]], self.focus[[0, 0, 1]]
        distance = np.array([52.0, 98.0, 140.0])
        together = beam_lines(box, focus, direction, probe=optics, focus_distance=distance)
        for beam in range(3):
            fixed = ContinuousWaveProbe(rayleigh_length=float(optics.length(distance[beam])))
            alone = beam_lines(box, focus[[beam]], direction[[beam]], probe=fixed, focus_distance=[1.0])
            np.testing.assert_allclose(together[beam], alone[0], atol=ROUNDING)
        assert not np.allclose(together[0], together[1], atol=0.01)

    @pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.0, 3.1, -4.7)])
    def test_mean_variance_of_many_boxes_is_the_expected_one(self, shift):
        """At points of the grid and between them; a coarse grid, whose beams lose a quarter of their variance."""
        maker = BoxMaker(WIDE_EDDIES, BoxGrid((96, 20, 20), (20.0, 30.0, 30.0)))
        scan = replace(self.scan, probe=ContinuousWaveProbe(rayleigh_length=WIDTH))
        state = RecordState(scan, 10.0, 0.3, 60.0)
        n_box = 200
        variance = np.empty((n_box, scan.n_beam))
        for seed in range(n_box):
            lines = beam_lines(
                maker.make(seed),
                state.focus + np.array(shift),
                state.line_of_sight,
                probe=scan.probe,
                focus_distance=scan.focus_distance,
            )
            variance[seed] = sample_records(lines, state, maker.grid).var(axis=-1).mean(axis=0)
        expected = state.expected_variance(maker)
        error = variance.std(axis=0, ddof=1) / np.sqrt(n_box)
        assert np.all(np.abs(variance.mean(axis=0) - expected) < 4.5 * error)  # Monte Carlo, six beams, skewed
        at_points = RecordState(self.scan, 10.0, 0.3, 60.0).expected_variance(maker)
        assert np.all(np.abs(variance.mean(axis=0) - at_points) > 4.5 * error)  # the test would see no probe

    @pytest.mark.parametrize("wind_speed", [4.0, 10.0])
    def test_a_short_one_takes_the_mean_square_of_the_derivative(self, wind_speed):
        """1 − H² = κ² l²/6 for a triangle of half-width l, to the order κ⁴ l⁴."""
        maker = BoxMaker(WIDE_EDDIES, BoxGrid((64, 8, 10), (20.0, 60.0, 50.0)))
        length = 0.2
        probed = RecordState(replace(self.scan, probe=PulsedProbe(gate_length=length)), wind_speed, 0.3, 50.0)
        points = RecordState(self.scan, wind_speed, 0.3, 50.0)
        change = (points.expected_variance(maker) - probed.expected_variance(maker)) / (length**2 / 6.0)
        k_2, k_3 = (2.0 * np.pi * np.fft.fftfreq(n, d) for n, d in zip((8, 10), (60.0, 50.0), strict=True))
        root = maker._tensor.spectral_vars.astype(np.float64)
        expected = np.zeros(self.scan.n_beam)
        for i, k_1 in enumerate(maker.wave_number):
            lag = k_1 * wind_speed * np.arange(50)
            kept = 1.0 - np.abs(np.mean(np.exp(1j * lag))) ** 2
            twice = 1.0 if i in {0, 32} else 2.0
            for beam, (n_1, n_2, n_3) in enumerate(points.line_of_sight):
                power = np.sum(np.einsum("i,ijyz->jyz", [n_1, n_2, n_3], root[:, :, i]) ** 2, axis=0)
                if twice == 1.0:
                    power[::4, ::5] *= 0.5
                # a cosine about the grid has κ² of two waves: what is odd in the shortest waves' number is lost
                square = (n_1 * k_1) ** 2 + ((n_2 * k_2) ** 2)[:, None] + (n_3 * k_3) ** 2
                odd = [
                    (n_1 * k_1 * (i < 32)),
                    (n_2 * k_2 * (np.arange(8) != 4))[:, None],
                    n_3 * k_3 * (np.arange(10) != 5),
                ]
                square = square + 2.0 * (odd[0] * odd[1] + odd[0] * odd[2] + odd[1] * odd[2])
                expected[beam] += maker.turbulence.dissipation * twice * kept * np.sum(power * square)
        np.testing.assert_allclose(change, expected, rtol=1e-4)  # (κ l)² is below 1e-4, differences of 1 in 10⁻¹⁶

    def test_focus_distance_is_needed(self):
        box = Box(np.zeros((3, *GRID.shape)), GRID)
        with pytest.raises(InputError, match="Missing focus_distance of beams with a probe volume: give one for each"):
            beam_lines(box, self.focus, self.scan.line_of_sight, probe=PulsedProbe(gate_length=30.0))


class TestState:
    def test_a_record_needs_two_scans(self):
        with pytest.raises(InputError, match=r"Invalid duration 1\.5 s for scan '4-beam': .*at least two scans of 1 s"):
            RecordState(load_scan("4-beam"), 10.0, 0.0, 1.5)

    @pytest.mark.parametrize(("name", "value"), [("wind_speed", 0.0), ("duration", -600.0)])
    def test_numbers(self, name, value):
        numbers = {"wind_speed": 10.0, "duration": 600.0, name: value}
        with pytest.raises(InputError, match=f"Invalid {name} {value}"):
            RecordState(load_scan("4-beam"), yaw=0.0, **numbers)

    def test_count_is_exact_where_division_is_not(self):
        scan = Scan("fast", [[-1.0, 0.0, 0.0]], [50.0], [0.0], 0.1)
        assert RecordState(scan, 10.0, 0.0, 0.3).n_sample == 3

    def test_yaw_is_the_states_not_the_scans(self):
        scan = load_scan("4-beam", yaw_deg=30.0)
        np.testing.assert_allclose(
            RecordState(scan, 10.0, 0.1, 600.0).line_of_sight, scan.with_yaw(0.1).line_of_sight, atol=1e-15
        )

    def test_placements_are_apart(self):
        shift = placements(BoxGrid((8, 16, 16), (10.0, 61.0, 61.0)), 61.0)
        assert shift.shape == (9, 3)
        assert np.all(shift[:, 0] == 0.0)
        apart = np.abs(shift[:, None] - shift[None])[~np.eye(9, dtype=bool)].max(axis=-1)
        assert apart.min() >= 4.0 * 61.0

    def test_one_placement_in_a_narrow_box(self):
        assert placements(BoxGrid((8, 8, 8), (10.0, 10.0, 10.0)), 61.0).tolist() == [[0.0, 0.0, 0.0]]


@pytest.fixture(scope="module", params=SIMULATORS)
def settings_of(request):
    return {**SETTINGS, "method": request.param}


@pytest.fixture(scope="module")
def series(settings_of):
    return simulate(load_scan("6-beam"), WIDE_EDDIES, **settings_of)


class TestSimulate:
    def test_layout(self, series):
        scan = load_scan("6-beam")
        assert series["radial_velocity"].dims == ("sample",)
        assert series.sizes["sample"] == 5 * 60 * 6
        assert series["time"].dtype == "datetime64[ns]"
        assert series["time"].values[0] == np.datetime64("2000-01-01T00:00:00")
        assert np.all(np.diff(series["time"].values) >= np.timedelta64(0, "ns"))
        assert series["time"].values[-1] < np.datetime64("2000-01-01T00:05:00")
        assert series["beam"].values[:6].tolist() == scan.beam.tolist()
        assert series.attrs["scan"] == "6-beam"
        assert series.attrs["scan_key"] == scan.key

    def test_truth_is_told(self, series):
        truth = json.loads(series.attrs["truth"])
        assert truth["length_scale"] == 100.0
        assert (truth["wind_speed"], truth["duration"], truth["shear"]) == (10.0, 60.0, 0.0)
        assert truth["stresses_record"][0] < truth["stresses"][0]  # a record loses its slow eddies
        assert truth["stresses"][4] < 0.0

    def test_each_method_tells_how(self):
        scan, truths = load_scan("6-beam"), {}
        for method in SIMULATORS:
            truths[method] = json.loads(simulate(scan, WIDE_EDDIES, **SETTINGS, method=method).attrs["truth"])
            assert truths[method]["method"] == method
        assert truths["boxes"]["generator"].startswith("hipersim")
        assert truths["lines"]["negative_part"] < 1e-6
        np.testing.assert_allclose(truths["lines"]["stresses"], WIDE_EDDIES.stresses())  # an infinite domain's

    def test_lines_are_the_default_and_need_no_hipersim(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "hipersim", None)
        series = simulate(load_scan("6-beam"), WIDE_EDDIES, **SETTINGS)
        assert json.loads(series.attrs["truth"])["method"] == "lines"
        with pytest.raises(MissingExtraError, match="hipersim"):
            simulate(load_scan("6-beam"), WIDE_EDDIES, **SETTINGS, method="boxes")

    def test_same_seed_same_numbers(self, series, settings_of):
        assert series.identical(simulate(load_scan("6-beam"), WIDE_EDDIES, **settings_of))

    def test_a_generator_is_a_seed(self, series, settings_of):
        again = simulate(load_scan("6-beam"), WIDE_EDDIES, **{**settings_of, "seed": np.random.default_rng(3)})
        assert series.identical(again)

    def test_more_records_begin_with_the_same(self, series, settings_of):
        fewer = simulate(load_scan("6-beam"), WIDE_EDDIES, **{**settings_of, "n_records": 2})
        assert fewer["radial_velocity"].equals(series["radial_velocity"][: 2 * 60 * 6])

    def test_mean_wind_is_in_the_radial_velocity(self, series):
        centre = series["radial_velocity"][series["beam"] == 5]
        assert float(centre.mean()) == pytest.approx(-10.0, abs=1.0)  # towards the lidar; turbulence of 1.3 m/s

    def test_windows_of_a_duration_that_is_no_multiple_of_the_scan(self):
        series = simulate(load_scan("pulsed-4-beam"), WIDE_EDDIES, wind_speed=10.0, duration=62.0, n_records=2, seed=1)
        second = series["time"] >= np.datetime64("2000-01-01T00:01:02")
        assert int(second.sum()) == 4 * 15
        assert series["time"].values[second.values][0] == np.datetime64("2000-01-01T00:01:02")

    def test_unknown_method(self):
        with pytest.raises(InputError, match="Unknown method of simulation 'magic': it must be one of lines, boxes"):
            simulate(load_scan("6-beam"), WIDE_EDDIES, wind_speed=10.0, seed=1, method="magic")

    def test_probe_is_told_and_takes_variance(self, settings_of):
        probed, points = load_scan("pulsed-4-beam"), load_scan("pulsed-4-beam@probe=point")
        series = simulate(probed, WIDE_EDDIES, **settings_of)
        assert json.loads(series.attrs["truth"])["probe"]["kind"] == "pulsed"
        ratio = float(
            series["radial_velocity"].var() / simulate(points, WIDE_EDDIES, **settings_of)["radial_velocity"].var()
        )
        assert 0.7 < ratio < 0.98  # the same eddies, smoothed; independent eddies would differ by a quarter

    def test_number_of_records(self):
        with pytest.raises(InputError, match="Invalid n_records 0"):
            simulate(load_scan("6-beam"), WIDE_EDDIES, wind_speed=10.0, seed=1, n_records=0)

    @pytest.mark.parametrize("method", SIMULATORS)
    def test_variances_average_to_the_record_tensor(self, method):
        scan = load_scan("6-beam", opening_angle_deg=45.0, yaw_deg=25.0)
        n_records = 240
        flow = {"wind_speed": 10.0, "duration": 60.0}
        series = simulate(scan, WIDE_EDDIES, **flow, n_records=n_records, seed=5, method=method)
        truth = json.loads(series.attrs["truth"])
        velocity = np.stack([series["radial_velocity"].values[series["beam"].values == beam] for beam in scan.beam])
        variance = velocity.reshape(scan.n_beam, n_records, 60).var(axis=-1)
        expected = radial_variance(scan.line_of_sight, truth["stresses_record"])
        error = variance.std(axis=1, ddof=1) / np.sqrt(n_records)
        assert np.all(np.abs(variance.mean(axis=1) - expected) < 4.5 * error)  # Monte Carlo, six beams, skewed
        if method == "boxes":
            state = RecordState(scan, 10.0, scan.yaw, 60.0)
            maker = BoxMaker(WIDE_EDDIES, grid_for([state], WIDE_EDDIES))
            np.testing.assert_allclose(state.expected_variance(maker), expected, rtol=1e-9)


SHEAR = 0.0288  # 1/s, of the seed's study


class TestShear:
    """The mean wind grows with height; the turbulence is carried with the wind at the lidar, so variances stay."""

    @pytest.mark.parametrize("method", SIMULATORS)
    def test_adds_its_wind_to_every_sample_of_a_beam(self, method):
        scan = load_scan("6-beam", opening_angle_deg=45.0, yaw_deg=25.0, tilt_deg=6.0)
        plain, sheared = (simulate(scan, WIDE_EDDIES, **SETTINGS, method=method, shear=shear) for shear in (0.0, SHEAR))
        added = SHEAR * scan.focus_distance * scan.line_of_sight[:, 2] * scan.line_of_sight[:, 0]
        assert np.ptp(added) > 1.0
        each = added[np.searchsorted(scan.beam, plain["beam"].values)]
        difference = sheared["radial_velocity"].values - plain["radial_velocity"].values
        np.testing.assert_allclose(difference, each, atol=ROUNDING)
        assert json.loads(sheared.attrs["truth"])["shear"] == SHEAR

    def test_sign(self):
        """Wind grows upwards: an upper beam sees it come in faster."""
        scan = load_scan("4-beam")
        flow = MannTurbulence(dissipation=1e-12, length_scale=61.0, gamma=3.2)
        series = simulate(scan, flow, wind_speed=10.0, duration=60.0, seed=1, shear=SHEAR)
        mean = series["radial_velocity"].groupby(series["beam"]).mean().values
        up = scan.line_of_sight[:, 2] > 0.0
        assert mean[up].max() < 10.0 * scan.line_of_sight[0, 0] < mean[~up].min()

    @pytest.mark.parametrize("name", ["4-beam", "6-beam", "50-beam"])
    @pytest.mark.parametrize("yaw_deg", [0.0, 20.0])
    def test_changes_no_variance_and_leaves_the_wind_of_a_symmetric_scan(self, name, yaw_deg):
        scan = load_scan(name, yaw_deg=yaw_deg)
        plain, sheared = (
            make_records(simulate(scan, WIDE_EDDIES, **SETTINGS, shear=shear), scan, duration=60.0)
            for shear in (0.0, SHEAR)
        )
        np.testing.assert_allclose(sheared["variance"].values, plain["variance"].values, rtol=1e-9)
        assert np.abs(sheared["mean"] - plain["mean"]).max() > 0.4
        np.testing.assert_allclose(sheared["wind_speed"], plain["wind_speed"], atol=ROUNDING)
        np.testing.assert_allclose(sheared["yaw"], plain["yaw"], atol=1e-9)

    def test_must_be_a_number(self):
        with pytest.raises(InputError, match="Invalid shear nan 1/s"):
            simulate(load_scan("4-beam"), WIDE_EDDIES, **SETTINGS, shear=np.nan)
