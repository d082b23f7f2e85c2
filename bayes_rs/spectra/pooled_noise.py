"""The instrument's noise in many records, from what their finest octaves say together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from bayes_rs._validation import FloatArray
from bayes_rs.processor import one_thread
from bayes_rs.spectra.octave_likelihood import Octaves
from bayes_rs.spectra.octave_theory import length_nodes

MOST_RECORDS = 200
"""Records that the noise of all is told from, evenly chosen: more tell it no better than the theory's shape is true."""
SHAPE_ERROR = 0.01
"""Standard deviation of what a spectrum of another shape makes look like noise, over the variance; measured in the air
of eleven kinds without any (docs/spectra.md)."""
TELLS = 0.05
"""Standard deviation of a record's noise over its variance up to which the records tell it, however small it is."""
_SHARES = np.log([0.001, 0.95])  # of a record's variance
_NODE, _FINE = 0.25, 0.05  # steps of ln share at which the likelihood is calculated, and summed
_COARSE = 0.4  # step of the median share that is refined
_POWERS = np.array([0.0, 0.5, 1.0])  # of the variance that noise grows with
_SPREADS = np.array([0.1, 0.3, 0.7])  # of ln noise, from record to record
_LENGTH_FINE = 0.1  # step of ln L
_LENGTH_SPREADS = np.array([0.1, 0.3, 0.7])  # of ln L
_SCALE = 0.3  # m/s; that of most lidars is less
_SHARE = 0.02  # of the variance: shares of noise below it are as likely a priori, above those of all sizes are
_LIGHT = 1e-4
_REACH = 3.0  # standard deviations of a record's noise that are looked at
_KEPT = 48  # records at most whose likelihoods are kept: more than the memory of a stream has
_PLACES = 8  # so many times that: a stream of several ranges has such a memory at each, and they take turns; 25 MB
_LEAST = -300.0  # logarithm of densities over their maximum: products of three are no denormal numbers, which are slow
_HYPERS = 128  # hyperparameters at a time, so that what is calculated of a record stays in the cache
_NODES = (7, 45, 25)  # at least; at most of few records and of many, of whom little is told only if each tells little


