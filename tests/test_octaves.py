"""Octaves of a record's variance: what they add up to, what is expected of them, and the length scale they tell."""

import json
from dataclasses import replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pytest
import xarray as xr
from scipy.linalg import toeplitz

import bayes_rs as brs
from bayes_rs.fits.uncertain_length import averaged_noise, averaged_reduced, length_range
from bayes_rs.geometry.probe import ContinuousWaveProbe, PointProbe
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.likelihoods.reduced_noise import ReducedNoise
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.quality.octaves import octave_count, octave_variances, record_octaves
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.spectra.octave_information import _octave_covariance, _Space, octave_information
from bayes_rs.spectra.octave_theory import Blocks, length_nodes, octave_theory
from bayes_rs.spectra.pooled_lengths import PRIOR_LOG_SD, PRIOR_MEDIAN, pool_lengths
from bayes_rs.spectra.record_lengths import REPORT, length_words, with_own_length_scale
from bayes_rs.theory.pairs import distinct_pairs
from bayes_rs.turbulence.two_point import radial_covariance

FLOW = brs.load_turbulence("fu-2022")
SIX = brs.load_scan("6-beam@opening_angle_deg=45,focus_distance=52")
STARING = brs.load_scan("staring")


def slow_octaves(velocity, place, n_octave):
    """The analysis of variance, block by block."""
    total = np.sum((velocity - velocity.mean()) ** 2)
    found, before = [], 0.0
    for level in range(1, n_octave):
        block = np.minimum(np.floor(place * 2**level), 2**level - 1)
        between = sum(
            np.sum(block == b) * (velocity[block == b].mean() - velocity.mean()) ** 2 for b in np.unique(block)
        )
        found.append(between - before)
        before = between
    return np.array([*found, total - before]) / len(velocity)


class TestDecomposition:
    @pytest.mark.parametrize(("n", "n_octave"), [(600, 10), (37, 6), (20, 3), (2, 1)])
    def test_octaves_are_an_analysis_of_variance_that_sums_to_the_variance(self, n, n_octave):
        rng = np.random.default_rng(n)
        velocity, group = 1e3 + rng.standard_normal(3 * n), np.repeat([0, 2, 3], n)
        place = rng.uniform(size=3 * n)
        energy = octave_variances(velocity, group, place, 5, n_octave)
        for number in (0, 2, 3):
            own = group == number
            assert energy[number].sum() == pytest.approx(velocity[own].var(), rel=1e-10)
            assert energy[number] == pytest.approx(slow_octaves(velocity[own], place[own], n_octave), abs=1e-9)
        assert np.isnan(energy[[1, 4]]).all()

    def test_groups_at_a_time_change_nothing(self, monkeypatch):
        rng = np.random.default_rng(3)
        group = np.sort(rng.integers(0, 40, 4000))
        time, velocity, keep = rng.integers(0, 10**12, 4000), rng.standard_normal(4000), rng.uniform(size=4000) < 0.8
        whole = record_octaves(velocity, group, time, keep, 41, 10**10, 5)
        direct = octave_variances(velocity[keep], group[keep], (time[keep] % 10**10) / 10**10, 41, 5)
        assert np.array_equal(whole, direct, equal_nan=True)
        monkeypatch.setattr("bayes_rs.quality.octaves._SUMS", 16 * 7)
        assert np.array_equal(record_octaves(velocity, group, time, keep, 41, 10**10, 5), whole, equal_nan=True)

    def test_records_hold_them(self):
        series = brs.simulate(SIX, FLOW, wind_speed=10.0, n_records=3, seed=1)
        records = brs.make_records(series, SIX)
        octaves = records["octave_variance"]
        assert (octaves.dims, octaves.dtype) == (("record", "beam", "octave"), np.float32)
        assert octaves.sizes["octave"] == octave_count(600.0)
        assert octaves.sum("octave").values == pytest.approx(records["variance"].values, rel=1e-5)


