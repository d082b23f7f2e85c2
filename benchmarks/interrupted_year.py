"""A year of records whose fit is interrupted: python benchmarks/interrupted_year.py FOLDER [--records 52560].

The records are those of benchmarks/year.py. One run goes through. Another has a worker killed and is killed itself, has
a worker killed and is interrupted, and is resumed each time. Printed are the seconds of each, and whether the tables
are the same, bit by bit.
"""

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from year import make_year, shipped_noise

import bayes_rs as brs


def main() -> None:
    """Measure, or be the run that is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--records", type=int, default=52_560)
    parser.add_argument("--run", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.run:
        fit(arguments.folder / arguments.run, arguments.records)
        return
    began = time.perf_counter()
    run(arguments, "whole")
    whole = time.perf_counter() - began
    print(f"{arguments.records} records, whole: {whole:.1f} s, load {os.getloadavg()[0]:.1f}", flush=True)
    n_part = len(part_files(arguments.folder / "whole", "summary"))
    for share, what in ((0.25, "kill"), (0.6, "interrupt")):
        began = time.perf_counter()
        stop_at(arguments, int(share * n_part), what)
        done = len(part_files(arguments.folder / "cut", "posterior"))
        print(f"{what} after {time.perf_counter() - began:.1f} s: {done} of {n_part} parts kept", flush=True)
    began = time.perf_counter()
    run(arguments, "cut")
    print(f"resumed to the end: {time.perf_counter() - began:.1f} s", flush=True)
    for name in ("summary", "posterior"):
        one, other = (part_files(arguments.folder / which, name) for which in ("whole", "cut"))
        same = [file.read_bytes() for file in one] == [file.read_bytes() for file in other]
        print(f"{name}: {'the same' if same else 'DIFFERENT'} in {len(one)} and {len(other)} files")


def fit(output: Path, n_record: int) -> None:
    """Fit the year with two workers, or what is left of it."""
    scan = brs.load_scan("6-beam")
    noise = shipped_noise(scan)
    if noise is None:
        sys.exit("No noise is shipped for the scan.")
    records = make_year(scan, noise, n_record)
    brs.fit(records, scan, seed=1, noise=noise, output=output, workers=2, sampler="auto", resume=True)


def part_files(folder: Path, dataset: str) -> list[Path]:
    """Return the files of a table in a folder of results, in the order of the records."""
    return sorted((folder / dataset).rglob("part-*.parquet"), key=lambda file: (file.name, file.parent.name))


def command(arguments: argparse.Namespace, name: str) -> list[str]:
    """Return the command of a run."""
    folder = str(arguments.folder)
    return [sys.executable, __file__, folder, "--records", str(arguments.records), "--run", name]


def run(arguments: argparse.Namespace, name: str) -> None:
    """Run to the end."""
    subprocess.run(command(arguments, name), check=True)  # noqa: S603 - this script


def stop_at(arguments: argparse.Namespace, n_part: int, what: str) -> None:
    """Start a run, kill one of its workers at half of so many parts, and stop it at all of them."""
    process = subprocess.Popen(command(arguments, "cut"))  # noqa: S603 - this script
    worker_killed = False
    while process.poll() is None:
        done = len(part_files(arguments.folder / "cut", "summary"))
        workers = children(process.pid)
        if not worker_killed and done >= n_part // 2 and len(workers) > 1:
            os.kill(workers[-1], signal.SIGKILL)
            worker_killed = True
        if done >= n_part:
            process.send_signal(signal.SIGKILL if what == "kill" else signal.SIGINT)
            break
        time.sleep(0.05)
    process.wait()


def children(process: int) -> list[int]:
    """Return the processes that a process started and that have loaded our modules: its workers."""
    found = Path(f"/proc/{process}/task/{process}/children")
    numbers = [int(number) for number in found.read_text(encoding="ascii").split()] if found.exists() else []
    return [number for number in numbers if b"loky" in Path(f"/proc/{number}/cmdline").read_bytes()]


if __name__ == "__main__":
    main()
