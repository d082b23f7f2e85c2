"""Make models/noise/*.nc, the noise that is shipped: virtual lidars in boxes of Mann turbulence.

Run from the checkout: python benchmarks/calibrate_shipped_noise.py; about half an hour. --help shows the options.
All scans at 10 m/s share one pass through the boxes; the noise of the pulsed lidar at several states takes another. No
scan has a probe volume here: the instruments' noise with theirs is by theory, benchmarks/make_noise_nets.py.
"""

from __future__ import annotations

import argparse
import time
from itertools import product
from pathlib import Path

import numpy as np

from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.box_noise import DEFAULT_SEED, noise_from_boxes
from bayes_rs.noise.noise import Noise
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import load_turbulence

DURATION = 600.0
WIND_SPEED = 10.0
BANK_WIND_SPEEDS = (3.0, 4.5, 6.5, 9.5, 14.0)
BANK_YAWS_DEG = (-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0)


def shipped_scans() -> dict[str, Scan]:
    """Return the scans that get one model each, by the name of their file."""
    scans = {name: load_scan(name) for name in ("staring", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam")}
    scans["zx-tm-point"] = load_scan("zx-tm@probe=point")
    for name in ("6-beam", "50-beam"):
        scans[f"{name}-45deg-52m"] = load_scan(name, opening_angle_deg=45.0, focus_distance=52.0)
    return scans


def main() -> None:
    """Calibrate and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boxes", type=int, default=240)
    parser.add_argument("--net-boxes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent.parent / "models" / "noise")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    turbulence = load_turbulence("fu-2022")

    scans = shipped_scans()
    states = [RecordState(scan, WIND_SPEED, 0.0, DURATION) for scan in scans.values()]
    start = time.perf_counter()
    models = noise_from_boxes(states, turbulence, options.boxes, DEFAULT_SEED)
    print(f"{options.boxes} boxes in {time.perf_counter() - start:.0f} s")
    for name, model in zip(scans, models, strict=True):
        write(model, options.folder / f"{name}.nc")

    pulsed = load_scan("pulsed-4-beam@probe=point")
    states = [
        RecordState(pulsed, speed, float(np.deg2rad(yaw)), DURATION)
        for speed, yaw in product(BANK_WIND_SPEEDS, BANK_YAWS_DEG)
    ]
    start = time.perf_counter()
    net = Noise.join(tuple(noise_from_boxes(states, turbulence, options.net_boxes, DEFAULT_SEED)))
    print(f"{options.net_boxes} boxes in {time.perf_counter() - start:.0f} s")
    write(net, options.folder / "pulsed-4-beam-point.nc")


def write(noise: Noise, file: Path) -> None:
    """Write one file and say how good it is."""
    noise.save(file, overwrite=True)
    for index in range(len(noise)):
        one = noise.state(index)
        error = np.diag(one.standard_error[0]) / np.diag(one.covariance[0])  # type: ignore[index]  # boxes have one
        print(
            f"{file.name:24s} U {one.wind_speed[0]:4.1f} m/s  yaw {np.rad2deg(one.yaw[0]):4.0f} deg  "
            f"relative sd {one.relative_error.min():.3f} to {one.relative_error.max():.3f}  "
            f"error of its square {100 * error.max():.1f} %  realizations {one.n_realizations[0]:.0f} of "
            f"{one.details['n_records']}  mean off by {one.details['mean_deviation_sigmas']} sigma",
            flush=True,
        )
    print(f"{file.name}: {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
