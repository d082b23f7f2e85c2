"""Commands that fit records and show what was found."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from bayes_rs.cli.options import (
    GroupedCommand,
    PictureFile,
    Quantity,
    refuse_beside_noise,
    refuse_for_records,
    settings_of,
    settings_options,
)
from bayes_rs.cli.range_options import fit_at_range, range_options
from bayes_rs.cli.records_of_files import EXIT_FLAGGED, exit_if_doubtful, records_and_scan
from bayes_rs.cli.voice import answer, detail, note, note_detail, tell, tell_rows
from bayes_rs.fits.settings import AUTO

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from bayes_rs.fits.fit_object import Fit
    from bayes_rs.geometry.scan import Scan


@click.command(cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True, metavar="FILES...|SETTINGS.toml|run.json", type=click.Path())
@settings_options("scan", "files", "records", "quality", "noise", "fit", "output")
@click.option(
    "--save-settings",
    metavar="FILE",
    type=click.Path(),
    help="Write all these settings to a TOML file before the work begins; `bayes-rs fit FILE` repeats them.",
)
def fit(files: tuple[str, ...], save_settings: str | None, **options: Any) -> None:
    """Estimate the Reynolds stresses of every record, with credible intervals.

    FILES are radial velocities (files, folders or patterns; - is a table of text on the standard input), or records
    that `bayes-rs records` wrote. In place of
    them, or before them, a settings file, or the run.json of an earlier run, which is repeated: options and files on
    the command line count before what it says.
    """
    settings = settings_of(files, options)

    from bayes_rs.fits.from_files import fit_files
    from bayes_rs.output import check_output_folder
    from bayes_rs.records.record_files import open_record_files, single_files

    output = settings.output.output
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output': name a folder for the results.")
    refuse_beside_noise(settings)
    if not settings.output.resume:
        check_output_folder(output, overwrite=settings.output.overwrite, inputs=settings.input_files())
    named = settings.scan.scan != AUTO or settings.scan.scan_toml is not None
    # the first tells what they are: a fleet has a hundred
    first = single_files(settings.files.files)[:1]
    if first and named and open_record_files(first, settings.scan.load()) is not None:
        refuse_for_records(settings)
    if save_settings is not None:
        _check_beside(Path(save_settings), Path(output))
        if Path(save_settings).exists():
            raise click.UsageError(f"File {save_settings!r} exists, and --save-settings replaces none: give another.")
        settings.save(save_settings)
    found = fit_files(settings, say=note_detail)
    try:
        draw_pictures(found, Path(output))
    except BaseException as error:
        error.add_note(f"The fit is finished and kept in {output!r}; of its pictures some are missing.")
        raise
    _tell(found, output)


def _check_beside(file: Path, output: Path) -> None:
    """Refuse a settings file that would be the output folder, or lie in it: that is made by the run, whole."""
    if output.resolve() in (file.resolve(), *file.resolve().parents):
        raise click.UsageError(
            f"Invalid --save-settings {str(file)!r}: it is in the output folder {str(output)!r}, which holds results "
            "only. Give a place outside of it, or leave it out: the run.json of the folder repeats a run, too."
        )


def draw_pictures(found: Fit, folder: Path) -> None:
    """Draw the stresses over time and the posterior of the first fitted record into the folder of a fit.

    Of a fit at several ranges, these into the folder of each, and the profile above them.
    """
    from bayes_rs.fits.ranged_fit import RangedFit
    from bayes_rs.output import output_file
    from bayes_rs.plot.profile_plot import profile
    from bayes_rs.result_folder import list_beside

    if isinstance(found, RangedFit):
        for own in found.fits.values():
            draw_pictures(own, Path(own.place))
        figures: dict[str, Figure] = {"profile.png": profile(found)}
    else:
        figures = _figures(found)
    for name, figure in figures.items():
        with output_file(folder / name, overwrite=True) as part:
            figure.savefig(part, dpi=130)
        list_beside(folder / name)


def _figures(found: Fit) -> dict[str, Figure]:
    """Return the pictures of a fit of one range, by the names of their files."""
    from bayes_rs.plot.corner_plot import corner as draw_corner
    from bayes_rs.plot.stresses_plot import stresses

    figures: dict[str, Figure] = {"stresses.png": stresses(found)}
    if found.has_draws and found.n_fitted:
        figures["corner.png"] = draw_corner(found, int(found.fitted.argmax()))
    if found.has_campaign:
        from bayes_rs.plot.campaign_plot import campaign

        figures["campaign.png"] = campaign(found)
    return figures


def _tell(found: Fit, output: str) -> None:
    """Say what was found, the headline first; exit with 1 if there were failures."""
    from bayes_rs.fits.headline import NOTHING
    from bayes_rs.fits.ranged_fit import RangedFit

    if found.run.get("n_resumed"):
        note(f"{found.run['n_resumed']} of {found.n_record} records were finished by an earlier run")
    headline = found.headline()
    tell_rows(headline.rows(), doubtful="" if headline.doubtful == NOTHING else "doubtful")
    table = found.profile_lines() if isinstance(found, RangedFit) else []
    for line in table:
        tell(line, wrap=False)
    for line in found.words:
        if line not in table:
            detail(line)
    tell(f"results in {output}", wrap=False)
    answer({"folder": output, **headline.to_plain()})
    failures = [f"file {name}: {reason}" for name, reason in found.run.get("bad_files", {}).items()]
    if "samples_late" in found.run:
        failures.append(
            f"{found.run['samples_late']} samples came after their record was closed and are not in it, the first of "
            f"{found.run['first_late']}: sort the files by time"
        )
    failures += found.failures
    for line in found.remarks:
        note_detail(line)
    for line in failures:
        note(line)
    if failures:
        sys.exit(EXIT_FLAGGED)


@click.command(cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True, metavar="FILES...|SETTINGS.toml", type=click.Path())
@settings_options(
    "scan",
    "files",
    "records",
    "quality",
    "noise",
    "fit",
    without=("derived", "draws", "campaign", "campaign_group", "campaign_unsteady"),
)
@click.option(
    "--factor",
    "factors",
    type=Quantity("factor"),
    multiple=True,
    default=(0.5, 2.0),
    show_default=True,
    help="Factor of all widths of the prior; several are compared.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="CSV file to write, with all columns.")
@click.option(
    "--budget",
    "budgets",
    type=PictureFile(or_table=True),
    multiple=True,
    help="Tell, too, what of each stress's uncertainty comes from sampling, from what is uncertain beside R (--yaw-sd "
    "and others), and from the prior: a CSV file or a picture (.png, .pdf, .svg) to write; may be given twice.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def sensitivity(
    files: tuple[str, ...],
    factors: tuple[float, ...],
    output: Path | None,
    budgets: tuple[Path, ...],
    overwrite: bool,
    **options: Any,
) -> None:
    """Fit the records under narrower and wider priors, and say which stresses the data decided.

    With --budget, say what their uncertainty is made of. FILES are radial velocities, or records that
    `bayes-rs records` wrote.
    """
    settings = settings_of(files, options)

    from contextlib import ExitStack
    from functools import partial

    from bayes_rs.fits.prior_check import prior_sensitivity, sensitivity_lines
    from bayes_rs.intervals import interval_words
    from bayes_rs.output import output_file, write_csv

    refuse_beside_noise(settings)
    own, uncertainty = settings.fit, None
    with ExitStack() as stack:
        writing = partial(output_file, overwrite=overwrite, inputs=[*files, *settings.all_inputs()])
        part = None if output is None else stack.enter_context(writing(output))
        parts = [stack.enter_context(writing(path)) for path in budgets]
        made, scan = records_and_scan(settings)
        asked: dict[str, Any] = {
            "noise": settings.noise.noise,
            "say": note,
            "turbulence": settings.noise.turbulence,
            **{name: getattr(own, name) for name in own.__dataclass_fields__ if name != "draws"},
        }
        table = prior_sensitivity(made, scan, factors=factors, **asked)
        if part is not None:
            write_csv(table, part, index=False)
        if budgets:
            asked = {**asked, "say": lambda line: None, "derived": own.derived or ("ti",)}  # noqa: ARG005 - it is said
            uncertainty = _budget(made, scan, asked, parts)
    tell(
        f"Widths of intervals ({interval_words(own.prob, own.interval)}), m² s⁻², medians over the fitted of "
        f"{made.sizes['record']} records. With the prior's width times a factor:"
    )
    tell("the posterior's width over its own under the prior itself; near 1, the data decide.")
    for line in sensitivity_lines(table):
        tell(line, wrap=False)
    if uncertainty is not None:
        from bayes_rs.fits.budget_table import budget_lines

        tell("What the uncertainty is made of, m² s⁻², variances averaged over the records:")
        for line in budget_lines(uncertainty):
            tell(line, wrap=False)
    for file in (output, *budgets):
        if file is not None:
            tell(f"{'picture' if file != output and _is_picture(file) else 'table'} in {file}", wrap=False)
    rows = json.loads(table.to_json(orient="records"))
    found = {"file": None if output is None else str(output), "unit": "m2 s-2", "prob": own.prob, "rows": rows}
    if uncertainty is not None:
        found["budget"] = json.loads(uncertainty.to_json(orient="records"))
    answer(found)
    exit_if_doubtful(made)


def _is_picture(file: Path) -> bool:
    from bayes_rs.pictures import picture_suffixes

    return file.suffix.lower() in picture_suffixes()


def _budget(made: xr.Dataset, scan: Scan, asked: dict[str, Any], parts: list[Path]) -> pd.DataFrame:
    """Return the uncertainty budget of records, and write it: as a picture, or as a table."""
    from bayes_rs.fits.budget import budget_of_records
    from bayes_rs.output import write_csv

    table = budget_of_records(made, scan, **asked)
    for part in parts:
        if _is_picture(part):
            from bayes_rs.plot.budget_plot import budget

            cast("Figure", budget(table)).savefig(part, dpi=130)
        else:
            write_csv(table, part, index=False)
    return table


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--record", default="0", show_default=True, help="Number of the record, or its start as 2020-09-04T12:00 (UTC)."
)
@range_options
@click.option("-o", "--output", type=PictureFile(), help="Picture to write; by default corner-RECORD.png in FOLDER.")
@click.option("--overwrite", is_flag=True, help="Replace an existing picture.")
def corner(
    folder: Path, record: str, distance: float | None, height: float | None, output: Path | None, overwrite: bool
) -> None:
    """Draw the posterior of one record of a fit, with the outline of the prior."""
    from bayes_rs.output import as_named, output_file
    from bayes_rs.plot.corner_plot import corner as draw_corner
    from bayes_rs.result_folder import list_beside

    found = fit_at_range(folder, distance, height)
    figure = draw_corner(found, record)
    picture = output if output is not None else Path(found.place) / f"corner-{record.replace(':', '')}.png"
    with output_file(picture, overwrite=overwrite) as part:
        figure.savefig(part, dpi=130)
    if output is None:
        list_beside(picture)
        picture = as_named(picture, folder)
    tell(str(picture), wrap=False)
    answer({"file": str(picture)})
