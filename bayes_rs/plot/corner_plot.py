"""Corner plots of a record's posterior, with the prior's outline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, as_items, check_array, check_choice, check_prob
from bayes_rs.errors import InputError
from bayes_rs.fits.campaign_words import share_words
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.fits.record_keys import RecordKey
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import INTERVALS, interval_of, interval_words
from bayes_rs.pictures import (
    POSTERIOR_COLOUR,
    PRIOR_COLOUR,
    TRUTH_COLOUR,
    Picture,
    hatched,
    new_or_given,
    prior_patch,
)
from bayes_rs.plot.density import LEVELS, smooth, smooth_pair
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.posteriors.prior_at_size import shapes_of

_VARIANCES = 3
"""The first stresses are variances, which are never below zero."""
_Given = TypeVar("_Given", bound=FigureBase)


def corner(
    fit: Fit,
    record: RecordKey = 0,
    *,
    prob: float | None = None,
    interval: str | None = None,
    stresses: Sequence[str] = STRESSES,
    truth: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    title: str | None = None,
    figure: _Given | None = None,
) -> _Given | Picture:
    """Draw the posterior of one record as a corner plot, with the outline of the prior.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`; it kept its draws.
    record : int, str, datetime, Timestamp or datetime64
        Number of the record, or its start (UTC; a text is an ISO time).
    prob : float, optional
        Probability of the intervals in the titles, by default that of the fit.
    interval : {"equal-tailed", "highest-density"}, optional
        Which intervals these are; by default those of the fit.
    stresses : sequence of str
        Which stresses, in this order; at least two.
    truth : array_like, shape (6,), optional
        Known stresses to mark, m² s⁻².
    limits : array_like, shape (6, 2), optional
        Axis limits of the stresses, m² s⁻²; give the same ones to plots that are to be compared.
    title : str, optional
        Title; by default scan, record and prior.
    figure : Figure or SubFigure, optional
        Where to draw.

    Returns
    -------
    figure : Figure or SubFigure
        What was given, or a new figure. Contours hold 68 and 95 % of the draws, titles give median, interval and the
        share that the data decided. The prior is drawn at the posterior's own size: prior shapes R/(uu + vv + ww) times
        the posterior's trace. Where the posterior fills that outline, the data said nothing and the prior everything.
        What is of a stress that the data decided less than half of (`is_priors`) is hatched grey.

    Raises
    ------
    InputError
        If it is no fit, the record does not exist or was not fitted, a stress is not known, or an array has the wrong
        shape.
    """
    index = check_fit(fit).find_record(record)
    own = fit.settings["fit"]
    prob = float(own["prob"]) if prob is None else check_prob(prob)
    kind = str(own["interval"]) if interval is None else check_choice(interval, tuple(INTERVALS), what="interval")
    shown = [
        STRESSES.index(check_choice(name, STRESSES, what="stress")) for name in as_items(stresses, what="stresses")
    ]
    if len(set(shown)) < max(len(shown), 2):
        raise InputError(f"Invalid stresses {list(stresses)!r}: give at least two, and each once.")
    posterior, prior = _draws(fit, index)
    if len(posterior) <= len(STRESSES):
        raise InputError(
            f"Record {index} has {len(posterior)} draws, and a corner plot needs more than {len(STRESSES)}: fit again "
            "with a larger target_ess (--ess)."
        )
    marks = None if truth is None else check_array(truth, (6,), what="truth")
    ranges = default_limits([posterior, prior]) if limits is None else check_array(limits, (6, 2), what="limits")
    decided = _decided(fit, index)
    target = new_or_given(figure, (10.5, 10.5) if len(shown) > 4 else (7.5, 7.5))
    grid = target.add_gridspec(len(shown), len(shown))
    for row, i in enumerate(shown):
        for column, j in enumerate(shown[: row + 1]):
            panel = target.add_subplot(grid[row, column])
            of_prior = bool(is_priors(decided[[i, j]]).any())
            if i == j:
                _draw_one(panel, prior[:, i], posterior[:, i], i, of_prior=of_prior)
                low, high = interval_of(posterior[:, i], prob, kind)
                words = f"{STRESSES[i]} = {np.median(posterior[:, i]):z.2f}\n{low:z.2f} to {high:z.2f}\n"
                words = words.replace("-", "\N{MINUS SIGN}")
                words += _share_line(float(decided[i]))
                # only the first needs room of its own: above the others there is no panel
                place: dict[str, Any] = {
                    "transform": panel.transAxes,
                    "ha": "center",
                    "va": "bottom",
                    "in_layout": row == 0,
                }
                panel.text(0.5, 1.03, words, fontsize=8, **place)
            else:
                _draw_pair(panel, prior[:, [j, i]], posterior[:, [j, i]], (j, i), of_prior=of_prior)
                panel.set_ylim(*ranges[i])
            panel.set_xlim(*ranges[j])
            if marks is not None:
                panel.axvline(marks[j], color=TRUTH_COLOUR, linewidth=1.0)
                if i != j:
                    panel.axhline(marks[i], color=TRUTH_COLOUR, linewidth=1.0)
                    panel.plot(marks[j], marks[i], "s", color=TRUTH_COLOUR, markersize=4)
            _finish_panel(panel, STRESSES[j], STRESSES[i], last=row == len(shown) - 1, first=column == 0 < row)
    handles = _handles(is_priors(decided[shown]), interval_words(prob, kind), has_truth=marks is not None)
    legend = target.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.995, 0.95), frameon=False, fontsize=8)
    legend.set_in_layout(False)  # it stands where there is no panel
    if title is None:
        start = fit.time[index]
        when = "" if np.isnat(start) else f", {np.datetime_as_string(start, unit='m')} UTC"
        title = f"{fit.run['scan']}, record {index}{when}, prior {fit.run['prior_name']}"
    head = target.suptitle(title, fontsize=11, x=0.99, y=0.985, ha="right", va="top", parse_math=False)
    head.set_in_layout(False)
    return target  # type: ignore[return-value] # what was given, or new


def prior_at_size(fit: Fit, record: RecordKey) -> FloatArray:
    """Return draws of the prior's shape R/(uu + vv + ww) times the trace of a record's posterior, shape (n, 6)."""
    return _draws(fit, check_fit(fit).find_record(record))[1]


def _draws(fit: Fit, index: int) -> tuple[FloatArray, FloatArray]:
    """Return posterior draws of a record, and draws of the prior's shape at the posterior's size, each (n, 6)."""
    posterior = fit.draws(index).reshape(-1, 6)
    prior = fit.prior_draws
    shape = shapes_of(prior)
    size = np.resize(posterior[:, :3].sum(axis=1), len(shape))
    return posterior, shape * size[:, None]


def default_limits(samples: Sequence[FloatArray]) -> FloatArray:
    """Return axis limits, shape (6, 2), that hold the central 99 % of every sample (n, 6)."""
    ends = np.array([np.quantile(sample, [0.005, 0.995], axis=0) for sample in samples])
    low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
    return np.stack([np.where(np.arange(6) < 3, np.minimum(low, 0.0), low), high], axis=1)


def corner_limits(fits: Sequence[Fit], records: Sequence[RecordKey]) -> FloatArray:
    """Return axis limits, shape (6, 2), that suit corner plots of records of several fits."""
    pairs = zip(fits, records, strict=True)
    samples = [part for fit, record in pairs for part in _draws(fit, check_fit(fit).find_record(record))]
    return default_limits(samples)


def _decided(fit: Fit, index: int) -> FloatArray:
    """Return the shares that the data decided of the stresses of a record, shape (6,)."""
    table = fit.summary(records=index, columns=["stress", "decided"])
    return np.asarray(table.set_index("stress")["decided"].loc[list(STRESSES)], dtype=np.float64)


def _share_line(decided: float) -> str:
    """Say who decided a stress, in a few words."""
    share = share_words(decided)
    return f"prior’s: data {share}" if is_priors(decided) else f"data’s: {share}"


def _draw_one(panel: Axes, prior: FloatArray, posterior: FloatArray, index: int, *, of_prior: bool) -> None:
    """Draw the densities of one stress."""
    positive = index < _VARIANCES
    panel.plot(*smooth(prior, positive=positive), color=PRIOR_COLOUR, linestyle="--", linewidth=1.0)
    x, density = smooth(posterior, positive=positive)
    if of_prior:
        panel.fill_between(x, density, **hatched())
        panel.plot(x, density, color=PRIOR_COLOUR, linewidth=1.2)
    else:
        panel.fill_between(x, density, color=POSTERIOR_COLOUR, alpha=0.3, linewidth=0)
        panel.plot(x, density, color=POSTERIOR_COLOUR, linewidth=1.4)
    panel.set_ylim(bottom=0.0)
    panel.set_yticks([])


def _draw_pair(panel: Axes, prior: FloatArray, posterior: FloatArray, pair: tuple[int, int], *, of_prior: bool) -> None:
    """Draw the contours of two stresses, draws (n, 2)."""
    positive = (pair[0] < _VARIANCES, pair[1] < _VARIANCES)
    x, y, density, value = smooth_pair(*prior.T, positive=positive, levels=LEVELS)
    panel.contour(x, y, density, levels=np.sort(value), colors=PRIOR_COLOUR, linestyles="--", linewidths=1.0)
    x, y, density, value = smooth_pair(*posterior.T, positive=positive, levels=LEVELS)
    levels, top = np.sort(value), [float(density.max()) * 1.01]
    if of_prior:
        # the hatching of contourf has no colour of its own: a patch of the outer region carries it
        drawn = panel.contourf(x, y, density, levels=[levels[0], *top], colors="none", hatches=["////"])
        drawn.set_edgecolor(PRIOR_COLOUR)
        drawn.set_linewidth(0.0)
        panel.contour(x, y, density, levels=levels, colors=PRIOR_COLOUR, linewidths=1.2)
        return
    faces = [_mixed(POSTERIOR_COLOUR, share) for share in (0.3, 0.65)]
    panel.contourf(x, y, density, levels=[*levels, *top], colors=faces)
    panel.contour(x, y, density, levels=levels, colors=POSTERIOR_COLOUR, linewidths=1.2)


def _mixed(colour: str, share: float) -> tuple[float, float, float]:
    """Return a colour on white paper."""
    red, green, blue = (1.0 - share * (1.0 - part) for part in to_rgb(colour))
    return red, green, blue


def _finish_panel(panel: Axes, across: str, along: str, *, last: bool, first: bool) -> None:
    """Put ticks and labels on the outer panels."""
    panel.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
    panel.tick_params(labelsize=8, labelbottom=last, labelleft=first)
    if across != along:
        panel.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
    if last:
        panel.set_xlabel(f"{across} [m² s⁻²]", fontsize=9)
    if first:
        panel.set_ylabel(f"{along} [m² s⁻²]", fontsize=9)


def _handles(of_prior: Any, which: str, *, has_truth: bool) -> list[Artist]:
    """Return the legend's handles, of what there is."""
    found: list[Artist] = []
    if not of_prior.all():
        found.append(Patch(color=_mixed(POSTERIOR_COLOUR, 0.65), label="posterior, 68 and 95 %"))
    if of_prior.any():
        found.append(prior_patch("mostly the prior's:\nthe data decided less than half"))
    found.append(
        Line2D([], [], color=PRIOR_COLOUR, linestyle="--", label="prior, at the posterior's\nsize uu + vv + ww")
    )
    if has_truth:
        found.append(Line2D([], [], color=TRUTH_COLOUR, marker="s", markersize=4, label="truth"))
    found.append(Line2D([], [], linestyle="", label=f"titles: median,\n{which}"))
    return found
