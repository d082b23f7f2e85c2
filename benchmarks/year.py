"""A year of records from variances to summaries: python benchmarks/year.py [--records 52560] [--workers 2].

Records have wind speeds from 4 to 20 m/s, directions within a few degrees, and tensors from the weak prior with a
narrower size; their variances are drawn from the shipped noise of the scan. Printed are seconds, milliseconds a record,
the largest memory of the parent and of a worker, and the flags; the year, and parts of it for the scaling.
"""

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import xarray as xr

import bayes_rs as brs
from bayes_rs.noise.store import find_shipped_noise
from bayes_rs.priors.registry import WeakPrior

START = np.datetime64("2020-01-01", "ns")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=52_560)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scan", action="append")
    parser.add_argument("--sampler", default="auto")
    arguments = parser.parse_args()
    for name in arguments.scan or ["6-beam", "50-beam"]:
        scan = brs.load_scan(name)
        noise = shipped_noise(scan)
        if noise is None:
            print(f"{name}: no noise is shipped")
            continue
        records = make_year(scan, noise, arguments.records)
        for share in (16, 4, 1):
            some = records.isel(record=slice(0, max(arguments.records // share, 1)))
            with tempfile.TemporaryDirectory() as folder:
                began = time.perf_counter()
                found = brs.fit(
                    some,
                    scan,
                    seed=1,
                    noise=noise,
                    output=Path(folder) / "year",
                    draws="none",
                    sampler=arguments.sampler,
                    workers=arguments.workers,
                )
                seconds = time.perf_counter() - began
                flagged = {word: count for word, count in found.flags.items() if count}
            people = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
            own, worker = (resource.getrusage(who).ru_maxrss / 1024 for who in people)
            print(
                f"{name}: {found.n_record} records, {arguments.workers} workers, {seconds:.1f} s, "
                f"{1e3 * seconds / found.n_record:.2f} ms a record, {own:.0f} and {worker:.0f} MB, {flagged}",
                flush=True,
            )


def shipped_noise(scan: brs.Scan) -> brs.Noise | None:
    """Return the noise that is shipped for a scan, over wind speeds and directions; None if there is none."""
    return find_shipped_noise(scan, brs.load_turbulence("fu-2022"), duration=600.0, method="theory")


def make_year(scan: brs.Scan, noise: brs.Noise, count: int) -> xr.Dataset:
    """Return records whose variances have the noise of their own wind speed and direction."""
    rng = np.random.default_rng(1)
    wind_speed, yaw = rng.uniform(4.0, 20.0, count), rng.normal(0.0, 5.0, count)
    parts = []
    for first in range(0, count, 512):
        some = slice(first, first + 512)
        at = noise.for_records(wind_speed[some], np.deg2rad(yaw[some]))
        mean = np.einsum("rbk,rk->rb", at.gain, WeakPrior(log_sd_uu=0.5).draw(len(at.gain), first + 1))
        log_covariance = np.log1p(at.covariance)
        values, vectors = np.linalg.eigh(log_covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        scatter = np.einsum("rbk,rk->rb", root, rng.normal(size=mean.shape))
        parts.append(mean * np.exp(scatter - 0.5 * np.einsum("rbb->rb", log_covariance)))
    variance = np.concatenate(parts)
    return xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.int64)),
            "wind_speed": ("record", wind_speed),
            "yaw": ("record", yaw),
        },
        coords={"beam": scan.beam, "time": ("record", START + np.arange(count) * np.timedelta64(600, "s"))},
        attrs={"duration": 600.0},
    )


if __name__ == "__main__":
    main()
