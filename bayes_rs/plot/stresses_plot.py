"""Stresses over time, with credible bands."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_prob
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.plot.style import POSTERIOR_COLOUR, PRIOR_COLOUR, TRUTH_COLOUR, known_stresses

MOST_POINTS = 3000
"""Records of which each is drawn; of more, medians over so many in a row that there are at most that many points."""


def stresses(fit: Fit, *, prob: float | None = None, truth: ArrayLike | None = None) -> Figure:
    """Draw the six stresses over time, with credible bands.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`.
    prob : float, optional
        Probability of the wide band, by default that of the fit; the narrow one holds half.
    truth : array_like, shape (6,) or (n_record, 6), optional
        Known stresses to mark, the same for all records or each record's own, m² s⁻².

    Returns
    -------
    figure : Figure
        Six panels: median, central 50 % band and central `prob` band; of a fit that kept no draws, median and
        interval of its summary. Records that were not fitted or are flagged are marked below. Of more than
        `MOST_POINTS` records, points are medians over records in a row.

    Raises
    ------
    InputError
        If `prob` is not between 0 and 1, or is another one than that of a fit without draws, or the truth has the wrong
        shape or is not finite.
    """
    prob = float(fit.settings["fit"]["prob"]) if prob is None else check_prob(prob)
    marks = None if truth is None else known_stresses(truth, fit.n_record)
    bands, names = _bands(fit, prob)
    # the starts of a fleet's records come again with every turbine: its axis is that of the numbers
    has_time = not np.isnat(fit.time).any() and bool(np.all(np.diff(fit.time) > np.timedelta64(0, "ns")))
    size = -(-fit.n_record // MOST_POINTS)
    of_points = np.arange(0, fit.n_record, size)
    when: NDArray[Any] = (fit.time if has_time else np.arange(fit.n_record))[of_points]
    figure = Figure(figsize=(11.0, 11.0), layout="constrained")
    axes = figure.subplots(6, 1, sharex=True)
    marked = np.unique(np.flatnonzero(fit.flag != 0) // size)
    if size > 1:
        bands = np.stack([_medians(bands[:, first : first + size]) for first in of_points.tolist()], axis=1)
        names = [f"{name}, medians over {size} records" for name in names]
    truth_style = _truth_style(fit.n_record)
    for index, (axis, name) in enumerate(zip(axes, STRESSES, strict=True)):
        _draw_bands(axis, when, bands[..., index])
        if marks is not None:
            axis.plot(when, marks[of_points, index], **truth_style)
        if index >= 3:
            axis.axhline(0.0, color="0.6", linewidth=0.8)
        axis.set_ylabel(f"{name}\n[m² s⁻²]")
        axis.grid(alpha=0.3)
        if len(marked):
            _mark_flagged(axis, when[marked])
    handles = [
        Line2D([], [], color=POSTERIOR_COLOUR, label="median"),
        *(
            Line2D([], [], color=POSTERIOR_COLOUR, alpha=alpha, linewidth=8, label=label)
            for alpha, label in zip((0.4, 0.2)[-len(names) :], names, strict=True)
        ),
    ]
    if marks is not None:
        handles.append(Line2D([], [], **truth_style, label="truth"))
    if len(marked):
        style: dict[str, Any] = {"color": PRIOR_COLOUR, "marker": "|", "linestyle": "", "markersize": 9}
        handles.append(Line2D([], [], **style, label="flagged record"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    axes[-1].set_xlabel("start of the record (UTC)" if has_time else "record")
    if has_time:
        _date_axis(axes[-1])
    words = f"{fit.run['scan']}: {fit.run['sight']}; prior {fit.run['prior_name']}"
    figure.suptitle(words, fontsize=11, parse_math=False)  # a name may hold a dollar sign
    return figure


def _bands(fit: Fit, prob: float) -> tuple[FloatArray, list[str]]:
    """Return levels of the stresses, shape (5 or 3, n_record, 6), NaN where not fitted, and the names of the bands."""
    if fit.has_draws:
        levels = [0.5 * (1.0 - prob), 0.25, 0.5, 0.75, 0.5 * (1.0 + prob)]
        bands = np.full((len(levels), fit.n_record, len(STRESSES)), np.nan)
        for rows, draws in fit.batches():
            bands[:, rows] = np.quantile(draws.reshape(len(rows), -1, len(STRESSES)), levels, axis=1)
        return bands, ["central 50 %", f"central {100 * prob:g} %"]
    own = fit.settings["fit"]["prob"]
    if prob != own:
        raise InputError(
            f"Invalid prob {prob:g}: this fit kept no draws, and its summary holds intervals of {own:g}; leave it out, "
            "or fit again with draws='float32'."
        )
    columns = fit.of_stresses("low", "median", "high")
    return np.stack(list(columns.values())), [f"{100 * prob:g} % interval, equal tails"]


def _medians(bands: FloatArray) -> FloatArray:
    """Return the medians of levels (n_level, n_record, 6) over the fitted records; NaN if there are none."""
    fitted = np.isfinite(bands).all(axis=(0, 2))
    return np.median(bands[:, fitted], axis=1) if fitted.any() else np.full((len(bands), bands.shape[2]), np.nan)


def _draw_bands(axis: Axes, when: NDArray[Any], bands: FloatArray) -> None:
    """Draw the bands of one stress, levels (5 or 3, n_record)."""
    low, middle, high = bands[0], bands[len(bands) // 2], bands[-1]
    if len(when) == 1:
        axis.errorbar(when, middle, yerr=np.abs([low - middle, high - middle]), fmt="o", color=POSTERIOR_COLOUR)
        return
    for outer, alpha in zip(range(len(bands) // 2), (0.2, 0.4), strict=False):
        axis.fill_between(when, bands[outer], bands[-1 - outer], color=POSTERIOR_COLOUR, alpha=alpha, linewidth=0)
    axis.plot(when, middle, color=POSTERIOR_COLOUR, linewidth=1.2, marker="." if len(when) < 40 else "")


def _truth_style(n_record: int) -> dict[str, Any]:
    style: dict[str, Any] = {"color": TRUTH_COLOUR, "linewidth": 1.2, "linestyle": "--" if n_record > 1 else ""}
    return {**style, "marker": "s" if n_record == 1 else "." if n_record < 40 else ""}


def _mark_flagged(axis: Axes, when: NDArray[Any]) -> None:
    axis.plot(
        when,
        np.zeros(len(when)),
        "|",
        color=PRIOR_COLOUR,
        transform=axis.get_xaxis_transform(),
        clip_on=False,
        markersize=9,
    )


def _date_axis(axis: Axes) -> None:
    import matplotlib.dates as mdates  # noqa: PLC0415 - only where dates are drawn

    locator = mdates.AutoDateLocator()  # type: ignore[no-untyped-call]  # matplotlib has no types here
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(mdates.ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]  # nor here
