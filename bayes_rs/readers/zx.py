"""ZX lidars (formerly ZephIR): line-of-sight velocities, a row for each point, and the statistics of ten minutes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_LIMIT, FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.belief import is_impossible
from bayes_rs.readers.compressed import UNREADABLE, plain_file, unreadable
from bayes_rs.readers.entries import numbers, times
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.format import FileFormat, resolve_format
from bayes_rs.readers.interface import OF_TABLES, Reader
from bayes_rs.readers.matching import match_rays
from bayes_rs.readers.rays import Rays
from bayes_rs.readers.samples import Samples
from bayes_rs.readers.table import Table, open_table
from bayes_rs.stated_time import stated_times

SUFFIXES = (".csv", ".txt", ".parquet", ".pq")
INVALID = tuple(float(number) for number in range(9987, 10000))
"""What stands for a missing number; each says another reason."""
DEFAULTS = {"positive": "towards", "invalid": INVALID, "phase_zero_deg": 0.0, "phase_turns": "up"}

TIME_HEADINGS = ("Timestamp (ISO 8601)", "Time and Date")
"""What ZX's converter calls the time, in files of wind and statistics."""

STATISTICS = {
    "Horizontal Wind Speed (m/s)": ("wind_speed", "m s-1"),
    "Horizontal Wind Speed Min (m/s)": ("wind_speed_min", "m s-1"),
    "Horizontal Wind Speed Max (m/s)": ("wind_speed_max", "m s-1"),
    "Horizontal Wind Speed Std. Dev. (m/s)": ("wind_speed_std", "m s-1"),
    "Vertical Wind Speed (m/s)": ("vertical_wind_speed", "m s-1"),
    "Wind Direction (deg)": ("wind_direction", "degree"),
    "TI": ("turbulence_intensity", "1"),
    "Packets in Average": ("packets", "1"),
}
"""What stands before ``at 98m`` in the headings: our name and unit."""
SITE = {
    "Tilt (deg)": ("tilt", "degree"),
    "ZephIR Bearing (deg)": ("bearing", "degree"),
    "Air Temp. (C)": ("air_temperature", "degree_Celsius"),
    "Pressure (mbar)": ("pressure", "hPa"),
    "Humidity (%)": ("humidity", "percent"),
    "MET Wind Speed (m/s)": ("met_wind_speed", "m s-1"),
    "MET Direction (deg)": ("met_wind_direction", "degree"),
    "Met Wind Speed (m/s)": ("met_wind_speed", "m s-1"),
    "Met Wind Direction (deg)": ("met_wind_direction", "degree"),
    "Proportion Of Packets With Rain (%)": ("rain", "percent"),
}

_CONVERTER = "CSV Converter"
_AT_HEIGHT = re.compile(r"(.+?) at (\d+(?:[.,]\d+)?)\s*m")
_ZONE = re.compile(r"Time sync: UTC\s*(?:([+-])\s*(\d{1,2})[.,]?(\d*)\s*hrs)?")
_TIME_FORMATS = (
    "%d.%m.%Y %H:%M:%S",
    "%d/%m/%Y %H:%M:%S",
    "%d.%m.%Y %H:%M",
    "%d/%m/%Y %H:%M",
    "%m/%d/%Y %I:%M:%S %p",
    "%d.%m.%Y %H:%M:%S.%f",
    "%d/%m/%Y %H:%M:%S.%f",
)
_ROUNDING = 1e-6
_ONE_SIDE = 0.6  # mean of the unit vectors of phases: 0.64 for half a cone, 0 for a whole one
_SEGMENT = re.compile(r"(?:Left|Right) LOS Speed \(m/s\) at Rotor Segment Height .*")
_RADIAN = re.compile(r".*[(\[]\s*rad(?:ians?)?\s*[)\]]", re.IGNORECASE)
_WORDS = {
    "phase": re.compile(
        r"(?:(?:(?:scan(?:ner)?|beam|prism) )?(?:phase|azimuth)(?: angle)?|scan(?:ner)? angle)"
        r"(?:\s*[(\[]\s*(?:deg(?:rees?)?|°|rad(?:ians?)?)\s*[)\]])?",
        re.IGNORECASE,
    ),
    "radial_velocity": re.compile(
        r"(?:(?:los|line[ -]of[ -]sight|radial)(?: wind)?(?: speed| velocity)|doppler velocity|los)"
        r"(?:\s*[(\[]\s*m(?:/s| s-1|\.s-1)\s*[)\]])?",
        re.IGNORECASE,
    ),
}
"""Headings that we take for a phase in degrees or radians, and for a line-of-sight velocity in m/s: assumed."""


