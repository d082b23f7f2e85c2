"""The spectral tensor of Mann's uniform-shear model, and the eddy lifetime that it rests on."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from bayes_rs._validation import FloatArray, as_numbers, check_non_negative, check_positive
from bayes_rs.errors import InputError

_ALONG, _ALL = 1.0 / 3.0, 2.5  # the two arguments of the incomplete beta function in the eddy lifetime
_LIFETIME_SCALE = 1.0 / np.sqrt(_ALONG * special.beta(_ALONG, _ALL))

Components = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Six arrays of one shape, in the order of `bayes_rs.geometry.stress.STRESSES`."""


def eddy_lifetime(wave_number: ArrayLike, *, gamma: float) -> FloatArray:
    """Return Mann's non-dimensional eddy lifetime β, the shear that an eddy of wave number |k| has undergone.

    Parameters
    ----------
    wave_number : array_like, shape (...)
        |k|L, without unit, above zero.
    gamma : float
        Anisotropy parameter Γ.

    Returns
    -------
    lifetime : ndarray, shape (...)
        β, without unit.

    Raises
    ------
    InputError
        If a wave number is not positive and finite, or gamma is negative.

    Notes
    -----
    Mann (1994), Eq. (3.6) and (3.7), with x = |k|L (the sheared wave number, not the initial one):

        β = Γ x^(−2/3) [₂F₁(1/3, 17/6; 4/3; −x^(−2))]^(−1/2).

    Since the third argument is the first plus one, ₂F₁ is an incomplete beta function (DLMF 8.17.7 and 15.8.1), which
    has no cancellation at any x:

        β = (Γ / x) [⅓ B(1/3, 5/2) I_w(1/3, 5/2)]^(−1/2),   w = 1 / (1 + x²).

    Limits: β → Γ x^(−2/3) for x → ∞, and β → 1.2053 Γ / x for x → 0, so that βk₁L stays finite there.

    References
    ----------
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886.

    Examples
    --------
    >>> float(eddy_lifetime(1e6, gamma=3.2)) / (3.2 * 1e6 ** (-2 / 3))  # doctest: +ELLIPSIS
    1.0000000000...
    """
    check_non_negative(gamma, what="gamma", unit="")
    x = as_numbers(wave_number, what="wave_number")
    if not np.all((x > 0.0) & np.isfinite(x)):
        raise InputError("Invalid wave_number: |k|L must be finite and above zero everywhere.")
    return gamma * lifetime_shape(x)


def lifetime_shape(x: FloatArray) -> FloatArray:
    """Return β/Γ at x = |k|L; see `eddy_lifetime`."""
    return np.asarray(_LIFETIME_SCALE / (x * np.sqrt(special.betainc(_ALONG, _ALL, 1.0 / (1.0 + x * x)))))


def scaled_tensor(k1: FloatArray, k2: FloatArray, k3: FloatArray, beta: FloatArray) -> Components:
    """Return Φ_uu, Φ_vv, Φ_ww, Φ_uv, Φ_uw, Φ_vw in units of αε^(2/3) L^(11/3).

    Parameters
    ----------
    k1, k2, k3 : ndarray, shapes that broadcast
        Wave vector times L; not all zero where beta is above zero.
    beta : ndarray, shape that broadcasts
        Eddy lifetime β at |k|L.

    Returns
    -------
    components : tuple of six ndarrays
        In the order of `bayes_rs.geometry.stress.STRESSES`.

    Notes
    -----
    Rapid distortion takes the initial wave vector k₀ = (k₁, k₂, k₃ + βk₁) to k, and Fourier amplitudes by the matrix

        A = [[1, 0, ζ₁], [0, 1, ζ₂], [0, 0, k₀²/k²]],      Φ = A Φ₀(k₀) Aᵀ,

    with the isotropic Φ₀ = E(k₀) / (4π k₀⁴) (k₀² δ_ij − k₀ᵢk₀ⱼ). With h² = k₁² + k₂², N = h² − k₃₀k₃,
    δ = atan2(βk₁h, h² + k₃₀k₃) and g = δ / (βk₁h), Mann's (1994) Eq. (3.16)–(3.18) read

        ζ₁ = β (c₁² N/k² − c₂² k₀² g),     ζ₂ = β c₁c₂ (N/k² + k₀² g),     c₁ = k₁/h, c₂ = k₂/h,

    which have their limits at k₁ → 0 and k₂ = 0 without division by k₁; at h = 0 they are −β and 0.
    The diagonal is written as sums of squares, so that it cannot be negative.
    """
    k30 = k3 + beta * k1
    h2 = k1 * k1 + k2 * k2
    ksq, k0sq = h2 + k3 * k3, h2 + k30 * k30
    cross = k30 * k3
    h = np.hypot(k1, k2)
    on_axis = h == 0.0  # there any direction of (k1, k2) gives the same limit
    c1, c2 = np.where(on_axis, 1.0, k1 / np.where(on_axis, 1.0, h)), k2 / np.where(on_axis, 1.0, h)
    turned = beta * k1 * h
    straight = np.where(ksq == 0.0, 1.0, h2 + cross)
    unturned = turned == 0.0
    ratio = np.where(
        unturned,
        1.0 / np.where(unturned, straight, 1.0),
        np.arctan2(turned, straight) / np.where(unturned, 1.0, turned),
    )
    damped, grown = (h2 - cross) / np.where(ksq == 0.0, 1.0, ksq), k0sq * ratio
    zeta1 = beta * (c1 * c1 * damped - c2 * c2 * grown)
    zeta2 = beta * c1 * c2 * (damped + grown)
    squeeze = k0sq / np.where(ksq == 0.0, 1.0, ksq)
    weight = (1.0 + k0sq) ** (-17.0 / 6.0) / (4.0 * np.pi)
    return (
        weight * ((k30 - k1 * zeta1) ** 2 + k2 * k2 * (1.0 + zeta1 * zeta1)),
        weight * ((k30 - k2 * zeta2) ** 2 + k1 * k1 * (1.0 + zeta2 * zeta2)),
        weight * squeeze * squeeze * h2,
        weight * (h2 * zeta1 * zeta2 - k1 * k2 - k30 * (k1 * zeta2 + k2 * zeta1)),
        weight * squeeze * (h2 * zeta1 - k1 * k30),
        weight * squeeze * (h2 * zeta2 - k2 * k30),
    )


