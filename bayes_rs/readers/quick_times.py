"""Times of plain columns of text at once: what is not plain is left to the careful way."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
UIntArray = NDArray[np.uint8]

_LEAST_ISO = 16  # as 2020-09-03T19:00
_ZERO = 48
_DIRECTIVE = re.compile(r"%([YmdHMSf])|([^%\w])")
_WIDTH = {"Y": 4, "m": 2, "d": 2, "H": 2, "M": 2, "S": 2}
_YEARS = (1678, 2261)
_MOST_DECIMALS = 9


def quick_iso_times(text: pa.ChunkedArray) -> tuple[NDArray[np.datetime64], bool] | None:
    """Return texts in ISO 8601 as times, or None where one is not plain.

    Parameters
    ----------
    text : ChunkedArray of string
        Null where there is none.

    Returns
    -------
    time : ndarray of datetime64[ns], shape (n,)
        UTC where the texts state an offset, or as they stand.
    with_offset : bool
        Whether they do, all of them.
    """
    length = pc.min(pc.binary_length(text)).as_py()
    if length is None or length < _LEAST_ISO:
        return None
    for zone in (None, "UTC"):
        try:
            time = text.cast(pa.timestamp("ns", zone))
        except pa.ArrowInvalid:
            continue
        return time.cast(pa.timestamp("ns")).to_numpy().astype("datetime64[ns]", copy=False), zone is not None
    return None


def quick_pattern_times(text: pa.ChunkedArray, pattern: str) -> NDArray[np.datetime64] | None:
    """Return texts of a pattern of digits as times, or None where one is not of it to the letter.

    Parameters
    ----------
    text : ChunkedArray of string
        Null where there is none.
    pattern : str
        Of ``%Y %m %d %H %M %S`` with two digits (the year: four), signs between them, and perhaps ``%f`` at the end,
        also left out.
    """
    parts = _parts(pattern)
    if parts is None:
        return None
    time = np.full(len(text), np.datetime64("NaT"), dtype="datetime64[ns]")
    at = 0
    for chunk in text.chunks:
        if not _fill(time[at : at + len(chunk)], chunk, parts):
            return None
        at += len(chunk)
    return time


@cache
def _parts(pattern: str) -> tuple[tuple[str, str], ...] | None:
    """Return the pattern as (directive, "") and ("", sign), or None if it is not a plain one."""
    found, at = [], 0
    while at < len(pattern):
        match = _DIRECTIVE.match(pattern, at)
        if match is None or not (match[2] or "-").isascii():
            return None
        found.append((match[1] or "", match[2] or ""))
        at = match.end()
    names = [name for name, _ in found if name]
    whole = {"Y", "m", "d"} <= set(names) and len(set(names)) == len(names)
    if not whole or ("f" in names and (found[-1][0] != "f" or found[-2][0] or found[-3][0] != "S")):
        return None
    return tuple(found)


def _fill(time: NDArray[np.datetime64], chunk: pa.Array, parts: tuple[tuple[str, str], ...]) -> bool:
    if chunk.null_count == len(chunk):
        return True
    offsets = np.frombuffer(chunk.buffers()[1], dtype=np.int32)[chunk.offset : chunk.offset + len(chunk) + 1]
    data = np.frombuffer(chunk.buffers()[2], dtype=np.uint8)
    there = np.asarray(chunk.is_valid().to_numpy(zero_copy_only=False))
    length = np.diff(offsets)
    for size in np.unique(length[there]).tolist():
        which = np.flatnonzero(there & (length == size))
        if len(which) == len(chunk):
            text = data[offsets[0] : offsets[-1]].reshape(len(chunk), size)
        else:
            text = data[offsets[which][:, np.newaxis] + np.arange(size)]
        found = _parsed(text, parts)
        if found is None:
            return False
        time[which] = found
    return True


def _parsed(text: UIntArray, parts: tuple[tuple[str, str], ...]) -> NDArray[np.datetime64] | None:
    """Return texts of one length, shape (n, length), as times."""
    fixed = sum(_WIDTH.get(name, 0) if name else 1 for name, _ in parts)
    n_decimal = text.shape[1] - fixed
    if parts[-1][0] != "f":
        if n_decimal != 0:
            return None
    elif n_decimal == -1:  # the fraction is left out, with its sign
        parts = parts[:-2]
    elif not 1 <= n_decimal <= _MOST_DECIMALS:
        return None
    value: dict[str, IntArray] = {}
    at = 0
    for name, sign in parts:
        if sign:
            if (text[:, at] != ord(sign)).any():
                return None
            at += 1
            continue
        width = _WIDTH.get(name, n_decimal)
        number = np.zeros(len(text), dtype=np.int64)
        for place in range(at, at + width):
            digit = text[:, place] - np.uint8(_ZERO)  # of what is no digit, more than nine
            if (digit > 9).any():
                return None
            number = 10 * number + digit
        value[name] = number * 10 ** (_MOST_DECIMALS - width) if name == "f" else number
        at += width
    return _joined(value)


def _joined(value: dict[str, IntArray]) -> NDArray[np.datetime64] | None:
    most = {"H": 23, "M": 59, "S": 59, "m": 12, "Y": _YEARS[1]}
    least = {"m": 1, "d": 1, "Y": _YEARS[0]}
    if any((value[name] > limit).any() for name, limit in most.items() if name in value):
        return None
    if any((value[name] < limit).any() for name, limit in least.items()):
        return None
    month = (12 * (value["Y"] - 1970) + value["m"] - 1).astype("datetime64[M]")
    day = month.astype("datetime64[D]") + (value["d"] - 1)
    if (day.astype("datetime64[M]") != month).any():
        return None
    seconds = 3600 * value.get("H", 0) + 60 * value.get("M", 0) + value.get("S", 0)
    nanoseconds = np.asarray(1_000_000_000 * seconds + value.get("f", 0), dtype=np.int64)
    time: NDArray[np.datetime64] = day.astype("datetime64[ns]") + nanoseconds.astype("timedelta64[ns]")
    return time
