"""Diagnostics of many walkers of few steps: how their means scatter, and change from early to late steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.intervals import quantile_of_ordered
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
    n_record, n_quantity = draws.shape[:2]
    ordered = np.sort(draws.reshape(n_record, n_quantity, -1), axis=-1)
    low, median, high = (quantile_of_ordered(ordered, level) for level in (0.5 - 0.5 * _PROB, 0.5, 0.5 + 0.5 * _PROB))
    mean = draws.mean(axis=(2, 3))
    steps = np.ascontiguousarray(np.moveaxis(draws, -1, 0))  # step by step, so that walkers are runs of numbers
    with np.errstate(invalid="ignore", divide="ignore"):
        tail = np.minimum(*(_of_share(steps <= level[..., None]) for level in (low, high)))
        values = _Halves.of(steps - mean[..., None])
        steps -= median[..., None]
        folded = _Halves.of(np.abs(steps, out=steps))
        bulk = values.effective()
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
    """Sums over each walker's early and late steps, and over each ensemble's squares in these steps.

    Parameters
    ----------
    early, late : ndarray, shape (n_record, n_quantity, N_ENSEMBLE, n_walker)
        Sums over half of `N_KEPT` steps.
    square : ndarray, shape (n_record, n_quantity, 2 N_ENSEMBLE)
        Sums of squares over early steps, then over late ones.
    """

    early: FloatArray
    late: FloatArray
    square: FloatArray

    @classmethod
    def of(cls, steps: FloatArray) -> _Halves:
        """Sum values, shape (N_KEPT, n_record, n_quantity, n_walker), which are squared in place."""
        half = N_KEPT // 2
        early, late = (_by_ensemble(np.add.reduce(part)) for part in (steps[:half], steps[half:]))
        np.multiply(steps, steps, out=steps)
        square = [_by_ensemble(np.add.reduce(part)).sum(axis=-1) for part in (steps[:half], steps[half:])]
        return cls(early, late, np.concatenate(square, axis=-1))

    @property
    def n_walker(self) -> int:
        """Number of walkers of a record."""
        return int(self.early.shape[-1] * N_ENSEMBLE)

    def effective(self) -> FloatArray:
        """Return the effective sample size of the mean; the values are about their mean."""
        variance = self.square.sum(axis=-1) / (self.n_walker * N_KEPT)
        return np.asarray(variance * self.n_walker / _spread((self.early + self.late) / N_KEPT))

    def r_hat(self) -> FloatArray:
        """Return the potential scale reduction between the early and late steps of all ensembles."""
        n = self.early.shape[-1] * (N_KEPT // 2)  # draws of a group
        mean = np.concatenate([part.sum(axis=-1) / n for part in (self.early, self.late)], axis=-1)
        within = (self.square - n * mean * mean).mean(axis=-1) / (n - 1.0)
        return np.asarray(np.sqrt((n - 1.0) / n + mean.var(axis=-1, ddof=1) / within))

    def drift(self) -> FloatArray:
        """Return the change from early to late steps in standard errors."""
        change = self.late - self.early
        mean = change.mean(axis=(-2, -1))
        error = np.sqrt(_spread(change - mean[..., None, None]) / self.n_walker)
        return np.asarray(np.abs(mean) / error)


def _of_share(below: NDArray[np.bool_]) -> FloatArray:
    """Return the effective sample size of the share that is True of (N_KEPT, n_record, n_quantity, n_walker) draws."""
    count = _by_ensemble(np.add.reduce(below.view(np.int8), dtype=np.int8).astype(np.float64))
    n_walker = below.shape[-1]
    count /= N_KEPT
    share = count.mean(axis=(-2, -1))
    count -= share[..., None, None]
    return np.asarray(share * (1.0 - share) * n_walker / _spread(count))


def _spread(centred: FloatArray) -> FloatArray:
    """Return γ₀ + 2 max(γ₁, 0) of walkers (…, N_ENSEMBLE, n) about their mean; neighbours are those of one ensemble."""
    own = np.sum(centred * centred, axis=(-2, -1))
    beside = np.sum(centred[..., 1:] * centred[..., :-1], axis=(-2, -1))
    return np.asarray((own + 2.0 * np.maximum(beside, 0.0)) / (centred.shape[-1] * N_ENSEMBLE))


def _by_ensemble(values: NDArray[Any]) -> NDArray[Any]:
    return values.reshape(*values.shape[:2], N_ENSEMBLE, -1)
