"""Folders, patterns, bad files among good ones, and streams."""

from __future__ import annotations

import itertools
import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from format_files import compress, long_frame, series_of, wide_frame, write_hpl
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ray_files import six_beam

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.readers import read, stream
from bayes_rs.readers.folders import find_files
from bayes_rs.records.making import make_records

SIX = six_beam(45.0, step=1.0)


def report_of(series: xr.Dataset) -> dict:
    return json.loads(series.attrs["read_report"])


def split(series: xr.Dataset, n_part: int) -> list[xr.Dataset]:
    edges = np.linspace(0, series.sizes["sample"], n_part + 1).astype(int)
    return [series.isel(sample=slice(low, high)) for low, high in itertools.pairwise(edges)]


@pytest.fixture(scope="module")
def day() -> xr.Dataset:
    return series_of(SIX, n_scan=400)


@pytest.fixture
def folder(tmp_path, day) -> Path:
    """A folder as campaigns leave it: files in folders, compressed ones, hidden, temporary and foreign ones."""
    for number, part in enumerate(split(day, 6)):
        month = tmp_path / f"month{number // 3}"
        month.mkdir(exist_ok=True)
        file = month / f"part{number}.csv"
        long_frame(part).to_csv(file, index=False)
        if number == 4:
            compress(file, ".gz")
            file.unlink()
    for name in (".hidden.csv", "~$part.csv", "part.csv~", "part.csv.tmp", "part.csv.part", "notes.pdf", "README"):
        (tmp_path / name).write_text("no table")
    hidden = tmp_path / ".cache"
    hidden.mkdir()
    (hidden / "part.csv").write_text("no table")
    return tmp_path


class TestFolders:
    def test_folder(self, folder, day):
        series = read(folder, SIX)
        assert series.sizes["sample"] == day.sizes["sample"]
        assert json.loads(series.attrs["source_files"]) == [
            "part0.csv", "part1.csv", "part2.csv", "part3.csv", "part4.csv.gz", "part5.csv",
        ]  # fmt: skip
        assert report_of(series)["files_passed_over"] == {"hidden": 2, "temporary": 4, "other_suffix": 2}

    def test_folders_that_a_run_left_unfinished_are_passed_over(self, tmp_path, day):
        long_frame(day).to_csv(tmp_path / "day.csv", index=False)
        for name in ("out.partial-x1y2", "out.replaced-x1y2"):
            (tmp_path / name / "records").mkdir(parents=True)
            (tmp_path / name / "records" / "part-000000.nc").write_text("half")
        found = find_files(tmp_path, (".csv", ".nc"))
        assert [path.name for path in found.paths] == ["day.csv"]
        assert found.passed_over == {"hidden": 0, "temporary": 2, "other_suffix": 0}
        named = tmp_path / "out.partial-x1y2" / "records"
        assert len(find_files(named, (".nc",)).paths) == 1  # named itself, it is meant

    @pytest.mark.parametrize(
        ("pattern", "n_file"), [("month?/part*.csv", 5), ("**/part[0-2].csv", 3), ("month1/*.csv.*", 1)]
    )
    def test_patterns(self, folder, pattern, n_file):
        series = read(str(folder / pattern), SIX)
        assert len(json.loads(series.attrs["source_files"])) == n_file

    def test_no_file_twice(self, folder):
        files = [folder / "month0", folder / "month0" / "part1.csv", str(folder / "month0" / "*.csv")]
        assert len(find_files(files, (".csv",)).paths) == 3

    def test_a_file_whose_name_looks_like_a_pattern(self, tmp_path, day):
        file = tmp_path / "part[1].csv"
        long_frame(day).to_csv(file, index=False)
        assert read(file, SIX).sizes == day.sizes

    def test_pattern_without_a_match(self, tmp_path):
        with pytest.raises(InputError, match=r"Pattern '.*\*.csv' matches no file: check the path and the pattern"):
            read(str(tmp_path / "*.csv"), SIX)

    def test_folder_without_a_readable_file(self, tmp_path):
        (tmp_path / "a.doc").touch()
        with pytest.raises(
            InputError, match=r"has no file that can be read: its files are 0 hidden, .* 1 with another"
        ):
            read(tmp_path, SIX)

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
    def test_a_pipe_is_no_file(self, tmp_path):
        """Opening one would wait for ever."""
        os.mkfifo(tmp_path / "a.csv")
        with pytest.raises(InputError, match="does not exist"):
            read(tmp_path / "a.csv", SIX)


