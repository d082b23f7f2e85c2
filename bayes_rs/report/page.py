"""The page: sections of words, pictures and tables, each only where there are data for it."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

from bayes_rs.fits.flags import FAILURES, FLAG_MEANINGS, FLAGS
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.records.report import describe_report
from bayes_rs.report import figures, words
from bayes_rs.report.availability import Availability, make_availability
from bayes_rs.report.campaign_section import campaign_section
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.series import Series, make_series, time_axis
from bayes_rs.report.tables import flat, folded, interval, lines, number, pairs, table
from bayes_rs.report.turbines import turbine_table
from bayes_rs.report.unsteady import unsteady_table

MOST_FILES = 400
"""Files up to which each has a row of its own."""
MOST_OPTIONS = 1500
"""Records up to which the picker is a list; beyond, a time is typed."""
_SCAN_BOX = '<div class="scroll" tabindex="0" role="region" aria-label="The scan file"><pre>{}</pre></div>'
_UNIT = "m² s⁻²"
_HOUR = 3.6e6  # ms
NO_SAMPLES = "not counted"
_WITHOUT_SCRIPT = (
    '<noscript><p class="note">The pictures need JavaScript. Every picture has a table, which does not.</p></noscript>'
)
_FIRST = 3  # records that are named for each flag


def render(found: ReportData, *, title: str | None = None) -> str:
    """Return the whole page.

    Parameters
    ----------
    found : ReportData
        From `read_folder`.
    title : str, optional
        Heading; by default the scan and the period.

    Returns
    -------
    html : str
        The page, with its style, its script and its data.
    """
    series = make_series(found)
    _, width, timed = time_axis(found)
    availability = make_availability(found.records, _HOUR / width if timed else None)
    data: dict[str, Any] = {
        "stresses": list(STRESSES),
        "prob": found.prob,
        "timed": timed,
        "series": figures.series_data(series),
        "records": figures.records_data(found),
        "flags": FLAGS,
        "availability": figures.availability_data(availability, found),
        "decided": figures.decided_data(found),
        "intensity": figures.intensity_data(found),
        "shape": figures.shape_data(found),
        "diagnostics": figures.diagnostics_data(found),
    }
    sections = [
        ("read", "What was read", _read_section(found, availability)),
        ("stresses", "Stresses over time", _stress_section(found, series)),
        ("turbines", "Turbines", turbine_table(found)),
        ("campaign", "Campaign", campaign_section(found.campaign)),
        ("record", "One record", _record_section(found, timed=timed)),
        ("decided", "What the data said", _decided_section(found, data)),
        ("intensity", "Turbulence intensity", _intensity_section(found, data)),
        ("shape", "Shape of the tensor", _shape_section(found, data)),
        ("diagnostics", "Diagnostics", _diagnostics_section(found)),
        ("provenance", "Provenance", _provenance_section(found)),
    ]
    shown = [section for section in sections if section[2]]
    scan = str(found.run.get("scan", "")) or "unknown scan"
    if title is None:
        title = f"Reynolds stresses, scan {scan}" + (f", {words.period(found)}" if words.period(found) else "")
    style, script = shipped("style.css"), shipped("script.js")
    return fill(
        shipped("template.html"),
        {
            "title": escape(title),
            "lead": escape(_lead(found)),
            "key_numbers": _key_numbers(found, scan),
            "links": "".join(f'<li><a href="#{key}">{escape(heading)}</a></li>' for key, heading, _ in shown),
            "sections": "\n".join(
                f'<section id="{key}" aria-labelledby="{key}-heading"><h2 id="{key}-heading">{escape(heading)}</h2>'
                f"{content}</section>"
                for key, heading, content in shown
            ),
            "without_script": _WITHOUT_SCRIPT,
            "data": as_script_data(data),
            "style": style,
            "script": script,
            "style_hash": content_hash(style),
            "script_hash": content_hash(script),
        },
    )


def fill(template: str, values: dict[str, str]) -> str:
    """Put values in the places ``{{name}}`` of a template, in one pass: what is put in is not looked at again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: values[match.group(1)], template)


def content_hash(text: str) -> str:
    """Return the hash by which a content security policy allows an inline text."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


def as_script_data(data: dict[str, Any]) -> str:
    """Return JSON that no text in it can break out of its element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def shipped(name: str) -> str:
    """Return the text of a file that the report ships."""
    return files("bayes_rs.report").joinpath(name).read_text(encoding="utf-8")


