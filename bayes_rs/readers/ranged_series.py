"""Series of several ranges: what `read` gives, with a range for each sample, and the one scan that reads them all."""

from __future__ import annotations

import json
from typing import Annotated

import numpy as np
import xarray as xr
from pydantic import Field

from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.layouts import Positive, read_json

DISTANCES = "range_distances"
"""Attribute of a series of several ranges: in JSON, the distance along each beam of the scan, range after range."""
_Table = Annotated[list[Annotated[list[Positive], Field(min_length=1)]], Field(min_length=1)]


def with_ranges(series: xr.Dataset, scan: Scan) -> xr.Dataset:
    """Return a series as users have it: of a scan at several ranges, with the scan's own beams and a range each.

    Parameters
    ----------
    series : Dataset
        As `join_samples` makes it.
    scan : Scan
        The scan that it was read with.
    """
    if not isinstance(scan, RangedScan):
        return series
    index, beam = scan.split(series["beam"].values)
    report = json.loads(series.attrs["read_report"])
    own = scan.of_one.beam.tolist()
    present = sorted(set(beam.tolist()))
    report |= {"beams_present": present, "beams_absent": [number for number in own if number not in present]}
    about = {"units": "m", "long_name": "distance along the beam at which the sample was measured"}
    return series.assign_coords(beam=("sample", beam), range=("sample", scan.range[index], about)).assign_attrs(
        {
            "scan_key": scan.of_one.key,
            DISTANCES: json.dumps(scan.distance.tolist()),
            "read_report": json.dumps(report),
        }
    )


def scan_of_series(series: xr.Dataset, scan: Scan) -> Scan:
    """Return the scan at the ranges of a series; the scan itself if the series has none.

    Raises
    ------
    InputError
        If the ranges are not such of this scan.
    """
    if isinstance(scan, RangedScan) or "range" not in series.variables:
        return scan
    values = np.asarray(series["range"].values, dtype=np.float64)
    if series["range"].dims != ("sample",) or not np.all(values > 0.0):
        raise InputError("Invalid range of the series: it must be a distance above zero, m, for each sample.")
    if DISTANCES in series.attrs:
        table = read_json(_Table, series.attrs[DISTANCES], what=f"{DISTANCES} of the series", advice="read it again")
        if len({len(row) for row in table}) == 1 and len(table[0]) == scan.n_beam:
            return RangedScan.of(scan, table)
        raise InputError(
            f"The series holds ranges of {len(table[0])} beams, and scan {scan.name!r} has {scan.n_beam}: give the "
            "scan that the series was read with."
        )
    return RangedScan.of(scan, np.unique(values))


def stacked(series: xr.Dataset, scan: RangedScan) -> xr.Dataset:
    """Return a series with the beams as a scan at several ranges numbers them; the inverse of `with_ranges`.

    Raises
    ------
    InputError
        If a sample's range is none of the scan's, or its beam is not one of it.
    """
    if "range" not in series.variables:
        return series
    values, known = np.asarray(series["range"].values, dtype=np.float64), scan.range
    middles = 0.5 * (known[1:] + known[:-1])
    index = np.searchsorted(middles, values)
    far = np.abs(known[index] - values) > 1e-3
    if far.any():
        raise InputError(
            f"Unknown range {values[far][0]:g} m in the series: the ranges of the scan {scan.name!r} are "
            f"{known.tolist()} m; give the scan that the series was read with."
        )
    beam = np.asarray(series["beam"].values)
    foreign = np.setdiff1d(beam, scan.of_one.beam)
    if len(foreign):
        raise InputError(
            f"Unknown beam {foreign[0]} in the series: the beams of scan {scan.name!r} are "
            f"{scan.of_one.beam.tolist()}; give the scan that the series was read with."
        )
    return series.assign_coords(beam=("sample", scan.join(index, beam.astype(np.int64)))).drop_vars("range")
