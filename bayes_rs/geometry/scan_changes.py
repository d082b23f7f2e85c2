"""Changes of a scan that are written behind its name: ``zx-300@focus_distance=98,probe=point``."""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

from bayes_rs._validation import check_choice
from bayes_rs.errors import InputError
from bayes_rs.models import check_is_name

_YES = {"yes": True, "no": False}


def split_changes(name: str | Path) -> tuple[str, dict[str, Any]]:
    """Split the name of a scan from the changes behind its last ``@``.

    Parameters
    ----------
    name : str or Path
        Such as ``"6-beam"``, ``"mine.toml@tilt_deg=2"`` or ``"6-beam@opening_angle_deg=30,focus_distance=49+98"``. The
        path of an existing file is never split.

    Returns
    -------
    name : str
        The name or path without changes.
    changes : dict
        Arguments of `load_scan`: numbers, lists of focus distances, and the probe as it is written.

    Raises
    ------
    InputError
        If a change is not known, not a number or given twice, or there is none behind the ``@``.

    Examples
    --------
    >>> split_changes("zx-300@focus_distance=49+98,probe=point")
    ('zx-300', {'focus_distance': [49.0, 98.0], 'probe': 'point'})
    """
    head, changes = _written_changes(name)
    for key, value in changes.items():
        if key != "probe" and "/" in value:
            raise InputError(
                f"Invalid {key} {value!r} of scan {head!r}: several values make several scans, which can be compared "
                "only; give one value here."
            )
    return head, {key: CHANGES[key](head, key, value) for key, value in changes.items()}


def several_scans(name: str | Path) -> list[str]:
    """Return the name of every scan that a name with several values of a change stands for.

    Parameters
    ----------
    name : str or Path
        A name of a scan; values of a change are separated by ``/``, in every change but the probe, whose value may be a
        path.

    Returns
    -------
    names : list of str
        All combinations, the last change varying fastest. A name without several values stands for itself.

    Raises
    ------
    InputError
        If a change is not valid.

    Examples
    --------
    >>> several_scans("6-beam@opening_angle_deg=15/30,focus_distance=98")
    ['6-beam@opening_angle_deg=15,focus_distance=98', '6-beam@opening_angle_deg=30,focus_distance=98']
    """
    head, changes = _written_changes(name)
    if not changes:
        return [head]
    values = [[value] if key == "probe" else value.split("/") for key, value in changes.items()]
    for key, several in zip(changes, values, strict=True):
        if len(set(several)) < len(several):
            raise InputError(
                f"Invalid {key} {changes[key]!r} of scan {head!r}: it names a value twice; give each once."
            )
    cells = [",".join(f"{key}={value}" for key, value in zip(changes, cell, strict=True)) for cell in product(*values)]
    return [f"{head}@{cell}" for cell in cells]


def _written_changes(name: str | Path) -> tuple[str, dict[str, str]]:
    """Split a name from its changes as they are written."""
    check_is_name(name, "scans")
    text = str(name)
    head, at, tail = text.rpartition("@")
    is_file = os.path.isfile(text)  # noqa: PTH113 - of a name that no file can have, Path.is_file raises
    if not at or is_file or (text.endswith(".toml") and "=" not in tail):
        return text, {}
    changes: dict[str, str] = {}
    for change in tail.split(","):
        key, equals, value = change.partition("=")
        if not equals or not value:
            raise InputError(
                f"Invalid change {change!r} of scan {head!r}: behind the @ stand changes such as probe=point or "
                "focus_distance=98, separated by commas."
            )
        check_choice(key, tuple(CHANGES), what="change", of=f"scan {head!r}")
        if key in changes:
            raise InputError(f"Invalid scan {text!r}: it changes {key} twice; give it once.")
        changes[key] = value
    return head, changes


def _number(scan: str, key: str, value: str) -> float:
    if "+" in value.lstrip("+"):
        raise InputError(f"Invalid {key} {value!r} of scan {scan!r}: only focus distances may be several.")
    try:
        return float(value)
    except ValueError as error:
        raise InputError(f"Invalid {key} {value!r} of scan {scan!r}: it must be a number.") from error


def _numbers(scan: str, key: str, value: str) -> list[float]:
    return [_number(scan, key, part) for part in value.split("+")]


def _whole_number(scan: str, key: str, value: str) -> int:
    try:
        return int(value)
    except ValueError as error:
        raise InputError(f"Invalid {key} {value!r} of scan {scan!r}: it must be a whole number.") from error


def _yes_or_no(scan: str, key: str, value: str) -> bool:
    if value not in _YES:
        raise InputError(f"Invalid {key} {value!r} of scan {scan!r}: it must be yes or no.")
    return _YES[value]


CHANGES: dict[str, Callable[[str, str, str], Any]] = {
    "opening_angle_deg": _number,
    "focus_distance": _numbers,
    "tilt_deg": _number,
    "yaw_deg": _number,
    "probe": lambda _scan, _key, value: value,
    "n_beams": _whole_number,
    "centre": _yes_or_no,
}
"""What of a scan can be changed, and how its value is read; each has the meaning of that argument of `load_scan`."""
