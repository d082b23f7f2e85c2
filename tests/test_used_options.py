"""Options of reading that no reader of the files uses are refused; what readers declare is what they ask for."""

import sys
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
import ray_files
from click.testing import CliRunner
from format_files import long_frame, series_of, wide_frame, write_hpl, write_spinnerlidar, write_zx
from ray_files import rays_of, six_beam, windcube_sweep, write_windcube
from ray_text_files import at_heights, ray_frame, write_molas, write_rtd, write_scn, write_windscanner

import bayes_rs as brs
from bayes_rs import InputError, load_scan
from bayes_rs.cli.group import commands
from bayes_rs.file_options import FileOptions
from bayes_rs.options import options_of
from bayes_rs.readers import READERS, find_scan, one_file, read, stream
from bayes_rs.readers.format import FileFormat, resolve_format
from bayes_rs.readers.interface import OF_EVERY_FORMAT, OF_TEXT_FILES
from bayes_rs.readers.one_file import opened_reader
from bayes_rs.records.record_files import open_records

SIX = six_beam(100.0, 150.0, step=1.0)
LOW = six_beam(45.0, step=1.0)
SERIES = series_of(SIX, n_scan=20)
RAYS = rays_of(SERIES, SIX, rough=False)
TOGETHER = replace(SIX, beam_time=np.zeros(SIX.n_beam))
ZX, SPIN = load_scan("zx-tm"), load_scan("spinnerlidar")
OF_ZX = {
    "columns": {"time": "When", "phase": "Scan angle", "radial_velocity": "LOS"},
    "time_format": "%d/%m/%Y %H:%M:%S.%f",
    "phase_zero_deg": 90.0,
    "phase_turns": "down",
}
OTHER = {
    "columns": {"cnr": "SNR"},
    "beam_numbers": {"LOS2": 2},
    "time_format": "unix",
    "separator": ";",
    "decimal": ",",
    "skip_rows": 3,
    "comment": "#",
    "encoding": "cp1252",
    "angle_tolerance_deg": 0.25,
    "range_tolerance": 7.0,
    "gate_length": 30.0,
    "gates_by": "height",
    "phase_zero_deg": 90.0,
    "phase_turns": "down",
    "bad_rows": "drop",
}
"""A value of each option that not every format uses."""


def to_csv(frame, file):
    frame.to_csv(file, index=False)
    return file


def to_netcdf(dataset, file):
    dataset.to_netcdf(file, engine="h5netcdf")
    return file


SCENES = {
    "halo": (LOW, lambda folder: write_hpl(folder / "a.hpl", series_of(LOW, n_scan=20), LOW), {}),
    "windcube-text": (SIX, lambda folder: write_rtd(folder / "a.rtd", at_heights(RAYS)), {}),
    "galion": (
        SIX,
        lambda folder: write_scn(folder / "a.scn", RAYS),
        {"gate_length": 50.0, "range_tolerance": 60.0},
    ),
    "windscanner": (SIX, lambda folder: write_windscanner(folder / "a.txt", RAYS), {}),
    "zx": (ZX, lambda folder: write_zx(folder / "a.csv", series_of(ZX, n_scan=3), ZX), OF_ZX),
    "spinnerlidar": (SPIN, lambda folder: write_spinnerlidar(folder / "a.txt", series_of(SPIN, n_scan=3), SPIN), {}),
    "molas": (SIX, lambda folder: write_molas(folder / "a.csv", RAYS), {}),
    "rays": (SIX, lambda folder: to_csv(ray_frame(RAYS, velocity="rws"), folder / "a.csv"), {"positive": "away"}),
    "long": (SIX, lambda folder: to_csv(long_frame(SERIES), folder / "a.csv"), {}),
    "wide": (
        TOGETHER,
        lambda folder: to_csv(wide_frame(series_of(TOGETHER, n_scan=20)), folder / "a.csv"),
        {},
    ),
    "windcube": (SIX, lambda folder: write_windcube(folder / "a.nc", windcube_sweep(RAYS)), {}),
    "e-windlidar": (SIX, lambda folder: to_netcdf(ray_files.e_windlidar(RAYS, time="units"), folder / "a.nc"), {}),
    "arm": (SIX, lambda folder: to_netcdf(ray_files.arm(RAYS), folder / "a.nc"), {}),
    "cfradial": (SIX, lambda folder: to_netcdf(ray_files.cfradial(RAYS), folder / "a.nc"), {}),
    "netcdf": (SIX, lambda folder: to_netcdf(SERIES, folder / "a.nc"), {}),
}
"""By format: a scan, what writes a file, and how it is read."""
WHERE_NEEDED = {"gates_by", "beam_numbers", "range_tolerance", "gate_length", "columns", "comment", "encoding"}
"""What a reader asks for only where the file has something that it is about."""