def recognises_zx(file: Path, _scan: Scan, file_format: FileFormat) -> bool:
    """Say whether the caller mapped a column of phases, or the first line or the headings are ZX's."""
    if "phase" in file_format.columns:
        return True
    if file.suffix.lower() in {".csv", ".txt"} and _first_line(file).startswith(_CONVERTER):
        return True
    try:
        table = open_table(file, file_format)
    except InputError:
        return False  # the readers of tables say what is wrong with it
    headings = table.headings
    if any(_SEGMENT.fullmatch(heading) for heading in headings):
        return True
    ours = any(heading in headings for heading in TIME_HEADINGS) and not table.has("beam")
    return ours and all(any(words.fullmatch(heading) for heading in headings) for words in _WORDS.values())


def read_zx(file: Path, scan: Scan, file_format: FileFormat) -> Samples:
    """Read line-of-sight velocities, a row each with its phase on the cone.

    Parameters
    ----------
    file : Path
        A CSV or Parquet table; a line of ZX's converter above the headings is skipped.
    scan : Scan
        The scan, all of whose beams must lie on one cone.
    file_format : FileFormat
        The reader's options; ``columns`` says what the file calls ``time``, ``phase`` and ``radial_velocity``, and
        ``status``. Without it they are looked for by their headings.

    Raises
    ------
    InputError
        If a column is not there or could be several, nothing says how the phase counts, the beams are not on one cone,
        velocities all round an upward cone have no signs, or an entry cannot be used.

    Notes
    -----
    ZX writes line-of-sight velocities at 50 Hz ("QCed line-of-sight data", or Mini Raw; seconds that fail its quality
    control are left out as a whole), and converts them to CSV [1]_. The headings are not published. Taken from what is:
    ``Timestamp (ISO 8601)`` or ``Time and Date``, the times of ZX's other files [2]_; and 9987 to 9999, which mark bad
    values [3]_, so that they count as missing whatever else the option ``invalid`` names. **Assumed** is that a heading
    such as ``Phase``, ``Azimuth (deg)`` or ``Scan angle (rad)`` is the phase and one such as ``LOS Velocity (m/s)`` or
    ``Line of sight speed`` the velocity. Where none or several fit, the file is refused, and ``columns`` says which it
    is; the report of the reading names the columns that were read.

    A phase counts in degrees (radians if its heading says so) from ``phase_zero_deg``, an angle θ of the scan: 0 is
    sideways (y), 90 is up; on an upward cone 0 is x, against the view, and 90 is y. It turns as θ does
    (``phase_turns="up"``) or the other way. Of a column that the caller did not name, both must be given, by option or
    by the scan's file: nothing published says them, and a wrong one turns R. Each phase goes to the beam within
    ``angle_tolerance_deg``; between the 50 points of a cone of 15° are 1.86°.

    A homodyne lidar measures the magnitude of the velocity: ``positive="towards"``, the default, takes the air to come
    towards the lidar, as for a ZX TM that looks into the wind. Round an upward cone (ZX 300) the sign changes twice, so
    that magnitudes alone are refused.

    References
    ----------
    .. [1] ZX Lidars, "Using QCed Line-of-Sight data", knowledge base, 25 July 2025.
    .. [2] Lidaco, samples of unit 317; github.com/resgroup/hill-of-towie-open-source-analysis, ``lidar_helpers.py``.
    .. [3] Hill of Towie open dataset v2, README.md, doi:10.5281/zenodo.20204946.
    """
    skip = 0
    if file.suffix.lower() in {".csv", ".txt"} and _first_line(file).startswith(_CONVERTER):
        skip = 1
    table = open_table(file, file_format, skip=skip)
    if any(_AT_HEIGHT.fullmatch(heading) for heading in table.headings):
        raise InputError(
            f"File {str(file)!r} holds ZX's statistics of averaging periods, or the winds that it fits to each turn, "
            "not line-of-sight velocities: read it with read_statistics; variances of beams need the 50 Hz data."
        )
    if any(_SEGMENT.fullmatch(heading) for heading in table.headings):
        raise InputError(
            f"File {str(file)!r} holds ZX TM's wind: line-of-sight speeds left and right at heights of the rotor, not "
            "the points of a scan; variances of beams need the 50 Hz data."
        )
    table = _by_headings(table)
    file_format = table.file_format
    for name in ("time", "phase", "radial_velocity", "cnr", "status"):
        needed = name in ("time", "phase", "radial_velocity") or name in file_format.required
        if needed and not table.has(name):
            raise table.missing(name)
    samples = [name for name in ("time", "phase", "radial_velocity", "cnr", "status") if table.has(name)]
    heading = {name: file_format.column(name) for name in samples}
    (frame, _), *_rest = table.pieces(list(dict.fromkeys(heading.values())), text=[heading["time"]])
    column = {name: table.column(frame, name, heading[name]) for name in samples}
    if file_format.time_format is None and heading["time"] == TIME_HEADINGS[1]:
        file_format = replace(file_format, time_format=_time_format(column["time"].values[:1000]))
    time, invalid = times(column["time"], file_format)
    value = {}
    for name in samples:
        if name != "time":
            value[name], is_invalid = numbers(column[name], file_format)
            invalid = invalid | is_invalid
    first_row = column["time"].first_row
    time = np.where(table.bad.mask(first_row, len(time)), np.datetime64("NaT", "ns"), time)
    table.bad.check(len(time))
    turn = 1.0 if file_format.phase_turns == "up" else -1.0
    measured = np.rad2deg(value["phase"]) if _RADIAN.fullmatch(heading["phase"]) else value["phase"]
    phase = np.deg2rad(file_format.phase_zero_deg + turn * measured)
    _check_signs(value["radial_velocity"], phase, scan, file)
    rays = Rays(
        file=file,
        kind="zx",
        file_format=file_format,
        time=file_format.to_start(time),
        direction=_on_the_cone(phase, scan),
        distance=np.full((len(time), 1), scan.focus_distance[0]),
        radial_velocity=file_format.to_away(value["radial_velocity"])[:, np.newaxis],
        cnr=value["cnr"][:, np.newaxis] if "cnr" in value else None,
        status=value["status"][:, np.newaxis] if "status" in value else None,
        row=column["time"].first_row + np.arange(len(time), dtype=np.int64),
        row_word=column["time"].row_word,
        counts={
            "rows": len(time),
            "rows_invalid_value": int(invalid.sum()),
            "rows_dropped": 0,
            "rows_without_time": 0,
            "rows_without_beam": 0,
            **table.bad.counts(first_row, len(time)),
        },
    )
    return match_rays(rays, scan, angle_tolerance_deg=file_format.angle_tolerance_deg)


