"""Scans: geometry, presets, TOML files and what is wrong with bad ones."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayes_rs import InputError, Scan, load_scan
from bayes_rs.geometry.probe import ContinuousWaveProbe, PointProbe
from bayes_rs.geometry.scan import tilt_matrix, yaw_matrix
from bayes_rs.geometry.scan_file import cone_direction
from bayes_rs.geometry.scan_writing import save_scan
from bayes_rs.models import models_folder, preset_names

ANGLE = st.floats(-np.pi, np.pi)
TILT = st.floats(-0.5 * np.pi, 0.5 * np.pi)


class TestGeometry:
    def test_beam_vector_is_the_documented_one(self):
        opening, phase = np.deg2rad(15.0), np.deg2rad(30.0)
        expected = [-np.cos(opening), np.cos(phase) * np.sin(opening), np.sin(phase) * np.sin(opening)]
        np.testing.assert_allclose(cone_direction(opening, phase), expected, rtol=1e-15)

    def test_positive_tilt_raises_the_upwind_beam(self):
        scan = load_scan("staring", tilt_deg=5.0)
        np.testing.assert_allclose(
            scan.line_of_sight[0], [-np.cos(np.deg2rad(5.0)), 0.0, np.sin(np.deg2rad(5.0))], atol=1e-15
        )

    def test_matrices_are_the_documented_ones(self):
        cosine, sine = np.cos(0.3), np.sin(0.3)
        np.testing.assert_allclose(tilt_matrix(0.3), [[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]], rtol=1e-15)
        np.testing.assert_allclose(yaw_matrix(0.3), [[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], rtol=1e-15)

    @given(TILT, ANGLE, st.floats(0.0, np.pi / 2), ANGLE)
    def test_lines_of_sight_are_unit_vectors_at_any_mounting(self, tilt, yaw, opening, phase):
        scan = Scan(
            "one",
            cone_direction(np.array([opening]), np.array([phase])),
            focus_distance=np.array([100.0]),
            beam_time=np.array([0.0]),
            scan_duration=1.0,
            tilt=tilt,
            yaw=yaw,
        )
        assert np.linalg.norm(scan.line_of_sight) == pytest.approx(1.0, abs=1e-14)

    @given(ANGLE)
    def test_at_yaw_is_the_same_as_mounting_with_that_yaw(self, yaw):
        scan = load_scan("6-beam", tilt_deg=3.0)
        np.testing.assert_allclose(scan.at_yaw(yaw), scan.with_yaw(yaw).line_of_sight, atol=1e-15)


class TestPresets:
    @pytest.mark.parametrize("name", preset_names("scans"))
    def test_every_preset_loads_and_names_its_source(self, name):
        scan = load_scan(name)
        assert scan.title
        assert len(scan.source) > 20

    @pytest.mark.parametrize(
        ("name", "n_beam"),
        [("staring", 1), ("2-beam", 2), ("4-beam", 4), ("5-beam", 5), ("6-beam", 6), ("50-beam", 50), ("51-beam", 51)],
    )
    def test_instruments_of_the_study(self, name, n_beam):
        scan = load_scan(name)
        angle = np.rad2deg(np.arccos(-scan.line_of_sight[:, 0]))
        centre = {"staring": 1, "5-beam": 1, "6-beam": 1, "51-beam": 1}.get(name, 0)
        assert scan.n_beam == n_beam
        assert np.count_nonzero(angle < 1e-6) == centre
        np.testing.assert_allclose(angle[angle > 1e-6], 15.0, rtol=1e-12)
        assert set(scan.focus_distance) == {98.0}

    def test_spinnerlidar_is_a_rosette_within_30_degrees(self):
        scan = load_scan("spinnerlidar")
        angle = np.rad2deg(np.arccos(-scan.line_of_sight[:, 0]))
        assert scan.n_beam == 400
        assert angle.min() < 0.5
        assert angle.max() == pytest.approx(30.0, abs=1e-9)
        assert (scan.scan_duration, set(scan.focus_distance)) == (2.0, {52.0})

    def test_zx_tm(self):
        scan = load_scan("zx-tm")
        assert (scan.n_beam, scan.scan_duration, set(scan.focus_distance)) == (50, 1.0, {50.0})
        assert np.rad2deg(scan.tilt) == pytest.approx(5.3)

    def test_zx_300_looks_up_at_the_heights_of_its_source(self):
        scan = load_scan("zx-300")
        height = (scan.focus_distance * scan.line_of_sight[:, 2]).reshape(11, 50)
        expected = np.array([10.0, 20, 30, 38, 50, 75, 100, 150, 200, 250, 300])[:, None] * np.ones(50)
        np.testing.assert_allclose(height, expected, rtol=1e-5)  # the file gives distances to 0.1 mm

    def test_lower_beams_of_the_pulsed_lidar_are_level_and_28_degrees_apart(self):
        scan = load_scan("pulsed-4-beam").select([2, 3])
        left, right = scan.line_of_sight
        assert np.rad2deg(np.arcsin(scan.line_of_sight[:, 2])) == pytest.approx([-0.15, -0.15], abs=0.01)
        assert np.rad2deg(np.arccos(left @ right)) == pytest.approx(28.4, abs=0.15)
        assert left[1] < 0.0 < right[1]

    @pytest.mark.parametrize("base", ["staring", "2-beam", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam"])
    def test_plane_variants_repeat_the_beams_at_five_distances(self, base):
        one, five = load_scan(base), load_scan(f"{base}-planes")
        np.testing.assert_array_equal(five.line_of_sight.reshape(5, -1, 3), np.tile(one.line_of_sight, (5, 1, 1)))
        assert sorted(set(five.focus_distance)) == [49.0, 72.0, 98.0, 121.0, 142.0]
        assert five.beam.tolist() == list(range(5 * one.n_beam))

    def test_presets_are_found_beside_the_package_and_named_when_unknown(self):
        assert models_folder("scans").is_dir()
        with pytest.raises(InputError, match=r"No preset '7-beam' in models/scans: use one of 2-beam, .*zx-tm"):
            load_scan("7-beam")


class TestOverrides:
    def test_opening_angle_focus_distance_tilt_and_yaw(self):
        scan = load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0, tilt_deg=2.0, yaw_deg=-10.0)
        np.testing.assert_allclose(scan.beam_direction[:5, 0], -np.cos(np.pi / 4))
        assert set(scan.focus_distance) == {52.0}
        assert (np.rad2deg(scan.tilt), np.rad2deg(scan.yaw)) == pytest.approx((2.0, -10.0))

    def test_several_focus_distances_make_planes(self):
        assert load_scan("4-beam", focus_distance=[50.0, 100.0]).n_beam == 8

    @pytest.mark.parametrize("name", preset_names("scans"))
    @pytest.mark.parametrize(
        "change", ["focus_distance=80", "focus_distance=80+120", "tilt_deg=2,yaw_deg=5,probe=point"]
    )
    def test_distance_mounting_and_probe_of_every_preset_can_be_changed(self, name, change):
        scan, own = load_scan(f"{name}@{change}"), load_scan(name)
        if "+" in change:
            assert set(scan.focus_distance) == {80.0, 120.0}
        elif "focus" in change:
            assert set(scan.focus_distance) == {80.0}
            np.testing.assert_allclose(scan.beam_direction, own.beam_direction[: scan.n_beam])
        else:
            assert (np.rad2deg([scan.tilt, scan.yaw]), scan.probe) == (pytest.approx([2.0, 5.0]), PointProbe())

    def test_beams_with_distances_of_their_own_take_one_for_all_but_for_planes(self, tmp_path):
        scan = load_scan("windcube-v2", focus_distance=80.0)
        own = load_scan("windcube-v2")
        assert scan.focus_distance.tolist() == [80.0] * 5
        assert (scan.beam.tolist(), scan.probe) == (own.beam.tolist(), own.probe)
        assert (
            load_scan("wls200s-dbs@focus_distance=100").beam_time.tolist()
            == load_scan("wls200s-dbs").beam_time.tolist()
        )
        planes = tmp_path / "planes.toml"
        save_scan(
            replace(
                load_scan("4-beam"),
                beam_direction=load_scan("4-beam").beam_direction[[0, 0, 1, 1]],
                focus_distance=[49.0, 98.0, 49.0, 98.0],
            ),
            planes,
        )
        with pytest.raises(
            InputError, match=r"^Scan 'planes' gives each beam its own focus_distance, and several to one"
        ):
            load_scan(f"{planes}@focus_distance=80")

    def test_opening_angle_of_listed_beams_is_refused(self):
        with pytest.raises(InputError, match=r"lists its beams one by one, so opening_angle_deg=20.0 does not apply"):
            load_scan("pulsed-4-beam", opening_angle_deg=20.0)

    def test_probe_can_be_switched_off_or_given(self):
        scan = load_scan("zx-tm")
        np.testing.assert_allclose(scan.probe_length, 1.565e-6 * 50.0**2 / (np.pi * 0.028**2))
        assert load_scan("zx-tm", probe="point").probe == PointProbe()
        assert load_scan("6-beam", probe="zx-tm").probe == scan.probe
        given = load_scan("6-beam", probe=ContinuousWaveProbe(rayleigh_length=3.0))
        assert given.geometry()["probe"] == {"kind": "continuous-wave", "rayleigh_length": 3.0}
        assert given.key != load_scan("6-beam").key
        assert given.select([2, 3]).probe == given.probe

    def test_other_names_of_probes_are_refused(self):
        message = (
            r"Invalid probe 'pulsed': it must be 'point', a scan that has one, .* No preset 'pulsed' in models/scans"
        )
        with pytest.raises(InputError, match=message):
            load_scan("6-beam", probe="pulsed")

    @pytest.mark.parametrize("name", ["zx-tm", "zx-300", "spinnerlidar", "spinnerlidar-planes", "pulsed-4-beam"])
    def test_instruments_have_their_probe_and_are_points_on_request(self, name):
        with_probe, without = load_scan(name), load_scan(name, probe="point")
        assert without.probe == PointProbe()
        assert np.all(with_probe.probe_length > 0.0)
        geometry = with_probe.geometry()
        geometry.pop("probe")
        assert geometry == without.geometry()
        assert with_probe.file_format == without.file_format
        assert "assumption" in with_probe.source

    def test_geometries_without_an_instrument_are_points(self):
        instruments = {
            "zx-tm",
            "zx-300",
            "spinnerlidar",
            "spinnerlidar-planes",
            "pulsed-4-beam",
            "windcube-v2",
            "wls200s-dbs",
        }
        assert {name for name in preset_names("scans") if load_scan(name).probe != PointProbe()} == instruments

    def test_the_weighting_of_the_pulsed_lidar_is_30_m_wide_at_half_its_height(self):
        probe = load_scan("pulsed-4-beam").probe
        np.testing.assert_allclose(probe.weighting([-15.0, 0.0, 15.0], 178.0) * 30.0, [0.5, 1.0, 0.5], rtol=1e-12)

    @pytest.mark.parametrize("distance", [-98.0, 0.0, np.nan, np.inf])
    def test_bad_focus_distance_is_refused(self, distance):
        with pytest.raises(InputError, match=r"^Invalid change of scan '6-beam': beams.focus_distance\.0 = "):
            load_scan("6-beam", focus_distance=distance)


class TestChangesBehindTheName:
    def test_are_those_of_the_arguments_and_stay_in_the_name(self):
        scan = load_scan("zx-300@focus_distance=49+98,tilt_deg=-2.5,probe=point")
        other = load_scan("zx-300", focus_distance=[49.0, 98.0], tilt_deg=-2.5, probe="point")
        assert (scan.key, scan.n_beam) == (other.key, 100)
        assert (scan.name, other.name) == ("zx-300@focus_distance=49+98,tilt_deg=-2.5,probe=point", "zx-300")
        assert load_scan("6-beam@probe=zx-tm").probe == load_scan("zx-tm").probe
        assert load_scan("6-beam@yaw_deg=3", tilt_deg=1.0).key == load_scan("6-beam", tilt_deg=1.0).key

    def test_of_a_file_even_if_its_path_has_an_at(self, tmp_path):
        folder = tmp_path / "me@home"
        folder.mkdir()
        file = save_scan(load_scan("zx-tm"), folder / "mine@probe=point.toml")
        assert load_scan(file).key == load_scan("zx-tm").key  # a file of that name wins
        assert load_scan(f"{file}@probe=point").key == load_scan("zx-tm@probe=point").key
        assert load_scan(f"{file}@probe=point").name == "mine@probe=point@probe=point"
        missing = folder / "none.toml"
        with pytest.raises(InputError, match=f"No file '{missing}'"):
            load_scan(missing)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("6-beam@", "Invalid change '' of scan '6-beam': behind the @ stand changes such as probe=point"),
            ("6-beam@point", "Invalid change 'point' of scan '6-beam'"),
            ("6-beam@tilt_deg=", "Invalid change 'tilt_deg=' of scan '6-beam'"),
            ("6-beam@angle=3", "Unknown change 'angle' of scan '6-beam'"),
            ("6-beam@tilt_deg=a", "Invalid tilt_deg 'a' of scan '6-beam': it must be a number"),
            ("6-beam@tilt_deg=1+2", "only focus distances may be several"),
            ("6-beam@tilt_deg=1,tilt_deg=2", "it changes tilt_deg twice"),
            ("6-beam@tilt_deg=nan", "Invalid tilt_deg nan degrees"),
            ("6-beam@focus_distance=-5", r"Invalid change of scan '6-beam': beams.focus_distance\.0 = -5.0: input"),
            ("6-beam@probe=staring", "Invalid probe 'staring': that scan has no probe volume; write 'point' if none"),
            ("6-beam@probe=no-such-scan", "Invalid probe 'no-such-scan'"),
            ("7-beam@tilt_deg=1", "No preset '7-beam'"),
            ("pulsed-4-beam@opening_angle_deg=20", "lists its beams one by one"),
        ],
    )
    def test_refused(self, text, message):
        with pytest.raises(InputError, match=message) as caught:
            load_scan(text)
        assert "\n" not in str(caught.value)

    def test_given_twice(self):
        with pytest.raises(InputError, match=r"Invalid scan '6-beam@tilt_deg=1': tilt_deg is also given as an option"):
            load_scan("6-beam@tilt_deg=1", tilt_deg=2.0)


class TestProbeOfABase:
    @pytest.mark.parametrize(
        ("probe", "parameters"),
        [
            ('kind = "point"', {}),
            (
                'kind = "pulsed"\ngate_length = 20.0',
                {"kind": "pulsed", "pulse": "top-hat", "gate_length": 20.0, "pulse_length": 20.0},
            ),
            (
                "aperture_radius = 0.05",
                {"kind": "continuous-wave", "wavelength": 1.565e-6, "aperture_radius": 0.05},
            ),
        ],
    )
    def test_another_kind_replaces_it_and_a_length_changes_it(self, probe, parameters, tmp_path):
        file = tmp_path / "mine.toml"
        file.write_text(f'base = "zx-tm"\n\n[probe]\n{probe}\n', encoding="utf-8")
        assert load_scan(file).probe.parameters() == parameters


class TestKey:
    def test_equal_geometry_has_an_equal_key_whatever_the_name_and_the_wind(self):
        scan = load_scan("6-beam")
        assert scan.key == load_scan("6-beam", yaw_deg=20.0).key

    def test_anything_else_changes_it(self):
        keys = {
            load_scan("6-beam").key,
            load_scan("6-beam", opening_angle_deg=16.0).key,
            load_scan("6-beam", focus_distance=99.0).key,
            load_scan("6-beam", tilt_deg=1.0).key,
            load_scan("6-beam").select([0, 1, 2, 3, 4]).key,
        }
        assert len(keys) == 5

    @pytest.mark.parametrize("name", ["beam_direction", "focus_distance", "beam_time"])
    def test_rounding_and_the_sign_of_zero_do_not_change_it(self, name):
        """Numbers that went through a file or a rotation differ in the last digits, and zeros in their sign."""
        scan = load_scan("6-beam")
        rounded = getattr(scan, name) + 1e-13
        assert np.any(rounded != getattr(scan, name))
        assert replace(scan, **{name: rounded}).key == scan.key
        zero = getattr(scan, name).copy()
        zero[zero == 0.0] = -0.0
        assert replace(scan, **{name: zero}).key == scan.key


GOOD = """
title = "Two beams"
source = "made up for a test of the file format"
[beams]
pattern = "list"
focus_distance = [100.0]
beam = [{ id = 4, vector = [-2.0, 0.0, 0.0] }, { id = 7, opening_angle_deg = 15.0, phase_deg = 90.0 }]
[timing]
scan_duration = 2.0
"""


class TestFiles:
    @pytest.fixture
    def write(self, tmp_path):
        def write(text):
            path = tmp_path / "mine.toml"
            path.write_text(text)
            return path

        return write

    def test_a_file_of_ones_own(self, write):
        scan = load_scan(write(GOOD))
        assert scan.name == "mine"
        assert scan.beam.tolist() == [4, 7]
        np.testing.assert_allclose(scan.line_of_sight[0], [-1.0, 0.0, 0.0])
        np.testing.assert_allclose(scan.beam_time, [0.0, 1.0])

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ('title = "Two beams"', 'titel = "Two beams"', r"mine.toml': title: required key is missing\."),
            ("[timing]", 'colour = "red"\n[timing]', r"beams\.colour = 'red': unknown key; remove it or correct"),
            ("[-2.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]", r"beam\.0\.vector = .*the vector of a beam must not be zero"),
            ("[100.0]", "[-100.0]", r"beams\.focus_distance\.0 = -100\.0: input should be greater than 0"),
            ("[100.0]", "[]", r"beams\.focus_distance = \[\]: list should have at least 1 item"),
            ("scan_duration = 2.0", "scan_duration = 0.0", r"timing\.scan_duration = 0\.0: input should be greater"),
            (", phase_deg = 90.0", "", r"Beam 7 has no direction: give opening_angle_deg and phase_deg"),
            ("id = 7", "id = 4", r"Invalid beam numbers \[4, 4\] in scan 'mine'"),
            ('"list"', '"spiral"', r"pattern|spiral"),
            ("[beams]", "[beams", r"is not valid TOML"),
        ],
    )
    def test_what_is_wrong_is_said_in_one_line(self, write, old, new, message):
        assert old in GOOD
        with pytest.raises(InputError, match=message) as caught:
            load_scan(write(GOOD.replace(old, new, 1)))
        assert "\n" not in str(caught.value)

    def test_what_a_file_lacks_may_be_given(self, write):
        file = write(GOOD.replace("focus_distance = [100.0]", ""))
        with pytest.raises(InputError, match="has no focus_distance"):
            load_scan(file)
        assert load_scan(file, focus_distance=80.0).focus_distance.tolist() == [80.0, 80.0]

    def test_a_fault_of_a_file_is_not_that_of_a_change(self, write):
        for file, words in (
            (GOOD.replace("= 2.0", "= -2.0"), r"timing\.scan_duration = -2\.0"),
            (GOOD.replace("[beams]", "mounting = 3\n[beams]"), "mounting = 3"),
        ):
            for change in ({}, {"focus_distance": 80.0}, {"tilt_deg": 1.0}, {"focus_distance": -1.0}):
                with pytest.raises(InputError, match=f"^Invalid scan file .*mine.toml': {words}"):
                    load_scan(write(file), **change)

    def test_a_probe_in_a_file(self, write):
        scan = load_scan(write(GOOD + '[probe]\nkind = "pulsed"\ngate_length = 30.0\n'))
        assert scan.geometry()["probe"] == {
            "kind": "pulsed",
            "pulse": "top-hat",
            "gate_length": 30.0,
            "pulse_length": 30.0,
        }
        assert load_scan(write(GOOD + '[probe]\nkind = "point"\n')).key == load_scan(write(GOOD)).key

    @pytest.mark.parametrize(
        ("lines", "message"),
        [
            ('kind = "laser"', r"mine.toml': probe.*continuous-wave"),
            ("wavelength = 1.5e-6", r"mine.toml': probe = .*kind"),
            ('kind = "continuous-wave"', r"give either rayleigh_length, or wavelength and aperture_radius"),
            (
                'kind = "continuous-wave"\nrayleigh_length = -1.0',
                r"probe\.rayleigh_length = -1\.0: input should be greater",
            ),
            ('kind = "continuous-wave"\ngate_length = 1.0', r"probe\.gate_length = 1\.0: unknown key"),
            ('kind = "pulsed"', r"probe\.gate_length: required key is missing"),
            (
                'kind = "pulsed"\ngate_length = 30.0\npulse = "sech"',
                r"probe\.pulse = 'sech': input should be 'top-hat' or",
            ),
            ('kind = "pulsed"\ngate_length = 30.0\npulse = "gaussian"', r"pulse_length is missing"),
            ('kind = "point"\ngate_length = 30.0', r"probe\.gate_length = 30\.0: unknown key"),
        ],
    )
    def test_what_is_wrong_with_a_probe_is_said_in_one_line(self, write, lines, message):
        with pytest.raises(InputError, match=message) as caught:
            load_scan(write(f"{GOOD}[probe]\n{lines}\n"))
        assert "\n" not in str(caught.value)

    def test_missing_file(self, tmp_path):
        with pytest.raises(
            InputError, match=r"No file '.*none.toml': give the path of a TOML file, or one of the names"
        ):
            load_scan(tmp_path / "none.toml")

    def test_shipped_files_say_nothing_that_the_schema_does_not_know(self):
        for path in models_folder("scans").glob("*.toml"):
            assert tomllib.loads(path.read_text())["source"]


class TestScanObject:
    def test_zero_vector_is_refused(self):
        with pytest.raises(
            InputError, match=r"Invalid direction \[0.0, 0.0, 0.0\] of beam 0 in scan 'x': its length is 0"
        ):
            Scan("x", np.zeros((1, 3)), np.array([1.0]), np.array([0.0]), 1.0)

    def test_negative_focus_distance_is_refused(self):
        with pytest.raises(InputError, match=r"Invalid focus_distance .*-5.* m in beam 0 of scan 'x': .* above zero"):
            Scan("x", np.array([[-1.0, 0, 0]]), np.array([-5.0]), np.array([0.0]), 1.0)

    def test_beam_time_outside_the_scan_is_refused(self):
        with pytest.raises(InputError, match=r"Invalid beam_time in scan 'x': every time must be in \[0, 1\) s"):
            Scan("x", np.array([[-1.0, 0, 0]]), np.array([5.0]), np.array([1.0]), 1.0)

    @pytest.mark.parametrize(
        ("made", "message"),
        [
            (lambda scan: scan.with_yaw(20), r"^Invalid yaw 20 rad in scan '6-beam': it must be from -6\.28319 to "),
            (
                lambda scan: replace(scan, yaw=10.0),
                r"^Invalid yaw 10\.0 rad in scan '6-beam': it must be .*np\.deg2rad",
            ),
            (
                lambda scan: replace(scan, tilt=5),
                r"^Invalid tilt 5 rad in scan '6-beam': it must be from -1\.5708 to 1",
            ),
            (lambda scan: scan.at_yaw([0.1, 20.0]), r"^Invalid yaw 20 rad: it must be from -12\.5664 .*np\.deg2rad"),
            (lambda scan: scan.at_yaw(-20), r"^Invalid yaw -20 rad"),
            (
                lambda _: load_scan("6-beam@tilt_deg=573"),
                r"^Invalid tilt_deg 573\.0 degrees: it must be from -90 to 90 d",
            ),
            (
                lambda _: load_scan("6-beam@yaw_deg=1146"),
                r"^Invalid yaw_deg 1146\.0 degrees: it must be from -360 to 3",
            ),
            (lambda _: load_scan("6-beam", tilt_deg=-91), r"^Invalid tilt_deg -91 degrees: it must be from -90 to 90"),
            (lambda _: load_scan("6-beam", yaw_deg=361), r"^Invalid yaw_deg 361 degrees: it must be from -360 to 360"),
        ],
    )
    def test_degrees_where_radians_are_meant_and_angles_beyond_a_turn_are_refused(self, made, message):
        with pytest.raises(InputError, match=message) as error:
            made(load_scan("6-beam"))
        assert "\n" not in str(error.value)

    def test_angles_up_to_a_turn_and_up_to_the_vertical_are_taken_and_come_back(self, tmp_path):
        for tilt_deg, yaw_deg in ((90.0, 360.0), (-90.0, -360.0), (89.999, 359.999)):
            scan = load_scan("6-beam", tilt_deg=tilt_deg, yaw_deg=yaw_deg)
            file = tmp_path / f"{tilt_deg}.toml"
            save_scan(scan, file)
            assert load_scan(file).key == scan.key
            assert load_scan(file).yaw == pytest.approx(scan.yaw, rel=1e-15)

    @pytest.mark.parametrize("line", ["tilt_deg = 91.0", "yaw_deg = -361.0"])
    def test_a_file_with_another_mounting_is_refused(self, line, tmp_path):
        file = tmp_path / "mine.toml"
        file.write_text(f'base = "6-beam"\n[mounting]\n{line}\n', encoding="utf-8")
        with pytest.raises(
            InputError, match=rf"mounting\.{line[:4]}.*: input should be (less|greater) than or equal to"
        ):
            load_scan(file)

    @pytest.mark.parametrize("angle", ["tilt", "yaw"])
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_an_angle_that_is_not_finite_is_refused(self, angle, value):
        with pytest.raises(InputError, match=rf"Invalid {angle} {value}.* in scan 'x'"):
            Scan("x", np.array([[-1.0, 0, 0]]), np.array([5.0]), np.array([0.0]), 1.0, **{angle: value})

    @pytest.mark.parametrize("beam", [[3, 3], [1], [0, 1, 2]])
    def test_beam_numbers_that_are_not_one_for_each_are_refused(self, beam):
        with pytest.raises(InputError, match=r"Invalid beam numbers .* in scan 'x': one for each beam, all different"):
            Scan("x", np.array([[-1.0, 0, 0]] * 2), np.full(2, 5.0), np.zeros(2), 1.0, beam=np.array(beam))

    def test_a_probe_must_be_one(self):
        with pytest.raises(InputError, match=r"Invalid probe 'point' of scan 'x': it must be a Probe"):
            Scan("x", np.array([[-1.0, 0, 0]]), np.array([5.0]), np.array([0.0]), 1.0, probe="point")

    def test_unknown_beam_is_refused(self):
        with pytest.raises(InputError, match=r"Unknown beam 9 in scan '4-beam': its beams are \[0, 1, 2, 3\]"):
            load_scan("4-beam").select([9])

    def test_arrays_cannot_be_changed(self):
        with pytest.raises(ValueError, match="read-only"):
            load_scan("4-beam").focus_distance[0] = 1.0
