"""Which records of a long campaign are sampled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray


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
    """
    raise NotImplementedError
