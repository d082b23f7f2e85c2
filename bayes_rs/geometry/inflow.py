"""Stresses that change over the scanned area: where the beams measure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray

GRADIENT_LENGTH = 100.0
"""Gradients are changes of ln R over this distance, m."""
GRADIENTS = {"lateral_gradient": 1, "vertical_gradient": 2}
"""The gradients by name, and the axis of the lidar's frame along which each is."""


def gradient_columns(scan_geometry: Mapping[str, Any], names: Sequence[str] = tuple(GRADIENTS)) -> FloatArray:
    """Return where the beams measure along each gradient, from the middle of the scan's points.

    Parameters
    ----------
    scan_geometry : mapping
        What `Scan.geometry` returns.
    names : sequence of str
        Of `GRADIENTS`.

    Returns
    -------
    columns : ndarray, shape (n_beam, n_gradient)
        Distances, m, in the levelled frame of the lidar: along +y across its axis, and upwards. The middle is the mean
        of the points of all beams; a scan that is symmetric about its axis has it there.
    """
    direction = np.asarray(scan_geometry["direction"], dtype=np.float64)
    point = direction * np.asarray(scan_geometry["focus_distance"], dtype=np.float64)[:, None]
    return np.asarray((point - point.mean(axis=0))[:, [GRADIENTS[name] for name in names]])
