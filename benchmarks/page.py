"""The benchmarks page, made again by one command: python benchmarks/page.py [--runs 3] [--output FILE].

Start-up of the command line; run time against error of the noise and of posteriors; scaling with records, beams and
workers; memory. The page says when, on which machine and with which versions, and of how many runs each number is.
About ten minutes on two quiet cores; the peers are in `posteriors.py --peers`.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
from year import make_year, shipped_noise

import bayes_rs as brs

PACKAGES = ("numpy", "scipy", "xarray", "pandas", "emcee", "arviz")
RECORDS = (328, 1312, 5248)
BEAMS = ("2-beam", "4-beam", "6-beam", "50-beam")
N_FIXED = 1312
"""Records where beams and workers vary."""


def main() -> None:
    """Measure and write, or do one measurement and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "measured.md")
    parser.add_argument("--one", nargs=3, metavar=("SCAN", "RECORDS", "WORKERS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        scan, records, workers = options.one
        print(json.dumps(long_fit(scan, int(records), int(workers))))
        return
    parts = [
        "# Benchmarks, as measured\n",
        f"Made by `python benchmarks/page.py --runs {options.runs}`. {machine()}",
        "Compare the numbers with each other, not with yours. [What the tables are about](README.md).\n",
        "## Start-up of the command line\n",
        f"Medians of {max(options.runs, 5)} runs, each in a process of its own.\n",
        start_up(max(options.runs, 5)),
        "## Noise: run time against error\n",
        "Relative error of the covariance of six beams. Medians of five; the lines' errors are rms over five seeds.\n",
        noise(),
        "## Posteriors: run time against error\n",
        "Root mean square error of mean, 5, 50 and 95 % points, in posterior standard deviations; one core, one run.\n",
        posteriors(),
        "## Scaling of a long fit\n",
        f"From variances to tables on the disk; medians of {options.runs} runs, each in a process of its own.\n",
        scaling(options.runs),
    ]
    options.output.write_text("\n".join(parts), encoding="utf-8")
    print(options.output.read_text(encoding="utf-8"))


def machine() -> str:
    """Say when and where."""
    load = os.getloadavg()[0]
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {os.cpu_count()} cores, {platform.machine()}, load {load:.1f} at the "
        f"start; bayes_rs {brs.__version__}, Python {platform.python_version()}, {versions}.\n"
    )


def table(frame: pd.DataFrame) -> str:
    """Lay out a table in Markdown."""
    rows = [list(frame.columns), ["---"] * len(frame.columns), *frame.astype(str).to_numpy().tolist()]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows) + "\n"


def timed(command: list[str]) -> tuple[float, str]:
    """Return seconds and output of a command."""
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 - our own
    return time.perf_counter() - began, done.stdout


def start_up(runs: int) -> str:
    """Return a table of what the command line takes before it does anything."""
    commands = {
        "`bayes-rs --help`": ["-m", "bayes_rs", "--help"],
        "`bayes-rs fit --help`": ["-m", "bayes_rs", "fit", "--help"],
        "`import bayes_rs`": ["-c", "import bayes_rs"],
        "`bayes-rs scans`": ["-m", "bayes_rs", "scans"],
    }
    rows = []
    for name, words in commands.items():
        seconds = [timed([sys.executable, *words])[0] for _ in range(runs)]
        rows.append({"command": name, "seconds": f"{statistics.median(seconds):.2f}"})
    return table(pd.DataFrame(rows))


def noise() -> str:
    """Return run time against error of the noise, by theory and on lines."""
    with tempfile.TemporaryDirectory() as folder:
        timed(
            [sys.executable, str(Path(__file__).parent / "noise_error.py"), folder, "--boxes", "0", "--lines", "1000"]
        )
        frame = pd.read_csv(Path(folder) / "noise-error.csv")
    frame["seconds"] = frame["seconds"].map("{:.3g}".format)
    frame["error"] = frame["error"].map("{:.2g}".format)
    return table(frame)


def posteriors() -> str:
    """Return run time against error of posteriors, of our samplers and of plain emcee."""
    with tempfile.TemporaryDirectory() as folder:
        timed([sys.executable, str(Path(__file__).parent / "posteriors.py"), folder])
        frame = pd.read_csv(Path(folder) / "posteriors.csv")
    return table(frame.round(4))


def scaling(runs: int) -> str:
    """Return how a long fit scales with records, beams and workers, and its memory."""
    cases = [("6-beam", count, 2) for count in RECORDS]
    cases += [(scan, N_FIXED, 2) for scan in BEAMS if scan != "6-beam"]
    cases += [("6-beam", N_FIXED, 1)]
    rows = []
    for scan, count, workers in cases:
        words = [sys.executable, __file__, "--one", scan, str(count), str(workers)]
        found = pd.DataFrame([json.loads(timed(words)[1]) for _ in range(runs)]).median()
        rows.append(
            {
                "scan": scan,
                "records": count,
                "workers": workers,
                "seconds": f"{found['seconds']:.2f}",
                "ms a record": f"{1e3 * found['seconds'] / count:.2f}",
                "memory of the parent, MB": f"{found['parent']:.0f}",
                "of a worker, MB": f"{found['worker']:.0f}",
            }
        )
    return table(pd.DataFrame(rows))


def long_fit(scan_name: str, count: int, workers: int) -> dict[str, float]:
    """Fit records with shipped noise; return seconds and peak memory."""
    scan = brs.load_scan(scan_name)
    noise = shipped_noise(scan)
    if noise is None:
        raise TypeError(f"No noise is shipped for {scan_name}.")
    records = make_year(scan, noise, count)
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        output = Path(folder) / "year"
        brs.fit(records, scan, seed=1, noise=noise, output=output, workers=workers, sampler="auto", draws="none")
        seconds = time.perf_counter() - began
    people = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    parent, worker = (resource.getrusage(who).ru_maxrss / 1024.0 for who in people)
    return {"seconds": seconds, "parent": parent, "worker": float(np.where(workers > 1, worker, parent))}


if __name__ == "__main__":
    main()
