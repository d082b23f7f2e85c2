"""One record: its posterior as intervals, a table and a corner plot, and its spectra."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import FigureBase

from bayes_rs import plot
from bayes_rs.app.charts import Chart, intervals_chart
from bayes_rs.app.opening import Opened
from bayes_rs.app.site import html
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.plot.style import prior_band
from bayes_rs.posteriors.decided import is_priors

if TYPE_CHECKING:
    from bayes_rs.fits.fit_object import Fit

_COLUMNS = ("record", "stress", "median", "low", "high", "decided", "flag")


def record_rows(fit: Fit, record: int) -> pd.DataFrame:
    """Return the six stresses of a record: median, ends of the interval, and what the data decided.

    Raises
    ------
    InputError
        If the record was not fitted.
    """
    number = fit.find_record(record)
    rows = fit.summary(records=[number], columns=_COLUMNS)
    return rows[rows["stress"].isin(STRESSES)].reset_index(drop=True)


def record_table(rows: pd.DataFrame, which: str) -> Any:
    """Return the numbers of a record as a table."""
    own = is_priors(rows["decided"].to_numpy())
    body = [
        html.Tr(
            [
                html.Th(row["stress"], scope="row"),
                *(html.Td(f"{row[name]:.3g}") for name in ("median", "low", "high")),
                html.Td(f"{row['decided']:.2f}"),
                html.Td("the prior’s" if is_own else "measured"),
            ],
            className="priors" if is_own else "",
        )
        for row, is_own in zip(rows.to_dict("records"), own, strict=True)
    ]
    head = ("stress", "median", "low", "high", "decided by the data", "whose it is")
    return html.Table(
        [
            html.Caption(f"Stresses in m² s⁻², with their {which}; decided: 1 the data, 0 the prior"),
            html.Thead(html.Tr([html.Th(name, scope="col") for name in head])),
            html.Tbody(body),
        ]
    )


def record_chart(fit: Fit, rows: pd.DataFrame, theme: str) -> Chart:
    """Return the intervals of a record as a chart, beside the prior at the record's size."""
    middle, low, high = (rows[name].to_numpy(dtype=np.float64) for name in ("median", "low", "high"))
    prob, kind = float(fit.settings["fit"]["prob"]), str(fit.settings["fit"]["interval"])
    ends = prior_band(fit, prob, kind, rows["record"].to_numpy(dtype=np.int64)[:1])[:, 0]
    of_prior = is_priors(rows["decided"].to_numpy()).tolist()
    return intervals_chart(middle, low, high, ends, of_prior, interval_words(prob, kind), theme)


def corner_of(fit: Fit, record: int) -> Callable[[], FigureBase]:
    """Return what draws the corner plot of a record."""
    return lambda: plot.corner(fit, record)


def spectra_of(opened: Opened, record: int) -> Callable[[], FigureBase]:
    """Return what draws the spectra of a record.

    Raises
    ------
    InputError
        If there are none.
    """
    if opened.spectra is None:
        raise InputError("There are no spectra here.")
    some = opened.spectra.isel(record=[record])
    fitted = None if opened.spectra_fit is None else opened.spectra_fit.isel(record=[record])
    return lambda: plot.spectra(some, fitted)
