"""Frames: stresses along the mean wind, or along the axes of the levelled lidar."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray
from bayes_rs.fits.result import check_result, group
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.geometry.stress import rotate_stress

FRAMES = ("wind", "lidar")
"""Frames of the stresses: of the mean wind, or of the levelled lidar (x against its view, y to its right, z up)."""


def lidar_frame_stress(result: xr.DataTree) -> xr.DataArray:
    """Return the posterior's draws of the stresses in the frame of the levelled lidar.

    Parameters
    ----------
    result : DataTree
        From `fit`.

    Returns
    -------
    stress : DataArray, dims (chain, draw, record, component)
        The draws, m² s⁻²; ``uu`` is the variance along the lidar's axis x, ``vv`` that along y, to its right.

    Raises
    ------
    InputError
        If the tree is not a result of `fit`.

    Notes
    -----
    Each record's draws are turned by its own wind direction ψ: R_lidar = T_yaw(ψ) R T_yaw(ψ)ᵀ, since beams are
    n · T_yaw(ψ) in the mean-wind frame. No radial variance changes.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("6-beam", yaw_deg=20.0), brs.load_turbulence("fu-2022")
    >>> records = brs.make_records(brs.simulate(scan, flow, wind_speed=10.0, n_records=1, seed=1), scan)
    >>> noise = brs.noise.calibrate(scan, flow, wind_speed=10.0, method="theory", cache=False)
    >>> result = brs.fit(records, scan, noise=noise, seed=1, target_ess=200)
    >>> lidar_frame_stress(result).dims
    ('chain', 'draw', 'record', 'component')
    """
    check_result(result)
    stress = group(result, "posterior")["stress"].transpose("chain", "draw", "record", "component")
    yaw = np.deg2rad(np.asarray(group(result, "observed_data")["yaw"].values, dtype=np.float64))
    about = {**stress.attrs, "frame": "levelled lidar"}
    return stress.copy(data=to_lidar_frame(stress.values, yaw)).assign_attrs(about)


def to_lidar_frame(stress: FloatArray, yaw: ArrayLike) -> FloatArray:
    """Turn stresses (..., 6) of the mean-wind frame into the levelled lidar's; yaw (...), rad."""
    return rotate_stress(stress, yaw_matrix(-np.asarray(yaw)))
