"""The look that all pictures share: colours, what the prior supplied, and figures that a notebook shows by itself."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, in_short

POSTERIOR_COLOUR = "#0072B2"
"""What the data said."""
PRIOR_COLOUR = "#6B6B6B"
"""What the prior supplied: hatched, or an outline."""
TRUTH_COLOUR = "#D55E00"
OTHER_COLOUR = "#E69F00"
"""What stands beside: flags, classic estimators, a second quantity."""
COLOURS = (POSTERIOR_COLOUR, OTHER_COLOUR, "#009E73", "#CC79A7", "#56B4E9", "#000000")
"""Of several cases, in this order; of Okabe and Ito (2008), which people with any colour vision tell apart."""
HATCH = "////"
DATA_MARK: dict[str, Any] = {"color": POSTERIOR_COLOUR}
PRIOR_MARK: dict[str, Any] = {"color": PRIOR_COLOUR, "markerfacecolor": "white"}
"""How marks are drawn, of what the data decided and of what is mostly the prior's."""
_NO_PICTURES = ("avif", "pgf", "raw", "rgba")
BEHIND: dict[str, Any] = {"color": PRIOR_COLOUR, "alpha": 0.15, "linewidth": 0}
"""How the prior's band behind a posterior is drawn."""


def picture_suffixes() -> tuple[str, ...]:
    """Return how the names of files can end that a figure is saved to, with the dot.

    Notes
    -----
    These are matplotlib's, without those that need more than is installed with it (``.pgf`` LaTeX, ``.avif`` a new
    Pillow), and without ``.raw`` and ``.rgba``, which state no size.
    """
    return tuple(f".{name}" for name in FigureCanvasBase.get_supported_filetypes() if name not in _NO_PICTURES)


class Picture(Figure):
    """A figure that a notebook shows by itself, and once: it is none of pyplot's."""

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG, which notebooks show in place of text."""
        sink = io.BytesIO()
        self.savefig(sink, format="png")
        return sink.getvalue()


def new_or_given(figure: FigureBase | None, size: tuple[float, float]) -> FigureBase:
    """Return the figure or subfigure that was given, or a new one of this size, inches.

    Raises
    ------
    InputError
        If what was given is no figure.
    """
    if figure is None:
        return Picture(figsize=size, layout="constrained")
    if not isinstance(figure, FigureBase):
        raise InputError(f"Invalid figure {in_short(figure)}: give a matplotlib Figure or SubFigure, or leave it out.")
    if isinstance(figure, Figure) and figure.get_layout_engine() is None:
        figure.set_layout_engine("constrained")  # titles and legends would lie on the panels
    return figure


def axes_of(ax: Axes | None, size: tuple[float, float]) -> tuple[Axes, Axes | Picture]:
    """Return the axes to draw on, and what the caller gets back: the axes that were given, or a new figure.

    Raises
    ------
    InputError
        If what was given are no axes.
    """
    if ax is None:
        figure = Picture(figsize=size, layout="constrained")
        return figure.subplots(), figure
    if not isinstance(ax, Axes):
        raise InputError(f"Invalid ax {in_short(ax)}: give matplotlib Axes, or leave it out.")
    return ax, ax


def hatched(**more: Any) -> dict[str, Any]:
    """Return the style of a face that is the prior's."""
    return {"facecolor": "none", "edgecolor": PRIOR_COLOUR, "hatch": HATCH, "linewidth": 0.0, **more}


def prior_patch(label: str) -> Patch:
    """Return the legend's handle of what is mostly the prior's."""
    return Patch(**hatched(linewidth=0.8), label=label)


def with_middles(when: NDArray[Any], values: FloatArray) -> tuple[NDArray[Any], FloatArray]:
    """Put the places halfway between neighbours among points: when (n,) and values (..., n) become 2 n − 1 long."""
    when = when if when.dtype.kind == "M" else when.astype(np.float64)
    at = np.empty(2 * len(when) - 1, dtype=when.dtype)
    at[::2], at[1::2] = when, when[:-1] + (when[1:] - when[:-1]) / 2
    found = np.empty((*values.shape[:-1], len(at)))
    found[..., ::2], found[..., 1::2] = values, 0.5 * (values[..., 1:] + values[..., :-1])
    return at, found


def reach_halfway(of_kind: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a kind of points reaches, on the places of `with_middles`: halfway to neighbours of another kind."""
    found = np.empty(2 * len(of_kind) - 1, dtype=np.bool_)
    found[::2], found[1::2] = of_kind, of_kind[1:] | of_kind[:-1]
    return found
