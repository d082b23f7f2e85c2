"""One progress bar for everything that takes longer than a moment."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

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
    silent = _no_terminal() if disable is None else disable
    yield from tqdm(iterable, total=total, desc=description, disable=silent, file=sys.stderr, leave=False)


@contextmanager
def progress_counter(
    total: int, description: str, unit: str, *, initial: int = 0, scale: bool = False, disable: bool | None = None
) -> Iterator[Any]:
    """Show how many of a number of things are done, how many a second, and the time left, on stderr.

    Parameters
    ----------
    total : int
        How many there are.
    description : str
        A few words in front of the bar.
    unit : str
        What is counted, with a blank in front.
    initial : int
        How many were done before: they do not count for the speed.
    scale : bool
        Shorten numbers: 1.2G instead of 1234567890.
    disable : bool, optional
        As for `progress`.

    Yields
    ------
    bar
        Its ``update(n)`` says that n more are done.
    """
    silent = _no_terminal() if disable is None else disable
    with tqdm(
        total=total,
        initial=initial,
        desc=description,
        unit=unit,
        unit_scale=scale,
        disable=silent,
        file=sys.stderr,
        leave=False,
    ) as bar:
        yield bar


def _no_terminal() -> bool:
    """Say whether nobody looks at stderr, which is None where a program was started without one."""
    return sys.stderr is None or sys.stderr.closed or not sys.stderr.isatty()
