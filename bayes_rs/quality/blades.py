"""Blade passages: what a nacelle lidar behind the rotor sees when a blade crosses its beam."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.quality.samples import BoolArray, IntArray
from bayes_rs.quality.spikes import is_far, running_median


def is_blade_passage(velocity: FloatArray, group: IntArray, *, window: int, threshold: float) -> BoolArray:
    """Find samples that a blade pulled towards zero: |v| < |m| and |v − m| > k · 1.4826 · MAD.

    Parameters
    ----------
    velocity : ndarray, shape (n_sample,)
        Finite radial velocities, m/s, beam after beam and each in time's order.
    group : ndarray of int, shape (n_sample,)
        Record and beam of each sample, as one number.
    window : int
        Number of samples of the running median m, odd; a blade must cover less than half of them.
    threshold : float
        k.

    Returns
    -------
    passage : ndarray of bool, shape (n_sample,)
        Which samples a blade is taken to have spoilt.

    Notes
    -----
    As the rule for spikes, on one side only: along the beam a blade moves more slowly than the wind.
    """
    median = running_median(velocity, group, window=window)
    far = is_far(np.abs(velocity - median), group, threshold=threshold)
    return np.asarray(far & (np.abs(velocity) < np.abs(median)))
