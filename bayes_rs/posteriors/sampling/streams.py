"""Random streams, one for each record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray


class RecordStreams:
    """One random stream for each record, so that a record's numbers do not depend on which others it is sampled with.

    Parameters
    ----------
    seed : int
        The seed of the whole fit.
    keys : sequence of int
        One number for each record, such as its start in nanoseconds; below zero before 1970.
    """

    def __init__(self, seed: int, keys: NDArray[np.int64]) -> None:
        self._streams = [
            np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, *divmod(int(key) % 2**64, 2**32)])))
            for key in keys
        ]

    def normal(self, records: NDArray[np.int64], shape: tuple[int, ...]) -> FloatArray:
        """Draw standard normal numbers, shape (len(records), *shape)."""
        return np.stack([self._streams[record].standard_normal(shape) for record in records])

    def chi_square(self, records: NDArray[np.int64], shape: tuple[int, ...], dof: float) -> FloatArray:
        """Draw χ² numbers with `dof` degrees of freedom, shape (len(records), *shape)."""
        return np.stack([2.0 * self._streams[record].standard_gamma(0.5 * dof, shape) for record in records])

    def uniform(self, records: NDArray[np.int64], shape: tuple[int, ...]) -> FloatArray:
        """Draw uniform numbers in [0, 1), shape (len(records), *shape)."""
        return np.stack([self._streams[record].random(shape) for record in records])

    def take(self, records: NDArray[np.int64]) -> RecordStreams:
        """Return the streams of some of the records; they are shared, not copied."""
        some = RecordStreams(0, np.empty(0, dtype=np.int64))
        some._streams = [self._streams[record] for record in records]
        return some
