"""Reading radial velocities: the same series from every format, and one clear line for every kind of bad file."""

from __future__ import annotations

import contextlib
import gzip
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.options import options_of
from bayes_rs.readers import READERS, FileOptions, read, stream
from bayes_rs.readers.format import resolve_format
from bayes_rs.records.making import make_records

LAST_DIGIT = 4 * np.finfo(float).eps  # decimal text to binary: pandas may be off by a unit in the last place
LAST_DECIMAL = 2e-16  # m/s: pandas 2.2 drops what is behind the 17th decimal place; it was off by 1.1e-16 at most
SCAN = load_scan("4-beam")
HEAD = "time,beam,radial_velocity\n"
ROWS = ["2020-09-03T19:00:00Z,0,-8.5", "2020-09-03T19:00:00Z,1,-7.5", "2020-09-03T19:00:01Z,0,-8.25"]


def write(folder: Path, text: str, name: str = "day.csv", encoding: str = "utf-8") -> Path:
    file = folder / name
    file.write_bytes(text.encode(encoding))
    return file


def long_csv(folder: Path, *rows: str, head: str = HEAD, name: str = "day.csv") -> Path:
    return write(folder, head + "".join(f"{row}\n" for row in rows), name)


def long_frame(n_time: int = 40, seed: int = 1) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    time = pd.Timestamp("2020-09-03T19:00:00.25") + pd.to_timedelta(np.arange(n_time), unit="s")
    return pd.DataFrame(
        {
            "time": np.repeat(time, 3),
            "beam": np.tile([0, 1, 3], n_time),
            "radial_velocity": np.where(rng.random(3 * n_time) < 0.1, np.nan, rng.normal(-9.0, 1.0, 3 * n_time)),
            "cnr": rng.normal(-10.0, 3.0, 3 * n_time),
            "status": rng.integers(0, 2, 3 * n_time),
        }
    )


def assert_same(series: xr.Dataset, reference: xr.Dataset) -> None:
    assert list(series.variables) == list(reference.variables)
    np.testing.assert_array_equal(series["time"], reference["time"])
    np.testing.assert_array_equal(series["beam"], reference["beam"])
    for name in reference.data_vars:
        np.testing.assert_allclose(series[name], reference[name], rtol=LAST_DIGIT)


def report_of(series: xr.Dataset) -> dict:
    return json.loads(series.attrs["read_report"])


