"""Independence proposals: a Student-t about the mode of each record's posterior, by vectorised Gauss–Newton steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.posterior import Posterior

DEGREES_OF_FREEDOM = 8.0
"""Of eight, weights are the most even once the proposal is fitted to draws, and their tails light enough before."""
_FLAT_ENOUGH = 1e-3
"""A record stops when a step gains less than this in log-posterior, or no step longer than this gains anything."""
_LONGEST_STEP = 3.0
"""No coordinate moves farther than this in a step: the prior's own spread is about 1."""
_LEAST_BEND = 1e-2
"""Least curvature of the log-prior that the proposal uses: it may be too wide, never without bound."""
_STEP = 1e-4
"""Central difference step of the coordinates; it only shapes the proposal, never the posterior."""
_OWN_WEIGHT = 12.0
"""Effective draws that a proposal's own moments count for when it is fitted to draws: two for each coordinate."""
_ROOM = 1.15
"""Factor of the covariance of a fitted proposal: what is left of the bias of skewed posteriors halves with it."""


@dataclass(frozen=True)
class StudentProposal:
    """Multivariate Student-t per record.

    Parameters
    ----------
    mode : ndarray, shape (n_record, n)
        Centre, in the posterior's coordinates.
    factor : ndarray, shape (n_record, n, n)
        Triangular F with precision Fᵀ F.
    n_iteration : int
        Gauss–Newton iterations that the slowest record took.
    """

    mode: FloatArray
    factor: FloatArray
    n_iteration: int

    @property
    def root(self) -> FloatArray:
        """F⁻¹, shape (n_record, n, n): it turns standard numbers into distances from the mode."""
        return np.asarray(np.linalg.solve(self.factor, np.eye(self.factor.shape[-1])))

    def transform(self, normal: FloatArray, chi_square: FloatArray) -> FloatArray:
        """Turn normal (n_record, n_draw, n) and χ² (n_record, n_draw) numbers into draws (n_record, n_draw, n)."""
        scaled = normal * np.sqrt(DEGREES_OF_FREEDOM / chi_square)[..., None]
        return np.asarray(self.mode[:, None, :] + scaled @ self.root.swapaxes(-1, -2))

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density, shape (n_record, n_draw), at coordinates (n_record, n_draw, n)."""
        whitened = self.factor @ (coordinate - self.mode[:, None, :]).swapaxes(-1, -2)
        return self.log_density_at(np.einsum("rkd,rkd->rd", whitened, whitened))

    def log_density_of(self, normal: FloatArray, chi_square: FloatArray) -> FloatArray:
        """Return the log-density, shape (n_record, n_draw), of the draws that `transform` makes of these numbers."""
        return self.log_density_at(np.sum(normal * normal, axis=-1) * (DEGREES_OF_FREEDOM / chi_square))

    def log_density_at(self, square: FloatArray) -> FloatArray:
        """Return the log-density, shape (n_record, n_draw), at squared distances |F (x − mode)|² from the mode."""
        n = self.mode.shape[-1]
        half = 0.5 * (DEGREES_OF_FREEDOM + n)
        constant = gammaln(half) - gammaln(0.5 * DEGREES_OF_FREEDOM) - 0.5 * n * np.log(DEGREES_OF_FREEDOM * np.pi)
        log_volume = np.log(np.abs(np.einsum("rkk->rk", self.factor))).sum(axis=1)
        density = np.log1p(square * (1.0 / DEGREES_OF_FREEDOM))
        density *= -half
        return np.asarray(density + (constant + log_volume[:, None]))  # squares may be shared by all records

    def take(self, records: NDArray[np.int64]) -> StudentProposal:
        """Return the proposal of some of the records."""
        return StudentProposal(self.mode[records], self.factor[records], self.n_iteration)

    def fitted_to(self, coordinate: FloatArray, weight: FloatArray) -> StudentProposal:
        """Return the proposal with the moments of weighted draws, as far as there are draws to tell them.

        Parameters
        ----------
        coordinate : ndarray, shape (n_record, n_draw, n)
            Draws.
        weight : ndarray, shape (n_record, n_draw)
            Their weights, which sum to 1.

        Returns
        -------
        proposal : StudentProposal
            Its mean is that of the draws and its covariance `_ROOM` times theirs, together with the old ones as of
            `_OWN_WEIGHT` draws.
        """
        effective = 1.0 / np.sum(weight * weight, axis=1)
        share = (effective / (effective + _OWN_WEIGHT))[:, None]
        mean = (coordinate.swapaxes(-1, -2) @ weight[:, :, None])[..., 0]
        centred = (coordinate - mean[:, None, :]).swapaxes(-1, -2)
        covariance = (centred * weight[:, None, :]) @ centred.swapaxes(-1, -2)
        root, apart = self.root, mean - self.mode
        own = root @ root.swapaxes(-1, -2) + share[..., None] * (apart[:, :, None] * apart[:, None, :])
        share_of_matrix = share[..., None]
        return self.refitted(
            np.arange(len(mean)),
            share * mean + (1.0 - share) * self.mode,
            _ROOM * (share_of_matrix * covariance + (1.0 - share_of_matrix) * own),
        )

    def refitted(self, records: NDArray[np.int64], mean: FloatArray, covariance: FloatArray) -> StudentProposal:
        """Return the proposal with another mean (n, k) and covariance (n, k, k) for some of the records.

        A covariance that is not that of a spread in all directions says nothing: such a record keeps its proposal.
        """
        mode, factor = self.mode.copy(), self.factor.copy()
        with np.errstate(invalid="ignore"):
            known = np.isfinite(covariance.sum(axis=(1, 2)) + mean.sum(axis=1))
        spread = np.asarray(known & (np.linalg.eigvalsh(np.where(known[:, None, None], covariance, 0.0))[:, 0] > 1e-8))
        mode[records[spread]] = mean[spread]
        root = np.linalg.cholesky(covariance[spread])
        # F with Fᵀ F = C⁻¹ is the inverse of C's Cholesky factor: lower triangular serves as well
        factor[records[spread]] = np.linalg.solve(root, np.eye(root.shape[-1]))
        return StudentProposal(mode, factor, self.n_iteration)


def laplace_proposal(posterior: Posterior, *, max_iteration: int = 30) -> StudentProposal:
    """Find the mode of every record's posterior and the curvature there.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records.
    max_iteration : int
        Bound on the Levenberg–Marquardt iterations. A record that has not converged by then keeps its best point: the
        proposal is then poorer, the sampler corrects for it, and the acceptance shows it.

    Returns
    -------
    proposal : StudentProposal
        Mode, and as precision JᵀJ − ∂²ln p(φ), with J the Jacobian of the whitened residuals and p the prior's density.
    """
    n = posterior.n_coordinate
    mode = np.zeros((posterior.n_record, n))
    damping = np.full(len(mode), 1e-3)
    height = posterior.log_density(mode[:, None, :])[:, 0]
    identity = np.eye(n)
    going = np.arange(len(mode))  # each record stops by itself, so that its proposal does not depend on the others
    n_iteration = 0
    while len(going) and n_iteration < max_iteration:
        n_iteration += 1
        part = posterior.take(going)
        gradient, precision = _curvature(part, mode[going])
        step = np.linalg.solve(precision + damping[going, None, None] * identity, gradient[..., None])[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        step = step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _LONGEST_STEP))
        trial = mode[going] + step
        trial_height = part.log_density(trial[:, None, :])[:, 0]
        better = trial_height > height[going]
        converged = np.where(
            better, trial_height - height[going] < _FLAT_ENOUGH, np.abs(step).max(axis=1) < _FLAT_ENOUGH
        )
        mode[going[better]] = trial[better]
        height[going[better]] = trial_height[better]
        damping[going] = np.where(better, 0.1 * damping[going], 10.0 * np.maximum(damping[going], 1e-2))
        going = going[~converged]
    _, precision = _curvature(posterior, mode)
    factor = np.asarray(np.linalg.cholesky(precision), dtype=np.float64).swapaxes(-1, -2)
    return StudentProposal(mode, factor, n_iteration)


def _curvature(posterior: Posterior, mode: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return gradient (n_record, n) and Gauss–Newton precision (n_record, n, n) of the log-posterior at the mode."""
    n = posterior.n_coordinate
    shift = _STEP * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
    around = mode[:, None, :] + shift
    seen = posterior.seen(around)
    residual = posterior.likelihood.whitened_residual(*seen)
    forward, backward = slice(1, n + 1), slice(n + 1, None)
    jacobian = (residual[:, forward] - residual[:, backward]) / (2.0 * _STEP)  # (record, n, seen)
    log_prior = posterior.log_prior(around)
    height = posterior.likelihood.log_density(*seen) + log_prior
    with np.errstate(invalid="ignore"):  # no slope, and no proposal, where the density is nowhere above zero
        gradient = (height[:, forward] - height[:, backward]) / (2.0 * _STEP)
    bend = (log_prior[:, forward] + log_prior[:, backward] - 2.0 * log_prior[:, :1]) / _STEP**2
    precision = jacobian @ jacobian.swapaxes(-1, -2) + np.eye(n) * np.maximum(-bend, _LEAST_BEND)[:, None, :]
    return gradient, precision
