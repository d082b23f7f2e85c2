"""WindCube files: the same records from every layout, and one clear line for every kind of bad file."""

from __future__ import annotations

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ray_checks import CHANGES, FLOW, SIX, check_changed, check_cut_off, check_refused, check_same_records
from ray_files import rays_of, windcube_sweep, write_windcube

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers import read
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.windcube import read_windcube, recognises_windcube, windcube_rays
from bayes_rs.records.making import make_records
from bayes_rs.simulation.virtual import simulate

LAYOUTS = ("flat", "groups", "two groups", "reference", "ray by ray", "swapped", "shared range")


@pytest.fixture(scope="module")
def series():
    return simulate(SIX, FLOW, wind_speed=8.0, n_records=2, seed=4)


@pytest.fixture(scope="module")
def table(series):
    return rays_of(series, SIX)


@pytest.fixture(scope="module")
def short(table):
    """Two cycles, as a dataset: Hypothesis writes out what a dataclass holds."""
    return windcube_sweep(table.take(slice(0, 12)))


def write(folder, table, layout):
    if layout == "flat":
        windcube_sweep(table).to_netcdf(folder / "noon.nc")
    elif layout == "swapped":
        windcube_sweep(table).transpose().to_netcdf(folder / "noon.nc")
    elif layout == "groups":
        write_windcube(folder / "noon.nc", windcube_sweep(table))
    elif layout == "reference":
        write_windcube(folder / "noon.nc", windcube_sweep(table, epoch="time_reference"))
    elif layout == "two groups":  # the second with its zeniths at gates of their own, one less
        slant = np.abs(table.elevation - 90.0) > 1.0
        up = table.take(~slant)
        up = replace(up, distance=up.distance[:, :-1], velocity=up.velocity[:, :-1])
        write_windcube(folder / "noon.nc", windcube_sweep(table.take(slant)), windcube_sweep(up))
    elif layout == "ray by ray":
        for start in range(0, len(table.seconds), 30):
            part = table.take(slice(start, start + 1 if start else 30))
            windcube_sweep(part).to_netcdf(folder / f"ray{start:04d}.nc")
    elif layout == "shared range":  # a gate dimension with its distances, as files of one elevation have
        slant = np.abs(table.elevation - 90.0) > 1.0
        for name, kept in (("slant", slant), ("up", ~slant)):
            sweep = windcube_sweep(table.take(kept))
            distances = ("gate_index", sweep["range"].values[0], sweep["range"].attrs)
            write_windcube(
                folder / f"{name}.nc", sweep.assign(range=distances).rename(gate_index="range").set_coords("range")
            )
    return sorted(folder.iterdir())


class TestRoundTrip:
    @pytest.mark.parametrize("layout", [layout for layout in LAYOUTS if layout != "ray by ray"])
    def test_the_same_records_from_every_layout(self, layout, tmp_path, series, table):
        files = write(tmp_path, table, layout)
        assert all(recognises_windcube(file) for file in files)
        back = read(files, SIX)
        assert back.sizes["sample"] == series.sizes["sample"]
        check_same_records(back, series)
        assert (back["cnr"] == -12.5).all()
        assert back.attrs["status_valid"] == 1.0
        report = json.loads(back.attrs["read_report"])
        assert report["rows_dropped"] == 0
        assert {file["format"] for file in report["files"]} == {"windcube"}

    def test_ray_by_ray(self, tmp_path, table):
        """A file for each ray, as WindCubes write fixed directions."""
        files = write(tmp_path, table, "ray by ray")
        back = read(files, SIX)
        assert back.sizes["sample"] == 2 * (30 + len(files) - 1)

    def test_a_stamp_at_the_end_goes_to_the_start_where_the_duration_is_known(self, tmp_path, series, table):
        write_windcube(tmp_path / "noon.nc", windcube_sweep(table, accumulation=2.0))
        back = read(tmp_path / "noon.nc", SIX)
        off = np.abs(back["time"].values - series["time"].values.astype("datetime64[ns]")) / np.timedelta64(1, "ns")
        assert off.max() <= 1.0  # rounding of a double of 1e3 s to ns
        kept = read(tmp_path / "noon.nc", SIX, time_stamp="start")
        assert ((kept["time"] - back["time"].values) == np.timedelta64(2, "s")).all()
        rays = windcube_rays(tmp_path / "noon.nc", resolve_format(FileOptions(), SIX))
        np.testing.assert_array_equal(rays.accumulation_time, np.full(len(table.seconds), 2.0))

    @pytest.mark.parametrize(
        ("units", "seconds"), [("ms", 2.0), ("s", 2000.0), (None, 2.0), ("fortnight", None), (b"ms", None)]
    )
    def test_accumulation_times_of_unknown_unit_are_not_used(self, tmp_path, table, units, seconds):
        sweep = windcube_sweep(table.take(slice(0, 12)), accumulation=2.0)
        sweep["ray_accumulation_time"].attrs = {} if units is None else {"units": units}
        sweep.to_netcdf(tmp_path / "noon.nc", engine="h5netcdf")
        rays = windcube_rays(tmp_path / "noon.nc", resolve_format(FileOptions(), SIX))
        if seconds is None and units != b"ms":
            assert rays.accumulation_time is None
        elif seconds is not None:
            assert rays.accumulation_time == pytest.approx(np.full(12, seconds))

    def test_rejected_velocities_do_not_count(self, tmp_path, table):
        velocity = table.velocity.copy()
        velocity[::7] = np.nan
        windcube_sweep(replace(table, velocity=velocity)).to_netcdf(tmp_path / "noon.nc")
        back = read(tmp_path / "noon.nc", SIX)
        assert (back["status"].values == np.isfinite(back["radial_velocity"].values)).all()
        sweep = windcube_sweep(table)
        sweep["radial_wind_speed_status"][5] = 0
        sweep.to_netcdf(tmp_path / "status.nc")
        records = make_records(read(tmp_path / "status.nc", SIX), SIX)
        assert int(records["count"].sum()) == 2 * len(table.seconds) - 2

    def test_options_count(self, tmp_path, table):
        sweep = windcube_sweep(table).rename(radial_wind_speed="rws", range="slant_range")
        sweep["rws"][3] = -9999.0
        sweep.to_netcdf(tmp_path / "noon.nc")
        back = read(
            tmp_path / "noon.nc",
            SIX,
            file_format="windcube",
            columns={"radial_velocity": "rws", "distance": "slant_range"},
            positive="towards",
            invalid=-9999,
        )
        plain = windcube_sweep(table)
        plain.to_netcdf(tmp_path / "plain.nc")
        other = read(tmp_path / "plain.nc", SIX)
        known = ~np.isnan(back["radial_velocity"].values)
        assert int((~known).sum()) == 2
        np.testing.assert_array_equal(-back["radial_velocity"].values[known], other["radial_velocity"].values[known])
        assert json.loads(back.attrs["read_report"])["rows_invalid_value"] == 1


