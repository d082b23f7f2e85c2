"""A folder of a few files of radial velocities for tests, and for the processes that tests interrupt and kill."""

import importlib
import os
import signal
import sys
from pathlib import Path

import numpy as np

from bayes_rs import MannTurbulence, Settings, fit_files, load_scan, simulate
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.records import record_store

SCAN_NAME = "2-beam"
SCAN = load_scan(SCAN_NAME)
FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2)
DURATION = 60.0
RECORDING = {"duration": DURATION, "min_availability": 0.5}
FITTING = {"target_ess": 100, "seed": 3, "sampler": "auto"}
LONG = {"draws": "none", "on_bad_file": "skip"}
"""As a user fits a year of files: the tests look at the tables, and at what is said of files that cannot be read."""
N_RECORD = 24


def make_series():
    """Radial velocities of records in a row; two of them are a gap."""
    series = simulate(SCAN, FLOW, wind_speed=10.0, duration=DURATION, n_records=N_RECORD, seed=5)
    second = (series["time"].values - series["time"].values[0]) / np.timedelta64(1, "s")
    return series.isel(sample=np.flatnonzero((second < 500.0) | (second > 700.0)))


def write_files(folder, series, n_file=5):
    """Write the series to files that end anywhere, with names in another order than their times."""
    folder.mkdir(parents=True, exist_ok=True)
    edges = [series.sizes["sample"] * index // n_file + 17 * (0 < index < n_file) for index in range(n_file + 1)]
    for index in range(n_file):
        write_file(folder / f"{9 - index}-day.csv", series.isel(sample=slice(edges[index], edges[index + 1])))


def write_file(file, series):
    series.to_dataframe().reset_index()[["time", "beam", "radial_velocity"]].to_csv(file, index=False)


def write_noise(file):
    calibrate(SCAN, FLOW, wind_speed=10.0, duration=DURATION, cache=False).save(file)


def run(files, output, noise, **options):
    """Fit files into a folder; options are those of settings, by their names."""
    names = [str(name) for name in (files if isinstance(files, list) else [files])]
    given = {"scan": SCAN_NAME, "noise": str(noise), **RECORDING, **FITTING, **LONG, **options}
    more = {"say": given.pop("say")} if "say" in given else {}
    return fit_files(Settings().changed(files=names, output=str(output), **given), **more)


def stop_at_write(number, sent):
    """Send this process a signal in the middle of writing its file of that number."""
    replace = Path.replace
    count = iter(range(1_000_000))

    def replacing(self, target):
        if next(count) == number:
            with self.open("rb+") as file:
                file.truncate(self.stat().st_size // 2)
            signal.raise_signal(sent)  # to this thread, and at once: os.kill may come a moment later
        return replace(self, target)

    Path.replace = replacing


if __name__ == "__main__":
    for name in ("distributed", "h5netcdf", "pyarrow.dataset", "scipy.stats"):  # here, not in each child
        importlib.import_module(name)
    record_store.SAVE_SECONDS = 0.0
    files, noise, *stops = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job would ignore it
    for stop in stops:
        output, number, sent = stop.split(":")
        child = os.fork()  # before any thread is started: the fits run in the children only
        if child == 0:
            stop_at_write(int(number), getattr(signal, sent))
            run(files, output, noise, resume=True)
            os._exit(0)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)  # noqa: T201 - for who started it
