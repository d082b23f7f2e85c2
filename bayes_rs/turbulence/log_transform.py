"""Integral transforms with kernels of k·r, as convolutions in the logarithms of k and r (Hamilton 2000)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import special

from bayes_rs._validation import FloatArray

ComplexArray = NDArray[np.complex128]


def log_convolution(
    log_k: FloatArray,
    log_r: FloatArray,
    step: float,
    bias: float,
    mellin: Callable[[ComplexArray], ComplexArray],
) -> FloatArray:
    """Return weights W[r, k] with Σ_k W f(log k) = ∫f(t) K(e^t r) dt, exact for band-limited f(t) e^(−bias·t).

    `mellin`(z) is ∫x^(z−1) K(x) dx. The logarithmic axis is periodic with more than twice the length
    of the grid; images of the result are smaller by exp(−bias · period).
    """
    n_frequency = int(np.ceil((log_k[-1] - log_k[0] + 4.0) / step))
    period = 2.0 * n_frequency * step
    eta = 2.0 * np.pi / period * np.arange(n_frequency + 1)
    twice = np.full(n_frequency + 1, 2.0)
    twice[[0, -1]] = 1.0
    kernel = twice * mellin(np.asarray(bias - 1j * eta, dtype=np.complex128))
    shifted = (kernel * np.exp(1j * np.outer(log_r, eta))) @ np.exp(1j * np.outer(eta, log_k))
    return np.asarray(np.exp(-bias * log_r)[:, np.newaxis] * shifted.real * np.exp(-bias * log_k) * step / period)


def bessel_mellin(m: int) -> Callable[[ComplexArray], ComplexArray]:
    """Return z ↦ ∫x^(z−1) J_m(x) dx = 2^(z−1) Γ((m+z)/2) / Γ(1+(m−z)/2), DLMF 10.22.43."""

    def mellin(z: ComplexArray) -> ComplexArray:
        power = (z - 1.0) * np.log(2.0) + special.loggamma(0.5 * (m + z)) - special.loggamma(1.0 + 0.5 * (m - z))
        return np.asarray(np.exp(power))

    return mellin


def cosine_mellin(z: ComplexArray) -> ComplexArray:
    """Return ∫x^(z−1) cos x dx = Γ(z) cos(πz/2), DLMF 5.9.7."""
    log_gamma = special.loggamma(z)
    return np.asarray(0.5 * (np.exp(log_gamma + 0.5j * np.pi * z) + np.exp(log_gamma - 0.5j * np.pi * z)))


def sine_mellin(z: ComplexArray) -> ComplexArray:
    """Return ∫x^(z−1) sin x dx = Γ(z) sin(πz/2), DLMF 5.9.7."""
    log_gamma = special.loggamma(z)
    return np.asarray(-0.5j * (np.exp(log_gamma + 0.5j * np.pi * z) - np.exp(log_gamma - 0.5j * np.pi * z)))
