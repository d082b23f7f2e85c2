"""The explicit options of a reader: what a file calls things, which sign, unit, zone and separators it uses."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta, timezone, tzinfo
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_choice, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan

NAMES = ("time", "beam", "radial_velocity", "cnr", "status")
DIRECTION_NAMES = ("azimuth", "elevation", "phase", "sx", "sy", "distance")
"""What a table of rays calls where each of them points, in place of a beam's number."""
SIGNS = ("away", "towards")
TIME_STAMPS = {"start": 0.0, "middle": 0.5, "end": 1.0}
TIME_FORMATS = ("unix", "labview", "matlab")
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
    time_format: str | None = None
    time_stamp: str | None = None
    sample_duration: float | None = None
    angle_tolerance_deg: float = 1.0
    range_tolerance: float | None = None
    phase_zero_deg: float = 0.0
    phase_turns: str = "up"
    from_format: frozenset[str] = frozenset()
    """Options that neither the caller nor the scan gave, so that the format's own default counts."""

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

    def to_start(self, time: NDArray[np.datetime64], duration: ArrayLike | None = None) -> NDArray[np.datetime64]:
        """Move times of samples to the start of their accumulation.

        Parameters
        ----------
        time : ndarray of datetime64[ns], shape (n,)
            As in the file.
        duration : array_like, shape () or (n,), optional
            How long a sample took, s, if the file says; the option ``sample_duration`` counts before it.

        Raises
        ------
        InputError
            If times stand at the middle or end of samples of unknown duration.
        """
        share = TIME_STAMPS[self.time_stamp or "start"]
        if share == 0.0:
            return time
        length = self.sample_duration if self.sample_duration is not None else duration
        if length is None and "time_stamp" in self.from_format:
            return time  # the format's own default must not make a file unreadable
        if length is None:
            raise InputError(
                f"Times that stand at the {self.time_stamp} of a sample need its duration, and the file does not say "
                "it: give sample_duration in seconds (--sample-duration)."
            )
        shift = np.round(share * 1e9 * np.asarray(length, dtype=np.float64))
        moved: NDArray[np.datetime64] = time - np.where(np.isfinite(shift), shift, 0.0).astype("timedelta64[ns]")
        return moved

    def is_invalid(self, values: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Say which values are among those that mark a missing entry."""
        return np.isin(values, np.asarray(self.invalid, dtype=np.float64))


def resolve_format(
    options: Mapping[str, Any], scan: Scan | None, *, defaults: Mapping[str, Any] | None = None
) -> FileFormat:
    """Combine the caller's options, the scan's own file format and the defaults, in this order of precedence.

    Parameters
    ----------
    options : mapping
        The options of `bayes_rs.read_radial_velocity`; None where not given.
    scan : Scan, optional
        The scan whose `file_format` stands in for options not given; None for a file that describes itself.
    defaults : mapping, optional
        What the format of the file sets where neither the caller nor the scan does.

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
    of_format = dict(defaults or {})
    of_scan = {} if scan is None else {key: value for key, value in scan.file_format.items() if value != {}}
    chosen: dict[str, Any] = {**of_format, **of_scan, **given}
    asked = _as_mapping(given.get("columns", {}), "columns")
    columns = {**of_format.get("columns", {}), **of_scan.get("columns", {}), **asked}
    for name in columns:
        if name not in (*NAMES, *DIRECTION_NAMES) and not _WIDE_NAME.fullmatch(name):
            raise InputError(
                f"Unknown name {name!r} in columns: it must be one of {', '.join((*NAMES, *DIRECTION_NAMES))}, or for "
                "a wide table vr_<beam number>, cnr_<beam number> or status_<beam number>."
            )
    file_format = FileFormat(
        columns={name: str(column) for name, column in columns.items()},
        beam_numbers=_as_beam_numbers(chosen.get("beam_numbers", {})),
        positive=check_choice(chosen.get("positive", "away"), SIGNS, what="positive"),
        velocity_unit=check_choice(chosen.get("velocity_unit", "m/s"), tuple(VELOCITY_UNITS), what="velocity_unit"),
        invalid=_as_numbers(chosen.get("invalid", ())),
        time_zone=str(chosen.get("time_zone", "UTC")),
        separator=_as_separator(chosen.get("separator", ",")),
        decimal=check_choice(chosen.get("decimal", "."), (".", ","), what="decimal"),
        status_valid=_if_given(chosen, "status_valid", check_finite, unit=""),
        out_of_order=check_choice(chosen.get("out_of_order", "error"), OUT_OF_ORDER, what="out_of_order"),
        required=frozenset(asked),
        time_format=_as_time_format(chosen.get("time_format")),
        time_stamp=_if_given(chosen, "time_stamp", check_choice, choices=tuple(TIME_STAMPS)),
        sample_duration=_if_given(chosen, "sample_duration", check_positive, unit="s"),
        angle_tolerance_deg=check_positive(
            chosen.get("angle_tolerance_deg", 1.0), what="angle_tolerance_deg", unit="degrees"
        ),
        range_tolerance=_if_given(chosen, "range_tolerance", check_positive, unit="m"),
        phase_zero_deg=check_finite(chosen.get("phase_zero_deg", 0.0), what="phase_zero_deg", unit="degrees"),
        phase_turns=check_choice(chosen.get("phase_turns", "up"), ("up", "down"), what="phase_turns"),
        from_format=frozenset(of_format) - set(of_scan) - set(given),
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


def _if_given(chosen: Mapping[str, Any], name: str, check: Callable[..., Any], **rule: Any) -> Any:
    value = chosen.get(name)
    return None if value is None else check(value, what=name, **rule)


def _as_time_format(value: object) -> str | None:
    if value is None or (isinstance(value, str) and (value in TIME_FORMATS or "%" in value)):
        return value
    raise InputError(
        f"Unknown time_format {value!r}: it must be one of {', '.join(TIME_FORMATS)}, or a pattern such as "
        "'%d.%m.%Y %H:%M:%S'; leave it out for ISO 8601."
    )


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
