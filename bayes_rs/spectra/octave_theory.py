"""The octaves of a record's variance as Mann turbulence gives them: expectations for any L, wind and direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.probe import PointProbe
from bayes_rs.geometry.scan import Scan, ScanByKey
from bayes_rs.processor import one_thread
from bayes_rs.quality.octaves import octave_count
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.theory.sampling_times import samples_that_fit
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.two_point import radial_covariance

LENGTHS = (4.0, 1000.0)
"""Length scales that are considered, m."""
LOG_STEP = 0.2
"""Step of the nodes of ln L."""
MOST_BEAMS = 6
"""Beams that are looked at, evenly chosen: neighbours tell little more."""
_SPEEDS = (1.0, 50.0)  # m/s
_STEP = 0.15  # of ln(U/L) in the table
_LAG_STEP = 0.06  # of the distances at which covariances are calculated, in asinh(distance/core)
_CORE = 0.02  # of L; below, covariances are interpolated as evenly as at it
_YAW_STEP = 20.0  # degrees
_PROBE_STEP = 0.4  # of ln U, for scans with a probe volume


def length_nodes() -> FloatArray:
    """Return the nodes of ln L."""
    first, last = np.log(LENGTHS)
    return np.asarray(np.linspace(first, last, int(np.ceil((last - first) / LOG_STEP)) + 1))


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of a record's samples at each level of halving.

    Parameters
    ----------
    sizes : tuple of ndarray of int
        Samples in each filled block, for each level from the whole record on.
    n_sample : int
        Samples in a full record.
    """

    sizes: tuple[NDArray[np.int64], ...]
    n_sample: int

    @classmethod
    def of(cls, n_sample: int, interval: float, begin: float, duration: float) -> Blocks:
        """Return those of a beam that is sampled at even times."""
        n_octave = octave_count(duration / interval)
        place = (begin + interval * np.arange(n_sample)) / duration
        sizes = []
        for level in range(n_octave):
            size = np.bincount(np.minimum((place * 2**level).astype(np.int64), 2**level - 1))
            sizes.append(size[size > 0])
        return cls(tuple(sizes), n_sample)

    @property
    def n_octave(self) -> int:
        """Number of octaves."""
        return len(self.sizes)

    def weights(self) -> FloatArray:
        """Return how the lags 1, 2, … weigh in the mean covariance within blocks, shape (n_octave, n_sample − 1)."""
        lag = np.arange(1, self.n_sample)
        found = np.zeros((self.n_octave, len(lag)))
        for level, sizes in enumerate(self.sizes):
            size, many = np.unique(sizes, return_counts=True)
            for n, times in zip(size.tolist(), many.tolist(), strict=True):
                found[level, : n - 1] += times * 2.0 * (n - lag[: n - 1]) / n
            found[level] /= max(self.n_sample - len(sizes), 1)
        return found

    def filled(self, share: FloatArray) -> FloatArray:
        """Return how many blocks hold a sample where a share of the samples is there, shape (…, n_octave + 1).

        Which are there is random. The last entry counts the samples.
        """
        share = np.asarray(share, dtype=np.float64)
        found = np.empty((*share.shape, self.n_octave + 1))
        for level, sizes in enumerate(self.sizes):
            size, many = np.unique(sizes, return_counts=True)
            found[..., level] = np.sum(many * (1.0 - (1.0 - share[..., np.newaxis]) ** size), axis=-1)
        found[..., -1] = share * self.n_sample
        return found


class ProbeTable(NamedTuple):
    """The mean correlation within blocks of beams with a probe volume.

    Parameters
    ----------
    values : ndarray, shape (n_beam, n_yaw, n_length, n_speed, n_octave)
        The correlations.
    yaws : ndarray, shape (n_yaw,)
        Their directions, rad.
    log_speeds : ndarray, shape (n_speed,)
        Their ln U.
    """

    values: FloatArray
    yaws: FloatArray
    log_speeds: FloatArray

    def at(self, log_speed: FloatArray, yaw: FloatArray) -> FloatArray:
        """Return the correlations of records, shape (n_record, n_beam, n_length, n_octave)."""
        low, part = _between(self.yaws, np.angle(np.exp(1j * yaw)))
        near, share = _between(self.log_speeds, log_speed)
        found = np.zeros((len(yaw), *np.take(self.values[:, 0], 0, axis=2).shape))
        for i, a in ((0, 1.0 - part), (1, part)):
            for j, b in ((0, 1.0 - share), (1, share)):
                found += (a * b)[:, None, None, None] * np.moveaxis(self.values, (1, 3), (0, 1))[low + i, near + j]
        return found


