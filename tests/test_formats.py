"""Formats: what is written as an instrument writes it gives the same series and the same records."""

from __future__ import annotations

import json
import re
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from format_files import (
    compress,
    long_frame,
    series_of,
    wide_frame,
    write_hpl,
    write_mini_raw,
    write_spinnerlidar,
    write_zx,
)
from ray_files import six_beam

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.readers import READERS, find_scan, read, read_statistics
from bayes_rs.readers.compressed import plain_suffix
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.halo import halo_rays
from bayes_rs.readers.looking import look
from bayes_rs.records.making import make_records
from bayes_rs.records.record_files import open_records
from bayes_rs.simulation.virtual import simulate
from bayes_rs.turbulence.mann import load_turbulence

WRITTEN = 5.1e-5  # m/s; four decimals in a StreamLine's text, and rounding of the sum of two numbers
MICROSECOND = np.timedelta64(1, "us")
SIX = six_beam(45.0, step=1.0)
ZX = load_scan("zx-tm")
FEW_SPINS = load_scan("spinnerlidar")


def report_of(series: xr.Dataset) -> dict:
    return json.loads(series.attrs["read_report"])


def assert_same(series: xr.Dataset, reference: xr.Dataset, *, tolerance: float = 1e-9) -> None:
    """The same samples in the same order; times to a microsecond, which float64 seconds since 1970 resolve."""
    order = np.lexsort((reference["beam"].values, reference["time"].values))
    np.testing.assert_array_equal(series["beam"], reference["beam"].values[order])
    late = np.abs(series["time"].values - reference["time"].values[order])
    assert late.max() <= MICROSECOND
    velocity = reference["radial_velocity"].values[order]
    np.testing.assert_allclose(series["radial_velocity"], velocity, rtol=0.0, atol=tolerance)


def assert_same_records(series: xr.Dataset, reference: xr.Dataset, scan, *, tolerance: float = 1e-9) -> None:
    got, wanted = make_records(series, scan), make_records(reference, scan)
    for name in ("count", "flag"):
        np.testing.assert_array_equal(got[name], wanted[name])
    for name in ("mean", "variance"):
        np.testing.assert_allclose(got[name], wanted[name], rtol=0.0, atol=10.0 * tolerance)


@pytest.fixture(scope="module")
def six() -> xr.Dataset:
    return series_of(SIX, n_scan=300)


@pytest.fixture(scope="module")
def simulated() -> xr.Dataset:
    series = simulate(load_scan("6-beam"), load_turbulence("fu-2022"), wind_speed=10.0, n_records=1, seed=1)
    return series[["radial_velocity"]].assign(cnr=xr.full_like(series["radial_velocity"], -10.0))


class TestSimulatedReadBack:
    """The whole way: virtual lidar, file, reader, records."""

    @pytest.mark.parametrize("kind", ["long", "wide", "parquet", "netcdf"])
    def test_tables(self, tmp_path, simulated, kind):
        scan = load_scan("6-beam")
        file = tmp_path / {"parquet": "a.parquet", "netcdf": "a.nc"}.get(kind, "a.csv")
        if kind == "long":
            long_frame(simulated).to_csv(file, index=False)
        elif kind == "wide":
            wide_frame(simulated).to_csv(file, index=False)
        elif kind == "parquet":
            long_frame(simulated).to_parquet(file)
        else:
            simulated.to_netcdf(file)
        assert_same_records(read(file, scan), simulated, scan)


class TestDecimalCommas:
    @pytest.mark.parametrize("frame", [long_frame, wide_frame])
    def test_same_series(self, tmp_path, frame):
        scan = replace(SIX, beam_time=np.zeros(6))
        series, file = series_of(scan, n_scan=50), tmp_path / "a.csv"
        frame(series).to_csv(file, index=False, sep=";", decimal=",")
        assert_same(read(file, scan, separator=";", decimal=","), series)


