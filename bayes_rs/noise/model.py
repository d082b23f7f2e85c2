"""Noise models: bias, gain and relative covariance of the beam variances of a record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_finite, check_positive
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan, yaw_matrix
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.file import noise_dataset, save_dataset
from bayes_rs.noise.noise_geometry import check_geometry, check_same_scan, geometry_difference
from bayes_rs.turbulence.interpolation import StateNet, combine, find_net, interpolate_covariance
from bayes_rs.turbulence.mann import MannTurbulence

NOISE_METHODS: tuple[str, ...] = ("boxes", "theory", "given")
"""Where a noise model's numbers can come from."""

_EDGE = np.array([np.log(1.05), np.deg2rad(2.5), np.log(1.05), 0.1])
"""Records no farther outside a bank than this in ln U, yaw, ln L and Γ are not counted as outside."""


@dataclass(frozen=True, eq=False)
class RecordNoise:
    """The noise of each of a number of records.

    Parameters
    ----------
    bias : ndarray, shape (n_record, n_beam)
        E[y_b] / (n·R n) − 1 for the ensemble tensor.
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain @ stresses of the record. The design matrix at the record's own yaw, and what the probe volume
        changes in it.
    covariance : ndarray, shape (n_record, n_beam, n_beam)
        Relative covariance K.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speed that the noise is for, m/s: the record's own where a bank interpolates, else the nearest
        calibrated one, or the nearest edge of the net.
    yaw : ndarray, shape (n_record,)
        Wind direction relative to the lidar axis that the noise is for, rad.
    state : ndarray of int, shape (n_record,)
        Equal numbers mean equal noise: the number of the nearest state, or where a bank interpolates a number of the
        wind speed and direction among those of these records.
    outside : ndarray of bool, shape (n_record,)
        Whether a record is outside the bank, so that its noise is that of the nearest edge or state.
    negative_part : ndarray, shape (n_record,)
        See `interpolate_covariance`; 0 without interpolation.
    """

    bias: FloatArray
    gain: FloatArray
    covariance: FloatArray
    wind_speed: FloatArray
    yaw: FloatArray
    state: NDArray[np.int64]
    outside: NDArray[np.bool_]
    negative_part: FloatArray


