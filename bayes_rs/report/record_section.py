"""One record: the picker, and the places of its pictures."""

from __future__ import annotations

from html import escape

import numpy as np

from bayes_rs.fits.flags import FAILURES
from bayes_rs.report import words
from bayes_rs.report.figures import picked
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.series import time_axis
from bayes_rs.report.tables import figure

MOST_OPTIONS = 1500
"""Records up to which the picker is a list; beyond, a time is typed."""


def record_section(found: ReportData, *, timed: bool) -> str:
    """Return the content of the section; empty if no record was fitted."""
    if not found.fitted.any():
        return ""
    rows = picked(found)
    first = int(np.argmax(found.fitted[rows]))
    if len(rows) <= MOST_OPTIONS:
        options = "".join(
            f'<option value="{place}"{" selected" if place == first else ""}>{escape(words.when(found, index))}'
            f"{_state(found, index)}</option>"
            for place, index in enumerate(rows.tolist())
        )
        control = f'<select id="pick">{options}</select>'
    elif timed:
        step = max(int(time_axis(found)[1] / 1e3), 1)
        ends = [np.datetime_as_string(found.time[rows[end]], unit="s") for end in (0, -1)]
        value = np.datetime_as_string(found.time[rows[first]], unit="s")
        control = (
            f'<input type="datetime-local" id="pick" min="{ends[0]}" max="{ends[1]}" step="{step}" value="{value}">'
        )
    else:
        control = (
            f'<input type="number" id="pick" min="{found.record[rows[0]]}" max="{found.record[rows[-1]]}" '
            f'value="{found.record[rows[first]]}">'
        )
    label = "Record, by its start (UTC)" if timed else "Record"
    picker = (
        '<div class="picker" role="group" aria-label="Choose a record"><button type="button" id="previous">Previous'
        f'</button><label for="pick">{label}</label>{control}<button type="button" id="next">Next</button>'
        '<button type="button" id="next-flagged">Next flagged</button></div>'
    )
    if len(rows) < len(found.record):
        picker += f'<p class="note">{len(rows)} of {len(found.record)} records, evenly spaced, can be chosen here.</p>'
    return (
        picker
        + '<p id="chosen" aria-live="polite"></p>'
        + figure("corner", '<span id="corner-words"></span>', '<div id="chosen-table"></div>')
    )


def _state(found: ReportData, index: int) -> str:
    if found.flag[index] & FAILURES:
        return ", failed"
    return ", flagged" if found.flag[index] else ""
