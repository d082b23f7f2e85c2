"""Scans: the beams of an instrument, their timing, and where they point in the mean-wind frame."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, as_whole_numbers, check_array, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan_card import scan_card, scan_rows
from bayes_rs.quantities import LIMITS


def tilt_matrix(tilt: ArrayLike) -> FloatArray:
    """Return T_tilt, which acts on row vectors as n · T_tilt; a positive tilt raises the beam that points upwind.

    Parameters
    ----------
    tilt : array_like, shape (...)
        Tilt angle α, rad.

    Returns
    -------
    rotation : ndarray, shape (..., 3, 3)
        [[cos α, 0, −sin α], [0, 1, 0], [sin α, 0, cos α]].
    """
    angle = np.asarray(tilt, dtype=np.float64)
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., 0, 0] = matrix[..., 2, 2] = np.cos(angle)
    matrix[..., 0, 2] = -np.sin(angle)
    matrix[..., 2, 0] = np.sin(angle)
    matrix[..., 1, 1] = 1.0
    return matrix


def yaw_matrix(yaw: ArrayLike) -> FloatArray:
    """Return T_yaw, which acts on row vectors as n · T_yaw.

    Parameters
    ----------
    yaw : array_like, shape (...)
        Wind direction relative to the lidar axis ψ, rad.

    Returns
    -------
    rotation : ndarray, shape (..., 3, 3)
        [[cos ψ, sin ψ, 0], [−sin ψ, cos ψ, 0], [0, 0, 1]].
    """
    angle = np.asarray(yaw, dtype=np.float64)
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., 0, 0] = matrix[..., 1, 1] = np.cos(angle)
    matrix[..., 0, 1] = np.sin(angle)
    matrix[..., 1, 0] = -np.sin(angle)
    matrix[..., 2, 2] = 1.0
    return matrix


@dataclass(frozen=True, repr=False)
class Scan:
    """All beams of an instrument, their timing and mounting.

    Parameters
    ----------
    name : str
        Name of the scan.
    beam_direction : array_like, shape (n_beam, 3)
        Unit vectors in the instrument's own frame, before tilt and yaw. A nacelle lidar's axis is −x.
    focus_distance : array_like, shape (n_beam,)
        Distance from the lidar to the measured point, m.
    beam_time : array_like, shape (n_beam,)
        When each beam is sampled within one scan, s.
    scan_duration : float
        Time between two visits of the same beam, s.
    beam : array_like of int, shape (n_beam,), optional
        Number of each beam; 0, 1, 2 … if not given.
    tilt, yaw : float
        Mounting angles, rad: the tilt from −π/2 to π/2, the yaw from −2π to 2π (`load_scan` takes degrees).
    title, source : str
        What it is, and where the numbers come from.
    file_format : mapping
        How this instrument's files name and sign things; see `bayes_rs.readers.FileOptions`.
    probe : Probe
        The probe volume of its beams; by default they see points.

    Raises
    ------
    InputError
        If a vector is not of unit length, a focus distance is not positive, an angle is none in radians, or the shapes
        disagree.

    Examples
    --------
    >>> scan = Scan("up", [[0.0, 0.0, 1.0]], focus_distance=[100.0], beam_time=[0.0], scan_duration=1.0)
    >>> scan.line_of_sight
    array([[0., 0., 1.]])
    """

    name: str
    beam_direction: FloatArray
    focus_distance: FloatArray
    beam_time: FloatArray
    scan_duration: float
    beam: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    tilt: float = 0.0
    yaw: float = 0.0
    title: str = ""
    source: str = ""
    file_format: Mapping[str, Any] = field(default_factory=dict)
    probe: Probe = field(default_factory=PointProbe)

    if TYPE_CHECKING:  # what it holds are arrays, what it takes need not be

        def __init__(
            self,
            name: str,
            beam_direction: ArrayLike,
            focus_distance: ArrayLike,
            beam_time: ArrayLike,
            scan_duration: float,
            beam: ArrayLike = ...,
            tilt: float = 0.0,
            yaw: float = 0.0,
            title: str = "",
            source: str = "",
            file_format: Mapping[str, Any] = ...,
            probe: Probe = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check and freeze the arrays."""
        direction = check_array(self.beam_direction, (None, 3), what=f"beam_direction of scan {self.name!r}")
        n_beam = len(direction)
        if n_beam == 0:
            raise InputError(f"Scan {self.name!r} has no beam: it needs at least one.")
        length = np.linalg.norm(direction, axis=1)
        for index in np.flatnonzero(np.abs(length - 1.0) > 1e-9).tolist():
            raise InputError(
                f"Invalid direction {direction[index].tolist()} of beam {index} in scan {self.name!r}: "
                f"its length is {length[index]:g} and must be 1; give a unit vector or angles."
            )
        distance = check_array(self.focus_distance, (n_beam,), what=f"focus_distance of scan {self.name!r}")
        for index in range(n_beam):
            check_positive(
                distance[index], what="focus_distance", unit="m", where=f"beam {index} of scan {self.name!r}"
            )
        time = check_array(self.beam_time, (n_beam,), what=f"beam_time of scan {self.name!r}")
        duration = check_positive(self.scan_duration, what="scan_duration", unit="s", where=f"scan {self.name!r}")
        if np.any(time < 0.0) or np.any(time >= duration):
            raise InputError(f"Invalid beam_time in scan {self.name!r}: every time must be in [0, {duration:g}) s.")
        given = as_whole_numbers(self.beam, what=f"beam numbers of scan {self.name!r}")
        beam = given if np.size(given) else np.arange(n_beam, dtype=np.int64)
        if beam.shape != (n_beam,) or len(np.unique(beam)) != n_beam:
            raise InputError(
                f"Invalid beam numbers {beam.tolist()} in scan {self.name!r}: one for each beam, all different."
            )
        for key in ("tilt", "yaw"):
            angle = check_finite(getattr(self, key), what=key, unit="rad", where=f"scan {self.name!r}")
            object.__setattr__(self, key, angle)
        if not isinstance(self.probe, Probe):
            raise InputError(
                f"Invalid probe {self.probe!r} of scan {self.name!r}: it must be a Probe, as make_probe returns it."
            )
        for key, array in (
            ("beam_direction", direction),
            ("focus_distance", distance),
            ("beam_time", time),
            ("beam", beam),
        ):
            frozen = array.copy()
            frozen.flags.writeable = False
            object.__setattr__(self, key, frozen)
        object.__setattr__(self, "scan_duration", duration)

    def __repr__(self) -> str:
        """Say in one line what it is."""
        said = ", ".join(f"{name} {value}" for name, value in self._rows().items())
        return f"<{type(self).__name__} {self.name!r}: {said}>"

    def _repr_html_(self) -> str:
        """Say it in a notebook, with a picture of the beams."""
        title = f"Scan {self.name}" + (f": {self.title}" if self.title else "")
        return scan_card(title, self._rows(), self.level_direction, self.beam.tolist())

    def _rows(self) -> dict[str, str]:
        rows = scan_rows(self.level_direction, self.focus_distance, self.scan_duration, self.probe)
        angles = {name: f"{np.rad2deg(getattr(self, name)):.4g}°" for name in ("tilt", "yaw") if getattr(self, name)}
        return {**rows, **angles}

    @property
    def n_beam(self) -> int:
        """Number of beams."""
        return len(self.beam_direction)

    @property
    def line_of_sight(self) -> FloatArray:
        """Unit vectors n of the beams in the mean-wind frame, shape (n_beam, 3), for the mounting's own yaw."""
        return self.beam_direction @ tilt_matrix(self.tilt) @ yaw_matrix(self.yaw)

    @property
    def level_direction(self) -> FloatArray:
        """Unit vectors in the levelled lidar frame (tilted, not yet yawed), shape (n_beam, 3)."""
        return self.beam_direction @ tilt_matrix(self.tilt)

    def at_yaw(self, yaw: ArrayLike) -> FloatArray:
        """Return the unit vectors of the beams for other wind directions.

        Parameters
        ----------
        yaw : array_like, shape (...)
            Wind direction relative to the lidar axis ψ, rad; replaces the mounting's own yaw.

        Returns
        -------
        line_of_sight : ndarray, shape (..., n_beam, 3)
            Unit vectors in the mean-wind frame.

        Raises
        ------
        InputError
            If an angle is beyond 4π, as degrees are; records may have turned as far.
        """
        most = LIMITS["wind_yaw"].most
        beyond = np.abs(yaw) > most
        if np.any(beyond):
            worst = np.asarray(yaw, dtype=np.float64)[beyond].flat[0]
            raise InputError(
                f"Invalid yaw {worst:g} rad: it must be from {-most:g} to {most:g} rad; it is in radians: "
                "np.deg2rad makes them of degrees."
            )
        return np.asarray(self.level_direction @ yaw_matrix(yaw), dtype=np.float64)

    def with_yaw(self, yaw: float) -> Scan:
        """Return this scan in wind from another direction.

        Parameters
        ----------
        yaw : float
            Wind direction relative to the lidar axis ψ, rad (`load_scan` and files take `yaw_deg`, degrees).

        Returns
        -------
        scan : Scan
            The same scan, turned.

        Raises
        ------
        InputError
            If it is not finite, or beyond a turn, as degrees are.
        """
        return replace(self, yaw=yaw)

    def select(self, beams: ArrayLike) -> Scan:
        """Return the scan with only the beams whose numbers are given, in that order.

        Parameters
        ----------
        beams : array_like of int
            Beam numbers.

        Returns
        -------
        scan : Scan
            The smaller scan; its timing is unchanged.

        Raises
        ------
        InputError
            If a number is not one of this scan's beams.
        """
        wanted = np.atleast_1d(as_whole_numbers(beams, what="beams"))
        if len(wanted) == 0:
            raise InputError(f"No beam of scan {self.name!r} is selected: name at least one of {self.beam.tolist()}.")
        for number in wanted.tolist():
            if number not in self.beam:
                raise InputError(f"Unknown beam {number} in scan {self.name!r}: its beams are {self.beam.tolist()}.")
        if np.array_equal(wanted, self.beam):
            return self
        index = np.array([int(np.flatnonzero(self.beam == number)[0]) for number in wanted])
        return replace(
            self,
            beam_direction=self.beam_direction[index],
            focus_distance=self.focus_distance[index],
            beam_time=self.beam_time[index],
            beam=self.beam[index],
        )

    @property
    def probe_length(self) -> FloatArray:
        """Length ℓ of each beam's probe volume, shape (n_beam,), m: zero for points; see `bayes_rs.geometry.probe`."""
        return self.probe.length(self.focus_distance)

    def geometry(self) -> dict[str, Any]:
        """Return everything about the scan that a noise model depends on, but yaw: plain numbers, rounded to 1e-9.

        The probe volume is in it only if it is not a point, so that the keys of scans without one stay what they were.
        """
        probe = self.probe.parameters()
        return {
            "beam": self.beam.tolist(),
            "direction": (np.round(self.level_direction, 9) + 0.0).tolist(),
            "focus_distance": (np.round(self.focus_distance, 9) + 0.0).tolist(),
            "beam_time": (np.round(self.beam_time, 9) + 0.0).tolist(),
            "scan_duration": round(self.scan_duration, 9),
            **({"probe": probe} if probe else {}),
        }

    @cached_property
    def key(self) -> str:
        """Fingerprint of the geometry, 16 hexadecimal digits: equal keys mean equal beams and timing."""
        text = json.dumps(self.geometry(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class ScanByKey:
    """A scan that can be looked up: equal to others of the same key and yaw.

    Parameters
    ----------
    key : str
        `Scan.key`.
    yaw : float
        `Scan.yaw`, rad.
    scan : Scan
        The scan.
    """

    key: str
    yaw: float
    scan: Scan = field(compare=False)

    @classmethod
    def of(cls, scan: Scan) -> ScanByKey:
        """Return that of a scan."""
        return cls(scan.key, float(scan.yaw), scan)