class TestExpectation:
    @pytest.mark.parametrize(("n", "interval", "begin"), [(600, 1.0, 0.3), (150, 4.0, 3.0), (21, 29.0, 0.0)])
    def test_it_is_that_of_the_quadratic_forms(self, n, interval, begin):
        blocks = Blocks.of(n, interval, begin, 600.0)
        covariance = np.exp(-interval * np.arange(n) / 40.0)
        place = (begin + interval * np.arange(n)) / 600.0
        direct = []
        for level in range(blocks.n_octave):
            block = np.floor(place * 2**level)
            average = (block[:, None] == block) / np.sum(block[:, None] == block, axis=0)
            direct.append(np.trace(average @ toeplitz(covariance)))
        direct = np.diff([*direct, n]) / n
        theory = octave_theory(STARING)
        within = blocks.weights() @ covariance[1:]
        assert theory.expected(within, blocks.filled(np.array(1.0))) == pytest.approx(direct, abs=1e-12)

    def test_white_noise_is_flat_and_missing_samples_are_counted(self):
        blocks = Blocks.of(600, 1.0, 0.0, 600.0)
        theory = octave_theory(STARING)
        for share in (1.0, 0.8):
            filled = blocks.filled(np.array(share))
            white = theory.expected(np.zeros(blocks.n_octave), filled)
            assert white == pytest.approx(np.diff(filled) / filled[-1], rel=1e-12)
        rng = np.random.default_rng(2)
        some = np.mean([self.filled_blocks(rng.uniform(size=600) < 0.8) for _ in range(400)], axis=0)
        assert some == pytest.approx(blocks.filled(np.array(0.8)), abs=1.5)  # six standard errors

    @staticmethod
    def filled_blocks(present):
        place = np.arange(600)[present] / 600.0
        return [*(len(np.unique(np.floor(place * 2**level))) for level in range(10)), present.sum()]

    def test_octaves_sum_to_the_variance_of_a_record_by_theory(self):
        theory = octave_theory(SIX)
        correlation = theory.correlation(np.array([12.0]), np.array([0.4]))
        expected = theory.expected(correlation, theory.blocks.filled(np.array(1.0)))
        index = int(np.argmin(np.abs(length_nodes() - np.log(61.0))))
        flow = replace(FLOW, length_scale=float(np.exp(length_nodes()[index])))
        bias = theory_noise(SIX, flow, wind_speed=12.0, yaw=0.4).bias[0]
        assert expected[0, :, index].sum(axis=-1) == pytest.approx(1.0 + bias, abs=2e-4)

    def test_the_table_of_a_probe_is_near_between_its_nodes(self):
        scan = brs.load_scan("pulsed-4-beam").select([0])
        theory = octave_theory(scan, yaw=(0.0, 0.3))
        speed, yaw, blocks = 7.1, 0.17, theory.blocks
        direct = scaled_autocovariance(
            scan.at_yaw(yaw)[0],
            speed * scan.scan_duration * np.arange(blocks.n_sample),
            np.exp(length_nodes()[[5, 14]]),
            gamma=3.2,
            probe=scan.probe,
            probe_length=float(scan.probe_length[0]),
        )
        within = (direct / direct[:, :1])[:, 1:] @ blocks.weights().T
        table = theory.correlation(np.array([speed]), np.array([yaw]))[0, 0, [5, 14]]
        full = blocks.filled(np.array(1.0))
        assert theory.expected(table, full) == pytest.approx(
            theory.expected(within, full), rel=0.02, abs=0.002
        )  # linear in yaw and ln U

    def test_a_short_probe_is_a_point(self):
        scan = brs.load_scan("pulsed-4-beam").select([0])
        short = replace(scan, probe=ContinuousWaveProbe(rayleigh_length=0.02))
        point = replace(scan, probe=PointProbe())
        at = np.array([8.0]), np.array([0.1])
        of_short, of_point = (octave_theory(one, yaw=(0.0, 0.2)).correlation(*at) for one in (short, point))
        assert of_short == pytest.approx(of_point, abs=0.01)  # linear between yaws 20° and winds a factor 1.5 apart

    def test_simulated_lines_agree(self):
        theory = octave_theory(SIX)
        series = brs.simulate(SIX, FLOW, wind_speed=10.0, n_records=150, seed=8)
        records = brs.make_records(series, SIX)
        node = int(np.argmin(np.abs(length_nodes() - np.log(61.0))))
        correlation = theory.correlation(np.array([10.0]), np.array([0.0]))
        expected = theory.expected(correlation, theory.blocks.filled(np.array(1.0)))[0, :, node]
        direction = SIX.at_yaw(0.0)
        level = np.einsum("bi,ij,bj->b", direction, unpack_stress(FLOW.stresses()), direction)
        energy = records["octave_variance"].values / level[:, None]
        score = (energy.mean(axis=0) - expected) / (energy.std(axis=0) / np.sqrt(150))
        # the node is 3 % from 61 m; of 60 scores of six beams that see the same air
        assert np.abs(score).max() < 4.5
        assert np.abs(score.mean(axis=0)).max() < 3.0


