"""Questions of a page in turn, of which only the newest is answered."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

_T = TypeVar("_T")


class Latest:
    """One answer at a time; of questions that one page asks in turn, only the newest counts when it is its turn.

    A slider asks faster than any answer comes. Whoever waits and is no longer the newest need not be answered.
    """

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._count = 0
        self._newest: dict[str, int] = {}

    def answer(self, page: str, make: Callable[[], _T]) -> _T | None:
        """Return what `make` makes, or None if `page` has asked again meanwhile."""
        self._count += 1
        ticket = self._count
        self._newest[page] = ticket
        with self._turn:
            return make() if self._newest[page] == ticket else None
