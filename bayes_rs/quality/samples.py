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

_CLOSE = 100_000


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


def distinct(numbers: IntArray) -> IntArray:
    """Return the distinct of many whole numbers, in order: quickly, if they lie as close together as those of beams."""
    if len(numbers) == 0:
        return np.empty(0, dtype=np.int64)
    low, high = int(numbers.min()), int(numbers.max())
    if high - low > _CLOSE:
        return np.unique(numbers).astype(np.int64)
    return low + np.flatnonzero(np.bincount(numbers - low))


def ends_by_beam(time: IntArray, beam: IntArray) -> dict[int, tuple[int, int]]:
    """Return for each beam the time of its first sample, and the latest of all its times."""
    numbers = distinct(beam)
    place = np.searchsorted(numbers, beam)
    first, latest = np.empty(len(numbers), dtype=np.int64), np.full(len(numbers), np.iinfo(np.int64).min)
    first[place[::-1]] = time[::-1]  # of several, the last one is kept
    if is_sorted(time):
        latest[place] = time
    else:
        np.maximum.at(latest, place, time)
    return {
        number: (begin, end)
        for number, begin, end in zip(numbers.tolist(), first.tolist(), latest.tolist(), strict=True)
    }


def is_sorted(time: IntArray) -> bool:
    """Say whether no time is earlier than the one before it."""
    return bool((time[1:] >= time[:-1]).all())
