"""Which records of a long campaign are sampled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_generator, check_count
from bayes_rs.campaign.cells import speed_bin


def choose_records(wind_speed: FloatArray, most: int, seed: int | np.random.Generator) -> NDArray[np.int64]:
    """Choose at most `most` records, as many of each wind speed as there are, evenly in time.

    Parameters
    ----------
    wind_speed : ndarray, shape (n_record,)
        Mean wind speeds in the records' order of time, m/s.
    most : int
        How many to choose.
    seed : int or numpy.random.Generator
        Seed of where the first one lies.

    Returns
    -------
    chosen : ndarray of int, shape (min(n_record, most),)
        Their places, rising. Every record has the same probability to be chosen.

    Notes
    -----
    A systematic sample (Cochran 1977, Ch. 8) of the records sorted by bin of wind speed and, within a bin, by time:
    steps of n_record/most from a random start.

    References
    ----------
    Cochran (1977), Sampling Techniques, 3rd ed., Wiley.
    """
    check_count(most, what="most")
    n = len(wind_speed)
    if n <= most:
        return np.arange(n)
    order = np.lexsort((np.arange(n), speed_bin(np.asarray(wind_speed, dtype=np.float64))))
    start = as_generator(seed).uniform()
    place = np.floor((start + np.arange(most)) * (n / most)).astype(np.int64)
    return np.asarray(np.sort(order[np.minimum(place, n - 1)]))
