"""How files of radial velocities are written: every option of reading, once."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime, timedelta, timezone, tzinfo
from typing import Any, ClassVar
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from bayes_rs._validation import check_choice, check_finite, check_positive
from bayes_rs.errors import InputError, did_you_mean, in_short
from bayes_rs.options import described, option, options_of
from bayes_rs.quantities import MOST_WIND

NAMES = ("time", "beam", "radial_velocity", "cnr", "status", "range")
STANDARD_INPUT = "-"
"""What stands for the standard input among the names of files."""
ALL_RANGES = "all"
"""What the option range is for all ranges that the files have."""
DIRECTION_NAMES = ("azimuth", "elevation", "phase", "sx", "sy", "distance", "height", "gate")
"""What a table of rays calls where each of them points, in place of a beam's number."""
SIGNS = ("away", "towards")
TIME_STAMPS = {"start": 0.0, "middle": 0.5, "end": 1.0}
TIME_FORMATS = ("unix", "unix-ms", "unix-us", "unix-ns", "labview", "matlab")
VELOCITY_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "knot": 1852.0 / 3600.0, "cm/s": 0.01, "mm/s": 0.001}
VELOCITY_LIMIT = MOST_WIND
"""m/s, beyond which velocities of files count as missing."""
GATES_BY = ("distance", "height")
DECIMALS = (".", ",")
TURNS = ("up", "down")
OUT_OF_ORDER = ("error", "sort")
ON_BAD_FILE = ("error", "skip")
BAD_ROWS = ("error", "drop")

OF_READING = ("file_format", "out_of_order", "bad_rows", "on_bad_file")
"""Options that are a matter of one reading, not of an instrument: a scan's ``[file]`` table does not have them."""

_WIDE_NAME = re.compile(r"(?:(?:vr|beam|cnr|status)_)?-?\d+")
_FIXED_OFFSET = re.compile(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?(\d{2}))?")
_LONGEST = 200  # characters of an entry: no heading is longer, and a message stays one line


