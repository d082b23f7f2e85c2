"""Sectors of angles, as of azimuth, rotor position or wind direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.quality.samples import BoolArray

Sector = tuple[float, float]


def in_sectors(angle_deg: FloatArray, sectors: Sequence[Sector]) -> BoolArray:
    """Say which angles lie in any of the sectors.

    Parameters
    ----------
    angle_deg : ndarray
        Angles, degrees, of any turn; NaN lies in no sector.
    sectors : sequence of (first, last)
        From `first` upwards to `last`, degrees, ends included: (350, 10) holds 0. The whole circle if the two are 360
        or more apart.

    Returns
    -------
    inside : ndarray of bool, of the shape of `angle_deg`
        Whether any sector holds the angle.
    """
    inside = np.zeros(np.shape(angle_deg), dtype=bool)
    for first, last in sectors:
        width = 360.0 if last - first >= 360.0 else (last - first) % 360.0
        inside |= (angle_deg - first) % 360.0 <= width
    return inside
