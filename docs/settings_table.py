"""The tables of options on the page settings.md, made from the classes of options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any

from bayes_rs.fits.settings import SECTIONS
from bayes_rs.options import Option, options_of

MARK = "% the tables of options stand here, made from the classes of options"
HEAD = ("option", "type", "default", "unit", "what it does", "command line")
_MOST_NAMED = 12


def option_tables() -> str:
    """Return a heading and a table for each section of the settings."""
    return "\n\n".join(f"### `[{name}]`\n\n{_table(options)}" for name, options in sections())


def sections() -> Iterator[tuple[str, list[Option]]]:
    """Give each section of a settings file, with its options; options that are a table come after their section."""
    for name, cls in SECTIONS.items():
        options = options_of(cls)
        nested = [entry for entry in options if isinstance(entry.type, type) and is_dataclass(entry.type)]
        yield name, [entry for entry in options if entry not in nested]
        for entry in nested:
            yield f"{name}.{entry.name}", options_of(entry.type)


def _table(options: list[Option]) -> str:
    rows = [HEAD, ("---",) * len(HEAD), *(_row(entry) for entry in options)]
    return "\n".join(f"| {' | '.join(text.replace('|', chr(92) + '|') for text in row)} |" for row in rows)


def _row(entry: Option) -> tuple[str, ...]:
    about = entry.about
    choices = entry.choices if len(entry.choices) <= _MOST_NAMED else ()
    named = f" ({', '.join(f'`{choice}`' for choice in choices)})" if choices else ""
    return (
        f"`{entry.name}`",
        _type(entry.type),
        _default(entry.default),
        about.unit,
        about.help.rstrip(".") + named,
        f"`{entry.flag}`" if entry.flag else "",
    )


def _type(annotation: Any) -> str:
    """Return a type in words, as a settings file has it."""
    words = getattr(annotation, "__name__", "") if isinstance(annotation, type) else str(annotation)
    for old, new in _WORDS.items():
        words = words.replace(old, new)
    kinds = [kind for kind in words.split(" | ") if kind not in ("None", "Prior")]
    return " or ".join(dict.fromkeys(kinds))


_WORDS = {
    "collections.abc.": "",
    "typing.": "",
    "bayes_rs.priors.interface.": "",
    "bayes_rs.noise.noise.": "",
    "tuple[float, float]": "two numbers",
    "tuple[float, float, float]": "three numbers",
    "Sequence[": "list[",
    "Mapping[": "table[",
}


def _default(value: Any) -> str:
    if value is None or (isinstance(value, (tuple, Mapping)) and not value):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"
