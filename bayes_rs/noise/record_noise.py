"""What records get from a noise: arrays along the records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray


@dataclass(frozen=True, eq=False)
class RecordNoise:
    """The noise of each of a number of records.

    Parameters
    ----------
    bias : ndarray, shape (n_record, n_beam)
        E[y_b] / (n·R n) − 1 for the ensemble tensor.
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain @ stresses of the record. The design matrix at the record's own yaw, and what the probe volume
        changes in it.
    covariance : ndarray, shape (n_record, n_beam, n_beam)
        Relative covariance K.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speed that the noise is for, m/s: the record's own where states are interpolated, else the nearest
        calibrated one, or the nearest edge of the net.
    yaw : ndarray, shape (n_record,)
        Wind direction relative to the lidar axis that the noise is for, rad.
    state : ndarray of int, shape (n_record,)
        Equal numbers mean equal noise: the number of the nearest state, or where states are interpolated a number of
        the wind speed and direction among those of these records.
    outside : ndarray of bool, shape (n_record,)
        Whether a record is farther from the states than `REACH`, so that the noise of the nearest edge or state, which
        it gets, is not its own.
    negative_part : ndarray, shape (n_record,)
        See `interpolate_covariance`; 0 without interpolation.
    """

    bias: FloatArray
    gain: FloatArray
    covariance: FloatArray
    wind_speed: FloatArray
    yaw: FloatArray
    state: NDArray[np.int64]
    outside: NDArray[np.bool_]
    negative_part: FloatArray

    def take(self, records: slice) -> RecordNoise:
        """Return that of some of the records."""
        return RecordNoise(**{name: values[records] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False)
class SonicNoise:
    """The joint moments of the beams' variances and a sonic's stresses, for each of a number of records.

    Parameters
    ----------
    covariance : ndarray, shape (n_record, 6, 6)
        Covariance of L⁻¹ S L⁻ᵀ, see `Noise`.
    beam_covariance : ndarray, shape (n_record, 6, n_beam)
        Its covariance with the relative variances of the beams.
    state : ndarray of int, shape (n_record,)
        Equal numbers mean equal moments.
    negative_part : ndarray, shape (n_record,)
        See `interpolate_covariance`, for the joint covariance of beams and sonic; 0 without interpolation.
    """

    covariance: FloatArray
    beam_covariance: FloatArray
    state: NDArray[np.int64]
    negative_part: FloatArray
