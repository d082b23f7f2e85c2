"""Noise by theory at the ends of what users may ask for: finite, semi-definite, continuous, or one clear error."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.turbulence.mann import MannTurbulence

FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2)
ROUNDING = 64.0 * np.finfo(np.float64).eps
QUADRATURE = 1e-4  # what theory_noise promises of a velocity covariance, relative to uu, unless told otherwise


def points(place):
    """Return a scan that looks at places, shape (n, 3), in m, all at once."""
    place = np.asarray(place, dtype=float)
    distance = np.linalg.norm(place, axis=1)
    return Scan("points", place / distance[:, None], distance, np.zeros(len(place)), 1.0)


def cone(angle_deg, n_beam=6, *, distance=98.0, scan_duration=1.0):
    phase = 2.0 * np.pi * np.arange(n_beam) / n_beam
    angle = np.deg2rad(angle_deg)
    across = np.sin(angle) * np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    unit = np.column_stack([np.full(n_beam, -np.cos(angle)), across])
    times = scan_duration * np.arange(n_beam) / n_beam
    return Scan("cone", unit / np.linalg.norm(unit, axis=1)[:, None], np.full(n_beam, distance), times, scan_duration)


def check(noise):
    """Finite, symmetric, positive semi-definite to rounding, with variances that a record can have."""
    assert np.all(np.isfinite(noise.covariance[0]))
    assert np.all(np.isfinite(noise.bias[0]))
    np.testing.assert_array_equal(noise.covariance[0], noise.covariance[0].T)
    eigenvalues = np.linalg.eigvalsh(noise.covariance[0])
    assert eigenvalues[0] >= -ROUNDING * noise.n_beam * eigenvalues[-1]
    spread = np.diag(noise.covariance[0])
    assert np.all(spread > 0.0)
    assert np.all(spread <= 2.0 * (1.0 + noise.details["covariance_error"]))  # N samples that are one: χ² of one degree
    assert np.all(noise.bias[0] < noise.details["velocity_covariance_error"] * 10.0)
    assert np.all(noise.bias[0] >= -1.0)
    assert noise.details["negative_part"] <= noise.details["covariance_error"] * noise.n_beam / eigenvalues[-1]
    return noise


def distance(one, other):
    return np.linalg.norm(one.covariance[0] - other.covariance[0]) / np.linalg.norm(other.covariance[0])


class TestExtremes:
    @pytest.mark.parametrize("apart", [0.0, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e4, 1e5])
    def test_two_beams_from_coincident_to_10_km_apart(self, apart):
        place = [[-98.0, 0.0, 0.0], [-98.0, 0.6 * apart, 0.8 * apart]]
        noise = check(theory_noise(points(place), FLOW, wind_speed=10.0))
        correlation = noise.correlation[0, 0, 1]
        if apart <= 1e-3:
            assert correlation == pytest.approx(1.0, abs=2.0 * noise.details["covariance_error"])
        if apart >= 1e3:  # 16 L; sheared eddies reach far: 0.0063 there at every tolerance
            assert abs(correlation) < (0.01 if apart == 1e3 else 1e-6)

    @pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 0.01, 45.0, 89.999, 90.0])
    def test_opening_angles(self, angle_deg):
        check(theory_noise(cone(angle_deg), FLOW, wind_speed=10.0))

    @pytest.mark.parametrize("gamma", [0.0, 0.01, 3.2, 6.0])
    @pytest.mark.parametrize("length_scale", [1.0, 10.0, 300.0, 5000.0])
    def test_length_scales_and_anisotropies(self, length_scale, gamma):
        flow = replace(FLOW, length_scale=length_scale, gamma=gamma)
        for duration in (10.0, 7200.0):
            check(theory_noise(load_scan("6-beam"), flow, wind_speed=10.0, duration=duration))

    @pytest.mark.parametrize("rate", [0.05, 1.0, 50.0])
    @pytest.mark.parametrize("duration", [10.0, 600.0, 7200.0])
    def test_sampling_and_record_lengths(self, duration, rate):
        scan = replace(load_scan("2-beam"), scan_duration=1.0 / rate, beam_time=np.array([0.0, 0.5 / rate]))
        if duration * rate < 2.0:
            with pytest.raises(InputError, match=r"has 1 samples in a record, .*make the record longer than"):
                theory_noise(scan, FLOW, wind_speed=10.0, duration=duration)
        else:
            check(theory_noise(scan, FLOW, wind_speed=10.0, duration=duration))

    @pytest.mark.parametrize("wind_speed", [0.01, 0.5, 80.0])
    def test_wind_speeds(self, wind_speed):
        check(theory_noise(load_scan("6-beam"), FLOW, wind_speed=wind_speed))

    def test_all_at_once(self):
        """The longest records of the smallest eddies, and the shortest of the largest."""
        far = replace(points([[-98.0, 0.0, 0.0], [-98.0, 1e4, 0.0]]), scan_duration=0.1)
        check(theory_noise(far, replace(FLOW, length_scale=1.0, gamma=6.0), wind_speed=25.0, duration=7200.0))
        check(theory_noise(far, replace(FLOW, length_scale=5000.0, gamma=6.0), wind_speed=1.0, duration=10.0))

    @pytest.mark.parametrize(
        "change",
        [
            {"wind_speed": 0.0},
            {"wind_speed": -1.0},
            {"wind_speed": np.nan},
            {"duration": 0.0},
            {"duration": np.inf},
            {"yaw": np.nan},
            {"tolerance": 1e-9},
            {"tolerance": -1.0},
            {"detrend": "cubic"},
        ],
    )
    def test_what_cannot_be_is_one_clear_error(self, change):
        with pytest.raises(InputError, match=f"(Invalid|Unknown) {next(iter(change))}") as caught:
            theory_noise(load_scan("2-beam"), FLOW, **{"wind_speed": 10.0, **change})
        assert "\n" not in str(caught.value)


class TestContinuous:
    """A relative change of 1e-3 in a parameter changes K by no more than a hundredth, at the edges of tables too."""

    cases = (
        (
            "length_scale",
            lambda v: (load_scan("6-beam"), replace(FLOW, length_scale=v), {}),
            (1.0, 61.0, 976.0, 5000.0),
        ),
        ("gamma", lambda v: (load_scan("6-beam"), replace(FLOW, gamma=v), {}), (1e-3, 1.0, 3.2, 6.0)),
        ("wind_speed", lambda v: (load_scan("6-beam"), FLOW, {"wind_speed": v}), (0.5, 5.0, 26.0)),
        ("opening", lambda v: (cone(v), FLOW, {}), (1e-3, 1.0, 15.0, 45.0, 89.9)),
        ("focus", lambda v: (cone(15.0, distance=v), FLOW, {}), (1e-3, 10.0, 244.0, 976.0, 1e4)),
        ("interval", lambda v: (cone(15.0, scan_duration=v), FLOW, {}), (0.1, 1.0, 20.0)),
        ("yaw", lambda v: (load_scan("6-beam"), FLOW, {"yaw": v}), (1e-3, 0.5, 1.5)),
    )

    @pytest.mark.parametrize(("name", "make", "values"), cases, ids=[case[0] for case in cases])
    def test_a_small_change_changes_little(self, name, make, values):
        for value in values:
            noises = []
            for factor in (1.0, 1.001):
                scan, flow, options = make(factor * value)
                noises.append(check(theory_noise(scan, flow, **{"wind_speed": 10.0, "duration": 300.0, **options})))
            assert distance(*noises) < 0.01, (name, value)

    @pytest.mark.parametrize("limit", ["gamma", "apart"])
    def test_limits_are_reached(self, limit):
        if limit == "gamma":
            one, other = (
                theory_noise(load_scan("6-beam"), replace(FLOW, gamma=gamma), wind_speed=10.0) for gamma in (0.0, 1e-4)
            )
        else:
            one, other = (
                theory_noise(points([[-98.0, 0.0, 0.0], [-98.0, apart, 0.0]]), FLOW, wind_speed=10.0)
                for apart in (0.0, 1e-5)
            )
        assert distance(one, other) < 5.0 * QUADRATURE


class TestLaws:
    def noise(self, scan, flow=FLOW, **options):
        return theory_noise(scan, flow, **{"wind_speed": 8.0, "duration": 300.0, "yaw": 0.2, **options})

    @pytest.mark.parametrize("factor", [1e-6, 1e6])
    def test_dissipation_scales_out(self, factor):
        one, other = (
            self.noise(load_scan("6-beam"), replace(FLOW, dissipation=f * FLOW.dissipation)) for f in (1.0, factor)
        )
        np.testing.assert_allclose(other.covariance[0], one.covariance[0], rtol=1e-12)
        np.testing.assert_allclose(other.bias[0], one.bias[0], rtol=1e-11)

    def test_order_of_the_beams(self):
        scan = load_scan("6-beam")
        mixed = [3, 0, 5, 1, 4, 2]
        one, other = self.noise(scan), self.noise(scan.select(mixed))
        np.testing.assert_allclose(other.covariance[0], one.covariance[0][np.ix_(mixed, mixed)], rtol=1e-11)

    def test_a_duplicate_beam_changes_nothing_but_doubles_it(self):
        scan = load_scan("6-beam")
        twice = replace(
            scan,
            beam_direction=np.vstack([scan.beam_direction, scan.beam_direction[2]]),
            focus_distance=np.append(scan.focus_distance, scan.focus_distance[2]),
            beam_time=np.append(scan.beam_time, scan.beam_time[2]),
            beam=np.arange(7),
        )
        one, other = self.noise(scan), self.noise(twice)
        index = [0, 1, 2, 3, 4, 5, 2]
        size = np.max(one.covariance[0])
        np.testing.assert_allclose(other.covariance[0], one.covariance[0][np.ix_(index, index)], atol=1e-12 * size)

    def test_reversed_beams(self):
        """n → −n with the places turned about, too: separations change sign, in which covariances are even."""
        place = load_scan("6-beam").line_of_sight * 98.0
        one, other = (self.noise(points(sign * place)) for sign in (1.0, -1.0))
        np.testing.assert_allclose(other.covariance[0], one.covariance[0], rtol=1e-10)
        np.testing.assert_allclose(other.bias[0], one.bias[0], rtol=1e-10)

    @pytest.mark.parametrize("factor", [0.5, 4.0])
    def test_only_ratios_count(self, factor):
        """L, distances and either times, or the wind speed, by one factor: K is the same."""
        scan = load_scan("6-beam")
        one = self.noise(scan)
        larger = replace(scan, focus_distance=factor * scan.focus_distance)
        slower = replace(larger, beam_time=factor * scan.beam_time, scan_duration=factor * scan.scan_duration)
        flow = replace(FLOW, length_scale=factor * FLOW.length_scale)
        by_time = self.noise(slower, flow, duration=factor * 300.0)
        by_speed = self.noise(larger, flow, wind_speed=factor * 8.0)
        for other in (by_time, by_speed):
            np.testing.assert_allclose(other.covariance[0], one.covariance[0], rtol=1e-9)
            np.testing.assert_allclose(other.bias[0], one.bias[0], rtol=1e-8)

    def test_mirror_image_in_the_vertical_plane(self):
        scan = load_scan("6-beam")
        mirrored = replace(scan, beam_direction=scan.beam_direction * [1.0, -1.0, 1.0])
        one, other = self.noise(scan, yaw=0.3), self.noise(mirrored, yaw=-0.3)
        np.testing.assert_allclose(other.covariance[0], one.covariance[0], rtol=1e-10)


class TestRandom:
    """Scenes drawn at random, from fixed seeds: whatever comes, it is noise or one clear error."""

    @staticmethod
    def scene(rng):
        n_beam = int(rng.integers(1, 7))
        unit = rng.normal(size=(n_beam, 3))
        unit /= np.linalg.norm(unit, axis=1)[:, None]
        if n_beam > 2 and rng.random() < 0.5:
            unit[1] = unit[0]  # coincident directions
        distance = 10.0 ** rng.uniform(-2.0, 4.0) * (1.0 if rng.random() < 0.5 else 10.0 ** rng.uniform(-3, 0, n_beam))
        scan_duration = 10.0 ** rng.uniform(-1.7, 1.3)
        times = np.sort(rng.uniform(0.0, scan_duration, n_beam)) if rng.random() < 0.7 else np.zeros(n_beam)
        scan = Scan("random", unit, np.broadcast_to(distance, n_beam), times, scan_duration, tilt=rng.normal() * 0.2)
        flow = MannTurbulence(
            dissipation=10.0 ** rng.uniform(-4.0, 1.0),
            length_scale=10.0 ** rng.uniform(0.0, 3.7),
            gamma=float(rng.choice([0.0, 3.2, 6.0])),
        )
        duration = min(10.0 ** rng.uniform(1.0, 3.86), 20_000.0 * scan_duration)
        options = {
            "wind_speed": 10.0 ** rng.uniform(-0.5, 1.6),
            "duration": duration,
            "yaw": rng.uniform(-np.pi, np.pi),
            "detrend": str(rng.choice(["mean", "linear"])),
        }
        return scan, flow, options

    @pytest.mark.parametrize("seed", range(60))
    def test_scene(self, seed):
        scan, flow, options = self.scene(np.random.default_rng(seed))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                noise = theory_noise(scan, flow, **options)
            except InputError as error:
                message = str(error)
            else:
                check(noise)
                return
        assert "Invalid duration" in message  # fewer samples than removing the mean or the line leaves
        assert options["duration"] <= 4.0 * scan.scan_duration