class TestInformation:
    def test_the_covariances_of_the_octaves_sum_to_that_of_the_variances(self):
        scan = SIX.select([0, 1, 3])
        n, interval, speed = 150, 4.0, 9.0
        slow = replace(scan, scan_duration=interval, beam_time=np.zeros(3))
        blocks = Blocks.of(n, interval, 0.0, 600.0)
        covariance = _octave_covariance(slow, blocks, interval, _Space(slow, 61.0, 3.2, 8000.0), speed)
        noise = theory_noise(slow, FLOW, wind_speed=speed)
        level = 1.0 + noise.bias[0]
        expected = noise.covariance[0] * level[:, None] * level
        assert covariance.sum(axis=(2, 3)) == pytest.approx(expected, rel=2e-3, abs=1e-5)

    def test_one_pair_is_that_of_dense_matrices(self):
        scan = replace(SIX.select([0, 2]), scan_duration=12.0)
        blocks = Blocks.of(50, 12.0, 0.0, 600.0)
        found = _octave_covariance(scan, blocks, 12.0, _Space(scan, 61.0, 3.2, 8000.0), 9.0)[0, 1]
        pairs = distinct_pairs(scan, scan.at_yaw(scan.yaw), np.full(2, 50), 9.0)
        which = int(np.flatnonzero((pairs.row == 0) & (pairs.column == 1))[0])
        one = pairs.distinct[which]
        lag = 9.0 * 12.0 * (np.arange(50) - np.arange(50)[:, None])
        rows = [pairs.first[one], pairs.second[one]]
        flow = replace(FLOW, length_scale=61.0)
        cross = np.stack(
            [
                radial_covariance(rows[:1], rows[1:], pairs.across[one][None], (pairs.along[one] - row)[None], flow)[0]
                for row in lag
            ]
        )
        own = [radial_covariance([row], [row], np.zeros((1, 2)), [[0.0]], flow)[0, 0] for row in rows]
        place = np.arange(50) * 12.0 / 600.0
        projections = [np.zeros((50, 50))]
        for level in range(blocks.n_octave):
            block = np.floor(place * 2**level)
            projections.append((block[:, None] == block) / np.sum(block[:, None] == block, axis=0))
        projections = [*projections[1:], np.eye(50)]
        parts = [after - before for before, after in pairwise(projections)]
        dense = [
            [2.0 * np.sum((left @ cross @ right) ** 2) / 50**2 / (own[0] * own[1]) for right in parts] for left in parts
        ]
        assert found == pytest.approx(np.array(dense), rel=5e-3, abs=1e-8)

    def test_beams_that_see_the_same_count_less(self):
        alone = octave_information(octave_theory(SIX.select([0])), 600.0)
        close = octave_information(octave_theory(brs.load_scan("6-beam")), 600.0)
        at = np.log([61.0]), np.array([9.0])
        assert alone.at(*at)[0] > 1.8 * close.at(*at)[0]


def simulated(scan, length_scale, n_records=40, seed=5, **options):
    series = brs.simulate(
        scan, replace(FLOW, length_scale=length_scale), wind_speed=9.0, n_records=n_records, seed=seed, **options
    )
    return series, brs.make_records(series, scan)


