"""One progress bar for everything that takes longer than a moment."""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from bayes_rs.interrupts import check_goes_on

_Item = TypeVar("_Item")
_counting: ContextVar[Counter | None] = ContextVar("counting", default=None)
hushed: ContextVar[bool] = ContextVar("hushed", default=False)
"""Whether no bar is shown where nobody says that one is."""
_tally: str | None = None
"""In a worker process: the file that it notes in what is done."""
_PATIENCE = 0.5
"""Seconds that a notebook goes without a bar: what is done by then needs none."""
_WORKER_LOOKS = 0.3
"""Seconds after which what workers noted is looked at again."""


class Counter:
    """A bar that counts what is done, also what is noted before the part that it is of is finished.

    Parameters
    ----------
    bar : tqdm
        What is shown.
    initial : int
        How many were done before.
    """

    def __init__(self, bar: Any, initial: int = 0) -> None:
        self._bar, self._initial = bar, initial
        self._finished = self._noted = 0
        self.shown = not bar.disable

    def update(self, n: int) -> None:
        """Say that n more are finished."""
        self._finished += n
        self._show()

    def note(self, n: int) -> None:
        """Say that n more of a part that is not finished are done."""
        self._noted += n
        self._show()

    def _show(self) -> None:
        check_goes_on()
        # what is noted is finished later; a part that is done again, because its worker died, is noted twice
        count = max(self._finished, self._noted)
        self._bar.update(max(min(self._initial + count, self._bar.total) - self._bar.n, 0))


def note_done(n: int) -> None:
    """Note that n of the things are done that the innermost `progress_counter` counts, also from a worker process."""
    counter = _counting.get()
    if counter is not None:
        counter.note(n)
    elif _tally is not None:
        descriptor = os.open(_tally, os.O_WRONLY | os.O_APPEND)
        try:
            os.write(descriptor, b"." * n)
        finally:
            os.close(descriptor)


def tally_in(file: str | None) -> None:
    """Let this worker process note in a file what is done; None: nobody looks."""
    global _tally  # noqa: PLW0603 - a process of a pool has nothing else to keep it in
    _tally = file


class Tally:
    """What worker processes note, seen by the process that counts.

    Attributes
    ----------
    file : str or None
        What the workers take as `tally_in`; None where nobody looks.
    seconds : float or None
        How long to wait before the next look; None where nobody looks.
    """

    def __init__(self, file: Path | None, counter: Counter | None) -> None:
        self.file = None if file is None else str(file)
        self.seconds = None if file is None else _WORKER_LOOKS
        self._counter, self._seen = counter, 0

    def look(self) -> None:
        """Show what was noted since the last look."""
        if self.file is None or self._counter is None:
            return
        size = Path(self.file).stat().st_size
        self._counter.note(size - self._seen)
        self._seen = size


@contextmanager
def worker_tally() -> Iterator[Tally]:
    """Give what shows the progress within the parts that worker processes do, if a bar is shown."""
    counter = _counting.get()
    if counter is None or not counter.shown:
        yield Tally(None, None)
        return
    with tempfile.TemporaryDirectory(prefix="bayes-rs-", ignore_cleanup_errors=True) as folder:
        file = Path(folder) / "done"
        file.touch()
        yield Tally(file, counter)


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
        for item in bar:
            check_goes_on()
            yield item


@contextmanager
def progress_counter(
    total: int, description: str, unit: str, *, initial: int = 0, scale: bool = False, disable: bool | None = None
) -> Iterator[Counter]:
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
    counter : Counter
        Its ``update(n)`` says that n more are done; `note_done` says so from within a part of the work.
    """
    with _bar(total, description, disable, unit=unit, initial=initial, unit_scale=scale) as bar:
        counter = Counter(bar, initial)
        before = _counting.set(counter)
        try:
            yield counter
        finally:
            _counting.reset(before)


def _bar(total: int | None, description: str, disable: bool | None, **more: Any) -> Any:
    """Return a bar: on stderr, in a notebook the one that it draws, if it has what that takes."""
    options = {"total": total, "desc": description, "leave": False, "file": sys.stderr, **more}
    if not _in_notebook():
        return tqdm(disable=_no_terminal() if disable is None else disable, **options)
    # tqdm.auto would warn where ipywidgets is missing; a line of text under the cell does there
    kind = notebook_tqdm() if importlib.util.find_spec("ipywidgets") else tqdm
    return kind(
        disable=hushed.get() if disable is None else disable, delay=0.0 if disable is False else _PATIENCE, **options
    )


def _no_terminal() -> bool:
    """Say whether nobody looks at stderr, which is None where a program was started without one."""
    return hushed.get() or sys.stderr is None or sys.stderr.closed or not sys.stderr.isatty()


def _in_notebook() -> bool:
    """Say whether this is the kernel of a notebook, whose stderr is no terminal though somebody looks at it."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return "IPKernelApp" in getattr(shell, "config", ())


def notebook_tqdm() -> Any:
    """Return tqdm's bar of widgets."""
    from tqdm.notebook import tqdm as of_widgets  # noqa: PLC0415 - of notebooks alone

    return of_widgets
