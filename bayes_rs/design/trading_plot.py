"""The picture of the trade-off between opening angle, focus distance, number of beams and record length."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from bayes_rs.design.trading import COLUMNS, DESIGN
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES

_COLOURS = dict(zip(STRESSES, ("#1f4e79", "#c26a16", "#2e7d4f", "#7a4ea3", "#b03050", "#6b6b6b"), strict=True))
_N_LEVEL = 8
_EDGE = 0.05  # of a panel
_PAIR = "; full: with centre, broken: without"


def plot_trade_off(
    grid: pd.DataFrame,
    *,
    beams: pd.DataFrame | None = None,
    durations: pd.DataFrame | None = None,
) -> Figure:
    """Draw expected 90 % widths over uu: contours over opening angle and focus distance, and lines.

    Parameters
    ----------
    grid : DataFrame
        From `trade_off`, for several opening angles and focus distances and one number of beams and duration. If it
        holds cones with and without a centre beam, the contours are of those with one.
    beams : DataFrame, optional
        From `trade_off`, for several numbers of beams at one opening angle, focus distance and duration.
    durations : DataFrame, optional
        From `trade_off`, for several durations at one number of beams, opening angle and focus distance.

    Returns
    -------
    figure : matplotlib.figure.Figure
        A panel of contours for each stress, with the prior's own width in its title, each with its own levels and
        dark where intervals are narrow; below, the width against the number of beams (full lines with a centre beam,
        broken ones without) and against the record length. For a `grid` with both kinds of cones, also the bias of the
        posterior mean with and without the centre beam, by opening angle: the width alone misleads there, since where
        the prior decides an interval can be narrow about the wrong place. A cross marks where the lines were
        calculated.

    Raises
    ------
    InputError
        If a table is not of `trade_off`, or does not vary in what its panel shows, or varies in more.
    """
    _check_table(grid, "grid", ("opening_angle_deg", "focus_distance"), free=("centre",))
    if beams is not None:
        _check_table(beams, "beams", ("n_beams",), free=("centre",))
    if durations is not None:
        _check_table(durations, "durations", ("duration",), free=())
    base = beams if beams is not None else durations
    both = grid["centre"].nunique() == 2
    count = (beams is not None) + (durations is not None) + both
    stresses = [name for name in STRESSES if name in set(grid["stress"])]
    n_column = min(3, len(stresses))
    n_row = int(np.ceil(len(stresses) / n_column))
    width = max(4.1 * n_column, 4.1 * count)
    figure = Figure(figsize=(width, 2.9 * n_row + (3.4 if count else 0.3)), layout="constrained")
    parts = figure.add_gridspec(2 if count else 1, 1, height_ratios=[2.9 * n_row, 3.2][: 2 if count else 1])
    _contour_panels(
        figure.add_subfigure(parts[0]), grid[grid["centre"]] if both else grid, base, stresses, (n_row, n_column)
    )
    if count:
        panels = iter(figure.add_subfigure(parts[1]).subplots(1, count, squeeze=False)[0])
        if beams is not None:
            _beam_lines(next(panels), beams)
        if durations is not None:
            _duration_lines(next(panels), durations)
        if both:
            _centre_lines(next(panels), grid, base)
    return figure


def _contour_panels(
    part: SubFigure, shown: pd.DataFrame, base: pd.DataFrame | None, stresses: list[str], shape: tuple[int, int]
) -> None:
    panels = part.subplots(*shape, sharex=True, sharey=True, squeeze=False)
    for panel, name in zip(panels.ravel(), stresses, strict=False):
        _contours(panel, shown[shown["stress"] == name], name)
        if base is not None:
            panel.autoscale(enable=False)  # the limits are those of the grid
            panel.plot(base["opening_angle_deg"].iloc[0], base["focus_distance"].iloc[0], "x", color="k", markersize=7)
    for panel in panels.ravel()[len(stresses) :]:
        panel.set_visible(False)
    for panel in panels[-1]:
        panel.set_xlabel("opening angle, degrees")
    for panel in panels[:, 0]:
        panel.set_ylabel("focus distance, m")
    first = shown.iloc[0]
    kind = "with" if first["centre"] else "without"
    part.suptitle(
        f"90 % width over uu: {first['n_beams']} beams {kind} a centre beam, records of {first['duration']:g} s",
        fontsize=11,
    )


def _contours(panel: Axes, rows: pd.DataFrame, name: str) -> None:
    table = rows.pivot_table(index="focus_distance", columns="opening_angle_deg", values="ratio_90")
    angle, far, width = table.columns.to_numpy(), table.index.to_numpy(), table.to_numpy()
    levels = MaxNLocator(_N_LEVEL).tick_values(float(width.min()), float(width.max()))
    panel.contourf(angle, far, width, levels=levels, cmap="Blues_r", alpha=0.75)
    lines = panel.contour(angle, far, width, levels=levels, colors="0.15", linewidths=0.8)
    panel.set_yscale("log")
    for text in panel.clabel(lines, fontsize=8, fmt="%g"):
        x, y = panel.transAxes.inverted().transform(panel.transData.transform(text.get_position()))
        if not (_EDGE < x < 1.0 - _EDGE and _EDGE < y < 1.0 - _EDGE):
            text.remove()  # it would be cut
    panel.yaxis.set_major_locator(FixedLocator(far.tolist()))
    panel.yaxis.set_minor_locator(NullLocator())
    panel.set_yticks(far, [f"{value:g}" for value in far])
    panel.set_title(f"{name}   (prior alone {rows['prior_ratio_90'].iloc[0]:.2g})", fontsize=10)


def _beam_lines(panel: Axes, rows: pd.DataFrame) -> None:
    _pair_lines(panel, rows, "n_beams", "ratio_90")
    panel.set_xscale("log")
    numbers = sorted(set(rows["n_beams"]))
    ticks = [number for number in (3, 4, 5, 6, 8, 12, 20, 30, 50, 100, 200) if numbers[0] <= number <= numbers[-1]]
    panel.set_xticks(ticks, [str(number) for number in ticks])
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_xlabel("number of beams")
    panel.set_ylabel("90 % width / uu")
    panel.set_title(f"{_where(rows)}{_PAIR if rows['centre'].nunique() == 2 else ''}", fontsize=9)
    _finish(panel)


def _duration_lines(panel: Axes, rows: pd.DataFrame) -> None:
    for name in dict.fromkeys(rows["stress"]):
        some = rows[rows["stress"] == name]
        panel.plot(
            some["duration"] / 60.0,
            some["ratio_90"],
            "-o",
            color=_COLOURS[name],
            markersize=3.0,
            linewidth=1.2,
            label=name,
        )
    panel.set_xscale("log")
    minutes = np.array(sorted(set(rows["duration"]))) / 60.0
    panel.set_xticks(minutes, [f"{value:g}" for value in minutes])
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_xlabel("record length, min")
    panel.set_ylabel("90 % width / uu")
    panel.set_title(f"{rows['n_beams'].iloc[0]} beams, {_where(rows)}", fontsize=9)
    _finish(panel)


def _centre_lines(panel: Axes, grid: pd.DataFrame, base: pd.DataFrame | None) -> None:
    distances = np.array(sorted(set(grid["focus_distance"])))
    wanted = distances[len(distances) // 2] if base is None else float(base["focus_distance"].iloc[0])
    far = distances[int(np.argmin(np.abs(distances - wanted)))]
    some = grid[grid["focus_distance"] == far]
    names = [name for name in STRESSES[:3] if name in set(some["stress"])] or list(dict.fromkeys(some["stress"]))
    _pair_lines(panel, some[some["stress"].isin(names)], "opening_angle_deg", "bias_ratio")
    panel.axhline(0.0, color="0.5", linewidth=0.8)
    panel.set_xlabel("opening angle, degrees")
    panel.set_ylabel("bias of the posterior mean / uu")
    panel.set_title(f"{some['n_beams'].iloc[0]} beams, {far:g} m, {some['duration'].iloc[0]:g} s{_PAIR}", fontsize=9)
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8, frameon=False)


def _pair_lines(panel: Axes, rows: pd.DataFrame, across: str, column: str) -> None:
    """Draw full lines with a centre beam, broken ones without."""
    kinds = sorted(set(rows["centre"]), reverse=True)
    for kind, name in dict.fromkeys(zip(rows["centre"], rows["stress"], strict=True)):
        some = rows[(rows["centre"] == kind) & (rows["stress"] == name)]
        panel.plot(
            some[across],
            some[column],
            "-o" if kind else "--o",
            color=_COLOURS[name],
            markersize=3.0,
            markerfacecolor=_COLOURS[name] if kind else "white",
            linewidth=1.2,
            label=name if kind == kinds[0] else None,
        )


def _finish(panel: Axes) -> None:
    panel.grid(alpha=0.3)
    panel.set_ylim(bottom=0.0)
    panel.legend(fontsize=8, frameon=False, ncols=3, loc="lower left")


def _where(rows: pd.DataFrame) -> str:
    text = f"{rows['opening_angle_deg'].iloc[0]:g}°, {rows['focus_distance'].iloc[0]:g} m"
    return text if rows["duration"].nunique() > 1 else f"{text}, {rows['duration'].iloc[0]:g} s"


def _check_table(table: pd.DataFrame, what: str, varied: tuple[str, ...], *, free: tuple[str, ...]) -> None:
    if not set(COLUMNS) <= set(table.columns) or table.empty:
        raise InputError(f"The table {what!r} is none of a trade-off: make one with bayes_rs.trade_off.")
    for column in DESIGN:
        count = table[column].nunique()
        if column in varied and count < 2:
            raise InputError(f"The table {what!r} has one {column} only: give trade_off at least two.")
        if column not in (*varied, *free) and count > 1:
            raise InputError(f"The table {what!r} has {count} values of {column}: choose one of them.")