class TestBadFiles:
    @pytest.fixture
    def files(self, folder) -> Path:
        (folder / "month1" / "part3.csv").write_text("time,beam,radial_velocity\n2024-03-01T10:00:00,0,fast\n")
        (folder / "month1" / "part5.csv").write_bytes(b"")
        return folder

    def test_error(self, files):
        with pytest.raises(InputError, match=r"part3\.csv"):
            read(files, SIX)

    def test_skip(self, files):
        series = read(files, SIX, on_bad_file="skip")
        assert len(json.loads(series.attrs["source_files"])) == 4
        skipped = report_of(series)["files_skipped"]
        assert [entry["name"] for entry in skipped] == ["part3.csv", "part5.csv"]
        assert "Invalid radial_velocity 'fast'" in skipped[0]["reason"]
        assert "is empty" in skipped[1]["reason"]

    def test_a_missing_file_is_never_skipped(self, files):
        with pytest.raises(InputError, match="does not exist"):
            read([files, files / "part9.csv"], SIX, on_bad_file="skip")

    def test_all_bad(self, tmp_path):
        (tmp_path / "a.csv").touch()
        (tmp_path / "b.csv").touch()
        message = r"None of 2 files could be read; the first: File '.*a.csv' is empty"
        with pytest.raises(InputError, match=message):
            read(tmp_path, SIX, on_bad_file="skip")
        with pytest.raises(InputError, match=message):
            list(stream(tmp_path, SIX, on_bad_file="skip"))

    def test_a_wrong_option_is_not_a_bad_file(self, files):
        with pytest.raises(InputError, match="Unknown positive 'up'"):
            read(files, SIX, on_bad_file="skip", positive="up")

    def test_stream(self, files):
        parts = list(stream(files, SIX, on_bad_file="skip", chunk_rows=200))
        skipped = [entry["name"] for part in parts for entry in report_of(part)["files_skipped"]]
        assert sorted(skipped) == ["part3.csv", "part5.csv"]


def assert_streams_to(parts: list[xr.Dataset], whole: xr.Dataset) -> None:
    """Law: the series of a stream, put together, are the series read whole; their counts add up."""
    last = None
    for part in parts:
        assert part.sizes["sample"] > 0
        times = part["time"].values
        assert (np.diff(times) >= np.timedelta64(0, "ns")).all()
        assert last is None or times[0] >= last
        last = times[-1]
        assert set(part.attrs) == set(whole.attrs)
    for name in whole.variables:
        np.testing.assert_array_equal(np.concatenate([part[name].values for part in parts]), whole[name].values)
    wanted, got = report_of(whole), [report_of(part) for part in parts]
    for key, value in wanted.items():
        if isinstance(value, int):
            assert sum(report[key] for report in got) == value, key
    assert set().union(*(report["beams_present"] for report in got)) == set(wanted["beams_present"])


