"""Radial velocities from files: one registry of formats, one way in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_rs._validation import check_choice
from bayes_rs.errors import InputError
from bayes_rs.readers.format import FileFormat, resolve_format
from bayes_rs.readers.long_table import looks_long, read_long
from bayes_rs.readers.netcdf import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf import describes_itself, own_options, read_netcdf
from bayes_rs.readers.samples import Samples, join_samples
from bayes_rs.readers.table import COMPRESSIONS, CSV_SUFFIXES, PARQUET_SUFFIXES, open_table, plain_suffix
from bayes_rs.readers.wide_table import looks_wide, read_wide
from bayes_rs.scan import Scan

READERS: dict[str, Callable[[Path, Scan, FileFormat], Samples]] = {
    "long": read_long,
    "wide": read_wide,
    "netcdf": read_netcdf,
}


def read_radial_velocity(
    files: str | Path | Sequence[str | Path],
    scan: Scan,
    *,
    file_format: str = "auto",
    columns: Mapping[str, str] | None = None,
    beam_numbers: Mapping[str, int] | None = None,
    positive: str | None = None,
    velocity_unit: str | None = None,
    invalid: float | Sequence[float] | None = None,
    time_zone: str | None = None,
    separator: str | None = None,
    decimal: str | None = None,
    status_valid: float | None = None,
    out_of_order: str = "error",
) -> xr.Dataset:
    r"""Read a lidar's radial velocities from one or several files.

    An option that is given counts before the scan's own ``[file]`` table, which counts before the default.

    Parameters
    ----------
    files : str, Path or sequence of them
        CSV (also compressed, for example ``.csv.gz``), Parquet or NetCDF files, in any order.
    scan : Scan
        The scan that the files were measured with. Beams that the files lack are reported, not refused.
    file_format : {"auto", "long", "wide", "netcdf"}
        ``long``: a row per sample, with columns ``time, beam, radial_velocity`` and, if there, ``cnr`` and ``status``
        (or ``quality``). ``wide``: a row per time, with a column ``time`` and one per beam, headed by the beam's
        number, ``vr_<number>`` or ``beam_<number>`` (and ``cnr_<number>``, ``status_<number>``). ``netcdf``:
        variables with the names of the long table, over samples or over time and beam. ``auto``: by the suffix and
        the headings.
    columns : mapping of str to str, optional
        What the file calls our names: ``{"radial_velocity": "RWS"}``.
    beam_numbers : mapping of str to int, optional
        The scan's number for each beam of the file: ``{"LOS2": 2}``. If given, it must name every beam in the files.
    positive : {"away", "towards"}, optional
        Direction in which the file counts radial velocity positive; ``away`` if not said anywhere.
    velocity_unit : {"m/s", "km/h", "knot"}, optional
        Unit of the radial velocity in the file; m/s if not said anywhere.
    invalid : float or sequence of float, optional
        Numbers that mark a missing entry, in any of the columns read, such as 9999.
    time_zone : str, optional
        Zone of times in text or Parquet files that carry none: ``Europe/Berlin``, ``UTC+1``; UTC if not said anywhere.
        NetCDF files count in UTC, by the CF conventions.
    separator : str, optional
        What separates the entries of a text file, one character or ``tab``; a comma if not said anywhere.
    decimal : {".", ","}, optional
        Decimal sign of a text file; a point if not said anywhere.
    status_valid : float, optional
        The status of a good sample; kept for `make_records`, which drops the others.
    out_of_order : {"error", "sort"}
        What to do where, within one file, the time of a beam goes backwards, or where one beam has two different
        velocities at one time: refuse the file, or sort and keep the first.

    Returns
    -------
    series : xarray.Dataset
        ``radial_velocity`` (sample), m/s, positive away from the lidar, NaN where missing; coordinates ``time``
        (sample), UTC, and ``beam`` (sample), the scan's beam numbers; ``cnr`` (sample), dB, and ``status`` (sample)
        where the files have them. Sorted by time, then beam. ``attrs["read_report"]`` counts in JSON what was read
        and dropped.

    Raises
    ------
    InputError
        If a file is missing, empty or of an unknown kind, a column is missing, an entry is not a number, time or beam
        of the scan, time goes backwards, or an option is not valid. The message names file, line and column.

    Notes
    -----
    Rows without a time or a beam are dropped and counted; rows without a velocity are kept as NaN, so that
    `make_records` can count them. Rows that repeat a sample (same beam, time and velocity) are dropped and counted:
    overlapping files are welcome. A NetCDF file whose variable ``radial_velocity`` has the attribute ``positive`` (as
    those that this package writes) describes itself, and the scan's ``[file]`` table is not used for it. Times of
    samples are taken as they stand in the file: nothing is added for the beam's place within the scan.

    Examples
    --------
    >>> import tempfile
    >>> from bayes_rs.scan_file import load_scan
    >>> lines = "time,beam,radial_velocity\n2020-09-03T19:00:00,0,-36.0\n2020-09-03T19:00:01,1,-18.0\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "day.csv"
    ...     _ = file.write_text(lines)
    ...     series = read_radial_velocity(file, load_scan("2-beam"), velocity_unit="km/h")
    >>> series["radial_velocity"].values
    array([-10.,  -5.])
    """
    check_choice(file_format, ("auto", *READERS), what="file_format")
    options = {
        "columns": columns,
        "beam_numbers": beam_numbers,
        "positive": positive,
        "velocity_unit": velocity_unit,
        "invalid": invalid,
        "time_zone": time_zone,
        "separator": separator,
        "decimal": decimal,
        "status_valid": status_valid,
        "out_of_order": out_of_order,
    }
    return join_samples([_read(file, scan, file_format, options) for file in _as_paths(files)], scan)


def _as_paths(files: str | Path | Sequence[str | Path]) -> list[Path]:
    paths = [Path(files)] if isinstance(files, (str, Path)) else [Path(file) for file in files]
    if not paths:
        raise InputError("No file given: name at least one file with radial velocities.")
    for path in paths:
        if path.is_dir():
            raise InputError(f"{str(path)!r} is a folder: name the files in it.")
        if not path.is_file():
            raise InputError(f"File {str(path)!r} does not exist: check its path.")
    return paths


def _read(file: Path, scan: Scan, kind: str, options: Mapping[str, Any]) -> Samples:
    resolved = resolve_format(options, scan)
    if kind == "auto":
        kind = _guess(file, scan, resolved)
    if kind == "netcdf" and describes_itself(file):
        given = {key: value for key, value in options.items() if value is not None}
        resolved = resolve_format({**own_options(file), **given}, scan, use_scan=False)
    return READERS[kind](file, scan, resolved)


def _guess(file: Path, scan: Scan, file_format: FileFormat) -> str:
    suffix = plain_suffix(file)
    if suffix in NETCDF_SUFFIXES:
        return "netcdf"
    if suffix not in (*CSV_SUFFIXES, *PARQUET_SUFFIXES):
        raise InputError(
            f"Unknown suffix {suffix!r} of file {str(file)!r}: it must be one of "
            f"{', '.join((*CSV_SUFFIXES, *PARQUET_SUFFIXES, *NETCDF_SUFFIXES))}, the text ones also compressed "
            f"({', '.join(COMPRESSIONS)}); rename the file, or convert it."
        )
    table = open_table(file, file_format)
    if looks_long(table):
        return "long"
    if looks_wide(table, scan):
        return "wide"
    raise InputError(
        f"File {str(file)!r} is neither a long table (columns {file_format.column('time')!r}, "
        f"{file_format.column('beam')!r}, {file_format.column('radial_velocity')!r}) nor a wide one (a column "
        f"per beam, headed by its number or vr_<number>): {table.found()}; "
        "map names with the options columns and beam_numbers."
    )
