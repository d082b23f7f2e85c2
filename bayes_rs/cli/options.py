"""Options of commands, made from the classes of options, and the settings that they give."""

from __future__ import annotations

import os
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin

import click
from click.shell_completion import CompletionItem

from bayes_rs._validation import check_count, check_finite, check_non_negative, check_positive, check_seed
from bayes_rs.cli.completion import ScanName, complete_column
from bayes_rs.errors import InputError, did_you_mean, in_short
from bayes_rs.file_options import ALL_RANGES
from bayes_rs.fits.settings import RUN_SUFFIX, SECTIONS, ScanOptions, Settings
from bayes_rs.options import Option, options_of
from bayes_rs.records.record_options import ADDED, options_beside

_Command = TypeVar("_Command", bound=Callable[..., Any])
TITLES = {
    "scan": "Scan",
    "files": "Files of radial velocities",
    "records": "Records",
    "quality": "Quality",
    "noise": "Noise",
    "fit": "Fit",
    "nuisances": "What is uncertain beside R",
    "output": "Output",
}
"""Titles of the sections in the help."""
_MOST_NAMED = 12
"""Values that the help of an open option names."""
_LONGEST_CHOICE = 30
"""Characters up to which choices stand behind the option itself, and not in its help."""
_TABLES = (".csv", ".txt")
"""How the names of tables end, where a picture may stand in place of one."""
SWITCH = ("auto", "on", "off")
"""Choices that the command line has as --NAME and --no-NAME."""
_MADE_OF_SERIES = ("files", "records", "quality")
"""Sections that are of no use where the files hold records that were made before."""


class GroupedCommand(click.Command):
    """A command whose help lists its options by section, its own last."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, those of each section under its title."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None:
                groups.setdefault(getattr(parameter, "group", "Options"), []).append(record)
        for title in sorted(groups, key=lambda title: title == "Options"):
            with formatter.section(title):
                formatter.write_dl(groups[title])


class FieldOption(click.Option):
    """An option of a command that is a field of a class of options."""

    def __init__(self, *names: str, group: str, **attributes: Any) -> None:
        """Take the title of its section, beside what any option takes."""
        super().__init__(list(names), **attributes)
        self.group = group


class Number(click.types.FloatParamType):
    """A number."""

    name = "number"


class Quantity(click.ParamType):  # type: ignore[type-arg] # generic in new versions of click only
    """A number whose limits are known by its name; a whole one if it counts something."""

    name = "number"

    def __init__(self, what: str, unit: str = "", *, minimum: int | None = None, zero: bool = False) -> None:
        """Take the name of the quantity, its unit, the least if it is a count, and whether it may be zero."""
        self.what, self.unit, self.minimum, self.zero = what, unit, minimum, zero

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | int:
        """Return the number."""
        check: Callable[..., float] = check_non_negative if self.zero else check_positive
        if self.what.endswith("_deg"):
            check = check_finite
        try:
            if self.minimum is None:
                return check(float(value), what=self.what, unit=self.unit)
            number = int(value)
            return (
                check_seed(number) if self.what == "seed" else check_count(number, what=self.what, minimum=self.minimum)
            )
        except InputError as error:
            self.fail(str(error), param, ctx)
        except ValueError:
            self.fail(f"{in_short(value)} is not a {'whole ' * (self.minimum is not None)}number.", param, ctx)

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002 - click's
        """Return what stands for the value in the help."""
        return "NUMBER" if self.minimum is None else "INTEGER"


class NumberOrWord(click.ParamType):  # type: ignore[type-arg] # generic in new versions of click only
    """A number of some unit, or one of a few words."""

    name = "number"

    def __init__(self, unit: str, words: Sequence[str]) -> None:
        """Take the unit and the words, for the message."""
        self.unit, self.words = unit, tuple(words)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        """Return the number, or the word."""
        if value in self.words:
            return str(value)
        try:
            return float(value)
        except ValueError:
            unit = f", {self.unit}" if self.unit else ""
            self.fail(f"{value!r} must be a number{unit}, or the word {' or '.join(self.words)}.", param, ctx)

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002 - click's
        """Return what stands for the value in the help."""
        return f"NUMBER|{'|'.join(self.words)}"

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002 - the arguments are click's
        param: click.Parameter,  # noqa: ARG002 - as above
        incomplete: str,
    ) -> list[CompletionItem]:
        """Complete the words."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]