@dataclass(frozen=True, eq=False)
class SonicNoise:
    """The joint moments of the beams' variances and a sonic's stresses, for each of a number of records.

    Parameters
    ----------
    covariance : ndarray, shape (n_record, 6, 6)
        Covariance of L⁻¹ S L⁻ᵀ, see `NoiseModel`.
    beam_covariance : ndarray, shape (n_record, 6, n_beam)
        Its covariance with the relative variances of the beams.
    state : ndarray of int, shape (n_record,)
        Equal numbers mean equal moments.
    negative_part : ndarray, shape (n_record,)
        See `interpolate_covariance`, for the joint covariance of beams and sonic; 0 without interpolation.
    """

    covariance: FloatArray
    beam_covariance: FloatArray
    state: NDArray[np.int64]
    negative_part: FloatArray


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Bias, gain and relative covariance of the beam variances of one record, at one state of the flow.

    Parameters
    ----------
    bias : array_like, shape (n_beam,)
        E[y_b] / (n·R n) − 1, with R the tensor of an infinite record; below zero, because a record loses its slow
        eddies with its mean.
    gain : array_like, shape (n_beam, 6)
        E[y] = gain @ stresses, for the stresses of a record (its own mean removed). For beams that measure
        at a point it is the design matrix.
    covariance : array_like, shape (n_beam, n_beam)
        Relative covariance K: Cov[y_a, y_b] = K_ab E[y_a] E[y_b].
    beam : array_like of int, shape (n_beam,)
        Numbers of the beams.
    scan_name : str
        Name of the scan.
    scan_geometry : mapping
        What `Scan.geometry` returned for it: the lists ``beam``, ``direction``, ``focus_distance`` (m) and
        ``beam_time`` (s), and ``scan_duration`` (s); for beams that do not see points, the mapping ``probe``.
    wind_speed : float
        Mean wind speed U, m/s.
    yaw : float
        Wind direction relative to the lidar axis ψ, rad.
    duration : float
        Length of a record T, s.
    turbulence : MannTurbulence
        Turbulence for which it was calibrated.
    method : str
        ``"boxes"``, ``"theory"`` or ``"given"``.
    n_realizations : float
        Effective number of independent records behind the covariance; infinite for theory.
    standard_error : array_like, shape (n_beam, n_beam), optional
        Standard error of each entry of the covariance.
    details : mapping
        How it was made, as plain JSON values.
    sonic_covariance : array_like, shape (6, 6), optional
        Covariance of L⁻¹ S L⁻ᵀ, with S the tensor that a sonic measures in the record and L Lᵀ its expectation; in the
        order uu, vv, ww, uv, uw, vw. Needed for the target ``"sonic"`` only.
    sonic_beam_covariance : array_like, shape (6, n_beam), optional
        Covariance of L⁻¹ S L⁻ᵀ with the relative variances y_b / E[y_b]; with `sonic_covariance` or not at all.

    Raises
    ------
    InputError
        If a shape disagrees with the beams, a number is not finite, or the covariance is not symmetric.
    NotPositiveDefiniteError
        If the covariance has an eigenvalue that is negative by more than rounding.

    Notes
    -----
    For a record k and beam b the radial-velocity variance is y_b = (1/N) Σ (v − v̄)², divisor N. Relative noise depends
    on L/(U T), Γ, the beams and their timing; the dissipation scales out.

    Examples
    --------
    >>> noise = NoiseModel(
    ...     bias=[-0.1], gain=[[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]], covariance=[[0.06]], beam=[0], scan_name="staring",
    ...     scan_geometry={"beam": [0], "direction": [[-1.0, 0.0, 0.0]], "focus_distance": [98.0], "beam_time": [0.0],
    ...                    "scan_duration": 1.0},
    ...     wind_speed=10.0, yaw=0.0, duration=600.0, turbulence=MannTurbulence(0.05, 61.0, 3.2), method="given",
    ... )
    >>> round(float(noise.relative_error[0]), 3)
    0.245
    """

    bias: FloatArray
    gain: FloatArray
    covariance: FloatArray
    beam: NDArray[np.int64]
    scan_name: str
    scan_geometry: Mapping[str, Any]
    wind_speed: float
    yaw: float
    duration: float
    turbulence: MannTurbulence
    method: str
    n_realizations: float = np.inf
    standard_error: FloatArray | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    sonic_covariance: FloatArray | None = None
    sonic_beam_covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check and freeze the arrays."""
        where = f"noise of scan {self.scan_name!r}"
        beam = np.array(self.beam, dtype=np.int64)
        if beam.ndim != 1 or len(beam) == 0:
            raise InputError(f"Invalid beam of shape {beam.shape} in {where}: one number for each beam, at least one.")
        n_beam = len(beam)
        geometry = check_geometry(self.scan_geometry, beam, where)
        arrays = {
            "bias": check_array(self.bias, (n_beam,), what=f"bias in {where}"),
            "gain": check_array(self.gain, (n_beam, len(STRESSES)), what=f"gain in {where}"),
            "covariance": check_array(self.covariance, (n_beam, n_beam), what=f"covariance in {where}"),
        }
        if self.standard_error is not None:
            arrays["standard_error"] = check_array(
                self.standard_error, (n_beam, n_beam), what=f"standard_error in {where}"
            )
        arrays.update(_checked_sonic(self.sonic_covariance, self.sonic_beam_covariance, n_beam, where))
        _check_covariance(arrays["covariance"], where)
        check_positive(self.wind_speed, what="wind_speed", unit="m/s", where=where)
        check_finite(self.yaw, what="yaw", unit="rad", where=where)
        check_positive(self.duration, what="duration", unit="s", where=where)
        check_choice(self.method, NOISE_METHODS, what="method of a noise model")
        if not self.n_realizations > 0.0:
            raise InputError(f"Invalid n_realizations {self.n_realizations!r} in {where}: it must be above zero.")
        for key, array in {**arrays, "beam": beam}.items():
            frozen = array.copy()
            frozen.flags.writeable = False
            object.__setattr__(self, key, frozen)
        object.__setattr__(self, "scan_geometry", geometry)
        try:
            object.__setattr__(self, "details", json.loads(json.dumps(dict(self.details))))
        except TypeError as error:
            raise InputError(f"Invalid details in {where}: {error}, and they must be plain JSON values.") from error

    @property
    def n_beam(self) -> int:
        """Number of beams."""
        return len(self.beam)

    @property
    def relative_error(self) -> FloatArray:
        """Relative standard deviation of each beam's variance, shape (n_beam,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """Correlation of the beams' variances, shape (n_beam, n_beam)."""
        return self.covariance / np.outer(self.relative_error, self.relative_error)

    def check_scan(self, scan: Scan) -> None:
        """Check that the noise was made for this scan, whatever its name and yaw.

        Parameters
        ----------
        scan : Scan
            The scan that it is to be used with; `select` the beams that are in use on both first.

        Raises
        ------
        NoiseMismatchError
            If beams, directions, focus distances or timing differ; the message names the first difference.
        """
        check_same_scan(self.scan_name, self.scan_geometry, scan)

    def select(self, beams: ArrayLike) -> NoiseModel:
        """Return the noise of only the beams whose numbers are given, in that order.

        Parameters
        ----------
        beams : array_like of int
            Beam numbers.

        Returns
        -------
        noise : NoiseModel
            The smaller model.

        Raises
        ------
        InputError
            If a number is not one of the model's beams.
        """
        wanted = np.atleast_1d(np.asarray(beams, dtype=np.int64))
        for number in wanted:
            if number not in self.beam:
                raise InputError(
                    f"Unknown beam {number} in the noise of scan {self.scan_name!r}: "
                    f"its beams are {self.beam.tolist()}."
                )
        index = np.array([int(np.flatnonzero(self.beam == number)[0]) for number in wanted])
        per_beam = ("beam", "direction", "focus_distance", "beam_time")
        geometry = {key: [self.scan_geometry[key][i] for i in index] for key in per_beam}
        pairs = np.ix_(index, index)
        return replace(
            self,
            bias=self.bias[index],
            gain=self.gain[index],
            covariance=self.covariance[pairs],
            beam=self.beam[index],
            scan_geometry={**self.scan_geometry, **geometry},
            standard_error=None if self.standard_error is None else self.standard_error[pairs],
            sonic_beam_covariance=None if self.sonic_beam_covariance is None else self.sonic_beam_covariance[:, index],
        )

    def for_records(self, wind_speed: ArrayLike, yaw: ArrayLike) -> RecordNoise:
        """Return the noise of records: the same for all, because this model knows one state only.

        Parameters
        ----------
        wind_speed : array_like, shape (n_record,)
            Mean wind speed of each record, m/s.
        yaw : array_like, shape (n_record,)
            Wind direction relative to the lidar axis, rad.

        Returns
        -------
        noise : RecordNoise
            Arrays along the records, as read-only views.
        """
        return NoiseBank((self,)).for_records(wind_speed, yaw)

    @property
    def has_sonic(self) -> bool:
        """Whether the model holds the joint moments with a sonic's stresses."""
        return self.sonic_covariance is not None

    @property
    def joint_covariance(self) -> FloatArray:
        """Covariance of the relative beam variances and L⁻¹ S L⁻ᵀ, shape (n_beam + 6, n_beam + 6).

        Raises
        ------
        InputError
            If the model does not hold the moments with a sonic.
        """
        if self.sonic_covariance is None or self.sonic_beam_covariance is None:
            raise InputError(
                f"The noise of scan {self.scan_name!r} holds no moments with a sonic, which the target 'sonic' needs: "
                "make it with calibrate(..., sonic=True), theory_bank(..., sonic=True) or bayes-rs calibrate --sonic."
            )
        across = self.sonic_beam_covariance
        return np.block([[self.covariance, across.T], [across, self.sonic_covariance]])

    def sonic_for_records(self, wind_speed: ArrayLike, yaw: ArrayLike) -> SonicNoise:
        """Return the moments with a sonic's stresses for records; as `NoiseBank.sonic_for_records`."""
        return NoiseBank((self,)).sonic_for_records(wind_speed, yaw)

    def to_dataset(self) -> xr.Dataset:
        """Return the model as a Dataset; see `save` for what is in it."""
        return NoiseBank((self,)).to_dataset().isel(state=0)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the model to a NetCDF file, which `load_noise` reads.

        Parameters
        ----------
        path : str or Path
            File to write.
        overwrite : bool
            Replace an existing file.

        Raises
        ------
        InputError
            If the file exists and `overwrite` is false, or the folder cannot be written.

        Notes
        -----
        Variables ``bias``, ``gain``, ``covariance``, ``standard_error``, ``wind_speed``, ``yaw``, ``n_realizations``
        and the scan's geometry; the turbulence and the record's length are attributes. The file appears complete or
        not at all.
        """
        save_dataset(self.to_dataset(), path, overwrite=overwrite)


class _Place(NamedTuple):
    """Where in a bank the noise of records comes from."""

    used: FloatArray  # (ln U, ψ, ln L, Γ), shape (n_record, 4)
    wind_speed: FloatArray
    state: NDArray[np.int64]  # the nearest, where there is no net
    outside: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class NoiseBank:
    """Noise models of one scan at several states of the flow: between them if they form a net, else the nearest.

    Parameters
    ----------
    models : tuple of NoiseModel
        At least one; all of the same scan and record length. Their turbulence may differ in L and Γ if the states hold
        every combination of their wind speeds, directions, L and Γ.

    Attributes
    ----------
    net : StateNet or None
        The net of (ln U, ψ, ln L, Γ) that the states form, if they form one.

    Raises
    ------
    InputError
        If there is no model, or two were made for different scans or record lengths, or for different turbulence
        without forming a net.

    Notes
    -----
    In a net, every record gets noise of its own: variances, correlations, bias and gain are interpolated to its ln U
    and ψ (`interpolate_covariance`, `StateNet`). `interpolation_error` tells how well, where that was measured.

    Other states are not interpolated: each record takes the nearest in (ln U, ψ), because the noise depends on the wind
    speed through L/(U T): a step of 1 in ln U counts as much as a step of 1 rad in yaw.

    Nothing is extrapolated: a record outside the bank gets its nearest edge or state, `RecordNoise.outside` marks it,
    and `RecordNoise.wind_speed` tells which one that was.
    """

    models: tuple[NoiseModel, ...]
    net: StateNet | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        """Check that the models belong together."""
        object.__setattr__(self, "models", tuple(self.models))
        if not self.models:
            raise InputError("A noise bank needs at least one noise model.")
        first = self.models[0]
        for model in self.models[1:]:
            difference = geometry_difference(first.scan_geometry, model.scan_geometry)
            if difference:
                raise InputError(f"The models of a noise bank must be of one scan: {difference}.")
        object.__setattr__(self, "net", find_net(self._coordinates))
        for model in self.models[1:]:
            same_flow = self.net is not None or _flow(model.turbulence) == _flow(first.turbulence)
            if model.duration != first.duration or not same_flow:
                raise InputError(
                    "The models of a noise bank must be of one record length and one turbulence: "
                    f"{first.duration:g} s, {_flow(first.turbulence)} and "
                    f"{model.duration:g} s, {_flow(model.turbulence)}; only a net with every combination may have "
                    "several turbulences."
                )

    @property
    def beam(self) -> NDArray[np.int64]:
        """Numbers of the beams, shape (n_beam,)."""
        return self.models[0].beam

    @property
    def n_beam(self) -> int:
        """Number of beams."""
        return self.models[0].n_beam

    @property
    def scan_name(self) -> str:
        """Name of the scan."""
        return self.models[0].scan_name

    @property
    def scan_geometry(self) -> Mapping[str, Any]:
        """Geometry of the scan, as `Scan.geometry` returns it."""
        return self.models[0].scan_geometry

    @property
    def duration(self) -> float:
        """Length of a record, s."""
        return self.models[0].duration

    @property
    def turbulence(self) -> MannTurbulence:
        """Turbulence for which the bank was calibrated; that of the first state if there are several."""
        return self.models[0].turbulence

    @property
    def n_turbulence(self) -> int:
        """Number of different turbulences among the states."""
        return len({_flow(model.turbulence) for model in self.models})

    @property
    def length_scale(self) -> FloatArray:
        """Length scale L of each state, shape (n_state,), m."""
        return np.array([model.turbulence.length_scale for model in self.models])

    @property
    def gamma(self) -> FloatArray:
        """Anisotropy Γ of each state, shape (n_state,)."""
        return np.array([model.turbulence.gamma for model in self.models])

    @property
    def interpolation_error(self) -> float | None:
        """Largest error of K between the states, ‖δK‖/‖K‖ (Frobenius); None where it was not measured."""
        stated = self.models[0].details.get("interpolation_error")
        return None if self.net is None or stated is None else float(stated)

    @property
    def _coordinates(self) -> FloatArray:
        """The states as (ln U, ψ, ln L, Γ), shape (n_state, 4)."""
        return np.column_stack([np.log(self.wind_speed), self.yaw, np.log(self.length_scale), self.gamma])

    @property
    def wind_speed(self) -> FloatArray:
        """Mean wind speed of each state, shape (n_state,), m/s."""
        return np.array([model.wind_speed for model in self.models])

    @property
    def yaw(self) -> FloatArray:
        """Wind direction of each state, shape (n_state,), rad."""
        return np.array([model.yaw for model in self.models])

    def check_scan(self, scan: Scan) -> None:
        """Check that the bank was made for this scan; as `NoiseModel.check_scan`."""
        check_same_scan(self.scan_name, self.scan_geometry, scan)

    def select(self, beams: ArrayLike) -> NoiseBank:
        """Return the bank of only the beams whose numbers are given; as `NoiseModel.select`."""
        return NoiseBank(tuple(model.select(beams) for model in self.models))

    def at_turbulence(self, length_scale: float, gamma: float) -> NoiseBank:
        """Return the bank for one turbulence out of those that it spans.

        Parameters
        ----------
        length_scale : float
            Length scale L, m.
        gamma : float
            Anisotropy Γ.

        Returns
        -------
        bank : NoiseBank
            Its states are the wind speeds and directions of this bank; bias, gain and covariance are interpolated.

        Raises
        ------
        InputError
            If the states form no net.
        """
        if self.net is None:
            raise InputError(
                "The states of this noise bank form no net, so nothing can be interpolated: make one with theory_bank."
            )
        flow = replace(self.turbulence, length_scale=length_scale, gamma=gamma)
        plane = sorted({(model.wind_speed, model.yaw): model for model in self.models}.items())
        noise = self.for_records(
            [speed for (speed, _), _ in plane],
            [yaw for (_, yaw), _ in plane],
            length_scale=length_scale,
            gamma=gamma,
        )
        models = [
            replace(
                model,
                bias=noise.bias[i],
                gain=noise.gain[i],
                covariance=noise.covariance[i],
                standard_error=None,
                turbulence=flow,
            )
            for i, (_, model) in enumerate(plane)
        ]
        if self.has_sonic:
            sonic = self.sonic_for_records(
                [speed for (speed, _), _ in plane],
                [yaw for (_, yaw), _ in plane],
                length_scale=length_scale,
                gamma=gamma,
            )
            models = [
                replace(model, sonic_covariance=sonic.covariance[i], sonic_beam_covariance=sonic.beam_covariance[i])
                for i, model in enumerate(models)
            ]
        return NoiseBank(tuple(models))

    def for_records(
        self,
        wind_speed: ArrayLike,
        yaw: ArrayLike,
        *,
        length_scale: ArrayLike | None = None,
        gamma: ArrayLike | None = None,
    ) -> RecordNoise:
        """Return the noise of records: interpolated if the states form a net, else that of the nearest state.

        Parameters
        ----------
        wind_speed : array_like, shape (n_record,)
            Mean wind speed of each record, m/s.
        yaw : array_like, shape (n_record,)
            Wind direction relative to the lidar axis, rad.
        length_scale, gamma : array_like, shape (n_record,), optional
            Length scale L, m, and anisotropy Γ of each record's turbulence; needed for a bank that spans several.

        Returns
        -------
        noise : RecordNoise
            Arrays along the records.

        Raises
        ------
        InputError
            If a wind speed is not positive, a number is not finite, or L or Γ is missing.
        """
        points = self._points(wind_speed, yaw, length_scale, gamma)
        angle = points[:, 1]
        place = self._place(points)
        if self.net is None:
            state = place.state
            covariance, negative_part = self._stacked("covariance", state), np.zeros(len(state))
            bias, probe = self._stacked("bias", state), self.probe_change(state)
        else:
            weights, _ = self.net.weights(points)
            _, first, state = np.unique(place.used, axis=0, return_index=True, return_inverse=True)
            state = state.reshape(-1)
            own = np.stack([model.covariance for model in self.models])
            covariance, negative_part = (part[state] for part in interpolate_covariance(own, weights[first]))
            bias = combine(weights, np.stack([model.bias for model in self.models]))
            probe = combine(weights, self.probe_change(np.arange(len(self.models))))
        direction = np.asarray(self.scan_geometry["direction"], dtype=np.float64)
        return RecordNoise(
            bias=bias,
            gain=design_matrix(direction @ yaw_matrix(angle)) + probe,
            covariance=covariance,
            wind_speed=place.wind_speed,
            yaw=place.used[:, 1],
            state=state.astype(np.int64),
            outside=place.outside,
            negative_part=negative_part,
        )

    def weights_for(
        self,
        wind_speed: ArrayLike,
        yaw: ArrayLike,
        *,
        length_scale: ArrayLike | None = None,
        gamma: ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Return how the states of a net are weighted for records.

        Parameters
        ----------
        wind_speed, yaw, length_scale, gamma
            As for `for_records`.

        Returns
        -------
        weights : ndarray, shape (n_record, n_state)
            Weights of the states.
        yaw : ndarray, shape (n_record,)
            The records' own directions, within half a turn of the bank's middle, rad.
        outside : ndarray of bool, shape (n_record,)
            Whether a record is outside the bank, and weighted as at its edge.

        Raises
        ------
        InputError
            As for `for_records`, and if the states form no net.
        """
        if self.net is None:
            raise InputError(
                "The states of this noise bank form no net, so nothing can be interpolated: make one with theory_bank."
            )
        points = self._points(wind_speed, yaw, length_scale, gamma)
        return self.net.weights(points)[0], points[:, 1], self._place(points).outside

    @property
    def has_sonic(self) -> bool:
        """Whether all states hold the joint moments with a sonic's stresses."""
        return all(model.has_sonic for model in self.models)

    def sonic_for_records(
        self,
        wind_speed: ArrayLike,
        yaw: ArrayLike,
        *,
        length_scale: ArrayLike | None = None,
        gamma: ArrayLike | None = None,
    ) -> SonicNoise:
        """Return the joint moments with a sonic's stresses for records; interpolated as `for_records` does it.

        Parameters
        ----------
        wind_speed, yaw, length_scale, gamma
            As for `for_records`.

        Returns
        -------
        noise : SonicNoise
            Arrays along the records.

        Raises
        ------
        InputError
            As for `for_records`, and if the bank does not hold these moments.
        """
        points = self._points(wind_speed, yaw, length_scale, gamma)
        place = self._place(points)
        joint = np.stack([model.joint_covariance for model in self.models])
        n_beam = self.n_beam
        if self.net is None:
            first, state = np.unique(place.state, return_inverse=True)
            between, negative_part = joint[first], np.zeros(len(first))
        else:
            weights, _ = self.net.weights(points)
            _, first, state = np.unique(place.used, axis=0, return_index=True, return_inverse=True)
            between, negative_part = interpolate_covariance(joint, weights[first])
        state = state.reshape(-1)
        return SonicNoise(
            covariance=between[state, n_beam:, n_beam:],
            beam_covariance=between[state, n_beam:, :n_beam],
            state=state.astype(np.int64),
            negative_part=negative_part[state],
        )

    def locate(self, wind_speed: ArrayLike, yaw: ArrayLike) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Return for which wind speeds and directions `for_records` gives the noise of records, and which are outside.

        Parameters
        ----------
        wind_speed, yaw : array_like, shape (n_record,)
            As for `for_records`; L and Γ do not matter here.

        Returns
        -------
        wind_speed : ndarray, shape (n_record,)
            m/s.
        yaw : ndarray, shape (n_record,)
            rad.
        outside : ndarray of bool, shape (n_record,)
            Whether a record is outside the bank.
        """
        place = self._place(self._points(wind_speed, yaw, self.length_scale[0], self.gamma[0]))
        return place.wind_speed, place.used[:, 1], place.outside

    def _points(
        self, wind_speed: ArrayLike, yaw: ArrayLike, length_scale: ArrayLike | None, gamma: ArrayLike | None
    ) -> FloatArray:
        """Return the records as (ln U, ψ, ln L, Γ), shape (n_record, 4); ψ within half a turn of the bank's middle."""
        speed, angle = np.broadcast_arrays(np.atleast_1d(wind_speed), np.atleast_1d(yaw))
        speed = check_array(speed, (None,), what="wind_speed of the records")
        angle = check_array(angle, (None,), what="yaw of the records")
        for index in np.flatnonzero(speed <= 0.0):
            raise InputError(f"Invalid wind_speed {speed[index]:g} m/s of record {index}: it must be above zero.")
        centre = 0.5 * (np.min(self.yaw) + np.max(self.yaw))
        near = np.where(np.abs(angle - centre) <= np.pi, angle, centre + np.angle(np.exp(1j * (angle - centre))))
        scale = self._flow_of_records(length_scale, self.length_scale, "length_scale", len(speed))
        for index in np.flatnonzero(scale <= 0.0):
            raise InputError(f"Invalid length_scale {scale[index]:g} m of record {index}: it must be above zero.")
        anisotropy = self._flow_of_records(gamma, self.gamma, "gamma", len(speed))
        return np.column_stack([np.log(speed), near, np.log(scale), anisotropy])

    def _place(self, points: FloatArray) -> _Place:
        """Find where in the bank the noise of records comes from."""
        coordinates = self._coordinates
        low, high = np.min(coordinates, axis=0), np.max(coordinates, axis=0)
        # several states have edges; how far records are from a single one is for the caller to say
        outside = np.any((points < low - _EDGE) | (points > high + _EDGE), axis=1) & (len(coordinates) > 1)
        if self.net is not None:
            used = self.net.weights(points)[1]
            nearest = np.zeros(len(points), dtype=np.int64)
            return _Place(used, np.exp(used[:, 0]), nearest, outside)
        turn = np.angle(np.exp(1j * (points[:, 1:2] - coordinates[:, 1])))
        state = np.argmin((points[:, :1] - coordinates[:, 0]) ** 2 + turn**2, axis=1)
        return _Place(coordinates[state], self.wind_speed[state], state, outside)

    def _flow_of_records(self, given: ArrayLike | None, own: FloatArray, name: str, n_record: int) -> FloatArray:
        """Return L or Γ of each record; the bank's, if it has but one."""
        several = bool(np.ptp(own) > 0.0)
        if given is None and several:
            raise InputError(
                f"This noise bank spans {name} {np.min(own):g} to {np.max(own):g}: give the {name} of the records, or "
                "take the bank of one turbulence with at_turbulence."
            )
        values = np.broadcast_to(np.asarray(own[0] if given is None or not several else given), (n_record,))
        return check_array(values, (None,), what=f"{name} of the records")

    def _stacked(self, name: str, state: NDArray[np.int64]) -> FloatArray:
        """Return an array of the models for each record; a read-only view where there is one model."""
        if len(self.models) == 1:
            only = np.asarray(getattr(self.models[0], name))
            return np.broadcast_to(only, (len(state), *only.shape))
        return np.stack([getattr(model, name) for model in self.models])[state]

    def probe_change(self, state: NDArray[np.int64]) -> FloatArray:
        """Return what the probe volume adds to the design matrix at states, shape (n, n_beam, 6); zero for points."""
        direction = np.asarray(self.scan_geometry["direction"], dtype=np.float64)
        change = np.stack([model.gain - design_matrix(direction @ yaw_matrix(model.yaw)) for model in self.models])
        return np.asarray(change[state], dtype=np.float64)

    def to_dataset(self, *, single_precision: bool = False) -> xr.Dataset:
        """Return the bank as a Dataset with dimension ``state``; as `NoiseModel.to_dataset`.

        Parameters
        ----------
        single_precision : bool
            See `save`.

        Returns
        -------
        dataset : xarray.Dataset
            What `save` writes.
        """
        return noise_dataset(self, single_precision=single_precision)

    def save(self, path: str | Path, *, overwrite: bool = False, single_precision: bool = False) -> None:
        """Write the bank to one NetCDF file, which `load_noise` reads; as `NoiseModel.save`.

        Parameters
        ----------
        path : str or Path
            File to write.
        overwrite : bool
            Replace an existing file.
        single_precision : bool
            Write half of each covariance, and bias and gain, in single precision (6e-8 relative), without standard
            errors: a fifth of the size. Rounding can leave eigenvalues just below zero; reading takes the nearest
            positive semi-definite matrix.

        Raises
        ------
        InputError
            If the file exists and `overwrite` is false, or the folder cannot be written.
        """
        save_dataset(self.to_dataset(single_precision=single_precision), path, overwrite=overwrite)


