"""Commands that fit records and show what came of it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayes_rs.cli.options import (
    chosen_nuisances,
    chosen_scan,
    given_records,
    instrument_noise_option,
    nuisance_options,
    read_or_make_records,
    read_series,
    reading_choices,
    reading_options,
    record_choices,
    record_options,
    records_of,
    scan_options,
)

if TYPE_CHECKING:
    from bayes_rs.fits.fit_job import Outcome
    from bayes_rs.fits.long_job import LongOutcome

EXIT_FLAGGED = 1
_JOB_OPTIONS = (
    "noise_file",
    "turbulence",
    "noise_method",
    "prior",
    "target",
    "sampler",
    "likelihood",
    "target_ess",
    "instrument_noise",
    "prob",
    "derived",
    "seed",
)
"""Options of `fit` that both kinds of jobs take under the same name."""
_SENSITIVITY_OPTIONS = (
    "noise_file",
    "turbulence",
    "noise_method",
    "prior",
    "factors",
    "prob",
    "target",
    "sampler",
    "instrument_noise",
    "seed",
)
"""Options of `sensitivity` that its job takes under the same name."""


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@scan_options
@reading_options
@record_options
@click.option(
    "--noise",
    "noise_file",
    type=click.Path(path_type=Path),
    help="Noise file; by default it is made for the records' wind speeds and directions.",
)
@click.option(
    "--turbulence", default="fu-2022", show_default=True, help="Turbulence of the noise, if no noise file is given."
)
@click.option("--noise-method", default="theory", show_default=True, help="theory or boxes, if no noise file is given.")
@click.option(
    "--prior",
    default="weak",
    show_default=True,
    help="Its name, with parameters if any, as ratio:vv=0.6,sd_vv=0.3; an unknown one lists them.",
)
@click.option("--target", default="record", show_default=True, help="record, ensemble or sonic: which R.")
@click.option(
    "--sampler",
    default="emcee",
    show_default=True,
    help="emcee, direct, auto or emcee-plain; auto is direct, and emcee for the records where that does not do.",
)
@click.option(
    "--likelihood", default="log-normal", show_default=True, help="log-normal, gamma, gaussian or gaussian-plugin."
)
@nuisance_options
@click.option("--ess", "target_ess", type=int, default=1000, show_default=True, help="Effective sample size to reach.")
@instrument_noise_option
@click.option("--prob", type=float, default=0.9, show_default=True, help="Probability of the credible intervals.")
@click.option(
    "--derived",
    multiple=True,
    help="More rows in the summary: ti, ti_v, ti_w, tke, friction_velocity, correlation_uv, correlation_uw, "
    "correlation_vw, anisotropy_2, anisotropy_3, lumley_xi, lumley_eta.",
)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option(
    "--draws",
    type=click.Choice(["full", "float32", "float64", "zarr", "none"]),
    default="full",
    show_default=True,
    help="What is kept of the draws. full: the result in one NetCDF file, with figures, for up to 2000 records. "
    "The others are for any number of records, part by part into Parquet tables, or a Zarr store beside them; then "
    "files are read piece by piece, and a file that cannot be used is named at the end.",
)
@click.option("--workers", type=int, default=1, show_default=True, help="Processes that share the work; not with full.")
@click.option("--scheduler", help="Address of a Dask scheduler whose workers share the work; not with full.")
@click.option("--resume", is_flag=True, help="Go on with an interrupted run of the same command; not with full.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def fit(
    files: tuple[Path, ...],
    output: Path,
    draws: str,
    workers: int,
    scheduler: str | None,
    resume: bool,
    overwrite: bool,
    **options: Any,
) -> None:
    """Estimate the Reynolds stresses of every record, with credible intervals.

    FILES are radial velocities (files, folders or patterns), or records that `bayes-rs records` wrote: of a year, one
    file a month, say.
    """
    from bayes_rs.fits.fit_job import run_fit
    from bayes_rs.fits.long_job import MOST_FULL, run_folder_fit, run_long_fit
    from bayes_rs.output import check_output_folder

    if not resume:
        check_output_folder(output, overwrite=overwrite)
    scan = chosen_scan(options)
    made = given_records(files, scan)
    common: dict[str, Any] = {
        **{name: options[name] for name in _JOB_OPTIONS},
        "overwrite": overwrite,
        "say": lambda line: click.echo(line, err=True),
    }
    shared: dict[str, Any] = {"draws": draws, "workers": workers, "scheduler": scheduler, "resume": resume}
    outcome: Outcome | LongOutcome
    if made is None and draws != "full":
        if options["motion"]:
            raise click.UsageError(
                "--motion needs all records at once: make them with bayes-rs records --motion first, and fit those."
            )
        outcome = run_folder_fit(
            [str(file) for file in files],
            scan,
            output,
            reading=reading_choices({**options, "on_bad_file": "skip"}),
            recording=record_choices(options),
            nuisances=chosen_nuisances(None, options),
            **common,
            **shared,
        )
        _tell(outcome, output)
        return
    if made is None:
        made = records_of(read_series(files, scan, options), scan, options)
    common |= {"nuisances": chosen_nuisances(made, options), "source_files": [file.name for file in files]}
    n_record = made.sizes["record"]
    if draws == "full" and n_record > MOST_FULL:
        click.echo(
            f"{n_record} records: more than {MOST_FULL}, so no draws and no figures are kept; "
            "--draws float32 keeps the draws",
            err=True,
        )
        draws = "none"
    if draws == "full":
        if resume or workers != 1 or scheduler is not None:
            raise click.UsageError(
                f"--resume, --workers and --scheduler are not for --draws full, which up to {MOST_FULL} records have "
                "by default: add --draws none, float32, float64 or zarr."
            )
        outcome = run_fit(made, scan, output, **common)
    else:
        outcome = run_long_fit(made, scan, output, **{**shared, "draws": draws}, **common)
    _tell(outcome, output)


def _tell(outcome: Outcome | LongOutcome, output: Path) -> None:
    """Say what came of a fit; exit with 1 if there were failures."""
    for line in outcome.words:
        click.echo(line)
    click.echo(f"{outcome.n_fitted} of {outcome.n_record} records fitted; results in {output}")
    for line in [*outcome.flags, *outcome.failures]:
        click.echo(line, err=True)
    if outcome.failures:
        sys.exit(EXIT_FLAGGED)


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@scan_options
@reading_options
@record_options
@click.option(
    "--noise",
    "noise_file",
    type=click.Path(path_type=Path),
    help="Noise file; by default it is made for the records' wind speeds and directions.",
)
@click.option(
    "--turbulence", default="fu-2022", show_default=True, help="Turbulence of the noise, if no noise file is given."
)
@click.option("--noise-method", default="theory", show_default=True, help="theory or boxes, if no noise file is given.")
@click.option("--prior", default="weak", show_default=True, help="The prior whose width is varied, as for fit.")
@click.option(
    "--factor",
    "factors",
    type=float,
    multiple=True,
    default=(0.5, 2.0),
    show_default=True,
    help="Factor of all widths of the prior; several are compared.",
)
@click.option("--target", default="record", show_default=True, help="record, ensemble or sonic: which R.")
@click.option("--sampler", default="auto", show_default=True, help="emcee, direct, auto or emcee-plain.")
@nuisance_options
@instrument_noise_option
@click.option("--prob", type=float, default=0.9, show_default=True, help="Probability of the central intervals.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="CSV file to write, with all columns.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def sensitivity(files: tuple[Path, ...], output: Path | None, overwrite: bool, **options: Any) -> None:
    """Fit the records under narrower and wider priors, and say which stresses the data decided.

    FILES are radial velocities, or one NetCDF file that `bayes-rs records` wrote.
    """
    from contextlib import nullcontext

    from bayes_rs.fits.sensitivity_job import run_sensitivity, sensitivity_lines
    from bayes_rs.output import output_file, write_csv

    with nullcontext() if output is None else output_file(output, overwrite=overwrite) as part:
        made, scan = read_or_make_records(files, options)
        table = run_sensitivity(
            made,
            scan,
            **{name: options[name] for name in _SENSITIVITY_OPTIONS},
            nuisances=chosen_nuisances(made, options),
            say=lambda line: click.echo(line, err=True),
        )
        if part is not None:
            write_csv(table, part, index=False)
    click.echo(
        f"Widths of {100.0 * options['prob']:g} % intervals, m² s⁻², medians over the fitted of "
        f"{made.sizes['record']} records. With the prior's width times a factor:"
    )
    click.echo("the posterior's width over its own under the prior itself; near 1, the data decide.")
    for line in sensitivity_lines(table):
        click.echo(line)
    if output is not None:
        click.echo(f"table in {output}")


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--record", default="0", show_default=True, help="Number of the record, or its start as 2020-09-04T12:00 (UTC)."
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Picture to write; by default corner-RECORD.png in FOLDER."
)
@click.option("--overwrite", is_flag=True, help="Replace an existing picture.")
def corner(folder: Path, record: str, output: Path | None, overwrite: bool) -> None:
    """Draw the posterior of one record of a fit, with the outline of the prior."""
    from bayes_rs.fits.fit_job import open_result
    from bayes_rs.output import output_file
    from bayes_rs.plot.plots import plot_corner

    figure = plot_corner(open_result(folder), record)
    picture = output if output is not None else folder / f"corner-{record.replace(':', '')}.png"
    with output_file(picture, overwrite=overwrite) as part:
        figure.savefig(part, dpi=130)
    click.echo(str(picture))
