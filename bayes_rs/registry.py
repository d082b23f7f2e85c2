"""Families of things by name, which are imported when they are used: a command's help needs the names alone."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, MutableMapping
from typing import Any, TypeVar

_Entry = TypeVar("_Entry")


class Registry(MutableMapping[str, _Entry]):
    """What there is of a family, by name, in order.

    Parameters
    ----------
    entries : dict of str to str
        By name, where each is: ``"package.module:attribute"``, which is imported when it is asked for.

    Examples
    --------
    >>> roots = Registry({"square": "math:sqrt"})
    >>> roots["cube"] = lambda number: number ** (1 / 3)
    >>> list(roots), roots["square"](9.0), round(roots["cube"](27.0), 12)
    (['square', 'cube'], 3.0, 3.0)
    """

    def __init__(self, entries: dict[str, str]) -> None:
        self._entries: dict[str, Any] = dict(entries)

    def __getitem__(self, name: str) -> _Entry:
        entry = self._entries[name]
        if isinstance(entry, str):
            module, _, attribute = entry.partition(":")
            entry = self._entries[name] = getattr(importlib.import_module(module), attribute)
        found: _Entry = entry
        return found

    def __setitem__(self, name: str, entry: _Entry) -> None:
        self._entries[name] = entry

    def __delitem__(self, name: str) -> None:
        del self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)
