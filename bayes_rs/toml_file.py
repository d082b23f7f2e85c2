"""TOML files that others wrote: read with limits, and what is wrong with them in one line."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Collection, Mapping
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bayes_rs.errors import InputError

MOST_BYTES = 2 * 1024**2
"""Length of a file: that of a list of ten thousand beams."""
_SHOWN = 60
_DEEP_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]++\s*+\.\s*+){32}""")  # the time to read one is quadratic


def _check_text(text: str) -> str:
    if bad := next((character for character in text if not character.isprintable() and character not in "\n\r\t"), ""):
        raise ValueError(f"the character {bad!r} cannot stand in a text; remove it")
    return text


Text = Annotated[str, Field(max_length=100_000), AfterValidator(_check_text)]
"""A text without control characters, which no output format takes."""
Size = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False)]
"""A number above zero, and small enough that no power of it overflows."""


class Table(BaseModel):
    """A table of a file: no other keys, and numbers are numbers, not true or "1"."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path : Path
        The file, in UTF-8, also with a byte order mark.

    Returns
    -------
    table : dict
        Its content.

    Raises
    ------
    InputError
        If it is not valid TOML, or longer or deeper than any scan or turbulence.
    """
    if path.stat().st_size > MOST_BYTES:
        raise InputError(
            f"File {str(path)!r} has {path.stat().st_size} bytes: a TOML file may have {MOST_BYTES}; check that it is "
            "the right one."
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
        if not _DEEP_KEY.search(text):
            return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(f"File {str(path)!r} is nested too deeply: correct it, or give another file.") from error
    except ValueError as error:  # also what is not UTF-8, and integers of thousands of digits
        reason = " ".join(str(error).split("; use sys.")[0].split())
        raise InputError(f"File {str(path)!r} is not valid TOML: {reason}.") from error
    raise InputError(f"File {str(path)!r} has a key of more than 32 parts: correct it, or give another file.")


def invalid_file(what: str, path: Path, error: ValidationError, *, leave_out: Collection[str] = ()) -> InputError:
    """Return the error to raise for a file with entries that are not valid: it names the first.

    Parameters
    ----------
    what : str
        What the file is of.
    path : Path
        The file.
    error : ValidationError
        From pydantic.
    leave_out : collection of str
        What pydantic adds to the place of an entry that does not stand in the file.

    Returns
    -------
    error : InputError
        With the place, the value and the rule, in one line of limited length.
    """
    return InputError(f"Invalid {what} file {str(path)!r}: {first_fault(error, leave_out=leave_out)}.")


def first_fault(error: ValidationError, *, leave_out: Collection[str] = ()) -> str:
    """Return the place, the value and the rule of the first entry that is not valid; see `invalid_file`."""
    first = error.errors(include_url=False, include_context=False)[0]
    place = ".".join(str(part) for part in first["loc"] if part not in leave_out)
    if not place.isprintable() or len(place) > 2 * _SHOWN:
        place = shown(place)
    rule = {
        "extra_forbidden": "unknown key; remove it or correct its spelling",
        "missing": "required key is missing",
    }.get(first["type"], first["msg"][0].lower() + first["msg"][1:])
    rule = rule if len(rule) <= 3 * _SHOWN else f"{rule[: 3 * _SHOWN]}…"
    given = "" if first["type"] == "missing" else f" = {shown(first['input'])}"
    return f"{place}{given}: {rule}"


def shown(value: Any) -> str:
    """Return what to show of a value: all of a short one, the beginning of a long one, and no control characters."""
    if isinstance(value, dict) or (isinstance(value, list) and not all(isinstance(one, (int, float)) for one in value)):
        return f"a table of {len(value)} keys" if isinstance(value, dict) else f"a list of {len(value)} entries"
    text = " ".join((repr(value[: _SHOWN + 1]) if isinstance(value, (str, list)) else repr(value)).split())
    return text if len(text) <= _SHOWN + 3 else f"{text[:_SHOWN]}…"


def toml_value(value: Any) -> str:
    """Return a plain value as TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{toml_key(key)} = {toml_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, Integral):
        return str(int(value))
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML's basic strings are JSON's


def toml_key(key: str) -> str:
    """Return a key as TOML, in quotes."""
    return json.dumps(str(key), ensure_ascii=False)
