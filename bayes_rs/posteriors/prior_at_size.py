"""The prior of a record whose size is known: what its stresses would be said to be without a word of their ratios."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import EQUAL_TAILED, interval_of

_MOST_DRAWS = 4000
"""Draws of the prior that are used: the ends of its 90 % interval are then known to 3 % of its width."""
_NODES = 12
"""Values of the uncertainty of the size between which the ends are interpolated."""
_LEAST = 1e-3
"""Relative uncertainty of a size below which it is taken as known."""


def shapes_of(prior: FloatArray) -> FloatArray:
    """Return the shapes R/(uu + vv + ww) of draws of a prior, shape (n, 6)."""
    return np.asarray(prior / prior[:, :3].sum(axis=1, keepdims=True))


def sizes_of(mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and sd of uu + vv + ww, each (n_record,), of means (n_record, 6) and covariances (n_record, 6, 6)."""
    variance = covariance[:, :3, :3].sum(axis=(1, 2))
    return mean[:, :3].sum(axis=1), np.sqrt(np.maximum(variance, 0.0))


def prior_interval_at_size(
    prior: FloatArray, mean: FloatArray, sd: FloatArray, prob: float, interval: str = EQUAL_TAILED
) -> tuple[FloatArray, FloatArray]:
    """Return the interval of the prior's stresses at the sizes of records.

    Parameters
    ----------
    prior : ndarray, shape (n, 6)
        Draws of the prior, m² s⁻².
    mean, sd : ndarray, shape (n_record,)
        Posterior mean and standard deviation of the size uu + vv + ww, m² s⁻²; NaN where there is none.
    prob : float
        Probability of the intervals.
    interval : {"equal-tailed", "highest-density"}
        Which intervals.

    Returns
    -------
    low, high : ndarray, shape (n_record, 6)
        Ends of the intervals, m² s⁻².

    Notes
    -----
    The prior's shape R/(uu + vv + ww) is multiplied by a log-normal size of the posterior's mean and standard
    deviation, independent of it. Where the interval of a posterior fills this one, the data said nothing of the stress
    but its size. The ends over the size depend on its relative uncertainty alone, so they are found at `_NODES` values
    of it, and interpolated.
    """
    shape = shapes_of(prior[:_MOST_DRAWS])
    log_sd = np.sqrt(np.log1p((np.maximum(sd, _LEAST * mean) / mean) ** 2))
    scale = mean * np.exp(-0.5 * log_sd**2)
    found = np.full((2, len(mean), len(STRESSES)), np.nan)
    known = np.isfinite(log_sd) & (mean > 0.0)
    if not known.any():
        return found[0], found[1]
    # quantiles of a normal distribution in an order of their own: the same for the same prior, and no draws
    normal = np.random.default_rng(len(shape)).permutation(_normal_scores(len(shape)))
    nodes = np.unique(np.linspace(log_sd[known].min(), log_sd[known].max(), _NODES))
    ends = np.array([interval_of((shape * np.exp(node * normal)[:, np.newaxis]).T, prob, interval) for node in nodes])
    for side in range(2):
        for index in range(len(STRESSES)):
            at = np.interp(log_sd[known], nodes, ends[:, side, index])
            found[side, known, index] = scale[known] * at
    return found[0], found[1]


def _normal_scores(n: int) -> FloatArray:
    import scipy  # noqa: PLC0415 - only where pictures are drawn

    return np.asarray(scipy.special.ndtri((np.arange(n) + 0.5) / n))
