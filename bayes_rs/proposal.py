"""Independence proposals: a Student-t about the mode of each record's posterior, by vectorised Gauss–Newton steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from bayes_rs._validation import FloatArray
from bayes_rs.likelihood import LogNormalLikelihood
from bayes_rs.prior import N_COORDINATE, Prior

DEGREES_OF_FREEDOM = 6.0
_FLAT_ENOUGH = 1e-3
"""A record stops when a step gains less than this in log-posterior, or no step longer than this gains anything."""
_LEAST_BEND = 1e-2
"""Least curvature of the log-prior that the proposal uses: it may be too wide, never without bound."""
_STEP = 1e-4
"""Central difference step of the coordinates; it only shapes the proposal, never the posterior."""


@dataclass(frozen=True)
class StudentProposal:
    """Multivariate Student-t per record.

    Parameters
    ----------
    mode : ndarray, shape (n_record, 6)
        Centre, in the prior's coordinates.
    factor : ndarray, shape (n_record, 6, 6)
        Upper triangular F with precision Fᵀ F.
    n_iteration : int
        Gauss–Newton iterations that the slowest record took.
    """

    mode: FloatArray
    factor: FloatArray
    n_iteration: int

    def transform(self, normal: FloatArray, chi_square: FloatArray) -> FloatArray:
        """Turn normal (n_record, n_draw, 6) and χ² (n_record, n_draw) numbers into draws (n_record, n_draw, 6)."""
        scaled = normal * np.sqrt(DEGREES_OF_FREEDOM / chi_square)[..., None]
        shift = np.linalg.solve(self.factor, scaled.swapaxes(-1, -2)).swapaxes(-1, -2)
        return np.asarray(self.mode[:, None, :] + shift)

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density, shape (n_record, n_draw), at coordinates (n_record, n_draw, 6)."""
        whitened = (coordinate - self.mode[:, None, :]) @ self.factor.swapaxes(-1, -2)
        square = np.einsum("rdk,rdk->rd", whitened, whitened)
        half = 0.5 * (DEGREES_OF_FREEDOM + N_COORDINATE)
        constant = gammaln(half) - gammaln(0.5 * DEGREES_OF_FREEDOM) - 3.0 * np.log(DEGREES_OF_FREEDOM * np.pi)
        log_volume = np.log(np.abs(np.einsum("rkk->rk", self.factor))).sum(axis=1)
        return np.asarray(constant + log_volume[:, None] - half * np.log1p(square / DEGREES_OF_FREEDOM))

    def take(self, records: np.ndarray[tuple[int], np.dtype[np.int64]]) -> StudentProposal:
        """Return the proposal of some of the records."""
        return StudentProposal(self.mode[records], self.factor[records], self.n_iteration)


def log_posterior(likelihood: LogNormalLikelihood, prior: Prior, coordinate: FloatArray) -> FloatArray:
    """Return the log-posterior up to a constant, shape (n_record, n_draw), at coordinates (n_record, n_draw, 6)."""
    return likelihood.log_density(prior.stress(coordinate)) + prior.log_density(coordinate)


def laplace_proposal(likelihood: LogNormalLikelihood, prior: Prior, *, max_iteration: int = 30) -> StudentProposal:
    """Find the mode of every record's posterior and the curvature there.

    Parameters
    ----------
    likelihood : LogNormalLikelihood
        Likelihood of n_record records.
    prior : Prior
        The prior.
    max_iteration : int
        Bound on the Levenberg–Marquardt iterations. A record that has not converged by then keeps its best point: the
        proposal is then poorer, the sampler corrects for it, and the acceptance shows it.

    Returns
    -------
    proposal : StudentProposal
        Mode, and as precision JᵀJ − ∂²ln p(φ), with J the Jacobian of the whitened residuals and p the prior's density.
    """
    n_record = len(likelihood.datum)
    mode = np.zeros((n_record, N_COORDINATE))
    damping = np.full(n_record, 1e-3)
    height = log_posterior(likelihood, prior, mode[:, None, :])[:, 0]
    identity = np.eye(N_COORDINATE)
    going = np.arange(n_record)  # each record stops by itself, so that its proposal does not depend on the others
    n_iteration = 0
    while len(going) and n_iteration < max_iteration:
        n_iteration += 1
        part = likelihood.take(going)
        gradient, precision = _curvature(part, prior, mode[going])
        step = np.linalg.solve(precision + damping[going, None, None] * identity, gradient[..., None])[..., 0]
        trial = mode[going] + step
        trial_height = log_posterior(part, prior, trial[:, None, :])[:, 0]
        better = trial_height > height[going]
        converged = np.where(
            better, trial_height - height[going] < _FLAT_ENOUGH, np.abs(step).max(axis=1) < _FLAT_ENOUGH
        )
        mode[going[better]] = trial[better]
        height[going[better]] = trial_height[better]
        damping[going] = np.where(better, 0.1 * damping[going], 10.0 * np.maximum(damping[going], 1e-2))
        going = going[~converged]
    _, precision = _curvature(likelihood, prior, mode)
    factor = np.asarray(np.linalg.cholesky(precision), dtype=np.float64).swapaxes(-1, -2)
    return StudentProposal(mode, factor, n_iteration)


def _curvature(likelihood: LogNormalLikelihood, prior: Prior, mode: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return gradient (n_record, 6) and Gauss–Newton precision (n_record, 6, 6) of the log-posterior at the mode."""
    shift = _STEP * np.concatenate([np.zeros((1, N_COORDINATE)), np.eye(N_COORDINATE), -np.eye(N_COORDINATE)])
    around = mode[:, None, :] + shift
    residual = likelihood.whitened_residual(prior.stress(around))
    forward, backward = slice(1, N_COORDINATE + 1), slice(N_COORDINATE + 1, None)
    jacobian = (residual[:, forward] - residual[:, backward]) / (2.0 * _STEP)  # (record, 6, seen)
    log_prior = prior.log_density(around)
    slope = (log_prior[:, forward] - log_prior[:, backward]) / (2.0 * _STEP)
    bend = (log_prior[:, forward] + log_prior[:, backward] - 2.0 * log_prior[:, :1]) / _STEP**2
    gradient = slope - np.einsum("rks,rs->rk", jacobian, residual[:, 0])
    precision = jacobian @ jacobian.swapaxes(-1, -2) + np.eye(N_COORDINATE) * np.maximum(-bend, _LEAST_BEND)[:, None, :]
    return gradient, precision