class TestEveryFormatGivesTheSameSeries:
    @pytest.fixture
    def reference(self) -> xr.Dataset:
        frame = long_frame()
        return xr.Dataset(
            {name: ("sample", frame[name].astype(float)) for name in ("radial_velocity", "cnr", "status")},
            coords={"time": ("sample", frame["time"].to_numpy("datetime64[ns]")), "beam": ("sample", frame["beam"])},
        )

    @pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet", ".nc"])
    def test_long(self, tmp_path, reference, suffix):
        frame, file = long_frame(), tmp_path / f"day{suffix}"
        if suffix == ".parquet":
            frame.to_parquet(file)
        elif suffix == ".nc":
            xr.Dataset.from_dataframe(frame.rename_axis("sample")).to_netcdf(file)
        else:
            frame.to_csv(file, index=False)
        assert_same(read(file, SCAN), reference)

    @pytest.mark.parametrize("suffix", [".csv", ".parquet"])
    @pytest.mark.parametrize("heading", ["{}", "vr_{}", "beam_{}"])
    def test_wide(self, tmp_path, reference, suffix, heading):
        frame = long_frame().pivot_table(
            index="time", columns="beam", values=["radial_velocity", "cnr", "status"], dropna=False
        )
        prefix = {"radial_velocity": heading, "cnr": "cnr_{}", "status": "status_{}"}
        frame.columns = [prefix[name].format(beam) for name, beam in frame.columns]
        file = tmp_path / f"day{suffix}"
        if suffix == ".parquet":
            frame.to_parquet(file)  # with time as its index
        else:
            frame.to_csv(file)
        assert_same(read(file, SCAN), reference)

    def test_wide_netcdf(self, tmp_path, reference):
        file = tmp_path / "day.nc"
        long_frame().set_index(["time", "beam"]).to_xarray().to_netcdf(file)
        assert_same(read(file, SCAN), reference)

    @pytest.mark.parametrize("suffix", [".csv", ".nc"])
    def test_marks_of_missing_entries_are_no_beams_and_no_statuses(self, tmp_path, suffix):
        file, frame = tmp_path / f"day{suffix}", long_frame()
        frame.loc[:5, "radial_velocity"] = [0.0, 1.0, 9999.0] * 2
        frame.loc[6, "status"] = 9999
        if suffix == ".csv":
            frame.loc[7, "beam"] = 9999
            frame.to_csv(file, index=False)
        else:
            xr.Dataset.from_dataframe(frame.rename_axis("sample")).to_netcdf(file)
        series = read(file, SCAN, invalid=[0, 1, 9999])
        kept = frame[frame["beam"] != 9999]
        np.testing.assert_array_equal(series["beam"], kept["beam"])
        np.testing.assert_array_equal(series["status"], kept["status"].where(kept["status"] != 9999))
        assert np.isnan(series["radial_velocity"][:6]).all()

    def test_marks_of_missing_entries_are_no_angles(self, tmp_path):
        rows = [f"2020-09-03T19:00:0{second}Z,0,62,100,5.5" for second in range(3)]
        file = long_csv(tmp_path, *rows, head="time,azimuth,elevation,distance,radial_velocity\n")
        rays = READERS["rays"].rays(file, resolve_format(FileOptions(invalid=0), None))
        assert np.isfinite(rays.direction).all()

    @pytest.mark.parametrize(
        ("name", "options", "match"),
        [("day.nc", {}, "times of format netcdf"), ("day.csv", {"time_format": "unix"}, "times of time_format unix")],
    )
    def test_a_zone_that_would_not_be_used_is_refused(self, tmp_path, name, options, match):
        file, frame = tmp_path / name, long_frame()
        if name == "day.nc":
            frame.set_index(["time", "beam"]).to_xarray().to_netcdf(file)
        else:
            frame.assign(time=frame["time"].astype("datetime64[ns]").astype("int64") / 1e9).to_csv(file, index=False)
        plain = read(file, SCAN, **options)
        assert_same(read(file, SCAN, time_zone="+00:00", **options), plain)
        with pytest.raises(
            InputError, match=rf"Invalid time_zone 'UTC\+1' for file .*{name}': {match} are taken for UTC"
        ):
            read(file, SCAN, time_zone="UTC+1", **options)
        of_scan = replace(SCAN, file_format={"time_zone": "UTC+1"})
        series = read(file, of_scan, **options)
        assert report_of(series)["files"][0]["time_zone"] == "UTC"
        assert (series["time"].values == plain["time"].values).all()

    def test_what_we_write_is_read_back(self, tmp_path):
        """Even with a scan whose own files count positive towards the lidar and name things otherwise."""
        scan, file = load_scan("pulsed-4-beam"), tmp_path / "day.nc"
        raw = long_csv(
            tmp_path, "2020-09-03T19:00:00Z,2,8.5,-5,1", head="Timestamp,LOSindex,RWS,CNR,RWSStatus\n", name="raw.csv"
        )
        series = read(raw, scan)
        assert series["radial_velocity"].values == [-8.5]
        series.to_netcdf(file)
        again = read(file, scan)
        assert_same(again, series)
        assert again.attrs["status_valid"] == 1

    def test_several_files_in_any_order(self, tmp_path, reference):
        frame = long_frame()
        files = []
        for number in (3, 0, 1):
            files.append(tmp_path / f"beam{number}.csv")
            frame[frame["beam"] == number].to_csv(files[-1], index=False)
        series = read(files, SCAN)
        assert_same(series, reference)
        assert json.loads(series.attrs["source_files"]) == ["beam3.csv", "beam0.csv", "beam1.csv"]
        assert report_of(series)["beams_absent"] == [2]
        assert report_of(series)["beams_present"] == [0, 1, 3]

    def test_attributes_survive_netcdf(self, tmp_path):
        series = read(long_csv(tmp_path, *ROWS), SCAN)
        series.to_netcdf(tmp_path / "series.nc")
        with xr.open_dataset(tmp_path / "series.nc") as again:
            assert again.attrs == series.attrs
        assert series.attrs["scan_key"] == SCAN.key


