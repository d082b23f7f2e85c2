"""Records that were written before, of one file or several."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.readers.compressed import own_suffix
from bayes_rs.readers.netcdf_file import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.records.belief import NOT_BELIEVED, add_not_believed, believed
from bayes_rs.records.given import check_starts, what_differs
from bayes_rs.records.layout import MAST_POSITION, OF_RANGES, REPORT, TURBINE, check_layout
from bayes_rs.records.ranges import DISTANCE, each_range, has_ranges, scan_of_records


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
    if not file.is_file() or own_suffix(file) not in NETCDF_SUFFIXES:
        return None
    try:
        dataset = load_netcdf(file)
    except InputError:
        return None  # the reader of radial velocities says what is wrong with it
    of_records = dataset.get("variance", xr.DataArray()).dims[-2:] == ("record", "beam")
    if not of_records and not {REPORT, OF_RANGES} & set(dataset.attrs):
        return None
    check_layout(
        dataset,
        *("variance", "beam", "flag", "wind_speed", "yaw"),
        what=f"The records in {str(file)!r}",
        advice="make them anew with bayes-rs records, or correct the file",
        ranges=True,
    )
    scan = as_scan(scan)
    key = dataset.attrs.get("scan_key", scan.key)
    if key != scan.key:
        raise InputError(
            f"The records in {str(file)!r} were made with another scan, {dataset.attrs.get('scan', '?')!r}, than "
            f"{scan.name!r} ({what_differs(dataset, key, scan)}): name that scan, with the same options, or make the "
            "records anew with this one."
        )
    if has_ranges(dataset):
        at_ranges = scan_of_records(dataset, scan)
        if not isinstance(at_ranges, RangedScan):
            raise InputError(f"The records in {str(file)!r} do not say their {DISTANCE}: make them anew.")
        return each_range(dataset, at_ranges, lambda part, _: believed(part))
    return believed(dataset)


def open_record_files(paths: Sequence[str | Path], scan: Scan | str | Path) -> xr.Dataset | None:
    """Read records that were written before, of one file or several; None if they are something else.

    Parameters
    ----------
    paths : sequence of str or Path
        The files; also folders and patterns, whose files are all of records.
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
    paths = single_files(paths)
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
            ("ranges", _ranges_of(first), _ranges_of(records)),
            ("a mast at", first.attrs.get(MAST_POSITION, "no place"), records.attrs.get(MAST_POSITION, "no place")),
        ):
            if one != other:
                raise InputError(
                    f"The records in {str(path)!r} have {what} {other} and those in {str(paths[0])!r} {one}: fit them "
                    "separately."
                )
        if (TURBINE in first) != (TURBINE in records):
            named, nameless = (paths[0], path) if TURBINE in first else (path, paths[0])
            raise InputError(
                f"The records in {str(named)!r} say their turbine and those in {str(nameless)!r} do not: make the "
                "latter anew with --turbine NAME, or fit them separately."
            )
    if len(found) == 1:
        check_starts(first, "give every record once")
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
    joined.attrs.pop(REPORT, None)  # it is that of the first file
    if OF_RANGES in joined.attrs:
        of_ranges = [{"scan_key": of["scan_key"]} for of in json.loads(joined.attrs[OF_RANGES])]
        joined.attrs[OF_RANGES] = json.dumps(of_ranges)
    joined.attrs.pop(NOT_BELIEVED, None)
    told = [json.loads(records.attrs[NOT_BELIEVED]) for records in found if NOT_BELIEVED in records.attrs]
    if told:
        joined.attrs[NOT_BELIEVED] = json.dumps(add_not_believed(told))
    check_starts(joined, "give every file once, and files that do not overlap")
    return joined


def single_files(paths: Sequence[str | Path]) -> list[Path]:
    """Return the files that are named, those of folders and patterns too; what is not there is named as it is."""
    if all(Path(path).is_file() for path in paths):
        return [Path(path) for path in paths]
    from bayes_rs.readers.folders import find_files  # noqa: PLC0415 - not needed for files
    from bayes_rs.readers.one_file import SUFFIXES  # noqa: PLC0415 - as above

    try:
        return list(find_files(paths, SUFFIXES).paths)
    except InputError:
        return [Path(path) for path in paths]  # the reader of radial velocities says what is wrong with them


def _ranges_of(records: xr.Dataset) -> list[float]:
    return records["range"].values.tolist() if has_ranges(records) else []