class TestStream:
    @pytest.mark.parametrize("chunk_rows", [7, 100, 1000, 10**6])
    @pytest.mark.parametrize("period", [None, 60.0])
    def test_is_the_series_read_whole(self, folder, chunk_rows, period):
        parts = list(stream(folder, SIX, chunk_rows=chunk_rows, period=period))
        assert_streams_to(parts, read(folder, SIX))
        assert (len(parts) > 1) == (chunk_rows < 1200)
        if period:
            for one, two in itertools.pairwise(parts):
                minute = two["time"].values[0].astype("datetime64[m]")
                assert one["time"].values[-1] < minute

    @pytest.mark.parametrize("kind", [".csv", ".parquet", ".nc", ".hpl"])
    def test_of_every_kind(self, tmp_path, day, kind):
        for number, part in enumerate(split(day, 3)):
            file = tmp_path / f"{number}{kind}"
            if kind == ".csv":
                long_frame(part).to_csv(file, index=False)
            elif kind == ".parquet":
                long_frame(part).to_parquet(file, row_group_size=100)
            elif kind == ".nc":
                part.to_netcdf(file)
            else:
                write_hpl(file, part, SIX)
        parts = list(stream(tmp_path, SIX, chunk_rows=300))
        assert len(parts) > 1
        assert_streams_to(parts, read(tmp_path, SIX))

    def test_wide(self, tmp_path):
        scan = replace(SIX, beam_time=np.zeros(6))
        wide_frame(series_of(scan, n_scan=200)).to_csv(tmp_path / "a.csv", index=False)
        assert_streams_to(
            list(stream(tmp_path / "a.csv", scan, chunk_rows=20)),
            read(tmp_path / "a.csv", scan),
        )

    def test_one_file_per_beam(self, tmp_path, day):
        """All files overlap from end to end."""
        for beam in range(6):
            long_frame(day.isel(sample=day["beam"].values == beam)).to_csv(tmp_path / f"{beam}.csv", index=False)
        parts = list(stream(tmp_path, SIX, chunk_rows=50))
        assert len(parts) > 5
        assert_streams_to(parts, read(tmp_path, SIX))

    def test_files_that_overlap_with_repeated_samples(self, tmp_path, day):
        long_frame(day.isel(sample=slice(0, 1500))).to_csv(tmp_path / "b.csv", index=False)
        long_frame(day.isel(sample=slice(1200, 2400))).to_csv(tmp_path / "a.csv", index=False)
        whole = read(tmp_path, SIX)
        assert report_of(whole)["duplicates_dropped"] == 300
        assert_streams_to(list(stream(tmp_path, SIX, chunk_rows=70)), whole)

    def test_records_are_those_of_the_whole(self, folder):
        """With the period of the records no record is torn."""
        scan = SIX
        whole = make_records(read(folder, scan), scan, duration=60.0)
        parts = list(stream(folder, scan, chunk_rows=500, period=60.0))
        assert len(parts) > 2
        joined = xr.concat([make_records(part, scan, duration=60.0) for part in parts], "record", combine_attrs="drop")
        for name in ("variance", "mean", "count", "flag"):
            np.testing.assert_allclose(joined[name], whole[name], rtol=1e-12)

    def test_beams_slightly_out_of_order(self, tmp_path, day):
        """Rows of one beam after the other within each scan, as some instruments write them, cross the borders."""
        frame = long_frame(day)
        frame["scan"] = np.arange(len(frame)) // 30
        frame = frame.sort_values(["scan", "beam", "time"]).drop(columns="scan")
        frame.to_csv(tmp_path / "a.csv", index=False)
        parts = list(stream(tmp_path / "a.csv", SIX, chunk_rows=100))
        assert len(parts) > 5
        assert_streams_to(parts, read(tmp_path / "a.csv", SIX))

    def test_a_file_sorted_by_beam(self, tmp_path, day):
        long_frame(day).sort_values(["beam", "time"]).to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=r"Time goes backwards in line 402 .*give a larger chunk_rows"):
            list(stream(tmp_path / "a.csv", SIX, chunk_rows=100))
        whole = read(tmp_path / "a.csv", SIX)
        assert_streams_to(list(stream(tmp_path / "a.csv", SIX, chunk_rows=10_000)), whole)

    @pytest.mark.parametrize("chunk_rows", [2, 100])
    def test_time_backwards_across_a_border(self, tmp_path, chunk_rows):
        times = ["10:00:00", "10:00:02", "10:00:01"]
        (tmp_path / "a.csv").write_text(
            "time,beam,radial_velocity\n" + "".join(f"2024-03-01T{time},0,1\n" for time in times)
        )
        with pytest.raises(InputError, match=r"Time goes backwards in line 4 of file .*a.csv': beam 0 at .*10:00:01Z"):
            list(stream(tmp_path / "a.csv", SIX, chunk_rows=chunk_rows))
        series = list(stream(tmp_path / "a.csv", SIX, chunk_rows=chunk_rows, out_of_order="sort"))
        assert sum(report_of(part)["samples_out_of_order"] for part in series) == 1

    def test_rows_without_a_time(self, tmp_path):
        rows = [",0,1", ",0,1", "2024-03-01T10:00:00,0,1", ",0,2"]
        (tmp_path / "a.csv").write_text("time,beam,radial_velocity\n" + "\n".join(rows))
        parts = list(stream(tmp_path / "a.csv", SIX, chunk_rows=1))
        assert_streams_to(parts, read(tmp_path / "a.csv", SIX))
        (tmp_path / "b.csv").write_text("time,beam,radial_velocity\n,0,1\n,0,1\n")
        with pytest.raises(InputError, match=r"has no sample with a time and a beam \(2 rows were read\)"):
            list(stream(tmp_path / "b.csv", SIX, chunk_rows=1))

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"chunk_rows": 0}, "Invalid chunk_rows 0: it must be a whole number of at least 1."),
            ({"period": -1.0}, "Invalid period -1.0 s"),
            ({"period": 1e-12}, "Invalid period 1e-12 s: it must be from 0.01 to 2.6784e+06 s"),
            ({"file_format": "excel"}, "Unknown file_format 'excel'"),
        ],
    )
    def test_options_are_checked_before_a_file_is_read(self, tmp_path, options, message):
        with pytest.raises(InputError, match=re.escape(message)):
            stream(tmp_path, SIX, **options)

    @settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(st.data())
    def test_law(self, tmp_path, data):
        """However the samples stand in files, and however many rows are read at a time."""
        staring = load_scan("4-beam")
        n_sample = data.draw(st.integers(1, 60))
        seconds = np.sort(np.array(data.draw(st.lists(st.integers(0, 400), min_size=n_sample, max_size=n_sample))))
        beams = np.array(data.draw(st.lists(st.integers(0, 3), min_size=n_sample, max_size=n_sample)))
        n_file = data.draw(st.integers(1, 4))
        of_file = np.array(data.draw(st.lists(st.integers(0, n_file - 1), min_size=n_sample, max_size=n_sample)))
        files = []
        for number in np.unique(of_file):
            rows = [
                f"{np.datetime64('2024-03-01T10:00:00') + np.timedelta64(int(second), 's')},{beam},{second % 7}.5\n"
                for second, beam in zip(seconds[of_file == number], beams[of_file == number], strict=True)
            ]
            files.append(tmp_path / f"{number}.csv")
            files[-1].write_text("time,beam,radial_velocity\n" + "".join(rows))
        chunk_rows = data.draw(st.integers(1, 30))
        period = data.draw(st.none() | st.sampled_from([1.0, 60.0, 600.0]))
        parts = list(stream(files, staring, chunk_rows=chunk_rows, period=period))
        assert_streams_to(parts, read(files, staring))
