"""Time and error of the shortcuts for many beams, against every pair with all its lags.

python benchmarks/noise_of_many_beams.py [SCAN ...]

Seconds are CPU time of one thread with the tables of the turbulence at hand. Errors are of K, ‖δK‖/‖K‖ (Frobenius) and
the largest entry's over the largest entry; of UᵀCU, the part of C = ln(1 + K) that stresses can move (Frobenius); and
of the posterior's 90 % intervals: the same six records are fitted with both by 20 000 draws. The median and the largest
change of a width over records and stresses are shown, beside those that another seed makes with the same noise.
"""

import os
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import xarray as xr

import bayes_rs as brs
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.likelihoods.base import REFERENCE_STRESS, seen_directions

SCANS = (
    "50-beam",
    "50-beam-planes",
    "zx-tm",
    "zx-300@focus_distance=39.3405",
    "zx-300@focus_distance=103.5276",
    "zx-300@focus_distance=310.5829",
    "spinnerlidar@probe=point",
    "spinnerlidar",
)
WIND_SPEED, N_RECORD = 10.0, 6


def relative(have: np.ndarray, want: np.ndarray) -> float:
    """Return the relative Frobenius error."""
    return float(np.linalg.norm(have - want) / np.linalg.norm(want))


def seen(scan: brs.Scan, covariance: np.ndarray) -> np.ndarray:
    """Return UᵀCU."""
    level = design_matrix(scan)
    left, kept = seen_directions((level / (level @ REFERENCE_STRESS)[:, None])[None])
    return left[0][:, kept[0]].T @ np.log1p(covariance) @ left[0][:, kept[0]]


def records(scan: brs.Scan, noise: brs.Noise) -> xr.Dataset:
    """Return records whose variances are log-normal by the exact noise."""
    rng = np.random.default_rng(2)
    logarithm = np.log1p(noise.covariance[0])
    mean = np.log(noise.gain[0] @ noise.turbulence.stresses() * (1.0 + noise.bias[0])) - 0.5 * np.diag(logarithm)
    variance = np.exp(rng.multivariate_normal(mean, logarithm, N_RECORD, check_valid="ignore", method="eigh"))
    return xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.int64)),
            "wind_speed": ("record", np.full(N_RECORD, WIND_SPEED)),
            "yaw": ("record", np.zeros(N_RECORD)),
        },
        coords={
            "beam": scan.beam,
            "time": ("record", np.datetime64("2020-01-01", "ns") + np.arange(N_RECORD) * np.timedelta64(600, "s")),
        },
        attrs={"duration": 600.0, "scan": scan.name, "scan_key": scan.key},
    )


def widths(data: xr.Dataset, scan: brs.Scan, noise: brs.Noise, seed: int) -> np.ndarray:
    """Return the widths of the intervals of all stresses of all records."""
    fitted = brs.fit(data, scan, noise=noise, seed=seed, sampler="direct", target_ess=20_000, progress=False)
    table = fitted.summary()
    return (table["high"] - table["low"]).to_numpy(dtype=float)


def change(have: np.ndarray, want: np.ndarray) -> str:
    """Say how widths change."""
    off = 100.0 * np.abs(have / want - 1.0)
    return f"{np.nanmedian(off):.2g} %, {np.nanmax(off):.2g} %"


def main(names: list[str]) -> None:
    """Print one line of the table for each scan."""
    turbulence = brs.load_turbulence("fu-2022")
    print(
        "| scan | CPU, every pair | CPU | calculated | K | largest entry | UᵀCU | widths | by another seed |\n|"
        + "---|" * 9
    )
    for name in names or SCANS:
        scan = brs.load_scan(name)
        brs.noise.theory(scan, turbulence, wind_speed=0.95 * WIND_SPEED)
        made, seconds = [], []
        for tolerance in ({"pair_tolerance": 0.0}, {}):
            start = time.process_time()
            made.append(brs.noise.theory(scan, turbulence, wind_speed=WIND_SPEED, **tolerance))
            seconds.append(time.process_time() - start)
        (exact, short), (k, have) = made, (one.covariance[0] for one in made)
        data = records(scan, exact)
        plain, other, ours = (widths(data, scan, one, seed) for one, seed in ((exact, 1), (exact, 2), (short, 1)))
        print(
            f"| {name} | {seconds[0]:.2g} s | {seconds[1]:.2g} s | {short.details['pairs_calculated']} | "
            f"{100.0 * relative(have, k):.2g} % | {100.0 * np.max(np.abs(have - k)) / np.max(k):.2g} % | "
            f"{100.0 * relative(seen(scan, have), seen(scan, k)):.2g} % | "
            f"{change(ours, plain)} | {change(other, plain)} |",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
