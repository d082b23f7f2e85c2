"""The command that writes boxes of turbulence for simulators of loads."""

from __future__ import annotations

import json
from pathlib import Path

import click

from bayes_rs.cli.options import Quantity
from bayes_rs.cli.range_options import fit_at_range, range_options
from bayes_rs.cli.voice import answer, plain_number, tell


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--record", default="0", show_default=True, help="Number of the record, or its start as 2020-09-04T12:00 (UTC)."
)
@range_options
@click.option(
    "--format",
    "of_format",
    type=click.Choice(["hawc2", "bladed", "turbsim", "netcdf"]),
    default="hawc2",
    show_default=True,
    help="For which simulator; OpenFAST reads turbsim.",
)
@click.option(
    "--boxes",
    "n_box",
    type=Quantity("n_box", minimum=1),
    default=6,
    show_default=True,
    help="How many boxes, each of another draw of the posterior.",
)
@click.option(
    "--points",
    type=(Quantity("points", minimum=4),) * 3,
    default=(2048, 32, 32),
    show_default=True,
    metavar="X Y Z",
    help="Points of a box along the wind, across it and upwards; even numbers.",
)
@click.option(
    "--length",
    type=Quantity("length", "m"),
    help="Length of a box, m; by default the record's wind speed times its duration.",
)
@click.option(
    "--size",
    type=(Quantity("size", "m"),) * 2,
    default=(160.0, 160.0),
    show_default=True,
    metavar="WIDTH HEIGHT",
    help="Width and height of a box, m: at least those of the rotor.",
)
@click.option("--seed", type=Quantity("seed", minimum=0), default=1, show_default=True, help="Same seed, same boxes.")
@click.option(
    "--length-scale", type=Quantity("length_scale", "m"), help="Length scale of all boxes, m; by default the fit's."
)
@click.option("--gamma", type=Quantity("gamma", zero=True), help="Anisotropy of all boxes; by default the fit's.")
@click.option(
    "--hub-height",
    type=Quantity("hub_height", "m"),
    help="Height of a box's centre, m; by default its lowest point is one step above the ground.",
)
@click.option(
    "--shear-exponent",
    type=float,
    default=0.0,
    show_default=True,
    help="Of the mean wind, in files that hold it (turbsim).",
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def boxes(
    folder: Path,
    record: str,
    distance: float | None,
    height: float | None,
    of_format: str,
    n_box: int,
    points: tuple[int, int, int],
    length: float | None,
    size: tuple[float, float],
    seed: int,
    length_scale: float | None,
    gamma: float | None,
    hub_height: float | None,
    shear_exponent: float,
    output: Path,
    overwrite: bool,
) -> None:
    """Write boxes of Mann turbulence that have the stresses of draws of a record, for simulators of loads.

    FOLDER is that of a fit. Loads that are simulated with all boxes have the spread that the measurement leaves.
    """
    from bayes_rs.fits.headline import decided_words, measured_by
    from bayes_rs.fits.load_boxes import TABLE, export_boxes, record_grid
    from bayes_rs.geometry.stress import STRESSES

    found = fit_at_range(folder, distance, height)
    grid = record_grid(found, record, points=points, size=size, length=length)
    table = export_boxes(
        found,
        record,
        output,
        grid=grid,
        seed=seed,
        n_box=n_box,
        format=of_format,
        length_scale=length_scale,
        gamma=gamma,
        hub_height=hub_height,
        shear_exponent=shear_exponent,
        overwrite=overwrite,
    )
    first = table.iloc[0]
    metres = " × ".join(f"{number:.5g}" for number in grid.size)
    count, step = (" × ".join(f"{number:.4g}" for number in numbers) for numbers in (grid.shape, grid.spacing))
    tell(
        f"{len(table)} {'boxes' if len(table) > 1 else 'box'} of record {first['record']}, wind "
        f"{first['wind_speed']:.2f} m/s: {metres} m, {count} points, {step} m apart"
    )
    shown = table[["file", *STRESSES, "length_scale"]].round(2).rename(columns={"length_scale": "L"})
    tell(shown.to_string(index=False), wrap=False)
    index = int(first["record"])
    decided = found.of_stresses("decided")["decided"][index]
    tell(f"in this record {decided_words(decided, by=measured_by(found, index))}")
    tell(f"stresses in m² s⁻², L in m; boxes and {TABLE}, which says what each is of, in {output}", wrap=False)
    answer(
        {
            "folder": str(output),
            "unit": "m2 s-2",
            "grid": {"points": grid.shape, "spacing": grid.spacing, "size": grid.size, "unit": "m"},
            "decided": dict(zip(STRESSES, map(plain_number, decided), strict=True)),
            "boxes": json.loads(table.to_json(orient="records")),
        }
    )