class TestCompressed:
    @pytest.mark.parametrize("suffix", [".gz", ".bz2", ".xz", ".zst", ".zip"])
    @pytest.mark.parametrize("kind", [".csv", ".nc", ".parquet", ".hpl"])
    def test_same_series(self, tmp_path, six, kind, suffix):
        file = tmp_path / f"day{kind}"
        if kind == ".csv":
            long_frame(six).to_csv(file, index=False)
        elif kind == ".nc":
            six.to_netcdf(file)
        elif kind == ".parquet":
            long_frame(six).to_parquet(file)
        else:
            write_hpl(file, six, SIX)
        packed = compress(file, suffix)
        series = read(packed, SIX)
        xr.testing.assert_identical(series.drop_attrs(deep=False), read(file, SIX).drop_attrs(deep=False))
        assert json.loads(series.attrs["source_files"]) == [packed.name]

    def test_errors_name_the_file_that_was_given(self, tmp_path):
        file = tmp_path / "day.csv"
        file.write_text("time,beam,radial_velocity\n2024-01-01T00:00:00,0,fast\n")
        packed = compress(file, ".gz")
        with pytest.raises(InputError, match=f"line 2 of file {re.escape(repr(str(packed)))}: it must be a number"):
            read(packed, SIX)

    def test_a_zip_of_several_files(self, tmp_path):
        with zipfile.ZipFile(tmp_path / "days.csv.zip", "w") as archive:
            archive.writestr("a.csv", "")
            archive.writestr("b.csv", "")
        with pytest.raises(InputError, match=r"days.csv.zip' holds 2 files: a .zip must hold one"):
            read(tmp_path / "days.csv.zip", SIX)

    def test_a_bomb(self, tmp_path, monkeypatch):
        monkeypatch.setattr("bayes_rs.readers.compressed.MOST_BYTES", 10_000_000)
        file = tmp_path / "day.csv"
        file.write_bytes(b"0" * 10_000_001)
        with pytest.raises(InputError, match=r"day.csv.gz' unpacks to more than 10000000 bytes: unpack it yourself"):
            read(compress(file, ".gz"), SIX)

    def test_plain_suffix(self):
        assert [plain_suffix(Path(name)) for name in ("a.NC.GZ", "a.csv", "a.b.parquet", "a.gz", "a")] == [
            ".nc", ".csv", ".parquet", "", "",
        ]  # fmt: skip


class TestContentBeforeName:
    """A Parquet or NetCDF file is known by how it begins, whatever it is called."""

    @pytest.mark.parametrize("name", ["day.csv", "day.txt", "day.nc", "day.hpl", "day.dat", "day", "day.csv.gz"])
    @pytest.mark.parametrize("kind", [".parquet", ".nc"])
    def test_same_series(self, tmp_path, six, kind, name):
        right = tmp_path / f"right{kind}"
        if kind == ".nc":
            six.to_netcdf(right)
        else:
            long_frame(six).to_parquet(right)
        named = right.rename(tmp_path / name.removesuffix(".gz"))
        file = compress(named, ".gz") if name.endswith(".gz") else named
        assert_same(read(file, SIX), six)
        assert report_of(read(file, SIX))["files"][0]["format"] == {".nc": "netcdf", ".parquet": "long"}[kind]

    @pytest.mark.parametrize("heading", ["PAR1", "CDF", "CDF1"])
    def test_a_text_that_begins_so_is_text(self, tmp_path, six, heading):
        frame = long_frame(six)
        frame.insert(0, heading, 1.0)
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert_same(read(tmp_path / "a.csv", SIX), six)

    def test_a_look(self, tmp_path, six):
        long_frame(six).to_parquet(tmp_path / "day.csv")
        assert "format: a table, 4 columns" in look(tmp_path / "day.csv").lines[1]
        six.to_netcdf(tmp_path / "day.txt")
        assert "format: NetCDF without rays" in look(tmp_path / "day.txt").lines[1]

    def test_records(self, tmp_path, simulated):
        scan = load_scan("6-beam")
        records = make_records(simulated, scan)
        records.to_netcdf(tmp_path / "records.dat")
        found = open_records(tmp_path / "records.dat", scan)
        np.testing.assert_array_equal(found["variance"], records["variance"])

    def test_rays(self, tmp_path):
        rays = {
            "azimuth": ("time", [0.0, 90.0, 180.0] * 4),
            "elevation": ("time", [60.0] * 12),
            "range": ("gate", [100.0, 120.0]),
            "radial_wind_speed": (("time", "gate"), np.ones((12, 2))),
        }
        times = ("time", np.arange(12.0), {"units": "seconds since 2021-05-13"})
        xr.Dataset(rays, coords={"time": times}).to_netcdf(tmp_path / "a.csv", engine="h5netcdf")
        assert find_scan(tmp_path / "a.csv", distance=120.0).n_beam == 3