def _figure(kind: str, caption: str, content: str = "", attributes: str = "") -> str:
    """Return the place of a picture, its caption, and its table."""
    return (
        f'<figure><div class="picture" data-figure="{kind}"{attributes}></div>'
        f"<figcaption>{caption}</figcaption>{content}</figure>"
    )


def _key(kind: str, text: str) -> str:
    return f'<span class="key"><span class="swatch {kind}" aria-hidden="true"></span>{escape(text)}</span> '


def _lead(found: ReportData) -> str:
    text = "Bayesian estimate of the six Reynolds stresses from the variances of a Doppler lidar's beams"
    when = words.period(found)
    text += f"{f', records from {when}' if when else ''}."
    text += f" Intervals hold {100.0 * found.prob:g} % probability and are {found.interval}."
    probe = str(found.run.get("probe_volume") or "")
    return f"{text} {probe[:1].upper()}{probe[1:]}." if probe else text


def _key_numbers(found: ReportData, scan: str) -> str:
    fitted = int(found.fitted.sum())
    failed = int(np.count_nonzero(found.flag & FAILURES))
    remarked = int(np.count_nonzero(found.flag)) - failed
    outside = int(np.count_nonzero(found.flag & FLAGS["outside_noise"]))
    without = int(np.count_nonzero(found.flag & FLAGS["no_usable_beam"]))  # gaps are most of them in a long fit
    doubts = len(found.run.get("doubts", []))
    entries = [
        ("Records", f"{len(found.record)}"),
        ("Fitted", f"{fitted}"),
        ("Failed", f"{failed} ({without} without a usable beam)" if without else f"{failed}"),
        ("Other flags", f"{remarked}"),
        *([("Outside the noise's reach", f"{outside}")] if outside else []),
        *([("Not believed", f"{doubts}, in the report of reading")] if doubts else []),
        ("Scan", scan),
    ]
    if found.target:
        entries.append(("Target", found.target))
    if found.prior:
        entries.append(("Prior", found.prior.split(":", 1)[0]))
    noise = found.run.get("noise")
    if isinstance(noise, dict) and "turbulence" in noise:
        entries.append(("Noise", f"{noise.get('method', '')}, {noise['turbulence']}"))
    for title in ("Length scale", "Instrument noise"):
        if said := (found.run.get(title.lower().replace(" ", "_")) or {}).get("words"):
            start = title.lower()
            entries.append((title, str(said).removeprefix(f"{start} ").removeprefix(f"{start}: ")))
    return pairs(entries, "key-numbers")


def _read_section(found: ReportData, availability: Availability) -> str:
    said = describe_report(found.records)
    parts = [lines(said)] if said else []
    parts.append(_count_tables(found.records.attrs))
    what = "Share of the expected samples that were used" if availability.of_samples else "Share of usable beams"
    caption = f"{what}, beam by beam. Above: share of the beams that are usable. " + "".join(
        _key(f"level-{level}", text)
        for level, text in enumerate(("none", "below 50 %", "50 to 80 %", "80 to 95 %", "95 % or more"))
    )
    n_record = len(found.record)
    rows = [
        (
            f"{beam}",
            f"{usable}",
            f"{100.0 * usable / n_record:.1f} %",
            NO_SAMPLES if not np.isfinite(samples) else f"{samples:.0f}",
            number(100.0 * samples / (n_record * availability.expected)) + " %",
        )
        for beam, usable, samples in zip(
            availability.beam_numbers.tolist(),
            availability.beam_usable.tolist(),
            availability.beam_samples.tolist(),
            strict=True,
        )
    ]
    header = ("beam", "usable records", "share", "samples used", "of the expected")
    parts.append(
        _figure(
            "availability",
            caption,
            folded("Table: availability of each beam", table("Availability of each beam", header, rows)),
        )
    )
    return "".join(parts)


