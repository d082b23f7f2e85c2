"""Least squares on a record's variances, which stands beside its posterior: what the data say without a prior."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.fits.batch import Batch, noise_at_median
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.geometry.stress import STRESSES, rotate_stress
from bayes_rs.likelihoods.least_squares import Solved, pseudo_inverse
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.record_noise import RecordNoise

MOST_BEAMS = 128
"""Scans with more beams get no standard errors of least squares: whole covariances would cost more than the fit."""


def least_squares_of(
    batch: Batch, level: FloatArray, noise: Noise, options: FitOptions, at_records: RecordNoise | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the stresses of records by least squares, and their standard errors.

    Parameters
    ----------
    batch : Batch
        Records with a wind speed and a direction.
    level : ndarray, shape (n_beam, 6)
        Design matrix of the beams at yaw 0.
    noise : Noise
        Noise of these beams.
    options : FitOptions
        Of the fit: instrument noise and inflation.
    at_records : RecordNoise, optional
        The noise of these records at the median of their length scales, where it is known.

    Returns
    -------
    stress, standard_error : ndarray, shape (n_record, 6)
        m² s⁻²; NaN where the record's beams do not determine the stress, as for `estimate`. The standard error is NaN,
        too, where least squares give a used beam a variance of zero or less, and for more than `MOST_BEAMS` beams.

    Notes
    -----
    All beams count the same, and are points, as by ``estimate(records, scan, noise=noise)``. Other than there, the
    instrument's noise is taken from the variances first, as far as the fit knows it, a record's own tilt and roll
    count, and noise that the fit inflates is inflated.
    """
    # stresses of the mean-wind frame to those of the levelled lidar, in which beams are the same for all records
    back = rotate_stress(np.eye(len(STRESSES)), yaw_matrix(-batch.yaw)[:, None]).swapaxes(-1, -2)
    rows = np.linalg.inv(back if batch.turn is None else back @ batch.turn)
    uncertain = options.nuisances.instrument_noise_log_sd > 0.0
    of_instrument = batch.median_noise(options) if uncertain else batch.known_noise(options)
    data: FloatArray = np.where(batch.used, batch.variance - of_instrument, 0.0).astype(np.float64)
    patterns, of = np.unique(batch.used, axis=0, return_inverse=True)
    inverse, seen = pseudo_inverse(np.where(patterns[:, :, None], level, 0.0))
    inverse, seen = inverse[of.ravel()], seen[of.ravel()]
    covariance: FloatArray | None = None
    if len(level) <= MOST_BEAMS:
        mean = np.einsum("bp,rpc,rc->rb", level, inverse, data)
        of_noise = noise_at_median(batch, noise, options.nuisances) if at_records is None else at_records
        scale = np.where(batch.used, mean + of_instrument, 0.0)
        positive = ((mean > 0.0) | ~batch.used).all(axis=1)
        scatter = options.nuisances.inflation * scale[:, :, None] * of_noise.covariance * scale[:, None, :]
        covariance = np.asarray(np.where(positive[:, None, None], scatter, np.nan), dtype=np.float64)
    found = Solved.empty(len(batch), len(STRESSES))
    found.put(slice(None), np.asarray(rows, dtype=np.float64), inverse, seen, data, covariance)
    return found.value, found.error
