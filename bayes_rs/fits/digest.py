"""A fingerprint of data and options, by which an interrupted job knows its own."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SHORT = 32
"""Hexadecimal digits of a part of a key: 128 bits, beyond any chance."""


def digest(*things: Any) -> str:
    """Return a hexadecimal SHA-256 fingerprint of arrays, numbers, texts, containers and objects made of them.

    Equal numbers have one fingerprint, whatever their type: 1, 1.0 and ``np.float64(1.0)``.

    Examples
    --------
    >>> digest(1.0, "a") == digest(1.0, "a"), digest(1.0) == digest(2.0)
    (True, False)
    """
    state = hashlib.sha256()
    for thing in things:
        _update(state, thing)
    return state.hexdigest()


def digest_parts(**things: Any) -> dict[str, str]:
    """Return a short fingerprint of each thing by its name, which together make a key and tell what differs.

    Examples
    --------
    >>> one, other = digest_parts(seed=1, prior="weak"), digest_parts(seed=2, prior="weak")
    >>> [name for name in one if one[name] != other[name]]
    ['seed']
    """
    return {name: digest(thing)[:_SHORT] for name, thing in things.items()}


def _update(state: Any, thing: Any) -> None:
    """Feed one thing; each ends where the next one cannot be taken for a part of it."""
    if isinstance(thing, np.generic):
        thing = thing.item() if isinstance(thing.item(), (bool, int, float, str, bytes)) else str(thing)
    if isinstance(thing, float) and thing.is_integer():
        thing = int(thing)
    if thing is None or isinstance(thing, (str, bytes, int, float)):
        state.update(f"{thing!r};".encode())
    elif isinstance(thing, np.ndarray):
        _update_array(state, thing)
    elif isinstance(thing, (list, tuple)):
        state.update(f"list {len(thing)} ".encode())
        for item in thing:
            _update(state, item)
    elif isinstance(thing, dict):
        state.update(f"dict {len(thing)} ".encode())
        for key in sorted(thing, key=repr):
            _update(state, [key, thing[key]])
    else:
        state.update(f"{type(thing).__qualname__} ".encode())
        _update(state, _attributes(thing))


def _update_array(state: Any, array: NDArray[Any]) -> None:
    state.update(f"array {array.dtype} {array.shape} ".encode())
    if array.dtype == object:
        _update(state, array.tolist())
    else:
        state.update(np.ascontiguousarray(array).tobytes())


def _attributes(thing: Any) -> dict[str, Any]:
    if is_dataclass(thing) and not isinstance(thing, type):
        return {entry.name: getattr(thing, entry.name) for entry in fields(thing)}
    if callable(thing) or not hasattr(thing, "__dict__"):
        raise TypeError(f"No fingerprint of {thing!r}: it must be made of arrays, numbers, texts and containers.")
    return dict(vars(thing))
