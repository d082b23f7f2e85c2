"""How a record is named: by its number, or by its start in any form in which Python holds a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs.errors import InputError, in_short
from bayes_rs.stated_time import stated_times

RecordKey: TypeAlias = int | str | datetime | np.datetime64
"""Number of a record, or its start: ISO time, ``datetime``, ``pandas.Timestamp`` or ``numpy.datetime64``, UTC."""
_MOST_NAMED = 3
"""Records that a message names of those that start at one time."""


def is_time(value: object) -> bool:
    """Tell whether a value is a time, and no text of one.

    Examples
    --------
    >>> is_time(np.datetime64("2020-09-04")), is_time(pd.Timestamp("2020-09-04")), is_time("2020-09-04")
    (True, True, False)
    """
    return isinstance(value, (datetime, np.datetime64))


def as_start(value: object) -> np.datetime64:
    """Return a time, or the text of one, as UTC without a zone; NaT if it is none.

    Parameters
    ----------
    value : str, datetime, Timestamp or datetime64
        The time; one that states no zone is taken for UTC.

    Examples
    --------
    >>> as_start("2020-09-04T14:00+02:00")
    np.datetime64('2020-09-04T12:00:00.000000000')
    """
    try:
        if is_time(value):
            stamp = pd.Timestamp(value)  # type: ignore[arg-type] # a time, as was asked
            found = stamp if pd.isna(stamp) or stamp.tzinfo is None else stamp.tz_convert("UTC").tz_localize(None)
        else:
            found = stated_times(pd.Series([str(value)])).dt.tz_localize(None)[0]
        return np.datetime64("NaT", "ns") if pd.isna(found) else found.as_unit("ns").to_datetime64()
    except (ValueError, OverflowError):  # a year that nanoseconds do not reach
        return np.datetime64("NaT", "ns")


def number_or_start(record: Any) -> int | np.datetime64:
    """Return what names a record: its number, or its start.

    Parameters
    ----------
    record : int, str, datetime, Timestamp or datetime64
        The name; a text of digits is a number. An array without dimensions stands for what it holds.

    Raises
    ------
    InputError
        If it is neither.
    """
    if isinstance(record, (np.ndarray, xr.DataArray)) and record.ndim == 0:
        record = np.asarray(record)[()]
    if isinstance(record, str) and record.lstrip("-").isdecimal():
        return int(record)
    if isinstance(record, (int, np.integer)) and not isinstance(record, bool):
        return int(record)
    start = as_start(record) if isinstance(record, str) or is_time(record) else np.datetime64("NaT", "ns")
    if np.isnat(start):
        raise InputError(f"Invalid record {in_short(record)}: give a number or a time such as 2020-09-04T12:00.")
    return start


def record_numbers(
    records: Sequence[Any] | NDArray[Any], n_record: int, time: Callable[[], NDArray[np.datetime64]]
) -> NDArray[np.int64]:
    """Return the numbers of records that are named, rising and each once; of a start all records that start then.

    Parameters
    ----------
    records : sequence of int, str, datetime, Timestamp or datetime64
        What names them.
    n_record : int
        Number of records.
    time : callable
        Returns their starts, shape (n_record,); it is called if one is named by its start.

    Raises
    ------
    InputError
        If there is no such record.
    """
    kind = records.dtype.kind if isinstance(records, np.ndarray) else ""
    if isinstance(records, np.ndarray) and kind not in ("i", "u", "M"):
        records = records.tolist()  # texts and times as they were given
    keys = records if kind in ("i", "u", "M") else [number_or_start(record) for record in records]
    of_time = [kind == "M" or isinstance(key, np.datetime64) for key in keys]
    numbers = np.array([key for key, its in zip(keys, of_time, strict=True) if not its], dtype=np.int64)
    beyond = numbers[(numbers < 0) | (numbers >= n_record)]
    if len(beyond):
        raise InputError(f"No record {beyond[0]}: there are {n_record}, numbered from 0.")
    if not any(of_time):
        return np.unique(numbers)
    starts = np.array([key for key, its in zip(keys, of_time, strict=True) if its], dtype="datetime64[ns]")
    named = [record for record, its in zip(records, of_time, strict=True) if its]
    known = time()
    for index in np.flatnonzero(~np.isin(starts, known))[:1].tolist():
        number_or_start(named[index])  # what is no time is told so
        raise _no_start(named[index], starts[index], known)
    return np.union1d(numbers, np.flatnonzero(np.isin(known, starts)))


def record_number(record: Any, n_record: int, time: Callable[[], NDArray[np.datetime64]]) -> int:
    """Return the number of one record.

    Parameters
    ----------
    record : int, str, datetime, Timestamp or datetime64
        What names it.
    n_record : int
        Number of records.
    time : callable
        Returns their starts, shape (n_record,); it is called if the record is named by its start.

    Raises
    ------
    InputError
        If there is no such record, or several start at that time.
    """
    match = record_numbers([record], n_record, time)
    if len(match) > 1:
        first = ", ".join(map(str, match[:_MOST_NAMED].tolist()))
        raise InputError(
            f"{len(match)} records start at {_written(record)}, as those of several turbines do: give a number, as "
            f"{first}."
        )
    return int(match[0])


def _no_start(record: object, start: np.datetime64, time: NDArray[np.datetime64]) -> InputError:
    known = time[~np.isnat(time)]
    if not len(known):
        return InputError(f"No record starts at {_written(record)}: the records have no times; give a number.")
    earlier = known[known < start]
    near = f"; the last before it at {_written(earlier.max())}" if len(earlier) else ""
    return InputError(
        f"No record starts at {_written(record)}: the records start from {_written(known[0])} to "
        f"{_written(known[-1])} (UTC){near}."
    )


def _written(time: object) -> str:
    """Write a time as it was given, or to the second where it has no part of one."""
    return str(time) if isinstance(time, str) else str(as_start(time)).removesuffix(f".{0:09d}")
