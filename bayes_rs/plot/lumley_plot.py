"""Lumley's triangle: how anisotropic the turbulence is, with the posterior's uncertainty."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray
from bayes_rs.fits.derived import lumley_coordinates
from bayes_rs.fits.fit_object import Fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.plot.style import PRIOR_COLOUR, TRUTH_COLOUR, known_stresses

POINT_COLOUR = "#1f4e79"
_MOST_DRAWS = 2000


def lumley(fit: Fit, record: int | str | None = None, *, truth: ArrayLike | None = None) -> Figure:
    """Draw the anisotropy of the Reynolds stresses in Lumley's triangle.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`; it kept its draws.
    record : int or str, optional
        Number of a record, or its start as ISO time (UTC), whose draws are shown; by default the medians of all
        records with the central 68 % of their draws.
    truth : array_like, shape (6,) or (n_record, 6), optional
        Known stresses to mark, the same for all records or each record's own, m² s⁻².

    Returns
    -------
    figure : Figure
        The plane of ξ and η, with the border of what is realizable.

    Raises
    ------
    InputError
        If the fit kept no draws, the record does not exist or was not fitted, or the truth has the wrong
        shape or is not finite.

    Notes
    -----
    6ξ³ = b_ij b_jk b_ki and 6η² = b_ij b_ji with b = R/(2k) − I/3; Pope (2000), Turbulent Flows, Sect. 11.3.2. Left of
    ξ = 0 two principal variances are larger than the third, right of it one is; on the upper border one is zero.
    """
    marks = None if truth is None else known_stresses(truth, fit.n_record)
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axis = figure.subplots()
    xi = np.linspace(-1.0 / 6.0, 1.0 / 3.0, 201)
    axis.plot(xi, np.sqrt(1.0 / 27.0 + 2.0 * xi**3), color="0.3", linewidth=1.2)
    axis.plot([-1.0 / 6.0, 0.0, 1.0 / 3.0], [1.0 / 6.0, 0.0, 1.0 / 3.0], color="0.3", linewidth=1.2)
    for place, words, side in (
        ((0.0, 0.0), "isotropic", ("left", "bottom", 6)),
        ((1.0 / 3.0, 1.0 / 3.0), "one component", ("right", "bottom", -6)),
        ((-1.0 / 6.0, 1.0 / 6.0), "two equal\ncomponents", ("left", "bottom", 0)),
    ):
        axis.annotate(words, place, (side[2], 4), textcoords="offset points", ha=side[0], va=side[1], fontsize=9)
    if record is None:
        _draw_records(axis, _levels(fit))
        axis.set_title(f"{fit.n_fitted} records: medians and central 68 %", fontsize=10)
        shown = fit.fitted
    else:
        index = fit.find_record(record)
        draws = fit.draws(index).reshape(-1, len(STRESSES))
        step = max(1, len(draws) // _MOST_DRAWS)
        axis.plot(*lumley_coordinates(draws[::step]), ".", color=POINT_COLOUR, markersize=2, alpha=0.4)
        axis.plot(*(np.median(part) for part in lumley_coordinates(draws)), "o", color=PRIOR_COLOUR, label="median")
        axis.set_title(f"record {record}: draws of the posterior", fontsize=10)
        shown = np.arange(fit.n_record) == index
    if marks is not None:
        points = np.unique(marks[shown], axis=0)
        axis.plot(*lumley_coordinates(points), "s", color=TRUTH_COLOUR, markersize=5, label="truth", zorder=4)
    if record is not None or marks is not None:
        axis.legend(loc="lower right")
    axis.set_xlabel("ξ")
    axis.set_ylabel("η")
    axis.set_xlim(-0.2, 0.36)
    axis.set_ylim(-0.01, 0.37)
    return figure


def _levels(fit: Fit) -> FloatArray:
    """Return the 16, 50 and 84 % points of ξ and η of the fitted records, shape (2, 3, n_record)."""
    found = [
        [np.quantile(part, (0.16, 0.5, 0.84), axis=1) for part in lumley_coordinates(draws.reshape(len(rows), -1, 6))]
        for rows, draws in fit.batches()
    ]
    return np.concatenate([np.asarray(part) for part in found], axis=-1) if found else np.empty((2, 3, 0))


def _draw_records(axis: Axes, levels: FloatArray) -> None:
    """Draw medians and bars of records."""
    (left, x, right), (low, y, high) = levels
    axis.errorbar(  # lists: matplotlib 3.10 takes the array of one record for a number
        x,
        y,
        xerr=[(x - left).tolist(), (right - x).tolist()],
        yerr=[(y - low).tolist(), (high - y).tolist()],
        fmt="o",
        color=POINT_COLOUR,
        markersize=3,
        linewidth=0.5,
        alpha=0.6,
    )
