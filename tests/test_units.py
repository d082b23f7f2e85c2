"""Units that NetCDF files state: what is read is converted exactly, and everything else is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from ray_checks import FLOW, SIX
from ray_files import e_windlidar, rays_of, windcube_sweep

from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_UNITS, FileOptions
from bayes_rs.readers import read
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.units import factor_to_degrees, factor_to_metres, velocity_unit_of
from bayes_rs.readers.windcube import windcube_rays
from bayes_rs.simulation.virtual import simulate

SPELLINGS = {
    "m/s": [
        "m/s", "m s-1", "m s^-1", "m s**-1", "m.s-1", "m*s^-1", "ms-1", "M/S", " m s-1 ", "meters per second", "mps",
        "m sec-1", "metre/second", "m/sec", "meter s-1", "m s(-1)", "m / s",
        "m s\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT ONE}",
    ],
    "cm/s": ["cm/s", "cm s-1", "centimeters per second"],
    "mm/s": ["mm s-1", "mm/s", "millimetres/second"],
    "km/h": ["km/h", "km h-1", "kph", "kilometers per hour"],
    "knot": ["knot", "knots", "kt", "kts", "Knots"],
}  # fmt: skip
NO_VELOCITY = [
    "1",
    "deg",
    "m",
    "s",
    "m s",
    "m/s2",
    "m2 s-2",
    "km/s",
    "m/h",
    "Hz",
    "dB",
    "m s-2",
    "meters",
    "per",
    "/",
    "m/s/s",
    "%",
]


@pytest.fixture(scope="module")
def table():
    return rays_of(simulate(SIX, FLOW, wind_speed=8.0, n_records=1, seed=4), SIX).take(slice(0, 24))


def rays_in(folder, sweep, **options):
    sweep.to_netcdf(folder / "noon.nc", engine="h5netcdf")
    return windcube_rays(folder / "noon.nc", resolve_format(FileOptions(**options), SIX))


class TestVelocity:
    @pytest.mark.parametrize(("unit", "text"), [(unit, text) for unit, texts in SPELLINGS.items() for text in texts])
    def test_every_spelling(self, tmp_path, table, unit, text):
        assert velocity_unit_of(text) == unit
        sweep = windcube_sweep(replace(table, velocity=table.velocity / VELOCITY_UNITS[unit]))
        sweep["radial_wind_speed"].attrs["units"] = text
        rays = rays_in(tmp_path, sweep)
        np.testing.assert_allclose(rays.radial_velocity, table.velocity, rtol=4e-16)
        assert rays.file_format.velocity_unit == unit

    @pytest.mark.parametrize("text", NO_VELOCITY)
    def test_others_are_refused(self, tmp_path, table, text):
        assert velocity_unit_of(text) is None
        sweep = windcube_sweep(table)
        sweep["radial_wind_speed"].attrs["units"] = text
        with pytest.raises(
            InputError, match=r"'radial_wind_speed' in file .*noon.nc' has the units .*: a velocity must"
        ):
            rays_in(tmp_path, sweep)

    def test_what_the_caller_says_counts_first(self, tmp_path, table):
        sweep = windcube_sweep(table)
        for text in ("1", "m/s", "km/h"):
            sweep["radial_wind_speed"].attrs["units"] = text
            rays = rays_in(tmp_path, sweep, velocity_unit="cm/s")
            np.testing.assert_allclose(rays.radial_velocity, 0.01 * table.velocity, rtol=4e-16)

    @pytest.mark.parametrize("units", [None, "", b""])
    def test_none_is_that_of_the_options(self, tmp_path, table, units):
        sweep = windcube_sweep(table)
        sweep["radial_wind_speed"].attrs = {} if units is None else {"units": units}
        np.testing.assert_array_equal(rays_in(tmp_path, sweep).radial_velocity, table.velocity)

    @pytest.mark.parametrize("attributes", [{}, {"positive": "away"}])
    def test_our_own_layout(self, tmp_path, attributes):
        """Before, units counted only beside the attribute `positive`."""
        series = simulate(SIX, FLOW, wind_speed=8.0, n_records=1, seed=4)
        plain = series["radial_velocity"].values
        series["radial_velocity"] = ("sample", 1000.0 * plain, {**attributes, "units": "mm s-1"})
        series.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        np.testing.assert_allclose(read(tmp_path / "a.nc", SIX)["radial_velocity"], plain, rtol=4e-16)
        series["radial_velocity"].attrs["units"] = "1"
        series.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
        with pytest.raises(InputError, match=r"b.nc' has the units '1': a velocity must be in m/s"):
            read(tmp_path / "b.nc", SIX)

    def test_e_windlidar(self, tmp_path, table):
        rays = e_windlidar(replace(table, velocity=100.0 * table.velocity))
        rays["VEL"].attrs["units"] = "cm s-1"
        rays.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        plain = e_windlidar(table)
        plain.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
        one, other = (read(tmp_path / name, SIX)["radial_velocity"] for name in ("a.nc", "b.nc"))
        np.testing.assert_allclose(one, other, rtol=4e-16)


class TestAnglesAndDistances:
    @pytest.mark.parametrize("text", ["rad", "radians", "Radian"])
    def test_radians(self, tmp_path, table, text):
        sweep = windcube_sweep(replace(table, azimuth=np.deg2rad(table.azimuth), elevation=np.deg2rad(table.elevation)))
        for name in ("azimuth", "elevation"):
            sweep[name].attrs["units"] = text
        plain = rays_in(tmp_path, windcube_sweep(table)).direction
        np.testing.assert_allclose(rays_in(tmp_path, sweep).direction, plain, atol=1e-15)

    @pytest.mark.parametrize(("text", "factor"), [("km", 1000.0), ("kilometers", 1000.0), ("cm", 0.01), ("ft", 0.3048)])
    def test_distances(self, tmp_path, table, text, factor):
        sweep = windcube_sweep(replace(table, distance=table.distance / factor))
        sweep["range"].attrs["units"] = text
        np.testing.assert_allclose(rays_in(tmp_path, sweep).distance, table.distance, rtol=4e-16)

    @pytest.mark.parametrize("text", ["degree", "degrees", "deg", "\N{DEGREE SIGN}", "Degrees", "degrees_true", ""])
    def test_degrees(self, tmp_path, text):
        assert factor_to_degrees(text, name="azimuth", file=tmp_path) == 1.0

    @pytest.mark.parametrize("text", ["m", "meters", "metre", ""])
    def test_metres(self, tmp_path, text):
        assert factor_to_metres(text, name="range", file=tmp_path) == 1.0

    @pytest.mark.parametrize("text", ["1", "m/s", "deg", "gate", "miles", "s"])
    def test_others_are_refused(self, tmp_path, text):
        with pytest.raises(
            InputError, match=r"'range' in file .* has the units .*: a distance must be in m, km, cm, mm"
        ):
            factor_to_metres(text, name="range", file=tmp_path)


def test_attributes_of_another_kind(tmp_path):
    """What is no text is no unit."""
    data = xr.Dataset({"a": ((), 1.0, {"units": 7})})
    with pytest.raises(InputError, match="has the units '7'"):
        factor_to_degrees(data["a"].attrs["units"], name="a", file=tmp_path)
