"""Text files of rays: what is written as instruments write it is read back, and the scan is found in it."""

from __future__ import annotations

import json
import re
from typing import ClassVar

import numpy as np
import pytest
from format_files import compress, series_of
from ray_files import SLANT, rays_of, six_beam
from ray_text_files import (
    HEIGHTS,
    at_heights,
    gate_frame,
    ray_frame,
    write_molas,
    write_rtd,
    write_scn,
    write_windscanner,
)

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers import READERS, find_scan, read
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.galion import galion_rays
from bayes_rs.readers.windcube_text import windcube_text_rays
from bayes_rs.readers.windscanner import windscanner_rays

SIX = six_beam(100.0, 150.0, step=1.0)
SERIES = series_of(SIX, n_scan=20)
RAYS = rays_of(SERIES, SIX, rough=False)
MILLISECOND = np.timedelta64(1, "ms")
RISE = np.sin(np.deg2rad(SLANT))
GALION = Scan(
    "galion", SIX.beam_direction[:6], np.full(6, 75.0), SIX.beam_time[:6], scan_duration=6.0, beam=np.arange(6)
)


def resolved(name, **options):
    return resolve_format(FileOptions(**options), None, defaults=READERS[name].defaults)


def report_of(series):
    return json.loads(series.attrs["read_report"])


def assert_read_back(series, reference=SERIES):
    """The same samples; text of times has milliseconds, and of velocities all four digits that there are."""
    order = np.lexsort((reference["beam"].values, reference["time"].values))
    np.testing.assert_array_equal(series["beam"], reference["beam"].values[order])
    assert np.abs(series["time"].values - reference["time"].values[order]).max() <= MILLISECOND
    velocity = reference["radial_velocity"].values[order]
    np.testing.assert_array_equal(series["radial_velocity"], velocity)


def assert_found(scan, expected=SIX):
    chord = np.linalg.norm(scan.beam_direction - expected.beam_direction, axis=1)
    assert np.rad2deg(chord).max() < 1e-5
    np.testing.assert_allclose(scan.focus_distance, expected.focus_distance, rtol=1e-7)
    np.testing.assert_allclose(scan.beam_time, expected.beam_time, atol=1e-9)
    assert scan.scan_duration == pytest.approx(expected.scan_duration)


WRITERS = {
    "windscanner": lambda folder: write_windscanner(folder / "a.txt", RAYS),
    "windscanner, two numbers before": lambda folder: write_windscanner(folder / "a.txt", RAYS, n_before=2),
    "windcube-text": lambda folder: write_rtd(folder / "a.rtd", at_heights(RAYS)),
    "windcube-text, stdrtd": lambda folder: write_rtd(folder / "a.stdrtd", at_heights(RAYS)),
    "windcube-text, version 1": lambda folder: write_rtd(folder / "a.rtd", at_heights(RAYS), version=1),
    "molas": lambda folder: write_molas(folder / "a.csv", RAYS),
}


@pytest.mark.parametrize("name", WRITERS)
class TestWrittenAndRead:
    def test_same_samples(self, tmp_path, name):
        series = read(WRITERS[name](tmp_path), SIX)
        assert_read_back(series)
        report = report_of(series)["files"][0]
        assert report["format"] == name.split(",")[0]
        assert (report["rows"], report["rows_dropped"], report["rows_without_beam"]) == (120, 0, 0)
        np.testing.assert_allclose(series["cnr"], -12.5)

    def test_the_scan_is_found(self, tmp_path, name):
        assert_found(find_scan(WRITERS[name](tmp_path), height=(100.0, 150.0)))

    def test_compressed(self, tmp_path, name):
        assert_read_back(read(compress(WRITERS[name](tmp_path), ".gz"), SIX))


