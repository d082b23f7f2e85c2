"""Figures: corner plots with the prior's outline, and stresses over time with credible bands."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

import matplotlib as mpl
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, as_numbers, check_array
from bayes_rs.errors import InputError
from bayes_rs.fits.result import check_result, flag_words, group
from bayes_rs.geometry.stress import STRESSES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POSTERIOR_COLOUR = "#1f4e79"
PRIOR_COLOUR = "#c26a16"
TRUTH_COLOUR = "#1b7837"
LEVELS = (0.68, 0.95)
"""Probability inside the contours; corner's own default, "1 sigma", holds 39 % in two dimensions."""


def find_record(result: xr.DataTree, record: int | str) -> int:
    """Return the number of the record that `record` means: a number, or the time at which the record starts.

    Raises
    ------
    InputError
        If there is no such record, or it was not fitted.
    """
    check_result(result)
    observed = group(result, "observed_data")
    n_record = observed.sizes["record"]
    if isinstance(record, str) and not record.lstrip("-").isdecimal():
        try:
            stamp = pd.Timestamp(record)
            wanted = (stamp.tz_convert("UTC").tz_localize(None) if stamp.tz else stamp).to_datetime64()
        except ValueError as error:
            raise InputError(f"Invalid record {record!r}: give a number or a time such as 2020-09-04T12:00.") from error
        times = observed.coords["time"].values
        match = np.flatnonzero(times == wanted)
        if len(match) == 0:
            raise InputError(f"No record starts at {record}: the records start from {times[0]} to {times[-1]} (UTC).")
        index = int(match[0])
    else:
        index = int(record)
        if not 0 <= index < n_record:
            raise InputError(f"No record {index}: there are {n_record}, numbered from 0.")
    if not np.isfinite(group(result, "posterior")["stress"].isel(record=index).values).all():
        words = flag_words(int(group(result, "sample_stats")["flag"].values[index]))
        raise InputError(f"Record {index} was not fitted ({words}): choose another one.")
    return index


@overload
def plot_corner(
    result: xr.DataTree,
    record: int | str = 0,
    *,
    truth: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    title: str | None = None,
    figure: None = None,
) -> Figure: ...


@overload
def plot_corner(
    result: xr.DataTree,
    record: int | str = 0,
    *,
    truth: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    title: str | None = None,
    figure: FigureBase,
) -> FigureBase: ...


def plot_corner(
    result: xr.DataTree,
    record: int | str = 0,
    *,
    truth: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    title: str | None = None,
    figure: FigureBase | None = None,
) -> FigureBase:
    """Draw the posterior of one record as a corner plot, with the outline of the prior.

    Parameters
    ----------
    result : DataTree
        From `fit`.
    record : int or str
        Number of the record, or its start as ISO time (UTC).
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
        Contours hold 68 and 95 %, titles give the 5, 50 and 95 % points. The prior is drawn at the posterior's own
        size: prior shapes R/(uu + vv + ww) times the posterior's trace. Where the posterior fills that outline, the
        data said nothing and the prior everything.

    Raises
    ------
    InputError
        If the record does not exist or was not fitted, or an array has the wrong shape.
    """
    with warnings.catch_warnings():
        # corner imports ArviZ, which announces its next version on stderr now and then
        warnings.filterwarnings("ignore", message="\\s*ArviZ is undergoing", category=FutureWarning)
        import corner  # noqa: PLC0415 - loading it takes longer than most commands

    index = find_record(result, record)
    posterior, prior = _draws(result, index)
    marks = None if truth is None else check_array(truth, (6,), what="truth")
    ranges = default_limits([posterior, prior]) if limits is None else check_array(limits, (6, 2), what="limits")
    target = figure if figure is not None else Figure(figsize=(10.5, 10.5))
    common = {
        "range": [tuple(pair) for pair in ranges],
        "levels": LEVELS,
        "plot_datapoints": False,
        "plot_density": False,
        "smooth": 1.0,
        "bins": 36,
        "fig": target,
    }
    labels = [f"{name} [m² s⁻²]" for name in STRESSES]
    with mpl.rc_context({"font.size": 9}):
        corner.corner(
            prior,
            color=PRIOR_COLOUR,
            contour_kwargs={"linestyles": ["--"], "linewidths": 1.0},
            hist_kwargs={"linestyle": "--", "density": True},
            labels=labels,
            no_fill_contours=True,
            **common,
        )
        corner.corner(
            posterior,
            color=POSTERIOR_COLOUR,
            fill_contours=True,
            labels=labels,
            hist_kwargs={"density": True, "linewidth": 1.4},
            truths=None if marks is None else list(marks),
            truth_color=TRUTH_COLOUR,
            **common,
        )
    _finish_corner(target, posterior, has_truth=marks is not None)
    if title is None:
        start = (
            result["observed_data"].coords["time"].values[index] if "time" in result["observed_data"].coords else None
        )
        when = f", {np.datetime_as_string(start, unit='m')} UTC" if start is not None else ""
        title = f"{result.attrs['scan']}, record {index}{when}, prior {result.attrs['prior_name']}"
    target.suptitle(title, fontsize=12, x=0.98, ha="right", parse_math=False)
    return target


