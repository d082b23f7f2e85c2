"""What the variances of a record's beams are expected to be, given each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.priors.ratio import RatioPrior

ANY_AIR = RatioPrior(
    sd_uu=20.0, vv=0.64, sd_vv=0.5, ww=0.35, sd_ww=0.7, uv=0.0, sd_uv=0.25, uw=-0.25, sd_uw=0.35, vw=0.0, sd_vw=0.25
)
"""Air of every kind lies within three of these standard deviations, and an alarm is beyond: a flow is no fault."""
GRADIENT_SD = 0.3
"""Standard deviation of the change of ln R over 100 m, up and across, which is no fault."""
FLOOR = 0.03
"""Standard deviation of ln y of each beam that no model of the noise has: pointing, small-scale flow."""

_N_STEP = 5
_STEP = 1e-4
_LONGEST = 2.0
_FAR = 4.5
_LOOSE = 25.0
_LEAST = 1e-9
"""Of the largest of the beams: no tensor gives a beam less."""


@dataclass(frozen=True)
class Expected:
    """Residuals of data, and how they scatter if nothing is wrong.

    Parameters
    ----------
    residual : ndarray, shape (n_record, n_beam)
        Data minus their expectation; 0 where a beam is not used.
    slope : ndarray, shape (n_record, n_beam, n)
        What flow can do to the data, per standard deviation of it.
    noise : ndarray, shape (n_record, n_beam, n_beam)
        Covariance of the data for known flow.
    left : ndarray, shape (n_record, n_beam)
        What the best flow leaves of the data.
    precision : ndarray, shape (n_record, n_beam, n_beam), optional
        Inverse of `covariance`, where it is known.
    """

    residual: FloatArray
    slope: FloatArray
    noise: FloatArray
    left: FloatArray
    precision: FloatArray | None = None

    def covariance(self, excess: float = 1.0) -> FloatArray:
        """Return the covariance of the residuals, noise times `excess`."""
        return excess * self.noise + self.slope @ self.slope.swapaxes(-1, -2)


def expected_variances(
    variance: FloatArray,
    used: NDArray[np.bool_],
    gain: FloatArray,
    log_covariance: FloatArray,
    offset: FloatArray | float,
    place: FloatArray,
) -> Expected:
    r"""Return residuals of log-variances under the prior predictive distribution, linear about the best flow.

    Parameters
    ----------
    variance : ndarray, shape (n_record, n_beam)
        Radial variances, m² s⁻².
    used : ndarray of bool, shape (n_record, n_beam)
        Which of them count.
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain · stresses + offset.
    log_covariance : ndarray, shape (n_record, n_beam, n_beam)
        ln(1 + K).
    offset : ndarray or float
        Variance of the instrument's noise, m² s⁻².
    place : ndarray, shape (n_beam, 2)
        Where the beams measure, across and up, m.

    Returns
    -------
    expected : Expected
        In units of ln y.

    Notes
    -----
    With θ the standard normal coordinates of the prior `ANY_AIR` and f(θ) = ln E[y],

    .. math::
        z = \ln y + \tfrac12 \operatorname{diag} C - f(\hat\theta) + J \hat\theta, \qquad
        \operatorname{Cov} z = C + J J^T ,

    where J is the slope of f at the best θ, which is found by Gauss–Newton steps with beams that are far from what the
    others say left loose.
    """
    half = 0.5 * np.einsum("rbb->rb", log_covariance)
    datum = np.where(used, np.log(np.where(used, variance, 1.0)) + half, 0.0)
    both = used[:, :, None] & used[:, None, :]
    own = np.eye(used.shape[1]) * np.where(used, FLOOR**2, 1.0)[:, None, :]
    noise = np.where(both, log_covariance, 0.0) + own
    problem = _Problem(datum, used, gain, np.broadcast_to(offset, variance.shape), place * (GRADIENT_SD / 100.0))
    weight = np.asarray(np.linalg.inv(noise), dtype=np.float64)
    theta = problem.best(weight)
    residual, slope = problem.linear(theta)
    left = problem.left(theta)
    precision = _with_slope(weight, slope)
    far = np.abs(np.einsum("rab,rb->ra", precision, residual)) > _FAR * np.sqrt(np.einsum("raa->ra", precision))
    far &= used
    again = np.flatnonzero(far.any(axis=1))
    if len(again):
        some = problem.take(again)
        loose = noise[again] + np.eye(used.shape[1]) * np.where(far[again], _LOOSE, 0.0)[:, None, :]
        theta = some.best(np.asarray(np.linalg.inv(loose), dtype=np.float64))
        residual[again], slope[again] = some.linear(theta)
        left[again] = some.left(theta)
        precision[again] = _with_slope(weight[again], slope[again])
    return Expected(residual, slope, noise, left, precision)


def _with_slope(weight: FloatArray, slope: FloatArray) -> FloatArray:
    """Return (N + J Jᵀ)⁻¹ from N⁻¹, by the identity of Woodbury: a matrix of the size of the flow is inverted."""
    lever = weight @ slope
    inner = np.eye(slope.shape[-1]) + slope.swapaxes(-1, -2) @ lever
    return np.asarray(weight - lever @ np.linalg.solve(inner, lever.swapaxes(-1, -2)))


@dataclass(frozen=True)
class _Problem:
    """Log-variances, and the flow that they are to be explained by."""

    datum: FloatArray
    used: NDArray[np.bool_]
    gain: FloatArray
    offset: FloatArray
    place: FloatArray

    def take(self, rows: NDArray[np.int64]) -> _Problem:
        return _Problem(self.datum[rows], self.used[rows], self.gain[rows], self.offset[rows], self.place)

    def best(self, weight: FloatArray) -> FloatArray:
        """Return the most probable coordinates, shape (n_record, 8), for noise whose inverse is `weight`."""
        theta = np.zeros((len(self.datum), ANY_AIR.n_coordinate + self.place.shape[1]))
        level = np.where(self.used, self.datum - self.model(theta[:, None])[:, 0], np.nan)
        known = np.isfinite(level).any(axis=1)  # none of a record whose variances have no logarithm
        theta[known, 0] = np.nanmedian(level[known], axis=1) / ANY_AIR.sd_uu
        identity = np.eye(theta.shape[1])
        for _ in range(_N_STEP):
            residual, slope = self.linear(theta)
            lever = slope.swapaxes(-1, -2) @ weight
            wanted = np.linalg.solve(lever @ slope + identity, np.einsum("rib,rb->ri", lever, residual)[..., None])
            step = wanted[..., 0] - theta
            longest = np.max(np.abs(step), axis=1, keepdims=True)
            theta = theta + step * np.minimum(1.0, _LONGEST / np.maximum(longest, _LONGEST))
        return theta

    def model(self, theta: FloatArray) -> FloatArray:
        """Return ln E[y], shape (n_record, n, n_beam), of coordinates (n_record, n, 8)."""
        n = ANY_AIR.n_coordinate
        signal = ANY_AIR.stress(theta[..., :n]) @ self.gain.swapaxes(-1, -2)
        signal = np.maximum(signal, _LEAST * signal.max(axis=-1, keepdims=True)) * np.exp(theta[..., n:] @ self.place.T)
        return np.asarray(np.where(self.used[:, None, :], np.log(signal + self.offset[:, None, :]), 0.0))

    def left(self, theta: FloatArray) -> FloatArray:
        """Return y − f(θ), shape (n_record, n_beam)."""
        return np.where(self.used, self.datum - self.model(theta[:, None])[:, 0], 0.0)

    def linear(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return y − f(θ) + J θ, shape (n_record, n_beam), and J."""
        moved = theta[:, None, :] + np.concatenate([np.zeros((1, theta.shape[1])), _STEP * np.eye(theta.shape[1])])
        value = self.model(moved)
        slope = (value[:, 1:] - value[:, :1]).swapaxes(-1, -2) / _STEP
        residual = np.where(self.used, self.datum - value[:, 0] + np.einsum("rbi,ri->rb", slope, theta), 0.0)
        return residual, slope
