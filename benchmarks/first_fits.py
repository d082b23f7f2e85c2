"""Time and error of the noise that the first fit of each preset makes, in an empty cache.

python benchmarks/first_fits.py [SCAN ...]

The net is the one that `fit` makes for records of 5 to 15 m/s from within 10° of the axis whose length scales reach
from 30 to 120 m, uncertainty included: simulated records in fu-2022 told 46 to 120 m with six beams and 31 to 94 m with
the WindCube's five. Seconds are CPU time of one thread, tables of the turbulence included. The errors are those that
the noise states: of K in the worst and the median cell of the net, and of the pairs that were not calculated. The
heights of a scan that looks at one after the other (ZX 300) are rows of their own, as they are fits of their own. A
scan that takes more than 300 s of CPU is given up.
"""

import os
import signal
import sys
import tempfile
import time
import tomllib

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import xarray as xr

import bayes_rs as brs
from bayes_rs.fits.noise_choice import OWN_TOLERANCE
from bayes_rs.models import models_folder
from bayes_rs.turbulence.two_point import _build_table

LAST = ("50-beam-planes", "51-beam-planes", "spinnerlidar", "spinnerlidar-planes")
LIMIT = 300  # s
WIND_SPEEDS, YAWS_DEG, LENGTH_SCALES = (5.0, 15.0), (-10.0, 10.0), (30.0, 120.0)


def presets() -> list[str]:
    """Return all scans that are shipped, those of most beams last, and sequential planes one by one."""
    names: list[str] = []
    for file in sorted(models_folder("scans").glob("*.toml")):
        spec = tomllib.loads(file.read_text(encoding="utf-8"))
        if spec.get("timing", {}).get("planes") == "sequential":
            names += [f"{file.stem}@focus_distance={distance}" for distance in spec["beams"]["focus_distance"]]
        else:
            names.append(file.stem)
    return [*(name for name in names if name not in LAST), *LAST]


def give_up(*_: object) -> None:
    """End a scan that takes too long."""
    raise TimeoutError


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
    signal.signal(signal.SIGPROF, give_up)
    for name in names or presets():
        scan = brs.load_scan(name)
        _build_table.cache_clear()
        start = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, LIMIT)
        try:
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
        except TimeoutError:
            print(f"| {name} | {scan.n_beam} | more than {LIMIT} | | | | |", flush=True)
            continue
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
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
