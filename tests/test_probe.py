"""Probe volumes: weightings and transfers, their quadratures, and what they do to the noise of a record."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayes_rs.errors import InputError, NoiseMismatchError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import (
    PROBE_ERROR,
    ContinuousWaveProbe,
    PointProbe,
    PulsedProbe,
    _cauchy_pair_rule,
    _cauchy_rule,
    _gauss_rule,
    make_probe,
    probe_difference,
)
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import cone_direction, load_scan
from bayes_rs.noise.by_theory import sonic_moments, theory_noise
from bayes_rs.noise.file import load_noise
from bayes_rs.theory.probed import probe_transfer, probed_covariance
from bayes_rs.turbulence.isotropic import isotropic_correlation
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence
from bayes_rs.turbulence.two_point import radial_covariance

SEED = load_turbulence("fu-2022")
OPTICS = ContinuousWaveProbe(wavelength=1.565e-6, aperture_radius=0.028)
PROBES = [
    ContinuousWaveProbe(rayleigh_length=6.1),
    PulsedProbe(30.0),
    PulsedProbe(20.0, pulse_length=50.0),
    PulsedProbe(30.0, "gaussian", 40.0),
]
RULE_OF_A_VARIANCE = 2e-4  # error of the rules over D, relative; the velocity covariances themselves are good to 1e-4
TABLE = 1e-4  # error of velocity covariances, relative to uu


def beams(directions, distance=98.0, probe=None, scan_duration=1.0):
    directions = np.atleast_2d(np.asarray(directions, dtype=float))
    n = len(directions)
    return Scan(
        "beams",
        directions / np.linalg.norm(directions, axis=1, keepdims=True),
        focus_distance=np.broadcast_to(np.asarray(distance, dtype=float), n),
        beam_time=np.zeros(n),
        scan_duration=scan_duration,
        probe=PointProbe() if probe is None else probe,
    )


@pytest.fixture(scope="module")
def seed_spectra():
    """log k₁ and the one-point spectra of the seed's flow."""
    log_k = np.arange(-18.0, 6.0, 0.1)
    return log_k, SEED.spectra(np.exp(log_k))


def variance_left(direction, probe, turbulence=SEED, focus=98.0):
    """The part of a beam's variance that the probe leaves."""
    n = np.atleast_2d(np.asarray(direction, dtype=float))
    n = n / np.linalg.norm(n)
    length = probe.length(np.array([focus]))
    both, here = np.stack([length, length], axis=-1), np.zeros((1, 2))
    left = probed_covariance(n, n, here, here[:, :1], turbulence, probe=probe, lengths=both)
    return float(left[0, 0] / (design_matrix(n) @ turbulence.stresses())[0])


class TestTransfer:
    @pytest.mark.parametrize("probe", PROBES, ids=lambda p: str(p.parameters()))
    def test_it_is_the_fourier_transform_of_the_weighting(self, probe):
        s = np.linspace(-4e4, 4e4, 1_600_001)  # the Lorentzian's tails beyond hold 1e-4 of it
        weight = probe.weighting(s, 98.0) * (s[1] - s[0])
        for k in (0.0, 0.01, 0.05, 0.1, 0.3):
            assert np.sum(weight * np.cos(k * s)) == pytest.approx(float(probe.transfer(k, 98.0)), abs=2e-4)
            assert float(probe.transfer(-k, 98.0)) == float(probe.transfer(k, 98.0))

    def test_rayleigh_length_follows_from_the_optics(self):
        np.testing.assert_allclose(OPTICS.length([52.0, 98.0]), [1.718, 6.103], rtol=1e-3)
        np.testing.assert_allclose(OPTICS.length(98.0), 1.565e-6 * 98.0**2 / (np.pi * 0.028**2), rtol=1e-14)

    def test_full_width_at_half_maximum(self):
        cw = ContinuousWaveProbe(rayleigh_length=6.0)
        assert cw.weighting(6.0, 98.0) == pytest.approx(0.5 * cw.weighting(0.0, 98.0))
        assert PulsedProbe(30.0).weighting(15.0, 98.0) == pytest.approx(0.5 / 30.0)
        narrow_gate = PulsedProbe(1e-3, "gaussian", 30.0)  # the pulse alone
        assert narrow_gate.weighting(15.0, 98.0) == pytest.approx(0.5 * narrow_gate.weighting(0.0, 98.0), rel=1e-6)

    def test_a_triangle_has_the_squared_sinc(self):
        k = np.array([0.02, 0.1, 0.4])
        np.testing.assert_allclose(PulsedProbe(30.0).transfer(k, 98.0), np.sinc(k * 15.0 / np.pi) ** 2, rtol=1e-12)

    def test_a_point_sees_all(self):
        assert np.all(PointProbe().transfer([0.0, 1.0, 1e3], 98.0) == 1.0)
        assert np.all(PointProbe().length([1.0, 2.0]) == 0.0)


