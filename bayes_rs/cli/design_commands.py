"""Commands that compare and choose scans."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click


@click.command(name="compare")
@click.argument("scans", nargs=-1, required=True, metavar="SCAN...")
@click.option("--turbulence", multiple=True, default=("fu-2022",), show_default=True, help="Name or file; repeatable.")
@click.option("--prior", multiple=True, default=("weak",), show_default=True, help="As for fit; repeatable.")
@click.option("--wind-speed", type=float, default=10.0, show_default=True, help="Mean wind speed, m/s.")
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option("--target", default="record", show_default=True, help="record or ensemble: which R.")
@click.option(
    "--method",
    type=click.Choice(["fast", "full", "both"]),
    default="fast",
    show_default=True,
    help="fast: variances drawn from the noise model; full: simulated records.",
)
@click.option("--records", "n_records", type=int, help="Records for each scene; 128 fast, 200 full by default.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def compare_command(scans: tuple[str, ...], output: Path, **options: Any) -> None:
    """Compare scans by how well they would know each stress.

    SCAN is a name that `bayes-rs scans` lists or a TOML file, with changes after an @, such as
    6-beam@opening_angle_deg=30,focus_distance=49+98.
    """
    from bayes_rs.design.compare_job import run_compare

    _, words = run_compare(scans, output, **options)
    for line in words:
        click.echo(line)
    click.echo(f"table, figure and JSON in {output}")


@click.command(name="trade-off")
@click.option("--beams", "n_beams", type=int, default=6, show_default=True, help="Number of beams of the contours.")
@click.option("--centre/--no-centre", default=True, show_default=True, help="One of them along the axis, or none.")
@click.option("--angle", "opening_angle_deg", type=float, multiple=True, help="Opening angle, degrees; several.")
@click.option("--distance", "focus_distance", type=float, multiple=True, help="Focus distance, m; several.")
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option(
    "--at",
    type=(float, float),
    default=(15.0, 98.0),
    show_default=True,
    metavar="ANGLE DISTANCE",
    help="Where numbers of beams and record lengths vary.",
)
@click.option("--number", "numbers", type=int, multiple=True, help="Number of beams of the lines; several.")
@click.option("--record-length", "durations", type=float, multiple=True, help="Record length, s; several.")
@click.option("--turbulence", default="fu-2022", show_default=True, help="Name or file.")
@click.option("--prior", default="weak", show_default=True, help="As for fit.")
@click.option("--wind-speed", type=float, default=10.0, show_default=True, help="Mean wind speed, m/s.")
@click.option("--scan-duration", type=float, default=1.0, show_default=True, help="Time for all beams once, s.")
@click.option("--probe-of", metavar="SCAN", help="A scan whose probe volume the beams have; points by default.")
@click.option("--records", "n_records", type=int, default=32, show_default=True, help="Records for each scene.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def trade_off_command(output: Path, overwrite: bool, **options: Any) -> None:
    """Expected interval widths of beams on a cone: opening angle, focus distance, number of beams, record length."""
    from bayes_rs.design.trade_job import run_trade_off

    given = {name: value for name, value in options.items() if value != ()}  # what is not listed has the job's default
    run_trade_off(output, overwrite=overwrite, say=click.echo, **given)
    click.echo(f"tables and figure in {output}")


@click.command()
@click.option(
    "--beams", "n_beams", type=int, multiple=True, required=True, help="Number of beams; of several, the best is kept."
)
@click.option("--max-angle", "max_angle_deg", type=float, help="Largest opening angle, degrees.")
@click.option("--rotor-radius", type=float, help="Largest distance of a measured point from the axis, m.")
@click.option(
    "--focus-distance", type=float, multiple=True, default=(98.0,), show_default=True, help="m; several for planes."
)
@click.option(
    "--criterion",
    type=click.Choice(["width", "variance", "trace"]),
    default="width",
    show_default=True,
    help="Interval widths, posterior variance, or least squares under independent noise.",
)
@click.option(
    "--turbulence",
    multiple=True,
    default=("fu-2022",),
    show_default=True,
    help="Name or file; of several, the worst case counts. Without influence on trace.",
)
@click.option("--stress", "stresses", multiple=True, help="For width: which stresses count; all by default.")
@click.option("--weight", "weights", type=float, multiple=True, help="For width: weight of each --stress.")
@click.option("--prior", default="weak", show_default=True, help="As for fit.")
@click.option("--wind-speed", type=float, default=10.0, show_default=True, help="Mean wind speed, m/s.")
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option(
    "--yaw",
    "yaw_deg",
    type=float,
    multiple=True,
    help="Wind direction relative to the lidar axis, degrees, 0 by default; of several, the worst case counts.",
)
@click.option("--scan-duration", type=float, default=1.0, show_default=True, help="Time for all beams once, s.")
@click.option("--dwell", type=float, help="Time for one beam, s, in place of --scan-duration.")
@click.option("--planes", default="simultaneous", show_default=True, help="simultaneous or sequential.")
@click.option("--cones", type=int, help="How many opening angles the beams share; each its own by default.")
@click.option("--centre/--no-centre", default=None, help="Hold one beam on the axis, or none.")
@click.option("--blocked", multiple=True, metavar="FROM:TO", help="Blocked range of theta, degrees from y towards z.")
@click.option("--min-elevation", "min_elevation_deg", type=float, help="Least angle above the horizontal, degrees.")
@click.option(
    "--min-spread", "min_spread_deg", type=float, default=0.0, show_default=True, help="Angle of two beams at least."
)
@click.option("--axis", default="upwind", show_default=True, help="upwind, or up for a lidar on the ground.")
@click.option("--tilt", "tilt_deg", type=float, default=0.0, show_default=True, help="Tilt of the lidar, degrees.")
@click.option("--probe-of", metavar="SCAN", help="A scan whose probe volume the beams have; points by default.")
@click.option("--starts", "n_starts", type=int, default=24, show_default=True, help="Number of local searches.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def optimize(output: Path, overwrite: bool, **options: Any) -> None:
    """Choose the directions of a scan's beams, within limits, so that they tell most about R."""
    from bayes_rs.design.optimize_job import run_optimize

    for name in ("stresses", "weights", "yaw_deg"):
        options[name] = options[name] or None
    if len(options["n_beams"]) == 1:
        (options["n_beams"],) = options["n_beams"]
    run_optimize(output, overwrite=overwrite, say=click.echo, **options)
    click.echo(f"scan, numbers and picture in {output}")
