"""Diagnostics of chains for many records and quantities at once.

All functions take draws of shape (..., n_chain, n_draw) and return shape (...). Agreement with ArviZ is tested.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.intervals import quantile_of_ordered


@dataclass(frozen=True)
class Diagnosis:
    """Diagnostics of many series of draws, each an array of shape (...).

    Parameters
    ----------
    ess_bulk, ess_tail : ndarray
        Effective sample sizes of the centre and of the tails.
    r_hat : ndarray
        Potential scale reduction between the ensembles.
    """

    ess_bulk: FloatArray
    ess_tail: FloatArray
    r_hat: FloatArray


def diagnose(draws: FloatArray, n_ensemble: int, prob: float = 0.9) -> Diagnosis:
    """Return the effective sample sizes and R-hat of draws; they share one sorting.

    Parameters
    ----------
    draws : ndarray, shape (..., n_chain, n_draw)
        Draws; at least four of each chain, chains of one ensemble are neighbours.
    n_ensemble : int
        Number of independent ensembles that the chains belong to; it divides n_chain.
    prob : float
        Central probability; the tails begin at its ends.

    Returns
    -------
    diagnosis : Diagnosis
        As `ess_bulk`, `ess_tail` and `r_hat` give them.
    """
    n_chain = draws.shape[-2]
    if n_chain % n_ensemble:
        raise InputError(f"Invalid n_ensemble {n_ensemble}: it must divide the number of chains, {n_chain}.")
    halves = _split(draws)  # first halves of all chains, then second halves
    flat = halves.reshape(*halves.shape[:-2], -1)
    order = np.argsort(flat, axis=-1)
    ordered = np.take_along_axis(flat, order, axis=-1)
    score = _placed(_normal_scores(ordered), order).reshape(halves.shape)
    distance = np.abs(ordered - quantile_of_ordered(ordered, 0.5)[..., None])
    outward = np.argsort(distance, axis=-1, kind="stable")  # falls, then rises: a sort that merges runs is quick
    folded = _placed(_normal_scores(np.take_along_axis(distance, outward, axis=-1)), outward)
    folded = _placed(folded, order)
    pooled = (*halves.shape[:-2], 2 * n_ensemble, -1)
    hat = np.maximum(_plain_r_hat(score.reshape(pooled)), _plain_r_hat(folded.reshape(pooled)))
    low, high = (
        quantile_of_ordered(ordered, level)[..., None, None] for level in ((1.0 - prob) / 2.0, (1.0 + prob) / 2.0)
    )
    tail = np.minimum(_ess((halves <= low).astype(np.float64)), _ess((halves <= high).astype(np.float64)))
    return Diagnosis(_ess(score), tail, hat)


def ess_bulk(draws: FloatArray) -> FloatArray:
    """Return the bulk effective sample size of rank-normalized split chains.

    Parameters
    ----------
    draws : ndarray, shape (..., n_chain, n_draw)
        Draws; at least four of each chain.

    Returns
    -------
    ess : ndarray, shape (...)
        Effective number of independent draws for the centre of the distribution; NaN where all draws are equal.

    References
    ----------
    Vehtari et al. (2021), Bayesian Analysis 16, 667–718, doi:10.1214/20-BA1221, Sects. 3.2 and 4.
    """
    return diagnose(draws, 1).ess_bulk


def ess_tail(draws: FloatArray, prob: float = 0.9) -> FloatArray:
    """Return the smaller effective sample size of the two tail probabilities.

    Parameters
    ----------
    draws : ndarray, shape (..., n_chain, n_draw)
        Draws; at least four of each chain.
    prob : float
        Central probability; the tails begin at its ends.

    Returns
    -------
    ess : ndarray, shape (...)
        Effective number of independent draws for the tails; NaN where all draws are equal.

    References
    ----------
    Vehtari et al. (2021), Bayesian Analysis 16, 667–718, doi:10.1214/20-BA1221, Sect. 4.3.
    """
    return diagnose(draws, 1, prob).ess_tail


def r_hat(draws: FloatArray, n_ensemble: int) -> FloatArray:
    """Return the rank-normalized split R-hat between independent ensembles.

    Parameters
    ----------
    draws : ndarray, shape (..., n_chain, n_draw)
        Draws; chains of one ensemble are neighbours.
    n_ensemble : int
        Number of independent ensembles that the chains belong to; it divides n_chain.

    Returns
    -------
    r_hat : ndarray, shape (...)
        Potential scale reduction, near 1 when the ensembles agree with each other and with their own first halves;
        NaN where all draws are equal.

    Notes
    -----
    Walkers of one ensemble are not independent, so the walkers of an ensemble are pooled: what is compared are the
    first and second halves of whole ensembles. The larger of the plain and the folded form is returned.

    References
    ----------
    Vehtari et al. (2021), Bayesian Analysis 16, 667–718, doi:10.1214/20-BA1221, Sects. 4.1 and 4.2.
    """
    return diagnose(draws, n_ensemble).r_hat


def autocorrelation_time(draws: FloatArray, window: float = 5.0) -> FloatArray:
    """Return the integrated autocorrelation time, in steps, from the mean autocorrelation of the chains.

    Parameters
    ----------
    draws : ndarray, shape (..., n_chain, n_draw)
        Draws.
    window : float
        The sum ends at the first lag that is `window` times the time so far.

    Returns
    -------
    time : ndarray, shape (...)
        τ = 1 + 2 Σ ρ(lag), in steps; NaN where a chain never moved.

    References
    ----------
    Sokal (1997), Monte Carlo methods in statistical mechanics, doi:10.1007/978-1-4899-0319-8_6; the averaging over
    walkers follows the documentation of emcee (Foreman-Mackey et al. 2013, doi:10.1086/670067).
    """
    n_draw = draws.shape[-1]
    flat = draws.reshape(-1, *draws.shape[-2:])
    centred = flat - flat.mean(axis=-1, keepdims=True)
    few = min(_FEW_LAGS, n_draw)
    covariance = np.stack(
        [np.einsum("scd,scd->sc", centred[..., : n_draw - lag], centred[..., lag:]) for lag in range(few)], axis=-1
    )
    time, complete = _windowed_time(covariance, window)
    left = np.flatnonzero(~complete)
    if len(left) and few < n_draw:
        time[left], _ = _windowed_time(_autocovariance(flat[left]), window)
    return time.reshape(draws.shape[:-2])


def _windowed_time(covariance: FloatArray, window: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return Sokal's time of autocovariances (n_series, n_chain, n_lag), and whether the window closed within them."""
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = (covariance / covariance[..., :1]).mean(axis=-2)
    times = 2.0 * np.cumsum(correlation, axis=-1) - 1.0
    inside = np.arange(times.shape[-1]) < window * times
    closed = ~inside.all(axis=-1)
    cut = np.where(closed, np.argmin(inside, axis=-1), times.shape[-1] - 1)
    return np.take_along_axis(times, cut[..., None], axis=-1)[..., 0], np.asarray(closed)