class TestRules:
    @pytest.mark.parametrize("probe", [*PROBES, PointProbe()], ids=lambda p: str(p.parameters()))
    def test_weights_are_positive_and_sum_to_one_and_nodes_are_symmetric(self, probe):
        position, weight = probe.nodes([98.0, 98.0])
        assert position.shape == (2, len(weight))
        np.testing.assert_allclose(position[0], -position[0, ::-1], atol=1e-9 * (1.0 + np.abs(position).max()))
        rules = (probe.difference_rule(), probe.pair_rule(), probe.pair_rule(wide=True))
        for one in (weight, *(rule.weight for rule in rules)):
            assert np.all(one > 0.0)
            assert np.sum(one) == pytest.approx(1.0, abs=1e-12)
        for rule in rules:
            spread = 1.0 + np.abs(rule.difference).max()
            assert np.sum(rule.weight * rule.difference) == pytest.approx(0.0, abs=1e-12 * spread)
            assert np.sum(rule.weight * rule.mean) == pytest.approx(0.0, abs=1e-9 * spread)

    @pytest.mark.parametrize("probe", PROBES[1:], ids=lambda p: str(p.parameters()))
    @pytest.mark.parametrize("k", [0.01, 0.03, 0.06])
    def test_rules_of_pulses_have_the_transfers(self, probe, k):
        (position,), weight = probe.nodes([98.0])
        one = float(probe.transfer(k, 98.0))
        assert np.sum(weight * np.cos(k * position)) == pytest.approx(one, abs=1e-6)
        rule = probe.difference_rule()
        scaled = k * float(probe.length(98.0))
        assert np.sum(rule.weight * np.cos(scaled * rule.difference)) == pytest.approx(one**2, abs=1e-6)
        rule = probe.pair_rule()  # exp(iκ_bρ − iκ_aσ) = exp(iD(κ_a + κ_b)/2 + iM(κ_b − κ_a))
        expected = float(probe.transfer(1.2 * k, 98.0) * probe.transfer(0.8 * k, 98.0))
        both = np.sum(rule.weight * np.cos(scaled * (rule.difference + 0.4 * rule.mean)))
        assert both == pytest.approx(expected, abs=1e-5)

    def test_two_means_at_each_difference_are_exact_on_one_side_of_the_wedge(self):
        """∫ exp(ipT) cos(q √(1 + T²)) / (π(1 + T²)) dT = exp(−|p|) for |p| > |q|: a dense sum."""
        t = np.tan(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 4_000_001)[1:-1])
        for p, q in ((1.0, 0.5), (0.3, 0.29), (2.0, 0.0)):
            total = np.mean(np.cos(p * t) * np.cos(q * np.sqrt(1.0 + t * t)))
            assert total == pytest.approx(np.exp(-p), abs=2e-3)  # the oscillating tails

    def test_means_have_the_variance_at_each_difference(self):
        narrow, wide = _cauchy_pair_rule(False, 1), _cauchy_pair_rule(True, 2)
        np.testing.assert_allclose(narrow.mean**2, 1.0 + 0.25 * narrow.difference**2, rtol=1e-12)
        middle = np.abs(wide.difference) < 2.0
        d, place = np.unique(wide.difference[middle], return_inverse=True)
        weight = np.bincount(place, wide.weight[middle])
        second = np.bincount(place, wide.weight[middle] * wide.mean[middle] ** 2) / weight
        np.testing.assert_allclose(second, 1.0 + 0.25 * d**2, rtol=5e-3)


