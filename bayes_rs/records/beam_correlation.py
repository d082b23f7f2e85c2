"""How the velocities of two beams go together within a record: what variances alone do not say."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.samples import BeamSamples, BoolArray, IntArray

CORRELATION = "beam_correlation"
"""Variable that holds the correlations."""
CORRELATED_BEAMS = "correlated_beams"
"""Attribute of records: the numbers of the beams that the correlations are of."""
MOST_BEAMS = 8
"""Beams whose pairs are correlated: of scans with more, so many that lie far apart."""
_NS = 1e9


def correlated_beams(scan: Scan) -> NDArray[np.int64]:
    """Return the numbers of the beams whose pairs are correlated, in the scan's order.

    Of a scan with many beams they are chosen one after the other, the first nearest to the middle of the points that
    the scan measures, each next one farthest from those before.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> correlated_beams(load_scan("6-beam")), len(correlated_beams(load_scan("50-beam")))
    (array([0, 1, 2, 3, 4, 5]), 8)
    """
    return beams_apart(scan, MOST_BEAMS)


def beams_apart(scan: Scan, n_beam: int) -> NDArray[np.int64]:
    """Return the numbers of so many beams, or of all if there are no more, as `correlated_beams` chooses them."""
    if scan.n_beam <= n_beam:
        return scan.beam
    place = scan.level_direction * scan.focus_distance[:, np.newaxis]
    chosen = [int(np.argmin(np.linalg.norm(place - place.mean(axis=0), axis=-1)))]
    nearest = np.linalg.norm(place - place[chosen[0]], axis=-1)
    while len(chosen) < n_beam:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(place - place[chosen[-1]], axis=-1))
    return np.asarray(scan.beam[np.sort(chosen)])


def pair_columns(wanted: NDArray[np.int64], have: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where the pairs of `wanted` beams stand among the pairs of those that records `have`; −1 if not there."""
    place = {int(number): index for index, number in enumerate(have.tolist())}
    column = np.full((len(have), len(have)), -1)
    first, second = np.triu_indices(len(have), 1)
    column[first, second] = column[second, first] = np.arange(len(first))
    at = np.array([place.get(int(number), -1) for number in wanted.tolist()])
    a, b = (at[side] for side in np.triu_indices(len(wanted), 1))
    return np.asarray(np.where((a >= 0) & (b >= 0), column[a, b], -1))


def beam_correlation(
    samples: BeamSamples, keep: BoolArray, scan: Scan, *, needed: float
) -> tuple[dict[str, Any], Mapping[str, str]]:
    r"""Return the correlations of the velocities of beams in each record, and the attribute that names the beams.

    Parameters
    ----------
    samples : BeamSamples
        All samples.
    keep : ndarray of bool, shape (n_sample,)
        Which of them count.
    scan : Scan
        The scan.
    needed : float
        Samples that a pair needs.

    Returns
    -------
    variables : dict
        ``beam_correlation`` (record, beam_pair): pairs row by row as of `numpy.triu_indices`; NaN where fewer samples
        than needed have a partner.
    attributes : mapping
        ``correlated_beams``.

    Notes
    -----
    Beams are sampled one after the other. A sample of the first beam goes with that of the second which is nearest to
    the scan's own delay after it, within half a scan and in the same record; nothing is interpolated. Of these samples

    .. math:: r_{ab} = \frac{\sum_i (v_{a,i} - \bar v_a)(v_{b,i} - \bar v_b)}
        {\sqrt{\sum_i (v_{a,i} - \bar v_a)^2 \sum_i (v_{b,i} - \bar v_b)^2}} .
    """
    numbers = correlated_beams(scan)
    delay = dict(zip(scan.beam.tolist(), scan.beam_time.tolist(), strict=True))
    own = {int(number): _of_beam(samples, keep, index) for index, number in enumerate(samples.numbers.tolist())}
    first, second = np.triu_indices(len(numbers), 1)
    found = np.full((samples.n_record, len(first)), np.nan)
    half = int(0.5 * scan.scan_duration * _NS)
    for column, (a, b) in enumerate(zip(numbers[first].tolist(), numbers[second].tolist(), strict=True)):
        if a in own and b in own:
            wait = round((delay[b] - delay[a]) * _NS)
            found[:, column] = _correlation(own[a], own[b], wait, half, samples.n_record, needed)
    long_name = "correlation of the velocities of two beams, each sample with the nearest of the other beam's"
    return (
        {CORRELATION: (("record", "beam_pair"), found, {"long_name": long_name})},
        {CORRELATED_BEAMS: json.dumps(numbers.tolist())},
    )


_Own = tuple[IntArray, IntArray, FloatArray]


def _of_beam(samples: BeamSamples, keep: BoolArray, index: int) -> _Own:
    """Return times, records and velocities of the samples of a beam that count."""
    rows = np.flatnonzero(keep & (samples.beam == index))
    return samples.time[rows], samples.group[rows] - index * samples.n_record, samples.velocity[rows]


def _correlation(a: _Own, b: _Own, wait: int, half: int, n_record: int, needed: float) -> FloatArray:
    """Return the correlation of two beams in each record, shape (n_record,)."""
    missing = np.full(n_record, np.nan)
    if len(a[0]) == 0 or len(b[0]) == 0:
        return missing
    due = a[0] + wait
    after = np.minimum(np.searchsorted(b[0], due), len(b[0]) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(b[0][before] - due) < np.abs(b[0][after] - due), before, after)
    pair = (np.abs(b[0][nearest] - due) <= half) & (b[1][nearest] == a[1])
    record, partner = a[1][pair], nearest[pair]
    count = np.bincount(record, minlength=n_record).astype(np.float64)
    # about the first pair of each record, so that a large mean costs no digits
    begins = np.flatnonzero(np.diff(record, prepend=-1))
    length = np.diff(begins, append=len(record))
    off_a, off_b = (values - np.repeat(values[begins], length) for values in (a[2][pair], b[2][partner]))

    def mean(values: FloatArray) -> FloatArray:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.bincount(record, weights=values, minlength=n_record) / count)

    mean_a, mean_b = mean(off_a), mean(off_b)
    of_a, of_b = mean(off_a**2) - mean_a**2, mean(off_b**2) - mean_b**2
    with np.errstate(invalid="ignore", divide="ignore"):
        found = (mean(off_a * off_b) - mean_a * mean_b) / np.sqrt(of_a * of_b)
    return np.where((count >= needed - 1e-9) & np.isfinite(found) & (np.abs(found) < 1.0), found, missing)
