"""The Whittle likelihood of a spectrum whose shape is known up to its size and a white floor, maximised over both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bayes_rs._validation import FloatArray

_MOST_STEPS, _MOST_HALVINGS = 60, 30
_CONVERGED = 1e-6  # of a log-likelihood: what the next step would gain


class Profile(NamedTuple):
    """The likelihood at several shapes, with size and floor at their best values.

    Attributes
    ----------
    log_density : ndarray, shape (n_shape,)
        Log-likelihood, with the prior of the floor; −inf for a shape that is not positive.
    log_size : ndarray, shape (n_shape,)
        ln A.
    floor : ndarray, shape (n_shape,)
        s, m² s⁻².
    covariance : ndarray, shape (n_shape, 2, 2)
        Of ln A and s, the inverse of the information (Fisher's, plus the floor's prior).
    """

    log_density: FloatArray
    log_size: FloatArray
    floor: FloatArray
    covariance: FloatArray


def profile_likelihood(
    spectrum: FloatArray,
    weight: FloatArray,
    shape: FloatArray,
    white: FloatArray,
    *,
    floor: float,
    floor_sd: float,
) -> Profile:
    """Maximise the Whittle likelihood over size and floor, for each of several shapes.

    Parameters
    ----------
    spectrum : ndarray, shape (n,)
        Estimated spectrum I, any beams in a row.
    weight : ndarray, shape (n,)
        Half the degrees of freedom of each estimate.
    shape : ndarray, shape (n_shape, n)
        Expected spectra E of a unit size.
    white : ndarray, shape (n,)
        Expected spectrum q of white noise of unit variance.
    floor, floor_sd : float
        Mean and standard deviation of the normal prior of the floor, m² s⁻²; with 0 it is known.

    Returns
    -------
    profile : Profile
        The log-likelihood at its maximum, where that is, and how sharp.

    Notes
    -----
    ℓ = −Σ w (ln S + I/S), S = A E + s q (Whittle 1953). Fisher scoring in ln A and s, with steps halved until ℓ grows.
    The floor may come out below zero as long as S is positive: that is what an unbiased estimate of none does.
    """
    positive = np.all(np.isfinite(shape) & (shape > 0.0), axis=1)
    e = np.where(positive[:, np.newaxis], shape, 1.0)
    known = floor_sd == 0.0
    precision = 0.0 if known else 1.0 / floor_sd**2
    s = np.full(len(e), floor)
    signal = np.sum(weight * (spectrum - floor * white)) / np.sum(weight)
    start = max(float(signal), 0.05 * float(np.sum(weight * spectrum) / np.sum(weight)))
    log_a = np.log(start / (np.sum(weight * e, axis=1) / np.sum(weight)))

    def value(log_size: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        total = np.exp(log_size)[:, np.newaxis] * e + noise[:, np.newaxis] * white
        good = np.all(total > 0.0, axis=1)
        safe = np.where(good[:, np.newaxis], total, 1.0)
        density = -np.sum(weight * (np.log(safe) + spectrum / safe), axis=1)
        density = density - 0.5 * precision * (noise - floor) ** 2
        return np.where(good, density, -np.inf), safe

    density, total = value(log_a, s)
    covariance: FloatArray = np.empty((len(e), 2, 2))
    for _ in range(_MOST_STEPS):
        size_slope = np.exp(log_a)[:, np.newaxis] * e / total
        floor_slope = np.zeros_like(total) if known else white / total
        misfit = weight * (spectrum / total - 1.0)
        gradient = np.stack(
            [np.sum(misfit * size_slope, axis=1), np.sum(misfit * floor_slope, axis=1) - precision * (s - floor)],
            axis=-1,
        )
        information = np.empty((len(e), 2, 2))
        information[:, 0, 0] = np.sum(weight * size_slope**2, axis=1)
        information[:, 0, 1] = information[:, 1, 0] = np.sum(weight * size_slope * floor_slope, axis=1)
        information[:, 1, 1] = 1.0 if known else np.sum(weight * floor_slope**2, axis=1) + precision
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        step = np.einsum("nij,nj->ni", covariance, gradient)
        left = 0.5 * np.einsum("ni,ni->n", step, gradient) > _CONVERGED
        if not left.any():
            break
        step *= np.minimum(1.0, 1.0 / np.maximum(np.abs(step[:, :1]), np.finfo(np.float64).tiny))
        taken = np.ones(len(e))
        best, new_a, new_s, new_total = density, log_a, s, total
        for _ in range(_MOST_HALVINGS):
            trial_a, trial_s = log_a + taken * step[:, 0], s + taken * step[:, 1]
            trial, trial_total = value(trial_a, trial_s)
            better = left & (trial >= density)
            best, new_a = np.where(better, trial, best), np.where(better, trial_a, new_a)
            new_s = np.where(better, trial_s, new_s)
            new_total = np.where(better[:, np.newaxis], trial_total, new_total)
            left &= ~better
            if not left.any():
                break
            taken = np.where(left, 0.5 * taken, taken)
        density, log_a, s, total = best, new_a, new_s, new_total
    if known:
        covariance[:, 1, :] = covariance[:, :, 1] = 0.0
    return Profile(np.where(positive, density, -np.inf), log_a, s, covariance)
