"""Which beams may be wrong together, and how strongly data ask for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray

_WIDTHS = (2, 3, 5, 8, 12, 16)
"""Numbers of neighbouring places around a cone that make a sector."""
_AXIS = 0.02
"""Beams that are closer to the axis than this, in the sine of the angle, have no place around it."""
_FEWEST = 5
"""Places around a cone from which on neighbours are looked at together."""
_N_NULL = 4000
_NULL_SEED = 15
_NULL_LEVEL = 0.05


@dataclass(frozen=True)
class Patterns:
    """Sets of beams that may be wrong together: each beam by itself, and neighbours around the cone.

    Parameters
    ----------
    matrix : ndarray, shape (n_pattern, n_beam)
        1 for the beams of a pattern, else 0; the first n_beam patterns are the beams, one by one.
    sector : sequence of tuple of float
        From where to where a pattern reaches, degrees from the y axis towards z; (nan, nan) for a beam on the axis.
    """

    matrix: FloatArray
    sector: Sequence[tuple[float, float]]

    def members(self, pattern: int) -> NDArray[np.int64]:
        """Return the places of a pattern's beams among the beams."""
        return np.flatnonzero(self.matrix[pattern])

    def __len__(self) -> int:
        """Return the number of patterns."""
        return len(self.matrix)


