"""Impossible data are not believed: fill values nobody declared, wrong units, clocks that were not set."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import netCDF4
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from format_files import long_frame, series_of, wide_frame, write_hpl, write_spinnerlidar, write_zx
from ray_files import e_windlidar, rays_of, six_beam, windcube_sweep, write_windcube
from scenes import plain_noise, records_of

import bayes_rs as brs
from bayes_rs.cli.group import commands
from bayes_rs.errors import InputError
from bayes_rs.fits.flags import FAILURES, FLAGS
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.quality.belief import Impossible, is_mark, of_unset_clock
from bayes_rs.readers import read, stream
from bayes_rs.records import stream_records
from bayes_rs.records.belief import believed, doubt_lines
from bayes_rs.records.flags import BEAM_FLAGS
from bayes_rs.records.making import make_records
from bayes_rs.records.windows import record_windows
from bayes_rs.wind.motion import read_motion

SIX = six_beam(45.0, step=1.0)
TOGETHER = replace(SIX, beam_time=np.zeros(6))
"""The six beams at once, as a wide table needs them."""
HUB = load_scan("6-beam", opening_angle_deg=45.0)
ZX = load_scan("zx-tm")
SPIN = load_scan("spinnerlidar")
FOUR = load_scan("4-beam")
OF_ZX = {
    "columns": {"time": "When", "phase": "Scan angle", "radial_velocity": "LOS"},
    "time_format": "%d/%m/%Y %H:%M:%S.%f",
    "phase_zero_deg": 90.0,
    "phase_turns": "down",
}
DEFAULT_FILL = netCDF4.default_fillvals["f8"]


def write_rays(file, series, kind):
    rays = rays_of(series, SIX, rough=False)
    if kind == "windcube":
        sweep = windcube_sweep(rays)
        return write_windcube(file, sweep.assign(radial_wind_speed_status=xr.ones_like(sweep["radial_wind_speed"])))
    e_windlidar(rays, time="units").to_netcdf(file, engine="h5netcdf")
    return file


def to(method, **options):
    def write(file, series):
        getattr(long_frame(series), method)(file, **options)
        return file

    return write


def write_wide(file, series):
    wide_frame(series).to_csv(file, index=False)
    return file


def write_netcdf(file, series):
    series.to_netcdf(file)
    return file


READERS = {
    "long": (SIX, "a.csv", to("to_csv", index=False), {}),
    "parquet": (SIX, "a.parquet", to("to_parquet"), {}),
    "wide": (TOGETHER, "a.csv", write_wide, {}),
    "netcdf": (SIX, "a.nc", write_netcdf, {}),
    "halo": (SIX, "a.hpl", lambda file, series: write_hpl(file, series, SIX), {}),
    "windcube": (SIX, "a.nc", lambda file, series: write_rays(file, series, "windcube"), {}),
    "e-windlidar": (SIX, "a.nc", lambda file, series: write_rays(file, series, "e-windlidar"), {}),
    "spinnerlidar": (SPIN, "a.txt", lambda file, series: write_spinnerlidar(file, series, SPIN), {}),
    "zx": (ZX, "a.csv", lambda file, series: write_zx(file, series, ZX), OF_ZX),
}
"""By reader: a scan, the name of a file, what writes it, and how it is read."""
CLOCKED = [name for name in READERS if name not in ("halo", "wide", "spinnerlidar")]
"""Readers of files that write the time of each sample alone, and do not tell beams by it."""


def scene(name, n_scan=60):
    scan, file_name, write, options = READERS[name]
    n_scan = 3 if name == "spinnerlidar" else n_scan
    return scan, file_name, write, options, series_of(scan, n_scan=n_scan)


def with_velocity(series, chosen, values):
    velocity = series["radial_velocity"].values.copy()
    velocity[chosen] = values
    return series.assign(radial_velocity=("sample", velocity))


def some_of(series, share=0.02, seed=2):
    """A share of the samples, none of which is missing; at least three."""
    there = np.flatnonzero(np.isfinite(series["radial_velocity"].values))
    return np.random.default_rng(seed).choice(there, max(3, int(share * len(there))), replace=False)


def report_of(dataset, name="read_report"):
    return json.loads(dataset.attrs[name])


def run(*words):
    return CliRunner().invoke(commands, [str(word) for word in words])


class TestFillValuesNobodyDeclared:
    @pytest.mark.parametrize("fill", [-9999.0, 999.0, -99.0, 99999.0, 1e20, DEFAULT_FILL])
    @pytest.mark.parametrize("name", READERS)
    def test_they_count_as_missing_in_every_reader(self, tmp_path, name, fill):
        """Exactly what NaN in their place gives; the most frequent is named as it stands in the file."""
        scan, file_name, write, options, series = scene(name)
        if (name, fill) == ("zx", -9999.0):
            fill = -9985.0  # ZX's own marks are declared by its reader
        chosen = some_of(series)
        (tmp_path / "one").mkdir()
        (tmp_path / "other").mkdir()
        got = read(write(tmp_path / "one" / file_name, with_velocity(series, chosen, fill)), scan, **options)
        wanted = read(write(tmp_path / "other" / file_name, with_velocity(series, chosen, np.nan)), scan, **options)
        xr.testing.assert_equal(got, wanted)
        assert report_of(got)["velocities_impossible"] == len(chosen)
        sign = -1.0 if name in ("spinnerlidar", "zx") else 1.0
        (told,) = report_of(got)["files"][0]["impossible_values"].items()
        assert float(told[0]) == sign * fill
        assert told[1] == len(chosen)
        (line,) = doubt_lines(got)
        assert f"--invalid {told[0]}" in line
        assert doubt_lines(wanted) == []
        declared = read(tmp_path / "one" / file_name, scan, **options, invalid=float(told[0]))
        xr.testing.assert_equal(declared, wanted)
        assert doubt_lines(declared) == []

    @pytest.mark.parametrize("name", READERS)
    def test_infinity_is_no_number_and_missing_in_every_reader(self, tmp_path, name):
        scan, file_name, write, options, series = scene(name)
        chosen, read_back = some_of(series), []
        for value in (np.inf, np.nan):
            (tmp_path / str(value)).mkdir()
            read_back.append(
                read(write(tmp_path / str(value) / file_name, with_velocity(series, chosen, value)), scan, **options)
            )
        xr.testing.assert_equal(*read_back)
        assert doubt_lines(read_back[0]) == []

    @pytest.mark.usefixtures("no_pictures")
    def test_the_command_says_so_and_ends_with_1(self, tmp_path):
        series = series_of(HUB, n_scan=700)
        file = tmp_path / "a.csv"
        long_frame(with_velocity(series, some_of(series), -9999.0)).to_csv(file, index=False)
        plain_noise(HUB).save(tmp_path / "noise.nc")
        words = (file, "--scan", "6-beam@opening_angle_deg=45")
        doubtful = run("records", *words, "-o", tmp_path / "a.nc")
        assert doubtful.exit_code == 1, doubtful.output
        assert "the most frequent is -9999 (83 times)" in doubtful.output
        assert "--invalid -9999" in doubtful.output
        declared = run("records", *words, "--invalid", "-9999", "-o", tmp_path / "b.nc")
        assert declared.exit_code == 0, declared.output
        one, other = (xr.load_dataset(tmp_path / name) for name in ("a.nc", "b.nc"))
        xr.testing.assert_equal(one, other)
        assert other["variance"].values.max() < 10.0
        fitted = run("fit", *words, "--noise", tmp_path / "noise.nc", "--draws", "none", "-o", tmp_path / "fit")
        assert fitted.exit_code == 1, fitted.output
        found = brs.open_fit(tmp_path / "fit")
        assert len(found.failures) == 1
        assert "the most frequent is -9999" in found.failures[0]
        assert fitted.stderr.splitlines()[-1] == found.failures[0]

    def test_a_stream_of_small_pieces_tells_the_same(self, tmp_path):
        series = series_of(SIX, n_scan=700)
        spoilt = with_velocity(series, some_of(series), -9999.0)
        file = to("to_csv", index=False)(tmp_path / "a.csv", spoilt)
        whole = read(file, SIX)
        pieces = list(stream(file, SIX, chunk_rows=500))
        assert len(pieces) > 4
        xr.testing.assert_equal(xr.concat([piece.drop_attrs() for piece in pieces], "sample"), whole.drop_attrs())
        assert sum(report_of(piece)["velocities_impossible"] for piece in pieces) == 83

    def test_the_status_declares_them(self, tmp_path):
        """What the instrument rejects itself is no doubt, whatever stands there."""
        series = series_of(SIX, n_scan=60)
        chosen = some_of(series)
        status = np.ones(series.sizes["sample"])
        status[chosen] = 0.0
        frame = long_frame(with_velocity(series, chosen, 9999.0)).assign(status=status)
        frame.to_csv(tmp_path / "a.csv", index=False)
        got = read(tmp_path / "a.csv", SIX, status_valid=1)
        records = make_records(got, SIX)
        assert doubt_lines(got) == doubt_lines(records) == []
        assert report_of(records, "records_report")["dropped"]["status"] == len(chosen)
        assert records["variance"].values.max() < 10.0

    @pytest.mark.parametrize("unit", ["km/h", "knot", "cm/s"])
    def test_named_as_in_the_file_whatever_its_unit(self, tmp_path, unit):
        rows = [f"2024-01-01T00:00:{second:02d}Z,0,{-9999 if second % 3 else 8}\n" for second in range(60)]
        (tmp_path / "a.csv").write_text("time,beam,radial_velocity\n" + "".join(rows))
        got = read(tmp_path / "a.csv", FOUR, velocity_unit=unit, positive="towards", velocity_limit=60.0)
        assert report_of(got)["files"][0]["impossible_values"] == {"-9999": 40}

    def test_sound_data_raise_no_doubt(self, tmp_path):
        for name in READERS:
            scan, file_name, write, options, series = scene(name)
            (tmp_path / name).mkdir()
            got = read(write(tmp_path / name / file_name, series), scan, **options)
            assert doubt_lines(got) == [], name
            assert np.isfinite(got["radial_velocity"].values).sum() == np.isfinite(series["radial_velocity"]).sum()


class TestSeriesOfAUser:
    def test_make_records_does_not_believe_them(self):
        series = series_of(SIX, n_scan=1300)
        chosen = some_of(series)
        got = make_records(with_velocity(series, chosen, 1e20), SIX)
        wanted = make_records(with_velocity(series, chosen, np.nan), SIX)
        xr.testing.assert_equal(got, wanted)
        assert report_of(got, "records_report")["dropped"]["impossible"] == len(chosen)
        (line,) = doubt_lines(got)
        assert line.startswith(f"{len(chosen)} of {series.sizes['sample']} samples are beyond 90 m/s")
        assert line in brs.records.describe_report(got)

    def test_in_chunks_as_in_one(self):
        series = series_of(SIX, n_scan=2600)
        spoilt = with_velocity(series, some_of(series.isel(sample=slice(9000, None)), seed=3) + 9000, -999.0)
        whole = make_records(spoilt, SIX)
        chunks = [spoilt.isel(sample=slice(first, first + 1000)) for first in range(0, spoilt.sizes["sample"], 1000)]
        got = stream_records(chunks, SIX)
        xr.testing.assert_equal(got, whole)
        assert doubt_lines(got) == doubt_lines(whole) != []

    def test_a_limit_of_its_own(self):
        series = with_velocity(series_of(SIX, n_scan=700), slice(0, 3), 95.0)
        assert doubt_lines(make_records(series, SIX)) != []
        kept = make_records(series.assign_attrs(velocity_limit=100.0), SIX)
        (line,) = doubt_lines(kept)  # they are believed, and lie far outside the others
        assert "(3 of 4157) lie far outside the others of their beam (spikes" in line
        assert kept.attrs["velocity_limit"] == 100.0

    def test_a_variance_that_no_atmosphere_has_is_flagged(self):
        """Each velocity may be; a beam that jumps between plus and minus 60 m/s may not."""
        series = series_of(SIX, n_scan=700)
        velocity = np.where(series["beam"] == 2, 60.0 * (-1.0) ** np.arange(series.sizes["sample"]), 0.0)
        jumps = velocity + series["radial_velocity"].values * (series["beam"].values != 2)
        sign = np.where(np.arange(series.sizes["sample"]) // 6 % 2, 1.0, -1.0)
        jumps = np.where(series["beam"] == 2, 60.0 * sign, jumps)
        records = make_records(series.assign(radial_velocity=("sample", jumps)), SIX)
        flagged = (records["flag"].values & BEAM_FLAGS["impossible"]) != 0
        assert flagged[:, 2].all()
        assert not np.delete(flagged, 2, axis=1).any()
        assert np.nanmax(np.abs(records["wind_speed"])) < 30.0  # its mean is not in the wind
        assert "larger than any atmosphere's" in doubt_lines(records)[0]


class TestUnits:
    @pytest.mark.parametrize("name", READERS)
    @pytest.mark.parametrize(("unit", "factor"), [("cm/s", 100.0), ("mm/s", 1000.0)])
    def test_a_unit_mistake_is_refused_with_the_unit(self, tmp_path, name, unit, factor):
        scan, file_name, write, options, series = scene(name)
        if name in ("halo", "windcube", "e-windlidar", "wide", "netcdf", "long", "parquet"):
            series = series.assign(radial_velocity=series["radial_velocity"] + 12.0)  # beams of 75° see little
        if name == "zx":
            series = series.assign(radial_velocity=series["radial_velocity"] + 2.0)  # 9.99 m/s would be a mark in mm/s
        file = write(tmp_path / file_name, series.assign(radial_velocity=factor * series["radial_velocity"]))
        hint = re.escape(f"velocity_unit='{unit}' (--velocity-unit {unit})")
        with pytest.raises(InputError, match=rf"holds radial velocities that no wind has: .*{hint}"):
            read(file, scan, **options)
        got = read(file, scan, **options, velocity_unit=unit)
        wanted = series.sortby(["time", "beam"])["radial_velocity"]
        np.testing.assert_allclose(got["radial_velocity"], wanted, rtol=0.0, atol=1e-4)  # four decimals in some files

    def test_a_stream_refuses_at_the_end_of_the_file(self, tmp_path):
        series = series_of(SIX, n_scan=700)
        spoilt = series.assign(radial_velocity=1000.0 * (series["radial_velocity"] + 12.0))
        file = to("to_csv", index=False)(tmp_path / "a.csv", spoilt)
        with pytest.raises(InputError, match="--velocity-unit mm/s"):
            list(stream(file, SIX, chunk_rows=500))

    def test_a_skipped_file_is_named(self, tmp_path):
        series = series_of(SIX, n_scan=100)
        to("to_csv", index=False)(tmp_path / "good.csv", series)
        late = series.assign_coords(time=series["time"] + np.timedelta64(1, "D"))
        to("to_csv", index=False)(tmp_path / "wrong.csv", late.assign(radial_velocity=1e3 * late["radial_velocity"]))
        got = read(tmp_path, SIX, on_bad_file="skip")
        (skipped,) = report_of(got)["files_skipped"]
        assert skipped["name"] == "wrong.csv"
        assert "--velocity-unit mm/s" in skipped["reason"]
        assert doubt_lines(got) == []

    def test_some_scattered_ones_are_missing(self, tmp_path):
        """Up to half of the values: bit errors, not a unit."""
        series = series_of(SIX, n_scan=100)
        chosen = some_of(series, share=0.4)
        values = np.random.default_rng(1).uniform(200.0, 9000.0, len(chosen))
        got = read(to("to_csv", index=False)(tmp_path / "a.csv", with_velocity(series, chosen, values)), SIX)
        assert report_of(got)["velocities_impossible"] == len(chosen)
        assert np.isnan(got["radial_velocity"]).sum() == len(chosen) + np.isnan(series["radial_velocity"]).sum()

    def test_one_value_in_most_rows_is_a_fill_value(self, tmp_path):
        series = series_of(SIX, n_scan=100)
        got = read(
            to("to_csv", index=False)(tmp_path / "a.csv", with_velocity(series, some_of(series, 0.9), 850.0)), SIX
        )
        assert np.isfinite(got["radial_velocity"]).sum() > 0

    def test_marks(self):
        for value in (-9999.0, 99.99, 999.9, 1e20, DEFAULT_FILL, float(np.float32(DEFAULT_FILL)), -32768.0, 2.0**31):
            assert is_mark(value)
        for value in (850.0, -1234.5, 99.5, 989.0):
            assert not is_mark(value)

    def test_the_count_of_different_values_is_bounded(self):
        found = Impossible()
        found.add(np.arange(1000.5, 50_000.0), 10)
        assert (found.count, len(found.values)) == (49_000, 10_000)
        with pytest.raises(InputError, match="49000 of 49010 are beyond 90 m/s"):
            found.check("It holds velocities", 90.0)


class TestClocksThatWereNotSet:
    @pytest.mark.parametrize("epoch", ["1970-01-01T00:00:02", "1980-01-06", "2000-01-01T03:00", "2106-02-07T06:28:15"])
    @pytest.mark.parametrize("name", CLOCKED)
    def test_rows_are_set_aside_with_their_line(self, tmp_path, name, epoch):
        scan, file_name, write, options, series = scene(name)
        n_early = 4
        time = series["time"].values.copy()
        early = np.datetime64(epoch, "ns") + np.arange(n_early) * np.timedelta64(1, "s")
        time[:n_early] = early
        file = write(tmp_path / file_name, series.assign_coords(time=("sample", time)))
        in_order = {"out_of_order": "sort"} if epoch.startswith("2106") else {}
        got = read(file, scan, **options, **in_order)
        wanted = series.isel(sample=slice(n_early, None)).sortby(["time", "beam"])
        late = np.abs(got["time"].values - wanted["time"].values)
        assert late.max() <= np.timedelta64(1, "us")
        np.testing.assert_array_equal(got["beam"], wanted["beam"])
        assert report_of(got)["rows_unset_clock"] == n_early
        (line,) = doubt_lines(got)
        assert f"{n_early} rows of file {file_name} have the time of a clock that was not set" in line
        assert re.search(rf"the first is (line|row|sample|ray) \d+, {epoch[:10]}", line)

    def test_rows_of_a_wide_table_count_once(self, tmp_path):
        frame = wide_frame(series_of(TOGETHER, n_scan=20))
        frame.loc[:1, "time"] = np.datetime64("1970-01-01") + np.arange(2) * np.timedelta64(1, "s")
        frame.to_csv(tmp_path / "a.csv", index=False)
        got = read(tmp_path / "a.csv", TOGETHER)
        assert got.sizes["sample"] == 18 * 6
        assert report_of(got)["rows_unset_clock"] == 2
        assert "the first is line 2, 1970-01-01T00:00:00Z" in doubt_lines(got)[0]

    def test_a_jump_ahead_and_back_is_no_error(self, tmp_path):
        """It was one: time goes backwards behind it."""
        series = series_of(SIX, n_scan=60)
        time = series["time"].values.copy()
        time[100] = np.datetime64("2106-02-07T06:28:15")
        file = to("to_csv", index=False)(tmp_path / "a.csv", series.assign_coords(time=("sample", time)))
        got = read(file, SIX)
        assert got.sizes["sample"] == series.sizes["sample"] - 1
        assert "the first is line 102, 2106-02-07T06:28:15Z" in doubt_lines(got)[0]

    @pytest.mark.parametrize("chunk_rows", [7, 50, 500])
    def test_pieces_do_not_matter(self, tmp_path, chunk_rows):
        series = series_of(SIX, n_scan=100)
        time = series["time"].values.copy()
        time[:60] = np.datetime64("1970-01-01") + np.arange(60) * np.timedelta64(1, "s")
        time[300] = np.datetime64("2000-01-01T00:00:07")
        file = to("to_csv", index=False)(tmp_path / "a.csv", series.assign_coords(time=("sample", time)))
        other = to("to_csv", index=False)(tmp_path / "b.csv", series.isel(sample=[0, 1]))
        whole = read([file, other], SIX)
        pieces = list(stream([file, other], SIX, chunk_rows=chunk_rows))
        xr.testing.assert_equal(xr.concat([piece.drop_attrs() for piece in pieces], "sample"), whole.drop_attrs())
        assert sum(report_of(piece)["rows_unset_clock"] for piece in pieces) == 61

    @pytest.mark.parametrize("start", ["2000-01-01T00:00", "1975-06-01T12:00", "2040-01-01T00:00"])
    def test_a_file_of_one_epoch_stays_as_it_is(self, tmp_path, start):
        series = series_of(SIX, n_scan=60, start=start)
        got = read(to("to_csv", index=False)(tmp_path / "a.csv", series), SIX)
        assert got.sizes["sample"] == series.sizes["sample"]
        assert doubt_lines(got) == []

    def test_a_series_that_runs_out_of_january_2000_stays_whole(self):
        time = np.datetime64("2000-01-20", "ns") + np.arange(60) * np.timedelta64(12, "h")
        assert not of_unset_clock(time).any()
        assert of_unset_clock(np.append(time, np.datetime64("2024-01-01", "ns"))).sum() == 0  # days of it are near
        alone = np.array(["2000-01-20", "2000-01-21", "2024-01-01"], dtype="datetime64[ns]")
        assert of_unset_clock(alone).tolist() == [True, True, False]

    def test_no_million_of_empty_records(self, tmp_path):
        """Another file was written before the clock was set: its records are named, and no empty ones lie between."""
        series = series_of(SIX, n_scan=700)
        unset = series_of(SIX, n_scan=700, start="1970-01-01T00:00:00")
        for name, one in (("a.csv", unset), ("b.csv", series)):
            to("to_csv", index=False)(tmp_path / name, one)
        read_whole = make_records(read(tmp_path, SIX), SIX)
        streamed = stream_records(stream(tmp_path, SIX, chunk_rows=1000), SIX)
        xr.testing.assert_equal(streamed, read_whole)
        starts = read_whole["time"].values
        assert len(starts) == 7 + 7
        for records in (read_whole, streamed):
            (line,) = doubt_lines(records)
            assert line.startswith("7 of 14 records are of a clock that was not set, the first of 1970-01-01T00:00:00Z")
            gaps = [text for text in brs.records.describe_report(records) if text.startswith("gap: no records between")]
            assert len(gaps) == 1
            assert "1970-01-01T01:00:00Z and 2024-03-01T09:50:00Z" in gaps[0]


class TestGaps:
    @pytest.mark.parametrize("window", [600, 86_400, 40 * 86_400])
    def test_windows_against_a_loop(self, window):
        rng = np.random.default_rng(window)
        days = np.cumsum(rng.choice([0.001, 1.0, 29.0, 31.0, 90.0], 40))
        number = (days * 86_400).astype(np.int64) // window
        wanted = [int(number[0])]
        for one in np.unique(number)[1:].tolist():
            if (one - wanted[-1]) * window <= 30 * 86_400 or one - wanted[-1] <= 2:
                wanted += range(wanted[-1] + 1, one)
            wanted.append(one)
        got = record_windows(rng.permutation(number), window * 10**9, 3)
        assert got.tolist() == wanted

    def test_a_gap_of_29_days_holds_empty_records_and_one_of_31_none(self):
        series = series_of(SIX, n_scan=700)
        for days, more in ((29, 29 * 144 - 7), (31, 0)):
            late = series.assign_coords(time=series["time"] + np.timedelta64(days, "D"))
            records = make_records(xr.concat([series, late], "sample"), SIX)
            assert records.sizes["record"] == 14 + more
            chunked = stream_records([series, late], SIX)
            xr.testing.assert_equal(chunked, records)


def times_from(start, minutes):
    series = series_of(HUB, n_scan=60 * minutes, start=start)
    return series.assign(radial_velocity=series["radial_velocity"].fillna(-3.0))


class TestRecordsThatTheDataOnlyTouch:
    def cut_off(self, records):
        return ((records["flag"].values & BEAM_FLAGS["cut_off"]) != 0).all(axis=1).tolist()

    def test_first_and_last_are_no_failures(self):
        records = make_records(times_from("2024-03-01T09:53:00", 34), HUB)
        assert records.sizes["record"] == 4
        assert self.cut_off(records) == [True, False, False, True]
        found = brs.fit(records, HUB, seed=1, noise=plain_noise(HUB), target_ess=50)
        assert found.failures == []
        assert found.n_fitted == 2
        assert found.flags["cut_off"] == 2
        assert FLAGS["cut_off"] & FAILURES == 0

    def test_enough_samples_are_fitted(self):
        records = make_records(times_from("2024-03-01T09:51:00", 29), HUB)
        assert self.cut_off(records) == [False, False, False]
        assert not records["flag"].any()

    def test_a_bad_record_in_the_middle_stays_a_failure(self):
        series = times_from("2024-03-01T09:50:00", 30)
        minute = (series["time"].values - np.datetime64("2024-03-01T09:50")) / np.timedelta64(1, "m")
        records = make_records(series.isel(sample=np.flatnonzero((minute < 10) | (minute > 13))), HUB)
        assert self.cut_off(records) == [False, False, False]
        bad = make_records(series.isel(sample=np.flatnonzero((minute < 10) | (minute > 15))), HUB)
        assert self.cut_off(bad) == [False, False, False]
        found = brs.fit(bad, HUB, seed=1, noise=plain_noise(HUB), target_ess=50)
        assert [line.split(";")[0] for line in found.failures] == ["record 1 (2024-03-01T10:00): no_usable_beam"]

    def test_bad_samples_in_a_whole_first_record_are_a_failure(self):
        series = times_from("2024-03-01T09:50:00", 20)
        bad = series["time"].values < np.datetime64("2024-03-01T09:56")
        records = make_records(with_velocity(series, np.flatnonzero(bad)[60:], np.nan), HUB)
        assert records["flag"].values[0, 0] == BEAM_FLAGS["too_few_samples"]

    def test_both_sides_of_a_gap(self):
        first, second = times_from("2024-03-01T09:50:00", 24), times_from("2024-03-01T11:03:00", 17)
        records = make_records(xr.concat([first, second], "sample"), HUB)
        cut = np.flatnonzero(self.cut_off(records))
        assert records["time"].values[cut].astype("datetime64[m]").astype(str).tolist() == [
            "2024-03-01T10:10",
            "2024-03-01T11:00",
        ]

    @pytest.mark.parametrize("size", [2000, 9000])
    def test_in_chunks_as_in_one(self, size):
        first, second = times_from("2024-03-01T09:53:00", 24), times_from("2024-03-01T11:03:00", 24)
        series = xr.concat([first, second], "sample")
        chunks = [series.isel(sample=slice(at, at + size)) for at in range(0, series.sizes["sample"], size)]
        got, wanted = stream_records(chunks, HUB), make_records(series, HUB)
        xr.testing.assert_equal(got, wanted)
        assert sum(self.cut_off(got)) == 4

    def test_a_pause_at_the_start_of_a_record_is_no_beginning_however_the_series_is_cut(self):
        """A block of a stream that begins with this record does not know that there are samples before it."""
        series = times_from("2024-03-01T09:50:00", 40)
        minute = (series["time"].values - np.datetime64("2024-03-01T09:50")) / np.timedelta64(1, "m")
        series = series.isel(sample=np.flatnonzero((minute < 10) | (minute > 15)))
        chunks = [series.isel(sample=slice(at, at + 100)) for at in range(0, series.sizes["sample"], 100)]
        got, wanted = stream_records(chunks, HUB, lateness=0.0), make_records(series, HUB)
        xr.testing.assert_equal(got, wanted)
        assert self.cut_off(got) == [False] * 4
        assert (got["flag"].values[1] == BEAM_FLAGS["too_few_samples"]).all()


class TestRecordsOfAUser:
    def records(self, n_record=40):
        rng = np.random.default_rng(1)
        return records_of(rng.uniform(0.5, 2.0, (n_record, 6)), HUB)

    def test_sound_ones_are_the_same_object(self):
        records = self.records()
        assert believed(records) is records

    @pytest.mark.parametrize("value", [9999.0, -9999.0, 1e6, 1e20, DEFAULT_FILL])
    @pytest.mark.usefixtures("short_campaign")
    def test_variances(self, value):
        records = self.records()
        records["variance"].values[3, 2] = value
        wanted = self.records()
        wanted["flag"].values[3, 2] = 1
        # a campaign takes most of the time, and one value is enough for it
        options = {"noise": plain_noise(HUB), "target_ess": 50, "campaign": "auto" if value == 1e20 else "off"}
        got, other = (brs.fit(one, HUB, seed=1, **options) for one in (records, wanted))
        pd.testing.assert_frame_equal(got.summary(), other.summary())
        assert got.failures[0].startswith("1 of 240 variances of the records are beyond 900 m² s⁻²")
        assert got.failures[1:] == other.failures
        assert all(line.startswith("campaign: its chains fell short") for line in other.failures)
        assert records["flag"].values[3, 2] == 0  # the user's own are not changed

    @pytest.mark.parametrize("name", ["wind_speed", "yaw"])
    @pytest.mark.parametrize("value", [9999.0, -999.0, 1e20])
    def test_winds(self, name, value):
        records = self.records()
        records[name].values[5] = value
        found = brs.fit(records, HUB, seed=1, noise=plain_noise(HUB), target_ess=50, campaign="off")
        assert not found.fitted[5]
        assert found.n_fitted == 39
        assert "which no atmosphere has" in found.failures[0]

    @pytest.mark.parametrize("value", [9999.0, 1e20, np.inf])
    def test_stresses_of_a_mast(self, value):
        """Where it is added, and in records that hold it."""
        records = self.records(3)
        table = pd.DataFrame({"time": records["time"].values, "uu": [1.0, 1.2, 9999.0], "vv": 0.8})
        found = brs.wind.with_mast(records, table, position=(0, 0, 0))
        np.testing.assert_array_equal(found["mast_stress"].values[:, 0], [1.0, 1.2, np.nan])
        line = "1 of 6 mast's stresses of the records are beyond 900 m² s⁻², which no atmosphere has, and are not used"
        assert [one[: len(line)] for one in doubt_lines(found)] == [line]
        held = brs.wind.with_mast(records, table[:2], position=(0, 0, 0))
        held["mast_stress"].values[2, :2] = value, 0.8
        fits = [
            brs.fit(one, HUB, seed=1, noise=plain_noise(HUB), target_ess=50, campaign="off") for one in (found, held)
        ]
        pd.testing.assert_frame_equal(fits[0].summary(), fits[1].summary())
        assert all(fit.failures[0].startswith(line) for fit in fits)

    @pytest.mark.parametrize(
        ("factor", "words"),
        [
            (1e4, "The records hold mast's stresses that no wind has: 15 of 15 are beyond 900"),
            (1e6, "15 of 15 are beyond"),
        ],
    )
    def test_a_mast_in_another_unit_is_refused(self, factor, words):
        records = self.records(5)
        stress = factor * np.random.default_rng(2).uniform(1.0, 2.0, (5, 3))
        table = pd.DataFrame({"time": records["time"].values, **dict(zip(("uu", "vv", "ww"), stress.T, strict=True))})
        with pytest.raises(InputError, match=f"{words}.*; check their unit"):
            brs.wind.with_mast(records, table, position=(0, 0, 0))

    def test_what_was_told_before_is_told_beside(self):
        records = self.records(3)
        records["variance"].values[0, 0] = 9999.0
        table = pd.DataFrame({"time": records["time"].values, "uu": [1.0, 1.2, 9999.0]})
        found = brs.wind.with_mast(believed(records), table, position=(0, 0, 0))
        assert len(doubt_lines(found)) == 2
        again = brs.wind.with_mast(found, table[:2], position=(0, 0, 0))
        assert len(doubt_lines(again)) == 1
        assert "mast" not in doubt_lines(again)[0]

    def test_the_noise_that_is_made_does_not_see_them(self):
        records = self.records(3)
        records["wind_speed"].values[:] = [9.0, 9999.0, 11.0]
        noise = brs.noise.calibrate(HUB, "fu-2022", records=records)
        assert noise.wind_speed.max() < 100.0

    @pytest.mark.parametrize(("name", "factor"), [("variance", 1e4), ("wind_speed", 100.0)])
    def test_another_unit_is_refused(self, name, factor):
        records = self.records()
        records[name].values[:] = factor * np.random.default_rng(2).uniform(1.0, 2.0, records[name].shape)
        with pytest.raises(InputError, match=r"The records hold .* that no wind has: .*; check their unit"):
            brs.fit(records, HUB, seed=1, noise=plain_noise(HUB))

    @pytest.mark.usefixtures("no_pictures")
    def test_files_of_records(self, tmp_path):
        brs.save_scan(HUB, tmp_path / "six.toml")
        for number in range(2):
            records = self.records(6).assign_attrs(scan_key=load_scan(tmp_path / "six.toml").key)
            records["variance"].values[:2, number] = -9999.0
            records = records.assign_coords(time=records["time"] + np.timedelta64(number, "D"))
            records.to_netcdf(tmp_path / f"{number}.nc", engine="h5netcdf")
        files = (tmp_path / "0.nc", tmp_path / "1.nc")
        plain_noise(load_scan(tmp_path / "six.toml")).save(tmp_path / "noise.nc")
        words = ("--scan", tmp_path / "six.toml", "--noise", tmp_path / "noise.nc", "--ess", "50", "--draws", "none")
        done = run("fit", *files, *words, "-o", tmp_path / "fit")
        assert done.exit_code == 1, done.output
        assert "4 of 72 variances of the records are beyond 900 m² s⁻²" in done.stderr
        assert "the most frequent is -9999 (4 times)" in done.stderr


MASKS = {
    "range of floats": ("f4", {"valid_range": np.array([-5.0, 5.0], "f4")}, {}),
    "least": ("f8", {"valid_min": -4.0}, {}),
    "most": ("f8", {"valid_max": 4.0}, {}),
    "packed limits": ("i2", {"valid_min": np.int16(-400), "valid_max": np.int16(400)}, {"scale_factor": 0.01}),
    "packed, negative scale": ("i2", {"valid_range": np.array([-300, 500], "i2")}, {"scale_factor": -0.01}),
    "default of floats": ("f4", {}, {}),
    "default of integers": ("i2", {}, {"scale_factor": 0.001}),  # −32.767 m/s: the limit of speed is no help
    "missing value": ("f8", {"missing_value": 3.5}, {}),
    "fill value": ("i2", {}, {"scale_factor": 0.01, "_FillValue": np.int16(350)}),
}


def velocities_in_netcdf4(file, kind, velocity):
    """Write velocities with the attributes of a mask; return what the NetCDF library itself does not mask."""
    stored, attributes, encoding = MASKS[kind]
    with netCDF4.Dataset(file, "w") as dataset:
        dataset.createDimension("sample", len(velocity))
        fill = encoding.get("_FillValue")
        variable = dataset.createVariable("radial_velocity", stored, ("sample",), fill_value=fill)
        variable.setncatts(attributes)
        variable.setncatts({name: value for name, value in encoding.items() if name != "_FillValue"})
        variable.set_auto_maskandscale(False)
        raw = velocity / encoding.get("scale_factor", 1.0)
        raw = np.round(raw).astype(stored) if stored.startswith("i") else raw.astype(stored)
        raw[7::10] = netCDF4.default_fillvals[stored] if kind.startswith("default") else raw[7::10]
        variable[:] = raw
        time = dataset.createVariable("time", "f8", ("sample",))
        time.units, time[:] = "seconds since 2024-01-01", np.arange(len(velocity), dtype=float)
        dataset.createVariable("beam", "i4", ("sample",))[:] = 0
    with netCDF4.Dataset(file) as dataset:
        return np.ma.filled(dataset["radial_velocity"][:].astype(float), np.nan)


class TestWhatNetcdfSaysItself:
    @pytest.mark.parametrize("kind", MASKS)
    def test_as_the_netcdf_library_masks_it(self, tmp_path, kind):
        velocity = np.round(np.random.default_rng(4).normal(0.0, 3.0, 200), 2)
        velocity[::20] = 3.5
        wanted = velocities_in_netcdf4(tmp_path / "a.nc", kind, velocity)
        assert 0 < np.isnan(wanted).sum() < 150
        got = read(tmp_path / "a.nc", FOUR)["radial_velocity"].values
        np.testing.assert_allclose(got, wanted, rtol=1e-6)

    @pytest.mark.parametrize("name", ["azimuth", "elevation", "range", "cnr", "radial_wind_speed"])
    def test_every_variable_of_rays(self, tmp_path, name):
        """Out of its range an angle or a distance is of no beam, a CNR and a velocity are missing."""
        series = series_of(SIX, n_scan=20)
        sweep = windcube_sweep(rays_of(series, SIX, rough=False))
        sweep = sweep.assign(radial_wind_speed_status=xr.ones_like(sweep["radial_wind_speed"]))
        bad = sweep[name].copy()
        bad.values[10] = 500.0
        bad.attrs |= {"valid_min": -100.0, "valid_max": 400.0}
        nan = sweep[name].copy()
        nan.values[10] = np.nan
        got, wanted = (
            read(write_windcube(tmp_path / f"{label}.nc", sweep.assign({name: one})), SIX)
            for label, one in (("got", bad), ("wanted", nan))
        )
        xr.testing.assert_equal(got, wanted)

    def test_times_of_rays(self, tmp_path):
        series = series_of(SIX, n_scan=20)
        sweep = windcube_sweep(rays_of(series, SIX, rough=False))
        time = sweep["time"].values.copy()
        time[10] = -1e9
        attributes = {**sweep["time"].attrs, "valid_min": 0.0}
        bad = sweep.assign_coords(time=("time", time, attributes))
        got = read(write_windcube(tmp_path / "a.nc", bad), SIX)
        assert report_of(got)["rows_without_time"] == 1
        assert doubt_lines(got) == []


class TestMotion:
    @pytest.mark.parametrize(("name", "value"), [("tilt_deg", "9999"), ("roll_deg", "-999"), ("velocity_x", "99999")])
    def test_impossible_entries_are_refused_with_the_option(self, tmp_path, name, value):
        file = tmp_path / "m.csv"
        file.write_text(f"t,x\n2024-01-01T00:00:00,1.0\n2024-01-01T00:00:01,{value}\n")
        columns = {"time": "t", name: "x"}
        with pytest.raises(InputError, match=rf"Invalid {name} {value} in column 'x', line 3 .*\(--invalid {value}\)"):
            read_motion(file, columns=columns)
        assert np.isnan(read_motion(file, columns=columns, invalid=[float(value)])[name].values[1])
