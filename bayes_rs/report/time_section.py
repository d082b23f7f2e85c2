"""Turbulence intensity and stresses over time, with what chooses the part of the time that is shown."""

from __future__ import annotations

from html import escape

import numpy as np

from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import PRIORS
from bayes_rs.records.layout import TURBINE
from bayes_rs.report import words
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.series import Series
from bayes_rs.report.tables import STAR, UNIT, figure, folded, interval, key, table

_HOUR = 3.6e6  # ms
_BUTTONS = (
    ("earlier", "Earlier", "◀"),
    ("later", "Later", "▶"),
    ("zoom-in", "Zoom in", "+"),
    ("zoom-out", "Zoom out", "−"),
    ("all", "All", ""),
)
"""Id, name and sign of the buttons that change the part of the time."""


def time_section(found: ReportData, series: Series, reference: str = "") -> str:
    """Return the content of the section.

    Parameters
    ----------
    found : ReportData
        What the report shows.
    series : Series
        Its points along time.
    reference : str
        What the reference is called; empty if there is none.
    """
    if not found.fitted.any():
        return '<p class="note">No record was fitted: see the flags under Diagnostics.</p>'
    star = f"; {STAR}" if series.priors.any() else ""
    return (
        f"<p>Median over the records, {UNIT}: {escape(words.median_words(found))}.</p>"
        + _toolbar(found)
        + figure(
            "stresses",
            _caption(found, series, reference),
            folded("Table: over time", _table(found, series, star)),
            " data-time",
        )
    )


def _toolbar(found: ReportData) -> str:
    buttons = "".join(
        f'<button type="button" id="{name}" title="{said}" aria-label="{said}">{sign or said}</button>'
        for name, said, sign in _BUTTONS
    )
    turbines = ""
    if TURBINE in found.records:
        names = np.unique(found.records[TURBINE].values.astype(str)).tolist()
        options = "".join(f'<option value="{place}">{escape(name)}</option>' for place, name in enumerate(names))
        turbines = (
            f'<label for="turbine">Turbine</label><select id="turbine"><option value="">all</option>{options}</select>'
        )
    return (
        '<div class="window" role="group" aria-label="Part of the time that is shown">'
        '<div id="strip" role="slider" tabindex="0" aria-label="Part of the time that is shown: arrow keys move it, '
        'plus and minus zoom, Escape shows all" aria-valuemin="0" aria-valuemax="100" aria-valuenow="50"></div>'
        f'<div class="picker">{turbines}{buttons}<span id="span" aria-live="polite"></span></div></div>'
    )


def _caption(found: ReportData, series: Series, reference: str) -> str:
    called = interval_words(found.prob, found.interval)
    if series.binned:
        what = _width_words(series)
        caption = (
            key("middle", f"posterior median, median over {what}")
            + key("band", f"{called}, of a record: medians of its ends")
            + key("outer", "where nine tenths of the records' medians are")
        )
    else:
        caption = key("middle", "posterior median") + key("band", called)
    if series.priors.any():
        caption += key("hatch", f"hatched grey, dashed line: {PRIORS}")
    return (
        caption
        + (key("room", "the prior's interval at the size that was found") if np.isfinite(series.room).any() else "")
        + (key("reference", reference) if reference else "")
        + key("failed", "a record failed")
        + key("remarked", "a record has another flag")
        + '<span class="hint">Drag across a panel to zoom, click to choose a record, click twice for all of the time. '
        "With more than 1000 records, bins give way to hours and records as you zoom.</span>"
    )


def _table(found: ReportData, series: Series, star: str) -> str:
    columns = [
        (name, series.median[:, c], series.low[:, c], series.high[:, c], series.priors[:, c])
        for c, name in enumerate(STRESSES)
    ]
    known = series.intensity
    if known:
        columns.insert(0, ("TI", known["median"], known["low"], known["high"], series.priors[:, 0]))
    rows = [
        (
            _start_words(series, index),
            *([str(series.count[index])] if series.binned else []),
            *(
                interval(float(middle[index]), float(low[index]), float(high[index]), priors=bool(priors[index]))
                for _, middle, low, high, priors in columns
            ),
            _flag_words(series, index),
        )
        for index in range(len(series.start))
    ]
    start = "start (UTC)" if series.timed else "record"
    names = [name if name == "TI" else f"{name}, {UNIT}" for name, *_ in columns]
    header = (start, *(["records"] if series.binned else []), *names, "flagged")
    called = interval_words(found.prob, found.interval)
    return table(f"Posterior medians, each with its {called}{star}", header, rows)


def _width_words(series: Series) -> str:
    if not series.timed:
        return f"{series.width:.0f} records"
    hours = round(series.width / _HOUR)
    return f"{hours} h" if hours < 48 else f"{hours // 24} days"


def _start_words(series: Series, index: int) -> str:
    if not series.timed:
        return f"{series.start[index]:.0f}"
    return words.stamp(np.datetime64(round(series.start[index] * 1e6), "ns"))


def _flag_words(series: Series, index: int) -> str:
    failed, remarked = int(series.n_failed[index]), int(series.n_remarked[index])
    if series.binned:
        return f"{failed} failed, {remarked} other" if failed or remarked else ""
    return "failed" if failed else "other" if remarked else ""