def _count_tables(attributes: dict[str, Any]) -> str:
    parts = []
    if "read_report" in attributes:
        report = json.loads(attributes["read_report"])
        columns = ("rows", "rows_invalid_value", "rows_dropped", "samples_out_of_order")
        listed, caption = report["files"], "Rows of each file"
        if len(listed) > MOST_FILES:
            listed = [file for file in listed if any(file.get(column) for column in columns[1:])][:MOST_FILES]
            caption = f"Rows of the first {len(listed)} files with any left out, of {len(report['files'])} files"
        rows = [(file["name"], *(str(file.get(column, "")) for column in columns)) for file in listed]
        header = ("file", "rows", "with an invalid value", "dropped", "out of order")
        parts.append(table(caption, header, rows))
    if "records_report" in attributes:
        report = json.loads(attributes["records_report"])
        counts = [
            ("samples", report["samples"]),
            ("duplicates dropped", report["duplicates_dropped"]),
            *((f"dropped: {name}", count) for name, count in report["dropped"].items()),
            ("samples used", report["samples_used"]),
            ("records", report["records"]),
            ("records without samples", report["records_without_samples"]),
            *(
                (f"flag {name}", f"{counted['count']} of {counted['of']}")
                for kind in ("beam_flags", "record_flags")
                for name, counted in report[kind].items()
            ),
        ]
        parts.append(table("Samples and records", ("what", "count"), counts))
    return folded("Table: counts of what was read and dropped", "".join(parts)) if parts else ""


def _stress_section(found: ReportData, series: Series) -> str:
    if not found.fitted.any():
        return '<p class="note">No record was fitted: see the flags under Diagnostics.</p>'
    percent = f"{100.0 * found.prob:g} %"
    if series.binned:
        what = _width_words(series)
        caption = (
            _key("middle", f"posterior median, median over {what}")
            + _key("band", f"{percent} credible interval of a record, medians of its ends")
            + _key("outer", "where nine tenths of the records' medians are")
        )
    else:
        caption = _key("middle", "posterior median") + _key("band", f"{percent} credible interval")
    caption += (
        _key("failed", "a record failed")
        + _key("remarked", "a record has another flag")
        + '<span class="hint">Click on a panel to choose a record.</span>'
    )
    rows = [
        (
            _start_words(series, index),
            *([str(series.count[index])] if series.binned else []),
            *(
                interval(*(float(values[index, column]) for values in (series.median, series.low, series.high)))
                for column in range(len(STRESSES))
            ),
            _flag_words(series, index),
        )
        for index in range(len(series.start))
    ]
    start = "start (UTC)" if series.timed else "record"
    header = (start, *(["records"] if series.binned else []), *(f"{name}, {_UNIT}" for name in STRESSES), "flagged")
    return f"<p>Median over the records, {_UNIT}: {escape(words.median_words(found))}.</p>" + _figure(
        "stresses",
        caption,
        folded(
            "Table: stresses over time",
            table(f"Posterior medians and {percent} intervals of the stresses", header, rows),
        ),
    )


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


def _record_section(found: ReportData, *, timed: bool) -> str:
    if not found.fitted.any():
        return ""
    rows = figures.picked(found)
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
        + _figure("corner", '<span id="corner-words"></span>', '<div id="chosen-table"></div>')
    )


def _state(found: ReportData, index: int) -> str:
    if found.flag[index] & FAILURES:
        return ", failed"
    return ", flagged" if found.flag[index] else ""


def _decided_section(found: ReportData, data: dict[str, Any]) -> str:
    if data["decided"] is None:
        return ""
    said = lines(words.decided_words(found))
    caption = (
        _key("size", "what the data decided of the stress")
        + "1: it is the data's; 0: it is the prior's; below 0, it leans on the prior more than the prior's own width. "
        "Dots: median record; lines: nine tenths of the records. Least squares (below) uses no prior: all beams count "
        "alike and as points, and a stress that the record's beams do not determine has none."
    )
    header = (
        "stress",
        "decided by the data",
        f"posterior median, {_UNIT}",
        f"least squares, {_UNIT}",
        "its standard error",
        "records that have it",
    )
    content = table(
        "What the data decided (nine tenths of the records), and least squares beside the posterior: median record",
        header,
        words.beside_rows(found),
    )
    along = words.direction_rows(found)
    if along:
        content += table(
            "Directions of R: how far the data narrowed the share that each has of the whole, median record",
            ("direction of R, lidar frame", "weight", "seen", "contraction of shape"),
            along,
        )
    return said + _figure("decided", caption, folded("Table: what the data decided, and least squares", content))