@dataclass(frozen=True)
class PooledNoise:
    """What the records together say of the noise of each: normal distributions of the logarithm of its share.

    Parameters
    ----------
    log_share, log_sd : ndarray, shape (n_record,)
        Means and standard deviations of the logarithm of noise over the record's variance; what the record itself
        tells is not in it.
    power : float
        Of the variance that noise grows with, posterior mean.
    common_log_sd : float
        Standard deviation of ln s₀: what all records have the same error of.
    """

    log_share: FloatArray
    log_sd: FloatArray
    power: float
    common_log_sd: float

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Return shares (n_record, n_node) and the logarithms of their weights (n_node,).

        The nodes are as close as the likelihood of a record may be narrow, where the others tell little.
        """
        widest = float(self.log_sd.max()) if len(self.log_sd) else 0.0
        most = _NODES[1] if len(self.log_sd) <= MOST_RECORDS else _NODES[2]
        number = int(np.clip(np.ceil(2.0 * _REACH * widest / _NODE), _NODES[0], most))
        place = np.linspace(-_REACH, _REACH, number)
        share = np.exp(self.log_share[:, np.newaxis] + self.log_sd[:, np.newaxis] * place)
        return np.minimum(share, np.exp(_SHARES[1])), -0.5 * place**2


def pool_noise(octaves: Octaves, *, median: float, log_sd: float) -> PooledNoise:
    r"""Return what the records of a campaign say of each one's instrument noise.

    Parameters
    ----------
    octaves : Octaves
        Of all records.
    median, log_sd : float
        The prior of L of a single record, m and 1.

    Returns
    -------
    pooled : PooledNoise
        For records that are not looked at, too.

    Notes
    -----
    The noise variance s of a record of variance V is log-normal,

    .. math:: \ln s_k \sim N(\ln s_0 + κ \ln(V_k / \bar V), τ^2) .

    κ is 0 for noise that is the same in all air, and up to 1 for that of lidars whose spectra broaden with the
    turbulence. Hyperparameters κ, τ and s₀, and the median and spread of ln L, which noise can be mistaken for, are
    summed over a grid: none is plugged in. The prior of s₀ is that of its share q of a variance, with the
    density 1/(q + 0.02), times that of √s₀, half-normal with a scale of 0.3 m/s. A record's own distribution leaves out
    what it tells itself.
    """
    variance = octaves.variance
    known = np.flatnonzero(np.isfinite(variance))
    log_size = np.log(variance / np.exp(np.mean(np.log(variance[known])))) if len(known) else np.zeros(len(variance))
    rows = known[np.unique(np.linspace(0, len(known) - 1, min(MOST_RECORDS, len(known))).round().astype(np.int64))]
    size = np.nan_to_num(log_size)
    fine, length = _steps(_SHARES, _FINE), _steps(length_nodes()[[0, -1]], _LENGTH_FINE)
    if 0 < len(rows) <= _KEPT:  # each by itself, as it comes again with every record of a stream that follows
        density = np.concatenate([_kept_density(_Record(octaves.take(rows[i : i + 1]))) for i in range(len(rows))])
    else:
        density = _density(octaves.take(rows))
    usual = float(np.exp(np.mean(np.log(variance[rows])))) if len(rows) else 1.0
    lengths = _length_hypers(length, median, log_sd)

    centre, power, spread = (
        axis.ravel() for axis in np.meshgrid(_steps(_SHARES, _COARSE), _POWERS, _SPREADS, indexing="ij")
    )
    weight, own = _posterior(density, fine, size[rows], (centre, power, spread), lengths, usual)
    share = weight @ centre
    width = max(float(np.sqrt(weight @ (centre - share) ** 2)), _COARSE / 2.0)
    if width < 2.0 * _COARSE:  # told: look closer
        both = np.unique(np.column_stack([power, spread])[weight > _LIGHT], axis=0)
        at = np.unique(np.clip(np.linspace(share - 4.0 * width, share + 4.0 * width, 41), *_SHARES))
        centre = np.repeat(at, len(both))
        power, spread = np.tile(both, (len(at), 1)).T
        weight, own = _posterior(density, fine, size[rows], (centre, power, spread), lengths, usual)
    mean, square = _moments(weight[np.newaxis], (centre, power, spread), size)
    mean[rows], square[rows] = _moments(own, (centre, power, spread), size[rows])
    common = float(np.sqrt(np.maximum(weight @ centre**2 - (weight @ centre) ** 2, 0.0)))
    return PooledNoise(mean, np.sqrt(square), float(weight @ power), common)


def _density(octaves: Octaves) -> FloatArray:
    """Return the likelihood of each record at the fine nodes of ln share and ln L, over its maximum."""
    share = np.exp(_steps(_SHARES, _NODE))
    found = octaves.log_likelihood(np.broadcast_to(share, (len(octaves), len(share))))
    of_share, of_length = _splines()
    between = of_share @ found @ of_length.T
    between -= between.max(axis=(1, 2), keepdims=True)
    return np.asarray(np.exp(np.maximum(between, _LEAST)))


@lru_cache(maxsize=1)
def _splines() -> tuple[FloatArray, FloatArray]:
    """Return the matrices of the cubic splines from the nodes of ln share, and of ln L, to the fine ones."""
    share, length = _steps(_SHARES, _NODE), length_nodes()
    fine = (_steps(_SHARES, _FINE), _steps(length[[0, -1]], _LENGTH_FINE))
    of_share, of_length = (
        np.asarray(scipy.interpolate.CubicSpline(node, np.eye(len(node)))(at))
        for node, at in zip((share, length), fine, strict=True)
    )
    return of_share, of_length


class _Record:
    """The octaves of one record, equal to others if all numbers are, and what they are compared with."""

    def __init__(self, octaves: Octaves) -> None:
        self.octaves = octaves
        own = (octaves.energy, octaves.count, octaves.used, octaves.wind_speed, octaves.yaw)
        self._key = (octaves.theory, octaves.information, *(values.tobytes() for values in own))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Record) and self._key == other._key


@lru_cache(maxsize=_PLACES * _KEPT)
@one_thread()  # what is kept must not depend on who asked for it first
def _kept_density(record: _Record) -> FloatArray:
    return _density(record.octaves)


def _moments(
    weight: FloatArray, hyper: tuple[FloatArray, FloatArray, FloatArray], size: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance of ln share of records, for weights (1, n_hyper) or (n_record, n_hyper)."""
    centre, power, spread = hyper
    mean, slope = weight @ centre, weight @ (power - 1.0)
    both = (centre - mean[:, np.newaxis], power - 1.0 - slope[:, np.newaxis])
    of_centre, mixed, of_slope = (np.sum(weight * a * b, axis=1) for a, b in ((both[0],) * 2, both, (both[1],) * 2))
    square = weight @ spread**2 + of_centre + 2.0 * mixed * size + of_slope * size**2
    return mean + slope * size, np.asarray(square)


