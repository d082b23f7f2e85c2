"""Entries of a file as numbers, times and beams: each converted or refused with its place in the file."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timezone
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.quick_times import quick_iso_times, quick_pattern_times
from bayes_rs.readers.table import Column
from bayes_rs.stated_time import stated_times

BoolArray = NDArray[np.bool_]
_EPOCHS = {
    "unix": ("1970-01-01", 1.0),
    "unix-ms": ("1970-01-01", 1e-3),
    "unix-us": ("1970-01-01", 1e-6),
    "unix-ns": ("1970-01-01", 1e-9),
    "labview": ("1904-01-01", 1.0),
    "matlab": ("1970-01-01", 86400.0),
}
_LIKELY = (3.15e8, 2.1e9)  # seconds from 1970 to 1980 and to 2036
_MATLAB_EPOCH = 719529.0  # the datenum of 1970-01-01
_WITH_OFFSET = r":\d{2}.*(?:Z|z|[+-]\d{2}(?::?\d{2})?)$"


def numbers(column: Column, file_format: FileFormat) -> tuple[FloatArray, BoolArray]:
    """Return a column as float64, NaN where an entry is missing, and which entries held an invalid value.

    Raises
    ------
    InputError
        If an entry is text, or the column is of complex numbers, or of true and false where that is no value.
    """
    kind = column.values.dtype
    if pd.api.types.is_complex_dtype(kind) or (pd.api.types.is_bool_dtype(kind) and column.name != "status"):
        raise InputError(
            f"Invalid {column.name} in {column.where(0)}: the entries are of type {kind}, and must be real numbers; "
            "give another column."
        )
    if pd.api.types.is_numeric_dtype(kind):
        values = column.values.to_numpy(dtype=np.float64, na_value=np.nan)
    else:
        text = _as_text(column.values, file_format)
        values, bad = text_as_numbers(text)
        if bad.any():
            index = int(np.argmax(bad))
            column.refuse(
                bad,
                f"Invalid {column.name} {_shown(column.values.iloc[index])} in {column.where(index)}: it must be a "
                "number; correct the entry, leave it empty if the value is missing",
            )
    finite = np.isfinite(values)
    if not file_format.invalid:
        return values if finite.all() else np.where(finite, values, np.nan), np.zeros(len(values), dtype=bool)
    is_invalid = file_format.is_invalid(values, column.name)
    return np.where(is_invalid | ~finite, np.nan, values), is_invalid


def text_as_numbers(text: pd.Series[Any]) -> tuple[FloatArray, BoolArray]:
    """Return texts as numbers, NaN where there is none, and which are no numbers."""
    try:
        plain = pa.chunked_array(pa.array(text, pa.string(), from_pandas=True)).cast(pa.float64())
    except pa.ArrowInvalid:
        pass
    else:
        return plain.to_numpy().astype(np.float64), np.zeros(len(text), dtype=bool)
    known = (text.notna() & (text != "") & (text.str.lower() != "nan")).to_numpy(dtype=bool)
    good = known & pd.to_numeric(text, errors="coerce").notna().to_numpy(dtype=bool)
    values = np.full(len(text), np.nan)
    values[good] = [float(entry) for entry in text[good]]  # to the last digit, as the parser above
    return values, known & ~good


def times(column: Column, file_format: FileFormat) -> tuple[NDArray[np.datetime64], BoolArray]:
    """Return a column as UTC times, NaT where an entry is missing, and which entries held an invalid value.

    Raises
    ------
    InputError
        If an entry is not a date and time, or is not one time in the file's zone.
    """
    raw = column.values
    if isinstance(raw.dtype, pd.DatetimeTZDtype):
        return _as_ns(raw.dt.tz_convert("UTC").dt.tz_localize(None)), np.zeros(len(raw), dtype=bool)
    if pd.api.types.is_datetime64_dtype(raw.dtype):
        return _to_utc(raw, column, file_format), np.zeros(len(raw), dtype=bool)
    quick = _quick_times(column, file_format)
    if quick is not None:
        return quick, np.zeros(len(raw), dtype=bool)
    text = _as_text(raw, file_format)
    if file_format.time_format in _EPOCHS:
        count, _ = text_as_numbers(text)
        is_invalid = file_format.is_invalid(count)
        known = (text.notna() & (text != "")).to_numpy(dtype=bool) & ~is_invalid
        return _counted(count, known, column, file_format.time_format), is_invalid
    is_number = pd.to_numeric(text.mask(text.str.contains(":", regex=False)), errors="coerce")
    is_invalid = file_format.is_invalid(is_number.to_numpy(dtype=np.float64, na_value=np.nan))
    known = (text.notna() & (text != "")).to_numpy(dtype=bool) & ~is_invalid
    pattern = file_format.time_format
    if pattern is not None and file_format.decimal == ",":  # as in the entries, which have points by now
        pattern = pattern.replace(",", ".")
    parsed = stated_times(text.where(known), pattern)
    in_range = (parsed > pd.Timestamp.min.tz_localize("UTC")) & (parsed < pd.Timestamp.max.tz_localize("UTC"))
    bad = known & ~in_range.to_numpy(dtype=bool)
    if file_format.time_format is None:  # ISO 8601 would take a bare number for a year
        bad |= known & is_number.notna().to_numpy(dtype=bool)
    if bad.any():
        index = int(np.argmax(bad))
        rule = "in ISO 8601, such as 2020-09-03T19:00:01.5 or 2020-09-03 20:00:01+01:00"
        hint = ""
        if file_format.time_format is None:
            counted = _epoch_of(float(is_number.iloc[index])) if is_number.notna().iloc[index] else ""
            hint = f", or give its time_format{counted}"
        else:
            rule = f"of the form {file_format.time_format!r}"
        column.refuse(
            bad,
            f"Invalid time {_shown(raw.iloc[index])} in {column.where(index)}: it must be a date and time {rule}; "
            f"correct the entry{hint}",
        )
        parsed = parsed.mask(bad)
        known &= ~bad
    naive = parsed.dt.tz_localize(None)
    with_offset = text.str.contains(_WITH_OFFSET, regex=True, na=False).to_numpy(dtype=bool)
    if with_offset.all() or (with_offset | ~known).all():
        return _as_ns(naive), is_invalid
    converted = _to_utc(naive.where(~with_offset), column, file_format)
    return np.where(with_offset, _as_ns(naive), converted), is_invalid


def _epoch_of(number: float) -> str:
    """Return, in words, how a number of a likely size counts time, or nothing."""
    names = [
        name for name in _EPOCHS if name.startswith("unix") and _LIKELY[0] < number * _EPOCHS[name][1] < _LIKELY[1]
    ]
    return f": by its size it is {names[0]!r} (--time-format {names[0]})" if names else ""


def _quick_times(column: Column, file_format: FileFormat) -> NDArray[np.datetime64] | None:
    """Return the times of a plain column, or None."""
    raw = column.values
    if not isinstance(raw.dtype, pd.StringDtype) or file_format.time_format in _EPOCHS:
        return None
    text = pa.chunked_array(pa.array(raw, pa.string(), from_pandas=True))
    pattern = file_format.time_format
    if file_format.decimal == ",":
        text = pc.replace_substring(text, ",", ".")
        pattern = None if pattern is None else pattern.replace(",", ".")
    if pattern is None:
        found = quick_iso_times(text)
        if found is None:
            return None
        time, with_offset = found
        if with_offset:
            return time
    else:
        of_pattern = quick_pattern_times(text, pattern)
        if of_pattern is None:
            return None
        time = of_pattern
    zone = file_format.zone
    if isinstance(zone, timezone):
        shift = round(1e6 * zone.utcoffset(None).total_seconds())
        return time - np.timedelta64(shift, "us")
    return time if file_format.time_zone == "UTC" else _to_utc(pd.Series(time), column, file_format)


def _counted(count: FloatArray, known: BoolArray, column: Column, time_format: str) -> NDArray[np.datetime64]:
    """Return times that are counted from an epoch, to a microsecond; float64 resolves no more."""
    epoch, unit = _EPOCHS[time_format]
    seconds = unit * (count - (_MATLAB_EPOCH if time_format == "matlab" else 0.0))
    bad = known & ~(np.abs(seconds) < 9e9)
    if bad.any():
        index = int(np.argmax(bad))
        counted = _epoch_of(float(count[index]))
        column.refuse(
            bad,
            f"Invalid time {_shown(column.values.iloc[index])} in {column.where(index)}: it must be a number, as "
            f"time_format={time_format!r} counts; correct the entry, or give another time_format{counted}",
        )
        known &= ~bad
    micro = np.round(1e6 * np.where(known, seconds, 0.0)).astype("timedelta64[us]")
    time = (np.datetime64(epoch, "us") + micro).astype("datetime64[ns]")
    return np.where(known, time, np.datetime64("NaT", "ns"))


def _shown(raw: object) -> str:
    text = str(raw)
    return repr(text if len(text) <= 60 else f"{text[:60]}…")


def beams(column: Column, scan: Scan, file_format: FileFormat) -> tuple[NDArray[np.int64], BoolArray, BoolArray]:
    """Return a column as beam numbers of the scan, which entries are missing, and which held an invalid value.

    Raises
    ------
    InputError
        If a beam is not one of the scan's.
    """
    code, labels = pd.factorize(column.values)
    number_of = np.zeros(len(labels) + 1, dtype=np.int64)  # the last stands for entries without a value
    is_missing, is_invalid = (np.zeros(len(labels) + 1, dtype=bool) for _ in range(2))
    is_missing[-1] = True
    for index, raw in enumerate(labels):
        label = beam_label(raw)
        number = beam_number(label, scan, file_format)
        is_mark = number is None and bool(file_format.is_invalid(_as_float(label)))  # the scan's beams mark nothing
        if label == "" or label.lower() == "nan" or is_mark:
            is_missing[index], is_invalid[index] = True, label not in ("", "nan")
            continue
        if number is None:
            _refuse_beam(label, code == index, column, scan, file_format)
            is_missing[index] = True
            continue
        number_of[index] = number
    return number_of[code], is_missing[code], is_invalid[code]


def _refuse_beam(label: str, rows: BoolArray, column: Column, scan: Scan, file_format: FileFormat) -> None:
    """Refuse a beam that the scan does not have; a text that is no number may be a row to leave out."""
    error = unknown_beam(label, column.where(int(np.argmax(rows))), scan, file_format)
    if column.bad is None or not column.bad.drop or np.isfinite(_as_float(label)):
        raise error
    column.refuse(rows, str(error).removesuffix("."))


def beam_label(raw: object) -> str:
    """Return what the file writes for a beam as text, without the decimals of a whole number."""
    if isinstance(raw, (float, np.floating)) and float(raw).is_integer():
        return str(int(raw))
    return str(raw).strip()


def beam_number(label: str, scan: Scan, file_format: FileFormat) -> int | None:
    """Return the scan's number of the beam that the file calls `label`, or None if it has none."""
    if file_format.beam_numbers:
        number = file_format.beam_numbers.get(label)
        if number is None:  # the file may write 2.0 or 02 for 2
            value = _as_float(label)
            number = file_format.beam_numbers.get(beam_label(float(value))) if np.isfinite(value) else None
    else:
        value = _as_float(label)
        number = int(value) if np.isfinite(value) and float(value).is_integer() else None
    return number if number is not None and number in scan.beam else None