class TestLengthScale:
    @pytest.mark.parametrize("length_scale", [15.0, 61.0, 200.0])
    def test_it_is_recovered(self, length_scale):
        _, records = simulated(SIX, length_scale)
        found = with_own_length_scale(records, SIX)
        report = json.loads(found.attrs[REPORT])
        assert report["n_told"] == 40
        assert abs(np.log(report["length_scale"] / length_scale)) < 0.25
        assert report["log_sd"] < 0.15

    def test_the_noise_of_the_instrument_does_not_shorten_it(self):
        series, records = simulated(SIX, 100.0)
        rng = np.random.default_rng(4)
        sd = np.sqrt(0.2 * float(records["variance"].mean()))
        noisy = series.assign(
            radial_velocity=series["radial_velocity"] + sd * rng.standard_normal(series.sizes["sample"])
        )
        found = json.loads(with_own_length_scale(brs.make_records(noisy, SIX), SIX).attrs[REPORT])
        assert abs(np.log(found["length_scale"] / 100.0)) < 0.3

    def test_gaps_do_not_move_it(self):
        series, _ = simulated(SIX, 61.0)
        there = np.random.default_rng(6).uniform(size=series.sizes["sample"]) < 0.8
        records = brs.make_records(series.isel(sample=np.flatnonzero(there)), SIX, min_availability=0.5)
        found = json.loads(with_own_length_scale(records, SIX).attrs[REPORT])
        assert abs(np.log(found["length_scale"] / 61.0)) < 0.25

    def test_what_cannot_tell_keeps_the_prior(self):
        _, records = simulated(SIX, 200.0, n_records=3)
        bare = records.drop_vars("octave_variance")
        dead = records.assign(flag=xr.ones_like(records["flag"]))
        other = records.isel(octave=slice(5))
        for told_nothing in (bare, dead, other):
            found = with_own_length_scale(told_nothing, SIX)
            assert found["length_scale"].values == pytest.approx(PRIOR_MEDIAN, rel=0.05)
            assert found["length_scale_log_sd"].values == pytest.approx(PRIOR_LOG_SD, rel=0.1)
            assert "do not tell it" in length_words(found)

    def test_a_record_without_wind_has_that_of_the_others(self):
        _, records = simulated(SIX, 200.0)
        records["wind_speed"].values[7] = np.nan
        found = with_own_length_scale(records, SIX)
        assert 130.0 < float(found["length_scale"][7]) < 300.0


def bell(log_length, width):
    """Log-likelihoods of records whose ln L is measured with a normal error."""
    return -0.5 * ((length_nodes() - np.asarray(log_length)[:, None]) / width) ** 2


class TestPooling:
    def test_a_single_record_has_the_prior_and_its_own_data(self):
        found = pool_lengths(bell([np.log(120.0)], 0.3), np.array([8.0]))
        share = 0.8**2 / (0.8**2 + 0.3**2)
        assert np.log(found.length_scale[0] / 61.0) == pytest.approx(share * np.log(120.0 / 61.0), abs=0.06)
        assert found.log_sd[0] == pytest.approx(0.3 * np.sqrt(share), rel=0.1)

    def test_many_records_tell_their_spread_and_how_it_grows_with_the_wind(self):
        rng = np.random.default_rng(1)
        speed = np.exp(rng.uniform(np.log(4.0), np.log(16.0), 600))
        truth = np.log(80.0) + 0.4 * np.log(speed / 8.0) + 0.4 * rng.standard_normal(600)
        found = pool_lengths(bell(truth + 0.3 * rng.standard_normal(600), 0.3), speed)
        assert found.spread == pytest.approx(0.4, abs=0.06)
        assert found.slope == pytest.approx(0.4, abs=0.12)
        error = (np.log(found.length_scale) - truth) / found.log_sd
        assert error.std() == pytest.approx(1.0, abs=0.1)
        assert np.mean(np.abs(error) < 1.645) > 0.86
        assert found.log_sd.mean() < 0.27  # 0.24 by the rule of two normals

    def test_one_record_that_is_unlike_the_others_stays_so(self):
        found = pool_lengths(bell([*np.full(40, np.log(60.0)), np.log(600.0)], 0.2), np.full(41, 9.0))
        assert found.spread < 0.3
        assert found.length_scale[-1] > 350.0


@pytest.fixture(scope="module")
def spanning():
    """Noise over a factor of eight in L."""
    return brs.noise.calibrate(
        SIX, wind_speed=[7.0, 11.0], length_scale=[20.0, 160.0], tolerance=0.02, cache=False, progress=False
    )


