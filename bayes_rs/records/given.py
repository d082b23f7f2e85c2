"""What is given as records or as a series is one."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import short
from bayes_rs.records.layout import TURBINE, check_layout


def check_are_records(records: xr.Dataset, *, ranges: bool = False) -> None:
    """Check that a Dataset holds records; also such at several ranges, if `ranges` says so.

    Raises
    ------
    InputError
        If it is no Dataset, or one of samples, or its variables are not laid out as those of records are.
    """
    if not isinstance(records, xr.Dataset):
        what = repr(records) if isinstance(records, str) else f"of type {type(records).__name__}"
        raise InputError(f"Invalid records {what}: give those of make_records(series, scan) or open_records(file).")
    if "radial_velocity" in records:
        raise InputError("Invalid records: they are samples; give make_records(samples, scan).")
    check_layout(records, "variance", "beam", ranges=ranges)
    if records.sizes.get("record") == 0:
        raise InputError("There is no record: the series is shorter than one averaging period.")
    if records.sizes.get("beam") == 0:
        raise InputError(
            "Invalid records: they hold no beam; select at least one, or make them again with make_records."
        )
    check_starts(records, "give every record once, and no two that overlap")


def check_starts(records: xr.Dataset, advice: str) -> None:
    """Check that no two records of a turbine have the same start.

    Raises
    ------
    InputError
        If two have.
    """
    if "time" not in records.coords or records["time"].dims != ("record",):
        return
    names = [name for name in ("time", TURBINE) if name in records.variables]
    again = pd.DataFrame({name: records[name].values for name in names}).duplicated().to_numpy()
    again = again & records["time"].notnull().values
    if again.any():
        many = "" if TURBINE in records else "; records of several turbines need its name in each (--turbine)"
        raise InputError(
            f"{np.count_nonzero(again)} records start at the same time as another, the first at "
            f"{records['time'].values[again][0]}: {advice}{many}."
        )


def check_is_series(series: xr.Dataset, *, ranges: bool = False) -> None:
    """Check that a Dataset holds samples; also such of several ranges, if `ranges` says so.

    Raises
    ------
    InputError
        If it is no Dataset, or lacks a variable over the samples.
    """
    if not isinstance(series, xr.Dataset):
        what = repr(series) if isinstance(series, str) else f"of type {type(series).__name__}"
        raise InputError(f"Invalid series {what}: give the Dataset of read(files, scan).")
    for name in ("radial_velocity", "time", "beam"):
        if name not in series.variables or series[name].dims != ("sample",):
            raise InputError(f"Invalid series: it needs {name!r} over the dimension 'sample'; make it with read.")
    if "range" in series.variables and not ranges:
        known = np.unique(series["range"].values)
        raise InputError(
            f"The series is of {len(known)} ranges ({', '.join(short(known[:12]))} m), and one of one is wanted here: "
            f"read it with the scan at one, as NAME@focus_distance={known[0]:g} (--focus-distance {known[0]:g})."
        )
