"""The one door for what we wrote and read again: a layout is data, and what comes in is checked against it.

A layout is declared once, beside the writer: a mapping of names to `Entry` for datasets, of names to kinds for tables,
and a class of pydantic for JSON and for attributes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from bayes_rs.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa
    import xarray as xr

Count = Annotated[int, Field(ge=0, le=2**53)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, le=1e12, allow_inf_nan=False)]

_SHOWN = 60
_KINDS = {
    "number": ("iuf", "numbers"),
    "whole": ("biu", "whole numbers"),
    "text": ("OSUT", "texts"),
    "time": ("M", "times"),
    "truth": ("b", "true or false"),
}
"""Kinds of NumPy's types that an entry may have, and how to call them."""
_BOUNDS = {"amount": (-1e15, 1e15), "size": (0.0, 1e15)}
"""Kinds of numbers in tables that have bounds: beyond them nothing is measured, and squares still are numbers."""
_UNIT = re.compile(r"([a-zµ°Ωω]+)(?:\^|\*\*)?([-+]?\d+)?")
_UNIT_WORDS = {
    **dict.fromkeys(("degrees", "deg", "°", "arc_degree"), "degree"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("meter", "metre", "meters", "metres"), "m"),
    **dict.fromkeys(("second", "seconds", "sec"), "s"),
}
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F][0-9a-fA-F]{2}")  # as JSON in a text has it
_POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−·.*", "0123456789--  *")
_SQUARE = re.compile(r"\(([^()]*)\) ?(?:\^|\*\*)?2")  # of a speed, say


