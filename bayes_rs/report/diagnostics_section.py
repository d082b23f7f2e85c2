"""Flags and diagnostics of the records."""

from __future__ import annotations

import numpy as np

from bayes_rs.fits.flags import FAILURES, FLAG_MEANINGS, FLAGS
from bayes_rs.report import figures, words
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import figure, folded, key, lines, number, table
from bayes_rs.report.unsteady import unsteady_table

_FIRST = 3
"""Records that are named for each flag."""


def diagnostics_section(found: ReportData) -> str:
    """Return the content of the section."""
    flags = []
    for name, bit in FLAGS.items():
        where = np.flatnonzero(found.flag & bit)
        if not len(where):
            continue
        first = ", ".join(words.when(found, index) for index in where[:_FIRST].tolist())
        more = f" and {len(where) - _FIRST} more" if len(where) > _FIRST else ""
        flags.append(
            (
                name,
                FLAG_MEANINGS.get(name, ""),
                "failure" if bit & FAILURES else "remark",
                first + more,
                str(len(where)),
                f"{100.0 * len(where) / len(found.record):.1f} %",
            )
        )
    header = ("flag", "means", "counts as", "first records", "records", "share")
    content = table("Flags of the records", header, flags, n_text=4) if flags else "<p>No record has a flag.</p>"
    content += unsteady_table(found)
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
        content += figure(
            "diagnostics",
            "Records by their diagnostics. " + key("limit", "limit beyond which a record is flagged"),
            folded("Table: diagnostics", table("Diagnostics over the records", columns, rows, n_text=2)),
        )
    return content
