"""The picture of a comparison of scans, from which a decision can be read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_rs._validation import check_choice
from bayes_rs.design.comparing import COLUMNS
from bayes_rs.design.grid_plot import grid_axes, grid_figure
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES

POSTERIOR_COLOUR = "#1f4e79"
CLASSIC_COLOUR = "#c26a16"
_NORMAL_90 = 3.2897
"""Width of the central 90 % interval of a normal distribution, in standard deviations."""
_OF_BARS = ("uu", "vv", "ww", "uw")
_CASE = ["turbulence", "prior", "data", "duration"]


def comparison(table: pd.DataFrame, *, stresses: Sequence[str] | None = None, classic: str = "lsq") -> Figure:
    """Draw the interval widths of scans, one panel for each stress.

    Parameters
    ----------
    table : DataFrame
        From `compare`.
    stresses : sequence of str, optional
        Which stresses; if not given uu, vv, ww and uw for bars, and all six for a grid.
    classic : str
        The classic estimator that is drawn beside bars: 3.29 times its root mean square error, which is the width of
        the 90 % interval of a normal distribution.

    Returns
    -------
    figure : matplotlib.figure.Figure
        Expected width of the 90 % credible interval over the true uu. Where scans of one name make a grid in which two
        things vary (say, opening angle and focus distance): contours, dark where intervals are narrow, each panel with
        its own levels, and the prior's own width in its title; of scans with and without a beam along the axis those
        with one. Where one thing varies (the record length, too): lines, broken for scans without a beam along the
        axis if there are both. Else bars, with a hollow mark for the classic estimator. The prior's own width is
        dotted, where it is on the axis. Of several turbulences and priors each has a mark of its own.

    Raises
    ------
    InputError
        If a stress is not known, or the table is no comparison.
    """
    for name in stresses or ():
        check_choice(name, STRESSES, what="stress")
    if not set(COLUMNS) <= set(table.columns) or table.empty:
        raise InputError("Not a table of scans: make one with bayes_rs.compare.")
    posterior = table[table["estimator"] == "posterior"].reset_index(drop=True)
    axes = grid_axes(posterior)
    if axes:
        return grid_figure(posterior, axes, stresses or STRESSES)
    return _bar_figure(posterior, table[table["estimator"] == classic], stresses or _OF_BARS, classic)


def _bar_figure(posterior: pd.DataFrame, old: pd.DataFrame, stresses: Sequence[str], classic: str) -> Figure:
    scans = list(dict.fromkeys(posterior["scan"]))
    n_case = len(posterior[_CASE].drop_duplicates())
    figure = Figure(figsize=(3.1 * len(stresses) + 2.0, 1.6 + 0.42 * len(scans) * n_case), layout="constrained")
    panels = figure.subplots(1, len(stresses), sharey=True, squeeze=False)[0]
    for panel, stress in zip(panels, stresses, strict=True):
        rows = posterior[posterior["stress"] == stress]
        largest = float(rows["width_ratio"].max())
        _bars(panel, rows, scans)
        _marks(panel, rows, old[old["stress"] == stress], scans, 1.25 * largest, classic)
        own = float((rows["prior_width_90"] * rows["width_ratio"] / rows["width_90"]).iloc[0])
        if own <= 1.3 * largest:
            panel.axvline(own, color="0.4", linestyle=":", linewidth=1.2)
        panel.set_xlim(0.0, 1.3 * largest)
        panel.set_title(stress)
        panel.set_xlabel("90 % width / uu")
        panel.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(scans)), scans, parse_math=False)  # a name may hold a dollar sign
    panels[0].invert_yaxis()
    _legend(figure, panels)
    return figure


def _places(rows: pd.DataFrame, scans: list[str]) -> pd.Series[float]:
    """Return where each row stands: beside its scan, the cases in their order."""
    cases = list(dict.fromkeys(rows[_CASE].itertuples(index=False, name=None)))
    number = np.array([cases.index(case) for case in rows[_CASE].itertuples(index=False, name=None)])
    place = rows["scan"].map(scans.index) + (number - 0.5 * (len(cases) - 1)) * 0.8 / len(cases)
    return pd.Series(place, index=rows.index, dtype=float)


def _bars(panel: Axes, rows: pd.DataFrame, scans: list[str]) -> None:
    place, groups = _places(rows, scans), rows.groupby(_CASE, sort=False)
    several = rows["duration"].nunique() > 1
    shades = np.linspace(1.0, 0.45, len(groups))
    for shade, ((flow, prior, data, duration), some) in zip(shades, groups, strict=True):
        panel.barh(
            place[some.index],
            some["width_ratio"],
            height=0.72 / len(groups),
            color=POSTERIOR_COLOUR,
            alpha=float(shade),
            label=f"{flow}, {prior}, {data}" + (f", {duration:g} s" if several else ""),
        )


def _marks(panel: Axes, rows: pd.DataFrame, old: pd.DataFrame, scans: list[str], most: float, classic: str) -> None:
    """Mark the classic estimator; a mark at the edge points to where it would be."""
    keys = ["scan", "turbulence", "data", "duration"]
    rmse = old.set_index(keys)["rmse"]
    for at, (_, row) in zip(_places(rows, scans), rows.iterrows(), strict=True):
        if (key := tuple(row[keys])) not in rmse.index:
            continue
        width = float(rmse.loc[key]) * _NORMAL_90 * row["width_ratio"] / row["width_90"]
        inside = width <= most
        panel.plot(
            min(width, most),
            at,
            "D" if inside else ">",
            markerfacecolor="none",
            color=CLASSIC_COLOUR,
            markersize=6,
            linestyle="none",
            label=f"{classic}, 3.29 RMSE" + ("" if inside else ": off the axis"),
        )


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    entries: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    legend = figure.legend(
        handles=list(entries.values()),
        labels=list(entries),
        loc="outside lower center",
        ncols=min(len(entries), 4),
        fontsize=9,
        frameon=False,
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