def spectral_tensor(wave_vector: ArrayLike, *, dissipation: float, length_scale: float, gamma: float) -> FloatArray:
    """Return the spectral tensor Φ_ij(k) of the Mann model.

    Parameters
    ----------
    wave_vector : array_like, shape (..., 3)
        k₁, k₂, k₃ along x, y, z, rad/m.
    dissipation : float
        αε^(2/3), m^(4/3) s⁻².
    length_scale : float
        L, m.
    gamma : float
        Anisotropy parameter Γ, 0 for isotropic turbulence.

    Returns
    -------
    tensor : ndarray, shape (..., 3, 3)
        Φ_ij, m⁵ s⁻², real and symmetric. ∫Φ_ij d³k over all wave vectors is the stress R_ij.

    Raises
    ------
    InputError
        If a parameter or a wave vector is not valid, or a wave vector is zero while gamma is not: there Φ has no limit.

    Notes
    -----
    Mann (1994), Eq. (3.16)–(3.22), without the blocking by the ground of his Sect. 4. E(k) is von Kármán's
    energy spectrum,

        E(k) = αε^(2/3) L^(5/3) (kL)⁴ / (1 + (kL)²)^(17/6).

    `scaled_tensor` has the equations as they are evaluated.

    References
    ----------
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886.

    Examples
    --------
    Turbulence without shear has the isotropic tensor E(k) / (4πk⁴) (k² δ_ij − k_i k_j):

    >>> tensor = spectral_tensor([0.02, 0.0, 0.0], dissipation=0.05, length_scale=61.0, gamma=0.0)
    >>> tensor.round(1)
    array([[   0. ,    0. ,    0. ],
           [   0. , 1573.7,    0. ],
           [   0. ,    0. , 1573.7]])
    """
    check_positive(dissipation, what="dissipation", unit="m^(4/3) s^-2")
    check_positive(length_scale, what="length_scale", unit="m")
    check_non_negative(gamma, what="gamma", unit="")
    k = as_numbers(wave_vector, what="wave_vector")
    if k.ndim == 0 or k.shape[-1] != 3:
        raise InputError(f"Invalid wave_vector of shape {k.shape}: the last dimension must hold k1, k2 and k3.")
    if not np.all(np.isfinite(k)):
        raise InputError("Invalid wave_vector: every entry must be finite.")
    kl = k * length_scale
    x = np.sqrt(np.sum(kl * kl, axis=-1))
    if gamma > 0.0:
        if np.any(x == 0.0):
            raise InputError(
                f"Invalid wave_vector: it is zero, where the tensor at gamma = {gamma:g} depends on the direction of "
                "approach; leave zero out."
            )
        beta = gamma * lifetime_shape(x)
    else:
        beta = np.zeros_like(x)
    uu, vv, ww, uv, uw, vw = scaled_tensor(kl[..., 0], kl[..., 1], kl[..., 2], beta)
    rows = np.stack([uu, uv, uw, uv, vv, vw, uw, vw, ww], axis=-1)
    return np.asarray(dissipation * length_scale ** (11.0 / 3.0) * rows.reshape(*k.shape[:-1], 3, 3))
