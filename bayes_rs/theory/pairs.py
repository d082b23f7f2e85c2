"""The distinct pairs of a scan's beams: those whose velocities have the same covariance are computed once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.sizes import check_size, check_work

_SEED = 11
_SAME = 1e-9  # pairs whose separations (m) and directions agree to this are computed once


_BYTES_A_PAIR, _BYTES_A_LAG, _BYTES_AN_ENTRY = 600.0, 200.0, 40.0
_SECONDS_A_LAG, _SECONDS_A_PAIR, _SECONDS_A_PROBED_PAIR = 2e-7, 1.2e-5, 3e-4
FEW = 40
"""Distinct pairs: for fewer, no shortcut is worth its checks."""
_MOST_PROBED = 1000.0  # pairs of beams with probe volumes: from these, others are interpolated


def seconds_of_pairs(scan: Scan, n_sample: float) -> float:
    """Estimate the time that the covariances of all pairs of a scan's beams take, s, with the shortcuts for many."""
    n_pair = scan.n_beam * (scan.n_beam + 1) / 2.0
    of_probes = _SECONDS_A_PROBED_PAIR * min(n_pair, _MOST_PROBED) if np.any(scan.probe_length > 0.0) else 0.0
    of_one = 2.0 * n_sample * _SECONDS_A_LAG
    if n_pair < FEW:
        return float(n_pair * of_one + of_probes)
    return float(scan.n_beam * of_one + n_pair * min(of_one, _SECONDS_A_PAIR) + of_probes)


def check_pairs(scan: Scan, n_sample: float) -> None:
    """Refuse a scan and a number of samples of each beam whose covariances no memory holds, or no one waits for.

    Raises
    ------
    InputError
        If the lags of one pair of beams, or the pairs, are too many.
    """
    n_pair = scan.n_beam * (scan.n_beam + 1) / 2.0
    n_byte = n_pair * _BYTES_A_PAIR + 2.0 * n_sample * _BYTES_A_LAG + float(scan.n_beam) ** 2 * _BYTES_AN_ENTRY
    what = f"The covariances of {scan.n_beam} beams with {n_sample:.4g} samples each, of scan {scan.name!r},"
    advice = "choose a shorter duration, a longer scan_duration or fewer beams."
    check_size(what, n_byte, advice)
    check_work(what, seconds_of_pairs(scan, n_sample), advice)


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
    _, index, distinct = np.unique(fingerprints(table), return_index=True, return_inverse=True)
    order = np.argsort(index)  # as they come: the same at all wind speeds, as far as the same pairs are distinct
    index, distinct = index[order], np.argsort(order)[distinct.reshape(-1)]
    return Pairs(
        row=row,
        column=column,
        distinct=distinct,
        first=table[index, 3:6],
        second=table[index, 6:9],
        across=table[index, 1:3],
        along=table[index, 0],
        lengths=lengths[index],
        samples=samples[index],
        own=(row == column)[index],
    )


def fingerprints(table: FloatArray) -> NDArray[np.uint64]:
    """Return a number for each row, the same for rows that agree to 1e-9; others share one once in 10¹⁹ pairs.

    Parameters
    ----------
    table : ndarray, shape (n, n_column)
        Of numbers below 10⁹.

    Returns
    -------
    mark : ndarray of uint64, shape (n,)
        The numbers.
    """
    whole = np.round(table / _SAME).astype(np.int64).view(np.uint64)
    odd = 2 * np.random.default_rng(_SEED).integers(0, 2**63, whole.shape[1], dtype=np.uint64) + 1
    factors = np.asarray(odd, dtype=np.uint64)
    mixed = np.zeros(len(whole), dtype=np.uint64)
    for column, factor in zip(whole.T, factors, strict=True):
        mixed = (mixed ^ (column * factor)) * factor
        mixed ^= mixed >> np.uint64(29)
    return mixed
