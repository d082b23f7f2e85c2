"""WindCube profilers (v1, v2, WLS70, WLS7): their ``.rtd`` text files, a header and then a line for each ray."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import as_zone
from bayes_rs.readers.entries import numbers, times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_TEXT_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.ray_groups import check_angles, counts_of
from bayes_rs.readers.rays import Rays, direction_of
from bayes_rs.readers.text_lines import TextLines, TextRows, read_lines, whole_rows

SUFFIXES = (".rtd", ".stdrtd")

_MOST_LINES = 500  # of a header; those in use have 41 to 57
_SIZE = re.compile(r"Header(?:Size|Length)\s*=\s*\d+\s*")
_AT_HEIGHT = re.compile(r"(\d+(?:\.\d+)?)\s*m\s+(radial wind speed|cnr)(?:\s*\((?:m/s|dB)\))?", re.IGNORECASE)
_NUMBERED = re.compile(r"(rws|cnr)[-_ ]?\d*(?:\s*\((?:m/s|dB)\))?", re.IGNORECASE)
_DAY_FIRST = r"^(\d{2})/(\d{2})/(\d{4})"
_LARGEST_ANGLE = 45.0  # degrees from the vertical; what is more is counted from the horizon


@dataclass(frozen=True)
class _Header:
    """What stands above the rows: the fields by their letters and digits only, and the headings of the columns."""

    fields: Mapping[str, str]
    headings: tuple[str, ...]
    n_line: int


def windcube_text_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the rays of one ``.rtd`` file.

    Parameters
    ----------
    file : Path
        Text in Latin-1, separated by tabs.
    file_format : FileFormat
        The reader's options.

    Returns
    -------
    rays : Rays
        One for each row. Rows at the end that are cut off are dropped and counted.

    Raises
    ------
    InputError
        If the header has no altitudes or angle, the rows are binary, or an entry cannot be used.

    Notes
    -----
    ``Position`` is the azimuth, degrees, or ``V`` for the vertical beam; the others have the elevation 90° − the
    header's ``ScanAngle``. The columns of a height are headed ``40m Radial Wind Speed (m/s)`` and ``40m CNR (dB)``
    (v2), or ``RWS`` and ``CNR`` with a number (v1 and WLS70), and then stand in the order of the header's
    ``Altitudes``. Heights count above the instrument, so that a gate is height / sin(elevation) along its beam.
    The velocity is positive towards the lidar. The header's ``timezone`` is that of the times, where nobody says
    another. What part of a ray the time stamps is not published; the header's pulses over their rate give the duration
    that the option ``time_stamp`` needs. The azimuth counts from the instrument's own north: ``DirectionOffset``,
    pitch and roll are not applied, nor the angles in the rows of moving instruments.

    References
    ----------
    Header, columns and elevation: Lidaco (github.com/e-WindLidar/Lidaco, ``lidaco/readers/Windcubev2.py`` and
    samples); doppy (github.com/actris-cloudnet/doppy, ``wls70.rs`` and ``wls77.rs``). Sign: L-TERRA's
    ``lidar_preprocessing_functions.py``, which takes minus the column for the velocity away from the lidar.
    """
    lines = read_lines(file)
    header = _header(lines)
    at = {name.lower(): index for index, name in reversed(list(enumerate(header.headings)))}
    if "position" not in at:
        raise InputError(_no_rays(file, header.headings))
    velocity_at, cnr_at, height = _heights(header, file)
    columns = sorted({0, at["position"], *velocity_at, *cnr_at})
    width = len(header.headings)
    table = whole_rows(
        lines,
        first=header.n_line,
        separator="\t",
        n_field=[n for n in (width, width - 1, width + 1) if n > columns[-1] + 1],
        columns=columns,
        text=[0, at["position"]],
        bad_rows=file_format.bad_rows,
    )
    file_format = _with_zone(file_format, header, file)
    text = table.column("time", 0, header.headings[0])
    text = replace(text, values=text.values.astype("string").str.replace(_DAY_FIRST, r"\3-\2-\1", regex=True))
    time, invalid = times(text, file_format)
    azimuth, elevation = _angles(table, at["position"], header, file_format, file)
    velocity, cnr = np.empty((2, len(table.rows), len(height)))
    for index, place in enumerate(velocity_at):
        velocity[:, index], is_invalid = numbers(
            table.column("radial_velocity", place, header.headings[place]), file_format
        )
        invalid = invalid | is_invalid
    for index, place in enumerate(cnr_at):
        cnr[:, index], _ = numbers(table.column("cnr", place, header.headings[place]), file_format)
    kept = table.kept()
    duration = np.full(int(kept.sum()), _duration(header))
    rise = np.sin(np.deg2rad(elevation[kept]))[:, np.newaxis]
    order = np.argsort(height, kind="stable")
    return Rays(
        file=file,
        kind="windcube-text",
        file_format=file_format,
        time=file_format.to_start(time[kept], duration if np.isfinite(duration).all() else None),
        direction=direction_of(azimuth[kept], elevation[kept]),
        distance=height[order] / rise,
        radial_velocity=file_format.to_away(velocity[kept][:, order]),
        cnr=cnr[kept][:, order] if cnr_at else None,
        status=None,
        row=table.rows[kept],
        row_word="line",
        counts=counts_of(len(duration), invalid=int(invalid[kept].sum()), left_out=table.counts()),
        facts=table.facts(),
        accumulation_time=duration,
    )


