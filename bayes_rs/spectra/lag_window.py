"""What the spectrum of a finite, gappy record is expected to be: a sum over the lags of the autocovariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.turbulence.log_transform import ComplexArray


def taper_weights(present: NDArray[np.bool_], tapers: int) -> FloatArray:
    """Return the weights of the samples of a record, one row a taper; the squares of each row sum to one.

    Parameters
    ----------
    present : ndarray of bool, shape (n_slot,)
        Which samples there are.
    tapers : int
        Number of sine tapers K; 0 for equal weights.

    Returns
    -------
    weights : ndarray, shape (max(K, 1), n_slot)
        Zero where there is no sample.

    Notes
    -----
    Sine tapers, Riedel and Sidorenko (1995): h_k(j) ∝ sin(π k (j + 1) / (N + 1)), k = 1 … K.

    References
    ----------
    Riedel and Sidorenko (1995), IEEE Trans. Signal Process. 43, 188–195, doi:10.1109/78.365298.
    """
    n = len(present)
    rows = np.ones((1, n))
    if tapers > 0:
        rows = np.sin(np.pi * np.outer(np.arange(1, tapers + 1), np.arange(1, n + 1)) / (n + 1.0))
    rows = rows * present
    return np.asarray(rows / np.sqrt(np.sum(rows * rows, axis=1, keepdims=True)))


def ordinates(n_slot: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the numbers k of the frequencies k/(NΔ) above zero, and 2, or 1 at the Nyquist frequency.

    Parameters
    ----------
    n_slot : int
        Number of slots N.

    Returns
    -------
    number : ndarray of int, shape (N // 2,)
        1 … N // 2.
    sides : ndarray, shape (N // 2,)
        How many of the two-sided spectrum's frequencies each stands for.
    """
    number = np.arange(1, n_slot // 2 + 1)
    return number, np.where(2 * number == n_slot, 1.0, 2.0)


def fourier_rows(present: NDArray[np.bool_], tapers: int) -> ComplexArray:
    """Return the rows w that make each Fourier sum of a record: Σ_j w_j v_j, its mean removed.

    Parameters
    ----------
    present : ndarray of bool, shape (n_slot,)
        Which samples there are.
    tapers : int
        Number of tapers; 0 for equal weights.

    Returns
    -------
    rows : ndarray of complex, shape (n_taper, n_frequency, n_slot)
        h_j exp(−2πi k j / N), less its mean over the samples that there are, which removes the record's mean.
    """
    n = len(present)
    number, _ = ordinates(n)
    wave = np.exp(-2j * np.pi * (np.outer(number, np.arange(n)) % n) / n)
    rows = taper_weights(present, tapers)[:, np.newaxis] * wave
    return np.asarray(rows - present * (rows.sum(axis=-1, keepdims=True) / np.count_nonzero(present)))


def lag_windows(present: NDArray[np.bool_], interval: float, tapers: int) -> FloatArray:
    """Return what turns an autocovariance into the expected spectrum of a record.

    Parameters
    ----------
    present : ndarray of bool, shape (n_slot,)
        Which samples there are.
    interval : float
        Time between slots Δ, s.
    tapers : int
        Number of tapers; 0 for equal weights.

    Returns
    -------
    windows : ndarray, shape (n_frequency, n_slot)
        q: the expected spectrum is q @ C, with C the autocovariance at the lags 0, Δ, 2Δ … The first column is what
        white noise of unit variance adds.

    Notes
    -----
    The estimate at f_k is Δ s_k Σ_j,l w_j w̄_l v_j v_l, with s_k = 2 (1 at the Nyquist frequency) and w the rows of
    `fourier_rows`, so its expectation is Δ s_k Σ_j,l w_j w̄_l C(j − l): the sum of the autocorrelation of w times C.
    Aliasing, leakage, the removal of the mean and the gaps are all in it, exactly. It is the expected periodogram of
    the de-biased Whittle likelihood (Sykulski et al. 2019), with gaps in the same way.

    References
    ----------
    Sykulski, Olhede, Guillaumin, Lilly and Early (2019), Biometrika 106, 251–266, doi:10.1093/biomet/asy071.

    Examples
    --------
    White noise has a flat spectrum, but for what the mean takes from a record with gaps:

    >>> full, half = np.ones(8, dtype=bool), np.arange(8) < 4
    >>> lag_windows(full, 1.0, 0)[:, 0].round(3), lag_windows(half, 1.0, 0)[:, 0].round(3)
    (array([2., 2., 2., 1.]), array([1.146, 2.   , 1.854, 1.   ]))
    """
    rows = fourier_rows(present, tapers)
    n = rows.shape[-1]
    _, sides = ordinates(n)
    power = np.abs(np.fft.fft(rows, 2 * n, axis=-1)) ** 2
    windows = np.fft.ifft(power.mean(axis=0), axis=-1)[:, :n].real
    windows[:, 1:] *= 2.0
    return np.asarray(interval * sides[:, np.newaxis] * windows)


def ordinate_correlation(n_slot: int, tapers: int) -> FloatArray:
    """Return the covariance of two estimates d frequencies apart over that of raw ones, for a locally flat spectrum.

    Parameters
    ----------
    n_slot : int
        Number of slots.
    tapers : int
        Number of tapers; 0 for equal weights.

    Returns
    -------
    covariance : ndarray, shape (n_slot // 2 + 1,)
        (1/K²) Σ_ij |Σ_t h_i h_j exp(2πi d t / N)|², at d = 0, 1, …; 1, 0, 0, … without a taper.
    """
    weights = taper_weights(np.ones(n_slot, dtype=np.bool_), tapers)
    products = weights[:, np.newaxis] * weights[np.newaxis]
    power = np.abs(np.fft.rfft(products, axis=-1)) ** 2
    return np.asarray(power.sum(axis=(0, 1)) / len(weights) ** 2)
