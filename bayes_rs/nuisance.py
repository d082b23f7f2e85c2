"""What may be uncertain beside R: the lidar's yaw and tilt, its own noise, the length scale, the size of the noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_non_negative, check_positive
from bayes_rs.errors import InputError
from bayes_rs.scan import tilt_matrix, yaw_matrix
from bayes_rs.stress import rotate_stress

N_LENGTH_NODE = 5
"""Nodes of the Gauss–Hermite rule over ln L."""


@dataclass(frozen=True, kw_only=True)
class Nuisances:
    """Uncertain quantities that the posterior of R is averaged over; a zero (or an infinite `inflation_dof`) is off.

    Parameters
    ----------
    yaw_sd_deg : float
        Standard deviation of the error of a record's wind direction relative to the lidar, degrees.
    tilt_sd_deg : float
        Standard deviation of the error of the lidar's tilt, degrees.
    instrument_noise_log_sd : float
        Standard deviation of the logarithm of the instrument's noise variance; its median is the ``instrument_noise``
        of `fit`, the same for all beams.
    length_scale_log_sd : float
        Standard deviation of ln L, the turbulence's length scale; needs a noise bank that spans several.
    length_scale : float, optional
        Median of L, m; by default the ``length_scale`` of each record.
    inflation : float
        Fixed factor of the covariance of the log-variances, above 1 for flow that is less Gaussian than the model.
    inflation_dof : float
        Degrees of freedom ν of an uncertain factor with the inverse-gamma distribution IG(ν/2, ν/2).

    Raises
    ------
    InputError
        If a width is negative or not finite, or a factor is not positive.

    Notes
    -----
    An error of yaw or tilt turns R, since n Q R Qᵀ nᵀ is the variance of the beam n Q; the noise stays that of the
    nominal direction. Yaw, tilt and the instrument's noise are sampled as coordinates of their own, normal a priori.
    The length scale is summed out with a Gauss–Hermite rule of five nodes, the inflation exactly: a normal density
    whose covariance has an inverse-gamma factor is a Student-t.

    Examples
    --------
    >>> Nuisances(yaw_sd_deg=2.0).n_coordinate
    1
    """

    yaw_sd_deg: float = 0.0
    tilt_sd_deg: float = 0.0
    instrument_noise_log_sd: float = 0.0
    length_scale_log_sd: float = 0.0
    length_scale: float | None = None
    inflation: float = 1.0
    inflation_dof: float = np.inf

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, unit in (
            ("yaw_sd_deg", "°"),
            ("tilt_sd_deg", "°"),
            ("instrument_noise_log_sd", ""),
            ("length_scale_log_sd", ""),
        ):
            check_non_negative(getattr(self, name), what=name, unit=unit, where="the nuisances")
        if self.length_scale is not None:
            check_positive(self.length_scale, what="length_scale", unit="m", where="the nuisances")
        check_positive(self.inflation, what="inflation", unit="", where="the nuisances")
        if not self.inflation_dof > 2.0:
            raise InputError(
                f"Invalid inflation_dof {self.inflation_dof!r}: it must be above 2, for the noise to have a variance."
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sampled ones, in the order of their coordinates."""
        switch = {
            "yaw_error": self.yaw_sd_deg,
            "tilt_error": self.tilt_sd_deg,
            "instrument_noise": self.instrument_noise_log_sd,
        }
        return tuple(name for name, width in switch.items() if width > 0.0)

    def in_words(self) -> str:
        """Say in one line what is uncertain beside R."""
        parts = []
        if self.yaw_sd_deg:
            parts.append(f"yaw ± {self.yaw_sd_deg:g}°")
        if self.tilt_sd_deg:
            parts.append(f"tilt ± {self.tilt_sd_deg:g}°")
        if self.instrument_noise_log_sd:
            parts.append(f"instrument noise within a factor {np.exp(self.instrument_noise_log_sd):.2g}")
        if self.length_scale_log_sd:
            parts.append(f"length scale within a factor {np.exp(self.length_scale_log_sd):.2g}")
        if self.inflation != 1.0:
            parts.append(f"noise inflated by {self.inflation:g}")
        if np.isfinite(self.inflation_dof):
            parts.append(f"noise inflation uncertain, {self.inflation_dof:g} degrees of freedom")
        return ", ".join(parts) + " (one standard deviation)" if parts else "nothing but R"

    @property
    def n_coordinate(self) -> int:
        """Number of coordinates that are sampled beside those of R."""
        return len(self.names)

    def length_scale_nodes(self) -> tuple[FloatArray, FloatArray]:
        """Return factors of L and their weights, each shape (n_node,); one node of weight 1 where L is known."""
        if self.length_scale_log_sd == 0.0:
            return np.ones(1), np.ones(1)
        node, weight = np.polynomial.hermite_e.hermegauss(N_LENGTH_NODE)
        return np.exp(self.length_scale_log_sd * node), np.asarray(weight / weight.sum())


