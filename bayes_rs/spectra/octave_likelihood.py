"""The likelihood of ln L given the octaves of a record's variances: a look-up in tables of a scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.spectra.octave_information import Information
from bayes_rs.spectra.octave_theory import OctaveTheory, length_nodes

NOISE_SHARES = np.array([0.0, 0.01, 0.03, 0.07, 0.15, 0.3])
"""Instrument noise over the variance of the turbulence: what the likelihood is averaged over."""
NOISE_SHARE_MEAN = 0.05
"""Mean of its exponential prior."""
_LEAST = 1e-9  # of a beam's variance: octaves that are nothing but rounding
_RECORDS = 256  # at a time


def length_likelihood(
    energy: FloatArray,
    count: FloatArray,
    used: NDArray[np.bool_],
    wind_speed: FloatArray,
    yaw: FloatArray,
    theory: OctaveTheory,
    information: Information,
) -> FloatArray:
    r"""Return the log-likelihood of ln L of records, less its maximum.

    Parameters
    ----------
    energy : ndarray, shape (n_record, n_beam, n_octave)
        Octaves of the variances, m² s⁻².
    count : ndarray, shape (n_record, n_beam)
        Samples.
    used : ndarray of bool, shape (n_record, n_beam)
        Which beams count.
    wind_speed, yaw : ndarray, shape (n_record,)
        Mean wind, m/s, and its direction relative to the lidar axis, rad.
    theory : OctaveTheory
        Expected octaves of these beams.
    information : Information
        What they tell of L.

    Returns
    -------
    log_density : ndarray, shape (n_record, n_length)
        At `length_nodes`; zero everywhere where no beam tells anything.

    Notes
    -----
    An octave of ν differences of expectation A_b (e_l + r w_l), e from theory and w that of white noise, is taken for
    A (e + r w) χ²_ν/ν. The size A_b of each beam is maximised over, so that R has no influence but through its
    anisotropy; the instrument's noise over the variance, r, is averaged over an exponential prior. The sum over beams
    and octaves is raised to the power of `octave_information` at its own maximum.
    """
    nodes = length_nodes()
    found = np.zeros((len(energy), len(nodes)))
    prior = np.log(np.gradient(NOISE_SHARES)) - NOISE_SHARES / NOISE_SHARE_MEAN
    for first in range(0, len(energy), _RECORDS):
        rows = slice(first, first + _RECORDS)
        by_noise = _independent(energy[rows], count[rows], used[rows], wind_speed[rows], yaw[rows], theory)
        best = nodes[np.argmax(_averaged(by_noise, prior), axis=-1)]
        power = information.at(best, wind_speed[rows])
        density = _averaged(power[:, np.newaxis, np.newaxis] * by_noise, prior)
        found[rows] = density - density.max(axis=-1, keepdims=True)
    return found


def _averaged(density: FloatArray, prior: FloatArray) -> FloatArray:
    """Return the log-likelihood (n_record, n_length) averaged over the noise, of (n_record, n_noise, n_length)."""
    joint = density + prior[:, np.newaxis]
    top = joint.max(axis=1, keepdims=True)
    return np.asarray(np.log(np.sum(np.exp(joint - top), axis=1)) + top[:, 0])


def _independent(
    energy: FloatArray,
    count: FloatArray,
    used: NDArray[np.bool_],
    wind_speed: FloatArray,
    yaw: FloatArray,
    theory: OctaveTheory,
) -> FloatArray:
    """Return the log-likelihood as if octaves and beams were independent, shape (n_record, n_noise, n_length)."""
    n_sample = theory.blocks.n_sample
    share = np.clip(count / n_sample, 1.0 / n_sample, 1.0)
    filled = theory.blocks.filled(share)
    dof = np.diff(filled)  # (n_record, n_beam, n_octave)
    white = dof / filled[..., -1:]
    shape = theory.expected(theory.correlation(wind_speed, yaw), filled[:, :, np.newaxis])
    total = np.sum(energy, axis=-1)
    sound = used & np.isfinite(total) & (total > 0.0)
    half = np.where(sound[..., np.newaxis], 0.5 * dof, 0.0)
    all_half = half.sum(axis=-1)
    relative = np.where(sound[..., np.newaxis], energy / np.where(sound, total, 1.0)[..., np.newaxis], 0.0)
    weighted = half * relative
    density = np.empty((len(energy), len(NOISE_SHARES), shape.shape[2]))
    for index, noise in enumerate(NOISE_SHARES):
        mean = np.maximum(shape + noise * white[:, :, np.newaxis], _LEAST)  # (n_record, n_beam, n_length, n_octave)
        size = np.einsum("rbo,rbno->rbn", weighted, np.reciprocal(mean))
        log_size = np.log(np.where(sound[..., np.newaxis], size, 1.0))
        log_mean = np.einsum("rbo,rbno->rbn", half, np.log(mean))
        density[:, index] = -np.sum(log_mean + all_half[..., np.newaxis] * log_size, axis=1)
    return density
