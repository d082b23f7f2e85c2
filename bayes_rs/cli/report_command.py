"""The command that writes the report of a fit."""

from __future__ import annotations

from pathlib import Path

import click

from bayes_rs.cli.options import Quantity
from bayes_rs.cli.range_options import fit_at_range, range_options
from bayes_rs.cli.voice import answer, tell


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="HTML file to write; by default report.html in FOLDER."
)
@click.option("--title", help="Heading of the page; by default the scan and the period.")
@click.option(
    "--prob",
    type=Quantity("prob"),
    help="Probability of the credible intervals; by default that of the fit. Needs the draws.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing report.")
@range_options
def report(
    folder: Path,
    output: Path | None,
    title: str | None,
    prob: float | None,
    overwrite: bool,
    distance: float | None,
    height: float | None,
) -> None:
    """Write one HTML page that shows what a fit found; it needs no network.

    Of a fit at several ranges, a page of the profile, and one for each range.
    """
    from bayes_rs.report.writing import write_report

    found = fit_at_range(folder, distance, height)
    page = str(write_report(found, output, title=title, prob=prob, overwrite=overwrite))
    tell(page, wrap=False)
    answer({"file": page})
