"""The command that says what the mean wind was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bayes_rs.cli.options import GroupedCommand, Quantity, refuse_given, settings_of, settings_options
from bayes_rs.cli.records_of_files import exit_if_doubtful, records_and_scan
from bayes_rs.cli.voice import answer, plain_number, tell


@click.command(cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True, metavar="FILES...|SETTINGS.toml", type=click.Path())
@settings_options(
    "scan",
    "files",
    "records",
    "quality",
    "noise",
    only={"noise": ("turbulence",)},
    without=("mast", "mast_position", "correlations"),
)
@click.option(
    "--heading",
    "heading_deg",
    type=Quantity("heading_deg", "degrees"),
    help="Where the lidar looks, degrees clockwise from north.",
)
@click.option(
    "--hub-height",
    type=Quantity("hub_height", "m"),
    help="Height of the lidar above the ground, m; with it a profile is fitted.",
)
@click.option(
    "--law",
    type=click.Choice(["power", "log", "linear"]),
    default="power",
    show_default=True,
    help="Profile of the mean wind, with --hub-height.",
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="CSV file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def wind(
    files: tuple[str, ...],
    output: Path,
    overwrite: bool,
    heading_deg: float | None,
    hub_height: float | None,
    law: str,
    **options: Any,
) -> None:
    """Mean wind speed, direction and shear of every record, each with its standard deviation.

    FILES are radial velocities, or records that `bayes-rs records` wrote.
    """
    # settings may name a mast, or ask for correlations: no wind is of these
    settings = settings_of(files, options).changed(mast=(), mast_position=None, correlations=False)

    from bayes_rs.output import output_file, write_csv
    from bayes_rs.turbulence.mann import load_turbulence
    from bayes_rs.wind.mean_vector import mean_wind
    from bayes_rs.wind.profile import wind_profile

    if hub_height is None:
        refuse_given(("law",), "it is of the profile, which is fitted where --hub-height is given: add that.")
    with output_file(output, overwrite=overwrite, inputs=[*files, *settings.all_inputs()]) as part:
        made, scan = records_and_scan(settings)
        flow = load_turbulence(settings.noise.flow)
        found = mean_wind(made, scan, turbulence=flow, heading_deg=heading_deg)
        names = ["wind_speed", "wind_speed_sd", "yaw", "yaw_sd", *(["wind_direction"] * ("wind_direction" in found))]
        table = found[names].to_dataframe()[names]
        if "time" in found.coords:
            table.insert(0, "time", found["time"].values)
        if hub_height is not None:
            profile = wind_profile(made, scan, turbulence=flow, hub_height=hub_height, law=law)
            for name in profile.data_vars:
                if profile[name].dims == ("record",):
                    table[f"profile_{name}"] = profile[name].values
        write_csv(table, part, index_label="record", date_format="%Y-%m-%dT%H:%M:%S")
    middle = table[["wind_speed_sd", "yaw_sd"]].median()
    answer(
        {
            "file": str(output),
            "n_record": len(table),
            "wind_speed_sd": {"median": plain_number(middle["wind_speed_sd"]), "unit": "m/s"},
            "yaw_sd": {"median": plain_number(middle["yaw_sd"]), "unit": "degree"},
        }
    )
    tell(
        f"{len(table)} records; median standard deviation of the wind speed {middle['wind_speed_sd']:.2f} m/s, of its "
        f"direction {middle['yaw_sd']:.1f}°; table in {output}"
    )
    exit_if_doubtful(made)
