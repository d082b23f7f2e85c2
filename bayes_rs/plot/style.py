"""Colours of the figures, and the truth that they mark."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, as_numbers, check_array
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES

POSTERIOR_COLOUR = "#1f4e79"
PRIOR_COLOUR = "#c26a16"
TRUTH_COLOUR = "#1b7837"


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