def read_statistics(
    files: str | Path | Sequence[str | Path],
    *,
    time_zone: str | None = None,
    time_format: str | None = None,
    invalid: float | Sequence[float] = (9999.0, 9998.0),
) -> xr.Dataset:
    """Read the wind statistics of ten minutes that a ZX lidar computes itself.

    They hold no radial velocities, so that no stresses follow from them: they are to compare results with.

    Parameters
    ----------
    files : str, Path or sequence of them
        ``Wind10_…csv`` files of ZX's converter, also folders, patterns and compressed files.
    time_zone : str, optional
        Zone of the times; that of the file's first line if not given.
    time_format : str, optional
        Pattern of the times such as ``%d.%m.%Y %H:%M:%S``; found in the file if not given.
    invalid : float or sequence of float
        Numbers that mark a missing entry.

    Returns
    -------
    statistics : xarray.Dataset
        ``wind_speed``, ``wind_speed_min``, ``wind_speed_max``, ``wind_speed_std``, ``vertical_wind_speed``, m/s,
        ``wind_direction``, degrees, ``turbulence_intensity`` and ``packets`` over (time, height), and ``tilt``,
        ``bearing``, ``air_temperature``, ``pressure``, ``humidity``, ``met_wind_speed``, ``met_wind_direction`` and
        ``rain`` over (time), those that the files have. ``time`` is the start of the averaging period, UTC; ``height``
        in m as in the headings. ``attrs["time_stamp"]`` says what the file stamps, ``attrs["left_out"]`` which columns
        were not read, ``attrs["impossible_values"]`` which speeds beyond 90 m/s were taken for missing, if any.

    Raises
    ------
    InputError
        If a file cannot be read, its headings are not ZX's, a time cannot be read, or the file stamps the end of the
        period.

    Notes
    -----
    Separators follow from the headings: semicolons go with decimal commas, commas with points. The turbulence
    intensity is the lidar's own; in a file at hand it is 1.09 times the standard deviation over the mean.

    References
    ----------
    Headings, first line and 9999: a file of unit 317 in the samples of Lidaco (github.com/e-WindLidar/Lidaco,
    samples/Kassel_Experiment/data/WP4/10min).

    Examples
    --------
    >>> import tempfile
    >>> first = "CSV Converter: v1,114;Unit: 317;Time sync: UTC +1,0 hrs"
    >>> headings = "Reference;Time and Date;Horizontal Wind Speed (m/s) at 98m;TI at 98m"
    >>> row = "1;13.12.2016 00:10:00;5,464;0,1482"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "Wind10_317.csv"
    ...     _ = file.write_text(chr(10).join([first, headings, row, ""]))
    ...     statistics = read_statistics(file)
    >>> statistics["wind_speed"].item(), str(statistics["time"].values[0])[:16]
    (5.464, '2016-12-12T23:10')
    """
    found = find_files(files, (".csv", ".txt"))
    parts = []
    for file in found.paths:
        with plain_file(file) as plain:
            try:
                parts.append(_statistics(plain, time_zone, time_format, invalid))
            except InputError as error:
                raise InputError(str(error).replace(repr(str(plain)), repr(str(file)))) from error
    joined = parts[0] if len(parts) == 1 else xr.concat(parts, "time", join="outer", combine_attrs="drop_conflicts")
    return joined.sortby("time").drop_duplicates("time")


