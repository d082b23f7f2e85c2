"""Commands that compare and choose scans."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from bayes_rs.cli.completion import ScanName
from bayes_rs.cli.options import GroupedCommand, Quantity, class_options
from bayes_rs.cli.voice import answer, tell
from bayes_rs.design.compare_options import CompareOptions
from bayes_rs.design.scan_criteria import CriterionOptions
from bayes_rs.design.scan_limits import ScanLimits
from bayes_rs.options import from_plain, options_of

_output = click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
_overwrite = click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")


@click.command(name="compare", cls=GroupedCommand)
@click.argument("scans", nargs=-1, required=True, metavar="[LABEL=]SCAN...", type=ScanName())
@class_options((CompareOptions, "Comparison"))
@_output
@_overwrite
def compare_command(scans: tuple[str, ...], output: Path, overwrite: bool, **options: Any) -> None:
    """Compare scans by how well they would know each stress.

    SCAN is a name that `bayes-rs scans` lists or a TOML file, with changes after an @, such as
    6-beam@opening_angle_deg=30,focus_distance=49+98 (two planes). Several values of a change, separated by /, make
    several scans: 6-beam@opening_angle_deg=15/30/45,n_beams=4/6 are six. Changes are opening_angle_deg,
    focus_distance, tilt_deg, yaw_deg, probe, n_beams (all beams of a cone) and centre (yes or no: one of them along
    the axis). A LABEL before the name stands for it in table and picture, as in wide=6-beam@opening_angle_deg=45.
    """
    given = _given(options)
    from_plain(CompareOptions, given, where="the options of compare")  # before what takes a second to load

    from bayes_rs.design.compare_job import run_compare

    _, words = run_compare(scans, output, options=given, overwrite=overwrite)
    for line in words:
        tell(line, wrap="  " not in line)
    tell(f"table, figure and JSON in {output}")
    answer({"folder": str(output), **json.loads((output / "comparison.json").read_text(encoding="utf-8"))})


@click.command(cls=GroupedCommand)
@class_options((ScanLimits, "What the scan may be"), (CriterionOptions, "What it is judged by"))
@click.option(
    "--beams",
    "n_beams",
    type=Quantity("n_beams", minimum=1),
    multiple=True,
    required=True,
    help="Number of beams; of several, the best is kept.",
)
@click.option(
    "--starts",
    "n_starts",
    type=Quantity("n_starts", minimum=1),
    default=24,
    show_default=True,
    help="Number of local searches.",
)
@click.option("--seed", type=Quantity("seed", minimum=0), default=1, show_default=True, help="Same seed, same scan.")
@_output
@_overwrite
def optimize(n_beams: tuple[int, ...], n_starts: int, seed: int, output: Path, overwrite: bool, **options: Any) -> None:
    """Choose the directions of a scan's beams, within limits, so that they tell most about R."""
    options = _given(options)
    for cls in (ScanLimits, CriterionOptions):
        names = {entry.name for entry in options_of(cls)}
        from_plain(cls, {name: value for name, value in options.items() if name in names}, where="the options")

    from bayes_rs.design.optimize_job import run_optimize

    _, words = run_optimize(n_beams, output, options=options, n_starts=n_starts, seed=seed, overwrite=overwrite)
    for line in words:
        tell(line, wrap="  " not in line)
    tell(f"scan, numbers and picture in {output}")
    answer({"folder": str(output), **json.loads((output / "optimum.json").read_text(encoding="utf-8"))})


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """Leave out what was not given: it has the default of its field."""
    return {name: value for name, value in options.items() if value is not None and value != ()}
