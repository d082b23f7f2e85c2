"""Lumley's triangle: how anisotropic the turbulence is, with the posterior's uncertainty, and what is the prior's."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.derived import lumley_coordinates
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.fits.record_keys import RecordKey
from bayes_rs.fits.shape_points import ShapePoints, shape_is_priors, shape_points
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.pictures import DATA_MARK, POSTERIOR_COLOUR, PRIOR_COLOUR, PRIOR_MARK, TRUTH_COLOUR, Picture, axes_of
from bayes_rs.plot.density import LEVELS, smooth_pair
from bayes_rs.plot.style import known_stresses

_MOST_DRAWS = 2000
_Given = TypeVar("_Given", bound=Axes)


def lumley(
    fit: Fit, record: RecordKey | None = None, *, truth: ArrayLike | None = None, ax: _Given | None = None
) -> _Given | Picture:
    """Draw the anisotropy of the Reynolds stresses in Lumley's triangle.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`.
    record : int, str, datetime, Timestamp or datetime64, optional
        Number of a record, or its start (UTC; a text is an ISO time), whose draws are shown, if they were kept;
        by default the points of all records, each with its interval.
    truth : array_like, shape (6,) or (n_record, 6), optional
        Known stresses to mark, the same for all records or each record's own, m² s⁻².
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    figure : Figure or Axes
        The axes that were given, or a new figure: the plane of ξ and η, with the border of what is realizable, and the
        outline that holds 68 and 95 % of the prior. The point of a record is hollow and grey where the data decided
        less than half of uu, vv or ww: its shape is mostly the prior's.

    Raises
    ------
    InputError
        If it is no fit, the record does not exist or was not fitted, or the truth has the wrong shape or is not finite.

    Notes
    -----
    6ξ³ = b_ij b_jk b_ki and 6η² = b_ij b_ji with b = R/(2k) − I/3; Pope (2000), Turbulent Flows, Sect. 11.3.2. Left of
    ξ = 0 two principal variances are larger than the third, right of it one is; on the upper border one is zero. A
    record's point is that of `shape_points`: the medians of ``lumley_xi`` and ``lumley_eta`` in its summary.
    """
    check_fit(fit)
    marks = None if truth is None else known_stresses(truth, fit.n_record)
    index = None if record is None else fit.find_record(record)
    axis, given = axes_of(ax, (6.8, 6.0))
    inside = _draw_triangle(axis)
    priors = fit.prior_draws[: 2 * _MOST_DRAWS]
    x, y, density, value = smooth_pair(*lumley_coordinates(priors), positive=(False, True), levels=LEVELS)
    outline = axis.contour(x, y, density, levels=np.sort(value), colors=PRIOR_COLOUR, linestyles="--", linewidths=1.0)
    outline.set_clip_path(inside)
    found = shape_points(fit)
    of_prior = shape_is_priors(fit)
    shown = fit.fitted if index is None else np.arange(fit.n_record) == index
    handles = []
    if index is not None and fit.has_draws:
        draws = fit.draws(index).reshape(-1, len(STRESSES))
        colour = PRIOR_COLOUR if of_prior[index] else POSTERIOR_COLOUR
        step = max(1, len(draws) // _MOST_DRAWS)
        axis.plot(*lumley_coordinates(draws[::step]), ".", color=colour, markersize=2, alpha=0.4, label="draws")
        handles.append(
            Line2D([], [], color=colour, marker=".", markersize=3, linestyle="", label="draws of the record")
        )
    for mask, style, words in (
        (shown & ~of_prior, DATA_MARK, ""),
        (
            shown & of_prior,
            PRIOR_MARK,
            "mostly the prior’s: the data decided\nless than half of uu, vv or ww",
        ),
    ):
        if mask.any():
            _draw_points(axis, found, mask, style, large=index is not None)
            handles.append(Line2D([], [], marker="o", linestyle="", label=words or _point_words(fit, found), **style))
    if not any(line.get_label() == _point_words(fit, found) for line in handles):
        handles.append(Line2D([], [], linestyle="", label=f"points: {_point_words(fit, found)}"))
    handles.append(Line2D([], [], color=PRIOR_COLOUR, linestyle="--", label="prior, 68 and 95 %"))
    if marks is not None:
        points = np.unique(marks[shown], axis=0)
        (drawn,) = axis.plot(
            *lumley_coordinates(points), "s", color=TRUTH_COLOUR, markersize=5, label="truth", zorder=5
        )
        handles.append(drawn)
    axis.legend(handles=handles, loc="upper left", fontsize=8, frameon=False)
    axis.set_title(f"{fit.n_fitted} records" if record is None else f"record {record}", fontsize=10)
    axis.set_xlabel("ξ (no unit)")
    axis.set_ylabel("η (no unit)")
    axis.set_xlim(-0.2, 0.36)
    axis.set_ylim(-0.025, 0.5)
    axis.set_yticks([0.0, 0.1, 0.2, 0.3])
    return given  # type: ignore[return-value] # what was given, or new


def _draw_triangle(axis: Axes) -> Polygon:
    """Draw the border of what is realizable, and return it."""
    xi = np.linspace(-1.0 / 6.0, 1.0 / 3.0, 201)
    upper = np.stack([xi, np.sqrt(np.maximum(1.0 / 27.0 + 2.0 * xi**3, 0.0))], axis=-1)
    border = Polygon(np.concatenate([upper, [[0.0, 0.0]]]), facecolor="none", edgecolor="0.3", linewidth=1.2, zorder=2)
    axis.add_patch(border)
    for place, words, side in (
        ((0.0, 0.0), "isotropic", ("center", "top", 0, -3)),
        ((1.0 / 3.0, 1.0 / 3.0), "one component", ("right", "bottom", 0, 5)),
        ((-1.0 / 6.0, 1.0 / 6.0), "two equal\ncomponents", ("left", "bottom", -18, 12)),
    ):
        horizontal, vertical, right, up = side
        axis.annotate(
            words, place, (right, up), textcoords="offset points", ha=horizontal, va=vertical, fontsize=9, zorder=6
        )
    return border


def _point_words(fit: Fit, found: ShapePoints) -> str:
    """Say what a point and its bars are."""
    if found.low is None:
        return found.words
    return f"{found.words},\n{interval_words(fit.settings['fit']['prob'], fit.settings['fit']['interval'])}"


def _draw_points(
    axis: Axes, found: ShapePoints, mask: NDArray[np.bool_], style: dict[str, Any], *, large: bool
) -> None:
    """Draw the points of some records, with bars where their intervals are known."""
    x, y = found.middle[mask].T
    bars: dict[str, Any] = {}
    if found.low is not None and found.high is not None:
        ends: FloatArray = np.maximum([found.middle - found.low, found.high - found.middle], 0.0)[:, mask]
        # lists: matplotlib 3.10 takes the array of one record for a number
        bars = {"xerr": ends[..., 0].tolist(), "yerr": ends[..., 1].tolist()}
    size: dict[str, Any] = (
        {"markersize": 7, "elinewidth": 1.2, "zorder": 4} if large else {"markersize": 3.5, "elinewidth": 0.4}
    )
    drawn = axis.errorbar(x, y, **bars, fmt="o", **size, **style)
    for line in drawn[2]:
        line.set_alpha(float(np.clip(20.0 / max(len(x), 1), 0.12, 1.0)))  # many bars would hide the points
