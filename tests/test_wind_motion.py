"""Motion: per-record attitude against slow sums, and removal of what a moving lidar adds, built from the physics."""

import json

import numpy as np
import pytest
import xarray as xr

import bayes_rs as brs
from bayes_rs import InputError, load_scan, load_turbulence
from bayes_rs.records import RecordOptions
from bayes_rs.wind import add_motion, read_motion, remove_motion, with_motion

FLOW = load_turbulence("fu-2022")
SECOND = np.timedelta64(1_000_000_000, "ns")
START = np.datetime64("2020-09-03T19:00", "ns")


def motion_of(seconds, **variables):
    time = START + (np.asarray(seconds) * 1e9).astype(np.int64).astype("timedelta64[ns]")
    return xr.Dataset(
        {name: ("time", np.asarray(v, dtype=float)) for name, v in variables.items()}, coords={"time": time}
    )


def records_at(scan, n_record=3):
    series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=n_record, seed=3)
    return brs.make_records(series.assign_coords(time=series["time"] - series["time"][0] + START), scan)


def rotate_by_hand(direction, tilt_deg, roll_deg, heading_deg):
    """Turn one vector about x, then y, then z, each written out."""
    x, y, z = direction
    c, s = np.cos(np.deg2rad(roll_deg)), np.sin(np.deg2rad(roll_deg))
    y, z = c * y - s * z, s * y + c * z
    c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
    x, z = c * x + s * z, -s * x + c * z
    c, s = np.cos(np.deg2rad(heading_deg)), np.sin(np.deg2rad(heading_deg))
    return np.array([c * x + s * y, -s * x + c * y, z])  # clockwise from above: −x (ahead) goes to +y (right)


