"""Figures as pictures in the page."""

from __future__ import annotations

import base64
import io
import threading
from collections.abc import Callable

from matplotlib.figure import FigureBase

_DPI = 110
_DRAWING = threading.Lock()
"""Matplotlib's settings are those of the process, so one figure is drawn at a time."""


def picture(draw: Callable[[], FigureBase]) -> str:
    """Return what a function draws as the address of a PNG picture, which holds the picture itself."""
    file = io.BytesIO()
    with _DRAWING:
        figure = draw()
        figure.savefig(file, format="png", dpi=_DPI, facecolor="white")  # type: ignore[attr-defined]  # of a Figure
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode('ascii')}"