def quantile_error(ordered: FloatArray, level: FloatArray, ess: FloatArray) -> FloatArray:
    """Return the Monte-Carlo standard error of quantiles.

    Parameters
    ----------
    ordered : ndarray, shape (..., n_draw)
        Draws, smallest first.
    level : ndarray, shape (...)
        Probabilities of the quantiles.
    ess : ndarray, shape (...)
        Effective sample size.

    Returns
    -------
    error : ndarray, shape (...)
        Half the distance of the draws that are one binomial standard deviation, √(p (1 − p)/n), to both sides of the
        level.
    """
    spread = np.sqrt(np.maximum(level * (1.0 - level), 0.0) / ess)
    last = ordered.shape[-1] - 1
    spread = np.where(np.isfinite(spread), spread, 0.0)
    at = [np.rint(np.clip(level + side * spread, 0.0, 1.0) * last).astype(np.int64) for side in (-1.0, 1.0)]
    ends = [np.take_along_axis(ordered, place[..., None], axis=-1)[..., 0] for place in at]
    return np.where(np.isfinite(ess), 0.5 * (ends[1] - ends[0]), np.nan)


_FEW_LAGS = 16
"""Lags that are summed directly before the autocovariance at all lags is computed."""


def _split(draws: FloatArray) -> FloatArray:
    """Cut chains (..., n_chain, n_draw) in halves (..., 2 n_chain, n_draw // 2), an odd middle draw left out."""
    n_draw = draws.shape[-1]
    if n_draw < 4:
        raise InputError(f"Chains of {n_draw} draws are too short for diagnostics: each needs at least 4.")
    half = n_draw // 2
    return np.concatenate([draws[..., :half], draws[..., -half:]], axis=-2)


def _normal_scores(ordered: FloatArray) -> FloatArray:
    """Return the normal scores of the ranks of draws in order, (..., n), ties at their mean rank."""
    n = ordered.shape[-1]
    tied = ordered[..., 1:] == ordered[..., :-1]
    place = np.arange(n, dtype=np.int32)
    first = np.broadcast_to(place, ordered.shape).copy()
    first[..., 1:][tied] = 0
    np.maximum.accumulate(first, axis=-1, out=first)
    last = np.broadcast_to(place, ordered.shape).copy()
    last[..., :-1][tied] = n
    last = np.minimum.accumulate(last[..., ::-1], axis=-1)[..., ::-1]
    return np.asarray(_score_table(n)[first + last])


