"""The Monte-Carlo error of what a fit reports: python benchmarks/sampling_error.py [--records 48] [--seeds 8].

For records of several scans and priors, the mean, median and 5 and 95 % points of the six stresses by each sampler,
with its default effort and several seeds, against long direct samples of the same density (four of 60 000 effective
draws). Printed are, in posterior standard deviations: root mean square, the size that 95 % of errors stay below, and
the largest mean error of a stress over all records and seeds (bias); and the share of errors within twice what the
summary states for each (`mcse_mean`, `mcse_median`, `mcse_low`, `mcse_high`).
"""

import argparse

import numpy as np
import pandas as pd
from posteriors import SCANS, scene
from year import make_year, shipped_noise

import bayes_rs as brs
from bayes_rs.fits.batch import Batch, make_posterior
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.summarizing import summarize_draws
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling import sample
from bayes_rs.posteriors.sampling.effort import Effort

NUMBERS = ("mean", "low", "median", "high")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=48)
    parser.add_argument("--seeds", type=int, default=8)
    arguments = parser.parse_args()
    rows = []
    for name, posterior in scenes(arguments.records):
        keys = np.arange(posterior.n_record)
        runs = [numbers("direct", posterior, keys, 700 + run, 60_000) for run in range(4)]
        exact = {number: np.mean([run[number] for run in runs], axis=0) for number in (*NUMBERS, "sd")}
        for sampler in ("emcee", "direct"):
            found = [numbers(sampler, posterior, keys, seed, 1000) for seed in range(arguments.seeds)]
            for number in NUMBERS:
                error = np.array([run[number] - exact[number] for run in found])
                stated = np.array([run[f"mcse_{number}"] for run in found])
                relative = error / exact["sd"]
                rows.append(
                    {
                        "records": name,
                        "sampler": sampler,
                        "number": number,
                        "rms": float(np.sqrt(np.mean(relative**2))),
                        "95 %": float(np.quantile(np.abs(relative), 0.95)),
                        "bias": float(np.abs(relative.mean(axis=(0, 1))).max()),
                        "within 2 stated": float((np.abs(error) < 2.0 * stated).mean()),
                    }
                )
                print(pd.DataFrame(rows[-1:]).round(4).to_string(index=False, header=len(rows) == 1), flush=True)


def scenes(n_record: int) -> list[tuple[str, Posterior]]:
    """Return posteriors: of the seed's flow under the weak prior, and of records of a year under weak and flat ones."""
    records = np.arange(n_record)
    found = [(name, scene(name).take(records)) for name in SCANS]
    scan = brs.load_scan("6-beam")
    noise = shipped_noise(scan)
    if noise is None:
        raise SystemExit("No noise of the scan is shipped.")
    year = make_year(scan, noise, n_record)
    batch = Batch(
        year["variance"].values,
        np.ones(year["variance"].shape, dtype=np.bool_),
        year["wind_speed"].values,
        np.deg2rad(year["yaw"].values),
        records,
    )
    for prior in ("weak", "flat"):
        options = FitOptions(prior=prior, instrument_noise=0.0)
        found.append((f"year, 6-beam, {prior}", make_posterior(batch, noise, options)[0]))
    return found


def numbers(sampler: str, posterior: Posterior, keys: np.ndarray, seed: int, target_ess: int) -> dict[str, np.ndarray]:
    """Return what a summary states, each (n_record, 6)."""
    chains, _ = sample(sampler, posterior, keys=keys, effort=Effort(seed, target_ess, 5))
    known = {name: getattr(chains, name) for name in ("ess_bulk", "ess_tail", "r_hat")}
    return summarize_draws(chains.stress, (), np.full(len(keys), np.nan), 0.9, "equal-tailed", known)


if __name__ == "__main__":
    main()