class TestOptions:
    def test_sign(self, tmp_path):
        file = long_csv(tmp_path, *ROWS)
        away, towards = (read(file, SCAN, positive=sign) for sign in ("away", "towards"))
        np.testing.assert_array_equal(away["radial_velocity"], -towards["radial_velocity"])
        assert away["radial_velocity"].values[0] == -8.5

    @pytest.mark.parametrize(
        ("unit", "metres"), [("m/s", 3600.0), ("km/h", 1000.0), ("knot", 1852.0), ("cm/s", 36.0), ("mm/s", 3.6)]
    )
    def test_unit(self, tmp_path, unit, metres):
        file = long_csv(tmp_path, "2020-09-03T19:00:00Z,0,3600")
        series = read(file, SCAN, velocity_unit=unit, velocity_limit=4000.0)
        np.testing.assert_allclose(series["radial_velocity"], [metres], rtol=LAST_DIGIT)

    def test_decimal_commas(self, tmp_path):
        text = "time;beam;radial_velocity;note\n2020-09-03T19:00:00,250Z;1;-8,5;a,b\n"
        series = read(write(tmp_path, text), SCAN, separator=";", decimal=",")
        assert series["radial_velocity"].values == [-8.5]
        assert series["time"].values == np.datetime64("2020-09-03T19:00:00.250")

    @pytest.mark.parametrize("mark", [",", "."])
    def test_decimal_commas_in_times_of_another_form(self, tmp_path, mark):
        text = "time;beam;radial_velocity\n03.09.2020 19:00:00,250;1;-8,5\n"
        form = f"%d.%m.%Y %H:%M:%S{mark}%f"
        series = read(write(tmp_path, text), SCAN, separator=";", decimal=",", time_format=form)
        assert series["time"].values == np.datetime64("2020-09-03T19:00:00.250")

    def test_tab(self, tmp_path):
        file = write(tmp_path, "\t".join(HEAD.split(",")) + ROWS[0].replace(",", "\t") + "\n")
        assert read(file, SCAN, separator="tab")["radial_velocity"].values == [-8.5]

    @pytest.mark.parametrize("zone", ["UTC+1", "UTC+01:00", "+01:00", "Etc/GMT-1"])
    def test_time_zone(self, tmp_path, zone):
        file = long_csv(tmp_path, "2020-09-03 19:00:00,0,-8.5")
        assert read(file, SCAN, time_zone=zone)["time"].values == np.datetime64("2020-09-03T18:00")
        assert read(file, SCAN)["time"].values == np.datetime64("2020-09-03T19:00")

    def test_an_offset_in_the_file_counts_before_the_option(self, tmp_path):
        rows = ["2020-09-03T19:00:00+02:00,0,1", "2020-09-03T20:00:00+0100,1,1", "2020-09-03T17:00:00Z,2,1"]
        rows.append("2020-09-03T22:00:00,3,1")
        series = read(long_csv(tmp_path, *rows), SCAN, time_zone="UTC+3")
        hours = (series.sortby("beam")["time"].values - np.datetime64("2020-09-03")) / np.timedelta64(1, "h")
        np.testing.assert_array_equal(hours, [17.0, 19.0, 17.0, 19.0])

    @pytest.mark.parametrize("zone", ["UTC+1", "Europe/Berlin"])
    def test_time_zone_of_parquet(self, tmp_path, zone):
        frame = long_frame(n_time=2)
        frame["time"] = frame["time"].dt.tz_localize(zone) if zone == "Europe/Berlin" else frame["time"]
        frame.to_parquet(tmp_path / "day.parquet")
        series = read(tmp_path / "day.parquet", SCAN, time_zone="UTC+1")
        hours = 2 if zone == "Europe/Berlin" else 1  # summer time
        assert series["time"].values[0] == np.datetime64("2020-09-03T19:00:00.250") - np.timedelta64(hours, "h")

    def test_invalid_value_in_any_column(self, tmp_path):
        rows = [
            "2020-09-03T19:00:00Z,0,9999,1",
            "2020-09-03T19:00:01Z,9999,-8,1",
            "9999,0,-8,1",
            "2020-09-03T19:00:02Z,0,-8,9999",
            "2020-09-03T19:00:03Z,0,-8,2",
        ]
        series = read(long_csv(tmp_path, *rows, head="time,beam,radial_velocity,cnr\n"), SCAN, invalid=9999)
        np.testing.assert_array_equal(series["radial_velocity"], [np.nan, -8.0, -8.0])
        np.testing.assert_array_equal(series["cnr"], [1.0, np.nan, 2.0])
        report = report_of(series)
        assert (report["rows"], report["rows_invalid_value"], report["rows_dropped"]) == (5, 4, 2)
        assert (report["rows_without_time"], report["rows_without_beam"]) == (1, 1)

    def test_columns_and_beam_numbers(self, tmp_path):
        file = long_csv(tmp_path, "2020-09-03T19:00:00Z,LOS2,1", head="Timestamp,LOS,RWS\n")
        columns = {"time": "Timestamp", "beam": "LOS", "radial_velocity": "RWS"}
        series = read(file, SCAN, columns=columns, beam_numbers={"LOS2": 3})
        assert series["beam"].values == [3]

    @pytest.mark.parametrize(
        "options", [{"columns": {"vr_2": "left"}}, {"columns": {"2": "left"}}, {"beam_numbers": {"left": 2}}]
    )
    def test_columns_of_a_wide_table(self, tmp_path, options):
        file = long_csv(tmp_path, "2020-09-03T19:00:00Z,1", head="time,left\n")
        assert read(file, SCAN, **options)["beam"].values == [2]

    def test_beam_numbers_match_labels_written_as_decimals(self, tmp_path):
        file = long_csv(tmp_path, "2020-09-03T19:00:00Z,2.0,1", "2020-09-03T19:00:00Z,03,1")
        assert read(file, SCAN)["beam"].values.tolist() == [2, 3]
        series = read(file, SCAN, beam_numbers={"2": 0, "3": 1})
        assert series["beam"].values.tolist() == [0, 1]

    def test_the_option_counts_before_the_scan(self, tmp_path):
        scan = load_scan("pulsed-4-beam")
        file = long_csv(tmp_path, "2020-09-03T19:00:00Z,2,8.5,7", head="Timestamp,LOSindex,RWS,speed\n")
        assert read(file, scan)["radial_velocity"].values == [-8.5]
        assert read(file, scan, positive="away")["radial_velocity"].values == [8.5]
        columns = {"radial_velocity": "speed"}
        assert read(file, scan, columns=columns)["radial_velocity"].values == [-7.0]

    def test_quality_stands_for_status(self, tmp_path):
        file = long_csv(tmp_path, "2020-09-03T19:00:00Z,2,8.5,7", head="time,beam,radial_velocity,quality\n")
        assert read(file, SCAN, status_valid=7)["status"].values == [7]

    def test_byte_order_mark_blank_line_and_spaces(self, tmp_path):
        text = "\ufefftime, beam , radial_velocity\r\n2020-09-03T19:00:00Z, 0 , -8.5\r\n\r\n2020-09-03T19:00:01Z,0,\r\n"
        series = read(write(tmp_path, text), SCAN)
        np.testing.assert_array_equal(series["radial_velocity"], [-8.5, np.nan])
        assert report_of(series)["rows_dropped"] == 1

    def test_units_in_a_netcdf_that_describes_itself(self, tmp_path):
        dataset = xr.Dataset.from_dataframe(long_frame(2).rename_axis("sample"))
        dataset["radial_velocity"].attrs = {"units": "km/h", "positive": "towards"}
        dataset.to_netcdf(tmp_path / "day.nc")
        series = read(tmp_path / "day.nc", SCAN)
        np.testing.assert_allclose(series["radial_velocity"], -dataset["radial_velocity"] / 3.6)
        dataset["radial_velocity"].attrs["units"] = "furlong"
        dataset.to_netcdf(tmp_path / "bad.nc")
        with pytest.raises(
            InputError,
            match=r"'radial_velocity' in file .*bad.nc' has the units 'furlong': a velocity must be in m/s, km/h",
        ):
            read(tmp_path / "bad.nc", SCAN)