class TestHalo:
    def test_same_records(self, tmp_path, six):
        series = read(write_hpl(tmp_path / "a.hpl", six, SIX), SIX)
        assert_same(series, six, tolerance=WRITTEN)
        assert_same_records(series, six, SIX, tolerance=WRITTEN)
        np.testing.assert_allclose(series["cnr"], six["cnr"], atol=1e-3)  # nine decimals of an SNR of a hundredth
        (entry,) = report_of(series)["files"]
        assert (entry["format"], entry["positive"], entry["options_of_format"]) == (
            "halo",
            "away",
            ["positive", "time_zone"],
        )

    @pytest.mark.parametrize("options", [{"overlap": 3.0}, {"decimal": ","}, {"spectral_width": True}])
    def test_layouts_in_use(self, tmp_path, six, options):
        overlap = options.get("overlap")
        file = write_hpl(tmp_path / "a.hpl", six, SIX, n_gate=16 if overlap else 5, **options)
        assert_same(read(file, SIX, range_tolerance=3.0), six, tolerance=WRITTEN)

    def test_a_published_ray(self, tmp_path):
        """Numbers of a file from Eriswil as its reader's own tests give them (halo-reader, test_read.py)."""
        text = write_hpl(tmp_path / "a.hpl", series_of(SIX, n_scan=1), SIX, n_gate=2, gate_length=48.0).read_text()
        head = text.split("****\n")[0].replace("20240301 09:50:00.00", "20221214 11:00:18.99")
        ray = "11.00499444   0.00  90.00 -0.01 -0.20\n  0 2.5990 1.027855  1.569249E-6\n  1 -0.0764 1.014089  7.96E-7\n"
        file = tmp_path / "eriswil.hpl"
        file.write_text(head + "****\n" + ray)
        rays = halo_rays(file, resolve_format(FileOptions(), SIX))
        assert abs(rays.time[0] - np.datetime64("2022-12-14T11:00:17.979984")) <= MICROSECOND
        np.testing.assert_array_equal(rays.radial_velocity, [[2.599, -0.0764]])
        np.testing.assert_allclose(rays.cnr, 10.0 * np.log10([[0.027855, 0.014089]]), rtol=1e-9)
        np.testing.assert_array_equal(rays.distance, [[24.0, 72.0]])
        np.testing.assert_allclose(rays.direction, [[0.0, 0.0, 1.0]], atol=1e-15)

    def test_midnight(self, tmp_path):
        late = series_of(SIX, n_scan=10, start="2024-02-29T23:59:57")
        assert_same(read(write_hpl(tmp_path / "a.hpl", late, SIX), SIX), late, tolerance=WRITTEN)

    def test_first_ray_after_midnight(self, tmp_path):
        late = series_of(SIX, n_scan=2, start="2024-03-01T00:00:01")
        file = write_hpl(tmp_path / "a.hpl", late, SIX)
        file.write_text(file.read_text().replace("20240301 00:00:01.00", "20240229 23:59:59.50"))
        assert_same(read(file, SIX), late, tolerance=WRITTEN)

    @pytest.mark.parametrize("cut", [10, 70, 150])
    def test_cut_off(self, tmp_path, six, cut):
        file = write_hpl(tmp_path / "a.hpl", six, SIX)
        file.write_bytes(file.read_bytes()[:-cut])
        series = read(file, SIX)
        lost = six.sizes["sample"] - series.sizes["sample"]
        assert lost == report_of(series)["rows_dropped"] == (0 if cut < 20 else 1)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("****", "++++", "has no line of '[*]{4}'"),
            ("Number of gates:\t5", "Number of gates:\tfew", "no number for 'number of gates'"),
            ("Number of gates:\t5", "Number of gates:\t4", r"Invalid gate|it must start with"),
            ("(range gate + 0.5)", "(range gate + 1)", "formula of the range unknown"),
            ("20240301", "2024030", "Start time"),
            ("  2 -19.4000", "  7 -19.4000", r"Invalid gate 7 in line 21 of file .*it must be 2"),
            ("  2 -19.4000", "  2 fast", r"Line 21 of file .* is '2 fast 0.990000000 -1.2162.*: it must start with 4"),
            ("9.83333333333 ", "25.0 ", "Invalid time 25 in line 18"),
        ],
    )
    def test_bad_files(self, tmp_path, six, old, new, message):
        file = write_hpl(tmp_path / "a.hpl", six, SIX)
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match=message) as caught:
            read(file, SIX)
        assert "a.hpl" in str(caught.value)