def test_every_format_has_a_scene_and_says_what_it_uses():
    assert sorted(SCENES) == sorted(READERS)
    some = {entry.name for entry in options_of(FileOptions)} - set(OF_EVERY_FORMAT)
    assert set(OTHER) == some
    for reader in READERS.values():
        assert set(reader.uses) <= some
        assert len(set(reader.uses)) == len(reader.uses)


@pytest.mark.parametrize("name", SCENES)
def test_a_reader_says_of_all_options_that_it_asks_for(name, tmp_path, monkeypatch):
    """The options are watched while a file is read: none is asked for that is not declared."""
    asked: set[str] = set()
    known = {entry.name for entry in options_of(FileOptions)}

    class Watched(FileFormat):
        def __getattribute__(self, attribute):
            who = sys._getframe(1).f_code.co_name  # making and copying the options asks for all
            if attribute in known and who not in ("replace", "__post_init__", "put", "check_kinds"):
                asked.add(attribute)
            return super().__getattribute__(attribute)

    def watched(*arguments, **more):
        found = resolve_format(*arguments, **more)
        return Watched(**{entry.name: getattr(found, entry.name) for entry in fields(found)})

    monkeypatch.setattr(one_file, "resolve_format", watched)
    scan, write, options = SCENES[name]
    with opened_reader(write(tmp_path), scan, FileOptions(**options)) as (reader, plain, file_format):
        asked.clear()
        reader.read(plain, scan, file_format)
    assert reader.name == name
    assert asked - set(OF_EVERY_FORMAT) <= set(reader.uses)
    assert set(reader.uses) - asked <= WHERE_NEEDED


@pytest.mark.parametrize("name", SCENES)
def test_an_option_of_another_format_is_refused_and_its_own_are_not(name, tmp_path):
    scan, write, options = SCENES[name]
    file = write(tmp_path)
    is_text = file.suffix != ".nc"
    for option, value in OTHER.items():
        if option in READERS[name].uses:
            continue
        users = [one for one, reader in READERS.items() if option in reader.uses]
        of = "files of text" if option in OF_TEXT_FILES else f"the format{'s' * (len(users) > 1)} {', '.join(users)}"
        with pytest.raises(InputError) as caught:
            read(file, scan, **{**options, option: value})
        assert str(caught.value).startswith(f"The option {option} {value!r} (--"), option
        words = f") is of {of}, and not used by the format of these files, {name} (file {str(file)!r})"
        assert words in str(caught.value)
    kept = read(file, scan, **options)
    own = {"bad_rows": "drop"} if is_text and "bad_rows" in READERS[name].uses else {}
    same = read(file, scan, **options, **own)
    np.testing.assert_array_equal(same["radial_velocity"], kept["radial_velocity"])


