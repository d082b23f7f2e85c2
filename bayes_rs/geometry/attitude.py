"""Attitude: where beams point when the lidar's tilt and roll are those of the record, not those of the scan."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan, tilt_matrix, yaw_matrix
from bayes_rs.geometry.stress import STRESSES, rotate_stress


def roll_matrix(roll: ArrayLike) -> FloatArray:
    """Return T_roll, which acts on row vectors as n · T_roll; a positive roll raises the beams on the +y side.

    Parameters
    ----------
    roll : array_like, shape (...)
        Roll angle ρ about the lidar's axis, rad.

    Returns
    -------
    rotation : ndarray, shape (..., 3, 3)
        [[1, 0, 0], [0, cos ρ, sin ρ], [0, −sin ρ, cos ρ]].

    Notes
    -----
    +y is on the right of one who looks out along the beams (−x) with z up: seen from there, a positive roll turns the
    lidar anticlockwise. A beam is n · T_roll · T_tilt · T_yaw.

    Examples
    --------
    >>> (np.array([0.0, 1.0, 0.0]) @ roll_matrix(np.deg2rad(90.0))).round(12) + 0.0
    array([0., 0., 1.])
    """
    angle = np.asarray(roll, dtype=np.float64)
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., 0, 0] = 1.0
    matrix[..., 1, 1] = matrix[..., 2, 2] = np.cos(angle)
    matrix[..., 1, 2] = np.sin(angle)
    matrix[..., 2, 1] = -np.sin(angle)
    return matrix


def level_direction(scan: Scan, tilt: ArrayLike, roll: ArrayLike) -> FloatArray:
    """Return the beams in the levelled lidar frame at other tilts and rolls (rad), shape (..., n_beam, 3)."""
    return np.asarray(scan.beam_direction @ (roll_matrix(roll) @ tilt_matrix(tilt)), dtype=np.float64)


def own_attitude(records: xr.Dataset) -> tuple[FloatArray, FloatArray] | None:
    """Return tilt and roll of each record, rad, where they were measured; None where the scan's tilt holds for all.

    Raises
    ------
    InputError
        If the records have a roll and no tilt, or an angle is not finite.
    """
    if "roll" not in records:
        return None
    angles = []
    for name in ("tilt", "roll"):
        if name not in records or records[name].dims != ("record",):
            raise InputError(f"The records have no {name} with dims ('record',): make it with bayes_rs.with_motion.")
        values = np.asarray(records[name].values, dtype=np.float64)
        for index in np.flatnonzero(~np.isfinite(values)).tolist():
            raise InputError(
                f"Invalid {name} {values[index]} of record {index}: it must be a finite angle, degrees; "
                "make it with bayes_rs.with_motion."
            )
        angles.append(np.deg2rad(values))
    return angles[0], angles[1]


def record_direction(records: xr.Dataset, scan: Scan) -> FloatArray:
    """Return the beams' unit vectors in the levelled lidar frame: (n_beam, 3), or (n_record, n_beam, 3) with motion."""
    attitude = own_attitude(records)
    return scan.level_direction if attitude is None else level_direction(scan, *attitude)


def gain_turn(records: xr.Dataset, scan: Scan) -> FloatArray | None:
    """Return what takes the gains of the scan's own attitude to those of each record's; None without measured attitude.

    Parameters
    ----------
    records : xarray.Dataset
        Records with ``yaw``, and with ``tilt`` and ``roll`` from `with_motion`, degrees.
    scan : Scan
        The scan, with its nominal tilt α₀.

    Returns
    -------
    turn : ndarray, shape (n_record, 6, 6), or None
        gain @ turn is the gain at the record's attitude. Records without a yaw have the identity.

    Notes
    -----
    All beams of a record turn together, n' = n Q with Q = T_yaw(−ψ) T_tilt(−α₀) T_roll(ρ) T_tilt(α) T_yaw(ψ), and the
    variance of a beam n Q is that of the beam n for the tensor Q R Qᵀ, which is linear in the six stresses.
    """
    attitude = own_attitude(records)
    if attitude is None:
        return None
    tilt, roll = attitude
    yaw = np.nan_to_num(np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64)))
    turn = yaw_matrix(-yaw) @ tilt_matrix(-scan.tilt) @ roll_matrix(roll) @ tilt_matrix(tilt) @ yaw_matrix(yaw)
    images = rotate_stress(np.eye(len(STRESSES)), turn.swapaxes(-1, -2)[:, None])  # row k: the image of unit stress k
    return np.asarray(images.swapaxes(-1, -2))
