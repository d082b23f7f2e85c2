"""The picture of a comparison of scans, from which a decision can be read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bayes_rs._validation import check_choice
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES

POSTERIOR_COLOUR = "#1f4e79"
CLASSIC_COLOUR = "#c26a16"
_NORMAL_90 = 3.2897
"""Width of the central 90 % interval of a normal distribution, in standard deviations."""


def plot_comparison(
    table: pd.DataFrame, *, stresses: Sequence[str] = ("uu", "vv", "ww", "uw"), classic: str = "lsq"
) -> Figure:
    """Draw the interval widths of scans beside each other, one panel for each stress.

    Parameters
    ----------
    table : DataFrame
        From `compare`; of several turbulences and priors each gets a mark of its own.
    stresses : sequence of str
        Which stresses.
    classic : str
        The classic estimator that is drawn beside: 3.29 times its root mean square error, which is the width of the
        90 % interval of a normal distribution.

    Returns
    -------
    figure : matplotlib.figure.Figure
        Bars: expected width of the 90 % credible interval over the true uu, from narrow (good) to wide. Vertical line:
        the prior's own width, where it is on the axis. Hollow mark: the classic estimator.

    Raises
    ------
    InputError
        If a stress is not known, or the table is no comparison.
    """
    for name in stresses:
        check_choice(name, STRESSES, what="stress")
    if not {"scan", "estimator", "width_ratio", "rmse", "stress"} <= set(table.columns) or table.empty:
        raise InputError("Not a table of scans: make one with bayes_rs.compare.")
    posterior = table[table["estimator"] == "posterior"]
    scans = list(dict.fromkeys(posterior["scan"]))
    cases = list(dict.fromkeys(zip(posterior["turbulence"], posterior["prior"], posterior["data"], strict=True)))
    height = 0.8 / len(cases)
    figure = Figure(figsize=(3.1 * len(stresses) + 2.0, 1.6 + 0.42 * len(scans) * max(len(cases), 1)))
    panels = figure.subplots(1, len(stresses), sharey=True, squeeze=False)[0]
    shades = np.linspace(1.0, 0.45, len(cases))
    for panel, stress in zip(panels, stresses, strict=True):
        rows = posterior[posterior["stress"] == stress]
        largest = float(rows["width_ratio"].max())
        for number, (flow, prior, data) in enumerate(cases):
            some = rows[(rows["turbulence"] == flow) & (rows["prior"] == prior) & (rows["data"] == data)]
            some = some.set_index("scan")
            place = np.array([scans.index(name) for name in some.index]) + (number - 0.5 * (len(cases) - 1)) * height
            panel.barh(
                place,
                some["width_ratio"],
                height=0.9 * height,
                color=POSTERIOR_COLOUR,
                alpha=float(shades[number]),
                label=", ".join(part for part in (flow, prior, data) if part),
            )
            old = table[
                (table["estimator"] == classic)
                & (table["stress"] == stress)
                & (table["turbulence"] == flow)
                & (table["data"] == data)
            ].set_index("scan")
            truth = posterior[(posterior["turbulence"] == flow) & (posterior["stress"] == "uu")]["truth"].iloc[0]
            for at, name in zip(place, some.index, strict=True):
                if name in old.index:
                    width = float(old.loc[name, "rmse"]) * _NORMAL_90 / truth
                    inside = width <= 1.25 * largest  # a mark at the edge points to where it would be
                    panel.plot(
                        min(width, 1.25 * largest),
                        at,
                        "D" if inside else ">",
                        markerfacecolor="none",
                        color=CLASSIC_COLOUR,
                        markersize=6,
                        linestyle="none",
                        label=f"{classic}, 3.29 RMSE" + ("" if inside else ": off the axis"),
                    )
        own = float(rows["prior_width_90"].iloc[0]) / float(posterior[posterior["stress"] == "uu"]["truth"].iloc[0])
        if own <= 1.3 * largest:
            panel.axvline(own, color="0.4", linestyle=":", linewidth=1.2)
        panel.set_xlim(0.0, 1.3 * largest)
        panel.set_title(stress)
        panel.set_xlabel("90 % width / uu")
        panel.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(scans)), scans, parse_math=False)  # a name may hold a dollar sign
    panels[0].invert_yaxis()
    handles, labels = [], []
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            if label not in labels:
                handles.append(handle)
                labels.append(label)
    columns = min(len(labels), 4)
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=9, frameon=False)
    for text in legend.get_texts():
        text.set_parse_math(False)
    figure.set_layout_engine("constrained")
    return figure
