"""The noise of a many-beam scan, reduced to what the six stresses can move before it is interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.inflow import GRADIENT_LENGTH, gradient_columns
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.likelihoods.base import REFERENCE_STRESS, seen_directions
from bayes_rs.noise.noise import Noise
from bayes_rs.turbulence.interpolation import combine

LEAST_BEAMS = 16
"""Scans with fewer beams are not reduced beforehand: their covariances are small."""
_POINTS = 1e-7
"""Gains that differ by less from those of points are points: directions in noise files have nine digits."""


@dataclass(frozen=True)
class ReducedRecordNoise:
    """The reduced noise of some records.

    Parameters
    ----------
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain · stresses.
    bias : ndarray, shape (n_record, n_beam)
        E[y]/(n·R n) − 1 for the ensemble tensor.
    covariance : ndarray, shape (n_record, n_seen, n_seen)
        Uᵀ C U with C = ln(1 + K).
    log_variance : ndarray, shape (n_record, n_beam)
        diag C.
    outside : ndarray of bool, shape (n_record,)
        Whether the noise does not reach to the record.
    """

    gain: FloatArray
    bias: FloatArray
    covariance: FloatArray
    log_variance: FloatArray
    outside: NDArray[np.bool_]

    def take(self, records: slice) -> ReducedRecordNoise:
        """Return that of some of the records."""
        return ReducedRecordNoise(**{name: values[records] for name, values in vars(self).items()})


class ReducedNoise:
    """Noise whose covariances are reduced to a few directions in the space of the beams.

    Parameters
    ----------
    bank : Noise
        Noise whose states form a net, of beams that see points.
    gradients : sequence of str
        Gradients of R that may move the data besides; see `gradient_columns`.

    Attributes
    ----------
    left : ndarray, shape (n_beam, n_seen)
        U, an orthonormal basis of the column space of ∂ ln E[y]/∂R at a reference tensor in the lidar's frame. Turning
        the wind turns R and leaves this space as it is, so that one basis serves all records. So it is with the
        gradients, whose directions are the lidar's.

    Notes
    -----
    The data of a record are Uᵀ ln y, and need no more of C = ln(1 + K) than Uᵀ C U and diag C. Those are interpolated:
    the logarithms of the trace and of the variances, and the matrix over its trace. At the noise's states they are
    exact; between them the error is that of the interpolation, as it is for whole covariances.
    """

    def __init__(self, bank: Noise, gradients: tuple[str, ...] = ()) -> None:
        self.bank = bank
        self.direction = np.asarray(bank.scan_geometry["direction"], dtype=np.float64)
        level = design_matrix(self.direction)
        moved = level / (level @ REFERENCE_STRESS)[:, None]
        if gradients:
            columns = gradient_columns(bank.scan_geometry, gradients)
            moved = np.concatenate([moved, columns / GRADIENT_LENGTH], axis=-1)
        left, seen = seen_directions(moved[None])
        self.left: FloatArray = np.ascontiguousarray(left[0][:, seen[0]])
        logarithm = np.log1p(bank.covariance)
        reduced = np.stack([self.left.T @ matrix @ self.left for matrix in logarithm])
        trace = np.einsum("sii->s", reduced)
        self._log_trace: FloatArray = np.log(trace)
        self._shape: FloatArray = reduced / trace[:, None, None]
        self._log_diagonal: FloatArray = np.log(np.einsum("sbb->sb", logarithm))
        self._bias: FloatArray = bank.bias

    @staticmethod
    def suits(bank: Noise) -> bool:
        """Tell whether noise can be reduced: that of many points, in a net. Records must use every beam besides."""
        return (
            bank.net is not None and bank.n_beam >= LEAST_BEAMS and float(np.max(np.abs(bank.probe_change()))) < _POINTS
        )

    def for_records(self, wind_speed: ArrayLike, yaw: ArrayLike, **flow: ArrayLike) -> ReducedRecordNoise:
        """Return the reduced noise of records; as `Noise.for_records`."""
        weights, angle, outside = self.bank.weights_for(wind_speed, yaw, **flow)
        scale = np.exp(combine(weights, self._log_trace))
        return ReducedRecordNoise(
            gain=design_matrix(self.direction @ yaw_matrix(angle)),
            bias=combine(weights, self._bias),
            covariance=combine(weights, self._shape) * scale[:, None, None],
            log_variance=np.exp(combine(weights, self._log_diagonal)),
            outside=outside,
        )


@lru_cache(maxsize=2)
def reduced(bank: Noise, gradients: tuple[str, ...] = ()) -> ReducedNoise:
    """Return the reduced noise; that of the same noise and gradients is made once."""
    return ReducedNoise(bank, gradients)
