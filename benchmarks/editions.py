"""The same jobs by this edition and by another, in one run: python benchmarks/editions.py [--base REVISION] [--runs 3].

The other edition is taken from the repository's history (0.1.0, the first one, unless another is named) into a
temporary folder and run there, by the same Python with the same packages, in turn with this one. Each number is the
median over processes of the CPU that a job took, after a first small one of its kind, with the library's own caches
empty.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tarfile
import tempfile
from dataclasses import replace
from io import BytesIO
from itertools import islice
from pathlib import Path

import pandas as pd
from measuring import medians, run, spent, table

FIRST = "b71a2f7"
"""The commit of 0.1.0."""
HERE = Path(__file__).resolve()
N_RECORD = 512
N_YEAR = 5256
"""A tenth of a year."""
JOBS = {
    "emcee-6-beam": "posteriors and summary of 6 beams, emcee (the default), ms a record",
    "direct-6-beam": "the same, direct",
    "emcee-50-beam": "posteriors and summary of 50 beams, emcee, ms a record",
    "direct-50-beam": "the same, direct",
    "year": "a tenth of a year of 6-beam records into a folder, two workers, sampler `auto`, ms a record",
    "noise-6-beam": "noise at a state, 6 points, tables at hand, ms",
    "noise-50-beam": "noise at a state, 50 points, ms",
    "noise-50-beam-with-probe": "noise at a state, 50 beams with probe, ms",
    "noise-spinnerlidar-with-probe": "noise at a state, 400 beams with probe, ms",
    "reading": "two hours of 50 Hz from CSV to records, ms",
    "command": "`bayes-rs fit` of the demonstration's file, start to end, ms",
}
SLOW = ("noise-spinnerlidar-with-probe",)
"""Jobs of minutes in the first edition: one run each."""


def main() -> None:
    """Measure both editions, or do one job and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", default=FIRST)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--jobs", nargs="+", default=list(JOBS), choices=list(JOBS))
    parser.add_argument("--one", nargs=2, metavar=("JOB", "FOLDER"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(one_job(arguments.one[0], Path(arguments.one[1]))))
        return
    print(compare(arguments.base, arguments.runs, arguments.jobs))


def compare(base: str, runs: int, jobs: list[str] | None = None) -> str:
    """Return the table of both editions and their ratio; one line instead if the history does not hold the other."""
    root = HERE.parents[1]
    command = ["git", "-C", str(root), "archive", "--format=tar", base]
    archive = subprocess.run(command, capture_output=True, check=False)  # noqa: S603 - our own words
    if archive.returncode:
        return f"Not measured: this copy of the repository has no revision {base}.\n"
    rows = []
    with tempfile.TemporaryDirectory() as place:
        old, data = Path(place) / "edition", Path(place) / "data"
        data.mkdir()
        with tarfile.open(fileobj=BytesIO(archive.stdout)) as opened:
            opened.extractall(old, filter="data")
        run([str(HERE), "--one", "data", str(data)], str(root))
        for job in jobs or list(JOBS):
            often = 1 if job in SLOW else runs
            words = [str(HERE), "--one", job, str(data)]
            before, now = (medians(words, often, str(folder))["ms"] for folder in (old, root))
            rows.append(
                {
                    "job": JOBS[job],
                    base if base != FIRST else "0.1.0": f"{before:.3g}",
                    "now": f"{now:.3g}",
                    "times as fast": f"{before / now:.2g}",
                }
            )
    return table(pd.DataFrame(rows))


def one_job(job: str, folder: Path) -> dict[str, float]:
    """Do one job, with the edition that this process finds."""
    os.environ["XDG_CACHE_HOME"] = str(folder / f"cache-{os.getpid()}")
    if job == "data":
        write_data(folder)
        return {}
    if job == "command":
        return {"ms": 1e3 * command(folder)}
    if job == "reading":
        return {"ms": 1e3 * reading(folder)}
    kind, _, scan = job.partition("-")
    if kind == "noise":
        return {"ms": 1e3 * noise(scan)}
    if kind == "year":
        return {"ms": 1e3 * year(folder) / N_YEAR}
    return {"ms": 1e3 * posteriors(kind, scan, folder) / N_RECORD}


def write_data(folder: Path) -> None:
    """Write what both editions are given: records of two scans, and two hours of a ZX TM."""
    from year import make_year, shipped_noise  # noqa: PLC0415 - of this edition alone
    from zx_day import write_day  # noqa: PLC0415

    import bayes_rs as brs  # noqa: PLC0415 - the edition is chosen by the process

    for name, count in (("6-beam", N_YEAR), ("50-beam", N_RECORD)):
        scan = brs.load_scan(name)
        noise = shipped_noise(scan)
        if noise is None:
            raise TypeError(f"No noise is shipped for {name}.")
        make_year(scan, noise, count).to_netcdf(folder / f"{name}.nc", engine="h5netcdf")
    write_day(folder / "zx-tm.csv", brs.load_scan("zx-tm"), hours=2)
    with (folder / "zx-tm.csv").open(encoding="utf-8") as source:
        (folder / "few.csv").write_text("".join(islice(source, 40_000)), encoding="utf-8")


def posteriors(sampler: str, name: str, folder: Path) -> float:
    """Return the CPU from variances to a summary."""
    import bayes_rs as brs  # noqa: PLC0415

    scan, noise = brs.load_scan(name), _shipped(name)
    records = _records(folder, name).isel(record=slice(0, N_RECORD))

    alone = {} if hasattr(brs, "fit_campaign") else {"campaign": False}  # the first edition learns nothing from others

    def fit(some: object) -> None:
        made = brs.fit(some, scan, noise=noise, seed=1, sampler=sampler, **alone)
        made.summary() if hasattr(made, "summary") else brs.summary(made)

    fit(records.isel(record=slice(0, 8)))
    return spent(lambda: fit(records)).cpu


def year(folder: Path) -> float:
    """Return the CPU of all processes from variances to a folder of tables."""
    import bayes_rs as brs  # noqa: PLC0415

    scan, noise, records = brs.load_scan("6-beam"), _shipped("6-beam"), _records(folder, "6-beam")
    with tempfile.TemporaryDirectory() as place:
        output = Path(place) / "year"
        job = {"noise": noise, "seed": 1, "workers": 2, "sampler": "auto"}
        if hasattr(brs, "fit_campaign"):
            return spent(lambda: brs.fit_campaign(records, scan, output, **job)).cpu
        job |= {"output": output, "draws": "none", "campaign": False}
        return spent(lambda: brs.fit(records, scan, **job)).cpu


def noise(name: str) -> float:
    """Return the CPU of the noise at one state, after that of a smaller scan; with a probe, or points."""
    import bayes_rs as brs  # noqa: PLC0415

    theory = brs.theory_noise if hasattr(brs, "theory_noise") else brs.noise.theory
    flow = brs.load_turbulence("fu-2022")
    name, _, kind = name.partition("-with-")
    probe = None
    if kind:  # the first edition's presets had none
        where = brs if hasattr(brs, "ContinuousWaveProbe") else brs.geometry
        probe = where.ContinuousWaveProbe(wavelength=1.565e-6, aperture_radius=0.028)

    def make(of: str, wind_speed: float) -> None:
        scan = brs.load_scan(of)
        theory(scan if probe is None else replace(scan, probe=probe), flow, wind_speed=wind_speed)

    make("2-beam" if name == "6-beam" else "6-beam", 10.0)
    return spent(lambda: make(name, 11.0)).cpu


def reading(folder: Path) -> float:
    """Return the CPU from a file to records."""
    import bayes_rs as brs  # noqa: PLC0415

    scan = brs.load_scan("zx-tm")
    read = brs.read_radial_velocity if hasattr(brs, "read_radial_velocity") else brs.read

    def records(file: Path) -> None:
        brs.make_records(read(file, scan, positive="away"), scan)

    records(folder / "few.csv")
    return spent(lambda: records(folder / "zx-tm.csv")).cpu


def command(folder: Path) -> float:
    """Return the CPU of the command line, from start to end, on a small file."""
    import bayes_rs as brs  # noqa: PLC0415

    file = str(brs.demo_file("6-beam-45") if hasattr(brs, "demo_file") else brs.models.demo_file("6-beam-45"))
    words = ["-m", "bayes_rs", "fit", file, "--scan", "6-beam", "--opening-angle", "45", "--focus-distance", "52"]
    output = folder / f"command-{os.getpid()}"
    return spent(lambda: run([*words, "--turbulence", "fu-2022", "--output", str(output)])).cpu


def _shipped(name: str) -> object:
    import bayes_rs as brs  # noqa: PLC0415

    if hasattr(brs, "find_shipped_noise"):
        find = brs.find_shipped_noise
    else:
        from bayes_rs.noise.store import find_shipped_noise as find  # noqa: PLC0415
    return find(brs.load_scan(name), brs.load_turbulence("fu-2022"), duration=600.0, method="theory")


def _records(folder: Path, name: str) -> object:
    import xarray as xr  # noqa: PLC0415

    records = xr.load_dataset(folder / f"{name}.nc", engine="h5netcdf")
    return records.assign_coords(time=records["time"].astype("datetime64[ns]"))


if __name__ == "__main__":
    main()
