"""What of a file is not believed: velocities that no wind has, and rows from before the clock was set."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_rs.quality.belief import BoolArray, Impossible, is_far, is_impossible, is_unset
from bayes_rs.readers.samples import Samples, as_utc

_MOST_WAITING = 100_000
"""Samples of an unset clock that are held back until others tell what time it was."""


def believed(parts: Iterable[Samples]) -> Iterator[Samples]:
    """Give the pieces of one file without what no atmosphere has; what that was stands in their counts and facts.

    Parameters
    ----------
    parts : iterable of Samples
        The file's pieces, in their order.

    Yields
    ------
    part : Samples
        With impossible velocities as NaN (``velocities_impossible`` in its counts), and without the samples of a clock
        that was not set (``rows_unset_clock``).

    Raises
    ------
    InputError
        At the end of a file most of whose velocities are impossible, but do not stand for missing entries.

    Notes
    -----
    A velocity is impossible beyond the option ``velocity_limit``, if the status does not reject it already. A time is
    set aside if it is before 1990, in January 2000, or from 2036 on, while others of the file are not and lie more than
    30 days from it. Pieces with such times only wait for the first of the others.
    """
    found = Impossible()
    waiting: list[Samples] = []
    n_waiting = 0
    known: tuple[np.datetime64, np.datetime64] | None = None
    limit = 0.0
    for part in parts:
        limit = part.file_format.velocity_limit
        possible = _without_impossible(part, found)
        unset = is_unset(possible.time)
        if not unset.all():
            good = possible.time[~unset] if unset.any() else possible.time
            first, last = good.min(), good.max()
            known = (first, last) if known is None else (min(known[0], first), max(known[1], last))
        if known is None and n_waiting + len(possible.time) <= _MOST_WAITING:
            waiting.append(possible)
            n_waiting += len(possible.time)
            continue
        for held in waiting:
            yield _set_aside(held, is_unset(held.time), known)
        waiting = []
        yield _set_aside(possible, unset, known)
        file = possible.file
    for held in waiting:
        yield held
        file = held.file
    if found.count:
        found.check(f"File {str(file)!r} holds radial velocities", limit)


def _without_impossible(part: Samples, found: Impossible) -> Samples:
    velocity = part.radial_velocity
    impossible = is_impossible(velocity, part.file_format.velocity_limit)
    if part.status is not None and part.file_format.status_valid is not None:
        impossible &= part.status == part.file_format.status_valid  # the others do not count already
    count = int(np.count_nonzero(impossible))
    counts = {**part.counts, "velocities_impossible": count, "rows_unset_clock": 0}
    n_good = int(np.count_nonzero(~np.isnan(velocity))) - count
    if count == 0:
        found.add(velocity[:0], n_good)
        return replace(part, counts=counts)
    if not found.first:
        found.first = f"{part.row_word} {part.row[int(np.argmax(impossible))]}"
    own = Impossible()
    own.add(velocity[impossible], n_good, part.file_format.as_written)
    found.join(own)
    return replace(
        part,
        radial_velocity=np.where(impossible, np.nan, velocity),
        counts=counts,
        facts={**part.facts, "impossible_values": own.told(), "velocity_limit": part.file_format.velocity_limit},
    )


def _set_aside(part: Samples, unset: BoolArray, known: tuple[np.datetime64, np.datetime64] | None) -> Samples:
    if known is None or not unset.any():
        return part
    aside = unset & is_far(part.time, *known)
    if not aside.any():
        return part
    first = int(np.argmax(aside))
    facts: dict[str, Any] = {"first_unset_clock": f"{part.row_word} {part.row[first]}, {as_utc(part.time[first])}"}
    kept = part.select(np.flatnonzero(~aside), with_counts=True)
    rows = len(np.unique(part.row[aside]))
    return replace(kept, counts={**part.counts, "rows_unset_clock": rows}, facts={**part.facts, **facts})
