"""What the data said, turbulence intensity by wind speed, and the shape of the tensor."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import PRIORS
from bayes_rs.report import words
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import UNIT, figure, folded, key, lines, number, table


def decided_section(found: ReportData, data: dict[str, Any]) -> str:
    """Return the content of the section: what the data decided, and least squares beside the posterior."""
    if data["decided"] is None:
        return ""
    said = lines(words.decided_words(found))
    caption = (
        key("size", "what the data decided of the stress")
        + key("size priors", PRIORS)
        + "1: it is the data's; 0: it is the prior's; below 0, it leans on the prior more than the prior's own width. "
        "Dots: median record; lines: nine tenths of the records. Least squares (below) uses no prior: all beams count "
        "alike and as points, and a stress that the record's beams do not determine has none."
    )
    header = (
        "stress",
        "decided by the data",
        f"posterior median, {UNIT}",
        f"least squares, {UNIT}",
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
    return said + figure("decided", caption, folded("Table: what the data decided, and least squares", content))


def intensity_section(found: ReportData, data: dict[str, Any]) -> str:
    """Return the content of the section: turbulence intensity by wind speed."""
    known = data["intensity"]
    if known is None:
        return ""
    called = interval_words(found.prob, found.interval)
    caption = (
        (key("dot", f"records, each with its {called}") + key("hollow", "flagged") if "points" in known else "")
        + key("middle", "median over 1 m/s")
        + (key("hatch", f"hatched, dashed or hollow grey: {PRIORS}") if 1 in known["priors"] else "")
        + (
            ""
            if "points" in known
            else key("band", f"medians of the ends of the {called}")
            + key("outer", "where nine tenths of the records' medians are")
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
    return "<p>σ_u/U: the root of uu over the mean wind speed of the record, as the beams see it.</p>" + figure(
        "intensity",
        caption,
        folded("Table: turbulence intensity", table("Turbulence intensity by wind speed", header, rows)),
    )


def shape_section(found: ReportData, data: dict[str, Any]) -> str:
    """Return the content of the section: the Lumley triangle."""
    if data["shape"] is None:
        return ""
    caption = (
        (key("dot", f"each record: {found.shape.words}") if 0 in data["shape"]["priors"] else "")
        + (key("dot priors", f"hollow grey: {PRIORS} of uu, vv or ww") if 1 in data["shape"]["priors"] else "")
        + (key("cloud", "draws of the chosen record, grey if prior's") if "draws" in data["records"] else "")
        + key("chosen", f"the chosen record: {found.shape.words}")
        + "The Lumley triangle: every realizable tensor is inside; bottom, all three principal variances are equal; "
        "right corner, only one is not zero; upper curve, one is zero."
    )
    points = found.shape.middle[found.fitted].T
    rows = [
        (name, *(number(value) for value in np.quantile(values, [0.05, 0.5, 0.95]).tolist()))
        for name, values in zip(("ξ", "η"), points, strict=True)
    ]
    content = table("Shape over the records", ("coordinate", "5 %", "median", "95 %"), rows)
    return figure("shape", caption, folded("Table: shape of the tensor", content))
