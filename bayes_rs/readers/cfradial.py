"""CfRadial, versions 1 and 2, and other NetCDF files with azimuth, elevation, range and a radial velocity."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_rs.errors import InputError
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_NETCDF_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.netcdf_file import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf_file import glance
from bayes_rs.readers.netcdf_group import Group
from bayes_rs.readers.netcdf_names import STANDARD_NAMES, VELOCITIES
from bayes_rs.readers.ray_times import accumulation_time_of, times_of
from bayes_rs.readers.ray_variables import join_rays, own_names, rays_from
from bayes_rs.readers.rays import Rays
from bayes_rs.readers.units import as_text

NAMES = {"time": "time", "azimuth": "azimuth", "elevation": "elevation", "distance": "range"}
_OTHERS = {"cnr": ("cnr", "CNR", "SNR", "snr"), "intensity": ("intensity",)}
_COMPONENTS = {"v": "u", "V": "U"}
"""Names of a velocity that are the lateral component of the wind in a file that has the other one, too."""


def recognises_cfradial(file: Path) -> bool:
    """Say whether a file has a group with azimuth, elevation, range, time and a radial velocity."""
    try:
        groups = glance(file)
    except InputError:
        return False
    return any(velocities_in(group) and set(NAMES.values()) <= set(group.variables) for group in groups.values())


def velocities_in(group: Group) -> list[str]:
    """Return the radial velocities of a group: those with a standard name; if there are none, those with a known name.

    Examples
    --------
    >>> velocities_in(Group("/", ("VEL", "WIDTH"), {"VEL": None}, {"VEL": {}}, {}))
    ['VEL']
    """
    by_standard = [name for name in group.variables if _standard_name(group, name) in STANDARD_NAMES]
    known = [name for name in VELOCITIES if name in group.variables and _COMPONENTS.get(name) not in group.names]
    return by_standard or known


def cfradial_rays(file: Path, file_format: FileFormat, *, kind: str = "cfradial") -> Rays:
    """Return the rays of one file.

    Parameters
    ----------
    file : Path
        A NetCDF file with its variables in the root (CfRadial 1) or in a group for each sweep (CfRadial 2).
    file_format : FileFormat
        The reader's options.
    kind : str
        What the rays are said to come from.

    Returns
    -------
    rays : Rays
        Times as they stand in the file: the convention does not say what part of a ray they stamp.

    Raises
    ------
    InputError
        If the file cannot be read, or it has no radial velocity, or several.

    Notes
    -----
    Read from the variables: ``azimuth``, clockwise from north, and ``elevation``; ``range``; ``time``; and the
    velocity, which is the variable with the standard name ``radial_velocity_of_scatterers_away_from_instrument``, or
    ``…_toward_instrument`` (then it counts positive towards the lidar), or else one with a usual name: ``VEL``,
    ``VR``, ``radial_velocity``, ``velocity``, ``doppler_velocity`` and others, positive away. ``cnr`` from ``cnr``,
    ``CNR``, ``SNR``, dB, or from ``intensity``, the ratio plus one.

    References
    ----------
    CfRadial data file format, versions 1.3 (2013) and 2.0 (draft, 2016), National Center for Atmospheric Research
    (github.com/NCAR/CfRadial); the standard name table of the CF conventions.
    """
    parts: list[Rays] = []
    groups = glance(file, file_format.columns.values())
    for group in groups.values():
        velocity = _velocity(group, file, file_format)
        if velocity is None:
            continue
        names = own_names({**NAMES, **_others(group), "radial_velocity": velocity}, file_format)
        parts.append(
            rays_from(
                group,
                file,
                file_format,
                kind=kind,
                names=names,
                time=times_of(group, names["time"], file),
                accumulation_time=accumulation_time_of(group),
                first_row=1 + sum(len(part.time) for part in parts),
            )
        )
    if not parts:
        raise InputError(
            f"File {str(file)!r} has no radial velocity, by a standard name or a usual one, in its root or in a group: "
            "say what the file calls it with columns={'radial_velocity': NAME} (--column radial_velocity=NAME), or "
            "give another file_format."
        )
    return join_rays(parts)


def own_options(file: Path) -> Mapping[str, Any] | None:
    """Return which way a file counts its velocity, if its standard name says so; None if not."""
    for group in glance(file).values():
        for name in velocities_in(group):
            sign = STANDARD_NAMES.get(_standard_name(group, name))
            if sign is not None:
                return {"positive": sign}
    return None


def _velocity(group: Group, file: Path, file_format: FileFormat) -> str | None:
    """Return the velocity of a group; None if it has none."""
    if "radial_velocity" in file_format.required:
        own = file_format.column("radial_velocity")
        return own if own in group.variables else None
    found = velocities_in(group)
    if len(found) > 1:
        raise InputError(
            f"File {str(file)!r} has {len(found)} radial velocities, {', '.join(map(repr, found))}: say which with "
            f"columns={{'radial_velocity': {found[0]!r}}} (--column radial_velocity={found[0]})."
        )
    return found[0] if found else None


def _others(group: Group) -> dict[str, str]:
    """Return what a group calls what not every file has."""
    return {
        name: next(one for one in known if one in group.variables)
        for name, known in _OTHERS.items()
        if any(one in group.variables for one in known)
    }


def _standard_name(group: Group, name: str) -> str:
    return as_text(group.attributes.get(name, {}).get("standard_name"))


read_cfradial = by_rays(cfradial_rays)

READER = Reader(
    name="cfradial",
    title="CfRadial 1 and 2, and other NetCDF files with azimuth, elevation, range and a radial velocity",
    source="CfRadial 1.3 and 2.0 (github.com/NCAR/CfRadial) and the standard names of the CF conventions",
    suffixes=NETCDF_SUFFIXES,
    recognises=lambda file, *_: recognises_cfradial(file),
    read=read_cfradial,
    rays=cfradial_rays,
    own_options=own_options,
    defaults={"positive": "away"},
    in_utc=True,
    uses=OF_NETCDF_RAYS,
)
