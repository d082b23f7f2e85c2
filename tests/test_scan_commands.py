"""Commands about scans: one that is shown, one that is found in files, and the scan auto."""

import json
import re
import shlex

import click
import numpy as np
import pytest
from click.testing import CliRunner
from ray_files import RayTable, mixed_hour, rays_of, six_beam, windcube_sweep, write_windcube

import bayes_rs as brs
from bayes_rs.cli.group import commands
from bayes_rs.cli.options import PictureFile
from bayes_rs.errors import InputError
from bayes_rs.fits.found_scan import with_found_scan
from bayes_rs.fits.settings import Settings
from bayes_rs.geometry.scan_words import beam_table, scan_lines
from bayes_rs.models import preset_names
from bayes_rs.pictures import picture_suffixes

SIX = six_beam(100.0)


def run(*words):
    return CliRunner().invoke(commands, [str(word) for word in words])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    series = brs.simulate(SIX, "fu-2022", wind_speed=8.0, n_records=2, seed=6)
    path = tmp_path_factory.mktemp("six") / "six_noon.nc"
    windcube_sweep(rays_of(series, SIX)).to_netcdf(path, engine="h5netcdf")
    return path


@pytest.fixture(scope="module")
def hour(tmp_path_factory):
    return mixed_hour(tmp_path_factory.mktemp("mixed") / "hour", n_gate=6, bursts=1)


class TestPictureNames:
    """What a picture's name ends in is checked before a file is read."""

    @pytest.mark.parametrize(
        "words",
        [
            ("scans", "6-beam", "-o"),
            ("look", "none.csv", "-o"),
            ("corner", "none", "-o"),
            ("sensitivity", "none.csv", "--budget"),
        ],
    )
    @pytest.mark.parametrize("name", ["p.xlsx", "p", "p.pgf"])
    def test_an_ending_that_is_none_is_refused(self, words, name, tmp_path):
        done = run(*words, tmp_path / name)
        assert done.exit_code == 2
        assert f"{name}' is no name of a " in " ".join(done.stderr.split())
        assert ".png" in done.stderr
        assert not list(tmp_path.iterdir())

    def test_every_option_that_names_a_picture_checks_it(self):
        context = click.Context(commands)
        every = [commands.get_command(context, name) for name in commands.list_commands(context)]
        options = [one for command in every for one in command.params if isinstance(one, click.Option)]
        written = [one for one in options if re.search(r"[Pp]icture .*to write|Picture to write", one.help or "")]
        assert len(written) == 4
        assert all(isinstance(one.type, PictureFile) for one in written)

    @pytest.mark.parametrize("suffix", picture_suffixes())
    def test_every_ending_that_is_offered_can_be_written(self, suffix, tmp_path):
        done = run("scans", "2-beam", "-o", tmp_path / f"p{suffix.upper()}")
        assert done.exit_code == 0, done.output
        assert (tmp_path / f"p{suffix.upper()}").stat().st_size > 1000


