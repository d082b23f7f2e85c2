"""Covariances along the wind that are calculated once for all wind speeds, against those of each wind speed."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_rs.geometry.probe import PROBE_ERROR, ContinuousWaveProbe, PulsedProbe
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.gaps import gap_noise
from bayes_rs.noise.net import refined_noise
from bayes_rs.theory import kept_lines, pair_moments
from bayes_rs.theory.kept_lines import kept_covariance, many_speeds
from bayes_rs.theory.pairs import distinct_pairs
from bayes_rs.theory.probed import by_rules, probed_covariance
from bayes_rs.turbulence.mann import load_turbulence

FLOW = load_turbulence("fu-2022")
CW, PULSE = ContinuousWaveProbe(rayleigh_length=6.1), PulsedProbe(gate_length=20.0)
SPEEDS = (4.0, 7.3, 9.0, 14.0)
SAME = 3e-4
"""Relative error of K by the two interpolations along the wind, that of `probed_covariance` and that of kept lines."""


@pytest.fixture(autouse=True)
def nothing_kept():
    with many_speeds():
        pass
    yield
    with many_speeds():
        pass


def counted(monkeypatch):
    """Return a list that takes the number of lines of each calculation."""
    rows, by_rules = [], kept_lines.by_rules
    monkeypatch.setattr(
        kept_lines, "by_rules", lambda *given, **how: rows.append(len(given[0])) or by_rules(*given, **how)
    )
    return rows


def state_by_state(monkeypatch, scan, flow, **options):
    """Noise at each wind speed from covariances that are calculated for it alone."""

    def alone(*given, shortest, rules, **how):
        assert rules == "full"
        del shortest
        return probed_covariance(*given, **how)

    with monkeypatch.context() as patch:
        patch.setattr(pair_moments, "kept_covariance", alone)
        return [theory_noise(scan, flow, wind_speed=u, **options) for u in SPEEDS]


def off(have, want):
    return np.linalg.norm(have - want, axis=(-2, -1)) / np.linalg.norm(want, axis=(-2, -1))


SCENES = {
    "pulse": (load_scan("windcube-v2"), {}, 15.0),
    "long pulse": (load_scan("wls200s-dbs"), {"yaw": 0.6}, 61.0),
    "continuous wave": (replace(load_scan("6-beam"), probe=CW), {"yaw": -0.2}, 15.0),
    "linear": (replace(load_scan("4-beam"), probe=PULSE), {"detrend": "linear"}, 61.0),
    "planes": (replace(load_scan("2-beam-planes").select(np.arange(0, 6)), probe=CW), {}, 61.0),
    "many beams": (load_scan("zx-tm").select(np.arange(0, 50, 4)), {}, 61.0),
}


class TestAgainstEachWindSpeed:
    @pytest.mark.parametrize("scene", SCENES)
    def test_theory(self, scene, monkeypatch):
        scan, options, length_scale = SCENES[scene]
        flow = replace(FLOW, length_scale=length_scale)
        want = state_by_state(monkeypatch, scan, flow, **options)
        with many_speeds():
            have = [theory_noise(scan, flow, wind_speed=u, **options) for u in SPEEDS]
        for one, other in zip(have, want, strict=True):
            assert off(one.covariance, other.covariance)[0] < SAME
            np.testing.assert_allclose(one.bias, other.bias, atol=SAME)
            np.testing.assert_allclose(one.gain, other.gain, atol=SAME)

    def test_points_of_many_pairs(self, monkeypatch):
        monkeypatch.setattr(kept_lines, "_MANY_POINTS", 100)
        scan = load_scan("spinnerlidar@probe=point")
        scan = scan.select(scan.beam[::9])
        alone = [theory_noise(scan, FLOW, wind_speed=u, yaw=0.1).covariance for u in SPEEDS]
        calls = []
        calculate = kept_lines.radial_covariance
        with many_speeds():
            monkeypatch.setattr(
                kept_lines,
                "radial_covariance",
                lambda *given, **how: calls.append(len(given[0])) or calculate(*given, **how),
            )
            together = [theory_noise(scan, FLOW, wind_speed=u, yaw=0.1).covariance for u in SPEEDS]
        assert np.max(off(np.concatenate(together), np.concatenate(alone))) < SAME
        assert np.max(calls) > 100
        assert sum(count > 100 for count in calls) == 1

    @pytest.mark.parametrize("scan", [load_scan("windcube-v2"), replace(load_scan("2-beam"), probe=CW)])
    def test_a_net_is_within_its_stated_error(self, scan):
        net = refined_noise(
            scan, FLOW, wind_speed=[6.0, 12.0], yaw_deg=[-5.0, 5.0], tolerance=0.02, cache=False, progress=False
        )
        speeds, yaws = np.array([6.4, 8.8, 11.3]), np.deg2rad([-4.0, 1.0, 3.0])
        found = net.for_records(speeds, yaws)
        truth = [theory_noise(scan, FLOW, wind_speed=u, yaw=y).covariance[0] for u, y in zip(speeds, yaws, strict=True)]
        assert np.max(off(found.covariance, np.array(truth))) < 1.2 * net.interpolation_error + SAME
        assert net.interpolation_error <= 0.02

    def test_gaps(self):
        scan = load_scan("windcube-v2")
        whole = theory_noise(scan, FLOW, wind_speed=9.0)
        every = gap_noise(scan, FLOW, np.ones((5, 120), dtype=bool), wind_speed=9.0)
        assert off(every.covariance, whole.covariance)[0] < SAME


class TestKept:
    def test_numbers_do_not_depend_on_what_was_asked_for_before(self):
        scan = load_scan("windcube-v2")
        alone = theory_noise(scan, FLOW, wind_speed=9.0, yaw=0.2)
        for speed, yaw in ((20.0, 0.2), (4.0, 0.0), (9.0, 0.1)):
            theory_noise(scan, FLOW, wind_speed=speed, yaw=yaw)
            theory_noise(scan, replace(FLOW, length_scale=30.0), wind_speed=speed, yaw=yaw)
        again = theory_noise(scan, FLOW, wind_speed=9.0, yaw=0.2)
        np.testing.assert_array_equal(again.covariance, alone.covariance)
        with many_speeds():
            theory_noise(scan, FLOW, wind_speed=5.0, yaw=0.2)
            np.testing.assert_array_equal(
                theory_noise(scan, FLOW, wind_speed=9.0, yaw=0.2).covariance, alone.covariance
            )

    def test_other_wind_speeds_calculate_nothing_along_the_wind(self, monkeypatch):
        rows = counted(monkeypatch)
        scan = load_scan("windcube-v2")
        for speed in SPEEDS:
            theory_noise(scan, FLOW, wind_speed=speed)
        assert len(rows) <= 2  # slow wind may have a shorter grid
        rows.clear()
        theory_noise(scan, FLOW, wind_speed=9.0, yaw=0.3)
        theory_noise(scan, replace(FLOW, dissipation=0.3), wind_speed=9.0, yaw=0.3)
        assert len(rows) == 2  # another direction, and another flow

    @pytest.mark.parametrize("probe", [CW, PULSE])
    def test_a_beam_with_itself_takes_half_of_the_nodes(self, probe):
        """Its covariance is even, so those at separations of both signs tell what the other nodes would."""
        ahead = np.array([[-1.0, 0.2, 0.1], [-0.6, 0.0, 0.8]])
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        along, lengths = (
            np.tile(np.array([-300.0, -20.0, 0.0, 20.0, 300.0]), (2, 1)),
            np.array([[6.0, 6.0], [9.0, 9.0]]),
        )
        both = by_rules(ahead, ahead, np.zeros((2, 2)), along, FLOW, probe, lengths, 1e-4)
        one_more = np.append(along, [[7.0], [7.0]], axis=1)
        every = by_rules(ahead, ahead, np.zeros((2, 2)), one_more, FLOW, probe, lengths, 1e-4)
        np.testing.assert_allclose(both, every[:, :-1], rtol=1e-9, atol=1e-9)

    def test_mirror_images_and_beams_in_the_other_order_have_one_line(self, monkeypatch):
        rng = np.random.default_rng(2)
        direction = np.column_stack([-np.ones(6), rng.normal(0.0, 0.3, (6, 2))])
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        first, second, across = direction[:3], direction[3:], rng.normal(0.0, 20.0, (3, 2))
        along, lengths = rng.normal(0.0, 200.0, (3, 40)), rng.uniform(2.0, 9.0, (3, 2))
        mirror, side = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0])
        images = [
            (first, second, across, along, lengths),
            (second, first, across, along, lengths[:, ::-1]),
            (first * mirror, second * mirror, across * side, along, lengths),
            (first, second, -across, -along, lengths),
            (second * mirror, first * mirror, -across * side, -along, lengths[:, ::-1]),
        ]
        *given, lengths = (np.concatenate(parts) for parts in zip(*images, strict=True))
        rows = counted(monkeypatch)
        have = kept_covariance(*given, FLOW, lengths=lengths, probe=CW, shortest=2.0)
        assert rows == [3]
        want = probed_covariance(*given, FLOW, lengths=lengths, probe=CW)
        np.testing.assert_allclose(have, want, atol=2e-4 * FLOW.stresses()[0])

    def test_a_symmetric_pattern_has_one_line_to_the_left_and_to_the_right(self, monkeypatch):
        rows = counted(monkeypatch)
        theory_noise("windcube-v2", FLOW, wind_speed=9.0, yaw=0.3)
        assert sum(rows) > 0
        rows.clear()
        theory_noise("windcube-v2", FLOW, wind_speed=9.0, yaw=-0.3)
        assert rows == []

    def test_many_pairs_are_chosen_alike_at_all_wind_speeds(self, monkeypatch):
        rows = counted(monkeypatch)
        theory_noise("zx-tm", FLOW, wind_speed=10.0, yaw=0.1)
        assert sum(rows) > 200
        rows.clear()
        theory_noise("zx-tm", FLOW, wind_speed=9.3, yaw=0.1)
        assert sum(rows) < 30  # of pairs that tell the largest error

    def test_far_nodes_and_separations_between_those_of_a_line_change_little(self, monkeypatch):
        """Probes twice as long as the eddies: the tails of their weighting reach to thousands of L."""
        scan, flow = load_scan("zx-300@focus_distance=258.819").select([0, 3, 25]), replace(FLOW, length_scale=20.0)
        found = []
        steps = ("kept_lines.LAG_STEP", "kept_lines._COARSE_LAG_STEP")
        for what, value in (((), None), (("probed._FARTHEST",), np.inf), (steps, 0.1)):
            for name in what:
                monkeypatch.setattr(f"bayes_rs.theory.{name}", value)
            with many_speeds():
                found.append(theory_noise(scan, flow, wind_speed=9.0).covariance)
        plain, farther, finer = found
        np.testing.assert_allclose(plain, farther, rtol=5e-5)
        np.testing.assert_allclose(farther, finer, rtol=0.5 * PROBE_ERROR)  # where beams cross, far from their foci
        assert np.max(np.abs(plain / farther - 1.0)) > 1e-8  # there are such nodes
        assert np.max(np.abs(farther / finer - 1.0)) > 1e-8

    def test_what_is_kept_is_forgotten(self):
        with many_speeds():
            theory_noise("windcube-v2", FLOW, wind_speed=9.0)
            assert kept_lines._lines.cache_info().currsize > 0
        assert kept_lines._lines.cache_info().currsize == 0
        assert kept_lines._POINTS.get() is None

    @pytest.mark.parametrize("most", [0, 3, 7])
    def test_more_lines_than_are_kept(self, most, monkeypatch):
        monkeypatch.setattr(kept_lines, "_MOST_KEPT", most)
        rng = np.random.default_rng(1)
        direction = np.column_stack([-np.ones(9), rng.normal(0.0, 0.2, (9, 2))])
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        across, along = rng.normal(0.0, 20.0, (9, 2)), rng.normal(0.0, 200.0, (9, 300))
        for probe in (CW, PULSE):
            lengths = np.tile(probe.length([50.0]), (9, 2))
            how = {"probe": probe, "shortest": float(lengths[0, 0])}
            for rows in (slice(0, 5), slice(2, 9), slice(0, 9)):
                given = (direction[rows], direction[::-1][rows], across[rows], along[rows])
                have = kept_covariance(*given, FLOW, lengths=lengths[rows], **how)
                want = probed_covariance(*given, FLOW, lengths=lengths[rows], probe=probe)
                np.testing.assert_allclose(have, want, atol=2e-4 * FLOW.stresses()[0])


class TestDistinctPairs:
    @pytest.mark.parametrize("name", ["50-beam", "zx-tm", "6-beam-planes"])
    def test_pairs_are_the_same_that_agree_in_every_number(self, name):
        scan = load_scan(name)
        pairs = distinct_pairs(scan, scan.at_yaw(0.0), np.full(scan.n_beam, 600), 9.0)
        table = np.concatenate(
            [pairs.first, pairs.second, pairs.across, pairs.along[:, None], pairs.own[:, None]], axis=1
        )
        assert len(np.unique(np.round(table / 1e-9) + 0.0, axis=0)) == len(table) < len(pairs.row)
        _, first = np.unique(pairs.distinct, return_index=True)
        assert np.all(np.diff(first) > 0)  # in the order in which they come
        np.testing.assert_array_equal(np.abs(pairs.first), np.abs(scan.at_yaw(0.0)[pairs.row[first]]))