class TestSpinnerLidar:
    def test_same_records(self, tmp_path):
        few = series_of(FEW_SPINS, n_scan=20)
        series = read(write_spinnerlidar(tmp_path / "a.txt", few, FEW_SPINS), FEW_SPINS)
        assert_same(series, few)
        assert_same_records(series, few, FEW_SPINS)
        (entry,) = report_of(series)["files"]
        assert entry["format"] == "spinnerlidar"
        assert entry["options_of_format"] == ["columns", "positive", "separator", "time_format"]

    def test_looking_downwind(self, tmp_path):
        few = series_of(FEW_SPINS, n_scan=2)
        file = write_spinnerlidar(tmp_path / "a.txt", few, FEW_SPINS)
        one, other = (read(file, FEW_SPINS, positive=sign) for sign in ("towards", "away"))
        np.testing.assert_array_equal(one["radial_velocity"], -other["radial_velocity"])

    @pytest.mark.parametrize(
        ("columns", "message"),
        [
            ({"sx": "12"}, "has 11 columns, and sx is to be number 12"),
            ({"sx": "left"}, "Invalid column 'left' of sx: a file without headings needs the number"),
            ({"sx": "2"}, r"Invalid position sx = .* in line 1 of file .*: it is outside the unit disc"),
        ],
    )
    def test_columns(self, tmp_path, columns, message):
        file = write_spinnerlidar(tmp_path / "a.txt", series_of(FEW_SPINS, n_scan=1), FEW_SPINS)
        with pytest.raises(InputError, match=message):
            read(file, FEW_SPINS, file_format="spinnerlidar", columns=columns)


MAP_OF_ZX = {
    "columns": {"time": "When", "phase": "Scan angle", "radial_velocity": "LOS"},
    "time_format": "%d/%m/%Y %H:%M:%S.%f",
    "phase_zero_deg": 90.0,
    "phase_turns": "down",
}


class TestZX:
    @pytest.mark.parametrize("converter", [True, False])
    def test_same_records(self, tmp_path, converter):
        turns = series_of(ZX, n_scan=20)
        file = write_zx(tmp_path / "raw.csv", turns, ZX, converter=converter)
        series = read(file, ZX, **MAP_OF_ZX)
        assert_same(series, turns)
        assert_same_records(series, turns, ZX)
        missing = int(np.isnan(turns["radial_velocity"]).sum())
        assert missing > 0
        assert report_of(series)["rows_invalid_value"] == missing
        assert np.nanmax(series["radial_velocity"]) < 0.0

    def test_on_a_cone_that_looks_up(self, tmp_path):
        scan = load_scan("zx-300")
        one_height = scan.select(scan.beam[:50])
        turns = series_of(one_height, n_scan=3)
        file = tmp_path / "raw.csv"
        theta = np.degrees(np.arctan2(one_height.beam_direction[:, 1], one_height.beam_direction[:, 0]))
        frame = pd.DataFrame(
            {"time": turns["time"], "phase": np.tile(theta, 3), "radial_velocity": turns["radial_velocity"]}
        )
        frame.to_csv(file, index=False)
        assert_same(read(file, one_height, file_format="zx", positive="away"), turns)

    def test_other_scans(self, tmp_path):
        file = write_zx(tmp_path / "raw.csv", series_of(ZX, n_scan=1), ZX)
        with pytest.raises(InputError, match="do not lie on one cone"):
            read(file, FEW_SPINS, **MAP_OF_ZX)

    def test_statistics_are_no_velocities(self, tmp_path):
        file = write_statistics(tmp_path)
        with pytest.raises(InputError, match=r"Wind10_317.csv' holds ZX's statistics .* read it with read_statistics"):
            read(file, ZX, separator=";", decimal=",")


