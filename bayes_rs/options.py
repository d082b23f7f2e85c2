"""Options that are written once: name, type, default, unit and one line of help.

A class of options is a frozen dataclass whose fields are made with `option`. Python's keywords, settings files, the
command line, `run.json` and the tables of the documentation are all made from these fields.
"""

from __future__ import annotations

import math
import reprlib
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from bayes_rs.errors import InputError, did_you_mean, in_short

_Class = TypeVar("_Class")
_KEY = "bayes_rs option"
_NO_NUMBERS = ("inf", "-inf", "nan")
"""Numbers that JSON lacks: they are written as texts."""


@dataclass(frozen=True)
class About:
    """What an option is, beside its name, type and default.

    Parameters
    ----------
    help : str
        One line: what it does.
    unit : str
        Unit of its numbers, as ``"m/s"``; empty if they have none.
    choices : str
        Where its values are listed, as ``"bayes_rs.priors.registry:PRIORS"``: the keys of a registry; empty if there is
        no list.
    flag : str or None
        Its name on the command line, as ``"--ess"``; None for its own name, and ``""`` where the command line does not
        have it.
    metavar : str
        What stands for its value in the help, as ``"OURS=THEIRS"``.
    open : bool
        Whether other values than the listed ones are possible, too.
    """

    help: str
    unit: str = ""
    choices: str | tuple[str, ...] = ""
    flag: str | None = None
    metavar: str = ""
    open: bool = False


def option(
    default: Any = MISSING,
    help: str = "",  # noqa: A002 - the word that argparse and click have for it
    *,
    unit: str = "",
    choices: str | tuple[str, ...] = "",
    flag: str | None = None,
    metavar: str = "",
    open: bool = False,  # noqa: A002 - an open list of choices
) -> Any:
    """Return a dataclass field that says what its option is; see `About`."""
    about = {_KEY: About(help=help, unit=unit, choices=choices, flag=flag, metavar=metavar, open=open)}
    if isinstance(default, (dict, list)):
        return field(default_factory=default.copy, metadata=about)
    return field(default=default, metadata=about)


@dataclass(frozen=True)
class Option:
    """One option of a class of options: its field, its type and what it is."""

    name: str
    type: Any
    default: Any
    about: About

    @property
    def flag(self) -> str:
        """Its name on the command line; empty where the command line does not have it."""
        own = self.about.flag
        return f"--{self.name.replace('_', '-')}" if own is None else own

    @property
    def choices(self) -> tuple[str, ...]:
        """The values that it may have; empty if there is no list."""
        if not isinstance(self.about.choices, str):
            return self.about.choices
        if not self.about.choices:
            return ()
        module, _, name = self.about.choices.partition(":")
        return tuple(getattr(__import__(module, fromlist=[name]), name))


def options_of(cls: type) -> list[Option]:
    """Return the options of a class, in the order of their fields."""
    return list(_options_of(cls))


@lru_cache(maxsize=64)
def _options_of(cls: type) -> tuple[Option, ...]:
    """Return the options of a class: its hints are looked up once, and not for every file that is read."""
    hints = get_type_hints(cls)
    return tuple(
        Option(entry.name, hints[entry.name], _default(entry), entry.metadata[_KEY])
        for entry in fields(cls)
        if _KEY in entry.metadata
    )


def described(cls: type[_Class]) -> type[_Class]:
    """Complete a class of options from its fields: the section Parameters of its docstring, and the kinds of values.

    What is made of it is checked by its own rules, and for the kinds of its values.
    """
    lines = ["Parameters", "----------"]
    for entry in fields(cls):  # type: ignore[arg-type] # a dataclass: the decorator stands above its own
        about = entry.metadata[_KEY]
        optional = "" if entry.default is MISSING and entry.default_factory is MISSING else ", optional"
        lines.append(f"{entry.name} : {_in_words(str(entry.type))}{optional}")
        lines.append(f"    {about.help.rstrip('.')}{f', {about.unit}' if about.unit else ''}.")
    own = getattr(cls, "__post_init__", None)

    def checked(self: Any) -> None:
        try:
            if own is not None:
                own(self)
        except (AttributeError, OverflowError, TypeError, ValueError) as error:
            if not isinstance(error, InputError):
                check_kinds(self)  # its words are better than those of a rule that expects another kind
            raise
        check_kinds(self)

    cls.__post_init__ = checked  # type: ignore[attr-defined] # a dataclass calls it
    first, _, rest = (cls.__doc__ or "").partition("\n\n")
    body = "\n".join(line.removeprefix("    ") for line in rest.splitlines())
    cls.__doc__ = "\n\n".join(part for part in (first, "\n".join(lines), body.strip()) if part) + "\n"
    return cls


