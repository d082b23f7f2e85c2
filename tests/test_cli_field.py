"""Commands and options for field data: wind, quality rules, motion, gradients."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import bayes_rs as brs
from bayes_rs.cli.group import commands
from bayes_rs.folder_lock import locked

pytestmark = pytest.mark.usefixtures("no_pictures")
SCAN = "6-beam"
SHORT = ("--ess", "50", "--seed", "1")
ANGLE = ("--scan", SCAN, "--opening-angle", "45", "--focus-distance", "52")


@pytest.fixture(scope="module")
def scan():
    return brs.load_scan(SCAN, opening_angle_deg=45.0, focus_distance=52.0)


@pytest.fixture(scope="module")
def series(scan):
    return brs.simulate(scan, brs.load_turbulence("fu-2022"), wind_speed=10.0, n_records=3, seed=4, shear=0.02)


@pytest.fixture(scope="module")
def file(series, tmp_path_factory):
    path = tmp_path_factory.mktemp("field") / "day.csv"
    frame = series.to_dataframe().reset_index(drop=True)[["time", "beam", "radial_velocity"]]
    frame["radial_velocity"] = frame["radial_velocity"].round(4)
    frame.to_csv(path, index=False, date_format="%Y-%m-%dT%H:%M:%S.%f")
    return path


def run(*words):
    return CliRunner().invoke(commands, [str(word) for word in words])


class TestWhatIsRead:
    """No command writes over a file that it reads, whatever it is told."""

    @pytest.mark.parametrize("command", ["records", "wind", "sensitivity"])
    @pytest.mark.parametrize("named", ["data.csv", ".", "*.csv", "far/../data.csv"])
    def test_it_is_not_written_over(self, file, tmp_path, monkeypatch, command, named):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "far").mkdir()
        data = file.read_bytes()
        Path("data.csv").write_bytes(data)
        done = run(command, named, *ANGLE, "-o", "data.csv", "--overwrite")
        assert "Output 'data.csv' is one of the files that are read" in str(done.exception)
        assert Path("data.csv").read_bytes() == data
        assert sorted(path.name for path in tmp_path.iterdir()) == ["data.csv", "far"]

    def test_nor_are_motion_and_settings(self, file, tmp_path):
        motion, settings = tmp_path / "motion.csv", tmp_path / "settings.toml"
        motion.write_text("time,tilt\n2024-01-01,5\n")
        brs.Settings().changed(files=(str(file),)).save(settings)
        columns = ("--motion-column", "time=time", "--motion-column", "tilt_deg=tilt")
        for words in ((file, *ANGLE, "--motion", motion, *columns, "-o", motion), (settings, "-o", settings)):
            before = Path(words[-1]).read_bytes()
            done = run("wind", *words, "--overwrite")
            assert "is one of the files that are read" in str(done.exception)
            assert Path(words[-1]).read_bytes() == before


class TestWind:
    def test_table_is_that_of_the_functions(self, file, scan, tmp_path):
        out = tmp_path / "wind.csv"
        done = run("wind", file, *ANGLE, "--heading", 350, "--hub-height", 80, "-o", out)
        assert done.exit_code == 0, done.output
        table = pd.read_csv(out, parse_dates=["time"])
        records = brs.make_records(brs.read(file, scan), scan)
        flow = brs.load_turbulence("fu-2022")
        wind = brs.wind.mean_wind(records, scan, turbulence=flow, heading_deg=350.0)
        for name in ("wind_speed", "wind_speed_sd", "yaw", "yaw_sd", "wind_direction"):
            np.testing.assert_allclose(table[name], wind[name], rtol=1e-12)
        profile = brs.wind.wind_profile(records, scan, turbulence=flow, hub_height=80.0)
        np.testing.assert_allclose(table["profile_shear_exponent"], profile["shear_exponent"], rtol=1e-12)
        assert (table["time"] == records["time"].values).all()
        assert "3 records" in done.output

    def test_without_a_hub_height_there_is_no_profile(self, file, tmp_path):
        assert run("wind", file, *ANGLE, "-o", tmp_path / "wind.csv").exit_code == 0
        assert not any(name.startswith("profile") for name in pd.read_csv(tmp_path / "wind.csv").columns)


class TestRecords:
    def test_quality_rules_reach_the_records(self, file, scan, tmp_path):
        out = tmp_path / "records.nc"
        rules = ("--velocity-range", -100, 0, "--min-wind-speed", 50, "--trend-level", 0.01, "--exclude", "low_wind")
        done = run("records", file, *ANGLE, *rules, "-o", out)
        assert done.exit_code == 0, done.output
        records = xr.load_dataset(out)
        expected = brs.make_records(
            brs.read(file, scan),
            scan,
            quality=brs.QualityRules(
                velocity_range=(-100.0, 0.0), min_wind_speed=50.0, trend_level=0.01, exclude=["low_wind"]
            ),
        )
        np.testing.assert_array_equal(records["flag"], expected["flag"])
        assert (records["flag"] > 0).all()  # all wind is below 50 m/s
        assert "trend_p_value" in records

    @pytest.mark.parametrize(
        ("made", "now", "words"),
        [
            ((), ("--tilt", 5), "(tilt 0° and 5°, in the records and now)"),
            (("--tilt", 5), (), "(tilt 5° and 0°, in the records and now)"),
            ((), ("--focus-distance", 80), "distance 98 m and 80 m"),
        ],
    )
    def test_of_scans_of_one_name_it_is_said_what_differs(self, file, tmp_path, made, now, words):
        named = ("--scan", "6-beam@opening_angle_deg=45")
        assert run("records", file, *named, *made, "-o", tmp_path / "r.nc").exit_code == 0
        done = run("fit", tmp_path / "r.nc", *named, *now, "-o", tmp_path / "out")
        assert words in str(done.exception)

    def test_motion_gives_each_record_its_own_tilt(self, file, series, tmp_path):
        motion = tmp_path / "motion.csv"
        time = np.unique(series["time"].values)[::60]
        tilt = np.where(np.arange(len(time)) < len(time) // 3, 1.0, 3.0)
        pd.DataFrame({"Timestamp": time, "Tilt": tilt, "Roll": 0.5}).to_csv(motion, index=False)
        out = tmp_path / "records.nc"
        columns = [
            word for pair in ("time=Timestamp", "tilt_deg=Tilt", "roll_deg=Roll") for word in ("--motion-column", pair)
        ]
        done = run("records", file, *ANGLE, "--motion", motion, *columns, "-o", out)
        assert done.exit_code == 0, done.output
        np.testing.assert_allclose(xr.load_dataset(out)["tilt"], [1.0, 3.0, 3.0], atol=0.1)
        np.testing.assert_allclose(xr.load_dataset(out)["roll"], 0.5, rtol=1e-12)
        assert "tilt and roll from 1 files, of 3 of 3 records" in done.output
        assert run("records", file, *ANGLE, "-o", tmp_path / "bare.nc").exit_code == 0
        again = run("records", tmp_path / "bare.nc", *ANGLE, "--motion", motion, *columns, "-o", tmp_path / "again.nc")
        assert again.exit_code == 0, again.output
        np.testing.assert_array_equal(xr.load_dataset(tmp_path / "again.nc")["tilt"], xr.load_dataset(out)["tilt"])

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            ((), "Invalid columns {}: give the heading of the time, and of what moves"),
            (("time=t", "tilt_deg=a", "--motion", "none.csv"), "No file 'none.csv'"),
            (("time=t", "tilt_deg=b"), "no column 'b'"),
            (("time=t", "heading_deg=a"), "neither tilt_deg nor roll_deg"),
            (("time=t", "tilt_deg=a", "velocity_x=a"), "bayes_rs.wind.remove_motion"),
        ],
    )
    @pytest.mark.parametrize("command", ["fit", "records", "spectra"])
    def test_what_is_wrong_with_motion_is_said_before_files_are_read(
        self, command, words, message, file, tmp_path, monkeypatch
    ):
        """With a good file of velocities, and with none that can be read: the motion is looked at first."""
        monkeypatch.chdir(tmp_path)
        (tmp_path / "mo.csv").write_text("t,a\n2000-01-01T00:00:01,1.5\n")
        (tmp_path / "bad.csv").write_text("time,beam,radial_velocity\noops,0,1\n")
        for velocities in (file, "bad.csv"):
            columns = [one for pair in words if "=" in pair for one in ("--motion-column", pair)]
            more = [word for word in words if "=" not in word]
            done = run(command, velocities, *ANGLE, "--motion", "mo.csv", *columns, *more, "-o", "out")
            assert message in str(done.exception)
            assert not hasattr(done.exception, "__notes__")
            assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.csv", "mo.csv"]

    def test_covariances_of_one_beam_are_refused_before_files_are_read(self, file, tmp_path):
        words = ("--scan", "staring", "--information", "covariances", "-o", tmp_path / "out")
        assert "one beam has no covariance with another" in str(run("fit", file, *words).exception)
        assert not (tmp_path / "out").exists()

    def test_what_marks_a_missing_entry_for_the_scan_does_so_for_the_motion(self, file, tmp_path):
        """A pulsed nacelle lidar writes tilt and roll beside the velocities, and 9999 for all of them."""
        scan, motion = tmp_path / "ours.toml", tmp_path / "motion.csv"
        brs.save_scan(replace(brs.load_scan("6-beam", opening_angle_deg=45.0), file_format={"invalid": [9999.0]}), scan)
        motion.write_text("Timestamp,Tilt\n2000-01-01T00:00:01,9999\n2000-01-01T00:00:02,1.5\n")
        columns = ("--motion-column", "time=Timestamp", "--motion-column", "tilt_deg=Tilt")
        done = run("records", file, "--scan", scan, "--motion", motion, *columns, "-o", tmp_path / "records.nc")
        assert done.exit_code == 0, done.output
        assert xr.load_dataset(tmp_path / "records.nc")["tilt"].values[0] == pytest.approx(1.5, rel=1e-12)

    def test_columns_of_no_motion_are_refused(self, file, tmp_path):
        done = run("records", file, *ANGLE, "--motion-column", "tilt_deg=Tilt", "-o", tmp_path / "records.nc")
        assert isinstance(done.exception, brs.InputError)
        assert "The option motion_columns is only used with motion: give the files" in str(done.exception)

    @pytest.mark.parametrize("command", ["fit", "wind", "sensitivity", "records"])
    def test_options_without_effect_on_records_are_refused(self, file, tmp_path, command):
        """They were applied when the records were made, or never: neither may pass for the other."""
        made = tmp_path / "made.nc"
        assert run("records", file, *ANGLE, "-o", made).exit_code == 0
        some = ("--duration", 600, "--cnr-range", -23, 0, "--positive", "towards")
        done = run(command, made, *ANGLE, *some, "-o", tmp_path / "out")
        assert done.exit_code == 2
        assert "--positive, --duration, --cnr-range: for radial velocities only, and " in done.output
        assert "made.nc' holds records that were made before: leave it out, or give the files" in done.output
        assert not (tmp_path / "out").exists()


class TestFit:
    @pytest.mark.parametrize("more", [(), ("--draws", "none")])
    def test_flags_are_told(self, file, tmp_path, more):
        """An instrument's noise above the variance leaves almost no stress: not without a word."""
        options = ("--instrument-noise", 2, "--sampler", "direct", "-v", *more)
        done = run("fit", file, *ANGLE, *options, "-o", tmp_path / "out")
        assert done.exit_code == 0, done.output
        assert "3 of 3 records fitted" in done.output
        words = "the instrument's noise that was given is above the variance of every beam; "
        assert f"3 of 3 records: {words}" in done.output
        for name in ("noise_above_variance", "beams_disagree"):
            assert f"flag {name}: 3 of 3 records, first record 0 (2000-01-01T00:00)" in done.output.splitlines()

    def test_noise_far_above_every_variance_is_refused(self, file, tmp_path):
        done = run("fit", file, *ANGLE, "--instrument-noise", 1000, "-o", tmp_path / "out")
        words = r"Invalid instrument_noise 1000 m² s⁻² \(--instrument-noise\), a standard deviation of 31\.6 m/s"
        assert re.search(words, str(done.exception))
        assert "or leave it out" in str(done.exception)

    def test_a_folder_that_is_being_written_is_not_replaced(self, file, tmp_path):
        """Nor by a fit of the other kind, which fills a folder of its own and puts it in the place of the old one."""
        out = tmp_path / "out"
        assert run("fit", file, *ANGLE, "--sampler", "direct", "--draws", "none", "-o", out).exit_code == 0
        before = {path: path.stat().st_mtime_ns for path in out.glob("**/*")}
        with locked(out):
            done = run("fit", file, *ANGLE, "--sampler", "direct", "-o", out, "--overwrite")
        assert isinstance(done.exception, brs.InputError)
        assert f"Output folder {str(out)!r} is being written by another run" in str(done.exception)
        assert {path: path.stat().st_mtime_ns for path in out.glob("**/*")} == before
        assert run("fit", file, *ANGLE, "--sampler", "direct", "-o", out, "--overwrite").exit_code == 0
        assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []

    def test_excluded_records_are_no_failures(self, file, tmp_path):
        rules = ("--min-wind-speed", 50, "--exclude", "low_wind")
        done = run("fit", file, *ANGLE, *rules, "--sampler", "direct", "-o", tmp_path / "out")
        assert done.exit_code == 0, done.output
        assert "0 of 3 records fitted" in done.output
        table = pd.read_csv(tmp_path / "out" / "summary.csv")
        assert table["mean"].isna().all()
        assert set(table["flag"]) == {"low_wind;excluded"}

    def test_a_folder_is_fitted_file_by_file(self, file, tmp_path):
        (tmp_path / "raw").mkdir()
        (tmp_path / "raw" / "day.csv").write_bytes(file.read_bytes())
        (tmp_path / "raw" / "junk.csv").write_text("no table")
        done = run("fit", tmp_path / "raw", *ANGLE, "--sampler", "auto", "--draws", "none", "-o", tmp_path / "out")
        assert done.exit_code == 1  # the file that cannot be used is a failure, and stops nothing
        assert "junk.csv" in done.output
        assert "3 of 3 records fitted" in done.output
        whole = run("fit", file, *ANGLE, "--sampler", "auto", "-o", tmp_path / "whole")
        assert whole.exit_code == 0
        one, other = (pd.read_csv(tmp_path / name / "summary.csv") for name in ("out", "whole"))
        pd.testing.assert_frame_equal(one.drop(columns=["time"]), other.drop(columns=["time"]), rtol=1e-12)
        assert run("report", tmp_path / "out").exit_code == 0
        assert (tmp_path / "out" / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")

    def test_gradients_reach_the_posterior(self, file, tmp_path):
        done = run(
            "fit",
            file,
            *ANGLE,
            "--vertical-gradient-sd",
            0.3,
            "--sampler",
            "direct",
            "--ess",
            200,
            "-o",
            tmp_path / "out",
        )
        assert done.exit_code == 0, done.output
        result = brs.open_fit(tmp_path / "out")
        assert "vertical_gradient" in result["posterior"]
        spread = result["posterior"]["vertical_gradient"].std().item()
        assert 0.1 < spread < 0.5

    def test_noise_of_the_records_is_what_they_tell(self, file, tmp_path):
        done = run("fit", file, *ANGLE, "--instrument-noise", "records", "-v", "-o", tmp_path / "out")
        assert done.exit_code == 0, done.output
        assert "instrument noise" in done.output

    def test_a_word_that_is_no_noise(self, file, tmp_path):
        done = run("fit", file, *ANGLE, "--instrument-noise", "much", "-o", tmp_path / "out")
        assert done.exit_code == 2
        assert "'much' must be a number, m² s⁻², or the word records." in done.output


def test_motion_is_written_as_the_velocities_are(file, series, tmp_path):
    """A logger writes all its files with the same separator and decimal sign."""
    ours, motion = tmp_path / "ours.csv", tmp_path / "motion.csv"
    pd.read_csv(file).to_csv(ours, index=False, sep=";", decimal=",")
    time = np.unique(series["time"].values)[::60]
    pd.DataFrame({"time": time, "tilt_deg": 1.5}).to_csv(motion, index=False, sep=";", decimal=",")
    columns = ("--motion-column", "time=time", "--motion-column", "tilt_deg=tilt_deg")
    written = ("--separator", ";", "--decimal", ",", *columns)
    done = run("records", ours, *ANGLE, *written, "--motion", motion, "-o", tmp_path / "records.nc")
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(xr.load_dataset(tmp_path / "records.nc")["tilt"], 1.5, rtol=1e-12)


class TestMast:
    """What a mast measured beside, from files: the same numbers as with `with_mast`."""

    PLACE = ("--mast-position", -98, 5, 2)

    @pytest.fixture
    def records(self, file, scan):
        return brs.make_records(brs.read(file, scan), scan)

    @pytest.fixture
    def table(self, records, tmp_path):
        path = tmp_path / "mast.csv"
        stress = np.array([[1.4, 0.9, 0.5, 0.1, -0.3, 0.0]]) * np.array([[1.0], [0.9], [1.1]])
        columns = dict(zip(brs.STRESSES, stress.T, strict=True))
        pd.DataFrame({"time": records["time"].values, **columns}).to_csv(path, index=False)
        return path

    def test_fit_takes_it_as_data(self, file, records, scan, table, tmp_path):
        out = tmp_path / "out"
        done = run("fit", file, *ANGLE, *SHORT, "--mast", table, *self.PLACE, "-o", out)
        assert done.exit_code == 0, done.output
        assert "the beams and the mast beside measured" in done.output
        beside = brs.wind.with_mast(records, table, position=(-98, 5, 2))
        expected = brs.fit(beside, scan, seed=1, target_ess=50).summary()
        found = brs.open_fit(out)
        pd.testing.assert_frame_equal(found.summary(), expected, check_exact=True)
        alone = brs.fit(records, scan, seed=1, target_ess=50).summary()
        assert (found.summary()["sd"] < 0.95 * alone["sd"]).any()
        reference = pd.DataFrame({"time": records["time"].values, "ti": 0.11})
        page = brs.write_report(found, tmp_path / "page.html", reference=reference).read_text()
        assert "What a mast measured is among the data of this fit" in page
        told = found.settings["records"]
        assert told["mast"] == [str(table)]
        assert told["mast_position"] == [-98.0, 5.0, 2.0]
        again = run("fit", out / "run.json", "-o", tmp_path / "again")
        assert again.exit_code == 0, again.output
        pd.testing.assert_frame_equal(brs.open_fit(tmp_path / "again").summary(), expected, check_exact=True)

    def test_records_hold_it(self, file, table, tmp_path):
        done = run("records", file, *ANGLE, "--mast", table, *self.PLACE, "-o", tmp_path / "with.nc")
        assert done.exit_code == 0, done.output
        assert "a mast at (-98, 5, 2) m is data of the fit: it has stresses of 3 of 3 records" in done.output
        assert run("records", file, *ANGLE, "-o", tmp_path / "bare.nc").exit_code == 0
        held = xr.load_dataset(tmp_path / "with.nc")["mast_stress"].values
        np.testing.assert_allclose(held, pd.read_csv(table)[list(brs.STRESSES)].to_numpy(), rtol=1e-12)
        for name, more in (("with", ()), ("bare", ("--mast", table, *self.PLACE))):
            done = run("fit", tmp_path / f"{name}.nc", *ANGLE, *SHORT, *more, "-o", tmp_path / name)
            assert done.exit_code == 0, done.output
        one, other = (brs.open_fit(tmp_path / name).summary() for name in ("with", "bare"))
        pd.testing.assert_frame_equal(one, other, check_exact=True)

    def test_rows_a_minute_apart_are_told(self, file, table, tmp_path):
        time = np.datetime64("2000-01-01") + np.arange(30) * np.timedelta64(60, "s")
        pd.DataFrame({"time": time, "uu": 1.0}).to_csv(table, index=False)
        done = run("records", file, *ANGLE, "--mast", table, *self.PLACE, "-o", tmp_path / "with.nc")
        assert "has rows 60 s apart, and the records last 600 s" in done.output
        assert "it has stresses of 3 of 3 records of 600 s" in done.output

    def test_records_of_two_masts_are_not_fitted_together(self, file, table, tmp_path):
        for name, place in (("one", (-98, 5, 2)), ("two", (-98, -5, 2))):
            words = ("--mast", table, "--mast-position", *place, "-o", tmp_path / f"{name}.nc")
            assert run("records", file, *ANGLE, *words).exit_code == 0
        done = run("fit", tmp_path / "one.nc", tmp_path / "two.nc", *ANGLE, "-o", tmp_path / "out")
        assert "have a mast at [-98.0, -5.0, 2.0] and those in" in str(done.exception)

    @pytest.mark.parametrize("command", ["fit", "records", "sensitivity", "spectra"])
    def test_a_wrong_file_is_said_before_anything_is_read(self, command, file, table, tmp_path, monkeypatch):
        def read(*_args, **_options):
            raise AssertionError("files were read")

        monkeypatch.setattr("bayes_rs.records.record_store.store_records", read)
        monkeypatch.setattr("bayes_rs.fits.from_files.store_records", read)
        monkeypatch.setattr("bayes_rs.records.making.make_records", read)
        pd.read_csv(table).rename(columns={"uu": "sigma_u"}).to_csv(table, index=False)
        done = run(command, file, *ANGLE, "--mast", table, *self.PLACE, "-o", tmp_path / "out")
        assert isinstance(done.exception, brs.InputError)
        assert "needs time and at least uu: rename them." in str(done.exception)
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (("--mast", "mast.csv"), "The option mast needs mast_position (--mast-position X Y Z): say where"),
            (("--mast-position", 1, 2, 3), "The option mast_position is only used with mast: give its files"),
            (("--mast-log-sd", 0.4), "The option mast_log_sd is only used with a mast beside the beams: give that"),
            (("--coherence-log-sd", 0.4), "The option coherence_log_sd is only used with information 'covariances'"),
            (("--mast", "none.csv", *PLACE), "File 'none.csv' does not exist: check its path."),
            (("--mast", "mast.csv", *PLACE, "--yaw-sd", 2), "Invalid uncertain yaw_error with a mast beside the beams"),
            (("--mast", "mast.csv", *PLACE, "--target", "sonic"), "Invalid target 'sonic' with a mast beside the"),
        ],
    )
    def test_what_does_not_go_together_is_refused_at_once(self, options, message, file, table, tmp_path, monkeypatch):
        monkeypatch.chdir(table.parent)
        done = run("fit", file, *ANGLE, *options, "-o", tmp_path / "out")
        assert message in str(done.exception)
        assert not (tmp_path / "out").exists()

    def test_what_is_read_is_kept_and_what_goes_on_is_said(self, file, table, tmp_path):
        """A mast of another day is known when the files are read: resume goes on from these once it is corrected."""
        right = table.read_text()
        table.write_text(right.replace("2000-", "2001-"))
        words = ("fit", file, *ANGLE, "--mast", table, *self.PLACE, "-o", tmp_path / "out")
        done = run(*words)
        assert "begins with a record" in str(done.exception)
        (note,) = done.exception.__notes__
        assert "is kept in" in note
        assert "once the input is corrected, the same call with resume goes on from there" in note
        table.write_text(right)
        assert run(*words, "--resume").exit_code == 0

    def test_a_mast_of_another_day(self, file, table, tmp_path):
        frame = pd.read_csv(table)
        frame["time"] = (pd.to_datetime(frame["time"]) + pd.Timedelta("400D")).astype(str)
        frame.to_csv(table, index=False)
        done = run("records", file, *ANGLE, "--mast", table, *self.PLACE, "-o", tmp_path / "r.nc")
        assert "(2001-02-04T00:00:00 to 2001-02-04T00:20:00) begins with a record (2000-01-01T00:00:00" in str(
            done.exception
        )

    def test_one_that_stands_beside_several_ranges(self, table, series, tmp_path):
        far = tmp_path / "far.csv"
        frame = series.to_dataframe().reset_index(drop=True)[["time", "beam", "radial_velocity"]]
        pd.concat([frame.assign(range=r) for r in (40.0, 80.0)]).to_csv(far, index=False)
        words = ("--scan", SCAN, "--mast", table, *self.PLACE, "-o", tmp_path / "r.nc")
        for command in ("records", "fit"):  # before hours of reading
            done = run(command, far, "--range", "40,80", *words)
            assert "A mast stands beside records of one range: read the files of radial" in str(done.exception)
            assert not list(tmp_path.glob("r.nc*"))
        made = run("records", far, "--scan", SCAN, "--range", "40,80", "-o", tmp_path / "both.nc")
        assert made.exit_code == 0, made.output
        done = run("records", tmp_path / "both.nc", *words)
        assert "The records are at 2 ranges (40, 80 m), and those of one" in str(done.exception)

    def test_the_wind_has_no_use_for_one(self, file, table, tmp_path):
        done = run("wind", file, *ANGLE, "--mast", table, *self.PLACE, "-o", tmp_path / "w.csv")
        assert done.exit_code == 2
        assert "No such option" in done.output
        done = run("wind", file, *ANGLE, "--correlations", "-o", tmp_path / "w.csv")  # nor for these
        assert done.exit_code == 2
        assert "No such option" in done.output
