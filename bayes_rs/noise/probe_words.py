"""What the probe volume of a noise does to the variances, in one line."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import make_probe
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.geometry.scan_words import probe_in_words
from bayes_rs.models import preset_names
from bayes_rs.noise.noise import Noise

_MOST_STATES = 16  # of wind speed and direction, evenly chosen by direction: their noise is made for the line


def probe_words(noise: Noise, wind_speed: ArrayLike, yaw: ArrayLike, length_scale: ArrayLike | None = None) -> str:
    """Say which probe volume the noise counts with, and which part of the beams' variances it takes.

    Parameters
    ----------
    noise : Noise
        The noise.
    wind_speed : array_like, shape (n_record,)
        Mean wind speeds of the records, m/s; those that are not known are left out.
    yaw : array_like, shape (n_record,)
        Their wind directions relative to the lidar axis, rad.
    length_scale : array_like, shape (n_record,), optional
        Their length scales, m, where the noise knows several; by default, and where not known, the middle one of the
        noise.

    Returns
    -------
    words : str
        One line; empty if the beams are points or no record has a wind.
    """
    geometry = noise.scan_geometry
    speed, angle = np.asarray(wind_speed, dtype=np.float64), np.asarray(yaw, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(speed) & np.isfinite(angle) & (speed > 0.0))
    if not geometry.get("probe") or not len(known):
        return ""
    ordered = known[np.argsort(angle[known], kind="stable")]
    some = ordered[np.unique(np.linspace(0, len(ordered) - 1, min(len(ordered), _MOST_STATES)).round().astype(int))]
    own = None if length_scale is None else np.asarray(length_scale, dtype=np.float64)[some]
    loss = 100.0 * probe_loss(noise, speed[some], angle[some], own)
    name, at, _ = noise.scan_name.partition("@")
    change = f"{noise.scan_name}{',' if at else '@'}probe=point"
    how = f"--scan {change}" if name in preset_names("scans") else "@probe=point behind the name of its file"
    part = _span(loss.ravel())
    size = probe_in_words(make_probe(**geometry["probe"]), np.asarray(geometry["focus_distance"], dtype=np.float64))
    return f"probe volume: {size}; it takes {part} % of the beams' variances; {how} counts the beams as points"


def probe_loss(
    noise: Noise, wind_speed: ArrayLike, yaw: ArrayLike, length_scale: ArrayLike | None = None
) -> FloatArray:
    """Return the part of each beam's variance that the probe volume takes, at the turbulence of the noise.

    Parameters
    ----------
    noise : Noise
        The noise.
    wind_speed, yaw : array_like, shape (n_record,)
        Mean wind speeds, m/s, and wind directions relative to the lidar axis, rad.
    length_scale : array_like, shape (n_record,), optional
        As for `probe_words`.

    Returns
    -------
    loss : ndarray, shape (n_record, n_beam)
        1 − gain_b·R / n·R n, zero for points.
    """
    scale = np.full(np.shape(wind_speed), float(np.median(noise.length_scale)))
    if length_scale is not None:
        own = np.asarray(length_scale, dtype=np.float64)
        scale = np.where(np.isfinite(own), own, scale)
    scale = np.clip(scale, noise.length_scale.min(), noise.length_scale.max())
    gamma = np.full(np.shape(wind_speed), float(np.median(noise.gamma)))
    gain = noise.for_records(wind_speed, yaw, length_scale=scale, gamma=gamma).gain
    direction = np.asarray(noise.scan_geometry["direction"], dtype=np.float64)
    stresses = noise.turbulence.stresses()
    points = design_matrix(direction @ yaw_matrix(np.asarray(yaw, dtype=np.float64)))
    return np.asarray(1.0 - (gain @ stresses) / (points @ stresses))


def _span(values: FloatArray) -> str:
    low, high = f"{np.min(values):.2g}", f"{np.max(values):.2g}"
    if float(high) >= 100.0:
        low, high = f"{np.min(values):.0f}", f"{np.max(values):.0f}"
    return low if low == high else f"{low} to {high}"
