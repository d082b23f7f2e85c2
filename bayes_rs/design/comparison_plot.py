"""The picture of a comparison of scans, from which a decision can be read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayes_rs._validation import as_items, check_choice
from bayes_rs.design.comparing import COLUMNS
from bayes_rs.design.grid_plot import WIDTH, grid_axes, grid_figure
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.pictures import (
    OTHER_COLOUR,
    POSTERIOR_COLOUR,
    PRIOR_COLOUR,
    Picture,
    hatched,
    new_or_given,
    prior_patch,
)
from bayes_rs.posteriors.decided import PRIORS, is_priors

_NORMAL_90 = 3.2897
"""Width of the central 90 % interval of a normal distribution, in standard deviations."""
_CASE = ["turbulence", "prior", "data", "duration"]


_Given = TypeVar("_Given", bound=FigureBase)


def comparison(
    table: pd.DataFrame,
    *,
    stresses: Sequence[str] = STRESSES,
    classic: str = "lsq",
    figure: _Given | None = None,
) -> _Given | Picture:
    """Draw the interval widths of scans, one panel for each stress.

    Parameters
    ----------
    table : DataFrame
        From `compare`.
    stresses : sequence of str
        Which stresses, in this order.
    classic : str
        The classic estimator that is drawn beside bars: 3.29 times its root mean square error, which is the width of
        the 90 % interval of a normal distribution.
    figure : Figure or SubFigure, optional
        Where to draw.

    Returns
    -------
    figure : Figure or SubFigure
        What was given, or a new figure. Expected width of the 90 % credible interval over the true uu. Where scans of
        one name make a grid in which two things vary (say, opening angle and focus distance): contours, dark where
        intervals are narrow, each panel with its own levels, and the prior's width at the record's size in its title;
        of scans with and without a beam along the axis those with one. Where one thing varies (the record length, too):
        lines, broken for scans without a beam along the axis if there are both. Else bars, with a hollow mark for the
        classic estimator. The prior's width at the record's size is a dotted line. What the data decide less than half
        of (`is_priors`) is hatched grey, its marks are hollow. Of several turbulences and priors each has a mark of its
        own.

    Raises
    ------
    InputError
        If a stress is not known, or the table is no comparison.
    """
    for name in as_items(stresses, what="stresses"):
        check_choice(name, STRESSES, what="stress")
    if not set(COLUMNS) <= set(getattr(table, "columns", ())) or table.empty:
        raise InputError("Not a table of scans: make one with bayes_rs.compare.")
    posterior = table[table["estimator"] == "posterior"].reset_index(drop=True)
    axes = grid_axes(posterior)
    if axes:
        return grid_figure(posterior, axes, stresses, figure)  # type: ignore[return-value] # what was given, or new
    old = table[table["estimator"] == classic]
    return _bar_figure(posterior, old, stresses, classic, figure)  # type: ignore[return-value] # as above


def _bar_figure(
    posterior: pd.DataFrame, old: pd.DataFrame, stresses: Sequence[str], classic: str, figure: FigureBase | None
) -> FigureBase:
    scans = list(dict.fromkeys(posterior["scan"]))
    n_case = len(posterior[_CASE].drop_duplicates())
    n_column = min(3, len(stresses))
    n_row = int(np.ceil(len(stresses) / n_column))
    height = 0.9 + 0.42 * len(scans) * n_case
    target = new_or_given(figure, (3.6 * n_column + 1.4, n_row * height + 1.4))
    grid = target.subplots(n_row, n_column, sharey=True, squeeze=False)
    panels: list[Axes] = grid.ravel()[: len(stresses)].tolist()
    for panel, stress in zip(panels, stresses, strict=True):
        rows = posterior[posterior["stress"] == stress]
        own = (rows["prior_width_90_at_size"] * rows["width_ratio"] / rows["width_90"]).to_numpy(dtype=np.float64)
        largest = max(float(rows["width_ratio"].max()), float(own.max()))
        _bars(panel, rows, scans)
        _marks(panel, rows, old[old["stress"] == stress], scans, 1.1 * largest, classic)
        for at, width in zip(_places(rows, scans), own, strict=True):
            panel.vlines(width, at - 0.46 / n_case, at + 0.46 / n_case, color=PRIOR_COLOUR, linestyle=":", linewidth=2)
        panel.set_xlim(0.0, 1.18 * largest)
        panel.set_title(stress, fontsize=10)
        panel.grid(axis="x", alpha=0.3)
    for panel in grid.ravel()[len(stresses) :]:
        panel.set_visible(False)
    for column in range(n_column):
        lowest = grid[(len(stresses) - 1 - column) // n_column, column]
        lowest.set_xlabel(f"{WIDTH} [1]")
    for panel in panels:  # each: panels that share an axis have labels of their own
        panel.set_yticks(range(len(scans)), scans, parse_math=False)  # a name may hold a dollar sign
    panels[0].invert_yaxis()
    _legend(target, panels, posterior, str(posterior["interval"].iloc[0]))
    return target


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
        label = f"{flow}, {prior}, {data}" + (f", {duration:g} s" if several else "")
        of_prior = is_priors(some["decided"])
        for mask, style in (
            (~of_prior, {"color": POSTERIOR_COLOUR, "alpha": float(shade), "label": label}),
            (of_prior, hatched(linewidth=0.8)),
        ):
            if mask.any():
                chosen = some[mask]
                panel.barh(place[chosen.index], chosen["width_ratio"], height=0.72 / len(groups), **style)


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
            color=OTHER_COLOUR,
            markersize=6,
            linestyle="none",
            label=f"{classic}, 3.29 RMSE" + ("" if inside else ": off the axis"),
        )


def _legend(figure: FigureBase, panels: Sequence[Axes], posterior: pd.DataFrame, interval: str) -> None:
    entries: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if not entries:  # the prior decided all
        first = posterior.iloc[0]
        entries[f"{first['turbulence']}, {first['prior']}, {first['data']}"] = Patch(color=POSTERIOR_COLOUR)
    more: list[Artist] = [prior_patch(PRIORS)] if is_priors(posterior["decided"]).any() else []
    more.append(Line2D([], [], color=PRIOR_COLOUR, linestyle=":", linewidth=2, label="prior at the size uu + vv + ww"))
    entries |= {str(handle.get_label()): handle for handle in more}
    legend = figure.legend(
        handles=list(entries.values()),
        labels=list(entries),
        title=f"expected widths of 90 % intervals, {interval}",
        title_fontsize=9,
        loc="outside lower center",
        ncols=min(len(entries), 3),
        fontsize=9,
        frameon=False,
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
