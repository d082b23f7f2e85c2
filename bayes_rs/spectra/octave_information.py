"""How much less the octaves of a record tell of L than independent ones would: beams see the same eddies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.processor import one_thread
from bayes_rs.spectra.octave_theory import Blocks, OctaveTheory, length_nodes
from bayes_rs.theory.pairs import distinct_pairs
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.two_point import radial_covariance

_MOST_SAMPLES = 128
_SCALES = np.log([8.0, 30.0, 110.0, 400.0])
_SPEEDS = np.log([4.0, 16.0])
_CORE, _LAG_STEP = 0.05, 0.2  # of L, and of the separations along the wind in asinh(separation / core)
_NOISE = 0.02  # share of instrument noise at which the information is that of the table
_NOISE_SD = 0.05
_FEW = 0.4  # the few differences of the coarsest octaves tell less than the linearisation says; measured, see the docs


@dataclass(frozen=True, eq=False)
class Information:
    """The power of the likelihood by ln L and ln U.

    Parameters
    ----------
    ratio : ndarray, shape (n_length, n_speed)
        By what the log-likelihood of independent octaves and beams is to be multiplied.
    """

    ratio: FloatArray

    def at(self, log_length: FloatArray, wind_speed: FloatArray) -> FloatArray:
        """Return the power at L and U of records, shape (n_record,), by interpolation of its logarithm."""
        table = np.log(self.ratio)
        found = np.zeros(len(log_length))
        for i, a in _shares(_SCALES, log_length):
            for j, b in _shares(_SPEEDS, np.log(wind_speed)):
                found += a * b * table[i, j]
        return np.asarray(np.exp(found))


def _shares(axis: FloatArray, at: FloatArray) -> list[tuple[NDArray[np.int64], FloatArray]]:
    inside = np.clip(at, axis[0], axis[-1])
    low = np.clip(np.searchsorted(axis, inside, side="right") - 1, 0, len(axis) - 2)
    part = (inside - axis[low]) / (axis[low + 1] - axis[low])
    return [(low, 1.0 - part), (low + 1, part)]


def octave_information(theory: OctaveTheory, duration: float) -> Information:
    r"""Return the power of the likelihood of a scan's octaves.

    Parameters
    ----------
    theory : OctaveTheory
        The expected octaves of the beams.
    duration : float
        Length of a record, s.

    Returns
    -------
    information : Information
        Kept for the next call.

    Notes
    -----
    For octaves e of expectation μ with ν_l = 2^{l−1} differences each, the likelihood Σ ν/2 (−ln μ − e/μ) claims the
    information H on (ln A_b, ln L, noise); the truth is the sandwich H⁻¹ J H⁻¹ with J from the covariance of the
    octaves. With P_l the averaging over the blocks of level l, those of beams a and b have

    .. math:: Cov[e_{al}, e_{bm}] = 2 ‖(P_l − P_{l-1}) C_{ab} (P_m − P_{m-1})‖^2_F / (N_a N_b)

    in Gaussian turbulence (Isserlis). The power is the claimed variance of ln L over the true one, times 0.4
    for what the linearisation overstates, at zero yaw, and with point-like beams: a probe volume changes the finest
    octaves only, which tell little of L.

    Records of more than 128 samples of a beam are thinned for this: what the beams share is in the coarse octaves.
    """
    return _information(_Kept(theory, duration))


class _Kept:
    def __init__(self, theory: OctaveTheory, duration: float) -> None:
        self.theory, self.duration = theory, duration

    def __hash__(self) -> int:
        return id(self.theory)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kept) and self.theory is other.theory and self.duration == other.duration


@lru_cache(maxsize=8)
@one_thread()  # what is kept must not depend on who asked for it first
def _information(kept: _Kept) -> Information:
    theory, duration = kept.theory, kept.duration
    scan = theory.scan
    thin = int(np.ceil(theory.blocks.n_sample / _MOST_SAMPLES))
    interval = scan.scan_duration * thin
    n_sample = theory.blocks.n_sample // thin
    blocks = Blocks.of(n_sample, interval, float(scan.beam_time[0]), duration)
    ratio = np.empty((len(_SCALES), len(_SPEEDS)))
    for i, log_length in enumerate(_SCALES):
        between = _Space(scan, float(np.exp(log_length)), theory.gamma, float(np.exp(_SPEEDS[-1])) * 1.1 * duration)
        for j, log_speed in enumerate(_SPEEDS):
            ratio[i, j] = _ratio(theory, blocks, interval, between, float(np.exp(log_speed)))
    return Information(ratio)


class _Space:
    """The covariances of the beams' velocities by their separation along the wind, each distinct pair once."""

    def __init__(self, scan: Scan, length_scale: float, gamma: float, reach: float) -> None:
        self.length_scale = length_scale
        line = scan.at_yaw(scan.yaw)
        self.pairs = distinct_pairs(scan, line, np.ones(scan.n_beam, dtype=np.int64), 0.0)  # where they look, not when
        self.core = _CORE * length_scale
        half = int(np.ceil(np.arcsinh(reach / self.core) / _LAG_STEP))
        self.place = _LAG_STEP * np.arange(-half, half + 1)
        unit = MannTurbulence(dissipation=1.0, length_scale=length_scale, gamma=gamma)
        of = self.pairs
        along = np.broadcast_to(self.core * np.sinh(self.place), (len(of.first), len(self.place)))
        covariance = radial_covariance(of.first, of.second, of.across, along, unit)
        self.between = scipy.interpolate.CubicSpline(self.place, covariance, axis=1)
        own = np.zeros((scan.n_beam, 2))
        self.variance = radial_covariance(line, line, own, own[:, :1], unit)[:, 0]

    def at(self, which: int, apart: NDArray[np.floating[Any]]) -> FloatArray:
        """Return the covariances of a distinct pair at separations along the wind, m."""
        return np.asarray(self.between(np.arcsinh(apart / self.core))[which])


