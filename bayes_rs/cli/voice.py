"""What commands say, and how much of it: the options that every command has, and the one way to each stream.

Results go to stdout, notes and failures to stderr. On a terminal lines are wrapped to its width, and titles and doubts
have a colour; words never depend on it.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TextIO, TypeVar

import click

_Command = TypeVar("_Command", bound=click.Command)
_KEY = "bayes_rs.voice"
_NARROWEST = 40
"""Columns below which nothing is wrapped."""
TITLE, DOUBT = {"bold": True}, {"fg": "yellow", "bold": True}
"""Styles of the name of a line, and of one that asks for attention."""


@dataclass
class Voice:
    """How much a command says."""

    verbose: bool = False
    quiet: bool = False
    json: bool = False


def _set(context: click.Context, parameter: click.Parameter, value: Any) -> None:
    """Note an option, wherever on the command line it stands."""
    if context.get_parameter_source(str(parameter.name)) is not click.core.ParameterSource.COMMANDLINE:
        return
    if parameter.name == "color":
        context.color = value
        return
    own = voice()
    setattr(own, str(parameter.name), value)
    if parameter.name == "quiet":
        from bayes_rs.progress import hushed

        before = hushed.set(True)
        context.find_root().call_on_close(lambda: hushed.reset(before))
    if own.quiet and (own.verbose or own.json):
        raise click.UsageError(f"--quiet and --{'verbose' if own.verbose else 'json'} ask for opposite things.")


_OPTIONS: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = (
    (("-v", "--verbose"), {"is_flag": True, "help": "Say all: the settings, what was read, how numbers came about."}),
    (("-q", "--quiet"), {"is_flag": True, "help": "Say nothing but errors."}),
    (("--json",), {"is_flag": True, "help": "Write what was found as JSON to the standard output."}),
    (
        ("--color/--no-color",),
        {"default": None, "help": "Colours, or none; by default on a terminal. NO_COLOR and FORCE_COLOR count, too."},
    ),
)


def voice_options(command: _Command) -> _Command:
    """Give a command the options that say how much it says; in the group and behind the command they mean the same."""
    if not any(parameter.name == "verbose" for parameter in command.params):
        command.params += [
            click.Option(names, expose_value=False, is_eager=True, callback=_set, **more) for names, more in _OPTIONS
        ]
    return command


def voice() -> Voice:
    """Return how much the command that runs says."""
    context = click.get_current_context(silent=True)
    if context is None:
        return Voice()
    found: Voice = context.find_root().meta.setdefault(_KEY, Voice())
    return found


def colour_of_environment() -> bool | None:
    """Return what NO_COLOR and FORCE_COLOR say of colours; None where they say nothing."""
    if os.environ.get("NO_COLOR"):
        return False
    return True if os.environ.get("FORCE_COLOR") else None


def tell(words: str = "", *, wrap: bool = True, indent: int = 2) -> None:
    """Say a result, on stdout; a table, or a command to copy, is not wrapped."""
    own = voice()
    if not (own.quiet or own.json):
        click.echo(_wrapped(words, sys.stdout, indent=indent) if wrap else words)


def tell_rows(rows: Iterable[tuple[str, str]], doubtful: str = "") -> None:
    """Say results that have names; the one called `doubtful` stands out where it says something."""
    own, rows = voice(), list(rows)
    if own.quiet or own.json:
        return
    size = max(len(name) for name, _ in rows) + 2
    for name, words in rows:
        text = _wrapped(f"{f'{name}:':<{size}}{words}", sys.stdout, indent=size)
        style = DOUBT if name == doubtful else TITLE
        click.echo(click.style(text[: len(name) + 1], **style) + text[len(name) + 1 :])


def detail(words: str = "", *, wrap: bool = True) -> None:
    """Say a result that only --verbose asks for."""
    if voice().verbose:
        tell(words, wrap=wrap)


def answer(found: Mapping[str, Any]) -> None:
    """Write what was found as JSON, where --json asks for it."""
    if voice().json:
        click.echo(json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False))


def plain_number(value: float) -> float | None:
    """Return a number as JSON has it: null for one that is not known."""
    return float(value) if math.isfinite(value) else None


def note(words: str) -> None:
    """Say on stderr what was done, or what fell short."""
    if not voice().quiet:
        click.echo(_wrapped(words, sys.stderr), err=True)


def note_detail(words: str) -> None:
    """Say on stderr how it is done, where --verbose asks for it."""
    if voice().verbose:
        note(words)


def error(words: str) -> None:
    """Say what is wrong, on stderr, whatever was asked for."""
    click.echo(_wrapped(words, sys.stderr), err=True)


def terminal_width(otherwise: int) -> int:
    """Return the columns of the terminal that stdout is, at most so many; and so many if it is none."""
    if sys.stdout is None or not sys.stdout.isatty():
        return otherwise
    return min(max(shutil.get_terminal_size().columns, _NARROWEST), otherwise)


def _wrapped(words: str, stream: TextIO | None, *, indent: int = 2) -> str:
    """Wrap a line that goes to a terminal."""
    if stream is None or not stream.isatty():
        return words
    width = shutil.get_terminal_size().columns
    if width < _NARROWEST or len(words) <= width:
        return words
    lead = len(words) - len(words.lstrip())
    return textwrap.fill(
        words,
        width,
        subsequent_indent=" " * (lead + indent),
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
        drop_whitespace=True,
    )
