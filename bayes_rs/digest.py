"""A fingerprint of data and options, by which an interrupted job knows its own."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def digest(*things: Any) -> str:
    """Return a hexadecimal SHA-256 fingerprint of arrays, numbers, texts, containers and objects made of them.

    Examples
    --------
    >>> digest(1.0, "a") == digest(1.0, "a"), digest(1.0) == digest(2.0)
    (True, False)
    """
    state = hashlib.sha256()
    for thing in things:
        _update(state, thing)
    return state.hexdigest()


def _update(state: Any, thing: Any) -> None:
    if isinstance(thing, np.ndarray):
        state.update(f"array {thing.dtype} {thing.shape} ".encode())
        state.update(repr(thing.tolist()).encode() if thing.dtype == object else np.ascontiguousarray(thing).tobytes())
    elif is_dataclass(thing) and not isinstance(thing, type):
        state.update(f"{type(thing).__qualname__}(".encode())
        for entry in fields(thing):
            state.update(entry.name.encode())
            _update(state, getattr(thing, entry.name))
    elif isinstance(thing, dict):
        state.update(b"{")
        for key in sorted(thing, key=str):
            state.update(str(key).encode())
            _update(state, thing[key])
    elif isinstance(thing, (list, tuple)):
        state.update(b"[")
        for item in thing:
            _update(state, item)
    elif thing is None or isinstance(thing, (str, bytes, int, float, np.generic)):
        state.update(f"{type(thing).__name__} {thing!r};".encode())
    else:
        state.update(f"{type(thing).__qualname__} ".encode())
        _update(state, vars(thing))
