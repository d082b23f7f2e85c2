"""Units that NetCDF files state: those that are read, by all spellings in use, and what they are in ours."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from bayes_rs.errors import InputError, in_short
from bayes_rs.readers.format import FileFormat

_LENGTH = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("km", "kilometer", "kilometers", "kilometre", "kilometres"), 1000.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 0.001),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}
_SECOND = ("s", "sec", "secs", "second", "seconds")
_HOUR = ("h", "hr", "hour", "hours")
_PER = {
    **{(length, second): "m/s" for length, factor in _LENGTH.items() if factor == 1.0 for second in _SECOND},
    **{(length, second): "cm/s" for length, factor in _LENGTH.items() if factor == 0.01 for second in _SECOND},
    **{(length, second): "mm/s" for length, factor in _LENGTH.items() if factor == 0.001 for second in _SECOND},
    **{(length, hour): "km/h" for length, factor in _LENGTH.items() if factor == 1000.0 for hour in _HOUR},
}
_WORDS = {
    **dict.fromkeys(("ms-1", "ms^-1", "mps"), "m/s"),
    **dict.fromkeys(("kmh", "kph", "kmh-1"), "km/h"),
    **dict.fromkeys(("knot", "knots", "kt", "kts", "kn"), "knot"),
}
_ANGLE = {
    **dict.fromkeys(
        ("degree", "degrees", "deg", "degs", "\N{DEGREE SIGN}", "arc_degree", "arc_degrees", "degree_true",
         "degrees_true", "degrees true", "angular_degree", "angular_degrees"), 1.0),
    **dict.fromkeys(("rad", "radian", "radians"), 180.0 / np.pi),
}  # fmt: skip
_DIVIDED = re.compile(r"([a-z]+)\s*(?:/|\bper\b)\s*\(?([a-z]+)\)?")
_TO_THE_POWER = re.compile(r"([a-z]+)[\s.*\u00b7\u22c5]+([a-z]+)\s*(?:\^|\*\*)?\s*\(?[-\u2212]1\)?")
_SUPERSCRIPT = "\u207b\u00b9"


@lru_cache(maxsize=256)
def velocity_unit_of(text: str) -> str | None:
    """Return what we call the unit of a velocity, one of `VELOCITY_UNITS`; None if it is no such.

    Examples
    --------
    >>> [velocity_unit_of(text) for text in ("m s-1", "m.s^-1", "Meters per second", "cm s**-1", "kts", "1", "deg")]
    ['m/s', 'm/s', 'm/s', 'cm/s', 'knot', None, None]
    """
    plain = text.strip().lower().replace(_SUPERSCRIPT, "-1")
    if plain in _WORDS:
        return _WORDS[plain]
    parts = _DIVIDED.fullmatch(plain) or _TO_THE_POWER.fullmatch(plain)
    return None if parts is None else _PER.get((parts[1], parts[2]))


def with_velocity_unit(file_format: FileFormat, stated: object, *, name: str, file: Path) -> FileFormat:
    """Return the options with the unit that a file states for its velocity, unless the caller or the scan gave one.

    Parameters
    ----------
    file_format : FileFormat
        The options.
    stated : object
        The attribute ``units``; None or empty if there is none: then the unit of the options counts.
    name, file
        For the message.

    Raises
    ------
    InputError
        If it is no unit of a velocity that is known.
    """
    text = as_text(stated)
    if "velocity_unit" in file_format.said or not text:
        return file_format
    unit = velocity_unit_of(text)
    if unit is None:
        raise InputError(
            f"Variable {name!r} in file {str(file)!r} has the units {in_short(text)}: a velocity must be in m/s, km/h, "
            "knot, cm/s or mm/s; name the right variable with columns={'radial_velocity': NAME}, or, if the attribute "
            "is wrong, say the unit with velocity_unit (--velocity-unit)."
        )
    return file_format if unit == file_format.velocity_unit else replace(file_format, velocity_unit=unit)


def factor_to_degrees(stated: object, *, name: str, file: Path) -> float:
    """Return by what an angle must be multiplied to be in degrees; without a unit it is in degrees.

    Raises
    ------
    InputError
        If the unit is not known.
    """
    return _factor(_ANGLE, stated, name, file, "an angle must be in degrees or radians")


def factor_to_metres(stated: object, *, name: str, file: Path) -> float:
    """Return by what a length must be multiplied to be in m; without a unit it is in m.

    Raises
    ------
    InputError
        If the unit is not known.
    """
    return _factor(_LENGTH, stated, name, file, "a distance must be in m, km, cm, mm or feet")


def _factor(known: dict[str, float], stated: object, name: str, file: Path, rule: str) -> float:
    text = as_text(stated).lower()
    if text and text not in known:
        raise InputError(
            f"Variable {name!r} in file {str(file)!r} has the units {in_short(text)}: {rule}; correct the attribute, "
            "or name the right variable with columns (--column OURS=THEIRS)."
        )
    return known.get(text, 1.0)


def as_text(stated: object) -> str:
    """Return an attribute as text; nothing for none."""
    if stated is None:
        return ""
    return (stated.decode("utf-8", "replace") if isinstance(stated, bytes) else str(stated)).strip()
