"""What no atmosphere has: velocities beyond all winds, and times of a clock that was not set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_UNITS

BoolArray = NDArray[np.bool_]

MOST_ANGLE = 720.0
"""Degrees; scanners and vanes may count on beyond a turn, numbers that stand for nothing are far beyond."""
CLOCK_GAP = np.timedelta64(30, "D")
"""Times of a clock that was not set are taken for such only so far from all others."""
MOST_TOLD = 10
"""Impossible values that a report names, the most frequent first."""

_FIRST = np.datetime64("1990-01-01", "ns")
_RESET = (np.datetime64("1999-12-30", "ns"), np.datetime64("2000-02-01", "ns"))
_OVERRUN = np.datetime64("2036-02-06", "ns")
"""Clocks that were not set start in 1970 or 1980, or on 2000-01-01; they run over in 2036, 2038 and 2106."""
_NO_UNIT = 1e5
"""A number that no unit makes a wind: 100 m/s are 1e5 mm/s."""
_BITS = (32766.0, 32767.0, 32768.0, 65535.0)
_FILL_SHARE = 0.05
"""Share of the impossible values from which on one that repeats stands for a missing entry."""
_LEAST = 10
"""Scattered values from which on they say something of the unit."""
_MOST_VALUES = 10_000
_USUAL = (0.3, 60.0)
"""Median speeds, m/s, that make a unit likely."""


def is_impossible(velocity: FloatArray, limit: float) -> BoolArray:
    """Say which velocities are beyond plus or minus `limit`, in its unit; those that are NaN are not."""
    return np.asarray((velocity > limit) | (velocity < -limit))


def is_unset(time: NDArray[np.datetime64]) -> BoolArray:
    """Say which times a clock shows that was not set, if others of the same source are far from them.

    Parameters
    ----------
    time : ndarray of datetime64[ns], shape (n,)
        UTC.

    Returns
    -------
    unset : ndarray of bool, shape (n,)
        Before 1990, in January 2000 (two days before it, too), or from 6 February 2036 on.
    """
    if len(time) and _RESET[1] <= time.min() and time.max() < _OVERRUN:
        return np.zeros(len(time), dtype=bool)  # as nearly always
    return np.asarray((time < _FIRST) | ((time >= _RESET[0]) & (time < _RESET[1])) | (time >= _OVERRUN))


def is_far(time: NDArray[np.datetime64], first: np.datetime64, last: np.datetime64) -> BoolArray:
    """Say which times are more than `CLOCK_GAP` before `first` or after `last`."""
    return np.asarray((time < first - CLOCK_GAP) | (time > last + CLOCK_GAP))


def of_unset_clock(time: NDArray[np.datetime64]) -> BoolArray:
    """Say which of several times a clock shows that was not set; none if all do, or if no other is far from them."""
    unset = is_unset(time)
    if not unset.any() or unset.all():
        return np.zeros(len(time), dtype=bool)
    return unset & is_far(time, time[~unset].min(), time[~unset].max())


def is_mark(value: float) -> bool:
    """Say whether a number is one that files use for a missing entry: nines, a power of two, or beyond any unit."""
    size = abs(value)
    return size >= _NO_UNIT or size in _BITS or set(f"{size:.9g}".replace(".", "")) == {"9"}


@dataclass
class Impossible:
    """The impossible values of a source, counted.

    Parameters
    ----------
    values : Counter
        How often each occurs; those beyond the first `_MOST_VALUES` different ones are only in `count`.
    count, n_good : int
        How many values are impossible, and how many are not and are there.
    first : str
        Where the first one stands; empty if that is not known.
    """

    values: Counter[float] = field(default_factory=Counter)
    count: int = 0
    n_good: int = 0
    first: str = ""

    def add(
        self, values: FloatArray, n_good: int, as_written: Callable[[FloatArray], FloatArray] | None = None
    ) -> None:
        """Count more values, all of them impossible, beside `n_good` that are not; `as_written` turns them back."""
        self.count += len(values)
        self.n_good += n_good
        if len(values):
            different, number = np.unique(values, return_counts=True)
            different = different if as_written is None else as_written(different)
            for value, times in zip(different.tolist(), number.tolist(), strict=True):
                if value in self.values or len(self.values) < _MOST_VALUES:
                    self.values[value] += times

    def join(self, other: Impossible) -> None:
        """Count what another part of the source has counted."""
        self.count += other.count
        self.n_good += other.n_good
        self.values.update(other.values)

    @property
    def n_scattered(self) -> int:
        """How many of them do not stand for a missing entry: no mark, and no value that repeats."""
        least = max(2.0, _FILL_SHARE * self.count)
        return self.count - sum(n for value, n in self.values.items() if n >= least or is_mark(value))

    def check(self, what: str, limit: float, *, unit: str = "m/s", hint: bool = True) -> None:
        """Refuse a source most of whose values are impossible, and not one number for a missing entry.

        Parameters
        ----------
        what : str
            The source and its quantity, as ``File 'a.csv' holds radial velocities``.
        limit : float
            Beyond which they are, in `unit`.
        unit : str
            Unit of the values.
        hint : bool
            Whether the option ``velocity_unit`` can help.

        Raises
        ------
        InputError
            If more than half of the values that are there, and at least `_LEAST`, are impossible and scattered.
        """
        scattered = self.n_scattered
        if scattered < _LEAST or 2 * scattered <= self.n_good + scattered or scattered <= _FILL_SHARE * self.count:
            return
        least = max(2.0, _FILL_SHARE * self.count)
        loose = {value: n for value, n in self.values.items() if n < least and not is_mark(value)}
        sizes = np.repeat(np.abs(list(loose)), list(loose.values()))
        found = next(iter(loose))
        usual = [name for name in ("cm/s", "mm/s") if _USUAL[0] <= np.median(sizes) * VELOCITY_UNITS[name] <= _USUAL[1]]
        advice = "check their unit, and that they are what they should be"
        if hint and usual:
            named = " or ".join(f"velocity_unit={name!r} (--velocity-unit {name})" for name in usual)
            advice = f"another unit would make them usual, {named}; or give a larger velocity_limit (--velocity-limit)"
        where = f" in {self.first}" if self.first else ""
        raise InputError(
            f"{what} that no wind has: {scattered} of {self.n_good + scattered} are beyond {limit:g} {unit}, such as "
            f"{found:g}{where}; {advice}."
        )

    def told(self) -> dict[str, int]:
        """Return the most frequent values as text, and how often each occurs."""
        return {in_words(value): number for value, number in self.values.most_common(MOST_TOLD)}


def in_words(value: float) -> str:
    """Return a number as text that reads back as the same number, without the decimals of a whole one."""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def add_told(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    """Add up what `Impossible.told` says of two sources."""
    total: Counter[str] = Counter(one)
    total.update(other)
    return dict(total.most_common(MOST_TOLD))


def most_frequent(told: Mapping[str, Any]) -> tuple[str, int]:
    """Return the most frequent value of `Impossible.told` and how often it occurs."""
    return max(told.items(), key=lambda pair: pair[1])
