"""Noise: bias, gain and relative covariance of the beam variances of a record, at one or several states of the flow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan, yaw_matrix
from bayes_rs.html_parts import card, heat_map
from bayes_rs.noise.checking import checked_fields
from bayes_rs.noise.flow_states import FlowStates
from bayes_rs.noise.layout import noise_dataset
from bayes_rs.noise.noise_geometry import check_same_scan, geometry_difference
from bayes_rs.noise.record_noise import RecordNoise, SonicNoise
from bayes_rs.noise.sealed import save_dataset
from bayes_rs.turbulence.interpolation import StateNet, spread_and_correlation
from bayes_rs.turbulence.mann import MannTurbulence

_ABSENT = object()
_PER_STATE = ("bias", "gain", "covariance", "wind_speed", "yaw", "length_scale", "gamma", "n_realizations")
_OPTIONAL = ("standard_error", "sonic_covariance", "sonic_beam_covariance")
_MOST_KEPT = 4_000_000  # numbers, 32 MB
_AT_ONCE = 16_384
"""Records that are placed among the states at a time."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Bias, gain and relative covariance of a scan's beam variances, at one or several states of the flow.

    All arrays have the states as their first axis, of length 1 for one state. With a single number as `wind_speed`, the
    arrays may be given without that axis.

    Parameters
    ----------
    bias : array_like, shape (n_state, n_beam)
        E[y_b] / (n·R n) − 1, with R the tensor of an infinite record; below zero, because a record loses its slow
        eddies with its mean.
    gain : array_like, shape (n_state, n_beam, 6)
        E[y] = gain @ stresses, for the stresses of a record (its own mean removed). For beams that measure
        at a point it is the design matrix.
    covariance : array_like, shape (n_state, n_beam, n_beam)
        Relative covariance K: Cov[y_a, y_b] = K_ab E[y_a] E[y_b].
    beam : array_like of int, shape (n_beam,)
        Numbers of the beams.
    scan_name : str
        Name of the scan.
    scan_geometry : mapping
        What `Scan.geometry` returned for it: the lists ``beam``, ``direction``, ``focus_distance`` (m) and
        ``beam_time`` (s), and ``scan_duration`` (s); for beams that do not see points, the mapping ``probe``.
    wind_speed : array_like, shape (n_state,), or float
        Mean wind speed U, m/s.
    yaw : array_like, shape (n_state,), or float
        Wind direction relative to the lidar axis ψ, rad.
    duration : float
        Length of a record T, s.
    turbulence : MannTurbulence
        Turbulence for which it was made; L and Γ are those of the first state.
    method : str
        ``"boxes"``, ``"theory"`` or ``"given"``.
    length_scale, gamma : array_like, shape (n_state,), or float, optional
        Length scale L, m, and anisotropy Γ; by default those of `turbulence`. They may differ if the states hold every
        combination of their wind speeds, directions, L and Γ.
    n_realizations : array_like, shape (n_state,), or float
        Effective number of independent records behind the covariance; infinite for theory.
    standard_error : array_like, shape (n_state, n_beam, n_beam), optional
        Standard error of each entry of the covariance.
    details : mapping
        How it was made, as plain JSON values.
    state_details : sequence of mapping, optional
        What of that differs between the states, one mapping for each.
    sonic_covariance : array_like, shape (n_state, 6, 6), optional
        Covariance of L⁻¹ S L⁻ᵀ, with S the tensor that a sonic measures in the record and L Lᵀ its expectation; in the
        order uu, vv, ww, uv, uw, vw. Needed for the target ``"sonic"`` only.
    sonic_beam_covariance : array_like, shape (n_state, 6, n_beam), optional
        Covariance of L⁻¹ S L⁻ᵀ with the relative variances y_b / E[y_b]; with `sonic_covariance` or not at all.

    Attributes
    ----------
    states : FlowStates
        The states: wind speed, direction, L and Γ.

    Raises
    ------
    InputError
        If a shape disagrees with the beams or the states, a number is not finite, a covariance is not symmetric, or
        states of several turbulences form no net.
    NotPositiveDefiniteError
        If a covariance has an eigenvalue that is negative by more than rounding.

    Notes
    -----
    For a record k and beam b the radial-velocity variance is y_b = (1/N) Σ (v − v̄)², divisor N. Relative noise depends
    on L/(U T), Γ, the beams and their timing; the dissipation scales out.

    Where the states are every combination of some wind speeds, directions, L and Γ (a net), every record gets noise of
    its own: variances, correlations, bias and gain are interpolated to its ln U and ψ (`interpolate_covariance`,
    `StateNet`). `interpolation_error` tells how well, where that was measured.

    Other states are not interpolated: each record takes the nearest in (ln U, ψ), because the noise depends on the wind
    speed through L/(U T): a step of 1 in ln U counts as much as a step of 1 rad in yaw.

    Nothing is extrapolated: a record outside gets the nearest edge or state, `RecordNoise.outside` marks it if it is
    farther away than `REACH`, and `RecordNoise.wind_speed` tells which one that was. So it is with one state.

    Examples
    --------
    >>> noise = Noise(
    ...     bias=[-0.1], gain=[[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]], covariance=[[0.06]], beam=[0], scan_name="staring",
    ...     scan_geometry={"beam": [0], "direction": [[-1.0, 0.0, 0.0]], "focus_distance": [98.0], "beam_time": [0.0],
    ...                    "scan_duration": 1.0},
    ...     wind_speed=10.0, yaw=0.0, duration=600.0, turbulence=MannTurbulence(0.05, 61.0, 3.2), method="given",
    ... )
    >>> noise.relative_error.round(3)
    array([[0.245]])
    >>> noise.for_records([10.2, 16.0], yaw=0.0).outside
    array([False,  True])
    """

    bias: FloatArray
    gain: FloatArray
    covariance: FloatArray
    beam: NDArray[np.int64]
    scan_name: str
    scan_geometry: Mapping[str, Any]
    wind_speed: FloatArray
    yaw: FloatArray
    duration: float
    turbulence: MannTurbulence
    method: str
    length_scale: FloatArray = None  # type: ignore[assignment] # that of the turbulence
    gamma: FloatArray = None  # type: ignore[assignment] # that of the turbulence
    n_realizations: FloatArray = np.inf  # type: ignore[assignment] # one number for all states
    standard_error: FloatArray | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    state_details: tuple[Mapping[str, Any], ...] = ()
    sonic_covariance: FloatArray | None = None
    sonic_beam_covariance: FloatArray | None = None
    states: FlowStates = field(init=False, repr=False)

    if TYPE_CHECKING:  # what it holds are arrays, what it takes need not be

        def __init__(
            self,
            bias: ArrayLike,
            gain: ArrayLike,
            covariance: ArrayLike,
            beam: ArrayLike,
            scan_name: str,
            scan_geometry: Mapping[str, Any],
            wind_speed: ArrayLike,
            yaw: ArrayLike,
            duration: float,
            turbulence: MannTurbulence,
            method: str,
            length_scale: ArrayLike | None = None,
            gamma: ArrayLike | None = None,
            n_realizations: ArrayLike = ...,
            standard_error: ArrayLike | None = None,
            details: Mapping[str, Any] = ...,
            state_details: Sequence[Mapping[str, Any]] = ...,
            sonic_covariance: ArrayLike | None = None,
            sonic_beam_covariance: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check and freeze the arrays."""
        for name, value in checked_fields(vars(self)).items():
            object.__setattr__(self, name, value)
        states = FlowStates(self.wind_speed, self.yaw, self.length_scale, self.gamma)
        object.__setattr__(self, "states", states)
        if states.net is None and self.n_turbulence > 1:
            raise InputError(
                f"Invalid states in noise of scan {self.scan_name!r}: they are of {self.n_turbulence} turbulences and "
                "form no net; only a net, with every combination of wind speed, direction, L and Γ, may have several "
                "turbulences."
            )

    @classmethod
    def join(cls, parts: Sequence[Noise]) -> Noise:
        """Return the states of several noises of one scan as one noise.

        Parameters
        ----------
        parts : sequence of Noise
            At least one; all of the same scan, record length, dissipation and method.

        Returns
        -------
        noise : Noise
            Their states, in this order. Standard errors and moments with a sonic are kept if all of them have them.

        Raises
        ------
        InputError
            If there is none, or two do not belong together.
        """
        parts = tuple(parts)
        if not parts:
            raise InputError("There is no noise to join: give at least one.")
        first = parts[0]
        for part in parts[1:]:
            if difference := geometry_difference(first.scan_geometry, part.scan_geometry):
                raise InputError(f"Noise can be joined if it is of one scan: {difference}.")
            have, want = (
                f"{one.duration:g} s, dissipation {one.turbulence.dissipation:g}, method {one.method}"
                for one in (part, first)
            )
            if have != want:
                raise InputError(
                    f"Noise can be joined if it is of one record length, dissipation and method: {want}; and {have}."
                )
        details = [part._details_of(index) for part in parts for index in range(len(part))]
        shared = {key: v for key, v in details[0].items() if all(d.get(key, _ABSENT) == v for d in details)}
        columns = {name: [getattr(part, name) for part in parts] for name in (*_PER_STATE, *_OPTIONAL)}
        changes: dict[str, Any] = {
            name: None if any(one is None for one in values) else np.concatenate(values)
            for name, values in columns.items()
        }
        changes["state_details"] = [{key: v for key, v in d.items() if key not in shared} for d in details]
        return replace(first, details=shared, **changes)

    def __repr__(self) -> str:
        """Say in one line what it is."""
        return f"<Noise of scan {self.scan_name}, {self.in_words()[len('noise: ') :]}>"

    def _repr_html_(self) -> str:
        """Say it in a notebook, with the correlation of the beams' variances in the middle state."""
        low, high = (f"{100.0 * value:.3g}" for value in (self.relative_error.min(), self.relative_error.max()))
        rows = [
            ("noise", self.in_words()[len("noise: ") :]),
            ("records", f"{self.duration:g} s"),
            ("error of a variance", f"{low if low == high else f'{low} to {high}'} % of it"),
        ]
        middle = len(self) // 2
        what = f"correlation of the beams' variances at {self.wind_speed[middle]:g} m/s"
        return card(
            f"Noise of scan {self.scan_name}", rows, heat_map(self.correlation[middle], list(map(str, self.beam)), what)
        )

    def __len__(self) -> int:
        """Number of states."""
        return len(self.wind_speed)

    @property
    def n_state(self) -> int:
        """Number of states."""
        return len(self)

    @property
    def n_beam(self) -> int:
        """Number of beams."""
        return len(self.beam)

    @property
    def net(self) -> StateNet | None:
        """The net of (ln U, ψ, ln L, Γ) that the states form, if they form one."""
        return self.states.net

    @property
    def n_turbulence(self) -> int:
        """Number of different turbulences among the states."""
        return len(np.unique(np.column_stack([self.length_scale, self.gamma]), axis=0))

    @property
    def interpolation_error(self) -> float | None:
        """Largest error of K between the states, ‖δK‖/‖K‖ (Frobenius); None where it was not measured."""
        stated = self._details_of(0).get("interpolation_error")
        return None if self.net is None or stated is None else float(stated)

    @property
    def relative_error(self) -> FloatArray:
        """Relative standard deviation of each beam's variance, shape (n_state, n_beam)."""
        return np.asarray(np.sqrt(np.einsum("sbb->sb", self.covariance)))

    @property
    def correlation(self) -> FloatArray:
        """Correlation of the beams' variances, shape (n_state, n_beam, n_beam)."""
        spread = self.relative_error
        return self.covariance / (spread[:, :, np.newaxis] * spread[:, np.newaxis])

    @property
    def has_sonic(self) -> bool:
        """Whether it holds the joint moments with a sonic's stresses."""
        return self.sonic_covariance is not None

    @property
    def joint_covariance(self) -> FloatArray:
        """Covariance of the relative beam variances and L⁻¹ S L⁻ᵀ, shape (n_state, n_beam + 6, n_beam + 6).

        Raises
        ------
        InputError
            If the noise does not hold the moments with a sonic.
        """
        if self.sonic_covariance is None or self.sonic_beam_covariance is None:
            raise InputError(
                f"The noise of scan {self.scan_name!r} holds no moments with a sonic, which the target 'sonic' needs: "
                "make it with noise.calibrate(..., sonic=True) or bayes-rs calibrate --sonic."
            )
        across = self.sonic_beam_covariance
        return np.block([[self.covariance, across.swapaxes(-1, -2)], [across, self.sonic_covariance]])

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

    def state(self, index: int) -> Noise:
        """Return the noise of one state.

        Parameters
        ----------
        index : int
            Number of the state.

        Returns
        -------
        noise : Noise
            That state alone; `Noise.join` puts states together again.
        """
        return self._some_states([index])

    def select(self, beams: ArrayLike) -> Noise:
        """Return the noise of only the beams whose numbers are given, in that order.

        Parameters
        ----------
        beams : array_like of int
            Beam numbers.

        Returns
        -------
        noise : Noise
            The noise of these beams.

        Raises
        ------
        InputError
            If a number is not one of the noise's beams.
        """
        wanted = np.atleast_1d(np.asarray(beams, dtype=np.int64))
        for number in wanted:
            if number not in self.beam:
                raise InputError(
                    f"Unknown beam {number} in the noise of scan {self.scan_name!r}: "
                    f"its beams are {self.beam.tolist()}."
                )
        if np.array_equal(wanted, self.beam):
            return self
        index = np.array([int(np.flatnonzero(self.beam == number)[0]) for number in wanted])
        per_beam = ("beam", "direction", "focus_distance", "beam_time")
        geometry = {key: [self.scan_geometry[key][i] for i in index] for key in per_beam}
        row, column = np.ix_(index, index)
        return replace(
            self,
            bias=self.bias[:, index],
            gain=self.gain[:, index],
            covariance=self.covariance[:, row, column],
            beam=self.beam[index],
            scan_geometry={**self.scan_geometry, **geometry},
            standard_error=None if self.standard_error is None else self.standard_error[:, row, column],
            sonic_beam_covariance=None
            if self.sonic_beam_covariance is None
            else self.sonic_beam_covariance[:, :, index],
        )

    def at_turbulence(self, length_scale: float, gamma: float) -> Noise:
        """Return the noise for one turbulence out of those that it spans.

        Parameters
        ----------
        length_scale : float
            Length scale L, m.
        gamma : float
            Anisotropy Γ.

        Returns
        -------
        noise : Noise
            Its states are the wind speeds and directions of this noise; bias, gain and covariance are interpolated.

        Raises
        ------
        InputError
            If the states form no net.
        """
        self.states.check_net()
        winds = zip(self.wind_speed.tolist(), self.yaw.tolist(), strict=True)
        plane = {wind: index for index, wind in enumerate(winds)}
        some = self._some_states([plane[wind] for wind in sorted(plane)])
        noise = self.for_records(some.wind_speed, some.yaw, length_scale=length_scale, gamma=gamma)
        sonic = None
        if self.has_sonic:
            sonic = self.sonic_for_records(some.wind_speed, some.yaw, length_scale=length_scale, gamma=gamma)
        return replace(
            some,
            bias=noise.bias,
            gain=noise.gain,
            covariance=noise.covariance,
            standard_error=None,
            turbulence=replace(self.turbulence, length_scale=length_scale, gamma=gamma),
            length_scale=np.full(len(some), length_scale),
            gamma=np.full(len(some), gamma),
            sonic_covariance=None if sonic is None else sonic.covariance,
            sonic_beam_covariance=None if sonic is None else sonic.beam_covariance,
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
            Length scale L, m, and anisotropy Γ of each record's turbulence; needed where the states have several. Where
            they have one, a record that is too far from it is marked as outside, and one that is NaN is not known.

        Returns
        -------
        noise : RecordNoise
            Arrays along the records; read-only views where there is one state.

        Raises
        ------
        InputError
            If a wind speed is not positive, a number is not finite, or L or Γ is missing.
        """
        points = self.states.points(wind_speed, yaw, length_scale, gamma)
        place = self.states.place(points)
        different, negative_part, state = place.covariances(self.covariance, self._parts)
        probe = place.values(self.probe_change())
        direction = np.asarray(self.scan_geometry["direction"], dtype=np.float64)
        return RecordNoise(
            bias=place.values(self.bias),
            gain=design_matrix(direction @ yaw_matrix(points[:, 1])) + probe,
            covariance=np.broadcast_to(different[0], (len(state), *different[0].shape))
            if len(self) == 1
            else different[state],
            wind_speed=place.wind_speed,
            yaw=place.used[:, 1],
            state=state,
            outside=place.outside,
            negative_part=negative_part[state],
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
            The records' own directions, within half a turn of the states' middle, rad.
        outside : ndarray of bool, shape (n_record,)
            Whether a record is outside, and weighted as at the edge.

        Raises
        ------
        InputError
            As for `for_records`, and if the states form no net.
        """
        self.states.check_net()
        points = self.states.points(wind_speed, yaw, length_scale, gamma)
        place = self.states.place(points)
        return np.asarray(place.weights), points[:, 1], place.outside

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
            As for `for_records`, and if the noise does not hold these moments.
        """
        place = self.states.place(self.states.points(wind_speed, yaw, length_scale, gamma))
        different, negative_part, state = place.covariances(self.joint_covariance)
        n_beam = self.n_beam
        return SonicNoise(
            covariance=different[state, n_beam:, n_beam:],
            beam_covariance=different[state, n_beam:, :n_beam],
            state=state,
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
            Whether a record is outside.
        """
        place = self.states.place(self.states.points(wind_speed, yaw, self.length_scale[0], self.gamma[0]))
        return place.wind_speed, place.used[:, 1], place.outside

    def probe_change(self) -> FloatArray:
        """Return what the probe volume adds to the design matrix, shape (n_state, n_beam, 6); zero for points."""
        return self._probe_change

    @cached_property
    def _parts(self) -> tuple[FloatArray, FloatArray] | None:
        """What all records are interpolated from; kept unless it is large."""
        some = self.net is not None and self.covariance.size <= _MOST_KEPT
        return spread_and_correlation(self.covariance) if some else None

    @cached_property
    def _probe_change(self) -> FloatArray:
        direction = np.asarray(self.scan_geometry["direction"], dtype=np.float64)
        return np.stack(
            [gain - design_matrix(direction @ yaw_matrix(yaw)) for gain, yaw in zip(self.gain, self.yaw, strict=True)]
        )

    def in_words(
        self,
        wind_speed: ArrayLike | None = None,
        yaw: ArrayLike | None = None,
        *,
        length_scale: ArrayLike | None = None,
        gamma: ArrayLike | None = None,
    ) -> str:
        """Say which noise it is, how well it is interpolated, and how many records are outside it.

        Parameters
        ----------
        wind_speed, yaw : array_like, shape (n_record,), optional
            Mean wind speeds of records, m/s, and their directions, rad; those that are not known are left out.
        length_scale : array_like, shape (n_record,) or (n, n_record), optional
            Length scales of the records, m; n of them where their noise is averaged over as many.
        gamma : array_like, shape (n_record,), optional
            Their anisotropies. Without what `for_records` needs, the error is that of the worst place of the net.

        Returns
        -------
        words : str
            One line. The error of the interpolation is that of the cells of the net that hold records, where it was
            measured cell by cell.
        """
        origin = self.details.get("origin")
        words = (
            f"noise: {f'{origin}, ' if origin else ''}{self.turbulence.name}, method {self.method}, {len(self)} "
            f"state{'s' * (len(self) > 1)} ({_span(self.wind_speed)} m/s, yaw {_span(np.rad2deg(self.yaw))}°, "
            f"L {_span(self.length_scale)} m)"
        )
        speed, angle = (np.asarray([] if one is None else one, dtype=np.float64) for one in (wind_speed, yaw))
        known = np.isfinite(speed) & np.isfinite(angle) & (speed > 0.0)
        if self.net is not None:
            words += f"; interpolated, with an error {self._error_in_words(speed, angle, known, length_scale, gamma)}"
        elif len(self) > 1:
            words += "; each record uses the nearest"
        if self.has_sonic:
            words += "; with the moments of a sonic"
        if wind_speed is None or yaw is None:
            return words
        some = np.flatnonzero(known)
        pieces = [some[first : first + _AT_ONCE] for first in range(0, len(some), _AT_ONCE)]
        n_outside = sum(int(np.count_nonzero(self.locate(speed[rows], angle[rows])[2])) for rows in pieces)
        if n_outside:
            nearest = "edge" if self.net is not None else "nearest state"
            words += f"; {n_outside} of {np.count_nonzero(known)} records are outside and use its {nearest}"
        return words

    def _error_in_words(
        self,
        speed: FloatArray,
        yaw: FloatArray,
        known: NDArray[np.bool_],
        length_scale: ArrayLike | None,
        gamma: ArrayLike | None,
    ) -> str:
        """Say how well records are interpolated, or if that is not known, how well the worst that there may be."""
        error = self.interpolation_error
        if error is None or self.net is None:
            return "not measured"
        by_cell = np.asarray(self._details_of(0).get("interpolation_errors", []), dtype=np.float64)
        n_cell = np.prod([max(len(axis) - 1, 1) for axis in self.net.axes])
        lengths = np.atleast_2d(self._or_own(length_scale, self.length_scale))
        anisotropy = self._or_own(gamma, self.gamma)
        there = known & np.isfinite(lengths) & np.isfinite(anisotropy)
        if by_cell.shape != (n_cell,) or not there.any():
            return f"of at most {100.0 * error:.2g} %"
        of_all = np.broadcast_arrays(speed, yaw, lengths, anisotropy)
        cell = self.net.cells(self.states.points(*(one[there] for one in of_all)))
        return f"of {100.0 * np.max(by_cell[cell]):.2g} % at the records"

    @staticmethod
    def _or_own(given: ArrayLike | None, own: FloatArray) -> FloatArray:
        """Return what records have of L or Γ, or what all states have; NaN where neither is known."""
        if np.ptp(own) == 0.0:
            return own[:1]
        return np.asarray(np.nan if given is None else given, dtype=np.float64)

    def to_dataset(self, *, single_precision: bool = False) -> xr.Dataset:
        """Return the noise as a Dataset with dimension ``state``.

        Parameters
        ----------
        single_precision : bool
            See `save`.

        Returns
        -------
        dataset : xarray.Dataset
            What `save` writes.
        """
        return noise_dataset(vars(self), probe_change=self.probe_change() if single_precision else None)

    def save(self, path: str | Path, *, overwrite: bool = False, single_precision: bool = False) -> None:
        """Write the noise to a NetCDF file, which `bayes_rs.noise.load` reads.

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

        Notes
        -----
        Variables ``bias``, ``gain``, ``covariance``, ``standard_error``, ``wind_speed``, ``yaw``, ``n_realizations``
        and the scan's geometry; the turbulence and the record's length are attributes. The file appears complete or
        not at all.
        """
        save_dataset(self.to_dataset(single_precision=single_precision), path, overwrite=overwrite)

    def _some_states(self, index: Sequence[int]) -> Noise:
        """Return the noise of some of the states."""
        rows = np.arange(len(self))[list(index)]
        arrays = {name: getattr(self, name) for name in (*_PER_STATE, *_OPTIONAL)}
        changes: dict[str, Any] = {name: None if values is None else values[rows] for name, values in arrays.items()}
        flow = replace(
            self.turbulence, length_scale=float(self.length_scale[rows[0]]), gamma=float(self.gamma[rows[0]])
        )
        if len(rows) == 1:
            changes |= {"details": self._details_of(int(rows[0])), "state_details": ()}
        elif self.state_details:
            changes["state_details"] = tuple(self.state_details[row] for row in rows)
        return replace(self, turbulence=flow, **changes)

    def _details_of(self, index: int) -> dict[str, Any]:
        return {**self.details, **(self.state_details[index] if self.state_details else {})}


def _span(values: FloatArray) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
