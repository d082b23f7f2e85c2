"""The command that makes spectra, and fits them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bayes_rs.cli.options import chosen_scan, read_series, reading_options, record_options, records_of, scan_options


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@scan_options
@reading_options
@record_options
@click.option(
    "--turbulence",
    default="fu-2022",
    show_default=True,
    help="Turbulence whose anisotropy the spectra are fitted with.",
)
@click.option(
    "--length-scale-prior",
    type=(float, float),
    default=(60.0, 0.8),
    show_default=True,
    help="Median of the length scale, m, and standard deviation of its logarithm.",
)
@click.option(
    "--instrument-noise", type=float, default=0.0, show_default=True, help="Expected instrument noise, m² s⁻²."
)
@click.option(
    "--instrument-noise-sd",
    "floor_sd",
    type=float,
    help="Its standard deviation, m² s⁻²; 0 if it is known. By default 20 % of each variance.",
)
@click.option("--tapers", type=int, default=0, show_default=True, help="Sine tapers; 0 is the plain periodogram.")
@click.option(
    "--one-length-scale",
    is_flag=True,
    help="Give all records in records.nc the length scale that they have in common, not each its own.",
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def spectra(files: tuple[Path, ...], output: Path, overwrite: bool, **options: Any) -> None:
    """Make spectra of radial velocities; find length scale, dissipation and instrument noise of every record."""
    from bayes_rs.output import check_output_folder
    from bayes_rs.spectra.spectra_job import run_spectra

    check_output_folder(output, overwrite=overwrite, inputs=files)
    scan = chosen_scan(options)
    series = read_series(files, scan, options)
    made = records_of(series, scan, options)
    run_spectra(
        series,
        made,
        scan,
        output,
        turbulence=options["turbulence"],
        length_scale_prior=options["length_scale_prior"],
        instrument_noise=options["instrument_noise"],
        instrument_noise_sd=options["floor_sd"],
        tapers=options["tapers"],
        one_length_scale=options["one_length_scale"],
        overwrite=overwrite,
        source_files=[file.name for file in files],
        say=click.echo,
    )
    click.echo(f"results in {output}")
