"""One progress bar for everything that takes longer than a moment."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

from tqdm import tqdm

_Item = TypeVar("_Item")


def progress(
    iterable: Iterable[_Item], total: int | None, description: str, *, disable: bool | None = None
) -> Iterator[_Item]:
    """Pass items through and show how far they are, on stderr.

    Parameters
    ----------
    iterable : iterable
        What to pass through.
    total : int or None
        How many items there will be, if known.
    description : str
        A few words in front of the bar.
    disable : bool, optional
        True for no bar, False for a bar in any case; by default a bar only if stderr is a terminal.

    Yields
    ------
    item
        The items, unchanged.

    Examples
    --------
    >>> list(progress([1, 2, 3], 3, "counting", disable=True))
    [1, 2, 3]
    """
    silent = not sys.stderr.isatty() if disable is None else disable
    yield from tqdm(iterable, total=total, desc=description, disable=silent, file=sys.stderr, leave=False)