class TestWays:
    """One mechanism for all ways to files."""

    @pytest.fixture
    def table(self, tmp_path):
        return to_csv(long_frame(SERIES), tmp_path / "a.csv")

    def test_a_parquet_table_has_no_separator(self, tmp_path):
        long_frame(SERIES).to_parquet(tmp_path / "a.parquet")
        for name in OF_TEXT_FILES:
            with pytest.raises(
                InputError, match=rf"^The option {name} .* is of files of text, .*, long \(file '.*a.parq"
            ):
                read(tmp_path / "a.parquet", SIX, **{name: OTHER[name]})
        assert read(tmp_path / "a.parquet", SIX, decimal=",", bad_rows="drop").sizes["sample"] == SERIES.sizes["sample"]

    def test_files_of_several_formats_are_read_if_one_uses_it(self, tmp_path, table):
        half = SERIES.isel(sample=slice(0, 120)), SERIES.isel(sample=slice(120, None))
        to_csv(long_frame(half[0]), table)
        to_netcdf(half[1], tmp_path / "b.nc")
        assert read([tmp_path / "b.nc", table], SIX, bad_rows="drop").sizes["sample"] == SERIES.sizes["sample"]
        with pytest.raises(
            InputError, match=r"these files, netcdf \(file '.*b.nc'\), long \(file '.*a.csv'\): leave it out"
        ):
            read([tmp_path / "b.nc", table], SIX, gate_length=30.0)
        found = run("records", tmp_path / "b.nc", table, "--scan", scan_file(tmp_path), "--bad-rows", "drop",
                    "-o", tmp_path / "r.nc")  # fmt: skip
        assert found.exit_code == 0, found.output

    def test_a_file_that_cannot_be_used_says_so_itself(self, tmp_path):
        (tmp_path / "a.csv").write_text("what,ever\n1,2\n")
        with pytest.raises(InputError, match="is neither a long table"):
            read(tmp_path / "a.csv", SIX, gate_length=30.0)

    def test_a_stream_a_survey_and_a_format_that_is_named(self, tmp_path, table):
        with pytest.raises(InputError, match=r"^The option gate_length 30\.0"):
            stream(table, SIX, gate_length=30.0)
        with pytest.raises(InputError, match=r"^The option gate_length 30\.0"):
            read(table, SIX, gate_length=30.0, file_format="long")
        rays = SCENES["windcube"][1](tmp_path)
        with pytest.raises(InputError, match=r"^The option skip_rows 3 \(--skip-rows\) is of files of text"):
            find_scan(rays, distance=100.0, skip_rows=3)
        assert find_scan(rays, distance=100.0, gates_by="distance").n_beam

    def test_several_are_named(self, table):
        with pytest.raises(InputError, match=r"long \(file '.*a.csv'\); nor are phase_turns: leave"):
            read(table, SIX, phase_zero_deg=30.0, phase_turns="down")

    def test_a_scan_s_own_table_may_be_of_other_files(self, table):
        scan = replace(SIX, file_format={"gate_length": 30.0, "comment": "#"})
        assert read(table, scan).sizes["sample"] == SERIES.sizes["sample"]

    def test_a_reader_of_someone_else_uses_all(self, table, monkeypatch):
        monkeypatch.setitem(READERS, "long", replace(READERS["long"], uses=None))
        assert read(table, SIX, gate_length=30.0).sizes["sample"] == SERIES.sizes["sample"]

    @pytest.mark.parametrize("command", ["records", "fit"])
    def test_the_command_line(self, tmp_path, table, command):
        found = run(command, table, "--scan", scan_file(tmp_path), "--phase-zero", "30", "-o", tmp_path / "new" / "out")
        assert isinstance(found.exception, InputError)
        assert str(found.exception).startswith("The option phase_zero_deg 30.0 (--phase-zero) is of the format zx")
        assert not (tmp_path / "new").exists()

    def test_a_run_is_repeated_from_its_settings(self, tmp_path):
        hour = brs.demo_file("6-beam-45")
        settings = brs.Settings().changed(
            scan="6-beam@opening_angle_deg=45,focus_distance=52", files=[str(hour)], bad_rows="drop", decimal=",",
            output=str(tmp_path / "out"),
        )  # fmt: skip
        brs.fit_files(settings)
        again = brs.Settings.load(tmp_path / "out" / "run.json").changed(output=str(tmp_path / "again"))
        assert brs.fit_files(again).summary().equals(brs.open_fit(tmp_path / "out").summary())


