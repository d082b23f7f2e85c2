"""What two points see of Mann turbulence: covariances and cross-spectra of velocity, for any separation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, as_numbers, check_array, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES, unpack_stress
from bayes_rs.processor import one_thread
from bayes_rs.turbulence.isotropic import isotropic_covariance, isotropic_cross_spectra, isotropic_radial
from bayes_rs.turbulence.log_transform import ComplexArray, bessel_mellin, cosine_mellin, log_convolution, sine_mellin
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence
from bayes_rs.turbulence.one_point import isotropic_tensor
from bayes_rs.turbulence.spectral_tensor import lifetime_shape, scaled_tensor
from bayes_rs.turbulence.stencil import STENCIL, interpolate_rows, stencil, stretched

INDEX_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""The two indices of each of the six stresses."""
_ODD_IN_K2 = (STRESSES.index("uv"), STRESSES.index("vw"))
_CORE = 0.01  # L: separations below it are interpolated as evenly as at it
_BLOCK = 60_000  # covariances at a time: their working arrays stay in the processor's cache
_WORTH_A_TABLE = 100  # places of one pair for which the components are weighted in the whole table
_TABLES = 8  # such tables at a time
_ON_GRID = 1e-9  # steps: separations that near those of a table are those of the table
_LEAST_REACH = (256.0, 4.0)  # L, along and across: a table reaches at least so far, and then to powers of four
# exponents that make both transforms decay at both ends; results do not depend on them
_BIAS_ACROSS, _BIAS_ALONG = 0.3, 0.5


class Resolution(NamedTuple):
    """Sizes of the quadrature for one tolerance; lengths in L, wave numbers as log(kL)."""

    step: float
    n_angle: int
    n_harmonic: int
    log_k1: tuple[float, float]
    log_kappa: tuple[float, float]
    table_step: float
    across_step: float
    n_direction: int
    n_across: int  # points that values are interpolated from in distance, and in direction
    single: bool  # single precision: its rounding is far below the error


_CHECKED_GAMMA = 6.0  # measured errors at 10 and 15 stay below the promise that grows with its square
# Errors of velocity covariances relative to uu, measured at random separations against a step of 0.1, 120 angles and 48
# harmonics (repeated in tests/test_two_point.py): below the key of this table for gamma up to 6.
_RESOLUTIONS: dict[float, Resolution] = {
    5e-3: Resolution(0.25, 64, 24, (-15.0, 7.0), (-12.0, 8.0), 0.40, 0.30, 32, 4, True),
    1e-3: Resolution(0.25, 64, 24, (-15.0, 7.0), (-12.0, 8.0), 0.25, 0.25, 40, 6, False),
    1e-4: Resolution(0.20, 64, 24, (-16.0, 8.0), (-14.0, 9.0), 0.15, 0.15, 64, 6, False),
    2e-5: Resolution(0.14, 72, 28, (-17.0, 9.0), (-15.0, 9.5), 0.12, 0.12, 80, 6, False),
}


def resolution_for(tolerance: float, gamma: float) -> tuple[float, Resolution]:
    """Return the coarsest resolution that keeps `tolerance`, and the error that it promises.

    Parameters
    ----------
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.
    gamma : float
        Anisotropy parameter Γ; above 6 the promised errors grow with its square.

    Returns
    -------
    promised : float
        The error that it promises, at most `tolerance`.
    resolution : Resolution
        Sizes of the quadrature and of the table.

    Raises
    ------
    InputError
        If `tolerance` is smaller than the finest resolution keeps.
    """
    check_positive(tolerance, what="tolerance", unit="")
    growth = max(gamma / _CHECKED_GAMMA, 1.0) ** 2
    for error in sorted(_RESOLUTIONS, reverse=True):
        if error * growth <= tolerance:
            return error * growth, _RESOLUTIONS[error]
    raise InputError(
        f"Invalid tolerance {tolerance!r}: the smallest error that the theory keeps at gamma = {gamma:g} is "
        f"{min(_RESOLUTIONS) * growth:.3g} of uu."
    )