def _statistics(
    file: Path, time_zone: str | None, time_format: str | None, invalid: float | Sequence[float]
) -> xr.Dataset:
    first = _first_line(file)
    skip = 1 if first.startswith(_CONVERTER) else 0
    if "Time stamps indicate the end" in first:
        raise InputError(
            f"File {str(file)!r} says that its time stamps indicate the end of the averaging period: this reader takes "
            "the start; convert the file again."
        )
    headings = _line(file, skip)
    with_semicolon = headings.count(";") > headings.count(",")
    written = FileOptions(
        separator=";" if with_semicolon else ",",
        decimal="," if with_semicolon else ".",
        invalid=invalid,
        time_zone=time_zone or _zone(first),
        columns={"time": "Time and Date"},
        time_format=time_format,
    )
    file_format = resolve_format(written, None)
    table = open_table(file, file_format, skip=skip)
    if not table.has("time"):
        raise table.missing("time")
    height, known, left_out = _headings(table)
    if not height:
        raise InputError(
            f"File {str(file)!r} has no column such as 'Horizontal Wind Speed (m/s) at 98m': {table.found()}; check "
            "that it is a Wind10 file of ZX's converter."
        )
    wanted = ["Time and Date", *known]
    (frame, _), *_rest = table.pieces(wanted, text=["Time and Date"])
    column = table.column(frame, "time", "Time and Date")
    if time_format is None:
        file_format = resolve_format(replace(written, time_format=_time_format(column.values)), None)
    time, _ = times(column, file_format)
    heights = np.array(sorted(height), dtype=np.float64)
    variables: dict[str, Any] = {}
    impossible: list[float] = []
    for heading, (name, unit, at) in known.items():
        values, _ = numbers(table.column(frame, name, heading), file_format)
        if unit == "m s-1":
            bad = is_impossible(values, VELOCITY_LIMIT)
            impossible += np.unique(values[bad]).tolist()
            values = np.where(bad, np.nan, values)
        if at is None:
            variables[name] = ("time", values, {"units": unit})
        else:
            block = variables.setdefault(name, (("time", "height"), _empty(len(values), len(heights)), {"units": unit}))
            block[1][:, int(np.flatnonzero(heights == at)[0])] = values
    keep = ~np.isnat(time)
    return xr.Dataset(
        variables,
        coords={"time": time, "height": ("height", heights, {"units": "m"})},
        attrs=_attributes(left_out, impossible),
    ).isel(time=np.flatnonzero(keep))


def _attributes(left_out: list[str], impossible: list[float]) -> dict[str, Any]:
    found = {"impossible_values": sorted(set(impossible))} if impossible else {}
    return {"time_stamp": "start of the averaging period, UTC", "left_out": left_out, **found}


def _empty(n_time: int, n_height: int) -> FloatArray:
    return np.full((n_time, n_height), np.nan)


def _headings(table: Table) -> tuple[set[float], dict[str, tuple[str, str, float | None]], list[str]]:
    """Return the heights, what each known heading means, and the headings that mean nothing to us."""
    known: dict[str, tuple[str, str, float | None]] = {}
    left_out = []
    for heading in table.headings:
        match = _AT_HEIGHT.fullmatch(heading)
        if match is not None and match[1] in STATISTICS:
            known[heading] = (*STATISTICS[match[1]], float(match[2].replace(",", ".")))
        elif heading in SITE:
            known[heading] = (*SITE[heading], None)
        elif heading != "Time and Date":
            left_out.append(heading[:60])
    return {at for _, _, at in known.values() if at is not None}, known, left_out


