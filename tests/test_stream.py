"""Fits of records as they close: those of the batch, bit by bit, and no more work than one record is."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayes_rs as brs
from bayes_rs import processor
from bayes_rs.errors import InputError
from bayes_rs.fits.range_job import seed_of_range
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.priors.interface import LogRatioPrior
from bayes_rs.records import stream as record_stream
from bayes_rs.spectra import pooled_noise

SCAN = "2-beam"
FLOW = "fu-2022"
SEED = 3
N_RECORD = 4
RANGES = (60.0, 120.0)
SECOND = np.timedelta64(1, "s")
NOTHING_POOLED = {"instrument_noise": 0.0, "scatter": "theory", "unsteady_level": 0.0, "turbulence": FLOW}


@pytest.fixture(scope="module")
def series():
    return brs.simulate(SCAN, FLOW, wind_speed=10.0, n_records=N_RECORD, seed=1)


@pytest.fixture(scope="module")
def records(series):
    return brs.make_records(series, SCAN)


@pytest.fixture(scope="module")
def noise():
    """Noise over length scales, so that those of the records are found."""
    return brs.noise.calibrate(
        SCAN, FLOW, wind_speed=[5.0, 20.0], yaw_deg=[-20.0, 20.0], length_scale=[20.0, 160.0], tolerance=0.05
    )


@pytest.fixture(scope="module")
def noise_of_one_length():
    return brs.noise.calibrate(SCAN, FLOW, wind_speed=[5.0, 20.0], yaw_deg=[-20.0, 20.0], tolerance=0.05)


@pytest.fixture(scope="module")
def ranged():
    """A series at two ranges, whose samples come together."""
    parts = []
    for distance in RANGES:
        own = brs.simulate(
            f"{SCAN}@focus_distance={distance:g}", FLOW, wind_speed=10.0, n_records=3, seed=int(distance)
        )
        parts.append(own.assign_coords(range=("sample", np.full(own.sizes["sample"], distance))))
    return xr.concat(parts, dim="sample").drop_attrs().sortby(["time", "range"])


@pytest.fixture(scope="module")
def run_of_ranges(ranged):
    lines = []
    stream = brs.Stream(SCAN, seed=SEED, turbulence=FLOW, memory=1, sampler="direct", say=lines.append)
    found = [fit for piece in pieces(ranged, 1100) for fit in stream.add(piece)]
    return stream, [*found, *stream.close()], lines


def pieces(series, size):
    for first in range(0, series.sizes["sample"], size):
        yield series.isel(sample=slice(first, first + size))


def run(series, size=700, **options):
    stream = brs.Stream(SCAN, seed=SEED, **options)
    found = [fit for piece in pieces(series, size) for fit in stream.add(piece)]
    return stream, [*found, *stream.close()]


def same(one, batch, record, but=()):
    """Check the fit of one record against that record of another fit, to the last bit."""
    for name in ("summary", "draws", "posterior"):
        mine, other = one.table(name), batch.table(name)
        other = other[other["record"] == batch.table("posterior")["record"].iloc[record]].reset_index(drop=True)
        without = ["record", *but]
        pd.testing.assert_frame_equal(
            mine.drop(columns=without, errors="ignore"), other.drop(columns=without, errors="ignore"), check_exact=True
        )


class TestNumbersOfTheBatch:
    @pytest.mark.parametrize("memory", [0, 2])
    def test_of_the_records_that_it_remembers(self, series, records, noise, memory):
        _, found = run(series, noise=noise, memory=memory)
        assert len(found) == N_RECORD
        for number, one in enumerate(found):
            some = records.isel(record=slice(max(number - memory, 0), number + 1))
            batch = brs.fit(some, SCAN, noise=noise, seed=SEED, campaign="off")
            same(one, batch, -1)
            assert one.n_fitted == 1

    def test_of_all_records_where_nothing_is_learnt_from_others(self, series, records, noise_of_one_length):
        batch = brs.fit(records, SCAN, noise=noise_of_one_length, seed=SEED, campaign="off", **NOTHING_POOLED)
        for memory in (0, 1):
            _, found = run(series, noise=noise_of_one_length, memory=memory, **NOTHING_POOLED)
            for number, one in enumerate(found):
                same(one, batch, number)

    def test_what_is_learnt_from_others_counts(self, series, noise):
        """The tests above would be blind if it did not."""
        _, alone = run(series, noise=noise, memory=0)
        _, beside = run(series, noise=noise, memory=3)
        assert not np.array_equal(alone[-1].summary()["mean"], beside[-1].summary()["mean"])

    def test_whatever_the_size_of_the_chunks(self, series, noise_of_one_length):
        _, one = run(series, size=97, noise=noise_of_one_length)
        _, other = run(series, size=10**6, noise=noise_of_one_length)
        for number, (a, b) in enumerate(zip(one, other, strict=True)):
            same(a, b, 0)
            assert a.records["time"].values == series["time"].values[0] + number * np.timedelta64(600, "s")

    def test_records_are_those_of_make_records(self, series, records, noise_of_one_length):
        _, found = run(series, noise=noise_of_one_length)
        for number, one in enumerate(found):
            for name in ("variance", "mean", "count", "flag", "wind_speed", "yaw", "octave_variance"):
                assert one.records[name].values.tobytes() == records[name].values[[number]].tobytes()

    def test_a_settings_object_says_the_same_as_options(self, series, tmp_path):
        settings = brs.Settings().changed(seed=SEED, prior="flat", duration=300.0)
        settings.save(tmp_path / "live.toml")
        half = brs.noise.calibrate(SCAN, FLOW, wind_speed=10.0, duration=300.0)
        some = series.isel(sample=slice(0, 1300))
        found = []
        for given, options in (
            (settings, {}),
            (tmp_path / "live.toml", {}),
            (None, {"seed": SEED, "prior": "flat", "duration": 300.0}),
        ):
            stream = brs.Stream(SCAN, given, noise=half, **options)
            found.append([*stream.add(some), *stream.close()])
        assert len(found[0]) == 3
        for other in found[1:]:
            same(other[0], found[0][0], 0)


class TestSlidingWindow:
    def test_one_closes_every_so_often(self, series, noise_of_one_length):
        some = series.isel(sample=slice(0, 2000))  # 1000 s
        stream, found = run(some, noise=noise_of_one_length, every=100.0, **NOTHING_POOLED)
        assert len(found) == 5  # from 0, 100, ... 400 s
        moved = some.assign_coords(time=some["time"] - np.timedelta64(300, "s"))
        records = brs.make_records(moved, SCAN).isel(record=[1])
        records = records.assign_coords(time=records["time"] + np.timedelta64(300, "s"))
        own = {name: value for name, value in NOTHING_POOLED.items() if name != "turbulence"}
        same(found[3], brs.fit(records, SCAN, noise=stream.noise, seed=SEED, **own), 0)


class TestSeveralRanges:
    """Each range has the numbers of a fit of its records alone, and those that are not there hold nothing up."""

    def test_numbers_are_those_of_the_batch(self, ranged, run_of_ranges):
        stream, found, _ = run_of_ranges
        records = brs.make_records(ranged, SCAN)
        assert len(found) == records.sizes["record"] == 3
        assert list(stream.noise) == list(RANGES)
        for number, one in enumerate(found):
            assert isinstance(one, RangedFit)
            for distance in RANGES:
                some = brs.records.at_range(records, distance).isel(record=slice(max(number - 1, 0), number + 1))
                seed = one.at(distance).run["settings"]["fit"]["seed"]
                assert seed == seed_of_range(SEED, distance)
                options = {"noise": stream.noise[distance], "campaign": "off", "sampler": "direct"}
                same(one.at(distance), brs.fit(some, SCAN, seed=seed, **options), -1)

    def test_records_are_those_of_make_records(self, ranged, run_of_ranges):
        records = brs.make_records(ranged, SCAN)
        for number, one in enumerate(run_of_ranges[1]):
            assert one.records.sizes["record"] == 1
            for name in ("variance", "mean", "count", "flag", "wind_speed", "yaw", "octave_variance"):
                assert one.records[name].values.tobytes() == records[name].values[:, [number]].tobytes()

    def test_together_they_are_a_fit_at_several_ranges(self, run_of_ranges):
        one = run_of_ranges[1][0]
        assert one.profile()["range"].unique().tolist() == list(RANGES)
        assert one.summary()["range"].unique().tolist() == list(RANGES)
        assert one.n_fitted == 2

    def test_each_range_has_noise_of_its_own(self, run_of_ranges):
        stream, _, lines = run_of_ranges
        assert [line.split(":")[0] for line in lines] == ["range 60 m", "range 120 m"]
        assert stream.noise[60.0].scan_geometry["focus_distance"] == [60.0, 60.0]
        assert stream.noise[120.0].scan_geometry["focus_distance"] == [120.0, 120.0]

    def test_noise_that_another_stream_has_made_is_taken(self, ranged, run_of_ranges):
        before, found, _ = run_of_ranges
        lines = []
        stream = brs.Stream(
            SCAN, seed=SEED, turbulence=FLOW, memory=1, sampler="direct", noise=before.noise, say=lines.append
        )
        first = stream.add(ranged)[0]
        assert lines == []
        for distance in RANGES:
            same(first.at(distance), found[0].at(distance), 0)

    def test_a_range_without_wind_does_not_hold_up_the_others(self, ranged, run_of_ranges):
        still = ranged["radial_velocity"].copy()
        still.values[ranged["range"].values == RANGES[1]] = np.nan
        stream = brs.Stream(SCAN, seed=SEED, turbulence=FLOW, memory=1, sampler="direct")
        found = stream.add(ranged.assign(radial_velocity=still))
        assert len(found) == 2
        assert list(stream.noise) == [RANGES[0]]
        assert list(found[0].fits) == [0]
        same(found[0].at(RANGES[0]), run_of_ranges[1][0].at(RANGES[0]), 0)

    def test_of_a_sliding_window(self, ranged, run_of_ranges):
        stream = brs.Stream(
            SCAN, seed=SEED, turbulence=FLOW, memory=0, sampler="direct", noise=run_of_ranges[0].noise, every=300.0
        )
        found = stream.add(ranged.isel(sample=slice(0, 4400)))  # 1100 s
        assert [one.time[0] for one in found] == [ranged["time"].values[0], ranged["time"].values[0] + 300 * SECOND]
        records = brs.make_records(ranged, SCAN)
        assert found[0].records["variance"].values.tobytes() == records["variance"].values[:, :1].tobytes()


class TestNoise:
    def test_is_made_once_for_later_winds_and_kept(self, series):
        lines = []
        stream = brs.Stream(SCAN, seed=SEED, turbulence=FLOW, say=lines.append)
        assert stream.noise is None
        fits = [fit for piece in pieces(series, 700) for fit in stream.add(piece)]
        assert len(fits) == N_RECORD - 1
        assert len(lines) == 1
        assert stream.noise.wind_speed.min() <= 3.0
        assert stream.noise.wind_speed.max() >= 25.0
        assert np.rad2deg(np.ptp(stream.noise.yaw)) >= 40.0
        assert all("outside_noise" not in fit.summary()["flag"].iloc[0] for fit in fits)

    def test_of_all_length_scales_where_they_are_the_records_own(self, series):
        stream = brs.Stream(SCAN, seed=SEED)
        stream.add(series.isel(sample=slice(0, 1300)))
        assert stream.noise.length_scale.min() == pytest.approx(10.0)
        assert stream.noise.length_scale.max() == pytest.approx(320.0)

    def test_a_record_beyond_is_flagged(self, series, noise_of_one_length):
        fast = series.assign(radial_velocity=3.0 * series["radial_velocity"])
        _, found = run(fast.isel(sample=slice(0, 1300)), noise=noise_of_one_length)
        assert "outside_noise" in found[0].summary()["flag"].iloc[0]

    def test_records_wait_for_the_first_wind(self, series):
        still = series["radial_velocity"].copy()
        still.values[:1200] = np.nan
        stream = brs.Stream(SCAN, seed=SEED, turbulence=FLOW)
        some = series.assign(radial_velocity=still)
        assert stream.add(some.isel(sample=slice(0, 1300))) == []
        first, second = stream.add(some.isel(sample=slice(1300, 2500)))
        assert (first.n_fitted, second.n_fitted) == (0, 1)

    def test_without_any_wind_there_is_none(self, series):
        stream = brs.Stream(SCAN, seed=SEED)
        stream.add(series.isel(sample=slice(0, 600)).assign(radial_velocity=("sample", np.full(600, np.nan))))
        with pytest.raises(InputError, match="none of 1 records has a wind speed and direction"):
            stream.close()


class TestWork:
    """By counts: a record is made, looked at and sampled once, however long the stream has run."""

    def test_of_each_record(self, series, noise_of_one_length, monkeypatch):
        calls = {"draw": 0, "sorted": []}
        draw = LogRatioPrior.draw

        def counted(self, *args):
            calls["draw"] += 1
            return draw(self, *args)

        monkeypatch.setattr(LogRatioPrior, "draw", counted)
        from bayes_rs.records import making  # noqa: PLC0415 - its function is counted

        made = making.sort_samples

        def looked_at(chunk, *args):
            calls["sorted"].append(chunk.sizes["sample"])
            return made(chunk, *args)

        monkeypatch.setattr(making, "sort_samples", looked_at)
        run(series, noise=noise_of_one_length, memory=1)
        assert calls["draw"] == 1  # of the prior, for all records together
        # every sample once; one of the next record with each; and once what an empty record is
        assert sum(size for size in calls["sorted"] if size > 2) == series.sizes["sample"]
        assert len([size for size in calls["sorted"] if size <= 2]) <= N_RECORD + 1


class TestKept:
    """By counts: what is the same for records that follow each other is not calculated again."""

    @staticmethod
    def counted(monkeypatch, where, name):
        calls, function = [], getattr(where, name)

        def counting(*args, **options):
            calls.append(args)
            return function(*args, **options)

        monkeypatch.setattr(where, name, counting)
        return calls

    def test_no_record_is_made_of_the_window_that_is_open(self, series, noise_of_one_length, monkeypatch):
        calls = self.counted(monkeypatch, record_stream, "make_records")
        run(series, noise=noise_of_one_length)
        assert len(calls) == N_RECORD

    def test_what_the_octaves_of_a_record_say_is_calculated_once(self, series, noise, monkeypatch):
        pooled_noise._kept_density.cache_clear()
        calls = self.counted(monkeypatch, pooled_noise, "_density")
        run(series, noise=noise, memory=3)
        assert len(calls) == N_RECORD

    def test_the_noise_of_a_record_is_found_once_to_look_at_beams_and_once_to_fit(self, series, noise, monkeypatch):
        calls = self.counted(monkeypatch, type(noise), "for_records")
        run(series, noise=noise, memory=0)
        assert len(calls) == 2 * N_RECORD  # for its three length scales together

    def test_libraries_are_looked_for_once(self, series, noise_of_one_length, monkeypatch):
        processor._libraries.cache_clear()
        calls = self.counted(monkeypatch, processor, "ThreadpoolController")
        run(series, noise=noise_of_one_length)
        assert len(calls) == 1

    def test_key_of_a_scan(self, monkeypatch):
        scan = brs.load_scan(SCAN)
        calls = self.counted(monkeypatch, type(scan), "geometry")
        assert scan.key == scan.select(scan.beam).key
        assert len(calls) == 1


class TestRefused:
    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"campaign": "on"}, "A stream learns no campaign"),
            ({"campaign_group": "hour"}, "A stream learns no campaign"),
            ({"motion": "tilt.csv"}, "motion is not used in a stream"),
            ({"mast": "cup.csv", "mast_position": (0.0, 0.0, 0.0)}, "mast is not used in a stream"),
            ({"mast_log_sd": 0.3}, "The option mast_log_sd is only used with a mast beside the beams"),
            ({"memory": -1}, "memory"),
            ({"every": 70.0}, "Invalid every 70.0 s"),
            ({"lateness": -1.0}, "lateness"),
            ({"priors": "flat"}, "Unknown option 'priors'"),
            ({"duration": 300.0}, "records last 300 s and the noise is for records of 600 s"),
            ({"settings": 3}, "Invalid settings 3"),
        ],
    )
    def test_what_a_stream_cannot_do(self, noise_of_one_length, options, words):
        with pytest.raises(InputError, match=words):
            brs.Stream(SCAN, noise=noise_of_one_length, **options)

    def test_noise_of_another_scan(self, noise_of_one_length):
        with pytest.raises(brs.NoiseMismatchError):
            brs.Stream("2-beam@opening_angle_deg=30", noise=noise_of_one_length)

    def test_a_sample_that_is_too_late(self, series, noise_of_one_length):
        stream = brs.Stream(SCAN, seed=SEED, noise=noise_of_one_length)
        stream.add(series.isel(sample=slice(0, 1300)))
        with pytest.raises(InputError, match="came too late"):
            stream.add(series.isel(sample=slice(0, 10)))

    def test_one_noise_for_several_ranges(self, ranged, noise_of_one_length):
        with pytest.raises(InputError, match="of one range, and these samples are of 2: give a mapping of each range"):
            brs.Stream(SCAN, noise=noise_of_one_length).add(ranged)

    def test_noises_of_ranges_for_samples_without(self, series, noise_of_one_length):
        with pytest.raises(InputError, match="noise is of several ranges, and these samples have none"):
            brs.Stream(SCAN, noise={60.0: noise_of_one_length}).add(series)

    def test_samples_with_and_without_ranges(self, series, ranged):
        stream = brs.Stream(SCAN, seed=SEED, turbulence=FLOW)
        stream.add(ranged.isel(sample=slice(0, 100)))
        with pytest.raises(InputError, match="samples have no range, and those before have a range"):
            stream.add(series.isel(sample=slice(100, 200)))
        stream.add(ranged.isel(sample=slice(100, 200)))  # nothing of the others was taken

    def test_a_range_that_the_first_samples_do_not_have(self, ranged):
        stream = brs.Stream(SCAN, seed=SEED, turbulence=FLOW)
        near = ranged["range"].values == RANGES[0]
        stream.add(ranged.isel(sample=np.flatnonzero(near)[:100]))
        with pytest.raises(InputError, match="Unknown range 120 m in the series"):
            stream.add(ranged.isel(sample=np.flatnonzero(~near)[:100]))


def test_a_fit_of_a_stream_draws_and_tells(series, noise_of_one_length):
    _, found = run(series.isel(sample=slice(0, 1300)), noise=noise_of_one_length)
    assert isinstance(found[0], brs.Fit)
    assert isinstance(found[0].to_arviz()["posterior"], xr.Dataset | xr.DataTree)
    figure = brs.plot.corner(found[0], 0)
    assert len(figure.axes) == 21
