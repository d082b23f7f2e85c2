"""What is tried on options and arguments, and the small scene that it is tried in."""

import importlib
import os
import pkgutil
import tempfile
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from ray_files import RayTable, windcube_sweep

WORDS = (
    "0",
    "-1",
    "1e300",
    "-1e300",
    "1e-300",
    "1e9",
    "1e-9",
    "nan",
    "inf",
    "-inf",
    str(2**70),
    "0.5",
    "1",
    "3",
    "12",
    "",
    " ",
    "abc",
    "%n",
    "%%%",
    "x" * 1000,
    "9" * 400,
    "\u202e☃é",
    "a\nb",
    "a=b",
    "=",
    "é=1e300",
    "1:2",
    "nan:inf",
    "1,5",
    "true",
    "None",
    "../..",
    "/dev/null",
    "6-beam@n_beams=99999999",
    "6-beam@focus_distance=1e300",
    "6-beam@opening_angle_deg=nan",
    "weak:log_sd_vv=1e300",
    "flat:bound=nan",
    "ratio:vv=1e-300",
    "mann:gamma_high=1e9",
    "campaign:",
    "time=0",
    "LOS=1e300",
    "uu=-1",
    "vv=1e300",
)
"""Texts on the command line."""


@lru_cache(maxsize=1)
def scene() -> SimpleNamespace:
    """Return small inputs that every command and call runs on in a moment; they are made once, before any fork."""
    import bayes_rs as brs  # noqa: PLC0415 - loaded once, before the processes are forked

    for module in pkgutil.walk_packages(brs.__path__, "bayes_rs."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    keeper = tempfile.TemporaryDirectory(prefix="fuzz-scene-")
    place = Path(keeper.name)
    os.environ["BAYES_RS_CACHE"] = str(place / "cache")
    scan = brs.load_scan("2-beam")
    series = brs.simulate(scan, "fu-2022", wind_speed=10.0, duration=60.0, n_records=3, seed=1)
    table = series.to_dataframe().reset_index()[["time", "beam", "radial_velocity"]]
    table.to_csv(place / "series.csv", index=False)
    records = brs.make_records(series, scan, duration=60.0)
    noise = brs.noise.calibrate(scan, "fu-2022", wind_speed=10.0, duration=60.0, cache=False)
    noise.save(place / "noise.nc")
    records.to_netcdf(place / "records.nc", engine="h5netcdf")
    azimuth = np.tile([0.0, 90.0, 180.0, 270.0], 3)
    rays = RayTable(np.arange(12.0), azimuth, np.full(12, 75.0), np.full((12, 1), 100.0), np.ones((12, 1)))
    windcube_sweep(rays).to_netcdf(place / "rays.nc", engine="h5netcdf")
    fit = brs.fit(
        records, scan, noise=noise, seed=1, target_ess=50, campaign="off", output=place / "fit", progress=False
    )
    return SimpleNamespace(
        keeper=keeper, place=place, scan=scan, series=series, records=records, noise=noise, fit=fit, brs=brs
    )
