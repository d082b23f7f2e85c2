"""What theory expects of the parts of records, against simulated ones and by laws."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.special

import bayes_rs as brs
from bayes_rs.records.block_statistics import BLOCKS, blocks_of
from bayes_rs.theory.block_theory import _log_variance, block_theory
from bayes_rs.turbulence.mann import MannTurbulence

FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2, name="test")
SIGMAS = 4.0


def theory_of(scan, flow=FLOW, **options):
    given = {"wind_speed": 10.0, "yaw": 0.0, "duration": 600.0, "n_part": 64, "blocks": blocks_of(scan, 600.0)}
    return block_theory(scan, flow, **{**given, **options})


@pytest.fixture(scope="module")
def scan():
    return brs.load_scan("2-beam")


@pytest.fixture(scope="module")
def records(scan):
    return brs.make_records(brs.simulate(scan, FLOW, wind_speed=10.0, n_records=400, seed=8), scan)


class TestAgainstSimulation:
    @pytest.mark.parametrize(
        ("name", "of_theory"), [("block_scatter", "scatter"), ("block_scatter_of_beams", "scatter_of_beams")]
    )
    def test_scatters(self, scan, records, name, of_theory):
        found = records[name].values
        error = found.std(axis=0) / np.sqrt(len(found))
        expected = getattr(theory_of(scan), of_theory)
        # the draws that the logarithm's variance comes from leave 3 % besides
        assert np.all(np.abs(found.mean(axis=0) - expected) < SIGMAS * error + 0.03 * expected)

    @pytest.mark.parametrize(("name", "component"), [("part_wind", 0), ("part_wind_across", 1)])
    def test_covariances_of_parts(self, scan, records, name, component):
        wind = records[name].values - (10.0 if component == 0 else 0.0)
        expected = theory_of(scan).wind[component]
        for apart in (0, 1, 3, 8):
            products = np.mean(wind[:, apart:] * wind[:, : 64 - apart], axis=1)
            error = products.std() / np.sqrt(len(products))
            assert abs(products.mean() - expected[apart]) < SIGMAS * error + 0.01 * expected[0]

    def test_blocks_of_other_air_scatter_otherwise(self, scan, records):
        """A wrong length scale is seen, so that the checks above could fail."""
        found = records["block_scatter"].values[:, -1]
        error = found.std() / np.sqrt(len(found))
        for length_scale in (15.0, 250.0):
            other = theory_of(scan, replace(FLOW, length_scale=length_scale)).scatter[-1]
            assert abs(found.mean() - other) > 2.0 * SIGMAS * error


class TestLaws:
    def test_dissipation_scales_winds_and_no_scatter(self, scan):
        one, other = theory_of(scan), theory_of(scan, replace(FLOW, dissipation=0.15))
        np.testing.assert_allclose(other.wind, 3.0 * one.wind, rtol=1e-9)
        np.testing.assert_allclose(other.scatter, one.scatter, rtol=1e-9)

    def test_all_parts_together_are_the_record(self, scan):
        """The mean covariance of all pairs of parts is the variance of the record's mean, with 64 parts or 16."""
        means = []
        for number in (64, 16):
            wind = theory_of(scan, n_part=number).wind[0]
            weight = np.r_[number, 2.0 * (number - np.arange(1, number))]
            means.append(weight @ wind / number**2)
        np.testing.assert_allclose(means[0], means[1], rtol=0.01)

    def test_blocks_not_asked_for_are_not_known(self, scan):
        found = theory_of(scan, blocks=(8,)).scatter
        assert np.isfinite(found).tolist() == [number == 8 for number in BLOCKS]

    def test_a_beam_that_looks_up_sees_no_horizontal_wind(self):
        up = brs.geometry.Scan("up", [[0.0, 0.0, 1.0]], focus_distance=[100.0], beam_time=[0.0], scan_duration=1.0)
        assert theory_of(up).wind.shape == (0, 64)

    @pytest.mark.parametrize("count", [3, 30, 300])
    def test_log_variance_of_equal_eigenvalues_is_that_of_a_chi_square(self, count):
        expected = scipy.special.polygamma(1, 0.5 * count)
        # 4000 draws: the variance of a variance that is nearly normal
        assert abs(_log_variance(np.full(count, 0.7)) / expected - 1.0) < SIGMAS * np.sqrt(3.0 / 4000)
