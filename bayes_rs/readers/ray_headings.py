"""Which column of a table of rays is which: by the words of its heading, and by what the caller says."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from bayes_rs.errors import InputError
from bayes_rs.readers.headings import IS_RATIO, SAYS_PLACE, Heading, take_apart, unknown_unit
from bayes_rs.readers.table import Table

NEEDED = ("time", "azimuth", "elevation", "radial_velocity")
_OPTIONAL = ("cnr", "status")
_PLACES = ("distance", "height", "gate")
"""What may say where a gate is; the first that is there counts."""

_OF_BEAM = r"(?:(?:beam|los|ray|laser|sensor|scan|scanner) )?"
_VELOCITY = r"(?:radial|los|line of sight|doppler)(?: wind)? (?:speed|velocity|vel)"
_WORDS = {
    "time": (
        r"(?:utc )?(?:time|time ?stamp|date ?time|date (?:and )?time|time (?:and )?date|date)(?: (?:utc|iso))?",
        r"(?:(?:start|begin|ray) time|time (?:start|begin))(?: utc)?",
    ),
    "azimuth": (_OF_BEAM + r"(?:azimuth|azim|azi|az)(?: angle)?",),
    "elevation": (_OF_BEAM + r"(?:elevation|elev|ele|el)(?: angle)?",),
    "radial_velocity": (_VELOCITY, r"rws|v ?r|vrad|v ?los|doppler|radial wind|rad vel|vel rad"),
    "cnr": (r"cnr|carrier to noise(?: ratio)?", r"snr|signal to noise(?: ratio)?"),
    "status": (rf"status|(?:{_VELOCITY}|rws) status", r"quality(?: flag)?|qc(?: flag)?"),
    "distance": (
        r"(?:(?:slant|radial|focus|los|line of sight|gate|measurement) )?(?:range|distance|dist)",
        r"range gate (?:distance|cent(?:er|re))|gate cent(?:er|re)|distance to gate",
    ),
    "height": (r"(?:(?:measurement|gate) )?(?:height|altitude)(?: above (?:the )?(?:lidar|instrument|sensor))?",),
    "gate": (r"(?:range )?gate(?: (?:number|index|no|id))?|gate index",),
}
"""Headings in lower case, without units and signs; of the last six the first pattern that fits counts."""
_FIRST_COUNTS = ("cnr", "status", "distance", "height", "gate")


@dataclass(frozen=True)
class RayColumns:
    """The columns of a table of rays.

    Parameters
    ----------
    time : tuple of Heading
        One column, or one of dates and one of times of the day.
    azimuth, elevation : Heading
    radial_velocity, cnr, status : tuple of Heading
        One, or one for each gate; empty for what the table does not have.
    place : str
        What says where the gates are: ``distance``, ``height`` or ``gate``.
    place_columns : tuple of Heading
        Its columns, one or one for each gate; empty if the numbers in the headings are it.
    heights : tuple of Heading
        Columns of heights beside those of distances, which they must agree with.
    per_gate : bool
        Whether a row is a whole ray, with a column for each gate.
    """

    time: tuple[Heading, ...]
    azimuth: Heading
    elevation: Heading
    radial_velocity: tuple[Heading, ...]
    cnr: tuple[Heading, ...]
    status: tuple[Heading, ...]
    place: str
    place_columns: tuple[Heading, ...]
    heights: tuple[Heading, ...]
    per_gate: bool


def find_ray_columns(table: Table) -> RayColumns:
    """Find the columns of a table of rays.

    Raises
    ------
    InputError
        If one is missing, or could be several. The message lists them and says how to name one.
    """
    headings = [take_apart(heading) for heading in table.headings]
    azimuth, elevation = (_needed(table, headings, name) for name in ("azimuth", "elevation"))
    velocity = _columns(table, headings, "radial_velocity")
    if not velocity:
        raise _missing(table, "radial_velocity")
    per_gate = len(velocity) > 1 or (
        velocity[0].number is not None
        and velocity[0].own not in _mapped(table, "radial_velocity")
        and all(heading.number is not None for name in _PLACES for heading in _candidates(table, headings, name))
    )
    in_decibels = [heading for heading in headings if heading.unit in ("", "db") and not IS_RATIO.search(heading.own)]
    of = {"cnr": headings if "cnr" in table.file_format.columns else in_decibels, "status": headings}
    others = {name: _beside(_columns(table, of[name], name), velocity, per_gate) for name in _OPTIONAL}
    if others["cnr"] and others["cnr"][0] not in in_decibels:
        raise unknown_unit(table.file, others["cnr"][0], "dB")
    for name in _OPTIONAL:
        if name in table.file_format.required and not others[name]:
            raise _missing(table, name)
    place, columns = _place(table, headings, velocity, per_gate=per_gate)
    return RayColumns(
        time=_time(table, headings),
        azimuth=azimuth,
        elevation=elevation,
        radial_velocity=velocity,
        cnr=others["cnr"],
        status=others["status"],
        place=place,
        place_columns=columns,
        heights=_heights(table, headings, velocity, per_gate=per_gate) if place == "distance" and columns else (),
        per_gate=per_gate,
    )


def looks_like_rays(table: Table) -> bool:
    """Say whether a table has columns for an azimuth, an elevation and a radial velocity, and none for a beam."""
    headings = [take_apart(heading) for heading in table.headings]
    return not table.has("beam") and all(
        _candidates(table, headings, name) for name in ("azimuth", "elevation", "radial_velocity")
    )


def _mapped(table: Table, name: str) -> tuple[str, ...]:
    """Return what the caller, or the scan, says that the file calls `name`."""
    columns = table.file_format.columns
    names = ("distance", "range") if name == "distance" else (name,)
    return tuple(columns[own] for own in names if own in columns)


def _candidates(table: Table, headings: Iterable[Heading], name: str) -> list[Heading]:
    mapped = _mapped(table, name)
    if mapped:
        exact = [heading for heading in headings if heading.own == mapped[0]]
        if exact:
            return exact
        words = take_apart(mapped[0]).words
        return [heading for heading in headings if heading.number is not None and heading.words == words]
    taken = set(table.file_format.columns.values())
    free = [heading for heading in headings if heading.own not in taken]
    patterns = _WORDS[name]
    found: list[Heading] = []
    for pattern in patterns:
        fits = [heading for heading in free if re.fullmatch(pattern, _words_of(heading, name))]
        if name in _FIRST_COUNTS and fits:
            return fits
        found += fits
    return [heading for heading in free if heading in found]


def _words_of(heading: Heading, name: str) -> str:
    """Return the words to compare; a word beside the number that says what the number is is none of them."""
    if heading.number is None or heading.place is None or name in _PLACES:
        return heading.words
    return " ".join(SAYS_PLACE[heading.place].sub(" ", heading.words).split())


def _needed(table: Table, headings: Iterable[Heading], name: str) -> Heading:
    found = [heading for heading in _candidates(table, headings, name) if heading.number is None] or [
        heading for heading in _candidates(table, headings, name) if heading.own in _mapped(table, name)
    ]
    if not found:
        raise _missing(table, name)
    if len(found) > 1:
        raise _ambiguous(table, name, found)
    return found[0]


def _time(table: Table, headings: Iterable[Heading]) -> tuple[Heading, ...]:
    """Return the column of times, or those of the date and of the time of the day, in this order."""
    found = _candidates(table, headings, "time")
    if sorted(heading.words for heading in found) == ["date", "time"]:
        return tuple(sorted(found, key=lambda heading: heading.words))
    return (_needed(table, headings, "time"),)


def _columns(table: Table, headings: Iterable[Heading], name: str) -> tuple[Heading, ...]:
    """Return the one column of a name, or its columns for each gate in the order of their numbers."""
    found = _candidates(table, headings, name)
    if len(found) < 2:
        return tuple(found)
    numbers = [heading.number for heading in found if heading.number is not None]
    alike = {(heading.words, heading.unit) for heading in found}
    if len(numbers) < len(found) or len(set(numbers)) < len(found) or len(alike) > 1:
        raise _ambiguous(table, name, found)
    return tuple(sorted(found, key=lambda heading: heading.number or 0.0))


def _beside(found: tuple[Heading, ...], velocity: tuple[Heading, ...], per_gate: bool) -> tuple[Heading, ...]:
    """Return the columns that stand beside those of the velocity; none if they are for other gates."""
    same = [heading.number for heading in found] == [heading.number for heading in velocity]
    return found if (same if per_gate else len(found) == 1) else ()


def _place(
    table: Table, headings: Iterable[Heading], velocity: tuple[Heading, ...], *, per_gate: bool
) -> tuple[str, tuple[Heading, ...]]:
    for name in ("height", *_PLACES) if table.file_format.gates_by == "height" else _PLACES:
        found = _columns(table, headings, name)
        if found and _beside(found, velocity, per_gate):
            return name, found
        if found and per_gate and len(found) == 1 and found[0].number is None and name == "distance":
            raise InputError(
                f"File {str(table.file)!r} has a column of velocities for each gate, and one column {found[0].own!r} "
                "for the distance of all: give one for each gate, or take it out."
            )
    words = take_apart(velocity[0].own)
    if per_gate and all(heading.metres for heading in velocity):
        said = [name for name in ("distance", "height") if "heading" in _mapped(table, name)] or [
            name for name in ("distance", "height") if name == words.place
        ]
        if said:
            return said[0], ()
        raise InputError(
            f"File {str(table.file)!r} heads its columns with metres ({velocity[0].own!r}), and does not say whether "
            "they are distances along the beam or heights: give columns={'distance': 'heading'} (--column "
            "distance=heading) or columns={'height': 'heading'}."
        )
    raise _missing(table, "distance")


def _heights(
    table: Table, headings: Iterable[Heading], velocity: tuple[Heading, ...], *, per_gate: bool
) -> tuple[Heading, ...]:
    """Return the columns of heights that stand beside distances; none if nothing is to be compared."""
    of_gates = [
        heading for heading in _candidates(table, headings, "height") if per_gate == (heading.number is not None)
    ]
    found = tuple(sorted(of_gates, key=lambda heading: heading.number or 0.0))
    return _beside(found, velocity, per_gate) if table.file_format.gates_by is None else ()


def _missing(table: Table, name: str) -> InputError:
    other = ", or height, or gate with gate_length" if name == "distance" else ""
    return InputError(
        f"File {str(table.file)!r} has no column for the {name.replace('_', ' ')}{other} of its rays: {table.found()}; "
        f"say what the file calls it with columns={{{name!r}: 'its heading'}} (--column {name}=HEADING)."
    )


def _ambiguous(table: Table, name: str, found: Iterable[Heading]) -> InputError:
    listed = ", ".join(repr(heading.own[:60]) for heading in list(found)[:8])
    return InputError(
        f"File {str(table.file)!r} has several columns that may be the {name.replace('_', ' ')} of its rays, {listed}: "
        f"say which with columns={{{name!r}: 'its heading'}} (--column {name}=HEADING)."
    )
