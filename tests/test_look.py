"""A first look at files: what is said of them, and that the command that is proposed is one."""

import shlex
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from ray_files import mixed_hour, rays_of, six_beam, windcube_sweep

import bayes_rs as brs
from bayes_rs.cli.group import commands
from bayes_rs.errors import InputError
from bayes_rs.plot.look_plot import draw_look
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.look_table import look_at_table, over_phase
from bayes_rs.readers.looking import look, sparkline


def run(*words):
    return CliRunner().invoke(commands, [str(word) for word in words])


def proposed(words, **filled):
    """The proposed command, with what a person puts for the words that it leaves open."""
    return ["".join(filled.get(word, word)) for word in words]


@pytest.fixture(scope="module")
def series():
    return brs.simulate("zx-tm@probe=point", "fu-2022", wind_speed=9.0, duration=60.0, n_records=2, seed=1, shear=0.04)


def zx_table(series, zero, turns):
    """A table as of a ZX: phases from `zero` that turn up or down, velocities positive towards the lidar."""
    angle = 7.2 * series["beam"].values
    way = 1.0 if turns == "up" else -1.0
    frame = pd.DataFrame(
        {
            "Timestamp (ISO 8601)": pd.DatetimeIndex(series["time"].values).strftime("%Y-%m-%dT%H:%M:%S.%f"),
            "Phase (deg)": ((angle - zero) * way) % 360.0,
            "LOS Velocity (m/s)": -series["radial_velocity"].values.round(3),
        }
    )
    return frame.iloc[np.argsort(series["time"].values, kind="stable")]


class TestRays:
    def test_a_file_of_beams(self, tmp_path):
        scan = six_beam(100.0)
        table = rays_of(brs.simulate(scan, "fu-2022", wind_speed=8.0, n_records=2, seed=6), scan)
        velocity = table.velocity.copy()
        velocity[:24, 1] = np.nan
        windcube_sweep(type(table)(table.seconds, table.azimuth, table.elevation, table.distance, velocity)).to_netcdf(
            tmp_path / "six.nc", engine="h5netcdf"
        )
        found = look(tmp_path / "six.nc")
        azimuths = [line.split()[1] for line in found.lines if line.startswith("  azimuth")]
        assert azimuths == ["0.0", "0.0", "72.0", "144.0", "216.0", "288.0"]
        (tmp_path / "cut.nc").write_bytes((tmp_path / "six.nc").read_bytes()[:3000])
        with pytest.raises(InputError, match=r"cut.nc' cannot be read as NetCDF: .*; check that it is complete"):
            look(tmp_path / "cut.nc")
        assert found.lines[1].startswith("format: windcube, rays that say where they point; positive away, ")
        assert "(by the format: positive, time_stamp, status_valid)" in found.lines[1]
        assert found.lines[2].startswith("scan 1: 6 beams (azimuth, elevation) (0.0, 75.0), ")
        assert "a beam every 30 s, median; no gap" in found.lines[3]
        assert found.lines[4].startswith("missing or invalid: 3.3 % of all gates, 0.0 % at 53")
        assert sum("rays     40" in line for line in found.lines) == 6
        assert found.words[:2] == ("find-scan", str(tmp_path / "six.nc"))
        done = run(*found.words[:-1], tmp_path / "scan.toml")
        assert done.exit_code == 0, done.output

    def test_a_folder_of_several_scans_is_looked_at_in_part(self, tmp_path):
        folder = mixed_hour(tmp_path / "hour", n_gate=4, bursts=2)
        found = look(folder)
        assert found.lines[0].startswith("40 files, ")
        assert found.lines[1] == "looked at 17 of them: the first ones, and others evenly chosen"
        assert any(line.startswith("scan 2: stare at ") for line in found.lines)
        assert any(line.endswith("a beam every 20 s, median") for line in found.lines)
        azimuth = found.phase_deg[np.isfinite(found.over_phase)]
        assert azimuth.tolist() == [0.0, 90.0, 180.0, 270.0]

    def test_gaps_are_counted_where_all_is_looked_at(self, tmp_path):
        folder = mixed_hour(tmp_path / "hour", n_gate=4, bursts=1)
        kept = [str(file) for file in sorted(folder.glob("*dbs*"))]
        found = look([*kept[:5], *kept[-5:]])
        assert any("1 gap of 104 s; samples in 72 % of the time" in line for line in found.lines)


