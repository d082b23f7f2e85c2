"""Doppler lidars of the Atmospheric Radiation Measurement facility (ARM): their b1 files, NetCDF."""

from __future__ import annotations

from pathlib import Path

from bayes_rs.errors import InputError
from bayes_rs.readers.cfradial import cfradial_rays
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_NETCDF_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.netcdf_file import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf_file import glance
from bayes_rs.readers.rays import Rays

_OWN = {"base_time", "time_offset", "time", "range", "azimuth", "elevation", "radial_velocity", "intensity"}


def recognises_arm(file: Path) -> bool:
    """Say whether a file is of an ARM Doppler lidar, by its variables."""
    try:
        return set(glance(file)["/"].names) >= _OWN
    except InputError:
        return False


def arm_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the rays of one file.

    Parameters
    ----------
    file : Path
        A file of the datastreams ``dlfpt`` (staring), ``dlppi``, ``dlrhi`` or ``dlusr``, level b1.
    file_format : FileFormat
        The reader's options.

    Returns
    -------
    rays : Rays
        Times as they stand in the file.

    Raises
    ------
    InputError
        If the file cannot be read, or a variable is missing or cannot be used.

    Notes
    -----
    Read from the variables: ``radial_velocity`` (time, range), m/s, positive away, missing outside its ``valid_min``
    and ``valid_max``; ``intensity``, the signal-to-noise ratio plus one, from which ``cnr`` is 10 log₁₀(intensity −
    1) dB; ``azimuth``, clockwise from north, and ``elevation``, degrees; ``range`` to the centre of the gate, m;
    ``time``, s since midnight. ``pitch`` and ``roll``, which newer files have, are not applied.

    References
    ----------
    R. K. Newsom and R. Krishnamurthy, Doppler Lidar (DL) Instrument Handbook, DOE/SC-ARM-TR-101, 2022: sign and
    quantities; and the files' own attributes.
    """
    return cfradial_rays(file, file_format, kind="arm")


read_arm = by_rays(arm_rays)

READER = Reader(
    name="arm",
    title="ARM Doppler lidar (dlfpt, dlppi, dlrhi, dlusr), level b1, NetCDF",
    source="Doppler Lidar Instrument Handbook, DOE/SC-ARM-TR-101 (2022), and the files' own attributes",
    suffixes=NETCDF_SUFFIXES,
    recognises=lambda file, *_: recognises_arm(file),
    read=read_arm,
    rays=arm_rays,
    defaults={"positive": "away"},
    in_utc=True,
    uses=OF_NETCDF_RAYS,
)