class ListedChoice(click.Choice):  # type: ignore[type-arg] # generic in new versions of click only
    """A text that is one of a list; another gets the nearest of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the entry of the list."""
        try:
            return str(super().convert(value, param, ctx))
        except click.BadParameter as error:
            meant = did_you_mean(value, map(str, self.choices))
            self.fail(
                f"{error.format_message().partition(': ')[2]} {meant[:1].upper()}{meant[1:]}".rstrip(), param, ctx
            )


class OpenChoice(click.ParamType):  # type: ignore[type-arg] # as above
    """A text that is often, but not always, one of a list."""

    name = "text"

    def __init__(self, choices: Callable[[], Sequence[str]]) -> None:
        """Take what returns the list."""
        self.choices = choices

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002 - the arguments are click's
        param: click.Parameter,  # noqa: ARG002 - as above
        incomplete: str,
    ) -> list[CompletionItem]:
        """Complete the entries of the list, and files."""
        words = [CompletionItem(word) for word in self.choices() if word.startswith(incomplete)]
        return words or [CompletionItem(incomplete, type="file")]


class PictureFile(click.Path):
    """A file that a picture is written to: what its name ends in is checked before anything is computed."""

    def __init__(self, *, or_table: bool = False) -> None:
        """Say whether it may be a table as well: a name that ends in .csv or .txt."""
        super().__init__(path_type=Path)
        self.others = _TABLES if or_table else ()

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        from bayes_rs.pictures import picture_suffixes  # matplotlib is slow to import

        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        allowed = (*self.others, *picture_suffixes())
        if path.suffix.lower() not in allowed:
            kind = "table or picture" if self.others else "picture"
            self.fail(f"{str(path)!r} is no name of a {kind}: end it in one of {', '.join(allowed)}.", param, ctx)
        return path


