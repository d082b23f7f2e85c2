"""Checks of user input, and the one form that their messages have."""

from __future__ import annotations

import reprlib
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs.errors import InputError

FloatArray = NDArray[np.float64]


def as_generator(seed: int | np.random.Generator) -> np.random.Generator:
    """Make the one random generator of a call from its `seed`."""
    if isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"Invalid seed {seed!r}: it must be a non-negative integer or a numpy.random.Generator.")
    return np.random.default_rng(int(seed))


def check_choice(value: str, choices: tuple[str, ...], *, what: str, of: str = "") -> str:
    """Return `value` if it is one of `choices`."""
    if value not in choices:
        owner = f" of {of}" if of else ""
        raise InputError(f"Unknown {what} {value!r}{owner}: it must be one of {', '.join(choices)}.")
    return value


def check_positive(value: float, *, what: str, unit: str, where: str = "") -> float:
    """Return `value` as a float if it is finite and above zero."""
    return _check_number(
        value, lambda number: number > 0.0, "a finite number above zero", what=what, unit=unit, where=where
    )


def check_non_negative(value: float, *, what: str, unit: str, where: str = "") -> float:
    """Return `value` as a float if it is finite and not below zero."""
    return _check_number(
        value, lambda number: number >= 0.0, "a finite number, zero or above", what=what, unit=unit, where=where
    )


def check_finite(value: float, *, what: str, unit: str, where: str = "") -> float:
    """Return `value` as a float if it is finite."""
    return _check_number(value, np.isfinite, "a finite number", what=what, unit=unit, where=where)


def check_count(value: int, *, what: str, minimum: int = 1) -> int:
    """Return `value` as an int if it is a whole number of at least `minimum`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < minimum:
        raise InputError(f"Invalid {what} {value!r}: it must be a whole number of at least {minimum}.")
    return int(value)


def as_numbers(values: ArrayLike, *, what: str) -> FloatArray:
    """Return `values` as a float64 array of any shape."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"Invalid {what} {reprlib.repr(values)}: it must be an array of numbers.") from error


def check_array(values: ArrayLike, shape: tuple[int | None, ...], *, what: str) -> FloatArray:
    """Return `values` as a finite float64 array of `shape`, where None stands for any length."""
    array = as_numbers(values, what=what)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("n" if size is None else str(size) for size in shape)
        raise InputError(f"Invalid {what} of shape {array.shape}: the shape must be ({wanted}).")
    if not np.all(np.isfinite(array)):
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"Invalid {what}: the entry at {first} is {array[first]}, and every entry must be finite.")
    return array


def _check_number(
    value: object, rule: Callable[[float], bool], rule_in_words: str, *, what: str, unit: str, where: str
) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]  # what is no number is refused below
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number) or not rule(number):
        place = f" in {where}" if where else ""
        raise InputError(f"Invalid {what} {value!r}{' ' + unit if unit else ''}{place}: it must be {rule_in_words}.")
    return number
