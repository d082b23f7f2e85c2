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
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    help="CSV file with a mast's turbulence intensity, to compare with: time (start), and ti or sigma_u and U; or the "
    "series of its sonic, a TOA5 file or a folder of them, UTC.",
)
@click.option(
    "--beside", type=click.Path(path_type=Path), help="Folder of another fit of the same records, to compare with."
)
@click.option(
    "--budget", is_flag=True, help="With the uncertainty budget: what of each stress's variance comes from where."
)
@click.option("--overwrite", is_flag=True, help="Replace an existing report.")
@range_options
def report(
    folder: Path,
    output: Path | None,
    title: str | None,
    prob: float | None,
    reference: Path | None,
    beside: Path | None,
    budget: bool,
    overwrite: bool,
    distance: float | None,
    height: float | None,
) -> None:
    """Write one HTML page that shows what a fit found; it needs no network.

    Of a fit at several ranges, a page of the profile, and one for each range.
    """
    from bayes_rs.output import as_named
    from bayes_rs.report.writing import write_report

    found = fit_at_range(folder, distance, height)
    other = None if beside is None else fit_at_range(beside, distance, height)
    page = write_report(
        found,
        output,
        title=title,
        prob=prob,
        reference=reference,
        beside=other,
        budget=budget,
        overwrite=overwrite,
    )
    page = as_named(page, folder)
    tell(str(page), wrap=False)
    answer({"file": str(page)})
