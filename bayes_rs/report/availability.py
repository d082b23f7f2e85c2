"""Which beams were there when, as a picture: at most so many rows and columns, with or without times and counts."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.records.availability import expected_samples

MOST_COLUMNS = 168
MOST_ROWS = 50


@dataclass(frozen=True)
class Availability:
    """Shares of usable beams and of samples.

    Parameters
    ----------
    beam : list of str
        Names of the rows: numbers of beams, or first and last of several.
    edges : ndarray, shape (n_column + 1,)
        Where the columns begin, as numbers of records; the last entry is the end.
    share : ndarray, shape (n_row, n_column)
        Samples over the expected ones, at most 1; of records without counts, the share of usable beams.
    usable : ndarray, shape (n_column,)
        Share of the beams of records that are usable.
    of_samples : bool
        Whether `share` is of samples.
    beam_numbers : ndarray, shape (n_beam,)
        Number of each beam.
    beam_usable : ndarray, shape (n_beam,)
        Records in which each beam is usable.
    beam_samples : ndarray, shape (n_beam,)
        Its samples used; NaN if not counted.
    expected : float
        Samples that a full record of a beam holds; NaN if not known.
    """

    beam: list[str]
    edges: NDArray[np.int64]
    share: FloatArray
    usable: FloatArray
    of_samples: bool
    beam_numbers: NDArray[np.int64]
    beam_usable: NDArray[np.int64]
    beam_samples: FloatArray
    expected: float


def make_availability(records: xr.Dataset, per_hour: float | None) -> Availability:
    """Sum up which beams can be used.

    Parameters
    ----------
    records : Dataset
        From `make_records`.
    per_hour : float or None
        Records in an hour, if they have times: many records are put together by whole hours.

    Returns
    -------
    availability : Availability
        In at most `MOST_COLUMNS` columns and `MOST_ROWS` rows.
    """
    usable = records["flag"].transpose("record", "beam").values == 0
    n_record, n_beam = usable.shape
    count = records.get("count")
    expected = expected_samples(records)
    of_samples = count is not None and bool(np.isfinite(expected))
    samples = np.full(usable.shape, np.nan) if count is None else count.transpose("record", "beam").values.astype(float)
    share = np.minimum(samples / expected, 1.0) if of_samples else usable.astype(np.float64)
    edges = _edges(n_record, MOST_COLUMNS, per_hour)
    rows = _edges(n_beam, MOST_ROWS, None)
    in_columns = np.add.reduceat(share, edges[:-1], axis=0) / np.diff(edges)[:, None]
    numbers = records["beam"].values
    return Availability(
        beam=[
            str(numbers[first]) if last == first + 1 else f"{numbers[first]}–{numbers[last - 1]}"
            for first, last in pairwise(rows.tolist())
        ],
        edges=edges,
        share=(np.add.reduceat(in_columns, rows[:-1], axis=1) / np.diff(rows)).T,
        usable=np.add.reduceat(usable.mean(axis=1), edges[:-1]) / np.diff(edges),
        of_samples=of_samples,
        beam_numbers=numbers,
        beam_usable=usable.sum(axis=0),
        beam_samples=samples.sum(axis=0),
        expected=expected,
    )


def _edges(n: int, most: int, per_hour: float | None) -> NDArray[np.int64]:
    size = -(-n // most)
    if size > 1 and per_hour is not None and per_hour > 1.0:
        size = int(-(-size // per_hour) * per_hour)
    return np.append(np.arange(0, n, max(size, 1)), n)