@described
@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """How the files of a lidar are written, and what to do with bad ones.

    Raises
    ------
    InputError
        If a value is not valid.

    Notes
    -----
    What is None, or an empty mapping, is not said. An option that is said counts before the scan's own ``[file]``
    table, which counts before the default of the file's format, which counts before the general default: positive
    away, m/s, UTC, comma and point, no invalid value, times as they stand, rays within 1 degree, phase from 0 upwards.
    An option that is said and that no reader of the files uses is refused where they are read.

    ``columns`` names ``time``, ``beam``, ``radial_velocity``, ``cnr``, ``status`` and ``range``, the distance along
    the beam in m: of a table with several, the rows at the scan's distances are read. In files of rays it also names
    ``azimuth``, ``elevation``, ``distance`` (or ``range``), ``height``, ``gate``, ``sx``, ``sy`` and ``phase``. In a
    file without headings a column is its number, from 1. ``beam_numbers``, if given, must name every beam of the files.
    ``time_zone`` is of written times in text and Parquet files; NetCDF and Halo files and counted times are in UTC, and
    refuse another zone of the caller's. ``time_format`` is a pattern, ``unix`` or ``labview`` (seconds since 1970 or
    1904), ``unix-ms``, ``unix-us`` or ``unix-ns`` (milli-, micro- or nanoseconds), or ``matlab`` (days, as datenum
    counts). The time kept is the start of a sample: with ``time_stamp`` middle or end, times are moved back by the
    duration that the file gives, or by ``sample_duration``. Gates of rays are within half of their spacing of the focus
    distance, unless ``range_tolerance`` is given. With ``range`` or ``height`` the beams are read at each of several
    distances, which stay apart: each gets its own R. Every format with its source, sign, stamp and zone stands in
    docs/formats.md.

    Examples
    --------
    >>> FileOptions(positive="towards", invalid=9999).given()
    {'positive': 'towards', 'invalid': (9999.0,)}
    """

    file_format: str = option(
        "auto",
        "Format of the files; auto finds it from their suffix and what they hold",
        choices="bayes_rs.readers.registry:FORMATS",
        flag="--format",
    )
    columns: Mapping[str, str] = option(
        {},
        "What the files call our names, as radial_velocity=RWS",
        flag="--column",
        metavar="OURS=THEIRS",
    )
    beam_numbers: Mapping[str, int] = option(
        {}, "The scan's number of a beam of the files, as LOS2=2", flag="--beam-number", metavar="THEIRS=OURS"
    )
    positive: str | None = option(None, "Direction in which the files count radial velocity positive", choices=SIGNS)
    velocity_unit: str | None = option(None, "Unit of the radial velocity in the files", choices=tuple(VELOCITY_UNITS))
    invalid: float | Sequence[float] | None = option(
        None, "Numbers that mark a missing entry, such as 9999", metavar="NUMBER"
    )
    velocity_limit: float | None = option(
        None, f"Speed that no wind has, by default {VELOCITY_LIMIT:g}: faster velocities count as missing", unit="m/s"
    )
    time_zone: str | None = option(None, "Zone of times that carry none, as UTC, UTC+1 or Europe/Berlin")
    time_format: str | None = option(
        None,
        "How times are written if not in ISO 8601: a pattern as %d.%m.%Y %H:%M:%S, or unix, unix-ms, labview, matlab",
    )
    time_stamp: str | None = option(
        None, "What a time in the files stands for: the start, middle or end of a sample", choices=tuple(TIME_STAMPS)
    )
    sample_duration: float | None = option(
        None, "Length of a sample where the files do not say it, for time_stamp", unit="s"
    )
    separator: str | None = option(None, "What separates the entries of a text file: one character, or tab")
    decimal: str | None = option(None, "Decimal sign of a text file", choices=DECIMALS)
    skip_rows: int | None = option(None, "Lines above the headings of a text file, which are skipped")
    comment: str | None = option(None, "What a line of a text file begins with that is no row, as #")
    encoding: str | None = option(
        None, "Encoding of a text file, as cp1252; by default UTF-8, or UTF-16 where its byte-order mark says so"
    )
    status_valid: float | None = option(None, "Status of a good sample; the others are dropped when records are made")
    angle_tolerance_deg: float | None = option(
        None, "Largest angle between a ray and its beam", unit="degrees", flag="--angle-tolerance"
    )
    range_tolerance: float | None = option(
        None, "Largest difference between a gate and a beam's focus distance", unit="m"
    )
    gate_length: float | None = option(
        None, "Length of a range gate in files that only number their gates: gate n is at (n + ½) of it", unit="m"
    )
    range: str | float | Sequence[float] | None = option(
        None,
        "Distances along the beams at which R is wanted, each by itself, or all that the files have",
        unit="m",
        metavar="M,M,...|all",
    )
    height: float | Sequence[float] | None = option(
        None,
        "Heights above a lidar that looks up at which R is wanted, in place of distances",
        unit="m",
        metavar="M,M,...",
    )
    gates_by: str | None = option(
        None, "What to believe where a file's distances of gates contradict their heights", choices=GATES_BY
    )
    phase_zero_deg: float | None = option(
        None, "Where on its cone a ZX's phase is zero: 0 is sideways (y), 90 up", unit="degrees", flag="--phase-zero"
    )
    phase_turns: str | None = option(None, "Which way a ZX's phase turns from there", choices=TURNS)
    out_of_order: str = option(
        "error",
        "What to do where time goes backwards: refuse, or sort. Two velocities of one beam at one time are refused "
        "either way; only of a few, as of a clock that was set back, sort makes missing ones",
        choices=OUT_OF_ORDER,
    )
    bad_rows: str = option(
        "error",
        "What to do with rows of a table that cannot be read: refuse the first, or drop and count them (at most 1 %)",
        choices=BAD_ROWS,
    )
    on_bad_file: str = option(
        "error",
        "What to do with a file that cannot be used: refuse all, or skip it and name it in the report",
        choices=ON_BAD_FILE,
    )

    names: ClassVar[tuple[str, ...]] = (*NAMES, *DIRECTION_NAMES)
    """What `columns` may name, beside the columns of a wide table."""

    def __post_init__(self) -> None:
        """Check the options, and bring them into one form."""

        def put(name: str, as_one: Callable[..., Any], **rule: Any) -> None:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, as_one(value, what=name, **rule))

        for entry in fields(self):
            _check_length(entry.name, getattr(self, entry.name))
        for name in ("columns", "beam_numbers"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, {})
        for name in ("file_format", "time_zone"):
            put(name, _text)
        put("columns", _columns, names=self.names)
        put("beam_numbers", _beam_numbers)
        for name, choices in (
            ("positive", SIGNS),
            ("velocity_unit", tuple(VELOCITY_UNITS)),
            ("time_stamp", tuple(TIME_STAMPS)),
            ("decimal", DECIMALS),
            ("gates_by", GATES_BY),
            ("phase_turns", TURNS),
            ("out_of_order", OUT_OF_ORDER),
            ("bad_rows", BAD_ROWS),
            ("on_bad_file", ON_BAD_FILE),
        ):
            put(name, _choice, choices=choices)
        put("invalid", _numbers)
        put("range", _distances)
        put("height", _distances)
        put("time_format", _time_format)
        put("separator", _separator)
        put("skip_rows", _count)
        put("comment", _comment)
        put("encoding", _encoding)
        put("status_valid", _number, check=check_finite, unit="")
        put("phase_zero_deg", _number, check=check_finite, unit="degrees")
        for name, unit in (
            ("velocity_limit", "m/s"),
            ("sample_duration", "s"),
            ("angle_tolerance_deg", "degrees"),
            ("range_tolerance", "m"),
            ("gate_length", "m"),
        ):
            put(name, _number, check=check_positive, unit=unit)
        if self.time_zone is not None:
            as_zone(self.time_zone)

    def given(self) -> dict[str, Any]:
        """Return the options that are said, by name."""
        return {
            entry.name: value
            for entry in options_of(FileOptions)
            if (value := getattr(self, entry.name)) != entry.default
        }


