"""A day of a ZX TM at 50 Hz, from CSV to summaries: python benchmarks/zx_day.py FOLDER [--workers 2] [--repeat 3].

The day is simulated and written to FOLDER as one CSV file of 4.3 million rows, unless it is there. Printed are the
seconds of reading, noise and fit, the largest memory of this process and of a worker, and the flags; with --profile,
where the time of reading goes; with --reading, the CPU time from the file to records beside that of Arrow's plain read,
and the memory of it for one day and for two.
"""

import argparse
import cProfile
import os
import pstats
import resource
import shutil
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

import bayes_rs as brs
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.readers.reading import FileOptions
from bayes_rs.records.record_store import store_records
from bayes_rs.records.stream import stream_records

START = np.datetime64("2020-09-04", "ns")
POSITIVE = "away"
"""As simulated, whatever the instrument's own files say."""


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scan", default="zx-tm")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--reading", action="store_true")
    arguments = parser.parse_args()
    scan = brs.load_scan(arguments.scan)
    file = arguments.folder / f"{arguments.scan}-day.csv"
    if not file.exists():
        write_day(file, scan)
    print(f"{file.stat().st_size / 1e6:.0f} MB, load {os.getloadavg()[0]:.1f}", flush=True)
    if arguments.profile:
        profile(file, scan, arguments.folder / "store")
        return
    if arguments.reading:
        reading(file, scan, arguments.repeat)
        return
    for _ in range(arguments.repeat):
        settings = brs.Settings().changed(
            files=[str(file)],
            scan=arguments.scan,
            positive=POSITIVE,
            sampler="auto",
            draws="none",
            output=str(arguments.folder / "out"),
            workers=arguments.workers,
            overwrite=True,
        )
        began = time.perf_counter()
        found = brs.fit_files(settings)
        seconds = time.perf_counter() - began
        people = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        own, worker = (resource.getrusage(who).ru_maxrss / 1024 for who in people)
        flagged = {word: count for word, count in found.flags.items() if count}
        print(
            f"{found.n_fitted} of {found.n_record} records, {seconds:.1f} s {found.run['seconds']}, {own:.0f} and "
            f"{worker:.0f} MB, {flagged}, load {os.getloadavg()[0]:.1f}",
            flush=True,
        )


def write_day(file: Path, scan: brs.Scan, *, hours: int = 24) -> None:
    """Simulate a day, the same two hours of turbulence at another wind speed in turn, and write it as a long table."""
    file.parent.mkdir(parents=True, exist_ok=True)
    flow = brs.load_turbulence("fu-2022")
    series = brs.simulate(scan, flow, wind_speed=10.0, n_records=12, seed=1)
    since = series["time"].values - series["time"].values[0].astype("datetime64[D]")
    part = file.with_suffix(".part")
    with part.open("wb") as sink:
        for turn in range(hours // 2):
            columns = {
                "time": START + turn * np.timedelta64(2, "h") + since,
                "beam": series["beam"].values,
                "radial_velocity": np.round((0.8 + 0.05 * turn) * series["radial_velocity"].values, 4),
            }
            pyarrow.csv.write_csv(pa.table(columns), sink, pyarrow.csv.WriteOptions(include_header=turn == 0))
    part.replace(file)


def reading(file: Path, scan: brs.Scan, repeat: int) -> None:
    """Print the CPU time of reading and making records, in multiples of that of Arrow's read, and the memory of it."""
    two, few = file.with_name(f"two-{file.name}"), file.with_name(f"few-{file.name}")
    with file.open(encoding="utf-8") as source, few.open("w", encoding="utf-8") as sink:
        sink.writelines(islice(source, 100_000))
    records_cpu(few, scan)  # what is loaded at the first use is not the file's
    for one in (file, two):
        if one is two:
            add_next_day(file, two)
        seconds = records_cpu(one, scan)
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{one.stat().st_size / 1e6:.0f} MB: {seconds:.2f} s of CPU, at most {most:.0f} MB", flush=True)
    two.unlink()
    few.unlink()
    for _ in range(repeat):
        arrow = min(cpu_of(lambda: pyarrow.csv.read_csv(file)) for _ in range(3))
        ours = records_cpu(file, scan)
        load = os.getloadavg()[0]
        print(
            f"Arrow {arrow:.2f} s, records {ours:.2f} s of CPU: {ours / arrow:.1f} times, load {load:.1f}", flush=True
        )


def add_next_day(file: Path, two: Path) -> None:
    """Write a file that holds the day and the next."""
    shutil.copy(file, two)
    day, after = (
        str(np.datetime_as_string(time, unit="D")).encode() for time in (START, START + np.timedelta64(1, "D"))
    )
    with file.open("rb") as source, two.open("ab") as sink:
        next(source)
        while block := source.readlines(1 << 24):
            sink.write(b"".join(block).replace(day, after))


def records_cpu(file: Path, scan: brs.Scan) -> float:
    """Return the CPU seconds from a file to records, as a stream."""
    return cpu_of(lambda: stream_records(brs.readers.stream(file, scan, positive=POSITIVE), scan))


def cpu_of(job: Callable[[], object]) -> float:
    """Return the CPU seconds of a job, those of its threads and children with it."""

    def spent() -> float:
        return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))

    before = spent()
    job()
    return spent() - before


def profile(file: Path, scan: brs.Scan, store: Path) -> None:
    """Print where the time of reading and making records goes."""
    shutil.rmtree(store, ignore_errors=True)
    profiler = cProfile.Profile()
    with begin_result_folder(store, key="profile", key_parts={}) as folder:
        profiler.runcall(store_records, [file], scan, folder, reading=FileOptions(positive=POSITIVE))
    pstats.Stats(profiler).sort_stats("tottime").print_stats(25)


if __name__ == "__main__":
    main()
