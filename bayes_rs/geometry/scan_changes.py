"""Changes of a scan that are written behind its name: ``zx-300@focus_distance=98,probe=point``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_rs._validation import check_choice
from bayes_rs.errors import InputError

CHANGES = ("opening_angle_deg", "focus_distance", "tilt_deg", "yaw_deg", "probe")
"""What of a scan can be changed; each has the meaning of that argument of `load_scan`."""


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
    text = str(name)
    head, at, tail = text.rpartition("@")
    if not at or Path(text).is_file() or (text.endswith(".toml") and "=" not in tail):
        return text, {}
    changes: dict[str, Any] = {}
    for change in tail.split(","):
        key, equals, value = change.partition("=")
        if not equals or not value:
            raise InputError(
                f"Invalid change {change!r} of scan {head!r}: behind the @ stand changes such as probe=point or "
                "focus_distance=98, separated by commas."
            )
        check_choice(key, CHANGES, what="change", of=f"scan {head!r}")
        if key in changes:
            raise InputError(f"Invalid scan {text!r}: it changes {key} twice; give it once.")
        changes[key] = value if key == "probe" else _numbers(head, key, value)
    return head, changes


def _numbers(scan: str, key: str, value: str) -> float | list[float]:
    try:
        numbers = [float(part) for part in value.split("+")]
    except ValueError as error:
        raise InputError(f"Invalid {key} {value!r} of scan {scan!r}: it must be a number.") from error
    if key == "focus_distance":
        return numbers
    if len(numbers) > 1:
        raise InputError(f"Invalid {key} {value!r} of scan {scan!r}: only focus distances may be several.")
    return numbers[0]
