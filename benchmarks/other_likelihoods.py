"""Likelihoods beside the log-normal one, for comparison: Gaussian, gamma, and Gaussian with noise fixed beforehand.

`register` gives them to the package by name. Those of powers of the variances, Gaussian (power 1) and gamma (cube
root), have noise that grows with R; that of ``gaussian-plugin`` is fixed at variances fitted to the record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.likelihoods.base import (
    BeamData,
    Likelihood,
    NormalLikelihood,
    beam_data,
    check_tails,
    expected_signal,
    factor_reduced,
    log_normalizer,
    unit_pivots,
    whiten_reduced,
)
from bayes_rs.likelihoods.log_normal import LIKELIHOODS
from bayes_rs.priors.registry import N_COORDINATE, WeakPrior

_CUBE_ROOT = 1.0 / 3.0
_DROPPED = 1e-9
"""Share of the smallest reduced eigenvalue that the dropped eigenvalues of the noise may have together."""
_NUMBERS = 2_000_000
"""Numbers that are held at once for the covariances of the draws: 16 MB. Memory, not the result, depends on it."""
_N_ITERATION = 6
_STEP = 1e-4
"""Central difference step of the coordinates."""


@dataclass(frozen=True)
class PowerLikelihood(NormalLikelihood):
    """y^p is normal, with mean μ m^p and covariance diag(m^p) C diag(m^p), after reduction; m = E[y] depends on R.

    Parameters
    ----------
    gain, offset, n_datum, dof, place
        As in `Likelihood`.
    power : float
        p, 1 or 1/3.
    reference : ndarray, shape (n_record, n_beam)
        Expected variances m₀ of the reference shape.
    datum : ndarray, shape (n_record, n_seen)
        Reduced data z = Uᵀ (y/m₀)^p.
    left : ndarray, shape (n_record, n_beam, n_seen)
        U: orthonormal, zero for beams and directions that a record does not have.
    centre : ndarray, shape (n_record, n_beam)
        μ.
    root, sign : ndarray, shapes (n_record, n_beam, n_root) and (n_record, n_root)
        C = root · diag(sign) · rootᵀ.
    seen : ndarray of bool, shape (n_record, n_seen)
        Which directions a record has.

    Notes
    -----
    The statistic z is a fixed function of the data, so that its density at different R may be compared: it is normal
    with mean Uᵀ q μ and covariance Uᵀ diag(q) C diag(q) U, q = (m/m₀)^p, and the determinant of that covariance counts.
    It has no part in the residuals: its logarithm is nearly linear in ln R, and adds no curvature.

    p = 1: μ = 1 and C = K, the moments of the noise model as they are; y itself is Gaussian.

    p = 1/3: a gamma variable of mean m and relative variance K has a nearly normal cube root about m^(1/3) (1 − K/9)
    of variance m^(2/3) K/9 (Wilson and Hilferty 1931). The entries of C are such that the cubes of the normal numbers
    have the relative covariance K: with v = K_bb/9, μ = 1 − v, s = μ² + v,
    9 s_a s_b C_ab + 18 μ_a μ_b C_ab² + 6 C_ab³ = K_ab.

    References
    ----------
    Wilson and Hilferty (1931), Proc. Natl. Acad. Sci. 17, 684–688, doi:10.1073/pnas.17.12.684.
    """

    gain: FloatArray
    offset: FloatArray
    power: float
    reference: FloatArray
    datum: FloatArray
    left: FloatArray
    centre: FloatArray
    root: FloatArray
    sign: FloatArray
    seen: NDArray[np.bool_]
    n_datum: NDArray[np.int64]
    dof: float = np.inf
    place: FloatArray | None = None

    def _whiten(
        self, stress: FloatArray, offset: FloatArray | None, gradient: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        n_draw, n_root, n_seen = stress.shape[1], self.root.shape[2], self.left.shape[2]
        residual, log_determinant = np.empty((*stress.shape[:2], n_seen)), np.empty(stress.shape[:2])
        step = max(1, _NUMBERS // max(1, n_draw * n_root * n_seen))
        for start in range(0, self.n_record, step):
            part = slice(start, start + step)
            place = None if self.place is None else self.place[part]
            mean = expected_signal(stress[part], self.gain[part], place, None if gradient is None else gradient[part])
            mean = mean + self.offset[part, None, :]
            if offset is not None:
                mean = mean + offset[part, :, None]
            scale = np.where(mean > 0.0, mean / self.reference[part, None, :], np.nan) ** self.power
            left = self.left[part]
            difference = self.datum[part, None, :] - (scale * self.centre[part, None, :]) @ left
            spread = (left[:, :, :, None] * self.root[part, :, None, :]).reshape(len(left), left.shape[1], -1)
            spread = (scale @ spread).reshape(*scale.shape[:2], n_seen, n_root)
            covariance = (spread * self.sign[part, None, None, :]) @ spread.swapaxes(-1, -2)
            covariance += unit_pivots(self.seen[part])[:, None]
            residual[part], log_determinant[part] = _whitened(covariance, difference)
        return residual, log_normalizer(self.n_datum[:, None], log_determinant, self.dof)


def power_likelihood(
    variance: FloatArray,
    used: NDArray[np.bool_],
    gain: FloatArray,
    covariance: FloatArray,
    offset: FloatArray | float = 0.0,
    *,
    power: float,
    inflation: float = 1.0,
    dof: float = np.inf,
    reference: FloatArray | None = None,
    place: FloatArray | None = None,
) -> PowerLikelihood:
    """Prepare the likelihood of powers of the variances of many records.

    Parameters
    ----------
    variance, used, gain, covariance, offset
        As in `log_normal_likelihood`.
    power : float
        1 or 1/3.
    inflation, dof, reference, place
        As in `log_normal_likelihood`; `inflation` multiplies K.

    Returns
    -------
    likelihood : PowerLikelihood
        The likelihood.

    Raises
    ------
    InputError
        If a record uses no beam, a used variance is not positive, or an option is invalid.
    NotPositiveDefiniteError
        If the noise of the reduced data is singular at the reference shape.
    """
    check_tails(inflation, dof)
    data = beam_data(variance, used, gain, offset, place)
    centre, of_power = power_moments(inflation * data.relative_covariance(covariance), power)
    scale = data.reference_variance(reference)
    left, seen = data.seen_directions(scale)
    reduced = left.swapaxes(-1, -2) @ of_power @ left
    factor_reduced(reduced, seen, variance.shape[1], what="covariance")
    root, sign = _signed_root(of_power, np.linalg.eigvalsh(reduced + unit_pivots(seen)).min(axis=1))
    return PowerLikelihood(
        gain=data.gain,
        offset=data.offset,
        power=power,
        reference=scale,
        datum=np.einsum("rbs,rb->rs", left, (data.variance / scale) ** power),
        left=left,
        centre=centre,
        root=root,
        sign=sign,
        seen=seen,
        n_datum=seen.sum(axis=1).astype(np.int64),
        dof=float(dof),
        place=data.place,
    )


def power_moments(covariance: FloatArray, power: float) -> tuple[FloatArray, FloatArray]:
    """Return mean μ and covariance C of (y/m)^p that give y/m the mean 1 and the covariance K (see `PowerLikelihood`).

    Parameters
    ----------
    covariance : ndarray, shape (..., n_beam, n_beam)
        K.
    power : float
        1 or 1/3. For 1/3 the moments of y/m are right to a few (K_bb/9)⁴.

    Returns
    -------
    centre : ndarray, shape (..., n_beam)
        μ.
    of_power : ndarray, shape (..., n_beam, n_beam)
        C.

    Raises
    ------
    InputError
        If the power is neither 1 nor 1/3.
    """
    ninth = np.diagonal(covariance, axis1=-2, axis2=-1) / 9.0
    if power == 1.0:
        return np.ones_like(ninth), covariance
    if power != _CUBE_ROOT:
        raise InputError(f"Invalid power {power!r}: it must be 1 or 1/3.")
    centre = 1.0 - ninth
    linear = centre**2 + ninth
    first = 9.0 * linear[..., :, None] * linear[..., None, :]
    second = 18.0 * centre[..., :, None] * centre[..., None, :]
    of_power = covariance / 9.0
    for _ in range(6):  # Newton: the error is squared each time, from K² at first
        value = (first + (second + 6.0 * of_power) * of_power) * of_power
        slope = first + (2.0 * second + 18.0 * of_power) * of_power
        of_power = of_power - (value - covariance) / slope
    return centre, of_power


def _signed_root(matrices: FloatArray, smallest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return F and signs s with F diag(s) Fᵀ = C, without eigenvalues that are nothing beside `smallest`."""
    values, vectors = np.linalg.eigh(matrices)
    order = np.argsort(-np.abs(values), axis=1)
    values = np.take_along_axis(values, order, axis=1)
    tail = np.cumsum(np.abs(values)[:, ::-1], axis=1)[:, ::-1]
    n_root = max(1, int(np.max(np.count_nonzero(tail > _DROPPED * smallest[:, None], axis=1))))
    values = values[:, :n_root]
    vectors = np.take_along_axis(vectors, order[:, None, :n_root], axis=2)
    return np.asarray(vectors * np.sqrt(np.abs(values))[:, None, :]), np.sign(values)