class TestTimes:
    def read(self, folder, table, change):
        sweep = windcube_sweep(table.take(slice(0, 12)))
        sweep = change(sweep)
        sweep.to_netcdf(folder / "noon.nc", engine="h5netcdf")
        return windcube_rays(folder / "noon.nc", resolve_format(FileOptions(), SIX)).time

    def test_missing_ones_are_none(self, tmp_path, table):
        def change(sweep):
            return sweep.assign_coords(time=sweep["time"].where(np.arange(12) != 2))

        assert np.flatnonzero(np.isnat(self.read(tmp_path, table, change))).tolist() == [2]

    @pytest.mark.parametrize(
        "units", ["", "fortnights since 2000-01-01", "seconds since noon", "seconds since 2000-13-01"]
    )
    def test_units_that_say_no_date_are_refused(self, tmp_path, table, units):
        with pytest.raises(InputError, match=r"'time' of file .*noon\.nc.* cannot be read as times in"):
            self.read(tmp_path, table, lambda sweep: sweep.assign_coords(time=sweep["time"].assign_attrs(units=units)))

    def test_other_calendars_are_refused(self, tmp_path, table):
        with pytest.raises(InputError, match="cannot be read as times"):
            self.read(tmp_path, table, lambda s: s.assign_coords(time=s["time"].assign_attrs(calendar="360_day")))


def refused(folder, sweep, match):
    check_refused(folder, sweep, "windcube", match)


