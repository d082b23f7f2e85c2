"""Records at several ranges: one dataset with the dimension ``range``, and what of it is of one range."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan, nearest_range
from bayes_rs.geometry.scan import Scan
from bayes_rs.records.layout import OF_RANGES, REPORT

RANGE = "range"
"""The dimension of records at several ranges."""
DISTANCE = "focus_distance"
"""Coordinate (range, beam), or (beam) of one range: the distance along each beam at which it measured, m."""
_OF_ONE = (REPORT, "scan_key", "beams_absent", "not_believed", "length_scale_report", "instrument_noise_report")
"""Attributes of records that each range has for itself."""


def has_ranges(records: xr.Dataset) -> bool:
    """Tell whether records are at several ranges, or at one with that dimension."""
    return RANGE in records.dims


def stack_ranges(parts: Sequence[xr.Dataset], scan: RangedScan) -> xr.Dataset:
    """Return records of several ranges, of the same records and beams, as one dataset.

    Parameters
    ----------
    parts : sequence of Dataset
        The records of each range, in the scan's order of ranges.
    scan : RangedScan
        The scan at these ranges.
    """
    beams = parts[0]["beam"].values
    column = [int(np.flatnonzero(scan.of_one.beam == number)[0]) for number in beams]
    bare = [part.drop_vars((DISTANCE, RANGE, "height"), errors="ignore") for part in parts]
    joined = xr.concat(
        [part.assign_attrs() for part in bare],
        dim=RANGE,
        data_vars="all",
        coords="minimal",
        compat="override",
        join="exact",
        combine_attrs="override",
    )
    about = {"units": "m", "long_name": "distance along the beams, the median of them"}
    joined = joined.assign_coords(
        {
            RANGE: (RANGE, scan.range, about),
            DISTANCE: ((RANGE, "beam"), scan.distance[:, column], {"units": "m"}),
        }
    )
    if scan.height is not None:
        joined = joined.assign_coords(
            height=(RANGE, scan.height, {"units": "m", "long_name": "height above the lidar"})
        )
    of_ranges = [{name: part.attrs[name] for name in _OF_ONE if name in part.attrs} for part in parts]
    shared = {name: value for name, value in parts[0].attrs.items() if name not in (*_OF_ONE, RANGE, "height")}
    return joined.assign_attrs(shared | {"scan_key": scan.of_one.key, OF_RANGES: json.dumps(of_ranges)}).pipe(_without)


def _without(records: xr.Dataset) -> xr.Dataset:
    """Return records without the attributes of one range."""
    for name in _OF_ONE:
        if name != "scan_key":
            records.attrs.pop(name, None)
    return records


def split_ranges(records: xr.Dataset) -> list[xr.Dataset]:
    """Return the records of each range, as `make_records` makes them of one."""
    found = []
    of_ranges = json.loads(records.attrs.get(OF_RANGES, "null")) or [{}] * records.sizes[RANGE]
    for index, own in enumerate(of_ranges):
        part = records.isel({RANGE: index})
        named = {name: float(part[name].values) for name in (RANGE, "height") if name in part.coords}
        part = part.drop_vars((RANGE, "height"), errors="ignore")
        attributes = {name: value for name, value in part.attrs.items() if name != OF_RANGES}
        attributes.pop("scan_key", None)
        part.attrs = {**attributes, **own, **named}
        found.append(part)
    return found


def at_range(records: xr.Dataset, distance: float | None = None, *, height: float | None = None) -> xr.Dataset:
    """Return the records of one range.

    Parameters
    ----------
    records : Dataset
        At several ranges, as `make_records` makes them of a series that has some.
    distance : float, optional
        The range, m; the nearest is taken, if it is within half the distance to the next.
    height : float, optional
        The height above the lidar, m, in place of the range.

    Returns
    -------
    records : Dataset, dims (record, beam)
        As of a scan that measures there only; ``focus_distance`` (beam) holds the distances.

    Raises
    ------
    InputError
        If there is no range near, or the records have none.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> near, far = (
    ...     brs.simulate(f"2-beam@focus_distance={d}", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
    ...     .assign_coords(range=lambda s, d=d: ("sample", np.full(s.sizes["sample"], float(d))))
    ...     for d in (80, 120)
    ... )
    >>> series = xr.concat([near, far], dim="sample").drop_attrs()
    >>> records = brs.make_records(series, "2-beam")
    >>> dict(records.sizes)["range"], at_range(records, 118.0)["variance"].shape
    (2, (2, 2))
    """
    if not has_ranges(records):
        raise InputError("The records have no dimension 'range': they are of one range already.")
    if (distance is None) == (height is None):
        raise InputError("Give a range or a height, in m, one of the two.")
    what, wanted = ("range", distance) if distance is not None else ("height", height)
    if what not in records.coords:
        raise InputError(f"The records have no {what}s: choose by the other.")
    index = nearest_range(np.asarray(records[what].values, dtype=np.float64), float(wanted or 0.0), what=what)
    return split_ranges(records)[index]


def scan_of_records(records: xr.Dataset, scan: Scan) -> Scan:
    """Return the scan with the distances that records say they are from; several for records at several ranges.

    Raises
    ------
    InputError
        If a beam of the records is none of the scan.
    """
    if DISTANCE not in records.coords or isinstance(scan, RangedScan):
        return scan
    known = scan.select(records["beam"].values)  # refuses foreign beams
    values = np.atleast_2d(np.asarray(records[DISTANCE].values, dtype=np.float64))
    table = np.repeat(np.median(values, axis=1)[:, np.newaxis], scan.n_beam, axis=1)
    for column, number in enumerate(known.beam.tolist()):
        table[:, np.flatnonzero(scan.beam == number)[0]] = values[:, column]
    if has_ranges(records):
        return RangedScan.of(scan, table)
    of_files = {name: value for name, value in scan.file_format.items() if name != "range"}
    return replace(scan, focus_distance=table[0], file_format=of_files)


def each_range(records: xr.Dataset, scan: RangedScan, function: Callable[[xr.Dataset, Scan], xr.Dataset]) -> xr.Dataset:
    """Return records at several ranges of which each range has gone through a function of its records and scan."""
    done = [function(part, scan.at(index)) for index, part in enumerate(split_ranges(records))]
    return stack_ranges(done, scan)
