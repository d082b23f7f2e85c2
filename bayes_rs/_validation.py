"""Checks of user input, and the one form that their messages have."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs.errors import InputError, did_you_mean, in_short
from bayes_rs.quantities import LIMITS, MOST_SEED, OF_COUNT, OF_SIZE, Limits

FloatArray = NDArray[np.float64]


def check_seed(seed: int, *, what: str = "seed") -> int:
    """Return a seed as an int: one rule for all, so that a run can be repeated from what it wrote."""
    if isinstance(seed, np.random.Generator):
        raise InputError(
            f"Invalid {what}, a numpy.random.Generator: here it must be a whole number, so that the run can be "
            "repeated; draw one from it with generator.integers(2**63)."
        )
    if not _is_whole(seed) or not 0 <= seed < MOST_SEED:
        raise InputError(f"Invalid {what} {in_short(seed)}: it must be a whole number from 0 to 2**63 - 1.")
    return int(seed)


def as_generator(seed: int | np.random.Generator) -> np.random.Generator:
    """Make the one random generator of a call from its `seed`."""
    if isinstance(seed, np.random.Generator):
        return seed
    if not _is_whole(seed) or not 0 <= seed < MOST_SEED:
        raise InputError(
            f"Invalid seed {in_short(seed)}: it must be a whole number from 0 to 2**63 - 1, or a "
            "numpy.random.Generator."
        )
    return np.random.default_rng(int(seed))


def check_choice(value: str, choices: tuple[str, ...], *, what: str, of: str = "") -> str:
    """Return `value` if it is one of `choices`."""
    if not isinstance(value, str) or value not in choices:
        owner = f" of {of}" if of else ""
        meant = did_you_mean(value, choices)
        listed = f"it must be one of {', '.join(choices)}{f'; {meant}' if meant else '.'}"
        raise InputError(f"Unknown {what} {in_short(value)}{owner}: {listed}")
    return value


def check_positive(value: float, *, what: str, unit: str, where: str = "") -> float:
    """Return `value` as a float if it is above zero and within the limits of the quantity `what`."""
    return _check_number(
        value, lambda number: number > 0.0, "a finite number above zero", what=what, unit=unit, where=where
    )


def check_non_negative(value: float, *, what: str, unit: str, where: str = "") -> float:
    """Return `value` as a float if it is zero, or above and within the limits of the quantity `what`."""
    return _check_number(
        value, lambda number: number >= 0.0, "a finite number, zero or above", what=what, unit=unit, where=where
    )


def check_finite(value: float, *, what: str, unit: str, where: str = "", quantity: str | None = None) -> float:
    """Return `value` as a float if it is finite, and within the limits of the quantity (`what`), if it has some."""
    return _check_number(
        value,
        None,
        "a finite number",
        what=what,
        unit=unit,
        where=where,
        limits=LIMITS.get(quantity or what.split(" ", maxsplit=1)[0]),
    )


def check_prob(prob: float, *, what: str = "prob") -> float:
    """Return the probability of an interval as a float."""
    number = as_number(prob)
    if not 0.0 < number < 1.0:
        raise InputError(f"Invalid {what} {in_short(prob)}: it must be between 0 and 1.")
    return _check_number(prob, None, "", what=what, unit="", where="", limits=LIMITS["prob"])


def check_count(value: int, *, what: str, minimum: int = 1) -> int:
    """Return `value` as an int if it is a whole number of at least `minimum`, and within the limits of `what`."""
    if not _is_whole(value) or value < minimum:
        raise InputError(f"Invalid {what} {in_short(value)}: it must be a whole number of at least {minimum}.")
    limits = LIMITS.get(what, OF_COUNT)
    if value > limits.most:
        usual = f"; {limits.usual}" if limits.usual else ""
        raise InputError(
            f"Invalid {what} {in_short(value)}: it must be a whole number of at most {int(limits.most)}{usual}."
        )
    return int(value)


def check_log_normal(prior: Any, *, what: str, unit: str, width: str) -> tuple[float, float]:
    """Return median and standard deviation of the logarithm, both above zero and within limits of their own."""
    given = as_items(prior, what=what)
    if len(given) != 2:
        raise InputError(
            f"Invalid {what} {in_short(prior)}: it must be two numbers, median ({unit}) and width of the logarithm."
        )
    return (
        check_positive(given[0], what=what, unit=unit, where="its median"),
        check_positive(given[1], what=width, unit="", where=what),
    )


def check_switch(value: bool, *, what: str) -> bool:
    """Return `value` if it is true or false."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"Invalid {what} {in_short(value)}: it must be True or False.")
    return bool(value)