def _whitened(covariance: FloatArray, difference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return L⁻¹d and ln det(LLᵀ) by Cholesky factors L of all matrices at once; NaN where there is none."""
    n = difference.shape[-1]
    factor: list[list[FloatArray]] = [[] for _ in range(n)]  # factor[i][k] for k ≤ i
    whitened = np.empty_like(difference)
    log_determinant = np.zeros(difference.shape[:-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(n):
            below = [covariance[..., i, j] - _dot(factor[i], factor[j]) for i in range(j, n)]
            pivot = np.sqrt(np.where(below[0] > 0.0, below[0], np.nan))
            log_determinant += 2.0 * np.log(pivot)
            rest = difference[..., j] - _dot(factor[j], [whitened[..., k] for k in range(j)])
            whitened[..., j] = rest / pivot
            for i in range(j, n):
                factor[i].append(below[i - j] / pivot)
    return whitened, log_determinant


def _dot(first: list[FloatArray], second: list[FloatArray]) -> FloatArray | float:
    """Return Σ_k a_k b_k over the entries that both lists have."""
    total: FloatArray | float = 0.0
    for a, b in zip(first, second, strict=False):
        total = total + a * b
    return total


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


OTHER_LIKELIHOODS: dict[str, Callable[..., Likelihood]] = {
    "gaussian-plugin": plugin_likelihood,
    "gaussian": partial(power_likelihood, power=1.0),
    "gamma": partial(power_likelihood, power=1.0 / 3.0),
}
"""The likelihoods of this file by name; each call takes what `bayes_rs.likelihoods.log_normal.LIKELIHOODS` asks for."""


def register() -> None:
    """Let `bayes_rs.fit` find these likelihoods by name."""
    LIKELIHOODS.update(OTHER_LIKELIHOODS)
