"""Run time against error of the campaign posterior: python benchmarks/campaign_error.py [--records 150] [--runs 3].

Six beams at 45° and at 15°; records are drawn from a campaign with a scatter and a dependence on wind speed of its own.
Error: root mean square, over seeds, the means of the six coordinates and their standard deviations, of the distance of
a run's posterior mean from that of a long run, in posterior standard deviations. Time: CPU of one process with one
thread.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from functools import partial

import numpy as np
import pandas as pd
from measuring import spent, table

import bayes_rs as brs
from bayes_rs.campaign import CampaignPosterior
from bayes_rs.campaign.sampling import TARGET_ESS, sample_campaign
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.priors.registry import WeakPrior

TARGETS = (TARGET_ESS, 4 * TARGET_ESS)
LONG = 1600
"""Effective size of the long run."""
SCATTER = np.diag([0.1, 0.3, 0.4, 0.3, 0.3, 0.3]) ** 2
SCALING = (50, 150, 500, 1500)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=150)
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    print(error_against_time(arguments.records, arguments.runs))
    print(scaling(SCALING))


def error_against_time(n_record: int, runs: int) -> str:
    """Return a table of the CPU and the error at several targets of the effective size."""
    rows = []
    for angle in (45.0, 15.0):
        posterior, speed = scene(angle, n_record)
        long = sample_campaign(posterior, speed, seed=1, target_ess=LONG, most_sweeps=40_000)
        middle, width = told(long)
        for target in TARGETS:
            seconds, errors, sweeps = [], [], []
            for seed in range(2, 2 + runs):
                took = spent(partial(sample_campaign, posterior, speed, seed=seed, target_ess=target))
                seconds.append(took.cpu)
                errors.append((told(took.result)[0] - middle) / width)
                sweeps.append(took.result.n_sweep)
            rows.append(
                {
                    "scan": f"6-beam, {angle:g}°",
                    "records": n_record,
                    "effective size asked for": f"{target}{' (default)' if target == TARGET_ESS else ''}",
                    "sweeps": f"{np.median(sweeps):.0f}",
                    "CPU, s": f"{np.median(seconds):.1f}",
                    "error": f"{np.sqrt(np.mean(np.square(errors))):.3f}",
                }
            )
    return table(pd.DataFrame(rows))


def scaling(counts: tuple[int, ...]) -> str:
    """Return a table of the CPU against the number of records, at the default target."""
    rows = []
    for count in counts:
        posterior, speed = scene(45.0, count)
        took = spent(partial(sample_campaign, posterior, speed, seed=2))
        rows.append(
            {
                "records": count,
                "sweeps": took.result.n_sweep,
                "CPU, s": f"{took.cpu:.1f}",
                "ms a record": f"{1e3 * took.cpu / count:.0f}",
                "target reached": "yes" if took.result.converged else "no",
            }
        )
    return table(pd.DataFrame(rows))


def told(campaign: CampaignPosterior) -> tuple[np.ndarray, np.ndarray]:
    """Return posterior means, and half-widths as standard deviations, of the means and spreads of the coordinates."""
    rows = campaign.hyper[campaign.hyper["name"].str.match("mean|sd ")]
    return rows["mean"].to_numpy(), (rows["high"] - rows["low"]).to_numpy() / (2.0 * 1.645)


def scene(angle: float, n_record: int) -> tuple[Posterior, np.ndarray]:
    """Return the posteriors of a campaign's records under the prior `weak`, and their wind speeds."""
    rng = np.random.default_rng(1)
    scan, flow = brs.load_scan("6-beam", opening_angle_deg=angle), brs.load_turbulence("fu-2022")
    noise = brs.noise.theory(scan, flow, wind_speed=10.0)
    speed = rng.uniform(6.0, 14.0, n_record)
    prior = WeakPrior()
    coordinate = rng.standard_normal((n_record, 6)) @ np.sqrt(SCATTER) + [0.0, 0.2, -0.3, 0.1, -0.2, 0.0]
    coordinate[:, 0] += np.log(speed / 10.0)
    log_covariance = np.log1p(noise.covariance[0])
    values, vectors = np.linalg.eigh(log_covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scatter = rng.standard_normal((n_record, scan.n_beam)) @ root.T - 0.5 * np.diag(log_covariance)
    gain = np.broadcast_to(noise.gain[0], (n_record, *noise.gain[0].shape))
    mean = np.einsum("rbk,rk->rb", gain, prior.stress(coordinate))
    covariance = np.broadcast_to(noise.covariance[0], (n_record, scan.n_beam, scan.n_beam))
    used = np.ones(mean.shape, dtype=np.bool_)
    return Posterior(log_normal_likelihood(mean * np.exp(scatter), used, gain, covariance, 0.0), prior), speed


if __name__ == "__main__":
    main()
