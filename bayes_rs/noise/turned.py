"""Scans that a turn about the vertical maps onto themselves, as the cone of a profiler: their noise is turned, too."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs.geometry.scan import Scan, yaw_matrix
from bayes_rs.noise.noise import Noise

_FEWEST = 6  # beams: of fewer, a state is cheap
_SAME = 1e-7  # of direction, and of times and distances relative to the largest


class Turn(NamedTuple):
    """A turn of the wind that only permutes the beams of a scan.

    Attributes
    ----------
    step_deg : float
        The turn, degrees.
    order : ndarray of int, shape (n_beam,)
        The beam that sees the wind before the turn as each beam sees it after it.
    """

    step_deg: float
    order: NDArray[np.int64]

    def split(self, yaw_deg: float) -> tuple[float, int]:
        """Return the direction from 0 up to the step that stands for `yaw_deg`, and by how many steps it is turned."""
        steps = int(np.floor(yaw_deg / self.step_deg + 1e-7))
        return max(yaw_deg - steps * self.step_deg, 0.0), steps

    def apply(self, noise: Noise, steps: int, yaw_deg: float) -> Noise:
        """Return the noise of a state for the wind turned by a number of steps, which is then from `yaw_deg`."""
        of = np.arange(len(self.order))
        for _ in range(steps % len(self.order)):
            of = self.order[of]
        across = noise.sonic_beam_covariance
        return replace(
            noise,
            yaw=np.full(len(noise), np.deg2rad(yaw_deg)),
            bias=noise.bias[:, of],
            gain=noise.gain[:, of],
            covariance=noise.covariance[:, of][:, :, of],
            sonic_beam_covariance=None if across is None else across[:, :, of],
        )


def find_turn(scan: Scan) -> Turn | None:
    """Return the turn of the wind by one part in `n_beam` of the circle, if it only permutes the beams.

    Parameters
    ----------
    scan : Scan
        The scan.

    Returns
    -------
    turn : Turn or None
        None for fewer than six beams, and where directions, distances or times say otherwise.

    Notes
    -----
    Times may be shifted by a constant, modulo the scan's duration. Pairs that the turn moves over the end of a scan
    then have one sample more or less in common: K changes by about one part in the number of samples.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> round(find_turn(load_scan("zx-300", focus_distance=103.5)).step_deg, 9)
    7.2
    >>> find_turn(load_scan("zx-tm")) is None
    True
    """
    n, direction, time = scan.n_beam, scan.level_direction, scan.beam_time
    if n < _FEWEST or np.ptp(scan.focus_distance) > _SAME * np.max(scan.focus_distance):
        return None
    turned = direction @ yaw_matrix(2.0 * np.pi / n)
    apart = np.linalg.norm(turned[:, np.newaxis] - direction, axis=-1)
    order = np.argmin(apart, axis=1).astype(np.int64)
    if np.max(np.min(apart, axis=1)) > _SAME or len(np.unique(order)) != n:
        return None
    later = (time[order] - time - (time[order[0]] - time[0])) / scan.scan_duration
    if np.max(np.abs(later - np.round(later))) > _SAME:
        return None
    return Turn(360.0 / n, order)