class TestScans:
    @pytest.mark.parametrize("name", preset_names("scans"))
    def test_each_is_shown(self, name):
        lines = scan_lines(brs.load_scan(name))
        assert lines[0].startswith(f"{name}: ")
        assert max(map(len, lines)) <= 110
        assert len(lines) < 45

    def test_one_line_by_line(self):
        done = run("scans", "pulsed-4-beam@focus_distance=100")
        assert (done.exit_code, done.stderr) == (0, "")
        lines = done.stdout.splitlines()
        assert lines[2:6] == [
            "beams     4, 15° from the axis; they look ahead, to 100 m",
            "timing    a cycle of 4 s: a beam has 150 samples in 600 s; all beams together 1 a second",
            "mounting  tilt 5 degrees",
            "probe     pulsed, gate of 30 m and top-hat pulse of 30 m",
        ]
        assert lines[-5:] == [
            "beam  opening°  phase°  distance m  height m  time s",
            "   0      15.0   160.4       100.0      17.1   0.000",
            "   1      15.0    19.6       100.0      17.1   1.000",
            "   2      15.0   199.6       100.0      -0.3   2.000",
            "   3      15.0   340.4       100.0      -0.3   3.000",
        ]

    def test_many_beams_are_cut_short(self):
        lines = beam_table(brs.load_scan("zx-300"))
        assert len(lines) == 13
        assert lines[-2] == "… 539 more beams …"
        assert lines[-1].split() == ["549", "187.2", "75.0", "310.6", "300.0", "10.980"]

    def test_a_picture(self, tmp_path):
        picture = tmp_path / "one.png"
        done = run("scans", "zx-tm", "-o", picture)
        assert done.exit_code == 0
        assert done.stdout.endswith(f"picture in {picture}\n")
        assert picture.read_bytes().startswith(b"\x89PNG")
        again = run("scans", "zx-tm", "-o", picture)
        assert isinstance(again.exception, InputError)
        assert run("scans", "zx-tm", "-o", picture, "--overwrite").exit_code == 0
        assert "draws one scan: name it" in run("scans", "-o", picture).output

    def test_the_picture_has_the_points_of_the_scan(self):
        scan = brs.load_scan("pulsed-4-beam")
        angles, above, beside = brs.plot.scan(scan).axes
        points = scan.line_of_sight * scan.focus_distance[:, np.newaxis]
        np.testing.assert_allclose(above.lines[-2].get_xydata(), points[:, [1, 0]] * [1.0, -1.0])
        np.testing.assert_allclose(beside.lines[-2].get_xydata(), points[:, [0, 2]] * [-1.0, 1.0])
        away = np.hypot(*angles.lines[-1].get_xydata().T)
        np.testing.assert_allclose(away, np.rad2deg(np.arccos(-scan.beam_direction[:, 0])))
        assert {text.get_text() for text in angles.texts} == {"0", "1", "2", "3"}