class Open(BaseModel):
    """What JSON or attributes hold: numbers are numbers; what no field names may be there, too."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)


_Model = TypeVar("_Model")


@dataclass(frozen=True)
class Entry:
    """What a variable of a dataset is.

    Parameters
    ----------
    dims : tuple of str
        Its dimensions, in their order.
    kind : str
        What it holds: ``number``, ``whole``, ``text``, ``time`` or ``truth``.
    unit : str
        Its unit, if it has one: another one is refused, none is taken for this one.
    values : tuple
        What a coordinate must be, if that is known.
    positive : bool
        Whether all that is a number is above zero.
    most : float
        Absolute value that none of its numbers exceeds: powers of them still are numbers.
    least : float
        Number that none of them is below.
    flags : bool
        Whether its attributes may name bits, by the CF conventions.
    """

    dims: tuple[str, ...]
    kind: str = "number"
    unit: str = ""
    values: tuple[Any, ...] = ()
    positive: bool = False
    most: float = 1e12
    least: float = float("-inf")
    flags: bool = False


def check_dataset(
    dataset: xr.Dataset,
    layout: Mapping[str, Entry],
    *,
    what: str,
    needs: Collection[str] = (),
    attributes: type[BaseModel] | None = None,
    optional_dim: str = "",
    advice: str,
) -> None:
    """Check the variables and attributes of a dataset that a layout names.

    Parameters
    ----------
    dataset : Dataset
        What was read, or given.
    layout : mapping of str to Entry
        What variables are, where they are there.
    what : str
        What it is, for messages, in the plural, as ``The records``.
    needs : collection of str
        Variables that must be there.
    attributes : class, optional
        What the attributes are; those that are numbers or arrays of NumPy count as plain.
    optional_dim : str
        A first dimension that variables may have or lack.
    advice : str
        What to do, for messages.

    Raises
    ------
    InputError
        For the first entry that is not what the layout says.
    """
    for name in needs:
        if name not in dataset.variables:
            raise InputError(f"{what} have no {name} with dims {layout[name].dims}: {advice}.")
    variables = dataset.variables
    for name, entry in layout.items():
        words = _fault_of(variables[name], entry, optional_dim) if name in variables else ""
        if words:
            raise InputError(f"{what} cannot be used: {name} {words}; {advice}.")
    if attributes is not None:
        check_plain(
            attributes, {str(key): _as_plain(value) for key, value in dataset.attrs.items()}, what=what, advice=advice
        )


def check_table(table: pa.Table, layout: Mapping[str, str], *, what: str, advice: str) -> None:
    """Check that a table of Arrow has the columns of a layout, each once, of its kind.

    Parameters
    ----------
    table : Table
        What was read.
    layout : mapping of str to str
        The kind of each column, as in `Entry`; numbers may be an ``amount`` or a ``size``, which is not below zero.
        Numbers and times may be missing.
    what, advice : str
        As for `check_dataset`.

    Raises
    ------
    InputError
        For the first column that is not what the layout says.
    """
    import pyarrow as pa  # noqa: PLC0415 - who reads no table need not load it

    def _is_number(kind: pa.DataType) -> bool:
        return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))

    is_kind = {
        **dict.fromkeys(("number", *_BOUNDS), _is_number),
        "whole": pa.types.is_integer,
        "text": lambda kind: pa.types.is_string(kind) or pa.types.is_large_string(kind),
        "time": lambda kind: pa.types.is_timestamp(kind) and kind.tz is None,
        "truth": pa.types.is_boolean,
    }
    for name, kind in layout.items():
        count = table.column_names.count(name)
        if count != 1:
            reason = f"has {count} columns {name!r}" if count else f"has no column {name!r}"
            raise InputError(f"{what} cannot be used: it {reason}; {advice}.")
        column = table.column(name)
        if not is_kind[kind](column.type):
            words = "numbers" if kind in _BOUNDS else _KINDS[kind][1]
            raise InputError(
                f"{what} cannot be used: column {name!r} holds {column.type}, and must hold {words}; {advice}."
            )
        if kind in _BOUNDS:
            low, high = _BOUNDS[kind]
            values = column.to_numpy()
            bad = (values < low) | (values > high)  # what is not a number is neither
            if bad.any():
                raise InputError(
                    f"{what} cannot be used: column {name!r} holds {values[bad][0]:g}, and must hold numbers from "
                    f"{low:g} to {high:g}; {advice}."
                )
        if column.null_count and kind in ("whole", "text", "truth"):  # numbers that are missing are empty
            raise InputError(f"{what} cannot be used: column {name!r} has {column.null_count} empty entries; {advice}.")


def read_json(kind: Any, content: bytes | str, *, what: str, advice: str) -> Any:
    """Return what JSON holds, as plain values, checked against a class of pydantic or any type.

    Raises
    ------
    InputError
        If it is no JSON, or not what the class says.
    """
    try:
        found = json.loads(content)
    except RecursionError as error:
        raise InputError(f"{what} cannot be read: it is nested too deeply; {advice}.") from error
    except ValueError as error:  # also what is not UTF-8, and integers of thousands of digits
        reason = " ".join(str(error).split("; use sys.")[0].split())
        raise InputError(f"{what} cannot be read as JSON: {reason[:200]}; {advice}.") from error
    check_plain(kind, found, what=what, advice=advice)
    return found


def check_plain(kind: Any, values: Any, *, what: str, advice: str) -> Any:
    """Check plain values against a class of pydantic, or any type; return what that makes of them.

    Raises
    ------
    InputError
        For the first that is not what the class says.
    """
    try:
        return (kind if isinstance(kind, TypeAdapter) else TypeAdapter(kind)).validate_python(_writable(values))
    except ValidationError as error:
        raise InputError(f"{what} cannot be used: {first_fault(error)}; {advice}.") from error
    except RecursionError as error:
        raise InputError(f"{what} cannot be used: it is nested too deeply; {advice}.") from error


def first_fault(error: ValidationError, *, leave_out: Collection[str] = ()) -> str:
    """Return the place, the value and the rule of the first entry that is not valid, in one line of limited length."""
    first = error.errors(include_url=False, include_context=False)[0]
    place = ".".join(str(part) for part in first["loc"] if part not in leave_out) or "its content"
    if not place.isprintable() or len(place) > 2 * _SHOWN:
        place = shown(place)
    rule = {
        "extra_forbidden": "unknown key; remove it or correct its spelling",
        "missing": "required key is missing",
    }.get(first["type"], first["msg"][0].lower() + first["msg"][1:].split(" or instance of ")[0])
    rule = rule if len(rule) <= 3 * _SHOWN else f"{rule[: 3 * _SHOWN]}…"
    given = "" if first["type"] == "missing" else f" = {shown(first['input'])}"
    return f"{place}{given}: {rule}"


def shown(value: Any) -> str:
    """Return what to show of a value: all of a short one, the beginning of a long one, and no control characters."""
    if isinstance(value, dict) or (isinstance(value, list) and not all(isinstance(one, (int, float)) for one in value)):
        return f"a table of {len(value)} keys" if isinstance(value, dict) else f"a list of {len(value)} entries"
    if isinstance(value, int) and abs(value) >= 10**_SHOWN:
        return f"a whole number of {value.bit_length()} bits"  # the program need not be able to write it
    text = " ".join((repr(value[: _SHOWN + 1]) if isinstance(value, (str, list)) else repr(value)).split())
    return text if len(text) <= _SHOWN + 3 else f"{text[:_SHOWN]}…"


def _fault_of(found: xr.Variable, entry: Entry, optional_dim: str) -> str:
    """Say in words what of a variable is not as its entry says; nothing if all is."""
    dims = tuple(str(dim) for dim in found.dims)
    if optional_dim and dims[:1] == (optional_dim,):
        dims = dims[1:]
    if dims != tuple(dim for dim in entry.dims if dim != optional_dim):
        return f"has dims {found.dims}, and must have {entry.dims}"
    kinds, words = _KINDS[entry.kind]
    values = found.values
    whole = entry.kind == "whole" and not entry.flags and _all_whole(values)  # bits are no floats, numbers may be
    if values.dtype.kind == "O" and "O" in kinds and not _all_texts(values):
        wrong = next(value for value in values.ravel().tolist() if not isinstance(value, str))
        return f"holds {wrong!r}, and must hold {words}"
    if values.dtype.kind not in kinds and not whole:
        return f"holds {_type_words(values.dtype)}, and must hold {words}"
    unit = found.attrs.get("units", "")
    stated = not isinstance(unit, str) or unit.strip() != ""
    if entry.unit and stated and (not isinstance(unit, str) or _unit(unit) != _unit(entry.unit)):
        return f"is in {shown(_as_plain(unit))}, and must be in {entry.unit!r}"
    if entry.values and tuple(values.tolist()) != entry.values:
        return f"is {', '.join(map(str, values.tolist()))[:_SHOWN]}, and must be {', '.join(map(str, entry.values))}"
    return _fault_of_values(values, entry, found.attrs)


def _all_whole(values: Any) -> bool:
    return values.dtype.kind == "f" and bool(np.all((np.abs(values) < 2.0**53) & (values == np.round(values))))


def _fault_of_values(values: Any, entry: Entry, attributes: Mapping[Any, Any]) -> str:
    if entry.positive and (values <= 0.0).any():
        return f"holds {values[values <= 0.0][0]}, and must be above zero"
    if entry.kind == "number" and (beyond := np.abs(values) > entry.most).any():
        return f"holds {values[beyond][0]:g}, and must hold numbers up to {entry.most:g}"
    if entry.kind == "number" and (below := values < entry.least).any():
        return f"holds {values[below][0]:g}, and must hold no number below {entry.least:g}"
    if entry.flags and not _names_bits(attributes):
        return "has flag_masks and flag_meanings that do not fit each other"
    return ""


def _writable(values: Any) -> Any:
    """Return plain values without what no text holds: names of files may have it, and need not be text."""
    if isinstance(values, str):
        return _SURROGATE.sub("?", values.encode("utf-8", "replace").decode("utf-8"))
    if isinstance(values, dict):
        return {_writable(key): _writable(value) for key, value in values.items()}
    return [_writable(value) for value in values] if isinstance(values, list) else values


def _all_texts(values: Any) -> bool:
    return all(isinstance(one, str) for one in values.ravel().tolist())


def _type_words(dtype: Any) -> str:
    return next((words for kinds, words in _KINDS.values() if dtype.kind in kinds), f"values of type {dtype}")


@lru_cache(maxsize=256)
def _unit(text: str) -> Mapping[str, int]:
    """Return the powers of the units in a text: those of ``m s-1``, ``m/s`` and ``m·s⁻¹`` are the same."""
    plain = text.strip().lower().translate(_POWERS)
    if square := _SQUARE.fullmatch(plain):
        return {name: 2 * power for name, power in _unit(square[1]).items()}
    above, *below = plain.split("/")
    found: dict[str, int] = {}
    for part, sign in ((above, 1), *((one, -1) for one in below)):
        if _UNIT.sub("", part).strip(" *") not in ("", "1"):
            return {text: 1}
        for name, power in _UNIT.findall(part):
            word = _UNIT_WORDS.get(name, name)
            found[word] = found.get(word, 0) + sign * int(power or 1)
    return {name: power for name, power in found.items() if power}


def _names_bits(attributes: Mapping[Any, Any]) -> bool:
    """Tell whether there is a whole number for each meaning, and no others."""
    masks, meanings = _as_plain(attributes.get("flag_masks", [])), attributes.get("flag_meanings", "")
    masks = masks if isinstance(masks, list) else [masks]
    whole = all(isinstance(mask, int) and not isinstance(mask, bool) and 0 <= mask < 2**31 for mask in masks)
    return isinstance(meanings, str) and whole and len(masks) == len(meanings.split())


def _as_plain(value: Any) -> Any:
    """Return an attribute as Python has it."""
    return value.tolist() if hasattr(value, "tolist") else value
