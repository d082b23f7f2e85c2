"""Pictures of a comparison over a grid of scans: contours where two things vary, lines where one does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from bayes_rs._validation import FloatArray
from bayes_rs.design.scan_grid import DESIGN
from bayes_rs.pictures import COLOURS, HATCH, PRIOR_COLOUR, PRIOR_MARK, new_or_given, prior_patch
from bayes_rs.posteriors.decided import PRIOR_BELOW, PRIORS, is_priors

WIDTH = "90 % width / uu"
_LABELS = {
    "n_beam": "number of beams [1]",
    "opening_angle_deg": "opening angle [°]",
    "focus_distance": "focus distance [m]",
    "tilt_deg": "tilt [°]",
    "yaw_deg": "yaw [°]",
    "duration": "record length [s]",
}
_LOGARITHMIC = ("n_beam", "focus_distance", "duration")
_N_LEVEL = 8
_EDGE = 0.05  # of a panel
_MOST_TICKS = 8
_CASE = ["turbulence", "prior", "data"]


def grid_axes(posterior: pd.DataFrame) -> list[str]:
    """Return the one or two columns of `DESIGN` that vary over a whole grid of like scans; none if it is no grid.

    Scans are alike if their names are the same before the ``@``. With and without a beam along the axis may both be
    there: that is no axis. Two axes are a picture for one turbulence, prior and kind of records only.
    """
    varied = [name for name in DESIGN if posterior[name].nunique() > 1]
    axes = [name for name in varied if name != "centre"]
    cells = posterior[["scan", "duration"]].drop_duplicates()
    alike = cells["scan"].str.rpartition("@")[0].where(cells["scan"].str.contains("@"), cells["scan"]).nunique() == 1
    whole = len(posterior[varied].drop_duplicates()) == len(cells) == np.prod([posterior[v].nunique() for v in varied])
    few = len(axes) == 1 or (len(axes) == 2 and len(posterior[_CASE].drop_duplicates()) == 1)
    return axes if alike and whole and few else []


def grid_figure(
    posterior: pd.DataFrame, axes: Sequence[str], stresses: Sequence[str], given: FigureBase | None = None
) -> FigureBase:
    """Draw the 90 % widths over uu against what varies, a panel for each stress."""
    n_column = min(3, len(stresses))
    n_row = int(np.ceil(len(stresses) / n_column))
    figure = new_or_given(given, (4.1 * n_column, 2.9 * n_row + 1.1))
    panels = figure.subplots(n_row, n_column, sharex=True, sharey=len(axes) == 2, squeeze=False)
    across = axes[0]
    shown = posterior[posterior["centre"]] if len(axes) == 2 and posterior["centre"].nunique() == 2 else posterior
    for panel, stress in zip(panels.ravel(), stresses, strict=False):
        rows = shown[shown["stress"] == stress]
        if len(axes) == 2:
            _contours(panel, rows, axes[0], axes[1])
            panel.set_title(f"{stress}   (prior at this size {float(_of_prior(rows).median()):.2g})", fontsize=10)
        else:
            _lines(panel, rows, across)
            panel.set_title(stress, fontsize=10)
    for panel in panels.ravel()[len(stresses) :]:
        panel.set_visible(False)
    for panel in panels[-1]:
        panel.set_xlabel(_LABELS[across])
    for panel in panels[:, 0]:
        panel.set_ylabel(_LABELS[axes[1]] if len(axes) == 2 else f"{WIDTH} [1]")
    _legend(figure, panels[0, 0], shown, of_lines=len(axes) == 1)
    which = str(posterior["interval"].iloc[0])
    title = figure.suptitle(f"expected 90 % width over uu, {which}; {_constant(shown)}", fontsize=11)
    title.set_parse_math(False)
    return figure


def _contours(panel: Axes, rows: pd.DataFrame, across: str, along: str) -> None:
    table = rows.pivot_table(index=along, columns=across, values="width_ratio")
    first, second, width = table.columns.to_numpy(), table.index.to_numpy(), table.to_numpy()
    levels = MaxNLocator(_N_LEVEL).tick_values(float(width.min()), float(width.max()))
    panel.contourf(first, second, width, levels=levels, cmap="Blues_r", alpha=0.75)
    share = rows.pivot_table(index=along, columns=across, values="decided").to_numpy()
    if is_priors(share).any():
        drawn = panel.contourf(first, second, share, levels=[-np.inf, PRIOR_BELOW], colors="none", hatches=[HATCH])
        drawn.set_edgecolor(PRIOR_COLOUR)
        drawn.set_linewidth(0.0)
    lines = panel.contour(first, second, width, levels=levels, colors="0.15", linewidths=0.8)
    _scale(panel, across, first, "x")
    _scale(panel, along, second, "y")
    for text in panel.clabel(lines, fontsize=8, fmt="%g"):
        at = panel.transAxes.inverted().transform(panel.transData.transform(text.get_position()))
        if not np.all((at > _EDGE) & (at < 1.0 - _EDGE)):
            text.remove()  # it would be cut


def _lines(panel: Axes, rows: pd.DataFrame, across: str) -> None:
    """Draw a colour for each case; broken lines are those without a beam along the axis, where both are there."""
    kinds = rows["centre"].nunique()
    for number, (case, some) in enumerate(rows.groupby(_CASE, sort=False)):
        colour = COLOURS[number % len(COLOURS)]
        for centre, part in some.groupby("centre", sort=False):
            ordered = part.sort_values(across)
            broken = kinds == 2 and not centre
            panel.plot(
                ordered[across],
                ordered["width_ratio"],
                "--" if broken else "-",
                color=colour,
                markersize=0.0,
                linewidth=1.2,
                label=", ".join(map(str, case))
                + (f", {'with' if centre else 'without'} a centre beam" if kinds == 2 else ""),
            )
            of_prior = is_priors(ordered["decided"])
            own: dict[str, Any] = {"color": colour}
            for mask, style in ((~of_prior, own), (of_prior, PRIOR_MARK)):
                chosen = ordered[mask]
                panel.plot(chosen[across], chosen["width_ratio"], "o", markersize=4.5, **style)
            panel.plot(ordered[across], _of_prior(ordered), ":", color=PRIOR_COLOUR, linewidth=1.5)
    top = 1.08 * max(float(rows["width_ratio"].max()), float(_of_prior(rows).max()))
    panel.set_ylim(0.0, top)
    _scale(panel, across, np.array(sorted(set(rows[across]))), "x")
    panel.grid(alpha=0.3)


def _legend(figure: FigureBase, panel: Axes, rows: pd.DataFrame, *, of_lines: bool) -> None:
    """Say what lines, marks and hatching are, below the panels."""
    handles, _ = panel.get_legend_handles_labels() if of_lines else ([], [])
    if is_priors(rows["decided"]).any():
        mark = Line2D([], [], color=PRIOR_COLOUR, marker="o", mfc="white", linestyle="", label=PRIORS)
        handles.append(mark if of_lines else prior_patch(PRIORS))
    if of_lines:
        label = "prior at the size uu + vv + ww"
        handles.append(Line2D([], [], color=PRIOR_COLOUR, linestyle=":", linewidth=1.5, label=label))
    if handles:
        legend = figure.legend(
            handles=handles, loc="outside lower center", ncols=min(len(handles), 3), fontsize=9, frameon=False
        )
        for text in legend.get_texts():
            text.set_parse_math(False)


def _scale(panel: Axes, name: str, values: FloatArray, which: str) -> None:
    """Put ticks at values of the grid, on a logarithmic scale where ratios count."""
    if name not in _LOGARITHMIC:
        return
    axis, ticks = (panel.xaxis, panel.set_xticks) if which == "x" else (panel.yaxis, panel.set_yticks)
    (panel.set_xscale if which == "x" else panel.set_yscale)("log")
    shown = values[np.unique(np.linspace(0, len(values) - 1, min(len(values), _MOST_TICKS)).round().astype(int))]
    axis.set_major_locator(FixedLocator(shown.tolist()))
    axis.set_minor_locator(NullLocator())
    ticks(shown, [f"{value:g}" for value in shown])


def _of_prior(rows: pd.DataFrame) -> pd.Series[float]:
    """Return the prior's 90 % width at the record's size over the true uu."""
    return rows["prior_width_90_at_size"] * rows["width_ratio"] / rows["width_90"]


def _constant(posterior: pd.DataFrame) -> str:
    """Say what all scans of the picture have in common."""
    first = posterior.iloc[0]
    constant = {name for name in DESIGN if posterior[name].nunique() == 1}
    words = {
        "n_beam": f"{first['n_beam']} beams",
        "opening_angle_deg": f"{first['opening_angle_deg']:g}°",
        "focus_distance": f"{first['focus_distance']:g} m",
        "duration": f"records of {first['duration']:g} s",
    }
    parts = [text for name, text in words.items() if name in constant]
    if "centre" in constant:
        parts.insert(int("n_beam" in constant), f"{'with' if first['centre'] else 'without'} a centre beam")
    return f"changes of {first['scan'].partition('@')[0]}: {', '.join(parts)}"
