"""Points of a Student-t that fill space evenly, shared by all records and turned for each by rotations of its own."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, ndtri

from bayes_rs._validation import FloatArray
from bayes_rs.even_points import even_points
from bayes_rs.posteriors.proposal import DEGREES_OF_FREEDOM, StudentProposal
from bayes_rs.posteriors.sampling.streams import RecordStreams


@lru_cache(maxsize=64)
def student_points(n_set: int, k: int, size: int, *key: int) -> tuple[FloatArray, FloatArray]:
    """Return scrambled Sobol points of a standard Student-t, each set scrambled independently.

    Parameters
    ----------
    n_set : int
        Number of sets.
    k : int
        Dimensions.
    size : int
        Points of a set.
    *key : int
        What the scrambling is drawn from: the seed of the fit, and what tells these points from others.

    Returns
    -------
    point : ndarray, shape (n_set, k, size)
        Points.
    square : ndarray, shape (n_set, size)
        Their squared distances from the origin, which no rotation changes.
    """
    point, square = np.empty((n_set, k, size)), np.empty((n_set, size))
    for index, entropy in enumerate(np.random.SeedSequence([*key, n_set, k, size]).spawn(n_set)):
        uniform = even_points(size, k + 1, np.random.default_rng(entropy))
        chi_square = 2.0 * gammaincinv(0.5 * DEGREES_OF_FREEDOM, uniform[:, k])
        point[index] = (ndtri(uniform[:, :k]) * np.sqrt(DEGREES_OF_FREEDOM / chi_square)[:, None]).T
        square[index] = np.sum(point[index] ** 2, axis=0)
    point.setflags(write=False)
    square.setflags(write=False)
    return point, square


def rotations(streams: RecordStreams, records: NDArray[np.int64], n_set: int, k: int) -> FloatArray:
    """Draw uniform rotations (and reflections) for some records, shape (n_record, n_set, k, k).

    Gram–Schmidt on normal numbers, for all records at once; each row is a unit vector.
    """
    row = streams.normal(records, (n_set, k, k)).reshape(-1, k, k)
    for index in range(k):
        unit = row[:, index]
        unit /= np.sqrt(np.einsum("nj,nj->n", unit, unit))[:, None]
        rest = row[:, index + 1 :]
        rest -= np.einsum("nij,nj->ni", rest, unit)[:, :, None] * unit[:, None, :]
    return row.reshape(len(records), n_set, k, k)


def placed(proposal: StudentProposal, rotation: FloatArray, point: FloatArray) -> FloatArray:
    """Turn points into draws of each record's proposal.

    Parameters
    ----------
    proposal : StudentProposal
        Of n_record records.
    rotation : ndarray, shape (n_record, n_set, k, k)
        From `rotations`.
    point : ndarray, shape (n_set, k, size)
        From `student_points`.

    Returns
    -------
    coordinate : ndarray, shape (n_record, k, n_set, size)
        Draws: in memory, each coordinate is a run of numbers.
    """
    n_set, k, size = point.shape
    coordinate = np.empty((len(rotation), k, n_set, size))
    np.matmul(proposal.root[:, None] @ rotation, point, out=coordinate.swapaxes(1, 2))
    coordinate += proposal.mode[:, :, None, None]
    return coordinate


def draws_last(coordinate: FloatArray) -> FloatArray:
    """Return (n_record, k, …, n) coordinates as (n_record, n_draw, k), the shape that densities take; nothing moves."""
    return coordinate.reshape(*coordinate.shape[:2], -1).swapaxes(1, 2)
