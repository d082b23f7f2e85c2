"""Turbulence intensity of another instrument: read from a table, and matched with the records by their starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, in_short
from bayes_rs.readers.toa5 import is_toa5, read_sonic
from bayes_rs.reference_table import check_stated, matched_rows, reference_numbers, reference_table, reference_times
from bayes_rs.wind.sonic import sonic_stresses

_LARGEST = 1.0
"""Median above which a turbulence intensity is taken for one in per cent."""
_NAMES = {"time": "time", "timestamp": "time", "ti": "ti", "sigma_u": "sigma_u", "u": "U", "wind_speed": "U"}


def intensity_reference(
    source: str | Path | pd.DataFrame | xr.Dataset, time: NDArray[np.datetime64], duration: float
) -> tuple[FloatArray, FloatArray]:
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

    Raises
    ------
    InputError
        If the file cannot be read, columns are missing, times or numbers are none, two rows are of one time, the
        intensity is in per cent, no row is of any record, or a sonic's stresses are of periods of another length.
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
    ti = np.where(np.isfinite(ti) & (ti > 0.0), ti, np.nan)
    if np.isfinite(ti).any() and np.nanmedian(ti) > _LARGEST:
        raise InputError(
            f"The turbulence intensity of the {where} has the median {np.nanmedian(ti):g}: give σ_u/U, not per cent."
        )
    row = matched_rows(start, time, duration, where)
    there = row >= 0
    return np.where(there, ti[row], np.nan), np.where(there, speed[row], np.nan)


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