def as_zone(name: str) -> tzinfo:
    """Return the time zone called `name`: an IANA name such as Europe/Berlin, or an offset such as UTC+1 or +01:00."""
    offset = _FIXED_OFFSET.fullmatch(name.strip())
    if offset is not None:
        sign, hours, minutes = offset.groups()
        shift = timedelta(hours=int(hours), minutes=int(minutes or 0))
        if shift < timedelta(hours=24):
            return timezone(shift if sign == "+" else -shift)
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        raise InputError(
            f"Unknown time_zone {name!r}: it must be a name such as UTC or Europe/Berlin, or an offset such as UTC+1."
        ) from error


def is_utc(name: str) -> bool:
    """Say whether a time zone is UTC by another name or offset.

    Examples
    --------
    >>> is_utc("Etc/UTC"), is_utc("+00:00"), is_utc("Europe/London")
    (True, True, False)
    """
    zone = as_zone(name)
    return all(zone.utcoffset(datetime(2020, month, 1)) == timedelta(0) for month in (1, 7))


def _check_length(name: str, value: Any) -> None:
    """Refuse an entry that no file has, so that every message is one line."""
    if isinstance(value, Mapping):
        parts = [*value, *value.values()]
    else:
        parts = list(value) if isinstance(value, (list, tuple)) else [value]
    for part in parts:
        text = repr(part)
        if len(text) > _LONGEST:
            raise InputError(
                f"Invalid {name} {text[:60]}…: an entry of {len(text)} characters is no option; at most {_LONGEST} "
                "may be."
            )


def _text(value: object, *, what: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"Invalid {what} {in_short(value)}: it must be a text.")
    return value


def _choice(value: str, *, what: str, choices: tuple[str, ...]) -> str:
    return check_choice(value, choices, what=what)


def _number(value: Any, *, what: str, check: Callable[..., float], unit: str) -> float:
    if isinstance(value, (bool, str)):  # as in a file that has true or "1" for a number
        raise InputError(f"Invalid {what} {in_short(value)}{' ' + unit if unit else ''}: it must be a finite number.")
    return check(value, what=what, unit=unit)


