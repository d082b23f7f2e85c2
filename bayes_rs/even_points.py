"""Points of the unit cube that fill it evenly: scrambled Sobol sequences, with whole direction numbers."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy

from bayes_rs._validation import FloatArray


def even_points(n_point: int, n_dimension: int, rng: np.random.Generator) -> FloatArray:
    """Return the first scrambled Sobol points.

    Parameters
    ----------
    n_point : int
        How many.
    n_dimension : int
        Dimensions of the cube.
    rng : numpy.random.Generator
        What scrambles them.

    Returns
    -------
    point : ndarray, shape (n_point, n_dimension)
        Inside the unit cube. They have 64 random bits: none is 0, and one of 1 by rounding is kept inside.

    References
    ----------
    Owen (2023), Practical Quasi-Monte Carlo Integration, Ch. 17, https://artowen.su.domains/mc/practicalqmc.pdf.
    """
    _load_direction_numbers()
    power = int(np.ceil(np.log2(n_point)))
    uniform = scipy.stats.qmc.Sobol(n_dimension, rng=rng).random_base2(power)[:n_point]
    return np.asarray(np.clip(uniform, 0.5**64, 1.0 - 0.5**53))


@cache
def _load_direction_numbers() -> None:
    """Have scipy read its table of direction numbers, which it does at the first use.

    Where an interrupt comes while it reads, the exception of it is swallowed, and the generator that is made goes on
    with zeros: its points are all the same. Once the table is read, nothing comes between.

    Raises
    ------
    KeyboardInterrupt
        That one.
    """
    if not scipy.stats.qmc.Sobol(2, scramble=False).random(2)[1].all():
        raise KeyboardInterrupt