class TestFindScan:
    def test_writes_the_scan_and_says_what_comes_next(self, file, tmp_path):
        out = tmp_path / "six.toml"
        done = run("find-scan", file, "--height", 100, "--probe-gate-length", 40, "--positive", "away", "-o", out)
        assert (done.exit_code, done.stderr) == (0, ""), done.output
        found = brs.load_scan(out)
        assert (found.name, found.n_beam, found.probe.parameters()["gate_length"]) == ("six", 6, 40.0)
        expected = brs.find_scan(file, height=100.0, probe=found.probe)
        assert found.key == expected.key
        lines = done.stdout.splitlines()
        assert lines[0].startswith(f"{out}: 6 beams, from 240 rays of six_noon.nc, each within")
        assert lines[1].split() == [
            "beam",
            "azimuth°",
            "elevation°",
            "distance",
            "m",
            "height",
            "m",
            "time",
            "s",
            "rays",
        ]
        assert lines[2].split()[0] == "0"
        assert lines[2].split()[2:] == ["75.0", "103.5", "100.0", "0.000", "40"]
        assert "cycle of 30 s: 20 samples of a beam in 600 s" in lines
        assert "probe volume: pulsed, gate of 40 m and top-hat pulse of 40 m" in lines
        assert "sees all six stresses" in lines
        assert lines[-1] == f"next: bayes-rs fit {file} --scan {out} --positive away -o OUT/"

    def test_the_next_command_is_one(self, hour, tmp_path):
        out = tmp_path / "dbs.toml"
        done = run("find-scan", hour, "--height", 150, "--scan-group", 1, "-o", out)
        assert done.exit_code == 0, done.output
        words = shlex.split(done.stdout.splitlines()[-1].removeprefix("next: bayes-rs "))
        assert words == ["fit", str(hour / "*dbs*"), "--scan", str(out), "-o", "OUT/"]
        made = run("records", *words[1:-1], tmp_path / "records.nc")
        assert "75 of 75 samples used" in made.stderr
        told = [line for line in done.stdout.splitlines() if line.startswith("not of this scan: ")]
        assert [line.split()[4:6] for line in told] == [
            ["2:", "stare"],
            ["3:", "PPI,"],
            ["4:", "PPI,"],
            ["5:", "RHI,"],
        ]

    def test_files_that_no_pattern_tells_apart(self, hour, tmp_path):
        names = {}
        for number, path in enumerate(sorted(hour.iterdir())):
            names[path.name] = tmp_path / f"{number:03}.nc"
            names[path.name].write_bytes(path.read_bytes())
        done = run("find-scan", tmp_path, "--range", 150, "-o", tmp_path / "dbs.toml")
        assert done.exit_code == 0, done.output
        assert done.stdout.endswith(f"next: bayes-rs fit {tmp_path} --scan auto --range 150 -o OUT/\n")

    def test_a_lidar_that_shares_its_time(self, tmp_path):
        """Ten cycles of 20 s in every ten minutes: a beam has 10 of 30 samples."""
        seconds = (6e8 + 600.0 * np.arange(5)[:, None] + 5.0 * np.arange(40)).ravel()
        azimuth, elevation = np.tile([0.0, 90.0, 180.0, 270.0], 50), np.full(200, 75.0)
        table = RayTable(seconds, azimuth, elevation, np.full((200, 1), 100.0), np.ones((200, 1)))
        windcube_sweep(table).to_netcdf(tmp_path / "shared.nc", engine="h5netcdf")
        done = run("find-scan", tmp_path / "shared.nc", "-o", tmp_path / "dbs.toml")
        assert (
            "cycle of 20 s: 30 samples of a beam in 600 s\nin these files 10: the lidar shares its time" in done.stdout
        )
        assert done.stdout.splitlines()[-1].endswith("dbs.toml --min-availability 0.3 -o OUT/")

    def test_replaces_nothing_unasked(self, file, tmp_path):
        out = tmp_path / "six.toml"
        out.write_text("mine")
        done = run("find-scan", file, "--height", 100, "-o", out)
        assert isinstance(done.exception, InputError)
        assert out.read_text() == "mine"
        assert run("find-scan", file, "--height", 100, "-o", out, "--overwrite").exit_code == 0
        assert brs.load_scan(out).n_beam == 6

    @pytest.mark.parametrize(
        ("words", "match"),
        [
            (
                ["-o", "six.toml"],
                r"The gates that are there: in direction \(.*, 75\.0\).* heights 51\.7, 100, 148\.3 m",
            ),
            (["--height", "9e3", "-o", "six.toml"], "No gate at height 9000 m"),
            (["--height", "1", "--range", "1", "-o", "six.toml"], "Give height or distance"),
            (["--height", "100", "-o", "six.txt"], "must end in .toml"),
            (["--height", "100", "--probe", "6-beam", "-o", "six.toml"], "that scan has no probe volume"),
            (["--height", "100", "--probe", "zx-tm", "--probe-gate-length", "3", "-o", "six.toml"], "say the same"),
        ],
    )
    def test_what_is_refused(self, file, tmp_path, monkeypatch, words, match):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(Exception, match=match):
            commands.main(["find-scan", str(file), *words], standalone_mode=False)
        assert not list(tmp_path.iterdir())