def beam_patterns(direction: FloatArray) -> Patterns:
    """Return the patterns of beams with these unit vectors (n_beam, 3), in the frame of the lidar's axis.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.deg2rad([0.0, 90.0, 180.0, 270.0])
    >>> beams = np.stack([-0.8 * np.ones(4), 0.6 * np.cos(angle), 0.6 * np.sin(angle)], axis=1)
    >>> len(beam_patterns(beams))  # four places: no sectors
    4
    """
    n_beam = len(direction)
    aside = np.hypot(direction[:, 1], direction[:, 2]) > _AXIS
    angle = np.round(np.degrees(np.arctan2(direction[:, 2], direction[:, 1])) % 360.0, 1) % 360.0
    places = np.unique(angle[aside])
    rows = list(np.eye(n_beam))
    sector = [(float(angle[b]), float(angle[b])) if aside[b] else (np.nan, np.nan) for b in range(n_beam)]
    if len(places) >= _FEWEST:
        for width in _WIDTHS:
            if width > max(2, len(places) // 3):
                break
            for first in range(len(places)):
                some = places[(first + np.arange(width)) % len(places)]
                rows.append((aside & np.isin(angle, some)).astype(np.float64))
                sector.append((float(some[0]), float(some[-1])))
    return Patterns(np.array(rows), sector)


@dataclass(frozen=True)
class Scores:
    """What some data say against their covariance.

    Parameters
    ----------
    square : ndarray, shape (n_record,)
        zᵀ V⁻¹ z; χ² of `count` degrees of freedom if V is right.
    count : ndarray of int, shape (n_record,)
        Number of data.
    score : ndarray, shape (n_record, n_pattern)
        How many standard deviations the best shift of a pattern's beams is from 0; 0 for patterns without data.
    shift : ndarray, shape (n_record, n_pattern)
        That shift, in the units of the data.
    swap : ndarray, shape (n_record, n_beam, n_beam)
        By how much `square` falls if the data of two beams are exchanged; −inf where one has none.
    """

    square: FloatArray
    count: NDArray[np.int64]
    score: FloatArray
    shift: FloatArray
    swap: FloatArray


def score_patterns(
    residual: FloatArray,
    covariance: FloatArray,
    used: NDArray[np.bool_],
    patterns: Patterns,
    datum: FloatArray,
    precision: FloatArray | None = None,
) -> Scores:
    r"""Return how strongly residuals ask for a shift of each pattern's beams, and for an exchange of two.

    Parameters
    ----------
    residual : ndarray, shape (n_record, n_beam)
        Data minus their expectation; 0 where a beam is not used.
    covariance : ndarray, shape (n_record, n_beam, n_beam)
        Their covariance V.
    used : ndarray of bool, shape (n_record, n_beam)
        Which beams have data.
    patterns : Patterns
        The patterns.
    datum : ndarray, shape (n_record, n_beam)
        The data themselves: what is exchanged.
    precision : ndarray, shape (n_record, n_beam, n_beam), optional
        Inverse of V, where it is known; V must then be zero between used beams and others.

    Returns
    -------
    scores : Scores
        See there.

    Notes
    -----
    For the beams a of a pattern, and P the inverse of V,

    .. math::
        s = \frac{a^T P z}{a^T P a}, \qquad t = \frac{a^T P z}{\sqrt{a^T P a}},

    are the shift of least squares and that over its standard deviation. For one beam, t is its distance from what the
    others predict, in standard deviations of that prediction. χ² falls by t² if the beams of the pattern may be wrong.
    """
    both = used[:, :, None] & used[:, None, :]
    if precision is None:
        whole = np.where(both, covariance, 0.0) + np.eye(used.shape[1]) * np.where(used, 0.0, 1.0)[:, :, None]
        precision = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    inverse = np.where(both, 0.5 * (precision + precision.swapaxes(-1, -2)), 0.0)
    pull = np.einsum("rab,rb->ra", inverse, residual)
    over = pull @ patterns.matrix.T
    weight = np.einsum("rpb,pb->rp", patterns.matrix @ inverse, patterns.matrix)
    with np.errstate(invalid="ignore", divide="ignore"):
        score = np.where(weight > 0.0, over / np.sqrt(weight), 0.0)
        shift = np.where(weight > 0.0, over / weight, 0.0)
    step = datum[:, None, :] - datum[:, :, None]  # what beam a would gain if it had the datum of beam b
    own = np.einsum("raa->ra", inverse)
    change = pull[:, None, :] - pull[:, :, None]
    change *= step
    change *= 2.0
    apart = own[:, :, None] + own[:, None, :]
    apart -= 2.0 * inverse
    apart *= np.square(step, out=step)
    change -= apart
    return Scores(
        np.asarray(np.einsum("rb,rb->r", residual, pull)),
        np.count_nonzero(used, axis=1),
        score,
        shift,
        np.where(both, change, -np.inf),
    )


def independent_patterns(covariance: FloatArray, patterns: Patterns) -> float:
    """Return how many independent scores have the largest of the patterns' scores, for data of this covariance.

    Parameters
    ----------
    covariance : ndarray, shape (n_beam, n_beam)
        Covariance V of data without fault.
    patterns : Patterns
        The patterns.

    Returns
    -------
    count : float
        n such that the largest |t| is above the 95 % quantile of 4000 simulated ones with 1 − (1 − 2 Φ(−t))ⁿ = 5 %.
    """
    if len(patterns) == 1:
        return 1.0
    precision = np.linalg.inv(covariance)
    weight = np.einsum("pb,pb->p", patterns.matrix @ precision, patterns.matrix)
    pull = _normal(len(covariance)) @ np.linalg.cholesky(0.5 * (precision + precision.T)).T
    largest = np.max(np.abs(pull @ patterns.matrix.T) / np.sqrt(weight), axis=1)
    at = float(np.quantile(largest, 1.0 - _NULL_LEVEL))
    return float(np.clip(np.log1p(-_NULL_LEVEL) / np.log1p(-2.0 * scipy.special.ndtr(-at)), 1.0, len(patterns)))


@lru_cache(maxsize=4)
def _normal(number: int) -> FloatArray:
    """Return independent normal numbers, (_N_NULL, number), the same for all covariances."""
    return np.random.default_rng(_NULL_SEED).standard_normal((_N_NULL, number))


def largest_tail(score: FloatArray, count: float) -> FloatArray:
    """Return the probability that the largest of `count` independent |t| is at least so large: 1 − (1 − 2 Φ(−t))ⁿ."""
    return np.asarray(-np.expm1(count * np.log1p(-np.minimum(2.0 * scipy.special.ndtr(-np.abs(score)), 1.0 - 1e-12))))
