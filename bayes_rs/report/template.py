"""The frame of a page: what is put in it, and what allows its own style and script only."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Any

_COMMON = ("numbers", "ticks", "drawing", "tables")
FIT_SCRIPTS = (
    *_COMMON,
    "records",
    "span",
    "points",
    "series",
    "availability",
    "decided",
    "budget",
    "intensity",
    "campaign",
    "reference",
    "beside",
    "density",
    "corner",
    "shape",
    "diagnostics",
    "address",
    "page",
)
"""Parts of the script of the page of a fit, in their order."""
RANGES_SCRIPTS = (*_COMMON, "profile", "address", "ranges_page")
"""Parts of the script of the page of a fit at several ranges."""
Section = tuple[str, str, str]
"""A section: its id, its heading, its content."""


def framed(
    title: str, head: str, sections: Sequence[Section], data: dict[str, Any], scripts: Sequence[str], more: str = ""
) -> str:
    """Return a whole page.

    Parameters
    ----------
    title : str
        Heading, as text.
    head : str
        What stands between heading and sections, as HTML.
    sections : sequence of (id, heading, content)
        Content is HTML; sections without any are left out.
    data : dict
        What the script draws.
    scripts : sequence of str
        Names of the parts of the script.
    more : str
        HTML before the first section.
    """
    shown = [section for section in sections if section[2]]
    style, script = shipped("style.css"), script_of(scripts)
    return fill(
        shipped("template.html"),
        {
            "title": escape(title),
            "head": head,
            "links": "".join(f'<li><a href="#{key}">{escape(heading)}</a></li>' for key, heading, _ in shown),
            "sections": more
            + "\n".join(
                f'<section id="{key}" aria-labelledby="{key}-heading"><h2 id="{key}-heading">{escape(heading)}</h2>'
                f"{content}</section>"
                for key, heading, content in shown
            ),
            "data": as_script_data(data),
            "style": style,
            "script": script,
            "style_hash": content_hash(style),
            "script_hash": content_hash(script),
        },
    )


def script_of(names: Sequence[str]) -> str:
    """Return the parts of a script as one, in a scope of its own."""
    parts = [shipped(f"scripts/{name}.js").rstrip("\n") for name in names]
    return '"use strict";\n(() => {\n' + "\n\n".join(parts) + "\n})();\n"


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
