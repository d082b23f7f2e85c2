"""How well a few beams stand for all in the log-normal likelihood: W ln m from the ln m of q selected beams.

python benchmarks/beam_selection.py

The beams are picked by pivoted QR of ln m over 4000 tensors, half from each prior, turned about the vertical by up to
60° as records of other wind directions are; the others are interpolated by least squares, constants exactly. Printed is
the error of the whitened residuals, in their standard deviations, over 4000 other tensors. About a minute.
"""

import numpy as np
import scipy.linalg

import bayes_rs as brs
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.priors.registry import make_prior

SCANS = {"50-beam": (30, 40), "51-beam": (30, 40), "spinnerlidar": (40, 120, 200)}
N_TENSOR = 2000
MOST_YAW = np.pi / 3.0
SEED = 7


def turned(stress: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Turn tensors, shape (n, 6), about the vertical."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.zeros((len(stress), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = cosine
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -sine, sine, 1.0
    matrix = stress[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    new = turn @ matrix @ turn.swapaxes(1, 2)
    return new[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def tensors(prior: str, rng: np.random.Generator) -> np.ndarray:
    """Draw tensors of a prior, and turn each."""
    return turned(make_prior(prior).draw(N_TENSOR, rng), rng.uniform(-MOST_YAW, MOST_YAW, N_TENSOR))


def interpolation(log_mean: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which `count` beams to keep, and T (n_beam, count) with rows that sum to 1."""
    shape = log_mean - log_mean.mean(axis=1, keepdims=True)
    kept = scipy.linalg.qr(shape, pivoting=True, mode="r")[1][:count]
    level = log_mean[:, kept].mean(axis=1, keepdims=True)
    about = np.linalg.lstsq(log_mean[:, kept] - level, log_mean - level, rcond=1e-12)[0].T
    return kept, about + (1.0 - about.sum(axis=1, keepdims=True)) / count


def main() -> None:
    """Print a row for each scan, number of kept beams and prior."""
    rng = np.random.default_rng(SEED)
    turbulence = brs.load_turbulence("fu-2022")
    train = np.concatenate([tensors("weak", rng), tensors("flat", rng)])
    test = {prior: tensors(prior, rng) for prior in ("weak", "flat")}
    for name, counts in SCANS.items():
        scan = brs.load_scan(name, probe="point")
        matrix = brs.geometry.design_matrix(scan)
        covariance = brs.noise.calibrate(scan, turbulence, wind_speed=10.0).covariance[0]
        every = np.ones((1, scan.n_beam))
        whitening = log_normal_likelihood(every, every > 0.0, matrix[None], covariance[None]).whitening[0]
        log_mean = np.log(train @ matrix.T)
        for count in counts:
            kept, to_all = interpolation(log_mean, count)
            cells = [name, f"{count} of {scan.n_beam}"]
            for stress in test.values():
                wanted = np.log(stress @ matrix.T)
                error = np.abs((wanted - wanted[:, kept] @ to_all.T) @ whitening.T).max(axis=1)
                cells += [f"{np.quantile(error, 0.99):.0e}", f"{error.max():.0e}"]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
