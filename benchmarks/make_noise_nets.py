"""Make the noise by theory that is shipped in models/noise, and print a table of sizes and errors.

Usage: python benchmarks/make_noise_nets.py [NAME ...]
"""

import sys
import time
from dataclasses import replace

from bayes_rs import load_scan, load_turbulence
from bayes_rs.models import models_folder
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.net import measure_interpolation, refined_noise
from bayes_rs.noise.store import THEORY_SUFFIX

SCANS = {name: name for name in ("staring", "2-beam", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam")} | {
    "zx-tm": "zx-tm",
    "zx-tm-point": "zx-tm@probe=point",
    "pulsed-4-beam": "pulsed-4-beam",
    "pulsed-4-beam-point": "pulsed-4-beam@probe=point",
}
"""The scans by the names of their files."""
WIND_SPEEDS = (3.0, 25.0)
YAWS_DEG = (-60.0, 60.0)


def main(names: list[str]) -> None:
    """Make the nets of the files that are named, or of all."""
    turbulence = load_turbulence("fu-2022")
    print("| scan | beams | states | error of K between them | file, kB | seconds |\n|---|---|---|---|---|---|")
    for name in names or SCANS:
        start = time.perf_counter()
        scan = load_scan(SCANS[name])
        net = refined_noise(scan, turbulence, wind_speed=WIND_SPEEDS, yaw_deg=YAWS_DEG, cache=False)
        seconds = time.perf_counter() - start
        error = measure_interpolation(net, scan)  # with all beams, not some
        stated = {"interpolation_error": error, "interpolation_error_beams": scan.n_beam}
        kept = {key: value for key, value in net.details.items() if key not in ("key", "origin")}
        file = models_folder("noise") / f"{name}{THEORY_SUFFIX}.nc"
        replace(net, details={**kept, **stated}).save(file, overwrite=True, single_precision=True)
        load_noise(file).check_scan(scan)
        size = file.stat().st_size / 1000.0
        print(
            f"| {name} | {scan.n_beam} | {len(net)} | {100.0 * error:.2f} % | {size:.0f} | {seconds:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
