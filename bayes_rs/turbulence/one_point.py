"""What one point sees of Mann turbulence: stresses and spectra, as quadratures that converge exponentially."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from bayes_rs._validation import FloatArray, as_numbers, check_non_negative, check_positive
from bayes_rs.errors import InputError
from bayes_rs.processor import one_thread
from bayes_rs.turbulence.spectral_tensor import Components, lifetime_shape, scaled_tensor

ISOTROPIC_VARIANCE = float(special.gamma(2.5) * special.gamma(1.0 / 3.0) / special.gamma(17.0 / 6.0) / 3.0)
"""Variance of each component at Γ = 0 in units of αε^(2/3) L^(2/3): ∫(2/3)E dk, 0.6883439."""

# Both quadratures are trapezoidal rules over variables in which the integrand is analytic within about π/2 of the
# real axis and dies off exponentially: the error falls as exp(−π²/step). Halving the steps, widening the ranges and
# doubling the counts moves no stress by more than 3e-9 of uu for gamma up to 6 (6e-10 up to 3.2, 4e-8 at 15).
_STEP = 0.2
_LOG_K = (-22.0, 15.0)
_PAD = 11.0


def isotropic_tensor(k1: FloatArray, k2: FloatArray, k3: FloatArray) -> Components:
    """Return the tensor at Γ = 0, as `scaled_tensor` does."""
    weight = (1.0 + k1 * k1 + k2 * k2 + k3 * k3) ** (-17.0 / 6.0) / (4.0 * np.pi)
    return (
        weight * (k2 * k2 + k3 * k3),
        weight * (k1 * k1 + k3 * k3),
        weight * (k1 * k1 + k2 * k2),
        -weight * k1 * k2,
        -weight * k1 * k3,
        -weight * k2 * k3,
    )


@lru_cache(maxsize=256)
@one_thread()  # what is kept must not depend on who asked for it first
def scaled_stresses(gamma: float) -> tuple[float, float, float, float, float, float]:
    """Return the six one-point stresses in units of αε^(2/3) L^(2/3).

    Parameters
    ----------
    gamma : float
        Anisotropy parameter Γ.

    Returns
    -------
    stresses : tuple of six floats
        In the order of `bayes_rs.geometry.stress.STRESSES`; uv and vw are zero by the reflection symmetry in y.

    Raises
    ------
    InputError
        If gamma is negative or not finite.

    Notes
    -----
    R_ij = R_ij(Γ=0) + ∫[Φ_ij(k; Γ) − Φ_ij(k; 0)] d³k: the first part is known in closed form, the second dies off
    faster. The integral is over log |k|, over w = asinh(k₃/h), and over w₀ = asinh(k₃₀/h), which stands for the azimuth
    φ = arccos(k₁/h) through k₃₀ = k₃ + βk₁, with h² = k₁² + k₂²:

        d³k = k³ sech²w dlog k dw dφ,     cos φ = (sinh w₀ − sinh w) / β.

    In these variables the tensor is smooth however large β is; w₀ runs as a cosine between its ends, where cos φ = ±1.

    References
    ----------
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886.

    Examples
    --------
    >>> round(scaled_stresses(0.0)[0], 7)
    0.6883439
    >>> uu, vv, ww, uv, uw, vw = scaled_stresses(3.2)
    >>> round(uu, 5), round(uw, 5)
    (1.77222, -0.46488)
    """
    check_non_negative(gamma, what="gamma", unit="")
    total = np.zeros(6)
    total[:3] = ISOTROPIC_VARIANCE
    if gamma > 0.0:
        for log_k in np.arange(_LOG_K[0], _LOG_K[1] + 0.5 * _STEP, _STEP):
            total += _STEP * _sheared_shell(float(np.exp(log_k)), gamma)
    uu, vv, ww, _, uw, _ = (float(value) for value in total)
    return uu, vv, ww, 0.0, uw, 0.0


def _sheared_shell(k: float, gamma: float) -> FloatArray:
    """Integrate Φ(Γ) − Φ(0) over the sphere |k|L = k, times k³: what a step in log k adds to the stresses."""
    beta = gamma * lifetime_shape(np.asarray(k))
    reach = float(np.arcsinh(beta))
    w = _STEP * np.arange(int((_PAD + reach) / _STEP) + 2)[:, np.newaxis]  # w < 0 mirrors w > 0
    w_weight = np.where(w == 0.0, 1.0, 2.0) * _STEP
    count = int(16 + 4 * reach)
    psi = (np.arange(count) + 0.5) * np.pi / count
    p = np.sinh(w)
    high, low = p + beta, p - beta
    slope_high, slope_low = np.hypot(1.0, high), np.hypot(1.0, low)
    apart = np.where(  # sinh of the distance between the ends of w0, without cancellation
        low > 0.0,
        4.0 * p * beta / (high * slope_low + np.abs(low) * slope_high),
        high * slope_low - low * slope_high,
    )
    half = 0.5 * np.arcsinh(apart)
    top, bottom = np.arcsinh(high), np.arcsinh(low)
    w0 = 0.5 * (top + bottom) + half * np.cos(psi)
    near, far = half * np.sin(0.5 * psi) ** 2, half * np.cos(0.5 * psi) ** 2
    to_top = 2.0 * np.cosh(0.5 * (top + w0)) * np.sinh(near) / beta  # 1 − cos φ
    to_bottom = 2.0 * np.cosh(0.5 * (bottom + w0)) * np.sinh(far) / beta  # 1 + cos φ
    azimuth_weight = (
        (np.pi / count)
        * np.cosh(w0)
        / np.sqrt(np.cosh(0.5 * (top + w0)) * np.cosh(0.5 * (bottom + w0)) * _sinhc(near) * _sinhc(far))
    )
    cosine = np.where(to_top < to_bottom, 1.0 - to_top, to_bottom - 1.0)
    h = k / np.cosh(w)
    k1, k2, k3 = h * cosine, h * np.sqrt(to_top * to_bottom), k * np.tanh(w) * np.ones_like(psi)
    weight = 2.0 * k**3 * w_weight / np.cosh(w) ** 2 * azimuth_weight  # k2 < 0 mirrors k2 > 0
    sheared, plain = scaled_tensor(k1, k2, k3, beta), isotropic_tensor(k1, k2, k3)
    sums = np.array([np.sum(weight * (a - b)) for a, b in zip(sheared, plain, strict=True)])
    sums[[3, 5]] = 0.0  # uv and vw: odd in k2
    return sums


def _sinhc(value: FloatArray) -> FloatArray:
    return np.where(value < 1e-4, 1.0 + value * value / 6.0, np.sinh(value) / np.maximum(value, 1e-4))


def isotropic_spectra(k1: FloatArray) -> FloatArray:
    """Return F_uu, F_vv, F_ww, F_uv, F_uw, F_vw at Γ = 0 in units of αε^(2/3) L^(5/3); k1 is k₁L; shape (..., 6).

    Notes
    -----
    Integrals of the von Kármán tensor: F_uu = (9/55) (1 + k₁²)^(−5/6),
    F_vv = F_ww = (3/110) (3 + 8k₁²) (1 + k₁²)^(−11/6).
    """
    base = 1.0 + k1 * k1
    along = 9.0 / 55.0 * base ** (-5.0 / 6.0)
    across = 3.0 / 110.0 * (3.0 + 8.0 * k1 * k1) * base ** (-11.0 / 6.0)
    zero = np.zeros_like(along)
    return np.stack([along, across, across, zero, zero, zero], axis=-1)


def one_point_spectra(wave_number: ArrayLike, *, dissipation: float, length_scale: float, gamma: float) -> FloatArray:
    """Return the one-point spectra F_ij(k₁), two-sided.

    Parameters
    ----------
    wave_number : array_like, shape (n,)
        k₁, rad/m, above zero.
    dissipation : float
        αε^(2/3), m^(4/3) s⁻².
    length_scale : float
        L, m.
    gamma : float
        Anisotropy parameter Γ.

    Returns
    -------
    spectra : ndarray, shape (n, 6)
        F_ij, m³ s⁻², in the order of `STRESSES`. The integral over all k₁, from −∞ to ∞, is the stress.

    Raises
    ------
    InputError
        If a wave number or a parameter is not valid.

    Notes
    -----
    F_ij(k₁) = ∫∫Φ_ij dk₂ dk₃, Mann (1994), Eq. (2.7), as F_ij(Γ=0) plus the integral of what the shear changes, over
    asinh(k₂/k₁) and over a variable that resolves k₃ both about k₃ = 0 and about k₃ + βk₁ = 0.

    Examples
    --------
    In the inertial range the along-wind spectrum is (9/55) αε^(2/3) k₁^(−5/3), and the others are 4/3 of it:

    >>> spectra = one_point_spectra([30.0], dissipation=0.05, length_scale=61.0, gamma=3.2)[0]
    >>> float(round(spectra[0] / (9 / 55 * 0.05 * 30.0 ** (-5 / 3)), 3)), float(round(spectra[2] / spectra[0], 3))
    (1.0, 1.333)
    """
    check_positive(dissipation, what="dissipation", unit="m^(4/3) s^-2")
    check_positive(length_scale, what="length_scale", unit="m")
    check_non_negative(gamma, what="gamma", unit="")
    k1 = as_numbers(wave_number, what="wave_number")
    if k1.ndim != 1 or not np.all((k1 > 0.0) & np.isfinite(k1)):
        raise InputError("Invalid wave_number: k1 must be a list of finite numbers above zero, rad/m.")
    scaled = isotropic_spectra(k1 * length_scale)
    if gamma > 0.0:
        for index, value in enumerate(k1 * length_scale):
            scaled[index] += _sheared_spectrum(float(value), gamma)
    return np.asarray(dissipation * length_scale ** (5.0 / 3.0) * scaled)


def _sheared_spectrum(k1: float, gamma: float) -> FloatArray:
    """Integrate Φ(Γ) − Φ(0) over k₂ and k₃ at one k₁L."""
    reach = _PAD + float(np.arcsinh(1.0 / k1))
    a = _STEP * np.arange(int(reach / _STEP) + 2)[:, np.newaxis]  # k2 < 0 mirrors k2 > 0
    a_weight = np.where(a == 0.0, 1.0, 2.0) * _STEP
    h = k1 * np.cosh(a)
    offset = np.ones_like(a)
    for _ in range(40):  # k3/h at which k3 + βk1 = 0: only the mapping's centre, so its precision does not matter
        offset = np.sqrt(offset * gamma * lifetime_shape(h * np.hypot(1.0, offset)) / np.cosh(a))
    centre = 0.5 * offset
    v_step = _STEP
    v_max = 2.0 * (reach + float(np.arcsinh(np.max(centre))))
    v = v_step * np.arange(-int(v_max / v_step) - 1, int(v_max / v_step) + 2)
    sine, cosine = np.sinh(0.5 * v), np.cosh(0.5 * v)
    root = np.hypot(cosine, centre)  # asinh(y − c) + asinh(y + c) = v has the solution y = tanh(v/2) √(cosh²(v/2) + c²)
    y = sine / cosine * root
    slope = 0.5 * root / cosine**2 + 0.5 * sine**2 / root
    k2, k3 = k1 * np.sinh(a) * np.ones_like(v), h * (y - centre)
    beta = gamma * lifetime_shape(np.sqrt(h * h + k3 * k3))
    weight = h * h * a_weight * slope * v_step
    sheared, plain = scaled_tensor(np.full_like(k3, k1), k2, k3, beta), isotropic_tensor(np.full_like(k3, k1), k2, k3)
    sums = np.array([np.sum(weight * (x - z)) for x, z in zip(sheared, plain, strict=True)])
    sums[[3, 5]] = 0.0  # uv and vw: odd in k2
    return sums
