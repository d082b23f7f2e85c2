"""Diagnostics of many walkers of few steps: how their means scatter, and change from early to late steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.diagnostics import quantile_of_ordered
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE

N_KEPT = 4
"""Steps of a walker that are kept; the first half of them are early, the second late."""
_PROB = 0.9
"""The tails begin at the ends of this central interval."""


@dataclass(frozen=True)
class WalkerDiagnosis:
    """Diagnostics of the draws of walkers, each an array of shape (n_record, n_quantity) but for `drift`.

    Parameters
    ----------
    ess_bulk, ess_tail : ndarray
        Effective sample sizes of the mean, and of the share below an end of the central 90 %: the smaller of both ends.
    r_hat : ndarray
        Potential scale reduction between the early and late halves of all ensembles; the larger of that of the values
        and that of their distances from the median.
    drift : ndarray, shape (n_record,)
        Largest change from early to late steps, of a mean or a mean distance from the median, in standard errors.
    """

    ess_bulk: FloatArray
    ess_tail: FloatArray
    r_hat: FloatArray
    drift: FloatArray


def diagnose_walkers(draws: FloatArray) -> WalkerDiagnosis:
    r"""Return the diagnostics of draws of walkers.

    Parameters
    ----------
    draws : ndarray, shape (n_record, n_quantity, n_walker, N_KEPT)
        Draws. Walkers of one of the `N_ENSEMBLE` ensembles are neighbours, and so are those with the same start.

    Returns
    -------
    diagnosis : WalkerDiagnosis
        NaN, and no drift, where all draws are equal.

    Notes
    -----
    With W walkers, whose means over the steps have the variance γ₀ and, from neighbour to neighbour, the covariance
    γ₁, and σ² the variance of the draws, the effective sample size is

    .. math:: W \sigma^2 / (\gamma_0 + 2 \max(\gamma_1, 0)) :

    what a walker remembers of its last step is in γ₀, a start that neighbours share is in γ₁. It has a relative
    standard error of about √(2/W), and no assumption of how the chain forgets.
    """
    n_record, n_quantity, _, n_step = draws.shape
    half = n_step // 2
    ordered = np.sort(draws.reshape(n_record, n_quantity, -1), axis=-1)
    low, median, high = (quantile_of_ordered(ordered, level) for level in (0.5 - 0.5 * _PROB, 0.5, 0.5 + 0.5 * _PROB))
    mean = draws.mean(axis=(2, 3))
    with np.errstate(invalid="ignore", divide="ignore"):
        values = _Halves.of(draws - mean[..., None, None], half)
        folded = _Halves.of(np.abs(draws - median[..., None, None]), half)
        bulk = values.effective(n_step)
        tail = np.minimum(*(_of_share(draws, level) for level in (low, high)))
        r_hat = np.maximum(values.r_hat(), folded.r_hat())
        drift = np.fmax(values.drift(), folded.drift()).max(axis=1)
    equal = ordered[..., 0] == ordered[..., -1]
    return WalkerDiagnosis(
        ess_bulk=np.where(equal, np.nan, bulk),
        ess_tail=np.where(equal, np.nan, tail),
        r_hat=np.where(equal, np.nan, r_hat),
        drift=np.where(np.isfinite(drift), drift, 0.0),
    )


@dataclass(frozen=True)
class _Halves:
    """Sums over each walker's early and late steps, (n_record, n_quantity, n_walker), and of their squares."""

    early: FloatArray
    late: FloatArray
    square: FloatArray
    size: int

    @classmethod
    def of(cls, values: FloatArray, half: int) -> _Halves:
        early, late = _sum_of_steps(values[..., :half]), _sum_of_steps(values[..., half:])
        of_groups = [
            np.einsum("rqewt,rqewt->rqe", part, part)
            for part in (_by_ensemble(values[..., :half]), _by_ensemble(values[..., half:]))
        ]
        return cls(early, late, np.stack(of_groups, axis=-1), half)

    def effective(self, n_step: int) -> FloatArray:
        """Return the effective sample size of the mean; the values are about their mean."""
        variance = self.square.sum(axis=(-2, -1)) / (self.early.shape[-1] * n_step)
        return np.asarray(variance * self.early.shape[-1] / _spread((self.early + self.late) / n_step))

    def r_hat(self) -> FloatArray:
        n = self.size * self.early.shape[-1] // N_ENSEMBLE  # draws of a group
        total = np.stack([_by_ensemble(part).sum(axis=-1) for part in (self.early, self.late)], axis=-1)
        mean = (total / n).reshape(*total.shape[:2], -1)
        within = (self.square.reshape(mean.shape) - n * mean * mean).mean(axis=-1) / (n - 1.0)
        return np.asarray(np.sqrt((n - 1.0) / n + mean.var(axis=-1, ddof=1) / within))

    def drift(self) -> FloatArray:
        change = self.late - self.early
        mean = change.mean(axis=-1)
        error = np.sqrt(_spread(change - mean[..., None]) / change.shape[-1])
        return np.asarray(np.abs(mean) / error)


def _of_share(draws: FloatArray, level: FloatArray) -> FloatArray:
    """Return the effective sample size of the share of draws up to a level."""
    below = draws <= level[..., None, None]
    count = np.asarray(_sum_of_steps(below.view(np.int8)), dtype=np.float64)
    share = count.mean(axis=-1) / draws.shape[-1]
    count /= draws.shape[-1]
    count -= share[..., None]
    return np.asarray(share * (1.0 - share) * draws.shape[2] / _spread(count))


def _spread(centred: FloatArray) -> FloatArray:
    """Return γ₀ + 2 max(γ₁, 0) of walkers (…, n_walker) about their mean; neighbours are those of one ensemble."""
    of = _by_ensemble(centred)
    own = np.einsum("rqew,rqew->rq", of, of)
    beside = np.einsum("rqew,rqew->rq", of[..., 1:], of[..., :-1])
    return np.asarray((own + 2.0 * np.maximum(beside, 0.0)) / centred.shape[-1])


def _by_ensemble(values: FloatArray) -> FloatArray:
    return values.reshape(*values.shape[:2], N_ENSEMBLE, -1, *values.shape[3:])


def _sum_of_steps(values: NDArray[Any]) -> NDArray[Any]:
    total = values[..., 0].copy()
    for step in range(1, values.shape[-1]):
        total += values[..., step]
    return total
