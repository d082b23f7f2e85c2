"""Hostile NetCDF: sizes that fill the memory, types that are none of ours, names that are paths."""

import time
import tracemalloc

import h5py
import numpy as np
import pytest
import xarray as xr
from scenes import plain_noise, records_of

from bayes_rs import InputError, fit, load_scan, open_fit, read
from bayes_rs.noise.file import load_noise
from bayes_rs.records.record_files import open_records
from bayes_rs.result_folder import seal_folder

SCAN = load_scan("2-beam")
LOADERS = [load_noise, lambda file: read(file, SCAN)]


def huge(file):
    with h5py.File(file, "w") as opened:
        opened.create_dataset("radial_velocity", shape=(10**12,), dtype="f8", chunks=(1024,))


def objects(file):
    with h5py.File(file, "w") as opened:
        opened.create_dataset("radial_velocity", (3,), dtype=h5py.vlen_dtype(np.float64))
        opened.create_dataset("time", (3,), dtype=h5py.ref_dtype)


def paths(file):
    with h5py.File(file, "w") as opened:
        opened["../../evil"] = np.zeros(3)
        opened["a/b/c/d"] = np.zeros(3)


def outside(file):
    """A link that would read another file."""
    with h5py.File(file.with_name("secret.h5"), "w") as opened:
        opened["x"] = np.zeros(3)
    with h5py.File(file, "w") as opened:
        opened["radial_velocity"] = h5py.ExternalLink("secret.h5", "/x")


def around(file):
    with h5py.File(file, "w") as opened:
        opened["group/again"] = h5py.SoftLink("/group")
        opened["group/same"] = opened["group"]


@pytest.mark.parametrize("write", [huge, objects, paths, outside, around])
@pytest.mark.parametrize("load", LOADERS)
def test_refused_at_once(tmp_path, write, load):
    file = tmp_path / "x.nc"
    write(file)
    tracemalloc.start()
    began = time.process_time()
    try:
        with pytest.raises(InputError, match=r"x\.nc"):
            load(file)
        assert tracemalloc.get_traced_memory()[1] < 200e6
    finally:
        tracemalloc.stop()
    assert time.process_time() - began < 20.0
    assert sorted(path.name for path in tmp_path.iterdir()) in (["x.nc"], ["secret.h5", "x.nc"])


@pytest.mark.parametrize("write", [huge, objects, around])
def test_records_and_fits(tmp_path, write):
    write(tmp_path / "records.nc")
    assert open_records(tmp_path / "records.nc", SCAN) is None
    scan = load_scan("staring")
    place = tmp_path / "out"
    fit(records_of(np.ones((1, 1)), scan), scan, output=place, seed=1, noise=plain_noise(scan), target_ess=50)
    (place / "records.nc").unlink()
    write(place / "records.nc")
    seal_folder(place)  # as if our own run had written it
    with pytest.raises(InputError, match=r"records\.nc"):
        _ = open_fit(place).records


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("format_version", np.array([1, 1])),
        ("format_version", "one"),
        ("kind", np.arange(3)),
        ("dissipation", "much"),
        ("dissipation", np.array([0.05, 0.06])),
        ("dissipation", np.inf),
        ("details", "[" * 100_000),
        ("details", 5),
        ("details", "[]"),
        ("scan_duration", np.nan),
        ("duration", -1.0),
    ],
)
def test_attributes_of_noise_of_another_type(tmp_path, name, value):
    dataset = plain_noise(SCAN).to_dataset().assign_attrs({name: value})
    dataset.to_netcdf(tmp_path / "noise.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=r"noise\.nc"):
        load_noise(tmp_path / "noise.nc")


@pytest.mark.parametrize("name", ["bias", "gain", "covariance", "direction", "method", "details"])
@pytest.mark.parametrize("change", [lambda v: v.isel({v.dims[-1]: []}), lambda v: 0 * v.size])
def test_variables_of_noise_of_another_type(tmp_path, name, change):
    whole = plain_noise(SCAN).to_dataset()
    if name not in whole.variables or not whole[name].dims:
        whole = whole.expand_dims("state")
    changed = change(whole[name])
    dataset = whole.drop_vars(name)
    dataset[name] = (
        changed if not isinstance(changed, xr.DataArray) else (tuple(f"{d}_" for d in changed.dims), changed.values)
    )
    dataset.to_netcdf(tmp_path / "noise.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=r"noise\.nc"):
        load_noise(tmp_path / "noise.nc")
