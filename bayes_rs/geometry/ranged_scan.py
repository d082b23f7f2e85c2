"""A scan whose beams measure at several ranges at once, as those of a pulsed lidar do: the same beams at each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_finite
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan

_SAME_HEIGHT = 0.1
"""Share by which the heights of a level's beams may differ from their median, to be called one height."""
_SAME_DIRECTION = 1e-6  # chord; to rounding
_RISES = 0.1
"""Component upwards of the flattest beam from which on a scan looks up: from 6 degrees of elevation on."""


@dataclass(frozen=True)
class RangedScan(Scan):
    """Every beam of a scan at every one of several ranges, in one `Scan`: range after range, beam after beam.

    Readers and records take it as any scan; it knows which of its beams are which beam of the scan at which range.

    Parameters
    ----------
    base : Scan
        The scan; its focus distances do not matter.
    distance : ndarray, shape (n_range, n_beam)
        Distance along each beam at each range, m.
    """

    base: Scan | None = None
    distance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def of(cls, base: Scan, distance: ArrayLike) -> RangedScan:
        """Return the beams of a scan at several ranges.

        Parameters
        ----------
        base : Scan
            The scan, with one focus distance for each direction.
        distance : array_like, shape (n_range, n_beam) or (n_range,)
            Distances along the beams, m, in rising order.

        Raises
        ------
        InputError
            If the scan has beams of one direction, or the distances do not rise.
        """
        given = np.asarray(distance, dtype=np.float64)
        table = np.repeat(given[:, np.newaxis], base.n_beam, axis=1) if given.ndim == 1 else given
        table = check_array(table, (None, base.n_beam), what=f"ranges of scan {base.name!r}")
        if len(table) == 0:
            raise InputError(f"No range of scan {base.name!r} is named: name at least one, in m.")
        if (np.diff(table, axis=0) <= 0.0).any():
            raise InputError(
                f"Invalid ranges {_listed(np.median(table, axis=1))} m of scan {base.name!r}: they must rise, and each "
                "stand once."
            )
        check_one_distance(base)
        table.flags.writeable = False
        offset = np.arange(len(table), dtype=np.int64)[:, np.newaxis] * _step(base)
        n_range = len(table)
        return cls(
            name=base.name,
            beam_direction=np.tile(base.beam_direction, (n_range, 1)),
            focus_distance=table.ravel(),
            beam_time=np.tile(base.beam_time, n_range),
            scan_duration=base.scan_duration,
            beam=(base.beam + offset).ravel(),
            tilt=base.tilt,
            yaw=base.yaw,
            title=base.title,
            source=base.source,
            file_format=base.file_format,
            probe=base.probe,
            base=base,
            distance=table,
        )

    @property
    def of_one(self) -> Scan:
        """The scan whose beams these are."""
        if self.base is None:
            raise RuntimeError("A RangedScan is made with RangedScan.of.")
        return self.base

    @property
    def n_range(self) -> int:
        """Number of ranges."""
        return len(self.distance)

    @property
    def range(self) -> FloatArray:
        """What each range is called, shape (n_range,), m: the median of its beams' distances."""
        return np.asarray(np.median(self.distance, axis=1))

    @property
    def height(self) -> FloatArray | None:
        """Height of each range above the lidar, shape (n_range,), m; None if the scan does not look up."""
        if not looks_up(self.of_one):
            return None
        heights = self.distance * self.of_one.level_direction[:, 2]
        middle = np.median(heights, axis=1)
        same = np.abs(heights - middle[:, np.newaxis]) <= _SAME_HEIGHT * middle[:, np.newaxis]
        return np.asarray(middle) if same.all() else None

    def at(self, index: int) -> Scan:
        """Return the scan at one range, by its place."""
        of_files = {name: value for name, value in self.of_one.file_format.items() if name != "range"}
        return replace(self.of_one, focus_distance=self.distance[index], file_format=of_files)

    def split(self, beam: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the place of the range and the scan's own number of beams that this scan numbers."""
        place = np.argsort(self.beam)[np.searchsorted(np.sort(self.beam), beam)]
        return place // self.of_one.n_beam, self.of_one.beam[place % self.of_one.n_beam]

    def join(self, index: NDArray[np.int64], beam: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return this scan's numbers of beams; the inverse of `split`."""
        return np.asarray(beam + index * _step(self.of_one), dtype=np.int64)

    def names(self) -> list[str]:
        """Return what to call the ranges in words, as ``range 80 m`` or ``height 120 m``."""
        height = self.height
        what, values = ("range", self.range) if height is None else ("height", height)
        return [f"{what} {words} m" for words in short(values)]


def looks_up(scan: Scan) -> bool:
    """Tell whether all beams of a scan rise, so that a height is a distance along each."""
    return bool(scan.level_direction[:, 2].min() >= _RISES)


def distances_at(scan: Scan, height: ArrayLike) -> FloatArray:
    """Return the distances along the beams of a scan at heights above the lidar, shape (n_height, n_beam), m.

    Parameters
    ----------
    scan : Scan
        A scan whose beams rise.
    height : array_like, shape (n_height,)
        Heights h, m.

    Raises
    ------
    InputError
        If a beam does not rise.

    Notes
    -----
    h / sin ε, with the elevation ε of each beam in the levelled frame.
    """
    if not looks_up(scan):
        raise InputError(
            f"Invalid height for scan {scan.name!r}: not all of its beams rise; give range (--range) instead."
        )
    heights = np.array([check_finite(one, what="height", unit="m") for one in np.atleast_1d(height)])
    return np.asarray(heights[:, np.newaxis] / scan.level_direction[:, 2])


def check_one_distance(scan: Scan) -> None:
    """Refuse a scan with several beams of one direction, whose ranges are beams already.

    Raises
    ------
    InputError
        If it has such beams.
    """
    chord = np.linalg.norm(scan.beam_direction[:, np.newaxis] - scan.beam_direction, axis=-1)
    np.fill_diagonal(chord, np.inf)
    if scan.n_beam > 1 and chord.min() < _SAME_DIRECTION:
        raise InputError(
            f"Scan {scan.name!r} has planes, several beams in one direction, which are fitted together: for R at each "
            "range give the scan of one plane, or leave range and height out."
        )


def nearest_range(values: FloatArray, wanted: float, *, what: str = "range") -> int:
    """Return the place of the range, or height, shape (n_range,), m, nearest to a wanted one.

    Raises
    ------
    InputError
        If none is within half the distance to the next, or the wanted one is no number.
    """
    wanted = check_finite(wanted, what=what, unit="m")
    index = int(np.argmin(np.abs(values - wanted)))
    steps = np.abs(np.diff(values))[max(index - 1, 0) : index + 1]
    if np.abs(values[index] - wanted) > (0.5 * steps.max() if len(steps) else 0.05 * wanted) + 1e-6:
        raise InputError(f"No {what} {wanted:g} m: there are {_listed(values)} m.")
    return index


def short(values: FloatArray | Sequence[float]) -> list[str]:
    """Write distances or heights as short as they stay different: to a metre, or with decimals."""
    for digits in range(4):
        words = [f"{value:.{digits}f}" for value in values]
        if len(set(words)) == len(words):
            return words
    return [repr(float(value)) for value in values]


def _step(base: Scan) -> int:
    """Return what the numbers of beams grow by from range to range: a power of ten beyond all of them."""
    most = int(np.abs(base.beam).max())
    return int(10 ** len(str(2 * most + 1)))


def _listed(values: FloatArray | Any) -> str:
    words = short(np.asarray(values))
    return ", ".join(words) if len(words) <= 12 else f"{', '.join(words[:6])} … {words[-1]}"