class TestBadRows:
    """Lines of another length, and entries that are no numbers, in the middle of a file."""

    CASES: ClassVar = {
        "windscanner": (lambda folder: write_windscanner(folder / "a.txt", RAYS), 0, ";", {}),
        "windcube-text": (lambda folder: write_rtd(folder / "a.rtd", at_heights(RAYS)), 12, "\t", {}),
        "galion": (lambda folder: write_scn(folder / "a.scn", RAYS), 6, "\t", {"gate_length": 50.0}),
    }  # the last two: lines of header, and what separates entries

    @pytest.mark.parametrize("name", CASES)
    def test_are_refused_or_left_out_counted_and_the_first_named(self, tmp_path, name):
        write, n_head, separator, options = self.CASES[name]
        file = write(tmp_path)
        whole = READERS[name].rays(file, resolved(name, **options))
        lines = file.read_bytes().split(b"\n")
        lines[n_head + 3] = lines[n_head + 3][:30]
        words = lines[n_head + 6].decode("latin-1").split(separator)
        words[1 if name == "galion" else 5] = "oops"
        lines[n_head + 6] = separator.join(words).encode("latin-1")
        file.write_bytes(b"\n".join(lines))
        with pytest.raises(
            InputError, match=rf"Line {n_head + 4} of file .* entries, .* bad_rows='drop' \(--bad-rows drop"
        ):
            READERS[name].rays(file, resolved(name, **options))
        rays = READERS[name].rays(file, resolved(name, bad_rows="drop", **options))
        assert rays.counts["rows_bad"] == 2
        assert rays.facts["first_bad_row"].startswith(f"Line {n_head + 4} of file")
        if name == "galion":  # a row is a gate there
            gone = np.isnan(rays.radial_velocity) & ~np.isnan(whole.radial_velocity)
            assert gone.sum() == 2
            np.testing.assert_array_equal(rays.radial_velocity[~gone], whole.radial_velocity[~gone])
        else:
            kept = np.delete(np.arange(len(whole.time)), [3, 6])
            for field in ("time", "radial_velocity", "distance", "direction", "cnr", "row"):
                np.testing.assert_array_equal(getattr(rays, field), getattr(whole, field)[kept], err_msg=field)

    def test_a_file_with_many_is_none(self, tmp_path):
        file = write_windscanner(tmp_path / "a.txt", RAYS)
        lines = file.read_text().split("\n")
        lines[10:30] = ["cut"] * 20
        file.write_text("\n".join(lines))
        with pytest.raises(
            InputError, match=r"has 20 bad rows of 100, more than may be left out .* the first: Line 11"
        ):
            read(file, SIX, bad_rows="drop")


class TestWindScanner:
    def test_the_time_is_the_start_and_the_stop_gives_the_duration(self, tmp_path):
        file = write_windscanner(tmp_path / "a.txt", RAYS, duration=0.4)
        assert_read_back(read(file, SIX))
        late = read(file, SIX, time_stamp="end")
        assert (read(file, SIX)["time"].values - late["time"].values == np.timedelta64(400, "ms")).all()

    def test_a_cut_last_line_is_dropped_and_counted(self, tmp_path):
        file = write_windscanner(tmp_path / "a.txt", RAYS)
        file.write_bytes(file.read_bytes()[:-60] + b"\0" * 500)
        series = read(file, SIX)
        assert report_of(series)["files"][0]["rows_cut"] == 1
        assert series.sizes["sample"] == SERIES.sizes["sample"] - 2

    def test_a_cut_number_is_not_believed(self, tmp_path):
        """A line that lacks its end is whole only if what was read of it stands before the cut."""
        file = write_windscanner(tmp_path / "a.txt", RAYS.take(slice(0, 12)))
        whole = file.read_bytes()
        for n in range(1, 40):
            file.write_bytes(whole[:-n])
            rays = windscanner_rays(file, resolved("windscanner"))
            assert len(rays.time) in (11, 12)
            np.testing.assert_array_equal(rays.radial_velocity, np.round(RAYS.velocity[: len(rays.time)], 4))

    def test_a_line_of_another_length_is_named(self, tmp_path):
        file = write_windscanner(tmp_path / "a.txt", RAYS)
        lines = file.read_text().split("\n")
        lines[3] = lines[3][:-20]
        file.write_text("\n".join(lines))
        with pytest.raises(InputError, match=r"Line 4 of file '.*a\.txt' has 2\d entries, and must have 24: correct"):
            read(file, SIX)

    def test_a_word_is_named_with_its_line(self, tmp_path):
        file = write_windscanner(tmp_path / "a.txt", RAYS)
        lines = file.read_text().split("\n")
        words = lines[7].split(";")
        words[9] = "fast"
        lines[7] = ";".join(words)
        file.write_text("\n".join(lines))
        with pytest.raises(InputError, match=r"Invalid radial_velocity 'fast' in column '10', line 8 of file"):
            read(file, SIX)

    @pytest.mark.parametrize("text", ["", "1;2;3\n", "a;b\n", "0;271;13511;13560;1.5;2.5;37.1;4.2;100;3.5;-18.5;0.6\n"])
    def test_other_files_are_refused(self, tmp_path, text):
        (tmp_path / "a.txt").write_text(text)
        with pytest.raises(InputError, match="does not begin with a ray as a WindScanner writes it"):
            read(tmp_path / "a.txt", SIX, file_format="windscanner")


