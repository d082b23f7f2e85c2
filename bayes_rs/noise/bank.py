"""Noise at several states of the flow, and what records get from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan, yaw_matrix
from bayes_rs.noise.file import noise_dataset, save_dataset
from bayes_rs.noise.flow_states import FlowStates
from bayes_rs.noise.noise_geometry import check_same_scan, geometry_difference
from bayes_rs.noise.record_noise import RecordNoise, SonicNoise
from bayes_rs.turbulence.interpolation import StateNet
from bayes_rs.turbulence.mann import MannTurbulence

if TYPE_CHECKING:  # a model gives records its noise as a bank of one, and so stands above this module
    from bayes_rs.noise.model import NoiseModel


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
    states : FlowStates
        The states: wind speed, direction, L and Γ of the models.

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
    states: FlowStates = field(init=False, repr=False)

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
        states = FlowStates(
            wind_speed=np.array([model.wind_speed for model in self.models]),
            yaw=np.array([model.yaw for model in self.models]),
            length_scale=np.array([model.turbulence.length_scale for model in self.models]),
            gamma=np.array([model.turbulence.gamma for model in self.models]),
        )
        object.__setattr__(self, "states", states)
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
    def net(self) -> StateNet | None:
        """The net of (ln U, ψ, ln L, Γ) that the states form, if they form one."""
        return self.states.net

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
        return self.states.length_scale

    @property
    def gamma(self) -> FloatArray:
        """Anisotropy Γ of each state, shape (n_state,)."""
        return self.states.gamma

    @property
    def interpolation_error(self) -> float | None:
        """Largest error of K between the states, ‖δK‖/‖K‖ (Frobenius); None where it was not measured."""
        stated = self.models[0].details.get("interpolation_error")
        return None if self.net is None or stated is None else float(stated)

    @property
    def wind_speed(self) -> FloatArray:
        """Mean wind speed of each state, shape (n_state,), m/s."""
        return self.states.wind_speed

    @property
    def yaw(self) -> FloatArray:
        """Wind direction of each state, shape (n_state,), rad."""
        return self.states.yaw

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
        self.states.check_net()
        flow = replace(self.turbulence, length_scale=length_scale, gamma=gamma)
        plane = sorted({(model.wind_speed, model.yaw): model for model in self.models}.items())
        speed, yaw = [speed for (speed, _), _ in plane], [yaw for (_, yaw), _ in plane]
        noise = self.for_records(speed, yaw, length_scale=length_scale, gamma=gamma)
        sonic = None
        if self.has_sonic:
            sonic = self.sonic_for_records(speed, yaw, length_scale=length_scale, gamma=gamma)
        return NoiseBank(
            tuple(
                replace(
                    model,
                    bias=noise.bias[i],
                    gain=noise.gain[i],
                    covariance=noise.covariance[i],
                    standard_error=None,
                    turbulence=flow,
                    sonic_covariance=None if sonic is None else sonic.covariance[i],
                    sonic_beam_covariance=None if sonic is None else sonic.beam_covariance[i],
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
        points = self.states.points(wind_speed, yaw, length_scale, gamma)
        place = self.states.place(points)
        different, negative_part, state = place.covariances(np.stack([model.covariance for model in self.models]))
        one = len(self.models) == 1
        probe = place.values(self.probe_change())
        direction = np.asarray(self.scan_geometry["direction"], dtype=np.float64)
        return RecordNoise(
            bias=place.values(np.stack([model.bias for model in self.models])),
            gain=design_matrix(direction @ yaw_matrix(points[:, 1])) + probe,
            covariance=np.broadcast_to(different[0], (len(state), *different[0].shape)) if one else different[state],
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
            The records' own directions, within half a turn of the bank's middle, rad.
        outside : ndarray of bool, shape (n_record,)
            Whether a record is outside the bank, and weighted as at its edge.

        Raises
        ------
        InputError
            As for `for_records`, and if the states form no net.
        """
        self.states.check_net()
        points = self.states.points(wind_speed, yaw, length_scale, gamma)
        place = self.states.place(points)
        return np.asarray(place.weights), points[:, 1], place.outside

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
        place = self.states.place(self.states.points(wind_speed, yaw, length_scale, gamma))
        joint = np.stack([model.joint_covariance for model in self.models])
        different, negative_part, state = place.covariances(joint)
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
            Whether a record is outside the bank.
        """
        place = self.states.place(self.states.points(wind_speed, yaw, self.length_scale[0], self.gamma[0]))
        return place.wind_speed, place.used[:, 1], place.outside

    def probe_change(self) -> FloatArray:
        """Return what the probe volume adds to the design matrix, shape (n_state, n_beam, 6); zero for points."""
        direction = np.asarray(self.scan_geometry["direction"], dtype=np.float64)
        return np.stack([model.gain - design_matrix(direction @ yaw_matrix(model.yaw)) for model in self.models])

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


def _flow(turbulence: MannTurbulence) -> tuple[float, float, float]:
    return turbulence.dissipation, turbulence.length_scale, turbulence.gamma
