"""What the parts of a record tell of it: winds that show fronts and trends, and how much its variance scatters."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.samples import BeamSamples, BoolArray
from bayes_rs.records.least_squares import horizontal_wind

MOST_BEAMS = 8
"""Beams that the statistics are made of: of scans with more, these are spread evenly over their numbers."""
BLOCKS = (4, 8, 16)
"""Numbers of blocks of a record whose variances are compared."""
_PARTS = (64, 32, 16)
_LEAST_OF_PART = {64: 2.0, 32: 3.0, 16: 1.0}  # samples of a beam in a part
_LEAST_OF_BLOCK = 4.0  # samples of a beam in a block: fewer have no variance to speak of
_MISSING = 0.15  # share of a beam's parts that may be empty, to be filled from those beside them
_NS = 1e9


def n_part(scan: Scan, duration: float) -> int:
    """Return into how many parts a record of `duration` seconds is cut; 0 if its samples are too few."""
    samples = duration / scan.scan_duration
    return next((number for number in _PARTS if samples / number >= _LEAST_OF_PART[number] - 1e-9), 0)


def blocks_of(scan: Scan, duration: float) -> tuple[int, ...]:
    """Return the numbers of blocks whose variances a record's samples allow to compare."""
    return (
        tuple(number for number in BLOCKS if duration / scan.scan_duration / number >= _LEAST_OF_BLOCK - 1e-9)
        if n_part(scan, duration)
        else ()
    )


def chosen_beams(scan: Scan) -> Scan:
    """Return the scan of the beams that the statistics are made of."""
    if scan.n_beam <= MOST_BEAMS:
        return scan
    index = np.linspace(0, scan.n_beam, MOST_BEAMS, endpoint=False).astype(np.int64)
    return scan.select(scan.beam[index])


def wind_weights(scan: Scan, used: BoolArray) -> tuple[FloatArray, bool]:
    """Return the weights that make the horizontal wind of the beams in use, and whether these see its direction.

    Parameters
    ----------
    scan : Scan
        Of the chosen beams.
    used : ndarray of bool, shape (n_beam,)
        Which of them to use.

    Returns
    -------
    weights : ndarray, shape (2, n_beam)
        (U_L, V_L) = weights @ radial velocities, in the levelled frame of the lidar. Where the direction is not seen,
        the first row gives the speed along the scan's own yaw, and the second is zero.
    sees_direction : bool
        Whether it is seen.
    """
    found = horizontal_wind(np.zeros((1, scan.n_beam)), used[None], scan.level_direction, scan.yaw)
    return found.estimator[0], bool(found.yaw_seen[0])


def block_statistics(
    samples: BeamSamples, keep: BoolArray, scan: Scan, *, window: int, used: BoolArray
) -> dict[str, Any]:
    r"""Return the statistics of the parts of records, as variables of an xarray.Dataset.

    Parameters
    ----------
    samples : BeamSamples
        All samples.
    keep : ndarray of bool, shape (n_sample,)
        Which of them count.
    scan : Scan
        The whole scan.
    window : int
        Length of a record, ns.
    used : ndarray of bool, shape (n_record, n_beam)
        The beams without a flag, of those that the samples hold.

    Returns
    -------
    variables : dict
        ``part_beams`` (record), bits of the chosen beams in use; ``part_wind`` and ``part_wind_across`` (record, part),
        m/s, the wind of each part in the levelled frame of the lidar; ``block_scatter`` and ``block_scatter_of_beams``
        (record, blocks). NaN where a record does not tell; empty if a scan has too few samples for any.

    Notes
    -----
    With s²_bj the variance of beam b in block j of M about that block's own mean,

    .. math:: q_j = \frac{1}{B} \sum_b \frac{s^2_{bj}}{\tfrac1M \sum_i s^2_{bi}} ,

    ``block_scatter`` is the variance of ln q_j over the blocks, with the divisor M − 1, and ``block_scatter_of_beams``
    the mean over the beams of that of ln s²_bj. Both are sums over the samples of a record, made once for parts and put
    together for blocks.
    """
    duration = window / _NS
    number, blocks = n_part(scan, duration), blocks_of(scan, duration)
    if number == 0:
        return {}
    chosen = chosen_beams(scan)
    sums = _sums(samples, keep, chosen, window, number)
    place = {int(beam): index for index, beam in enumerate(samples.numbers.tolist())}
    own = np.zeros(sums.number.shape[:2], dtype=bool)
    for index, beam in enumerate(chosen.beam.tolist()):
        if beam in place:
            own[:, index] = used[:, place[beam]]
    own &= (sums.number == 0).mean(axis=-1) <= _MISSING
    bits = (own * (1 << np.arange(chosen.n_beam))).sum(axis=1)
    wind = _winds(_filled(sums, own), own, chosen)
    both, of_beams = _scatters(sums, own, blocks)
    words = "variance over a record's blocks of the logarithm of their variances"
    blocks_words = "numbers of blocks: " + ", ".join(str(of) for of in BLOCKS)
    level = "m s-1"
    return {
        "part_beams": ("record", bits.astype(np.int16), {"long_name": "bits of the beams that the parts are of"}),
        "part_wind": (
            ("record", "part"),
            wind[:, 0],
            {"units": level, "long_name": "wind of a part of the record, x of the levelled lidar frame"},
        ),
        "part_wind_across": (
            ("record", "part"),
            wind[:, 1],
            {"units": level, "long_name": "wind of a part of the record, y of the levelled lidar frame"},
        ),
        "block_scatter": (
            ("record", "blocks"),
            both,
            {"long_name": f"{words}, mean of the beams", "comment": blocks_words},
        ),
        "block_scatter_of_beams": (
            ("record", "blocks"),
            of_beams,
            {"long_name": f"{words}, beam by beam, mean over the beams", "comment": blocks_words},
        ),
    }