def from_plain(cls: type[_Class], values: Mapping[str, Any], *, where: str) -> _Class:
    """Make options from what a TOML file or a JSON object holds.

    Raises
    ------
    InputError
        If a key is not an option, a value is of another type, or the class refuses a value.
    """
    known = {entry.name: entry for entry in options_of(cls)}
    for name in values:
        if name not in known:
            raise InputError(f"Unknown option {name!r} in {where}: {nearest(name, known)}")
    try:
        return cls(**{name: _as_type(value, known[name].type, f"{where}, {name}") for name, value in values.items()})
    except TypeError as error:
        raise InputError(f"Invalid options in {where}: {error}.") from error


def to_plain(options: Any) -> dict[str, Any]:
    """Return options as plain values, as `from_plain` takes them: what is infinite or not a number is a text.

    Raises
    ------
    InputError
        If a value is an object that cannot be written, such as a prior of the user's own class.
    """
    return {entry.name: _plain(getattr(options, entry.name), entry.name) for entry in options_of(type(options))}


def about_option(cls: type, name: str) -> About:
    """Return what an option of a class is."""
    return next(entry.about for entry in options_of(cls) if entry.name == name)


def check_plain(cls: type, values: Mapping[str, Any], *, where: str) -> None:
    """Refuse values of a file that are of another type than their options are.

    Raises
    ------
    InputError
        For the first of them: a text where a number is wanted, say.
    """
    for entry in options_of(cls):
        if entry.name in values and not _has_type(values[entry.name], entry.type):
            words = " or ".join(dict.fromkeys(_KINDS[kind] for kind in _kinds(entry.type) if kind in _KINDS))
            given = "true" if values[entry.name] is True else "false" if values[entry.name] is False else None
            raise InputError(
                f"Invalid {entry.name} {given or reprlib.repr(values[entry.name])} in {where}: it must be {words}."
            )


def check_kinds(options: Any) -> None:
    """Refuse values of options that are of another kind than their types say: a text or a bool for a number, say.

    Raises
    ------
    InputError
        For the first of them.
    """
    for entry in options_of(type(options)):
        value = getattr(options, entry.name)
        if not _is_kind(value, entry.type):
            words = " or ".join(dict.fromkeys(word for kind in _members(entry.type) for word in _kind_in_words(kind)))
            unit = f" {entry.about.unit}" if entry.about.unit and isinstance(value, (int, float)) else ""
            raise InputError(f"Invalid {entry.name} {in_short(value)}{unit}: it must be {words}.")


def _members(annotation: Any) -> tuple[Any, ...]:
    union = get_origin(annotation) in (typing.Union, types.UnionType)
    return get_args(annotation) if union else (annotation,)


def _is_kind(value: Any, annotation: Any) -> bool:
    return any(_is_one_kind(value, kind) for kind in _members(annotation))


def _is_one_kind(value: Any, kind: Any) -> bool:
    origin = get_origin(kind)
    if kind in (float, int):
        return isinstance(value, Real if kind is float else Integral) and not isinstance(value, bool)
    if kind is bool:
        return isinstance(value, bool) or type(value).__name__ == "bool"  # NumPy's, which help need not load
    if origin is Mapping:
        return value is None or isinstance(value, Mapping)
    if origin in (Sequence, tuple):
        inner = get_args(kind)[0]
        if isinstance(value, (str, Path)):  # one may stand for a list of one
            return _is_kind(value, inner)
        several = isinstance(value, (list, tuple)) or getattr(value, "ndim", 0) > 0
        return several and all(_is_kind(part, inner) for part in value)
    return isinstance(value, kind)


