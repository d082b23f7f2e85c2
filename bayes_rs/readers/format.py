"""The explicit options of a reader: what a file calls things, which sign, unit, zone and separators it uses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta, timezone, tzinfo
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from bayes_rs._validation import FloatArray, check_choice, check_finite
from bayes_rs.errors import InputError
from bayes_rs.scan import Scan

NAMES = ("time", "beam", "radial_velocity", "cnr", "status")
SIGNS = ("away", "towards")
VELOCITY_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "knot": 1852.0 / 3600.0}
OUT_OF_ORDER = ("error", "sort")

_WIDE_NAME = re.compile(r"(?:(?:vr|beam|cnr|status)_)?-?\d+")
_FIXED_OFFSET = re.compile(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?(\d{2}))?")


@dataclass(frozen=True)
class FileFormat:
    """How to read one instrument's files; the meaning of each field is in `bayes_rs.read_radial_velocity`."""

    columns: Mapping[str, str]
    beam_numbers: Mapping[str, int]
    positive: str
    velocity_unit: str
    invalid: tuple[float, ...]
    time_zone: str
    separator: str
    decimal: str
    status_valid: float | None
    out_of_order: str
    required: frozenset[str]
    """Names that the caller mapped to a column, so that the column must be there."""

    @property
    def zone(self) -> tzinfo:
        """The zone of times that carry none."""
        return as_zone(self.time_zone)

    def column(self, name: str) -> str:
        """Return what the file calls `name`."""
        return self.columns.get(name, name)

    def to_away(self, velocity: FloatArray) -> FloatArray:
        """Convert radial velocities as in the file to m/s, positive away from the lidar."""
        sign = -1.0 if self.positive == "towards" else 1.0
        return sign * VELOCITY_UNITS[self.velocity_unit] * velocity

    def is_invalid(self, values: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Say which values are among those that mark a missing entry."""
        return np.isin(values, np.asarray(self.invalid, dtype=np.float64))


def resolve_format(options: Mapping[str, Any], scan: Scan, *, use_scan: bool = True) -> FileFormat:
    """Combine the caller's options, the scan's own file format and the defaults, in this order of precedence.

    Parameters
    ----------
    options : mapping
        The options of `bayes_rs.read_radial_velocity`; None where not given.
    scan : Scan
        The scan whose `file_format` stands in for options not given.
    use_scan : bool
        False for a file that describes itself: then only the caller's options count.

    Returns
    -------
    file_format : FileFormat
        The checked options.

    Raises
    ------
    InputError
        If an option is not valid.
    """
    given = {key: value for key, value in options.items() if value is not None}
    chosen: dict[str, Any] = {**(scan.file_format if use_scan else {}), **given}
    own_columns = dict(scan.file_format.get("columns", {})) if use_scan else {}
    columns = {**own_columns, **_as_mapping(given.get("columns", {}), "columns")}
    for name in columns:
        if name not in NAMES and not _WIDE_NAME.fullmatch(name):
            raise InputError(
                f"Unknown name {name!r} in columns: it must be one of {', '.join(NAMES)}, or for a wide table "
                "vr_<beam number>, cnr_<beam number> or status_<beam number>."
            )
    status_valid = chosen.get("status_valid")
    file_format = FileFormat(
        columns={name: str(column) for name, column in columns.items()},
        beam_numbers=_as_beam_numbers(chosen.get("beam_numbers", {})),
        positive=check_choice(chosen.get("positive", "away"), SIGNS, what="positive"),
        velocity_unit=check_choice(chosen.get("velocity_unit", "m/s"), tuple(VELOCITY_UNITS), what="velocity_unit"),
        invalid=_as_numbers(chosen.get("invalid", ())),
        time_zone=str(chosen.get("time_zone", "UTC")),
        separator=_as_separator(chosen.get("separator", ",")),
        decimal=check_choice(chosen.get("decimal", "."), (".", ","), what="decimal"),
        status_valid=None if status_valid is None else check_finite(status_valid, what="status_valid", unit=""),
        out_of_order=check_choice(chosen.get("out_of_order", "error"), OUT_OF_ORDER, what="out_of_order"),
        required=frozenset(_as_mapping(given.get("columns", {}), "columns")),
    )
    as_zone(file_format.time_zone)
    if file_format.separator == file_format.decimal and "separator" in chosen:
        raise InputError(
            f"Invalid separator {file_format.separator!r}: it is also the decimal sign; files with decimal commas "
            "are separated by ';' or tab as a rule."
        )
    return file_format


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


def _as_mapping(value: object, what: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"Invalid {what} {value!r}: it must be a mapping from names to names or numbers.")
    return {str(key): item for key, item in value.items()}


def _as_beam_numbers(value: object) -> dict[str, int]:
    numbers = _as_mapping(value, "beam_numbers")
    for label, number in numbers.items():
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)):
            raise InputError(
                f"Invalid beam_numbers entry {label!r}: {number!r}: it must be a whole number, the scan's beam number."
            )
    return {label.strip(): int(number) for label, number in numbers.items()}


def _as_numbers(value: float | Sequence[float]) -> tuple[float, ...]:
    items = list(value) if isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, str) else [value]
    return tuple(check_finite(item, what="entry of invalid", unit="") for item in items)


def _as_separator(value: object) -> str:
    if value in ("tab", "\\t"):
        return "\t"
    if not isinstance(value, str) or len(value) != 1 or value.isalnum() or value in "\r\n\"'":
        raise InputError(f"Invalid separator {value!r}: it must be one character such as ',' or ';', or 'tab'.")
    return value