def unknown_beam(label: str, where: str, scan: Scan, file_format: FileFormat) -> InputError:
    """Return the error to raise for a beam that the scan does not have."""
    used = f" by beam_numbers={dict(file_format.beam_numbers)}" if file_format.beam_numbers else ""
    return InputError(
        f"Unknown beam {label!r} in {where}: it is not{used} one of the beams of scan {scan.name!r}, "
        f"{_shortened(scan.beam.tolist())}; map it with beam_numbers={{{label!r}: number}} "
        f"(--beam-number {label}=NUMBER), or give the scan that the file was measured with."
    )


def _as_text(values: pd.Series[Any], file_format: FileFormat) -> pd.Series[Any]:
    text = values.astype("string").str.strip()
    return text.str.replace(",", ".", regex=False) if file_format.decimal == "," else text


def _as_float(label: str) -> FloatArray:
    try:
        return np.asarray(float(label))
    except ValueError:
        return np.asarray(np.nan)


def _as_ns(values: pd.Series[Any]) -> NDArray[np.datetime64]:
    return values.to_numpy().astype("datetime64[ns]")


def _to_utc(values: pd.Series[Any], column: Column, file_format: FileFormat) -> NDArray[np.datetime64]:
    local = values.dt.tz_localize(file_format.zone, ambiguous="NaT", nonexistent="NaT")
    lost = (local.isna() & values.notna()).to_numpy(dtype=bool)
    if lost.any():
        index = int(np.argmax(lost))
        raise InputError(
            f"Invalid time {_shown(column.values.iloc[index])} in {column.where(index)}: the clock change makes it "
            f"twice or not at all a time in {file_format.time_zone}; if the instrument keeps one offset all year, "
            "give that, for example time_zone='UTC+1'."
        )
    return _as_ns(local.dt.tz_convert("UTC").dt.tz_localize(None))


def _shortened(numbers: Sequence[int]) -> str:
    listed = [str(number) for number in numbers]
    return ", ".join(listed) if len(listed) <= 12 else f"{', '.join(listed[:5])} … {listed[-1]}"