def _kind_in_words(kind: Any) -> list[str]:
    if kind is type(None):
        return []
    origin = get_origin(kind)
    if origin is Mapping:
        return ["a mapping"]
    if origin in (Sequence, tuple):
        inner = [_PLURAL[one] for one in _members(get_args(kind)[0]) if one in _PLURAL]
        return [f"a list{' of ' + ' or '.join(inner) if inner else ''}"]
    return [_KINDS.get(kind, f"a {kind.__name__}")]


_PLURAL = {int: "whole numbers", float: "numbers", str: "texts", bool: "bools"}
_KINDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    list: "a list",
    dict: "a table",
}


def _kinds(annotation: Any) -> list[type]:
    """Return the types of plain values that an option takes."""
    found: list[type] = []
    union = get_origin(annotation) in (typing.Union, types.UnionType)
    for kind in get_args(annotation) if union else (annotation,):
        origin = get_origin(kind)
        if origin is Mapping or (isinstance(kind, type) and is_dataclass(kind)):
            found.append(dict)
        elif origin in (Sequence, tuple):
            found += [list, *([str] if str in get_args(kind) else [])]  # one text may stand for a list of one
        elif kind in _KINDS:
            found.append(kind)
    return found


def _has_type(value: Any, annotation: Any) -> bool:
    kinds = _kinds(annotation)
    if isinstance(value, bool):
        return bool in kinds
    if isinstance(value, int) or (isinstance(value, str) and value in _NO_NUMBERS):
        return float in kinds or type(value) in kinds
    return value is None or type(value) in kinds


def nearest(name: str, known: Mapping[str, Any], elsewhere: Mapping[str, tuple[str, ...]] | None = None) -> str:
    """Ask which option was meant, or say which there are; `elsewhere` are those of other sections, and their places."""
    places = elsewhere or {}
    meant = did_you_mean(name, {**known, **places})
    if not meant:
        return f"the options are {', '.join(known)}."
    close = next(one for one in {**known, **places} if meant == f"did you mean {one!r}?")
    return meant if close in known else f"did you mean {close!r} of section {'.'.join(places[close])}?"


def _default(entry: Field[Any]) -> Any:
    return entry.default_factory() if entry.default_factory is not MISSING else entry.default


def _in_words(annotation: str) -> str:
    return annotation.replace(" | ", " or ").replace(" or None", "")


def _as_type(value: Any, annotation: Any, where: str) -> Any:
    """Return a plain value as the type of an option has it: lists as tuples, texts for numbers that JSON lacks."""
    if isinstance(value, Mapping) and is_dataclass(annotation):
        return from_plain(annotation, value, where=where)  # type: ignore[arg-type] # a class of options
    kinds = get_args(annotation) if get_origin(annotation) in (typing.Union, types.UnionType) else (annotation,)
    if isinstance(value, str) and value in _NO_NUMBERS and float in kinds and str not in kinds:
        return float(value)
    if isinstance(value, list):
        return tuple(tuple(part) if isinstance(part, list) else part for part in value)
    return value


def _plain(value: Any, name: str) -> Any:
    plain: Any = value.item() if hasattr(value, "item") and not hasattr(value, "__len__") else value
    if (isinstance(plain, float) and not math.isfinite(plain)) or hasattr(plain, "__fspath__"):
        plain = str(plain)
    elif isinstance(plain, Mapping):
        plain = {str(key): _plain(part, name) for key, part in plain.items()}
    elif isinstance(plain, Sequence) and not isinstance(plain, str):
        plain = [_plain(part, name) for part in plain]
    elif is_dataclass(plain) and not isinstance(plain, type) and options_of(type(plain)):
        plain = to_plain(plain)
    elif not (plain is None or isinstance(plain, (bool, int, float, str))):
        raise InputError(
            f"Invalid {name} {plain!r}: it cannot be written to a file; give its name, or numbers and texts."
        )
    return plain