class _Sums(NamedTuple):
    """Sums over the samples of each part, (n_record, n_beam, n_part), about the first sample of each record and beam.

    A large mean costs no digits so.
    """

    number: FloatArray
    first: FloatArray
    square: FloatArray
    start: FloatArray


def _sums(samples: BeamSamples, keep: BoolArray, chosen: Scan, window: int, number: int) -> _Sums:
    """Return the sums of all parts, of the chosen beams."""
    of_beam = np.full(len(samples.numbers), -1)
    for index, beam in enumerate(samples.numbers.tolist()):
        found = np.flatnonzero(chosen.beam == beam)
        if len(found):
            of_beam[index] = found[0]
    column = of_beam[samples.beam]
    which = keep & (column >= 0)
    group, value, column = samples.group[which], samples.velocity[which], column[which]
    begins = np.flatnonzero(np.diff(group, prepend=-1))
    off = value - np.repeat(value[begins], np.diff(begins, append=len(group)))
    record = group - samples.beam[which] * samples.n_record
    cell = (record * chosen.n_beam + column) * number + (samples.time[which] % window) * number // window
    shape = (samples.n_record, chosen.n_beam, number)
    start = np.zeros(shape[:2])
    start[record[begins], column[begins]] = value[begins]

    def summed(weights: FloatArray | None) -> FloatArray:
        return np.bincount(cell, weights=weights, minlength=int(np.prod(shape))).astype(np.float64).reshape(shape)

    return _Sums(summed(None), summed(off), summed(off * off), start)


def _filled(sums: _Sums, own: BoolArray) -> FloatArray:
    """Return the means of the parts, shape (n_record, n_beam, n_part); empty ones lie on the line between others."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.asarray(sums.start[..., None] + sums.first / sums.number)
    number = np.arange(mean.shape[-1])
    for record, beam in np.argwhere(own & (sums.number == 0).any(axis=-1)):
        there = sums.number[record, beam] > 0
        mean[record, beam] = np.interp(number, number[there], mean[record, beam, there])
    return mean


def _winds(mean: FloatArray, own: BoolArray, chosen: Scan) -> FloatArray:
    """Return the winds of the parts in the levelled frame, shape (n_record, 2, n_part); NaN where none is seen."""
    wind = np.full((len(mean), 2, mean.shape[-1]), np.nan)
    patterns, of = np.unique(own, axis=0, return_inverse=True)
    for index, pattern in enumerate(patterns):
        weights, sees_direction = wind_weights(chosen, pattern)
        rows = np.flatnonzero(of.ravel() == index)
        if np.any(weights[0]):
            wind[rows, 0] = np.einsum("b,rbp->rp", weights[0, pattern], mean[rows][:, pattern])
        if sees_direction:
            wind[rows, 1] = np.einsum("b,rbp->rp", weights[1, pattern], mean[rows][:, pattern])
    return np.where(np.isfinite(wind), wind, np.nan)


def _scatters(sums: _Sums, own: BoolArray, blocks: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Return both scatters, each (n_record, len(BLOCKS)); NaN where a block of a beam has no variance."""
    n_record, n_beam, number = sums.number.shape
    both, of_beams = np.full((n_record, len(BLOCKS)), np.nan), np.full((n_record, len(BLOCKS)), np.nan)
    n_own = own.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        for column, n_block in enumerate(BLOCKS):
            if n_block not in blocks:
                continue
            count, first, square = (
                values.reshape(n_record, n_beam, n_block, number // n_block).sum(axis=-1)
                for values in (sums.number, sums.first, sums.square)
            )
            variance = np.where(own[..., None], square / count - (first / count) ** 2, 1.0)
            variance = np.where(variance > 0.0, variance, np.nan)
            relative = np.where(own[..., None], variance / variance.mean(axis=-1, keepdims=True), 0.0)
            both[:, column] = np.log(relative.sum(axis=1) / n_own[:, None]).var(axis=-1, ddof=1)
            of_beams[:, column] = np.where(own, np.log(variance).var(axis=-1, ddof=1), 0.0).sum(axis=1) / n_own
    # one kind of NaN, whatever the way to it, so that records are the same bit by bit in any company
    return np.where(np.isfinite(both), both, np.nan), np.where(np.isfinite(of_beams), of_beams, np.nan)
