"""A first look at files as a picture: the mean velocity over the phase, and the first samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from bayes_rs.pictures import OTHER_COLOUR, POSTERIOR_COLOUR, Picture
from bayes_rs.readers.looking import Look

_TOPS = {0.0: "zero 90", 90.0: "zero 0, up\nor 180, down", 180.0: "zero 270", 270.0: "zero 0, down\nor 180, up"}
"""For which phase zeros, and turns, the top of the cone is at a phase."""
_AT_TOP: dict[str, Any] = {
    "xycoords": ("data", "axes fraction"),
    "textcoords": "offset points",
    "fontsize": 7,
    "va": "top",
}


def draw_look(found: Look) -> Picture:
    """Draw the mean velocity over the phase or azimuth, with the phase zeros that there may be, and the first samples.

    Parameters
    ----------
    found : Look
        From `bayes_rs.readers.looking.look`.

    Returns
    -------
    figure : Figure
        The samples alone where files have neither phase nor azimuth.
    """
    figure = Picture(figsize=(9.0, 3.8), layout="constrained")
    known = np.isfinite(found.over_phase)
    *cones, series = figure.subplots(1, 2 if known.any() else 1, squeeze=False)[0]
    for cone in cones:
        _draw_cone(cone, found)
    series.plot(found.seconds, found.velocity, ".", color=POSTERIOR_COLOUR, markersize=2)
    series.set_xlabel("time since the first sample (s)")
    series.set_ylabel("velocity (m/s)")
    series.set_title("the first samples", fontsize=10)
    return figure


def _draw_cone(cone: Axes, found: Look) -> None:
    """Draw the mean velocity over the phase or azimuth."""
    known = np.isfinite(found.over_phase)
    cone.plot(
        found.phase_deg[known], found.over_phase[known], "o-", color=POSTERIOR_COLOUR, markersize=3, linewidth=0.8
    )
    for top, words in _TOPS.items() if found.angle == "phase" else ():
        cone.axvline(top, color=OTHER_COLOUR, linewidth=0.8, linestyle="--")
        cone.annotate(f"top for\n{words}", (top, 0.98), (3, 0), color=OTHER_COLOUR, **_AT_TOP)
    cone.set_xlim(-5.0, 365.0)
    cone.set_xticks([0, 90, 180, 270, 360])
    cone.set_xlabel(f"{found.angle} (degrees)")
    cone.set_ylabel("mean velocity (m/s)")
    cone.set_title(f"mean over the {found.angle}", fontsize=10)
