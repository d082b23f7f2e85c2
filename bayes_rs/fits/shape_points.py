"""Where a record stands in Lumley's triangle: one point, the same in pictures, tables and the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.derived import lumley_coordinates
from bayes_rs.fits.fit_object import Fit
from bayes_rs.posteriors.decided import is_priors

SHAPE_NAMES = ("lumley_xi", "lumley_eta")


@dataclass(frozen=True, eq=False)
class ShapePoints:
    """Points of records in Lumley's triangle.

    Parameters
    ----------
    middle : ndarray, shape (n_record, 2)
        ξ and η; NaN where a record was not fitted.
    low, high : ndarray, shape (n_record, 2), or None
        Ends of their intervals; None where they are not known.
    words : str
        What a point is.
    """

    middle: FloatArray
    low: FloatArray | None
    high: FloatArray | None
    words: str


def shape_points(fit: Fit, table: pd.DataFrame | None = None) -> ShapePoints:
    """Return the point of each record in Lumley's triangle.

    Parameters
    ----------
    fit : Fit
        The fit.
    table : DataFrame, optional
        Its summary with ``lumley_xi`` and ``lumley_eta``, where it is there already.

    Returns
    -------
    points : ShapePoints
        Medians and intervals of ``lumley_xi`` and ``lumley_eta`` as `Fit.summary` gives them; of a fit that kept
        neither draws nor these, ξ and η of the posterior mean of R.

    Notes
    -----
    ξ and η are functions of R that curve, so that they are taken of each draw: the posterior mean of R is closer to
    isotropy than nearly all draws where R is not well known, and would stand outside their cloud.
    """
    if table is None and not fit.has_draws and not set(SHAPE_NAMES) <= set(fit.settings["fit"]["derived"]):
        mean = fit.of_stresses("mean")["mean"]
        middle = np.full((fit.n_record, 2), np.nan)
        known = np.isfinite(mean).all(axis=1)
        middle[known] = np.stack(lumley_coordinates(mean[known]), axis=-1)
        return ShapePoints(middle, None, None, "of the posterior mean of R (no draws were kept)")
    if table is None:
        own = tuple(fit.settings["fit"]["derived"])
        table = fit.summary(derived=own if set(SHAPE_NAMES) <= set(own) else SHAPE_NAMES)
    found = {
        name: np.stack(
            [table.loc[table["stress"] == one, name].to_numpy(dtype=np.float64) for one in SHAPE_NAMES], axis=-1
        )
        for name in ("median", "low", "high")
    }
    return ShapePoints(found["median"], found["low"], found["high"], "medians of the posterior")


def shape_is_priors(fit: Fit) -> NDArray[np.bool_]:
    """Tell of which records the shape is mostly the prior's, shape (n_record,): less than half of uu, vv or ww decided.

    A principal variance hangs on all of R, and no shape is known whose variances are not.
    """
    return np.asarray(is_priors(fit.of_stresses("decided")["decided"][:, :3]).any(axis=1))