class TestBeside:
    """Options that the tables of a lidar's motion and of a mast have, too."""

    @pytest.fixture
    def files(self, tmp_path):
        series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
        records = brs.make_records(series, "2-beam")
        to_netcdf(series, tmp_path / "a.nc")
        to_netcdf(records, tmp_path / "r.nc")
        at = pd.to_datetime(series["time"].values) + pd.Timedelta("1h")
        pd.DataFrame({"when": at, "tilt": "0,5"}).to_csv(tmp_path / "motion.csv", index=False, sep=";")
        pd.DataFrame({"time": records["time"].values, "uu": [1.5, -999.0], "uv": [0.0, -999.0], "vv": 1.0}).to_csv(
            tmp_path / "mast.csv", index=False
        )
        return tmp_path

    MOTION = ("--motion-column", "time=when", "--motion-column", "tilt_deg=tilt", "--time-zone", "UTC+1",
              "--separator", ";", "--decimal", ",")  # fmt: skip

    @pytest.mark.parametrize("lidar", ["a.nc", "r.nc"])
    def test_a_table_of_motion_beside_netcdf_has_its_own_zone(self, files, lidar):
        out = files / "made.nc"
        found = run("records", files / lidar, "--scan", "2-beam", "--motion", files / "motion.csv", *self.MOTION,
                    "-o", out)  # fmt: skip
        assert found.exit_code == 0, found.output
        assert open_records(out, "2-beam")["tilt"].values.tolist() == [0.5, 0.5]
        assert "of 2 of 2 records" in found.output

    def test_so_in_a_fit_and_with_other_settings(self, files):
        out = files / "out"
        found = run("fit", files / "a.nc", "--scan", "2-beam", "--motion", files / "motion.csv", *self.MOTION,
                    "-o", out)  # fmt: skip
        assert found.exit_code == 0, found.output
        run_again = brs.Settings.load(out / "run.json")
        assert run_again.files.time_zone == "UTC+1"

    @pytest.mark.parametrize("option", [("--time-zone", "UTC+1"), ("--separator", ";")])
    def test_without_motion_they_are_refused(self, files, option):
        found = run("records", files / "a.nc", "--scan", "2-beam", *option, "-o", files / "made.nc")
        assert isinstance(found.exception, InputError)
        assert option[0] in str(found.exception)
        found = run("records", files / "r.nc", "--scan", "2-beam", *option, "-o", files / "made.nc")
        assert found.exit_code == 2
        assert f"{option[0]}: for radial velocities only" in found.output

    @pytest.mark.parametrize("lidar", ["a.nc", "r.nc"])
    def test_a_mark_of_a_mast_s_table(self, files, lidar):
        words = ("records", files / lidar, "--scan", "2-beam", "--mast", files / "mast.csv", "--mast-position", "-98",
                 "0", "0", "-o", files / "made.nc")  # fmt: skip
        found = run(*words)
        assert isinstance(found.exception, InputError)
        advice = "leave empty what is not known, or name the number that marks it with invalid=-999 (--invalid -999)."
        assert str(found.exception).endswith(advice)
        found = run(*words, "--invalid", "-999")
        assert found.exit_code == 0, found.output
        assert "it has stresses of 2 of 2 records" in " ".join(found.output.split())

    def test_a_covariance_of_zero_marks_nothing(self, files):
        records = brs.make_records(brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1), "2-beam")
        for mast in (files / "mast.csv", pd.read_csv(files / "mast.csv")):
            found = brs.wind.with_mast(records, mast, position=(-98, 0, 0), invalid=(-999, 0))
            np.testing.assert_array_equal(
                found["mast_stress"].values[:, [0, 1, 3]], [[1.5, 1.0, 0.0], [np.nan, 1.0, np.nan]]
            )


def run(*words):
    return CliRunner().invoke(commands, [str(word) for word in words])


def scan_file(folder):
    return brs.save_scan(SIX, folder / "six.toml", overwrite=True)
