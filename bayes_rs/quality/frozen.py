"""Frozen values: a beam that repeats one number."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.quality.samples import BoolArray, IntArray


def is_frozen(velocity: FloatArray, group: IntArray, there: BoolArray, *, run: int) -> BoolArray:
    """Find runs of at least `run` equal values in the sequence of a beam's samples in a record.

    Parameters
    ----------
    velocity : ndarray, shape (n_sample,)
        Radial velocities, m/s, beam after beam and each in time's order.
    group : ndarray of int, shape (n_sample,)
        Record and beam of each sample, as one number.
    there : ndarray of bool, shape (n_sample,)
        Which samples no other filter has dropped; a sample that is not there ends a run.
    run : int
        Number of equal values that count as frozen.

    Returns
    -------
    frozen : ndarray of bool, shape (n_sample,)
        Which samples stand in such a run; all of it, since nothing tells its first value from the others.
    """
    goes_on = np.zeros(len(velocity), dtype=bool)
    goes_on[1:] = (velocity[1:] == velocity[:-1]) & (group[1:] == group[:-1]) & there[1:] & there[:-1]
    number = np.cumsum(~goes_on) - 1
    return np.asarray(there & (np.bincount(number)[number] >= run))
