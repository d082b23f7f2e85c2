"""Noise models: bias, gain and relative covariance of the beam variances of a record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_finite, check_positive
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.bank import NoiseBank
from bayes_rs.noise.file import save_dataset
from bayes_rs.noise.noise_geometry import check_geometry, check_same_scan
from bayes_rs.noise.record_noise import RecordNoise, SonicNoise
from bayes_rs.turbulence.mann import MannTurbulence

__all__ = ["NOISE_METHODS", "Noise", "NoiseBank", "NoiseModel", "RecordNoise", "SonicNoise"]

NOISE_METHODS: tuple[str, ...] = ("boxes", "theory", "given")
"""Where a noise model's numbers can come from."""


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

    if TYPE_CHECKING:  # what it holds are arrays, what it takes need not be

        def __init__(
            self,
            bias: ArrayLike,
            gain: ArrayLike,
            covariance: ArrayLike,
            beam: ArrayLike,
            scan_name: str,
            scan_geometry: Mapping[str, Any],
            wind_speed: float,
            yaw: float,
            duration: float,
            turbulence: MannTurbulence,
            method: str,
            n_realizations: float = ...,
            standard_error: ArrayLike | None = None,
            details: Mapping[str, Any] = ...,
            sonic_covariance: ArrayLike | None = None,
            sonic_beam_covariance: ArrayLike | None = None,
        ) -> None: ...

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
    def models(self) -> tuple[NoiseModel, ...]:
        """The model itself, as the only one: what a `NoiseBank` holds several of."""
        return (self,)

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

    def for_records(
        self,
        wind_speed: ArrayLike,
        yaw: ArrayLike,
        *,
        length_scale: ArrayLike | None = None,
        gamma: ArrayLike | None = None,
    ) -> RecordNoise:
        """Return the noise of records: the same for all, because this model knows one state only.

        Parameters
        ----------
        wind_speed : array_like, shape (n_record,)
            Mean wind speed of each record, m/s.
        yaw : array_like, shape (n_record,)
            Wind direction relative to the lidar axis, rad.
        length_scale, gamma : array_like, shape (n_record,), optional
            As for `NoiseBank.for_records`; of no influence here.

        Returns
        -------
        noise : RecordNoise
            Arrays along the records, as read-only views.
        """
        return NoiseBank((self,)).for_records(wind_speed, yaw, length_scale=length_scale, gamma=gamma)

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

    def sonic_for_records(
        self,
        wind_speed: ArrayLike,
        yaw: ArrayLike,
        *,
        length_scale: ArrayLike | None = None,
        gamma: ArrayLike | None = None,
    ) -> SonicNoise:
        """Return the moments with a sonic's stresses for records; as `NoiseBank.sonic_for_records`."""
        return NoiseBank((self,)).sonic_for_records(wind_speed, yaw, length_scale=length_scale, gamma=gamma)

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


Noise: TypeAlias = NoiseModel | NoiseBank
"""What `calibrate` makes, `load_noise` reads and `fit` takes."""


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