class TestTables:
    @pytest.mark.parametrize("turns", ["up", "down"])
    @pytest.mark.parametrize("zero", [0.0, 90.0, 270.0])
    def test_a_phase_zero_is_found_where_shear_tells_it(self, series, tmp_path, zero, turns):
        file = tmp_path / "zx.csv"
        zx_table(series, zero, turns).to_csv(file, index=False)
        found = look(file)
        likely = {tuple(line.split()[:4]) for line in found.lines if line.endswith("likely")}
        assert ("--phase-zero", f"{zero:g}", "--phase-turns", turns) in likely
        assert len(likely) == 2  # zero up and which way, or zero sideways here and there
        assert any("counts positive towards" in line for line in found.lines)
        words = proposed(found.words, TURNS=turns, ZERO=f"{zero:g}")
        assert words[words.index("--phase-zero") + 1] == f"{zero:g}"
        done = run("records", *words[1:-1], tmp_path / "records.nc", "--duration", 60)
        assert done.exit_code == 0, done.output
        scan = brs.load_scan("zx-tm")
        made = brs.records.open_record_files([tmp_path / "records.nc"], scan)
        expected = brs.make_records(series, brs.load_scan("zx-tm@probe=point"), duration=60.0)
        np.testing.assert_allclose(made["variance"], expected["variance"], rtol=1e-2)  # velocities of three digits

    def test_the_command_refuses_to_be_typed_without_the_turns(self, series, tmp_path):
        zx_table(series, 90.0, "up").to_csv(tmp_path / "zx.csv", index=False)
        done = run(*look(tmp_path / "zx.csv").words)
        assert done.exit_code == 2
        assert "TURNS" in done.output

    def test_a_long_table_with_marks_and_a_decimal_comma(self, tmp_path):
        times = pd.date_range("2020-09-03", periods=400, freq="1s").strftime("%Y-%m-%dT%H:%M:%S")
        frame = pd.DataFrame({"Date and Time": times, "LOS": np.arange(400) % 2, "RWS": 8.0 + np.arange(400) % 7})
        frame.loc[[3, 9], "RWS"] = 9999.0
        text = frame.to_csv(index=False, sep=";", decimal=",")
        (tmp_path / "a.csv").write_text("exported by someone\n" + text, encoding="utf-8")
        found = look(tmp_path / "a.csv")
        assert "1 lines above the headings" in found.lines
        assert "2 beams, samples of each: 0: 200, 1: 200" in found.lines
        assert any("a beam every 2 s, median; no gap" in line for line in found.lines)
        assert "2 velocities are beyond 90 m/s, most often 9999" in found.lines
        assert [*found.words[found.words.index("--separator") :]][:4] == ["--separator", ";", "--decimal", ","]
        assert found.words[found.words.index("--invalid") + 1] == "9999"
        assert "radial_velocity=RWS" in found.words

    @pytest.mark.parametrize(("factor", "name", "epoch"), [(1.0, "unix", 1.6e9), (1.0, "labview", 3.68e9)])
    def test_times_as_numbers(self, tmp_path, factor, name, epoch):
        frame = pd.DataFrame({"time": epoch + factor * np.arange(50), "beam": 0, "radial_velocity": -5.0})
        frame.to_parquet(tmp_path / "a.parquet")
        found = look(tmp_path / "a.parquet")
        assert found.words[found.words.index("--time-format") + 1] == name
        assert "samples from 2020-" in " ".join(found.lines)
        assert "--positive away" in " ".join(found.words)

    def test_a_table_without_headings(self, tmp_path):
        (tmp_path / "a.txt").write_text("\n".join(f"{3600 + i};{i % 3};-5.{i % 10}" for i in range(30)) + "\n")
        found = look(tmp_path / "a.txt")
        assert [line.split()[0] for line in found.lines[3:6]] == ["1", "2", "3"]
        named = look(tmp_path / "a.txt", columns={"beam": "2", "radial_velocity": "3"})
        assert "3 beams, samples of each: 0: 10, 1: 10, 2: 10" in named.lines

    def test_empty_entries_of_a_table_with_semicolons(self, tmp_path):
        (tmp_path / "a.csv").write_text("time;beam;radial_velocity\n" + "2020-01-01T00:00:00;;\n" * 4)
        assert "no velocity is a number" in look(tmp_path / "a.csv").lines

    @pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-8-sig"])
    def test_encodings(self, tmp_path, encoding):
        text = "time,Höhe °,beam\n2020-01-01T00:00:00,3,1\n2020-01-01T00:00:01,3,1\n"
        (tmp_path / "a.csv").write_bytes(text.encode(encoding))
        table = look_at_table(tmp_path / "a.csv", FileFormat())
        assert table.headings == ("time", "Höhe °", "beam")

    @pytest.mark.parametrize("content", [b"", b"one word\n", b"\x00\x01\x02" * 100])
    def test_what_is_no_table(self, tmp_path, content):
        (tmp_path / "a.csv").write_bytes(content)
        with pytest.raises(InputError, match=r"File '.*a\.csv'"):
            look(tmp_path / "a.csv")


class TestCommand:
    def test_says_lines_and_the_command(self, series, tmp_path):
        zx_table(series, 90.0, "up").to_csv(tmp_path / "zx.csv", index=False)
        done = run("look", tmp_path / "zx.csv", "--positive", "towards", "-o", tmp_path / "look.png")
        assert done.exit_code == 0, done.output
        assert (tmp_path / "look.png").read_bytes().startswith(b"\x89PNG")
        found = look(tmp_path / "zx.csv")
        titles = [[axis.get_title() for axis in draw_look(one).axes] for one in (found, replace(found, over_phase=[]))]
        assert titles == [["mean over the phase", "the first samples"], ["the first samples"]]
        words = shlex.split(done.stdout.splitlines()[-1].removeprefix("next: bayes-rs "))
        assert words[:4] == ["fit", str(tmp_path / "zx.csv"), "--scan", "zx-tm"]
        assert words[-4:] == ["--positive", "towards", "-o", "OUT/"]
        assert words.count("--positive") == 1

    def test_a_series_of_our_own(self, series, tmp_path):
        series.to_netcdf(tmp_path / "own.nc", engine="h5netcdf")
        done = run("look", tmp_path / "own.nc")
        assert "a series of radial velocities, as bayes_rs writes them" in done.stdout

    def test_what_is_not_there(self, tmp_path):
        done = run("look", tmp_path / "none.csv")
        assert isinstance(done.exception, InputError)


def test_sparkline_and_bins():
    assert sparkline(np.array([0.0, np.nan, 0.5, 1.0])) == "▁·▅█"
    assert sparkline(np.array([np.nan])) == ""
    over = over_phase(np.array([359.0, 1.0, 90.0, np.nan]), np.array([1.0, 3.0, 5.0, 7.0]))
    assert (over[0], over[9]) == (2.0, 5.0)
    assert np.isfinite(over).sum() == 2