Noise: TypeAlias = NoiseModel | NoiseBank
"""What `calibrate` makes, `load_noise` reads and `fit` takes."""


def _flow(turbulence: MannTurbulence) -> tuple[float, float, float]:
    return turbulence.dissipation, turbulence.length_scale, turbulence.gamma


def _checked_sonic(
    covariance: FloatArray | None, beam_covariance: FloatArray | None, n_beam: int, where: str
) -> dict[str, FloatArray]:
    """Check the moments with a sonic's stresses, if there are any."""
    if covariance is None and beam_covariance is None:
        return {}
    if covariance is None or beam_covariance is None:
        raise InputError(
            f"Invalid moments with a sonic in {where}: give both, sonic_covariance and sonic_beam_covariance, or none."
        )
    own = check_array(covariance, (len(STRESSES), len(STRESSES)), what=f"sonic_covariance in {where}")
    _check_covariance(own, f"sonic_covariance in {where}")
    across = check_array(beam_covariance, (len(STRESSES), n_beam), what=f"sonic_beam_covariance in {where}")
    return {"sonic_covariance": own, "sonic_beam_covariance": across}


def _check_covariance(covariance: FloatArray, where: str) -> None:
    size = float(np.max(np.abs(covariance)))
    asymmetry = np.abs(covariance - covariance.T)
    if np.any(asymmetry > 1e-12 * size):
        first = tuple(int(i) for i in np.argwhere(asymmetry > 1e-12 * size)[0])
        raise InputError(
            f"Invalid covariance in {where}: the entry at {first} is {covariance[first]:g} and its mirror image is "
            f"{covariance.T[first]:g}, and the matrix must be symmetric."
        )
    eigenvalues = np.linalg.eigvalsh(covariance)
    if eigenvalues[0] < -64.0 * len(covariance) * np.finfo(np.float64).eps * size:
        raise NotPositiveDefiniteError(
            f"Invalid covariance in {where}: its smallest eigenvalue is {eigenvalues[0]:g}, and a covariance has none "
            "below zero; check the numbers given.",
            smallest_eigenvalue=float(eigenvalues[0]),
        )
