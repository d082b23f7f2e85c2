"""Rays and the beams of a scan: which ray is which beam's, at which gate, and what is said when it is not clear."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ray_files import AZIMUTH, ELEVATION, six_beam

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.matching import SINGLE_GATE_SHARE, directions_in_words, match_rays
from bayes_rs.readers.rays import Rays, angles_of, direction_of
from bayes_rs.readers.samples import join_samples
from bayes_rs.records.making import make_records

SIX = six_beam(100.0)
GATES = np.array([50.0, 100.0, 150.0])


def rays(azimuth, elevation, distance=GATES, *, time=None, velocity=None) -> Rays:
    azimuth, elevation = np.broadcast_arrays(np.atleast_1d(azimuth).astype(float), np.atleast_1d(elevation))
    n_ray = len(azimuth)
    distance = np.broadcast_to(np.asarray(distance, dtype=float), (n_ray, np.shape(distance)[-1])).copy()
    start = np.datetime64("2021-05-13T12:00", "ns")
    velocity = np.arange(n_ray)[:, None] + 0.01 * np.arange(distance.shape[1]) if velocity is None else velocity
    return Rays(
        file=Path("noon.nc"),
        kind="windcube",
        file_format=resolve_format(FileOptions(), SIX),
        time=start + np.arange(n_ray) * np.timedelta64(1, "s") if time is None else time,
        direction=direction_of(azimuth, elevation),
        distance=distance,
        radial_velocity=np.asarray(velocity, dtype=float),
        cnr=-velocity,
        status=None,
        row=np.arange(n_ray) + 1,
        row_word="ray",
    )


def toward(azimuth, elevation, distance=100.0, **changes) -> Scan:
    direction = direction_of(np.atleast_1d(azimuth).astype(float), np.atleast_1d(elevation).astype(float))
    n_beam = len(direction)
    distance = np.broadcast_to(np.asarray(distance, dtype=float), (n_beam,))
    return Scan("some", direction, distance, np.arange(n_beam) / n_beam, scan_duration=1.0, **changes)


class TestDirections:
    def test_north_is_minus_x_east_is_y_and_up_is_z(self):
        np.testing.assert_allclose(
            direction_of(np.array([0.0, 90.0, 17.0]), np.array([0.0, 0.0, 90.0])),
            [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            atol=1e-15,
        )

    @given(st.floats(0.0, 359.99), st.floats(-89.9, 89.9))
    def test_angles_are_the_inverse(self, azimuth, elevation):
        back = angles_of(direction_of(np.array([azimuth]), np.array([elevation])))
        # an azimuth is a ratio of two cosines of the elevation, 2e-3 at the ends: a thousand roundings
        assert abs((back[0][0] - azimuth + 180.0) % 360.0 - 180.0) < 1e-10
        assert back[1][0] == pytest.approx(elevation, abs=1e-12 + 1e-12 * abs(elevation) * 180.0)

    @pytest.mark.parametrize("wind_from", [0.0, 33.0, 90.0, 200.0, 359.0])
    def test_the_yaw_of_a_record_is_the_meteorological_wind_direction(self, wind_from):
        """Wind from the direction D blows against a ray that looks to D: its radial velocity is negative."""
        radial = -8.0 * np.cos(np.deg2rad(AZIMUTH - wind_from)) * np.cos(np.deg2rad(ELEVATION))
        velocity = np.tile(radial, 20)[:, None] + np.repeat(np.tile([0.1, -0.1], 10), 6)[:, None]
        table = rays(np.tile(AZIMUTH, 20), np.tile(ELEVATION, 20), [100.0], velocity=velocity)
        table = replace(table, time=table.time[0] + np.arange(120) * np.timedelta64(5, "s"))
        record = make_records(join_samples([match_rays(table, SIX)], SIX), SIX)
        assert float(record["wind_speed"][0]) == pytest.approx(8.0, rel=1e-9)
        assert abs((float(record["yaw"][0]) - wind_from + 180.0) % 360.0 - 180.0) < 1e-9

    def test_words_are_rounded_shortened_and_most_frequent_first(self):
        many = direction_of(np.array([359.97, 0.02, 10.0, *range(20, 220, 20)]), np.full(13, 75.0))
        assert directions_in_words(many).startswith("(0.0, 75.0), (10.0, 75.0), (20.0, 75.0)")
        assert directions_in_words(many).endswith("and 4 more")
        assert directions_in_words(direction_of(np.array([217.0]), np.array([89.99]))) == "(0.0, 90.0)"
        assert directions_in_words(np.full((2, 3), np.nan)) == "none"


class TestWhichBeam:
    @pytest.mark.parametrize(
        ("azimuth", "elevation", "beam"),
        [
            (0.0, 75.0, 0),
            (360.0, 75.0, 0),
            (359.999, 75.0, 0),
            (-0.4, 75.3, 0),
            (720.0, 75.0, 0),
            (71.9995, 75.002, 1),
            (288.0, 74.4, 4),
            (0.0, 90.0, 5),
            (217.0, 89.99, 5),
            (123.0, 90.9, 5),
            (180.0, 105.0, 0),  # over the top
        ],
    )
    def test_angles_as_they_stand_in_files(self, azimuth, elevation, beam):
        assert match_rays(rays(azimuth, elevation), SIX).beam.tolist() == [beam]

    @settings(max_examples=50, deadline=None)
    @given(st.integers(0, 2**32 - 1))
    def test_each_ray_goes_to_the_nearest_beam_within_the_tolerance(self, seed):
        """Against the angle between every ray and every beam, by the tangent of half of it."""
        rng = np.random.default_rng(seed)
        scan = toward(np.arange(0.0, 360.0, 30.0), np.full(12, 60.0))
        beam = rng.integers(0, 12, 40)
        away = rng.uniform(0.0, 3.0, 40)
        looks = rays(30.0 * beam, 60.0 + away * rng.choice([-1.0, 1.0], 40))
        cross = np.linalg.norm(looks.direction[:, None] - scan.beam_direction, axis=-1)
        angle = np.rad2deg(
            2.0 * np.arctan2(cross, np.linalg.norm(looks.direction[:, None] + scan.beam_direction, axis=-1))
        )
        expected = np.where(angle.min(axis=1) <= 1.5, angle.argmin(axis=1), -1)
        if (expected < 0).all():
            return
        found = match_rays(looks, scan, angle_tolerance_deg=1.5)
        np.testing.assert_array_equal(found.beam, expected[expected >= 0])
        np.testing.assert_array_equal(found.row - 1, np.flatnonzero(expected >= 0))

    def test_the_tolerance_ends_where_it_says(self):
        for elevation, inside in ((75.499, True), (75.501, False)):
            table = rays([0.0, 72.0], [elevation, 75.0])
            assert match_rays(table, SIX, angle_tolerance_deg=0.5).beam.tolist() == ([0, 1] if inside else [1])

    def test_rays_of_no_beam_are_dropped_and_counted(self):
        table = replace(rays([0.0, 30.0, 72.0, 72.0], [75.0, 75.0, 60.0, 75.0]), counts={"rows": 5, "rows_dropped": 1})
        found = match_rays(table, SIX)
        assert found.row.tolist() == [1, 4]
        assert found.counts == {
            "rows": 5,
            "rows_invalid_value": 0,
            "rows_dropped": 3,
            "rows_without_time": 0,
            "rows_without_beam": 2,
        }

    def test_rays_without_a_time_or_an_angle_are_dropped_and_counted(self):
        time = np.array(["2021-05-13T12:00", "NaT", "2021-05-13T12:01"], dtype="datetime64[ns]")
        found = match_rays(rays([0.0, 72.0, np.nan], 75.0, time=time), SIX)
        assert found.row.tolist() == [1]
        assert found.counts["rows_dropped"] == 2
        assert (found.counts["rows_without_time"], found.counts["rows_without_beam"]) == (1, 1)

    def test_no_ray_of_any_beam_is_an_error_with_both_lists(self):
        with pytest.raises(InputError) as caught:
            match_rays(rays([10.0, 20.0, 20.0], 75.0), SIX)
        text = str(caught.value)
        assert "'noon.nc'" in text
        assert "(azimuth, elevation) are (20.0, 75.0), (10.0, 75.0), the scan's are" in text
        assert "(288.0, 75.0)" in text
        assert "find_scan" in text
        assert "\n" not in text

    def test_two_beams_nearly_as_near_are_an_error_about_the_tolerance(self):
        scan = toward([0.0, 1.0], [0.0, 0.0])
        with pytest.raises(InputError, match=r"0\.4 degrees from beam 0 and 0\.6 degrees from beam 1 .* smaller tol"):
            match_rays(rays([0.05, 0.4], [0.0, 0.0]), scan)
        assert match_rays(rays([0.05, 0.4], [0.0, 0.0]), scan, angle_tolerance_deg=0.5).beam.tolist() == [0, 0]
        assert match_rays(rays([0.05, 0.95], [0.0, 0.0]), scan).beam.tolist() == [0, 1]

    @pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, "wide"])
    def test_tolerances_must_be_positive(self, tolerance):
        with pytest.raises(InputError, match="angle_tolerance_deg"):
            match_rays(rays(0.0, 75.0), SIX, angle_tolerance_deg=tolerance)
        with pytest.raises(InputError, match="range_tolerance"):
            match_rays(rays(0.0, 75.0), SIX, range_tolerance=tolerance)

    def test_no_ray_is_no_sample(self):
        found = match_rays(rays(np.zeros(0), np.zeros(0)), SIX)
        assert (len(found.time), found.counts["rows"]) == (0, 0)


class TestWhichGate:
    def test_slant_and_vertical_rays_have_their_own_ranges(self):
        """The trap of six-beam files: the same height is another gate distance on the vertical ray."""
        scan = six_beam(100.0, 200.0)
        slant, up = [52.0, 104.0, 156.0, 208.0], [50.0, 100.0, 150.0, 200.0]
        found = match_rays(rays([0.0, 0.0], [75.0, 90.0], [slant, up]), scan)
        assert found.beam.tolist() == [0, 6, 5, 11]
        np.testing.assert_allclose(found.radial_velocity, [0.01, 0.03, 1.01, 1.03])
        np.testing.assert_allclose(found.cnr, -found.radial_velocity)
        assert found.status is None

    @pytest.mark.parametrize(
        ("distance", "tolerance", "gate"),
        [
            (124.9, None, 1),
            (125.1, None, 2),
            (175.0, None, 2),  # half a spacing beyond the last gate
            (175.1, None, None),
            (24.9, None, None),
            (104.0, 5.0, 1),
            (104.0, 3.9, None),
            (400.0, 300.0, 2),
        ],
    )
    def test_the_nearest_gate_within_half_the_spacing(self, distance, tolerance, gate):
        scan = toward(0.0, 75.0, distance)
        if gate is None:
            with pytest.raises(InputError, match=r"No gate of file .noon\.nc. .* from 50 to 150 m and the focus dist"):
                match_rays(rays(0.0, 75.0), scan, range_tolerance=tolerance)
        else:
            found = match_rays(rays(0.0, 75.0), scan, range_tolerance=tolerance)
            assert found.radial_velocity == pytest.approx([0.01 * gate])

    def test_uneven_gates_count_by_the_spacing_beside_them(self):
        table = rays(0.0, 75.0, [50.0, 60.0, 160.0])
        for distance, found in ((45.0, 0.0), (109.0, 0.01), (111.0, 0.02), (210.0, 0.02)):
            assert match_rays(table, toward(0.0, 75.0, distance)).radial_velocity == pytest.approx([found], abs=1e-12)
        with pytest.raises(InputError, match="No gate"):
            match_rays(table, toward(0.0, 75.0, 44.0))

    @pytest.mark.parametrize("share", [-0.99 * SINGLE_GATE_SHARE, 0.0, 0.99 * SINGLE_GATE_SHARE])
    def test_an_only_gate_may_be_off_by_a_twentieth(self, share):
        for gates in ([100.0 * (1.0 + share)], [np.nan, 100.0 * (1.0 + share), np.nan]):
            assert len(match_rays(rays(0.0, 75.0, gates), toward(0.0, 75.0)).time) == 1
        with pytest.raises(InputError, match="No gate"):
            match_rays(rays(0.0, 75.0, [106.0]), toward(0.0, 75.0))

    def test_planes_take_a_gate_each_and_a_plane_out_of_reach_is_absent(self):
        scan = toward([0.0, 0.0, 0.0], [75.0, 75.0, 75.0], [52.0, 149.0, 900.0])
        samples = match_rays(rays([0.0, 0.0], 75.0), scan)
        assert samples.beam.tolist() == [0, 1, 0, 1]
        assert samples.counts["rows_without_beam"] == 0
        assert join_samples([samples], scan).attrs["read_report"].count('"beams_absent": [2]') == 1

    def test_two_planes_of_one_gate_are_an_error(self):
        scan = toward([0.0, 0.0, 90.0], [75.0, 75.0, 75.0], [110.0, 95.0, 100.0])
        with pytest.raises(InputError, match=r"Beams 1 and 0 .* at 95 and 110 m, take the same gate of ray 2 .* 100 m"):
            match_rays(rays([90.0, 0.0], 75.0), scan)
        assert match_rays(rays([90.0, 0.0], 75.0), scan, range_tolerance=5.0).beam.tolist() == [2, 1]

    def test_rays_without_a_gate_are_counted_and_beams_keep_the_scan_s_numbers(self):
        scan = toward(0.0, 75.0, 100.0, beam=np.array([7]))
        found = match_rays(rays([0.0, 0.0], 75.0, [GATES, GATES * np.nan]), scan)
        assert (found.beam.tolist(), found.counts["rows_without_beam"]) == ([7], 1)
