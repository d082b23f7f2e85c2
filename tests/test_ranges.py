"""All ranges at once: what is read at several ranges is, range by range, what is read at each alone."""

import json
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from ray_files import rays_of, six_beam, windcube_sweep, write_windcube

import bayes_rs as brs
from bayes_rs import load_scan, make_records, read
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.cli.group import commands
from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan, distances_at, short
from bayes_rs.records import at_range, describe_report, open_records, store_records, stream_records
from bayes_rs.records.flags import BEAM_FLAGS
from bayes_rs.records.ranges import scan_of_records
from bayes_rs.result_folder import open_result_folder
from bayes_rs.wind.motion import add_motion

HEIGHTS = (80.0, 120.0, 200.0)
DURATION = 600.0


def scan_at(height):
    return six_beam(height)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Forty minutes of a six-beam scan with gates at three heights, and gates with rubbish around them."""
    planes = six_beam(*HEIGHTS)
    rng = np.random.default_rng(5)
    n_cycle = 80
    time = np.datetime64("2024-03-01T00:00", "ns") + (
        (30.0 * np.arange(n_cycle)[:, np.newaxis] + planes.beam_time) * 1e9
    ).astype("timedelta64[ns]")
    spread = np.repeat([0.5, 1.0, 2.0], 6)
    velocity = planes.line_of_sight @ np.array([-8.0, 0.0, 0.0]) + spread * rng.normal(size=(n_cycle, 18))
    series = xr.Dataset(
        {"radial_velocity": ("sample", velocity.ravel())},
        coords={"time": ("sample", time.ravel()), "beam": ("sample", np.tile(planes.beam, n_cycle))},
    )
    place = tmp_path_factory.mktemp("ranges") / "six.nc"
    return write_windcube(place, windcube_sweep(rays_of(series, planes)))


def assert_same_records(one, other):
    """Records of one range read with others are those of that range read alone, bit by bit."""
    assert set(one.variables) == set(other.variables) - {"focus_distance"}
    for name in one.variables:
        np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=str(name))
        assert one[name].dims == other[name].dims
        assert one[name].dtype == other[name].dtype
    # what was read is told once for all ranges; the gates of the file are rounded to a millimetre
    skipped = ("read_report", "scan_key")
    assert {k: v for k, v in one.attrs.items() if k not in skipped} == {
        k: v for k, v in other.attrs.items() if k not in (*skipped, "range", "height")
    }


class TestScanAtRanges:
    def test_each_range_is_the_scan_with_these_distances(self):
        base = load_scan("4-beam")
        ranged = RangedScan.of(base, [50.0, 90.0, 200.0])
        assert ranged.n_beam == 3 * base.n_beam
        for index, distance in enumerate((50.0, 90.0, 200.0)):
            assert ranged.at(index).key == load_scan("4-beam", focus_distance=distance).key

    def test_numbers_of_beams_are_split_and_joined_again(self):
        base = load_scan("4-beam").select([3, 1])
        ranged = RangedScan.of(base, [50.0, 90.0])
        index, beam = ranged.split(ranged.beam)
        assert index.tolist() == [0, 0, 1, 1]
        assert beam.tolist() == [3, 1, 3, 1]
        np.testing.assert_array_equal(ranged.join(index, beam), ranged.beam)

    def test_heights_are_those_of_beams_that_rise(self):
        six = six_beam(100.0)
        ranged = RangedScan.of(six, distances_at(six, [80.0, 160.0]))
        np.testing.assert_allclose(ranged.height, [80.0, 160.0])
        assert RangedScan.of(load_scan("4-beam"), [80.0]).height is None
        # the zenith's gate is 3.5 % higher than the others: the median is told
        np.testing.assert_allclose(RangedScan.of(six, [100.0]).height, 100.0 * np.sin(np.deg2rad(75.0)))
        flat = six.select([0, 5])
        assert RangedScan.of(flat, [[80.0, 120.0]]).height is None

    @pytest.mark.parametrize(
        ("distance", "words"),
        [([90.0, 50.0], "they must rise"), ([50.0, 50.0], "each stand once"), ([], "No range")],
    )
    def test_ranges_that_are_none_are_refused(self, distance, words):
        with pytest.raises(InputError, match=words):
            RangedScan.of(load_scan("4-beam"), distance)

    def test_planes_have_their_ranges_already(self):
        with pytest.raises(InputError, match="has planes"):
            RangedScan.of(load_scan("4-beam-planes"), [50.0])

    def test_names_are_as_short_as_they_differ(self):
        assert short([80.0, 120.0]) == ["80", "120"]
        assert short([80.2, 80.4]) == ["80.2", "80.4"]


class TestReading:
    def test_every_height_is_what_it_is_alone(self, file):
        scan = scan_at(120.0)
        together = make_records(read(file, scan, height=HEIGHTS), scan)
        assert dict(together.sizes)["range"] == 3
        np.testing.assert_allclose(together["height"].values, HEIGHTS, rtol=1e-3)
        for height in HEIGHTS:
            own = scan_at(height)
            assert_same_records(make_records(read(file, own), own), at_range(together, height=height))

    def test_variances_are_those_of_numpy(self, file):
        scan = scan_at(120.0)
        series = read(file, scan, height=HEIGHTS)
        records = make_records(series, scan)
        for place, value in enumerate(records["range"].values):
            for beam in range(6):
                mine = (series["range"].values == value) & (series["beam"].values == beam)
                first = mine & (series["time"].values < np.datetime64("2024-03-01T00:10"))
                expected = np.var(series["radial_velocity"].values[first])
                np.testing.assert_allclose(records["variance"].values[place, 0, beam], expected, rtol=1e-12)

    def test_all_are_the_gates_that_the_beams_have_in_common(self, file):
        series = read(file, scan_at(120.0), range="all")
        # three heights, and a gate of rubbish before and behind them
        assert len(np.unique(series["range"].values)) == 5
        np.testing.assert_allclose(
            np.unique(series["range"].values)[1:4], np.array(HEIGHTS) / np.sin(np.deg2rad(75)), atol=1.0
        )

    def test_a_stream_is_the_whole(self, file):
        scan = scan_at(120.0)
        whole = make_records(read(file, scan, height=HEIGHTS), scan)
        parts = brs.readers.stream(file, scan, chunk_rows=50, period=600.0, height=HEIGHTS)
        streamed = stream_records(parts, scan)
        for name in whole.variables:
            np.testing.assert_array_equal(whole[name].values, streamed[name].values, err_msg=str(name))

    def test_records_of_files_are_kept_and_not_read_again(self, file, tmp_path):
        scan = scan_at(120.0)
        reading = brs.readers.FileOptions(height=HEIGHTS)
        whole = make_records(read(file, scan, height=HEIGHTS), scan)
        with begin_result_folder(tmp_path / "out", key="k", key_parts={}) as folder:
            stored = store_records(file, scan, folder, reading=reading).records
            again = store_records(file, scan, folder, reading=reading)
            for name in whole.variables:
                np.testing.assert_array_equal(whole[name].values, stored[name].values, err_msg=str(name))
                np.testing.assert_array_equal(whole[name].values, again.records[name].values, err_msg=str(name))
            assert again.n_resumed == 1
            said = []
            other = store_records(
                file, scan, folder, reading=brs.readers.FileOptions(height=HEIGHTS[:2]), say=said.append
            )
            assert other.n_resumed == 0
            assert said == ["The files are read at other ranges than by an earlier run: all are read again."]
            assert other.records.sizes["range"] == 2
            folder.finish({})
        assert open_result_folder(tmp_path / "out").finished

    def test_a_range_without_a_sample_has_the_records_of_the_others(self, file):
        scan = scan_at(120.0)
        series = read(file, scan, height=HEIGHTS)
        near = series["range"].values == np.unique(series["range"].values)[0]
        late = series["time"].values > np.datetime64("2024-03-01T00:20")
        some = series.isel(sample=~near | late)
        records = make_records(some, scan)
        assert records.sizes["record"] == 4
        assert (records["flag"].values[0, :2] & BEAM_FLAGS["no_samples"]).all()
        assert not records["flag"].values[1].any()
        none = make_records(series.isel(sample=~near), scan)
        assert (none["flag"].values[0] == BEAM_FLAGS["no_samples"]).all()
        assert np.isnan(none["wind_speed"].values[0]).all()
        np.testing.assert_array_equal(none["variance"].values[1], records["variance"].values[1])

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"range": [80.0], "height": [80.0]}, "two ways to say one thing"),
            ({"range": "some"}, "or the word all"),
            ({"range": -5.0}, "range"),
            ({"height": [900.0]}, "No gate at height 900 m"),
            ({"height": [119.0, 121.0]}, "take the same gate"),
            ({"range": []}, "at least one distance"),
        ],
    )
    def test_what_cannot_be_is_refused(self, file, options, words):
        with pytest.raises(InputError, match=words):
            read(file, scan_at(120.0), **options)

    def test_a_height_needs_beams_that_rise(self):
        with pytest.raises(InputError, match="not all of its beams rise"):
            distances_at(load_scan("4-beam"), [80.0])

    def test_a_file_without_ranges_has_none_to_choose(self, tmp_path):
        table = tmp_path / "wide.csv"
        table.write_text("time,vr_0,vr_1\n2024-01-01T00:00:00,1,2\n2024-01-01T00:00:01,1,2\n")
        with pytest.raises(InputError, match="does not say at which range it was measured"):
            read(table, "2-beam", range=[80.0])


class TestFilesOfOneBeam:
    """A file may hold one ray only, or a beam may have none at all."""

    @pytest.fixture
    def files(self, tmp_path):
        planes, paths = six_beam(*HEIGHTS), []
        time = np.datetime64("2024-03-01T00:00", "ns") + (planes.beam_time * 1e9).astype("timedelta64[ns]")
        velocity = planes.line_of_sight @ np.array([-8.0, 0.0, 0.0])
        series = xr.Dataset(
            {"radial_velocity": ("sample", velocity)},
            coords={"time": ("sample", time), "beam": ("sample", planes.beam)},
        )
        whole = rays_of(series, planes)
        names = [entry.name for entry in fields(whole)]
        for index in range(len(whole.seconds)):
            one = replace(whole, **{name: getattr(whole, name)[index : index + 1] for name in names})
            paths.append(write_windcube(tmp_path / f"{index}.nc", windcube_sweep(one)))
        return paths

    def test_their_gates_are_put_together(self, files):
        series = read(files, scan_at(120.0), height=HEIGHTS)
        assert series.sizes["sample"] == 18
        for beam in range(6):
            assert len(np.unique(series["range"].values[series["beam"].values == beam])) == 3

    def test_a_beam_without_a_ray_is_absent(self, files):
        series = read(files[:-1], scan_at(120.0), height=HEIGHTS)
        assert series.sizes["sample"] == 15
        assert json.loads(series.attrs["read_report"])["beams_absent"] == [5]

    def test_rays_of_another_scan_are_said_to_be_such(self, files):
        words = r"No ray of file '.*0.nc' looks along a beam of scan '2-beam': give the scan that it was measured with"
        with pytest.raises(InputError, match=words):
            read(files, "2-beam", range=[100.0])


class TestPulsedTable:
    """A pulsed nacelle lidar's own table: a row for each beam and distance."""

    DISTANCES = (80.0, 120.0, 160.0, 178.0, 200.0)

    @staticmethod
    def write(file, distances, *, n_scan=300):
        rng = np.random.default_rng(2)
        time = np.datetime64("2024-03-01T00:00", "ns") + np.arange(n_scan * 4) * np.timedelta64(1, "s")
        rows = pd.DataFrame(
            [
                (stamp, beam, distance, round(9.0 + (1.0 + place) * rng.normal(), 3), -12.0, 1)
                for stamp, beam in zip(time, np.tile(np.arange(4), n_scan), strict=True)
                for place, distance in enumerate(distances)
            ],
            columns=["Timestamp", "LOSindex", "Distance", "RWS", "CNR", "RWSStatus"],
        )
        rows.to_csv(file, index=False)
        return rows

    def test_all_distances_are_read_and_stay_apart(self, tmp_path):
        rows = self.write(tmp_path / "a.csv", self.DISTANCES)
        records = make_records(read(tmp_path / "a.csv", "pulsed-4-beam"), "pulsed-4-beam")
        assert records["range"].values.tolist() == list(self.DISTANCES)
        for place, distance in enumerate(self.DISTANCES):
            for beam in range(4):
                own = rows[(rows["Distance"] == distance) & (rows["LOSindex"] == beam)].iloc[:150]
                found = records["variance"].values[place, 0, beam]
                np.testing.assert_allclose(found, np.var(own["RWS"]), rtol=1e-12)
        # the standard deviations were 1 to 5 m/s: no range has that of another
        assert (np.diff(records["variance"].values[:, 0].mean(axis=1)) > 1.0).all()

    def test_some_are_taken_by_what_is_near(self, tmp_path):
        self.write(tmp_path / "a.csv", self.DISTANCES)
        series = read(tmp_path / "a.csv", "pulsed-4-beam", range=[122.0, 80.0])
        assert np.unique(series["range"].values).tolist() == [80.0, 120.0]
        report = json.loads(series.attrs["read_report"])["files"][0]
        assert report["rows_of_other_ranges"] == 3 * 1200

    @pytest.mark.parametrize("moves", [0.02, 0.2, 2.0])
    def test_a_gate_may_move_a_little(self, tmp_path, moves):
        rows = self.write(tmp_path / "a.csv", self.DISTANCES)
        whole = make_records(read(tmp_path / "a.csv", "pulsed-4-beam"), "pulsed-4-beam")
        rng = np.random.default_rng(4)
        off = np.where(rng.random(len(rows)) < 0.5, 1.0, rng.uniform(-1.0, 1.0, len(rows)))
        rows.assign(Distance=np.round(rows["Distance"] + moves * off, 3)).to_csv(tmp_path / "b.csv", index=False)
        for options in ({}, {"range": self.DISTANCES}):
            series = read(tmp_path / "b.csv", "pulsed-4-beam", **options)
            report = json.loads(series.attrs["read_report"])["files"][0]
            assert (report["rows_of_other_ranges"], len(report["ranges"])) == (0, 5)
            records = make_records(series, "pulsed-4-beam")
            np.testing.assert_allclose(records["range"].values, self.DISTANCES, atol=moves)
            np.testing.assert_array_equal(records["variance"].values, whole["variance"].values)

    def test_gates_that_are_close_stay_apart(self, tmp_path):
        close = [10.0, 10.25, 10.5, 10.75]
        self.write(tmp_path / "a.csv", close)
        records = make_records(read(tmp_path / "a.csv", "pulsed-4-beam", range="all"), "pulsed-4-beam")
        assert records["range"].values.tolist() == close
        assert (np.diff(records["variance"].values[:, 0].mean(axis=1)) > 1.0).all()

    @pytest.mark.parametrize("options", [{}, {"range": "all"}, {"range": [80.0]}])
    def test_distances_in_km_are_refused(self, tmp_path, options):
        rows = self.write(tmp_path / "a.csv", self.DISTANCES)
        rows.assign(Distance=rows["Distance"] / 1000.0).to_csv(tmp_path / "a.csv", index=False)
        words = r"distances of file '.*a.csv' are 0.08, 0.12, 0.16, 0.178, 0.2, and must be in m: they look like km"
        with pytest.raises(InputError, match=words):
            read(tmp_path / "a.csv", "pulsed-4-beam", **options)
        with pytest.raises(InputError, match=words):
            read(tmp_path / "a.csv", load_scan("pulsed-4-beam", focus_distance=160.0), **options)

    def test_a_file_whose_gates_are_elsewhere_is_told(self, tmp_path):
        self.write(tmp_path / "a.csv", [80.0, 120.0])
        later = self.write(tmp_path / "b.csv", [90.0, 120.0])
        later.assign(Timestamp=later["Timestamp"] + pd.Timedelta("1h")).to_csv(tmp_path / "b.csv", index=False)
        series = read([tmp_path / "a.csv", tmp_path / "b.csv"], "pulsed-4-beam")
        assert [file.get("gates_off") for file in json.loads(series.attrs["read_report"])["files"]] == [None, 10.0]
        one, other, *_ = describe_report(make_records(series, "pulsed-4-beam"))
        assert "count for" not in one
        assert other.endswith("; gates up to 10 m from the ranges that they count for, those of another file")

    def test_a_stream_is_the_whole_where_a_range_lacks_a_beam(self, tmp_path):
        rows = self.write(tmp_path / "a.csv", self.DISTANCES)
        rows[(rows["Distance"] < 200.0) | (rows["LOSindex"] != 2)].to_csv(tmp_path / "a.csv", index=False)
        series = read(tmp_path / "a.csv", "pulsed-4-beam")
        whole = make_records(series, "pulsed-4-beam")
        chunks = [series.isel(sample=slice(first, first + 1000)) for first in range(0, series.sizes["sample"], 1000)]
        streamed = stream_records(chunks, "pulsed-4-beam")
        for name in whole.variables:
            np.testing.assert_array_equal(whole[name].values, streamed[name].values, err_msg=str(name))
        assert whole.attrs["of_ranges"] == streamed.attrs["of_ranges"]

    def test_a_flag_that_is_repeated_loses_no_range(self, tmp_path):
        self.write(tmp_path / "a.csv", self.DISTANCES)
        call = ["records", str(tmp_path / "a.csv"), "--scan", "pulsed-4-beam", "-o", str(tmp_path / "r.nc")]
        done = CliRunner().invoke(commands, [*call, "--range", "200,80", "--range", "120"])
        assert done.exit_code == 0, done.output
        assert open_records(tmp_path / "r.nc", "pulsed-4-beam")["range"].values.tolist() == [80.0, 120.0, 200.0]
        done = CliRunner().invoke(commands, [*call, "--overwrite", "--range", "80", "--range", "all"])
        assert done.exit_code == 2
        assert "--range all: it stands alone; leave the other --range out." in done.output

    def test_the_scans_own_distance_alone_is_no_dimension(self, tmp_path):
        self.write(tmp_path / "a.csv", [178.0])
        assert "range" not in read(tmp_path / "a.csv", "pulsed-4-beam").coords
        self.write(tmp_path / "b.csv", [120.0])
        assert np.unique(read(tmp_path / "b.csv", "pulsed-4-beam")["range"].values).tolist() == [120.0]

    def test_who_gives_a_distance_gets_that_alone(self, tmp_path):
        self.write(tmp_path / "a.csv", self.DISTANCES)
        series = read(tmp_path / "a.csv", load_scan("pulsed-4-beam", focus_distance=160.0))
        assert "range" not in series.coords
        assert series.sizes["sample"] == 1200

    def test_a_series_is_written_and_read_with_its_ranges(self, tmp_path):
        self.write(tmp_path / "a.csv", self.DISTANCES)
        series = read(tmp_path / "a.csv", "pulsed-4-beam")
        series.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        again = read(tmp_path / "a.nc", "pulsed-4-beam", range="all")
        for name in ("radial_velocity", "time", "beam", "range"):
            np.testing.assert_array_equal(series[name].values, again[name].values)
        one = read(tmp_path / "a.nc", load_scan("pulsed-4-beam", focus_distance=160.0))
        np.testing.assert_array_equal(
            one["radial_velocity"].values, series["radial_velocity"].values[series["range"].values == 160.0]
        )

    def test_a_file_among_others_that_says_no_range_is_refused(self, tmp_path):
        self.write(tmp_path / "a.csv", self.DISTANCES)
        other = pd.read_csv(tmp_path / "a.csv").query("Distance == 80").drop(columns="Distance")
        other.to_csv(tmp_path / "b.csv", index=False)
        with pytest.raises(InputError, match=r"b.csv.* does not say at which range"):
            read([tmp_path / "a.csv", tmp_path / "b.csv"], "pulsed-4-beam")


