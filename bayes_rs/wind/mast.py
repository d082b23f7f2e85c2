"""What a mast measured beside a lidar, with the records of that: a further block of the data of their fit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_array
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.records.layout import check_layout
from bayes_rs.reference_table import matched_rows, reference_numbers, reference_table, reference_times

MAST, MAST_POSITION = "mast_stress", "mast_position"
"""Variable of records with the stresses of a mast, and attribute with its place."""
_ROUNDING = 1e-9


def with_mast(records: xr.Dataset, mast: xr.Dataset | pd.DataFrame | str | Path, *, position: ArrayLike) -> xr.Dataset:
    """Return records that hold what a mast measured in the same periods; a fit takes it as data beside the beams.

    Parameters
    ----------
    records : Dataset
        From `make_records`, at one range.
    mast : Dataset, DataFrame, str or Path
        From `sonic_stresses`; or a table, or a CSV file, with the column ``time`` (start of the period, UTC if no
        offset is stated) and some of ``uu``, ``vv``, ``ww``, ``uv``, ``uw``, ``vw``, m² s⁻², in the
        frame of the period's mean wind, its mean removed. The variance of a cup anemometer is ``uu`` alone.
    position : array_like, shape (3,)
        Where it measures, m from the lidar in the levelled frame of that: x against the view of a nacelle lidar, z up.
        So a mast 200 m in front of it is at (-200, 0, 0).

    Returns
    -------
    records : Dataset
        With ``mast_stress`` (record, stress), NaN where there is none, and the place in
        ``attrs["mast_position"]``.

    Raises
    ------
    InputError
        If the columns are missing, a variance is not above zero, a tensor is not realizable, or no period is one of the
        records.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
    >>> cup = pd.DataFrame({"time": ["2000-01-01 00:10"], "uu": [1.3]})
    >>> with_mast(brs.make_records(series, "2-beam"), cup, position=(-98, 0, 0))["mast_stress"].values[:, 0]
    array([nan, 1.3])
    """
    check_layout(records, "variance", "flag", "wind_speed", "yaw")
    place = check_array(position, (3,), what="position of the mast")
    if isinstance(mast, xr.Dataset):
        if "stress" not in mast or mast["stress"].dims != ("record", "component"):
            raise InputError("Invalid mast: it has no 'stress' (record, component); give what sonic_stresses returns.")
        table: pd.DataFrame | str | Path = pd.DataFrame(
            {"time": mast["time"].values, **dict(zip(STRESSES, mast["stress"].values.T, strict=True))}
        )
    elif isinstance(mast, (str, Path, pd.DataFrame)):
        table = mast
    else:
        raise InputError(f"Invalid mast {in_short(mast)}: give a file, a table, or what sonic_stresses returns.")
    stress = _matched(table, records)
    return records.assign(
        {MAST: (("record", "stress"), stress, {"units": "m2 s-2", "long_name": "stresses that a mast measured"})}
    ).assign_attrs({MAST_POSITION: json.dumps(place.tolist())})


def _matched(mast: pd.DataFrame | str | Path, records: xr.Dataset) -> FloatArray:
    """Return the stresses of the mast at each record, shape (n_record, 6)."""
    table, where = reference_table(mast)
    columns = {str(name).strip().lower(): name for name in table.columns}
    there = [name for name in STRESSES if name in columns]
    if "time" not in columns or "uu" not in there:
        found = ", ".join(repr(str(name)) for name in table.columns[:20])
        raise InputError(f"The mast {where} has the columns {found}, and needs time and at least uu: rename them.")
    start = reference_times(table[columns["time"]], where)
    values = np.full((len(table), len(STRESSES)), np.nan)
    for name in there:
        values[:, STRESSES.index(name)] = reference_numbers(table[columns[name]], name, where)
    _check_realizable(values, where)
    row = matched_rows(start, records["time"].values, float(records.attrs.get("duration", 600.0)), where)
    return np.where((row >= 0)[:, np.newaxis], values[row], np.nan)


def _check_realizable(values: FloatArray, where: str) -> None:
    """Refuse variances that are not above zero, and covariances that are beyond them."""
    bad = np.argwhere(values[:, :3] <= 0.0)
    if len(bad):
        row, column = (int(index) for index in bad[0])
        raise InputError(
            f"Row {row} of the mast {where} has {STRESSES[column]} {values[row, column]:g} m² s⁻²: a "
            "variance is above zero; leave it empty where there is none."
        )
    for column, (i, j) in enumerate(((0, 1), (0, 2), (1, 2)), start=3):
        most = np.sqrt(values[:, i] * values[:, j])
        beyond = np.flatnonzero(np.abs(values[:, column]) >= most * (1.0 - _ROUNDING))
        if len(beyond):
            raise InputError(
                f"Row {beyond[0]} of the mast {where} has {STRESSES[column]} {values[beyond[0], column]:g} m² "
                f"s⁻², beyond the root of {STRESSES[i]} times {STRESSES[j]}, {most[beyond[0]]:g}: no wind has that."
            )
