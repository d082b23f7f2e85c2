"""Times of rays in a NetCDF file: when each was measured, and for how long."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.netcdf_group import Group
from bayes_rs.readers.netcdf_missing import without_missing
from bayes_rs.stated_time import says_since

_GREGORIAN = ("standard", "gregorian", "proleptic_gregorian")
_MOST_SECONDS = 4e9
_SECONDS_SINCE = re.compile(
    r"(?:seconds|second|secs|sec|s)\s+since\s+((?:19|20)\d\d-\d\d-\d\d)"
    r"(?:[T ](\d{1,2}:\d\d:\d\d)(\.\d{1,9})?)?\s*(?:Z|UTC|[+-]?0{1,2}:?00)?"
)
"""As most files count: ARM's end with an offset of 0:00, which no library reads."""

_SECONDS = {"ms": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3, "s": 1.0, "second": 1.0, "seconds": 1.0}
_REFERENCE = "time_reference"


def times_of(sweep: Group, name: str, file: Path) -> NDArray[np.datetime64]:
    """Return the times of the rays; older files give the epoch as text in a variable of its own."""
    if name not in sweep.variables:
        return np.zeros(0, dtype="datetime64[ns]")  # rays_from refuses the file
    variable = sweep.variables[name]
    units = str(variable.attrs.get("units", ""))
    if _REFERENCE in sweep.variables and (_REFERENCE in units or not units):
        units = f"seconds since {text_of(sweep.variables[_REFERENCE])}"
    return decode_times(variable, units, name, file)


def accumulation_time_of(sweep: Group) -> FloatArray | None:
    """Return how long rays took, s; None if the file does not say, or not in a unit that is known."""
    if "ray_accumulation_time" not in sweep.variables:
        return None
    variable = sweep.variables["ray_accumulation_time"]
    factor = _SECONDS.get(str(variable.attrs.get("units", "ms")).strip().lower())
    if factor is None or not np.issubdtype(variable.dtype, np.number):
        return None
    return factor * np.asarray(variable.values, dtype=np.float64)


@lru_cache(maxsize=64)
def _epoch(units: str) -> np.datetime64 | None:
    """Return what units count seconds from, UTC; None if they are no seconds or say it in another way than ISO 8601."""
    found = _SECONDS_SINCE.fullmatch(units.strip())
    if found is None:
        return None
    date, time, fraction = found[1], found[2] or "00:00:00", found[3] or ""
    try:
        return np.datetime64(f"{date}T{time.zfill(8)}{fraction}", "ns")
    except ValueError:
        return None


def decode_times(variable: xr.Variable, units: str, name: str, file: Path) -> NDArray[np.datetime64]:
    """Return times that a file counts in `units` (such as ``seconds since 1970-01-01``), NaT where missing.

    Raises
    ------
    InputError
        If the units or the calendar cannot be used, or the times are no numbers.
    """
    calendar = variable.attrs.get("calendar", "standard")
    epoch = _epoch(units) if calendar in _GREGORIAN else None
    if epoch is not None and variable.dtype.kind in "iuf":
        seconds = np.asarray(without_missing(variable).values, dtype=np.float64)
        known = np.isfinite(seconds)
        if not known.any() or np.abs(seconds[known]).max() < _MOST_SECONDS:
            counted = np.where(known, seconds, 0.0)
            whole = np.floor(counted)
            since = 1_000_000_000 * whole.astype(np.int64) + np.round(1e9 * (counted - whole)).astype(np.int64)
            times = epoch + since.astype("timedelta64[ns]")
            times[~known] = np.datetime64("NaT", "ns")
            return np.asarray(times)
    attributes = {"units": units, **{key: variable.attrs[key] for key in ("calendar",) if key in variable.attrs}}
    try:
        if not says_since(units):
            raise ValueError("they do not say the date that they count from")
        raw = np.asarray(without_missing(variable).values, dtype=np.float64)
        dated = xr.Variable(variable.dims, np.where(np.isfinite(raw), raw, np.nan), attributes)
        decoded = xr.decode_cf(xr.Dataset({"t": dated}), decode_timedelta=False)["t"].values
        if not np.issubdtype(decoded.dtype, np.datetime64):
            raise ValueError("they are no dates of the Gregorian calendar")
        return decoded.astype("datetime64[ns]")
    except UNREADABLE as error:
        raise InputError(
            f"Variable {name!r} of file {str(file)!r} cannot be read as times in {units!r}: {_first_line(error)}; "
            "give a file whose times are counted by the CF conventions, such as 'seconds since 1970-01-01'."
        ) from error


def text_of(variable: xr.Variable) -> str:
    """Return the text that a variable holds as a string, bytes or characters."""
    raw = variable.values
    if raw.dtype.kind == "S" and raw.ndim:
        return b"".join(raw.ravel().tolist()).decode("utf-8", errors="replace").strip("\0 ")
    value = raw.ravel()[0] if raw.size else ""
    return (value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)).strip("\0 ")


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
