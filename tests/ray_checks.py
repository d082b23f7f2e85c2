"""Checks that every reader of NetCDF files of rays passes: the same records back, bad files refused by name."""

from __future__ import annotations

import contextlib
import itertools

import h5py
import numpy as np
import pytest
from ray_files import six_beam

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers import read
from bayes_rs.readers.format import resolve_format
from bayes_rs.records.making import make_records
from bayes_rs.turbulence.mann import MannTurbulence

SIX = six_beam(100.0, 150.0)
FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2)

CHANGES = {
    "drop": lambda rays, name: rays.drop_vars(name),
    "text": lambda rays, name: rays.assign({name: (rays[name].dims, np.full(rays[name].shape, "?"))}),
    "bytes": lambda rays, name: rays.assign({name: (rays[name].dims, np.full(rays[name].shape, b"?"))}),
    "number": lambda rays, name: rays.assign({name: ((), 1.0)}),
    "nan": lambda rays, name: rays.assign({name: rays[name] * np.nan}),
    "huge": lambda rays, name: rays.assign({name: rays[name].astype(float) * 1e300}),
    "other_dim": lambda rays, name: rays.assign({name: ("other", np.arange(5.0))}),
}
"""What can be wrong with a variable: name → changed dataset of (dataset, variable)."""

_NUMBER = itertools.count()


def check_same_records(back, series):
    """Velocities are written and read as doubles; times are doubles of some 1e3 s: 1e-12 s, below 1 ns."""
    records, expected = make_records(back, SIX), make_records(series, SIX)
    for name in ("variance", "mean", "wind_speed", "yaw"):
        np.testing.assert_allclose(records[name], expected[name], rtol=1e-12, atol=1e-13, err_msg=name)
    for name in ("count", "flag", "time", "beam"):
        np.testing.assert_array_equal(records[name], expected[name], err_msg=name)


def check_refused(folder, rays, file_format, match, **options):
    """A bad file gives one line with its name."""
    rays.to_netcdf(folder / "bad.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=match) as caught:
        read(folder / "bad.nc", SIX, file_format=file_format, **options)
    assert "bad.nc" in str(caught.value)
    assert "\n" not in str(caught.value)


def check_cut_off(file, reader, recognises, n):
    """Of `n` beginnings of a file, none is read and none is recognised."""
    whole = file.read_bytes()
    for length in np.linspace(0, len(whole) - 1, n).astype(int):
        file.write_bytes(whole[:length])
        with pytest.raises(InputError, match=file.name.replace(".", r"\.")):
            reader(file, SIX, resolve_format(FileOptions(), SIX))
        assert not recognises(file)


def check_changed(folder, rays, file_format, changes, attributes):
    """A file is read, or refused with its name, after (change, variable) and then (attribute, value), variable."""
    with np.errstate(all="ignore"):
        for change, name in changes:
            if name in rays.variables and rays[name].ndim and rays[name].dtype.kind in "fi":
                with contextlib.suppress(ValueError):  # some are no dataset at all
                    rays = change(rays, name)
    file = folder / f"bad{next(_NUMBER)}.nc"  # a library may hold on to a file that it could not open
    rays.to_netcdf(file, engine="h5netcdf")
    with h5py.File(file, "a") as written:
        for (key, value), name in attributes:
            if name in written:
                written[name].attrs[key] = value
    for kind in (file_format, "auto"):
        try:
            message, back = "", read(file, SIX, file_format=kind)
        except InputError as error:
            message, back = str(error), None
        assert back is None or set(back["beam"].values) <= set(SIX.beam)
        assert back is not None or (file.name in message and "\n" not in message)
