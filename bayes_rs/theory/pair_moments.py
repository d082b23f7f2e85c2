"""What the noise of a record needs of every pair of its beams: each by itself, or many from few."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.processor import one_thread
from bayes_rs.theory.kept_lines import kept_covariance
from bayes_rs.theory.lag_nodes import LagNodes, lag_nodes
from bayes_rs.theory.pair_interpolation import PairSample, interpolate_pairs, pair_features, spread_pairs
from bayes_rs.theory.pairs import FEW, Pairs
from bayes_rs.theory.probed import CHUNK, Rules, count_nodes, shortest_length
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.toeplitz import toeplitz_inner, toeplitz_trace

PAIR_TOLERANCE = 0.003
"""Largest relative error of K (Frobenius) that shortcuts for many beams may make: widths change by less than 1 %."""

_MANY = 400  # distinct pairs of beams with probes: then most are interpolated
COARSE = 5e-3
"""Tolerance of the velocity covariances of most pairs, where that does."""
_ROADS = ((0.25, COARSE), (0.15, 1e-4))  # growth of the lags' distances, and tolerance of the velocity covariances
_N_CHECKED = 24  # pairs whose sums over all lags are compared
_AS_MANY = 400  # pairs by the rules as they are: where those by coarse rules take no more work, all are calculated
_SEEN = 1e-3  # of the direction of stresses that beams see best: what they see less well counts as unseen
_CAUTION = 5.0  # the largest error of all pairs over that of the checked ones
_EVERY = {"pairs_calculated": "every one, with all lags"}


_Probes = Rules | Literal["points"]


class PairMoments(NamedTuple):
    """Moments of the distinct pairs of a scan's beams.

    Attributes
    ----------
    inner : ndarray, shape (n_distinct,)
        ‖P C_ab P‖²_F / (N_a N_b), m⁴ s⁻⁴.
    trace : ndarray, shape (n_distinct,)
        E s² of those of a beam with itself, m² s⁻²; else not filled.
    error : float
        Five times the largest error of an entry of K by shortcuts that was found, relative to the largest entry: only
        some entries are checked. 0 without shortcuts.
    about : dict
        What to report of the shortcuts.
    """

    inner: FloatArray
    trace: FloatArray
    error: float
    about: dict[str, Any]


@dataclass(frozen=True)
class _Record:
    """A record of a scan: whose pairs, and in what turbulence."""

    pairs: Pairs
    scan: Scan
    turbulence: MannTurbulence
    wind_speed: float
    detrend: str
    tolerance: float

    @property
    def step(self) -> float:
        """How far the wind goes in a sampling interval, m."""
        return self.wind_speed * self.scan.scan_duration

    @cached_property
    def shortest(self) -> float:
        """The shortest probe volume, m; 0 of points."""
        return shortest_length(self.scan.probe_length)

    def groups(self, index: NDArray[np.int64]) -> list[tuple[int, int, NDArray[np.int64]]]:
        """Return the pairs by their numbers of samples."""
        first, second = self.pairs.samples[index].T
        both = np.max(self.pairs.samples) + 1
        found, of = np.unique(first * both + second, return_inverse=True)
        return [(int(n // both), int(n % both), index[of == number]) for number, n in enumerate(found)]

    def covariance(
        self, part: NDArray[np.int64], lag: NDArray[np.int64], tolerance: float, probes: _Probes = "full"
    ) -> FloatArray:
        """Return the covariances of pairs at lags."""
        pairs = self.pairs
        return kept_covariance(
            pairs.first[part],
            pairs.second[part],
            pairs.across[part],
            pairs.along[part, np.newaxis] - self.step * lag,
            self.turbulence,
            probe=self.scan.probe,
            lengths=np.zeros_like(pairs.lengths[part]) if probes == "points" else pairs.lengths[part],
            shortest=self.shortest,
            tolerance=tolerance,
            rules="full" if probes == "points" else probes,
        )

    def count_nodes(self, index: NDArray[np.int64], rules: Rules) -> int:
        """Count the pairs of points that stand for pairs of beams."""
        pairs, flow, probe = self.pairs, self.turbulence, self.scan.probe
        return count_nodes(pairs.first[index], pairs.second[index], flow, probe, pairs.lengths[index], rules)

    def exact(self, index: NDArray[np.int64], probes: _Probes = "full") -> tuple[FloatArray, FloatArray]:
        """Return inner and trace of pairs from all lags."""
        inner, trace = np.full(len(self.pairs.own), np.nan), np.full(len(self.pairs.own), np.nan)
        for n_a, n_b, members in self.groups(index):
            lag = np.arange(-(n_a - 1), n_b)
            for part in np.array_split(members, int(np.ceil(len(members) * len(lag) / CHUNK))):
                covariance = self.covariance(part, lag, self.tolerance, probes)
                inner[part] = toeplitz_inner(covariance, covariance, n_a, n_b, detrend=self.detrend) / (n_a * n_b)
                own = self.pairs.own[part]
                if np.any(own):  # then n_a = n_b
                    trace[part[own]] = toeplitz_trace(covariance[own], n_a, detrend=self.detrend) / n_a
        return inner[index], trace[index]

    def nodes(self, growth: float) -> dict[tuple[int, int], LagNodes]:
        """Return the lags that stand for all, by the numbers of samples."""
        centre = self.pairs.along / self.step
        return {
            (n_a, n_b): lag_nodes(
                n_a, n_b, (float(np.min(centre[of])), float(np.max(centre[of]))), growth, detrend=self.detrend
            )
            for n_a, n_b, of in self.groups(np.arange(len(centre)))
        }

    def by_nodes(
        self,
        index: NDArray[np.int64],
        nodes: dict[tuple[int, int], LagNodes],
        tolerance: float,
        probes: _Probes = "full",
    ) -> FloatArray:
        """Return inner of pairs from few lags."""
        inner = np.full(len(self.pairs.own), np.nan)
        for n_a, n_b, members in self.groups(index):
            some = nodes[n_a, n_b]
            for part in np.array_split(members, int(np.ceil(len(members) * len(some.lag) / CHUNK))):
                inner[part] = some.inner(self.covariance(part, some.lag, tolerance, probes)) / (n_a * n_b)
        return inner[index]


def pair_moments(
    pairs: Pairs,
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: float,
    detrend: str,
    tolerance: float,
    design: FloatArray,
    pair_tolerance: float = PAIR_TOLERANCE,
) -> PairMoments:
    """Return what the noise of a record needs of the distinct pairs of its beams.

    Parameters
    ----------
    pairs : Pairs
        From `distinct_pairs`.
    scan : Scan
        Their scan: its probe and its timing.
    turbulence : MannTurbulence
        The turbulence.
    wind_speed : float
        Mean wind speed, m/s.
    detrend : str
        ``"mean"`` or ``"linear"``.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.
    design : ndarray, shape (n_beam, 6)
        What the variance of each beam is of the stresses, up to a factor of each beam.
    pair_tolerance : float
        Largest relative error of K that shortcuts may make; 0 for none.

    Returns
    -------
    moments : PairMoments
        Those of a beam with itself are never shortened.

    Notes
    -----
    Three shortcuts, each compared with what it stands for:

    - Covariances are calculated at lags whose distances grow (`lag_nodes`), from coarser tables. Some pairs, as points,
      are compared with all lags at `tolerance`; where they differ by more than half of `pair_tolerance`, lags and
      tables are finer, and at last all.
    - Where probe volumes are so long that they need fine rules, rules half as fine are taken, if those pairs differ by
      no more than 0.4 of `pair_tolerance` by them.
    - Of many pairs of beams with probe volumes, those of points are calculated for all, and those of the volumes for
      some, from which the others are interpolated (`interpolate_pairs`) with an error that pairs outside of those tell:
      that of K, and what it makes of the widths of intervals.
      Where the volumes are so long that they need fine rules, coarse rules take the place of points: what is between
      them and the fine ones is smoother by far.
    """
    record = _Record(pairs, scan, turbulence, wind_speed, detrend, tolerance)
    every = np.arange(len(pairs.own))
    if pair_tolerance == 0.0 or len(every) < FEW:
        return PairMoments(*record.exact(every), 0.0, dict(_EVERY))
    with one_thread():
        return _shortened(record, design, pair_tolerance)


def _shortened(record: _Record, design: FloatArray, pair_tolerance: float) -> PairMoments:
    pairs = record.pairs
    inner, trace = np.full(len(pairs.own), np.nan), np.full(len(pairs.own), np.nan)
    own, rest = np.flatnonzero(pairs.own), np.flatnonzero(~pairs.own)
    inner[own], trace[own] = record.exact(own)
    _, first = np.unique(pairs.distinct, return_index=True)  # of the pairs, one that is each distinct one
    mean = trace[pairs.distinct[pairs.row == pairs.column]]
    size = 2.0 / (mean[pairs.row[first]] * mean[pairs.column[first]])  # K = size · inner
    largest = float(np.max(size[own] * inner[own]))
    some = rest[spread_pairs(np.hypot(*pairs.across[rest].T), _N_CHECKED)]
    exact, _ = record.exact(some, "points")
    for growth, coarser in _ROADS:
        tolerance, nodes = max(record.tolerance, coarser), record.nodes(growth)
        off = size[some] * (record.by_nodes(some, nodes, tolerance, "points") - exact)
        lag_error, most = _relative(off, size[some] * exact), float(np.max(np.abs(off))) / largest
        if lag_error <= 0.5 * pair_tolerance:
            break
    else:
        return PairMoments(*record.exact(np.arange(len(pairs.own))), 0.0, dict(_EVERY))
    rules: Rules = "full"
    if record.count_nodes(some, "half") < record.count_nodes(some, "full"):
        full = record.by_nodes(some, nodes, tolerance)
        off = size[some] * (record.by_nodes(some, nodes, tolerance, "half") - full)
        rule_error = _relative(off, size[some] * full)
        if rule_error <= 0.4 * pair_tolerance:
            rules, lag_error = "half", float(np.hypot(lag_error, rule_error))
            most += float(np.max(np.abs(off))) / largest
    with_some = "with some lags" if rules == "full" else "with some lags and rules half as fine"
    about = {"pairs_calculated": f"every one, {with_some}", "pair_error": lag_error, "pair_error_largest": most}

    def calculate(index: NDArray[np.int64]) -> FloatArray:
        return record.by_nodes(rest[index], nodes, tolerance, rules)

    if len(rest) < _MANY or not np.any(pairs.lengths[rest] > 0.0):
        inner[rest] = calculate(np.arange(len(rest)))
        return PairMoments(inner, trace, _CAUTION * most, about)
    coarse = record.count_nodes(rest, "coarse") <= _AS_MANY / len(rest) * record.count_nodes(rest, rules)
    alike = record.by_nodes(rest, nodes, tolerance, "coarse" if coarse else "points")
    covariance = size * inner
    covariance[rest] = size[rest] * alike
    shares = _shares_of_widths(pairs, design / (design @ record.turbulence.stresses())[:, np.newaxis], covariance)
    found = _interpolated(record, rest, alike, size[rest], shares[rest], calculate, pair_tolerance)
    inner[rest] = found.values
    most += found.largest_error / largest
    about = {
        "pairs_calculated": f"{found.n_calculated + len(own)} of {len(pairs.own)}, {with_some}",
        "pair_error": float(np.hypot(lag_error, found.error)),
        "pair_error_largest": most,
        "pair_error_widths": found.width_error,
    }
    return PairMoments(inner, trace, _CAUTION * most, about)


def _interpolated(
    record: _Record,
    rest: NDArray[np.int64],
    alike: FloatArray,
    size: FloatArray,
    shares: FloatArray,
    calculate: Callable[[NDArray[np.int64]], FloatArray],
    pair_tolerance: float,
) -> PairSample:
    """Return the moments of pairs of beams with probes, most of them interpolated."""
    pairs = record.pairs
    features, apart, aside = pair_features(
        pairs.first[rest],
        pairs.second[rest],
        pairs.across[rest],
        pairs.along[rest],
        pairs.lengths[rest],
        step=record.step,
        length_scale=record.turbulence.length_scale,
    )
    return interpolate_pairs(
        features, apart, aside, alike, size, shares, calculate, 0.75 * pair_tolerance, pair_tolerance
    )


def _shares_of_widths(pairs: Pairs, relative: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return how much the width of each stress changes, relatively, with K of each distinct pair, shape (n, 6).

    The width is that of least squares of the logarithms of the variances: its square is a sum over K.
    """
    solution = np.linalg.pinv(relative, rcond=_SEEN)
    both = solution[:, pairs.row] * solution[:, pairs.column] * np.where(pairs.row == pairs.column, 1.0, 2.0)
    whole = np.stack([np.bincount(pairs.distinct, weights=one, minlength=len(covariance)) for one in both], axis=-1)
    return np.asarray(0.5 * whole / np.maximum(np.abs(covariance @ whole), np.finfo(np.float64).tiny))


def _relative(off: FloatArray, values: FloatArray) -> float:
    return float(np.sqrt(np.sum(off**2) / np.sum(values**2)))
