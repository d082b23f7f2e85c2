"""The errors that a caller may want to catch by name; three of them carry data."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable
from typing import Any

_LONGEST_NAME = 100
_SHOWN = reprlib.Repr()
_SHOWN.maxstring = _SHOWN.maxother = 200
_SHOWN.maxlong = 40


def in_short(value: object) -> str:
    """Return a value for a message: what Python writes of it, in one line and not too long."""
    try:
        text = _SHOWN.repr(value)
    except Exception:  # noqa: BLE001 - an object of the user's own may fail to say what it is
        text = f"<{type(value).__name__}>"
    return " ".join(text.split())


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the question for the name that was meant, as ``did you mean 'zx-tm'?``; empty if none is near.

    Parameters
    ----------
    name : object
        What was given.
    known : iterable of str
        The names that there are. Case, hyphens, underscores, points and spaces do not count.
    """
    if not isinstance(name, str) or len(name) > _LONGEST_NAME or not plain_name(name):
        return ""
    plain = {plain_name(one): one for one in known}
    begins = [one for one in plain if len(name) > 1 and one.startswith(plain_name(name))]
    close = begins[:1] or difflib.get_close_matches(plain_name(name), list(plain), n=1)
    return f"did you mean {plain[close[0]]!r}?" if close else ""


def plain_name(name: str) -> str:
    """Return a name as it is compared: in small letters, without hyphens, underscores, points and spaces."""
    return "".join(character for character in name.lower() if character not in "-_. ")


class InputError(ValueError):
    """Input that cannot be used: one line that says what, the value, the rule, where, and what to do."""


class _WithData(Exception):  # noqa: N818 - what three errors share
    """An error with data, which comes from a worker as it was raised there."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), self.args), self.__dict__


def _again(kind: type[BaseException], args: tuple[Any, ...]) -> BaseException:
    return kind.__new__(kind, *args)


class NoiseMismatchError(_WithData, InputError):
    """Noise that was made for another scan than the one it is used with.

    Attributes
    ----------
    difference : str
        The first thing in which the two scans differ.
    """

    def __init__(self, message: str, *, difference: str) -> None:
        super().__init__(message)
        self.difference = difference


class NotPositiveDefiniteError(_WithData, InputError):
    """A covariance matrix that is not positive definite.

    Attributes
    ----------
    smallest_eigenvalue : float
        Smallest eigenvalue of the offending matrix, in its own unit.
    """

    def __init__(self, message: str, *, smallest_eigenvalue: float) -> None:
        super().__init__(message)
        self.smallest_eigenvalue = smallest_eigenvalue


class MissingExtraError(ImportError):
    """An optional package that is needed for what was asked and is not installed."""


class WorkerError(RuntimeError):
    """Worker processes that die again and again."""


class LostResultsError(_WithData, RuntimeError):
    """Results of a run that are gone, or not what it wrote, when the run ends.

    Attributes
    ----------
    damage : dict of str to str
        What is wrong with each file, by its path in the folder.
    """

    def __init__(self, message: str, *, damage: dict[str, str]) -> None:
        super().__init__(message)
        self.damage = damage
