"""The states of the flow at which noise is known, and where records are among them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array
from bayes_rs.errors import InputError
from bayes_rs.turbulence.interpolation import StateNet, combine, find_net, interpolate_covariance

REACH = np.array([np.log(1.1), np.deg2rad(3.5), np.log(1.1), 0.15])
"""Steps in ln U, yaw, ln L and Γ that change the width of an interval by 5 % at most.

A record is outside where its distances to the states, each over its step, add up to more than one. The width goes as
the root of K's diagonal; over the shipped scans and 5 to 20 m/s, steps of 0.11 in ln U and in ln L change it by 5 %,
and so do 5.5° and 0.21 in Γ at 15°, and 3.5° and 0.15 at 45° (``benchmarks/noise_reach.py``).
"""


_ROUNDING = 1e-9


class Place(NamedTuple):
    """Where among the states records are."""

    used: FloatArray  # the (ln U, ψ, ln L, Γ) that their noise is for, shape (n_record, 4)
    wind_speed: FloatArray  # and its U, m/s
    outside: NDArray[np.bool_]
    weights: FloatArray | None  # of the states, shape (n_record, n_state), if they form a net
    nearest: NDArray[np.int64]  # else the number of the nearest state

    def values(self, of_states: FloatArray) -> FloatArray:
        """Return values of the states (n_state, ...) for each record; a read-only view where there is one state."""
        if self.weights is not None:
            return combine(self.weights, of_states)
        if len(of_states) == 1:
            return np.broadcast_to(of_states[0], (len(self.nearest), *of_states.shape[1:]))
        return of_states[self.nearest]

    def covariances(
        self, of_states: FloatArray, parts: tuple[FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Return the different covariance matrices of records, their negative parts, and which one each record has."""
        if self.weights is None:
            return of_states, np.zeros(len(of_states)), self.nearest
        _, first, number = np.unique(self.used, axis=0, return_index=True, return_inverse=True)
        between, negative_part = interpolate_covariance(of_states, self.weights[first], parts)
        return between, negative_part, number.reshape(-1).astype(np.int64)


@dataclass(frozen=True, eq=False)
class FlowStates:
    """States of the flow: between them if they form a net, else the nearest.

    Parameters
    ----------
    wind_speed : ndarray, shape (n_state,)
        Mean wind speed U, m/s.
    yaw : ndarray, shape (n_state,)
        Wind direction relative to the lidar axis ψ, rad.
    length_scale : ndarray, shape (n_state,)
        Length scale L, m.
    gamma : ndarray, shape (n_state,)
        Anisotropy Γ.

    Attributes
    ----------
    net : StateNet or None
        The net of (ln U, ψ, ln L, Γ) that the states form, if they form one.
    """

    wind_speed: FloatArray
    yaw: FloatArray
    length_scale: FloatArray
    gamma: FloatArray
    net: StateNet | None = field(init=False)

    def __post_init__(self) -> None:
        """Find the net."""
        object.__setattr__(self, "net", find_net(self.coordinates))

    @property
    def coordinates(self) -> FloatArray:
        """The states as (ln U, ψ, ln L, Γ), shape (n_state, 4)."""
        return np.column_stack([np.log(self.wind_speed), self.yaw, np.log(self.length_scale), self.gamma])

    def check_net(self) -> None:
        """Check that there is a net to interpolate in.

        Raises
        ------
        InputError
            If the states form none.
        """
        if self.net is None:
            raise InputError(
                "The states of this noise form no net, so nothing can be interpolated: make one with "
                "noise.calibrate(..., tolerance=0.01)."
            )

    def points(
        self,
        wind_speed: ArrayLike,
        yaw: ArrayLike,
        length_scale: ArrayLike | None = None,
        gamma: ArrayLike | None = None,
    ) -> FloatArray:
        """Return records as (ln U, ψ, ln L, Γ), shape (n_record, 4); ψ within half a turn of the states' middle.

        Raises
        ------
        InputError
            If a wind speed or length scale is not positive, a number is not finite, or L or Γ is missing.
        """
        speed, angle = np.broadcast_arrays(np.atleast_1d(wind_speed), np.atleast_1d(yaw))
        speed = check_array(speed, (None,), what="wind_speed of the records")
        angle = check_array(angle, (None,), what="yaw of the records")
        for index in np.flatnonzero(speed <= 0.0):
            raise InputError(f"Invalid wind_speed {speed[index]:g} m/s of record {index}: it must be above zero.")
        centre = 0.5 * (np.min(self.yaw) + np.max(self.yaw))
        near = np.where(np.abs(angle - centre) <= np.pi, angle, centre + np.angle(np.exp(1j * (angle - centre))))
        scale = _of_records(length_scale, self.length_scale, "length_scale", len(speed))
        for index in np.flatnonzero(scale <= 0.0):
            raise InputError(f"Invalid length_scale {scale[index]:g} m of record {index}: it must be above zero.")
        anisotropy = _of_records(gamma, self.gamma, "gamma", len(speed))
        return np.column_stack([np.log(speed), near, np.log(scale), anisotropy])

    def place(self, points: FloatArray) -> Place:
        """Find where among the states the records at `points` are."""
        if self.net is not None:
            weights, used = self.net.weights(points)
            return Place(
                used, np.exp(used[:, 0]), _outside(points - used), weights, np.zeros(len(points), dtype=np.int64)
            )
        coordinates = self.coordinates
        turn = np.angle(np.exp(1j * (points[:, 1:2] - coordinates[:, 1])))
        nearest = np.argmin((points[:, :1] - coordinates[:, 0]) ** 2 + turn**2, axis=1)
        away = points - coordinates[nearest]
        away[:, 1] = turn[np.arange(len(points)), nearest]
        return Place(coordinates[nearest], self.wind_speed[nearest], _outside(away), None, nearest)


def _outside(away: FloatArray) -> NDArray[np.bool_]:
    """Tell which distances (ln U, ψ, ln L, Γ) from the states, shape (n_record, 4), are too far."""
    return np.asarray(np.abs(away) @ (1.0 / REACH) > 1.0 + _ROUNDING)


def _of_records(given: ArrayLike | None, own: FloatArray, name: str, n_record: int) -> FloatArray:
    """Return L or Γ of each record; that of the states where it is not known and they have but one."""
    if np.ptp(own) > 0.0:
        if given is None:
            raise InputError(
                f"This noise spans {name} {np.min(own):g} to {np.max(own):g}: give the {name} of the records, or take "
                "the noise of one turbulence with at_turbulence."
            )
        return check_array(np.broadcast_to(np.asarray(given), (n_record,)), (None,), what=f"{name} of the records")
    values = np.broadcast_to(np.asarray(own[0] if given is None else given, dtype=np.float64), (n_record,))
    return np.where(np.isfinite(values), values, own[0])
