"""e-WindLidar: the NetCDF layout of IEA Wind Task 32 for lidar data, as the WindScanner.eu community writes it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_NETCDF_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.netcdf_file import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf_file import glance
from bayes_rs.readers.netcdf_group import Group
from bayes_rs.readers.ray_times import decode_times
from bayes_rs.readers.ray_variables import own_names, rays_from
from bayes_rs.readers.rays import Rays
from bayes_rs.stated_time import stated_times

NAMES = {
    "radial_velocity": "VEL",
    "time": "time",
    "azimuth": "azimuth_angle",
    "elevation": "elevation_angle",
    "distance": "range",
    "cnr": "CNR",
    "status": "status",
}
OLD_VELOCITY = "DOPPLER"
"""What files converted from a Galion call the radial velocity."""

_EPOCH = re.compile(r"(?:since|start at)\s+(\d{4}[-/]\d{2}[-/]\d{2}(?:[T ]\d{2}:\d{2}(?::\d{2}(?:\.\d+)?)?)?)")


def recognises_e_windlidar(file: Path) -> bool:
    """Say whether a file is in this layout, by its variables."""
    try:
        names = set(glance(file)["/"].names)
    except InputError:
        return False
    return {"azimuth_angle", "elevation_angle", "range"} <= names and bool(
        names & {NAMES["radial_velocity"], OLD_VELOCITY}
    )


def e_windlidar_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the rays of one file.

    Parameters
    ----------
    file : Path
        A NetCDF file with ``VEL`` (time, range), m/s.
    file_format : FileFormat
        The reader's options.

    Returns
    -------
    rays : Rays
        The layout stamps a ray at its start; the option ``time_stamp`` says otherwise.

    Raises
    ------
    InputError
        If the file cannot be read, a variable is missing or cannot be used, or nothing says when the time starts.

    Notes
    -----
    Read from the variables: ``VEL`` (or ``DOPPLER``), ``CNR``, dB; ``azimuth_angle``, clockwise from north, and
    ``elevation_angle``, degrees, one for all rays or one each; ``range``, m, over the gates or over rays and gates;
    ``time``, as text by ISO 8601, or in seconds since an epoch that stands in ``units``, ``long_name`` or ``comment``
    (such as ``seconds since campaign start at 2019-03-08T20:05:03.76Z``); ``accumulation_time``, s. Dimensions may have
    any names: those of the time are the rays'.

    The layout does not fix the sign of the velocity, and converters keep that of the instrument (a WindScanner counts
    positive away, a WindCube's ``.rtd`` towards): the option ``positive`` says it. ``yaw``, ``pitch`` and ``roll`` of
    the lidar are not applied: the layout counts azimuth from north and elevation from the horizon. Files of profilers
    may hold heights in ``range``; give distances along the beam.

    References
    ----------
    The layout is that of Lidaco, the converter of the e-WindLidar initiative (github.com/e-WindLidar/Lidaco: the
    table of variables and the readers).
    """
    names = own_names(NAMES, file_format)
    group = glance(file, names.values())["/"]
    if names["radial_velocity"] not in group.variables and "radial_velocity" not in file_format.required:
        names["radial_velocity"] = OLD_VELOCITY if OLD_VELOCITY in group.variables else NAMES["radial_velocity"]
    return rays_from(
        group,
        file,
        file_format,
        kind="e-windlidar",
        names=names,
        time=_times(group, names["time"], file),
        accumulation_time=_accumulation_time(group),
    )


def _times(group: Group, name: str, file: Path) -> NDArray[np.datetime64]:
    if name not in group.variables:
        return np.zeros(0, dtype="datetime64[ns]")  # rays_from refuses the file
    variable = group.variables[name]
    if not np.issubdtype(variable.dtype, np.number):
        return _times_from_text(variable, name, file)
    units = str(variable.attrs.get("units", ""))
    if " since " in units:
        return decode_times(variable, units, name, file)
    for key in ("long_name", "comment", "description"):
        found = _EPOCH.search(str(variable.attrs.get(key, "")))
        if found:
            return decode_times(variable, f"seconds since {found.group(1).replace('/', '-')}", name, file)
    raise InputError(
        f"Variable {name!r} of file {str(file)!r} counts seconds ({units!r}), and no units, long_name or comment of "
        "it says since when: correct the attribute units, for example to 'seconds since 2019-03-08 20:05:03'."
    )


def _times_from_text(variable: xr.Variable, name: str, file: Path) -> NDArray[np.datetime64]:
    text = pd.Series([_as_text(entry) for entry in variable.values.ravel()], dtype="string").str.strip("\0 ")
    parsed = stated_times(text)
    bad = (parsed.isna() & (text != "")).to_numpy(dtype=bool)
    if bad.any():
        index = int(np.argmax(bad))
        raise InputError(
            f"Invalid time {text.iloc[index]!r} in ray {index + 1} of file {str(file)!r}: {name!r} must be text such "
            "as 2016-11-10T23:30:00Z; correct the entry."
        )
    naive: NDArray[np.datetime64] = parsed.dt.tz_localize(None).to_numpy().astype("datetime64[ns]")
    return naive.reshape(variable.shape)


def _as_text(entry: object) -> str:
    return entry.decode("utf-8", errors="replace") if isinstance(entry, bytes) else str(entry)


def _accumulation_time(group: Group) -> FloatArray | None:
    """Return how long rays took, s, from the variable or the attribute of that name; None if there is none."""
    held = group.variables.get("accumulation_time")
    if held is not None and np.issubdtype(held.dtype, np.number):
        return np.asarray(held.values, dtype=np.float64)
    try:
        return np.asarray(float(group.attrs["accumulation_time"]))
    except (KeyError, TypeError, ValueError):
        return None


read_e_windlidar = by_rays(e_windlidar_rays)

READER = Reader(
    name="e-windlidar",
    title="e-WindLidar NetCDF of IEA Wind Task 32, with rays",
    source="Lidaco, the converter of the e-WindLidar initiative (github.com/e-WindLidar/Lidaco)",
    suffixes=NETCDF_SUFFIXES,
    recognises=lambda file, *_: recognises_e_windlidar(file),
    read=read_e_windlidar,
    rays=e_windlidar_rays,
    defaults={"time_stamp": "start"},
    in_utc=True,
    uses=OF_NETCDF_RAYS,
)
