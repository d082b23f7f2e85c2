"""The records with a front or a trend: by how much the wind changes, and what that adds to the stresses."""

from __future__ import annotations

import numpy as np

from bayes_rs.fits.flags import FLAGS
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import number, table
from bayes_rs.report.words import when

COLUMNS = {
    "wind_change": "along the wind, m/s",
    "cross_wind_change": "across, m/s",
    "change_uu": "adds to uu, m² s⁻²",
    "change_vv": "to vv",
    "change_uv": "to uv",
}
"""Variables of the records that are shown."""
_MOST = 50


def unsteady_table(found: ReportData) -> str:
    """Return the table of the unsteady records, the largest changes first; empty if there are none.

    Parameters
    ----------
    found : ReportData
        What the report shows.

    Returns
    -------
    html : str
        At most 50 records are listed.
    """
    rows = np.flatnonzero(found.flag & FLAGS["unsteady"])
    if len(rows) == 0 or any(name not in found.records for name in COLUMNS):
        return ""
    values = np.column_stack([np.asarray(found.records[name].values, dtype=np.float64) for name in COLUMNS])
    rows = rows[np.argsort(-values[rows, 2] - values[rows, 3], kind="stable")]
    cells = [[when(found, int(row)), *(number(value) for value in values[row])] for row in rows[:_MOST].tolist()]
    words = "Unsteady records: the wind changes as by a front or a trend, and the stresses hold what that adds"
    if len(rows) > _MOST:
        words += f"; {_MOST} of {len(rows)}"
    return table(words, ("record", *COLUMNS.values()), cells)
