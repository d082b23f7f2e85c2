"""The benchmarks page, made again by one command: python benchmarks/page.py [--runs 3] [--output FILE] [--parts …].

Beside 0.1.0, in the same run; start-up; run time against error of noise, posteriors, reading and the campaign; scaling
with records, beams and workers; memory. The page says when, on which machine, at which load and with which versions,
and of how many runs each number is. About half an hour on two quiet cores; the peers are in `posteriors.py --peers`.
"""

import argparse
import json
import os
import platform
import statistics
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
from campaign_error import SCALING, error_against_time
from campaign_error import scaling as campaign_scaling
from editions import FIRST, compare
from measuring import load, medians, peak_memory, run, spent, table
from reading_error import reading
from year import make_year, shipped_noise

import bayes_rs as brs

PACKAGES = ("numpy", "scipy", "xarray", "pandas", "emcee", "arviz")
RECORDS = (1312, 5248, 20_992)
BEAMS = ("2-beam", "4-beam", "6-beam", "50-beam")
N_FIXED = 5248
"""Records where beams, workers and samplers vary."""
HERE = Path(__file__).resolve()


def main() -> None:
    """Measure and write, or do one measurement and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--output", type=Path, default=HERE.parent / "measured.md")
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--one", nargs=4, metavar=("SCAN", "RECORDS", "WORKERS", "SAMPLER"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        scan, records, workers, sampler = options.one
        print(json.dumps(long_fit(scan, int(records), int(workers), sampler)))
        return
    about = (
        "Compare the numbers with each other, not with yours. Seconds are of CPU, of all processes of a job, unless "
        "the clock is named; medians of the runs that are named. [What the tables are about](README.md).\n"
    )
    made = f"Made by `python benchmarks/page.py --runs {options.runs}`. {machine()}"
    text = ["# Benchmarks, as measured\n", made, about]
    for name in options.parts:
        heading, words, part = PARTS[name]
        before = load()
        text += [f"## {heading}\n", f"{words} ({before} at the start)\n", part(options.runs)]
        options.output.write_text("\n".join(text), encoding="utf-8")  # what is measured is kept
        print(text[-1], flush=True)


def machine() -> str:
    """Say when and where."""
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {os.cpu_count()} cores, {platform.machine()}, {load()} at the "
        f"start; bayes_rs {brs.__version__}, Python {platform.python_version()}, {versions}.\n"
    )


def start_up(runs: int) -> str:
    """Return a table of what the command line takes before it does anything."""
    commands = {
        "`bayes-rs --help`": ["-m", "bayes_rs", "--help"],
        "`bayes-rs fit --help`": ["-m", "bayes_rs", "fit", "--help"],
        "`import bayes_rs`": ["-c", "import bayes_rs"],
        "`bayes_rs.fit`, looked up": ["-c", "import bayes_rs; bayes_rs.fit"],
        "`bayes-rs scans`": ["-m", "bayes_rs", "scans"],
    }
    rows = []
    for name, words in commands.items():
        found = [spent(partial(run, words)) for _ in range(max(runs, 5))]
        cpu, clock = (statistics.median(one[place] for one in found) for place in (0, 1))
        rows.append({"command": name, "s of CPU": f"{cpu:.2f}", "by the clock": f"{clock:.2f}"})
    return table(pd.DataFrame(rows))


def noise(runs: int) -> str:  # noqa: ARG001 - it takes medians of five by itself
    """Return run time against error of the noise, by theory and on lines."""
    with tempfile.TemporaryDirectory() as folder:
        run([str(HERE.parent / "noise_error.py"), folder, "--boxes", "0", "--lines", "1000"])
        frame = pd.read_csv(Path(folder) / "noise-error.csv")
    frame["seconds"] = frame["seconds"].map("{:.3g}".format)
    frame["error"] = frame["error"].map("{:.2g}".format)
    return table(frame)


def posteriors(runs: int) -> str:  # noqa: ARG001 - the error is the mean over many records
    """Return run time against error of posteriors, of our samplers and of plain emcee."""
    with tempfile.TemporaryDirectory() as folder:
        run([str(HERE.parent / "posteriors.py"), folder])
        frame = pd.read_csv(Path(folder) / "posteriors.csv")
    return table(frame.round(4))


def campaign(runs: int) -> str:
    """Return run time against error of the campaign, and its scaling."""
    return error_against_time(60, runs) + "\n" + campaign_scaling(SCALING)


def scaling(runs: int) -> str:
    """Return how a long fit scales with records, beams and workers, and its memory."""
    cases = [("6-beam", count, 2, "emcee") for count in RECORDS]
    cases += [(scan, N_FIXED, 2, "emcee") for scan in BEAMS if scan != "6-beam"]
    cases += [("6-beam", N_FIXED, 1, "emcee"), ("6-beam", N_FIXED, 2, "direct")]
    rows = []
    for scan, count, workers, sampler in cases:
        found = medians([str(HERE), "--one", scan, str(count), str(workers), sampler], runs)
        rows.append(
            {
                "scan": scan,
                "records": count,
                "workers": workers,
                "sampler": sampler,
                "by the clock, s": f"{found['clock']:.1f}",
                "CPU, ms a record": f"{1e3 * found['cpu'] / count:.2f}",
                "memory of the parent, MB": f"{found['parent']:.0f}",
                "of a worker, MB": f"{found['worker']:.0f}",
            }
        )
    return table(pd.DataFrame(rows))


def long_fit(scan_name: str, count: int, workers: int, sampler: str) -> dict[str, float]:
    """Fit records with shipped noise, one by one; return seconds and peak memory."""
    scan = brs.load_scan(scan_name)
    noise_of_scan = shipped_noise(scan)
    if noise_of_scan is None:
        raise TypeError(f"No noise is shipped for {scan_name}.")
    records = make_year(scan, noise_of_scan, count)
    job = {"seed": 1, "noise": noise_of_scan, "workers": workers, "sampler": sampler, "draws": "none"}
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "year"
        took = spent(lambda: brs.fit(records, scan, output=output, campaign=False, **job))
    parent, worker = peak_memory()
    return {
        "cpu": took.cpu,
        "clock": took.clock,
        "parent": parent,
        "worker": float(np.where(workers > 1, worker, parent)),
    }


PARTS: dict[str, tuple[str, str, Callable[[int], str]]] = {
    "editions": (
        "Beside 0.1.0, in the same run",
        "Each job by both editions in turn, with the same data and packages, after a small job of its kind.",
        lambda runs: compare(FIRST, runs),
    ),
    "start": ("Start-up", "Each in a process of its own.", start_up),
    "noise": (
        "Noise: run time against error",
        "Relative error of the covariance of six beams. Medians of five; the lines' errors are rms over five seeds.",
        noise,
    ),
    "posteriors": (
        "Posteriors: run time against error",
        "Root mean square error of mean, 5, 50 and 95 % points, in posterior standard deviations; one core, one run.",
        posteriors,
    ),
    "reading": (
        "Reading: run time against error",
        "Beside the plain read of the same files.",
        lambda runs: reading(4, 400, runs),
    ),
    "campaign": (
        "Campaign: run time against error",
        "Error of means and spreads against a long run, in posterior standard deviations; CPU by number of records.",
        campaign,
    ),
    "scaling": (
        "Scaling of a long fit",
        "From variances to tables on the disk, each in processes of its own; without what is learnt from the campaign.",
        scaling,
    ),
}


if __name__ == "__main__":
    main()
