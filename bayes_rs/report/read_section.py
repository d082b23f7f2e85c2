"""What was read, what was dropped, and the availability of the beams."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from bayes_rs.records.report import describe_report
from bayes_rs.report.availability import Availability
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import figure, folded, key, lines, number, table

MOST_FILES = 400
"""Files up to which each has a row of its own."""
NO_SAMPLES = "not counted"


def read_section(found: ReportData, availability: Availability) -> str:
    """Return the content of the section."""
    said = describe_report(found.records)
    parts = [lines(said)] if said else []
    parts.append(_count_tables(found.records.attrs))
    what = "Share of the expected samples that were used" if availability.of_samples else "Share of usable beams"
    caption = f"{what}, beam by beam. Above: share of the beams that are usable. " + "".join(
        key(f"level-{level}", text)
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
        figure(
            "availability",
            caption,
            folded("Table: availability of each beam", table("Availability of each beam", header, rows)),
            " data-time",
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