UNITS = {"yaw_error": "degree", "tilt_error": "degree", "instrument_noise": "m2 s-2"}
"""Units of the sampled nuisances in the result."""


@dataclass(frozen=True)
class RecordNuisances:
    """The sampled nuisances of some records.

    Parameters
    ----------
    choice : Nuisances
        Which are on.
    yaw : ndarray, shape (n_record,)
        Nominal wind direction relative to the lidar, rad.
    instrument_noise : float
        Median of the instrument's noise variance, m² s⁻²; used where it is uncertain.
    """

    choice: Nuisances = field(default_factory=Nuisances)
    yaw: FloatArray = field(default_factory=lambda: np.zeros(0))
    instrument_noise: float = 0.0

    @property
    def n_coordinate(self) -> int:
        """Number of sampled nuisances."""
        return self.choice.n_coordinate

    def values(self, coordinate: FloatArray) -> dict[str, FloatArray]:
        """Return the nuisances, each (n_record, n_draw), of standard normal coordinates (n_record, n_draw, n)."""
        found = {}
        for index, name in enumerate(self.choice.names):
            if name == "instrument_noise":
                found[name] = self.instrument_noise * np.exp(
                    self.choice.instrument_noise_log_sd * coordinate[..., index]
                )
            else:
                width = self.choice.yaw_sd_deg if name == "yaw_error" else self.choice.tilt_sd_deg
                found[name] = width * coordinate[..., index]
        return found

    def apply(self, stress: FloatArray, coordinate: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Return the stresses as the nominal beams see them, and the instrument's noise variance if it is uncertain.

        Parameters
        ----------
        stress : ndarray, shape (n_record, n_draw, 6)
            Stresses in the mean-wind frame, m² s⁻².
        coordinate : ndarray, shape (n_record, n_draw, n)
            Coordinates of the nuisances.

        Returns
        -------
        stress : ndarray, shape (n_record, n_draw, 6)
            Q R Qᵀ with Q = T_yaw(−ψ) T_tilt(δα) T_yaw(ψ + δψ): the beams are row vectors, n T_tilt T_yaw.
        offset : ndarray or None, shape (n_record, n_draw)
            Variance of the instrument's noise, m² s⁻².
        """
        values = self.values(coordinate)
        offset = values.pop("instrument_noise", None)
        if not values:
            return stress, offset
        nominal = np.broadcast_to(self.yaw[:, None], stress.shape[:-1])
        error = {name: np.deg2rad(value) for name, value in values.items()}
        turn = yaw_matrix(nominal + error.get("yaw_error", 0.0))
        if "tilt_error" in error:
            turn = tilt_matrix(error["tilt_error"]) @ turn
        turn = yaw_matrix(-nominal) @ turn
        return rotate_stress(stress, turn.swapaxes(-1, -2)), offset

    def take(self, records: NDArray[np.int64]) -> RecordNuisances:
        """Return the nuisances of some of the records."""
        return RecordNuisances(self.choice, self.yaw[records] if len(self.yaw) else self.yaw, self.instrument_noise)
