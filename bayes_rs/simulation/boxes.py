"""Boxes of Mann turbulence from hipersim: the grid that a scene needs, the box, and what the box holds on average."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_positive
from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.stress import STRESSES, unpack_stress
from bayes_rs.turbulence.mann import MannTurbulence

MAX_POINTS = 25_000_000
"""Largest number of grid points: hipersim needs about 80 bytes for each, so this is 2 GiB."""

_FINEST = (12.0, 6.0)
"""Grid points per length scale, along the wind and across it."""

_WAVES_AT_ONCE = 100_000
"""How many waves are worked on at a time: few enough to stay in the processor's cache."""

_INDICES = [("uvw".index(stress[0]), "uvw".index(stress[1])) for stress in STRESSES]

_WIDTH = 12.0
"""Width and height of a box in length scales: at 6 the covariance of u is 9 % too large, at 12 it is 6 %."""


@dataclass(frozen=True)
class BoxGrid:
    """A regular grid, periodic in all three directions.

    Parameters
    ----------
    shape : tuple of int
        Number of points along x, y and z, all even.
    spacing : tuple of float
        Distance between points along x, y and z, m.

    Raises
    ------
    InputError
        If a number of points is odd or below 4, or a spacing is not positive.

    Examples
    --------
    >>> BoxGrid((2048, 32, 32), (4.0, 8.0, 8.0)).size
    (8192.0, 256.0, 256.0)
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Check the numbers."""
        for count in self.shape:
            if count < 4 or count % 2:
                raise InputError(f"Invalid shape {self.shape} of a box: every number must be even and at least 4.")
        for step in self.spacing:
            check_positive(step, what="spacing", unit="m", where="the grid of a box")

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and height of the box, m: the periods of the field."""
        along, across, upward = (count * step for count, step in zip(self.shape, self.spacing, strict=True))
        return along, across, upward

    @property
    def n_point(self) -> int:
        """Number of points."""
        return int(np.prod(self.shape))

    @cached_property
    def wave_number(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Wave numbers k₁ from 0, k₂ and k₃ from −π/Δ, all up to π/Δ with it, rad/m: n_x/2 + 1, n_y + 1 and n_z + 1."""
        along, across, upward = (
            np.asarray(2.0 * np.pi / size * np.arange(-(count // 2), count // 2 + 1))
            for count, size in zip(self.shape, self.size, strict=True)
        )
        return along[self.shape[0] // 2 :], across, upward

    def parts(self) -> Iterator[slice]:
        """Cut the wave numbers k₁ into parts that are worked on one at a time."""
        n_x, n_y, n_z = self.shape
        step = max(_WAVES_AT_ONCE // (n_y * n_z), 1)
        return (slice(first, min(first + step, n_x // 2 + 1)) for first in range(0, n_x // 2 + 1, step))

    def transfer(self, part: slice, line_of_sight: FloatArray, probe: Probe, focus_distance: float) -> FloatArray:
        """Return what a probe does to the waves of a box.

        Parameters
        ----------
        part : slice
            Which wave numbers k₁.
        line_of_sight : ndarray, shape (3,)
            Unit vector n.
        probe : Probe
            The probe volume.
        focus_distance : float
            Focus distance, m.

        Returns
        -------
        transfer : ndarray, shape (n_k1, n_y + 1, n_z + 1)
            H(k·n) at the wave numbers of `wave_number`; for the shortest wave along x the mean of H at k₁ and −k₁.
        """
        k_1, k_2, k_3 = self.wave_number
        across = line_of_sight[1] * k_2[:, None] + line_of_sight[2] * k_3
        along = line_of_sight[0] * k_1[part, None, None]
        transfer = probe.transfer(along + across, focus_distance)
        if part.stop == len(k_1):
            transfer[-1] = 0.5 * (transfer[-1] + probe.transfer(across - along[-1], focus_distance))
        return transfer


def choose_grid(
    turbulence: MannTurbulence, *, record_length: float, extent: float = 0.0, max_points: int = MAX_POINTS
) -> BoxGrid:
    """Choose the grid of a box from the turbulence, the records and the size of the scan.

    Parameters
    ----------
    turbulence : MannTurbulence
        Its length scale L sets the width and the finest step.
    record_length : float
        Longest stretch of air that a record sees, U T, m.
    extent : float
        Largest distance between beams across the wind, m.
    max_points : int
        Limit to the number of grid points.

    Returns
    -------
    grid : BoxGrid
        Length at least 3 records and 24 L, width and height at least 12 L and twice the extent, so that the field's
        period is not mistaken for correlation; steps L/12 along and L/6 across the wind, finer for records so short
        that they see only small eddies. A grid over the limit is made shorter first, down to 1.2 records, then
        coarser, up to four times.

    Raises
    ------
    InputError
        If no such grid is within the limit.

    Examples
    --------
    >>> choose_grid(MannTurbulence(0.05, 61.0, 3.2), record_length=6000.0, extent=51.0).shape
    (3600, 72, 72)
    """
    scale = turbulence.length_scale
    check_positive(record_length, what="record_length", unit="m")
    along = min(scale / _FINEST[0], record_length / 64.0)
    across = min(scale / _FINEST[1], record_length / 32.0)
    width = max(_WIDTH * scale, 2.0 * extent)
    for coarser in (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0):
        for records in (3.0, 2.0, 1.2) if coarser == 1.0 else (1.2,):
            length = max(records * record_length, 24.0 * scale)
            n_along, n_across = _even(length / (coarser * along)), _even(width / (coarser * across))
            if n_along * n_across**2 <= max_points:
                return BoxGrid((n_along, n_across, n_across), (coarser * along, coarser * across, coarser * across))
    raise InputError(
        f"A box for records of {record_length:g} m, a scan {extent:g} m wide and eddies of {scale:g} m would need more "
        f"than {max_points} grid points: use method='theory', a shorter duration or a smaller scan."
    )


def _even(count: float) -> int:
    return 2 * int(scipy.fft.next_fast_len(max(int(np.ceil(0.5 * count - 1e-9)), 4), real=True))


@dataclass(frozen=True, eq=False)
class Box:
    """A box of turbulence.

    Parameters
    ----------
    velocity : ndarray, shape (3, n_x, n_y, n_z)
        Fluctuations u, v, w on the grid, m/s: x along the mean wind, y to the left, z up.
    grid : BoxGrid
        The grid.
    """

    velocity: NDArray[np.floating[Any]]
    grid: BoxGrid

    @cached_property
    def amplitude(self) -> NDArray[np.complexfloating[Any, Any]]:
        """Fourier amplitudes c(k) in u(x) = Σ_k c(k) exp(i k·x), shape (3, n_x/2 + 1, n_y, n_z), m/s; c(−k) = c(k)*."""
        n_x, n_y, n_z = self.grid.shape
        kind = np.result_type(self.velocity.dtype, np.complex64)
        amplitude = np.empty((3, n_x // 2 + 1, n_y, n_z), dtype=kind)
        for component in range(3):
            amplitude[component] = scipy.fft.rfftn(self.velocity[component], axes=(2, 1, 0), norm="forward")
        return amplitude


class BoxMaker:
    """Makes boxes of one turbulence on one grid; the spectral tensor is computed once for all of them.

    Parameters
    ----------
    turbulence : MannTurbulence
        The turbulence.
    grid : BoxGrid
        The grid.

    Raises
    ------
    MissingExtraError
        If hipersim is not installed.

    Notes
    -----
    The velocity is a sum of waves with independent Gaussian amplitudes, u_i(x) = Σ_k C_ij(k) n_j(k) exp(i k·x), where
    C C* is the spectral tensor of Mann (1998) integrated over the cell of each wave number. It is made by hipersim with
    its fast compensation of the scales that the grid leaves out (HighFreqComp = 1) and without doubling, so that the
    field is exactly periodic and band-limited. hipersim is run on one core, because its boxes depend on the number of
    cores.

    References
    ----------
    Mann (1998), Probabilistic Engineering Mechanics 13, 269–282, doi:10.1016/S0266-8920(97)00036-2.
    hipersim, DTU Wind and Energy Systems, https://gitlab.windenergy.dtu.dk/HiperSim/hipersim.

    Examples
    --------
    >>> maker = BoxMaker(MannTurbulence(0.05, 61.0, 3.2), BoxGrid((64, 8, 8), (20.0, 40.0, 40.0)))
    >>> maker.make(seed=1).velocity.shape
    (3, 64, 8, 8)
    >>> bool(maker.tensor[0, 2] < 0.0)  # uw
    True
    """

    def __init__(self, turbulence: MannTurbulence, grid: BoxGrid) -> None:
        tensor = _hipersim().MannSpectralTensor
        self.turbulence = turbulence
        self.grid = grid
        self._tensor = tensor(
            alphaepsilon=turbulence.dissipation,
            L=turbulence.length_scale,
            Gamma=turbulence.gamma,
            Nxyz=grid.shape,
            dxyz=grid.spacing,
            HighFreqComp=1,
            double_xyz=(False, False, False),
            n_cpu=1,
        )

    def make(self, seed: int) -> Box:
        """Make the box of one seed; the same seed gives the same box.

        Parameters
        ----------
        seed : int
            Seed of the amplitudes.

        Returns
        -------
        box : Box
            The box.
        """
        return Box(np.asarray(self._tensor.generate(seed=seed).uvw), self.grid)

    @cached_property
    def wave_number(self) -> FloatArray:
        """Wave numbers k₁ ≥ 0 of the box along x, shape (n_x/2 + 1,), rad/m."""
        count, step = self.grid.shape[0], self.grid.spacing[0]
        return np.asarray(2.0 * np.pi * np.fft.rfftfreq(count, step))

    @cached_property
    def spectrum(self) -> FloatArray:
        """Expected stresses in each wave number k₁ ≥ 0, shape (n_x/2 + 1, 3, 3), m² s⁻²: they sum to the box's tensor.

        Notes
        -----
        F_ij(k₁) = Σ_{k₂,k₃} [C C*]_ij, doubled for −k₁; an average over all boxes that could be drawn, without
        Monte-Carlo error. The eight waves that are their own mirror image carry half, as hipersim takes the real part
        of their amplitudes.
        """
        parts = [self._power(part).sum(axis=(2, 3)) for part in self.grid.parts()]
        return unpack_stress(np.concatenate(parts, axis=1).T)

    def radial_spectrum(self, line_of_sight: ArrayLike, probe: Probe, focus_distance: ArrayLike) -> FloatArray:
        """Return the expected variance of radial velocities in each wave number k₁ ≥ 0.

        Parameters
        ----------
        line_of_sight : array_like, shape (n_beam, 3)
            Unit vectors.
        probe : Probe
            The probe volume.
        focus_distance : array_like, shape (n_beam,)
            Focus distances, m.

        Returns
        -------
        spectrum : ndarray, shape (n_beam, n_x/2 + 1)
            Σ_{k₂,k₃} n·[C C*] n H(k·n)², doubled for −k₁, m² s⁻².

        Notes
        -----
        As `spectrum`, exact for all boxes that could be drawn. A wave of two grid steps is a cosine about the grid's
        points (`interpolation_weights`); it counts with its variance there, where a probe multiplies it by the mean of
        H for both its directions.
        """
        direction = check_array(line_of_sight, (None, 3), what="line_of_sight")
        distance = check_array(focus_distance, (len(direction),), what="focus_distance")
        if isinstance(probe, PointProbe):
            return np.asarray(np.einsum("bi,kij,bj->bk", direction, self.spectrum, direction))
        _, n_y, n_z = self.grid.shape
        rows, spectrum = design_matrix(direction), np.empty((len(direction), len(self.wave_number)))
        for part in self.grid.parts():
            power = self._power(part)
            for beam, row in enumerate(rows):
                transfer = self.grid.transfer(part, direction[beam], probe, float(distance[beam]))
                transfer[:, 0] = 0.5 * (transfer[:, 0] + transfer[:, n_y])
                transfer[:, :, 0] = 0.5 * (transfer[:, :, 0] + transfer[:, :, n_z])
                kept = np.fft.ifftshift(transfer[:, :n_y, :n_z], axes=(1, 2)) ** 2
                spectrum[beam, part] = np.einsum("kyz,kyz->k", np.tensordot(row, power, axes=1), kept)
        return spectrum

    def _power(self, part: slice) -> FloatArray:
        """Return the six expected stresses of waves, with those of −k, shape (6, n_k1, n_y, n_z), m² s⁻²."""
        n_x, n_y, n_z = self.grid.shape
        root = self._tensor.spectral_vars[:, :, part].astype(np.float64)  # (3, 3, n_k1, n_y, n_z)
        power = self.turbulence.dissipation * np.stack([np.sum(root[i] * root[j], axis=0) for i, j in _INDICES])
        for plane, along in enumerate(range(part.start, part.stop)):
            if along in {0, n_x // 2}:
                power[:, plane, :: n_y // 2, :: n_z // 2] *= 0.5
            else:
                power[:, plane] *= 2.0
        return np.asarray(power)

    @property
    def tensor(self) -> FloatArray:
        """The box's own truth, shape (3, 3), m² s⁻²: expected products of the fluctuations about zero.

        Notes
        -----
        No mean is removed, and it is not the average of a single box: a box of a few hundred metres has its own mean.
        """
        return np.asarray(self.spectrum.sum(axis=0))


def generator_name() -> str:
    """Return the generator's name and version, which a cached noise model depends on.

    Raises
    ------
    MissingExtraError
        If hipersim is not installed.
    """
    _hipersim()
    return f"hipersim {version('hipersim')}"


def hipersim_for(instead: str) -> Any:
    """Return the package hipersim; `instead` is what the error says to do without it.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import hipersim  # noqa: PLC0415 - an optional package, half a second to import
    except ImportError as error:
        raise MissingExtraError(
            "Boxes of Mann turbulence need the package hipersim, which is not installed: "
            f'run pip install "bayes_rs[boxes]"{instead}.'
        ) from error
    return hipersim


def _hipersim() -> Any:
    return hipersim_for(', or use method="theory"')