@dataclass(frozen=True, eq=False)
class OctaveTheory:
    """The expected octaves of some beams of a scan.

    Parameters
    ----------
    scan : Scan
        The beams.
    blocks : Blocks
        Their samples.
    gamma : float
        Anisotropy Γ.
    point : scipy.interpolate.CubicSpline
        Mean covariance within blocks of uu, vv, ww and uw by ln(U/L), relative to Σ of these at one point.
    at_zero : ndarray, shape (4,)
        The covariances at one point.
    probed : ProbeTable, optional
        The mean correlation within blocks of beams with a probe volume.
    """

    scan: Scan
    blocks: Blocks
    gamma: float
    point: scipy.interpolate.CubicSpline
    at_zero: FloatArray
    probed: ProbeTable | None = None

    def correlation(self, wind_speed: FloatArray, yaw: FloatArray) -> FloatArray:
        """Return the mean correlation within blocks, shape (n_record, n_beam, n_length, n_octave).

        Parameters
        ----------
        wind_speed : ndarray, shape (n_record,)
            Mean wind speeds, m/s.
        yaw : ndarray, shape (n_record,)
            Directions relative to the lidar axis, rad.
        """
        speed = np.log(np.clip(wind_speed, *_SPEEDS))
        if self.probed is not None:
            return self.probed.at(speed, yaw)
        parts = self.point(speed[:, np.newaxis] - length_nodes())  # (n_record, n_length, 4, n_octave)
        line = np.stack([self.scan.at_yaw(float(angle)) for angle in yaw]) if len(yaw) else np.empty((0, 0, 3))
        weight = _weights(line)
        total = weight @ self.at_zero
        return np.asarray(np.einsum("rbc,rnco->rbno", weight / total[..., np.newaxis], parts, optimize=True))

    def expected(self, correlation: FloatArray, filled: FloatArray) -> FloatArray:
        """Return the expected octaves of unit variance, shape (…, n_octave).

        Parameters
        ----------
        correlation : ndarray, shape (…, n_octave)
            From `correlation`.
        filled : ndarray, shape (…, n_octave + 1)
            From `Blocks.filled`.

        Notes
        -----
        E S_l = M_l c(0) + (N − M_l) c̄_l with M_l filled blocks, whatever samples are missing at random.
        """
        n_sample = filled[..., -1:]
        apart = np.concatenate([(n_sample - filled[..., :-1]) * correlation, 0.0 * correlation[..., :1]], axis=-1)
        return np.asarray(np.diff(filled + apart, axis=-1) / n_sample)


def _weights(line: FloatArray) -> FloatArray:
    """Return how uu, vv, ww and uw weigh in a radial variance along the wind, where uv and vw vanish."""
    return np.stack([line[..., 0] ** 2, line[..., 1] ** 2, line[..., 2] ** 2, 2 * line[..., 0] * line[..., 2]], axis=-1)


