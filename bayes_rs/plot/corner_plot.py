"""Corner plots of a record's posterior, with the prior's outline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_array
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.plot.style import POSTERIOR_COLOUR, PRIOR_COLOUR, TRUTH_COLOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEVELS = (0.68, 0.95)
"""Probability inside the contours; corner's own default, "1 sigma", holds 39 % in two dimensions."""


@overload
def corner(
    fit: Fit,
    record: int | str = 0,
    *,
    truth: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    title: str | None = None,
    figure: None = None,
) -> Figure: ...


@overload
def corner(
    fit: Fit,
    record: int | str = 0,
    *,
    truth: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    title: str | None = None,
    figure: FigureBase,
) -> FigureBase: ...


def corner(
    fit: Fit,
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
    fit : Fit
        From `fit` or `open_fit`; it kept its draws.
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
    draw_corner = _corner_of_arrays()
    index = fit.find_record(record)
    posterior, prior = _draws(fit, index)
    if len(posterior) <= len(STRESSES):
        raise InputError(
            f"Record {index} has {len(posterior)} draws, and a corner plot needs more than {len(STRESSES)}: fit again "
            "with a larger target_ess (--ess)."
        )
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
        draw_corner(
            prior,
            color=PRIOR_COLOUR,
            contour_kwargs={"linestyles": ["--"], "linewidths": 1.0},
            hist_kwargs={"linestyle": "--", "density": True},
            labels=labels,
            no_fill_contours=True,
            **common,
        )
        draw_corner(
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
        start = fit.time[index]
        when = "" if np.isnat(start) else f", {np.datetime_as_string(start, unit='m')} UTC"
        title = f"{fit.run['scan']}, record {index}{when}, prior {fit.run['prior_name']}"
    target.suptitle(title, fontsize=12, x=0.98, ha="right", parse_math=False)
    return target


@cache
def _corner_of_arrays() -> Callable[..., Any]:
    """Return the function of the package corner that draws arrays, from its own module `corner.core`.

    `import corner` loads ArviZ too, for objects that are not arrays, and with it numba, if that is installed, which
    compiles as it is loaded: a second of what a short command takes. So that one module is loaded alone, and is not
    entered among the modules: who imports corner elsewhere has all of it.
    """
    package = find_spec("corner")
    if package is None or package.origin is None:
        raise ModuleNotFoundError("No module named 'corner'", name="corner")
    spec = spec_from_file_location("corner.core", Path(package.origin).with_name("core.py"))
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError("No module named 'corner.core'", name="corner.core")
    core = module_from_spec(spec)
    spec.loader.exec_module(core)
    draw: Callable[..., Any] = core.corner_impl
    return draw


def prior_at_size(fit: Fit, record: int | str) -> FloatArray:
    """Return draws of the prior's shape R/(uu + vv + ww) times the trace of a record's posterior, shape (n, 6)."""
    return _draws(fit, fit.find_record(record))[1]


def _draws(fit: Fit, index: int) -> tuple[FloatArray, FloatArray]:
    """Return posterior draws of a record, and draws of the prior's shape at the posterior's size, each (n, 6)."""
    posterior = fit.draws(index).reshape(-1, 6)
    prior = fit.prior_draws
    shape = prior / prior[:, :3].sum(axis=1, keepdims=True)
    size = np.resize(posterior[:, :3].sum(axis=1), len(shape))
    return posterior, shape * size[:, None]


def default_limits(samples: Sequence[FloatArray]) -> FloatArray:
    """Return axis limits, shape (6, 2), that hold the central 99 % of every sample (n, 6)."""
    ends = np.array([np.quantile(sample, [0.005, 0.995], axis=0) for sample in samples])
    low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
    return np.stack([np.where(np.arange(6) < 3, np.minimum(low, 0.0), low), high], axis=1)


def corner_limits(fits: Sequence[Fit], records: Sequence[int | str]) -> FloatArray:
    """Return axis limits, shape (6, 2), that suit corner plots of records of several fits."""
    samples = [part for fit, record in zip(fits, records, strict=True) for part in _draws(fit, fit.find_record(record))]
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