class TestGalion:
    def test_same_samples(self, tmp_path):
        series = series_of(GALION, n_scan=20)
        table = rays_of(series, GALION, rough=False)
        file = write_scn(tmp_path / "a.scn", table)  # gates 0 to 2 at 25, 75 and 125 m
        back = read(file, GALION, gate_length=50.0)
        assert_read_back(back, series)
        np.testing.assert_allclose(back["cnr"], -10.0)
        assert_found(find_scan(file, distance=75.0, gate_length=50.0), GALION)

    def test_the_gates_need_a_length(self, tmp_path):
        file = write_scn(tmp_path / "a.scn", RAYS)
        with pytest.raises(InputError, match=r"numbers its gates and does not say how long they are: give gate_length"):
            read(file, SIX)

    def test_a_ray_that_is_cut_off_has_the_gates_that_are_there(self, tmp_path):
        file = write_scn(tmp_path / "a.scn", RAYS)
        file.write_bytes(file.read_bytes()[:-30])
        rays = galion_rays(file, resolved("galion", gate_length=50.0))
        assert rays.radial_velocity.shape == RAYS.velocity.shape
        assert np.isnan(rays.radial_velocity[-1, -1])
        assert rays.counts["rows_cut"] == 1

    def test_no_headings(self, tmp_path):
        (tmp_path / "a.scn").write_text("Filename:\ta.scn\n0\t1.5\t1.1\n")
        with pytest.raises(InputError, match=r"has no line of headings range gate, doppler, intensity, ray time"):
            read(tmp_path / "a.scn", SIX, gate_length=30.0)

    def test_a_bad_time_is_named_with_its_line(self, tmp_path):
        file = write_scn(tmp_path / "a.scn", RAYS)
        lines = file.read_text().split("\n")
        for index in (10, 11):
            lines[index] = re.sub(r"2024-03-01 [\d:.]+", "yesterday", lines[index])
        file.write_text("\n".join(lines))
        with pytest.raises(InputError, match=r"Invalid time 'yesterday' in column 'ray time', line 11 of file"):
            read(file, SIX, gate_length=30.0)


