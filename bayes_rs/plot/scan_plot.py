"""A scan as a picture: where its beams point, from the lidar, from above and from the side."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.scan_words import looks_up, probe_in_words
from bayes_rs.pictures import OTHER_COLOUR, POSTERIOR_COLOUR, Picture, new_or_given

_MOST_NAMED = 60
"""Beams that have their number beside them."""


_Given = TypeVar("_Given", bound=FigureBase)


def scan(scan: Scan | str | Path, *, figure: _Given | None = None) -> _Given | Picture:
    """Draw where the beams of a scan point, and to where.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, its name or file.
    figure : Figure or SubFigure, optional
        Where to draw.

    Returns
    -------
    figure : Figure or SubFigure
        What was given, or a new figure. Left the beams as the lidar sees them, joined in the order of time, degrees
        from its axis (of scans that look up: from the zenith, north up, east right); then the measured points with tilt
        and yaw, from above and from the side, m, with the full width of their probe volume at half its maximum.

    Examples
    --------
    >>> figure = scan("zx-tm")
    >>> len(figure.axes)
    3
    """
    shown = as_scan(scan)
    target = new_or_given(figure, (11.0, 4.4))
    angles, above, beside = target.subplots(1, 3)
    _draw_angles(angles, shown)
    points = shown.line_of_sight * shown.focus_distance[:, np.newaxis]
    width = 2.0 if shown.probe.parameters().get("kind") == "continuous-wave" else 1.0  # of z_R; of a gate and its pulse
    half = 0.5 * width * shown.probe_length[:, np.newaxis] * shown.line_of_sight
    up = looks_up(shown)
    across, along, height = (points[:, 1], -points[:, 0], points[:, 2])
    far, sideways = ("north", "east") if up else ("ahead, upwind", "to the right, seen along the beams")
    _draw_points(above, np.stack([across, along]), np.stack([half[:, 1], -half[:, 0]]), "from above")
    above.set_xlabel(f"{sideways} (m)")
    above.set_ylabel(f"{far} (m)")
    _draw_points(beside, np.stack([along, height]), np.stack([-half[:, 0], half[:, 2]]), "from the side")
    beside.set_xlabel(f"{far} (m)")
    beside.set_ylabel("height above the lidar (m)")
    seen = sight(shown)
    target.suptitle(
        f"{shown.name}: {shown.n_beam} beams, cycle of {shown.scan_duration:g} s; {seen.in_words()}\n"
        f"probe: {probe_in_words(shown.probe, shown.focus_distance)}",
        fontsize=10,
    )
    return target  # type: ignore[return-value] # what was given, or new


def _draw_angles(axis: Axes, scan: Scan) -> None:
    """Draw the directions before tilt and yaw, on a plane on which distances from the middle are angles."""
    first, second, third = scan.beam_direction.T
    if looks_up(scan):
        away, right, up = np.arccos(np.clip(third, -1.0, 1.0)), second, -first
        axis.set_xlabel("degrees from the zenith, to the east")
        axis.set_ylabel("degrees from the zenith, to the north")
    else:
        away, right, up = np.arccos(np.clip(-first, -1.0, 1.0)), second, third
        axis.set_xlabel("degrees from the axis, to the right")
        axis.set_ylabel("degrees from the axis, up")
    length = np.hypot(right, up)
    place = np.rad2deg(away) * np.stack([right, up]) / np.where(length > 0.0, length, 1.0)
    order = np.argsort(scan.beam_time, kind="stable")
    plane = order[: len(np.unique(np.round(scan.beam_direction, 6), axis=0))]
    axis.plot(*place[:, plane], color="0.75", linewidth=0.8, zorder=1)
    axis.plot(*place, "o", color=POSTERIOR_COLOUR, markersize=4, zorder=2)
    if scan.n_beam <= _MOST_NAMED:
        for index, number in enumerate(scan.beam.tolist()):
            axis.annotate(str(number), place[:, index], (3, 3), textcoords="offset points", fontsize=7)
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.12)
    axis.grid(color="0.9")
    axis.set_axisbelow(True)
    axis.set_title("as the lidar looks", fontsize=10)


def _draw_points(axis: Axes, place: FloatArray, half: FloatArray, title: str) -> None:
    """Draw the measured points, their probes, and thin lines to the lidar."""
    for (x, y), (dx, dy) in zip(place.T.tolist(), half.T.tolist(), strict=True):
        axis.plot([0.0, x], [0.0, y], color="0.85", linewidth=0.5, zorder=1)
        axis.plot([x - dx, x + dx], [y - dy, y + dy], color=OTHER_COLOUR, linewidth=2.0, alpha=0.6, zorder=2)
    axis.plot(*place, "o", color=POSTERIOR_COLOUR, markersize=3, zorder=3)
    axis.plot(0.0, 0.0, "s", color="0.2", markersize=6, zorder=4)
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.12)
    axis.grid(color="0.9")
    axis.set_axisbelow(True)
    axis.set_title(title, fontsize=10)
