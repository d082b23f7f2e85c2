"""The one way to make noise: names and files, states, nets, records and gaps."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import plain_noise, records_of

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.noise.gaps import gap_noise
from bayes_rs.turbulence.mann import load_turbulence

FLOW = load_turbulence("fu-2022")


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("bias", "gain", "covariance"))


def some_records(scan, wind_speed, **variables):
    records = records_of(np.ones((len(wind_speed), scan.n_beam)), scan)
    records["wind_speed"][:] = wind_speed
    return records.assign({name: ("record", values) for name, values in variables.items()})


class TestNames:
    def test_a_scan_and_a_turbulence_may_be_names_or_files(self, tmp_path):
        scan = load_scan("2-beam")
        brs.save_scan(scan, tmp_path / "mine.toml")
        want = calibrate(scan, FLOW, wind_speed=10, cache=False)
        assert same(calibrate("2-beam", "fu-2022", wind_speed=10, cache=False), want)
        assert same(calibrate("2-beam", wind_speed=10, cache=False), want)
        mine = calibrate(tmp_path / "mine.toml", wind_speed=10, cache=False)
        np.testing.assert_allclose(mine.covariance, want.covariance, rtol=1e-6)  # a file has nine digits
        assert same(brs.noise.theory("2-beam", wind_speed=10.0), want)
        moments = brs.noise.sonic_moments("2-beam", wind_speed=10.0)
        np.testing.assert_array_equal(moments.mean, brs.noise.sonic_moments(scan, FLOW, wind_speed=10.0).mean)

    def test_an_unknown_name(self):
        with pytest.raises(InputError, match="No preset '7-beam'"):
            calibrate("7-beam", wind_speed=10.0)
        with pytest.raises(InputError, match="No preset 'calm'"):
            calibrate("6-beam", "calm", wind_speed=10.0)


class TestStates:
    def test_every_combination_wind_speeds_first(self):
        noise = calibrate(
            "staring", wind_speed=[8.0, 12.0], yaw_deg=[0.0, 20.0], length_scale=[30.0, 60.0], gamma=3.0, cache=False
        )
        assert noise.wind_speed.tolist() == [8.0, 8.0, 12.0, 12.0] * 2
        np.testing.assert_allclose(np.rad2deg(noise.yaw), [0.0, 20.0] * 4)
        assert noise.length_scale.tolist() == [30.0] * 4 + [60.0] * 4
        assert set(noise.gamma.tolist()) == {3.0}
        flow = replace(FLOW, length_scale=60.0, gamma=3.0)
        assert same(noise.state(6), theory_noise("staring", flow, wind_speed=12.0))
        assert noise.state(6).turbulence == flow

    def test_with_a_tolerance_a_net_over_the_ranges(self):
        noise = calibrate("staring", wind_speed=[6.0, 12.0], tolerance=0.01, cache=False)
        assert noise.interpolation_error <= 0.01
        assert not noise.locate([6.0, 9.0, 12.0], 0.0)[2].any()

    def test_with_gaps(self):
        present = np.random.default_rng(1).random((2, 60)) < 0.8
        noise = calibrate("2-beam", wind_speed=9.0, duration=60.0, present=present)
        assert same(noise, gap_noise(load_scan("2-beam"), FLOW, present, wind_speed=9.0, duration=60.0))
        with pytest.raises(InputError, match="Invalid present with several states"):
            calibrate("2-beam", wind_speed=[9.0, 10.0], duration=60.0, present=present)


class TestRecords:
    def test_their_beams_winds_and_length_scales(self, tmp_path):
        scan = load_scan("6-beam").select([4, 1])
        records = some_records(scan, [9.0, 10.0], length_scale=[40.0, 80.0])
        noise = calibrate("6-beam", records=records, cache=tmp_path)
        assert noise.beam.tolist() == [4, 1]
        flow = {"length_scale": [40.0, 80.0], "gamma": 3.2}
        assert not noise.for_records(records["wind_speed"], 0.0, **flow).outside.any()
        assert noise.interpolation_error <= 0.01

    @pytest.mark.parametrize("change", [{"yaw_deg": 3.0}, {"present": [[True]]}])
    def test_what_they_bring_along(self, change):
        scan = load_scan("2-beam")
        with pytest.raises(InputError, match=f"Invalid {next(iter(change))} with records"):
            calibrate(scan, records=some_records(scan, [9.0, 10.0]), **change)

    def test_records_without_a_wind(self):
        records = some_records(load_scan("2-beam"), [9.0])
        for without in (
            records.drop_vars("wind_speed"),
            records.drop_vars("yaw"),
            records.assign(yaw=records["yaw"] * np.nan),
        ):
            with pytest.raises(InputError, match=r"No record has a wind speed and direction.*: give them, or a noise"):
                calibrate("2-beam", records=without)
        flagged = without.assign(flag=(without["variance"].dims, np.full(without["variance"].shape, 129, np.uint8)))
        with pytest.raises(InputError, match=r"a flag \(too_few_samples 2 of 2, cut_off 2 of 2\); a lower min_availab"):
            calibrate("2-beam", records=flagged)

    def test_words_count_those_outside(self):
        words = plain_noise(load_scan("2-beam")).in_words([10.0, 16.0, np.nan], [0.0, 0.0, 0.0])
        assert words == (
            "noise: test, method given, 1 state (10 m/s, yaw 0°, L 61 m); 1 of 2 records are outside and use its "
            "nearest state"
        )
