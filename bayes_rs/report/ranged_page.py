"""The page of a fit at several ranges: the profile, what each range says, and where the pages of the ranges are."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from html import escape
from typing import Any

from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.records.report import describe_report
from bayes_rs.report.page import content_hash, fill, shipped
from bayes_rs.report.tables import flat, folded, interval, lines, number, pairs, table

_LEAD = (
    "Bayesian estimate of the six Reynolds stresses from the variances of a Doppler lidar's beams, each range by "
    "itself: with its own noise, length scale and campaign."
)
_SALT = "bayes_rs"
"""Makes the names inside a picture the same on every run."""


def render_ranges(found: RangedFit, links: Mapping[int, str], *, title: str | None = None) -> str:
    """Return the whole page.

    Parameters
    ----------
    found : RangedFit
        The fit.
    links : mapping of int to str
        Addresses of the pages of the ranges, by their places, relative to this page.
    title : str, optional
        Heading; by default the scan.

    Returns
    -------
    html : str
        The page, with its style and its picture.
    """
    scan = str(found.run["scan"])
    names, rows = found.range_names, found.profile()
    first = next(iter(found.fits.values()))
    sections = [
        ("profile", "Profile", _picture(found) + _table(rows)),
        ("ranges", "Each range", _ranges(found, names, links)),
        ("doubts", "Flags and doubts", lines([*found.failures, *found.remarks]) if _doubts(found) else ""),
        ("read", "What was read", lines(describe_report(found.records))),
        ("provenance", "Provenance", folded("Settings", pairs(flat(dict(found.run["settings"])), "settings"))),
    ]
    shown = [section for section in sections if section[2]]
    style = shipped("style.css")
    fitted = f"{found.n_fitted} of {found.n_record} records at {len(found.fits)} of {len(found.ranges)} ranges"
    return fill(
        shipped("template.html"),
        {
            "title": escape(title or f"Reynolds stresses at {len(found.ranges)} ranges, scan {scan}"),
            "lead": escape(f"{_LEAD} The scan {first.run['sight']}."),
            "key_numbers": pairs(
                [
                    ("fitted", fitted),
                    ("scan", scan),
                    ("prior", str(first.run["prior_name"])),
                ],
                "key-numbers",
            ),
            "links": "".join(f'<li><a href="#{key}">{escape(heading)}</a></li>' for key, heading, _ in shown),
            "sections": "\n".join(
                f'<section id="{key}" aria-labelledby="{key}-heading"><h2 id="{key}-heading">{escape(heading)}</h2>'
                f"{content}</section>"
                for key, heading, content in shown
            ),
            "without_script": "",
            "data": "{}",
            "style": style,
            "script": "",
            "style_hash": content_hash(style),
            "script_hash": content_hash(""),
        },
    )


def _doubts(found: RangedFit) -> bool:
    return bool(found.failures or found.remarks)


def _picture(found: RangedFit) -> str:
    """Return the profile as a picture in the page."""
    # matplotlib is loaded where there is something to draw
    import matplotlib as mpl  # noqa: PLC0415 - as above

    from bayes_rs.plot.profile_plot import profile  # noqa: PLC0415 - as above

    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": _SALT, "svg.fonttype": "path"}):
        profile(found).savefig(buffer, format="svg", metadata={"Date": None})
    text = base64.b64encode(buffer.getvalue()).decode("ascii")
    words = "Turbulence intensity and stresses over the ranges, with intervals; the table below holds the numbers"
    caption = "A hollow mark is more the prior's than the data's."
    image = f'<img class="picture" alt="{words}" src="data:image/svg+xml;base64,{text}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def _table(rows: Any) -> str:
    what = "height" if "height" in rows else "range"
    quantities = list(dict.fromkeys(rows["quantity"]))
    header = [f"{what}, m", *("TI" if name == "ti" else name for name in quantities)]
    cells = []
    for value, own in rows.groupby(what, sort=True):
        by_name = {row["quantity"]: row for row in own.to_dict("records")}
        cells.append(
            [
                number(float(value)),
                *(
                    interval(row["estimate"], row["low"], row["high"]) + ("*" if is_priors(row["decided"]) else "")
                    for row in (by_name[name] for name in quantities)
                ),
            ]
        )
    percent = 100.0 * float(rows["prob"].iloc[0])
    of = " or ".join(dict.fromkeys(rows["of"]))
    caption = (
        f"Turbulence intensity and stresses, m² s⁻², with {percent:g} % intervals ({of}); *: more the prior's than the "
        "data's"
    )
    return table(caption, header, cells)


def _ranges(found: RangedFit, names: list[str], links: Mapping[int, str]) -> str:
    items = []
    for place, name in enumerate(names):
        own = found.fits.get(place)
        if own is None:
            items.append(f"<li>{escape(name)}: no record can be fitted</li>")
            continue
        told = (own.run.get("length_scale") or {}).get("words", "")
        words = escape(f"{own.n_fitted} of {own.n_record} records{f'; {told}' if told else ''}")
        link = f'<a href="{escape(links[place])}">{escape(name)}</a>' if place in links else escape(name)
        items.append(f"<li>{link}: {words}</li>")
    return f"<ul>{''.join(items)}</ul>"
