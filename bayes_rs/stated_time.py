"""Times that a text states in full: what libraries would fill in from the clock of the machine is no time."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Any

import pandas as pd

_FULL_DATE = r"^\d{4}(?:\W\d{1,2}\W\d{1,2}|\d{4})"
_SAID_SINCE = re.compile(r"\d{1,5}([-/. ])\d{1,2}\1\d{1,2}(?!\d)|\d{8}(?!\d)")
_FRACTION = re.compile(r"%S[.,:]%f")
_MIDNIGHT = re.compile(r"^(.*(?:\D|^))24((?::?00)(?:(?::?00)(?:[.,]0+)?)?(?![\d:]).*)$")
_LEAP_SECOND = re.compile(r"^(.*59:?)60(?:[.,]\d*)?(?!\d)")
_SIXTY = r":6[01](?!\d)"
_FIRST, _LAST = pd.Timestamp("1700-01-01", tz="UTC"), pd.Timestamp("2262-01-01", tz="UTC")
_EXAMPLE = datetime(2003, 11, 22, 13, 14, 15, tzinfo=UTC)
"""No two of its numbers are the same."""


def stated_times(text: pd.Series[Any], pattern: str | None = None) -> pd.Series[Any]:
    """Return texts as times, NaT where one is not a full date, or a full date and time of day.

    Parameters
    ----------
    text : Series of str
        The texts.
    pattern : str, optional
        How they are written, as ``%d.%m.%Y %H:%M:%S``; by default in ISO 8601.

    Returns
    -------
    times : Series of datetime64, UTC
        The times; those that state no offset are taken for UTC.

    Notes
    -----
    Pandas takes ``today`` and ``now`` for the clock of the machine, whatever pattern it is given, and a year for its
    first day. ``24:00:00`` is the next day's midnight, as ISO 8601 has it. A leap second, ``23:59:60``, is
    ``23:59:59.999999``, whatever its fraction: no day of UTC as computers count has it, and it must not come after what
    follows.

    Examples
    --------
    >>> stated_times(pd.Series(["2020-09-03 19:00", "2020-09-03", "today", "now", "2020", "19:00"])).notna().tolist()
    [True, True, False, False, False, False]
    """
    text = text.astype("string")
    full = text.str.contains(_FULL_DATE if pattern is None else r"\d", regex=True, na=False)
    found = _parsed(text.where(full), pattern)
    if pattern is not None and ":%f" not in pattern:  # of 60 seconds, pandas makes a minute
        found = found.mask(text.str.contains(_SIXTY, regex=True, na=False))
    late = full & found.isna()
    for words, instead, shift in (
        (_MIDNIGHT, r"\g<1>00\g<2>", pd.Timedelta(days=1)),
        (_LEAP_SECOND, r"\g<1>59", pd.Timedelta(microseconds=999_999)),
    ):
        if late.any():
            other = text.str.replace(words, instead, regex=True)
            changed = _parsed(other.where(late & (other != text).fillna(value=False).astype(bool)), pattern)
            changed = changed.where((changed > _FIRST) & (changed < _LAST)) + shift
            if changed.notna().any():
                found = found.astype("datetime64[us, UTC]") if found.dt.unit != "ns" else found
                found = found.where(changed.isna(), changed.astype(found.dtype))
    return found


def _parsed(text: pd.Series[Any], pattern: str | None) -> pd.Series[Any]:
    """Return texts as times of a pattern, also where a fraction of a second is left out with its sign."""
    found = pd.to_datetime(text, format=pattern or "ISO8601", utc=True, errors="coerce")
    if pattern is not None and _FRACTION.search(pattern):
        left = text.where(found.isna())
        if left.notna().any():
            whole = pd.to_datetime(left, format=_FRACTION.sub("%S", pattern), utc=True, errors="coerce")
            found = found.where(whole.isna(), whole.astype(found.dtype))
    return found


def states_a_date(pattern: str) -> bool:
    """Say whether a pattern can be read, and states year, month and day.

    Examples
    --------
    >>> states_a_date("%d.%m.%Y %H:%M"), states_a_date("%H:%M:%S"), states_a_date("%n")
    (True, False, False)
    """
    try:
        found = stated_times(pd.Series([_EXAMPLE.strftime(pattern)]), pattern)[0]
    except (ValueError, re.error):  # a directive that pandas does not know
        return False
    return not pd.isna(found) and found.date() == _EXAMPLE.date()


def says_since(units: str) -> bool:
    """Say whether units of times, such as ``seconds since 1970-01-01``, state the full date that they count from.

    Examples
    --------
    >>> says_since("days since 1970-1-1 00:00"), says_since("seconds since today"), says_since("hours since 10:30")
    (True, False, False)
    """
    _, since, date = units.partition(" since ")
    return bool(since) and _SAID_SINCE.match(date.strip()) is not None