class TestWindCubeText:
    def test_a_gate_is_its_height_over_the_sine_of_the_elevation(self, tmp_path):
        file = write_rtd(tmp_path / "a.rtd", at_heights(RAYS))
        rays = windcube_text_rays(file, resolved("windcube-text"))
        up = rays.direction[:, 2] > 0.999
        np.testing.assert_allclose(rays.distance[up], [HEIGHTS] * int(up.sum()))
        np.testing.assert_allclose(rays.distance[~up], [[height / RISE for height in HEIGHTS]] * int((~up).sum()))

    def test_the_sign_is_turned(self, tmp_path):
        file = write_rtd(tmp_path / "a.rtd", at_heights(RAYS))
        plain = read(file, SIX, positive="away")["radial_velocity"]
        np.testing.assert_array_equal(plain, -read(file, SIX)["radial_velocity"])

    def test_the_zone_of_the_header_is_that_of_the_times(self, tmp_path):
        file = write_rtd(tmp_path / "a.rtd", at_heights(RAYS), zone="UTC+2")
        early = read(file, SIX)["time"].values
        assert (SERIES["time"].values.min() - early.min()) == np.timedelta64(2, "h")
        assert (read(file, SIX, time_zone="UTC")["time"].values - early == np.timedelta64(2, "h")).all()

    def test_the_duration_is_that_of_the_header(self, tmp_path):
        file = write_rtd(tmp_path / "a.rtd", at_heights(RAYS))
        moved = read(file, SIX)["time"].values - read(file, SIX, time_stamp="end")["time"].values
        assert (moved == np.timedelta64(800, "ms")).all()

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (("HeaderSize=", "Size="), r"does not begin with 'HeaderSize=' or 'HeaderLength='"),
            (
                ("Timestamp", "\xff\x01\x7f"),
                r"no line of headings that begins with Timestamp or Date: its rows",
            ),
            (("Position", "Temp"), r"has no column Position, or none of radial wind speeds .* give the \.rtd file"),
            (("Radial Wind Speed (m/s)", "Z"), r"has no column Position, or none of radial wind speeds"),
            (("ScanAngle", "Angle"), r"Invalid ScanAngle None in the header .* up to 45 degrees"),
            (("timezone=UTC+0", "timezone=local"), r"The header of file .* cannot be used: Unknown time_zone 'local'"),
            (
                ("2024/03/01 09:50:03", "2024/13/01 09:50:03"),
                r"Invalid time '2024/13/01 09:50:03.00' in column",
            ),
        ],
    )
    def test_bad_files(self, tmp_path, change, message):
        file = write_rtd(tmp_path / "a.rtd", at_heights(RAYS))
        file.write_bytes(file.read_bytes().replace(*(word.encode("latin-1") for word in change)))
        with pytest.raises(InputError, match=message):
            read(file, SIX)

    def test_an_angle_from_the_horizon_is_refused(self, tmp_path):
        file = write_rtd(tmp_path / "a.rtd", at_heights(RAYS), angle="62.0")
        with pytest.raises(InputError, match=r"Invalid ScanAngle '62.0' .* the angle of the beams from the vertical"):
            read(file, SIX)

    def test_a_cut_last_line_is_dropped_and_counted(self, tmp_path):
        file = write_rtd(tmp_path / "a.rtd", at_heights(RAYS))
        file.write_bytes(file.read_bytes()[:-40])
        assert report_of(read(file, SIX))["files"][0]["rows_cut"] == 1


class TestNotRead:
    @pytest.mark.parametrize(
        ("name", "words"),
        [
            ("Wind_317.ZPH", "convert it to CSV with the manufacturer's Waltz"),
            ("a.sta", "give its .rtd file"),
        ],
    )
    def test_says_what_to_give_instead(self, tmp_path, name, words):
        (tmp_path / name).write_bytes(b"\x01\x02")
        with pytest.raises(InputError, match=words):
            read(tmp_path / name, SIX)
        with pytest.raises(InputError, match=words):
            find_scan(tmp_path / name, height=100.0)

    def test_a_folder_passes_them_over(self, tmp_path):
        write_rtd(tmp_path / "a.rtd", at_heights(RAYS))
        (tmp_path / "a.sta").write_text("HeaderSize=3")
        series = read(tmp_path, SIX)
        assert_read_back(series)
        assert report_of(series)["files_passed_over"]["other_suffix"] == 1


LONG = {
    "words": ({"time": "Timestamp (UTC)", "azimuth": "Azimuth angle [deg]", "elevation": "EL", "distance": "Range (m)",
               "velocity": "Radial Wind Speed [m/s]", "cnr": "CNR [dB]", "status": "Status"}, {}),
    "short words": ({"time": "DateTime", "azimuth": "azi", "elevation": "ele", "velocity": "v_r", "cnr": "SNR"}, {}),
    "camel": ({"time": "timeStamp", "azimuth": "beamAzimuth", "elevation": "beamElevation", "distance": "gateDistance",
               "velocity": "radialVelocity"}, {}),
    "named": ({"time": "t", "azimuth": "a", "elevation": "e", "distance": "d", "velocity": "LOS"},
              {"columns": {"time": "t", "azimuth": "a", "elevation": "e", "range": "d", "radial_velocity": "LOS"}}),
}  # fmt: skip


