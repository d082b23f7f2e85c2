"""Commands about scans, records and noise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayes_rs.cli.completion import ScanName
from bayes_rs.cli.options import GroupedCommand, Quantity, refuse_given, settings_of, settings_options
from bayes_rs.cli.records_of_files import exit_if_doubtful, records_and_scan
from bayes_rs.cli.voice import answer, tell

if TYPE_CHECKING:
    from bayes_rs.noise.noise import Noise

_UNDER = 7
"""Columns by which the second line of a reason stands under its first."""
_MOUNTING = {"scan": ("opening_angle_deg", "focus_distance", "tilt_deg", "yaw_deg")}


@click.command()
@click.option("-o", "--output", default="bayes-rs-demo", show_default=True, help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier demo.")
@click.option("--seed", type=Quantity("seed", minimum=0), default=1, show_default=True, help="Same seed, same numbers.")
def demo(output: str, overwrite: bool, seed: int) -> None:
    """The main job on embedded data: what a six-beam and a single-angle lidar know of the same wind."""
    from bayes_rs.cli.demo_job import demo_widths, run_demo

    for line in run_demo(output, seed=seed, overwrite=overwrite):
        tell(line, wrap="  " not in line)
    answer({"folder": output, "unit": "m2 s-2", "width_90": demo_widths(output)})


@click.command(cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True, metavar="FILES...|SETTINGS.toml", type=click.Path())
@settings_options("scan", "files", "records", "quality", "output", only={"output": ("workers",)})
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="NetCDF file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option(
    "--turbine",
    metavar="NAME",
    help="Name of the turbine or lidar, which is kept with its records: `fit` takes those of many together.",
)
def records(files: tuple[str, ...], output: Path, overwrite: bool, turbine: str | None, **options: Any) -> None:
    """Make records, one variance per beam and averaging period, from files of radial velocities.

    A file - is the standard input: a table of text.
    """
    from bayes_rs.output import output_file, write_netcdf
    from bayes_rs.readers.standard_input import with_standard_input
    from bayes_rs.records.layout import check_turbine, with_turbine

    if turbine is not None:
        check_turbine(turbine)
    settings = settings_of(files, options)
    written = output_file(output, overwrite=overwrite, inputs=[*files, *settings.all_inputs()])
    with written as part, with_standard_input(settings.files.files) as named:
        made, _ = records_and_scan(settings.changed(files=tuple(named)))
        write_netcdf(made if turbine is None else with_turbine(made, turbine), part)
    ranges = f" at each of {made.sizes['range']} ranges" if "range" in made.sizes else ""
    tell(f"{made.sizes['record']} records{ranges} in {output}")
    answer({"file": str(output), "n_record": made.sizes["record"], "n_range": made.sizes.get("range", 1)})
    exit_if_doubtful(made)


@click.command(cls=GroupedCommand)
@click.argument("scan", type=ScanName())
@settings_options(
    "scan",
    "records",
    "noise",
    "fit",
    only={**_MOUNTING, "records": ("duration",), "noise": ("turbulence",), "fit": ("prior", "target_ess")},
)
@click.option(
    "--wind-speed", type=Quantity("wind_speed", "m/s"), default=10.0, show_default=True, help="Mean wind speed, m/s."
)
def plan(scan: str, wind_speed: float, **options: Any) -> None:
    """Say what a scene needs computed, what is skipped and why, and what bounds the error.

    SCAN is a name that `bayes-rs scans` lists, or a TOML file; changes follow an @, as in zx-tm@probe=point.
    """
    settings = settings_of((), {"scan": scan, **options})

    from bayes_rs.design.planning import plan as make_plan
    from bayes_rs.turbulence.mann import load_turbulence

    made = make_plan(
        settings.scan.load(),
        load_turbulence(settings.noise.flow),
        wind_speed=wind_speed,
        duration=settings.records.duration,
        prior=settings.fit.prior,
        target_ess=settings.fit.target_ess,
    )
    for line in made.lines():
        tell(line, indent=_UNDER if line.startswith(" ") else 2)
    answer({"title": made.title, "steps": [vars(step) for step in made.steps]})


@click.command(cls=GroupedCommand)
@click.argument("scan", type=ScanName())
@settings_options(
    "scan",
    "records",
    "noise",
    only={**_MOUNTING, "records": ("duration",), "noise": ("turbulence",)},
)
@click.option(
    "--wind-speed",
    type=Quantity("wind_speed", "m/s"),
    multiple=True,
    required=True,
    help="Mean wind speed, m/s; may be repeated, for several states of the wind.",
)
@click.option(
    "--noise-yaw",
    type=Quantity("yaw_deg", "degrees"),
    multiple=True,
    help="Wind direction relative to the lidar axis, degrees; by default that of the scan. May be repeated.",
)
@click.option(
    "--method",
    type=click.Choice(["theory", "boxes"]),
    default="theory",
    show_default=True,
    help="By theory, or by a virtual lidar in boxes of turbulence, which checks the theory.",
)
@click.option("--sonic", is_flag=True, help="With the moments that `fit --target sonic` needs.")
@click.option(
    "--boxes",
    "n_boxes",
    type=Quantity("n_boxes", minimum=2),
    default=100,
    show_default=True,
    help="Number of turbulence boxes.",
)
@click.option("--seed", type=Quantity("seed", minimum=0), default=1, show_default=True, help="Seed of the boxes.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="NetCDF file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def calibrate(
    scan: str,
    wind_speed: tuple[float, ...],
    noise_yaw: tuple[float, ...],
    method: str,
    sonic: bool,
    n_boxes: int,
    seed: int,
    output: Path,
    overwrite: bool,
    **options: Any,
) -> None:
    """Calibrate the noise of a scan's beam variances, and write it to a file for `fit --noise`.

    SCAN is a name that `bayes-rs scans` lists, or a TOML file; changes follow an @, as in zx-tm@probe=point.
    """
    settings = settings_of((), {"scan": scan, **options})

    from bayes_rs.noise.box_noise import Boxes
    from bayes_rs.noise.calibrating import calibrate as run_calibration
    from bayes_rs.output import output_file

    if method != "boxes":
        refuse_given(("n_boxes", "seed"), "it is of boxes, and the noise is made by theory: add --method boxes.")
    with output_file(output, overwrite=overwrite, inputs=settings.all_inputs()) as part:
        noise = run_calibration(
            settings.scan.load(),
            settings.noise.flow,
            wind_speed=list(wind_speed),
            yaw_deg=list(noise_yaw) or None,
            duration=settings.records.duration,
            method=Boxes(n_boxes=n_boxes, seed=seed) if method == "boxes" else method,
            sonic=sonic,
        )
        noise.save(part)
    for line in _noise_lines(noise):
        tell(line)
    tell(f"noise in {output}")
    answer(
        {
            "file": str(output),
            "states": [
                {"wind_speed": float(speed), "unit": "m/s", "least": float(error.min()), "most": float(error.max())}
                for speed, error in zip(noise.wind_speed, noise.relative_error, strict=True)
            ],
        }
    )


def _noise_lines(noise: Noise) -> list[str]:
    return [
        f"wind {speed:g} m/s: relative standard deviation of a beam variance {error.min():.3f} to {error.max():.3f}"
        for speed, error in zip(noise.wind_speed, noise.relative_error, strict=True)
    ]
