"""Many short WindCube files, from NetCDF to records: python benchmarks/windcube_files.py FOLDER [--files 4320].

A day of DBS cycles is written to FOLDER, a file of five rays and 159 gates each, with all the variables that the
instrument writes, unless files are there. Printed is what a file costs, in CPU of this process and of the one that
reads NetCDF, as a multiple of h5py reading the variables in use; what a year of such files (1.5 million) would take;
and seconds of the clock, by the number of workers.
"""

import argparse
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

import bayes_rs as brs
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers import netcdf_guard
from bayes_rs.records.record_store import store_records

CYCLE = 20.0
DAY, YEAR = 4320, 1_500_000
IN_USE = (
    "radial_wind_speed", "radial_wind_speed_status", "cnr", "range", "time", "azimuth", "elevation",
    "ray_accumulation_time",
)  # fmt: skip
NOT_IN_USE = (
    "doppler_spectrum_mean_error", "doppler_spectrum_width", "horizontal_wind_speed", "radial_wind_speed_ci",
    "relative_beta", "vertical_wind_speed", "wind_direction", "wind_speed_ci", "wind_speed_status",
)  # fmt: skip
HEIGHT = 500.0


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--files", type=int, default=DAY)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    files = sorted(arguments.folder.glob("*.nc")) or write_files(arguments.folder, arguments.files)
    files = files[: arguments.files]
    print(
        f"{len(files)} files, {sum(file.stat().st_size for file in files) / 1e6:.0f} MB, load {os.getloadavg()[0]:.1f}"
    )
    scan = brs.find_scan(files[:20], height=HEIGHT)
    plain(files)  # once, so that all of them come from memory
    base, _ = measured(lambda: plain(files))
    base /= len(files)
    print(f"h5py, the variables in use: {1e3 * base:.2f} ms a file")
    for name, job in (
        ("find_scan", lambda: brs.find_scan(files, height=HEIGHT)),
        ("read", lambda: brs.read(files, scan)),
        ("to records in a folder", lambda: records(files, scan, 1)),
    ):
        cpu, clock = measured(job)
        each = cpu / len(files)
        print(
            f"{name}: {1e3 * each:.2f} ms of CPU a file, {each / base:.1f} times h5py; {clock:.1f} s of the clock; "
            f"a year {YEAR * each / 3600.0:.1f} h of CPU",
            flush=True,
        )
    for workers in (1, 2):
        began = time.perf_counter()
        records(files, scan, workers)
        clock, memory = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"to records in a folder, {workers} workers: {clock:.1f} s, at most {memory:.0f} MB", flush=True)


def measured(job: Callable[[], object]) -> tuple[float, float]:
    """Return seconds of CPU, also of the process that reads NetCDF, and of the clock."""
    netcdf_guard._guard.end()  # what it has used counts when it has ended
    before, began = sum(os.times()[:4]), time.perf_counter()
    job()
    clock = time.perf_counter() - began
    netcdf_guard._guard.end()
    return sum(os.times()[:4]) - before, clock


def plain(files: list[Path]) -> None:
    """Read the variables in use, and nothing else."""
    for file in files:
        with h5py.File(file, "r") as opened:
            sweep = next(opened[name] for name in opened if name.startswith("Sweep"))
            for name in IN_USE:
                sweep[name][()]


def records(files: list[Path], scan: Scan, workers: int) -> None:
    """Make records in a folder of results, as a fit does first."""
    with (
        tempfile.TemporaryDirectory() as place,
        begin_result_folder(Path(place) / "out", key="benchmark", key_parts={}) as folder,
    ):
        store_records(list(files), scan, folder, workers=workers, progress=False)


def write_files(folder: Path, n_file: int) -> list[Path]:
    """Write files that differ in their times and velocities."""
    rng = np.random.default_rng(1)
    height = np.arange(200.0, 8101.0, 50.0)
    elevation = np.array([75.0, 90.0, 75.0, 75.0, 75.0])
    dims, shape = ("time", "gate_index"), (5, len(height))
    distance = np.trunc(height / np.sin(np.deg2rad(elevation))[:, np.newaxis]).astype(np.int32)
    variables = {name: (dims, rng.normal(size=shape), {"units": "1", "comments": name}) for name in NOT_IN_USE}
    variables |= {
        "radial_wind_speed": (dims, rng.normal(size=shape), {"units": "m s-1"}),
        "radial_wind_speed_status": (dims, np.ones(shape, dtype=np.uint8), {"flag_values": "0b,1b"}),
        "cnr": (dims, np.full(shape, -12.5), {"units": "dB"}),
        "range": (dims, distance, {"units": "m"}),
        "measurement_height": (dims, np.tile(height, (5, 1)).astype(np.int32), {"units": "m"}),
        "azimuth": ("time", np.array([0.0, 0.0, 180.0, 270.0, 90.0]), {"units": "degrees"}),
        "elevation": ("time", elevation, {"units": "degrees"}),
        "ray_accumulation_time": ((), np.int32(2000), {"units": "ms"}),
        "time_reference": ((), "1970-01-01T00:00:00Z"),
        "sweep_index": ((), np.int32(0)),
        "settings_file": ("settings_file_dim", np.full(9376, b"x")),
    }
    units = {"units": "seconds since time_reference", "calendar": "gregorian"}
    start = 1625144608.0 + 4.0 * np.arange(5.0)
    sweep = xr.Dataset(variables, coords={"time": ("time", start, units)})
    root = xr.Dataset(
        {"sweep_group_name": ("sweep", np.array(["Sweep_1"], dtype=object)), "sweep_fixed_angle": ("sweep", [75.0])},
        attrs={"Conventions": "CF/Radial 2.0 , CF-1.7"},
    )
    first = folder / "dbs_0000000.nc"
    root.to_netcdf(first, engine="h5netcdf")
    sweep.to_netcdf(first, group="Sweep_1", mode="a", engine="h5netcdf")
    files = [first]
    for number in range(1, n_file):
        files.append(Path(shutil.copyfile(first, folder / f"dbs_{number:07d}.nc")))
        with h5py.File(files[-1], "a") as opened:
            opened["Sweep_1/time"][...] = start + CYCLE * number
            opened["Sweep_1/radial_wind_speed"][...] = rng.normal(size=shape)
    return files


if __name__ == "__main__":
    main()
