"""The samples of a series as the filters take them: beam after beam, each beam in time's order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.file_options import VELOCITY_LIMIT

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class BeamSamples:
    """The samples of a series beam after beam, each beam in time's order, none twice.

    Parameters
    ----------
    time : ndarray of int, shape (n_sample,)
        Nanoseconds since 1970-01-01 00:00 UTC.
    beam, group : ndarray of int, shape (n_sample,)
        Place of each sample's beam in `numbers`; record and beam together, ``beam * n_record + record``.
    velocity : ndarray, shape (n_sample,)
        Radial velocity, m/s; NaN where missing.
    columns : mapping of str to ndarray, shape (n_sample,)
        What else the series holds of each sample, by name: ``cnr``, ``status``.
    numbers : ndarray of int, shape (n_beam,)
        The scan's numbers of the beams.
    n_record : int
        Number of records.
    velocity_limit : float
        Speed that no wind has, m/s.
    """

    time: IntArray
    beam: IntArray
    group: IntArray
    velocity: FloatArray
    columns: Mapping[str, FloatArray]
    numbers: IntArray
    n_record: int
    velocity_limit: float = VELOCITY_LIMIT

    @property
    def n_group(self) -> int:
        """Number of records times number of beams."""
        return self.n_record * len(self.numbers)

    def by_beam(self, chosen: BoolArray) -> list[int]:
        """Count the chosen samples of each beam."""
        return [int(count) for count in np.bincount(self.beam[chosen], minlength=len(self.numbers))]
