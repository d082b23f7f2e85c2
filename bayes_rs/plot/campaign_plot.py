"""A campaign: its means, what the data decided of its hyperparameters, and turbulence intensity by wind speed."""

from __future__ import annotations

import re
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.campaign_words import ALL, share_words
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.pictures import OTHER_COLOUR, POSTERIOR_COLOUR, PRIOR_COLOUR, PRIOR_MARK, Picture, new_or_given
from bayes_rs.plot.style import prior_band
from bayes_rs.posteriors.decided import PRIORS, is_priors

_SPEED = re.compile(r"([0-9.]+)-([0-9.]+) m/s")
"""A bin of wind speed in the table of a campaign."""
_ROW_HEIGHT = 0.2
"""Height of the row of a hyperparameter, inches."""


_Given = TypeVar("_Given", bound=FigureBase)


def campaign(fit: Fit, *, figure: _Given | None = None) -> _Given | Picture:
    """Draw what the records together say: means of the stresses, hyperparameters, turbulence intensity by wind speed.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`, with a campaign.
    figure : Figure or SubFigure, optional
        Where to draw.

    Returns
    -------
    figure : Figure or SubFigure
        What was given, or a new figure. Left, above: mean of each stress over the campaign, with its interval, beside
        the average of the records' posterior means under the given prior, which carries the bias of that prior. Left,
        below: mean and 90 % quantile of the turbulence intensity in each bin of wind speed, with intervals. Right:
        interval of each hyperparameter, in units of its prior's interval, which goes from −1 to 1. What the data
        decided less than half of (`is_priors`) has a hollow grey mark and a broken grey bar; grey bands behind the
        means are the prior of one record at the size of the median one.

    Raises
    ------
    InputError
        If it is no fit, or has no campaign; the message says why.
    """
    table, hyper = check_fit(fit).campaign(), fit.campaign_hyper()
    height = max(7.0, 1.6 + _ROW_HEIGHT * len(hyper))
    target = new_or_given(figure, (12.0, height))
    grid = target.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
    _draw_means(target.add_subplot(grid[0, 0]), table, fit)
    _draw_intensity(target.add_subplot(grid[1, 0]), table)
    _draw_hyper(target.add_subplot(grid[:, 1]), hyper)
    about = fit.run["campaign"]
    words = f"{fit.run['scan']}: campaign of {about['n_record']} records, begun with the prior {fit.run['prior_name']}"
    target.suptitle(words, fontsize=11, parse_math=False)  # a name may hold a dollar sign
    return target  # type: ignore[return-value] # what was given, or new


def record_means(fit: Fit) -> FloatArray:
    """Return the average over the fitted records of their posterior means under the given prior, shape (6,), m² s⁻²."""
    return np.asarray(fit.of_stresses("mean")["mean"][fit.fitted].mean(axis=0))


