"""Options of commands, made from the classes of options, and the settings that they give."""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin

import click
from click.shell_completion import CompletionItem

from bayes_rs.fits.settings import RUN_SUFFIX, SECTIONS, ScanOptions, Settings
from bayes_rs.options import Option, options_of

_Command = TypeVar("_Command", bound=Callable[..., Any])
_TITLES = {
    "scan": "Scan",
    "files": "Files of radial velocities",
    "records": "Records",
    "quality": "Quality",
    "noise": "Noise",
    "fit": "Fit",
    "nuisances": "What is uncertain beside R",
    "output": "Output",
}
_MOST_NAMED = 12
"""Values that the help of an option names."""
_MADE_OF_SERIES = ("files", "records", "quality")
"""Sections that are of no use where the files hold records that were made before."""


class GroupedCommand(click.Command):
    """A command whose help lists its options by section."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, those of each section under its title."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                groups.setdefault(getattr(parameter, "group", "Options"), []).append(record)
        for title in sorted(groups, key=lambda title: title == "Options"):
            with formatter.section(title):
                formatter.write_dl(groups[title])


class SettingsOption(click.Option):
    """An option of a command that is one of the settings."""

    def __init__(self, *names: str, group: str, **attributes: Any) -> None:
        """Take the title of its section, beside what any option takes."""
        super().__init__(list(names), **attributes)
        self.group = group


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
        """Complete the entries of the list."""
        return [CompletionItem(word) for word in self.choices() if word.startswith(incomplete)]


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
        made: list[SettingsOption] = []
        for section in sections:
            wanted = None if only is None else only.get(section)
            for entry in options_of(SECTIONS[section]):
                if entry.name in without or (wanted is not None and entry.name not in wanted):
                    continue
                nested = options_of(entry.type) if isinstance(entry.type, type) and is_dataclass(entry.type) else []
                if nested:
                    made += [_option(one, _TITLES.get(entry.name, entry.name)) for one in nested if one.flag]
                elif entry.flag:
                    made.append(_option(entry, _TITLES[section]))
        parameters = getattr(command, "__click_params__", [])
        command.__click_params__ = [*parameters, *reversed(made)]  # type: ignore[attr-defined] # as click keeps them
        return command

    return decorate


def class_options(*classes: tuple[type, str]) -> Callable[[_Command], _Command]:
    """Return a decorator that gives a command the options of classes of options, each with the title of its group."""

    def decorate(command: _Command) -> _Command:
        made = [_option(entry, title) for cls, title in classes for entry in options_of(cls) if entry.flag]
        parameters = getattr(command, "__click_params__", [])
        command.__click_params__ = [*parameters, *reversed(made)]  # type: ignore[attr-defined] # as click keeps them
        return command

    return decorate


def settings_of(files: Sequence[str], options: Mapping[str, Any]) -> Settings:
    """Return the settings of a command: those of a settings file, if one is named, and over them the options given.

    Parameters
    ----------
    files : sequence of str
        The command's arguments: files, or one settings file (``.toml``) or `run.json`.
    options : mapping
        Values of the command's options by name; None and empty where they were not given.

    Raises
    ------
    InputError
        If the settings file, or an option, is not valid.
    """
    given = {name: value for name, value in options.items() if value is not None and value != ()}
    if len(files) == 1 and Path(files[0]).suffix in (".toml", RUN_SUFFIX):
        settings = Settings.load(files[0])
        if any(entry.name in given for entry in options_of(ScanOptions)):
            given["scan_toml"] = None  # what the command line says of the scan counts
    else:
        settings = Settings().changed(files=tuple(files))
    return settings.changed(**given)


def refuse_without_effect(files: Sequence[str]) -> None:
    """Refuse options of reading, or of making records, for records that were made before: they would do nothing.

    Raises
    ------
    UsageError
        If there is one on the command line.
    """
    context = click.get_current_context()
    without = [
        parameter.opts[0]
        for parameter in context.command.params
        if getattr(parameter, "group", "") in {_TITLES[name] for name in _MADE_OF_SERIES}
        and parameter.name not in ("motion", "motion_columns")
        and context.get_parameter_source(str(parameter.name)) is click.core.ParameterSource.COMMANDLINE
    ]
    if without:
        raise click.UsageError(
            f"{', '.join(without)}: for radial velocities only, and {files[0]!r} holds records that were made before: "
            "leave it out, or give the files of radial velocities."
        )


def _option(entry: Option, group: str) -> SettingsOption:
    """Return the command line's option of one of the settings."""
    kinds = _kinds(entry.type)
    names = [entry.name, entry.flag, *(["-o"] if entry.name == "output" else [])]
    attributes: dict[str, Any] = {"default": None, "help": _help(entry), "group": group}
    if entry.about.metavar:
        attributes["metavar"] = entry.about.metavar
    container = next((kind for kind in kinds if get_origin(kind) in (tuple, Mapping, Sequence)), None)
    if bool in kinds:
        return SettingsOption(*names, is_flag=True, **attributes)
    if container is not None and get_origin(container) is tuple:
        attributes.setdefault("metavar", "LOW HIGH")
        return SettingsOption(*names, type=get_args(container), nargs=2, **attributes)
    if container is not None and get_origin(container) is Mapping:
        value = get_args(container)[1]
        return SettingsOption(*names, multiple=True, callback=_pairs(entry, value), **attributes)
    if container is not None:
        return SettingsOption(*names, multiple=True, type=_type(entry, list(get_args(container))), **attributes)
    return SettingsOption(*names, type=_type(entry, kinds), **attributes)


def _kinds(annotation: Any) -> list[Any]:
    """Return the types that a value may have, None left out."""
    union = get_origin(annotation) in (Union, types.UnionType)
    return [kind for kind in (get_args(annotation) if union else (annotation,)) if kind is not type(None)]


def _type(entry: Option, kinds: list[Any]) -> Any:
    plain: list[Any] = [part for kind in kinds for part in _kinds(kind)]
    if float in plain and str in plain:
        return NumberOrWord(entry.about.unit, entry.choices)
    if float in plain:
        return click.FLOAT
    if int in plain:
        return click.INT
    if not entry.about.choices:
        return click.STRING
    return OpenChoice(lambda: entry.choices) if entry.about.open else click.Choice(entry.choices)


def _help(entry: Option) -> str:
    about = entry.about
    unit = f", {about.unit}" if about.unit else ""
    named = f": {', '.join(entry.choices)}" if about.open and len(entry.choices) <= _MOST_NAMED else ""
    default = entry.default
    shown = "" if default is None or default is False or default in ((), {}) else f"  [default: {_shown(default)}]"
    return f"{about.help.rstrip('.')}{named}{unit}.{shown}"


def _shown(default: Any) -> str:
    return f"{default:g}" if isinstance(default, float) else str(default)


def _pairs(entry: Option, value: type) -> Callable[[click.Context, click.Parameter, tuple[str, ...]], Any]:
    """Return what makes a mapping of texts NAME=VALUE; None where none was given."""

    def make(_context: click.Context, _parameter: click.Parameter, texts: tuple[str, ...]) -> dict[str, Any] | None:
        found: dict[str, Any] = {}
        for text in texts:
            name, equals, what = text.partition("=")
            if not equals:
                raise click.UsageError(f"{entry.flag} {text!r}: write it as {entry.about.metavar or 'NAME=VALUE'}.")
            try:
                found[name] = value(what)
            except ValueError:
                raise click.UsageError(f"{entry.flag} {text!r}: {what!r} must be a whole number.") from None
        return found or None

    return make
