"""A glance at a NetCDF file: by one request, and what the library gives that takes all of it."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import xarray as xr
from ray_checks import FLOW, SIX
from ray_files import cfradial, rays_of, windcube_sweep, write_cfradial2, write_windcube

from bayes_rs.readers import find_scan, netcdf_file, netcdf_guard, read
from bayes_rs.readers.netcdf_file import glance
from bayes_rs.records.making import make_records
from bayes_rs.simulation.virtual import simulate


@pytest.fixture(scope="module")
def table():
    return rays_of(simulate(SIX, FLOW, wind_speed=8.0, n_records=1, seed=4), SIX).take(slice(0, 24))


@pytest.fixture
def requests(monkeypatch):
    """What the other process is asked for, from now on."""
    asked: list[str] = []
    real = netcdf_guard._guard.ask

    def ask(file, request):
        asked.append(request["do"])
        return real(file, request)

    monkeypatch.setattr(netcdf_guard._guard, "ask", ask)
    return asked


def other_way(file, monkeypatch):
    """The same groups by looking at all of the file and reading its variables one by one."""
    with monkeypatch.context() as patch:
        real = netcdf_file.ask
        patch.setattr(
            netcdf_file,
            "ask",
            lambda file, do, **what: ({"unusual": True}, b"") if do == "glance" else real(file, do, **what),
        )
        netcdf_file._last.kept = None
        found = glance(file)
    netcdf_file._last.kept = None
    return found


def everything(table) -> xr.Dataset:
    """Variables in use of all types, packed and not, with and without values that are missing."""
    sweep = windcube_sweep(table, epoch="time_reference", accumulation=2.0)
    velocity = table.velocity.copy()
    velocity[2, 1] = np.nan
    return sweep.assign(
        radial_wind_speed=(("time", "gate_index"), velocity, {"units": "m s-1", "valid_min": -30.0}),
        measurement_height=(("time", "gate_index"), np.round(table.distance).astype(np.int32), {"units": "m"}),
        CNR=(("time", "gate_index"), np.arange(velocity.size, dtype=np.int16).reshape(velocity.shape)),
        status=("time", np.arange(24, dtype=np.uint8)),
        intensity=("time", np.arange(24, dtype=">f4")),
    )


ENCODINGS = {
    "plain": {},
    "packed": {"radial_wind_speed": {"dtype": "int16", "scale_factor": np.float32(0.01), "_FillValue": np.int16(-999)}},
    "offset": {"azimuth": {"dtype": "int32", "scale_factor": 0.01, "add_offset": 180.0, "_FillValue": np.int32(-1)}},
    "fills": {"measurement_height": {"_FillValue": np.int32(100)}, "CNR": {"_FillValue": np.int16(7)}},
    "two fills": {"radial_wind_speed": {"_FillValue": -9.0, "missing_value": -9.0}},
    "chunks": {"radial_wind_speed": {"chunksizes": (5, 2), "zlib": True}},
}


class TestTheSame:
    @pytest.mark.parametrize("encoding", ENCODINGS)
    def test_as_the_library_gives(self, tmp_path, table, monkeypatch, encoding):
        file = tmp_path / "a.nc"
        everything(table).to_netcdf(file, engine="h5netcdf", encoding=ENCODINGS[encoding])
        found, right = glance(file), other_way(file, monkeypatch)
        assert list(found) == list(right)
        assert set(found["/"].names) - {"gate_index"} == set(right["/"].names)
        assert sorted(found["/"].variables) == sorted(right["/"].variables)
        for name, variable in right["/"].variables.items():
            own = found["/"].variables[name]
            assert own.dims == variable.dims
            np.testing.assert_array_equal(own.values, variable.values, err_msg=name)
            for key in ("units", "valid_min", "standard_name", "calendar"):
                assert own.attrs.get(key) == variable.attrs.get(key)
        assert found["/"].sizes == right["/"].sizes

    @pytest.mark.parametrize("write", [write_windcube, write_cfradial2])
    def test_groups(self, tmp_path, table, monkeypatch, write):
        sweep = windcube_sweep(table) if write is write_windcube else cfradial(table)
        file = write(tmp_path / "a.nc", sweep, sweep)
        found, right = glance(file), other_way(file, monkeypatch)
        assert list(found) == list(right)
        for path in right:
            assert set(found[path].names) >= set(right[path].names)
            for name, variable in right[path].variables.items():
                np.testing.assert_array_equal(found[path].variables[name].values, variable.values, err_msg=name)

    @pytest.mark.parametrize("change", ["no scales", "longer dimension", "soft link", "no attribute", "a flag"])
    def test_what_is_unusual(self, tmp_path, table, monkeypatch, requests, change):
        """It is looked at, as all files were."""
        file = tmp_path / "a.nc"
        windcube_sweep(table).to_netcdf(file, engine="h5netcdf", unlimited_dims=["time"])
        with h5py.File(file, "a") as opened:
            if change == "no scales":
                del opened["range"].attrs["DIMENSION_LIST"]
            elif change == "longer dimension":
                opened["time"].resize((30,))
            elif change == "soft link":
                opened["other"] = h5py.SoftLink("/range")
            elif change == "no attribute":
                opened["range"].attrs["units"] = h5py.Empty("S1")
            else:
                del opened["cnr"]
                opened["cnr"] = np.ones((24, 4), dtype=bool)
        found = glance(file)
        assert "look" in requests
        right = other_way(file, monkeypatch)
        for name, variable in right["/"].variables.items():
            np.testing.assert_array_equal(found["/"].variables[name].values, variable.values, err_msg=name)


class TestOnce:
    def test_one_request_a_file(self, tmp_path, table, requests):
        for number in range(4):
            write_windcube(tmp_path / f"{number}.nc", windcube_sweep(table.take(slice(6 * number, 6 * number + 6))))
        netcdf_file._last.kept = None
        scan = find_scan(tmp_path, height=100.0)
        assert requests == ["glance"] * 4
        requests.clear()
        series = read(tmp_path, scan)
        assert requests == ["glance"] * 4
        assert make_records(series, scan).sizes["record"] == 1

    def test_a_file_that_changes_is_read_again(self, tmp_path, table):
        file = tmp_path / "a.nc"
        windcube_sweep(table).to_netcdf(file, engine="h5netcdf")
        first = glance(file)["/"].variables["range"].values
        windcube_sweep(table.take(slice(0, 12))).to_netcdf(file, engine="h5netcdf")
        assert len(first) == 24
        assert len(glance(file)["/"].variables["range"].values) == 12

    def test_values_that_are_not_in_use_are_not_read(self, tmp_path, table):
        """A variable of no use may announce what it likes."""
        file = tmp_path / "a.nc"
        windcube_sweep(table).to_netcdf(file, engine="h5netcdf")
        with h5py.File(file, "a") as opened:
            opened.create_dataset("settings_file", shape=(10**12,), chunks=(1000,), dtype="f8")
        assert "settings_file" in glance(file)["/"].names
        assert read(file, SIX).sizes["sample"] > 0
