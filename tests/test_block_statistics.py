"""The statistics of the parts of records: laws, and a slow way to the same numbers."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import bayes_rs as brs
from bayes_rs.records.block_statistics import BLOCKS, blocks_of, chosen_beams, n_part, wind_weights

START = np.datetime64("2024-05-01T00:00", "ns")


def series_of(scan, velocity):
    """A series of velocities (n_beam, n_sample) at the scan's own times."""
    n_sample = velocity.shape[1]
    time = scan.beam_time[:, None] + scan.scan_duration * np.arange(n_sample)
    stamps = START + np.round(time * 1e9).astype("timedelta64[ns]")
    return xr.Dataset(
        {"radial_velocity": ("sample", velocity.ravel())},
        coords={
            "time": ("sample", stamps.ravel()),
            "beam": ("sample", np.repeat(scan.beam, n_sample)),
        },
    )


def times(scan, n_sample):
    return scan.beam_time[:, None] + scan.scan_duration * np.arange(n_sample)


@pytest.fixture(scope="module")
def scan():
    return brs.load_scan("6-beam@opening_angle_deg=45,focus_distance=52")


@pytest.fixture
def velocity(scan):
    return -8.0 + np.random.default_rng(1).standard_normal((scan.n_beam, 600)).cumsum(axis=1) * 0.1


class TestLaws:
    def test_parts_of_a_uniform_wind_are_that_wind(self, scan):
        u, v = 9.0, 2.0
        flicker = 1e-9 * (-1.0) ** np.arange(600)  # beams that are constant are flagged
        found = brs.make_records(series_of(scan, (scan.level_direction @ [u, v, 0.0])[:, None] + flicker), scan)
        np.testing.assert_allclose(found["part_wind"].values, u, atol=1e-8)
        np.testing.assert_allclose(found["part_wind_across"].values, v, atol=1e-8)

    def test_parts_of_a_trend_lie_on_it(self, scan):
        change = 3.0 * (times(scan, 600) / 600.0 - 0.5)
        found = brs.make_records(series_of(scan, scan.level_direction[:, :1] * (10.0 + change)), scan)
        wind = found["part_wind"].values[0]
        line = 10.0 + 3.0 * ((np.arange(64) + 0.5) / 64 - 0.5)
        np.testing.assert_allclose(wind, line, atol=3.0 / 600.0)  # parts of 18 and 19 samples

    @pytest.mark.parametrize(("factor", "shift"), [(3.0, 0.0), (1.0, 50.0), (0.5, -7.0)])
    def test_scatter_knows_neither_level_nor_mean(self, scan, velocity, factor, shift):
        one = brs.make_records(series_of(scan, velocity), scan)
        other = brs.make_records(series_of(scan, factor * velocity + shift), scan)
        for name in ("block_scatter", "block_scatter_of_beams"):
            np.testing.assert_allclose(other[name].values, one[name].values, rtol=1e-8)

    def test_blocks_that_differ_by_a_factor_scatter_by_its_logarithm(self, scan):
        # sixteen times the same sample of eddies, of other strength each time
        strength = np.exp(0.4 * np.random.default_rng(2).standard_normal(16))
        eddies = np.random.default_rng(3).standard_normal((scan.n_beam, 40))
        velocity = (strength[:, None] * eddies[:, None, :]).reshape(scan.n_beam, 640)
        fast = replace(scan, beam_time=scan.beam_time * 0.9375, scan_duration=scan.scan_duration * 0.9375)
        found = brs.make_records(series_of(fast, velocity), fast)
        expected = np.log(strength**2).var(ddof=1)
        np.testing.assert_allclose(found["block_scatter"].values[0, -1], expected, rtol=1e-8)
        np.testing.assert_allclose(found["block_scatter_of_beams"].values[0, -1], expected, rtol=1e-8)


def slow_scatter(scan, velocity, time, n_block):
    """Both scatters, sample by sample."""
    block = np.floor(time / (600.0 / n_block) + 1e-9).astype(int)
    variance = np.array([[velocity[b, block[b] == j].var() for j in range(n_block)] for b in range(scan.n_beam)])
    relative = (variance / variance.mean(axis=1, keepdims=True)).mean(axis=0)
    return np.log(relative).var(ddof=1), np.log(variance).var(axis=1, ddof=1).mean()


class TestReference:
    def test_scatters_and_winds_the_slow_way(self, scan, velocity):
        found = brs.make_records(series_of(scan, velocity), scan)
        time = times(scan, 600)
        for column, n_block in enumerate(BLOCKS):
            whole, beams = slow_scatter(scan, velocity, time, n_block)
            np.testing.assert_allclose(found["block_scatter"].values[0, column], whole, rtol=1e-9)
            np.testing.assert_allclose(found["block_scatter_of_beams"].values[0, column], beams, rtol=1e-9)
        part = np.floor(time / 9.375 + 1e-9).astype(int)
        mean = np.array([[velocity[b, part[b] == j].mean() for j in range(64)] for b in range(scan.n_beam)])
        wind = np.linalg.lstsq(scan.level_direction[:, :2], mean, rcond=None)[0]
        np.testing.assert_allclose(found["part_wind"].values[0], wind[0], rtol=1e-9)
        np.testing.assert_allclose(found["part_wind_across"].values[0], wind[1], rtol=1e-8, atol=1e-9)

    def test_missing_parts_lie_between_their_neighbours(self, scan):
        line = 10.0 + times(scan, 600) / 600.0
        velocity = scan.level_direction[:, :1] * line
        velocity[2, 100:130] = np.nan
        found = brs.make_records(series_of(scan, velocity), scan)
        np.testing.assert_allclose(np.diff(found["part_wind"].values[0]), 1.0 / 64, atol=0.005)

    def test_a_beam_without_samples_is_left_out(self, scan, velocity):
        velocity[3, :300] = np.nan
        found = brs.make_records(series_of(scan, velocity), scan)
        assert found["part_beams"].values.tolist() == [0b110111]
        series = series_of(scan, velocity)
        one = brs.make_records(series.isel(sample=series["beam"].values != 3), scan)
        np.testing.assert_array_equal(found["part_wind"].values, one["part_wind"].values)
        np.testing.assert_array_equal(found["block_scatter"].values, one["block_scatter"].values)


class TestSizes:
    def test_parts_and_blocks_by_the_number_of_samples(self):
        expected = {"6-beam": (64, (4, 8, 16)), "pulsed-4-beam": (64, (4, 8, 16))}
        for name, (parts, blocks) in expected.items():
            scan = brs.load_scan(name)
            assert (n_part(scan, 600.0), blocks_of(scan, 600.0)) == (parts, blocks)
        slow = replace(brs.load_scan("6-beam"), scan_duration=30.0)
        assert (n_part(slow, 600.0), blocks_of(slow, 600.0)) == (16, (4,))
        slower = replace(slow, scan_duration=60.0)
        assert (n_part(slower, 600.0), blocks_of(slower, 600.0)) == (0, ())

    def test_too_few_samples_give_no_statistics(self):
        scan = replace(brs.load_scan("6-beam"), scan_duration=60.0)
        velocity = np.random.default_rng(1).standard_normal((6, 10))
        assert "part_wind" not in brs.make_records(series_of(scan, velocity), scan)

    def test_few_of_many_beams(self):
        scan = brs.load_scan("50-beam")
        chosen = chosen_beams(scan)
        assert chosen.n_beam == 8
        weights, sees = wind_weights(chosen, np.ones(8, dtype=bool))
        assert sees
        np.testing.assert_allclose(weights @ chosen.level_direction[:, :2], np.eye(2), atol=1e-12)
