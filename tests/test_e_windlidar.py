"""e-WindLidar files: the same records from every way to write them, and one clear line for every kind of bad file."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ray_checks import CHANGES, FLOW, SIX, check_changed, check_cut_off, check_refused, check_same_records
from ray_files import e_windlidar, rays_of

from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers import read
from bayes_rs.readers.e_windlidar import e_windlidar_rays, read_e_windlidar, recognises_e_windlidar
from bayes_rs.readers.format import resolve_format
from bayes_rs.simulation.virtual import simulate

VARIABLES = ("VEL", "CNR", "range", "azimuth_angle", "elevation_angle", "time")
OWN_CHANGES = {**CHANGES, "no_attrs": lambda rays, name: rays.assign({name: rays[name].drop_attrs()})}
ATTRIBUTES = [
    ("units", "\u00b0?"),
    ("units", 7),
    ("comment", [1.0, 2.0]),
    ("comment", "seconds since campaign start at 2000-99-99"),
    ("long_name", 7),
    ("missing_value", "x"),
    ("scale_factor", "x"),
    ("_FillValue", "x"),
]


@pytest.fixture(scope="module")
def series():
    return simulate(SIX, FLOW, wind_speed=8.0, n_records=2, seed=5)


@pytest.fixture(scope="module")
def table(series):
    return rays_of(series, SIX)


@pytest.fixture(scope="module")
def short(table):
    return e_windlidar(table.take(slice(0, 12)))


class TestRoundTrip:
    @pytest.mark.parametrize("time", ["comment", "long_name", "units", "text"])
    def test_the_same_records_from_every_way_to_write_times(self, time, tmp_path, series, table):
        file = tmp_path / "noon.nc"
        e_windlidar(table, time=time).to_netcdf(file, engine="h5netcdf")
        assert recognises_e_windlidar(file)
        back = read(file, SIX)
        check_same_records(back, series)
        assert (back["cnr"] == -12.5).all()
        assert json.loads(back.attrs["read_report"])["files"][0]["format"] == "e-windlidar"

    def test_dimensions_may_have_any_names_and_order(self, tmp_path, series, table):
        renamed = e_windlidar(table).rename(range="gate_distance").rename_dims(time="ray", gate_distance="gate")
        renamed = renamed.rename(gate_distance="range").reset_coords().transpose()
        renamed.to_netcdf(tmp_path / "noon.nc", engine="h5netcdf")
        back = read(tmp_path / "noon.nc", SIX)
        np.testing.assert_array_equal(np.sort(back["radial_velocity"]), np.sort(series["radial_velocity"]))

    def test_rays_in_scans(self, tmp_path, series, table):
        """Two dimensions of rays: the scans, and the rays of each."""
        flat = e_windlidar(table).reset_coords()
        folded = flat.coarsen(time=6).construct(time=("scan", "ray"))
        folded.to_netcdf(tmp_path / "noon.nc", engine="h5netcdf")
        back = read(tmp_path / "noon.nc", SIX)
        np.testing.assert_array_equal(back["radial_velocity"], self.sorted_like(back, series))

    @staticmethod
    def sorted_like(back, series):
        order = np.lexsort((series["beam"].values, series["time"].values))
        assert (series["beam"].values[order] == back["beam"].values).all()
        return series["radial_velocity"].values[order]

    def test_one_direction_one_range_and_the_old_name(self, tmp_path, table):
        """A file of one line of sight, with a number for each angle, as the converter writes it for fixed beams."""
        up = np.flatnonzero(table.elevation > 89.0)
        fixed = e_windlidar(table.take(up)).rename(VEL="DOPPLER")
        fixed = fixed.assign(
            azimuth_angle=((), 217.0),
            elevation_angle=((), 89.99),
            range=("range", [50.0, 100.0, 150.0, 200.0], {"units": "m"}),
        )
        fixed.to_netcdf(tmp_path / "noon.nc", engine="h5netcdf")
        back = read(tmp_path / "noon.nc", SIX)
        assert np.unique(back["beam"]).tolist() == [5, 11]
        np.testing.assert_array_equal(back["radial_velocity"][::2], table.velocity[up, 1])

    def test_accumulation_time_counts_where_a_stamp_is_not_at_the_start(self, tmp_path, table):
        start = table.take(slice(0, 12))
        e_windlidar(start, accumulation=2.0).to_netcdf(tmp_path / "variable.nc", engine="h5netcdf")
        e_windlidar(start).assign_attrs(accumulation_time="2").to_netcdf(tmp_path / "attribute.nc", engine="h5netcdf")
        for name in ("variable.nc", "attribute.nc"):
            plain = read(tmp_path / name, SIX)["time"].values
            for stamp, shift in (("start", 0), ("middle", 1), ("end", 2)):
                moved = read(tmp_path / name, SIX, time_stamp=stamp)["time"].values
                assert (plain - moved == np.timedelta64(shift, "s")).all()

    def test_the_sign_is_an_option(self, tmp_path, short):
        short.to_netcdf(tmp_path / "noon.nc", engine="h5netcdf")
        away, towards = (
            read(tmp_path / "noon.nc", SIX, positive=sign)["radial_velocity"].values for sign in ("away", "towards")
        )
        np.testing.assert_array_equal(away, -towards)


def refused(folder, rays, match):
    check_refused(folder, rays, "e-windlidar", match)


class TestBadFiles:
    @pytest.mark.parametrize(
        ("name", "ours"),
        [("VEL", "radial velocity"), ("time", "time"), ("azimuth_angle", "azimuth"), ("range", "distance")],
    )
    def test_missing_variables(self, tmp_path, short, name, ours):
        refused(tmp_path, short.drop_vars(name), f"no variable '{name}' for the {ours} of its rays")

    def test_times_since_nothing(self, tmp_path, short):
        short = short.assign_coords(time=short["time"].drop_attrs())
        refused(tmp_path, short, "counts seconds .* no units, long_name or comment of it says since when")

    def test_times_that_are_no_times(self, tmp_path, table):
        rays = e_windlidar(table.take(slice(0, 12)), time="text").reset_coords()
        text = rays["time"].values
        rays = rays.assign(time=("time", np.where(np.arange(12) == 3, "soon", text).astype(object))).reset_coords()
        refused(tmp_path, rays, "Invalid time 'soon' in ray 4 of file")
        rays = rays.assign(time=("time", np.where(np.arange(12) == 3, "", text).astype(object))).reset_coords()
        rays.to_netcdf(tmp_path / "gap.nc", engine="h5netcdf")
        back = read(tmp_path / "gap.nc", SIX)
        assert json.loads(back.attrs["read_report"])["rows_without_time"] == 1

    def test_angles_of_no_lidar(self, tmp_path, short):
        refused(tmp_path, short.assign(azimuth_angle=short["azimuth_angle"] + 1e4), "Invalid azimuth 10000")

    def test_a_direction_that_the_scan_does_not_have(self, tmp_path, short):
        refused(tmp_path, short.assign(elevation_angle=short["elevation_angle"] - 30.0), "No ray of file")

    def test_files_that_are_cut_off(self, tmp_path, short):
        file = tmp_path / "noon.nc"
        short.to_netcdf(file, engine="h5netcdf")
        check_cut_off(file, read_e_windlidar, recognises_e_windlidar, 20)

    @settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        st.lists(st.tuples(st.sampled_from(sorted(OWN_CHANGES)), st.sampled_from(VARIABLES)), max_size=2),
        st.lists(st.tuples(st.sampled_from(ATTRIBUTES), st.sampled_from(VARIABLES)), max_size=1),
    )
    def test_a_changed_file_is_read_or_refused_with_its_name(self, tmp_path, short, changes, attributes):
        check_changed(
            tmp_path, short, "e-windlidar", [(OWN_CHANGES[change], name) for change, name in changes], attributes
        )


def test_rays_keep_what_the_file_says_of_them(tmp_path, short):
    short.to_netcdf(tmp_path / "noon.nc", engine="h5netcdf")
    up = Scan("up", np.array([[0.0, 0.0, 1.0]]), np.array([100.0]), np.zeros(1), scan_duration=30.0)
    rays = e_windlidar_rays(tmp_path / "noon.nc", resolve_format(FileOptions(), up))
    assert (rays.kind, rays.row_word, rays.row[0], rays.status) == ("e-windlidar", "ray", 1, None)
    assert rays.accumulation_time is None
    assert np.linalg.norm(rays.direction, axis=1) == pytest.approx(np.ones(12), abs=1e-12)
