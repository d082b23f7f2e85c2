"""Noise models: bias, gain and relative covariance of the beam variances of a record, and their files."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_finite, check_positive
from bayes_rs.errors import InputError, NoiseMismatchError, NotPositiveDefiniteError
from bayes_rs.forward import design_matrix
from bayes_rs.interpolation import StateNet, combine, find_net, interpolate_covariance, nearest_semidefinite
from bayes_rs.mann import MannTurbulence
from bayes_rs.probe import probe_difference
from bayes_rs.scan import Scan, yaw_matrix
from bayes_rs.stress import STRESSES

NOISE_METHODS: tuple[str, ...] = ("boxes", "theory", "given")
"""Where a noise model's numbers can come from."""

FILE_KIND = "bayes_rs noise"
FILE_VERSION = 1

_GEOMETRY_TOLERANCE = 2e-6
"""Two scans are the same if directions, distances (m) and times (s) differ by no more than this."""

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

    def __post_init__(self) -> None:
        """Check and freeze the arrays."""
        where = f"noise of scan {self.scan_name!r}"
        beam = np.array(self.beam, dtype=np.int64)
        if beam.ndim != 1 or len(beam) == 0:
            raise InputError(f"Invalid beam of shape {beam.shape} in {where}: one number for each beam, at least one.")
        n_beam = len(beam)
        geometry = _check_geometry(self.scan_geometry, beam, where)
        arrays = {
            "bias": check_array(self.bias, (n_beam,), what=f"bias in {where}"),
            "gain": check_array(self.gain, (n_beam, len(STRESSES)), what=f"gain in {where}"),
            "covariance": check_array(self.covariance, (n_beam, n_beam), what=f"covariance in {where}"),
        }
        if self.standard_error is not None:
            arrays["standard_error"] = check_array(
                self.standard_error, (n_beam, n_beam), what=f"standard_error in {where}"
            )
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
        _check_scan(self, scan)

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
        _save(self.to_dataset(), path, overwrite=overwrite)


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
            difference = _geometry_difference(first.scan_geometry, model.scan_geometry)
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
        _check_scan(self.models[0], scan)

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
        return NoiseBank(
            tuple(
                replace(
                    model,
                    bias=noise.bias[i],
                    gain=noise.gain[i],
                    covariance=noise.covariance[i],
                    standard_error=None,
                    turbulence=flow,
                )
                for i, (_, model) in enumerate(plane)
            )
        )

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
            bias, probe = self._stacked("bias", state), self._probe_change(state)
        else:
            weights, _ = self.net.weights(points)
            _, first, state = np.unique(place.used, axis=0, return_index=True, return_inverse=True)
            state = state.reshape(-1)
            own = np.stack([model.covariance for model in self.models])
            covariance, negative_part = (part[state] for part in interpolate_covariance(own, weights[first]))
            bias = combine(weights, np.stack([model.bias for model in self.models]))
            probe = combine(weights, self._probe_change(np.arange(len(self.models))))
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

    def _probe_change(self, state: NDArray[np.int64]) -> FloatArray:
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
        first, models = self.models[0], self.models
        details = [dict(model.details) for model in models]
        shared = {key: value for key, value in details[0].items() if all(d.get(key, _ABSENT) == value for d in details)}
        own = [json.dumps({k: v for k, v in d.items() if k not in shared}, sort_keys=True) for d in details]
        pair = ("state", "beam", "other_beam")
        variables: dict[str, Any] = {
            "bias": (pair[:2], np.stack([m.bias for m in models]), {"units": "1"}),
            "gain": (("state", "beam", "stress"), np.stack([m.gain for m in models]), {"units": "1"}),
            "covariance": (pair, np.stack([m.covariance for m in models]), {"units": "1"}),
            "n_realizations": ("state", np.array([float(m.n_realizations) for m in models])),
            "method": ("state", np.array([m.method for m in models], dtype=object)),
            "details": ("state", np.array(own, dtype=object)),
        }
        if all(m.standard_error is not None for m in models):
            variables["standard_error"] = (pair, np.stack([np.asarray(m.standard_error) for m in models]))
        if single_precision:
            row, column = np.triu_indices(self.n_beam)
            upper = np.stack([m.covariance[row, column] for m in models]).astype(np.float32)
            change = np.round(self._probe_change(np.arange(len(models))), 8).astype(np.float32)
            variables["bias"] = (pair[:2], variables["bias"][1].astype(np.float32), {"units": "1"})
            variables["covariance_upper"] = (("state", "beam_pair"), upper, {"units": "1"})
            variables["gain_change"] = (("state", "beam", "stress"), change, {"units": "1"})
            for name in ("covariance", "gain", "standard_error"):
                variables.pop(name, None)
        geometry = first.scan_geometry
        coordinates: dict[str, Any] = {
            "beam": first.beam,
            "other_beam": first.beam,
            "stress": np.array(STRESSES, dtype=object),
            "wind_speed": ("state", self.wind_speed, {"units": "m s-1"}),
            "yaw": ("state", self.yaw, {"units": "rad"}),
            "direction": (("beam", "axis"), np.array(geometry["direction"], dtype=np.float64)),
            "focus_distance": ("beam", np.array(geometry["focus_distance"], dtype=np.float64), {"units": "m"}),
            "beam_time": ("beam", np.array(geometry["beam_time"], dtype=np.float64), {"units": "s"}),
        }
        if self.n_turbulence > 1:
            coordinates["length_scale"] = ("state", self.length_scale, {"units": "m"})
            coordinates["gamma"] = ("state", self.gamma, {"units": "1"})
        attributes = {
            "kind": FILE_KIND,
            "format_version": FILE_VERSION,
            "scan": first.scan_name,
            "scan_duration": float(geometry["scan_duration"]),
            "duration": float(first.duration),
            "dissipation": first.turbulence.dissipation,
            "length_scale": first.turbulence.length_scale,
            "gamma": first.turbulence.gamma,
            "turbulence": first.turbulence.name,
            "turbulence_source": first.turbulence.source,
            "details": json.dumps(shared, sort_keys=True),
            **({"probe": json.dumps(geometry["probe"], sort_keys=True)} if "probe" in geometry else {}),
        }
        return xr.Dataset(variables, coords=coordinates, attrs=attributes)

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
        _save(self.to_dataset(single_precision=single_precision), path, overwrite=overwrite)


