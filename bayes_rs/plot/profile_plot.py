"""Profiles: stresses and turbulence intensity over the ranges, or over the heights, of a fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.plot.style import POSTERIOR_COLOUR
from bayes_rs.posteriors.decided import is_priors


def profile(fit: Fit, record: int | str | None = None) -> Figure:
    """Draw the stresses and the turbulence intensity over the ranges, or over the heights of a scan that looks up.

    Parameters
    ----------
    fit : RangedFit
        From `fit` or `open_fit`, at several ranges.
    record : int or str, optional
        Number of a record, or its start as ISO time (UTC); by default all records together, as `RangedFit.profile`
        has them.

    Returns
    -------
    figure : Figure
        Seven panels: turbulence intensity and the six stresses, each with its interval at each range. What is the
        prior's more than the data's has a hollow mark.

    Raises
    ------
    InputError
        If the fit is of one range, or there is no such record.
    """
    if not isinstance(fit, RangedFit):
        raise InputError("This fit is of one range, and has no profile: fit records at several ranges (--range all).")
    table = fit.profile(record)
    upright = "height" in table
    quantities = list(dict.fromkeys(table["quantity"]))
    if upright:
        figure = Figure(figsize=(2.1 * len(quantities) + 0.6, 5.2), layout="constrained")
        axes = figure.subplots(1, len(quantities), sharey=True, squeeze=False)[0]
    else:
        figure = Figure(figsize=(9.0, 1.5 * len(quantities) + 1.0), layout="constrained")
        axes = figure.subplots(len(quantities), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, quantities, strict=True):
        _draw(axis, table[table["quantity"] == name], upright=upright)
        label = "TI, σ_u/U" if name == "ti" else f"{name} [m² s⁻²]"
        (axis.set_xlabel if upright else axis.set_ylabel)(label)
    words = "height above the lidar [m]" if upright else "range [m]"
    (axes[0].set_ylabel if upright else axes[-1].set_xlabel)(words)
    figure.legend(handles=_handles(table), loc="outside lower center", ncols=2, frameon=False)
    which = "all records" if record is None else f"record {record}"
    figure.suptitle(f"{fit.run['scan']}: {which}", fontsize=11, parse_math=False)  # a name may hold a dollar sign
    return figure


def _draw(axis: Axes, rows: pd.DataFrame, *, upright: bool) -> None:
    place = rows["height" if upright else "range"].to_numpy(dtype=np.float64)
    middle, low, high, share = (
        rows[name].to_numpy(dtype=np.float64) for name in ("estimate", "low", "high", "decided")
    )
    ends = np.maximum([middle - low, high - middle], 0.0)
    one, other = (middle, place) if upright else (place, middle)
    error: dict[str, Any] = {"xerr": ends} if upright else {"yerr": ends}
    axis.errorbar(one, other, **error, fmt="-", color=POSTERIOR_COLOUR, linewidth=0.8, elinewidth=1.4, capsize=2)
    of_data = ~is_priors(share)
    axis.plot(one[of_data], other[of_data], "o", color=POSTERIOR_COLOUR, markersize=5)
    axis.plot(one[~of_data], other[~of_data], "o", color=POSTERIOR_COLOUR, markerfacecolor="white", markersize=5)
    if rows["quantity"].iloc[0] in ("uv", "uw", "vw"):
        (axis.axvline if upright else axis.axhline)(0.0, color="0.6", linewidth=0.8, zorder=0)
    else:
        (axis.set_xlim if upright else axis.set_ylim)(0.0, 1.06 * float(np.max(high)))
    axis.grid(alpha=0.3)


def _handles(table: pd.DataFrame) -> list[Line2D]:
    of = " or ".join(dict.fromkeys(table["of"]))
    percent = 100.0 * float(table["prob"].iloc[0])
    style: dict[str, Any] = {"color": POSTERIOR_COLOUR, "marker": "o", "linewidth": 1.0}
    return [
        Line2D([], [], **style, label=f"{of}, with {percent:g} % interval"),
        Line2D([], [], **style, markerfacecolor="white", label="more the prior's than the data's"),
    ]
