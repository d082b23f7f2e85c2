"""Profiles: stresses and turbulence intensity over the ranges, or over the heights, of a fit."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.fits.record_keys import RecordKey
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.pictures import BEHIND, DATA_MARK, PRIOR_MARK, Picture, new_or_given
from bayes_rs.plot.style import prior_band, prior_words
from bayes_rs.posteriors.decided import PRIORS, is_priors

_Given = TypeVar("_Given", bound=FigureBase)


def profile(fit: Fit, record: RecordKey | None = None, *, figure: _Given | None = None) -> _Given | Picture:
    """Draw the stresses and the turbulence intensity over the ranges, or over the heights of a scan that looks up.

    Parameters
    ----------
    fit : RangedFit
        From `fit` or `open_fit`, at several ranges.
    record : int, str, datetime, Timestamp or datetime64, optional
        Number of a record, or its start (UTC; a text is an ISO time); by default all records together, as
        `RangedFit.profile` has them.
    figure : Figure or SubFigure, optional
        Where to draw.

    Returns
    -------
    figure : Figure or SubFigure
        What was given, or a new figure. Seven panels: turbulence intensity and the six stresses, each with its interval
        at each range. What is the prior's more than the data's has a hollow grey mark and a broken grey bar. Behind is
        the prior's band at the record's size (`prior_interval_at_size`), of all records the medians of its ends.

    Raises
    ------
    InputError
        If it is no fit, or one of one range, or there is no such record.
    """
    check_fit(fit)
    if not isinstance(fit, RangedFit):
        raise InputError("This fit is of one range, and has no profile: fit records at several ranges (--range all).")
    table = fit.profile(record)
    upright = "height" in table
    quantities = list(dict.fromkeys(table["quantity"]))
    size = (2.1 * len(quantities) + 0.6, 5.4) if upright else (9.0, 1.6 * len(quantities) + 1.2)
    target = new_or_given(figure, size)
    if upright:
        axes = target.subplots(1, len(quantities), sharey=True, squeeze=False)[0]
    else:
        axes = target.subplots(len(quantities), 1, sharex=True, squeeze=False)[:, 0]
    prob, kind = float(table["prob"].iloc[0]), str(table["interval"].iloc[0])
    behind = _behind(fit, record, prob, kind)
    for axis, name in zip(axes, quantities, strict=True):
        _draw(axis, table[table["quantity"] == name], behind[name], upright=upright)
        label = "TI, σ_u/U [1]" if name == "ti" else f"{name} [m² s⁻²]"
        (axis.set_xlabel if upright else axis.set_ylabel)(label)
    words = "height above the lidar [m]" if upright else "range [m]"
    (axes[0].set_ylabel if upright else axes[-1].set_xlabel)(words)
    handles = _handles(table, interval_words(prob, kind), prior_words(prob, kind))
    target.legend(handles=handles, loc="outside lower center", ncols=3 if upright else 1, frameon=False)
    which = "all records" if record is None else f"record {record}"
    target.suptitle(f"{fit.run['scan']}: {which}", fontsize=11, parse_math=False)  # a name may hold a dollar sign
    return target  # type: ignore[return-value] # what was given, or new


def _behind(fit: RangedFit, record: RecordKey | None, prob: float, kind: str) -> dict[str, FloatArray]:
    """Return the prior's band of each quantity: rows of range, low and high."""
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in ("ti", *STRESSES)}
    for place, own in fit.fits.items():
        band = prior_band(own, prob, kind)
        chosen = own.fitted if record is None else np.arange(own.n_record) == _number(own, record)
        if not chosen.any():
            continue
        speed = np.asarray(own.records["wind_speed"].values, dtype=np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            of = {"ti": np.sqrt(np.maximum(band[..., 0], 0.0)) / speed}
        of |= {name: band[..., index] for index, name in enumerate(STRESSES)}
        for name, values in of.items():
            known = values[:, chosen][:, np.isfinite(values[0, chosen])]
            if known.shape[1]:
                rows[name].append((float(fit.ranges[place]), *np.median(known, axis=1).tolist()))
    return {name: np.array(found).reshape(-1, 3) for name, found in rows.items()}


def _number(own: Fit, record: RecordKey) -> int:
    """Return the number of a record at one range; −1 if it was not fitted there."""
    try:
        return own.find_record(record)
    except InputError:
        return -1


def _draw(axis: Axes, rows: pd.DataFrame, behind: FloatArray, *, upright: bool) -> None:
    place = rows["height" if upright else "range"].to_numpy(dtype=np.float64)
    middle, low, high, share = (
        rows[name].to_numpy(dtype=np.float64) for name in ("estimate", "low", "high", "decided")
    )
    of_range = dict(zip(behind[:, 0].tolist(), behind[:, 1:].tolist(), strict=True))
    band = np.array([of_range.get(one, [np.nan, np.nan]) for one in rows["range"].tolist()])
    (axis.fill_betweenx if upright else axis.fill_between)(place, band[:, 0], band[:, 1], **BEHIND)
    of_prior = is_priors(share)
    axis.plot(*((middle, place) if upright else (place, middle)), color="0.6", linewidth=0.8, zorder=1)
    for mask, style in (
        (~of_prior, DATA_MARK),
        (of_prior, PRIOR_MARK),
    ):
        ends = np.maximum([middle - low, high - middle], 0.0)[:, mask]
        one, other = (middle[mask], place[mask]) if upright else (place[mask], middle[mask])
        error: dict[str, Any] = {"xerr": ends} if upright else {"yerr": ends}
        drawn = axis.errorbar(one, other, **error, fmt="o", markersize=5, elinewidth=1.4, capsize=2, **style)
        if style is PRIOR_MARK:
            for line in drawn[2]:
                line.set_linestyle("--")
    if rows["quantity"].iloc[0] in ("uv", "uw", "vw"):
        (axis.axvline if upright else axis.axhline)(0.0, color="0.6", linewidth=0.8, zorder=0)
    else:
        (axis.set_xlim if upright else axis.set_ylim)(0.0, 1.06 * float(np.nanmax([*high, *band[:, 1]])))
    axis.grid(alpha=0.3)


def _handles(table: pd.DataFrame, which: str, behind: str) -> list[Artist]:
    of = " or ".join(dict.fromkeys(table["of"]))
    priors = is_priors(table["decided"].to_numpy(dtype=np.float64))
    style: dict[str, Any] = {"marker": "o", "linewidth": 1.4}
    found: list[Artist] = []
    if not priors.all():
        found.append(Line2D([], [], **DATA_MARK, **style, label=f"{of}, {which}"))
    if priors.any():
        label = PRIORS if not priors.all() else f"{of}, {which}, {PRIORS}"
        found.append(Line2D([], [], **PRIOR_MARK, linestyle="--", **style, label=label))
    return [*found, Patch(**BEHIND, label=behind)]
