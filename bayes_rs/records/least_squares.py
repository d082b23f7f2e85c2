"""The mean wind of a record by least squares from the means of its beams."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

RANK_TOLERANCE = 1e-6
"""Of the largest singular value: beams closer together than this cannot tell wind directions apart."""


class WindSolution(NamedTuple):
    """Mean wind vectors, and how they follow from the means.

    Attributes
    ----------
    velocity : ndarray, shape (n_record, n_component)
        Mean wind in the levelled lidar frame, m/s; NaN where it is not seen.
    estimator : ndarray, shape (n_record, n_component, n_beam)
        velocity = estimator @ means; zero for beams that a record does not use.
    seen : ndarray of bool, shape (n_record,)
        Whether the used beams determine every component.
    """

    velocity: FloatArray
    estimator: FloatArray
    seen: NDArray[np.bool_]


class HorizontalWind(NamedTuple):
    """Horizontal mean winds.

    Attributes
    ----------
    speed : ndarray, shape (n_record,)
        m/s; NaN where the wind is not seen.
    yaw : ndarray, shape (n_record,)
        Wind direction relative to the lidar axis ψ, rad, in [−π, π].
    yaw_seen, wind_seen : ndarray of bool, shape (n_record,)
        Whether the beams see the direction, and the wind at all.
    estimator : ndarray, shape (n_record, 2, n_beam)
        (U_L, V_L) = estimator @ means; where the direction is not seen, its first row gives the speed along the scan's
        own yaw, and the second is zero.
    """

    speed: FloatArray
    yaw: FloatArray
    yaw_seen: NDArray[np.bool_]
    wind_seen: NDArray[np.bool_]
    estimator: FloatArray


def solve_wind(
    mean: FloatArray,
    valid: NDArray[np.bool_],
    direction: FloatArray,
    *,
    weights: FloatArray | None = None,
    vertical: bool = False,
) -> WindSolution:
    """Solve v̄_b = n_b · U for the mean wind vector of each record by least squares.

    Parameters
    ----------
    mean : ndarray, shape (n_record, n_beam)
        Means of the beams, m/s, positive away.
    valid : ndarray of bool, shape (n_record, n_beam)
        Which of them to use.
    direction : ndarray, shape (n_beam, 3) or (n_record, n_beam, 3)
        Unit vectors in the levelled lidar frame.
    weights : ndarray, shape (n_beam,), optional
        Weights of the squares; all equal if not given.
    vertical : bool
        Solve for a mean vertical component, too.

    Returns
    -------
    solution : WindSolution
        The same for a record in any company.
    """
    root = np.ones(direction.shape[-2]) if weights is None else np.sqrt(weights)
    rows = direction[..., : 3 if vertical else 2] * root[:, None]
    if direction.ndim == 2:
        patterns, of = np.unique(valid, axis=0, return_inverse=True)
        rows = np.where(patterns[:, :, None], rows, 0.0)
        of = of.ravel()
    else:
        rows = np.where(valid[:, :, None], rows, 0.0)
        of = np.arange(len(valid))
    size = np.linalg.svd(rows, compute_uv=False)
    enough = rows.shape[1] >= rows.shape[2]
    seen = (size[:, -1] > RANK_TOLERANCE * size[:, 0]) & enough
    inverse = np.zeros(rows.swapaxes(-1, -2).shape)
    inverse[seen] = np.linalg.pinv(rows[seen])
    estimator = (inverse * root)[of]
    velocity = np.einsum("rcb,rb->rc", estimator, np.where(valid, mean, 0.0))
    return WindSolution(np.where(seen[of, None], velocity, np.nan), estimator, seen[of])


def horizontal_wind(
    mean: FloatArray,
    valid: NDArray[np.bool_],
    direction: FloatArray,
    own_yaw: float,
    *,
    weights: FloatArray | None = None,
) -> HorizontalWind:
    """Return horizontal mean winds; beams that cannot tell directions apart leave ψ to the scan's own yaw.

    Parameters
    ----------
    mean, valid, direction, weights
        As in `solve_wind`.
    own_yaw : float
        The scan's own yaw, rad.

    Returns
    -------
    wind : HorizontalWind
        U = √(U_L² + V_L²) and ψ = atan2(−V_L, U_L). Where only a projection is seen, ψ is the scan's own yaw, turned by
        180° if the projected wind comes from behind.
    """
    solution = solve_wind(mean, valid, direction, weights=weights)
    u_level, v_level = solution.velocity.T
    speed, yaw = np.hypot(u_level, v_level), np.arctan2(-v_level, u_level)
    estimator, seen = solution.estimator, solution.seen
    # n in the mean-wind frame of the scan's own yaw: v = n U
    along = direction[..., 0] * np.cos(own_yaw) - direction[..., 1] * np.sin(own_yaw)
    along = np.where(valid, along, 0.0)
    weight = along if weights is None else along * weights
    square = np.einsum("rb,rb->r", weight, along)
    projects = ~seen & (np.sqrt(np.einsum("rb,rb->r", along, along)) > RANK_TOLERANCE) & (square > 0.0)
    estimator[projects, 0] = weight[projects] / square[projects, None]
    estimator[projects, 1] = 0.0
    projected = np.einsum("rb,rb->r", estimator[projects, 0], np.where(valid, mean, 0.0)[projects])
    turned = own_yaw + np.where(projected < 0.0, np.pi, 0.0)
    speed[projects], yaw[projects] = np.abs(projected), np.pi - np.remainder(np.pi - turned, 2.0 * np.pi)
    return HorizontalWind(speed, yaw, seen, seen | projects, estimator)