def as_items(values: Any, *, what: str) -> list[Any]:
    """Return several values as a list; a single text or number is a list of one."""
    if isinstance(values, (str, bytes)) or np.isscalar(values):
        return [values]
    if not isinstance(values, Iterable) or isinstance(values, Mapping) or getattr(values, "ndim", 1) == 0:
        raise InputError(f"Invalid {what} {in_short(values)}: it must be a list.")
    return list(values)


def as_number(value: Any) -> float:
    """Return one real number as a float; NaN for what is none, such as a text, a bool or an array."""
    if isinstance(value, (bool, np.bool_, str, bytes, complex, np.complexfloating)) or value is np.ma.masked:
        return np.nan
    if hasattr(value, "dtype") and (np.ndim(value) > 0 or value.dtype.kind not in "iuf"):
        return np.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return np.nan


def as_numbers(values: ArrayLike, *, what: str) -> FloatArray:
    """Return `values` as a float64 array of any shape."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "USbcmMV" or (array.dtype.kind == "O" and _holds_texts(array)):
            raise TypeError(array.dtype)  # noqa: TRY301 - one message for all that are no numbers
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(f"Invalid {what} {in_short(values)}: it must be an array of numbers.") from error


def as_whole_numbers(values: ArrayLike, *, what: str) -> NDArray[np.int64]:
    """Return `values` as an int64 array of any shape."""
    array = np.atleast_1d(as_numbers(values, what=what))
    if not np.all(np.isfinite(array) & (np.abs(array) < MOST_SEED) & (array == np.round(array))):
        raise InputError(f"Invalid {what} {in_short(values)}: they must be whole numbers.")
    return np.asarray(array).astype(np.int64)


def check_array(values: ArrayLike, shape: tuple[int | None, ...], *, what: str) -> FloatArray:
    """Return `values` as a finite float64 array of `shape`, where None stands for any length, within limits."""
    array = as_numbers(values, what=what)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("n" if size is None else str(size) for size in shape)
        raise InputError(f"Invalid {what} of shape {array.shape}: the shape must be ({wanted}).")
    if not np.all(np.isfinite(array)):
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"Invalid {what}: the entry at {first} is {array[first]}, and every entry must be finite.")
    limits = LIMITS.get(what)
    if limits is not None:
        for first in np.argwhere((array != 0.0) & ((array < limits.least) | (array > limits.most)))[:1].tolist():
            rule = f"from {limits.least:g} to {limits.most:g}{'; ' * bool(limits.usual)}{limits.usual}."
            if array.size == 1:
                raise InputError(f"Invalid {what} {array.item()}: it must be {rule}")
            place = f"the entry at {tuple(first)} is {array[tuple(first)]}"
            raise InputError(f"Invalid {what}: {place}, and every entry must be {rule}")
    return array


def _is_whole(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _holds_texts(array: NDArray[Any]) -> bool:
    return any(isinstance(entry, (str, bytes, complex)) for entry in array.ravel().tolist())


def _check_number(
    value: object,
    rule: Callable[[float], bool] | None,
    rule_in_words: str,
    *,
    what: str,
    unit: str,
    where: str,
    limits: Limits | None = None,
) -> float:
    number = as_number(value)
    if rule is not None:
        limits = LIMITS.get(what, OF_SIZE)
    if not np.isfinite(number) or (rule is not None and not rule(number)):
        wrong = rule_in_words
    elif limits is not None and number != 0.0 and not limits.least <= number <= limits.most:
        wrong = f"from {limits.least:g} to {limits.most:g}{' ' + unit if unit else ''}"
        wrong += f"; {limits.usual}" if limits.usual else ""
    else:
        return number
    place = f" in {where}" if where else ""
    raise InputError(f"Invalid {what} {in_short(value)}{' ' + unit if unit else ''}{place}: it must be {wrong}.")
