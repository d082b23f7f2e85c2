"""One progress bar for everything that takes longer than a moment."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from tqdm import tqdm

_Item = TypeVar("_Item")

_PATIENCE = 0.5
"""Seconds that a notebook goes without a bar: what is done by then needs none."""


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
        True for no bar, False for a bar in any case; by default a bar only if stderr is a terminal, or a notebook's.

    Yields
    ------
    item
        The items, unchanged.

    Examples
    --------
    >>> list(progress([1, 2, 3], 3, "counting", disable=True))
    [1, 2, 3]
    """
    with _bar(total, description, disable, iterable=iterable) as bar:
        yield from bar


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
    with _bar(total, description, disable, unit=unit, initial=initial, unit_scale=scale) as bar:
        yield bar


def _bar(total: int | None, description: str, disable: bool | None, **more: Any) -> Any:
    """Return a bar: on stderr, in a notebook the one that it draws, if it has what that takes."""
    options = {"total": total, "desc": description, "leave": False, "file": sys.stderr, **more}
    if not _in_notebook():
        nobody = sys.stderr is None or sys.stderr.closed or not sys.stderr.isatty()
        return tqdm(disable=nobody if disable is None else disable, **options)
    # tqdm.auto would warn where ipywidgets is missing; a line of text under the cell does there
    kind = notebook_tqdm() if importlib.util.find_spec("ipywidgets") else tqdm
    return kind(disable=bool(disable), delay=0.0 if disable is False else _PATIENCE, **options)


def _in_notebook() -> bool:
    """Say whether this is the kernel of a notebook, whose stderr is no terminal though somebody looks at it."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return "IPKernelApp" in getattr(shell, "config", ())


def notebook_tqdm() -> Any:
    """Return tqdm's bar of widgets."""
    from tqdm.notebook import tqdm as of_widgets  # noqa: PLC0415 - of notebooks alone

    return of_widgets
