"""What a record costs in a stream: python benchmarks/stream.py [--records 12].

CPU of `Stream.add` for the chunks with which a record closes, and for those with which none does, in milliseconds:
median over simulated ten-minute records of two scans, chunks of 10 s. The noise is given. Beside it, what the record
alone costs, without a fit, and what each costs in one fit of all of them.
"""

import argparse
import os
import time

import numpy as np
import xarray as xr

import bayes_rs as brs
from bayes_rs.fits.noise_choice import NET_LENGTHS
from bayes_rs.records.closing import ClosingRecords

NOTHING_POOLED = {"instrument_noise": 0.0, "scatter": "theory", "unsteady_level": 0.0}
BEFORE = 36  # records that fill the longest memory
KINDS = {
    "defaults, memory 5": {},
    "direct, memory 5": {"sampler": "direct"},
    "memory 0": {"memory": 0},
    "memory 35": {"memory": 35},
    "nothing learnt": {"memory": 0, **NOTHING_POOLED},
    "nothing learnt, direct": {"memory": 0, "sampler": "direct", **NOTHING_POOLED},
}


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=12)
    n_record = parser.parse_args().records
    print(f"load {os.getloadavg()[0]:.1f}; median ms of CPU: a record, a chunk without one")
    for name in ("6-beam", "50-beam"):
        scan = brs.load_scan(name)
        series = brs.simulate(scan, "fu-2022", wind_speed=10.0, n_records=n_record + BEFORE, seed=1)
        reach = {"wind_speed": [5.0, 20.0], "yaw_deg": [-20.0, 20.0], "tolerance": 0.02}
        one, many = (brs.noise.calibrate(scan, length_scale=length, **reach) for length in (61.0, NET_LENGTHS))
        for kind, options in KINDS.items():
            noise = one if "scatter" in options else many
            skipped = 0 if options.get("memory") == 35 else BEFORE - 6  # what fills no memory
            some = series.isel(sample=slice(skipped * series.sizes["sample"] // (n_record + BEFORE), None))
            closing, other = measured(brs.Stream(scan, noise=noise, seed=1, **options), some, scan.n_beam)
            print(f"{name:8} {kind:24} {np.median(closing[-n_record:]):6.0f} {np.median(other):6.1f}", flush=True)
        closing, other = measured(ClosingRecords(scan, before=5), some, scan.n_beam)
        print(f"{name:8} {'records, no fit':24} {np.median(closing[-n_record:]):6.0f} {np.median(other):6.1f}")
        records = brs.make_records(series, scan)
        began = time.process_time()
        brs.fit(records, scan, noise=many, seed=1, campaign="off")
        print(f"{name:8} {'all in one fit':24} {1e3 * (time.process_time() - began) / records.sizes['record']:6.1f}")


def measured(stream: brs.Stream | ClosingRecords, series: xr.Dataset, n_beam: int) -> tuple[list[float], list[float]]:
    """Return milliseconds of CPU of the chunks that close a record, and of the others."""
    closing, other = [], []
    for first in range(0, series.sizes["sample"], 10 * n_beam):
        chunk = series.isel(sample=slice(first, first + 10 * n_beam))
        began = time.process_time()
        found = stream.add(chunk)
        (closing if found else other).append(1e3 * (time.process_time() - began))
    return closing, other


if __name__ == "__main__":
    main()
