"""CfRadial and ARM files: the same records from every layout, and one clear line for every kind of bad file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ray_checks import CHANGES, FLOW, SIX, check_changed, check_cut_off, check_refused, check_same_records
from ray_files import arm, cfradial, rays_of, write_cfradial2

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers import find_scan, read
from bayes_rs.readers.arm import arm_rays, read_arm, recognises_arm
from bayes_rs.readers.cfradial import cfradial_rays, own_options, read_cfradial, recognises_cfradial
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.netcdf_names import AWAY, STANDARD_NAMES, VELOCITIES
from bayes_rs.readers.registry import READERS
from bayes_rs.records.making import make_records
from bayes_rs.simulation.virtual import simulate

TOWARD = "radial_velocity_of_scatterers_toward_instrument"
SINGLE = 2e-6
"""Of the largest velocity: rounding to a single."""


@pytest.fixture(scope="module")
def series():
    return simulate(SIX, FLOW, wind_speed=8.0, n_records=2, seed=6)


@pytest.fixture(scope="module")
def table(series):
    return rays_of(series, SIX)


@pytest.fixture(scope="module")
def short(table):
    return table.take(slice(0, 24))


def check_refused_by(folder, rays, match, kind="cfradial", **options):
    check_refused(folder, rays, kind, match, **options)


class TestRoundTrip:
    @pytest.mark.parametrize("layout", ["root", "groups", "two groups", "classic", "turned", "by azimuth"])
    def test_the_same_records_from_every_layout(self, layout, tmp_path, series, table):
        file = tmp_path / "noon.nc"
        sweep = cfradial(table)
        if layout == "root":
            sweep.to_netcdf(file, engine="h5netcdf")
        elif layout == "turned":
            sweep.transpose().to_netcdf(file, engine="h5netcdf")
        elif layout == "classic":
            sweep.to_netcdf(file, format="NETCDF3_64BIT", engine="scipy")
        elif layout == "by azimuth":  # as xradar writes sweeps
            write_cfradial2(file, sweep.swap_dims(time="azimuth"))
        elif layout == "groups":
            write_cfradial2(file, sweep)
        else:
            half = len(table.seconds) // 2
            write_cfradial2(file, cfradial(table.take(slice(half))), cfradial(table.take(slice(half, None))))
        assert recognises_cfradial(file)
        assert not recognises_arm(file)
        back = read(file, SIX)
        check_same_records(back, series)
        np.testing.assert_array_equal(back["cnr"], -12.5)
        assert json.loads(back.attrs["read_report"])["files"][0]["format"] == "cfradial"
        assert find_scan(file, height=100.0).n_beam == 6

    @pytest.mark.parametrize("name", [*(name for name in VELOCITIES if name != "radial_wind_speed"), "anything"])
    def test_velocities_of_any_name(self, name, tmp_path, short):
        """`radial_wind_speed` is a WindCube's."""
        standard = {"anything": AWAY}.get(name)
        cfradial(short, velocity=name, standard_name=standard).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        cfradial(short).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
        one, other = (read(tmp_path / file, SIX)["radial_velocity"] for file in ("a.nc", "b.nc"))
        np.testing.assert_array_equal(one, other)

    @pytest.mark.parametrize("standard", STANDARD_NAMES)
    def test_the_standard_name_says_the_sign(self, standard, tmp_path, short):
        cfradial(short, standard_name=standard).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        cfradial(short).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
        sign = -1.0 if "toward" in standard else 1.0
        back, plain = (read(tmp_path / file, SIX) for file in ("a.nc", "b.nc"))
        np.testing.assert_array_equal(back["radial_velocity"], sign * plain["radial_velocity"])
        said = read(tmp_path / "a.nc", SIX, positive="towards")
        np.testing.assert_array_equal(said["radial_velocity"], -plain["radial_velocity"])
        assert own_options(tmp_path / "b.nc") is None

    def test_packed_numbers_and_fill_values(self, tmp_path, short):
        velocity = np.round(short.velocity, 2)
        velocity[3:9] = np.nan
        sweep = cfradial(replace(short, velocity=velocity))
        packing = {"dtype": "int16", "scale_factor": np.float32(0.01), "_FillValue": np.int16(-32768)}
        sweep.to_netcdf(tmp_path / "a.nc", engine="h5netcdf", encoding={"VEL": packing})
        rays = cfradial_rays(tmp_path / "a.nc", resolve_format(FileOptions(), None))
        np.testing.assert_allclose(rays.radial_velocity, velocity, atol=1e-5)
        with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as right:
            np.testing.assert_array_equal(rays.radial_velocity, right["VEL"].values.astype(float))


