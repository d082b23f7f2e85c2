"""What the readers of rays look for in a NetCDF file: the names of its variables and attributes, in one list."""

from __future__ import annotations

from typing import Any

AWAY = "radial_velocity_of_scatterers_away_from_instrument"
TOWARDS = (
    "radial_velocity_of_scatterers_toward_instrument",
    "radial_velocity_of_scatterers_towards_instrument",
)
STANDARD_NAMES = {AWAY: "away", **dict.fromkeys(TOWARDS, "towards"), "radial_velocity_of_scatterers": "away"}
"""Standard names of a radial velocity in the CF conventions and in CfRadial, and which way it counts positive."""

VELOCITIES = (
    "radial_wind_speed",
    "radial_velocity",
    "VEL",
    "VR",
    "VRAD",
    "VRADH",
    "velocity",
    "doppler_velocity",
    "mean_doppler_velocity",
    "Doppler",
    "DOPPLER",
    "corrected_velocity",
    "V",
    "v",
)
"""Names of a radial velocity in files of rays, the likelier ones first."""
MARKS = ("azimuth", "azimuth_angle", "elevation", "elevation_angle")
"""A group with one of these holds rays."""

NAMES = (
    *VELOCITIES,
    *MARKS,
    "time",
    "time_reference",
    "range",
    "cnr",
    "CNR",
    "intensity",
    "SNR",
    "snr",
    "radial_wind_speed_status",
    "status",
    "ray_accumulation_time",
    "accumulation_time",
    "measurement_height",
)
"""Variables that a reader of rays can use."""

_OF_VALUES = (
    "units",
    "_FillValue",
    "missing_value",
    "scale_factor",
    "add_offset",
    "valid_range",
    "valid_min",
    "valid_max",
    "_Unsigned",
    "dtype",
)
REQUEST: dict[str, Any] = {
    "among": VELOCITIES,
    "standard_names": tuple(STANDARD_NAMES),
    "attrs": _OF_VALUES,
    "more_attrs": {
        "time": ("calendar", "long_name", "comment", "description"),
        **dict.fromkeys((*VELOCITIES, ""), ("standard_name", "positive")),
    },
    "group_attrs": (
        "accumulation_time",
        "status_valid",
        "datastream",
    ),
}
"""What `netcdf_process` is asked for, beside the names."""
