"""What may be uncertain beside R: yaw, tilt, instrument noise, gradients of R, length scale, size of the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_number, check_choice, check_non_negative, check_positive
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.inflow import GRADIENT_LENGTH, gradient_columns
from bayes_rs.geometry.scan import tilt_matrix, yaw_matrix
from bayes_rs.geometry.stress import rotate_stress
from bayes_rs.options import described, option

N_LENGTH_NODE = 5
"""Nodes of the Gauss–Hermite rule over ln L."""


@described
@dataclass(frozen=True, kw_only=True)
class Nuisances:
    """Uncertain quantities that the posterior of R is averaged over; a zero (or an infinite `inflation_dof`) is off.

    Raises
    ------
    InputError
        If a width is negative or not finite, a factor is not positive, or `yaw_sd_missing_deg` is given without
        ``"records"``.

    Notes
    -----
    A zero (or an infinite `inflation_dof`) switches a quantity off. A record whose own ``yaw_sd`` is 0 has a known
    direction; `mean_wind` with a turbulence gives records theirs. The instrument's noise is the same for all beams; of
    noise that the records hold, its median is the mean of a record's beams. A gradient of 0.3 means that the stresses
    change by up to about a third over 100 m. The uncertain factor has the inverse-gamma distribution IG(ν/2, ν/2).

    An error of yaw or tilt turns R, since n Q R Qᵀ nᵀ is the variance of the beam n Q; the noise stays that of the
    nominal direction. Yaw, tilt, the instrument's noise and the gradients are sampled as coordinates of their own,
    normal a priori. The errors of yaw are independent from record to record, and of the errors of the variances: in
    Gaussian turbulence a record's means and variances are uncorrelated. A bias that all records share is not one of
    them; it does not average out.

    Gradients γ make the six stresses grow and fall together, R(y, z) = R exp(γ_y y + γ_z z) with y and z from the
    middle of the scan's points (`bayes_rs.geometry.inflow.gradient_columns`), where R is that of the result. It stays
    realizable, and is linear in y and z as far as the change is small. With one opening angle, almost all of a gradient
    looks like uw (vertical) or uv (lateral), and priors decide what it is; see `inflow_confounding`. The relative
    covariance of the noise does not depend on a gradient.

    The length ℓ of the probe volume is the same for all beams of a record. What a longer one takes of every variance,
    σ ∂ln E[y]/∂ln ℓ by `probe_slope`, is an error of ln y that the beams share, and is put into their covariance: to
    first order in ln ℓ, so for errors well below a factor of two.

    The length scale is summed out with a Gauss–Hermite rule of five nodes, the inflation exactly: a normal density
    whose covariance has an inverse-gamma factor is a Student-t.

    Examples
    --------
    >>> Nuisances(yaw_sd_deg=2.0).n_coordinate
    1
    """

    yaw_sd_deg: float | str = option(
        0.0,
        "Standard deviation of the error of a record's wind direction; or records, for each record's own yaw_sd: as it "
        "holds it, else as its beams' means give it",
        unit="degrees",
        choices=("records",),
        flag="--yaw-sd",
    )
    yaw_sd_missing_deg: float | None = option(
        None,
        "With records, the standard deviation for records that have none of their own; by default they are refused",
        unit="degrees",
        flag="--yaw-sd-missing",
    )
    tilt_sd_deg: float = option(
        0.0, "Standard deviation of the error of the lidar's tilt", unit="degrees", flag="--tilt-sd"
    )
    instrument_noise_log_sd: float = option(
        0.0,
        "Standard deviation of the logarithm of the instrument's noise variance, whose median is the instrument noise",
        flag="--instrument-noise-sd",
    )
    length_scale_log_sd: float | str = option(
        "records",
        "Standard deviation of the logarithm of the turbulence's length scale, where the noise spans several; records "
        "is each record's own, as its spectra give it, and 0 where it has none",
        choices=("records",),
        flag="--length-scale-sd",
    )
    length_scale: float | None = option(
        None, "Median of the length scale; by default each record's own, else that of the turbulence", unit="m"
    )
    probe_length_log_sd: float = option(
        0.0,
        "Standard deviation of the logarithm of the probe volume's length, whose median is that of the scan",
        flag="--probe-length-sd",
    )
    vertical_gradient_sd: float = option(
        0.0, "Standard deviation of the change of the stresses' logarithm over 100 m upwards"
    )
    lateral_gradient_sd: float = option(
        0.0, "Standard deviation of the change of the stresses' logarithm over 100 m along y of the lidar's frame"
    )
    inflation: float = option(1.0, "Factor of the noise's covariance, above 1 for flow that is less Gaussian")
    inflation_dof: float = option(
        np.inf, "Degrees of freedom of an uncertain factor of the noise's covariance; by default it is certain"
    )

    def __post_init__(self) -> None:
        """Check the numbers."""
        if isinstance(self.yaw_sd_deg, str):
            check_choice(self.yaw_sd_deg, ("records",), what="yaw_sd_deg")
        else:
            check_non_negative(self.yaw_sd_deg, what="yaw_sd_deg", unit="°", where="the nuisances")
        if isinstance(self.length_scale_log_sd, str):
            check_choice(self.length_scale_log_sd, ("records",), what="length_scale_log_sd")
        else:
            check_non_negative(self.length_scale_log_sd, what="length_scale_log_sd", unit="", where="the nuisances")
        if self.yaw_sd_missing_deg is not None:
            check_non_negative(self.yaw_sd_missing_deg, what="yaw_sd_missing_deg", unit="°", where="the nuisances")
            if not self.yaw_sd_of_records:
                raise InputError(
                    f"Invalid yaw_sd_missing_deg {self.yaw_sd_missing_deg:g} with yaw_sd_deg {self.yaw_sd_deg:g}: it "
                    "stands in for records without a yaw_sd of their own; give yaw_sd_deg='records', or leave it out."
                )
        for name, unit in (
            ("tilt_sd_deg", "°"),
            ("instrument_noise_log_sd", ""),
            ("probe_length_log_sd", ""),
            ("vertical_gradient_sd", "per 100 m"),
            ("lateral_gradient_sd", "per 100 m"),
        ):
            check_non_negative(getattr(self, name), what=name, unit=unit, where="the nuisances")
        if self.length_scale is not None:
            check_positive(self.length_scale, what="length_scale", unit="m", where="the nuisances")
            if self.length_scale_sd == 0.0:
                raise InputError(
                    f"Invalid length_scale {self.length_scale:g} m with length_scale_log_sd "
                    f"{self.length_scale_log_sd}: it is the median of an "
                    "uncertain length scale; say how uncertain it is (--length-scale-sd), or leave it out."
                )
        check_positive(self.inflation, what="inflation", unit="", where="the nuisances")
        if not as_number(self.inflation_dof) > 2.0:
            raise InputError(
                f"Invalid inflation_dof {in_short(self.inflation_dof)}: it must be above 2, for the noise to have a "
                "variance."
            )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the sampled ones, in the order of their coordinates."""
        switch = {
            "yaw_error": self.yaw_sd_of_records or bool(self.yaw_sd_deg),
            "tilt_error": self.tilt_sd_deg > 0.0,
            "instrument_noise": self.instrument_noise_log_sd > 0.0,
            **dict.fromkeys(self.gradient_names, True),
        }
        return tuple(name for name, on in switch.items() if on)

    @property
    def yaw_sd_of_records(self) -> bool:
        """Whether each record says itself how uncertain its wind direction is."""
        return isinstance(self.yaw_sd_deg, str)

    @property
    def length_scale_sd(self) -> float:
        """Standard deviation of ln L that all records share; 0 where each record says its own."""
        return 0.0 if isinstance(self.length_scale_log_sd, str) else float(self.length_scale_log_sd)

    @property
    def length_scale_sd_of_records(self) -> bool:
        """Whether each record says itself how uncertain its length scale is."""
        return isinstance(self.length_scale_log_sd, str)

    @property
    def _gradient_sd(self) -> dict[str, float]:
        return {"lateral_gradient": self.lateral_gradient_sd, "vertical_gradient": self.vertical_gradient_sd}

    @property
    def gradient_names(self) -> tuple[str, ...]:
        """Names of the gradients of R that are sampled, in the order of their coordinates: the last ones."""
        return tuple(name for name, width in self._gradient_sd.items() if width > 0.0)

    def without_gradients(self) -> Nuisances:
        """Return the same for a homogeneous inflow."""
        return replace(self, vertical_gradient_sd=0.0, lateral_gradient_sd=0.0)

    def place(self, scan_geometry: Mapping[str, Any]) -> FloatArray | None:
        """Return by how much ln E[y] changes with each gradient's coordinate, (n_beam, n_gradient); None if none is on.

        `scan_geometry` is that of the noise model: what `Scan.geometry` returns.
        """
        if not self.gradient_names:
            return None
        width = np.array([self._gradient_sd[name] for name in self.gradient_names])
        return np.asarray(gradient_columns(scan_geometry, self.gradient_names) * (width / GRADIENT_LENGTH))

    def in_words(self) -> str:
        """Say in one line what is uncertain beside R."""
        parts = []
        if self.yaw_sd_of_records:
            missing = self.yaw_sd_missing_deg
            parts.append(
                "yaw ± what each record says" + (f" ({missing:g}° where it does not)" if missing is not None else "")
            )
        elif self.yaw_sd_deg:
            parts.append(f"yaw ± {self.yaw_sd_deg:g}°")
        if self.tilt_sd_deg:
            parts.append(f"tilt ± {self.tilt_sd_deg:g}°")
        if self.instrument_noise_log_sd:
            parts.append(f"instrument noise within a factor {np.exp(self.instrument_noise_log_sd):.2g}")
        if self.probe_length_log_sd:
            parts.append(f"length of the probe volume within a factor {np.exp(self.probe_length_log_sd):.2g}")
        for name, width in self._gradient_sd.items():
            if width:
                parts.append(f"{name.replace('_', ' ')} of ln R ± {width:g} per {GRADIENT_LENGTH:g} m")
        if self.length_scale_sd:
            parts.append(f"length scale within a factor {np.exp(self.length_scale_sd):.2g}")
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
        if self.length_scale_sd == 0.0:
            return np.ones(1), np.ones(1)
        node, weight = np.polynomial.hermite_e.hermegauss(N_LENGTH_NODE)
        return np.exp(self.length_scale_sd * node), np.asarray(weight / weight.sum())


