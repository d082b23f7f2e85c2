"""What theory expects of the parts of a record: covariances of their mean winds, scatter of their variances."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.samples import BoolArray
from bayes_rs.records.block_statistics import BLOCKS, wind_weights
from bayes_rs.theory.pairs import Pairs, distinct_pairs
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.toeplitz import toeplitz_inner, toeplitz_trace

_TOLERANCE = 1e-3  # of uu: far below what a record's own scatter lets one see
_MOST_SAMPLES = 600  # of a beam in a record: more are thinned
_MOST_IN_BLOCK = 40  # the same in a block, for the eigenvalues of its covariance
_N_DRAW = 4000  # of a block's variance: its log-variance is good to 2 %
_SEED = 7
_SMALL = 1e-4  # of the variance of a block: covariances below it end the sum over blocks
_LEAST_LEFT = 1e-9  # share of the largest eigenvalue of a covariance below which one counts as rounding


class BlockTheory(NamedTuple):
    """What theory expects of the parts of a record, for the turbulence's own dissipation.

    Attributes
    ----------
    wind : ndarray, shape (n_component, n_part)
        Covariance, m² s⁻², of the mean winds of two parts, by how many parts they are apart: along the wind and across,
        as far as the beams see them.
    scatter, scatter_of_beams : ndarray, shape (len(BLOCKS),)
        Expected ``block_scatter`` and ``block_scatter_of_beams`` of records; NaN for numbers of blocks not asked for.
    """

    wind: FloatArray
    scatter: FloatArray
    scatter_of_beams: FloatArray


class _Lags(NamedTuple):
    """Covariances of the radial velocities of distinct pairs of beams at lags of whole steps."""

    pairs: Pairs
    covariance: FloatArray  # (n_distinct, 2 n_sample − 1)
    step: float  # s
    n_sample: int

    def at(self, first: int, count: int) -> FloatArray:
        """Return those of `count` lags from `first` on, in steps, shape (n_distinct, count); zero beyond the record."""
        place = self.n_sample - 1 + first + np.arange(count)
        inside = (place >= 0) & (place < self.covariance.shape[1])
        return np.where(inside, self.covariance[:, np.clip(place, 0, self.covariance.shape[1] - 1)], 0.0)


def block_theory(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: float,
    yaw: float,
    duration: float,
    n_part: int,
    blocks: tuple[int, ...],
) -> BlockTheory:
    r"""Return what theory expects of the parts of a record in Gaussian, frozen Mann turbulence.

    Parameters
    ----------
    scan : Scan
        Of the beams that the statistics are made of, all in use.
    turbulence : MannTurbulence
        The turbulence.
    wind_speed : float
        Mean wind speed, m/s.
    yaw : float
        Wind direction relative to the lidar axis, rad.
    duration : float
        Length of the record, s.
    n_part : int
        Number of parts of equal length.
    blocks : tuple of int
        Numbers of blocks to compare the variances of.

    Returns
    -------
    expected : BlockTheory
        Covariances and scatters.

    Notes
    -----
    The mean wind of a part is w·v with the weights w of the least-squares wind (`wind_weights`), so that parts k apart
    have the covariance

    .. math:: \frac{1}{n^2} \sum_{ab} w_a w_b \sum_{i,j<n} C_{ab}(kT/P + (j - i) \Delta t) .

    The variance of a block is a quadratic form of Gaussian velocities, :math:`q = \sum_m \lambda_m \chi^2_m` with
    the eigenvalues of the covariance of its samples, each beam's over its expected variance. Var[ln q] is taken from
    draws of that sum: a few large eddies and many small ones make it smaller than the logarithm of a gamma variable of
    the same variance. The covariances of ln q between blocks are those of q, from Isserlis' theorem, times
    Var[ln q]/Var[q]; what is expected of the scatter is the variance less the mean covariance of two blocks.
    """
    lags = _lags(scan, turbulence, wind_speed, yaw, duration)
    used: BoolArray = np.ones(scan.n_beam, dtype=bool)
    weights, sees_direction = wind_weights(scan, used)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    components = turn @ weights if sees_direction else weights[:1] if np.any(weights[0]) else weights[:0]
    wind = np.array([_wind_covariance(lags, row, duration, n_part) for row in components]).reshape(-1, n_part)
    scatter, of_beams = np.full(len(BLOCKS), np.nan), np.full(len(BLOCKS), np.nan)
    for number in blocks:
        column = BLOCKS.index(number)
        samples = duration / number / lags.step
        few = int(samples + 1e-9)
        found = np.array(_log_scatter(lags, scan.n_beam, duration, number, few))
        if few < _MOST_IN_BLOCK and samples - few > 1e-6:  # some blocks have a sample more
            more = np.array(_log_scatter(lags, scan.n_beam, duration, number, few + 1))
            found += (samples - few) * (more - found)
        scatter[column], of_beams[column] = found
    return BlockTheory(wind, scatter, of_beams)


def _lags(scan: Scan, turbulence: MannTurbulence, wind_speed: float, yaw: float, duration: float) -> _Lags:
    every = max(1, int(duration / scan.scan_duration / _MOST_SAMPLES))
    step = every * scan.scan_duration
    number = int(duration / step + 1e-9)
    pairs = distinct_pairs(scan, scan.at_yaw(yaw), np.full(scan.n_beam, number), wind_speed)
    lag = wind_speed * step * np.arange(-(number - 1), number)
    covariance = probed_covariance(
        pairs.first,
        pairs.second,
        pairs.across,
        pairs.along[:, None] - lag,
        turbulence,
        probe=scan.probe,
        lengths=pairs.lengths,
        tolerance=_TOLERANCE,
    )
    return _Lags(pairs, covariance, step, number)


def _wind_covariance(lags: _Lags, weights: FloatArray, duration: float, n_part: int) -> FloatArray:
    """Return the covariances of the mean winds of parts 0, 1, 2 … parts apart, shape (n_part,)."""
    pairs = lags.pairs
    both = weights[pairs.row] * weights[pairs.column]
    of_distinct = np.bincount(pairs.distinct, weights=both, minlength=len(lags.covariance))
    turned = np.bincount(
        pairs.distinct, weights=np.where(pairs.row == pairs.column, 0.0, both), minlength=len(lags.covariance)
    )
    samples = max(duration / n_part / lags.step, 1.0)
    few = int(samples + 1e-9)
    n = few + 1  # some parts have a sample more than others
    off = np.abs(np.arange(-(n - 1), n))
    share = samples - few
    weight = (1.0 - share) * np.maximum(few - off, 0) / few**2 + share * (n - off) / n**2
    total = np.empty(n_part)
    for apart in range(n_part):
        between = apart * samples
        low = int(between + 1e-9)
        at = [
            weight @ (of_distinct @ lags.at(step - (n - 1), 2 * n - 1) + turned @ lags.at(-step - (n - 1), 2 * n - 1))
            for step in (low, low + 1)
        ]
        total[apart] = at[0] + (between - low) * (at[1] - at[0])
    return total


def _log_scatter(lags: _Lags, n_beam: int, duration: float, number: int, n: int) -> tuple[float, float]:
    """Return the expected scatters over `number` blocks of n samples: of the mean of the beams, and beam by beam."""
    pairs = lags.pairs
    mean = np.full(len(lags.covariance), np.nan)
    mean[pairs.own] = toeplitz_trace(lags.at(-(n - 1), 2 * n - 1)[pairs.own], n) / n
    of_beam = mean[pairs.distinct[pairs.row == pairs.column]]
    size = of_beam[pairs.row] * of_beam[pairs.column]
    once = pairs.row == pairs.column
    whole, beams = [], []
    for apart in range(number):
        middle = round(apart * duration / number / lags.step)
        ahead, behind = (lags.at(way * middle - (n - 1), 2 * n - 1) for way in (1, -1))
        square = [2.0 * toeplitz_inner(of, of, n, n)[pairs.distinct] / n**2 / size for of in (ahead, behind)]
        whole.append((square[0].sum() + square[1][~once].sum()) / n_beam**2)
        beams.append(square[0][once].mean())
        if whole[-1] < _SMALL * whole[0]:
            break
    share = [_between(np.array(values), number) for values in (whole, beams)]
    of_whole, of_beams = _log_over_plain(lags, of_beam, n)
    return float(whole[0] * of_whole * (1.0 - share[0])), float(beams[0] * of_beams * (1.0 - share[1]))


def _between(covariance: FloatArray, number: int) -> float:
    """Return the mean covariance of two different blocks of `number` over the variance of one."""
    apart = np.arange(1, len(covariance))
    return float(np.sum(2.0 * (number - apart) / (number * (number - 1)) * covariance[1:]) / covariance[0])


def _log_over_plain(lags: _Lags, of_beam: FloatArray, n: int) -> tuple[float, float]:
    """Return Var[ln q]/Var[q] of a block of n samples, of the beams' mean and the mean over the beams.

    Both are of the same thinned samples, so that the ratio hardly depends on how many are left.
    """
    pairs, n_beam = lags.pairs, len(of_beam)
    every = max(1, -(-n // _MOST_IN_BLOCK))
    some = n // every
    apart = every * (np.arange(some)[None, :] - np.arange(some)[:, None])
    covariance = np.empty((n_beam, n_beam, some, some))
    covariance[pairs.row, pairs.column] = lags.covariance[:, lags.n_sample - 1 + apart][pairs.distinct]
    covariance[pairs.column, pairs.row] = covariance[pairs.row, pairs.column].swapaxes(-1, -2)
    root = np.sqrt(of_beam)
    covariance /= (root[:, None] * root)[:, :, None, None]
    centre = np.eye(some) - 1.0 / some
    covariance = centre @ covariance @ centre
    whole = np.linalg.eigvalsh(covariance.swapaxes(1, 2).reshape(n_beam * some, n_beam * some))
    beams = np.linalg.eigvalsh(covariance[np.arange(n_beam), np.arange(n_beam)])
    return _ratio(whole), float(np.mean([_ratio(values) for values in beams]))


def _ratio(eigenvalue: Any) -> float:
    """Return Var[ln q]/Var[q] for q of mean one."""
    return _log_variance(eigenvalue) * float(np.sum(eigenvalue)) ** 2 / float(2.0 * np.sum(eigenvalue**2))


def _log_variance(eigenvalue: FloatArray) -> float:
    """Return Var[ln Σ λ_m χ²_m]; eigenvalues of which there are many small ones are put together in one mean."""
    ordered = np.sort(eigenvalue)[::-1]
    ordered = ordered[ordered > _LEAST_LEFT * ordered[0]]
    large = ordered[:_MOST_IN_BLOCK]
    rest = ordered[_MOST_IN_BLOCK:]
    squares, state = _squares(len(large))
    total = squares @ large
    if len(rest):
        rng = np.random.default_rng()
        rng.bit_generator.state = state
        shape = 0.5 * rest.sum() ** 2 / np.sum(rest**2)
        total += rng.gamma(shape, rest.sum() / shape, _N_DRAW)
    return float(np.log(total).var())


@lru_cache(maxsize=_MOST_IN_BLOCK)
def _squares(count: int) -> tuple[FloatArray, Any]:
    """Return draws of `count` chi-squared variables, shape (_N_DRAW, count), and where their generator stands."""
    rng = np.random.default_rng(_SEED)
    squares = rng.standard_normal((_N_DRAW, count)) ** 2
    squares.flags.writeable = False
    return squares, rng.bit_generator.state
