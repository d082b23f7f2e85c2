"""Which records and columns of a fit are asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import as_items
from bayes_rs.errors import InputError, in_short
from bayes_rs.fits.record_keys import RecordKey, as_start, is_time, record_numbers
from bayes_rs.fits.summarizing import COLUMNS

Selection: TypeAlias = RecordKey | slice | ArrayLike
"""Numbers or starts of records, a slice of them, or a truth value for each."""


def check_columns(columns: Sequence[str]) -> tuple[str, ...]:
    """Return names of columns of a summary.

    Raises
    ------
    InputError
        If there is no such column.
    """
    wanted = tuple(as_items(columns, what="columns"))
    for name in wanted:
        if name not in COLUMNS:
            raise InputError(f"Invalid column {name!r} of a summary: it has {', '.join(COLUMNS)}.")
    return wanted


def selected_records(
    records: Selection, n_record: int, time: Callable[[], NDArray[np.datetime64]]
) -> NDArray[np.int64]:
    """Return the numbers of the records that are asked for, rising and each once.

    Parameters
    ----------
    records : int, str, datetime, Timestamp, datetime64, slice or array_like
        As for `Fit.summary`.
    n_record : int
        Number of records.
    time : callable
        Returns their starts, shape (n_record,).

    Raises
    ------
    InputError
        If it names no records of the fit.
    """
    if isinstance(records, slice):
        ends = (records.start, records.stop)
        if any(isinstance(end, str) or is_time(end) for end in ends):
            return _between(*ends, records.step, time())
        if not all(end is None or isinstance(end, (int, np.integer)) for end in (*ends, records.step)):
            raise InputError(f"Invalid records {records!r}: give a slice of numbers, or of ISO times as texts.")
        if records.step == 0:
            raise InputError(f"Invalid records {records!r}: the step of a slice must not be 0.")
        return np.unique(np.arange(n_record)[records])
    values = np.atleast_1d(np.asarray(records))
    if values.dtype.kind == "b":
        if values.shape != (n_record,):
            raise InputError(
                f"Invalid records of shape {values.shape}: truth values must be one for each of {n_record} records."
            )
        return np.flatnonzero(values)
    if values.size == 0:
        return np.empty(0, dtype=np.int64)
    if values.dtype.kind not in "iuMUTO" or values.ndim != 1:
        raise InputError(
            f"Invalid records {in_short(records)}: give numbers, a slice of numbers or of ISO times, starts, or a "
            "truth value for each record."
        )
    return record_numbers(values, n_record, time)


def _between(start: object, stop: object, step: object, time: NDArray[np.datetime64]) -> NDArray[np.int64]:
    """Return the records that start from one time on and before another."""
    if step is not None:
        raise InputError(f"Invalid records with step {step!r}: a slice of times has none.")
    chosen = ~np.isnat(time)
    for end, wanted in ((start, np.greater_equal), (stop, np.less)):
        if end is not None:
            stamp = as_start(end)
            if np.isnat(stamp):
                raise InputError(f"Invalid time {end!r} of records: give an ISO time such as 2020-09-04T12:00.")
            chosen &= wanted(time, stamp)
    return np.flatnonzero(chosen)
