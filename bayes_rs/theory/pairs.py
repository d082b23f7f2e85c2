"""The distinct pairs of a scan's beams: those whose velocities have the same covariance are computed once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan

_SAME = 1e-9  # pairs whose separations (m) and directions agree to this are computed once


class Pairs(NamedTuple):
    """All pairs of beams, row ≤ column, and the distinct ones among them."""

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    distinct: NDArray[np.int64]  # which distinct pair each pair is
    first: FloatArray
    second: FloatArray
    across: FloatArray
    along: FloatArray  # separation of the sampled parcels at the first scan, along the wind
    lengths: FloatArray  # of the two beams' probe volumes, m
    samples: NDArray[np.int64]  # of the first and of the second beam
    own: NDArray[np.bool_]  # a beam with itself


def distinct_pairs(scan: Scan, line_of_sight: FloatArray, count: NDArray[np.int64], wind_speed: float) -> Pairs:
    """Find the distinct pairs: mirror images in the x–z plane are one, and so are shifted copies."""
    row, column = np.triu_indices(scan.n_beam)
    place = line_of_sight * scan.focus_distance[:, np.newaxis]
    place[:, 0] -= wind_speed * scan.beam_time
    apart = place[column] - place[row]
    first, second = line_of_sight[row], line_of_sight[column]
    samples = np.stack([count[row], count[column]], axis=-1)
    mirror = np.where(apart[:, 1] < 0.0, -1.0, 1.0)[:, np.newaxis] * [0.0, 1.0, 0.0] + [1.0, 0.0, 1.0]
    lengths = np.stack([scan.probe_length[row], scan.probe_length[column]], axis=-1)
    own = (row == column)[:, np.newaxis]
    table = np.concatenate([mirror * apart, mirror * first, mirror * second, samples, own, lengths], axis=1)
    _, index, distinct = np.unique(np.round(table / _SAME) + 0.0, axis=0, return_index=True, return_inverse=True)
    return Pairs(
        row=row,
        column=column,
        distinct=distinct.reshape(-1),
        first=table[index, 3:6],
        second=table[index, 6:9],
        across=table[index, 1:3],
        along=table[index, 0],
        lengths=lengths[index],
        samples=samples[index],
        own=(row == column)[index],
    )
