"""The scans of a comparison: names, files and scans, and the columns of a table that say what each of them is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_rs._validation import as_items
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_changes import several_scans
from bayes_rs.geometry.scan_file import load_scan

DESIGN = ("n_beam", "centre", "opening_angle_deg", "focus_distance", "tilt_deg", "yaw_deg", "duration")
"""The columns that say which scan and record length a row is for."""
_ON_AXIS = 1e-9  # rad
_DIGITS = 9  # of what is calculated from unit vectors


def _name(scan: object) -> str | Path:
    if not isinstance(scan, (str, Path)):
        raise InputError(f"Invalid scan {in_short(scan)}: give a Scan, or a name or file of one.")
    return scan


def named_scans(
    scans: str | Path | Scan | Sequence[str | Path | Scan], label: str | Sequence[str] | None = None
) -> list[tuple[str, Scan]]:
    """Return the scans with their labels; a name with several values of a change is as many scans.

    Parameters
    ----------
    scans : str, Path or Scan, or sequence of them
        Names, files or scans; a label may stand before a name, as ``"wide=6-beam@opening_angle_deg=45"``.
    label : str or sequence of str, optional
        What each of `scans` is called, in place of its name. Of a name that is several scans, the label stands for what
        is before the ``@``.

    Raises
    ------
    InputError
        If there is no scan, two have one label, a name is not valid, or there are more or fewer labels than scans.

    Examples
    --------
    >>> [label for label, _ in named_scans(["wide=6-beam@n_beams=4/6", "zx-tm"])]
    ['wide@n_beams=4', 'wide@n_beams=6', 'zx-tm']
    """
    given = [scans] if isinstance(scans, (str, Path, Scan)) else as_items(scans, what="scans")
    loaded = [pair for scan, own in zip(given, _labels(given, label), strict=True) for pair in _of_one(scan, own)]
    if not loaded:
        raise InputError("There is no scan to compare: name at least one.")
    labels = [label for label, _ in loaded]
    for one in labels:
        if labels.count(one) > 1:
            raise InputError(f"Scan {one!r} is named twice: give each once, or each a label of its own.")
    return loaded


def split_label(name: str) -> tuple[str, str]:
    """Split ``LABEL=SCAN``; the label is empty where there is none: the ``=`` of a change or of a path is no such sign.

    Examples
    --------
    >>> split_label("wide=6-beam@tilt_deg=5"), split_label("6-beam@tilt_deg=5"), split_label("a/b=c.toml")
    (('wide', '6-beam@tilt_deg=5'), ('', '6-beam@tilt_deg=5'), ('', 'a/b=c.toml'))
    """
    head, sign, rest = name.partition("=")
    if not sign or not head.strip() or any(mark in head for mark in "@/\\") or Path(name).is_file():
        return "", name
    return head.strip(), rest


def _labels(given: Sequence[Any], label: str | Sequence[str] | None) -> list[str]:
    """Return the label of each of the given scans; empty where it has none."""
    if label is None:
        return [""] * len(given)
    labels = [label] if isinstance(label, str) else list(as_items(label, what="label"))
    if len(labels) != len(given):
        raise InputError(f"Invalid label: there are {len(labels)} for {len(given)} scans; give one for each.")
    for one in labels:
        if not isinstance(one, str) or not one.strip() or "@" in one:
            raise InputError(f"Invalid label {in_short(one)}: give a text, without an @.")
    return labels


def _of_one(scan: object, label: str) -> list[tuple[str, Scan]]:
    """Return the scans that one entry stands for, with their labels."""
    if isinstance(scan, Scan):
        return [(label or scan.name, scan)]
    own, name = split_label(scan) if isinstance(scan, str) else ("", _name(scan))
    label = label or own
    several = several_scans(_name(name))
    if not label:
        return [(one, load_scan(one)) for one in several]
    if len(several) == 1:
        return [(label, load_scan(several[0]))]
    return [(f"{label}@{one.rpartition('@')[2]}", load_scan(one)) for one in several]


def design_of(scan: Scan) -> dict[str, Any]:
    """Return what the columns `DESIGN` say of a scan, but for the duration.

    The opening angle is the largest of a beam from the axis, and the focus distance the largest one. The axis is z for
    a lidar whose beams point up on average, and −x for the others.
    """
    back, side, up = scan.beam_direction.T
    upward = np.sum(up) > np.sum(-back)
    opening = np.arctan2(np.hypot(back, side), up) if upward else np.arctan2(np.hypot(side, up), -back)
    return {
        "n_beam": scan.n_beam,
        "centre": bool(np.any(opening < _ON_AXIS)),
        "opening_angle_deg": float(np.round(np.rad2deg(np.max(opening)), _DIGITS)),
        "focus_distance": float(np.max(scan.focus_distance)),
        "tilt_deg": float(np.round(np.rad2deg(scan.tilt), _DIGITS)),
        "yaw_deg": float(np.round(np.rad2deg(scan.yaw), _DIGITS)),
    }
