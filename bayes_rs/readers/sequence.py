"""Rays of a pattern that crosses itself: which beam a ray is, by where it points and when in the scan."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.matching import SINGLE_GATE_SHARE, directions_in_words
from bayes_rs.readers.rays import Rays
from bayes_rs.readers.samples import Samples

TIME_SHARE = 0.05
"""Share of a scan by which a ray may be early or late."""

_NEAREST = 12  # beams looked at for each ray and plane; a rosette's middle has seven within a degree


def match_sequence(
    rays: Rays, scan: Scan, *, angle_tolerance_deg: float = 1.0, range_tolerance: float | None = None
) -> Samples:
    """Give each ray to the beam that it looks along at its place in the scan.

    Parameters
    ----------
    rays : Rays
        The rays of one file, with one gate each, in the order of time.
    scan : Scan
        The scan, whose beams may cross: what tells them apart is `beam_time`.
    angle_tolerance_deg : float
        Largest angle between a ray and its beam, degrees.
    range_tolerance : float, optional
        Largest difference between the gate and the beam's focus distance, m; a twentieth of it if not given.

    Returns
    -------
    samples : Samples
        One sample for each ray with a beam. The others are dropped, and counted as ``rows_without_beam``.

    Raises
    ------
    InputError
        If no ray has a beam.

    Notes
    -----
    When scans start is not in the file. It follows from the rays themselves: with b the nearest beam of ray i, the
    phase of t_i − t_b within a scan is the same for all rays but those near a crossing. Its running circular mean
    over one scan is the start of the scan. Among the beams within both tolerances, the one with the smallest sum of
    squares of angle and time, each in units of its tolerance, is the ray's.
    """
    n_ray = len(rays.time)
    known = np.flatnonzero(np.isfinite(rays.direction).all(axis=1) & ~np.isnat(rays.time))
    chosen = np.full(n_ray, -1, dtype=np.int64)
    n_plane = max(1, len(np.unique(scan.focus_distance)))
    n_near = min(len(scan.beam), _NEAREST * n_plane)
    if len(known):
        found = scipy.spatial.cKDTree(scan.beam_direction).query(rays.direction[known], k=list(range(1, n_near + 1)))
        chord, near = np.asarray(found[0]), np.asarray(found[1])
        angle = np.rad2deg(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))
        off = np.abs(rays.distance[known] - scan.focus_distance[near])
        allowed = SINGLE_GATE_SHARE * scan.focus_distance[near] if range_tolerance is None else range_tolerance
        fits = (angle <= angle_tolerance_deg) & (off <= allowed)
        late = (rays.time[known] - rays.time[known[0]]) / np.timedelta64(1, "s")
        phase = late[:, np.newaxis] / scan.scan_duration - scan.beam_time[near] / scan.scan_duration
        best = np.argmax(fits, axis=1)  # the nearest that fits: they come in order
        start = _running_phase(phase[np.arange(len(known)), best], np.asarray(fits.any(axis=1)), len(scan.beam))
        early = (phase - start[:, np.newaxis] + 0.5) % 1.0 - 0.5
        fits &= np.abs(early) <= TIME_SHARE
        has = np.flatnonzero(fits.any(axis=1))
        misfit = np.where(fits, (angle / angle_tolerance_deg) ** 2 + (early / TIME_SHARE) ** 2, np.inf)
        chosen[known[has]] = near[has, np.argmin(misfit, axis=1)[has]]
    keep = chosen >= 0
    if n_ray and not keep.any():
        raise InputError(
            f"No ray of file {str(rays.file)!r} is within {angle_tolerance_deg:g} degrees of a beam of scan "
            f"{scan.name!r} and at its distance: the file's directions (azimuth, elevation) are "
            f"{directions_in_words(rays.direction)}, its distances from {np.nanmin(rays.distance):g} to "
            f"{np.nanmax(rays.distance):g} m; give the scan that the file was measured with."
        )
    no_time = np.isnat(rays.time)
    return Samples(
        file=rays.file,
        kind=rays.kind,
        file_format=rays.file_format,
        time=rays.time[keep],
        beam=scan.beam[chosen[keep]],
        radial_velocity=rays.radial_velocity[keep, 0],
        cnr=None if rays.cnr is None else rays.cnr[keep, 0],
        status=None if rays.status is None else rays.status[keep, 0],
        row=rays.row[keep],
        row_word=rays.row_word,
        counts={
            **rays.counts,
            "rows_dropped": rays.counts.get("rows_dropped", 0) + int((~keep).sum()),
            "rows_without_time": rays.counts.get("rows_without_time", 0) + int(no_time.sum()),
            "rows_without_beam": rays.counts.get("rows_without_beam", 0) + int((~keep & ~no_time).sum()),
        },
        facts=rays.facts,
    )


def _running_phase(phase: FloatArray, counts: NDArray[np.bool_], length: int) -> FloatArray:
    """Return the running circular mean of `phase`, in turns, over `length` entries about each."""
    turning = np.where(counts, np.exp(2j * np.pi * phase), 0.0)
    total = np.concatenate([[0.0], np.cumsum(turning)])
    middle = np.arange(len(phase))
    low = np.maximum(middle - length // 2, 0)
    high = np.minimum(middle + length // 2 + 1, len(phase))
    mean: FloatArray = np.angle(total[high] - total[low]) / (2.0 * np.pi)
    return mean