class TestWithMotion:
    def test_means_and_spreads(self):
        scan = load_scan("6-beam", tilt_deg=2.0)
        rng = np.random.default_rng(1)
        seconds = np.sort(rng.uniform(-100.0, 1100.0, 500))
        tilt, roll = rng.normal(4.0, 1.0, 500), rng.normal(-1.0, 0.5, 500)
        found = with_motion(records_at(scan), motion_of(seconds, tilt_deg=tilt, roll_deg=roll), scan)
        for record in range(2):
            inside = (seconds >= 600 * record) & (seconds < 600 * (record + 1))
            assert found["motion_count"].values[record] == inside.sum()
            assert found["tilt"].values[record] == pytest.approx(tilt[inside].mean())
            assert found["roll_sd"].values[record] == pytest.approx(roll[inside].std())
        assert found["motion_count"].values[2] == 0
        assert found["tilt"].values[2] == pytest.approx(2.0)
        assert found["roll"].values[2] == 0.0
        assert np.isnan(found["tilt_sd"].values[2])

    def test_the_wind_is_that_of_the_turned_beams(self):
        scan = load_scan("6-beam")
        wind = np.array([8.0, -1.5, 0.0])
        mean = [rotate_by_hand(n, 6.0, -9.0, 0.0) @ wind for n in scan.beam_direction]
        records = records_at(scan, 1)
        records = records.assign(mean=(("record", "beam"), np.array([mean])))
        motion = motion_of(np.arange(600.0), tilt_deg=np.full(600, 6.0), roll_deg=np.full(600, -9.0))
        found = with_motion(records, motion, scan)
        assert found["wind_speed"].item() == pytest.approx(np.hypot(8.0, 1.5), rel=1e-12)
        assert found["yaw"].item() == pytest.approx(np.degrees(np.arctan2(1.5, 8.0)), rel=1e-10)

    def test_a_time_at_the_end_is_the_next_record(self):
        scan = load_scan("6-beam")
        found = with_motion(records_at(scan, 2), motion_of([0.0, 600.0, 1200.0], tilt_deg=[1.0, 2.0, 3.0]), scan)
        assert found["tilt"].values.tolist() == [1.0, 2.0]
        assert found["motion_count"].values.tolist() == [1, 1]

    def test_headings_are_averaged_on_the_circle(self):
        scan = load_scan("6-beam")
        motion = motion_of([0.0, 1.0], tilt_deg=[0.0, 0.0], heading_deg=[350.0, 20.0])
        found = with_motion(records_at(scan, 1), motion, scan)
        assert found["heading"].item() == pytest.approx(5.0)
        assert found["wind_direction"].item() == pytest.approx((5.0 + found["yaw"].item()) % 360.0)

    def test_errors_of_another_attitude_are_dropped(self):
        scan = load_scan("6-beam")
        records = brs.wind.mean_wind(records_at(scan, 1), scan, turbulence=FLOW)
        assert "yaw_sd" in records
        assert "yaw_sd" not in with_motion(records, motion_of([0.0], tilt_deg=[3.0]), scan)

    @pytest.mark.parametrize(
        ("motion", "message"),
        [
            (motion_of([0.0], velocity_x=[1.0]), r"The motion has neither tilt_deg nor roll_deg"),
            (
                motion_of([1.0, 1.0], tilt_deg=[1.0, 2.0]),
                r"its times must rise, and entry 1 is not after the one before",
            ),
            (
                motion_of([0.0], tilt_deg=[9999.0]),
                r"Invalid tilt_deg 9999 of the motion at 2020-09-03T19:00.*as invalid",
            ),
            (xr.Dataset({"tilt_deg": ("time", [1.0])}), r"it needs times over the dimension 'time'"),
        ],
    )
    def test_refuses(self, motion, message):
        scan = load_scan("6-beam")
        with pytest.raises(InputError, match=message):
            with_motion(records_at(scan, 1), motion, scan)

    def test_refuses_motion_of_no_record(self):
        """As a mast whose periods match no record is refused: times two hours off say nothing of any record."""
        scan = load_scan("6-beam")
        motion = motion_of([7200.0, 8000.0], tilt_deg=[1.0, 2.0])
        words = r"No time of the motion \(2020-09-03T21:00:00 to 2020-09-03T21:13:20 UTC\).*check its time zone"
        with pytest.raises(InputError, match=words):
            with_motion(records_at(scan, 2), motion, scan)
        with pytest.raises(InputError, match=r"No time of the motion"):
            with_motion(records_at(scan, 1), motion_of([0.0], tilt_deg=[np.nan]), scan)

    def test_says_how_many_records_have_none(self, caplog):
        scan = load_scan("6-beam")
        with_motion(records_at(scan, 3), motion_of([0.0, 700.0], tilt_deg=[1.0, 2.0]), scan)
        (words,) = caplog.messages
        assert words.startswith(
            "The motion says nothing of 1 of 3 records, the first of 2020-09-03T19:20:00: they keep"
        )


class TestAddMotion:
    @pytest.fixture
    def options(self, tmp_path):
        file = tmp_path / "motion.csv"
        file.write_text("t,a,v\n2020-09-03 19:00:01,1.5,0.5\n2020-09-03 19:10:01,2.5,0.5\n")

        def of(**columns):
            return RecordOptions(motion=[file], motion_columns=columns)

        return of

    def test_says_how_many_records_have_some(self, options, caplog):
        scan, said = load_scan("6-beam"), []
        found = add_motion(records_at(scan, 3), scan, options(time="t", tilt_deg="a"), say=said.append)
        assert found["tilt"].values.tolist() == [1.5, 2.5, 0.0]
        assert said == ["tilt and roll from 1 files, of 2 of 3 records"]
        assert len(caplog.messages) == 1

    @pytest.mark.parametrize("beside", [{"tilt_deg": "a"}, {}])
    def test_refuses_velocities_and_names_the_way(self, options, beside):
        scan = load_scan("6-beam")
        words = r"Invalid motion_columns velocity_x \(--motion-column velocity_x=v\).*bayes_rs\.wind\.remove_motion"
        with pytest.raises(InputError, match=words):
            add_motion(records_at(scan, 2), scan, options(time="t", velocity_x="v", **beside))


