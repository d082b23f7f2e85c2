"""The mean wind of records from the means of their beams, and what the beams could not see of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.records.flags import RECORD_FLAGS
from bayes_rs.records.least_squares import horizontal_wind


def wind_of_beams(
    mean: FloatArray, valid: NDArray[np.bool_], scan: Scan
) -> tuple[FloatArray, FloatArray, NDArray[np.uint8]]:
    """Return the wind of each record, from the means of the valid beams.

    Parameters
    ----------
    mean : ndarray, shape (n_record, n_beam)
        Means of the beams, m/s.
    valid : ndarray of bool, shape (n_record, n_beam)
        Which of them to use.
    scan : Scan
        The scan of these beams.

    Returns
    -------
    wind_speed, yaw : ndarray, shape (n_record,)
        m/s, and degrees.
    flag : ndarray of uint8, shape (n_record,)
        `RECORD_FLAGS`.
    """
    wind = horizontal_wind(mean, valid, scan.level_direction, scan.yaw)
    usable_beam = valid.any(axis=1)
    flag = (
        RECORD_FLAGS["beam_flagged"] * ~valid.all(axis=1)
        + RECORD_FLAGS["no_usable_beam"] * ~usable_beam
        + RECORD_FLAGS["yaw_not_seen"] * (usable_beam & ~wind.yaw_seen)
        + RECORD_FLAGS["wind_not_seen"] * ~wind.wind_seen
    ).astype(np.uint8)
    return wind.speed, np.degrees(wind.yaw), flag
