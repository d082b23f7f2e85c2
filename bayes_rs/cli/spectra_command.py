"""The command that makes spectra, and fits them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bayes_rs.cli.options import GroupedCommand, Quantity, settings_of, settings_options
from bayes_rs.cli.records_of_files import exit_if_doubtful, series_and_records, with_scan
from bayes_rs.cli.voice import answer, tell


@click.command(cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True, metavar="FILES...|SETTINGS.toml", type=click.Path())
@settings_options("scan", "files", "records", "quality", "noise", only={"noise": ("turbulence",)})
@click.option(
    "--length-scale-prior",
    type=(Quantity("length_scale_prior", "m"), Quantity("length_scale_log_sd")),
    default=(60.0, 0.8),
    show_default=True,
    help="Median of the length scale, m, and standard deviation of its logarithm.",
)
@click.option(
    "--instrument-noise",
    type=Quantity("instrument_noise", "m² s⁻²", zero=True),
    default=0.0,
    show_default=True,
    help="Expected instrument noise, m² s⁻².",
)
@click.option(
    "--instrument-noise-sd",
    "floor_sd",
    type=Quantity("instrument_noise_sd", "m² s⁻²", zero=True),
    help="Its standard deviation, m² s⁻²; 0 if it is known. By default 20 % of each variance.",
)
@click.option(
    "--tapers",
    type=Quantity("tapers", minimum=0),
    default=0,
    show_default=True,
    help="Sine tapers; 0 is the plain periodogram.",
)
@click.option(
    "--one-length-scale",
    is_flag=True,
    help="Give all records in records.nc the length scale that they have in common, not each its own.",
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def spectra(
    files: tuple[str, ...],
    output: Path,
    overwrite: bool,
    length_scale_prior: tuple[float, float],
    instrument_noise: float,
    floor_sd: float | None,
    tapers: int,
    one_length_scale: bool,
    **options: Any,
) -> None:
    """Make spectra of radial velocities; find length scale, dissipation and instrument noise of every record."""
    settings = settings_of(files, options)

    from bayes_rs.output import check_output_folder
    from bayes_rs.spectra.spectra_job import run_spectra

    check_output_folder(output, overwrite=overwrite, inputs=settings.files.files)
    settings = with_scan(settings)
    scan = settings.scan.load()
    series, made = series_and_records(settings, scan)
    lines: list[str] = []

    def say(line: str) -> None:
        lines.append(line)
        tell(line)

    run_spectra(
        series,
        made,
        scan,
        output,
        turbulence=settings.noise.flow,
        length_scale_prior=length_scale_prior,
        instrument_noise=instrument_noise,
        instrument_noise_sd=floor_sd,
        tapers=tapers,
        one_length_scale=one_length_scale,
        overwrite=overwrite,
        source_files=[Path(file).name for file in settings.files.files],
        say=say,
    )
    tell(f"results in {output}")
    answer({"folder": str(output), "lines": lines})
    exit_if_doubtful(made)
