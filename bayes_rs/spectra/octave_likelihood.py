"""The likelihood of ln L given the octaves of a record's variances: a look-up in tables of a scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.spectra.octave_information import Information
from bayes_rs.spectra.octave_theory import OctaveTheory, length_nodes

NOISE_PARTS = np.array([0.0, 0.04, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97])
"""Instrument noise over the most that the finest octaves leave for it: what the likelihood is averaged over."""
NOISE_SHARE = 0.02
"""Share of a variance below which all shares of noise are as likely a priori; above, those of all sizes are."""
_FINEST = 2  # octaves that bound the noise
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
    anisotropy; the instrument's noise, the same for all beams, is averaged over a prior 1/(q + 0.02) of its share q of
    the variance. The sum over beams
    and octaves is raised to the power of `octave_information` at its own maximum.
    """
    nodes = length_nodes()
    found = np.zeros((len(energy), len(nodes)))
    for first in range(0, len(energy), _RECORDS):
        rows = slice(first, first + _RECORDS)
        by_noise, prior = _independent(energy[rows], count[rows], used[rows], wind_speed[rows], yaw[rows], theory)
        best = nodes[np.argmax(_averaged(by_noise, prior), axis=-1)]
        power = information.at(best, wind_speed[rows])
        density = _averaged(power[:, np.newaxis, np.newaxis] * by_noise, prior)
        found[rows] = density - density.max(axis=-1, keepdims=True)
    return found


def _averaged(density: FloatArray, prior: FloatArray) -> FloatArray:
    """Return the log-likelihood (n_record, n_length) averaged over the noise, of (n_record, n_noise, n_length)."""
    joint = density + prior[..., np.newaxis]
    top = joint.max(axis=1, keepdims=True)
    return np.asarray(np.log(np.sum(np.exp(joint - top), axis=1)) + top[:, 0])


def _independent(
    energy: FloatArray,
    count: FloatArray,
    used: NDArray[np.bool_],
    wind_speed: FloatArray,
    yaw: FloatArray,
    theory: OctaveTheory,
) -> tuple[FloatArray, FloatArray]:
    """Return the log-likelihood as if octaves and beams were independent, (n_record, n_noise, n_length), and a prior.

    The prior is that of the noise, (n_record, n_noise).
    """
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
    fine = np.where(sound[..., np.newaxis], energy, 0.0)[..., -_FINEST:].sum(axis=(1, 2))
    room = np.where(sound[..., np.newaxis], white, 0.0)[..., -_FINEST:].sum(axis=(1, 2))
    most = fine / np.maximum(room, _LEAST)  # m² s⁻²: if the finest octaves were nothing but noise
    density = np.empty((len(energy), len(NOISE_PARTS), shape.shape[2]))
    prior = np.empty((len(energy), len(NOISE_PARTS)))
    usual = np.sum(np.where(sound, total, 0.0), axis=1) / np.maximum(np.count_nonzero(sound, axis=1), 1)
    for index, (part, width) in enumerate(zip(NOISE_PARTS, np.gradient(NOISE_PARTS), strict=True)):
        noise = np.clip(part * most[:, np.newaxis] / np.where(sound, total, 1.0), 0.0, 0.95)[
            ..., np.newaxis, np.newaxis
        ]
        mean = np.maximum((1.0 - noise) * shape + noise * white[:, :, np.newaxis], _LEAST)  # (…, n_length, n_octave)
        prior[:, index] = np.log(width / (part * most / np.maximum(usual, _LEAST) + NOISE_SHARE))
        size = np.einsum("rbo,rbno->rbn", weighted, np.reciprocal(mean))
        log_size = np.log(np.where(sound[..., np.newaxis], size, 1.0))
        log_mean = np.einsum("rbo,rbno->rbn", half, np.log(mean))
        density[:, index] = -np.sum(log_mean + all_half[..., np.newaxis] * log_size, axis=1)
    return density, prior