UNITS = {
    "yaw_error": "degree",
    "tilt_error": "degree",
    "instrument_noise": "m2 s-2",
    "lateral_gradient": "(100 m)-1",
    "vertical_gradient": "(100 m)-1",
}
"""Units of the sampled nuisances in the result."""


class Seen(NamedTuple):
    """What a likelihood takes: stresses, instrument noise and gradients; None for what is not uncertain."""

    stress: FloatArray
    offset: FloatArray | None = None
    gradient: FloatArray | None = None


@dataclass(frozen=True)
class RecordNuisances:
    """The sampled nuisances of some records.

    Parameters
    ----------
    choice : Nuisances
        Which are on.
    yaw : ndarray, shape (n_record,)
        Nominal wind direction relative to the lidar, rad.
    instrument_noise : float or ndarray, shape (n_record, 1)
        Median of the instrument's noise variance, m² s⁻²; used where it is uncertain.
    yaw_sd : ndarray, shape (n_record,), optional
        Standard deviations of the yaw errors, degrees, where `choice` leaves them to the records.
    """

    choice: Nuisances = field(default_factory=Nuisances)
    yaw: FloatArray = field(default_factory=lambda: np.zeros(0))
    instrument_noise: FloatArray | float = 0.0
    yaw_sd: FloatArray | None = None

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
                found[name] = self._width(name) * coordinate[..., index]
        return found

    def coordinate(self, values: Mapping[str, FloatArray]) -> FloatArray:
        """Return the coordinates (n_record, n_draw, n) of nuisances, each (n_record, n_draw): the inverse of `values`.

        Of an error that is zero, because its width is, the coordinate does not count, and is 0.
        """
        found = []
        for name in self.choice.names:
            if name == "instrument_noise":
                found.append(np.log(values[name] / self.instrument_noise) / self.choice.instrument_noise_log_sd)
            else:
                width = self._width(name)
                found.append(values[name] / np.where(width > 0.0, width, 1.0))
        return np.stack(found, axis=-1)

    def _width(self, name: str) -> FloatArray | float:
        if name == "yaw_error" and self.yaw_sd is not None:
            return self.yaw_sd[:, None]
        return float(
            getattr(self.choice, {"yaw_error": "yaw_sd_deg", "tilt_error": "tilt_sd_deg"}.get(name, f"{name}_sd"))
        )

    def apply(self, stress: FloatArray, coordinate: FloatArray) -> Seen:
        """Return the stresses as the nominal beams see them, and what else of it is uncertain.

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
        gradient : ndarray or None, shape (n_record, n_draw, n_gradient)
            Coordinates of the gradients, for the likelihood's ``place``.
        """
        values = self.values(coordinate)
        offset = values.pop("instrument_noise", None)
        n_gradient = len(self.choice.gradient_names)
        gradient = coordinate[..., -n_gradient:] if n_gradient else None
        for name in self.choice.gradient_names:
            values.pop(name)
        if not values:
            return Seen(stress, offset, gradient)
        nominal = np.broadcast_to(self.yaw[:, None], stress.shape[:-1])
        error = {name: np.deg2rad(value) for name, value in values.items()}
        turn = yaw_matrix(nominal + error.get("yaw_error", 0.0))
        if "tilt_error" in error:
            turn = tilt_matrix(error["tilt_error"]) @ turn
        turn = yaw_matrix(-nominal) @ turn
        return Seen(rotate_stress(stress, turn.swapaxes(-1, -2)), offset, gradient)

    def take(self, records: NDArray[np.int64]) -> RecordNuisances:
        """Return the nuisances of some of the records."""
        noise = self.instrument_noise
        return RecordNuisances(
            self.choice,
            self.yaw[records] if len(self.yaw) else self.yaw,
            noise[records] if isinstance(noise, np.ndarray) else noise,
            None if self.yaw_sd is None else self.yaw_sd[records],
        )
