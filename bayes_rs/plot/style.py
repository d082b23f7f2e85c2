"""What pictures of fits share: the truth that they mark, and what of a fit is the prior's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, as_numbers, check_array
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import EQUAL_TAILED, interval_words
from bayes_rs.posteriors.prior_at_size import prior_interval_at_size, sizes_of


def prior_band(fit: Fit, prob: float, interval: str = EQUAL_TAILED) -> FloatArray:
    """Return the interval of the prior at the size of each record's posterior, shape (2, n_record, 6), m² s⁻².

    It is of `prior_interval_at_size`: all pictures draw this behind a posterior. NaN where a record was not fitted.
    """
    mean, sd = sizes_of(fit.of_stresses("mean")["mean"], fit.covariance())
    return np.stack(prior_interval_at_size(fit.prior_draws, mean, sd, prob, interval))


def prior_words(prob: float, interval: str) -> str:
    """Return what the legend calls the prior's band."""
    return f"prior at the size uu + vv + ww, {interval_words(prob, interval)}"


def known_stresses(truth: ArrayLike, n_record: int) -> FloatArray:
    """Return the true stresses of each record, shape (n_record, 6), from those of all, (6,), or of each, (n_record, 6).

    Raises
    ------
    InputError
        If the shape is neither, an entry is not finite, or a variance is below zero.
    """
    given = as_numbers(truth, what="truth")
    shape = (6,) if given.ndim == 1 else (n_record, 6)
    known = np.broadcast_to(check_array(given, shape, what="truth"), (n_record, 6))
    negative = np.argwhere(known[:, :3] < 0.0)
    if len(negative):
        record, index = negative[0].tolist()
        raise InputError(
            f"Invalid truth: {STRESSES[index]} of record {record} is {known[record, index]:g}, and a variance is not "
            f"below zero; give the stresses in the order {', '.join(STRESSES)}."
        )
    return known
