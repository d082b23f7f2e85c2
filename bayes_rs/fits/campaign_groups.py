"""The classes of the records of a campaign, in words."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs.errors import InputError
from bayes_rs.fits.fit_options import CAMPAIGN_GROUPS

MOST_GROUPS = 24
"""Classes that a campaign may have."""
_SPEED_WIDTH = 4
"""Width of the classes of wind speed, m/s."""
_SECTOR = 30
"""Width of the sectors of direction, degrees; the first is centred on 0."""
_HOURS = 4
"""Hours of a class of the time of day, UTC."""
UNKNOWN = "unknown"
"""Class of records whose class is not known."""


def campaign_groups(records: xr.Dataset, name: str | None) -> NDArray[np.str_] | None:
    """Return the class of each record, in words.

    Parameters
    ----------
    records : Dataset
        The records.
    name : str or None
        ``"wind_speed"``, in classes of 4 m/s; ``"direction"``, in sectors of 30° of ``wind_direction`` where records
        have it and of ``yaw`` (relative to the lidar's axis) otherwise; ``"hour"``, in four hours of the day, UTC; or a
        variable of the records that holds texts or whole numbers.

    Returns
    -------
    group : ndarray of str, shape (n_record,), or None
        None if there are to be no classes.

    Raises
    ------
    InputError
        If the records do not have it, or in too many values.

    Examples
    --------
    >>> records = xr.Dataset({"yaw": ("record", [-10.0, 20.0, 350.0])})
    >>> campaign_groups(records, "direction").tolist()
    ['345 to 15 degrees', '15 to 45 degrees', '345 to 15 degrees']
    """
    if name is None:
        return None
    if name in CAMPAIGN_GROUPS and name not in records:
        group = _SOME[name](records)
    elif name == "wind_speed":
        group = _by_wind_speed(records)
    else:
        group = _of_variable(records, name)
    found = np.unique(group)
    if len(found) > MOST_GROUPS:
        raise InputError(
            f"Invalid campaign_group {name!r}: the records have {len(found)} different values of it, and at most "
            f"{MOST_GROUPS} classes are possible; give the records a variable with fewer."
        )
    return group


def _by_wind_speed(records: xr.Dataset) -> NDArray[np.str_]:
    return _classes(np.asarray(records["wind_speed"].values, dtype=np.float64), _SPEED_WIDTH, 0.0, None, "m/s")


def _by_direction(records: xr.Dataset) -> NDArray[np.str_]:
    source = "wind_direction" if "wind_direction" in records else "yaw"
    return _classes(np.asarray(records[source].values, dtype=np.float64), _SECTOR, 0.5 * _SECTOR, 360, "degrees")


def _by_hour(records: xr.Dataset) -> NDArray[np.str_]:
    if "time" not in records.coords or not np.issubdtype(records["time"].dtype, np.datetime64):
        raise InputError("Invalid campaign_group 'hour': the records have no times.")
    time = records["time"].values.astype("datetime64[s]")
    hour = (time - time.astype("datetime64[D]")).astype(np.float64) / 3600.0
    return _classes(np.where(np.isnat(time), np.nan, hour), _HOURS, 0.0, None, "h UTC")


_SOME = {"wind_speed": _by_wind_speed, "direction": _by_direction, "hour": _by_hour}


def _classes(value: NDArray[np.float64], width: int, shift: float, turn: int | None, unit: str) -> NDArray[np.str_]:
    """Name the classes of this width that begin at −shift; numbers on a circle come round after `turn`."""
    known = np.isfinite(value)
    number = np.floor((np.where(known, value, 0.0) + shift) / width).astype(np.int64)
    low = number * width - round(shift)
    high = low + width
    if turn is not None:
        low, high = low % turn, high % turn
    names = [f"{one} to {other} {unit}" for one, other in zip(low.tolist(), high.tolist(), strict=True)]
    return np.where(known, np.array(names, dtype=np.str_), UNKNOWN)


def _of_variable(records: xr.Dataset, name: str) -> NDArray[np.str_]:
    if name not in records or records[name].dims != ("record",):
        one_each = [str(key) for key in records.data_vars if records[key].dims == ("record",)]
        raise InputError(
            f"Invalid campaign_group {name!r}: it must be {', '.join(CAMPAIGN_GROUPS)}, or a variable of the records "
            f"with one value each: {', '.join(one_each)}."
        )
    values = records[name].values
    if values.dtype.kind == "f":
        known = np.isfinite(values)
        if np.any(values[known] != np.round(values[known])):
            raise InputError(
                f"Invalid campaign_group {name!r}: its values are numbers with fractions; give the records a variable "
                "with a text or a whole number for each class."
            )
        return np.where(known, np.where(known, values, 0.0).astype(np.int64).astype(np.str_), UNKNOWN)
    if values.dtype.kind not in "iubUSO":
        raise InputError(f"Invalid campaign_group {name!r}: its values must be texts or whole numbers.")
    texts = np.array([UNKNOWN if value is None else str(value).strip() or UNKNOWN for value in values.tolist()])
    return texts.astype(np.str_)
