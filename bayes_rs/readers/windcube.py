"""WindCube scanning lidars: NetCDF files with one or many rays, as the instrument writes them or flattened."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bayes_rs.errors import InputError
from bayes_rs.readers.cfradial import velocities_in
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_NETCDF_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.netcdf_file import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf_file import glance
from bayes_rs.readers.ray_times import accumulation_time_of, times_of
from bayes_rs.readers.ray_variables import join_rays, own_names, rays_from
from bayes_rs.readers.rays import Rays

NAMES = {
    "radial_velocity": "radial_wind_speed",
    "time": "time",
    "azimuth": "azimuth",
    "elevation": "elevation",
    "distance": "range",
    "cnr": "cnr",
    "status": "radial_wind_speed_status",
    "height": "measurement_height",
}
STATUS_VALID = 1.0
"""``radial_wind_speed_status`` of an accepted velocity; 0 is rejected."""


def recognises_windcube(file: Path) -> bool:
    """Say whether a file is a WindCube's: by its variables in the root or in a group, or by a list of no groups."""
    try:
        groups = glance(file)
    except InputError:
        return False
    own = {NAMES[name] for name in ("radial_velocity", "azimuth", "elevation", "distance")}
    if any(own <= set(group.names) for group in groups.values()):
        return True
    others = {name for group in groups.values() for name in velocities_in(group)} - {NAMES["radial_velocity"]}
    return "sweep_group_name" in groups["/"].names and not others  # CfRadial 2 lists its groups, too


def windcube_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the rays of one file.

    Parameters
    ----------
    file : Path
        A NetCDF file of a scanning WindCube (100S, 200S, 400S): CfRadial-like, with a group for each sweep that the
        root's ``sweep_group_name`` lists, or all variables in the root.
    file_format : FileFormat
        The reader's options. The status of a good sample is 1 if they do not say.

    Returns
    -------
    rays : Rays
        The file stamps a ray at its end; times go to its start where the file says how long it took.

    Raises
    ------
    InputError
        If the file cannot be read, or a variable is missing or cannot be used.

    Notes
    -----
    Read from the variables: ``radial_wind_speed`` (time, gate), m/s, positive away; ``cnr``, dB;
    ``radial_wind_speed_status``; ``azimuth``, clockwise from north, and ``elevation``, degrees; ``range``, m, over the
    gates or over rays and gates (slant and vertical rays of one scan have different ranges); ``time``, counted from
    the file's own epoch or from the text in ``time_reference``; ``ray_accumulation_time``, ms; ``measurement_height``
    of the gates, m above the lidar, against which ``range`` is checked: some files have its rows in another order than
    the rays.

    References
    ----------
    The layout is that of the files themselves (``Conventions = "CF/Radial 2.0, CF-1.7"``), as the readers of
    lidarwind (doi:10.21105/joss.04852) and xradar describe it.
    """
    if file_format.status_valid is None:
        file_format = replace(file_format, status_valid=STATUS_VALID)
    names = own_names(NAMES, file_format)
    velocity = names["radial_velocity"]
    parts: list[Rays] = []
    groups = glance(file, names.values())
    sweeps = [group for group in groups.values() if velocity in group.variables]
    if velocity in groups["/"].variables:
        sweeps = sweeps[:1]
    for sweep in sweeps:
        parts.append(
            rays_from(
                sweep,
                file,
                file_format,
                kind="windcube",
                names=names,
                time=times_of(sweep, names["time"], file),
                accumulation_time=accumulation_time_of(sweep),
                first_row=1 + sum(len(part.time) for part in parts),
            )
        )
    if not parts:
        raise InputError(
            f"File {str(file)!r} has no variable {velocity!r}, in its root or in a group: it is not a WindCube's "
            "NetCDF file, or of a scan that was broken off; leave it out, or give another file_format."
        )
    return join_rays(parts)


read_windcube = by_rays(windcube_rays)

READER = Reader(
    name="windcube",
    title="WindCube scanning lidar (100S, 200S, 400S), NetCDF with rays",
    source="the files' own CF/Radial layout, as lidarwind (doi:10.21105/joss.04852) and xradar read it",
    suffixes=NETCDF_SUFFIXES,
    recognises=lambda file, *_: recognises_windcube(file),
    read=read_windcube,
    rays=windcube_rays,
    defaults={"positive": "away", "time_stamp": "end", "status_valid": STATUS_VALID},
    in_utc=True,
    uses=OF_NETCDF_RAYS,
)
