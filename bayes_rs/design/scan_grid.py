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


def named_scans(scans: str | Path | Scan | Sequence[str | Path | Scan]) -> list[tuple[str, Scan]]:
    """Return the scans with their labels; a name with several values of a change is as many scans.

    Raises
    ------
    InputError
        If there is no scan, one is given twice, or a name is not valid.
    """
    given = [scans] if isinstance(scans, (str, Path, Scan)) else as_items(scans, what="scans")
    loaded = [
        pair
        for scan in given
        for pair in (
            [(scan.name, scan)]
            if isinstance(scan, Scan)
            else [(name, load_scan(name)) for name in several_scans(_name(scan))]
        )
    ]
    if not loaded:
        raise InputError("There is no scan to compare: name at least one.")
    labels = [label for label, _ in loaded]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"Scan {label!r} is named twice: give each once.")
    return loaded


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
