"""A corner plot that follows a slider, as Plotly reads it: all panels in one pair of axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.app.charts import Chart, Palette, clear, layout_of, legend_below
from bayes_rs.app.choosing import prior_at_size
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.plot.density import outlines, smooth
from bayes_rs.posteriors.decided import PRIORS

_GAP = 0.06  # between panels, of a panel
_CELLS = 48  # of a density along an axis
_VARIANCES = 3
_DASH = "4px,3px"
_Line = FloatArray


def corner_chart(draws: FloatArray, truth: FloatArray, of_prior: Sequence[bool], theme: str) -> Chart:
    """Return the corner plot of a posterior, quick enough to follow a slider.

    Parameters
    ----------
    draws : ndarray, shape (n, 6)
        Posterior draws, m² s⁻².
    truth : ndarray, shape (6,)
        The stresses that were simulated, which set the limits of the axes, too: they stay while the scan changes.
    of_prior : sequence of bool
        Which stresses the prior decided more than the data: what shows them is grey and hatched.
    theme : str
        ``"dark"`` or ``"light"``.

    Notes
    -----
    All panels are drawn in one pair of axes: a page redraws one of them ten times as fast as 21.
    """
    palette = Palette.of(theme)
    draws = np.asarray(draws, dtype=np.float64)
    limits = corner_limits(truth)
    prior = prior_at_size(draws)
    ours: tuple[list[_Line], list[_Line]] = ([], [])
    greys: tuple[list[_Line], list[_Line]] = ([], [])
    theirs: tuple[list[_Line], list[_Line]] = ([], [])
    for row in range(len(STRESSES)):
        for column in range(row):
            cell = _Cell(column, row, limits[column], limits[row])
            own = greys if of_prior[row] or of_prior[column] else ours
            for some, into in ((draws, own), (prior, theirs)):
                for which, lines in enumerate(_outlines(some, column, row)):
                    into[which].extend(cell.place(line) for line in lines)
    bars: list[_Line] = []
    grey_bars: list[_Line] = []
    prior_bars: list[_Line] = []
    for index in range(len(STRESSES)):
        cell = _Cell(index, index, limits[index], (0.0, 1.15))
        (grey_bars if of_prior[index] else bars).append(cell.place(_hill(draws, index)))
        prior_bars.append(cell.place(_hill(prior, index)))
    marks = [
        _Cell(column, row, limits[column], limits[row]).place(np.array([[truth[column], truth[row]]]))
        for row in range(len(STRESSES))
        for column in range(row)
    ]
    hatch = {"shape": "/", "size": 5, "solidity": 0.25, "fgcolor": palette.grey, "bgcolor": "rgba(0,0,0,0)"}
    data = [
        _filled(grey_bars + greys[1], palette.grey, 0.0, PRIORS, fillpattern=hatch),
        _filled(greys[0], palette.grey, 0.25, ""),
        _filled(ours[1], palette.data, 0.25, ""),
        _filled(ours[0] + bars, palette.data, 0.55, "posterior, 68 and 95 %"),
        _filled(theirs[1] + prior_bars, palette.prior, None, "prior, at the posterior’s uu + vv + ww", dash=_DASH),
        _filled([_frame(_Cell(c, r, (0, 1), (0, 1))) for r in range(6) for c in range(r + 1)], palette.faint, None, ""),
        {
            "type": "scatter",
            "mode": "markers",
            "name": "simulated truth",
            "x": [float(mark[0, 0]) for mark in marks],
            "y": [float(mark[0, 1]) for mark in marks],
            "marker": {"symbol": "square", "size": 6, "color": palette.truth},
            "hoverinfo": "skip",
        },
    ]
    layout = layout_of(
        palette,
        margin={"l": 46, "r": 6, "t": 6, "b": 110},
        xaxis={"range": [0, 6], "visible": False, "fixedrange": True},
        yaxis={"range": [0, 6], "visible": False, "fixedrange": True},
        annotations=_corner_words(limits, of_prior, palette),
        showlegend=True,
        legend=legend_below(-0.1),
        uirevision="corner",
    )
    return {"data": data, "layout": layout}


@dataclass(frozen=True)
class _Cell:
    """A panel of the corner plot, whose axes go over these limits."""

    column: int
    row: int
    x: Sequence[float] | FloatArray
    y: Sequence[float] | FloatArray

    def place(self, line: FloatArray) -> FloatArray:
        """Return points (n, 2) where the panel is in the common axes; what is outside lies on the frame."""
        inside = [
            np.clip((line[:, i] - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0) for i, ends in enumerate((self.x, self.y))
        ]
        size = 1.0 - _GAP
        return np.column_stack([self.column + size * inside[0], 5.0 - self.row + size * inside[1]])


def corner_limits(truth: FloatArray) -> FloatArray:
    """Return limits of the axes, shape (6, 2), m² s⁻², that are the same for every scan in a flow."""
    trace = float(truth[:3].sum())
    high = np.maximum(2.4 * truth[:3], 0.7 * trace)  # a variance that no beam sees goes far beyond its truth
    cross = 0.45 * trace
    return np.array([[0.0, high[0]], [0.0, high[1]], [0.0, high[2]], *[[-cross, cross]] * 3])


def _outlines(draws: FloatArray, column: int, row: int) -> list[list[_Line]]:
    """Return the lines that hold 68 and 95 % of draws (n, 6) in a panel."""
    positive = (column < _VARIANCES, row < _VARIANCES)
    return outlines(draws[:, column], draws[:, row], positive=positive, n_grid=_CELLS)


def _hill(draws: FloatArray, index: int) -> _Line:
    """Return the density of one stress as a closed outline, (n, 2), 1 at most."""
    place, height = smooth(draws[:, index], positive=index < _VARIANCES, n_grid=_CELLS)
    return np.column_stack([[place[0], *place, place[-1]], [0.0, *(height / height.max()), 0.0]])


def _frame(cell: _Cell) -> FloatArray:
    return cell.place(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]))


def _filled(
    lines: Sequence[FloatArray], colour: str, share: float | None, name: str, dash: str = "solid", **more: Any
) -> Chart:
    """Return outlines as one trace, with gaps between them; not filled without a share."""
    x: list[float | None] = []
    y: list[float | None] = []
    for line in lines:
        x += [*np.round(line[:, 0], 3).tolist(), None]
        y += [*np.round(line[:, 1], 3).tolist(), None]
    fill: Chart = {} if share is None else {"fill": "toself", "fillcolor": clear(colour, share)}
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "showlegend": bool(name),
        "x": x,
        "y": y,
        "line": {"color": colour, "width": 1.2, "dash": dash},
        "hoverinfo": "skip",
        **fill,
        **more,
    }


def _corner_words(limits: FloatArray, of_prior: Sequence[bool], palette: Palette) -> list[Chart]:
    """Return the names of the stresses and the ends of their axes."""
    size = 1.0 - _GAP
    common = {"showarrow": False, "xref": "x", "yref": "y"}
    words: list[Chart] = []
    for index, (name, own) in enumerate(zip(STRESSES, of_prior, strict=True)):
        colour = palette.grey if own else palette.text
        centre = index + 0.5 * size
        words.append(
            {
                **common,
                "x": centre,
                "y": 0,
                "yshift": -3,
                "yanchor": "top",
                "text": f"<b>{name}</b>",
                "font": {"color": colour},
            }
        )
        for place, anchor, value in zip((index, index + size), ("left", "right"), limits[index], strict=True):
            words.append(
                {
                    **common,
                    "x": place,
                    "y": 0,
                    "xanchor": anchor,
                    "yanchor": "top",
                    "yshift": -18,
                    "text": f"{value:.2g}".replace("-", "−"),
                    "font": {"size": 9},
                }
            )
        if index > 0:
            height = 5.0 - index
            words.append(
                {
                    **common,
                    "x": 0,
                    "y": height + 0.5 * size,
                    "xanchor": "right",
                    "text": f"<b>{name}</b>",
                    "font": {"color": colour},
                    "xshift": -4,
                }
            )
            for place, anchor, value in zip((height, height + size), ("bottom", "top"), limits[index], strict=True):
                words.append(
                    {
                        **common,
                        "x": 0,
                        "y": place,
                        "xanchor": "right",
                        "yanchor": anchor,
                        "text": f"{value:.2g}".replace("-", "−"),
                        "font": {"size": 9},
                        "xshift": -4,
                    }
                )
    return words