Noise: TypeAlias = NoiseModel | NoiseBank
"""What `calibrate` makes, `load_noise` reads and `fit` takes."""

_ABSENT = object()


def load_noise(path: str | Path) -> NoiseModel | NoiseBank:
    """Read a noise model or a noise bank from the NetCDF file that `save` wrote.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    noise : NoiseModel or NoiseBank
        Whichever the file holds.

    Raises
    ------
    InputError
        If there is no such file, or it is not a noise file that this version can read.

    Examples
    --------
    >>> from bayes_rs.models import models_folder
    >>> load_noise(models_folder("noise") / "6-beam.nc").scan_name
    '6-beam'
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"No noise file {str(file)!r}: make one with calibrate, or give the path of another.")
    try:
        dataset = xr.load_dataset(file, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        raise InputError(
            f"File {str(file)!r} cannot be read as NetCDF, it is damaged or of another kind: {error}."
        ) from error
    if dataset.attrs.get("kind") != FILE_KIND:
        raise InputError(f"File {str(file)!r} is not a noise file of bayes_rs: make one with calibrate.")
    version = dataset.attrs.get("format_version", 0)
    if version != FILE_VERSION:
        raise InputError(
            f"Noise file {str(file)!r} has format version {version} and this program reads {FILE_VERSION}: "
            "calibrate again."
        )
    try:
        return _from_dataset(dataset)
    except InputError as error:
        raise InputError(f"Noise file {str(file)!r} is damaged: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"Noise file {str(file)!r} is damaged, {error} cannot be read: calibrate again.") from error


def _from_dataset(dataset: xr.Dataset) -> NoiseModel | NoiseBank:
    one = "state" not in dataset.dims
    states = dataset.expand_dims("state") if one else dataset
    attributes = states.attrs
    geometry = {
        "beam": states["beam"].values.tolist(),
        "direction": _per_beam(states["direction"]).tolist(),
        "focus_distance": _per_beam(states["focus_distance"]).tolist(),
        "beam_time": _per_beam(states["beam_time"]).tolist(),
        "scan_duration": float(attributes["scan_duration"]),
        **({"probe": json.loads(attributes["probe"])} if "probe" in attributes else {}),
    }
    turbulence = MannTurbulence(
        dissipation=float(attributes["dissipation"]),
        length_scale=float(attributes["length_scale"]),
        gamma=float(attributes["gamma"]),
        name=str(attributes["turbulence"]),
        source=str(attributes["turbulence_source"]),
    )
    shared = json.loads(attributes["details"])
    gain, covariance = _matrices(states)
    models = []
    for index in range(states.sizes["state"]):
        state = states.isel(state=index)
        own_scale = float(state["length_scale"]) if "length_scale" in state.coords else turbulence.length_scale
        own_gamma = float(state["gamma"]) if "gamma" in state.coords else turbulence.gamma
        models.append(
            NoiseModel(
                bias=state["bias"].values,
                gain=gain[index],
                covariance=covariance[index],
                beam=state["beam"].values,
                scan_name=str(attributes["scan"]),
                scan_geometry=geometry,
                wind_speed=float(state["wind_speed"]),
                yaw=float(state["yaw"]),
                duration=float(attributes["duration"]),
                turbulence=replace(turbulence, length_scale=own_scale, gamma=own_gamma),
                method=str(state["method"].item()),
                n_realizations=float(state["n_realizations"]),
                standard_error=state["standard_error"].values if "standard_error" in state else None,
                details={**shared, **json.loads(str(state["details"].item()))},
            )
        )
    return models[0] if one else NoiseBank(tuple(models))


def _matrices(states: xr.Dataset) -> tuple[FloatArray, FloatArray]:
    """Return gain and covariance of each state, whether written in full or in single precision."""
    if "covariance_upper" not in states:
        return states["gain"].values, states["covariance"].values
    n_beam = states.sizes["beam"]
    row, column = np.triu_indices(n_beam)
    covariance = np.empty((states.sizes["state"], n_beam, n_beam))
    covariance[:, row, column] = covariance[:, column, row] = states["covariance_upper"].values
    direction, yaw = _per_beam(states["direction"]), np.asarray(states["yaw"].values, dtype=np.float64)
    gain = design_matrix(direction @ yaw_matrix(yaw)) + states["gain_change"].values
    return np.asarray(gain, dtype=np.float64), nearest_semidefinite(covariance)[0]


def _per_beam(variable: xr.DataArray) -> FloatArray:
    values = variable.isel(state=0) if "state" in variable.dims else variable
    return np.asarray(values.values, dtype=np.float64)


def _save(dataset: xr.Dataset, path: str | Path, *, overwrite: bool) -> None:
    file = Path(path)
    if file.exists() and not overwrite:
        raise InputError(f"File {str(file)!r} exists: give another name, or overwrite=True to replace it.")
    try:
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=f".{file.name}-") as folder:
            part = Path(folder) / "part.nc"
            dataset.to_netcdf(part, engine="h5netcdf", encoding=_encoding(dataset))
            part.replace(file)
    except OSError as error:
        raise InputError(
            f"Cannot write {str(file)!r}: {error.strerror or error}; give a folder that exists and can be written."
        ) from error


def _encoding(dataset: xr.Dataset) -> dict[str, dict[str, Any]]:
    large = [name for name, item in dataset.variables.items() if item.dtype.kind == "f" and item.nbytes > 4096]
    return {str(name): {"zlib": True, "complevel": 6, "shuffle": True} for name in large}


def _flow(turbulence: MannTurbulence) -> tuple[float, float, float]:
    return turbulence.dissipation, turbulence.length_scale, turbulence.gamma


def _check_geometry(geometry: Mapping[str, Any], beam: NDArray[np.int64], where: str) -> dict[str, Any]:
    missing = [
        key for key in ("beam", "direction", "focus_distance", "beam_time", "scan_duration") if key not in geometry
    ]
    if missing:
        raise InputError(f"Invalid scan_geometry in {where}: {missing[0]!r} is missing; take it from Scan.geometry().")
    if list(geometry["beam"]) != beam.tolist():
        raise InputError(
            f"Invalid beam {beam.tolist()} in {where}: its scan_geometry has the beams {list(geometry['beam'])}."
        )
    return {
        "beam": beam.tolist(),
        "direction": check_array(geometry["direction"], (len(beam), 3), what=f"direction in {where}").tolist(),
        "focus_distance": check_array(
            geometry["focus_distance"], (len(beam),), what=f"focus_distance in {where}"
        ).tolist(),
        "beam_time": check_array(geometry["beam_time"], (len(beam),), what=f"beam_time in {where}").tolist(),
        "scan_duration": float(geometry["scan_duration"]),
        **({"probe": dict(geometry["probe"])} if geometry.get("probe") else {}),
    }


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


def _geometry_difference(noise: Mapping[str, Any], scan: Mapping[str, Any]) -> str:
    """Say in words what differs first between two geometries, the noise's and a scan's; empty if nothing does."""
    if list(noise["beam"]) != list(scan["beam"]):
        return f"the beams are {_short(noise['beam'])} in the noise and {_short(scan['beam'])} in the scan"
    for key, word, unit in (
        ("direction", "direction", ""),
        ("focus_distance", "focus distance", " m"),
        ("beam_time", "time within the scan", " s"),
    ):
        have, want = np.asarray(noise[key]), np.asarray(scan[key])
        gap = np.abs(have - want).reshape(len(have), -1).max(axis=1)
        for index in np.flatnonzero(gap > _GEOMETRY_TOLERANCE):
            return (
                f"the {word} of beam {noise['beam'][index]} is {_number(have[index])}{unit} in the noise and "
                f"{_number(want[index])}{unit} in the scan"
            )
    if abs(noise["scan_duration"] - scan["scan_duration"]) > _GEOMETRY_TOLERANCE:
        return f"the scan takes {noise['scan_duration']:g} s in the noise and {scan['scan_duration']:g} s in the scan"
    return probe_difference(noise.get("probe"), scan.get("probe"))


def _check_scan(noise: NoiseModel, scan: Scan) -> None:
    difference = _geometry_difference(noise.scan_geometry, scan.geometry())
    if difference:
        raise NoiseMismatchError(
            f"The noise of scan {noise.scan_name!r} was not made for scan {scan.name!r}: {difference}. "
            "Run calibrate for this scan, or select the beams that both have.",
            difference=difference,
        )


def _short(numbers: list[int]) -> str:
    return str(list(numbers)) if len(numbers) <= 8 else f"{len(numbers)} from {numbers[0]} to {numbers[-1]}"


def _number(value: FloatArray) -> str:
    return f"{float(value):g}" if value.ndim == 0 else "(" + ", ".join(f"{item:.4f}" for item in value) + ")"