def velocity_covariance(
    separation: ArrayLike, turbulence: MannTurbulence | str | Path, *, tolerance: float = 1e-4
) -> FloatArray:
    """Return the covariance tensor of the velocities at two points.

    Parameters
    ----------
    separation : array_like, shape (..., 3)
        From the first point to the second, along x, y, z, m. Time lags enter as x separations, −Uτ (frozen turbulence).
    turbulence : MannTurbulence, str or Path
        The turbulence, its name or its file.
    tolerance : float
        Largest error, relative to the variance of u.

    Returns
    -------
    covariance : ndarray, shape (..., 3, 3)
        C_ij(r) = ⟨u_i(x) u_j(x + r)⟩, m² s⁻²; symmetric in i, j and even in r.

    Raises
    ------
    InputError
        If the separation is not finite or not of that shape, or the tolerance is below what the theory keeps.

    Notes
    -----
    C_ij(r) = ∫Φ_ij(k) exp(ik·r) d³k, Mann (1994), Eq. (2.4). The tensor at Γ = 0 transforms in closed form (Bessel
    functions K). What the shear changes is expanded, at each k₁, in harmonics of the angle of (k₂, k₃), once for all
    separations; each harmonic's radial integral is a Hankel transform, and the integral over k₁ a Fourier transform.
    Both are done as convolutions in the logarithms of wave number and distance (Hamilton 2000), so that the cost and
    the error do not grow with the separation. The result is tabulated and interpolated to fifth order.

    References
    ----------
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886.
    Hamilton (2000), Mon. Not. R. Astron. Soc. 312, 257–284, doi:10.1046/j.1365-8711.2000.03071.x.

    Examples
    --------
    >>> velocity_covariance([100.0, 0.0, 0.0], "fu-2022").diagonal().round(3)
    array([0.797, 0.174, 0.063])
    """
    turbulence = as_turbulence(turbulence)
    r = as_numbers(separation, what="separation")
    if r.ndim == 0 or r.shape[-1] != 3:
        raise InputError(f"Invalid separation of shape {r.shape}: the last dimension must hold x, y and z.")
    flat = check_array(r.reshape(-1, 3), (None, 3), what="separation") / turbulence.length_scale
    table = covariance_table(turbulence.gamma, flat, tolerance=tolerance)
    along = table.components(*flat.T)
    isotropic = isotropic_covariance(flat)
    tensor = unpack_stress(along) + isotropic
    return np.asarray(turbulence.velocity_scale**2 * tensor.reshape(*r.shape[:-1], 3, 3))


