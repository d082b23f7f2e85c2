"""What two points see of isotropic von Kármán turbulence (Γ = 0), in closed form; lengths in L, results scaled."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy
from scipy import special

from bayes_rs._validation import FloatArray
from bayes_rs.processor import one_thread
from bayes_rs.turbulence.log_transform import ComplexArray
from bayes_rs.turbulence.one_point import ISOTROPIC_VARIANCE


def isotropic_correlation(distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return f and g, the longitudinal and lateral covariance at Γ = 0; distance in L, result in αε^(2/3) L^(2/3).

    Notes
    -----
    f(r) = σ² 2^(2/3)/Γ(1/3) r^(1/3) K_(1/3)(r), g = f + r f'/2, von Kármán (1948).
    """
    r = np.asarray(distance, dtype=np.float64)
    safe = np.where(r > 0.0, r, 1.0)
    scale = ISOTROPIC_VARIANCE * 2.0 ** (2.0 / 3.0) / special.gamma(1.0 / 3.0) * np.cbrt(safe)
    f = scale * special.kv(1.0 / 3.0, safe)
    g = f - 0.5 * scale * safe * special.kv(2.0 / 3.0, safe)
    return np.where(r > 0.0, f, ISOTROPIC_VARIANCE), np.where(r > 0.0, g, ISOTROPIC_VARIANCE)


_NOTHING = 20.0  # L: beyond, f and g are below 1e-8 of the variance
_LOG_NEAREST, _LOG_FARTHEST, _N_CORRELATION = np.log(1e-7), np.log(60.0), 2400


@lru_cache(maxsize=2)
@one_thread()  # what is kept must not depend on who asked for it first
def _correlation_spline(kind: str) -> FloatArray:
    """Return the polynomials of a cubic spline of f − g and g, their highest powers first, shape (2, 4, n_piece)."""
    log_r = np.linspace(_LOG_NEAREST, _LOG_FARTHEST, _N_CORRELATION)
    f, g = isotropic_correlation(np.exp(log_r))
    spline = scipy.interpolate.CubicSpline(log_r, np.stack([f - g, g], axis=-1))
    return np.ascontiguousarray(spline.c.transpose(2, 0, 1), dtype=kind)


def _correlations(log_r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return f − g and g from the spline, up to its end; zero beyond.

    Pieces are even: without a search for them it takes a sixth of the time of SciPy's own evaluation.
    """
    step = float((_LOG_FARTHEST - _LOG_NEAREST) / (_N_CORRELATION - 1))
    past = log_r - float(_LOG_NEAREST)
    piece = (past * (1.0 / step)).astype(np.int64)
    past -= (step * piece).astype(past.dtype, copy=False)
    beyond = log_r > _LOG_FARTHEST
    values = []
    for cubes in _correlation_spline(past.dtype.name):  # the clip is of those beyond
        value = cubes[0].take(piece, mode="clip") * past
        for cube in cubes[1:3]:
            value += cube.take(piece, mode="clip")
            value *= past
        value += cubes[3].take(piece, mode="clip")
        value[beyond] = 0.0
        values.append(value)
    return values[0], values[1]


def isotropic_radial(first: FloatArray, second: FloatArray, across: FloatArray, along: FloatArray) -> FloatArray:
    """Return n_a · C(r) n_b at Γ = 0 in αε^(2/3) L^(2/3), shape (n, n_lag); lengths in L; as precise as it is given.

    Beyond `_NOTHING` across the wind it is zero.
    """
    near = np.sum(across * across, axis=-1) < _NOTHING**2
    if not np.all(near):
        some = np.zeros(along.shape, dtype=along.dtype)
        if np.any(near):
            some[near] = isotropic_radial(first[near], second[near], across[near], along[near])
        return some
    square = along * along + np.sum(across * across, axis=-1, keepdims=True)
    near = square < np.exp(2.0 * _LOG_NEAREST)  # outside the spline: evaluated directly
    log_r = 0.5 * np.log(np.where(near, 1.0, square).astype(square.dtype, copy=False))
    difference, lateral = _correlations(log_r)
    if np.any(near):
        f, g = isotropic_correlation(np.sqrt(square[near]))
        difference[near], lateral[near] = f - g, g
    towards = first[:, :1] * along + np.sum(first[:, 1:] * across, axis=-1, keepdims=True)
    towards *= second[:, :1] * along + np.sum(second[:, 1:] * across, axis=-1, keepdims=True)
    towards /= np.where(square > 0.0, square, 1.0).astype(square.dtype, copy=False)
    return np.asarray(difference * towards + lateral * np.sum(first * second, axis=-1, keepdims=True))


def isotropic_covariance(separation: FloatArray) -> FloatArray:
    """Return C_ij at Γ = 0, shape (n, 3, 3), for separations in L, shape (n, 3)."""
    distance = np.sqrt(np.sum(separation**2, axis=-1))
    f, g = isotropic_correlation(distance)
    unit = separation / np.where(distance > 0.0, distance, 1.0)[:, np.newaxis]
    outer = unit[:, :, np.newaxis] * unit[:, np.newaxis, :]
    return np.asarray((f - g)[:, np.newaxis, np.newaxis] * outer + g[:, np.newaxis, np.newaxis] * np.eye(3))


def isotropic_cross_spectra(k1: FloatArray, y: float, z: float) -> ComplexArray:
    """Return χ_ij at Γ = 0 in αε^(2/3) L^(5/3), shape (n, 3, 3).

    Notes
    -----
    With a² = 1 + k₁² and T_μ = d^μ K_μ(ad), the transform of (a² + κ²)^(−17/6) over (k₂, k₃) is
    2π T_(11/6) / ((2a)^(11/6) Γ(17/6)), DLMF 10.22.46; factors k₂ and k₃ are derivatives by y and z, where
    ∂T_μ/∂y = −a y T_(μ−1).
    """
    a = np.sqrt(1.0 + k1 * k1)
    d = float(np.hypot(y, z))
    mu = 11.0 / 6.0
    front = 0.5 / ((2.0 * a) ** mu * special.gamma(mu + 1.0))

    def t(order: float) -> FloatArray:
        """Return d^order K_order(ad), with its limit at d = 0."""
        if d == 0.0:
            return np.asarray(0.5 * special.gamma(order) * (2.0 / a) ** order)
        return np.asarray(d**order * special.kv(order, a * d))

    zero, first = front * t(mu), front * a * t(mu - 1.0)
    second = front * a * a * (d ** (mu - 2.0) * special.kv(mu - 2.0, a * d) if d > 0.0 else np.zeros_like(a))
    k2k2, k3k3, k2k3 = first - y * y * second, first - z * z * second, -y * z * second
    k1k2, k1k3 = 1j * k1 * y * first, 1j * k1 * z * first
    k1k1 = k1 * k1 * zero
    rows = [[k2k2 + k3k3, -k1k2, -k1k3], [-k1k2, k1k1 + k3k3, -k2k3], [-k1k3, -k2k3, k1k1 + k2k2]]
    return np.stack([np.stack([item.astype(np.complex128) for item in row], axis=-1) for row in rows], axis=-2)