COUNTS = {"phase_zero_deg": 0.0, "phase_turns": "up"}


class TestZXByHeadings:
    @pytest.mark.parametrize("radian", [False, True])
    def test_same_records(self, tmp_path, radian):
        turns = series_of(ZX, n_scan=40)
        file = write_mini_raw(tmp_path / "raw.csv", turns, ZX, radian=radian)
        series = read(file, ZX, **COUNTS)
        assert_same(series, turns)
        assert_same_records(series, turns, ZX)
        report = report_of(series)
        missing = int(np.isnan(turns["radial_velocity"]).sum())
        assert report["rows_invalid_value"] == missing
        assert missing > 13  # each mark of a bad value
        (of_file,) = report["files"]
        assert of_file["format"] == "zx"
        assert of_file["invalid"] == list(range(9987, 10000))
        assert of_file["columns"] == {
            "time": "Timestamp (ISO 8601)",
            "phase": "Phase (rad)" if radian else "Phase (deg)",
            "radial_velocity": "LOS Velocity (m/s)",
        }

    @pytest.mark.parametrize("phase", ["Azimuth", "Scan angle (deg)", "Phase angle [°]", "PRISM AZIMUTH (degrees)"])
    @pytest.mark.parametrize("velocity", ["LOS", "Line of sight speed (m/s)", "line-of-sight velocity [m s-1]"])
    def test_headings_that_are_taken(self, tmp_path, phase, velocity):
        turns = series_of(ZX, n_scan=1)
        names = {"Phase (deg)": phase, "LOS Velocity (m/s)": velocity}
        file = write_mini_raw(tmp_path / "raw.csv", turns, ZX, **names)
        assert_same(read(file, ZX, **COUNTS), turns)

    @pytest.mark.parametrize("pattern", ["%d/%m/%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f"])
    def test_times_of_the_older_converter(self, tmp_path, pattern):
        turns = series_of(ZX, n_scan=1)
        file = write_mini_raw(tmp_path / "raw.csv", turns, ZX, **{"Timestamp (ISO 8601)": "Time and Date"})
        frame = pd.read_csv(file)
        frame["Time and Date"] = pd.to_datetime(frame["Time and Date"]).dt.strftime(pattern)
        frame.to_csv(file, index=False)
        assert_same(read(file, ZX, **COUNTS), turns)

    def test_a_column_that_is_named_counts_first(self, tmp_path):
        turns = series_of(ZX, n_scan=1)
        file = write_mini_raw(tmp_path / "raw.csv", turns, ZX)
        frame = pd.read_csv(file)
        frame["Azimuth"] = frame["Phase (deg)"]
        frame["Phase (deg)"] += 90.0
        frame.to_csv(file, index=False)
        with pytest.raises(InputError, match=r"several columns that could be phase, 'Phase \(deg\)', 'Azimuth': say"):
            read(file, ZX, **COUNTS)
        assert_same(read(file, ZX, columns={"phase": "Azimuth"}), turns)
        turned = read(file, ZX, columns={"phase": "Phase (deg)"}, phase_zero_deg=-90.0)
        assert_same(turned, turns)

    @pytest.mark.parametrize("counts", [{}, {"phase_zero_deg": 0.0}, {"phase_turns": "down"}])
    def test_how_a_phase_counts_is_not_guessed(self, tmp_path, counts):
        file = write_mini_raw(tmp_path / "raw.csv", series_of(ZX, n_scan=1), ZX)
        words = r"does not say where its 'Phase \(deg\)' is zero and which way it turns: give phase_zero_deg"
        with pytest.raises(InputError, match=words):
            read(file, ZX, **counts)

    @pytest.mark.parametrize(
        ("names", "columns", "words"),
        [
            (
                {"Phase (deg)": "Angle"},
                None,
                r"no column 'phase' for phase: its columns are 'Timestamp \(ISO 8601\)', ",
            ),
            ({"LOS Velocity (m/s)": "v (km/h)"}, None, "no column 'radial_velocity' for radial_velocity: .*'v \\(km/h"),
            ({"Timestamp (ISO 8601)": "t"}, None, "no column 'time' for time: its columns are 't', 'Range"),
            ({}, {"phase": "Angle"}, "no column 'Angle' for phase: its columns are"),
        ],
    )
    def test_columns_that_are_not_there(self, tmp_path, names, columns, words):
        file = write_mini_raw(tmp_path / "raw.csv", series_of(ZX, n_scan=1), ZX, **names)
        with pytest.raises(InputError, match=words):
            read(file, ZX, file_format="zx", columns=columns, **COUNTS)

    def test_magnitudes_all_round_an_upward_cone(self, tmp_path):
        scan = load_scan("zx-300")
        one_height = scan.select(scan.beam[:50])
        turns = series_of(one_height, n_scan=3)
        azimuth = np.degrees(np.arctan2(one_height.beam_direction[:, 1], one_height.beam_direction[:, 0]))
        velocity = turns["radial_velocity"].values
        signed = np.where(np.tile(azimuth, 3) > 0.0, velocity, -velocity)
        for values, refused in ((np.abs(velocity), True), (signed, False)):
            frame = pd.DataFrame({"time": turns["time"], "phase": np.tile(azimuth, 3), "radial_velocity": values})
            frame.to_csv(tmp_path / "raw.csv", index=False)
            if refused:
                with pytest.raises(InputError, match=r"holds magnitudes .* upward cone of scan 'zx-300'.* with signs"):
                    read(tmp_path / "raw.csv", one_height, file_format="zx")
            else:
                read(tmp_path / "raw.csv", one_height, file_format="zx")

    def test_pairs_at_heights_of_the_rotor_are_no_scan(self, tmp_path):
        """The headings are those of the README of the Hill of Towie open dataset, v2."""
        sides = [f"{side} LOS Speed (m/s) at Rotor Segment Height 59.0m" for side in ("Left", "Right")]
        frame = pd.DataFrame({"Timestamp (ISO 8601)": ["2026-01-01T00:00:00"], "Range (m)": [208.0]})
        frame[sides] = [[8.1, 9987.0]]
        frame.to_csv(tmp_path / "Wind_ZTM5060.csv", index=False)
        with pytest.raises(InputError, match="holds ZX TM's wind: line-of-sight speeds left and right at heights"):
            read(tmp_path / "Wind_ZTM5060.csv", ZX)

    def test_a_long_table_stays_one(self, tmp_path):
        turns = series_of(ZX, n_scan=1)
        file = write_mini_raw(tmp_path / "raw.csv", turns, ZX)
        frame = pd.read_csv(file).assign(beam=turns["beam"].values)
        frame.to_csv(file, index=False)
        columns = {"time": "Timestamp (ISO 8601)", "radial_velocity": "LOS Velocity (m/s)"}
        series = read(file, ZX, columns=columns, invalid=list(range(9987, 10000)))
        assert report_of(series)["files"][0]["format"] == "long"