class TestVariance:
    @pytest.mark.parametrize(("rayleigh_length", "left"), [(1.7, 0.91), (6.1, 0.83)])
    def test_axial_variance_that_published_rayleigh_lengths_leave(self, rayleigh_length, left):
        part = variance_left([-1, 0, 0], ContinuousWaveProbe(rayleigh_length=rayleigh_length))
        assert part == pytest.approx(left, abs=0.005)

    @pytest.mark.parametrize("probe", [*PROBES, ContinuousWaveProbe(rayleigh_length=61.0)], ids=str)
    @pytest.mark.parametrize("component", [0, 1, 2])
    def test_along_the_wind_it_is_the_integral_of_the_filtered_one_point_spectrum(self, probe, component, seed_spectra):
        log_k, spectra = seed_spectra
        k1 = np.exp(log_k)
        step = log_k[1] - log_k[0]
        kept = 2.0 * step * np.sum(k1 * spectra[:, component] * probe.transfer(k1, 98.0) ** 2)
        _, filtered = probe_transfer(np.array([[-1.0, 0.0, 0.0]]), probe.length(np.array([98.0])), probe, SEED)
        np.testing.assert_allclose(filtered[0, component], kept, atol=3.0 * TABLE * SEED.stresses()[0])

    @pytest.mark.parametrize("direction", [[-1, 0, 0], [0, 1, 0], [-0.5, 0.5, 0.7]])
    def test_isotropic_turbulence_has_the_closed_form_in_all_directions(self, direction):
        """Longitudinal covariance f, weighted by the Lorentzian of twice the length."""
        isotropic = MannTurbulence(dissipation=1.0, length_scale=1.0, gamma=0.0)
        angle = (np.arange(40_000) + 0.5) / 40_000 * 0.5 * np.pi
        for z_r in (0.03, 0.3, 3.0):
            expected = np.mean(isotropic_correlation(2.0 * z_r * np.tan(angle))[0]) / isotropic.stresses()[0]
            left = variance_left(direction, ContinuousWaveProbe(rayleigh_length=z_r), isotropic)
            assert left == pytest.approx(expected, rel=RULE_OF_A_VARIANCE)

    @pytest.mark.parametrize("direction", [[-1, 0, 0], [-0.9, 0.3, 0.3], [0, 0, 1]])
    def test_it_falls_from_one_to_zero_smoothly(self, direction):
        lengths = 61.0 * np.logspace(-7, 1, 17)
        left = np.array([variance_left(direction, ContinuousWaveProbe(rayleigh_length=z)) for z in lengths])
        assert left[0] == pytest.approx(1.0, abs=2.0 * TABLE)
        assert 0.0 < left[-1] < 0.2  # 0.16 along the wind, as its spectrum says
        assert np.all(np.diff(left) < TABLE)
        assert np.abs(np.diff(left)).max() < 0.3

    def test_transfers_are_between_zero_and_one_and_least_along_the_beam(self):
        n = cone_direction(np.deg2rad([0.0, 15.0, 90.0]), np.deg2rad([0.0, 40.0, 90.0]))
        for z in (1e-3, 6.1, 610.0):
            probe = ContinuousWaveProbe(rayleigh_length=z)
            transfer, _ = probe_transfer(n, np.full(3, z), probe, SEED)
            assert np.all((transfer >= 0.0) & (transfer <= 1.0))

    def test_node_sums_have_the_variance(self):
        """Σ_q w_q v(p + s_q n), which a simulator uses: its variance, with 16 or 8 nodes."""
        n = np.array([[-0.9659, 0.2588, 0.0]])
        n /= np.linalg.norm(n)
        for probe, error in ((PROBES[0], 5e-3), (PROBES[1], 0.01), (PROBES[3], 0.03)):
            position, weight = probe.nodes([98.0])
            apart = position[0][:, None] - position[0][None, :]
            count = apart.size
            covariance = radial_covariance(
                np.repeat(n, count, axis=0),
                np.repeat(n, count, axis=0),
                apart.reshape(-1, 1) * n[:, 1:],
                apart.reshape(-1, 1) * n[:, :1],
                SEED,
            )
            total = np.sum(np.outer(weight, weight).ravel() * covariance[:, 0])
            expected = variance_left(n, probe) * (design_matrix(n) @ SEED.stresses())[0]
            assert total == pytest.approx(expected, rel=error)


