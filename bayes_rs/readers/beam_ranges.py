"""Which beam a row of a table is of, where beams of one direction have several ranges."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.matching import cells_of_gates, check_metres, facts_of_gates, first_of_direction, nearest_gates
from bayes_rs.readers.unnamed_ranges import listed_ranges

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class BeamRanges:
    """The distances of a file, and the beam that each of them has in each direction of a scan.

    Parameters
    ----------
    scan : Scan
        The scan.
    ranges : ndarray, shape (n_range,)
        Distinct distances along the beam of the file, m, in order.
    cell : ndarray of int, shape (n_range,)
        Which gate each of them is of, since a gate may move a little; −1 if it is none, as one of 0 m.
    gates : ndarray, shape (n_gate,)
        Where the gates are, m: the mean of their distances.
    target : ndarray of int, shape (n_beam, n_gate)
        By the index of a beam that only says the direction: the index of the beam at this gate; −1 if there is none.
    """

    scan: Scan
    ranges: FloatArray
    cell: IntArray
    gates: FloatArray
    target: IntArray

    def facts(self) -> dict[str, Any]:
        """Return what a report says of the file: its gates, those that some beam has, and how far off they are."""
        index, gate = np.nonzero(self.target >= 0)
        wanted = self.scan.focus_distance[self.target[index, gate]]
        return {
            "ranges": self.gates.tolist(),
            "ranges_used": self.gates[np.unique(gate)].tolist(),
            **facts_of_gates(self.scan, self.gates[gate], wanted),
        }

    def beams(self, number: IntArray, distance: FloatArray) -> tuple[IntArray, BoolArray]:
        """Return the beam of each row, and whether it has one.

        Parameters
        ----------
        number : ndarray of int, shape (n,)
            A beam of the scan that looks the same way.
        distance : ndarray, shape (n,)
            Distance along it, m; NaN where the file says none: such rows have no beam.
        """
        order = np.argsort(self.scan.beam, kind="stable")
        index = order[np.minimum(np.searchsorted(self.scan.beam, number, sorter=order), len(order) - 1)]
        there = np.isfinite(distance)
        place = np.minimum(np.searchsorted(self.ranges, np.where(there, distance, 0.0)), len(self.ranges) - 1)
        gate = self.cell[place]
        found = self.target[index, gate]
        fits = there & (gate >= 0) & (found >= 0)
        return np.where(fits, self.scan.beam[found], number), fits


def no_range(file: Path) -> InputError:
    """Return the error to raise for a file that says no range, where R is wanted at several."""
    return InputError(
        f"File {str(file)!r} does not say at which range it was measured, and R is wanted at several: say which column "
        "holds it with columns={'range': 'its heading'} (--column range=HEADING), or leave range and height (--range, "
        "--height) out."
    )


def match_ranges(ranges: FloatArray, scan: Scan, file: Path, file_format: FileFormat) -> BeamRanges:
    """Find the range of a file that each beam of a scan has.

    Parameters
    ----------
    ranges : ndarray, shape (n_range,)
        Distinct distances of the file, m, in order.
    scan : Scan
        The scan.
    file : Path
        For messages.
    file_format : FileFormat
        With ``range_tolerance``; by default half the spacing of the ranges there, or a twentieth of the focus distance
        if there is only one.

    Raises
    ------
    InputError
        If no range is at a distance of the scan, two beams of one direction would have the same range, or the ranges
        cannot be in m.
    """
    heading = file_format.column("range")
    if len(ranges) == 0:
        raise InputError(
            f"File {str(file)!r} has no number in its column {heading!r} of ranges: give another column with "
            "columns={'range': 'its heading'} (--column range=HEADING)."
        )
    there = ranges > 0.0
    cell = np.full(len(ranges), -1, dtype=np.int64)
    cell[there] = cells_of_gates(ranges[there])
    gates = np.round(np.bincount(cell[there], weights=ranges[there]) / np.bincount(cell[there]), 6)
    check_metres(ranges, file)
    gate, good = nearest_gates(gates[np.newaxis], scan.focus_distance, file_format.range_tolerance)
    if not good.any():
        found = listed_ranges(gates if len(gates) else ranges)
        raise InputError(
            f"No row of file {str(file)!r} is at a distance of scan {scan.name!r}: the ranges in column {heading!r} "
            f"are {found} m, and the scan's distances {listed_ranges(np.unique(scan.focus_distance))} "
            "m; give the scan one of the file's as focus_distance (--focus-distance), or a larger range_tolerance "
            "(--range-tolerance)."
        )
    first = first_of_direction(scan)
    target = np.full((scan.n_beam, len(gates)), -1, dtype=np.int64)
    for index in np.flatnonzero(good[0]).tolist():
        along, at = first == first[index], int(gate[0, index])
        other = int(target[index, at])
        if other >= 0:
            raise InputError(
                f"Beams {scan.beam[other]} and {scan.beam[index]} of scan {scan.name!r}, at "
                f"{scan.focus_distance[other]:g} and {scan.focus_distance[index]:g} m, have the same range of file "
                f"{str(file)!r}, {gates[at]:g} m: give focus distances that are further apart, or a smaller "
                "range_tolerance (--range-tolerance)."
            )
        target[along, at] = index
    return BeamRanges(scan, ranges, cell, gates, target)
