"""Radial velocities from files: one registry of formats, one way in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.options import split_options
from bayes_rs.readers.registry import READERS, SUFFIXES, read_file
from bayes_rs.readers.samples import FilesReport, Samples, check_order, join_samples, no_sample, none_read
from bayes_rs.readers.streaming import stream_radial_velocity
from bayes_rs.readers.zx import read_statistics

__all__ = ["READERS", "read_radial_velocity", "read_statistics", "stream_radial_velocity"]


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
    time_format: str | None = None,
    time_stamp: str | None = None,
    sample_duration: float | None = None,
    separator: str | None = None,
    decimal: str | None = None,
    status_valid: float | None = None,
    angle_tolerance_deg: float | None = None,
    range_tolerance: float | None = None,
    phase_zero_deg: float | None = None,
    phase_turns: str | None = None,
    out_of_order: str = "error",
    on_bad_file: str = "error",
) -> xr.Dataset:
    r"""Read a lidar's radial velocities from one or several files.

    An option that is given counts before the scan's own ``[file]`` table, which counts before the default of the
    file's format, which counts before the general default.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files in any order, also compressed (``.gz``, ``.bz2``, ``.xz``, ``.zst``, ``.zip``); folders, of which all
        files with a known suffix are read, but hidden and temporary ones; patterns such as ``2024-*/*.nc``.
    scan : Scan
        The scan that the files were measured with. Beams that the files lack are reported, not refused.
    file_format : {"auto", "long", "wide", "netcdf", "windcube", "e-windlidar", "halo", "spinnerlidar", "zx"}
        ``long``: a row per sample, with columns ``time, beam, radial_velocity`` and, if there, ``cnr`` and ``status``
        (or ``quality``). ``wide``: a row per time, with a column ``time`` and one per beam, headed by the beam's
        number, ``vr_<number>`` or ``beam_<number>`` (and ``cnr_<number>``, ``status_<number>``). ``netcdf``:
        variables with the names of the long table, over samples or over time and beam. The others are files of
        instruments, whose rays are matched with the scan's beams by direction and range. ``auto``: by the suffix and
        what the file holds.
    columns : mapping of str to str, optional
        What the file calls our names, ``{"radial_velocity": "RWS"}``; the number of the column, from 1, in a file
        without headings. Files of rays also have ``azimuth``, ``elevation``, ``distance``, or ``sx``, ``sy``, or
        ``phase``.
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
    time_format : str, optional
        How times are written in text: a pattern such as ``%d.%m.%Y %H:%M:%S``, ``unix`` or ``labview`` (seconds since
        1970 or 1904), ``matlab`` (days, as datenum counts); ISO 8601 if not said anywhere.
    time_stamp : {"start", "middle", "end"}, optional
        Where in a sample's accumulation its time stands. The time kept is the start, as records are named by theirs:
        times at the middle or end are moved back. If not said anywhere they are taken as they stand.
    sample_duration : float, optional
        How long a sample takes, s, where the file does not say; needed for ``middle`` and ``end``.
    separator : str, optional
        What separates the entries of a text file, one character or ``tab``; a comma if not said anywhere.
    decimal : {".", ","}, optional
        Decimal sign of a text file; a point if not said anywhere.
    status_valid : float, optional
        The status of a good sample; kept for `make_records`, which drops the others.
    angle_tolerance_deg : float, optional
        Largest angle between a ray and its beam, degrees; 1 if not said anywhere.
    range_tolerance : float, optional
        Largest difference between a gate and a beam's focus distance, m. By default half the spacing of the gates;
        of a ray with one gate, a twentieth of the distance.
    phase_zero_deg : float, optional
        Where on the scan's cone a file's phase is zero: an angle θ, 0 sideways (y), 90 up; 0 if not said anywhere. A
        ``zx`` file whose phase is found by its heading needs it, and `phase_turns`.
    phase_turns : {"up", "down"}, optional
        Whether the phase grows from sideways (y) upwards, as θ does, or downwards; up if not said anywhere.
    out_of_order : {"error", "sort"}
        What to do where, within one file, the time of a beam goes backwards, or where one beam has two different
        velocities at one time: refuse the file, or sort and keep the first.
    on_bad_file : {"error", "skip"}
        What to do with a file that cannot be read, for example a damaged one among thousands: refuse them all, or
        leave it out and name it, with the reason, in the report.

    Returns
    -------
    series : xarray.Dataset
        ``radial_velocity`` (sample), m/s, positive away from the lidar, NaN where missing; coordinates ``time``
        (sample), UTC, and ``beam`` (sample), the scan's beam numbers; ``cnr`` (sample), dB, and ``status`` (sample)
        where the files have them. Sorted by time, then beam. ``attrs["read_report"]`` counts in JSON what was read
        and dropped, and says for each file its format, the options it was read with, and which of them are the
        format's own defaults.

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
    those that this package writes) describes itself, and the scan's ``[file]`` table is not used for it. Nothing is
    added to times for the beam's place within the scan. Every format with its source, sign, stamp, zone and invalid
    values stands in docs/formats.md; `stream_radial_velocity` reads the same without holding all in memory.

    Examples
    --------
    >>> import tempfile
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> lines = "time,beam,radial_velocity\n2020-09-03T19:00:00,0,-36.0\n2020-09-03T19:00:01,1,-18.0\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "day.csv"
    ...     _ = file.write_text(lines)
    ...     series = read_radial_velocity(file, load_scan("2-beam"), velocity_unit="km/h")
    >>> series["radial_velocity"].values
    array([-10.,  -5.])
    """
    kind, on_bad_file, options = split_options(
        {
            "file_format": file_format,
            "columns": columns,
            "beam_numbers": beam_numbers,
            "positive": positive,
            "velocity_unit": velocity_unit,
            "invalid": invalid,
            "time_zone": time_zone,
            "time_format": time_format,
            "time_stamp": time_stamp,
            "sample_duration": sample_duration,
            "separator": separator,
            "decimal": decimal,
            "status_valid": status_valid,
            "angle_tolerance_deg": angle_tolerance_deg,
            "range_tolerance": range_tolerance,
            "phase_zero_deg": phase_zero_deg,
            "phase_turns": phase_turns,
            "out_of_order": out_of_order,
            "on_bad_file": on_bad_file,
        },
        tuple(READERS),
        scan,
    )
    found = find_files(files, SUFFIXES)
    parts: list[Samples] = []
    skipped: list[dict[str, str]] = []
    for file in found.paths:
        try:
            part = read_file(file, scan, kind, options)
            if len(part.time) == 0:
                raise no_sample(file, part.counts.get("rows", 0))
            if part.file_format.out_of_order == "error":
                check_order(part)
        except InputError as error:
            if on_bad_file == "error":
                raise
            skipped.append({"name": file.name, "reason": str(error)})
        else:
            parts.append(part)
    if not parts:
        raise none_read(len(skipped), skipped[0]["reason"])
    return join_samples(parts, scan, report=FilesReport(skipped=skipped, passed_over=found.passed_over))