def speed_bins(table: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return the rows of a quantity in bins of wind speed, and the middles of these in a column ``speed``, m/s."""
    found = [_SPEED.fullmatch(text) for text in table["bin"].astype(str)]
    speed = [np.nan if match is None else 0.5 * (float(match[1]) + float(match[2])) for match in found]
    rows = table.assign(speed=speed)
    return rows[(rows["quantity"] == quantity) & rows["speed"].notna()].sort_values("speed")


def _bars(
    axis: Axes, place: FloatArray, rows: pd.DataFrame, colour: str, of_prior: NDArray[np.bool_], marker: str = "o"
) -> None:
    """Draw means with their intervals, those that are mostly the prior's hollow, grey and broken."""
    middle, low, high = (rows[name].to_numpy(dtype=np.float64) for name in ("mean", "low", "high"))
    ends = np.maximum([middle - low, high - middle], 0.0)
    own: dict[str, Any] = {"color": colour}
    for mask, style in ((~of_prior, own), (of_prior, PRIOR_MARK)):
        drawn = axis.errorbar(
            place[mask], middle[mask], yerr=ends[:, mask], fmt=marker, markersize=5, capsize=3, zorder=3, **style
        )
        for line in drawn[2] if style is PRIOR_MARK else ():
            line.set_linestyle("--")


def _draw_means(axis: Axes, table: pd.DataFrame, fit: Fit) -> None:
    rows = table[table["bin"] == ALL].set_index("quantity").loc[list(STRESSES)]
    place = np.arange(len(STRESSES), dtype=np.float64)
    which = interval_words(float(rows["prob"].iloc[0]), str(rows["interval"].iloc[0]))
    of_prior = is_priors(rows["decided"])
    band = prior_band(fit, float(rows["prob"].iloc[0]), str(rows["interval"].iloc[0]))
    low, high = np.median(band[:, fit.fitted], axis=1)
    axis.bar(place, high - low, bottom=low, width=0.7, color=PRIOR_COLOUR, alpha=0.15, linewidth=0)
    axis.axhline(0.0, color="0.6", linewidth=0.8)
    _bars(axis, place - 0.1, rows, POSTERIOR_COLOUR, of_prior)
    axis.plot(place + 0.1, record_means(fit), "D", color=OTHER_COLOUR, markerfacecolor="none")
    labels = [f"{name}\n{share_words(share)}" for name, share in zip(STRESSES, rows["decided"], strict=True)]
    axis.set_xticks(place, labels)
    axis.set_ylabel("mean over the records [m² s⁻²]")
    axis.set_title("Stresses, and the share that the data decided", fontsize=10)
    axis.grid(alpha=0.3, axis="y")
    top = max(float(np.max(high)), float(rows["high"].max()))
    axis.set_ylim(top=1.75 * top)  # room for the legend
    handles = [
        Line2D([], [], color=POSTERIOR_COLOUR, marker="o", label=f"campaign, {which}"),
        *([_prior_handle()] if of_prior.any() else []),
        Line2D(
            [],
            [],
            color=OTHER_COLOUR,
            marker="D",
            linestyle="",
            markerfacecolor="none",
            label=f"average of the records' means, prior {fit.run['prior_name']}",
        ),
        Patch(color=PRIOR_COLOUR, alpha=0.15, linewidth=0, label="prior of one record, at the size of the median one"),
    ]
    axis.legend(handles=handles, frameon=False, fontsize=8, loc="upper right")


def _prior_handle() -> Line2D:
    return Line2D([], [], color=PRIOR_COLOUR, marker="o", linestyle="--", markerfacecolor="white", label=PRIORS)


def _draw_intensity(axis: Axes, table: pd.DataFrame) -> None:
    which = interval_words(float(table["prob"].iloc[0]), str(table["interval"].iloc[0]))
    any_prior = False
    handles = []
    for quantity, label, colour, marker in (
        ("ti", "mean", POSTERIOR_COLOUR, "o"),
        ("ti_p90", "90 % quantile over the records", OTHER_COLOUR, "s"),
    ):
        rows = speed_bins(table, quantity)
        speed, middle, low, high = (rows[name].to_numpy(dtype=np.float64) for name in ("speed", "mean", "low", "high"))
        of_prior = is_priors(rows["decided"])
        any_prior |= bool(of_prior.any())
        axis.fill_between(speed, low, high, alpha=0.2, linewidth=0, color=colour)
        axis.plot(speed, middle, color=colour, linewidth=1.2)
        _bars(axis, speed, rows, colour, of_prior, marker)
        handles.append(Line2D([], [], color=colour, marker=marker, label=label))
    axis.set_ylim(0.0, axis.get_ylim()[1] * 1.4)  # room for the legend
    axis.set_xlabel("wind speed [m/s]")
    axis.set_ylabel("turbulence intensity σ_u/U [1]")
    axis.set_title("Turbulence intensity by wind speed", fontsize=10)
    axis.grid(alpha=0.3)
    if any_prior:
        handles.append(_prior_handle())
    axis.legend(handles=handles, title=which, title_fontsize=8, frameon=False, fontsize=8, loc="upper left")


def _draw_hyper(axis: Axes, hyper: pd.DataFrame) -> None:
    row = np.arange(len(hyper))
    low, high = (hyper[f"prior_{name}"].to_numpy(dtype=np.float64) for name in ("low", "high"))
    centre = 0.5 * (low + high)
    half = np.where(high > low, 0.5 * (high - low), 1.0)
    ends = [(hyper[name].to_numpy(dtype=np.float64) - centre) / half for name in ("low", "mean", "high")]
    axis.hlines(row, -1.0, 1.0, color=PRIOR_COLOUR, linewidth=7, alpha=0.25)
    of_prior = is_priors(hyper["decided"])
    for mask, colour, face, line in (
        (~of_prior, POSTERIOR_COLOUR, POSTERIOR_COLOUR, "-"),
        (of_prior, PRIOR_COLOUR, "white", "--"),
    ):
        axis.hlines(row[mask], ends[0][mask], ends[2][mask], color=colour, linewidth=1.6, linestyle=line)
        axis.plot(ends[1][mask], row[mask], "o", color=colour, markerfacecolor=face, markersize=4)
    axis.set_yticks(row, hyper["name"].astype(str).tolist(), fontsize=8, parse_math=False)
    axis.invert_yaxis()
    axis.set_xlabel(f"in units of the prior's interval ({interval_words(0.9, str(hyper['interval'].iloc[0]))}) [1]")
    axis.set_title("Hyperparameters: posterior on its prior (grey)", fontsize=10)
    axis.grid(alpha=0.3, axis="x")
    shares = axis.secondary_yaxis("right")
    shares.set_yticks(row, [_value(one) for one in hyper.to_dict("records")], fontsize=8)
    shares.tick_params(length=0)


def _value(row: dict[Any, Any]) -> str:
    """Return a hyperparameter's mean, interval and the share that the data decided."""
    words = f"{row['mean']:z.2f} ({row['low']:z.2f} to {row['high']:z.2f})".replace("-", "\N{MINUS SIGN}")
    return f"{words}, {share_words(row['decided'])}"