def dense_covariance(n_a, n_b, apart, along, lengths, probe, n_node=48):
    """The long way: a product of two dense rules."""
    if isinstance(probe, ContinuousWaveProbe):
        position, weight = _cauchy_rule(n_node)
    else:
        node, gauss = np.polynomial.legendre.leggauss(n_node)
        position = node * (0.5 + 4.0 * probe.ratio)
        weight = gauss * probe.weighting(position * probe.gate_length, 98.0)
        weight /= weight.sum()
    out = np.zeros(len(along))
    for s, w in zip(position, weight, strict=True):
        shift = lengths[1] * position[:, None] * n_b - lengths[0] * s * n_a
        covariance = radial_covariance(
            np.tile(n_a, (len(shift), 1)),
            np.tile(n_b, (len(shift), 1)),
            apart[1:] + shift[:, 1:],
            apart[0] + shift[:, :1] + along,
            SEED,
        )
        out += w * (weight @ covariance)
    return out


class TestPairs:
    @pytest.mark.parametrize(
        ("opening", "turn", "focus", "probe"),
        [
            (15.0, 5.0, 98.0, OPTICS),
            (15.0, 72.0, 98.0, OPTICS),
            (15.0, 180.0, 98.0, OPTICS),
            (30.0, 180.0, 52.0, OPTICS),
            (30.0, 1.0, 52.0, OPTICS),
            (45.0, 72.0, 52.0, OPTICS),
            (15.0, 180.0, 50.0, ContinuousWaveProbe(rayleigh_length=20.0)),
            (15.0, 60.0, 300.0, ContinuousWaveProbe(rayleigh_length=61.0)),
            (15.0, 180.0, 98.0, PulsedProbe(30.0, "gaussian", 30.0)),
            (15.0, 5.0, 98.0, PulsedProbe(30.0)),
            (45.0, 72.0, 98.0, PulsedProbe(60.0, "gaussian", 60.0)),
        ],
    )
    def test_norms_of_covariances_are_those_of_dense_sums(self, opening, turn, focus, probe):
        n_a, n_b = cone_direction(np.deg2rad([opening, opening]), np.deg2rad([0.0, turn]))
        apart, along = focus * (n_b - n_a), np.arange(-600.0, 601.0, 5.0)
        lengths = probe.length(np.array([focus, focus]))
        pair = probed_covariance(
            n_a[None], n_b[None], apart[None, 1:], apart[0] + along[None], SEED, probe=probe, lengths=lengths[None]
        )[0]
        dense = dense_covariance(n_a, n_b, apart, along, lengths, probe)
        own = probed_covariance(
            n_a[None], n_a[None], np.zeros((1, 2)), along[None], SEED, probe=probe, lengths=lengths[None]
        )[0]
        assert abs(np.sum(pair**2) - np.sum(dense**2)) < PROBE_ERROR * np.sum(own**2)

    def test_interpolated_lags_are_the_ones_calculated_directly(self):
        n_a, n_b = cone_direction(np.deg2rad([15.0, 15.0]), np.deg2rad([0.0, 72.0]))
        apart = (98.0 * (n_b - n_a))[None]
        along = apart[:, :1] + np.arange(-6000.0, 6001.0, 10.0)[None]
        for first, separation in ((n_b, np.zeros((1, 3))), (n_a, apart)):
            lags = along - apart[:, :1] + separation[:, :1]
            for probe in (OPTICS, PROBES[1]):
                lengths = probe.length(np.array([[98.0, 98.0]]))
                many, few = (
                    probed_covariance(
                        first[None], n_b[None], separation[:, 1:], some, SEED, probe=probe, lengths=lengths
                    )
                    for some in (lags, lags[:, 590:611])
                )
                np.testing.assert_allclose(many[:, 590:611], few, atol=2e-4 * SEED.stresses()[0])

    def test_rayleigh_lengths_of_two_planes_add_up_along_one_line(self):
        n = np.array([[-1.0, 0.0, 0.0]])
        lags = np.arange(-100.0, 101.0, 10.0)[None]
        both, one = (
            probed_covariance(n, n, np.zeros((1, 2)), lags, SEED, probe=OPTICS, lengths=np.array([lengths]))
            for lengths in ([1.0, 5.0], [3.0, 3.0])
        )
        np.testing.assert_allclose(both, one, atol=TABLE)  # farthest nodes are left out by the shorter length

    def test_a_beam_and_a_point_see_each_other_through_one_weighting(self):
        n = np.array([[-1.0, 0.0, 0.0]])
        lag = np.zeros((1, 1))
        beam_and_point, half = (
            probed_covariance(n, n, np.zeros((1, 2)), lag, SEED, probe=OPTICS, lengths=np.array([lengths]))[0, 0]
            for lengths in ([6.0, 0.0], [3.0, 3.0])
        )
        assert beam_and_point == pytest.approx(half, rel=5e-3)  # 16 nodes that are not graded towards the cusp