class TestRecordsAtRanges:
    @pytest.fixture
    @staticmethod
    def records(file):
        scan = scan_at(120.0)
        return make_records(read(file, scan, height=HEIGHTS), scan)

    def test_they_are_written_and_read_again(self, records, tmp_path):
        place = tmp_path / "records.nc"
        records.to_netcdf(place, engine="h5netcdf")
        found = open_records(place, scan_at(120.0))
        for name in records.variables:
            np.testing.assert_array_equal(records[name].values, found[name].values, err_msg=str(name))
        assert json.loads(found.attrs["of_ranges"]) == json.loads(records.attrs["of_ranges"])

    def test_their_report_has_a_line_for_each_range(self, records):
        said = brs.records.describe_report(records)
        assert any(line.startswith("4 records of 600 s at each of the heights") for line in said)
        for height in ("80", "120", "200"):
            assert any(line.startswith(f"  {height}: 4 with all beams") for line in said)

    def test_what_is_of_one_range_refuses_several(self, records):
        with pytest.raises(InputError, match=r"are at 3 ranges .* take one with .*at_range"):
            brs.wind.mean_wind(records, scan_at(120.0), turbulence="fu-2022")
        with pytest.raises(InputError, match=r"are at 3 ranges .* take one with .*at_range"):
            brs.noise.calibrate(scan_at(120.0), "fu-2022", records=records)
        words = r"are at 1 range \(.* m\), .* at one \(--focus-distance DISTANCE, in place of --range\)"
        with pytest.raises(InputError, match=words):
            brs.wind.mean_wind(records.isel(range=[0]), scan_at(120.0), turbulence="fu-2022")

    def test_what_is_of_one_range_refuses_a_series_of_several(self, file):
        scan = scan_at(120.0)
        series = read(file, scan, height=HEIGHTS)
        records = make_records(series, scan)
        words = r"of 3 ranges \(83, 124, 207 m\).*NAME@focus_distance=82.822"
        with pytest.raises(InputError, match=words):
            brs.spectra.radial_spectra(series, scan, at_range(records, height=80.0))
        with pytest.raises(InputError, match=words):
            brs.wind.reconstruct_pairs(series, scan)

    def test_each_range_gets_the_motion_of_the_lidar(self, records, tmp_path):
        moved = tmp_path / "motion.csv"
        stamps = pd.date_range("2024-03-01T00:00", periods=240, freq="10s")
        pd.DataFrame({"time": stamps, "tilt_deg": np.linspace(0.0, 2.0, 240)}).to_csv(moved, index=False)
        columns = {"time": "time", "tilt_deg": "tilt_deg"}
        options = brs.records.RecordOptions(motion=[moved], motion_columns=columns)
        found = add_motion(records, scan_at(120.0), options)
        assert found["tilt"].dims == ("range", "record")
        for height in HEIGHTS:
            own = at_range(records, height=height)
            alone = add_motion(own, scan_of_records(own, scan_at(120.0)), options)
            for name in ("tilt", "wind_speed", "yaw"):
                np.testing.assert_array_equal(alone[name].values, at_range(found, height=height)[name].values)

    def test_a_range_is_taken_by_what_is_near(self, records):
        assert at_range(records, height=118.0).attrs["height"] == pytest.approx(120.0, rel=1e-3)
        with pytest.raises(InputError, match="No height 400 m: there are 80, 120, 200 m"):
            at_range(records, height=400.0)
        with pytest.raises(InputError, match="Give a range or a height"):
            at_range(records)
        with pytest.raises(InputError, match="of one range already"):
            at_range(at_range(records, height=80.0), 80.0)