def _header(lines: TextLines) -> _Header:
    file = lines.file
    fields: dict[str, str] = {}
    if not len(lines) or not _SIZE.fullmatch(lines.text(0)):
        raise InputError(
            f"File {str(file)!r} does not begin with 'HeaderSize=' or 'HeaderLength=', as a WindCube's .rtd file does: "
            "check that it is one."
        )
    for index in range(min(len(lines), _MOST_LINES)):
        text = lines.text(index)
        words = tuple(word.strip() for word in text.split("\t"))
        if len(words) > 1 and words[0].lower().split(" ")[0] in ("timestamp", "date"):
            return _Header(fields, words, index + 1)
        name, equals, value = text.partition("=")
        if equals:
            fields[re.sub(r"[^a-z0-9]", "", name.lower())] = value.strip().lstrip(")")
    raise InputError(
        f"File {str(file)!r} has a WindCube's header, but no line of headings that begins with Timestamp or Date: its "
        "rows are the instrument's own binary ones; convert it to text with the manufacturer's software."
    )


def _heights(header: _Header, file: Path) -> tuple[list[int], list[int], FloatArray]:
    """Return the columns of velocities and of CNR, and the height of each velocity, m."""
    found: dict[str, dict[float, int]] = {"radial wind speed": {}, "cnr": {}}
    for index, heading in enumerate(header.headings):
        match = _AT_HEIGHT.fullmatch(heading)
        if match:
            found[match[2].lower()][float(match[1])] = index
    velocity, cnr = found["radial wind speed"], found["cnr"]
    if velocity:
        return (
            list(velocity.values()),
            list(cnr.values()) if list(cnr) == list(velocity) else [],
            np.array(list(velocity)),
        )
    text = header.fields.get("altitudesm", header.fields.get("altitudesaglm", ""))
    try:
        height = np.array([float(word.replace(",", ".")) for word in text.split()])
    except ValueError:
        height = np.zeros(0)
    own: dict[str, list[int]] = {"rws": [], "cnr": []}
    for index, heading in enumerate(header.headings):
        match = _NUMBERED.fullmatch(heading)
        if match:
            own[match[1].lower()].append(index)
    if not len(height) or not (height > 0.0).all() or len(own["rws"]) != len(height):
        raise InputError(_no_rays(file, header.headings))
    return own["rws"], own["cnr"] if len(own["cnr"]) == len(height) else [], height


def _no_rays(file: Path, headings: Sequence[str]) -> str:
    shown = ", ".join(repr(heading[:40]) for heading in headings[:8])
    return (
        f"File {str(file)!r} has no column Position, or none of radial wind speeds for each of its heights: its "
        f"columns are {shown} and {max(len(headings) - 8, 0)} more; statistics (.sta) hold no radial velocities of "
        "beams: give the .rtd file."
    )


def _angles(
    table: TextRows, at: int, header: _Header, file_format: FileFormat, file: Path
) -> tuple[FloatArray, FloatArray]:
    try:
        angle = float(header.fields.get("scanangle", "").replace(",", "."))
    except ValueError:
        angle = np.nan
    position = table.column("azimuth", at, header.headings[at])
    text = position.values.astype("string").str.strip().str.upper()
    vertical = (text == "V").fillna(False).to_numpy(dtype=bool)
    azimuth, _ = numbers(replace(position, values=text.mask(vertical, "0")), file_format)
    if not vertical.all() and not 0.0 < angle <= _LARGEST_ANGLE:
        raise InputError(
            f"Invalid ScanAngle {header.fields.get('scanangle')!r} in the header of file {str(file)!r}: it must be the "
            f"angle of the beams from the vertical, up to {_LARGEST_ANGLE:g} degrees; correct the header."
        )
    elevation = np.where(vertical, 90.0, 90.0 - angle)
    check_angles(azimuth, elevation, table.rows, "line", file)
    return azimuth, elevation


def _with_zone(file_format: FileFormat, header: _Header, file: Path) -> FileFormat:
    """Return the options with the zone that the header states, if nobody said another."""
    stated = header.fields.get("timezone", "")
    if not stated or "time_zone" not in file_format.from_format:
        return file_format
    try:
        as_zone(stated)
    except InputError as error:
        raise InputError(f"The header of file {str(file)!r} cannot be used: {error}") from error
    return replace(file_format, time_zone=stated)


def _duration(header: _Header) -> float:
    """Return how long a ray takes by the header, s; NaN if it does not say."""
    try:
        pulses, rate = (float(header.fields[name]) for name in ("pulseslineofsight", "pulserepetitionratehz"))
    except (KeyError, ValueError):
        return np.nan
    return pulses / rate if pulses > 0.0 and rate > 0.0 else np.nan


read_windcube_text = by_rays(windcube_text_rays)

READER = Reader(
    name="windcube-text",
    title="WindCube v1, v2, WLS70 and WLS7, .rtd text",
    source="Lidaco (github.com/e-WindLidar/Lidaco); doppy (github.com/actris-cloudnet/doppy); sign: L-TERRA",
    suffixes=SUFFIXES,
    recognises=lambda *_: True,
    read=read_windcube_text,
    rays=windcube_text_rays,
    defaults={"positive": "towards", "time_zone": "UTC"},
    uses=OF_TEXT_RAYS,
)
