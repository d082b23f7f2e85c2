"""Turbulence intensity of another instrument: read from a table, and matched with the records by their starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, in_short
from bayes_rs.file_options import VELOCITY_LIMIT
from bayes_rs.readers.toa5 import is_toa5, read_sonic
from bayes_rs.reference_table import check_stated, matched_rows, reference_numbers, reference_table, reference_times
from bayes_rs.wind.sonic import sonic_stresses

_LARGEST = 1.0
"""Turbulence intensity above which none is believed; a median above it is taken for one in per cent."""
_NAMES = {"time": "time", "timestamp": "time", "ti": "ti", "sigma_u": "sigma_u", "u": "U", "wind_speed": "U"}


def intensity_reference(
    source: str | Path | pd.DataFrame | xr.Dataset, time: NDArray[np.datetime64], duration: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return a reference's turbulence intensity and wind speed at each record.

    Parameters
    ----------
    source : str, Path, DataFrame or Dataset
        A CSV file, or a table: columns ``time`` (start of the period, ISO 8601, UTC if no offset is stated), and ``ti``
        (σ_u/U, no per cent) or ``sigma_u`` and ``U`` (both m/s); ``U`` may stand beside ``ti``. Capital letters do not
        matter, ``timestamp`` and ``wind_speed`` stand for ``time`` and ``U``. Or the series of a sonic, a TOA5 file or
        a folder of them (`read_sonic`), whose stresses are made for records of this length; or these stresses, as from
        `sonic_stresses`.
    time : ndarray of datetime64, shape (n_record,)
        Starts of the records.
    duration : float
        Their length, s.

    Returns
    -------
    ti, wind_speed : ndarray, shape (n_record,)
        NaN where the reference has no row within a twentieth of a record's length, or no valid number; wind speed in
        m/s.
    left_out : ndarray of bool, shape (n_record,)
        Where a row is not used for what it states: a turbulence intensity that is not above 0, or is above 1, or a wind
        speed that is not above 0, is above 90 m/s, or is empty while other rows have one.

    Raises
    ------
    InputError
        If the file cannot be read, columns are missing, times or numbers are none, two rows are of one time, the
        intensity is in per cent, no row is of any record, no such row has valid numbers, or a sonic's stresses are of
        periods of another length.
    """
    table, where = _table(source, duration)
    columns = {_NAMES[str(name).strip().lower()]: name for name in table.columns if str(name).strip().lower() in _NAMES}
    if "time" not in columns or not ("ti" in columns or {"sigma_u", "U"} <= set(columns)):
        found = ", ".join(repr(str(name)) for name in table.columns[:20])
        raise InputError(f"The {where} has the columns {found}, and needs time, and ti or sigma_u and U: rename them.")
    start = reference_times(table[columns["time"]], where)
    numbers = {name: reference_numbers(table[columns[name]], name, where) for name in columns if name != "time"}
    speed = numbers.get("U", np.full(len(table), np.nan))
    with np.errstate(invalid="ignore", divide="ignore"):
        ti = numbers["ti"] if "ti" in numbers else numbers["sigma_u"] / np.where(speed > 0.0, speed, np.nan)
    above = ti[np.isfinite(ti) & (ti > 0.0)]
    if len(above) and np.median(above) > _LARGEST:
        raise InputError(
            f"The turbulence intensity of the {where} has the median {np.median(above):g}: give σ_u/U, not per cent."
        )
    row = matched_rows(start, time, duration, where)
    there = row >= 0
    ti, speed, stated = ti[row], speed[row], np.isfinite(numbers["ti" if "ti" in numbers else "sigma_u"][row])
    valid = there & (ti > 0.0) & (ti <= _LARGEST)
    windy = (speed > 0.0) & (speed <= VELOCITY_LIMIT)
    if np.isfinite(speed[there]).any():
        valid &= windy
    if not valid.any():
        first = table[[name for key, name in columns.items() if key != "time"]].iloc[row[there][0]]
        raise InputError(
            f"None of the {int(there.sum())} rows of the {where} that begin with a record has a turbulence intensity "
            f"above 0 and up to {_LARGEST:g}, and a wind speed above 0 and up to {VELOCITY_LIMIT:g} m/s if rows have "
            f"any; the first has {', '.join(f'{name} {value}' for name, value in first.items())}: correct the columns, "
            "or leave the reference out."
        )
    return np.where(valid, ti, np.nan), np.where(there & windy, speed, np.nan), there & stated & ~valid


def _table(source: str | Path | pd.DataFrame | xr.Dataset, duration: float) -> tuple[pd.DataFrame, str]:
    if isinstance(source, xr.Dataset):
        where = "reference that was given"
        check_stated(source.attrs.get("duration"), duration, where)
        return _of_sonic(source), where
    if not isinstance(source, (str, Path, pd.DataFrame)):
        raise InputError(
            f"Invalid reference {in_short(source)}: give a file, a table, or what bayes_rs.wind.sonic_stresses returns."
        )
    if not isinstance(source, pd.DataFrame) and (Path(source).is_dir() or is_toa5(Path(source))):
        return _of_sonic(sonic_stresses(read_sonic(source), duration=duration)), f"reference in {str(source)!r}"
    return reference_table(source)


def _of_sonic(stresses: xr.Dataset) -> pd.DataFrame:
    """Return σ_u and the wind speed of a sonic's records.

    Raises
    ------
    InputError
        If they are not what `sonic_stresses` returns.
    """
    missing = [name for name in ("stress", "wind_speed", "time") if name not in stresses.variables]
    if missing:
        raise InputError(f"Invalid reference without {missing[0]!r}: give the Dataset of bayes_rs.wind.sonic_stresses.")
    return pd.DataFrame(
        {
            "time": stresses["time"].values,
            "sigma_u": np.sqrt(stresses["stress"].sel(component="uu").values),
            "U": stresses["wind_speed"].values,
        }
    )