def _between(axis: FloatArray, at: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the node below and the share of the one above, of points that are moved onto the axis."""
    inside = np.clip(at, axis[0], axis[-1])
    low = np.clip(np.searchsorted(axis, inside, side="right") - 1, 0, len(axis) - 2)
    return low, (inside - axis[low]) / (axis[low + 1] - axis[low])


def chosen_beams(n_beam: int, most: int = MOST_BEAMS) -> NDArray[np.int64]:
    """Return the places of the beams that are looked at."""
    return np.unique(np.round(np.linspace(0, n_beam - 1, min(most, n_beam))).astype(np.int64))


def octave_theory(
    scan: Scan, duration: float = 600.0, gamma: float = 3.2, *, yaw: Sequence[float] = (-np.pi, np.pi)
) -> OctaveTheory:
    """Return the expected octaves of all beams of a scan.

    Parameters
    ----------
    scan : Scan
        The beams, all with the same times between samples.
    duration : float
        Length of a record, s.
    gamma : float
        Anisotropy Γ.
    yaw : sequence of float
        Lowest and highest direction relative to the lidar axis that is asked for, rad; matters with a probe volume.

    Returns
    -------
    theory : OctaveTheory
        Kept for the next call.

    Notes
    -----
    By Taylor's hypothesis the autocovariance of a point along n is n·C(Uτ)n, and depends on U/L only: one table of uu,
    vv, ww and uw serves all beams, winds and directions. With a probe volume there is a table for each beam.
    """
    ends = np.zeros(2) if isinstance(scan.probe, PointProbe) else np.rad2deg(yaw) / _YAW_STEP
    first, last = int(np.floor(min(ends) + 1e-9)), int(np.ceil(max(ends) - 1e-9))
    return _theory(ScanByKey.of(scan), float(duration), float(gamma), first, max(last, first + 1))


@lru_cache(maxsize=8)
@one_thread()  # what is kept must not depend on who asked for it first
def _theory(by_key: ScanByKey, duration: float, gamma: float, first: int, last: int) -> OctaveTheory:
    scan = by_key.scan
    interval, begin = scan.scan_duration, float(scan.beam_time[0])
    n_sample = int(samples_that_fit(duration - begin, interval))
    blocks, point, at_zero = _points(n_sample, interval, begin, duration, gamma)
    if isinstance(scan.probe, PointProbe):
        return OctaveTheory(scan, blocks, gamma, point, at_zero)
    lag = interval * np.arange(1, n_sample)
    yaws = np.deg2rad(_YAW_STEP * np.arange(first, last + 1))
    slowest, fastest = np.log(_SPEEDS)
    speeds = np.linspace(slowest, fastest, int(np.ceil((fastest - slowest) / _PROBE_STEP)) + 1)
    probed = _probed(scan, np.asarray(lag), blocks.weights(), gamma, yaws, speeds)
    return OctaveTheory(scan, blocks, gamma, point, at_zero, ProbeTable(probed, yaws, speeds))


@lru_cache(maxsize=8)
@one_thread()  # what is kept must not depend on who asked for it first
def _points(
    n_sample: int, interval: float, begin: float, duration: float, gamma: float
) -> tuple[Blocks, scipy.interpolate.CubicSpline, FloatArray]:
    """Return the blocks of a beam's samples, and the table of uu, vv, ww and uw: the same for all points."""
    blocks = Blocks.of(n_sample, interval, begin, duration)
    weights = blocks.weights()
    lag = interval * np.arange(1, n_sample)
    axes = np.eye(3)[[0, 1, 2, 0]], np.eye(3)[[0, 1, 2, 2]]
    shortest, longest = np.log(_SPEEDS[0] / LENGTHS[1]), np.log(_SPEEDS[1] / LENGTHS[0])
    node = np.linspace(shortest, longest, int(np.ceil((longest - shortest) / _STEP)) + 1)
    place = np.arange(0.0, np.arcsinh(np.exp(longest) * lag[-1] / _CORE) + 2.0 * _LAG_STEP, _LAG_STEP)
    unit = MannTurbulence(dissipation=1.0, length_scale=1.0, gamma=gamma)
    along = np.broadcast_to(-_CORE * np.sinh(place), (4, len(place)))
    between = scipy.interpolate.CubicSpline(place, radial_covariance(*axes, np.zeros((4, 2)), along, unit), axis=1)
    table = np.stack([between(np.arcsinh(np.exp(x) * lag / _CORE)) @ weights.T for x in node])
    return blocks, scipy.interpolate.CubicSpline(node, table), np.asarray(between(0.0))


def _probed(
    scan: Scan, lag: FloatArray, weights: FloatArray, gamma: float, yaws: FloatArray, log_speeds: FloatArray
) -> FloatArray:
    """Return the mean correlation within blocks of beams with probe volumes."""
    nodes = length_nodes()
    some = np.linspace(nodes[0], nodes[-1], len(nodes) // 3 + 1)
    core = 1.0  # m
    place = np.linspace(0.0, np.arcsinh(np.exp(log_speeds[-1]) * lag[-1] / core) + 0.1, 40)
    found = np.empty((scan.n_beam, len(yaws), len(some), len(log_speeds), len(weights)))
    for y, yaw in enumerate(yaws):
        line = scan.at_yaw(float(yaw))
        for b in range(scan.n_beam):
            near = scaled_autocovariance(
                line[b],
                core * np.sinh(place),
                np.exp(some),
                gamma=gamma,
                probe=scan.probe,
                probe_length=float(scan.probe_length[b]),
            )
            spline = scipy.interpolate.CubicSpline(place, near / near[:, :1], axis=1)
            for s, log_speed in enumerate(log_speeds):
                found[b, y, :, s] = spline(np.arcsinh(np.exp(log_speed) * lag / core)) @ weights.T
    return np.asarray(scipy.interpolate.CubicSpline(some, found, axis=2)(nodes))
