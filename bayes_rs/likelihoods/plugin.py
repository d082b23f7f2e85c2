"""The Gaussian likelihood whose noise is fixed beforehand, at variances fitted to the record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.likelihoods.base import (
    BeamData,
    NormalLikelihood,
    beam_data,
    check_tails,
    expected_signal,
    log_normalizer,
    whiten_reduced,
)
from bayes_rs.priors.registry import N_COORDINATE, WeakPrior

_N_ITERATION = 6
_STEP = 1e-4
"""Central difference step of the coordinates."""


@dataclass(frozen=True)
class PluginLikelihood(NormalLikelihood):
    """y is normal about E[y] with covariance D K D, D = diag of fitted variances, after reduction.

    Parameters
    ----------
    gain, offset, n_datum, dof, place
        As in `Likelihood`.
    datum : ndarray, shape (n_record, n_seen)
        Whitened, reduced variances W D⁻¹ (y − offset).
    response : ndarray, shape (n_record, n_seen, 6)
        W D⁻¹ gain.
    floor : ndarray, shape (n_record, n_seen)
        W D⁻¹ 1: what a unit of instrument noise on all beams adds.
    log_normalizer : ndarray, shape (n_record,)
        Log of the density's constant factor.
    projection : ndarray or None, shape (n_record, n_seen, n_beam)
        W D⁻¹, where there is a `place`.

    Notes
    -----
    The noise does not depend on R, so a draw costs a 6 × 6 product however many beams there are (unless R has
    gradients). D is the expected
    variance at a fit of the record, not y: a beam with a low y by chance would get a small error and pull the fit down.
    With no more beams than stresses, least squares returns y itself; so the fit is a few Gauss–Newton steps of ln y
    towards the mode under the prior ``"weak"``, whatever prior the posterior is for.

    The data are D⁻¹y, projected on the column space U of D⁻¹·gain as in `LogNormalLikelihood`; generalized least
    squares would project on K⁻¹U, and needs a K without errors in its smallest eigenvalues. D, and with it the reduced
    data, depends on K: densities of different K must not be compared or averaged.
    """

    gain: FloatArray
    offset: FloatArray
    datum: FloatArray
    response: FloatArray
    floor: FloatArray
    log_normalizer: FloatArray
    n_datum: NDArray[np.int64]
    dof: float = np.inf
    place: FloatArray | None = None
    projection: FloatArray | None = None

    def _whiten(
        self, stress: FloatArray, offset: FloatArray | None, gradient: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        if self.projection is not None and gradient is not None:
            signal = expected_signal(stress, self.gain, self.place, gradient)
            residual = self.datum[:, None, :] - signal @ self.projection.swapaxes(-1, -2)
        else:
            residual = self.datum[:, None, :] - stress @ self.response.swapaxes(-1, -2)
        if offset is not None:
            residual = residual - offset[:, :, None] * self.floor[:, None, :]
        return np.asarray(residual), self.log_normalizer[:, None]


def plugin_likelihood(
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
) -> PluginLikelihood:
    """Prepare the Gaussian likelihood with fixed noise of many records.

    Parameters
    ----------
    variance, used, gain, covariance, offset, inflation, dof, reference, place
        As in `log_normal_likelihood`; `inflation` multiplies K.

    Returns
    -------
    likelihood : PluginLikelihood
        The likelihood.

    Raises
    ------
    InputError
        If a record uses no beam, a used variance is not positive, or an option is not above zero.
    NotPositiveDefiniteError
        If the noise of the reduced data is singular.
    """
    check_tails(inflation, dof)
    data = beam_data(variance, used, gain, offset, place)
    relative = inflation * data.relative_covariance(covariance)
    fitted = fitted_variance(data, relative, reference)
    left, seen = data.seen_directions(fitted)
    # the density of Uᵀ D⁻¹ y; D is fixed, so its determinant would only be another constant
    reduced = left.swapaxes(-1, -2) @ relative @ left
    scaled, log_determinant = whiten_reduced(reduced, left / fitted[:, :, None], seen, what="covariance")
    n_datum = seen.sum(axis=1).astype(np.int64)
    return PluginLikelihood(
        gain=data.gain,
        offset=data.offset,
        datum=np.einsum("rsb,rb->rs", scaled, data.variance - data.offset),
        response=scaled @ data.gain,
        floor=scaled.sum(axis=2),
        log_normalizer=log_normalizer(n_datum, log_determinant, dof),
        n_datum=n_datum,
        dof=float(dof),
        place=data.place,
        projection=None if data.place is None else scaled,
    )


def fitted_variance(data: BeamData, covariance: FloatArray, reference: FloatArray | None = None) -> FloatArray:
    """Return smooth expected variances, shape (n_record, n_beam), of records with relative covariance K (masked).

    Gauss–Newton steps for ln y = ln E[y](φ) + noise of covariance K (reduced) with the prior ``"weak"`` on its
    coordinates φ (and standard normal gradients, where there is a `place`); the result is the expectation for a
    realizable tensor, always positive.
    """
    prior = WeakPrior()
    left, seen = data.seen_directions(data.reference_variance(reference))
    whitening, _ = whiten_reduced(left.swapaxes(-1, -2) @ covariance @ left, left, seen, what="covariance")
    log_y = np.log(data.variance)
    n_used = data.used.sum(axis=1)
    n = N_COORDINATE + (0 if data.place is None else data.place.shape[-1])

    def expected(coordinate: FloatArray) -> FloatArray:
        stress, gradient = prior.stress(coordinate[..., :N_COORDINATE]), coordinate[..., N_COORDINATE:]
        return expected_signal(stress, data.gain, data.place, gradient) + data.offset[:, None, :]

    coordinate = np.zeros((len(data.variance), n))
    level = np.where(
        data.used, log_y - np.log(data.gain @ prior.stress(coordinate[0, :N_COORDINATE]) + data.offset), 0.0
    )
    coordinate[:, 0] = level.sum(axis=1) / n_used / prior.log_sd_uu
    shift = _STEP * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
    for _ in range(_N_ITERATION):
        log_mean = np.log(expected(coordinate[:, None, :] + shift))
        residual = (log_y[:, None, :] - log_mean) @ whitening.swapaxes(-1, -2)
        jacobian = (residual[:, 1 : n + 1] - residual[:, n + 1 :]) / (2.0 * _STEP)
        gradient = np.einsum("rks,rs->rk", jacobian, residual[:, 0]) + coordinate
        precision = jacobian @ jacobian.swapaxes(-1, -2) + np.eye(n)
        coordinate = coordinate - np.linalg.solve(precision, gradient[:, :, None])[:, :, 0]
    signal = np.einsum("rbk,rk->rb", data.gain, prior.stress(coordinate[:, :N_COORDINATE]))
    if data.place is not None:
        signal *= np.exp(np.einsum("rbg,rg->rb", data.place, coordinate[:, N_COORDINATE:]))
    return np.asarray(signal + data.offset)