class TestBadFiles:
    def test_several_velocities(self, tmp_path, short):
        sweep = cfradial(short).assign(velocity=cfradial(short)["VEL"] + 1.0)
        check_refused_by(
            tmp_path,
            sweep,
            r"bad\.nc' has 2 radial velocities, 'VEL', 'velocity': say which with columns=\{'radial_velocity': 'VEL'\}",
        )
        chosen = read(tmp_path / "bad.nc", SIX, columns={"radial_velocity": "velocity"})["radial_velocity"]
        other = read(tmp_path / "bad.nc", SIX, columns={"radial_velocity": "VEL"})["radial_velocity"]
        np.testing.assert_allclose(chosen, other + 1.0)

    def test_one_of_them_by_the_standard_name(self, tmp_path, short):
        sweep = cfradial(short, standard_name=AWAY).assign(velocity=cfradial(short)["VEL"] + 1.0)
        sweep.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        cfradial(short).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
        one, other = (read(tmp_path / file, SIX)["radial_velocity"] for file in ("a.nc", "b.nc"))
        np.testing.assert_array_equal(one, other)

    def test_wind_components_are_no_radial_velocity(self, tmp_path, short):
        sweep = cfradial(short, velocity="v").assign(u=cfradial(short)["VEL"])
        check_refused_by(tmp_path, sweep, r"bad\.nc' has no radial velocity, by a standard name or a usual one")
        assert not recognises_cfradial(tmp_path / "bad.nc")

    @pytest.mark.parametrize("name", ["time", "azimuth", "elevation", "range"])
    def test_missing_variables(self, tmp_path, short, name):
        ours = {"range": "distance"}.get(name, name)
        check_refused_by(tmp_path, cfradial(short).drop_vars(name), rf"no variable '{name}' for the {ours} of its rays")

    def test_units_that_are_none(self, tmp_path, short):
        sweep = cfradial(short)
        sweep["VEL"].attrs["units"] = "1"
        check_refused_by(tmp_path, sweep, r"'VEL' in file .* has the units '1': a velocity must be in m/s")

    @pytest.mark.parametrize("kind", ["cfradial", "arm"])
    def test_files_that_are_cut_off(self, tmp_path, short, kind):
        file = tmp_path / "noon.nc"
        if kind == "arm":
            arm(short).to_netcdf(file, format="NETCDF3_64BIT", engine="scipy")
            check_cut_off(file, read_arm, recognises_arm, 12)
        else:
            cfradial(short).to_netcdf(file, engine="h5netcdf")
            check_cut_off(file, read_cfradial, recognises_cfradial, 12)

    @settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        changes=st.lists(
            st.tuples(
                st.sampled_from(list(CHANGES.values())),
                st.sampled_from(["VEL", "SNR", "range", "azimuth", "elevation", "time"]),
            ),
            max_size=2,
        ),
        attributes=st.lists(
            st.tuples(
                st.sampled_from([("units", 7), ("standard_name", 7), ("_FillValue", "x"), ("scale_factor", "x")]),
                st.sampled_from(["VEL", "range", "azimuth"]),
            ),
            max_size=1,
        ),
    )
    def test_changed_files(self, tmp_path, short, changes, attributes):
        check_changed(tmp_path, cfradial(short), "cfradial", changes, attributes)


class TestArm:
    @pytest.mark.parametrize("layout", ["NETCDF3_CLASSIC", "NETCDF4"])
    def test_the_same_records(self, layout, tmp_path, series, table):
        file = tmp_path / "sgpdlppiC1.b1.20191015.120023.cdf"
        engine = "scipy" if layout == "NETCDF3_CLASSIC" else "h5netcdf"
        arm(table).to_netcdf(file, format=layout, engine=engine)
        assert recognises_arm(file)
        back = read(file, SIX)
        np.testing.assert_allclose(back["radial_velocity"], series["radial_velocity"].values, atol=20.0 * SINGLE)
        np.testing.assert_allclose(back["cnr"], -12.5, atol=1e-4)
        np.testing.assert_array_equal(back["time"], series["time"])
        np.testing.assert_array_equal(back["beam"], series["beam"])
        report = json.loads(back.attrs["read_report"])["files"][0]
        assert (report["format"], report["positive"]) == ("arm", "away")
        one, other = make_records(back, SIX), make_records(series, SIX)
        np.testing.assert_allclose(one["variance"], other["variance"], rtol=1e-5)

    def test_velocities_beyond_its_limits_and_no_signal_are_missing(self, tmp_path, short):
        velocity = np.clip(short.velocity, -19.0, 19.0)
        velocity[2, 1], velocity[3, 2] = 25.0, -20.5
        rays = arm(replace(short, velocity=velocity))
        rays["intensity"][5, 0] = 0.9
        rays.to_netcdf(tmp_path / "a.cdf", format="NETCDF3_CLASSIC", engine="scipy")
        found = arm_rays(tmp_path / "a.cdf", resolve_format(FileOptions(), None))
        assert np.argwhere(np.isnan(found.radial_velocity)).tolist() == [[2, 1], [3, 2]]
        assert np.argwhere(np.isnan(found.cnr)).tolist() == [[5, 0]]

    def test_its_source_is_cited(self):
        assert "DOE/SC-ARM-TR-101" in READERS["arm"].source
        assert "NCAR/CfRadial" in READERS["cfradial"].source


def test_no_file_of_another_format_is_taken(tmp_path, series):
    series.to_netcdf(tmp_path / "own.nc", engine="h5netcdf")
    assert not recognises_cfradial(tmp_path / "own.nc")
    assert not recognises_arm(tmp_path / "own.nc")
    (tmp_path / "text.nc").write_text("time,beam\n")
    assert not recognises_cfradial(tmp_path / "text.nc")
    with pytest.raises(InputError, match=r"text\.nc"):
        read_cfradial(tmp_path / "text.nc", SIX, resolve_format(FileOptions(), SIX))
