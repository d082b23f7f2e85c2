"""What is given as records or as a series is one."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan, short
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.scan_words import scan_difference
from bayes_rs.records.layout import TURBINE, check_layout

_log = logging.getLogger(__name__)


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


def check_starts(records: xr.Dataset, advice: str) -> None:
    """Check that records that have starts all have one, and no two of a turbine the same.

    Raises
    ------
    InputError
        If one has none, or two have the same.
    """
    if "time" not in records.coords or records["time"].dims != ("record",):
        return
    missing = np.flatnonzero(records["time"].isnull().values)
    if 0 < len(missing) < records.sizes["record"]:
        raise InputError(
            f"Invalid records: {len(missing)} of {records.sizes['record']} have no start (time NaT), the first is "
            f"record {missing[0]}: give each its start, leave these out, or drop 'time' from all."
        )
    names = [name for name in ("time", TURBINE) if name in records.variables]
    again = pd.DataFrame({name: records[name].values for name in names}).duplicated().to_numpy()
    again = again & records["time"].notnull().values
    if again.any():
        many = "" if TURBINE in records else "; records of several turbines need its name in each (--turbine)"
        raise InputError(
            f"{np.count_nonzero(again)} records start at the same time as another, the first at "
            f"{records['time'].values[again][0]}: {advice}{many}."
        )


def warn_of_other_scan(data: xr.Dataset, scan: Scan | RangedScan) -> None:
    """Warn that samples or records say that they are of another scan than the one that they are taken for.

    Of a few of a scan's beams the key is another, and probe volumes may be changed on purpose: so it is no error.
    """
    key, own = str(data.attrs.get("scan_key", "")), scan.of_one if isinstance(scan, RangedScan) else scan
    if key not in ("", own.key):
        _log.warning(
            "The %s are of another scan, %r, than %r, which they are taken for (%s): give the scan that they were made "
            "with, unless this is meant.",
            *("samples" if "radial_velocity" in data else "records", str(data.attrs.get("scan", "?")), own.name),
            what_differs(data, key, own),
        )


def what_differs(data: xr.Dataset, key: str, scan: Scan) -> str:
    """Say in what the scan that samples or records are of differs from another; `key` is that of the former.

    They hold its name, its key and its tilt: it is known again by these.
    """
    mounted: dict[str, Any] = {}
    if "tilt" in data and "motion_count" not in data:
        mounted = {"tilt_deg": float(np.nanmedian(data["tilt"].values))}
    candidates = []
    with suppress(InputError):  # a tilt that no scan can have
        candidates += [replace(scan, tilt=np.deg2rad(mounted["tilt_deg"]))] if mounted else []
    with suppress(InputError):  # the name need not mean anything here
        name = str(data.attrs.get("scan", ""))
        candidates += [load_scan(name, **more) for more in ({}, mounted)]
    candidates += [timed for one in (*candidates, scan) for timed in _with_other_times(data, one)]
    for made in candidates:
        if made.key == key:
            what = "samples" if "radial_velocity" in data else "records"
            return f"{scan_difference(made, scan)}, in the {what} and now"
    return (
        "an option that its name does not tell, such as the opening angle, focus distance, tilt, cycle or times of the "
        "beams"
    )


def _with_other_times(data: xr.Dataset, scan: Scan) -> Iterator[Scan]:
    """Give a scan with the cycles that samples or records may have been measured in, and times of its beams in each."""
    cycles = [scan.scan_duration]
    if "radial_velocity" in data:
        of_beam = data["time"].values[data["beam"].values == scan.beam[0]]
        steps = np.diff(np.sort(of_beam)) / np.timedelta64(1, "s")
        cycles += [float(np.median(steps))] if len(steps) else []
    elif "count" in data and "duration" in data.attrs and int(data["count"].max()) > 0:
        cycles.append(float(data.attrs["duration"]) / int(data["count"].max()))
    for cycle in cycles:
        # as scans are written, so that the key is the same
        rounded = float(f"{cycle:.6g}")
        for times in (scan.beam_time * (rounded / scan.scan_duration), np.zeros(scan.n_beam)):
            with suppress(InputError):
                yield replace(scan, scan_duration=rounded, beam_time=times)


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
