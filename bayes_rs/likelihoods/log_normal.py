"""The likelihood of the beam variances of many records at once, by name; the log-normal one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.likelihoods.base import (
    REFERENCE_STRESS,
    BeamData,
    Likelihood,
    NormalLikelihood,
    beam_data,
    check_tails,
    log_normalizer,
    whiten_reduced,
)

__all__ = [
    "LIKELIHOODS",
    "REFERENCE_STRESS",
    "Likelihood",
    "LogNormalLikelihood",
    "log_normal_likelihood",
    "make_likelihood",
]

_BLOCK = 65_536
"""Expected variances that are held at once: half a megabyte stays in the cache, a factor of 3 for 400 beams."""


@dataclass(frozen=True)
class LogNormalLikelihood(NormalLikelihood):
    """ln y is normal about ln E[y] − ½ diag C with C = ln(1 + K), after reduction to what the stresses can move.

    Parameters
    ----------
    gain, offset, n_datum, dof, place
        As in `Likelihood`; normal noise unless `dof` is given, the same R for all beams unless `place` is.
    datum : ndarray, shape (n_record, n_seen)
        Whitened, reduced log-variances W (ln y + ½ diag C).
    whitening : ndarray, shape (n_record, n_seen, n_beam)
        W; rows that a record does not need are zero.
    log_normalizer : ndarray, shape (n_record,)
        Log of the density's constant factor.
    along_records : bool
        Whether arrays run along the records in memory, for few draws of many records; see `records_last`.

    Notes
    -----
    For noise of relative covariance K about the mean m, the log-normal vector with these two moments has
    Cov[ln y] = ln(1 + K) and E[ln y] = ln m − ½ diag ln(1 + K) (element by element).

    With more beams than the stresses can move independently, ln y is projected on the column space U of
    ∂ ln m/∂R at a reference shape (and of `place`, what gradients move), and the density is that of Uᵀ ln y, exactly.
    For noise that is the same for all beams up to rotation about the axis this loses nothing; in general it gives up
    the part of the information that sits in the noise's correlation between what R can and cannot explain, and with it
    the dependence on the smallest eigenvalues of K, which no finite number of boxes determines.
    """

    gain: FloatArray
    offset: FloatArray
    datum: FloatArray
    whitening: FloatArray
    log_normalizer: FloatArray
    n_datum: NDArray[np.int64]
    dof: float = np.inf
    place: FloatArray | None = None
    along_records: bool = False

    def records_last(self) -> LogNormalLikelihood:
        """Return the same likelihood with arrays that run along the records in memory."""
        return replace(super().records_last(), along_records=True)

    def _whiten(
        self, stress: FloatArray, offset: FloatArray | None, gradient: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        if self.along_records:
            return self._whiten_along_records(stress, offset, gradient), self.log_normalizer[:, None]
        n_draw, n_beam = stress.shape[1], self.gain.shape[1]
        # in memory, draws are last: each beam and each direction is a run of numbers
        residual = np.empty((self.n_record, self.datum.shape[1], n_draw))
        components = stress.swapaxes(-1, -2)
        n_together = max(1, _BLOCK // max(1, n_draw * n_beam))
        n_of_draws = max(1, _BLOCK // n_beam)
        for first in range(0, self.n_record, n_together):
            part = slice(first, first + n_together)
            for start in range(0, n_draw, n_of_draws):
                draws = slice(start, start + n_of_draws)
                mean = self.gain[part] @ components[part, :, draws]
                if self.place is not None and gradient is not None:
                    mean *= np.exp(self.place[part] @ gradient[part, draws].swapaxes(-1, -2))
                if self.offset[part].any():
                    mean += self.offset[part, :, None]
                if offset is not None:
                    mean += offset[part, None, draws]
                with np.errstate(invalid="ignore", divide="ignore"):  # see NormalLikelihood
                    log_mean = np.log(mean, out=mean)
                whitened = self.whitening[part] @ log_mean
                np.subtract(self.datum[part, :, None], whitened, out=residual[part, :, draws])
        return residual.swapaxes(-1, -2), self.log_normalizer[:, None]

    def _whiten_along_records(
        self, stress: FloatArray, offset: FloatArray | None, gradient: FloatArray | None
    ) -> FloatArray:
        """Return the residuals where all arrays run along the records in memory: sums over beams, not products."""
        mean = np.einsum("rdk,rbk->rdb", stress, self.gain)
        if self.place is not None and gradient is not None:
            mean *= np.exp(np.einsum("rdg,rbg->rdb", gradient, self.place))
        mean += self.offset[:, None, :]
        if offset is not None:
            mean += offset[:, :, None]
        with np.errstate(invalid="ignore", divide="ignore"):  # see NormalLikelihood
            log_mean = np.log(mean, out=mean)
        residual = np.einsum("rdb,rsb->rds", log_mean, self.whitening)
        return np.asarray(np.subtract(self.datum[:, None, :], residual, out=residual))


def log_normal_likelihood(
    variance: FloatArray,
    used: NDArray[np.bool_],
    gain: FloatArray,
    covariance: FloatArray,
    offset: FloatArray | float = 0.0,
    *,
    inflation: float = 1.0,
    dof: float = np.inf,
    reference: FloatArray | None = None,
    place: FloatArray | None = None,
) -> LogNormalLikelihood:
    """Prepare the log-normal likelihood of many records.

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
    inflation : float
        Factor of the covariance of ln y, for flow whose variances scatter more than a Gaussian one's. E[y] stays.
    dof : float
        Degrees of freedom of the noise: see `Likelihood`.
    reference : ndarray, shape (n_beam,), optional
        Expected variances at which more beams than stresses are reduced; by default those of `REFERENCE_STRESS`.
    place : ndarray, shape (n_record, n_beam, n_gradient), optional
        Where the beams measure, for stresses with gradients: see `Likelihood`.

    Returns
    -------
    likelihood : LogNormalLikelihood
        The likelihood.

    Raises
    ------
    InputError
        If a record uses no beam, a used variance is not positive, or an option is not above zero.
    NotPositiveDefiniteError
        If the noise of the reduced data is singular: the noise model says that a combination of stresses is known
        without error.
    """
    check_tails(inflation, dof)
    data = beam_data(variance, used, gain, offset, place)
    log_covariance = inflation * np.log1p(data.relative_covariance(covariance))
    left, seen = data.seen_directions(data.reference_variance(reference))
    return _log_normal(
        data,
        left,
        seen,
        left.swapaxes(-1, -2) @ log_covariance @ left,
        np.einsum("rbb->rb", log_covariance),
        float(dof),
    )


def reduced_log_normal_likelihood(
    variance: FloatArray,
    gain: FloatArray,
    left: FloatArray,
    covariance: FloatArray,
    log_variance: FloatArray,
    offset: FloatArray | float = 0.0,
    *,
    inflation: float = 1.0,
    dof: float = np.inf,
    place: FloatArray | None = None,
) -> LogNormalLikelihood:
    """Prepare the log-normal likelihood of records whose noise was reduced beforehand; every beam is used.

    Parameters
    ----------
    variance : ndarray, shape (n_record, n_beam)
        Radial variances y, m² s⁻².
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain · stresses + offset.
    left : ndarray, shape (n_beam, n_seen)
        Orthonormal basis U of what stresses and gradients can move.
    covariance : ndarray, shape (n_record, n_seen, n_seen)
        Uᵀ ln(1 + K) U.
    log_variance : ndarray, shape (n_record, n_beam)
        diag ln(1 + K).
    offset, inflation, dof, place
        As in `log_normal_likelihood`.

    Returns
    -------
    likelihood : LogNormalLikelihood
        The likelihood.

    Raises
    ------
    InputError, NotPositiveDefiniteError
        As `log_normal_likelihood`.
    """
    check_tails(inflation, dof)
    data = beam_data(variance, np.ones(variance.shape, dtype=np.bool_), gain, offset, place)
    seen = np.ones((len(variance), left.shape[1]), dtype=np.bool_)
    whole = np.broadcast_to(left, (len(variance), *left.shape))
    return _log_normal(data, whole, seen, inflation * covariance, inflation * log_variance, float(dof))


def _log_normal(
    data: BeamData,
    left: FloatArray,
    seen: NDArray[np.bool_],
    reduced: FloatArray,
    log_variance: FloatArray,
    dof: float,
) -> LogNormalLikelihood:
    """Whiten the reduced data."""
    whitening, log_determinant = whiten_reduced(reduced, left, seen, what="log-covariance")
    log_y = np.log(data.variance) + 0.5 * log_variance
    n_datum = seen.sum(axis=1).astype(np.int64)
    return LogNormalLikelihood(
        gain=data.gain,
        offset=data.offset,
        n_datum=n_datum,
        dof=dof,
        datum=np.einsum("rsb,rb->rs", whitening, log_y),
        whitening=whitening,
        log_normalizer=log_normalizer(n_datum, log_determinant, dof),
        place=data.place,
    )


LIKELIHOODS: dict[str, Callable[..., Likelihood]] = {"log-normal": log_normal_likelihood}
"""The likelihoods by name; each call takes variance, used, gain, covariance, offset and the options by name."""


def make_likelihood(
    name: str,
    variance: FloatArray,
    used: NDArray[np.bool_],
    gain: FloatArray,
    covariance: FloatArray,
    offset: FloatArray | float = 0.0,
    *,
    inflation: float = 1.0,
    dof: float = np.inf,
    reference: FloatArray | None = None,
    place: FloatArray | None = None,
) -> Likelihood:
    """Prepare the likelihood that `name` means.

    Parameters
    ----------
    name : str
        One of `LIKELIHOODS`.
    variance, used, gain, covariance, offset, inflation, dof, reference, place
        As in `log_normal_likelihood`.

    Returns
    -------
    likelihood : Likelihood
        The likelihood.

    Raises
    ------
    InputError
        If the name is not known, or the data are invalid.
    NotPositiveDefiniteError
        If the noise of the reduced data is singular.
    """
    maker = LIKELIHOODS[check_choice(name, tuple(LIKELIHOODS), what="likelihood")]
    return maker(
        variance, used, gain, covariance, offset, inflation=inflation, dof=dof, reference=reference, place=place
    )