def _steps(ends: FloatArray, step: float) -> FloatArray:
    """Return evenly spaced numbers from end to end, the step or a little less apart."""
    return np.asarray(np.linspace(ends[0], ends[1], int(np.ceil((ends[1] - ends[0]) / step)) + 1))


def _length_hypers(node: FloatArray, median: float, log_sd: float) -> tuple[FloatArray, FloatArray]:
    """Return distributions of ln L at nodes, (n_hyper, n_length), and the logarithms of their weights."""
    centre, spread = (axis.ravel() for axis in np.meshgrid(node[4:-4], _LENGTH_SPREADS, indexing="ij"))
    density = np.exp(np.maximum(-0.5 * ((node - centre[:, np.newaxis]) / spread[:, np.newaxis]) ** 2, _LEAST))
    width = np.sqrt(np.maximum(log_sd**2 - spread**2, 0.25 * log_sd**2))
    return density / density.sum(axis=1, keepdims=True), -0.5 * ((centre - np.log(median)) / width) ** 2 - np.log(width)


def _posterior(
    density: FloatArray,
    fine: FloatArray,
    size: FloatArray,
    hyper: tuple[FloatArray, FloatArray, FloatArray],
    lengths: tuple[FloatArray, FloatArray],
    usual: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the weights of hyperparameters, (n_hyper,), and without each record, (n_record, n_hyper)."""
    centre, power, spread = hyper
    of_length, log_prior_of_length = lengths
    n_record, n_hyper = len(density), len(centre)
    share = np.exp(centre)
    log_prior = np.log(share / (share + _SHARE)) - 0.5 * share * usual / _SCALE**2
    weight, own, top = np.empty(n_hyper), np.empty((n_record, n_hyper)), np.empty(n_hyper)
    for first in range(0, n_hyper, _HYPERS):
        some = slice(first, first + _HYPERS)
        total = log_prior[some, np.newaxis] + log_prior_of_length  # (n_some, n_length_hyper)
        evidence = np.empty((n_record, *total.shape))
        work = np.empty(total.shape)
        for one, at, found in zip(density, size, evidence, strict=True):
            prior = _normal(fine, centre[some] + (power[some] - 1.0) * at, spread[some])
            of_share = prior @ one
            of_share /= prior.sum(axis=1, keepdims=True)
            np.matmul(of_share, of_length.T, out=found)
            total += np.log(found, out=work)
        top[some] = total.max()
        total -= total.max()
        np.exp(total, out=total)
        total.sum(axis=1, out=weight[some])
        for found, without in zip(evidence, own, strict=True):
            np.divide(total, found, out=work).sum(axis=1, out=without[some])
    scale = np.exp(top - top.max()) if n_hyper else top
    return _normalised(weight * scale), _normalised(own * scale)


def _normal(fine: FloatArray, centre: FloatArray, spread: FloatArray) -> FloatArray:
    """Return normal densities of ln share at the fine nodes, (n_hyper, n_share), over the largest among them."""
    apart = fine - centre[:, np.newaxis]
    apart *= apart
    apart *= (-0.5 / spread**2)[:, np.newaxis]
    outside = centre - np.clip(centre, fine[0], fine[-1])
    if outside.any():
        apart += (0.5 * (outside / spread) ** 2)[:, np.newaxis]
    np.maximum(apart, _LEAST, out=apart)
    return np.exp(apart, out=apart)


def _normalised(weight: FloatArray) -> FloatArray:
    relative = weight / weight.max(axis=-1, keepdims=True)
    return np.asarray(relative / relative.sum(axis=-1, keepdims=True))
