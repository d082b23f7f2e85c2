"""What a shell completes: names of scans, and of the columns of a table."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from bayes_rs.file_options import FileOptions

_LONGEST = 10_000
"""Characters of the first line of a file that are looked at."""
_TEXT = (".csv", ".txt", ".tsv")
_CHANGES = ("opening_angle_deg", "focus_distance", "tilt_deg", "yaw_deg", "probe", "n_beams", "centre")


class ScanName(click.ParamType):  # type: ignore[type-arg] # generic in new versions of click only
    """A scan: a name of the list, with changes after an @, or a TOML file."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:  # noqa: ARG002 - click's
        """Return the name as it stands: whether there is such a scan is said where it is loaded."""
        return str(value)

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002 - the arguments are click's
        param: click.Parameter,  # noqa: ARG002 - as above
        incomplete: str,
    ) -> list[CompletionItem]:
        """Complete names of scans, after an @ names of changes, and files."""
        from bayes_rs.models import preset_names

        scan, at, changes = incomplete.partition("@")
        if at:
            before, comma, last = changes.rpartition(",")
            return [CompletionItem(f"{scan}@{before}{comma}{name}=") for name in _CHANGES if name.startswith(last)]
        words = [CompletionItem(name) for name in preset_names("scans") if name.startswith(incomplete)]
        return words or [CompletionItem(incomplete, type="file")]


def complete_column(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG001 - click's
    """Complete OURS=THEIRS: our names, and after the = the headings of the first file, if it is a table of text."""
    ours, equals, theirs = incomplete.partition("=")
    if not equals:
        return [CompletionItem(f"{name}=") for name in FileOptions.names if name.startswith(ours)]
    files = [*(ctx.params.get("files") or ()), *ctx.args]  # the latter where the option still lacks its value
    headings = _headings(Path(files[0])) if files else []
    return [CompletionItem(f"{ours}={heading}") for heading in headings if heading.startswith(theirs)]


def _headings(file: Path) -> list[str]:
    """Return the entries of the first line of a table of text; none of another file."""
    if file.suffix.lower() not in _TEXT or not file.is_file():
        return []
    try:
        with file.open(encoding="utf-8-sig", errors="replace") as lines:
            first = lines.readline(_LONGEST).rstrip("\r\n")
        separator = max(",;\t", key=first.count)
        return [heading.strip() for heading in next(csv.reader([first], delimiter=separator), [])]
    except (OSError, csv.Error):
        return []