def _zone(first: str) -> str:
    match = _ZONE.search(first)
    if match is None or match[1] is None:
        return "UTC"
    minutes = round(60.0 * float(f"0.{match[3] or '0'}"))
    return f"UTC{match[1]}{int(match[2]):02d}:{minutes:02d}"


def _time_format(values: pd.Series[Any]) -> str | None:
    text = values.astype("string").str.strip()
    text = text[text.notna() & (text != "")]
    for pattern in _TIME_FORMATS:
        if len(text) and bool(stated_times(text, pattern).notna().all()):
            return pattern
    return None


def _first_line(file: Path) -> str:
    return _line(file, 0)


def _line(file: Path, before: int) -> str:
    try:
        with file.open("rb") as opened:
            for _ in range(before):
                opened.readline()
            return opened.readline(65536).decode("utf-8", errors="replace").strip("\ufeff \r\n")
    except UNREADABLE as error:
        raise unreadable(file, error) from error


def _by_headings(table: Table) -> Table:
    """Return the table with the columns found by their headings, and ZX's marks of bad values among the invalid."""
    options = table.file_format
    found = {}
    for name in ("time", "phase", "radial_velocity"):
        if table.has(name):
            continue
        if name in options.required:
            raise table.missing(name)
        if name == "time":
            fits = [heading for heading in TIME_HEADINGS if heading in table.headings][:1]
        else:
            fits = [heading for heading in table.headings if _WORDS[name].fullmatch(heading)]
        if len(fits) > 1:
            raise InputError(
                f"File {str(table.file)!r} has several columns that could be {name}, {', '.join(map(repr, fits))}: "
                f"say which with columns={{{name!r}: 'its heading'}} (--column {name}=HEADING)."
            )
        if not fits:
            raise table.missing(name)
        found[name] = fits[0]
    if "phase" in found and options.from_format & {"phase_zero_deg", "phase_turns"}:
        raise InputError(
            f"File {str(table.file)!r} does not say where its {found['phase']!r} is zero and which way it turns: give "
            "phase_zero_deg (--phase-zero) and phase_turns (--phase-turns), or name the column with columns if it is "
            "the angle from y upwards."
        )
    invalid = tuple(sorted({*options.invalid, *INVALID}))
    return replace(table, file_format=replace(options, columns={**options.columns, **found}, invalid=invalid))


def _check_signs(velocity: FloatArray, phase: FloatArray, scan: Scan, file: Path) -> None:
    """Refuse magnitudes from all round an upward cone, where the air comes on one side and goes on the other."""
    known = np.isfinite(velocity) & np.isfinite(phase)
    upward = np.ptp(scan.beam_direction[:, 2]) <= _ROUNDING
    if not (upward and known.any()) or velocity[known].min() < 0.0:
        return
    all_round = np.abs(np.exp(1j * phase[known]).mean()) < _ONE_SIDE
    if all_round and velocity[known].max() > 0.0:
        raise InputError(
            f"File {str(file)!r} holds magnitudes (no velocity is below zero) from all round the upward cone of scan "
            f"{scan.name!r}, where the air comes on one side and goes on the other: give a file with signs."
        )


def _on_the_cone(phase: FloatArray, scan: Scan) -> FloatArray:
    """Return the directions at angles θ, rad, on the cone that all beams of the scan lie on."""
    sideways, upwards = np.cos(phase), np.sin(phase)
    for axis, sign in ((0, -1.0), (2, 1.0)):
        along = sign * scan.beam_direction[:, axis]
        if np.ptp(along) <= _ROUNDING and along[0] < 1.0:
            across = np.sqrt(1.0 - along[0] ** 2)
            constant = np.full_like(phase, sign * along[0])
            around = [across * sideways, across * upwards]
            return np.stack([constant, *around] if axis == 0 else [*around, constant], axis=-1)
    raise InputError(
        f"The beams of scan {scan.name!r} do not lie on one cone about its axis or the vertical: files with a phase "
        "need such a scan; give zx-tm or zx-300, or a scan like them."
    )


READER = Reader(
    name="zx",
    title="ZX TM, ZX 300 (ZephIR), line-of-sight velocities with a phase",
    source="files of ZX's converter; headings of the 50 Hz data are assumed, or named by the option columns",
    suffixes=SUFFIXES,
    recognises=recognises_zx,
    read=read_zx,
    defaults=DEFAULTS,
    uses=(*OF_TABLES, "angle_tolerance_deg", "phase_zero_deg", "phase_turns"),
)
