"""A table of another instrument, by starts of its periods: read, checked, and matched with records."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.errors import InputError
from bayes_rs.stated_time import stated_times

_log = logging.getLogger(__name__)
_NEAR = 0.05
"""A row belongs to a record if their starts differ by at most this share of the record's length."""


def reference_table(source: str | Path | pd.DataFrame, *, what: str = "reference") -> tuple[pd.DataFrame, str]:
    """Return a table, read if it is a file, and what and where it is in words."""
    if isinstance(source, pd.DataFrame):
        return source, f"{what} that was given"
    try:
        return pd.read_csv(source, dtype=str, encoding="utf-8-sig", skipinitialspace=True), f"{what} in {str(source)!r}"
    except (OSError, ValueError) as error:  # the errors of pandas' parser are ValueErrors
        raise InputError(f"The {what} {str(source)!r} cannot be read as CSV: {error}.") from error


def reference_times(column: pd.Series[Any], where: str) -> NDArray[np.datetime64]:
    """Return the starts of a table's periods, UTC, each there once."""
    if isinstance(column.dtype, pd.DatetimeTZDtype) or column.dtype.kind == "M":
        stamps = pd.to_datetime(column, utc=True)
    else:
        stamps = stated_times(column)
    bad = np.flatnonzero(stamps.isna().to_numpy())
    if len(bad):
        raise InputError(
            f"Row {bad[0]} of the {where} has the time {str(column.iloc[bad[0]])!r}: write 2020-09-04 12:00."
        )
    found = stamps.dt.tz_localize(None).to_numpy().astype("datetime64[ns]")
    order, count = np.unique(found, return_counts=True)
    if np.any(count > 1):
        raise InputError(f"The {where} has {count.max()} rows of {order[count > 1][0]}: keep one of a time.")
    return np.asarray(found)


def reference_numbers(column: pd.Series[Any], name: str, where: str) -> FloatArray:
    """Return a column of numbers; NaN where it is empty."""
    found = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    empty = column.isna() | column.astype("string").str.strip().str.lower().isin(["", "nan", "na", "null"])
    bad = np.flatnonzero(~np.isfinite(found) & ~empty.to_numpy(dtype=np.bool_))
    if len(bad):
        raise InputError(
            f"Row {bad[0]} of the {where} has {name} {str(column.iloc[bad[0]])!r}, which is no number: leave "
            "it empty where there is none."
        )
    return np.asarray(found)


def check_stated(stated: Any, duration: float, where: str) -> None:
    """Check that a table of periods whose length it states, s, is of the records' length; None states nothing.

    Raises
    ------
    InputError
        If it is of another one.
    """
    if stated is None:
        return
    own = check_positive(stated, what=f"duration of the {where}", unit="s")
    if not np.isclose(own, duration):
        raise InputError(
            f"The {where} is of periods of {own:g} s, and the records last {duration:g} s: make it for these, "
            f"as with bayes_rs.wind.sonic_stresses(series, duration={duration:g})."
        )


def matched_rows(
    start: NDArray[np.datetime64],
    time: NDArray[np.datetime64],
    duration: float,
    where: str,
    say: Callable[[str], object] = _log.warning,
) -> NDArray[np.int64]:
    """Return the row of each record, −1 where there is none.

    Parameters
    ----------
    start : ndarray of datetime64, shape (n,)
        Starts of the table's periods.
    time : ndarray of datetime64, shape (n_record,)
        Starts of the records.
    duration : float
        Length of a record, s.
    where : str
        What the table is and where, in words.
    say : callable
        Takes a line that says that the rows are as far apart as periods of another length are.

    Raises
    ------
    InputError
        If no row is of any record.
    """
    known = ~np.isnat(time)
    if not len(start) or not known.any():
        raise InputError(
            f"The {where} has {len(start)} rows, and {int(known.sum())} of {len(time)} records have a time: "
            "they are matched by time."
        )
    order = np.argsort(start)
    ordered = start[order].astype(np.int64)
    wanted = np.where(known, time.astype("datetime64[ns]").astype(np.int64), 0)
    above = np.clip(np.searchsorted(ordered, wanted), 0, len(ordered) - 1)
    below = np.maximum(above - 1, 0)
    nearest = np.where(np.abs(ordered[below] - wanted) <= np.abs(ordered[above] - wanted), below, above)
    near = known & (np.abs(ordered[nearest] - wanted) <= _NEAR * duration * 1e9)
    if not near.any():
        raise InputError(
            f"No row of the {where} ({span_words(start)}) begins with a record ({span_words(time[known])}): check its "
            "time zone, and that its times are starts."
        )
    if words := _other_step(np.diff(ordered) / 1e9, duration):
        say(f"The {where} {words}")
    return np.where(near, order[nearest], -1)


def _other_step(steps: FloatArray, duration: float) -> str:
    """Say that rows so far apart, s, seem to be of periods of another length than records; nothing if they do not.

    Gaps make steps longer, never shorter: rows of longer periods have no step as short as a record.
    """
    if not len(steps):
        return ""
    step = float(np.median(steps))
    shorter = step < (1.0 - _NEAR) * duration
    if not shorter:
        step = float(steps.min())
        if step <= (1.0 + _NEAR) * duration:
            return ""
    return (
        f"has rows {step:g} s apart, and the records last {duration:g} s: the row that begins with a record is taken "
        f"for all of it; if rows are of {'shorter' if shorter else 'longer'} periods, give those of {duration:g} s"
    )


def span_words(time: NDArray[np.datetime64]) -> str:
    """Return the first and the last of some times, UTC, in words."""
    return " to ".join(np.datetime_as_string([time.min(), time.max()], unit="s"))