def _intensity_section(found: ReportData, data: dict[str, Any]) -> str:
    known = data["intensity"]
    if known is None:
        return ""
    percent = f"{100.0 * found.prob:g} %"
    caption = (
        (_key("dot", f"records with {percent} intervals") + _key("hollow", "flagged") if "points" in known else "")
        + _key("middle", "median over 1 m/s")
        + (
            ""
            if "points" in known
            else _key("band", "medians of the intervals' ends")
            + _key("outer", "where nine tenths of the records' medians are")
        )
    )
    rows = [
        (
            f"{start} to {start + 1}",
            str(known["count"][index]),
            *(number(known[name][index]) for name in ("median", "low", "high", "spread_low", "spread_high")),
        )
        for index, start in enumerate(known["bin"])
    ]
    header = ("wind speed, m/s", "records", "median TI", "interval from", "to", "5 % of the records", "95 %")
    return "<p>σ_u/U: the root of uu over the mean wind speed of the record, as the beams see it.</p>" + _figure(
        "intensity",
        caption,
        folded("Table: turbulence intensity", table("Turbulence intensity by wind speed", header, rows)),
    )


def _shape_section(found: ReportData, data: dict[str, Any]) -> str:
    if data["shape"] is None:
        return ""
    caption = (
        _key("dot", f"each record: {found.shape.words}")
        + (_key("cloud", "draws of the chosen record") if "draws" in data["records"] else "")
        + _key("chosen", "the chosen record")
        + "The Lumley triangle: every realizable tensor is inside; bottom, all three principal variances are equal; "
        "right corner, only one is not zero; upper curve, one is zero."
    )
    points = found.shape.middle[found.fitted].T
    rows = [
        (name, *(number(value) for value in np.quantile(values, [0.05, 0.5, 0.95]).tolist()))
        for name, values in zip(("ξ", "η"), points, strict=True)
    ]
    content = table("Shape over the records", ("coordinate", "5 %", "median", "95 %"), rows)
    return _figure("shape", caption, folded("Table: shape of the tensor", content))


def _diagnostics_section(found: ReportData) -> str:
    flags = []
    for name, bit in FLAGS.items():
        where = np.flatnonzero(found.flag & bit)
        first = ", ".join(words.when(found, index) for index in where[:_FIRST].tolist())
        more = f" and {len(where) - _FIRST} more" if len(where) > _FIRST else ""
        flags.append(
            (
                name,
                FLAG_MEANINGS.get(name, ""),
                "failure" if bit & FAILURES else "remark",
                first + more or "–",
                str(len(where)),
                f"{100.0 * len(where) / len(found.record):.1f} %",
            )
        )
    header = ("flag", "means", "counts as", "first records", "records", "share")
    content = table("Flags of the records", header, flags, n_text=4) + unsteady_table(found)
    told = found.run.get("beams", {}).get("words", [])
    content += lines([line[0].upper() + line[1:] for line in told]) if told else ""
    limits = figures.diagnostic_limits(found)
    rows = []
    for name, values in figures.worst_diagnostics(found).items():
        known = np.flatnonzero(np.isfinite(values))
        if not len(known):
            continue
        low_is_bad = name.startswith("ess")
        worst = known[np.argmin(values[known]) if low_is_bad else np.argmax(values[known])]
        limit = limits[name]
        rows.append(
            (
                words.DIAGNOSTIC_WORDS[name],
                words.when(found, int(worst)),
                number(float(values[worst])),
                *(number(float(value)) for value in np.quantile(values[known], [0.05, 0.5, 0.95])),
                "none" if limit is None else f"{'below' if low_is_bad else 'above'} {limit:g}",
                str(len(known)),
            )
        )
    if rows:
        columns = ("diagnostic", "worst record", "worst", "5 %", "median", "95 %", "flagged if", "records")
        content += _figure(
            "diagnostics",
            "Records by their diagnostics. " + _key("limit", "limit beyond which a record is flagged"),
            folded("Table: diagnostics", table("Diagnostics over the records", columns, rows, n_text=2)),
        )
    return content


def _provenance_section(found: ReportData) -> str:
    run = dict(found.run)
    text = run.get("scan_toml")
    if isinstance(text, str):
        run["scan_toml"] = "see below"
    entries: Iterable[tuple[str, str]] = flat(run)
    content = table("How the numbers were made: run.json", ("entry", "value"), entries, n_text=2)
    if isinstance(text, str):
        content += folded("The scan, as the scan file that load_scan reads", _SCAN_BOX.format(escape(text)))
    return content
