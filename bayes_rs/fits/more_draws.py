"""How many draws a record needs, so that the numbers of its summary are as precise as asked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.quantities import LIMITS

NUMBERS = ("mean", "median", "low", "high")
"""Columns of the summary whose Monte-Carlo errors count."""
_MARGIN = 1.1
"""More draws than the error says: it scatters itself, and another look costs as much as the last."""
_GROWTH = 4.0
"""Most that the draws grow by from one look to the next: of few draws the largest error is overstated."""
_STEPS = (1.0, 1.5)
"""Numbers of draws are these times a power of two: few sizes, so that records share the points that are proposed."""


def monte_carlo_error(summary: Mapping[str, FloatArray]) -> FloatArray:
    """Return the largest Monte-Carlo standard error of a record's numbers over the posterior sd of their stress.

    Parameters
    ----------
    summary : mapping of str to ndarray, shape (n_record, n_quantity)
        ``sd`` and ``mcse_…`` of `NUMBERS`, as `summarize_draws` gives them; the stresses come first.

    Returns
    -------
    error : ndarray, shape (n_record,)
        Of mean, median and both ends of the interval of all stresses, the largest; NaN where one is not known.
    """
    stresses = slice(0, len(STRESSES))
    with np.errstate(invalid="ignore", divide="ignore"):  # draws that are all equal
        errors = [summary[f"mcse_{name}"][:, stresses] / summary["sd"][:, stresses] for name in NUMBERS]
    return np.asarray(np.max(errors, axis=(0, 2)))


def most_draws(options: FitOptions) -> float:
    """Return how many times the draws of `target_ess` a record may get: as often as chains may be doubled."""
    return float(min(2.0**options.max_extension, LIMITS["target_ess"].most // options.target_ess))


def times_the_draws(error: FloatArray, times: FloatArray, options: FitOptions) -> FloatArray:
    """Return how many times the draws of `target_ess` records need for the error that is asked.

    Parameters
    ----------
    error : ndarray, shape (n_record,)
        From `monte_carlo_error`, with the draws that there are.
    times : ndarray, shape (n_record,)
        How many times the draws of `target_ess` these are.
    options : FitOptions
        The options of the fit.

    Returns
    -------
    needed : ndarray, shape (n_record,)
        As `times` where the error is reached, or not known, or there are as many draws as may be; more elsewhere.

    Notes
    -----
    Errors go with one over the root of the number of draws.
    """
    asked, most = options.monte_carlo_error, most_draws(options)
    if asked is None:
        return times
    short = (error > asked) & (times < most)
    needed = np.where(short, times * np.minimum(_MARGIN * (error / asked) ** 2, _GROWTH), times)
    power = 2.0 ** np.floor(np.log2(needed))
    ladder = np.array([*(step * power for step in _STEPS), 2.0 * power])
    up = np.min(np.where(ladder >= needed, ladder, np.inf), axis=0)
    return np.where(short, np.minimum(np.where(up > times, up, 2.0 * times), most), times)


def expected_times(options: FitOptions) -> float:
    """Return how many times the draws of `target_ess` a usual record will need: one with near normal posteriors.

    The end of a 90 % interval of a normal distribution has an error of 2.1/√n sd, of the usual skewed one 3/√n.
    """
    if options.monte_carlo_error is None:
        return 1.0
    needed = (3.0 / options.monte_carlo_error) ** 2 / options.target_ess
    return float(np.clip(needed, 1.0, most_draws(options)))


def by_size(needed: FloatArray, times: FloatArray) -> Iterator[tuple[float, NDArray[np.int64]]]:
    """Give the places of records that need more draws, by how many times the draws of `target_ess` they need."""
    for size in np.unique(needed[needed > times]).tolist():
        yield size, np.flatnonzero((needed == size) & (needed > times))


def with_draws(options: FitOptions, times: float) -> FitOptions:
    """Return the options of a fit with so many times the draws; the prior is the one that was made."""
    target_ess = min(int(np.ceil(times * options.target_ess)), int(LIMITS["target_ess"].most))
    return replace(options, prior=options.made_prior, target_ess=target_ess)
