"""Files in the order of their first samples, most of them read before their turn comes."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayes_rs.readers.ahead import ReadFile
from bayes_rs.readers.samples import Samples

_MOST_TOGETHER = 200
"""Files that are added to the records at a time."""


class NotInOrderError(Exception):
    """A file begins before others end that had their turn: they were not in the order of their names."""


@dataclass(order=True)
class Waiting:
    """A file that waits for its turn: its first time, its place among all, what was noted of it, and what it holds.

    `samples` are None where its format is read in pieces.
    """

    first: np.datetime64
    index: int
    path: Path = field(compare=False)
    key: list[Any] = field(compare=False)
    samples: Samples | None = field(compare=False)


@dataclass
class FileQueue:
    """Files in the order of their first times, of which some are looked at in advance.

    Parameters
    ----------
    read : generator of ReadFile
        The files in the order of their names.
    first_of : callable
        Returns the first time of a file that is read in pieces, or what is wrong with it.
    wait : timedelta64
        How far a file may begin before others end.
    most : int
        Files that are looked at in advance; more are not in memory.
    most_rows : int
        Rows of them that are in memory; of others only the first time is known.

    Raises
    ------
    NotInOrderError
        From `take` and `next_first`, if a file comes too late.
    """

    read: Generator[ReadFile, None, None]
    first_of: Callable[[Path], np.datetime64 | Exception]
    wait: np.timedelta64
    most: int
    most_rows: int
    bad: list[tuple[Path, list[Any], Exception]] = field(default_factory=list)
    """Files that cannot be used; who uses the queue takes them."""
    _heap: list[Waiting] = field(default_factory=list)
    _rows: int = 0
    _count: int = 0
    _begun: np.datetime64 | None = None
    _reached: np.datetime64 | None = None

    def take(self, most: int = _MOST_TOGETHER) -> list[Waiting]:
        """Take the next file; with those after it that are read and begin after it ends, one after the other."""
        self._fill()
        if not self._heap:
            return []
        taken = [self._pop()]
        names = {taken[0].path.name}
        while len(taken) < most and self._heap:
            last, following = taken[-1], self._heap[0]
            if last.samples is None or following.samples is None or following.path.name in names:
                break
            if following.first <= last.samples.time.max():
                break
            taken.append(self._pop())
            names.add(following.path.name)
            self._fill()
        return taken

    def take_until(self, time: np.datetime64) -> list[Waiting]:
        """Take the files that begin by then."""
        self._fill()
        taken = []
        while self._heap and self._heap[0].first <= time:
            taken.append(self._pop())
            self._fill()
        return taken

    def put_back(self, files: Sequence[Waiting]) -> None:
        """Put files back that were taken, and not used."""
        for one in files:
            heapq.heappush(self._heap, one)
            self._rows += _rows_of(one)

    def next_first(self) -> np.datetime64 | None:
        """Return when the next file begins; None if there is none."""
        self._fill()
        return self._heap[0].first if self._heap else None

    def used(self, until: np.datetime64) -> None:
        """Note that files are used, and end at a time."""
        self._reached = until if self._reached is None else max(self._reached, until)

    def _pop(self) -> Waiting:
        one = heapq.heappop(self._heap)
        self._begun = one.first if self._begun is None else max(self._begun, one.first)
        self._rows -= _rows_of(one)
        return one

    def _fill(self) -> None:
        while len(self._heap) < self.most:
            found = next(self.read, None)
            if found is None:
                return
            self._count += 1
            first = found.error or (self.first_of(found.file) if found.samples is None else found.samples.time.min())
            if isinstance(first, Exception):
                self.bad.append((found.file, found.before, first))
                continue
            if self._comes_too_late(first):
                raise NotInOrderError
            one = Waiting(first, self._count, found.file, found.before, found.samples)
            if self._rows + _rows_of(one) > self.most_rows and self._heap:
                one.samples = None  # it is read again when its turn comes
            self._rows += _rows_of(one)
            heapq.heappush(self._heap, one)

    def _comes_too_late(self, first: np.datetime64) -> bool:
        """Say whether a file should have had its turn already."""
        begun, reached = self._begun, self._reached
        return (begun is not None and bool(first < begun)) or (
            reached is not None and bool(first + self.wait < reached)
        )


def _rows_of(one: Waiting) -> int:
    return 0 if one.samples is None else len(one.samples.time)
