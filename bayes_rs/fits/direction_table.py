"""What a result learned along each direction of R: those that the beams see, and those that they cannot see."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.forward import RANK_TOLERANCE, design_matrix
from bayes_rs.geometry.scan import Scan, yaw_matrix
from bayes_rs.geometry.stress import STRESSES, rotate_stress

_NAMED = 0.25
"""Share of the largest coefficient from which on a stress is named in a direction."""
_TOGETHER = 8
"""Records whose draws are looked at together: they stay in the cache."""
COLUMNS = ("record", "direction", "weight", "seen", "contraction", "contraction_shape", *STRESSES)


def scan_directions(scan: Scan) -> tuple[FloatArray, FloatArray]:
    """Return the weights, shape (6,), and the directions of R, shape (6, 6), one a row, of a scan's beams."""
    _, singular, vectors = np.linalg.svd(design_matrix(scan.at_yaw(0.0)), full_matrices=True)
    weight = np.zeros(len(STRESSES))
    weight[: len(singular)] = singular / singular[0]
    weight[weight <= RANK_TOLERANCE] = 0.0
    # the sign of a singular vector means nothing: the largest entry is made positive
    return weight, vectors * np.sign(np.take_along_axis(vectors, np.abs(vectors).argmax(axis=1)[:, None], axis=1))


def direction_rows(
    record: NDArray[Any], weight: FloatArray, vectors: FloatArray, contraction: FloatArray, of_shape: FloatArray
) -> pd.DataFrame:
    """Lay contractions (n_record, 6) along the directions of R out as the table of `Fit.directions`."""
    rows = pd.DataFrame(
        {
            "record": np.repeat(record, len(STRESSES)),
            "direction": np.tile(np.arange(len(STRESSES)), len(record)),
            "weight": np.tile(weight, len(record)),
            "contraction": contraction.ravel(),
            "contraction_shape": of_shape.ravel(),
            **dict(zip(STRESSES, np.tile(vectors.T, len(record)), strict=True)),
        }
    )
    return rows.assign(seen=rows["weight"] > 0.0)[list(COLUMNS)]


def direction_medians(
    weight: FloatArray, vectors: FloatArray, contraction: FloatArray, of_shape: FloatArray
) -> pd.DataFrame:
    """Return the table of the median record: a row for each direction, in their order; NaN if none was fitted."""
    medians = (median_of_known(values)[np.newaxis] for values in (contraction, of_shape))
    rows = direction_rows(np.zeros(1, dtype=np.int64), weight, vectors, *medians)
    return rows.drop(columns=["record", "direction", "seen"])


def median_of_known(values: FloatArray) -> FloatArray:
    """Return the median of the numbers of each column (n_record, n); NaN where a column has none."""
    found = [column[np.isfinite(column)] for column in values.T]
    return np.array([np.median(column) if len(column) else np.nan for column in found])


def prior_covariances(draws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariances, each (6, 6), of draws of a prior (n, 6) and of their shape."""
    return np.cov(draws, rowvar=False, bias=True), np.cov(_shape(draws), rowvar=False, bias=True)


def contraction_along(
    vectors: FloatArray,
    covariances: tuple[FloatArray, FloatArray],
    yaw: FloatArray,
    of_prior: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return the contractions of R and of its shape along directions of R.

    Parameters
    ----------
    vectors : ndarray, shape (6, 6)
        The directions, one a row, in the lidar's frame.
    covariances : tuple of ndarray, shape (n_record, 6, 6)
        Those of draws in the frame of each record's wind, and of their shape, from `covariances_of`.
    yaw : ndarray, shape (n_record,)
        Wind directions relative to the lidar's axis, rad.
    of_prior : tuple of ndarray, shape (6, 6)
        From `prior_covariances`.

    Returns
    -------
    contraction, of_shape : ndarray, shape (n_record, 6)
        As in `Fit.directions`.
    """
    back = rotate_stress(np.eye(len(STRESSES)), yaw_matrix(-np.where(np.isfinite(yaw), yaw, 0.0))[:, None])
    along = vectors @ back.swapaxes(-1, -2)  # d in the mean-wind frame: (record, direction, 6)
    found = []
    for covariance, prior in zip(covariances, of_prior, strict=True):
        spread = [((along @ matrix) * along).sum(axis=-1) for matrix in (covariance, prior)]
        found.append(np.asarray(1.0 - spread[0] / spread[1]))
    return found[0], found[1]


def covariances_of(draws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariances, each (n_record, 6, 6), of draws of R (n_record, n_draw, 6), and of their shape."""
    parts = [draws[first : first + _TOGETHER] for first in range(0, len(draws), _TOGETHER)]
    found = [(covariance_of(some), covariance_of(_shape(some))) for some in parts]
    return tuple(np.concatenate(matrices) for matrices in zip(*found, strict=True))  # type: ignore[return-value] # two


def covariance_of(draws: FloatArray, ddof: int = 0) -> FloatArray:
    """Return the covariances, shape (n_record, n, n), of draws (n_record, n_draw, n)."""
    components = draws.swapaxes(-1, -2)
    centred = components - components.mean(axis=-1, keepdims=True)
    return np.asarray(centred @ centred.swapaxes(-1, -2) / (draws.shape[1] - ddof))


def direction_words(direction: FloatArray) -> str:
    """Write a direction as a sum of stresses, entries below a twentieth of the largest left out.

    Parameters
    ----------
    direction : ndarray, shape (6,)
        Coefficients.

    Returns
    -------
    words : str
        Such as ``"0.98 uu − 0.12 vv"``.

    Examples
    --------
    >>> direction_words(np.array([0.9, -0.4, 0.01, 0.0, 0.0, 0.0]))
    '0.90 uu − 0.40 vv'
    """
    terms: list[str] = []
    for value, name in zip(direction, STRESSES, strict=True):
        if abs(value) >= 0.05 * np.abs(direction).max():
            sign = "− " if value < 0.0 else "+ " if terms else ""
            terms.append(f"{sign}{abs(value):.2f} {name}")
    return " ".join(terms)


def direction_name(direction: FloatArray) -> str:
    """Name a direction by the stresses that it is made of.

    Parameters
    ----------
    direction : ndarray, shape (6,)
        Coefficients.

    Returns
    -------
    name : str
        Stresses whose coefficient is at least `_NAMED` of the largest: those of its sign, against the others.

    Examples
    --------
    >>> direction_name(np.array([-0.04, 0.71, -0.70, 0.0, 0.0, 0.0]))
    'vv against ww'
    >>> direction_name(np.array([0.5, 0.6, 0.6, 0.0, 0.0, 0.0]))
    'uu, vv and ww together'
    """
    largest = direction[np.abs(direction).argmax()]
    share = direction / largest
    one, other = (
        [name for name, value in zip(STRESSES, sign * share, strict=True) if value >= _NAMED] for sign in (1, -1)
    )
    if not other:
        return one[0] if len(one) == 1 else f"{_joined(one)} together"
    return f"{_joined(one)} against {_joined(other)}"


def _joined(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _shape(stress: FloatArray) -> FloatArray:
    return np.asarray(stress / (stress[..., :1] + stress[..., 1:2] + stress[..., 2:3]))
