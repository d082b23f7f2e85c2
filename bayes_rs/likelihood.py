"""The likelihood of the beam variances of many records at once, log-normal with the noise model's covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.forward import RANK_TOLERANCE

REFERENCE_STRESS = np.array([1.0, 0.5, 0.27, 0.0, -0.15, 0.0])
"""Shape of R at which the data are reduced: near neutral flow. Another choice moves weight between beams, not truth."""


@dataclass(frozen=True)
class LogNormalLikelihood:
    """ln y is normal about ln E[y] − ½ diag C with C = ln(1 + K), after reduction to what the stresses can move.

    Parameters
    ----------
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain · stresses + offset; rows of beams that a record does not use are zero.
    offset : ndarray, shape (n_record, n_beam)
        Variance of the instrument's own noise, m² s⁻²; 1 for beams that a record does not use.
    datum : ndarray, shape (n_record, n_seen)
        Whitened, reduced log-variances W (ln y + ½ diag C).
    whitening : ndarray, shape (n_record, n_seen, n_beam)
        W; rows that a record does not need are zero.
    log_normalizer : ndarray, shape (n_record,)
        Log of the density's constant factor.
    n_datum : ndarray of int, shape (n_record,)
        Number of independent numbers that the record's variances were reduced to.

    Notes
    -----
    For noise of relative covariance K about the mean m, the log-normal vector with these two moments has
    Cov[ln y] = ln(1 + K) and E[ln y] = ln m − ½ diag ln(1 + K) (element by element).

    With more beams than the stresses can move independently, ln y is projected on the column space U of
    ∂ ln m/∂R at a reference shape, and the density is that of Uᵀ ln y, exactly. For noise that is the same for all
    beams up to rotation about the axis this loses nothing; in general it gives up the part of the information that sits
    in the noise's correlation between what R can and cannot explain, and with it the dependence on the smallest
    eigenvalues of K, which no finite number of boxes determines.
    """

    gain: FloatArray
    offset: FloatArray
    datum: FloatArray
    whitening: FloatArray
    log_normalizer: FloatArray
    n_datum: np.ndarray[tuple[int], np.dtype[np.int64]]

    def whitened_residual(self, stress: FloatArray) -> FloatArray:
        """Return the whitened residuals, shape (n_record, n_draw, n_seen), of stresses (n_record, n_draw, 6)."""
        mean = stress @ self.gain.swapaxes(-1, -2) + self.offset[:, None, :]
        with np.errstate(invalid="ignore", divide="ignore"):  # see log_density
            log_mean = np.log(mean)
        return np.asarray(self.datum[:, None, :] - log_mean @ self.whitening.swapaxes(-1, -2))

    def log_density(self, stress: FloatArray) -> FloatArray:
        """Return the log-likelihood, shape (n_record, n_draw), of stresses (n_record, n_draw, 6).

        A tensor for which a beam's expected variance is not positive has likelihood zero. For points that is a tensor
        of rank one across the beam, to rounding; with a probe volume the gain is interpolated, and is a positive form
        only up to the error of the interpolation.
        """
        with np.errstate(invalid="ignore"):
            residual = self.whitened_residual(stress)
            density = self.log_normalizer[:, None] - 0.5 * np.einsum("rds,rds->rd", residual, residual)
        return np.where(np.isfinite(density), density, -np.inf)

    def take(self, records: np.ndarray[tuple[int], np.dtype[np.int64]]) -> LogNormalLikelihood:
        """Return the likelihood of some of the records."""
        return LogNormalLikelihood(
            gain=self.gain[records],
            offset=self.offset[records],
            datum=self.datum[records],
            whitening=self.whitening[records],
            log_normalizer=self.log_normalizer[records],
            n_datum=self.n_datum[records],
        )


def log_normal_likelihood(
    variance: FloatArray,
    used: np.ndarray[tuple[int, int], np.dtype[np.bool_]],
    gain: FloatArray,
    covariance: FloatArray,
    offset: FloatArray | float = 0.0,
) -> LogNormalLikelihood:
    """Prepare the likelihood of many records.

    Parameters
    ----------
    variance : ndarray, shape (n_record, n_beam)
        Radial variances y, m² s⁻².
    used : ndarray of bool, shape (n_record, n_beam)
        Which of them to use; each record needs at least one.
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain · stresses + offset.
    covariance : ndarray, shape (n_record, n_beam, n_beam)
        Relative covariance K of the variances.
    offset : ndarray or float, shape (n_record, n_beam)
        Variance of the instrument's own noise, m² s⁻².

    Returns
    -------
    likelihood : LogNormalLikelihood
        The likelihood.

    Raises
    ------
    InputError
        If a record uses no beam, or a used variance is not positive.
    NotPositiveDefiniteError
        If the noise of the reduced data is singular: the noise model says that a combination of stresses is known
        without error.
    """
    n_beam = variance.shape[1]
    idle = np.flatnonzero(~used.any(axis=1))
    if len(idle):
        raise InputError(f"Record {idle[0]} has no usable beam: leave such records out before the likelihood is built.")
    bad = np.argwhere(used & ~(variance > 0.0))
    if len(bad):
        record, beam = (int(i) for i in bad[0])
        raise InputError(
            f"Invalid variance {variance[record, beam]} of record {record}, beam {beam}: it must be positive; "
            "flag the beam."
        )
    gain = np.where(used[:, :, None], gain, 0.0)
    offset = np.where(used, np.broadcast_to(np.asarray(offset, dtype=np.float64), variance.shape), 1.0)
    log_covariance = np.log1p(np.where(used[:, :, None] & used[:, None, :], covariance, 0.0))
    reference = np.where(used, gain @ REFERENCE_STRESS, 1.0)
    left, singular, _ = np.linalg.svd(gain / reference[:, :, None], full_matrices=False)
    seen = singular > RANK_TOLERANCE * singular[:, :1]
    left = left * seen[:, None, :]
    reduced = left.swapaxes(-1, -2) @ log_covariance @ left
    smallest = np.min(
        np.linalg.eigvalsh(reduced + np.eye(seen.shape[1]) * np.where(seen, 0.0, 1.0)[:, None, :]), axis=-1
    )
    worst = int(np.argmin(smallest))
    if smallest[worst] <= n_beam * np.finfo(np.float64).eps * np.max(np.abs(reduced[worst])):
        raise NotPositiveDefiniteError(
            f"The noise of record {worst} is singular: the smallest eigenvalue of its reduced log-covariance is "
            f"{smallest[worst]:.3g} and must be positive; use a noise model with more realizations, or fewer beams.",
            smallest_eigenvalue=float(smallest[worst]),
        )
    # directions that a record does not have get a unit pivot and a zero row: no part in residual and determinant
    factor = np.linalg.cholesky(reduced + np.eye(seen.shape[1]) * np.where(seen, 0.0, 1.0)[:, None, :])
    whitening = np.linalg.solve(factor, left.swapaxes(-1, -2))
    log_y = np.log(np.where(used, variance, 1.0)) + 0.5 * np.einsum("rbb->rb", log_covariance)
    n_datum = seen.sum(axis=1)
    log_determinant = 2.0 * np.log(np.einsum("rss->rs", factor)).sum(axis=1)
    return LogNormalLikelihood(
        gain=gain,
        offset=offset,
        datum=np.einsum("rsb,rb->rs", whitening, log_y),
        whitening=whitening,
        log_normalizer=-0.5 * (log_determinant + n_datum * np.log(2.0 * np.pi)),
        n_datum=n_datum.astype(np.int64),
    )
