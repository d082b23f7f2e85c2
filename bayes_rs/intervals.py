"""Credible intervals from draws: the one place where they are made, and the names that say which they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice, check_prob

INTERVALS = {
    "equal-tailed": "as much probability below as above",
    "highest-density": "the narrowest that holds the probability",
}
"""The kinds of intervals, in words."""
EQUAL_TAILED, HIGHEST_DENSITY = INTERVALS


def interval_words(prob: float, kind: str) -> str:
    """Return what a legend calls an interval.

    Examples
    --------
    >>> interval_words(0.9, "equal-tailed")
    '90 % interval, equal-tailed'
    """
    return f"{100.0 * prob:g} % interval, {kind}"


def interval_of(draws: FloatArray, prob: float, kind: str = EQUAL_TAILED) -> tuple[FloatArray, FloatArray]:
    """Return the credible interval of draws.

    Parameters
    ----------
    draws : ndarray, shape (..., n_draw)
        Draws.
    prob : float
        Share of the draws within, between 0 and 1.
    kind : {"equal-tailed", "highest-density"}
        Which interval.

    Returns
    -------
    low, high : ndarray, shape (...)
        Ends of the interval.

    Raises
    ------
    InputError
        If the probability or the kind is not valid.

    Notes
    -----
    The ends of the equal-tailed interval are quantiles, so those of a function that only grows, as √uu/U of uu, are the
    function's values at the ends. The interval of highest density is the narrowest of all that hold ⌊prob · n⌋ steps
    between neighbouring draws (Chen and Shao 1999). It is not carried over by such functions: of a variance that is
    hardly known it leaves out large values that the interval of its logarithm holds. Its ends have a larger Monte-Carlo
    error, because intervals of the same probability that lie near each other are nearly as narrow.

    References
    ----------
    Chen and Shao (1999), Journal of Computational and Graphical Statistics 8, 69–92,
    doi:10.1080/10618600.1999.10474802.

    Examples
    --------
    >>> draws = np.array([0.0, 1.0, 2.0, 3.0, 10.0])
    >>> for kind in INTERVALS:
    ...     print(kind, *interval_of(draws, 0.5, kind))
    equal-tailed 1.0 3.0
    highest-density 0.0 2.0
    """
    check_prob(prob)
    check_choice(kind, tuple(INTERVALS), what="interval")
    return interval_of_ordered(np.sort(draws, axis=-1), prob, kind)


def interval_of_ordered(ordered: FloatArray, prob: float, kind: str = EQUAL_TAILED) -> tuple[FloatArray, FloatArray]:
    """Return the interval of draws in order, smallest first; shapes as in `interval_of`."""
    if kind == EQUAL_TAILED:
        tail = 0.5 * (1.0 - prob)
        return quantile_of_ordered(ordered, tail), quantile_of_ordered(ordered, 1.0 - tail)
    step = _steps(ordered.shape[-1], prob)
    first = _first(ordered, step)[..., np.newaxis]
    return tuple(np.take_along_axis(ordered, place, axis=-1)[..., 0] for place in (first, first + step))  # type: ignore[return-value] # two of them


def interval_levels(ordered: FloatArray, prob: float, kind: str = EQUAL_TAILED) -> tuple[FloatArray, FloatArray]:
    """Return the probabilities below the ends of the interval of draws in order, each of shape (...)."""
    if kind == EQUAL_TAILED:
        below = np.full(ordered.shape[:-1], 0.5 * (1.0 - prob))
        return below, 1.0 - below
    last, step = ordered.shape[-1] - 1, _steps(ordered.shape[-1], prob)
    first = _first(ordered, step)
    return np.asarray(first / max(last, 1)), np.asarray((first + step) / max(last, 1))


def quantile_of_ordered(ordered: FloatArray, level: float) -> FloatArray:
    """Return a quantile of draws in order, (..., n), by linear interpolation between them."""
    position = level * (ordered.shape[-1] - 1)
    below = int(position)
    above = min(below + 1, ordered.shape[-1] - 1)
    return np.asarray(ordered[..., below] + (position - below) * (ordered[..., above] - ordered[..., below]))


def _steps(n_draw: int, prob: float) -> int:
    """Return how many steps between neighbouring draws hold the probability."""
    return min(int(prob * n_draw), n_draw - 1)


def _first(ordered: FloatArray, step: int) -> NDArray[np.intp]:
    """Return the place of the lower end of the narrowest interval of so many steps; the first of equal ones."""
    width = ordered[..., step:] - ordered[..., : ordered.shape[-1] - step]
    return np.asarray(np.argmin(width, axis=-1))
