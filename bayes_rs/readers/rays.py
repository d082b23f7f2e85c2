"""Rays: what an instrument measured along each line of sight, before the rays are told apart as beams of a scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.readers.format import FileFormat


@dataclass(frozen=True)
class Rays:
    """The rays of one file, with one or many range gates each.

    Parameters
    ----------
    file : Path
        Where they stand.
    kind : str
        Name of the format.
    file_format : FileFormat
        The options that they were read with.
    time : ndarray of datetime64[ns], shape (n_ray,)
        UTC.
    direction : ndarray, shape (n_ray, 3)
        Unit vectors in the instrument's own frame, before tilt and yaw: a nacelle lidar's axis is −x; for a
        ground-based lidar that counts azimuth clockwise from north, −x is north and y is east.
    distance : ndarray, shape (n_ray, n_gate)
        Range of each gate, m.
    radial_velocity : ndarray, shape (n_ray, n_gate)
        m/s, positive away from the lidar; NaN where missing.
    cnr, status : ndarray, shape (n_ray, n_gate), optional
        Carrier-to-noise ratio, dB, and the status as in the file.
    row : ndarray of int, shape (n_ray,)
        Where each ray stands in its file, as a person would count.
    row_word : str
        What a row is called: line, row, sample, ray.
    counts : mapping of str to int
        What was read and dropped: ``rows``, ``rows_invalid_value``, ``rows_dropped``, ``rows_without_time``,
        ``rows_without_beam``.
    accumulation_time : ndarray, shape (n_ray,), optional
        How long each ray was measured, s; NaN where the file does not say.
    facts : mapping
        What else the report says of the file.
    """

    file: Path
    kind: str
    file_format: FileFormat
    time: NDArray[np.datetime64]
    direction: FloatArray
    distance: FloatArray
    radial_velocity: FloatArray
    cnr: FloatArray | None
    status: FloatArray | None
    row: NDArray[np.int64]
    row_word: str
    counts: Mapping[str, int] = field(default_factory=dict)
    accumulation_time: FloatArray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


def direction_of(azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return unit vectors (..., 3) of rays that a ground-based lidar points to an azimuth and an elevation.

    Parameters
    ----------
    azimuth_deg : ndarray, shape (...)
        Degrees, clockwise from north.
    elevation_deg : ndarray, shape (...)
        Degrees above the horizon; 90 is the zenith, and values beyond it point backwards.

    Returns
    -------
    direction : ndarray, shape (..., 3)
        (−cos ε cos a, cos ε sin a, sin ε): −x is north, y is east, so that the yaw of a record, the wind's direction
        relative to the lidar axis, is the meteorological wind direction.
    """
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    return np.stack(
        [-np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )


def angles_of(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return azimuth, 0 to 360, and elevation, degrees, of unit vectors (..., 3); the inverse of `direction_of`.

    The azimuth of a ray within 0.05° of the vertical, which means nothing, is returned as 0.
    """
    level = np.hypot(direction[..., 0], direction[..., 1])
    elevation = np.rad2deg(np.arctan2(direction[..., 2], level))
    azimuth = np.rad2deg(np.arctan2(direction[..., 1], -direction[..., 0])) % 360.0
    upright = np.abs(elevation) > 89.95
    return np.where(upright | (azimuth == 360.0), 0.0, azimuth), elevation  # 360 is what −1e-15 % 360 rounds to
