"""The turbines of a fleet: a row for each, with its records and their medians."""

from __future__ import annotations

import numpy as np

from bayes_rs.fits.flags import FAILURES
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.records.layout import TURBINE
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import interval, number, table

MOST_TURBINES = 500
"""Turbines that have a row."""


def turbine_table(found: ReportData) -> str:
    """Return the table of the turbines, in the order of their names; empty if the records do not say theirs.

    Parameters
    ----------
    found : ReportData
        What the report shows.

    Returns
    -------
    html : str
        At most 500 turbines have a row.
    """
    if TURBINE not in found.records:
        return ""
    names, place = np.unique(found.records[TURBINE].values.astype(str), return_inverse=True)
    order = np.argsort(place, kind="stable")
    ends = np.searchsorted(place[order], np.arange(len(names) + 1))
    rows = []
    for index, name in enumerate(names[:MOST_TURBINES].tolist()):
        own = order[ends[index] : ends[index + 1]]
        fitted = own[found.fitted[own]]
        failed = int(np.count_nonzero(found.flag[own] & FAILURES))
        other = int(np.count_nonzero(found.flag[own])) - failed
        rows.append((name, f"{len(own)}", f"{len(fitted)}", f"{failed}", f"{other}", *_medians(found, fitted)))
    header = ("turbine", "records", "fitted", "failed", "other flags", "TI", "wind speed, m/s", *STRESSES)
    words = "Turbines: medians over their records, of the stresses (m² s⁻²) with medians of the intervals' ends"
    if len(names) > MOST_TURBINES:
        words += f"; {MOST_TURBINES} of {len(names)}"
    return table(words, header, rows)


def _medians(found: ReportData, rows: np.ndarray[tuple[int], np.dtype[np.int64]]) -> list[str]:
    """Return the texts of the medians over some records."""
    if not len(rows):
        return ["–"] * (2 + len(STRESSES))
    ti = found.derived["ti"]["median"][rows] if "ti" in found.derived else np.full(len(rows), np.nan)
    values = [np.median(found.numbers[name][rows], axis=0) for name in ("median", "low", "high")]
    middle = [
        number(float(np.nanmedian(one))) if np.isfinite(one).any() else "–" for one in (ti, found.wind_speed[rows])
    ]
    return [*middle, *(interval(*(float(value[index]) for value in values)) for index in range(len(STRESSES)))]
