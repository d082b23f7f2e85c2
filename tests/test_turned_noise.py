"""Noise of scans that a turn of the wind maps onto themselves, and nets that use it."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise import at_states
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.net import refined_noise
from bayes_rs.noise.turned import find_turn
from bayes_rs.turbulence.mann import load_turbulence

FLOW = load_turbulence("fu-2022")


def cone():
    """Twelve beams upwards, one after the other."""
    phase = 2.0 * np.pi * np.arange(12) / 12
    up, across = np.cos(0.3), np.sin(0.3)
    direction = np.column_stack([across * np.cos(phase), across * np.sin(phase), np.full(12, up)])
    scan = load_scan("zx-300@probe=point", focus_distance=80.0).select(np.arange(12))
    return replace(scan, beam_direction=direction, beam_time=np.arange(12) / 12.0)


class TestFindTurn:
    def test_of_the_presets_only_a_profilers_cone(self):
        assert find_turn(load_scan("zx-300", focus_distance=103.5)).step_deg == pytest.approx(7.2)
        for name in ("zx-tm", "50-beam", "spinnerlidar", "windcube-v2", "wls200s-dbs", "6-beam"):
            assert find_turn(load_scan(name)) is None

    def test_times_distances_and_directions_must_fit(self):
        scan = cone()
        assert find_turn(scan).step_deg == pytest.approx(30.0)
        assert sorted(find_turn(scan).order) == list(range(12))
        assert find_turn(replace(scan, beam_time=np.arange(12)[::-1] / 12.0)) is not None
        assert find_turn(replace(scan, beam_time=np.arange(12) ** 2 / 144.0)) is None
        assert find_turn(replace(scan, focus_distance=np.linspace(80.0, 81.0, 12))) is None
        assert find_turn(scan.select(np.arange(11))) is None
        tilted = replace(scan, beam_direction=np.roll(scan.beam_direction, 1, axis=1))
        assert find_turn(tilted) is None

    def test_of_simultaneous_beams(self):
        scan = replace(cone(), beam_time=np.zeros(12))
        turn = find_turn(scan)
        one, turned = (theory_noise(scan, FLOW, wind_speed=9.0, yaw=np.deg2rad(4.0 + at)) for at in (0.0, -90.0))
        # then nothing moves over the end of a scan, and the turn is exact
        made = turn.apply(one, -3, 4.0 - 90.0)
        for name in ("covariance", "gain", "bias", "yaw"):
            np.testing.assert_allclose(getattr(made, name), getattr(turned, name), rtol=1e-4, atol=1e-5)


class TestTurned:
    @pytest.mark.parametrize("steps", [1, -5, 19])
    def test_is_the_noise_that_is_calculated_there(self, steps):
        scan = cone()
        turn, yaw = find_turn(scan), 11.0
        there = yaw + steps * turn.step_deg
        assert turn.split(there) == (pytest.approx(yaw), steps)
        one, truth = (
            theory_noise(scan, FLOW, wind_speed=9.0, yaw=np.deg2rad(angle), sonic=True) for angle in (yaw, there)
        )
        made = turn.apply(one, steps, there)
        for name in ("covariance", "sonic_covariance"):
            off = np.linalg.norm(getattr(made, name) - getattr(truth, name)) / np.linalg.norm(getattr(truth, name))
            assert off < 0.003
        across = made.sonic_beam_covariance - truth.sonic_beam_covariance
        assert np.linalg.norm(across) / np.linalg.norm(truth.sonic_beam_covariance) < 0.003
        np.testing.assert_allclose(made.gain, truth.gain, atol=1e-12)
        np.testing.assert_allclose(made.bias, truth.bias, atol=1e-3)
        np.testing.assert_allclose(made.yaw, truth.yaw)

    def test_a_net_of_all_directions_is_calculated_for_a_few(self, monkeypatch):
        made = []
        monkeypatch.setattr(
            at_states, "theory_noise", lambda *given, **how: made.append(how["yaw"]) or theory_noise(*given, **how)
        )
        scan = cone()
        net = refined_noise(
            scan, FLOW, wind_speed=[9.0], yaw_deg=[-179.0, 180.0], tolerance=0.02, cache=False, progress=False
        )
        assert len(net) >= 13
        assert len(made) <= 8
        assert np.min(made) >= 0.0
        assert np.max(made) < np.deg2rad(30.0)
        assert net.interpolation_error <= 0.02
        assert net.details["interpolation_error_beams"] == 12
        rng = np.random.default_rng(3)
        for angle in rng.uniform(-np.pi, np.pi, 4):
            truth = theory_noise(scan, FLOW, wind_speed=9.0, yaw=angle).covariance[0]
            between = net.for_records([9.0], [angle]).covariance[0]
            # 0.3 % are of the turn
            off = np.linalg.norm(between - truth) / np.linalg.norm(truth)
            assert off < 1.2 * net.interpolation_error + 0.003


class TestRefining:
    def test_the_axis_that_errs_is_halved_and_finding_it_is_cheap(self, monkeypatch):
        made = []
        monkeypatch.setattr(
            at_states, "theory_noise", lambda *given, **how: made.append(1) or theory_noise(*given, **how)
        )
        # beams along the wind, seconds apart: K of two of them peaks at the wind speeds that carry eddies between them
        scan = load_scan("windcube-v2")
        flow = replace(FLOW, length_scale=20.0)
        net = refined_noise(
            scan, flow, wind_speed=[5.0, 15.0], yaw_deg=[-10.0, 10.0], tolerance=0.02, cache=False, progress=False
        )
        assert net.interpolation_error <= 0.02
        sizes = [len(axis) for axis in net.net.axes]
        assert sizes[0] > 5
        assert len(net) <= 100
        assert len(made) <= 200  # of the net, of the middles of its cells and those of coarser nets, and few besides
        speed, yaw = np.array([6.3, 12.1]), np.deg2rad([-7.0, 3.0])
        truth = [theory_noise(scan, flow, wind_speed=u, yaw=y).covariance[0] for u, y in zip(speed, yaw, strict=True)]
        off = net.for_records(speed, yaw).covariance - truth
        assert np.max(np.linalg.norm(off, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))) < 0.024
