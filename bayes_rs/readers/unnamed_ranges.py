"""Columns of ranges or heights that nobody named: what a file holds several of is not one series."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.format import FileFormat

IntArray = NDArray[np.int64]

_LIKE_RANGE = re.compile(
    r"(?:(?:slant|measurement|meas)\W?)?(?:range|distance|dist|height|altitude|alt|gate|level)"
    r"(?:[ _-]?(?:gate|number|index|no|m))?\.?(?:\s*[(\[].*[)\]])?",
    re.IGNORECASE,
)
_ONE_PLACE = 1.2
"""Largest ratio of what a column says of one beam, if it is no range: a platform's height changes a little."""
_MOST_LISTED = 12


def like_ranges(headings: Sequence[str], file_format: FileFormat, used: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the headings that look like a range or a height, and that nobody uses."""
    mapped = {*file_format.columns.values(), *used}
    return tuple(heading for heading in headings if heading not in mapped and _LIKE_RANGE.fullmatch(heading.strip()))


def several_in_words(headings: Sequence[str]) -> str:
    """Say what to do where a file holds several velocities of one beam and time."""
    if headings:
        names = ", ".join(repr(heading) for heading in headings)
        which = "its column" if len(headings) == 1 else "one of its columns"
        return (
            f"the file seems to hold several ranges at one time; if {which} {names} is the distance along the beam, m, "
            f"name it with columns={{'range': {headings[0]!r}}} (--column range={headings[0]!r}), or else split "
            "the file"
        )
    return (
        "the file seems to hold several ranges, heights or instruments at one time, or its times are rounded; name the "
        "column of the distance along the beam, m, with columns={'range': 'its heading'} (--column range=HEADING), "
        "split the file, or give time stamps that tell samples apart"
    )


def check_one_place(
    known: dict[tuple[str, int], tuple[float, float]], heading: str, beam: IntArray, values: FloatArray, file: Path
) -> None:
    """Refuse a file whose unused column of ranges says several of one beam.

    Parameters
    ----------
    known : dict
        Least and largest of the pieces before, by heading and beam; changed.
    heading : str
        Of the column.
    beam, values : ndarray, shape (n,)
        Beam numbers, and what the column says; NaN where it is no number.
    file : Path
        For the message.

    Raises
    ------
    InputError
        If one beam has values of which the largest is more than 1.2 times the least.
    """
    there = np.isfinite(values) & (values > 0.0)
    if not there.any():
        return
    of, place = np.unique(beam[there], return_inverse=True)
    least, most = np.full(len(of), np.inf), np.full(len(of), -np.inf)
    np.minimum.at(least, place.ravel(), values[there])
    np.maximum.at(most, place.ravel(), values[there])
    for number, low, high in zip(of.tolist(), least.tolist(), most.tolist(), strict=True):
        before = known.get((heading, number), (np.inf, -np.inf))
        known[heading, number] = min(low, before[0]), max(high, before[1])
        if known[heading, number][1] > _ONE_PLACE * known[heading, number][0]:
            found = listed_ranges(np.unique(values[there]))
            raise InputError(
                f"Beam {number} has several {heading!r} in file {str(file)!r}: {found}, and rows of several ranges are "
                f"not one series; if {heading!r} is the distance along the beam, m, name it with columns={{'range': "
                f"{heading!r}}} (--column range={heading!r}), which takes the rows at the scan's distances; or else "
                "give a file for each, or remove the column if it says something else."
            )


def listed_ranges(ranges: ArrayLike) -> str:
    """Return ranges as text, not all if there are many."""
    words = [f"{number:g}" for number in np.asarray(ranges).tolist()]
    return ", ".join(words) if len(words) <= _MOST_LISTED else f"{', '.join(words[:6])} … {words[-1]}"
