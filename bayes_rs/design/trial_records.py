"""Records on which scans are tried: variances at one state of the flow, drawn evenly or simulated."""

from __future__ import annotations

import numpy as np
import scipy
import xarray as xr

from bayes_rs._validation import FloatArray, as_generator
from bayes_rs.even_points import even_points
from bayes_rs.geometry.forward import RANK_TOLERANCE
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise import Noise
from bayes_rs.records.making import make_records
from bayes_rs.simulation.virtual import simulate
from bayes_rs.turbulence.mann import MannTurbulence

_SMALLEST = 1e-9  # eigenvalues of Σ below this part of the largest are rounding and the error of K


def even_normals(count: int, n_dimension: int, seed: int) -> FloatArray:
    """Return standard normal numbers, shape (count, n_dimension), evenly: normal scores of Sobol points."""
    return np.asarray(scipy.special.ndtri(even_points(count, n_dimension, as_generator(seed))))


def explained_errors(noise: Noise, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the errors of log-variances, as the noise has them, and which of their directions some R explains.

    Parameters
    ----------
    noise : Noise
        Noise of the record, with the relative covariance K.
    truth : ndarray, shape (6,)
        The stresses.

    Returns
    -------
    root : ndarray, shape (n_beam, n_beam)
        Σ^(1/2) with Σ = ln(1 + K), symmetric: the errors are Σ^(1/2) z with z of independent, standard normal numbers.
    turn : ndarray, shape (n_beam, 6)
        U Vᵀ of the singular value decomposition Σ^(-1/2) S = U s Vᵀ, where S = ∂ ln E[y]/∂R at the truth. Its columns
        span the z that some R explains, and it changes as smoothly as the scan does.
    """
    values, vectors = np.linalg.eigh(np.log1p(noise.covariance[0]))
    size = np.sqrt(np.maximum(values, _SMALLEST * values[-1]))
    whitened = (vectors / size) @ vectors.T
    slope = noise.gain[0] / (noise.gain[0] @ truth)[:, np.newaxis]
    left, seen, right = np.linalg.svd(whitened @ slope, full_matrices=False)
    kept = seen > RANK_TOLERANCE * seen[0]
    return (vectors * size) @ vectors.T, left[:, kept] @ right[kept]


def drawn_records(scan: Scan, noise: Noise, mean: FloatArray, truth: FloatArray, count: int, seed: int) -> xr.Dataset:
    """Return records whose variances are log-normal with the noise's moments, drawn evenly.

    Parameters
    ----------
    scan : Scan
        The scan.
    noise : Noise
        Its noise.
    mean : ndarray, shape (n_beam,)
        Expected variances, m² s⁻².
    truth : ndarray, shape (6,)
        The stresses, m² s⁻².
    count : int
        Number of records.
    seed : int
        Same seed, same numbers.

    Returns
    -------
    records : Dataset
        The records.

    Notes
    -----
    The errors that some R explains come from the same six numbers a record for every scan, so that scans differ by what
    they are and little by the draw. The other errors, of which there are some if there are more beams than the stresses
    can move independently, come from numbers of their own.
    """
    root, turn = explained_errors(noise, truth)
    white = even_normals(count, len(STRESSES), seed) @ turn.T
    inside, seen, _ = np.linalg.svd(turn, full_matrices=False)
    inside = inside[:, seen > RANK_TOLERANCE]
    if inside.shape[1] < scan.n_beam:
        # another order of the points: without it they would go up and down with those of the explained errors
        other = np.random.default_rng([seed, 1]).permutation(even_normals(count, scan.n_beam, seed))
        white += other - (other @ inside) @ inside.T
    variance = mean * np.exp(white @ root - 0.5 * np.log1p(np.diag(noise.covariance[0])))
    return trial_records(scan, noise, variance)


def simulated_records(
    scan: Scan, flow: MannTurbulence, wind_speed: float, duration: float, count: int, seed: int
) -> xr.Dataset:
    """Return records of simulated radial velocities; their wind is the one that was simulated."""
    series = simulate(scan, flow, wind_speed=wind_speed, duration=duration, n_records=count, seed=seed)
    records = make_records(series, scan, duration=duration).isel(record=slice(0, count))
    records["wind_speed"] = ("record", np.full(count, wind_speed))
    records["yaw"] = ("record", np.full(count, np.rad2deg(scan.yaw)))
    return records


def trial_records(scan: Scan, noise: Noise, variance: FloatArray) -> xr.Dataset:
    """Return records of these variances, shape (n_record, n_beam), in the wind that the noise is for."""
    count = len(variance)
    return xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.int64)),
            "wind_speed": ("record", np.full(count, noise.wind_speed[0])),
            "yaw": ("record", np.full(count, np.rad2deg(noise.yaw[0]))),
        },
        coords={"beam": scan.beam},
        attrs={"duration": noise.duration, "scan": scan.name, "scan_key": scan.key},
    )