class Range(click.ParamType):  # type: ignore[type-arg] # as above
    """Two numbers, FROM:TO."""

    name = "range"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Return the two numbers."""
        try:
            start, end = (float(part) for part in value.split(":"))
        except ValueError:
            self.fail(f"Invalid range {value!r}: write it as FROM:TO, such as 200:340.", param, ctx)
        return start, end


class Distances(click.ParamType):  # type: ignore[type-arg] # as above
    """Numbers of metres with commas between them, or a word."""

    name = "distances"

    def __init__(self, words: Sequence[str]) -> None:
        """Take the words that may stand for the numbers."""
        self.words = tuple(words)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...] | str:
        """Return the numbers, or the word."""
        if value in self.words:
            return str(value)
        try:
            return tuple(float(part) for part in value.split(","))
        except ValueError:
            word = f", or the word {' or '.join(self.words)}" if self.words else ""
            self.fail(f"{value!r} must be numbers of metres with commas between them, as 80,120{word}.", param, ctx)


def settings_options(
    *sections: str, only: Mapping[str, Sequence[str]] | None = None, without: Sequence[str] = ()
) -> Callable[[_Command], _Command]:
    """Return a decorator that gives a command the options of sections of the settings.

    Parameters
    ----------
    *sections : str
        Names of sections; ``fit`` brings those of the nuisances, too.
    only : mapping of str to sequence of str, optional
        Options that are taken of a section, by their names; by default all.
    without : sequence of str
        Names of options that are left out.
    """

    def decorate(command: _Command) -> _Command:
        made: list[FieldOption] = []
        for section in sections:
            wanted = None if only is None else only.get(section)
            for entry in options_of(SECTIONS[section]):
                if entry.name in without or (wanted is not None and entry.name not in wanted):
                    continue
                nested = options_of(entry.type) if isinstance(entry.type, type) and is_dataclass(entry.type) else []
                made += [field_option(one, TITLES[entry.name]) for one in nested if one.flag]
                if entry.flag and not nested:
                    made.append(field_option(entry, TITLES[section]))
        parameters = getattr(command, "__click_params__", [])
        command.__click_params__ = [*parameters, *reversed(made)]  # type: ignore[attr-defined] # as click keeps them
        return command

    return decorate


def class_options(*classes: tuple[type, str]) -> Callable[[_Command], _Command]:
    """Return a decorator that gives a command the options of classes of options, each with the title of its group."""

    def decorate(command: _Command) -> _Command:
        made = [field_option(entry, title) for cls, title in classes for entry in options_of(cls) if entry.flag]
        parameters = getattr(command, "__click_params__", [])
        command.__click_params__ = [*parameters, *reversed(made)]  # type: ignore[attr-defined] # as click keeps them
        return command

    return decorate


def settings_of(files: Sequence[str], options: Mapping[str, Any]) -> Settings:
    """Return the settings of a command: those of a settings file, if one is named, and over them the options given.

    Parameters
    ----------
    files : sequence of str
        The command's arguments: files; or first a settings file (``.toml``) or `run.json`, and then files that count
        in place of those that it names.
    options : mapping
        Values of the command's options by name; None and empty where they were not given.

    Raises
    ------
    InputError
        If the settings file, or an option, is not valid.
    """
    given = {name: value for name, value in options.items() if value is not None and value != ()}
    if not files or Path(files[0]).suffix not in (".toml", RUN_SUFFIX):
        return Settings().changed(files=tuple(files), **given)
    settings = Settings.load(files[0])
    if any(entry.name in given for entry in options_of(ScanOptions)):
        given["scan_toml"] = None  # what the command line says of the scan counts
    if files[1:]:
        given["files"] = tuple(files[1:])
    return settings.changed(**given)


def given_options() -> list[click.Option]:
    """Return the options that stand on the command line."""
    context = click.get_current_context()
    return [
        parameter
        for parameter in context.command.params
        if isinstance(parameter, click.Option)
        and context.get_parameter_source(str(parameter.name)) is click.core.ParameterSource.COMMANDLINE
    ]


def refuse_given(names: Sequence[str], why: str) -> None:
    """Refuse options that stand on the command line and would do nothing.

    Raises
    ------
    UsageError
        If there is one; `why` follows its name.
    """
    without = [option.opts[0] for option in given_options() if option.name in names]
    if without:
        raise click.UsageError(f"{', '.join(without)}: {why}")


def refuse_for_records(settings: Settings) -> None:
    """Refuse options of reading, or of making records, for records that were made before.

    Those that the files of motion or of a mast have, too, count for these if they are named.

    Raises
    ------
    UsageError
        If there is one on the command line.
    """
    names = {entry.name for section in _MADE_OF_SERIES for entry in options_of(SECTIONS[section])}
    refuse_given(
        sorted(names - set(ADDED) - options_beside(settings.records)),
        f"for radial velocities only, and {settings.files.files[0]!r} holds records that were made before: leave it "
        "out, or give the files of radial velocities.",
    )


def refuse_beside_noise(settings: Settings) -> None:
    """Refuse options that say how noise is made, where a noise file is given.

    Raises
    ------
    UsageError
        If there is one on the command line.
    """
    if settings.noise.noise is not None:
        refuse_given(
            ("turbulence",),
            f"it says how noise is made, and the noise of {settings.noise.noise!r} is given: leave one of them out.",
        )


def field_option(entry: Option, group: str) -> FieldOption:
    """Return the command line's option that a field of a class of options says.

    Parameters
    ----------
    entry : Option
        The field.
    group : str
        Title of its section in the help.
    """
    kinds = _kinds(entry.type)
    names = [entry.name, entry.flag, *(["-o"] if entry.name == "output" else [])]
    container = next((kind for kind in kinds if get_origin(kind) in (tuple, Mapping, Sequence)), None)
    origin = get_origin(container)
    pair = origin is tuple and ... not in get_args(container)
    distances = entry.about.metavar.startswith("M,M,...")
    several = container is not None and not pair and not distances
    attributes: dict[str, Any] = {"default": None, "help": _help(entry, several=several), "group": group}
    if entry.about.metavar:
        attributes["metavar"] = entry.about.metavar
    if bool in kinds:
        if type(None) in get_args(entry.type):
            names[1] = f"{entry.flag}/--no-{entry.flag.removeprefix('--')}"
        return FieldOption(*names, is_flag=True, **attributes)
    if entry.choices == SWITCH:
        names[1] = f"{entry.flag}/--no-{entry.flag.removeprefix('--')}"
        return FieldOption(*names, is_flag=True, callback=_switch, **attributes)
    if pair:
        attributes.setdefault("metavar", "LOW HIGH")
        return FieldOption(*names, type=get_args(container), nargs=len(get_args(container)), **attributes)
    if origin is Mapping:
        value = get_args(container)[1]
        if entry.name == "columns":
            attributes["shell_complete"] = complete_column
        return FieldOption(*names, multiple=True, callback=_pairs(entry, value), **attributes)
    if not entry.about.open and len("|".join(entry.choices)) > _LONGEST_CHOICE:
        attributes.setdefault("metavar", "NAME")
    kind = _type(entry, list(get_args(container)) if several else kinds)
    if distances:
        kind = Distances([ALL_RANGES] if str in kinds else [])
        return FieldOption(*names, multiple=True, type=kind, callback=_distances(entry), **attributes)
    return FieldOption(*names, multiple=several, type=kind, **attributes)


def _kinds(annotation: Any) -> list[Any]:
    """Return the types that a value may have, None left out."""
    union = get_origin(annotation) in (Union, types.UnionType)
    return [kind for kind in (get_args(annotation) if union else (annotation,)) if kind is not type(None)]


def _type(entry: Option, kinds: list[Any]) -> Any:
    plain: list[Any] = [part for kind in kinds for part in _kinds(kind)]
    if entry.about.metavar == "FROM:TO":
        return Range()
    if float in plain:
        return NumberOrWord(entry.about.unit, entry.choices) if str in plain else Number()
    if int in plain:
        return click.INT
    if entry.name == "scan":
        return ScanName()
    if not entry.about.choices:
        return click.Path() if entry.about.metavar in ("FILE", "FOLDER") else click.STRING
    return OpenChoice(lambda: entry.choices) if entry.about.open else ListedChoice(entry.choices)


def _help(entry: Option, *, several: bool) -> str:
    """Return an option's help: what it does, what it may be, its unit and default."""
    about, text = entry.about, entry.about.help.rstrip(".")
    if about.open and len(entry.choices) <= _MOST_NAMED:
        text += f" ({', '.join(entry.choices)})"
    elif not about.open and len("|".join(entry.choices)) > _LONGEST_CHOICE:
        text += f": {', '.join(entry.choices)}"
    if entry.choices == SWITCH:
        text += f"; {entry.flag}: on, --no-{entry.flag.removeprefix('--')}: off"
    default = entry.default
    has_default = default is not None and default is not False and default not in ((), {}, "")
    extra = "; ".join(
        [
            *([about.unit] if about.unit else []),
            *(["may be repeated"] if several else []),
            *([f"default: {_shown(default)}"] if has_default else []),
        ]
    )
    return f"{text}.  [{extra}]" if extra else f"{text}."


