"""Run time against error of the noise covariance: boxes of two sizes, lines, and theory at several tolerances.

python benchmarks/noise_error.py OUTPUT [--boxes N] [--lines N]

The error is ‖K − K_ref‖_F / ‖K_ref‖_F for the six-beam scan at the seed's flow (10 m/s, 600 s), against theory at its
tightest tolerance. Seconds are of one process with one thread, and count everything from nothing: the tables of theory,
the spectral tensor of boxes. Boxes are those of the study (8192 × 64 × 64 points, 128 m wide) and wider ones (256 m).
"""

import argparse
import os
import platform
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import bayes_rs as brs
from bayes_rs.noise.box_noise import noise_from_boxes
from bayes_rs.pictures import COLOURS
from bayes_rs.simulation.boxes import BoxGrid
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence import one_point, two_point

WIND_SPEED, DURATION = 10.0, 600.0
GRIDS = {
    "boxes of the study, 8192×64×64, 128 m wide": BoxGrid((8192, 64, 64), (2.2, 2.0, 2.0)),
    "boxes 4096×64×64, 256 m wide": BoxGrid((4096, 64, 64), (4.4, 4.0, 4.0)),
}


def forget() -> None:
    """Empty every cache of the theory, so that a measurement starts from nothing."""
    for module in (one_point, two_point):
        for thing in vars(module).values():
            if hasattr(thing, "cache_clear"):
                thing.cache_clear()


def relative_error(covariance: np.ndarray, reference: np.ndarray) -> float:
    """Return the relative Frobenius error."""
    return float(np.linalg.norm(covariance - reference) / np.linalg.norm(reference))


def by_theory(scan: brs.Scan, turbulence: brs.MannTurbulence, reference: np.ndarray) -> list[dict[str, object]]:
    """Time theory from nothing and with its tables at hand, medians of five."""
    rows = []
    for tolerance in (1e-3, 3e-4, 1e-4):
        cold, warm = [], []
        for _ in range(5):
            forget()
            start = time.perf_counter()
            noise = brs.noise.theory(scan, turbulence, wind_speed=WIND_SPEED, tolerance=tolerance)
            cold.append(time.perf_counter() - start)
            start = time.perf_counter()
            brs.noise.theory(scan, turbulence, wind_speed=1.01 * WIND_SPEED, tolerance=tolerance)
            warm.append(time.perf_counter() - start)
        error = relative_error(noise.covariance[0], reference)
        rows += [
            {
                "method": "theory, from nothing",
                "size": f"tolerance {tolerance:g}",
                "seconds": np.median(cold),
                "error": error,
            },
            {
                "method": "theory, tables at hand",
                "size": f"tolerance {tolerance:g}",
                "seconds": np.median(warm),
                "error": error,
            },
        ]
    return rows


def by_boxes(
    scan: brs.Scan, turbulence: brs.MannTurbulence, reference: np.ndarray, most: int
) -> list[dict[str, object]]:
    """Time boxes: K of the first 10, 30, 100 … of them, each with its own stresses as truth."""
    rows = []
    state = RecordState(scan, WIND_SPEED, scan.yaw, DURATION)
    for name, grid in GRIDS.items():
        for count in [number for number in (10, 100, 300) if number <= most]:
            start = time.perf_counter()
            (noise,) = noise_from_boxes([state], turbulence, count, 7, grid=grid)
            seconds = time.perf_counter() - start
            error = relative_error(noise.covariance[0], reference)
            rows.append({"method": name, "size": f"{count} boxes", "seconds": seconds, "error": error})
            print(rows[-1], flush=True)
    return rows


def by_lines(
    scan: brs.Scan, turbulence: brs.MannTurbulence, reference: np.ndarray, most: int
) -> list[dict[str, object]]:
    """Time the line simulator: K of the variances of 100, 300, 1000 … records; medians and rms errors of five seeds."""
    rows = []
    for count in [number for number in (100, 300, 1000, 3000, 10_000) if number <= most]:
        times, errors = [], []
        for seed in range(5):
            forget()
            start = time.perf_counter()
            series = brs.simulate(
                scan, turbulence, wind_speed=WIND_SPEED, duration=DURATION, n_records=count, seed=seed, method="lines"
            )
            variance = brs.make_records(series, scan)["variance"].values
            covariance = np.cov((variance / variance.mean(axis=0)).T)
            times.append(time.perf_counter() - start)
            errors.append(relative_error(covariance, reference))
        seconds, error = np.median(times), np.sqrt(np.mean(np.square(errors)))
        rows.append({"method": "lines", "size": f"{count} records", "seconds": seconds, "error": error})
        print(rows[-1], flush=True)
    return rows


def draw(table: pd.DataFrame) -> Figure:
    """Draw error against seconds."""
    figure = Figure(figsize=(8.5, 5.5), layout="constrained")
    axis = figure.subplots()
    for (name, rows), marker, colour in zip(table.groupby("method", sort=False), "osD^v", COLOURS, strict=False):
        axis.loglog(rows["seconds"], rows["error"], marker=marker, color=colour, label=name)
    axis.set_xlabel("seconds, one core")
    axis.set_ylabel("relative Frobenius error of K, six beams")
    axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize=9)
    return figure


def main() -> None:
    """Measure, and write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path)
    parser.add_argument("--boxes", type=int, default=100, help="most boxes of each size")
    parser.add_argument("--lines", type=int, default=10_000, help="most records of the line simulator")
    arguments = parser.parse_args()
    scan, turbulence = brs.load_scan("6-beam"), brs.load_turbulence("fu-2022")
    reference = brs.noise.theory(scan, turbulence, wind_speed=WIND_SPEED, tolerance=2e-5).covariance[0]
    rows = by_theory(scan, turbulence, reference)
    rows += by_lines(scan, turbulence, reference, arguments.lines)
    rows += by_boxes(scan, turbulence, reference, arguments.boxes)
    table = pd.DataFrame(rows)
    arguments.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(arguments.output / "noise-error.csv", index=False, float_format="%.3g")
    draw(table).savefig(arguments.output / "noise-error.png", dpi=100)
    print(table.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    print(
        f"{datetime.now(tz=UTC):%Y-%m-%d}, Python {platform.python_version()}, numpy {version('numpy')}, "
        f"{os.cpu_count()} cores, {platform.machine()}"
    )


if __name__ == "__main__":
    main()