class TestOrder:
    def test_backwards(self, tmp_path):
        file = long_csv(tmp_path, "2020-09-03T19:00:05Z,0,1", "2020-09-03T19:00:01Z,1,2", "2020-09-03T19:00:04Z,0,3")
        message = (
            f"Time goes backwards in line 4 of file {str(file)!r}: beam 0 at 2020-09-03T19:00:04Z comes after "
            "2020-09-03T19:00:05Z (line 2); check the time stamps, or give out_of_order='sort' "
            "(--out-of-order sort) to sort them."
        )
        with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
            read(file, SCAN)
        series = read(file, SCAN, out_of_order="sort")
        assert series["radial_velocity"].values.tolist() == [2.0, 3.0, 1.0]
        assert report_of(series)["samples_out_of_order"] == 1

    def test_repeated_rows(self, tmp_path):
        series = read(long_csv(tmp_path, *ROWS, ROWS[-1]), SCAN)
        assert_same(series, read(long_csv(tmp_path, *ROWS, name="b.csv"), SCAN))
        assert report_of(series)["duplicates_dropped"] == 1
        assert report_of(series)["duplicates_that_differ"] == 0

    def test_overlapping_files(self, tmp_path):
        one, two = long_csv(tmp_path, *ROWS[1:], name="1.csv"), long_csv(tmp_path, *ROWS[:2], name="2.csv")
        series = read([one, two], SCAN)
        assert series["radial_velocity"].values.tolist() == [-8.5, -7.5, -8.25]
        assert report_of(series)["duplicates_dropped"] == 1

    def test_a_velocity_is_kept_before_none(self, tmp_path):
        series = read(long_csv(tmp_path, "2020-09-03T19:00:00Z,0,", ROWS[0]), SCAN)
        assert series["radial_velocity"].values.tolist() == [-8.5]

    def test_two_velocities_at_one_time(self, tmp_path):
        """As when time stamps are rounded: dropping one in silence would lose data."""
        one, two = long_csv(tmp_path, ROWS[0], name="1.csv"), long_csv(tmp_path, "2020-09-03T19:00:00Z,0,-6")
        with pytest.raises(InputError, match=r"beam 0 at 2020-09-03T19:00:00Z differ: -8.5 m/s in line 2 .*-6 m/s in"):
            read([one, two], SCAN)
        with pytest.raises(InputError, match=r"differ: -8.5 m/s .*the files seem to be of several instruments"):
            read([one, two], SCAN, out_of_order="sort")
        (entry,) = (entry for entry in options_of(FileOptions) if entry.name == "out_of_order")
        assert "Two velocities of one beam at one time are refused either way" in entry.about.help