class TestNoise:
    def test_to_points_as_the_length_goes_to_zero(self):
        scan = load_scan("6-beam")
        points = theory_noise(scan, SEED, wind_speed=10.0)
        for z, tolerance in ((1e-2, 0.03), (1e-4, 2e-3)):
            tiny = replace(scan, probe=ContinuousWaveProbe(rayleigh_length=z))
            noise = theory_noise(tiny, SEED, wind_speed=10.0, probe_tolerance=0.0)
            assert noise.details["probe_as_points"] is False
            np.testing.assert_allclose(noise.covariance[0], points.covariance[0], rtol=tolerance)
            np.testing.assert_allclose(noise.gain[0], points.gain[0], atol=tolerance)
            np.testing.assert_allclose(noise.bias[0], points.bias[0], atol=tolerance)

    def test_a_probe_that_takes_nothing_is_left_out_within_its_bound(self):
        scan = replace(load_scan("6-beam"), probe=ContinuousWaveProbe(rayleigh_length=1e-3))
        skipped, whole = (theory_noise(scan, SEED, wind_speed=10.0, probe_tolerance=t) for t in (2e-3, 0.0))
        assert skipped.details["probe_as_points"] is True
        assert 0.0 < skipped.details["probe_loss"] < 2e-3
        points = theory_noise(load_scan("6-beam"), SEED, wind_speed=10.0)
        np.testing.assert_array_equal(skipped.covariance[0], points.covariance[0])
        np.testing.assert_array_equal(skipped.gain[0], points.gain[0])
        error = np.abs(skipped.covariance[0] - whole.covariance[0]).max()
        assert error < skipped.details["probe_error"] * skipped.covariance[0].max()
        expected, lost = points.gain[0] @ SEED.stresses(), skipped.details["probe_loss"]
        slack = expected.max() / np.min((1.0 + points.bias[0]) * expected)  # of Cauchy and Schwarz' inequality
        bound = 2.0 * lost + lost * slack * np.sqrt(8.0 / points.covariance[0].max())
        assert skipped.details["probe_error"] == pytest.approx(bound, rel=1e-6)  # eigenvalues of K set to zero
        assert skipped.scan_geometry["probe"] == scan.probe.parameters()

    def test_the_loss_is_that_of_the_beam_that_loses_most(self):
        """Rayleigh lengths grow with the square of the distance; one far beam is enough for a probe that counts."""
        directions, distance = load_scan("6-beam").beam_direction[:2], np.array([10.0, 120.0])

        def noise(index, tolerance=0.0):
            n = len(index)
            scan = Scan("far", directions[index], distance[index], np.zeros(n), 1.0, probe=OPTICS)
            return theory_noise(scan, SEED, wind_speed=10.0, duration=60.0, probe_tolerance=tolerance)

        near, far, both = (noise(np.array(index)).details["probe_loss"] for index in ([0], [1], [0, 1]))
        assert near < 0.1 * far
        assert both == pytest.approx(far, rel=1e-2)  # rules are made for the longest probe of a scan
        assert noise(np.array([0, 1]), 0.5 * far).details["probe_as_points"] is False
        assert noise(np.array([0, 1]), 2.0 * far).details["probe_as_points"] is True

    @pytest.mark.parametrize("probe", [OPTICS, PulsedProbe(30.0, "gaussian", 30.0)], ids=lambda p: p.kind)
    def test_gain_gives_the_expected_variances_of_the_model(self, probe):
        scan = replace(load_scan("6-beam"), probe=probe)
        noise = theory_noise(scan, SEED, wind_speed=10.0, duration=600.5)  # beams with one sample more
        record = sonic_moments(load_scan("6-beam"), SEED, wind_speed=10.0, duration=600.5).mean
        whole = theory_noise(scan, SEED, wind_speed=10.0)
        expected = (1.0 + noise.bias[0]) * (noise.gain[0] @ SEED.stresses())
        longer = sonic_moments(load_scan("6-beam"), SEED, wind_speed=10.0, duration=600.0).mean
        from_record = noise.gain[0] @ record
        np.testing.assert_allclose(from_record[:3], expected[:3], rtol=1e-6)
        np.testing.assert_allclose(
            whole.gain[0] @ longer, (1.0 + whole.bias[0]) * (whole.gain[0] @ SEED.stresses()), rtol=1e-6
        )
        assert np.all(np.abs(noise.gain[0]) <= np.abs(design_matrix(scan)) + 1e-12)

    def test_expected_variance_is_the_filtered_spectrum_less_the_mean(self, seed_spectra):
        scan = beams([[-1, 0, 0]], probe=OPTICS)
        noise = theory_noise(scan, SEED, wind_speed=10.0, duration=600.0)
        coarse, spectra = seed_spectra
        log_k = np.arange(-18.0, 5.9, 0.002)
        k1 = np.exp(log_k)
        spectrum = np.exp(np.interp(log_k, coarse, np.log(spectra[:, 0])))
        kept = spectrum * OPTICS.transfer(k1, 98.0) ** 2
        phase = 0.5 * k1 * 10.0
        lost = np.where(k1 < 0.1, np.sin(600 * phase) / (600.0 * np.sin(phase)), 0.0) ** 2  # beyond: 1e-5
        expected = 2.0 * 0.002 * np.sum(k1 * kept * (1.0 - lost))
        got = (1.0 + noise.bias[0, 0]) * (noise.gain[0, 0] @ SEED.stresses())
        assert got == pytest.approx(expected, rel=2e-3)

    def test_a_larger_probe_takes_more_and_scatters_more(self):
        scan = load_scan("6-beam")
        noises = [
            theory_noise(replace(scan, probe=ContinuousWaveProbe(rayleigh_length=z)), SEED, wind_speed=10.0)
            for z in (0.5, 2.0, 6.0, 20.0, 61.0)
        ]
        expected = np.array([(1.0 + m.bias[0]) * (m.gain[0] @ SEED.stresses()) for m in noises])
        assert np.all(np.diff(expected, axis=0) < 0.0)
        assert np.all(np.diff([m.relative_error[0] for m in noises], axis=0) > 0.0)

    def test_opposite_directions_are_the_same_beam(self):
        probe = ContinuousWaveProbe(rayleigh_length=6.1)
        one = beams([[-1, 0.2, 0.1], [-1, -0.2, 0.3]], distance=1e-9, probe=probe)
        other = beams([[1, -0.2, -0.1], [-1, -0.2, 0.3]], distance=1e-9, probe=probe)
        same, turned = (theory_noise(scan, SEED, wind_speed=10.0) for scan in (one, other))
        np.testing.assert_allclose(turned.covariance[0], same.covariance[0], rtol=1e-6)
        np.testing.assert_allclose(turned.gain[0], same.gain[0], rtol=1e-9, atol=1e-12)

    @pytest.mark.parametrize(("z_r", "gamma"), [(0.01, 3.2), (1.0, 0.0), (1.0, 6.0), (61.0, 3.2), (610.0, 3.2)])
    def test_finite_and_positive_semi_definite(self, z_r, gamma):
        turbulence = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=gamma)
        directions = [[-1, 0, 0], [-1, 1, 0], [-1, 0, 0], [-1, 1e-4, 0]]
        scan = beams(directions, probe=ContinuousWaveProbe(rayleigh_length=z_r))
        noise = theory_noise(scan, turbulence, wind_speed=10.0)  # checks the eigenvalues itself
        assert np.all(np.isfinite(noise.covariance[0]))
        assert np.all((noise.bias[0] < 0.0) & (noise.bias[0] > -1.0))
        assert noise.details["negative_part"] < PROBE_ERROR

    @pytest.mark.parametrize("name", ["zx-tm", "pulsed-4-beam"])
    def test_presets(self, name):
        scan = load_scan(name)
        noise = theory_noise(scan, SEED, wind_speed=10.0)
        assert noise.details["negative_part"] < PROBE_ERROR
        assert 0.03 < noise.details["probe_loss"] < 0.2
        noise.check_scan(scan)

    @pytest.mark.slow
    @pytest.mark.long
    def test_spinnerlidar_with_its_probe(self):
        noise = theory_noise(load_scan("spinnerlidar"), SEED, wind_speed=10.0)
        points = theory_noise(load_scan("spinnerlidar@probe=point"), SEED, wind_speed=10.0)
        assert noise.details["negative_part"] < PROBE_ERROR
        assert np.all(noise.relative_error[0] > points.relative_error[0])

    def test_only_ratios_of_lengths_count(self):
        scan = replace(load_scan("4-beam"), probe=ContinuousWaveProbe(rayleigh_length=3.0))
        one = theory_noise(scan, SEED, wind_speed=10.0)
        twice = MannTurbulence(dissipation=1.0, length_scale=122.0, gamma=3.2)
        doubled = replace(load_scan("4-beam", focus_distance=196.0), probe=ContinuousWaveProbe(rayleigh_length=6.0))
        other = theory_noise(doubled, twice, wind_speed=20.0)
        np.testing.assert_allclose(one.covariance[0], other.covariance[0], rtol=1e-9)
        np.testing.assert_allclose(one.gain[0], other.gain[0], rtol=1e-9, atol=1e-12)

    def test_sonic_and_probed_beams_are_jointly_positive_semi_definite(self):
        scan = replace(load_scan("6-beam"), probe=OPTICS)
        moments = sonic_moments(scan, SEED, wind_speed=10.0)
        noise = theory_noise(scan, SEED, wind_speed=10.0)
        expected = (1.0 + noise.bias[0]) * (noise.gain[0] @ SEED.stresses())
        beams_alone = noise.covariance[0] * np.outer(expected, expected)
        joint = np.block([[beams_alone, moments.cross_covariance], [moments.cross_covariance.T, moments.covariance]])
        assert np.linalg.eigvalsh(joint)[0] > -PROBE_ERROR * joint.max()
        points = sonic_moments(load_scan("6-beam"), SEED, wind_speed=10.0)
        np.testing.assert_array_equal(moments.covariance, points.covariance)
        assert np.all(moments.cross_covariance[:, 0] < points.cross_covariance[:, 0])


