"""A campaign: its means, what the data decided of its hyperparameters, and turbulence intensity by wind speed."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayes_rs._validation import FloatArray
from bayes_rs.fits.campaign_words import ALL, share_words
from bayes_rs.fits.fit_object import Fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.plot.style import POSTERIOR_COLOUR, PRIOR_COLOUR

_SPEED = re.compile(r"([0-9.]+)-([0-9.]+) m/s")
"""A bin of wind speed in the table of a campaign."""
_ROW_HEIGHT = 0.2
"""Height of the row of a hyperparameter, inches."""


def campaign(fit: Fit) -> Figure:
    """Draw what the records together say: means of the stresses, hyperparameters, turbulence intensity by wind speed.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`, with a campaign.

    Returns
    -------
    figure : Figure
        Left, above: mean of each stress over the campaign, with its interval, beside the average of the records'
        posterior means under the given prior, which carries the bias of that prior. Left, below: mean and 90 % quantile
        of the turbulence intensity in each bin of wind speed, with intervals. Right: interval of each hyperparameter,
        in units of its prior's interval, which goes from −1 to 1.

    Raises
    ------
    InputError
        If the fit has no campaign; the message says why.
    """
    table, hyper = fit.campaign(), fit.campaign_hyper()
    height = max(7.0, 1.6 + _ROW_HEIGHT * len(hyper))
    figure = Figure(figsize=(12.0, height), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    _draw_means(figure.add_subplot(grid[0, 0]), table, fit)
    _draw_intensity(figure.add_subplot(grid[1, 0]), table)
    _draw_hyper(figure.add_subplot(grid[:, 1]), hyper)
    about = fit.run["campaign"]
    words = f"{fit.run['scan']}: campaign of {about['n_record']} records, begun with the prior {fit.run['prior_name']}"
    figure.suptitle(words, fontsize=11, parse_math=False)  # a name may hold a dollar sign
    return figure


def record_means(fit: Fit) -> FloatArray:
    """Return the average over the fitted records of their posterior means under the given prior, shape (6,), m² s⁻²."""
    return np.asarray(fit.of_stresses("mean")["mean"][fit.fitted].mean(axis=0))


def speed_bins(table: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return the rows of a quantity in bins of wind speed, and the middles of these in a column ``speed``, m/s."""
    found = [_SPEED.fullmatch(text) for text in table["bin"].astype(str)]
    speed = [np.nan if match is None else 0.5 * (float(match[1]) + float(match[2])) for match in found]
    rows = table.assign(speed=speed)
    return rows[(rows["quantity"] == quantity) & rows["speed"].notna()].sort_values("speed")


def _draw_means(axis: Axes, table: pd.DataFrame, fit: Fit) -> None:
    rows = table[table["bin"] == ALL].set_index("quantity").loc[list(STRESSES)]
    place = np.arange(len(STRESSES))
    middle, low, high = (rows[name].to_numpy(dtype=np.float64) for name in ("mean", "low", "high"))
    axis.axhline(0.0, color="0.6", linewidth=0.8)
    ends = np.maximum([middle - low, high - middle], 0.0)
    axis.errorbar(place - 0.1, middle, yerr=ends, fmt="o", color=POSTERIOR_COLOUR, capsize=3)
    axis.plot(place + 0.1, record_means(fit), "D", color=PRIOR_COLOUR, markerfacecolor="none")
    labels = [f"{name}\n{share_words(share)}" for name, share in zip(STRESSES, rows["decided"], strict=True)]
    axis.set_xticks(place, labels)
    axis.set_ylabel("mean over the records [m² s⁻²]")
    axis.set_title("Stresses, and the share that the data decided", fontsize=10)
    axis.grid(alpha=0.3, axis="y")
    percent = 100.0 * float(rows["prob"].iloc[0])
    handles = [
        Line2D([], [], color=POSTERIOR_COLOUR, marker="o", label=f"campaign, {percent:g} % interval"),
        Line2D(
            [],
            [],
            color=PRIOR_COLOUR,
            marker="D",
            linestyle="",
            markerfacecolor="none",
            label=f"average of the records' means, prior {fit.run['prior_name']}",
        ),
    ]
    axis.legend(handles=handles, frameon=False, fontsize=8)


def _draw_intensity(axis: Axes, table: pd.DataFrame) -> None:
    styles: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("ti", "mean", {"color": POSTERIOR_COLOUR, "marker": "o"}),
        ("ti_p90", "90 % quantile over the records", {"color": PRIOR_COLOUR, "marker": "s"}),
    )
    for quantity, label, style in styles:
        rows = speed_bins(table, quantity)
        speed, middle, low, high = (rows[name].to_numpy(dtype=np.float64) for name in ("speed", "mean", "low", "high"))
        axis.fill_between(speed, low, high, alpha=0.2, linewidth=0, color=style["color"])
        ends = np.maximum([middle - low, high - middle], 0.0)
        axis.errorbar(speed, middle, yerr=ends, label=label, linewidth=1.2, markersize=4, capsize=2, **style)
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel("wind speed [m/s]")
    axis.set_ylabel("turbulence intensity σ_u / U")
    axis.set_title("Turbulence intensity by wind speed", fontsize=10)
    axis.grid(alpha=0.3)
    axis.legend(frameon=False, fontsize=8)


def _draw_hyper(axis: Axes, hyper: pd.DataFrame) -> None:
    row = np.arange(len(hyper))
    centre, low, high = (hyper[f"prior_{name}"].to_numpy(dtype=np.float64) for name in ("mean", "low", "high"))
    centre = 0.5 * (low + high)
    half = np.where(high > low, 0.5 * (high - low), 1.0)
    ends = [(hyper[name].to_numpy(dtype=np.float64) - centre) / half for name in ("low", "mean", "high")]
    axis.hlines(row, -1.0, 1.0, color=PRIOR_COLOUR, linewidth=5, alpha=0.25)
    axis.hlines(row, ends[0], ends[2], color=POSTERIOR_COLOUR, linewidth=2)
    axis.plot(ends[1], row, "o", color=POSTERIOR_COLOUR, markersize=3)
    axis.set_yticks(row, hyper["name"].astype(str).tolist(), fontsize=8, parse_math=False)
    axis.invert_yaxis()
    axis.set_xlabel("in units of the prior's interval")
    axis.set_title("Hyperparameters: posterior on its prior", fontsize=10)
    axis.grid(alpha=0.3, axis="x")
    shares = axis.secondary_yaxis("right")
    shares.set_yticks(row, [_value(one) for one in hyper.to_dict("records")], fontsize=8)
    shares.tick_params(length=0)


def _value(row: dict[Any, Any]) -> str:
    """Return a hyperparameter's mean, interval and the share that the data decided."""
    return f"{row['mean']:.2f} ({row['low']:.2f} to {row['high']:.2f}), {share_words(row['decided'])}"
