"""Which records share a mean: bins of wind speed and groups, and how alike the bins are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_items, as_numbers
from bayes_rs.errors import InputError

LOG_LENGTH = 1.0
"""Over this distance in ln U sizes stay alike."""
BIN_WIDTH = 1.0
"""Width of a bin of wind speed, m/s."""


def speed_bin(wind_speed: FloatArray) -> NDArray[np.int64]:
    """Return the number of the bin of each wind speed: bin k is centred at k times `BIN_WIDTH`."""
    return np.floor(wind_speed / BIN_WIDTH + 0.5).astype(np.int64)


def bin_speed(number: NDArray[np.int64]) -> FloatArray:
    """Return the wind speed, m/s, that stands for each bin: its centre, and that of its upper half for bin 0."""
    return np.maximum(number, 0.25) * BIN_WIDTH


def size_correlation(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the correlation of sizes at wind speeds (n,) and (m,), m/s, shape (n, m): a Matérn 3/2 kernel of ln U."""
    distance = np.sqrt(3.0) / LOG_LENGTH * np.abs(np.log(one)[:, None] - np.log(other)[None, :])
    return np.asarray((1.0 + distance) * np.exp(-distance))


@dataclass(frozen=True, eq=False)
class Cells:
    """The bins and groups of a campaign's records.

    Parameters
    ----------
    of_record : ndarray of int, shape (n_record,)
        Cell, a bin in a group, of each record.
    bin_of, group_of : ndarray of int, shape (n_cell,)
        Place of the bin and of the group of each cell.
    count : ndarray, shape (n_cell,)
        Number of records of each cell.
    speed : ndarray, shape (n_bin,)
        Wind speed of each bin, m/s.
    kernel_root : ndarray, shape (n_bin, n_bin)
        Cholesky factor of the correlation of the sizes between the bins.
    names : tuple of str
        Names of the groups.
    """

    of_record: NDArray[np.int64]
    bin_of: NDArray[np.int64]
    group_of: NDArray[np.int64]
    count: FloatArray
    speed: FloatArray
    kernel_root: FloatArray
    names: tuple[str, ...]

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """Where each cell begins among records that are sorted by cells."""
        return np.concatenate([[0], np.cumsum(self.count)[:-1]]).astype(np.int64)

    @cached_property
    def in_bin(self) -> FloatArray:
        """Which cells are in which bin, shape (n_bin, n_cell), 0 or 1."""
        return np.asarray(np.arange(self.n_bin)[:, None] == self.bin_of, dtype=np.float64)

    @cached_property
    def in_group(self) -> FloatArray:
        """Which cells are in which group, shape (n_group, n_cell), 0 or 1."""
        return np.asarray(np.arange(self.n_group)[:, None] == self.group_of, dtype=np.float64)

    @cached_property
    def both_count(self) -> FloatArray:
        """Number of records of each group in each bin, shape (n_group, n_bin)."""
        return np.asarray((self.in_group * self.count) @ self.in_bin.T)

    def order(self) -> NDArray[np.int64]:
        """Return what sorts the records by cells."""
        return np.argsort(self.of_record, kind="stable").astype(np.int64)

    def in_order(self) -> Cells:
        """Return the cells of records that are sorted by cells."""
        return replace(self, of_record=self.of_record[self.order()])

    @property
    def n_record(self) -> int:
        """Number of records."""
        return len(self.of_record)

    @property
    def n_bin(self) -> int:
        """Number of bins of wind speed that hold records."""
        return len(self.speed)

    @property
    def n_group(self) -> int:
        """Number of groups."""
        return len(self.names)


def make_cells(wind_speed: FloatArray, group: Sequence[object] | None = None) -> Cells:
    """Sort records into cells.

    Parameters
    ----------
    wind_speed : ndarray, shape (n_record,)
        Wind speeds, m/s.
    group : sequence of n_record, optional
        Groups.

    Returns
    -------
    cells : Cells
        The cells.

    Raises
    ------
    InputError
        If a wind speed is not above zero, or there is not a group for each record.
    """
    speed = as_numbers(wind_speed, what="wind_speed")
    bad = np.flatnonzero(~(np.isfinite(speed) & (speed > 0.0)))
    if len(bad):
        raise InputError(
            f"Invalid wind speed {speed[bad[0]]} m/s of record {bad[0]} of the campaign: it must be above zero; leave "
            "such records out of the campaign."
        )
    labels = [""] * len(speed) if group is None else [str(one) for one in as_items(group, what="group")]
    if len(labels) != len(speed):
        raise InputError(f"Invalid group of {len(labels)} entries: there must be one for each of {len(speed)} records.")
    number, bin_of = np.unique(speed_bin(speed), return_inverse=True)
    names, group_of = np.unique(np.array(labels, dtype=np.str_), return_inverse=True)
    cell, first, of_record, count = np.unique(
        bin_of * len(names) + group_of, return_index=True, return_inverse=True, return_counts=True
    )
    del cell
    centre = bin_speed(number)
    return Cells(
        of_record=of_record.astype(np.int64),
        bin_of=bin_of[first].astype(np.int64),
        group_of=group_of[first].astype(np.int64),
        count=count.astype(np.float64),
        speed=centre,
        kernel_root=np.asarray(np.linalg.cholesky(size_correlation(centre, centre)), dtype=np.float64),
        names=tuple(str(name) for name in names),
    )
