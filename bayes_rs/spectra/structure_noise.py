"""Structure functions at short lags: what they leave of the instrument's noise, and their scatter in Gaussian flow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray


class StructureFunction(NamedTuple):
    """Half the mean squares of differences between samples.

    Attributes
    ----------
    value : ndarray, shape (n_lag,)
        D(m), m² s⁻², at the lags 1 … n_lag.
    pairs : ndarray of int, shape (n_lag,)
        Number of pairs of samples.
    """

    value: FloatArray
    pairs: NDArray[np.int64]


def structure_function(velocity: FloatArray, n_lag: int) -> StructureFunction:
    """Return D(m) = ½⟨(v_{i+m} − v_i)²⟩ over the pairs of samples that are there.

    Parameters
    ----------
    velocity : ndarray, shape (n_slot,)
        Radial velocities, m/s; NaN where there is none.
    n_lag : int
        Largest lag.

    Returns
    -------
    structure : StructureFunction
        NaN at lags without pairs. Its expectation is that of the autocovariance, C(0) − C(m): no mean is removed.

    Examples
    --------
    >>> import numpy as np
    >>> structure_function(np.array([0.0, 2.0, np.nan, 2.0]), 2).value
    array([2., 0.])
    """
    value, count = np.full(n_lag, np.nan), np.zeros(n_lag, dtype=np.int64)
    for m in range(1, n_lag + 1):
        apart = velocity[m:] - velocity[:-m]
        known = np.isfinite(apart)
        count[m - 1] = int(np.count_nonzero(known))
        if count[m - 1]:
            value[m - 1] = 0.5 * float(np.mean(apart[known] ** 2))
    return StructureFunction(value, count)


def structure_covariance(autocovariance: FloatArray, present: NDArray[np.bool_], n_lag: int) -> FloatArray:
    """Return the covariance of structure functions of a Gaussian process.

    Parameters
    ----------
    autocovariance : ndarray, shape (n_slot + n_lag,) or longer
        C at the lags 0, 1, … of the samples, their noise included, m² s⁻².
    present : ndarray of bool, shape (n_slot,)
        Which samples there are.
    n_lag : int
        Largest lag.

    Returns
    -------
    covariance : ndarray, shape (n_lag, n_lag)
        Cov[D(m), D(n)], m⁴ s⁻⁴.

    Notes
    -----
    By Isserlis' theorem, with G(h) = ⟨(v_{i+m} − v_i)(v_{i+h+n} − v_{i+h})⟩ = C(h+n−m) − C(h−m) − C(h+n) + C(h),

        Cov[D(m), D(n)] = (1 / (2 N_m N_n)) Σ_h K_mn(h) G(h)²,

    K_mn(h) the number of pairs of differences at the places i and i + h that are both there: exact for any gaps.
    """
    n = len(present)
    pairs = np.zeros((n_lag, n))
    for m in range(1, n_lag + 1):
        pairs[m - 1, : n - m] = present[m:] & present[:-m]
    size = int(scipy.fft.next_fast_len(2 * n, real=True))
    waves = scipy.fft.rfft(pairs, size, axis=-1)
    lag = np.arange(-(n - 1), n)

    def c(at: NDArray[np.int64]) -> FloatArray:
        return autocovariance[np.abs(at)]

    covariance = np.empty((n_lag, n_lag))
    number = np.maximum(pairs.sum(axis=-1), 1.0)
    for a in range(1, n_lag + 1):
        for b in range(a, n_lag + 1):
            overlap = scipy.fft.irfft(waves[a - 1].conj() * waves[b - 1], size)
            both = np.round(overlap[lag % size])
            g = c(lag + b - a) - c(lag - a) - c(lag + b) + c(lag)
            covariance[a - 1, b - 1] = 0.5 * np.sum(both * g * g) / (number[a - 1] * number[b - 1])
            covariance[b - 1, a - 1] = covariance[a - 1, b - 1]
    return covariance


def intercept_weights(growth: FloatArray) -> FloatArray:
    """Return the weights that make least squares of D(m) = s + a·growth(m): rows for s and for a.

    Parameters
    ----------
    growth : ndarray, shape (n_lag,)
        How the structure function of the turbulence grows.

    Returns
    -------
    weights : ndarray, shape (2, n_lag)
        (s, a) = weights @ D.
    """
    return np.asarray(np.linalg.pinv(np.stack([np.ones_like(growth), growth], axis=-1)))
