"""An end that was asked for: it stands until it is heard, also where a library swallows the exception of it."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import NoReturn

_asked: int | None = None
"""The signal that asked for an end, from its coming until a program has taken notice."""


class EndedError(KeyboardInterrupt):
    """The system, or who runs it, told this program to end.

    Parameters
    ----------
    number : int
        The signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def end(number: int, _frame: FrameType | None = None) -> NoReturn:
    """Note that an end was asked for, and raise it: what handles a signal.

    Libraries are not made to be broken off anywhere. What C code calls, finalizers and callbacks print such an
    exception and go on, perhaps with numbers that are not made; others raise another error in its place. So it is
    noted, too.
    """
    global _asked  # noqa: PLW0603 - a process has one
    _asked = number
    if number != signal.SIGINT:
        signal.signal(number, signal.SIG_IGN)  # what is finished is written now
    raise EndedError(number)


def asked_to_end() -> int | None:
    """Return the signal that asked for an end which is not yet heard."""
    return _asked


def take_notice() -> None:
    """Say that an end that was asked for is heard."""
    global _asked  # noqa: PLW0603
    _asked = None


@contextmanager
def swallowed_in_silence() -> Iterator[None]:
    """Print no traceback of an end that a library swallows: it is raised again, and has its words then."""
    raised, unraisable = sys.excepthook, sys.unraisablehook

    def tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if not issubclass(kind, EndedError):
            raised(kind, error, trace)

    def tell_unraisable(what: sys.UnraisableHookArgs) -> None:
        if not issubclass(what.exc_type, EndedError):
            unraisable(what)

    sys.excepthook, sys.unraisablehook = tell, tell_unraisable
    try:
        yield
    finally:
        sys.excepthook, sys.unraisablehook = raised, unraisable


def check_goes_on() -> None:
    """Raise an end again that was asked for, and went unheard: nothing made after it is to be trusted, or kept.

    Raises
    ------
    EndedError
        If there is one.
    """
    if _asked is not None:
        raise EndedError(_asked)