def _placed(values: FloatArray, order: NDArray[np.int64]) -> FloatArray:
    """Put values, given in an order, back into the places that the order names."""
    placed = np.empty_like(values)
    np.put_along_axis(placed, order, values, axis=-1)
    return placed


@lru_cache(maxsize=16)
def _score_table(n: int) -> FloatArray:
    """Return the normal scores of the ranks 1, 1½, … n of n draws, shape (2 n − 1,)."""
    rank = 1.0 + 0.5 * np.arange(2 * n - 1)
    return np.asarray(ndtri((rank - 0.375) / (n + 0.25)))


def _plain_r_hat(draws: FloatArray) -> FloatArray:
    n_draw = draws.shape[-1]
    within = draws.var(axis=-1, ddof=1).mean(axis=-1)
    between = draws.mean(axis=-1).var(axis=-1, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((n_draw - 1.0) / n_draw + between / within))


def _autocovariance(draws: FloatArray) -> FloatArray:
    """Return the biased autocovariance at all lags, by FFT without wrap-around."""
    n_draw = draws.shape[-1]
    centred = draws - draws.mean(axis=-1, keepdims=True)
    spectrum = np.fft.rfft(centred, 2 * n_draw, axis=-1)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, 2 * n_draw, axis=-1)[..., :n_draw] / n_draw)


def _ess(draws: FloatArray) -> FloatArray:
    """Return the effective sample size by Geyer's initial monotone sequence over all chains."""
    n_chain, n_draw = draws.shape[-2:]
    flat = draws.reshape(-1, n_chain, n_draw)
    mean = flat.mean(axis=-1, keepdims=True)
    centred = flat - mean
    spread = mean[..., 0].var(axis=-1, ddof=1) if n_chain > 1 else np.zeros(len(flat))
    # most chains forget within a few steps: their sums end before these lags, the others get all lags
    few = min(_FEW_LAGS, n_draw)
    covariance = np.stack(
        [np.einsum("scd,scd->s", centred[..., : n_draw - lag], centred[..., lag:]) for lag in range(few)], axis=-1
    ) / (n_chain * n_draw)
    time, total, complete = _geyer_time(covariance, spread, n_draw)
    left = np.flatnonzero(~complete)
    if len(left):
        covariance = _autocovariance(flat[left]).mean(axis=-2)
        time[left], total[left], _ = _geyer_time(covariance, spread[left], n_draw)
    size = n_chain * n_draw
    effective = size / np.maximum(time, 1.0 / np.log10(size))
    return np.where(total > 0.0, effective, np.nan).reshape(draws.shape[:-2])


def _geyer_time(
    covariance: FloatArray, spread: FloatArray, n_draw: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the autocorrelation time and variance of series, and whether their sums ended within the lags given.

    Parameters
    ----------
    covariance : ndarray, shape (n_series, n_lag)
        Mean over chains of the biased autocovariance.
    spread : ndarray, shape (n_series,)
        Variance of the chains' means.
    n_draw : int
        Length of a chain.
    """
    n_lag = covariance.shape[-1]
    within = covariance[..., 0] * n_draw / (n_draw - 1.0)
    total = covariance[..., 0] + spread
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = 1.0 - (within[..., None] - covariance) / total[..., None]
    correlation[..., 0] = 1.0
    even, odd = correlation[..., 0 : n_lag - 1 : 2], correlation[..., 1:n_lag:2]
    pair = even + odd
    # the last lags have too few products to be summed in pairs; Stan and ArviZ stop at the same place
    summable = np.arange(pair.shape[-1]) < (n_draw - 3) // 2
    positive = np.logical_and.accumulate((pair > 0.0) & summable, axis=-1)
    monotone = np.minimum.accumulate(np.where(positive, pair, np.inf), axis=-1)
    time = 2.0 * np.where(positive, monotone, 0.0).sum(axis=-1) - 1.0
    # the even term after the last positive pair still counts when it is positive
    length = positive.sum(axis=-1)
    has_next = length < even.shape[-1]
    following = np.take_along_axis(even, np.minimum(length, even.shape[-1] - 1)[..., None], axis=-1)[..., 0]
    time = time + np.where(has_next & (following > 0.0), following, 0.0)
    return time, total, np.asarray(has_next | (n_lag == n_draw))
