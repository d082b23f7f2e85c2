"""Frames: stresses along the mean wind, or along the axes of the levelled lidar."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.groups import posterior
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.geometry.stress import rotate_stress

FRAMES = ("wind", "lidar")
"""Frames of the stresses: of the mean wind, or of the levelled lidar (x against its view, y to its right, z up)."""


def lidar_frame(fit: FitData) -> xr.DataArray:
    """Return the draws of a fit in the frame of the levelled lidar; see `Fit.lidar_frame`."""
    stress = posterior(fit)["stress"]
    yaw = np.deg2rad(np.asarray(fit.records["yaw"].values, dtype=np.float64))
    about = {**stress.attrs, "frame": "levelled lidar"}
    turned: xr.DataArray = stress.copy(data=to_lidar_frame(stress.values, yaw)).assign_attrs(about)
    return turned


def to_lidar_frame(stress: FloatArray, yaw: ArrayLike) -> FloatArray:
    """Turn stresses (..., 6) of the mean-wind frame into the levelled lidar's; yaw (...), rad."""
    return rotate_stress(stress, yaw_matrix(-np.asarray(yaw)))
