"""NetCDF files: the names of the long table as variables, over samples or over time and beam."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.beam_ranges import match_ranges, no_range
from bayes_rs.readers.entries import beams, numbers, times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import Reader
from bayes_rs.readers.netcdf_file import SUFFIXES, glance, open_netcdf
from bayes_rs.readers.netcdf_missing import without_missing
from bayes_rs.readers.samples import Samples
from bayes_rs.readers.table import Column
from bayes_rs.readers.units import as_text, with_velocity_unit
from bayes_rs.stated_time import says_since

RECORD_DIMS = ("record", "beam")
"""Dimensions of the variances in a file of records, which is no file of radial velocities."""


def read_netcdf(file: Path, scan: Scan, file_format: FileFormat) -> Samples:
    """Read a NetCDF file; its times are in UTC by the CF conventions.

    Raises
    ------
    InputError
        If a variable is missing or has the wrong dimensions, or an entry cannot be used.
    """
    with open_netcdf(file) as dataset:
        column = _flatten(dataset, file, file_format)
        velocity = column["radial_velocity"].heading
        stated = dataset[velocity].attrs.get("units")
    if isinstance(scan, RangedScan) and "range" not in column:
        raise no_range(file)
    file_format = with_velocity_unit(file_format, stated, name=velocity, file=file)
    time, invalid = times(column["time"], file_format)
    beam, no_beam, invalid_beam = beams(column["beam"], scan, file_format)
    invalid = invalid | invalid_beam
    value = {}
    for name in ("radial_velocity", "cnr", "status", "range"):
        if name in column:
            value[name], invalid_value = numbers(column[name], file_format)
            invalid = invalid | invalid_value
    no_time = np.isnat(time)
    keep = ~(no_time | no_beam)
    n_kept, counts, facts = int(keep.sum()), {}, {}
    if "range" in value:
        by_range = match_ranges(_distinct(value["range"]), scan, file, file_format)
        beam, fits = by_range.beams(beam, value["range"])
        no_range_said = keep & np.isnan(value["range"])
        counts = {
            "rows_without_range": int(no_range_said.sum()),
            "rows_of_other_ranges": int((keep & ~no_range_said & ~fits).sum()),
        }
        facts = by_range.facts()
        keep &= fits
    return Samples(
        file=file,
        kind="netcdf",
        file_format=file_format,
        time=file_format.to_start(time[keep]),
        beam=beam[keep],
        radial_velocity=file_format.to_away(value["radial_velocity"][keep]),
        cnr=value["cnr"][keep] if "cnr" in value else None,
        status=value["status"][keep] if "status" in value else None,
        row=np.flatnonzero(keep) + 1,
        row_word="sample",
        counts={
            "rows": len(keep),
            "rows_invalid_value": int(invalid.sum()),
            "rows_dropped": len(keep) - n_kept,
            "rows_without_time": int(no_time.sum()),
            "rows_without_beam": int(no_beam.sum()),
            **counts,
        },
        facts=facts,
    )


def _distinct(ranges: FloatArray) -> FloatArray:
    return np.unique(ranges[np.isfinite(ranges)])


def ranges_of_netcdf(file: Path, file_format: FileFormat) -> FloatArray:
    """Return the distinct ranges of a file, m, in order; empty if it says none.

    Raises
    ------
    InputError
        As `read_netcdf`.
    """
    with open_netcdf(file) as dataset:
        column = _flatten(dataset, file, file_format)
    return _distinct(numbers(column["range"], file_format)[0]) if "range" in column else np.zeros(0)


def own_options(file: Path) -> dict[str, Any] | None:
    """Return what a file says about sign, unit and status, if it says the sign: then no preset speaks for it."""
    root = glance(file)["/"]
    attributes = root.attributes.get("radial_velocity", {})
    if "positive" not in attributes:
        return None
    options: dict[str, Any] = {"positive": as_text(attributes["positive"])}
    if "status_valid" in root.attrs:
        try:
            options["status_valid"] = float(root.attrs["status_valid"])
        except (TypeError, ValueError) as error:
            raise InputError(
                f"Invalid status_valid {in_short(root.attrs['status_valid'])} in file {str(file)!r}: it must be a "
                "number; correct the attribute."
            ) from error
    return options


def _flatten(dataset: xr.Dataset, file: Path, file_format: FileFormat) -> dict[str, Column]:
    if (
        "radial_velocity" not in file_format.required
        and dataset.get("variance", xr.DataArray()).dims[-2:] == RECORD_DIMS
    ):
        raise InputError(
            f"File {str(file)!r} holds records, not radial velocities: give the files that the records were made of."
        )
    found = {}
    for name in ("radial_velocity", "time", "beam", "cnr", "status", "range"):
        own = file_format.column(name)
        if own not in dataset.variables and name == "status" and "quality" in dataset.variables:
            own = "quality"
        if own in dataset.variables:
            found[name] = dataset[own]
        elif name not in ("cnr", "status", "range") or name in file_format.required:
            raise InputError(
                f"File {str(file)!r} has no variable {own!r} for {name}: its variables are "
                f"{', '.join(repr(str(variable)) for variable in dataset.variables)}; "
                f"say what the file calls it with the option columns={{{name!r}: 'name in the file'}}."
            )
    units = str(found["time"].encoding.get("units", ""))
    if np.issubdtype(found["time"].dtype, np.datetime64) and units and not says_since(units):
        raise InputError(
            f"Variable {str(found['time'].name)!r} of file {str(file)!r} counts times in {units!r}: units must say the "
            "whole date that they count from, such as 'seconds since 1970-01-01'."
        )
    velocity = _without_coordinates(found["radial_velocity"])
    if velocity.size == 0:
        raise InputError(f"File {str(file)!r} has no sample: give a file with samples.")
    columns = {}
    for name, variable in found.items():
        if not set(variable.dims) <= set(velocity.dims):
            raise InputError(
                f"Variable {str(variable.name)!r} in file {str(file)!r} has the dimensions {variable.dims}: they must "
                f"be among those of the radial velocity, {velocity.dims}."
            )
        plain = _without_coordinates(variable)
        plain = plain.copy(data=without_missing(plain.variable).values)
        spread = plain.broadcast_like(velocity).transpose(*velocity.dims)
        values = pd.Series(spread.to_numpy().ravel())
        columns[name] = Column(name, str(variable.name), values, file, "sample", 1)
    return columns


def _without_coordinates(variable: xr.DataArray) -> xr.DataArray:
    return variable.drop_vars(list(variable.coords))


READER = Reader(
    name="netcdf",
    title="NetCDF with the names of the long table, as this package writes it",
    source="CF conventions for time; docs/formats.md",
    suffixes=SUFFIXES,
    recognises=lambda *_: True,
    read=read_netcdf,
    ranges=ranges_of_netcdf,
    own_options=own_options,
    in_utc=True,
    uses=("columns", "beam_numbers", "range_tolerance"),
)
