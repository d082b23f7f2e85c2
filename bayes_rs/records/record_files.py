"""Records that were written before, of one file or several."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.records.belief import NOT_BELIEVED, add_not_believed, believed
from bayes_rs.records.layout import REPORT, check_layout


def open_records(path: str | Path, scan: Scan | str | Path) -> xr.Dataset | None:
    """Read records that were written before; None if the file is something else, such as radial velocities.

    Parameters
    ----------
    path : str or Path
        The file.
    scan : Scan, str or Path
        The scan that measured them, its name or its file.

    Returns
    -------
    records : Dataset or None
        As they were written, but for what no atmosphere has (`bayes_rs.records.belief.believed`).

    Raises
    ------
    InputError
        If the records are not laid out as ours are, were made with another scan, or most of them hold what no
        atmosphere has.
    """
    file = Path(path)
    if file.suffix not in (".nc", ".nc4") or not file.is_file():
        return None
    try:
        dataset = load_netcdf(file)
    except InputError:
        return None  # the reader of radial velocities says what is wrong with it
    if dataset.get("variance", xr.DataArray()).dims != ("record", "beam") and REPORT not in dataset.attrs:
        return None
    check_layout(
        dataset,
        *("variance", "beam", "flag", "wind_speed", "yaw"),
        what=f"The records in {str(file)!r}",
        advice="make them anew with bayes-rs records, or correct the file",
    )
    scan = as_scan(scan)
    key = dataset.attrs.get("scan_key", scan.key)
    if key != scan.key:
        raise InputError(
            f"The records in {str(file)!r} were made with another scan, {dataset.attrs.get('scan', '?')!r}, than "
            f"{scan.name!r}: name that scan, with the same options, or make the records anew with this one."
        )
    return believed(dataset)


def open_record_files(paths: Sequence[str | Path], scan: Scan | str | Path) -> xr.Dataset | None:
    """Read records that were written before, of one file or several; None if they are something else.

    Parameters
    ----------
    paths : sequence of str or Path
        The files.
    scan : Scan, str or Path
        The scan that measured them, its name or its file.

    Returns
    -------
    records : Dataset or None
        Those of all files, one after the other.

    Raises
    ------
    InputError
        If the records were made with another scan, or those of several files do not go together.
    """
    found: list[xr.Dataset] = []
    for path in paths:
        records = open_records(path, scan)
        if records is None:
            return None
        found.append(records)
    first = found[0]
    for path, records in zip(paths, found, strict=True):
        for what, one, other in (
            ("beams", first["beam"].values.tolist(), records["beam"].values.tolist()),
            ("duration", first.attrs.get("duration"), records.attrs.get("duration")),
        ):
            if one != other:
                raise InputError(
                    f"The records in {str(path)!r} have {what} {other} and those in {str(paths[0])!r} {one}: fit them "
                    "separately."
                )
    if len(found) == 1:
        return first
    joined = xr.concat(
        found,
        dim="record",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    )
    joined = joined.drop_encoding()  # the first file's unit of time need not suit the others
    joined.attrs.pop("records_report", None)  # it is that of the first file
    joined.attrs.pop(NOT_BELIEVED, None)
    told = [json.loads(records.attrs[NOT_BELIEVED]) for records in found if NOT_BELIEVED in records.attrs]
    if told:
        joined.attrs[NOT_BELIEVED] = json.dumps(add_not_believed(told))
    if "time" in joined.coords and joined.indexes.get("time") is None:
        again = joined["time"].to_series().duplicated().to_numpy()
        if again.any():
            raise InputError(
                f"{np.count_nonzero(again)} records start at the same time as another, the first at "
                f"{joined['time'].values[again][0]}: give every file once, and files that do not overlap."
            )
    return joined
