"""The uncertainty budget of a fit: stacked shares of each stress's variance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from bayes_rs.errors import InputError
from bayes_rs.fits.budget_sources import (
    COHERENCE,
    COMBINED,
    INSTRUMENT,
    LENGTH,
    MAST_RATIO,
    PRIOR,
    PROBE,
    REST,
    SAMPLING,
    SCATTER,
    TAILS,
)
from bayes_rs.fits.campaign_words import share_words
from bayes_rs.pictures import POSTERIOR_COLOUR, PRIOR_COLOUR, Picture, axes_of, hatched
from bayes_rs.posteriors.decided import is_priors

_COLOURS = {
    SAMPLING: POSTERIOR_COLOUR,
    SCATTER: "#56B4E9",
    LENGTH: "#E69F00",
    INSTRUMENT: "#009E73",
    PROBE: "#CC79A7",
    "yaw": "#D55E00",
    "tilt": "#F0E442",
    "lateral gradient": "#7F4F24",
    "vertical gradient": "#000000",
    TAILS: "#882255",
    COHERENCE: "#999933",
    MAST_RATIO: "#DDAA99",
}
"""Of Okabe and Ito (2008), and four more."""
_WIDTH = 0.66


def budget(table: pd.DataFrame, *, ax: Axes | None = None) -> Axes | Picture:
    """Draw an uncertainty budget: what shares of each stress's variance come from where.

    Parameters
    ----------
    table : DataFrame
        From `bayes_rs.budget`, of all records together or of one.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    figure : Axes or Picture
        What was given, or a new figure. A bar for each stress: the parts of the data and of what else is uncertain in
        colours, the prior's hatched grey, the rest an outline. What is below zero, since it narrows the posterior,
        hangs below the line. Below each name are the combined standard uncertainty and the share that the data decided
        (`Fit.summary`), grey where it is less than half.

    Raises
    ------
    InputError
        If it is no budget, or one of several records each.
    """
    if not {"stress", "source", "type", "share", "u", "decided"} <= set(getattr(table, "columns", ())):
        raise InputError("Invalid table: give that of bayes_rs.budget.")
    if table.duplicated(["stress", "source"]).any():
        raise InputError("Invalid table: it has a budget for each of several records; choose one by its record.")
    names = list(dict.fromkeys(table["stress"]))
    axis, target = axes_of(ax, (1.2 + 1.15 * (len(names) + 1.9), 4.6))
    place = np.arange(len(names), dtype=np.float64)
    above, below = np.zeros(len(names)), np.zeros(len(names))
    handles = []
    for source in dict.fromkeys(table["source"]):
        if source == COMBINED:
            continue
        rows = table[table["source"] == source].set_index("stress").loc[names]
        share = 100.0 * rows["share"].to_numpy(dtype=np.float64)
        bottom = np.where(share >= 0.0, above, below)
        style = _style(source)
        axis.bar(place, share, bottom=bottom, width=_WIDTH, **style)
        above += np.maximum(share, 0.0)
        below += np.minimum(share, 0.0)
        kind = rows["type"].iloc[0]
        handles.append(Patch(**style, label=f"{source}, type {kind}" if kind else source))
    axis.axhline(0.0, color="0.4", linewidth=0.8)
    last = table[table["source"] == COMBINED].set_index("stress").loc[names]
    axis.set_xticks(place, [_label(name, last.loc[name]) for name in names], fontsize=9)
    for text, decided in zip(axis.get_xticklabels(), last["decided"], strict=True):
        text.set_color(PRIOR_COLOUR if np.isfinite(decided) and is_priors(decided) else "black")
    axis.set_ylabel("share of the variance [%]")
    axis.set_xlim(-0.6, len(names) - 0.4)
    axis.margins(y=0.03)
    axis.grid(alpha=0.3, axis="y")
    axis.set_axisbelow(True)
    axis.legend(handles=handles[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9, frameon=False)
    n_record = table.attrs.get("n_record", 1)
    of = "one record" if n_record == 1 or "record" in table else f"mean of {n_record} records"
    axis.set_title(f"Where the uncertainty comes from ({of})", fontsize=10)
    return target


def _style(source: str) -> dict[str, Any]:
    if source == PRIOR:
        return hatched(linewidth=0.8)
    if source == REST:
        return {"facecolor": "white", "edgecolor": PRIOR_COLOUR, "linestyle": "--", "linewidth": 0.8}
    return {"color": _COLOURS[source], "linewidth": 0.0}


def _label(name: str, row: pd.Series[Any]) -> str:
    """Return a stress's name, its combined standard uncertainty, and what the data decided."""
    unit = " m² s⁻²" if len(name) == 2 and name != "ti" else ""
    lines = [name, f"u = {row['u']:#.2g}{unit}"]
    if np.isfinite(row["decided"]):
        lines.append(f"decided {share_words(float(row['decided']))}")
        lines += ["mostly", "the prior’s"] if is_priors(row["decided"]) else []
    return "\n".join(lines)
