"""The noise of records with missing samples: dense matrices, direct draws, and how much gaps matter."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_rs.errors import InputError
from bayes_rs.geometry.probe import ContinuousWaveProbe
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.gaps import gap_noise
from bayes_rs.turbulence.mann import load_turbulence
from bayes_rs.turbulence.toeplitz import gapped_inner, gapped_trace, toeplitz_inner, toeplitz_trace
from bayes_rs.turbulence.two_point import radial_covariance

FLOW = load_turbulence("fu-2022")


def projection(time, detrend):
    """Return what takes the mean, or the line, out of samples at `time`."""
    columns = np.stack([np.ones(len(time)), time], axis=-1)[:, : 1 if detrend == "mean" else 2]
    basis = np.linalg.qr(columns)[0]
    return np.eye(len(time)) - basis @ basis.T


def joint_covariance(scan, times, wind_speed):
    """Return the dense covariance of all samples of all beams, beams one after the other."""
    n, blocks = scan.line_of_sight, []
    place = n * scan.focus_distance[:, None]
    for a in range(scan.n_beam):
        row = []
        for b in range(scan.n_beam):
            apart = place[b] - place[a]
            along = apart[0] - wind_speed * (times[b][None, :] - times[a][:, None])
            flat = radial_covariance(n[[a]], n[[b]], apart[None, 1:], along.reshape(1, -1), FLOW)
            row.append(flat.reshape(along.shape))
        blocks.append(row)
    return np.block(blocks)


@pytest.fixture
def scene():
    """Three of the six beams, 40 s, with gaps of every kind."""
    scan = load_scan("6-beam", yaw_deg=7.0).select([0, 2, 5])
    rng = np.random.default_rng(5)
    present = rng.random((3, 41)) < 0.7
    present[1, 10:30] = False
    present[:, -1] = True  # after the record's end for beams 2 and 5
    return scan, present, {"wind_speed": 8.0, "duration": 40.3}


def dense(scan, present, wind_speed, detrend):
    """Return K and E s² from dense matrices; the last sample of beams 2 and 5 would be after the record's end."""
    grid = np.arange(present.shape[1]) * scan.scan_duration
    times = [(t + grid)[keep & (t + grid < 40.3)] for t, keep in zip(scan.beam_time, present, strict=True)]
    joint = joint_covariance(scan, times, wind_speed)
    edges = np.cumsum([0] + [len(t) for t in times])
    take = [projection(t, detrend) for t in times]
    n_beam = len(times)
    covariance, mean = np.empty((n_beam, n_beam)), np.empty(n_beam)
    for a in range(n_beam):
        for b in range(n_beam):
            block = take[a] @ joint[edges[a] : edges[a + 1], edges[b] : edges[b + 1]] @ take[b]
            covariance[a, b] = 2.0 * np.sum(block**2) / (len(times[a]) * len(times[b]))
            if a == b:
                mean[a] = np.trace(block) / len(times[a])
    return covariance / np.outer(mean, mean), mean, joint, times


class TestAgainstDense:
    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    def test_three_beams_with_gaps(self, scene, detrend):
        scan, present, options = scene
        noise = gap_noise(scan, FLOW, present, detrend=detrend, **options)
        covariance, mean, _, times = dense(scan, present, options["wind_speed"], detrend)
        np.testing.assert_allclose(noise.covariance[0], covariance, rtol=1e-9)
        np.testing.assert_allclose((1.0 + noise.bias[0]) * (noise.gain[0] @ FLOW.stresses()), mean, rtol=1e-9)
        counts = [len(t) for t in times]
        assert noise.details["samples"] == [min(counts), max(counts)]

    def test_direct_draws(self, scene):
        """Gaussian records, thinned and their own mean removed: no formula of Isserlis."""
        scan, present, options = scene
        noise = gap_noise(scan, FLOW, present, **options)
        _, mean, joint, times = dense(scan, present, options["wind_speed"], "mean")
        n_draw = 40_000
        values, vectors = np.linalg.eigh(joint)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        draws = np.random.default_rng(8).normal(size=(n_draw, len(joint))) @ root.T
        variances = np.stack(
            [part.var(axis=1) for part in np.split(draws, np.cumsum([len(t) for t in times])[:-1], axis=1)], axis=-1
        )
        relative = variances / mean - 1.0
        products = relative[:, :, None] * relative[:, None]
        error = products.std(axis=0) / np.sqrt(n_draw)
        assert np.all(np.abs(products.mean(axis=0) - noise.covariance[0]) < 4.5 * error)  # six different entries
        assert np.all(error < 0.08 * noise.covariance[0])

    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    def test_sums_without_gaps_are_those_of_whole_matrices(self, detrend):
        diagonals = np.random.default_rng(2).normal(size=(4, 16))
        rows, columns = np.ones((4, 7), dtype=bool), np.ones((4, 10), dtype=bool)
        np.testing.assert_allclose(
            gapped_inner(diagonals, rows, columns, detrend=detrend),
            toeplitz_inner(diagonals, diagonals, 7, 10, detrend=detrend),
            rtol=1e-11,
        )
        np.testing.assert_allclose(
            gapped_trace(diagonals[:, :13], rows, detrend=detrend),
            toeplitz_trace(diagonals[:, :13], 7, detrend=detrend),
            rtol=1e-11,
        )