class TestFilesAndNames:
    def test_points_leave_keys_as_they_were(self):
        assert "probe" not in load_scan("6-beam").geometry()
        assert load_scan("zx-tm", probe="point").key == load_scan("zx-tm@probe=point").key
        assert load_scan("zx-tm").key != load_scan("zx-tm@probe=point").key

    def test_noise_keeps_its_probe_in_a_file(self, tmp_path):
        scan = load_scan("pulsed-4-beam")
        noise = theory_noise(scan, SEED, wind_speed=10.0)
        noise.save(tmp_path / "noise.nc")
        again = load_noise(tmp_path / "noise.nc")
        assert again.scan_geometry == noise.scan_geometry
        again.check_scan(scan)
        again.select([1, 2]).check_scan(scan.select([1, 2]))

    def test_noise_with_and_without_a_probe_do_not_mix(self):
        with_probe, without = load_scan("pulsed-4-beam"), load_scan("pulsed-4-beam@probe=point")
        noise = theory_noise(with_probe, SEED, wind_speed=10.0)
        message = (
            "the probe is pulsed, top-hat, gate_length 30 m, pulse_length 30 m in the noise and a point in the scan"
        )
        with pytest.raises(NoiseMismatchError, match=message):
            noise.check_scan(without)
        with pytest.raises(NoiseMismatchError, match="the probe is a point in the noise and pulsed, top-hat, gate"):
            theory_noise(without, SEED, wind_speed=10.0).check_scan(with_probe)

    @given(st.floats(0.1, 100.0), st.floats(0.1, 100.0))
    def test_probes_differ_by_their_numbers(self, one, other):
        first, second = (ContinuousWaveProbe(rayleigh_length=z).parameters() for z in (one, other))
        assert (probe_difference(first, second) == "") == bool(np.isclose(one, other, rtol=1e-9, atol=0.0))

    @pytest.mark.parametrize(
        ("kind", "parameters", "message"),
        [
            ("laser", {}, "Unknown kind of probe 'laser': it must be one of point, continuous-wave, pulsed"),
            ("continuous-wave", {}, "give either rayleigh_length, or wavelength and aperture_radius"),
            ("continuous-wave", {"wavelength": 1e-6}, "aperture_radius is missing"),
            ("continuous-wave", {"aperture_radius": 0.028}, "wavelength is missing"),
            ("continuous-wave", {"rayleigh_length": 1.0, "wavelength": 1e-6}, "give either rayleigh_length, or"),
            ("continuous-wave", {"rayleigh_length": -1.0}, "Invalid rayleigh_length -1.0 m in a continuous-wave probe"),
            ("continuous-wave", {"gate_length": 1.0}, "Unknown parameter 'gate_length' of a continuous-wave probe"),
            ("point", {"gate_length": 1.0}, "Unknown parameter 'gate_length' of a point probe: it has no parameters"),
            ("pulsed", {}, "gate_length is missing"),
            ("pulsed", {"gate_length": 30.0, "pulse": "gaussian"}, "pulse_length is missing"),
            ("pulsed", {"gate_length": 30.0, "pulse": "square"}, "Unknown pulse of a pulsed probe 'square'"),
            ("pulsed", {"gate_length": 0.0}, "Invalid gate_length 0.0 m in a pulsed probe"),
            ("pulsed", {"gate_length": 30.0, "pulse_length": np.nan}, "Invalid pulse_length nan m in a pulsed probe"),
        ],
    )
    def test_what_is_wrong_is_said(self, kind, parameters, message):
        with pytest.raises(InputError, match=message):
            make_probe(kind, **parameters)

    def test_a_point_has_no_weighting(self):
        with pytest.raises(InputError, match="A point has no weighting function"):
            PointProbe().weighting(0.0, 98.0)

    def test_tolerance_of_the_probe_is_checked(self):
        with pytest.raises(InputError, match="Invalid probe_tolerance -1"):
            theory_noise(load_scan("staring"), SEED, wind_speed=10.0, probe_tolerance=-1.0)


@pytest.mark.parametrize("n", [2, 5, 9])
def test_gaussian_quadrature_is_exact_for_polynomials(n):
    """Up to the degree 2n − 1, for a measure that is not symmetric: here ∫x^p 2x dx = 2/(p + 2) over (0, 1)."""
    points = (np.arange(4000) + 0.5) / 4000
    node, weight = _gauss_rule(points, points, n)
    for power in range(2 * n):
        assert np.sum(weight * node**power) == pytest.approx(np.sum(points * points**power) / np.sum(points), rel=1e-9)
        assert np.sum(weight * node**power) == pytest.approx(2.0 / (power + 2), rel=1e-4)  # sums by midpoints


def test_a_measure_of_few_points_is_its_own_quadrature():
    points = np.linspace(-1.0, 1.0, 9)
    weights = np.where(np.abs(points) < 0.3, 2.0, 0.0)
    nodes, shares = _gauss_rule(points, weights, 8)
    np.testing.assert_array_equal(nodes, points[np.abs(points) < 0.3])
    np.testing.assert_allclose(shares, 1.0 / 3.0)
