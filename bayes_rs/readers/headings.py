"""Headings of columns taken apart: their words, their unit, and a number that is a gate's or its metres."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from bayes_rs.errors import InputError

IS_RATIO = re.compile(r"[\[(]\s*1\s*[\])]")  # the unit of a plain ratio
_BRACKETS = re.compile(r"\s*[\[(]([^\[\]()]*)[\])]\s*")
_UNIT_AT_END = re.compile(r"(.+?) (deg(?:rees?)?|rad(?:ians?)?|m(?:et(?:er|re)s?)?|km|db|m s(?: 1)?|ms 1|mps)")
_NUMBER = re.compile(r"(?<![a-z0-9.])(\d+(?:\.\d+)?)(?: ?(m)(?:et(?:er|re)s?)?)?(?![a-z0-9.])")
_FILLER = re.compile(r"\b(?:at|gate|of|in|the)\b")
SAYS_PLACE = {
    "distance": re.compile(r"\b(?:range|distance|dist)\b"),
    "height": re.compile(r"\b(?:height|altitude)\b"),
}


@dataclass(frozen=True)
class Heading:
    """A heading taken apart.

    Parameters
    ----------
    own : str
        As in the file.
    words : str
        Its words in lower case, without unit; without its number, too, if it has just one.
    unit : str
        What stands in brackets or at the end, in lower case; empty if nothing does.
    number : float, optional
        The number in it.
    metres : bool
        Whether the number is followed by m.
    place : str, optional
        ``distance`` or ``height``, if a word beside the number says so.
    """

    own: str
    words: str
    unit: str
    number: float | None = None
    metres: bool = False
    place: str | None = None


def take_apart(own: str) -> Heading:
    """Take a heading apart.

    Examples
    --------
    >>> take_apart("Radial Wind Speed [m/s]")
    Heading(own='Radial Wind Speed [m/s]', words='radial wind speed', unit='m/s', number=None, metres=False, place=None)
    >>> found = take_apart("RWS_100m")
    >>> found.words, found.number, found.metres
    ('rws', 100.0, True)
    """
    text, unit = own.strip(), ""
    for inside in _BRACKETS.findall(text):
        text = text.replace(f"[{inside}]", " ").replace(f"({inside})", " ")
        if re.fullmatch(r"\s*\d+(?:\.\d+)?\s*m?\s*", inside):
            text += f" {inside}"
        else:
            unit = inside.strip().lower()
    text = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", " ", text).lower()
    text = re.sub(r"(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])", " ", text)
    text = " ".join(re.sub(r"(?<!\d)\.|\.(?!\d)|[^\w.]|_", " ", text).split())
    at_end = _UNIT_AT_END.fullmatch(text)
    if at_end and not unit and not re.search(r"\d$", at_end[1]):
        text, unit = at_end[1], {"m s": "m/s", "m s 1": "m/s", "ms 1": "m/s", "mps": "m/s"}.get(at_end[2], at_end[2])
    numbers = _NUMBER.findall(text)
    if len(numbers) != 1:
        return Heading(own, text, unit)
    rest = _NUMBER.sub(" ", text)
    place = next((name for name, word in SAYS_PLACE.items() if word.search(rest)), None)
    words = " ".join(_FILLER.sub(" ", rest).split())
    return Heading(own, words, unit, float(numbers[0][0]), bool(numbers[0][1]), place)


def unknown_unit(file: Path, heading: Heading, allowed: str) -> InputError:
    """Return the error to raise for a unit that is not read."""
    return InputError(
        f"Unknown unit {heading.unit[:40] or '1'!r} in the heading {heading.own[:60]!r} of file {str(file)!r}: it "
        f"must be {allowed}; rename the column."
    )
