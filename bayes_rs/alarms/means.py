"""What the means of a record's beams are expected to be, given each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.alarms.variances import Expected

COHERENCE = 1.5
"""Factor on the covariance of the means that turbulence makes: other air is less coherent than Mann's."""
MEAN_FLOOR = 0.012
"""Standard deviation of each beam's mean, over the wind speed, that no model has: pointing, terrain."""
LASTING_FLOOR = 0.005
"""The part of it that is the same in all records."""
TILT_SD = np.deg2rad(3.0)
"""Standard deviation of an error of the lidar's tilt, rad."""


class _Flow(NamedTuple):
    """One thing that a steady wind can have, over the wind speed: middle and standard deviation."""

    middle: float
    sd: float


WIND = {
    "along": _Flow(1.0, 3.0),
    "across": _Flow(0.0, 1.5),
    "up": _Flow(0.0, 0.01),
    "shear": _Flow(0.0015, 0.0025),
    "side_shear": _Flow(0.0, 0.0010),
    "veer": _Flow(0.0, 0.0010),
    "stretch": _Flow(0.0, 0.0005),
    "induction": _Flow(0.0, 0.05),
    "tilt": _Flow(0.0, float(TILT_SD)),
}
"""What the mean wind of a record may be; shears and stretch per metre. Shear of 0.0015/m is an exponent of 0.15 at
100 m, veer of 0.001/m is 3.4° over 60 m; a rotor slows the wind by an induction that falls with exp(−r / 60 m)."""
_INDUCED = 60.0


def expected_means(
    mean: FloatArray,
    used: NDArray[np.bool_],
    direction: FloatArray,
    distance: FloatArray,
    wind_speed: FloatArray,
    noise: FloatArray,
) -> Expected:
    r"""Return residuals of the beams' means against all steady winds.

    Parameters
    ----------
    mean : ndarray, shape (n_record, n_beam)
        Mean radial velocities, m/s, positive away.
    used : ndarray of bool, shape (n_record, n_beam)
        Which of them count.
    direction : ndarray, shape (n_beam, 3) or (n_record, n_beam, 3)
        Unit vectors in the levelled lidar frame.
    distance : ndarray, shape (n_beam,)
        Focus distances, m.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speed U, m/s.
    noise : ndarray, shape (n_record, n_beam, n_beam)
        Covariance of the means by turbulence, m² s⁻².

    Returns
    -------
    expected : Expected
        Over the wind speed, without unit.

    Notes
    -----
    At a beam's place (x, y, z) the wind is (U + y ∂U/∂y + z ∂U/∂z, V + z ∂V/∂z + y ∂V/∂y, W), and the beam is tilted
    by an angle that is not known; all but U and V are uncertain by what `WIND` says. On one cone a tilt, a mean W and a
    vertical shear look the same: only several distances, or a beam along the axis, tell them apart.
    """
    columns, middle = wind_columns(direction, distance)
    sd = np.array([flow.sd for flow in WIND.values()])
    relative = np.where(used, mean, 0.0) / wind_speed[:, None] - columns @ middle
    slope = np.where(used[:, :, None], columns * sd, 0.0)
    both = used[:, :, None] & used[:, None, :]
    own = np.eye(used.shape[1]) * np.where(used, MEAN_FLOOR**2, 1.0)[:, None, :]
    covariance = np.where(both, COHERENCE * noise / wind_speed[:, None, None] ** 2, 0.0) + own
    residual = np.where(used, relative, 0.0)
    gain = slope.swapaxes(-1, -2) @ np.linalg.inv(covariance + slope @ slope.swapaxes(-1, -2))
    left = residual - np.einsum("rbi,ria,ra->rb", slope, gain, residual)
    return Expected(residual, slope, covariance, left)


def wind_columns(direction: FloatArray, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what each entry of `WIND` does to the beams' means, shape (..., n_beam, 9), and the entries' middles."""
    x, y, z = np.moveaxis(direction, -1, 0)
    induced = np.exp(-distance / _INDUCED) * np.ones_like(x)
    place_y, place_z = y * distance, z * distance
    columns = np.stack([x, y, z, x * place_z, x * place_y, y * place_z, y * place_y, x * induced, z], axis=-1)
    return columns, np.array([flow.middle for flow in WIND.values()])
