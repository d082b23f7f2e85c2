"""Stresses over time, with credible bands, and what of them the prior supplied."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_choice, check_prob
from bayes_rs.errors import InputError
from bayes_rs.fits.campaign_words import share_words
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import INTERVALS, interval_of_ordered, interval_words, quantile_of_ordered
from bayes_rs.pictures import (
    BEHIND,
    DATA_MARK,
    OTHER_COLOUR,
    POSTERIOR_COLOUR,
    PRIOR_COLOUR,
    PRIOR_MARK,
    TRUTH_COLOUR,
    Picture,
    hatched,
    new_or_given,
    prior_patch,
    reach_halfway,
    with_middles,
)
from bayes_rs.plot.style import known_stresses, prior_band, prior_words
from bayes_rs.posteriors.decided import PRIORS, is_priors
from bayes_rs.records.layout import TURBINE

MOST_POINTS = 3000
"""Records of which each is drawn; of more, medians over so many in a row that there are at most that many points."""
_TOLERANCE = 1.5
"""A step to the next record that is so many times as long as a record is a gap, as in the report."""
_Given = TypeVar("_Given", bound=FigureBase)


def stresses(
    fit: Fit,
    *,
    prob: float | None = None,
    interval: str | None = None,
    truth: ArrayLike | None = None,
    figure: _Given | None = None,
) -> _Given | Picture:
    """Draw the six stresses over time, with credible bands.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`.
    prob : float, optional
        Probability of the wide band, by default that of the fit; the narrow one holds half.
    interval : {"equal-tailed", "highest-density"}, optional
        Which intervals the bands are; by default those of the fit.
    truth : array_like, shape (6,) or (n_record, 6), optional
        Known stresses to mark, the same for all records or each record's own, m² s⁻².
    figure : Figure or SubFigure, optional
        Where to draw.

    Returns
    -------
    figure : Figure or SubFigure
        What was given, or a new figure. Six panels: median, 50 % band and `prob` band; of a fit that kept no draws,
        median and interval of its summary. Where the data decided less than half of a stress of a record
        (`is_priors`), both are hatched grey. Behind them is the prior's band at the record's size
        (`prior_interval_at_size`). Lines and bands stop where there are no records for longer than one lasts, and
        between turbines. Records that were not fitted or are flagged are marked below. Of more than `MOST_POINTS`
        records, points are medians over records in a row.

    Raises
    ------
    InputError
        If it is no fit, `prob` is not between 0 and 1, `prob` or `interval` is another one than that of a fit without
        draws, or the truth has the wrong shape or is not finite.
    """
    own = check_fit(fit).settings["fit"]
    prob = float(own["prob"]) if prob is None else check_prob(prob)
    kind = str(own["interval"]) if interval is None else check_choice(interval, tuple(INTERVALS), what="interval")
    marks = None if truth is None else known_stresses(truth, fit.n_record)
    bands, names = _bands(fit, prob, kind)
    values = np.concatenate([bands, prior_band(fit, prob, kind), fit.of_stresses("decided")["decided"][np.newaxis]])
    # the starts of a fleet's records come again with every turbine: its axis is that of the numbers
    has_time = not np.isnat(fit.time).any() and bool(np.all(np.diff(fit.time) > np.timedelta64(0, "ns")))
    size = -(-fit.n_record // MOST_POINTS)
    of_points = np.arange(0, fit.n_record, size)
    when: NDArray[Any] = (fit.time if has_time else np.arange(fit.n_record))[of_points]
    target = new_or_given(figure, (11.0, 12.0))
    axes = target.subplots(6, 1, sharex=True)
    marked = np.unique(np.flatnonzero(fit.flag != 0) // size)
    if size > 1:
        values = np.stack([_medians(values[:, first : first + size]) for first in of_points.tolist()], axis=1)
        names = [f"{name}, medians over {size} records" for name in names]
    truth_style = _truth_style(fit.n_record)
    gaps = _gaps(fit, of_points, size, has_time=has_time)
    at, values = _with_gaps(when, values, gaps)
    shown_marks = None if marks is None else _with_gaps(when, marks[of_points].T, gaps)[1]
    for index, (axis, name) in enumerate(zip(axes, STRESSES, strict=True)):
        _draw_bands(axis, at, values[: len(bands), :, index], values[-3:-1, :, index], values[-1, :, index])
        axis.set_title(_decided_words(values[-1, :, index]), loc="right", fontsize=9, pad=3)
        if shown_marks is not None:
            axis.plot(at, shown_marks[index], **truth_style)
        if index >= 3:
            axis.axhline(0.0, color="0.6", linewidth=0.8)
        axis.set_ylabel(f"{name}\n[m² s⁻²]")
        axis.grid(alpha=0.3)
        if len(marked):
            _mark_flagged(axis, when[marked])
    handles = _handles(values[-1], names, prior_words(prob, kind))
    if marks is not None:
        handles.append(Line2D([], [], **truth_style, label="truth"))
    if len(marked):
        style: dict[str, Any] = {"color": OTHER_COLOUR, "marker": "|", "linestyle": "", "markersize": 9}
        handles.append(Line2D([], [], **style, label="flagged record"))
    target.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    axes[-1].set_xlabel("start of the record (UTC)" if has_time else "record")
    if has_time:
        _date_axis(axes[-1])
    words = f"{fit.run['scan']}: {fit.run['sight']}; prior {fit.run['prior_name']}"
    target.suptitle(words, fontsize=11, parse_math=False)  # a name may hold a dollar sign
    return target  # type: ignore[return-value] # what was given, or new


def _bands(fit: Fit, prob: float, kind: str) -> tuple[FloatArray, list[str]]:
    """Return levels of the stresses, shape (5 or 3, n_record, 6), NaN where not fitted, and the names of the bands."""
    if fit.has_draws:
        bands = np.full((5, fit.n_record, len(STRESSES)), np.nan)
        for rows, draws in fit.batches():
            ordered = np.sort(np.moveaxis(draws.reshape(len(rows), -1, len(STRESSES)), 1, -1), axis=-1)
            wide, narrow = (interval_of_ordered(ordered, share, kind) for share in (prob, 0.5))
            levels = (wide[0], narrow[0], quantile_of_ordered(ordered, 0.5), narrow[1], wide[1])
            bands[:, rows] = np.stack(levels)
        return bands, [interval_words(0.5, kind), interval_words(prob, kind)]
    own = fit.settings["fit"]
    for name, asked in (("prob", prob), ("interval", kind)):
        if asked != own[name]:
            raise InputError(
                f"Invalid {name} {asked}: this fit kept no draws, and its summary holds the intervals "
                f"{interval_words(own['prob'], own['interval'])}; leave it out, or fit again with draws='float32'."
            )
    columns = fit.of_stresses("low", "median", "high")
    return np.stack(list(columns.values())), [interval_words(prob, kind)]


def _gaps(fit: Fit, of_points: NDArray[np.int64], size: int, *, has_time: bool) -> NDArray[np.int64]:
    """Return the points after which there are no records for longer than a point lasts, or those of another turbine."""
    if len(of_points) < 2:
        return np.empty(0, dtype=np.int64)
    if not has_time:
        if TURBINE not in fit.records:
            return np.empty(0, dtype=np.int64)
        names = fit.records[TURBINE].values[of_points]
        return np.flatnonzero(names[1:] != names[:-1])
    steps = np.diff(fit.time) / np.timedelta64(1, "s")
    lasts = float(fit.records.attrs.get("duration", np.median(steps)))
    # the longest step from the first record of a point to that of the next
    longest = np.maximum.reduceat(steps[: of_points[-1]], of_points[:-1])
    return np.flatnonzero(longest > _TOLERANCE * lasts * size)


def _with_gaps(when: NDArray[Any], values: FloatArray, gaps: NDArray[np.int64]) -> tuple[NDArray[Any], FloatArray]:
    """Put a point without values, values (n, n_point, ...), halfway into each gap: nothing is drawn across it."""
    after = gaps + 1
    middles = when[gaps] + (when[after] - when[gaps]) / 2
    return np.insert(when if when.dtype.kind == "M" else when.astype(np.float64), after, middles), np.insert(
        values, after, np.nan, axis=1
    )


def _medians(values: FloatArray) -> FloatArray:
    """Return the medians of values (n, n_record, 6) over the fitted records; NaN if there are none."""
    fitted = np.isfinite(values[0]).all(axis=1)
    return np.median(values[:, fitted], axis=1) if fitted.any() else np.full((len(values), values.shape[2]), np.nan)


def _decided_words(decided: FloatArray) -> str:
    """Say what the data decided of one stress, shares (n_point,)."""
    known = decided[np.isfinite(decided)]
    if not len(known):
        return ""
    share, count = share_words(float(np.median(known))), int(is_priors(known).sum())
    if len(known) == 1:
        return f"{'mostly the prior’s: ' if count else ''}the data decided {share}"
    where = {0: "", len(known): "mostly the prior’s: "}.get(count, f"mostly the prior’s in {count} of {len(known)}: ")
    return f"{where}the data decided {share} (median)"


def _draw_bands(axis: Axes, when: NDArray[Any], bands: FloatArray, behind: FloatArray, decided: FloatArray) -> None:
    """Draw the bands of one stress, levels (5 or 3, n_point): those of the data blue, those of the prior hatched."""
    fitted = np.isfinite(bands[0])
    of_prior = is_priors(decided) & fitted
    if len(when) == 1:
        _draw_one(axis, when, bands, behind, of_prior=bool(of_prior[0]))
        return
    axis.fill_between(when, *behind, **BEHIND)
    alone = _alone(fitted)
    if alone.any():
        axis.vlines(when[alone], *behind[:, alone], color=PRIOR_COLOUR, alpha=BEHIND["alpha"], linewidth=6)
    at, levels = with_middles(when, bands)
    marker = "o" if np.count_nonzero(fitted) < 40 else ""
    blue: dict[str, Any] = {"color": POSTERIOR_COLOUR, "linewidth": 0}
    grey: dict[str, Any] = {"color": PRIOR_COLOUR, "linewidth": 0, "alpha": 0.3}
    for mask, style, line, faces in (
        (fitted & ~of_prior, DATA_MARK, "-", ({**blue, "alpha": 0.25}, {**blue, "alpha": 0.45})),
        (of_prior, PRIOR_MARK, "--", (hatched(linewidth=0.8), grey)),
    ):
        if not mask.any():
            continue
        where = reach_halfway(mask)
        for outer, face in zip(range(len(bands) // 2), faces, strict=False):
            axis.fill_between(at, levels[outer], levels[-1 - outer], where=where.tolist(), **face)
        middle = len(bands) // 2
        axis.plot(at, np.where(where, levels[middle], np.nan), linewidth=1.2, linestyle=line, **style)
        axis.plot(when[mask], bands[middle][mask], linestyle="", marker=marker, markersize=3.5, **style)
        if (mask & alone).any():  # no band reaches it
            own = bands[:, mask & alone]
            ends = np.abs(own[[0, -1]] - own[middle])
            axis.errorbar(when[mask & alone], own[middle], yerr=ends, fmt="o", markersize=4, capsize=2, **style)


def _alone(fitted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which points have no neighbour, shape (n_point,)."""
    padded = np.concatenate([[False], fitted, [False]])
    return np.asarray(fitted & ~padded[:-2] & ~padded[2:])


def _draw_one(axis: Axes, when: NDArray[Any], bands: FloatArray, behind: FloatArray, *, of_prior: bool) -> None:
    """Draw a single record: a point with bars, on the prior's."""
    low, middle, high = bands[0], bands[len(bands) // 2], bands[-1]
    axis.vlines(when, *behind, color=PRIOR_COLOUR, alpha=0.25, linewidth=14)
    style = PRIOR_MARK if of_prior else DATA_MARK
    bars = axis.errorbar(when, middle, yerr=np.abs([low - middle, high - middle]), fmt="o", capsize=3, **style)
    if of_prior:
        for line in bars[2]:
            line.set_linestyle("--")


def _handles(decided: FloatArray, names: list[str], behind: str) -> list[Artist]:
    """Return the legend's handles: of the data's and of the prior's parts, those that there are."""
    known = decided[np.isfinite(decided)]
    priors = is_priors(known)
    found: list[Artist] = []
    if not priors.all() or not len(known):
        found.append(Line2D([], [], color=POSTERIOR_COLOUR, label="median"))
        found += [
            Patch(color=POSTERIOR_COLOUR, alpha=alpha, linewidth=0, label=name)
            for alpha, name in zip((0.6, 0.25)[-len(names) :], names, strict=True)
        ]
    if priors.any():
        found.append(prior_patch(PRIORS))
    return [*found, Patch(**BEHIND, label=behind)]


def _truth_style(n_record: int) -> dict[str, Any]:
    style: dict[str, Any] = {"color": TRUTH_COLOUR, "linewidth": 1.2, "linestyle": "--" if n_record > 1 else ""}
    return {**style, "marker": "s" if n_record == 1 else "." if n_record < 40 else ""}


def _mark_flagged(axis: Axes, when: NDArray[Any]) -> None:
    axis.plot(
        when,
        np.zeros(len(when)),
        "|",
        color=OTHER_COLOUR,
        transform=axis.get_xaxis_transform(),
        clip_on=False,
        markersize=9,
    )


def _date_axis(axis: Axes) -> None:
    import matplotlib.dates as mdates  # noqa: PLC0415 - only where dates are drawn

    locator = mdates.AutoDateLocator()  # type: ignore[no-untyped-call]  # matplotlib has no types here
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(mdates.ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]  # nor here
