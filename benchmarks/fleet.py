"""A fleet through the command, from records to tables: python benchmarks/fleet.py [--records 10000 --records 100000].

Made are the files of a hundred turbines, one of records each, which all have the same starts (or with --ranges 10 one
file of records at ten heights); their variances are drawn from the shipped noise of the scan, as in `year.py`. They are
fitted by ``bayes-rs fit turbine-*.nc``, with `--workers` or on a Dask cluster of as many workers. Printed are seconds,
CPU of the parent and of the workers, the largest memory of both (sampled each second), files and bytes; then CPU,
memory and bytes of opening the fit, of a selection of its summary, and of the report.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import psutil
import xarray as xr
from year import make_year, shipped_noise

import bayes_rs as brs
from bayes_rs.records.layout import with_turbine

N_TURBINE = 100
AFTER = """
import resource, sys, time
import bayes_rs as brs
from bayes_rs.report.writing import write_report
def told(what, began):
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"  {what}: {time.process_time() - began:.1f} s of CPU, largest memory so far {memory:.0f} MB", flush=True)
began = time.process_time()
fit = brs.open_fit(sys.argv[1])
print(f"  {fit!r}")
told("open_fit", began)
if hasattr(fit, "at"):
    fit = fit.at(fit.ranges[0])
began = time.process_time()
hour = fit.summary(records=slice("2020-01-01T01:00", "2020-01-01T02:00"), columns=["record", "stress", "median"])
told(f"summary of an hour, {len(hour)} rows", began)
began = time.process_time()
page = write_report(sys.argv[1], overwrite=True)
told(f"report of {page.stat().st_size / 1e6:.1f} MB", began)
"""


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, action="append")
    parser.add_argument("--ranges", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--dask", action="store_true")
    parser.add_argument("--keep", type=Path, help="Folder for the files and results, which stay.")
    parser.add_argument("options", nargs="*", help="Options of bayes-rs fit, after --.")
    arguments = parser.parse_args()
    for count in arguments.records or [10_000, 100_000]:
        with ExitStack() as stack:
            place = arguments.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
            place.mkdir(parents=True, exist_ok=True)
            files = write_ranges(place, count, arguments.ranges) if arguments.ranges else write_fleet(place, count)
            crew = ["--workers", str(arguments.workers)]
            if arguments.dask:
                crew = ["--scheduler", stack.enter_context(cluster(arguments.workers))]
            told = fit(files, place / "fleet", [*crew, *arguments.options])
            print(f"{count} records, {' '.join(crew[::2])} {arguments.workers}: {told}", flush=True)
            subprocess.run(  # noqa: S603 - as below
                [sys.executable, "-c", AFTER, str(place / "fleet")], check=True
            )


def write_fleet(place: Path, count: int) -> list[str]:
    """Write the records of a hundred turbines, each into a file of its own."""
    scan = brs.load_scan("6-beam")
    noise = shipped_noise(scan)
    if noise is None:
        raise SystemExit("No noise is shipped for the scan.")
    each = count // N_TURBINE
    year, files = make_year(scan, noise, each * N_TURBINE), []
    start = year["time"].values[:each]
    for number in range(N_TURBINE):
        own = year.isel(record=slice(number * each, (number + 1) * each)).assign_coords(time=("record", start))
        files.append(str(place / f"turbine-{number + 1:03d}.nc"))
        with_turbine(own, f"T{number + 1:03d}").to_netcdf(files[-1], engine="h5netcdf")
    return files


def write_ranges(place: Path, count: int, n_range: int) -> list[str]:
    """Write records at several ranges into a file."""
    scan = brs.load_scan("6-beam")
    noise = shipped_noise(scan)
    if noise is None:
        raise SystemExit("No noise is shipped for the scan.")
    each = count // n_range
    year = make_year(scan, noise, each * n_range)
    parts = [
        year.isel(record=slice(place * each, (place + 1) * each)).assign_coords(time=year["time"][:each])
        for place in range(n_range)
    ]
    distance = np.linspace(40.0, 220.0, n_range)
    records = xr.concat(parts, dim=xr.DataArray(distance, dims="range", attrs={"units": "m"}, name="range"))
    each_beam = np.repeat(distance[:, None], scan.n_beam, axis=1)
    records = records.assign_coords(focus_distance=(("range", "beam"), each_beam, {"units": "m"}))
    file = str(place / "ranges.nc")
    records.to_netcdf(file, engine="h5netcdf")
    return [file]


def cluster(n_worker: int):
    """Start a scheduler and workers on this machine; gives the scheduler's address."""
    from contextlib import contextmanager  # noqa: PLC0415

    import distributed  # noqa: PLC0415

    @contextmanager
    def started():
        options = {"processes": True, "n_workers": n_worker, "threads_per_worker": 1, "dashboard_address": None}
        with distributed.LocalCluster(**options) as made:
            yield made.scheduler_address

    return started()


def fit(files: list[str], output: Path, options: list[str]) -> str:
    """Run the command, and say what it took."""
    words = ["fit", *files, "--scan", "6-beam", "--sampler", "direct", "--seed", "1", "-o", str(output), *options]
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = "from bayes_rs.cli import main; main()"
    run = subprocess.Popen(  # noqa: S603 - our own command
        [sys.executable, "-c", command, *words], env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    )
    most, own, watching = [0.0, 0.0], [0.0], threading.Event()
    watch = threading.Thread(target=_watch, args=(run.pid, most, own, watching))
    watch.start()
    code = run.wait()
    watching.set()
    watch.join()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    written = [file for file in output.rglob("*") if file.is_file()]
    size = sum(file.stat().st_size for file in written) / 1e6
    return (
        f"exit {code}, {time.perf_counter() - began:.0f} s, CPU {own[0]:.0f} s of the parent and {cpu - own[0]:.0f} s "
        f"of others, memory {most[0]:.0f} MB and {most[1]:.0f} MB a worker, {len(written)} files of {size:.0f} MB"
    )


def _watch(parent: int, most: list[float], own: list[float], end: threading.Event) -> None:
    """Note the largest memory of the parent and of its children, and the parent's CPU."""
    process = psutil.Process(parent)
    while not end.wait(1.0):
        try:
            most[0] = max(most[0], process.memory_info().rss / 1e6)
            times = process.cpu_times()
            own[0] = times.user + times.system
            for child in process.children(recursive=True):
                most[1] = max(most[1], child.memory_info().rss / 1e6)
        except psutil.Error:
            continue


if __name__ == "__main__":
    main()