class TestAverage:
    def test_it_has_the_moments_of_the_mixture(self, spanning):
        rng = np.random.default_rng(3)
        width, n = 0.35, 4000
        at = np.array([9.0]), np.zeros(1)
        found = averaged_noise(spanning, *at, {"length_scale": np.array([60.0])}, np.array([width]))
        drawn = spanning.for_records(
            np.full(n, 9.0), np.zeros(n), length_scale=60.0 * np.exp(width * rng.standard_normal(n))
        )
        assert found.covariance[0] == pytest.approx(drawn.covariance.mean(axis=0), rel=0.03)  # of the draws: 0.6 %
        assert (
            found.covariance[0, 0, 0]
            > 1.02 * spanning.for_records(*at, length_scale=np.array([60.0])).covariance[0, 0, 0]
        )

    def test_known_lengths_change_nothing(self, spanning):
        at = np.array([8.0, 10.0]), np.zeros(2)
        flow = {"length_scale": np.array([40.0, 90.0])}
        one = spanning.for_records(*at, **flow)
        for log_sd in (None, np.zeros(2)):
            assert np.array_equal(averaged_noise(spanning, *at, flow, log_sd).covariance, one.covariance)
        other = spanning.at_turbulence(61.0, 3.2)
        assert np.array_equal(
            averaged_noise(other, *at, flow, np.full(2, 0.5)).covariance, other.for_records(*at, **flow).covariance
        )

    def test_that_the_bias_varies_hardly_matters(self, spanning):
        n, rng = 2000, np.random.default_rng(5)
        drawn = spanning.for_records(
            np.full(n, 8.0), np.zeros(n), length_scale=60.0 * np.exp(0.5 * rng.standard_normal(n))
        )
        level, power = 1.0 + drawn.bias, 1.0 + np.einsum("rbb->rb", drawn.covariance)
        whole = np.mean(level**2 * power, axis=0) / np.mean(level, axis=0) ** 2 - 1.0
        averaged = np.mean(power, axis=0) - 1.0
        assert whole == pytest.approx(averaged, rel=0.03)

    def test_reduced_noise_is_averaged_alike(self, spanning):
        at = np.array([9.0]), np.zeros(1)
        flow, width = {"length_scale": np.array([60.0])}, np.array([0.4])
        whole, reduced = averaged_noise(spanning, *at, flow, width), ReducedNoise(spanning)
        found = averaged_reduced(reduced, *at, flow, width)
        logarithm = np.log1p(whole.covariance[0])
        assert found.covariance[0] == pytest.approx(reduced.left.T @ logarithm @ reduced.left, rel=0.02, abs=1e-4)
        assert found.log_variance[0] == pytest.approx(np.diag(logarithm), rel=0.02)

    def test_the_noise_must_reach_over_the_nodes(self):
        low, high = length_range(np.array([20.0, 100.0]), np.array([0.5, 0.2]))
        assert (low, high) == pytest.approx((20.0 * np.exp(-0.5 * 3**0.5), 100.0 * np.exp(0.2 * 3**0.5)))


class TestFit:
    SMALL: ClassVar = {"seed": 1, "target_ess": 100, "progress": False}

    def test_noise_is_made_for_the_lengths_of_the_records(self):
        _, records = simulated(SIX, 200.0, n_records=20)
        said = []
        own = brs.fit(records, SIX, say=said.append, **self.SMALL)
        fixed = brs.fit(records, SIX, turbulence="fu-2022", say=said.append, **self.SMALL)
        assert own.run["length_scale"]["length_scale"] == pytest.approx(200.0, rel=0.3)
        assert any("length scale from the spectra of 20 of 20 records" in line for line in said)
        width = {fit is own: (fit.summary()["high"] - fit.summary()["low"])[::6].median() for fit in (own, fixed)}
        assert width[True] > 1.3 * width[False]
        assert any("noise was made for L = 61 m, the records' spectra say" in line for line in said)
        assert not np.any(own.flag & 32768)
        assert np.mean((fixed.flag & 32768) != 0) > 0.7
        assert fixed.run["length_scale"]["coverage"] < 0.82

    def test_what_another_fit_found_does_not_move_fixed_noise(self):
        _, records = simulated(SIX, 200.0, n_records=4)
        own = brs.fit(records, SIX, **self.SMALL)
        again = brs.fit(own.records, SIX, turbulence="fu-2022", **self.SMALL)
        first = brs.fit(records, SIX, turbulence="fu-2022", **self.SMALL)
        assert again.summary()["mean"].tolist() == first.summary()["mean"].tolist()
        repeated = brs.fit(own.records, SIX, **self.SMALL)
        assert repeated.summary()["mean"].tolist() == own.summary()["mean"].tolist()

    def test_the_right_length_is_no_contradiction(self):
        _, records = simulated(SIX, 61.0, n_records=20)
        said = []
        fixed = brs.fit(records, SIX, turbulence="fu-2022", say=said.append, **self.SMALL)
        assert not fixed.run["length_scale"]["contradicts"]
        assert not any("made for" in line for line in said)
        assert np.mean((fixed.flag & 32768) != 0) <= 0.1