def _ratio(theory: OctaveTheory, blocks: Blocks, interval: float, space: _Space, wind_speed: float) -> float:
    """Return the power at one state."""
    scan, length_scale = theory.scan, space.length_scale
    n_beam, n_octave, n_sample = scan.n_beam, blocks.n_octave, blocks.n_sample
    nodes = length_nodes()
    full = blocks.filled(np.array(1.0))
    # the thinned record's levels are the coarsest of the whole one's
    correlation = theory.correlation(np.array([wind_speed]), np.array([scan.yaw]))[0][..., :n_octave]
    expected = theory.expected(correlation, full)
    slope = np.gradient(expected, nodes, axis=1)
    at = np.array([np.interp(np.log(length_scale), nodes, np.arange(len(nodes)))])
    low, part = int(at[0]), float(at[0] % 1.0)
    low, part = (low - 1, 1.0) if low == len(nodes) - 1 else (low, part)
    signal = (1.0 - part) * expected[:, low] + part * expected[:, low + 1]
    change = (1.0 - part) * slope[:, low] + part * slope[:, low + 1]
    dof = np.diff(full)
    white = dof / n_sample
    mean = signal + _NOISE * white
    covariance = _octave_covariance(scan, blocks, interval, space, wind_speed)
    claimed = np.zeros((n_beam + 2, n_beam + 2))
    claimed[-1, -1] = 1.0 / _NOISE_SD**2
    true = claimed.copy()
    rows = np.zeros((n_beam, n_octave, n_beam + 2))
    for b in range(n_beam):
        rows[b, :, b] = 1.0
        rows[b, :, -2] = change[b] / mean[b]
        rows[b, :, -1] = white / mean[b]
        claimed += (0.5 * dof[:, np.newaxis] * rows[b]).T @ rows[b]
        for a in range(n_beam):
            relative = covariance[a, b] / np.outer(mean[a], mean[b])
            true += (0.5 * dof[:, None] * rows[a]).T @ relative @ (0.5 * dof[:, None] * rows[b])
    inverse = np.linalg.inv(claimed)
    return _FEW * float(min(inverse[-2, -2] / (inverse @ true @ inverse)[-2, -2], 1.0))


def _octave_covariance(scan: Scan, blocks: Blocks, interval: float, space: _Space, wind_speed: float) -> FloatArray:
    """Return the covariances of the octaves of all pairs of beams, for unit variances, (b, b, octave, octave)."""
    n_sample, n_octave = blocks.n_sample, blocks.n_octave
    lag = wind_speed * interval * np.arange(-(n_sample - 1), n_sample)
    found = np.zeros((scan.n_beam, scan.n_beam, n_octave, n_octave))
    known: dict[tuple[int, float], FloatArray] = {}
    for a, b, which in zip(space.pairs.row, space.pairs.column, space.pairs.distinct.tolist(), strict=True):
        later = wind_speed * float(scan.beam_time[b] - scan.beam_time[a])
        # mirror images in the x–z plane are one pair, and look at the same separation along the wind
        key = (which, round(later, 9))
        if key not in known:
            along = float(space.pairs.along[which]) - later - lag
            diagonals = space.at(which, along)
            matrix = scipy.linalg.toeplitz(diagonals[n_sample - 1 :: -1], diagonals[n_sample - 1 :])
            known[key] = 2.0 * _projected_power(matrix, blocks) / n_sample**2
        one = known[key] / (space.variance[a] * space.variance[b])
        found[a, b] = one
        found[b, a] = one.T
    return found


def _projected_power(matrix: FloatArray, blocks: Blocks) -> FloatArray:
    """Return ‖(P_l − P_{l−1}) C (P_m − P_{m−1})‖² for all octaves."""
    n_octave = blocks.n_octave
    power = np.empty((n_octave + 1, n_octave + 1))
    for level in range(n_octave, -1, -1):
        rows = matrix if level == n_octave else _block_sums(matrix, blocks.sizes[level])
        row_size = np.ones(len(rows)) if level == n_octave else blocks.sizes[level]
        for other in range(n_octave, -1, -1):
            both = rows if other == n_octave else _block_sums(rows.T, blocks.sizes[other]).T
            size = np.ones(both.shape[1]) if other == n_octave else blocks.sizes[other]
            power[level, other] = (1.0 / row_size) @ both**2 @ (1.0 / size)
    return np.diff(np.diff(power, axis=0), axis=1)


def _block_sums(matrix: FloatArray, sizes: NDArray[np.int64]) -> FloatArray:
    return np.asarray(np.add.reduceat(matrix, np.concatenate([[0], np.cumsum(sizes)[:-1]]), axis=0))