def radial_covariance(
    first: ArrayLike,
    second: ArrayLike,
    across: ArrayLike,
    along: ArrayLike,
    turbulence: MannTurbulence,
    *,
    tolerance: float = 1e-4,
) -> FloatArray:
    """Return the covariances of the radial velocities of pairs of beams, for many separations along the wind at once.

    Parameters
    ----------
    first, second : array_like, shape (n_pair, 3)
        Unit vectors n_a and n_b of the two beams of each pair, in the mean-wind frame.
    across : array_like, shape (n, 2)
        Separation of the two measured points along y and z, m: n/n_pair places for each pair, those of the first pair
        first (the nodes of two probe volumes; hundreds of them cost less than as many pairs).
    along : array_like, shape (n, n_lag)
        Separations along x, m; a lag τ from the first to the second beam counts as Δx − Uτ.
    turbulence : MannTurbulence, str or Path
        The turbulence, its name or its file.
    tolerance : float
        Largest error, relative to the variance of u.

    Returns
    -------
    covariance : ndarray, shape (n, n_lag)
        n_a · C(r) n_b, m² s⁻².

    Raises
    ------
    InputError
        If shapes disagree, a number is not finite, or the tolerance is below what the theory keeps.

    Notes
    -----
    C_ab(τ) = n_a · [∫Φ(k) exp(ik·r) d³k] n_b; see `velocity_covariance`.

    Examples
    --------
    Two beams along the wind, 40 m apart sideways, at the same instant and 10 s apart at 10 m/s:

    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> seed = load_turbulence("fu-2022")
    >>> radial_covariance([[-1, 0, 0]], [[-1, 0, 0]], [[40.0, 0.0]], [[0.0, -100.0]], seed).round(3)
    array([[0.744, 0.672]])
    """
    across_scaled = check_array(across, (None, 2), what="across") / turbulence.length_scale
    n = len(across_scaled)
    n_a = check_array(first, (None, 3), what="first")
    n_b, n_place = check_array(second, (len(n_a), 3), what="second"), n // max(len(n_a), 1)
    if n_place * len(n_a) != n:
        raise InputError(
            f"Invalid across of shape {across_scaled.shape}: give as many places to each of {len(n_a)} pairs."
        )
    along_scaled = _scaled(check_array(along, (n, None), what="along"), turbulence)
    extent = np.array(
        [[np.max(np.abs(along_scaled), initial=0.0), *np.max(np.abs(across_scaled), axis=0, initial=0.0)]]
    )
    table = covariance_table(turbulence.gamma, extent, tolerance=tolerance)
    weights = np.stack(
        [n_a[:, i] * n_b[:, j] + (n_a[:, j] * n_b[:, i] if i != j else 0.0) for i, j in INDEX_PAIRS], axis=-1
    )
    covariance = np.empty(along_scaled.shape)
    at_once = max(1, _BLOCK // max(n_place * along_scaled.shape[1], 1))
    if n_place >= _WORTH_A_TABLE:
        at_once = min(at_once, _TABLES)
    for start in range(0, len(n_a), at_once):
        beams = slice(start, start + at_once)
        part = slice(start * n_place, min(start + at_once, len(n_a)) * n_place)
        (y, z), x = across_scaled[part].T, along_scaled[part]
        total = table.project(y, z, weights[beams], x)
        total += isotropic_radial(
            *(
                of.astype(total.dtype, copy=False)
                for of in (*(np.repeat(of[beams], n_place, axis=0) for of in (n_a, n_b)), across_scaled[part], x)
            )
        )
        np.multiply(total, turbulence.velocity_scale**2, out=covariance[part], dtype=np.float64)
    return covariance


def cross_spectra(
    wave_number: ArrayLike, separation: ArrayLike, turbulence: MannTurbulence | str | Path, *, tolerance: float = 1e-4
) -> ComplexArray:
    """Return the two-sided cross-spectra of the velocities at two points in the plane across the wind.

    Parameters
    ----------
    wave_number : array_like, shape (n,)
        k₁, rad/m, above zero.
    separation : array_like, shape (2,)
        From the first point to the second, along y and z, m.
    turbulence : MannTurbulence, str or Path
        The turbulence, its name or its file.
    tolerance : float
        Chooses the quadrature; see `velocity_covariance`.

    Returns
    -------
    spectra : ndarray of complex, shape (n, 3, 3)
        χ_ij(k₁; Δy, Δz), m³ s⁻². At −k₁ it is the conjugate.

    Raises
    ------
    InputError
        If an argument is not valid.

    Notes
    -----
    χ_ij(k₁; Δy, Δz) = ∫∫Φ_ij(k) exp(i(k₂Δy + k₃Δz)) dk₂ dk₃, Mann (1994), Eq. (2.8). A separation Δx between the points
    multiplies it by exp(ik₁Δx).

    Examples
    --------
    Without separation it is the one-point spectrum:

    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> seed = load_turbulence("fu-2022")
    >>> cross_spectra([0.01], [0.0, 0.0], seed)[0].real.diagonal().round(1)
    array([12.2,  8.1,  4.2])
    >>> seed.spectra([0.01])[0, :3].round(1)
    array([12.2,  8.1,  4.2])
    """
    turbulence = as_turbulence(turbulence)
    k1 = as_numbers(wave_number, what="wave_number") * turbulence.length_scale
    if k1.ndim != 1 or not np.all((k1 > 0.0) & np.isfinite(k1)):
        raise InputError("Invalid wave_number: k1 must be a list of finite numbers above zero, rad/m.")
    y, z = check_array(separation, (2,), what="separation") / turbulence.length_scale
    _, resolution = resolution_for(tolerance, turbulence.gamma)
    distance, direction = float(np.hypot(y, z)), float(np.arctan2(y, z))
    kappa_step = _grid(resolution.log_kappa, resolution.step)
    total = isotropic_cross_spectra(k1, y, z).astype(np.complex128)
    if turbulence.gamma > 0.0:
        harmonics = _harmonics(k1, np.exp(kappa_step), turbulence.gamma, resolution)
        sums = np.zeros((len(k1), len(STRESSES)), dtype=np.complex128)
        for m, hankel in enumerate(_hankel_weights(np.array([distance]), resolution)):
            for index in range(len(STRESSES)):
                angular = np.sin(m * direction) if index in _ODD_IN_K2 else np.cos(m * direction)
                sums[:, index] += 2.0 * np.pi * 1j**m * angular * (harmonics[index, m] @ hankel[0])
        row, column = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
        sheared = np.empty((len(k1), 3, 3), dtype=np.complex128)
        sheared[:, row, column] = sums
        sheared[:, column, row] = sums
        total += sheared
    return np.asarray(turbulence.dissipation * turbulence.length_scale ** (5.0 / 3.0) * total)


@dataclass(frozen=True)
class CovarianceTable:
    """What the shear changes in the covariances of one Γ, tabulated in units of L and αε^(2/3) L^(2/3).

    It holds for all wind speeds, length scales, dissipation rates, scans and yaw angles.

    Attributes
    ----------
    values : ndarray, shape (n_distance * n_direction * 6, n_along)
        The six components on a grid of lateral distance, direction and separation along the wind: those of one place
        across the wind lie beside each other, as they are asked for.
    promised_error : float
        Largest error of a covariance, relative to the variance of u.
    """

    gamma: float
    values: FloatArray
    shape: tuple[int, int, int]
    table_step: float
    across_step: float
    direction_step: float
    n_across: int
    along_start: int
    promised_error: float

    def project(self, y: FloatArray, z: FloatArray, weights: FloatArray, x: FloatArray) -> FloatArray:
        """Return Σ weights · components at separations (x, y, z).

        Parameters
        ----------
        y, z : ndarray, shape (n,)
            Separations across the wind, in L.
        weights : ndarray, shape (n_pair, 6)
            Weight of each component, as n_a n_b symmetrised for radial velocities, at n/n_pair separations in turn.
        x : ndarray, shape (n, n_lag)
            Separations along the wind, in L.

        Returns
        -------
        covariance : ndarray, shape (n, n_lag)
            In αε^(2/3) L^(2/3).
        """
        signs, columns, shares = self._place(y, z)
        n, n_pair = len(STRESSES), len(weights)
        n_place = len(y) // max(n_pair, 1)
        if n_place >= _WORTH_A_TABLE:
            # the components of each pair are weighted once in the whole table, for both signs of y
            both = np.stack([weights, np.where(_odd_mask(), -weights, weights)], axis=1).reshape(-1, n)
            lines = both.astype(self.values.dtype) @ self.values.reshape(-1, n, self.shape[2])
            own = np.repeat(2 * np.arange(n_pair, dtype=np.int32), n_place) + (y < 0.0)
            columns = np.int32(len(both)) * columns + own[:, np.newaxis].astype(np.int32)
            return self._along(_rows_times(shares, columns, lines.reshape(-1, self.shape[2])), x)
        column = (n * columns[:, :, np.newaxis] + np.arange(n)).astype(np.int32)
        share = shares[:, :, np.newaxis] * (signs * np.repeat(weights, n_place, axis=0))[:, np.newaxis]
        return self._along(_rows_times(share, column, self.values), x)

    def components(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Return the six components at separations (x, y, z), each of shape (n,), in L; shape (n, 6)."""
        signs, columns, shares = self._place(y, z)
        n, n_along = len(STRESSES), self.shape[2]
        at, weight = stencil(_stretch(x) / self.table_step - self.along_start, n_along)
        place = ((n * n_along) * columns[:, :, np.newaxis] + at[:, np.newaxis]).astype(np.int32)
        share = shares[:, :, np.newaxis] * weight[:, np.newaxis]
        one = self.values.reshape(-1, 1)
        return np.concatenate(
            [
                _rows_times(sign[:, np.newaxis, np.newaxis] * share, place + np.int32(index * n_along), one)
                for index, sign in enumerate(signs.T)
            ],
            axis=1,
        )

    def _place(self, y: FloatArray, z: FloatArray) -> tuple[FloatArray, NDArray[np.int32], FloatArray]:
        """Return each component's sign (n, 6), and places across the wind and their weights, shapes (n, n_across²)."""
        n_distance, n_direction, _ = self.shape
        points, ghost = self.n_across, STENCIL // 2
        near, near_weight = stencil(_stretch(np.hypot(y, z)) / self.across_step + ghost, n_distance, points)
        turn = np.arctan2(y, z)
        signs = np.where((turn < 0.0)[:, np.newaxis] & _odd_mask(), -1.0, 1.0)  # those odd in y change theirs with it
        facing, facing_weight = stencil(np.abs(turn) / self.direction_step + ghost, n_direction, points)
        columns = ((near * n_direction)[:, :, np.newaxis] + facing[:, np.newaxis]).astype(np.int32)
        shares = near_weight[:, :, np.newaxis] * facing_weight[:, np.newaxis]
        return signs, columns.reshape(len(y), points**2), shares.reshape(len(y), points**2)

    def _along(self, lines: FloatArray, x: FloatArray) -> FloatArray:
        if x.strides[0] == 0 and len(x) > 1:  # the same separations for all: perhaps those that the table holds
            place = _stretch(x[0]) / self.table_step - self.along_start
            first, whole = round(float(place[0])), round(float(place[0])) + np.arange(len(place))
            if first >= 0 and whole[-1] < self.shape[2] and np.max(np.abs(place - whole)) < _ON_GRID:
                return lines[:, first : first + len(place)]
        place = _stretch(x.astype(lines.dtype, copy=False))
        place *= 1.0 / self.table_step
        place -= self.along_start
        return interpolate_rows(lines, place)


def _rows_times(shares: FloatArray, columns: NDArray[np.int32], values: FloatArray) -> FloatArray:
    """Return Σ shares · values[columns] for each row."""
    n = len(shares)
    each = shares[0].size if n else 0
    start = each * np.arange(n + 1, dtype=np.int32)
    operator = scipy.sparse.csr_array(
        (shares.ravel().astype(values.dtype, copy=False), columns.ravel(), start), shape=(n, len(values))
    )
    return np.ascontiguousarray(operator @ values)


def covariance_table(gamma: float, separation: FloatArray, *, tolerance: float) -> CovarianceTable:
    """Return the table that holds all `separation`, shape (n, 3) in L; built once for each Γ and reach."""
    resolution_for(tolerance, gamma)
    tolerance = float(tolerance)
    reach = np.max(np.abs(separation), axis=0, initial=1e-3)
    along = max(float(reach[0]), _LEAST_REACH[0])
    across = max(float(np.hypot(reach[1], reach[2])), _LEAST_REACH[1])
    return _build_table(float(gamma), *(4.0 ** np.ceil(0.5 * np.log2([along, across]))), tolerance)


@lru_cache(maxsize=32)  # the app has two of each Γ
@one_thread()  # what is kept must not depend on who asked for it first
def _build_table(gamma: float, along: float, across: float, tolerance: float) -> CovarianceTable:
    promised, resolution = resolution_for(tolerance, gamma)
    ghost = STENCIL // 2
    step, across_step = resolution.table_step, resolution.across_step
    n_distance = int(np.ceil(_stretch(np.asarray(across)) / across_step)) + 1
    distance = _CORE * np.sinh(across_step * np.arange(n_distance + ghost))
    half = int(np.ceil(_stretch(np.asarray(along)) / step)) + ghost
    x = _CORE * np.sinh(step * np.arange(-half, half + 1))
    direction_step = np.pi / resolution.n_direction
    direction = direction_step * np.arange(-ghost, resolution.n_direction + ghost + 1)
    shape = (len(distance) + ghost, len(direction), len(x))
    values = np.zeros(
        (shape[0], shape[1], len(STRESSES), shape[2]), dtype=np.float32 if resolution.single else np.float64
    )
    if gamma > 0.0:
        for index, parts in enumerate(_harmonic_covariances(gamma, x[half:], distance, resolution)):
            m = np.arange(resolution.n_harmonic)
            angular = (np.sin if index in _ODD_IN_K2 else np.cos)(np.outer(direction, m))
            both = np.concatenate([parts[:, :, :0:-1] * np.where(m % 2 == 0, 1.0, -1.0)[:, None, None], parts], axis=2)
            mirror = (both * np.where(m % 2 == 0, 1.0, -1.0)[:, None, None])[:, ghost:0:-1]
            whole = np.tensordot(angular, np.concatenate([mirror, both], axis=1), axes=(1, 0))
            values[:, :, index] = whole.transpose(1, 0, 2)
    lines = values.reshape(-1, shape[2])
    lines.flags.writeable = False
    return CovarianceTable(gamma, lines, shape, step, across_step, direction_step, resolution.n_across, -half, promised)


def _harmonic_covariances(
    gamma: float, x: FloatArray, distance: FloatArray, resolution: Resolution
) -> list[FloatArray]:
    """Return, for each component, the angular harmonics of the covariance, shape (n_harmonic, n_distance, n_along)."""
    harmonics = _harmonics_of_tables(gamma, resolution._replace(table_step=0.0, across_step=0.0, n_direction=0))
    cosine, sine = _fourier_weights(x, resolution)
    parts = np.empty((len(STRESSES), resolution.n_harmonic, len(distance), len(x)))
    for m, hankel in enumerate(_hankel_weights(distance, resolution)):
        along, sign = ((cosine, 1.0), (sine, -1.0), (cosine, -1.0), (sine, 1.0))[m % 4]  # real part of i^m exp(ik1x)
        for index in range(len(STRESSES)):
            parts[index, m] = sign * 4.0 * np.pi * (hankel @ (along @ harmonics[index, m]).T)
    return list(parts)


@lru_cache(maxsize=2)
def _harmonics_of_tables(gamma: float, resolution: Resolution) -> FloatArray:
    """Return the harmonics on the grid of wave numbers that all tables of one Γ have, whatever they reach or hold."""
    k1 = np.exp(_grid(resolution.log_k1, resolution.step))
    kappa = np.exp(_grid(resolution.log_kappa, resolution.step))
    harmonics = _harmonics(k1, kappa, gamma, resolution)
    harmonics.flags.writeable = False
    return harmonics


def _harmonics(k1: FloatArray, kappa: FloatArray, gamma: float, resolution: Resolution) -> FloatArray:
    """Return the harmonics a_m(k₁, κ) of Φ(Γ) − Φ(0), shape (6, n_harmonic, n_k1, n_kappa).

    With k₂ = κ sin ϑ and k₃ = κ cos ϑ, the components even in k₂ are Σ a_m cos mϑ, the odd ones Σ a_m sin mϑ. Shear
    makes Φ steep about ϑ = π, within k₁/κ of it, where κ < βk₁; the angles are graded towards it accordingly.
    """
    node, weight = np.polynomial.legendre.leggauss(resolution.n_angle)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    m = np.arange(resolution.n_harmonic)[:, np.newaxis]
    out = np.empty((len(STRESSES), resolution.n_harmonic, len(k1), len(kappa)))
    for i, k1_i in enumerate(k1):
        grading = np.arcsinh(np.sqrt(gamma / k1_i))
        back = np.pi * np.sinh(grading * node) / np.sinh(grading)  # π − ϑ
        measure = weight * np.pi * grading * np.cosh(grading * node) / np.sinh(grading)
        k2, k3 = np.outer(kappa, np.sin(back)), -np.outer(kappa, np.cos(back))
        beta = gamma * lifetime_shape(np.hypot(k1_i, kappa))[:, np.newaxis]
        k1_all = np.full_like(k2, k1_i)
        sheared, plain = scaled_tensor(k1_all, k2, k3, beta), isotropic_tensor(k1_all, k2, k3)
        sign = np.where(m % 2 == 0, 1.0, -1.0)
        even = 2.0 / np.pi * sign * np.cos(m * back) * measure
        even[0] *= 0.5
        odd = -2.0 / np.pi * sign * np.sin(m * back) * measure
        for index in range(len(STRESSES)):
            out[index, :, i] = (odd if index in _ODD_IN_K2 else even) @ (sheared[index] - plain[index]).T
    return out


def _hankel_weights(distance: FloatArray, resolution: Resolution) -> list[FloatArray]:
    """Return W_m with Σ W_m[d, κ] f(κ) = ∫κ J_m(κd) f(κ) dκ, each of shape (n_distance, n_kappa)."""
    log_kappa = _grid(resolution.log_kappa, resolution.step)
    apart = distance > 0.0
    weights = []
    for m in range(resolution.n_harmonic):
        weight = np.zeros((len(distance), len(log_kappa)))
        if m == 0:
            weight[~apart] = resolution.step
        if np.any(apart):
            mellin = bessel_mellin(m)
            weight[apart] = log_convolution(log_kappa, np.log(distance[apart]), resolution.step, _BIAS_ACROSS, mellin)
        weights.append(weight * np.exp(2.0 * log_kappa))
    return weights


def _fourier_weights(x: FloatArray, resolution: Resolution) -> tuple[FloatArray, FloatArray]:
    """Return W with Σ W[x, k₁] f(k₁) = ∫cos(k₁x) f dk₁, and the same for the sine; x is not negative."""
    log_k1 = _grid(resolution.log_k1, resolution.step)
    cosine, sine = np.full((len(x), len(log_k1)), resolution.step), np.zeros((len(x), len(log_k1)))
    apart = x > 0.0
    for weight, kind in ((cosine, cosine_mellin), (sine, sine_mellin)):
        weight[apart] = log_convolution(log_k1, np.log(x[apart]), resolution.step, _BIAS_ALONG, kind)
    return cosine * np.exp(log_k1), sine * np.exp(log_k1)


def _grid(ends: tuple[float, float], step: float) -> FloatArray:
    return ends[0] + step * np.arange(round((ends[1] - ends[0]) / step) + 1, dtype=np.float64)


def _scaled(along: FloatArray, turbulence: MannTurbulence) -> FloatArray:
    """Return separations in L; where all rows are one in memory, they stay so."""
    rows = along[:1] if len(along) > 1 and along.strides[0] == 0 else along
    return np.broadcast_to(rows / turbulence.length_scale, along.shape)


def _stretch(distance: FloatArray) -> FloatArray:
    return stretched(distance * (1.0 / _CORE))


def _odd_mask() -> NDArray[np.bool_]:
    return np.isin(np.arange(len(STRESSES)), _ODD_IN_K2)
