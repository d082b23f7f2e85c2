"""What is left out where the covariances of some beams stand for those of all: widths by linear theory.

    python benchmarks/beams_taken.py [SCAN [BEAMS ...]]

Widths of 90 % intervals, m² s⁻², for the number of beams that are taken, up to all: the Gaussian posterior about the
stresses of fu-2022, under the default prior, with the data's covariance and what errors of the coherence do (`fit`'s
defaults, ln L known within 0.135). All pairs of all beams are calculated, none is reduced, so that the last row is what
a scan holds at most, in the model's own air.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import bayes_rs as brs
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.likelihoods.covariances import covariance_forms, factor_products
from bayes_rs.records.beam_correlation import beams_apart
from bayes_rs.theory.beam_covariances import COHERENCE, Views, coherence_slopes, covariance_moments, view_pairs

LENGTH_LOG_SD = 0.135  # of ln L, as simulated records of fu-2022 tell it
N_PRIOR = 20_000
STEP = 1e-4  # of a coordinate of the prior


def widths(scan: brs.Scan, n_beam: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the widths by the variances of some beams, and by their covariances as well."""
    options, flow = FitOptions(), brs.load_turbulence("fu-2022")
    prior = options.made_prior
    covariance = np.cov(prior.draw_coordinate(N_PRIOR, np.random.default_rng(0)).T)
    centre = prior.coordinate(flow.stresses()[np.newaxis])[0]
    chosen = scan.select(beams_apart(scan, n_beam))
    moments = covariance_moments(Views.of_scan(chosen, 0.0), flow, wind_speed=10.0, n_sample=600)
    direction = chosen.at_yaw(0.0)
    first, second = view_pairs(n_beam)
    form = covariance_forms(direction[first], direction[second], moments.tensor, moments.record)
    pair = first[n_beam:], second[n_beam:]

    def data(stress: np.ndarray) -> np.ndarray:
        expected = factor_products(stress) @ form
        own = expected[..., :n_beam]
        correlation = expected[..., n_beam:] / np.sqrt(own[..., pair[0]] * own[..., pair[1]])
        return np.concatenate([np.log(own), np.arctanh(correlation)], axis=-1)

    steps = STEP * np.eye(len(centre))
    high, low = prior.stress(centre + steps), prior.stress(centre - steps)
    of_stress, of_data = ((high - low) / (2.0 * STEP)).T, ((data(high) - data(low)) / (2.0 * STEP)).T
    sd = np.full(len(COHERENCE), options.coherence_log_sd)
    sd[COHERENCE.index("length_scale")] = LENGTH_LOG_SD
    spread = coherence_slopes(Views.of_scan(chosen, 0.0), flow, wind_speed=10.0, n_sample=600) * sd
    found = []
    for seen, of_errors in ((slice(n_beam), 0.0), (slice(None), spread @ spread.T)):
        noise = (moments.covariance + of_errors)[seen, seen]
        information = of_data[seen].T @ np.linalg.solve(noise, of_data[seen])
        posterior = np.linalg.solve(np.eye(len(centre)) + covariance @ information, covariance)
        found.append(3.29 * np.sqrt(np.einsum("si,ij,sj->s", of_stress, posterior, of_stress)))
    return found[0], found[1]


def main() -> None:
    """Print the table."""
    scan = brs.load_scan(sys.argv[1] if len(sys.argv) > 1 else "50-beam")
    numbers = [int(word) for word in sys.argv[2:]] or [4, 6, 8, 12, 16, 24, scan.n_beam]
    print("| beams taken | " + " | ".join(brs.STRESSES) + " | CPU, s |\n" + "|---" * 8 + "|")
    for number in numbers:
        start = time.process_time()
        by_variances, by_both = widths(scan, number)
        for name, values in ((f"{number}, variances", by_variances), (f"{number}", by_both)):
            cells = " | ".join(f"{value:.2f}" for value in values)
            print(f"| {name} | {cells} | {time.process_time() - start:.1f} |", flush=True)


if __name__ == "__main__":
    main()