FIRST = (
    "CSV Converter: v1,114;Unit: 317;Time sync: UTC +1,0 hrs;Time stamps indicate the beginning of the averaging period"
)
HEADINGS = (
    "Reference;Time and Date;Tilt (deg);Packets in Average at 297m;Wind Direction (deg) at 297m;"
    "Horizontal Wind Speed (m/s) at 297m;TI at 297m;Horizontal Wind Speed (m/s) at 38m;Checksum"
)
ROWS = (
    "21980722;13.12.2016 00:00:00;1;36;19,162;5,039;0,09593122;2,437;8",
    "21981114;13.12.2016 00:10:00;1;35;9999,000;9999,000;9999;9998,000;9",
)


def write_statistics(folder: Path, *, first: str = FIRST, headings: str = HEADINGS, rows=ROWS) -> Path:
    file = folder / "Wind10_317.csv"
    file.write_bytes("\r\n".join([first, headings, *rows]).encode("latin-1"))
    return file


class TestStatistics:
    def test_numbers_of_a_published_file(self, tmp_path):
        """The rows are those of unit 317 in the samples of Lidaco, some columns of them."""
        statistics = read_statistics(write_statistics(tmp_path))
        np.testing.assert_array_equal(statistics["height"], [38.0, 297.0])
        np.testing.assert_array_equal(statistics["wind_speed"], [[2.437, 5.039], [np.nan, np.nan]])
        np.testing.assert_array_equal(statistics["turbulence_intensity"][0], [np.nan, 0.09593122])
        np.testing.assert_array_equal(statistics["wind_direction"][0], [np.nan, 19.162])
        np.testing.assert_array_equal(statistics["tilt"], [1.0, 1.0])
        assert statistics["time"].values[0] == np.datetime64("2016-12-12T23:00")
        assert statistics.attrs["left_out"] == ["Reference", "Checksum"]

    def test_commas_and_slashes(self, tmp_path):
        file = write_statistics(
            tmp_path,
            first=FIRST.replace(";", ",").replace("+1,0", "-3.5"),
            headings=HEADINGS.replace(";", ","),
            rows=[ROWS[0].replace(",", ".").replace(";", ",").replace("13.12.2016", "13/12/2016")],
        )
        statistics = read_statistics(file)
        assert statistics["time"].values[0] == np.datetime64("2016-12-13T03:30")
        assert statistics["wind_speed"].values[0, 1] == 5.039

    def test_several_files(self, tmp_path):
        write_statistics(tmp_path, rows=ROWS[:1])
        later = tmp_path / "later"
        later.mkdir()
        write_statistics(later, rows=ROWS[1:])
        assert read_statistics(tmp_path).sizes["time"] == 2

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"first": FIRST.replace("beginning", "end")}, "time stamps indicate the end"),
            ({"headings": HEADINGS.replace("Time and Date", "When")}, "has no column 'Time and Date' for time"),
            ({"headings": HEADINGS.replace(" at ", " @ ")}, "has no column such as 'Horizontal Wind Speed"),
            ({"rows": [ROWS[0].replace("13.12.2016", "13.13.2016")]}, "Invalid time '13.13.2016 00:00:00'"),
            ({"rows": [ROWS[0].replace("5,039", "fast")]}, "Invalid wind_speed 'fast'"),
        ],
    )
    def test_bad_files(self, tmp_path, change, message):
        with pytest.raises(InputError, match=message):
            read_statistics(write_statistics(tmp_path, **change))