def _numbers(value: float | Sequence[float], *, what: str) -> tuple[float, ...]:
    items = list(value) if isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, str) else [value]
    return tuple(_number(item, what=f"entry of {what}", check=check_finite, unit="") for item in items)


def _distances(value: Any, *, what: str) -> str | tuple[float, ...]:
    if what == "range" and isinstance(value, str):
        if value != ALL_RANGES:
            raise InputError(f"Invalid range {in_short(value)}: it must be numbers in m, or the word {ALL_RANGES}.")
        return value
    items = list(value) if isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, str) else [value]
    found = tuple(_number(item, what=f"entry of {what}", check=check_positive, unit="m") for item in items)
    if not found:
        raise InputError(f"Invalid {what} []: it must name at least one distance, in m.")
    return found


def _mapping(value: object, *, what: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"Invalid {what} {in_short(value)}: it must be a mapping from names to names or numbers.")
    return {str(key): item for key, item in value.items()}


def _columns(value: object, *, what: str, names: tuple[str, ...]) -> dict[str, str]:
    columns = _mapping(value, what=what)
    for name, column in columns.items():
        if name not in names and not _WIDE_NAME.fullmatch(name):
            raise InputError(
                f"Unknown name {name!r} in columns: it must be one of {', '.join(names)}, or for "
                "a wide table vr_<beam number>, cnr_<beam number> or status_<beam number>"
                f"{f'; {meant}' if (meant := did_you_mean(name, names)) else '.'}"
            )
        if isinstance(column, bool) or not isinstance(column, (str, int, np.integer)):
            raise InputError(
                f"Invalid column {in_short(column)} for {name!r} in columns: it must be a heading, or a number."
            )
    return {name: str(column) for name, column in columns.items()}


def _beam_numbers(value: object, *, what: str) -> dict[str, int]:
    numbers = _mapping(value, what=what)
    for label, number in numbers.items():
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)):
            raise InputError(
                f"Invalid beam_numbers entry {label!r}: {in_short(number)}: it must be a whole number, the scan's beam "
                "number."
            )
    return {label.strip(): int(number) for label, number in numbers.items()}


def _time_format(value: object, *, what: str) -> str:
    if isinstance(value, str) and value in TIME_FORMATS:
        return value
    if not isinstance(value, str) or "%" not in value:
        raise InputError(
            f"Unknown {what} {in_short(value)}: it must be one of {', '.join(TIME_FORMATS)}, or a pattern such as "
            "'%d.%m.%Y %H:%M:%S'; leave it out for ISO 8601."
        )
    from bayes_rs.stated_time import states_a_date  # noqa: PLC0415 - pandas is slow to load

    if not states_a_date(value):
        raise InputError(
            f"Invalid {what} {in_short(value)}: it must be a pattern that can be read and states year, month and day, "
            "such as '%d.%m.%Y %H:%M:%S'; join the date and the time of day in one column, if the files have two."
        )
    return value


def _count(value: object, *, what: str) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        raise InputError(f"Invalid {what} {in_short(value)}: it must be a whole number, zero or above.")
    return int(value)


def _comment(value: object, *, what: str) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable() or value.strip() != value:
        raise InputError(f"Invalid {what} {in_short(value)}: it must be what such lines begin with, as '#'.")
    return value


def _encoding(value: object, *, what: str) -> str:
    try:
        "".encode(_text(value, what=what))  # codecs that are no text's are refused, too
    except (LookupError, ValueError) as error:
        raise InputError(
            f"Unknown {what} {in_short(value)}: it must be an encoding that Python knows, such as utf-8, cp1252, "
            "latin-1 or utf-16."
        ) from error
    return str(value)


def _separator(value: object, *, what: str) -> str:
    if value in ("tab", "\\t"):
        return "\t"
    if not isinstance(value, str) or len(value) != 1 or value.isalnum() or value in "\r\n\"'":
        raise InputError(f"Invalid {what} {in_short(value)}: it must be one character such as ',' or ';', or 'tab'.")
    return value
