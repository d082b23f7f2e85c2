"""The app's own charts, as Plotly reads them: interval widths, intervals of a record, availability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.app.choosing import Answer, prior_widths_at
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.pictures import POSTERIOR_COLOUR, PRIOR_COLOUR, TRUTH_COLOUR
from bayes_rs.posteriors.decided import PRIORS
from bayes_rs.report.availability import Availability

Chart = dict[str, Any]
"""A figure of Plotly as plain values: data, and layout."""

CONFIG: Chart = {"displayModeBar": False, "responsive": True, "scrollZoom": False, "doubleClick": False}
"""How charts behave in the page: no buttons, and no zoom that a finger on a phone would start by scrolling."""
_SYMBOLS = ("square", "diamond", "triangle-up", "x", "star", "cross", "hexagon")
_TICKS = [step * 10.0**power for power in range(-4, 4) for step in (1, 2, 5)]


@dataclass(frozen=True)
class Palette:
    """Colours of a chart: those of the figures, lightened on a dark page."""

    data: str
    prior: str
    truth: str
    grey: str
    text: str
    faint: str

    @classmethod
    def of(cls, theme: str) -> Palette:
        """Return the colours for ``"dark"``, or for any other theme the light ones."""
        named = (POSTERIOR_COLOUR, PRIOR_COLOUR, TRUTH_COLOUR)
        if theme == "dark":
            data, prior, truth = (_lighter(colour) for colour in named)
            return cls(data, prior, truth, "#a0a0a0", "#e4e4e4", "#4a4f55")
        return cls(*named, "#6b6b6b", "#1c1c1c", "#c9ced3")


def _lighter(colour: str) -> str:
    """Return a colour half way to white."""
    return "#" + "".join(f"{(int(colour[i : i + 2], 16) + 255) // 2:02x}" for i in (1, 3, 5))


def clear(colour: str, share: float) -> str:
    """Return a colour of which so much is seen, from 0 to 1."""
    return f"rgba({','.join(str(int(colour[i : i + 2], 16)) for i in (1, 3, 5))},{share:g})"


def layout_of(palette: Palette, **more: Any) -> Chart:
    """Return what the layouts of all charts have, and more."""
    common: Chart = {
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": palette.text, "size": 12, "family": "system-ui, sans-serif"},
        "hoverlabel": {"font": {"color": "#1c1c1c"}, "bgcolor": "#ffffff"},
        "dragmode": False,
    }
    return {**common, **more}


def legend_below(height: float) -> Chart:
    """Return a legend below a chart, where it hides nothing on a phone."""
    return {"orientation": "h", "y": height, "yanchor": "top", "x": 0, "xanchor": "left", "itemclick": False}


def widths_chart(mine: Answer, others: Sequence[Answer], theme: str) -> Chart:
    """Return interval widths of a scan as points, one row for each stress, beside presets and the prior.

    Parameters
    ----------
    mine : Answer
        The page's scan: large points with their Monte-Carlo errors, hollow and grey where the prior decided more.
    others : sequence of Answer
        Presets, as small points, hollow where the prior decided more.
    theme : str
        ``"dark"`` or ``"light"``.
    """
    palette = Palette.of(theme)
    rows = list(range(len(STRESSES)))
    names = [f"{name}{' (prior’s)' if own else ''}" for name, own in zip(STRESSES, mine.of_prior, strict=True)]
    prior = prior_widths_at(mine.truth)
    data: list[Chart] = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "the prior alone, where uu + vv + ww is known",
            "x": prior.tolist(),
            "y": rows,
            "marker": {
                "symbol": "line-ns",
                "size": 22,
                "line": {"color": palette.prior, "width": 3},
                "color": palette.prior,
            },
            "hovertemplate": "%{x:.2f} m² s⁻²<extra>prior</extra>",
        }
    ]
    for symbol, one in zip(_SYMBOLS, others, strict=False):
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": one.label,
                "x": one.width.tolist(),
                "y": [row + 0.22 for row in rows],
                "marker": {
                    "symbol": [f"{symbol}{'-open' if own else ''}" for own in one.of_prior],
                    "size": 9,
                    "color": palette.grey,
                },
                "hovertemplate": "%{x:.2f} m² s⁻²<extra>" + one.label + "</extra>",
            }
        )
    colours = [palette.grey if own else palette.data for own in mine.of_prior]
    data.append(
        {
            "type": "scatter",
            "mode": "markers",
            "name": "this scan, with the Monte-Carlo error",
            "x": mine.width.tolist(),
            "y": rows,
            "error_x": {"type": "data", "array": mine.error.tolist(), "color": palette.grey, "thickness": 1.2},
            "marker": {
                "symbol": ["circle-open" if own else "circle" for own in mine.of_prior],
                "size": 14,
                "color": colours,
                "line": {"width": 2, "color": colours},
            },
            "hovertemplate": "%{x:.2f} m² s⁻²<extra>this scan</extra>",
        }
    )
    layout = layout_of(
        palette,
        margin={"l": 82, "r": 12, "t": 8, "b": 46},
        xaxis={
            "type": "log",
            "title": {"text": "width (m² s⁻²)"},
            "gridcolor": palette.faint,
            "tickvals": _TICKS,
            "automargin": True,
            "fixedrange": True,
        },
        yaxis={
            "tickvals": rows,
            "ticktext": names,
            "range": [len(rows) - 0.4, -0.6],
            "gridcolor": palette.faint,
            "zeroline": False,
            "fixedrange": True,
        },
        showlegend=True,
        legend=legend_below(-0.2),
        uirevision="widths",
    )
    return {"data": data, "layout": layout}


def availability_chart(found: Availability, names: Sequence[str], theme: str) -> Chart:
    """Return which beams were there when, as a map.

    Parameters
    ----------
    found : Availability
        From `make_availability`.
    names : sequence of str
        What the columns begin with: starts of records, or their numbers.
    theme : str
        ``"dark"`` or ``"light"``.
    """
    palette = Palette.of(theme)
    what = "samples, of those expected" if found.of_samples else "usable beams"
    row = list(range(len(found.beam)))
    column = list(range(found.share.shape[1]))
    some = np.unique(np.linspace(0, len(column) - 1, min(4, len(column))).astype(int)).tolist()
    every = max(1, -(-len(row) // 12))
    data = [
        {
            "type": "heatmap",
            "z": np.round(100.0 * found.share, 1).tolist(),
            "x": column,
            "y": row,
            "zmin": 0,
            "zmax": 100,
            "colorscale": [[0, palette.prior], [0.5, clear(palette.data, 0.35)], [1, palette.data]],
            "colorbar": {"title": {"text": "%", "side": "top"}, "thickness": 10, "outlinewidth": 0},
            "text": [[f"beam {name}, {names[j]}" for j in column] for name in found.beam],
            "hovertemplate": "%{text}: %{z} %<extra></extra>",
        }
    ]
    layout = layout_of(
        palette,
        margin={"l": 46, "r": 6, "t": 8, "b": 40},
        xaxis={
            "tickvals": some,
            "ticktext": [names[j] for j in some],
            "automargin": True,
            "fixedrange": True,
            "showgrid": False,
        },
        yaxis={
            "title": {"text": "beam"},
            "tickvals": row[::every],
            "ticktext": found.beam[::every],
            "autorange": "reversed",
            "fixedrange": True,
            "showgrid": False,
        },
        title={"text": what, "font": {"size": 12}, "x": 0.02, "y": 0.99},
    )
    layout["margin"]["t"] = 28
    return {"data": data, "layout": layout}


def intervals_chart(
    middle: FloatArray,
    low: FloatArray,
    high: FloatArray,
    prior: FloatArray,
    of_prior: Sequence[bool],
    which: str,
    theme: str,
) -> Chart:
    """Return the intervals of the six stresses of a record, hollow and grey where the prior decided more.

    Parameters
    ----------
    middle, low, high : ndarray, shape (6,)
        Medians and ends of the intervals, m² s⁻².
    prior : ndarray, shape (2, 6)
        Ends of the prior's intervals at the record's size, m² s⁻².
    of_prior : sequence of bool
        Which stresses the prior decided more than the data.
    which : str
        What the legend calls the intervals.
    theme : str
        ``"dark"`` or ``"light"``.
    """
    palette = Palette.of(theme)
    rows = list(range(len(STRESSES)))
    hatch = {"shape": "/", "size": 6, "solidity": 0.2, "fgcolor": palette.grey, "bgcolor": "rgba(0,0,0,0)"}
    data: list[Chart] = [
        {
            "type": "bar",
            "orientation": "h",
            "name": "the prior, at this uu + vv + ww",
            "base": prior[0].tolist(),
            "x": (prior[1] - prior[0]).tolist(),
            "y": rows,
            "width": 0.62,
            "marker": {"color": clear(palette.prior, 0.18), "line": {"width": 0}},
            "hoverinfo": "skip",
        }
    ]
    for wanted, colour, name in (
        (False, palette.data, f"median and {which}"),
        (True, palette.grey, PRIORS),
    ):
        some = [row for row, own in zip(rows, of_prior, strict=True) if own == wanted]
        if not some:
            continue
        data += [
            {
                "type": "bar",
                "orientation": "h",
                "name": name,
                "base": low[some].tolist(),
                "x": (high - low)[some].tolist(),
                "y": some,
                "width": 0.32,
                "marker": {
                    "color": colour if not wanted else "rgba(0,0,0,0)",
                    "line": {"width": 1, "color": colour},
                    **({"pattern": hatch} if wanted else {}),
                },
                "hoverinfo": "skip",
            },
            {
                "type": "scatter",
                "mode": "markers",
                "showlegend": False,
                "x": middle[some].tolist(),
                "y": some,
                "marker": {
                    "symbol": "line-ns",
                    "size": 18,
                    "line": {"width": 3, "color": palette.text},
                    "color": palette.text,
                },
                "customdata": np.column_stack([low[some], high[some]]).tolist(),
                "hovertemplate": "%{x:.3g} (%{customdata[0]:.3g} to %{customdata[1]:.3g}) m² s⁻²<extra></extra>",
            },
        ]
    names = [f"{name}{' (prior’s)' if own else ''}" for name, own in zip(STRESSES, of_prior, strict=True)]
    layout = layout_of(
        palette,
        barmode="overlay",
        margin={"l": 82, "r": 12, "t": 8, "b": 46},
        xaxis={
            "title": {"text": "m² s⁻²"},
            "gridcolor": palette.faint,
            "zerolinecolor": palette.grey,
            "fixedrange": True,
        },
        yaxis={"tickvals": rows, "ticktext": names, "range": [5.6, -0.6], "fixedrange": True, "showgrid": False},
        showlegend=True,
        legend=legend_below(-0.2),
    )
    return {"data": data, "layout": layout}