class TestRemoveMotion:
    def test_a_lidar_that_goes_against_the_wind_sees_it_faster(self):
        scan = load_scan("staring")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=1)
        motion = xr.Dataset({"velocity_x": ("time", np.full(600, -1.0))}, coords={"time": series["time"].values})
        moved = series.assign(radial_velocity=series["radial_velocity"] - 1.0)  # −11 where it was −10
        found = remove_motion(moved, motion, scan)
        np.testing.assert_allclose(found["radial_velocity"], series["radial_velocity"], rtol=1e-12)

    def test_velocity_in_any_direction(self):
        """What is measured is n · (u − V)."""
        scan = load_scan("6-beam", tilt_deg=4.0)
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=1)
        rng = np.random.default_rng(2)
        own = rng.normal(size=(series.sizes["sample"], 3))
        n = scan.level_direction[series["beam"].values]
        moved = series.assign(radial_velocity=series["radial_velocity"] - np.einsum("si,si->s", n, own))
        motion = xr.Dataset(
            {f"velocity_{axis}": ("time", own[:, i]) for i, axis in enumerate("xyz")},
            coords={"time": series["time"].values},
        )
        found = remove_motion(moved, motion, scan)
        np.testing.assert_allclose(found["radial_velocity"], series["radial_velocity"], rtol=1e-10, atol=1e-10)
        report = json.loads(found.attrs["motion_report"])
        assert report["samples_without_motion"] == 0
        assert report["variance_before"]["0"] > report["variance_after"]["0"]
        assert report["removed_rms"]["velocity"]["0"] == pytest.approx(1.0, rel=0.1)  # of 600 normal numbers: 3 sigma

    @pytest.mark.parametrize("shear", [0.0, 0.03])
    def test_swaying_in_steady_wind(self, shear):
        """No turbulence, wind from the side: all variance is motion, and what stays is of second order in angles."""
        scan = load_scan("6-beam", tilt_deg=1.0)
        second = np.arange(600.0)
        tilt, roll = 1.0 + 2.0 * np.sin(0.6 * second), 3.0 * np.sin(0.4 * second + 1.0)
        heading = 359.0 + 2.0 * np.sin(0.3 * second)
        at = {"beam": np.tile(scan.beam, 600), "second": np.repeat(second, 6)}
        wind = 10.0 * np.array([np.cos(0.3), -np.sin(0.3), 0.0])
        velocity = []
        for beam, t in zip(at["beam"], at["second"].astype(int), strict=True):
            n = rotate_by_hand(scan.beam_direction[beam], tilt[t], roll[t], heading[t] - 359.0)
            velocity.append(n @ wind * (1.0 + shear / 10.0 * scan.focus_distance[beam] * n[2]))
        time = START + at["second"].astype(np.int64) * SECOND
        series = xr.Dataset(
            {"radial_velocity": ("sample", np.array(velocity))},
            coords={"time": ("sample", time), "beam": ("sample", at["beam"])},
        )
        motion = motion_of(second, tilt_deg=tilt, roll_deg=roll, heading_deg=np.remainder(heading, 360.0))
        found = remove_motion(series, motion, scan, shear=shear)
        report = json.loads(found.attrs["motion_report"])
        left = np.array(list(report["variance_after"].values())) / np.array(list(report["variance_before"].values()))
        # angles of 0.05 rad: what is left is (angle)² of what was there in velocity, and more where shear is strong
        assert np.all(left < (0.01 if shear else 1e-4))
        if shear:
            without = remove_motion(series, motion, scan)
            worse = json.loads(without.attrs["motion_report"])["variance_after"]
            assert all(worse[beam] > report["variance_after"][beam] for beam in worse)

    def test_turbulence_keeps_its_variance(self):
        """Motion is added and taken out again: the variances come back to second order in the angles."""
        scan = load_scan("6-beam")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=2, seed=4)
        t = (series["time"].values - series["time"].values[0]) / SECOND
        tilt, surge = 1.0 * np.sin(0.5 * t), 0.8 * np.sin(0.5 * t + 0.4)
        n = np.stack(
            [
                rotate_by_hand(scan.beam_direction[b], a, 0.0, 0.0)
                for b, a in zip(series["beam"].values, tilt, strict=True)
            ]
        )
        still = scan.level_direction[series["beam"].values]
        moved = series.assign(radial_velocity=series["radial_velocity"] + 10.0 * (n - still)[:, 0] - surge * n[:, 0])
        motion = xr.Dataset(
            {"tilt_deg": ("time", tilt), "velocity_x": ("time", surge)}, coords={"time": series["time"].values}
        )
        motion = motion.isel(time=np.unique(motion["time"].values, return_index=True)[1])
        truth, found = (brs.make_records(s, scan) for s in (series, remove_motion(moved, motion, scan)))
        wrong = brs.make_records(moved, scan)
        np.testing.assert_allclose(found["variance"], truth["variance"], rtol=0.01)
        assert np.all(wrong["variance"] / truth["variance"] > 1.1)

    def test_a_heading_is_interpolated_through_north(self):
        """A lidar that turns from 358° to 2° looks to 0° in between, not to 180°; steady wind from 350°."""
        scan = load_scan("6-beam")
        wind = 10.0 * np.array([np.cos(np.deg2rad(-10.0)), -np.sin(np.deg2rad(-10.0)), 0.0])
        second = np.arange(600.0)
        heading = 2.0 * np.cos(np.pi * second / 2.0)  # 2, 0, −2, 0 …
        velocity = np.array([[rotate_by_hand(n, 0.0, 0.0, h) @ wind for n in scan.beam_direction] for h in heading])
        series = xr.Dataset(
            {"radial_velocity": ("sample", velocity.ravel())},
            coords={
                "time": ("sample", START + np.repeat(second, 6).astype(np.int64) * SECOND),
                "beam": ("sample", np.tile(scan.beam, 600)),
            },
        )
        motion = motion_of(second[::2], heading_deg=np.remainder(heading[::2], 360.0))
        report = json.loads(remove_motion(series, motion, scan, max_gap=3.0).attrs["motion_report"])
        assert report["samples_without_motion"] == 6  # the last second has no motion after it
        assert max(report["variance_after"].values()) < 1e-3 * max(report["variance_before"].values())

    def test_gaps_become_missing_and_are_counted(self, caplog):
        scan = load_scan("staring")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=1)
        time = series["time"].values[np.r_[0:100, 200:500]]
        motion = xr.Dataset({"velocity_x": ("time", np.zeros(400))}, coords={"time": time})
        found = remove_motion(series, motion, scan, max_gap=2.0)
        missing = np.isnan(found["radial_velocity"].values)
        assert np.flatnonzero(missing).tolist() == [*range(100, 200), *range(500, 600)]
        assert json.loads(found.attrs["motion_report"])["samples_without_motion"] == 200
        assert caplog.messages == ["200 of 600 samples have no motion within 2 s, and count as missing."]

    def test_refuses_motion_that_holds_nothing(self):
        scan = load_scan("staring")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=1)
        with pytest.raises(InputError, match=r"The motion holds nothing to remove: give some of tilt_deg"):
            remove_motion(series, motion_of([0.0], depth=[1.0]), scan)

    @pytest.mark.parametrize("seconds", [np.arange(7200.0, 7800.0), np.arange(0.0, 600.0, 30.0)])
    @pytest.mark.parametrize("name", ["velocity_x", "tilt_deg"])
    def test_refuses_motion_of_no_sample(self, seconds, name):
        """Two hours off, or with gaps that are too long: all samples would be missing."""
        scan = load_scan("staring")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=1)
        series = series.assign_coords(time=series["time"] - series["time"][0] + START + SECOND // 2)
        words = rf"No sample .* UTC\) that have {name} and are at most max_gap=2 s apart"
        with pytest.raises(InputError, match=words):
            remove_motion(series, motion_of(seconds, **{name: np.zeros(len(seconds))}), scan)


class TestReadMotion:
    def test_several_files_in_any_order(self, tmp_path):
        (tmp_path / "b.csv").write_text("t;roll\n2020-09-03 19:00:02;1,5\n2020-09-03 19:00:03;9999\n;2\n")
        (tmp_path / "a.csv").write_text("t;roll\n2020-09-03 19:00:01;0,5\n2020-09-03 19:00:02;1,0\n")
        found = read_motion(
            [tmp_path / "b.csv", tmp_path / "a.csv"],
            columns={"time": "t", "roll_deg": "roll"},
            separator=";",
            decimal=",",
            invalid=[9999.0],
            time_zone="UTC+1",
        )
        assert found["time"].values.tolist() == (START - 3600 * SECOND + np.array([1, 2, 3]) * SECOND).tolist()
        np.testing.assert_array_equal(found["roll_deg"], [0.5, 1.0, np.nan])

    @pytest.mark.parametrize(
        ("columns", "message"),
        [
            ({"time": "t", "pitch": "p"}, r"Unknown name 'pitch' in columns: it must be one of time, tilt_deg"),
            ({"tilt_deg": "p"}, r"give the heading of the time, and of what moves, .*--motion-column tilt_deg=Tilt"),
            ({"time": "t", "tilt_deg": "p"}, r"has no column 'p' for tilt_deg"),
        ],
    )
    def test_refuses(self, tmp_path, columns, message):
        file = tmp_path / "a.csv"
        file.write_text("t,roll\n2020-09-03 19:00:01,0.5\n")
        with pytest.raises(InputError, match=message):
            read_motion(file, columns=columns)

    def test_times_of_another_form(self, tmp_path):
        file = tmp_path / "a.csv"
        file.write_text("t;p\n03.09.2020 19:00:01,5;0,25\n")
        columns = {"time": "t", "tilt_deg": "p"}
        form = "%d.%m.%Y %H:%M:%S,%f"
        motion = read_motion(file, columns=columns, separator=";", decimal=",", time_format=form)
        assert motion["time"].values == np.datetime64("2020-09-03T19:00:01.5")
        assert motion["tilt_deg"].values == 0.25

    def test_no_angle_marks_a_missing_entry(self, tmp_path):
        rows = ["time,tilt,roll,heading,x"] + [f"2020-09-03T19:00:0{second},0,0.0,0,0" for second in range(3)]
        (tmp_path / "a.csv").write_text("\n".join([*rows, "2020-09-03T19:00:03,-999,-999,-999,1"]) + "\n")
        columns = {"time": "time", "tilt_deg": "tilt", "roll_deg": "roll", "heading_deg": "heading", "velocity_x": "x"}
        motion = read_motion(tmp_path / "a.csv", columns=columns, invalid=(0, -999))
        for name in ("tilt_deg", "roll_deg", "heading_deg"):
            np.testing.assert_array_equal(motion[name].values, [0.0, 0.0, 0.0, np.nan])
        np.testing.assert_array_equal(motion["velocity_x"].values, [np.nan, np.nan, np.nan, 1.0])

    def test_refuses_a_file_that_is_not_there(self, tmp_path):
        with pytest.raises(InputError, match=r"No file .*: check the path of the motion\."):
            read_motion(tmp_path / "none.csv", columns={"time": "t", "tilt_deg": "p"})

    def test_the_measured_day(self, iea_folder):
        """The README of the data: the mean tilt is 5.0°; the stand is fixed."""
        files = sorted(iea_folder.glob("Lidar_*_LOS?_178m.csv"))
        scan = load_scan("pulsed-4-beam")
        motion = read_motion(
            files, columns={"time": "Timestamp", "tilt_deg": "Tilt", "roll_deg": "Roll"}, invalid=[9999.0]
        )
        records = brs.make_records(brs.read(files, scan), scan)
        found = with_motion(records, motion, scan)
        np.testing.assert_allclose(found["tilt"], 5.0, atol=0.05)
        np.testing.assert_allclose(found["roll"], 0.0, atol=0.05)
        assert float(found["tilt_sd"].max()) < 0.1
        np.testing.assert_allclose(found["yaw"], records["yaw"], atol=0.01)