def known_stresses(truth: ArrayLike, n_record: int) -> FloatArray:
    """Return the true stresses of each record, shape (n_record, 6), from those of all, (6,), or of each, (n_record, 6).

    Raises
    ------
    InputError
        If the shape is neither, an entry is not finite, or a variance is below zero.
    """
    given = as_numbers(truth, what="truth")
    shape = (6,) if given.ndim == 1 else (n_record, 6)
    known = np.broadcast_to(check_array(given, shape, what="truth"), (n_record, 6))
    negative = np.argwhere(known[:, :3] < 0.0)
    if len(negative):
        record, index = negative[0].tolist()
        raise InputError(
            f"Invalid truth: {STRESSES[index]} of record {record} is {known[record, index]:g}, and a variance is not "
            f"below zero; give the stresses in the order {', '.join(STRESSES)}."
        )
    return known


def prior_at_size(result: xr.DataTree, record: int | str) -> FloatArray:
    """Return draws of the prior's shape R/(uu + vv + ww) times the trace of a record's posterior, shape (n, 6)."""
    return _draws(result, find_record(result, record))[1]


def _draws(result: xr.DataTree, index: int) -> tuple[FloatArray, FloatArray]:
    """Return posterior draws of a record, and draws of the prior's shape at the posterior's size, each (n, 6)."""
    draws = group(result, "posterior")["stress"].isel(record=index).transpose("chain", "draw", "component")
    posterior = draws.values.reshape(-1, 6)
    prior = group(result, "prior")["stress"].values.reshape(-1, 6)
    shape = prior / prior[:, :3].sum(axis=1, keepdims=True)
    size = np.resize(posterior[:, :3].sum(axis=1), len(shape))
    return posterior, shape * size[:, None]


def default_limits(samples: Sequence[FloatArray]) -> FloatArray:
    """Return axis limits, shape (6, 2), that hold the central 99 % of every sample (n, 6)."""
    ends = np.array([np.quantile(sample, [0.005, 0.995], axis=0) for sample in samples])
    low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
    return np.stack([np.where(np.arange(6) < 3, np.minimum(low, 0.0), low), high], axis=1)


def corner_limits(results: Sequence[xr.DataTree], records: Sequence[int | str]) -> FloatArray:
    """Return axis limits, shape (6, 2), that suit corner plots of several results."""
    samples = [
        part for tree, record in zip(results, records, strict=True) for part in _draws(tree, find_record(tree, record))
    ]
    return default_limits(samples)


def _finish_corner(figure: FigureBase, posterior: FloatArray, *, has_truth: bool) -> None:
    axes = np.array(figure.axes).reshape(6, 6)
    low, middle, high = np.quantile(posterior, [0.05, 0.5, 0.95], axis=0)
    for index, name in enumerate(STRESSES):
        panel: Axes = axes[index, index]
        panel.autoscale(axis="y")
        panel.set_ylim(bottom=0.0)
        panel.set_title(
            f"{name} = {middle[index]:.2f} ({low[index]:.2f} to {high[index]:.2f})", fontsize=8, loc="center"
        )
    handles = [
        Line2D([], [], color=POSTERIOR_COLOUR, label="posterior, 68 and 95 %"),
        Line2D([], [], color=PRIOR_COLOUR, linestyle="--", label="prior, at the posterior's size uu + vv + ww"),
    ]
    if has_truth:
        handles.append(Line2D([], [], color=TRUTH_COLOUR, marker="s", label="truth"))
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.98, 0.94), frameon=False, fontsize=10)


