"""Diagnostics of chains for many records and quantities at once.

All functions take draws of shape (..., n_chain, n_draw) and return shape (...). Agreement with ArviZ is tested.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError


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
    return _ess(_rank_normal(_split(draws)))


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
    halves = _split(draws)
    flat = halves.reshape(*halves.shape[:-2], -1)
    ends = np.quantile(flat, [(1.0 - prob) / 2.0, (1.0 + prob) / 2.0], axis=-1)[..., None, None]
    return np.minimum(_ess((halves <= ends[0]).astype(np.float64)), _ess((halves <= ends[1]).astype(np.float64)))


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
    n_chain = draws.shape[-2]
    if n_chain % n_ensemble:
        raise InputError(f"Invalid n_ensemble {n_ensemble}: it must divide the number of chains, {n_chain}.")
    halves = _split(draws)  # first halves of all chains, then second halves
    pooled = halves.reshape(*halves.shape[:-2], 2 * n_ensemble, -1)
    middle = np.median(pooled.reshape(*pooled.shape[:-2], -1), axis=-1)[..., None, None]
    return np.maximum(_plain_r_hat(_rank_normal(pooled)), _plain_r_hat(_rank_normal(np.abs(pooled - middle))))


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
    covariance = _autocovariance(draws)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = (covariance / covariance[..., :1]).mean(axis=-2)
    times = 2.0 * np.cumsum(correlation, axis=-1) - 1.0
    inside = np.arange(times.shape[-1]) < window * times
    cut = np.where(inside.all(axis=-1), times.shape[-1] - 1, np.argmin(inside, axis=-1))
    return np.take_along_axis(times, cut[..., None], axis=-1)[..., 0]


def highest_density_interval(draws: FloatArray, prob: float) -> tuple[FloatArray, FloatArray]:
    """Return the shortest interval that holds a share of the draws.

    Parameters
    ----------
    draws : ndarray, shape (..., n_draw)
        Draws.
    prob : float
        Share of the draws, between 0 and 1.

    Returns
    -------
    low, high : ndarray, shape (...)
        Ends of the interval.
    """
    if not 0.0 < prob < 1.0:
        raise InputError(f"Invalid prob {prob!r}: it must be between 0 and 1.")
    ordered = np.sort(draws, axis=-1)
    n_draw = ordered.shape[-1]
    span = int(np.floor(prob * n_draw))
    width = ordered[..., span:] - ordered[..., : n_draw - span]
    start = np.argmin(width, axis=-1)[..., None]
    low = np.take_along_axis(ordered, start, axis=-1)[..., 0]
    high = np.take_along_axis(ordered, start + span, axis=-1)[..., 0]
    return low, high


def _split(draws: FloatArray) -> FloatArray:
    """Cut chains (..., n_chain, n_draw) in halves (..., 2 n_chain, n_draw // 2), an odd middle draw left out."""
    n_draw = draws.shape[-1]
    if n_draw < 4:
        raise InputError(f"Chains of {n_draw} draws are too short for diagnostics: each needs at least 4.")
    half = n_draw // 2
    return np.concatenate([draws[..., :half], draws[..., -half:]], axis=-2)


def _rank_normal(draws: FloatArray) -> FloatArray:
    """Replace draws by the normal scores of their ranks over all chains."""
    flat = draws.reshape(*draws.shape[:-2], -1)
    rank = rankdata(flat, axis=-1)
    return np.asarray(ndtri((rank - 0.375) / (flat.shape[-1] + 0.25))).reshape(draws.shape)


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
    covariance = _autocovariance(draws).mean(axis=-2)
    within = covariance[..., 0] * n_draw / (n_draw - 1.0)
    total = covariance[..., 0] + draws.mean(axis=-1).var(axis=-1, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = 1.0 - (within[..., None] - covariance) / total[..., None]
    correlation[..., 0] = 1.0
    even, odd = correlation[..., 0 : n_draw - 1 : 2], correlation[..., 1:n_draw:2]
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
    size = n_chain * n_draw
    effective = size / np.maximum(time, 1.0 / np.log10(size))
    return np.where(total > 0.0, effective, np.nan)