class TestLaws:
    def test_no_gap_is_the_noise_of_the_whole_record(self):
        scan = load_scan("6-beam", yaw_deg=10.0)
        whole = theory_noise(scan, FLOW, wind_speed=9.0)
        noise = gap_noise(scan, FLOW, np.ones((6, 600), dtype=bool), wind_speed=9.0)
        np.testing.assert_allclose(noise.covariance[0], whole.covariance[0], rtol=1e-9)
        np.testing.assert_allclose(noise.gain[0], whole.gain[0], atol=1e-11)
        np.testing.assert_array_equal(noise.bias[0], whole.bias[0])

    def test_half_of_the_record_at_one_end_is_a_record_of_half_the_length(self):
        scan = replace(load_scan("6-beam"), beam_time=np.zeros(6))
        present = np.zeros((6, 600), dtype=bool)
        present[:, 300:] = True
        half = theory_noise(scan, FLOW, wind_speed=9.0, duration=300.0)
        noise = gap_noise(scan, FLOW, present, wind_speed=9.0)
        np.testing.assert_allclose(noise.covariance[0], half.covariance[0], rtol=1e-9)
        ratio = (1.0 + half.bias[0]) / (1.0 + theory_noise(scan, FLOW, wind_speed=9.0).bias[0])
        np.testing.assert_allclose(noise.gain[0], half.gain[0] * ratio[:, None], atol=1e-11)

    def test_probe_volumes_have_gaps_too(self):
        scan = replace(load_scan("2-beam"), probe=ContinuousWaveProbe(rayleigh_length=6.1))
        whole = theory_noise(scan, FLOW, wind_speed=9.0, duration=60.0)
        noise = gap_noise(scan, FLOW, np.ones((2, 60), dtype=bool), wind_speed=9.0, duration=60.0)
        np.testing.assert_allclose(noise.covariance[0], whole.covariance[0], rtol=1e-9)
        np.testing.assert_allclose(noise.gain[0], whole.gain[0], rtol=1e-9)
        as_point = gap_noise(load_scan("2-beam"), FLOW, np.ones((2, 60), dtype=bool), wind_speed=9.0, duration=60.0)
        assert np.abs(as_point.covariance[0] / noise.covariance[0] - 1.0).max() > 0.01


class TestHowMuchGapsMatter:
    """The seed's flow, 10 m/s, 600 samples a second apart: neighbours tell nearly the same."""

    def change(self, present):
        scan = load_scan("6-beam")
        whole = theory_noise(scan, FLOW, wind_speed=10.0)
        noise = gap_noise(scan, FLOW, present, wind_speed=10.0)
        return np.diag(noise.covariance[0]) / np.diag(whole.covariance[0]) - 1.0, noise.details["gap_gain"]

    def test_a_tenth_at_random_changes_about_half_a_percent(self):
        change, gain = self.change(np.random.default_rng(4).random((6, 600)) > 0.1)
        assert np.all(np.abs(change) < 0.02)  # of the variance of a variance; 0.5 to 1.0 % here
        assert np.max(np.abs(np.array(gain) - 1.0)) < 0.005

    def test_half_at_random_changes_a_few_percent(self):
        change, _ = self.change(np.random.default_rng(4).random((6, 600)) > 0.5)
        assert np.all((change > 0.0) & (change < 0.08))

    def test_half_in_one_block_adds_two_thirds(self):
        present = np.ones((6, 600), dtype=bool)
        present[:, 300:] = False
        change, gain = self.change(present)
        assert np.all((change > 0.5) & (change < 1.0))
        assert max(gain) < 0.95  # and the slow eddies go with the mean of the shorter record


class TestErrors:
    def test_shape(self):
        with pytest.raises(InputError, match=r"Invalid present of shape \(2, 599\) .* \(2, 600\), one for each"):
            gap_noise(load_scan("2-beam"), FLOW, np.ones((2, 599), dtype=bool), wind_speed=10.0)

    def test_type(self):
        with pytest.raises(InputError, match=r"and type float64 .*: it must be of bools"):
            gap_noise(load_scan("2-beam"), FLOW, np.ones((2, 600)), wind_speed=10.0)

    def test_too_few_samples(self):
        present = np.ones((2, 600), dtype=bool)
        present[1, 1:] = False
        with pytest.raises(InputError, match="beam 1 has 1 samples, and removing the mean leaves nothing"):
            gap_noise(load_scan("2-beam"), FLOW, present, wind_speed=10.0)

    def test_disagreeing_diagonals(self):
        with pytest.raises(InputError, match=r"Invalid diagonals of shape \(4,\)"):
            gapped_inner(np.ones(4), np.ones(3, dtype=bool), np.ones(3, dtype=bool))


@pytest.mark.parametrize("name", ["50-beam", "zx-tm"])
def test_many_beams_without_gaps_are_those_of_theory(name):
    """Their covariances are calculated at some lags only."""
    scan = load_scan(name)
    scan = scan.select(scan.beam[::4])
    exact = theory_noise(scan, FLOW, wind_speed=9.0, pair_tolerance=0.0)
    found = gap_noise(scan, FLOW, np.ones((scan.n_beam, 600), dtype=bool), wind_speed=9.0)
    np.testing.assert_allclose(found.covariance, exact.covariance, rtol=5e-5)
    np.testing.assert_allclose(found.bias, exact.bias, rtol=1e-6)
    np.testing.assert_allclose(found.gain, exact.gain, rtol=2e-5, atol=1e-9)


def test_many_beams_with_gaps_are_those_of_few():
    """Pairs of few beams, of which all lags are calculated, have the same covariances."""
    scan = load_scan("50-beam")
    there = np.random.default_rng(4).uniform(size=(scan.n_beam, 600)) < 0.7
    there[:, 100:180] = False
    many = scan.select(scan.beam[::4])
    few = scan.select(scan.beam[[0, 12, 28]])
    whole = gap_noise(many, FLOW, there[::4], wind_speed=9.0).select(few.beam)
    own = gap_noise(few, FLOW, there[[0, 12, 28]], wind_speed=9.0)
    np.testing.assert_allclose(whole.covariance, own.covariance, rtol=5e-5)