def plot_stresses(result: xr.DataTree, *, prob: float = 0.9, truth: ArrayLike | None = None) -> Figure:
    """Draw the six stresses over time, with credible bands.

    Parameters
    ----------
    result : DataTree
        From `fit`.
    prob : float
        Probability of the wide band; the narrow one holds half.
    truth : array_like, shape (6,) or (n_record, 6), optional
        Known stresses to mark, the same for all records or each record's own, m² s⁻².

    Returns
    -------
    figure : Figure
        Six panels: median, central 50 % band and central `prob` band; records that were not fitted or are flagged are
        marked along the bottom.

    Raises
    ------
    InputError
        If the tree is not a result of `fit`, `prob` is not between 0 and 1, or the truth has the wrong shape or is not
        finite.
    """
    check_result(result)
    if not 0.0 < prob < 1.0:
        raise InputError(f"Invalid prob {prob!r}: it must be between 0 and 1.")
    observed = group(result, "observed_data")
    stress = group(result, "posterior")["stress"].transpose("record", "component", "chain", "draw").values
    n_record = len(stress)
    marks = None if truth is None else known_stresses(truth, n_record)
    flat = stress.reshape(n_record, 6, -1)
    levels = [0.5 * (1.0 - prob), 0.25, 0.5, 0.75, 0.5 * (1.0 + prob)]
    bands = np.quantile(flat, levels, axis=-1)  # NaN for records that were not fitted
    has_time = "time" in observed.coords
    when = observed.coords["time"].values if has_time else np.arange(n_record)
    flags = group(result, "sample_stats")["flag"].values
    figure = Figure(figsize=(11.0, 11.0), layout="constrained")
    axes = figure.subplots(6, 1, sharex=True)
    truth_style: dict[str, Any] = {"color": TRUTH_COLOUR, "linewidth": 1.2, "linestyle": "--" if n_record > 1 else ""}
    truth_style["marker"] = "s" if n_record == 1 else "." if n_record < 40 else ""
    for index, (axis, name) in enumerate(zip(axes, STRESSES, strict=True)):
        if n_record == 1:
            axis.errorbar(
                when,
                bands[2, :, index],
                yerr=np.abs(bands[[0, 4], :, index] - bands[2, :, index]),
                fmt="o",
                color=POSTERIOR_COLOUR,
            )
        else:
            axis.fill_between(
                when, bands[0, :, index], bands[4, :, index], color=POSTERIOR_COLOUR, alpha=0.2, linewidth=0
            )
            axis.fill_between(
                when, bands[1, :, index], bands[3, :, index], color=POSTERIOR_COLOUR, alpha=0.4, linewidth=0
            )
            axis.plot(
                when, bands[2, :, index], color=POSTERIOR_COLOUR, linewidth=1.2, marker="." if n_record < 40 else ""
            )
        if marks is not None:
            axis.plot(when, marks[:, index], **truth_style)
        if index >= 3:
            axis.axhline(0.0, color="0.6", linewidth=0.8)
        axis.set_ylabel(f"{name}\n[m² s⁻²]")
        axis.grid(alpha=0.3)
        marked = np.flatnonzero(flags != 0)
        if len(marked):
            axis.plot(
                when[marked],
                np.zeros(len(marked)),
                "|",
                color=PRIOR_COLOUR,
                transform=axis.get_xaxis_transform(),
                clip_on=False,
                markersize=9,
            )
    handles = [
        Line2D([], [], color=POSTERIOR_COLOUR, label="median"),
        Line2D([], [], color=POSTERIOR_COLOUR, alpha=0.4, linewidth=8, label="central 50 %"),
        Line2D([], [], color=POSTERIOR_COLOUR, alpha=0.2, linewidth=8, label=f"central {100 * prob:g} %"),
    ]
    if marks is not None:
        handles.append(Line2D([], [], **truth_style, label="truth"))
    if np.any(flags != 0):
        handles.append(
            Line2D([], [], color=PRIOR_COLOUR, marker="|", linestyle="", markersize=9, label="flagged record")
        )
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    axes[-1].set_xlabel("start of the record (UTC)" if has_time else "record")
    if has_time:
        import matplotlib.dates as mdates  # noqa: PLC0415 - only where dates are drawn

        locator = mdates.AutoDateLocator()  # type: ignore[no-untyped-call]  # matplotlib has no types here
        axes[-1].xaxis.set_major_locator(locator)
        formatter = mdates.ConciseDateFormatter(locator)  # type: ignore[no-untyped-call]  # nor here
        axes[-1].xaxis.set_major_formatter(formatter)
    words = f"{result.attrs['scan']}: {result.attrs['sight']}; prior {result.attrs['prior_name']}"
    figure.suptitle(words, fontsize=11, parse_math=False)  # a name may hold a dollar sign
    return figure
