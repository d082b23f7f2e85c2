"""The autocovariance of a beam's radial velocity in Mann turbulence, for many length scales at once."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.probe import Probe
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.turbulence.mann import MannTurbulence


def scaled_autocovariance(
    line_of_sight: FloatArray,
    lag_distance: FloatArray,
    length_scale: FloatArray,
    *,
    gamma: float,
    probe: Probe,
    probe_length: float,
    tolerance: float = 1e-4,
) -> FloatArray:
    """Return the autocovariances of one beam's radial velocity for several length scales.

    Parameters
    ----------
    line_of_sight : ndarray, shape (3,)
        Unit vector n in the mean-wind frame.
    lag_distance : ndarray, shape (n_lag,)
        Uτ, m, not below zero: frozen turbulence.
    length_scale : ndarray, shape (n_scale,)
        L, m.
    gamma : float
        Anisotropy parameter Γ.
    probe : Probe
        Probe volume of the beam.
    probe_length : float
        Its length, m; 0 for a point.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.

    Returns
    -------
    covariance : ndarray, shape (n_scale, n_lag)
        ∫ n·Φ(k) n |H(k·n)|² cos(k₁Uτ) d³k, over αε^(2/3) L^(2/3).

    Notes
    -----
    Everything is scaled with L, so that one call of `probed_covariance` at L = 1 serves all length scales.
    """
    n_scale = len(length_scale)
    rows = np.broadcast_to(line_of_sight, (n_scale, 3))
    lengths = np.broadcast_to((probe_length / length_scale)[:, np.newaxis], (n_scale, 2))
    return probed_covariance(
        np.ascontiguousarray(rows),
        np.ascontiguousarray(rows),
        np.zeros((n_scale, 2)),
        -lag_distance / length_scale[:, np.newaxis],
        MannTurbulence(dissipation=1.0, length_scale=1.0, gamma=gamma),
        probe=probe,
        lengths=np.ascontiguousarray(lengths),
        tolerance=tolerance,
    )
