"""The shortcuts for the noise of many beams, against every pair with all its lags."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scenes import point_scan

from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import ContinuousWaveProbe
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.theory.lag_nodes import lag_nodes
from bayes_rs.theory.pair_interpolation import interpolate_pairs, pair_features, spread_pairs
from bayes_rs.theory.pair_moments import PAIR_TOLERANCE
from bayes_rs.turbulence.mann import load_turbulence
from bayes_rs.turbulence.toeplitz import toeplitz_gram, toeplitz_inner, toeplitz_trace

SEED = load_turbulence("fu-2022")
WIDTH = 0.01  # the largest change of a posterior's width that is allowed


def part_of(name, count):
    scan = load_scan(name)
    return scan.select(scan.beam[np.linspace(0, scan.n_beam - 1, count).round().astype(int)])


def at_random(count, probe):
    """A scan that no one would make: beams anywhere, unequal focus distances, and unequal numbers of samples."""
    rng = np.random.default_rng(5)
    directions = np.column_stack([-np.ones(count), rng.normal(0.0, 0.3, (count, 2))])
    times = np.sort(rng.uniform(0.0, 4.9, count))
    scan = point_scan(directions, distance=rng.uniform(40.0, 160.0, count), scan_duration=5.0, times=times)
    return replace(scan, probe=probe)


SCENES = {
    "points": (part_of("spinnerlidar@probe=point", 60), {"wind_speed": 10.0}),
    "probes": (part_of("spinnerlidar", 60), {"wind_speed": 12.0, "yaw": 0.3}),
    "zx-tm": (load_scan("zx-tm"), {"wind_speed": 25.0, "yaw": -0.4}),
    "light wind": (load_scan("zx-tm"), {"wind_speed": 3.0}),
    "linear": (load_scan("50-beam"), {"wind_speed": 8.0, "detrend": "linear"}),
    "planes": (load_scan("6-beam-planes"), {"wind_speed": 8.0, "yaw": 0.2}),
    "low": (load_scan("zx-300@focus_distance=39.3405"), {"wind_speed": 7.0, "yaw": 1.0}),
    "middle": (load_scan("zx-300@focus_distance=103.5276"), {"wind_speed": 10.0}),
    "random": (at_random(60, ContinuousWaveProbe(rayleigh_length=6.0)), {"wind_speed": 9.0, "duration": 302.0}),
}
FLOWS = {
    "usual": SEED,
    "short eddies": replace(SEED, length_scale=10.0),
    "long eddies": replace(SEED, length_scale=320.0, gamma=5.0),
    "isotropic": replace(SEED, length_scale=30.0, gamma=0.0),
}

SLOW = {("short eddies", "middle"), ("short eddies", "random"), ("short eddies", "probes")}  # all pairs are calculated
EVERY = list(product(FLOWS, SCENES))
SOME = set(EVERY[::2]) - SLOW
"""Every second of the cases: each flow with four scenes or more, each scene with one flow or more, most with two."""


def widths(scan, covariance, flow):
    """The widths of the six stresses, in least squares of ln y with the covariance ln(1 + K): what the beams tell."""
    design = design_matrix(scan.line_of_sight)
    relative = design / (design @ flow.stresses())[:, None]
    u, s, vt = np.linalg.svd(relative, full_matrices=False)
    seen = s > 1e-3 * s[0]
    pseudo = (vt[seen].T / s[seen]) @ u[:, seen].T
    return np.sqrt(np.diag(pseudo @ np.log1p(covariance) @ pseudo.T))


class TestAgainstEveryPair:
    @pytest.mark.parametrize(
        ("flow", "scene"),
        [pytest.param(*both, marks=[pytest.mark.long] * (both not in SOME)) for both in EVERY],
    )
    def test_covariance_and_widths(self, flow, scene):
        scan, options = SCENES[scene]
        short = theory_noise(scan, FLOWS[flow], **options)
        exact = theory_noise(scan, FLOWS[flow], **options, pair_tolerance=0.0)
        k, truth = short.covariance[0], exact.covariance[0]
        assert np.linalg.norm(k - truth) < 1.5 * PAIR_TOLERANCE * np.linalg.norm(truth)  # the error is of a sample
        wide, true = widths(scan, k, FLOWS[flow]), widths(scan, truth, FLOWS[flow])
        np.testing.assert_allclose(wide, true, rtol=WIDTH)
        assert np.max(np.abs(k - truth)) < short.details["covariance_error"]
        np.testing.assert_allclose(short.bias, exact.bias, rtol=1e-9)  # beams with themselves are not shortened
        assert exact.details["pairs_calculated"] == "every one, with all lags"

    def test_the_stated_error_is_that_of_all_pairs(self):
        scan = load_scan("zx-300@focus_distance=103.5276")
        short, exact = (theory_noise(scan, SEED, wind_speed=10.0, pair_tolerance=t) for t in (PAIR_TOLERANCE, 0.0))
        found = np.linalg.norm((short.covariance - exact.covariance)[0]) / np.linalg.norm(exact.covariance[0])
        assert 0.3 * found < short.details["pair_error"] < PAIR_TOLERANCE

    @pytest.mark.parametrize(("length_scale", "wind_speed"), [(28.0, 14.0), (40.0, 10.0)])
    def test_long_probes_by_coarse_rules_first(self, length_scale, wind_speed):
        """Volumes as long as the eddies: points are no help, and all pairs were calculated."""
        scan, flow = load_scan("zx-300@focus_distance=155.2914"), replace(SEED, length_scale=length_scale)
        short, exact = (
            theory_noise(scan, flow, wind_speed=wind_speed, pair_tolerance=t) for t in (PAIR_TOLERANCE, 0.0)
        )
        k, truth = short.covariance[0], exact.covariance[0]
        assert int(short.details["pairs_calculated"].split()[0]) < 500
        assert np.linalg.norm(k - truth) < 1.5 * PAIR_TOLERANCE * np.linalg.norm(truth)
        np.testing.assert_allclose(widths(scan, k, flow), widths(scan, truth, flow), rtol=WIDTH)

    @pytest.mark.parametrize(
        ("length_scale", "tolerance", "half"), [(28.3, 0.004, True), (80.0, PAIR_TOLERANCE, False)]
    )
    def test_rules_half_as_fine_where_they_do(self, length_scale, tolerance, half):
        """Where the coarser of two rules is not good enough, it is found out, and not taken."""
        scan = load_scan("zx-300@focus_distance=310.5829").select(np.arange(0, 50, 5))
        flow = replace(SEED, length_scale=length_scale)
        short, exact = (theory_noise(scan, flow, wind_speed=10.0, pair_tolerance=t) for t in (tolerance, 0.0))
        k, truth = short.covariance[0], exact.covariance[0]
        assert short.details["pairs_calculated"].endswith("half as fine") is half
        assert np.linalg.norm(k - truth) < tolerance * np.linalg.norm(truth)
        assert short.details["pair_error"] < tolerance
        np.testing.assert_allclose(widths(scan, k, flow), widths(scan, truth, flow), rtol=WIDTH)

    def test_a_smaller_tolerance_is_kept(self):
        scan = load_scan("zx-tm")
        errors = []
        exact = theory_noise(scan, SEED, wind_speed=8.0, pair_tolerance=0.0).covariance[0]
        for tolerance in (1e-2, 1e-3, 1e-5):
            k = theory_noise(scan, SEED, wind_speed=8.0, pair_tolerance=tolerance).covariance[0]
            errors.append(np.linalg.norm(k - exact) / np.linalg.norm(exact))
            assert errors[-1] < 1.5 * tolerance
        assert errors[-1] < errors[0]

    def test_few_beams_are_calculated_as_ever(self):
        one, other = (theory_noise("6-beam", SEED, wind_speed=9.0, pair_tolerance=t) for t in (PAIR_TOLERANCE, 0.0))
        np.testing.assert_array_equal(one.covariance, other.covariance)

    def test_the_same_on_every_run(self):
        one, other = (theory_noise("zx-tm", SEED, wind_speed=9.5).covariance for _ in range(2))
        np.testing.assert_array_equal(one, other)

    def test_dissipation_has_no_influence(self):
        one, other = (
            theory_noise("zx-tm", replace(SEED, dissipation=d), wind_speed=9.5).covariance for d in (0.01, 1.0)
        )
        np.testing.assert_allclose(one, other, rtol=1e-8)

    def test_a_probe_of_no_length_sees_points(self):
        scan = load_scan("50-beam")
        short = replace(scan, probe=ContinuousWaveProbe(rayleigh_length=1e-3))
        points = theory_noise(scan, SEED, wind_speed=10.0)
        probes = theory_noise(short, SEED, wind_speed=10.0, probe_tolerance=0.0)
        np.testing.assert_allclose(probes.covariance, points.covariance, rtol=0.02)

    def test_what_is_no_tolerance(self):
        with pytest.raises(InputError, match="Invalid pair_tolerance -1"):
            theory_noise("zx-tm", SEED, wind_speed=9.5, pair_tolerance=-1.0)


class TestLagNodes:
    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    def test_all_lags_are_the_sums_themselves(self, detrend):
        values = np.random.default_rng(1).normal(size=(3, 70))
        nodes = lag_nodes(30, 41, (0.0, 0.5), 0.0, detrend=detrend)
        np.testing.assert_allclose(
            nodes.inner(values), toeplitz_inner(values, values, 30, 41, detrend=detrend), rtol=1e-10
        )
        gram = toeplitz_gram(values, 30, 41, detrend=detrend)
        for i in range(3):
            for j in range(3):
                inner = toeplitz_inner(values[i], values[j], 30, 41, detrend=detrend)
                assert gram[i, j] == pytest.approx(float(inner), rel=1e-9, abs=1e-9)

    @pytest.mark.parametrize(("growth", "error"), [(0.25, 5e-4), (0.15, 2e-5)])
    def test_a_cusp_is_summed_from_few(self, growth, error):
        n = 600
        lag = np.arange(-(n - 1), n)
        cusp = np.exp(-((np.abs(lag - 1.3) / 12.0) ** (2.0 / 3.0)))
        nodes = lag_nodes(n, n, (1.3, 1.3), growth, detrend="mean")
        assert len(nodes.lag) < 100
        at_nodes = cusp[nodes.lag + n - 1]
        assert float(nodes.inner(at_nodes[None])[0]) == pytest.approx(
            float(toeplitz_inner(cusp, cusp, n, n)), rel=error
        )
        assert float(at_nodes @ nodes.trace) == pytest.approx(float(toeplitz_trace(cusp, n)), rel=error)

    def test_where_few_save_nothing_all_are_taken(self):
        assert len(lag_nodes(12, 12, (-3.0, 3.0), 0.25, detrend="mean").lag) == 23


class TestInterpolation:
    def scene(self, n=900):
        rng = np.random.default_rng(3)
        direction = np.column_stack([-np.ones((n, 1)), rng.normal(0.0, 0.2, (n, 2))])
        across = rng.normal(0.0, 20.0, (n, 2))
        return pair_features(
            direction,
            direction[::-1],
            across,
            rng.normal(0.0, 5.0, n),
            np.full((n, 2), 2.0),
            step=20.0,
            length_scale=60.0,
        )

    def interpolate(self, features, apart, aside, calculate, tolerance, width_tolerance=1.0, alike=None):
        one = np.ones(len(apart))
        shares = one[:, np.newaxis] / len(apart)
        return interpolate_pairs(
            features, apart, aside, one if alike is None else alike, one, shares, calculate, tolerance, width_tolerance
        )

    def test_a_smooth_function_takes_few(self):
        features, apart, aside = self.scene()
        truth = np.exp(0.01 * (features[:, 0] + features[:, 1]) + 0.02 * features[:, 5])
        asked = []

        def calculate(index):
            asked.extend(index.tolist())
            return truth[index]

        found = self.interpolate(features, apart, aside, calculate, 0.02)
        assert found.n_calculated == len(asked) == len(set(asked)) < 0.6 * len(apart)
        assert found.error < 0.02
        np.testing.assert_allclose(found.values, truth, rtol=0.1)

    def test_a_rough_one_is_calculated_for_all(self):
        features, apart, aside = self.scene()
        truth = np.exp(np.random.default_rng(0).normal(size=len(apart)))
        found = self.interpolate(features, apart, aside, lambda index: truth[index], 1e-3)
        np.testing.assert_array_equal(found.values, truth)
        assert found.n_calculated == len(truth)
        assert found.error == found.largest_error == 0.0

    def test_more_are_calculated_where_widths_change_too_much(self):
        features, apart, aside = self.scene()
        truth = np.exp(0.05 * np.sin(features[:, 0]) + 0.05 * features[:, 5])
        some, more = (
            self.interpolate(features, apart, aside, lambda index: truth[index], 0.05, width) for width in (1.0, 1e-5)
        )
        assert more.n_calculated > some.n_calculated
        assert more.width_error <= 1e-5 < some.width_error

    def test_what_is_small_beside_others_is_told_by_differences(self):
        """A ratio of values that nearly vanish tells nothing."""
        features, apart, aside = self.scene()
        nearly = np.exp(np.random.default_rng(4).normal(-6.0, 3.0, len(apart)))
        truth = nearly + 0.05 * (1.2 + np.sin(0.05 * features[:, 0]))
        found = self.interpolate(features, apart, aside, lambda index: truth[index], 1e-3, alike=nearly)
        assert found.n_calculated < 0.4 * len(apart)
        np.testing.assert_allclose(found.values, truth, atol=2e-3)

    def test_spread_pairs_reach_both_ends(self):
        apart = np.random.default_rng(1).uniform(size=500)
        chosen = spread_pairs(apart, 20)
        assert {int(np.argmin(apart)), int(np.argmax(apart))} <= set(chosen.tolist())