class TestRegistry:
    def test_each_format_says_what_it_is(self):
        for name, reader in READERS.items():
            assert reader.name == name
            assert reader.title
            assert reader.source
            assert all(suffix.startswith(".") for suffix in reader.suffixes)
            resolve_format(FileOptions(), None, defaults=reader.defaults)  # its defaults are valid options

    def test_precedence(self, tmp_path, six):
        """The caller's option, then the scan's, then the format's, then the general one."""
        file = write_hpl(tmp_path / "a.hpl", six, SIX)
        away = read(file, SIX)["radial_velocity"]
        scan = replace(SIX, file_format={"positive": "towards"})
        np.testing.assert_array_equal(read(file, scan)["radial_velocity"], -away)
        series = read(file, scan, positive="away")
        np.testing.assert_array_equal(series["radial_velocity"], away)
        assert report_of(series)["files"][0]["options_of_format"] == ["time_zone"]


class TestTimes:
    ROW = "time,beam,radial_velocity\n{},0,1\n"

    @pytest.mark.parametrize(
        ("text", "time_format"),
        [
            ("1709287200.25", "unix"),
            ("3792131999.25", "labview"),
            ("739312.4166695601", "matlab"),
            ("01.03.2024 10:00:00.250", "%d.%m.%Y %H:%M:%S.%f"),
            ("2024-03-01 10:00:00.250", None),
        ],
    )
    def test_time_formats(self, tmp_path, text, time_format):
        file = tmp_path / "a.csv"
        file.write_text(self.ROW.format(text))
        time = read(file, SIX, time_format=time_format)["time"].values[0]
        shift = np.timedelta64(-1, "s") if time_format == "labview" else np.timedelta64(0, "s")
        wanted = np.datetime64("2024-03-01T10:00:00.25") + shift
        assert abs(time - wanted) <= 50 * MICROSECOND  # a datenum in float64 resolves 10 µs

    def test_pattern_in_a_zone(self, tmp_path):
        file = tmp_path / "a.csv"
        file.write_text(self.ROW.format("01.03.2024 10:00"))
        time = read(file, SIX, time_format="%d.%m.%Y %H:%M", time_zone="UTC+1")["time"].values[0]
        assert time == np.datetime64("2024-03-01T09:00")

    @pytest.mark.parametrize("time_format", ["unix", "%d.%m.%Y"])
    def test_bad_times(self, tmp_path, time_format):
        file = tmp_path / "a.csv"
        file.write_text(self.ROW.format("1e300x"))
        with pytest.raises(InputError, match="Invalid time '1e300x' in column 'time', line 2"):
            read(file, SIX, time_format=time_format)

    @pytest.mark.parametrize(("stamp", "share"), [("start", 0.0), ("middle", 0.5), ("end", 1.0), (None, 0.0)])
    def test_stamps(self, tmp_path, stamp, share):
        """The time kept is the start of a sample's accumulation."""
        file = tmp_path / "a.csv"
        file.write_text(self.ROW.format("2024-03-01T10:00:04"))
        series = read(file, SIX, time_stamp=stamp, sample_duration=4.0)
        wanted = np.datetime64("2024-03-01T10:00:04", "ms") - np.timedelta64(round(4000 * share), "ms")
        assert series["time"].values[0] == wanted
        assert report_of(series)["files"][0]["time_stamp"] == stamp

    def test_stamps_need_a_duration(self, tmp_path):
        file = tmp_path / "a.csv"
        file.write_text(self.ROW.format("2024-03-01T10:00:04"))
        with pytest.raises(InputError, match=r"at the end of a sample need its duration.*give sample_duration"):
            read(file, SIX, time_stamp="end")

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"time_stamp": "begin"}, "Unknown time_stamp 'begin': it must be one of start, middle, end."),
            ({"sample_duration": -1.0}, "Invalid sample_duration -1.0 s: it must be a finite number above zero."),
            (
                {"time_format": "ISO"},
                "Unknown time_format 'ISO': it must be one of unix, unix-ms, unix-us, unix-ns, labview, matlab, or",
            ),
            ({"angle_tolerance_deg": 0.0}, "Invalid angle_tolerance_deg 0.0 degrees"),
            ({"range_tolerance": "far"}, "Invalid range_tolerance 'far' m"),
            ({"phase_turns": "left"}, "Unknown phase_turns 'left': it must be one of up, down."),
            ({"on_bad_file": "warn"}, "Unknown on_bad_file 'warn': it must be one of error, skip."),
        ],
    )
    def test_options(self, tmp_path, options, message):
        file = tmp_path / "a.csv"
        file.write_text(self.ROW.format("2024-03-01T10:00:04"))
        with pytest.raises(InputError, match=re.escape(message)):
            read(file, SIX, **options)
