"""Tables and lists in HTML: everything that comes from a file is escaped here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

NO_VALUE = "–"
_MINUS = re.compile(r"(?<=[ (])-(?=\d)")
UNIT = "m² s⁻²"
STAR = "*: mostly the prior's"
"""What the star of `interval` means."""


def number(value: float | None, digits: int = 3) -> str:
    """Write a number with so many significant digits, a true minus, and a dash where there is none."""
    if value is None or not np.isfinite(value):
        return NO_VALUE
    magnitude = abs(value)
    if magnitude != 0.0 and (magnitude < 1e-4 or magnitude >= 1e6):
        text = f"{value:.{digits - 1}e}"
    elif magnitude >= 10.0**digits:
        text = f"{value:.0f}"
    else:
        places = digits - 1 - int(np.floor(np.log10(magnitude))) if magnitude > 0.0 else digits - 1
        text = f"{value:.{max(places, 0)}f}"
    return text.replace("-", "−")


def interval(middle: float, low: float, high: float, *, priors: bool = False, digits: int = 3) -> str:
    """Write a number with its interval; a star marks what is mostly the prior's."""
    if not np.isfinite(middle):
        return NO_VALUE
    middle_words, *ends = (number(value, digits) for value in (middle, low, high))
    return f"{middle_words}{'*' if priors else ''} ({ends[0]} to {ends[1]})"


def table(caption: str, header: Sequence[str], rows: Iterable[Sequence[Any]], *, n_text: int = 1) -> str:
    """Return an HTML table in a box that scrolls by itself.

    Parameters
    ----------
    caption : str
        What the table holds.
    header : sequence of str
        Headings of the columns.
    rows : iterable of sequences
        Cells; the first of each row is its heading.
    n_text : int
        Columns from the left that hold text; the others hold numbers.

    Returns
    -------
    html : str
        The table.
    """
    kinds = ["" if column < n_text else ' class="n"' for column in range(len(header))]
    head = "".join(f'<th scope="col"{kind}>{escape(name)}</th>' for name, kind in zip(header, kinds, strict=True))
    body = []
    for row in rows:
        first, *others = [escape(str(cell)) for cell in row]
        cells = "".join(f"<td{kind}>{cell}</td>" for cell, kind in zip(others, kinds[1:], strict=True))
        body.append(f'<tr><th scope="row">{first}</th>{cells}</tr>')
    label = escape(caption, quote=True)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{label}"><table><caption>{escape(caption)}'
        f"</caption><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def folded(summary: str, content: str) -> str:
    """Return content that is shown on request."""
    return f"<details><summary>{escape(summary)}</summary>{content}</details>"


def lines(texts: Iterable[str]) -> str:
    """Return a list of texts, whose negative numbers get a true minus."""
    items = (f"<li>{escape(_MINUS.sub('−', text))}</li>" for text in texts)
    return f"<ul>{''.join(items)}</ul>"


def pairs(entries: Iterable[tuple[str, str]], kind: str) -> str:
    """Return a list of names and values."""
    items = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in entries)
    return f'<dl class="{kind}">{items}</dl>'


def flat(content: Any, name: str = "") -> list[tuple[str, str]]:
    """Return nested dictionaries as names with dots and values in words."""
    if isinstance(content, dict):
        return [pair for key, value in content.items() for pair in flat(value, f"{name}.{key}" if name else str(key))]
    if isinstance(content, list):
        texts = [str(value) for value in content]
        return [(name, ("; " if any(", " in text for text in texts) else ", ").join(texts) or "none")]
    return [(name, "none" if content is None else str(content))]


def figure(kind: str, caption: str, content: str = "", attributes: str = "") -> str:
    """Return the place of a picture, its caption, and its table."""
    return (
        f'<figure><div class="picture" data-figure="{kind}"{attributes}></div>'
        f"<figcaption>{caption}</figcaption>{content}</figure>"
    )


def key(kind: str, text: str) -> str:
    """Return an entry of a legend: a mark, and its words."""
    return f'<span class="key"><span class="swatch {kind}" aria-hidden="true"></span>{escape(text)}</span> '