class TestBadInput:
    @pytest.mark.parametrize(
        ("rows", "message"),
        [
            (["2020-09-03T19:00:00Z,0,fast"], "Invalid radial_velocity 'fast' in column 'radial_velocity', line 2 of"),
            ([*ROWS, "2020-09-03T19:00:05Z,0,8,5"], "line 5 has 4 entries, and the headings 3; check the options"),
            (["2020-09-03T19:00:05Z,0,8,5"], "line 2 has 4 entries, and the headings 3"),
            (["", "yesterday,0,1"], "Invalid time 'yesterday' in column 'time', line 3 of"),
            (["2020,0,1"], "Invalid time '2020' in column 'time', line 2 of"),
            (["1599159600,0,1"], "Invalid time '1599159600' in column 'time', line 2 of"),
            (["2020-13-03T19:00:00Z,0,1"], "it must be a date and time in ISO 8601"),
            (["1020-12-03T19:00:00Z,0,1"], "Invalid time '1020-12-03T19:00:00Z'"),
            ([*ROWS, "2020-09-03T19:00:05Z,7,1"], "Unknown beam '7' in column 'beam', line 5 of"),
            (
                ["2020-09-03T19:00:05Z,left,1"],
                "the beams of scan '4-beam', 0, 1, 2, 3; map it with beam_num",
            ),
            (["2020-09-03T19:00:05Z,1.5,1"], "Unknown beam '1.5'"),
            ([], "has headings but no row"),
            ([",0,1"], "has no sample with a time and a beam (1 rows were read)"),
        ],
    )
    def test_lines(self, tmp_path, rows, message):
        file = long_csv(tmp_path, *rows)
        with pytest.raises(InputError, match=re.escape(message)) as caught:
            read(file, SCAN)
        assert str(file) in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_missing_file(self, tmp_path):
        with pytest.raises(InputError, match=r"File '.*nowhere.csv' does not exist: check its path"):
            read(tmp_path / "nowhere.csv", SCAN)

    def test_no_file(self):
        with pytest.raises(InputError, match="No file given"):
            read([], SCAN)

    def test_folder(self, tmp_path):
        with pytest.raises(InputError, match=r"Folder '.*' has no file that can be read: its files are 0 hidden"):
            read(tmp_path, SCAN)

    @pytest.mark.parametrize("name", ["day.csv", "day.parquet", "day.nc", "day.csv.gz"])
    def test_empty_file(self, tmp_path, name):
        with pytest.raises(InputError, match=r"is empty|cannot be read") as caught:
            read(write(tmp_path, "", name), SCAN)
        assert name in str(caught.value)

    @pytest.mark.parametrize("name", ["day.parquet", "day.nc", "day.csv.gz"])
    def test_damaged_file(self, tmp_path, name):
        with pytest.raises(InputError, match=r"cannot be read.*check that it is complete and not damaged"):
            read(write(tmp_path, HEAD + ROWS[0], name), SCAN)

    def test_truncated_gzip(self, tmp_path):
        file = tmp_path / "day.csv.gz"
        file.write_bytes(gzip.compress((HEAD + "\n".join(ROWS * 100)).encode())[:-30])
        with pytest.raises(InputError, match="cannot be read"):
            read(file, SCAN)

    @pytest.mark.parametrize("name", ["day.xlsx", "day", "day.gz"])
    def test_unknown_suffix(self, tmp_path, name):
        with pytest.raises(InputError, match=r"Unknown suffix '.*' of file .*: it must be one of .*\.csv, "):
            read(write(tmp_path, HEAD, name), SCAN)
        if name != "day.gz":
            series = read(write(tmp_path, HEAD + ROWS[0] + "\n", name), SCAN, file_format="long")
            assert series["radial_velocity"].values == [-8.5]

    @pytest.mark.parametrize("name", ["time", "beam", "radial_velocity"])
    def test_missing_column(self, tmp_path, name):
        file = long_csv(tmp_path, *ROWS, head=HEAD.replace(name, "other"))
        message = rf"has no column '{name}' for {name}: its columns are .*'other'.*with columns=\{{'{name}': "
        with pytest.raises(InputError, match=message):
            read(file, SCAN)

    def test_missing_column_of_the_scan(self, tmp_path):
        with pytest.raises(InputError, match="has no column 'RWS' for radial_velocity"):
            read(long_csv(tmp_path, *ROWS, head="Timestamp,LOSindex,v\n"), load_scan("pulsed-4-beam"))

    def test_missing_optional_column_that_was_asked_for(self, tmp_path):
        with pytest.raises(InputError, match="has no column 'snr' for cnr"):
            read(long_csv(tmp_path, *ROWS), SCAN, columns={"cnr": "snr"})

    @pytest.mark.parametrize("name", ["day.csv", "day.parquet", "day.nc", "wide.csv"])
    def test_a_status_that_is_not_there(self, tmp_path, name):
        """Nothing would be filtered, and nobody told."""
        file = tmp_path / name
        frame = long_frame(5)[["time", "beam", "radial_velocity"]]
        if name == "wide.csv":
            frame = frame.pivot_table(index="time", columns="beam", values="radial_velocity").reset_index()
        if name == "day.nc":
            read(long_csv(tmp_path, *ROWS, name="other.csv"), SCAN).to_netcdf(file, engine="h5netcdf")
        else:
            frame.to_parquet(file) if name == "day.parquet" else frame.to_csv(file, index=False)
        read(file, SCAN)
        message = rf"File '{re.escape(str(file))}' has no status, which status_valid=1 is about: say .*status=HEADING"
        with pytest.raises(InputError, match=message):
            read(file, SCAN, status_valid=1)
        with pytest.raises(InputError, match=message):
            next(iter(stream(file, SCAN, period=600.0, status_valid=1)))

    def test_a_table_that_is_to_be_netcdf(self, tmp_path):
        file = long_csv(tmp_path, *ROWS)
        message = (
            f"File {str(file)!r} cannot be read as NetCDF: it has no header of such a file; check that it is complete "
            "and not damaged."
        )
        with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
            read(file, SCAN, file_format="windcube")

    @pytest.mark.parametrize(("separator", "word"), [(";", "';'"), ("\t", "'tab'")])
    def test_wrong_separator(self, tmp_path, separator, word):
        file = write(tmp_path, (HEAD + ROWS[0]).replace(",", separator))
        with pytest.raises(InputError, match=f"is neither a long table .* nor a wide one .*then give separator={word}"):
            read(file, SCAN)

    def test_text_among_decimal_commas(self, tmp_path):
        text = HEAD.replace(",", ";") + "2020-09-03T19:00:00Z;1;-8,5\n2020-09-03T19:00:01Z;1;x\n"
        with pytest.raises(InputError, match="Invalid radial_velocity 'x' in column 'radial_velocity', line 3"):
            read(write(tmp_path, text), SCAN, separator=";", decimal=",")

    def test_same_heading_twice(self, tmp_path):
        file = long_csv(tmp_path, ROWS[0] + ",1", head="time,beam,radial_velocity,radial_velocity\n")
        with pytest.raises(InputError, match="has 2 columns 'radial_velocity'"):
            read(file, SCAN)

    def test_wide_without_beams(self, tmp_path):
        file = long_csv(tmp_path, "2020-09-03T19:00:00Z,1", head="time,left\n")
        with pytest.raises(InputError, match="has no column for a beam: its columns are 'time', 'left'"):
            read(file, SCAN, file_format="wide")

    def test_wide_without_time(self, tmp_path):
        with pytest.raises(InputError, match="has no column 'time' for time"):
            read(long_csv(tmp_path, "1,1", head="when,vr_1\n"), SCAN)

    def test_wide_with_unknown_beam(self, tmp_path):
        with pytest.raises(InputError, match="Unknown beam '7' in column 'vr_7' of file"):
            read(long_csv(tmp_path, "2020-09-03T19:00Z,1", head="time,vr_7\n"), SCAN)

    def test_wide_with_one_beam_twice(self, tmp_path):
        with pytest.raises(InputError, match="has two columns for radial_velocity of beam 1, 'vr_1' and 'beam_1'"):
            read(long_csv(tmp_path, "2020-09-03T19:00Z,1,2", head="time,vr_1,beam_1\n"), SCAN)

    def test_clock_change(self, tmp_path):
        file = long_csv(tmp_path, "2020-10-25T02:30:00,0,1")
        with pytest.raises(
            InputError, match=r"line 2 .* the clock change makes it twice or not at all a time in Europe"
        ):
            read(file, SCAN, time_zone="Europe/Berlin")

    def test_netcdf_without_a_variable(self, tmp_path):
        xr.Dataset.from_dataframe(long_frame(2).drop(columns="beam").rename_axis("sample")).to_netcdf(tmp_path / "a.nc")
        with pytest.raises(InputError, match=r"has no variable 'beam' for beam: its variables are .*'radial_velocity'"):
            read(tmp_path / "a.nc", SCAN)

    def test_records_are_no_radial_velocities(self, tmp_path):
        file = tmp_path / "records.nc"
        make_records(read(long_csv(tmp_path, *ROWS), SCAN), SCAN).to_netcdf(file, engine="h5netcdf")
        with pytest.raises(InputError, match="holds records, not radial velocities: give the files that the records"):
            read(file, SCAN)

    def test_netcdf_with_other_dimensions(self, tmp_path):
        dataset = xr.Dataset.from_dataframe(long_frame(2).rename_axis("sample"))
        dataset["cnr"] = ("other", [1.0, 2.0])
        dataset.to_netcdf(tmp_path / "a.nc")
        with pytest.raises(InputError, match=r"Variable 'cnr' in file .* has the dimensions \('other',\)"):
            read(tmp_path / "a.nc", SCAN)

    def test_files_that_differ_in_their_columns(self, tmp_path):
        one = long_csv(tmp_path, *ROWS, name="1.csv")
        two = long_csv(tmp_path, "2020-09-03T20:00:00Z,0,1,-5", head="time,beam,radial_velocity,cnr\n", name="2.csv")
        with pytest.raises(InputError, match=r"File '.*1.csv' has no cnr, but another of the files has"):
            read([one, two], SCAN)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"file_format": "excel"}, "Unknown file_format 'excel': it must be one of auto, "),
            ({"positive": "up"}, "Unknown positive 'up': it must be one of away, towards."),
            ({"velocity_unit": "mph"}, "Unknown velocity_unit 'mph': it must be one of m/s, km/h, knot, cm/s, mm/s."),
            ({"columns": {"velocity": "v"}}, "Unknown name 'velocity' in columns: it must be one of time, beam,"),
            ({"columns": "v"}, "Invalid columns 'v': it must be a mapping"),
            ({"beam_numbers": {"a": "b"}}, "Invalid beam_numbers entry 'a': 'b': it must be a whole number"),
            ({"invalid": "none"}, "Invalid entry of invalid 'none': it must be a finite number."),
            ({"time_zone": "Mars"}, "Unknown time_zone 'Mars': it must be a name such as UTC or Europe/Berlin"),
            ({"separator": ", "}, "Invalid separator ', ': it must be one character"),
            ({"decimal": ";"}, "Unknown decimal ';': it must be one of ., ,."),
            ({"decimal": ",", "separator": ","}, "Invalid separator ',': it is also the decimal sign"),
            ({"status_valid": "ok"}, "Invalid status_valid 'ok': it must be a finite number."),
            ({"out_of_order": "drop"}, "Unknown out_of_order 'drop': it must be one of error, sort."),
            ({"beam_numbers": {"0": 0}}, "Unknown beam '1' in column 'beam', line 3"),
        ],
    )
    def test_options(self, tmp_path, options, message):
        with pytest.raises(InputError, match=re.escape(message)):
            read(long_csv(tmp_path, *ROWS), SCAN, **options)


