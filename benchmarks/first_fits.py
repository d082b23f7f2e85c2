"""Time and error of the noise that the first fit of each preset makes, in an empty cache.

python benchmarks/first_fits.py [SCAN ...]

The net is the one that `fit` makes for records of 5 to 15 m/s from within 10° of the axis whose length scales reach
from 30 to 120 m, uncertainty included: simulated records in fu-2022 told 46 to 120 m with six beams and 31 to 94 m with
the WindCube's five. Seconds are CPU time of one thread, tables of the turbulence included. The errors are those that
the noise states: of K in the worst and the median cell of the net, and of the pairs that were not calculated.
"""

import os
import sys
import tempfile
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import xarray as xr

import bayes_rs as brs
from bayes_rs.fits.noise_choice import OWN_TOLERANCE
from bayes_rs.turbulence.two_point import _build_table

SCANS = (
    *("staring", "2-beam", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam"),
    *("staring-planes", "2-beam-planes", "4-beam-planes", "5-beam-planes", "6-beam-planes"),
    *("pulsed-4-beam", "windcube-v2", "wls200s-dbs", "zx-tm", "zx-300@focus_distance=103.5276"),
    *("zx-300@focus_distance=310.5829", "50-beam-planes", "51-beam-planes", "spinnerlidar@probe=point", "spinnerlidar"),
)
WIND_SPEEDS, YAWS_DEG, LENGTH_SCALES = (5.0, 15.0), (-10.0, 10.0), (30.0, 120.0)


def records_of(scan: brs.Scan) -> xr.Dataset:
    """Return records at the ends of the winds."""
    return xr.Dataset(
        {
            "variance": (("record", "beam"), np.ones((2, scan.n_beam))),
            "flag": (("record", "beam"), np.zeros((2, scan.n_beam), dtype=np.int64)),
            "wind_speed": ("record", list(WIND_SPEEDS)),
            "yaw": ("record", list(YAWS_DEG)),
        },
        coords={"beam": scan.beam},
        attrs={"duration": 600.0, "scan": scan.name, "scan_key": scan.key},
    )


def main(names: list[str]) -> None:
    """Print one line of the table for each scan."""
    print("| scan | beams | CPU, s | states | worst cell | median cell | pairs, largest |\n" + "|---" * 7 + "|")
    for name in names or SCANS:
        scan = brs.load_scan(name)
        _build_table.cache_clear()
        start = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            noise = brs.noise.calibrate(
                scan,
                "fu-2022",
                records=records_of(scan),
                length_scale=list(LENGTH_SCALES),
                tolerance=OWN_TOLERANCE,
                cache=folder,
                progress=False,
            )
        seconds = time.process_time() - start
        errors = 100.0 * np.array(noise.details["interpolation_errors"])
        pairs = max({**noise.details, **one}.get("pair_error", 0.0) for one in noise.state_details)
        print(
            f"| {name} | {scan.n_beam} | {seconds:.1f} | {len(noise)} | {np.max(errors):.2g} % | "
            f"{np.median(errors):.2g} % | {f'{100.0 * pairs:.2g} %' if pairs else 'every one'} |",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
