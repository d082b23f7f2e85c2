"""Periodic faults: do the samples that were dropped come at one frequency, as blades do?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bayes_rs._validation import FloatArray
from bayes_rs.quality.samples import BoolArray

MOST_BLOCKS = 1000
_SEEN = 1e-6
"""Least part of the phases' variance along an axis; below it the samples' own beat hides the frequency."""


@dataclass(frozen=True)
class Periodicity:
    """What the test found.

    Parameters
    ----------
    frequency : float
        Frequency at which the events stand out most, Hz; NaN if there was nothing to test.
    p_value : float
        Probability of so much or more, at any frequency tested, of events that fall on samples at random.
    n_event : int
        Number of events that were tested.
    """

    frequency: float
    p_value: float
    n_event: int


def find_periodicity(
    seconds: FloatArray, event: BoolArray, *, frequency_range: tuple[float, float], block: float = 60.0
) -> Periodicity:
    r"""Test whether events come at a frequency, by a Rayleigh test that knows when the samples were taken.

    Parameters
    ----------
    seconds : ndarray, shape (n_sample,)
        Times of all samples of one beam, s, in order.
    event : ndarray of bool, shape (n_sample,)
        Which of them are events.
    frequency_range : (low, high)
        Where to look, Hz.
    block : float
        Time over which the phase must hold, s: that for which the rotor's speed hardly changes.

    Returns
    -------
    found : Periodicity
        The best frequency of a net with two points to a resolved width 1/block, and its p-value, multiplied by the
        number of frequencies tried (at most 1).

    Notes
    -----
    With z_i = (cos 2πf t_i, sin 2πf t_i) over the N samples of a block, and n of them events, the sum over events less
    what the samples would give on average,

    .. math:: S = \sum_{\mathrm{events}} (z_i - \bar z), \qquad
        \mathrm{Cov}[S] = \frac{n (N - n)}{N - 1} \cdot \frac{1}{N} \sum_i (z_i - \bar z)(z_i - \bar z)^T ,

    has exactly this covariance if the events are n samples drawn at random without replacement, whatever beat the
    samples themselves have. The sum over blocks of S·Cov⁻¹S is taken as χ² with two degrees of freedom a block. Blade
    passages above the samples' Nyquist frequency are found at their true frequency and at its aliases alike. Events
    that cluster, as in gusts, are no such random draw; their p-value is too small at frequencies below that of the
    clusters. Of a long series the `MOST_BLOCKS` blocks with the most events are used.
    """
    low, high = frequency_range
    frequency = np.arange(low, high + 0.25 / block, 0.5 / block)
    number = np.floor((seconds - (seconds[0] if len(seconds) else 0.0)) / block).astype(np.int64)
    edges = np.flatnonzero(np.diff(number)) + 1
    parts = [
        (time, chosen)
        for time, chosen in zip(np.split(seconds, edges), np.split(event, edges), strict=True)
        if len(time) > 2 and 0 < np.count_nonzero(chosen) < len(time)
    ]
    parts = sorted(parts, key=lambda part: -np.count_nonzero(part[1]))[:MOST_BLOCKS]
    total, dof = np.zeros(len(frequency)), np.zeros(len(frequency))
    for time, chosen in parts:
        phase = 2.0 * np.pi * frequency[:, None] * (time - time[0])
        z = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        z -= z.mean(axis=1, keepdims=True)
        n, among = np.count_nonzero(chosen), len(time)
        covariance = np.einsum("fti,ftj->fij", z, z) / among * (n * (among - n) / (among - 1))
        size, axis = np.linalg.eigh(covariance)
        along = np.einsum("fi,fij->fj", z[:, chosen].sum(axis=1), axis)
        seen = size > _SEEN * n * (among - n) / (among - 1)
        total += np.where(seen, along**2 / np.where(seen, size, 1.0), 0.0).sum(axis=1)
        dof += seen.sum(axis=1)
    n_event = sum(int(np.count_nonzero(chosen)) for _, chosen in parts)
    if not dof.any():
        return Periodicity(np.nan, np.nan, n_event)
    p_value = np.where(dof > 0, scipy.stats.chi2.sf(total, np.maximum(dof, 1)), 1.0)
    excess = np.where(dof > 0, (total - dof) / np.sqrt(2.0 * np.maximum(dof, 1)), -np.inf)
    best = int(np.argmax(excess))  # p-values of a strong line all underflow to zero
    return Periodicity(float(frequency[best]), float(min(1.0, p_value[best] * np.count_nonzero(dof))), n_event)