class TestAuto:
    def test_records_are_those_of_the_found_scan(self, file, tmp_path):
        out = tmp_path / "records.nc"
        done = run("records", file, "--scan", "auto", "--height", 100, "--min-availability", 0.5, "-o", out)
        assert done.exit_code == 0, done.output
        said = "scan found: 6 beams at 100 to 103.5 m, a cycle of 30 s; 240 rays of six_noon.nc"
        assert done.stderr.splitlines()[0].startswith(said)
        scan = brs.find_scan(file, height=100.0)
        expected = brs.make_records(brs.read(file, scan), scan, min_availability=0.5)
        made = brs.records.open_record_files([out], scan)
        np.testing.assert_array_equal(made["variance"], expected["variance"])

    def test_a_fit_holds_what_repeats_it(self, file, tmp_path):
        options = ["--ess", 50, "--no-campaign", "--turbulence", "fu-2022", "--seed", 1]
        done = run("fit", file, "--scan", "auto", "--height", 100, *options, "-o", tmp_path / "one")
        assert done.exit_code == 0, done.output
        run_file = tmp_path / "one" / "run.json"
        told = json.loads(run_file.read_text())
        assert told["scan"] == "six_noon"
        assert "beams.beam" in told["scan_toml"]
        assert told["settings"]["files"]["height"] is None
        again = run("fit", run_file, "-o", tmp_path / "two")
        assert again.exit_code == 0, again.output
        one, two = (brs.open_fit(tmp_path / name) for name in ("one", "two"))
        np.testing.assert_array_equal(one.summary()["mean"], two.summary()["mean"])

    def test_several_heights_are_those_at_which_it_is_read(self, file):
        given = Settings().changed(files=[str(file)], scan="auto", height=(100.0, 150.0))
        found = with_found_scan(given, print)
        assert found.scan.load().n_beam == 6
        assert found.files.height == (100.0, 150.0)
        every = with_found_scan(given.changed(height=None, range="all"), print)
        assert every.scan.load().n_beam == 6
        assert every.files.range == "all"
        records = brs.make_records(brs.read(file, every.scan.load(), range="all"), every.scan.load())
        np.testing.assert_allclose(records["height"], [51.7, 100.0, 148.3], atol=0.1)

    def test_files_of_other_scans_are_not_read(self, hour, tmp_path):
        done = run("records", hour, "--scan", "auto", "--height", 150, "-o", tmp_path / "records.nc")
        lines = done.stderr.splitlines()
        assert [line.split(":")[0] for line in lines[1:5]] == ["not of this scan, and not read"] * 4
        assert "75 of 75 samples used" in done.stderr

    def test_of_many_files_some_are_looked_at(self, hour, monkeypatch):
        monkeypatch.setattr("bayes_rs.fits.found_scan.MOST_SURVEYED", 4)
        said = []
        given = Settings().changed(files=[str(hour / "*dbs*")], scan="auto", height=150.0)
        found = with_found_scan(given, said.append)
        assert found.files.files == given.files.files
        assert "20 rays of" in said[0]
        mixed = with_found_scan(given.changed(files=[str(hour)]), said.append)
        assert len(mixed.files.files) == 15  # of 22, all of which were looked at

    def test_settings_with_a_found_scan_are_saved_and_repeated(self, file, tmp_path):
        given = Settings().changed(files=[str(file)], scan="auto", height=100.0, tilt_deg=1.0)
        found = with_found_scan(given, print)
        assert with_found_scan(found, print) is found
        found.save(tmp_path / "s.toml")
        back = Settings.load(tmp_path / "s.toml").scan.load()
        assert back.key == found.scan.load().key
        assert (back.name, back.tilt) == ("six_noon", pytest.approx(np.deg2rad(1.0)))

    @pytest.mark.parametrize(
        ("options", "match"),
        [
            ({"height": None}, r"Give height or distance \(m; --height, --range\).* heights 51\.7, 100, 148\.3 m"),
            ({"range": 80.0}, "one of the two"),
            ({"opening_angle_deg": 20.0}, "Invalid opening_angle_deg with scan auto"),
            ({"focus_distance": [80.0]}, "Invalid focus_distance with scan auto"),
            ({"files": ()}, "found in files, and none is given"),
        ],
    )
    def test_what_is_refused(self, file, options, match):
        given = Settings().changed(**{"files": [str(file)], "scan": "auto", "height": 100.0, **options})
        with pytest.raises(InputError, match=match):
            with_found_scan(given, print)

    @pytest.mark.parametrize(
        ("options", "match"),
        [
            ({"scan_group": 2}, "Invalid scan_group with scan '6-beam'"),
            ({"scan": "auto", "scan_group": 0}, "Invalid scan_group 0"),
        ],
    )
    def test_options_that_do_not_fit(self, options, match):
        with pytest.raises(InputError, match=match):
            Settings().changed(**{"scan": "6-beam", **options})

    def test_without_files_there_is_no_auto(self):
        with pytest.raises(InputError, match="Scan auto is found in files of rays"):
            Settings().changed(scan="auto").scan.load()
        with pytest.raises(InputError, match="Scan auto is found in files of rays"):
            brs.load_scan("auto")


def test_a_file_in_groups_is_found_too(tmp_path):
    series = brs.simulate(SIX, "fu-2022", wind_speed=8.0, n_records=1, seed=6)
    write_windcube(tmp_path / "six.nc", windcube_sweep(rays_of(series, SIX)))
    done = run("find-scan", tmp_path / "six.nc", "--height", 100, "-o", tmp_path / "s.toml")
    assert done.exit_code == 0, done.output
