"""Commands that compare and choose scans."""

from __future__ import annotations

import importlib
import types
import typing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from bayes_rs.options import Option


class _Range(click.ParamType):  # type: ignore[type-arg] # generic in new versions of click only
    """Two numbers, FROM:TO."""

    name = "range"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Return the two numbers."""
        try:
            start, end = (float(part) for part in value.split(":"))
        except ValueError:
            self.fail(f"Invalid range {value!r}: write it as FROM:TO, such as 200:340.", param, ctx)
        return start, end


class _OptionsCommand(click.Command):
    """A command whose options are made of classes of options, which are loaded when they are asked for."""

    classes: tuple[str, ...] = ()
    _params: list[click.Parameter]
    _complete = False

    @property
    def params(self) -> list[click.Parameter]:
        """The parameters: one for each field of the classes, and the command's own."""
        if not self._complete:
            self._complete = True
            fields = [_click_option(entry) for entry in self.fields() if entry.flag]
            first = [param for param in self._params if isinstance(param, click.Argument)]
            self._params = [*first, *fields, *(param for param in self._params if param not in first)]
        return self._params  # click itself adds to this list

    @params.setter
    def params(self, own: list[click.Parameter]) -> None:
        self._params = own

    def fields(self) -> list[Option]:
        """Return the fields of the classes."""
        from bayes_rs.options import options_of

        places = [place.split(":") for place in self.classes]
        found = [getattr(importlib.import_module(module), name) for module, name in places]
        return [entry for cls in found for entry in options_of(cls)]


class _CompareCommand(_OptionsCommand):
    classes = ("bayes_rs.design.compare_options:CompareOptions",)


class _OptimizeCommand(_OptionsCommand):
    classes = ("bayes_rs.design.scan_limits:ScanLimits", "bayes_rs.design.scan_criteria:CriterionOptions")


def _click_option(entry: Option) -> click.Option:
    """Return the option of the command line that an option's field says."""
    kinds = typing.get_args(entry.type) if isinstance(entry.type, types.UnionType) else (entry.type,)
    several = any(typing.get_origin(kind) is not None for kind in kinds)
    default = "" if entry.default in (None, (), "") else f" [default: {entry.default}]"
    choices = entry.choices
    fixed = choices if isinstance(entry.about.choices, tuple) or entry.name == "criterion" else ()
    named = f" ({', '.join(choices)})" if choices and not fixed else ""
    unit = f" [{entry.about.unit}]" if entry.about.unit else ""
    text = f"{entry.about.help}{named}{unit}.{' Repeatable.' if several else ''}{default}"
    shared: dict[str, Any] = {"help": text, "default": None}
    if bool in kinds:
        return click.Option([f"{entry.flag}/--no-{entry.flag.removeprefix('--')}", entry.name], **shared)
    number = next((kind for kind in (int, float) if _holds(kinds, kind)), str)
    kind: Any = _Range() if entry.about.metavar == "FROM:TO" else click.Choice(fixed) if fixed else number
    metavar = entry.about.metavar or None
    return click.Option([entry.flag, entry.name], type=kind, multiple=several, metavar=metavar, **shared)


def _holds(kinds: tuple[Any, ...], kind: type) -> bool:
    return any(one is kind or kind in typing.get_args(one) for one in kinds)


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """Leave out what was not given: it has the default of its field."""
    return {name: value for name, value in options.items() if value is not None and value != ()}


_output = click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
_overwrite = click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")


@click.command(name="compare", cls=_CompareCommand)
@click.argument("scans", nargs=-1, required=True, metavar="SCAN...")
@_output
@_overwrite
def compare_command(scans: tuple[str, ...], output: Path, overwrite: bool, **options: Any) -> None:
    """Compare scans by how well they would know each stress.

    SCAN is a name that `bayes-rs scans` lists or a TOML file, with changes after an @, such as
    6-beam@opening_angle_deg=30,focus_distance=49+98 (two planes). Several values of a change, separated by /, make
    several scans: 6-beam@opening_angle_deg=15/30/45,n_beams=4/6 are six. Changes are opening_angle_deg,
    focus_distance, tilt_deg, yaw_deg, probe, n_beams (all beams of a cone) and centre (yes or no: one of them along
    the axis).
    """
    from bayes_rs.design.compare_job import run_compare

    _, words = run_compare(scans, output, options=_given(options), overwrite=overwrite)
    for line in words:
        click.echo(line)
    click.echo(f"table, figure and JSON in {output}")


@click.command(cls=_OptimizeCommand)
@click.option(
    "--beams", "n_beams", type=int, multiple=True, required=True, help="Number of beams; of several, the best is kept."
)
@click.option("--starts", "n_starts", type=int, default=24, show_default=True, help="Number of local searches.")
@click.option("--seed", type=int, default=1, show_default=True, help="Same seed, same scan.")
@_output
@_overwrite
def optimize(n_beams: tuple[int, ...], n_starts: int, seed: int, output: Path, overwrite: bool, **options: Any) -> None:
    """Choose the directions of a scan's beams, within limits, so that they tell most about R."""
    from bayes_rs.design.optimize_job import run_optimize

    options = _given(options)
    _, words = run_optimize(n_beams, output, options=options, n_starts=n_starts, seed=seed, overwrite=overwrite)
    for line in words:
        click.echo(line)
    click.echo(f"scan, numbers and picture in {output}")
