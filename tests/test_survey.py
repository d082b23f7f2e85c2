"""The scan that files were measured with, found from their rays."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest
from ray_files import RayTable, e_windlidar, mixed_hour, rays_of, six_beam, windcube_sweep, write_windcube

from bayes_rs.errors import InputError
from bayes_rs.geometry.probe import make_probe
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.scan_writing import save_scan
from bayes_rs.readers import read
from bayes_rs.readers.rays import angles_of, direction_of
from bayes_rs.readers.sorting import sort_files
from bayes_rs.readers.survey import find_scan
from bayes_rs.records.making import make_records
from bayes_rs.simulation.virtual import simulate
from bayes_rs.turbulence.mann import MannTurbulence

SIX = six_beam(100.0, 150.0)
FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2)
AZIMUTHS = [0.0, 72.0, 144.0, 216.0, 288.0]


def rays(seconds, azimuth, elevation, gates=(100.0, 120.0, 140.0)) -> RayTable:
    n_ray = len(seconds)
    angles = [np.broadcast_to(np.asarray(angle, dtype=float), (n_ray,)).copy() for angle in (azimuth, elevation)]
    distance = np.tile(np.asarray(gates, dtype=float), (n_ray, 1))
    return RayTable(np.asarray(seconds, dtype=float), *angles, distance, np.ones(distance.shape))


def write(file, table, layout="windcube"):
    (windcube_sweep(table) if layout == "windcube" else e_windlidar(table)).to_netcdf(file, engine="h5netcdf")
    return file


@pytest.fixture(scope="module")
def series():
    return simulate(SIX, FLOW, wind_speed=8.0, duration=600.0, seed=6)


class TestTheScanThatMadeTheFile:
    @pytest.mark.parametrize("layout", ["windcube", "e-windlidar"])
    def test_is_found(self, layout, tmp_path, series):
        found = find_scan(write(tmp_path / "noon.nc", rays_of(series, SIX), layout), height=[100.0, 150.0])
        assert found.name == "noon"
        assert found.n_beam == 12
        # means of twenty rays whose angles scatter by some thousandths of a degree, the zenith's by 0.01
        chord = np.linalg.norm(found.beam_direction - SIX.beam_direction, axis=1)
        assert np.rad2deg(chord).max() < 0.02
        np.testing.assert_allclose(found.focus_distance, SIX.focus_distance, rtol=1e-9)
        np.testing.assert_allclose(found.beam_time, SIX.beam_time, atol=1e-9)
        assert found.scan_duration == pytest.approx(30.0, abs=1e-9)

    def test_reads_its_file_to_the_same_records(self, tmp_path, series):
        file = write(tmp_path / "noon.nc", rays_of(series, SIX, rough=False))
        found = find_scan(file, height=[100.0, 150.0], name="six")
        records, expected = make_records(read(file, found), found), make_records(series, SIX)
        np.testing.assert_allclose(records["variance"], expected["variance"], rtol=1e-12)
        np.testing.assert_array_equal(records["count"], expected["count"])
        np.testing.assert_allclose(records["wind_speed"], expected["wind_speed"], rtol=1e-9)

    def test_survives_its_file(self, tmp_path, series):
        probe = make_probe("pulsed", gate_length=50.0, pulse_length=30.0)
        table = rays_of(series, SIX)
        found = find_scan(write(tmp_path / "noon.nc", table), height=(100.0, 150.0), probe=probe)
        assert found.probe == probe
        back = load_scan(save_scan(found, tmp_path / "found.toml"))
        assert back.key == found.key
        assert back.source == found.source

    def test_compressed_files(self, tmp_path, series):
        file = write(tmp_path / "noon.nc", rays_of(series, SIX))
        (tmp_path / "packed.nc.gz").write_bytes(gzip.compress(file.read_bytes()))
        found, plain = find_scan(tmp_path / "packed.nc.gz", height=100.0), find_scan(file, height=100.0)
        assert (found.name, found.key) == ("packed", plain.key)
        (tmp_path / "bad.nc.gz").write_bytes(gzip.compress(file.read_bytes()[:3000]))
        with pytest.raises(InputError, match=r"bad\.nc\.gz'"):
            find_scan(tmp_path / "bad.nc.gz", height=100.0, file_format="windcube")

    def test_several_files_with_a_gap(self, tmp_path, series):
        table = rays_of(series, SIX)
        late = replace(table, seconds=table.seconds + 7 * 3600.0 + 11.0)
        files = [write(tmp_path / "b.nc", late), write_windcube(tmp_path / "a.nc", windcube_sweep(table))]
        found = find_scan(tmp_path, height=100.0)
        np.testing.assert_allclose(found.beam_time, 5.0 * np.arange(6), atol=1e-9)
        assert found.scan_duration == pytest.approx(30.0)
        assert found.source.startswith("240 rays of a.nc and 1 more files, each within 0.0")
        assert find_scan(files, height=100.0).name == "b"


class TestDirections:
    def test_nought_and_a_turn_are_one(self, tmp_path):
        azimuth = np.tile([0.0, 120.0, 240.0, 360.0, 120.001, 239.999], 5)
        found = find_scan(write(tmp_path / "a.nc", rays(np.arange(30.0), azimuth, 60.0)), distance=100.0)
        assert angles_of(found.beam_direction)[0] == pytest.approx([0.0, 120.0, 240.0], abs=1e-3)
        assert found.source.endswith("each within 0.00025 degrees")  # half a thousandth, times cos 60°

    def test_a_zenith_of_any_azimuth_is_one(self, tmp_path):
        azimuth = np.tile([0.0, 17.0, 217.0, 359.0], 5)
        found = find_scan(write(tmp_path / "a.nc", rays(np.arange(20.0), azimuth, 89.99)), height=119.0)
        assert found.n_beam == 1
        assert found.beam_direction[0] == pytest.approx([0.0, 0.0, 1.0], abs=2e-4)
        assert (found.scan_duration, found.focus_distance[0]) == (1.0, 120.0)

    def test_rare_ones_are_dropped_and_named(self, tmp_path):
        azimuth = np.tile(AZIMUTHS, 20)
        azimuth[[7, 31]] = [100.0, 110.0]
        file = write(tmp_path / "a.nc", rays(np.arange(100.0), azimuth, 75.0))
        found = find_scan(file, distance=100.0)
        assert found.n_beam == 5
        assert found.source.endswith(
            "dropped 2 rays in rare directions (azimuth, elevation): (100.0, 75.0), (110.0, 75.0)"
        )
        with pytest.raises(InputError, match=r"one time only of direction \(100\.0, 75\.0\)"):
            find_scan(file, distance=100.0, min_share=0.0)

    def test_rays_without_angles_are_named(self, tmp_path):
        azimuth = np.tile(AZIMUTHS, 20)
        azimuth[3] = np.nan
        found = find_scan(write(tmp_path / "a.nc", rays(np.arange(100.0), azimuth, 75.0)), distance=100.0)
        assert "dropped 1 rays without a time or a direction" in found.source

    def test_a_sweep_is_no_scan(self, tmp_path):
        azimuth = np.tile(np.arange(0.0, 90.0, 0.5), 3)
        file = write(tmp_path / "a.nc", rays(np.arange(540.0), azimuth, 5.0))
        with pytest.raises(InputError, match=r"run into each other over .* smaller tolerance_deg"):
            find_scan(file, distance=100.0)
        assert find_scan(file, distance=100.0, tolerance_deg=0.2).n_beam == 180

    def test_no_ray_with_a_direction(self, tmp_path):
        with pytest.raises(InputError, match="no ray with a time and a direction"):
            find_scan(write(tmp_path / "a.nc", rays(np.arange(5.0), np.nan, 75.0)), distance=100.0)


class TestTimes:
    def test_cycles_that_jitter(self, tmp_path):
        """Uneven steps within a cycle, and cycles that differ by tenths of a second."""
        rng = np.random.default_rng(1)
        steps = np.array([0.0, 5.3, 10.5, 15.8, 21.0, 26.8])
        seconds = (30.2 * np.arange(100)[:, None] + rng.normal(0.0, 0.05, (100, 1)) + steps).ravel()
        azimuth, elevation = np.tile([*AZIMUTHS, 0.0], 100), np.tile([75.0] * 5 + [90.0], 100)
        found = find_scan(write(tmp_path / "a.nc", rays(seconds, azimuth, elevation)), distance=100.0)
        # a median of 99 differences with a scatter of 0.05 √2 s has an error of 1.25 · 0.07 / √99 = 0.009 s
        assert found.scan_duration == pytest.approx(30.2, abs=0.04)
        np.testing.assert_allclose(found.beam_time, steps, atol=1e-3)

    def test_bursts_that_start_within_a_cycle(self, tmp_path):
        """Two cycles in every ten minutes, from the fourth beam on: half of its visits follow a gap."""
        azimuth = np.tile(np.roll([0.0, 60.0, 120.0, 180.0, 240.0, 300.0], 3), 10)
        seconds = (600.0 * np.arange(5)[:, None] + 5.0 * np.arange(12)).ravel()
        found = find_scan(write(tmp_path / "a.nc", rays(seconds, azimuth, 60.0)), distance=100.0)
        assert found.scan_duration == 30.0
        assert found.beam_time.tolist() == [0.0, 5.0, 10.0, 15.0, 20.0, 25.0]

    def test_numbers_follow_time_from_north(self, tmp_path):
        azimuth = np.tile([200.0, 300.0, 359.9995, 100.0], 10)
        found = find_scan(write(tmp_path / "a.nc", rays(2.0 * np.arange(40), azimuth, 60.0)), distance=100.0)
        assert angles_of(found.beam_direction)[0] == pytest.approx([359.9995, 100.0, 200.0, 300.0], abs=1e-6)
        assert found.beam_time.tolist() == [0.0, 2.0, 4.0, 6.0]

    def test_files_of_one_cycle_cannot_say_how_long_it_takes(self, tmp_path):
        with pytest.raises(InputError, match=r"has one time only of direction .* more cycles"):
            find_scan(write(tmp_path / "a.nc", rays(np.arange(5.0), AZIMUTHS, 75.0)), distance=100.0)

    def test_a_scanner_that_waits_on_a_direction_is_refused(self, tmp_path):
        azimuth = np.tile(np.repeat(AZIMUTHS, 10), 4)
        file = write(tmp_path / "a.nc", rays(np.arange(200.0), azimuth, 75.0))
        with pytest.raises(InputError, match="stay on one direction before they go to the next"):
            find_scan(file, distance=100.0)

    def test_beams_seen_twice_in_a_cycle_are_named(self, tmp_path):
        azimuth = np.tile([0.0, 180.0, 90.0, 180.0, 270.0, 135.0, 45.0], 10)
        found = find_scan(write(tmp_path / "a.nc", rays(np.arange(70.0), azimuth, 60.0)), distance=100.0)
        assert found.scan_duration == 7.0
        assert found.source.endswith("not visited once in each cycle: (180.0, 60.0)")


class TestGates:
    def test_a_height_is_the_nearest_gate_of_each_direction(self, tmp_path):
        azimuth, elevation = np.tile([0.0, 0.0], 10), np.tile([30.0, 90.0], 10)
        file = write(tmp_path / "a.nc", rays(np.arange(20.0), azimuth, elevation, (60.0, 100.0, 140.0, 180.0, 220.0)))
        found = find_scan(file, height=[62.0, 100.0])
        assert found.focus_distance.tolist() == [140.0, 60.0, 220.0, 100.0]
        assert find_scan(file, distance=105.0).focus_distance.tolist() == [100.0, 100.0]
        with pytest.raises(InputError, match=r"No gate at height 130 m in direction \(0\.0, 30\.0\).* 260 m along"):
            find_scan(file, height=130.0)
        with pytest.raises(InputError, match="The heights 62 and 65 m have the same gate, at 140 m"):
            find_scan(file, height=[62.0, 65.0])

    def test_a_level_beam_has_no_height(self, tmp_path):
        file = write(tmp_path / "a.nc", rays(np.arange(20.0), 10.0, -1.0))
        with pytest.raises(InputError, match="the beam does not rise; give distance"):
            find_scan(file, height=100.0)
        assert find_scan(file, distance=100.0).focus_distance.tolist() == [100.0]


class TestInput:
    @pytest.mark.parametrize(
        ("options", "match"),
        [
            ({}, "Give height or distance"),
            ({"height": 1.0, "distance": 1.0}, "Give height or distance"),
            ({"height": []}, "No height given"),
            ({"height": -1.0}, "Invalid height -1"),
            ({"distance": [100.0, np.nan]}, "Invalid distance nan"),
            ({"height": 100.0, "tolerance_deg": 0.0}, "tolerance_deg"),
            ({"height": 100.0, "min_share": 1.5}, "Invalid min_share 1.5"),
            ({"height": 100.0, "file_format": "long"}, "Unknown file_format 'long'"),
        ],
    )
    def test_options(self, tmp_path, options, match):
        file = write(tmp_path / "a.nc", rays(np.arange(20.0), 10.0, 60.0))
        with pytest.raises(InputError, match=match):
            find_scan(file, **options)

    def test_files_of_other_formats(self, tmp_path, series):
        series.to_netcdf(tmp_path / "own.nc")
        with pytest.raises(InputError, match=r"own\.nc.* none of the formats whose rays say where they point"):
            find_scan(tmp_path / "own.nc", height=100.0)

    def test_the_gates_that_are_there_are_listed(self, tmp_path):
        file = write(tmp_path / "a.nc", rays(np.arange(20.0), 10.0, 30.0))
        words = (
            r"in direction \(10\.0, 30\.0\) \(azimuth, elevation\) at distances 100, 120, 140 m, heights 50, 60, 70 m\."
        )
        with pytest.raises(InputError, match=f"Give height or distance.* The gates that are there: {words}"):
            find_scan(file)
        many = write(tmp_path / "b.nc", rays(np.arange(20.0), 10.0, -1.0, 50.0 + 25.0 * np.arange(40)))
        with pytest.raises(InputError, match=r"300, … \(40 in all\), 1025 m\.$"):
            find_scan(many)

    def test_rays_with_one_gate_need_no_distance(self, tmp_path):
        assert find_scan(write(tmp_path / "a.nc", rays(np.arange(20.0), 10.0, 30.0, (93.0,)))).focus_distance == [93.0]

    def test_options_of_reading(self, tmp_path):
        sweep = windcube_sweep(rays(np.arange(20.0), 10.0, 60.0))
        sweep["elevation"].values[3] = -9999.0
        sweep.to_netcdf(tmp_path / "a.nc")
        with pytest.raises(InputError, match="Invalid elevation -9999"):
            find_scan(tmp_path / "a.nc", height=100.0)
        assert find_scan(tmp_path / "a.nc", height=100.0, invalid=-9999).n_beam == 1

    def test_the_gates_of_a_ray_may_change(self, tmp_path):
        """The median over rays: a file in which the gates were once set anew."""
        table = rays(np.arange(21.0), 10.0, 90.0)
        distance = table.distance.copy()
        distance[:5] += 8.0
        found = find_scan(write(tmp_path / "a.nc", replace(table, distance=distance)), height=121.0)
        assert found.focus_distance.tolist() == [120.0]


@pytest.fixture(scope="module")
def hour(tmp_path_factory):
    return mixed_hour(tmp_path_factory.mktemp("mixed") / "hour", n_gate=6, bursts=2)


class TestFilesOfSeveralScans:
    """Twenty minutes of one lidar, as `mixed_hour` writes them."""

    def test_are_sorted(self, hour):
        found = sort_files(hour)
        assert [(one.kind, len(one.files), one.n_ray) for one in found.groups] == [
            ("beams", 30, 150),
            ("stare", 4, 240),
            ("ppi", 2, 180),
            ("ppi", 2, 180),
            ("rhi", 2, 176),
        ]
        assert [{path.stem.split("_")[1] for path in one.files} for one in found.groups] == [
            {"dbs"},
            {"fixed"},
            {"ppi"},
            {"ppi"},
            {"rhi"},
        ]
        words = [line.partition(";")[0] for line in found.in_words()]
        assert words[1:] == [
            "2: stare at (azimuth, elevation) (0.0, 90.0)",
            "3: PPI, azimuth 340.0 to 69.0, elevation 4.0 degrees",
            "4: PPI, azimuth 100.0 to 278.0, elevation 10.0 degrees",
            "5: RHI, azimuth 30.0, elevation 2.0 to 89.0 degrees",
        ]
        assert found.in_words()[1].endswith(
            "; gates 100 to 225 m every 25 m; 4 files, 240 rays, 2021-05-22T12:05:00 to 12:16:59"
        )
        assert (found.groups[0].nearest, found.groups[0].farthest) == (100.0, 225.0)

    def test_the_only_one_with_beams_is_found(self, hour):
        """The zenith's stares count for nothing: with them a beam would have 17 samples for one of the others."""
        found = find_scan(hour, height=150.0)
        assert (found.n_beam, found.scan_duration) == (5, 20.0)
        assert found.beam_time.tolist() == [0.0, 4.0, 8.0, 12.0, 16.0]
        assert found.source.startswith("150 rays of 2021-05-22T12-00-00_dbs.nc and 29 more files")
        alone = find_scan(str(hour / "*dbs.nc"), height=150.0)
        assert alone.key == found.key

    def test_another_is_chosen_by_its_number(self, hour):
        stare = find_scan(hour, distance=125.0, group=2)
        assert (stare.n_beam, stare.scan_duration) == (1, 1.0)
        with pytest.raises(InputError, match=r"Invalid group 6: the files hold 5: 1: 5 beams"):
            find_scan(hour, distance=125.0, group=6)
        with pytest.raises(InputError, match="Invalid group 0"):
            find_scan(hour, distance=125.0, group=0)

    def test_two_with_beams_are_asked_for(self, tmp_path):
        seconds = np.arange(40.0)
        write(tmp_path / "a.nc", rays(seconds, np.tile([0.0, 90.0, 180.0, 270.0], 10), 75.0))
        write(tmp_path / "b.nc", rays(seconds + 50.0, np.tile([45.0, 135.0, 225.0, 315.0], 10), 62.0))
        with pytest.raises(InputError, match=r"hold 2 scans, and 2 of them have beams: 1: 4 beams .*--scan-group"):
            find_scan(tmp_path, height=100.0)
        assert find_scan(tmp_path, height=100.0, group=2).name == "b"

    def test_none_with_beams(self, tmp_path):
        write(tmp_path / "a.nc", rays(np.arange(40.0), 0.0, 90.0))
        write(tmp_path / "b.nc", rays(np.arange(50.0, 140.0), np.arange(90.0), 5.0))
        with pytest.raises(InputError, match=r"hold 2 scans, and none of them has beams: 1: stare at .* 2: PPI"):
            find_scan(tmp_path, height=100.0)

    def test_files_of_one_beam_each_are_one_scan(self, tmp_path):
        """Five files of an hour, one for each line of sight, in turn; and five stares one after the other."""
        for number, azimuth in enumerate(AZIMUTHS):
            write(tmp_path / f"los{number}.nc", rays(number + 5.0 * np.arange(20), azimuth, 75.0))
        (group,) = sort_files(tmp_path).groups
        assert (group.kind, len(group.files), len(group.direction)) == ("beams", 5, 5)
        assert find_scan(tmp_path, height=100.0).scan_duration == 5.0
        for number, azimuth in enumerate(AZIMUTHS):
            write(tmp_path / f"los{number}.nc", rays(number * 100.0 + np.arange(100), azimuth, 75.0))
        assert [group.kind for group in sort_files(tmp_path).groups] == ["stare"] * 5
        with pytest.raises(InputError, match="stay on one direction before they go to the next"):
            find_scan(tmp_path, height=100.0)

    def test_a_part_of_a_cycle_and_rays_on_the_way(self, tmp_path):
        for cycle in range(6):
            azimuth = [*AZIMUTHS, 20.0 + 30.0 * cycle] if cycle % 2 else AZIMUTHS
            write(tmp_path / f"{cycle}.nc", rays(10.0 * cycle + np.arange(len(azimuth)), azimuth, 75.0))
        write(tmp_path / "last.nc", rays(60.0 + np.arange(2), AZIMUTHS[:2], 75.0))
        (group,) = sort_files(tmp_path).groups
        assert (group.kind, group.n_ray, len(group.direction)) == ("beams", 35, 5)

    @pytest.mark.parametrize("n_beam", [8, 24, 50])
    def test_a_ring_is_no_sweep(self, tmp_path, n_beam):
        """Nor is a cone about the horizon, whose beams lie at one elevation only in pairs."""
        azimuth = np.tile(np.arange(0.0, 360.0, 360.0 / n_beam), 3)
        write(tmp_path / "a.nc", rays(np.arange(3.0 * n_beam), azimuth, 62.0))
        assert [group.kind for group in sort_files(tmp_path).groups] == ["beams"]
        cone = load_scan("50-beam").select(np.arange(0, 50, 50 // n_beam)).beam_direction
        write(tmp_path / "a.nc", rays(np.arange(3.0 * len(cone)), *(np.tile(one, 3) for one in angles_of(cone))))
        assert [group.kind for group in sort_files(tmp_path, tolerance_deg=0.5).groups] == ["beams"]

    @pytest.mark.parametrize("step", [0.1, 0.5, 1.0, 2.0, 5.0])
    @pytest.mark.parametrize("kind", ["ppi", "rhi", "sweep"])
    def test_sweeps_of_any_step(self, tmp_path, step, kind):
        rng = np.random.default_rng(2)
        turn = np.arange(10.0, 75.0, step)
        if kind == "sweep":
            turn = turn[:: max(int(1.0 / step), 1)] if step < 1.0 else np.arange(10.0, 75.0, 1.0)
        away = {"ppi": (turn + 310.0, 8.0), "rhi": (75.0, turn), "sweep": (1.2 * turn, turn)}[kind]
        azimuth, elevation = np.broadcast_arrays(*away)
        azimuth, elevation = (angle + rng.normal(0.0, 0.02, len(turn)) for angle in (azimuth, elevation))
        write(tmp_path / "a.nc", rays(0.5 * np.arange(len(turn)), azimuth % 360.0, elevation))
        assert [group.kind for group in sort_files(tmp_path).groups] == [kind]

    @pytest.mark.parametrize(("times", "kind"), [([0.0], "ppi"), ([0.0, 1000.0], "ppi"), ([0.0, 60.0], "beams")])
    def test_a_circle_that_comes_again_after_minutes_is_a_sweep(self, tmp_path, times, kind):
        for begin in times:
            write(tmp_path / f"{begin}.nc", rays(begin + 0.5 * np.arange(120), np.arange(0.0, 360.0, 3.0), 20.0))
        assert [group.kind for group in sort_files(tmp_path).groups] == [kind]

    def test_the_same_beams_with_other_gates_are_another_scan(self, tmp_path):
        """Gates of 25 m and 100 m in turn: probes of another length, which no scan joins."""
        for number, step in enumerate((25.0, 100.0, 25.0, 100.0)):
            seconds = 20.0 * number + 5.0 * np.arange(4)
            gates = 100.0 + step * np.arange(4)
            write(tmp_path / f"{number}.nc", rays(seconds, [0.0, 90.0, 180.0, 270.0], 75.0, gates))
        found = sort_files(tmp_path)
        assert [(one.kind, one.spacing, len(one.files)) for one in found.groups] == [
            ("beams", 25.0, 2),
            ("beams", 100.0, 2),
        ]

    def test_files_that_cannot_be_read(self, tmp_path):
        write(tmp_path / "a.nc", rays(np.arange(20.0), np.tile([0.0, 90.0], 10), 75.0))
        (tmp_path / "b.nc").write_bytes(b"nothing")
        with pytest.raises(InputError, match=r"b\.nc"):
            sort_files(tmp_path)
        found = sort_files(tmp_path, on_bad_file="skip")
        assert [path.name for path in found.skipped] == ["b.nc"]
        (tmp_path / "a.nc").unlink()
        with pytest.raises(InputError, match=r"None of 1 files has rays that can be read; the first: .*b\.nc"):
            sort_files(tmp_path, on_bad_file="skip")


def test_the_measured_hour(six_beam_hour):
    """Against what a person reads in the file: README of the data, and its first cycle."""
    found = find_scan(six_beam_hour, height=104.0)
    azimuth, elevation = angles_of(found.beam_direction)
    np.testing.assert_allclose((azimuth + 1.0) % 360.0 - 1.0, [*AZIMUTHS, 0.0], atol=0.002)
    np.testing.assert_allclose(elevation, [75.0] * 5 + [90.0], atol=0.001)
    assert found.focus_distance.tolist() == [104.0] * 5 + [100.0]
    assert found.scan_duration == pytest.approx(30.2, abs=0.05)
    assert found.beam_time == pytest.approx([0.0, 5.26, 10.52, 15.78, 21.04, 26.8], abs=0.05)
    assert found.source.startswith("715 rays of wls200s_sixbeam_20210513T12.nc, each within 0.00")
    np.testing.assert_allclose(
        found.beam_direction, direction_of(np.array([*AZIMUTHS, 0.0]), np.array([75.0] * 5 + [90.0])), atol=4e-5
    )