class TestBadFiles:
    @pytest.mark.parametrize("name", ["time", "azimuth", "elevation", "range"])
    def test_missing_variables(self, tmp_path, table, name):
        sweep = windcube_sweep(table).drop_vars(name)
        ours = {"range": "distance"}.get(name, name)
        refused(tmp_path, sweep, rf"no variable '{name}' for the {ours} of its rays.*columns=\{{'{ours}'")

    def test_no_velocity(self, tmp_path, table):
        refused(tmp_path, windcube_sweep(table).drop_vars("radial_wind_speed"), "no variable 'radial_wind_speed', in")
        write_windcube(tmp_path / "empty.nc")
        with pytest.raises(InputError, match="broken off"):
            read(tmp_path / "empty.nc", SIX)

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            (lambda s: s.assign(azimuth=("time", ["north"] * s.sizes["time"])), "'azimuth' .* must hold numbers"),
            (
                lambda s: s.assign(azimuth=("gate_index", [1.0] * 4)),
                r"'azimuth' .* has the dimensions \('gate_index',\)",
            ),
            (
                lambda s: s.assign(time=("t", [1.0], {"units": "seconds since 2000-01-01"})),
                "must have those of the time",
            ),
            (lambda s: s.expand_dims(pass_number=2), "at most one more, the gates"),
            (lambda s: s.assign(elevation=s["elevation"] - 9999.0), r"Invalid elevation -99\d\d.* in ray 1 of file"),
            (
                lambda s: s.assign(range=s["range"].assign_attrs(units="1")),
                "'range' .* has the units '1': a distance must",
            ),
            (
                lambda s: s.assign(azimuth=s["azimuth"].assign_attrs(units="m")),
                "'azimuth' .* has the units 'm': an angle must be in degrees or radians; correct the attribute",
            ),
            (
                lambda s: s.assign(radial_wind_speed=s["radial_wind_speed"].assign_attrs(units="deg")),
                "'radial_wind_speed' .* has the units 'deg': a velocity must be in m/s, km/h, knot, cm/s or mm/s",
            ),
            (lambda s: s.assign(elevation=s["elevation"] - 36.0), "No ray of file .* looks within 1 degrees of a beam"),
            (lambda s: s.assign(range=s["range"] * np.nan), "No gate of file"),
            (lambda s: s.assign(range=-s["range"]), "No gate of file"),
            (lambda s: s.isel(time=slice(0, 0)), "has no sample"),
        ],
    )
    def test_variables_that_cannot_be_used(self, tmp_path, table, change, match):
        with np.errstate(all="ignore"):
            refused(tmp_path, change(windcube_sweep(table.take(slice(0, 12)))), match)

    def test_angles_marked_as_invalid_are_left_out(self, tmp_path, table):
        sweep = windcube_sweep(table.take(slice(0, 12)))
        sweep["elevation"].values[4] = -9999.0
        sweep.to_netcdf(tmp_path / "noon.nc")
        back = read(tmp_path / "noon.nc", SIX, invalid=-9999)
        assert back.sizes["sample"] == 22
        assert json.loads(back.attrs["read_report"])["rows_without_beam"] == 1

    @pytest.mark.parametrize("layout", ["flat", "groups"])
    def test_files_that_are_cut_off(self, tmp_path, table, layout):
        file = write(tmp_path, table.take(slice(0, 12)), layout)[0]
        check_cut_off(file, read_windcube, recognises_windcube, 25)

    def test_broken_dimensions(self, tmp_path, table):
        """The netCDF-C library dies of this one, so files of rays never go through it."""
        file = write(tmp_path, table.take(slice(0, 12)), "flat")[0]
        with h5py.File(file, "a") as written:
            written["azimuth"].attrs["DIMENSION_LIST"] = "x"
        assert not recognises_windcube(file)
        with pytest.raises(InputError, match=r"noon\.nc.* cannot be read as NetCDF"):
            read_windcube(file, SIX, resolve_format(FileOptions(), SIX))

    def test_a_text_file_is_not_a_windcube_s(self, tmp_path):
        (tmp_path / "noon.nc").write_text("azimuth,elevation\n", encoding="utf-8")
        assert not recognises_windcube(tmp_path / "noon.nc")

    def test_our_own_files_are_not_a_windcube_s(self, tmp_path, series):
        series.to_netcdf(tmp_path / "own.nc")
        assert not recognises_windcube(tmp_path / "own.nc")


OWN_CHANGES = {
    **CHANGES,
    "infinite": lambda sweep, name: sweep.assign({name: sweep[name].astype(float) * np.inf}),
    "flags": lambda sweep, name: sweep.assign({name: sweep[name].astype(bool)}),
    "first_ray": lambda sweep, name: sweep.assign({name: sweep[name].isel(time=0, drop=True, missing_dims="ignore")}),
}
ATTRIBUTES = {
    "units": ["\u00b0?", 7, [1.0, 2.0], ""],
    "calendar": ["maya", 7],
    "missing_value": ["x", np.nan, [1.0, 2.0]],
    "scale_factor": ["x", np.nan, 0.0],
    "add_offset": ["x", np.inf],
    "_FillValue": ["x"],
}
VARIABLES = ("radial_wind_speed", "cnr", "radial_wind_speed_status", "range", "azimuth", "elevation", "time")


class TestMutations:
    @settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        st.lists(st.tuples(st.sampled_from(sorted(OWN_CHANGES)), st.sampled_from(VARIABLES)), max_size=2),
        st.lists(
            st.tuples(
                st.sampled_from([(key, value) for key, values in ATTRIBUTES.items() for value in values]),
                st.sampled_from(VARIABLES),
            ),
            max_size=1,
        ),
    )
    def test_a_changed_file_is_read_or_refused_with_its_name(self, tmp_path, short, changes, attributes):
        check_changed(
            tmp_path, short, "windcube", [(OWN_CHANGES[change], name) for change, name in changes], attributes
        )


class TestMeasured:
    def test_the_six_beam_hour(self, six_beam_hour):
        """Counts of rays as a person counts them in the file: 715, in six directions."""
        back = read(six_beam_hour, SIX)
        assert back.sizes["sample"] == 2 * 715
        counts = np.unique(back["beam"].values, return_counts=True)[1]
        assert counts.reshape(2, 6).tolist() == [[119, 119, 119, 120, 119, 119]] * 2
        raw = xr.open_dataset(six_beam_hour)
        first = raw.isel(time=0)
        sample = back.sel(sample=0)
        assert float(first["azimuth"]) == pytest.approx(215.999, abs=1e-3)
        assert int(sample["beam"]) == 3
        assert float(first["range"][0]) == pytest.approx(104.0)
        assert float(sample["radial_velocity"]) == float(first["radial_wind_speed"][0])
        raw.close()
