"""Numbers as short texts: what a page of a whole year can hold."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

MISSING = -32768
_LARGEST = 32767


def pack(values: NDArray[Any], kind: str) -> str:
    """Return an array as base64 of little-endian numbers of that kind, such as ``"f8"``."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()).decode("ascii")


def pack_few(values: NDArray[np.int64]) -> dict[str, Any]:
    """Return whole numbers of which few differ: those that there are, and in base64 the place of each among them."""
    different, place = np.unique(values, return_inverse=True)
    return {"values": different.tolist(), "place": pack(place.ravel(), "u2")}


def pack_steps(values: NDArray[Any]) -> dict[str, Any]:
    """Return numbers that go up by the same step as the first, the step and how many; others in base64, as ``"f8"``."""
    steps = np.diff(values)
    if len(values) and np.all(steps == steps[:1]):
        return {"first": float(values[0]), "step": float(steps[0]) if len(steps) else 0.0, "n": len(values)}
    return {"values": pack(values, "f8")}


def pack_rows(values: FloatArray) -> dict[str, str]:
    """Return rows (n_row, ...) as 16-bit integers, in units of the row's largest magnitude over 32767.

    Parameters
    ----------
    values : ndarray, shape (n_row, ...)
        Numbers; those that are not finite become `MISSING`.

    Returns
    -------
    packed : dict of str
        ``values`` (16-bit integers) and ``unit`` (32-bit floats, one a row), both base64. The error of a number is at
        most half a unit, 1.5e-5 of the largest in its row.
    """
    flat = values.reshape(len(values), -1)
    finite = np.isfinite(flat)
    largest = np.max(np.abs(flat), axis=1, initial=0.0, where=finite)
    unit = (np.where(largest > 0.0, largest, 1.0) / _LARGEST).astype(np.float32)
    steps = np.rint(np.where(finite, flat, 0.0) / unit[:, None].astype(np.float64))
    return {"values": pack(np.where(finite, steps, MISSING), "i2"), "unit": pack(unit, "f4")}


def plain(values: FloatArray, digits: int = 4) -> list[Any]:
    """Return an array as nested lists of numbers of so many significant digits, None where one is not finite."""
    if values.ndim > 1:
        return [plain(row, digits) for row in values]
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values.tolist()]