def test_special_formats_are_tried_before_general_ones(tmp_path):
    """Of the formats with one suffix, only the last may take every file: those behind it would never be asked."""
    nothing = write(tmp_path, "nothing\n", "nothing.dat")
    for suffix in {suffix for reader in READERS.values() for suffix in reader.suffixes}:
        *special, _ = [reader for reader in READERS.values() if suffix in reader.suffixes]
        for reader in special:
            with contextlib.suppress(InputError):
                assert not reader.recognises(nothing, SCAN, resolve_format(FileOptions(), SCAN))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.datetimes(min_value=pd.Timestamp("2001-01-01"), max_value=pd.Timestamp("2035-01-01")),
            st.sampled_from([0, 1, 2, 3]),
            st.floats(-90.0, 90.0) | st.none(),
        ),
        min_size=1,
        unique_by=lambda row: row[:2],
    ),
    st.sampled_from([(",", "."), (";", ","), ("tab", ","), ("|", ".")]),
    st.integers(-12, 12),
)
def test_whatever_is_written_is_read(tmp_path, rows, signs, hours):
    """Parsing law: any samples, written with any separators in any zone, come back sorted and unchanged."""
    separator, decimal = signs
    between = "\t" if separator == "tab" else separator
    lines = [between.join(HEAD.strip().split(","))]
    for time, beam, velocity in rows:
        number = "" if velocity is None else repr(velocity).replace(".", decimal)
        lines.append(between.join([time.isoformat(), str(beam), number]))
    file = write(tmp_path, "\n".join([*lines, ""]))
    zone = f"UTC{hours:+d}"
    series = read(file, SCAN, separator=separator, decimal=decimal, time_zone=zone, out_of_order="sort")
    expected = sorted(rows, key=lambda row: row[:2])
    time = np.array([row[0] for row in expected], dtype="datetime64[ns]") - np.timedelta64(hours, "h")
    np.testing.assert_array_equal(series["time"], time)
    np.testing.assert_array_equal(series["beam"], [row[1] for row in expected])
    velocity = [np.nan if row[2] is None else row[2] for row in expected]
    np.testing.assert_allclose(series["radial_velocity"], velocity, rtol=LAST_DIGIT, atol=LAST_DECIMAL)


class TestMeasured:
    def test_report(self, iea_folder):
        series = read(sorted(iea_folder.glob("Lidar_*.csv")), load_scan("pulsed-4-beam"))
        report = report_of(series)
        assert report["beams_present"] == [2, 3]
        assert report["beams_absent"] == [0, 1]
        assert [file["rows"] for file in report["files"]] == [21598, 21600]
        assert [file["rows_invalid_value"] for file in report["files"]] == [1, 554]
        assert [file["rows_dropped"] for file in report["files"]] == [1, 554]
        assert series.sizes["sample"] == 21597 + 21046
        assert series["time"].values[0] == np.datetime64("2020-09-03T19:00:01.547")
        assert float(series["radial_velocity"].max()) < 0.0  # the lidar looks upwind
        assert np.count_nonzero(series["status"] == 0) == 2