class TestTablesOfRays:
    @pytest.mark.parametrize("kind", [".csv", ".parquet"])
    @pytest.mark.parametrize("words", LONG)
    def test_a_row_for_each_ray_and_gate(self, tmp_path, words, kind):
        names, options = LONG[words]
        frame, file = ray_frame(RAYS, **names), tmp_path / f"a{kind}"
        frame.to_csv(file, index=False) if kind == ".csv" else frame.to_parquet(file)
        series = read(file, SIX, positive="away", **options)
        assert_read_back(series)
        assert report_of(series)["files"][0]["format"] == "rays"
        np.testing.assert_allclose(series["cnr"], -12.5)
        assert_found(find_scan(file, height=(100.0, 150.0), **options))

    @pytest.mark.parametrize("order", ["shuffled", "by distance", "descending"])
    def test_rows_in_any_order(self, tmp_path, order):
        frame = ray_frame(RAYS, velocity="rws")
        if order == "shuffled":
            frame = frame.sample(frac=1.0, random_state=3)
        else:
            by = ["distance", "time"] if order == "by distance" else ["time", "distance"]
            frame = frame.sort_values(by, ascending=order != "descending")
        frame.to_csv(tmp_path / "a.csv", index=False)
        sort = {} if order == "by distance" else {"out_of_order": "sort"}
        assert_read_back(read(tmp_path / "a.csv", SIX, positive="away", **sort))

    def test_a_height_is_above_the_lidar(self, tmp_path):
        frame = ray_frame(at_heights(RAYS), velocity="rws", distance="Height [m]")
        frame["Height [m]"] = np.tile(HEIGHTS, len(RAYS.seconds))
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert_read_back(read(tmp_path / "a.csv", SIX, positive="away"))

    @pytest.mark.parametrize("above", [0.0, 345.6])
    def test_heights_beside_distances_must_agree(self, tmp_path, above):
        """Law: heights above the lidar, or by one number above something else, change nothing."""
        frame = ray_frame(at_heights(RAYS), velocity="rws", distance="Range")
        frame["Height"] = np.tile(HEIGHTS, len(RAYS.seconds)) + above
        file = tmp_path / "a.csv"
        frame.to_csv(file, index=False)
        assert_read_back(read(file, SIX, positive="away"))
        frame.loc[21, "Height"] += 30.0
        frame.to_csv(file, index=False)
        message = r"Distances and heights .* contradict each other: in the ray of line 22, at an elevation of 90"
        with pytest.raises(InputError, match=message) as caught:
            read(file, SIX, positive="away")
        assert f"has the distance 100 m and the height {130 + above:g} m; say which" in str(caught.value)
        assert_read_back(read(file, SIX, positive="away", gates_by="distance"))

    def test_heights_are_believed_when_asked(self, tmp_path):
        frame = ray_frame(at_heights(RAYS), velocity="rws", distance="Range")
        frame["Height"] = np.tile(HEIGHTS, len(RAYS.seconds))
        frame["Range"] += 500.0 * (np.arange(len(frame)) % 7)
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert_read_back(read(tmp_path / "a.csv", SIX, positive="away", gates_by="height"))

    def test_heights_beside_distances_in_columns_for_each_gate(self, tmp_path):
        table = at_heights(RAYS)
        frame = gate_frame(table, velocity="rws_{}", distance="range_{}")
        frame["altitude"] = 12.5  # of the place: no gate's
        for gate, height in enumerate(HEIGHTS):
            frame[f"height_{gate}"] = height + 2.0
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert_read_back(read(tmp_path / "a.csv", SIX, positive="away"))
        frame["height_1"] += 40.0
        frame.to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=r"contradict each other: in the ray of line \d+, at an elevation"):
            read(tmp_path / "a.csv", SIX, positive="away")

    def test_gates_have_a_length(self, tmp_path):
        series = series_of(GALION, n_scan=20)
        frame = ray_frame(rays_of(series, GALION, rough=False), velocity="rws", distance="gate")
        frame["gate"] = np.tile(np.arange(3), len(frame) // 3)
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert_read_back(read(tmp_path / "a.csv", GALION, positive="away", gate_length=50.0), series)
        with pytest.raises(InputError, match=r"numbers its gates \(column 'gate'\) and does not say how long they are"):
            read(tmp_path / "a.csv", GALION, positive="away")

    def test_units_of_the_headings(self, tmp_path):
        frame = ray_frame(RAYS)
        frame["azimuth"], frame["elevation"] = np.deg2rad(frame["azimuth"]), np.deg2rad(frame["elevation"])
        frame["distance"], frame["velocity"] = frame["distance"] / 1000.0, -100.0 * frame["velocity"]
        names = {"azimuth": "az [rad]", "elevation": "el [rad]", "distance": "range [km]", "velocity": "vr [cm s-1]"}
        frame.rename(columns=names).to_csv(tmp_path / "a.csv", index=False)
        series = read(tmp_path / "a.csv", SIX, positive="towards")
        order = np.lexsort((SERIES["beam"].values, SERIES["time"].values))
        np.testing.assert_allclose(series["radial_velocity"], SERIES["radial_velocity"].values[order], rtol=1e-12)
        with pytest.raises(InputError, match=r"Column 'vr \[cm s-1\]' .* says cm/s, and the option velocity_unit km/h"):
            read(tmp_path / "a.csv", SIX, positive="away", velocity_unit="km/h")

    @pytest.mark.parametrize("name", ["az [gon]", "range [furlong]", "vr [furlong]"])
    def test_unknown_units(self, tmp_path, name):
        own = {"az": "azimuth", "range": "distance", "vr": "velocity"}[name.split()[0]]
        names = {"velocity": "vr", own: name}
        ray_frame(RAYS, **names).to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=rf"Unknown unit '\w+' in the heading {re.escape(repr(name))}"):
            read(tmp_path / "a.csv", SIX, positive="away")

    @pytest.mark.parametrize(
        ("layout", "options"),
        [
            ({"velocity": "RWS_{} [m/s]", "distance": "range_{} [m]", "cnr": "CNR_{}"}, {}),
            (
                {"velocity": "ws_{}", "distance": "range_gate_{}", "cnr": "CNR_{}"},
                {"columns": {"radial_velocity": "ws"}},
            ),
        ],
    )
    def test_columns_for_each_gate(self, tmp_path, layout, options):
        """The second is the layout of DTU's balconies tables."""
        gate_frame(RAYS, **layout).to_csv(tmp_path / "a.csv", index=False)
        series = read(tmp_path / "a.csv", SIX, positive="away", **options)
        assert_read_back(series)
        assert "cnr" in series

    def test_gates_in_two_units_are_refused(self, tmp_path):
        frame = gate_frame(RAYS, velocity="rws_{} [m/s]", distance="range_{}")
        frame.rename(columns={"rws_2 [m/s]": "rws_2 [km/h]"}).to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=r"several columns that may be the radial velocity .* 'rws_2 \[km/h\]'"):
            read(tmp_path / "a.csv", SIX, positive="away")

    @pytest.mark.parametrize(
        ("velocity", "options"),
        [
            ("Radial velocity at range [] m", {}),
            ("RWS []m (m/s)", {"columns": {"distance": "heading"}}),
            ("vr_[]m", {"columns": {"distance": "heading"}}),
        ],
    )
    def test_metres_in_the_headings(self, tmp_path, velocity, options):
        series = series_of(GALION, n_scan=20)
        table = rays_of(series, GALION, rough=False)
        gate_frame(table, velocity=velocity).to_csv(tmp_path / "a.csv", index=False)
        assert_read_back(read(tmp_path / "a.csv", GALION, positive="away", **options), series)

    def test_metres_that_are_heights(self, tmp_path):
        table = at_heights(RAYS)
        frame = gate_frame(table, velocity="RWS {}m")
        frame.columns = [re.sub(r"RWS (\d)m", lambda word: f"RWS {HEIGHTS[int(word[1])]}m", name) for name in frame]
        frame.to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=r"does not say whether they are distances along the beam or heights"):
            read(tmp_path / "a.csv", SIX, positive="away")
        assert_read_back(read(tmp_path / "a.csv", SIX, positive="away", columns={"height": "heading"}))

    def test_the_sign_must_be_said(self, tmp_path):
        file = tmp_path / "a.csv"
        ray_frame(RAYS, velocity="rws").to_csv(file, index=False)
        with pytest.raises(InputError, match=r"does not say in which direction .* turns the wind, and with it uw"):
            read(file, SIX)
        assert_found(find_scan(file, height=(100.0, 150.0)))  # needs no sign
        np.testing.assert_array_equal(
            read(file, SIX, positive="towards")["radial_velocity"],
            -read(file, SIX, positive="away")["radial_velocity"],
        )

    @pytest.mark.parametrize(
        ("names", "message"),
        [
            ({"cnr": "LOS velocity"}, r"several columns that may be the radial velocity .*'rws', 'LOS velocity'"),
            ({"cnr": "az"}, r"several columns that may be the azimuth of its rays, 'azimuth', 'az': say which with"),
            ({"cnr": "timestamp"}, r"several columns that may be the time of its rays, 'time', 'timestamp'"),
            ({"distance": "where"}, r"has no column for the distance, or height, or gate with gate_length of its rays"),
            ({"time": "when"}, r"has no column for the time of its rays: its columns are 'when'"),
        ],
    )
    def test_unclear_tables(self, tmp_path, names, message):
        ray_frame(RAYS, velocity="rws", **names).to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=message):
            read(tmp_path / "a.csv", SIX, positive="away")

    def test_a_date_and_a_time_of_the_day(self, tmp_path):
        frame = ray_frame(RAYS, velocity="rws", time="Time")
        frame.insert(3, "Date", frame["Time"].dt.strftime("%Y-%m-%d"))
        frame["Time"] = frame["Time"].dt.strftime("%H:%M:%S.%f")
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert_read_back(read(tmp_path / "a.csv", SIX, positive="away"))
        frame.loc[4, "Time"] = "noon"
        frame.to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=r"Invalid time '2024-03-01 noon' in column 'Date Time', line 6 of file"):
            read(tmp_path / "a.csv", SIX, positive="away")

    def test_bad_rows_are_left_out_counted_and_the_first_is_named(self, tmp_path):
        frame = ray_frame(RAYS, velocity="rws").astype({"rws": object, "azimuth": object})
        frame.loc[8, "rws"], frame.loc[3, "azimuth"] = "fast", "north"  # of gates that no beam takes
        file = tmp_path / "a.csv"
        frame.to_csv(file, index=False)
        with pytest.raises(InputError, match=r"Invalid azimuth 'north' in column 'azimuth', line 5 .* bad_rows='drop'"):
            read(file, SIX, positive="away")
        series = read(file, SIX, positive="away", bad_rows="drop")
        report = report_of(series)["files"][0]
        assert report["rows_bad"] == 2
        assert "Invalid azimuth 'north'" in report["first_bad_row"]
        assert series.sizes["sample"] == SERIES.sizes["sample"]
        wide = gate_frame(RAYS, velocity="rws_{}", distance="range_{}").astype({"rws_0": object})
        wide.loc[5, "rws_0"] = "fast"
        wide.to_csv(file, index=False)
        series = read(file, SIX, positive="away", bad_rows="drop")
        assert report_of(series)["files"][0]["rows_bad"] == 1
        assert series.sizes["sample"] == SERIES.sizes["sample"] - 2

    def test_a_last_row_that_is_cut_is_not_believed(self, tmp_path):
        frame = ray_frame(RAYS.take(slice(0, 30)), velocity="rws").drop(columns=["cnr", "status"])
        file = tmp_path / "a.csv"
        frame.to_csv(file, index=False)
        file.write_bytes(file.read_bytes()[:-3])
        series = read(file, SIX, positive="away")
        assert report_of(series)["files"][0]["rows_cut"] == 1
        assert series.sizes["sample"] == 60

    def test_what_is_not_in_decibels_is_no_cnr(self, tmp_path):
        frame = ray_frame(RAYS, velocity="rws", cnr="SNR [1]")
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert "cnr" not in read(tmp_path / "a.csv", SIX, positive="away")
        with pytest.raises(InputError, match=r"Unknown unit '1' in the heading 'SNR \[1\]' .* it must be dB"):
            read(tmp_path / "a.csv", SIX, positive="away", columns={"cnr": "SNR [1]"})

    @pytest.mark.parametrize("name", ["distance", "Height [m]"])
    def test_a_gate_that_a_ray_lacks_is_not_taken_for_its_neighbour(self, tmp_path, name):
        table = at_heights(RAYS)
        frame = ray_frame(table, velocity="rws", distance=name)
        if name != "distance":
            frame[name] = np.tile(HEIGHTS, len(RAYS.seconds))
        frame.drop(index=[5, 18]).to_csv(tmp_path / "a.csv", index=False)  # 100 m of the second, 150 m of the fifth ray
        series = read(tmp_path / "a.csv", SIX, positive="away")
        kept = np.delete(np.arange(SERIES.sizes["sample"]), [2, 9])
        order = np.lexsort((SERIES["beam"].values, SERIES["time"].values))[kept]
        np.testing.assert_array_equal(series["radial_velocity"], SERIES["radial_velocity"].values[order])
        wide = gate_frame(table, velocity="rws_{}", distance="range_{}")
        wide.loc[1, "range_1"], wide.loc[4, "range_2"] = np.nan, np.nan
        wide.to_csv(tmp_path / "a.csv", index=False)
        series = read(tmp_path / "a.csv", SIX, positive="away")
        np.testing.assert_array_equal(series["radial_velocity"], SERIES["radial_velocity"].values[order])

    def test_rows_without_a_distance_are_dropped_and_counted(self, tmp_path):
        frame = ray_frame(RAYS, velocity="rws")
        frame.loc[[0, 7], "distance"] = [np.nan, -1.0]
        frame.to_csv(tmp_path / "a.csv", index=False)
        series = read(tmp_path / "a.csv", SIX, positive="away")
        assert_read_back(series)
        assert report_of(series)["files"][0]["rows_without_range"] == 2

    def test_an_angle_that_is_none(self, tmp_path):
        frame = ray_frame(RAYS, velocity="rws")
        frame.loc[5, "azimuth"] = 9e9
        frame.to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=r"Invalid azimuth 9e\+09 in line 7 of file .* as the option invalid"):
            read(tmp_path / "a.csv", SIX, positive="away")

    def test_a_table_with_a_beam_stays_a_long_one(self, tmp_path):
        frame = ray_frame(RAYS, velocity="radial_velocity").drop(columns=["cnr", "status"]).iloc[1::4]
        frame["beam"] = np.tile(np.arange(6), len(frame) // 6)
        frame.to_csv(tmp_path / "a.csv", index=False)
        assert report_of(read(tmp_path / "a.csv", SIX))["files"][0]["format"] == "long"


class TestSeveralRanges:
    """All beams at each of several heights, from formats whose rays have all their gates."""

    @pytest.mark.parametrize("name", WRITERS)
    def test_each_height_is_read_by_itself(self, tmp_path, name):
        file = WRITERS[name](tmp_path)
        ranged = read(file, six_beam(100.0, step=1.0), height=(100.0, 150.0))
        places = np.unique(ranged["range"].values)  # those of the slant beams name them
        for place, height in zip(places, (100.0, 150.0), strict=True):
            alone, here = read(file, six_beam(height, step=1.0)), ranged["range"].values == place
            np.testing.assert_array_equal(ranged["radial_velocity"].values[here], alone["radial_velocity"].values)
            np.testing.assert_array_equal(ranged["time"].values[here], alone["time"].values)