def _shown(default: Any) -> str:
    if isinstance(default, tuple):
        return ", ".join(_shown(one) for one in default)
    return f"{default:g}" if isinstance(default, float) else str(default)


def _switch(_context: click.Context, _parameter: click.Parameter, given: bool | None) -> str | None:
    """Return what a switch is set to; None where the command line does not say."""
    return None if given is None else "on" if given else "off"


def _distances(
    entry: Option,
) -> Callable[[click.Context, click.Parameter, tuple[tuple[float, ...] | str, ...]], tuple[float, ...] | str | None]:
    """Return what puts distances together that stand after several of one flag; None where none was given."""

    def make(
        _context: click.Context, _parameter: click.Parameter, given: tuple[tuple[float, ...] | str, ...]
    ) -> tuple[float, ...] | str | None:
        words = [one for one in given if isinstance(one, str)]
        if words and len(given) > 1:
            raise click.UsageError(f"{entry.flag} {words[0]}: it stands alone; leave the other {entry.flag} out.")
        return words[0] if words else tuple(float(number) for one in given for number in one) or None

    return make


def _pairs(entry: Option, value: type) -> Callable[[click.Context, click.Parameter, tuple[str, ...]], Any]:
    """Return what makes a mapping of texts NAME=VALUE; None where none was given."""

    def make(_context: click.Context, _parameter: click.Parameter, texts: tuple[str, ...]) -> dict[str, Any] | None:
        found: dict[str, Any] = {}
        for text in texts:
            name, equals, what = text.partition("=")
            if not equals or not name:
                raise click.UsageError(f"{entry.flag} {text!r}: write it as {entry.about.metavar or 'NAME=VALUE'}.")
            if name in found:
                raise click.UsageError(f"{entry.flag} {text!r}: {name!r} is given twice.")
            try:
                found[name] = value(what)
            except ValueError:
                raise click.UsageError(f"{entry.flag} {text!r}: {what!r} must be a whole number.") from None
        return found or None

    return make
