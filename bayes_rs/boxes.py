"""Boxes of Mann turbulence from hipersim: the grid that a scene needs, the box, and what the box holds on average."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.mann import MannTurbulence

MAX_POINTS = 25_000_000
"""Largest number of grid points: hipersim needs about 80 bytes for each, so this is 2 GiB."""

_FINEST = (12.0, 6.0)
"""Grid points per length scale, along the wind and across it."""

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
    return 2 * int(next_fast_len(max(int(np.ceil(0.5 * count - 1e-9)), 4), real=True))


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
        root = self._tensor.spectral_vars  # (3, 3, n_x/2 + 1, n_y, n_z)
        n_x, n_y, n_z = self.grid.shape
        spectrum = np.einsum("ijkyz,ljkyz->kil", root, root, dtype=np.float64, optimize=False)
        for along in (0, n_x // 2):
            for across in (0, n_y // 2):
                for upward in (0, n_z // 2):
                    own = root[:, :, along, across, upward].astype(np.float64)
                    spectrum[along] -= 0.5 * own @ own.T
        spectrum[1:-1] *= 2.0
        return np.asarray(self.turbulence.dissipation * spectrum)

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


def _hipersim() -> Any:
    try:
        import hipersim  # noqa: PLC0415 - an optional package, half a second to import
    except ImportError as error:
        raise MissingExtraError(
            "Boxes of Mann turbulence need the package hipersim, which is not installed: "
            'run pip install "bayes_rs[boxes]", or use method="theory".'
        ) from error
    return hipersim
