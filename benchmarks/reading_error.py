"""Run time against error of reading: python benchmarks/reading_error.py [--hours 4] [--files 400] [--runs 3].

A day's part of a ZX TM at 50 Hz as CSV, and cycles of a WindCube as NetCDF files. Time: CPU, of threads and of the
process that reads NetCDF with it, beside a plain read of the same files by the library underneath in the same run.
Error: the largest relative difference of a beam's variance from that of the plain numbers, sorted and reduced by NumPy.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow.csv
from measuring import spent, table
from windcube_files import HEIGHT, measured, plain, write_files
from zx_day import POSITIVE, write_day

import bayes_rs as brs
from bayes_rs.records.stream import stream_records

DURATION = 600.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=int, default=4)
    parser.add_argument("--files", type=int, default=400)
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    print(reading(arguments.hours, arguments.files, arguments.runs))


def reading(hours: int, files: int, runs: int) -> str:
    """Return the table of both kinds of file."""
    with tempfile.TemporaryDirectory() as place:
        rows = [of_text(Path(place), hours, runs), of_netcdf(Path(place), files, runs)]
    return table(pd.DataFrame(rows))


def of_text(place: Path, hours: int, runs: int) -> dict[str, object]:
    """Return the row of one large file of text."""
    scan, file, few = brs.load_scan("zx-tm"), place / "day.csv", place / "few.csv"
    write_day(file, scan, hours=hours)
    with file.open(encoding="utf-8") as source:
        few.write_text("".join(next(source) for _ in range(40_000)), encoding="utf-8")

    def records(of: Path) -> np.ndarray:
        return np.asarray(stream_records(brs.readers.stream(of, scan, positive=POSITIVE), scan)["variance"].values)

    records(few)  # what is loaded at the first use is not the file's
    base = statistics.median(spent(lambda: pyarrow.csv.read_csv(file)).cpu for _ in range(runs))
    ours = statistics.median(spent(lambda: records(file)).cpu for _ in range(runs))
    frame = pyarrow.csv.read_csv(file).to_pandas()
    number = (frame["time"].to_numpy().astype("datetime64[ns]").astype(np.int64) // int(1e9 * DURATION)).astype(int)
    expected = frame.groupby([number, "beam"])["radial_velocity"].var(ddof=0).unstack().to_numpy()
    error = float(np.max(np.abs(records(file) / expected - 1.0)))
    what = f"ZX TM, {hours} h at 50 Hz, {file.stat().st_size / 1e6:.0f} MB of CSV, to records"
    return row(what, "Arrow", base, ours, error)


def of_netcdf(place: Path, count: int, runs: int) -> dict[str, object]:
    """Return the row of many small files of NetCDF."""
    folder = place / "cycles"
    folder.mkdir()
    files = write_files(folder, count)
    scan = brs.find_scan(files[:20], height=HEIGHT)
    brs.read(files[:20], scan)
    plain(files)
    base = statistics.median(measured(lambda: plain(files))[0] for _ in range(runs))
    ours = statistics.median(measured(lambda: brs.read(files, scan))[0] for _ in range(runs))
    series = brs.read(files, scan)
    velocity, beam = series["radial_velocity"].values, series["beam"].values
    found = np.sort([velocity[beam == one].var() for one in scan.beam])
    error = float(np.max(np.abs(found / plain_variances(files) - 1.0)))
    what = f"WindCube, {count} NetCDF files of five rays and 159 gates, to samples at {HEIGHT:g} m"
    return row(what, "h5py", base, ours, error)


def plain_variances(files: list[Path]) -> np.ndarray:
    """Return the variance of each direction over all files, sorted, by h5py and NumPy alone."""
    parts = []
    for file in files:
        with h5py.File(file, "r") as opened:
            sweep = next(opened[name] for name in opened if name.startswith("Sweep"))
            gate = np.argmin(np.abs(sweep["measurement_height"][0] - HEIGHT))
            parts.append([sweep["azimuth"][()], sweep["elevation"][()], sweep["radial_wind_speed"][:, gate]])
    azimuth, elevation, velocity = np.concatenate(parts, axis=1)
    _, beam = np.unique(np.stack([azimuth, elevation]), axis=1, return_inverse=True)
    return np.sort([velocity[beam == one].var() for one in np.unique(beam)])


def row(what: str, library: str, base: float, ours: float, error: float) -> dict[str, object]:
    """Return a row of the table."""
    return {
        "files": what,
        "plain read, s of CPU": f"{base:.2f} ({library})",
        "ours, s of CPU": f"{ours:.2f}",
        "times": f"{ours / base:.1f}",
        "largest error of a variance": f"{error:.1e}",
    }


if __name__ == "__main__":
    main()
