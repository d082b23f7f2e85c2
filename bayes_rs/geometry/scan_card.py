"""A scan in a line of text, and as a card with its beams in a notebook."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.probe import Probe
from bayes_rs.html_parts import beams, card


def scan_rows(direction: FloatArray, distance: FloatArray, duration: float, probe: Probe) -> dict[str, str]:
    """Return what there is to say of a scan, by name.

    Parameters
    ----------
    direction : ndarray, shape (n_beam, 3)
        Unit vectors in the levelled lidar's frame.
    distance : ndarray, shape (n_beam,)
        m.
    duration : float
        Of a cycle, s.
    probe : Probe
        The probe volume.
    """
    up = bool(direction[:, 2].mean() > 0.5)
    angle = np.rad2deg(np.arccos(np.clip(direction[:, 2] if up else -direction[:, 0], -1.0, 1.0)))
    return {
        "beams": f"{len(direction)}, {_ends(angle)}° from {'the zenith' if up else 'straight ahead'}",
        "distance": f"{_ends(distance)} m",
        "cycle": f"{duration:g} s",
        "probe": "points" if not probe.parameters() else f"{probe.kind}, {_ends(probe.length(distance))} m",
    }


def scan_card(title: str, rows: dict[str, str], direction: FloatArray, numbers: list[int]) -> str:
    """Return the HTML of a scan: its beams from the front, or of one that looks up from below."""
    if direction[:, 2].mean() > 0.5:
        level = np.maximum(direction[:, 2], 0.05)
        across, up, what = direction[:, 1] / level, -direction[:, 0] / level, "beams, from above"
    else:
        ahead = np.maximum(np.abs(direction[:, 0]), 0.05)
        across, up, what = direction[:, 1] / ahead, direction[:, 2] / ahead, "beams, as the lidar sees them"
    return card(title, rows.items(), beams(across, up, [str(number) for number in numbers], what))


def _ends(values: FloatArray) -> str:
    low, high = (f"{one:.3g}" for one in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"
