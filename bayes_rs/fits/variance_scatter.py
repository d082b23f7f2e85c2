"""How much more variances scatter than in Gaussian air: from the records' own blocks, shrunk over the campaign."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.fits.block_states import BlockStates
from bayes_rs.quality.samples import BoolArray, IntArray
from bayes_rs.records.block_statistics import BLOCKS

_DEPTHS = np.array([0.0, 0.02, 0.04, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8, 1.1, 1.5, 2.0])
"""Variances of the logarithm of the air's strength that a record may have."""
_TIME_SCALES = np.geomspace(20.0, 640.0, 11)  # s
_TYPICAL_SCALE, _SCALE_LOG_SD = 100.0, 0.9  # what the time scale is before the data speak
_PRIOR_RECORDS = 1.0  # the weights of the depths begin as if so many records had been seen ...
_GAUSSIAN_SHARE = 0.7  # ... of which this share in Gaussian air
_PRIOR_DEPTH = 0.2  # and the others with depths that decay so fast
_N_STEP = 200
_DONE = 1e-6
_FINE_DEPTHS = np.r_[0.0, np.geomspace(1e-3, 3.0, 120)]
_NESTED = 0.6  # what several numbers of blocks of the same records know, over what as many other records would
_LEAST_RECORDS = 3  # records from which on the scatter of the means is taken from the records
_THEORY_ERROR = 0.05  # of the expected scatters, relative: of the turbulence's shape and the length scale


@dataclass(frozen=True)
class VarianceScatter:
    """By how much the records' variances scatter beyond theory.

    Parameters
    ----------
    common : ndarray, shape (n_record,)
        Relative variance that all beams of a record share.
    own : ndarray, shape (n_record,)
        Relative variance of each beam by itself.
    depth : float
        Mean over the records of the variance of the logarithm of the air's strength.
    time_scale : float
        Time scale of that strength, s.
    shared : float
        Share of it that is the same for all beams, 0 to 1.
    n_record : int
        Records that it was learnt from.
    """

    common: FloatArray
    own: FloatArray
    depth: float
    time_scale: float
    shared: float
    n_record: int


def averaged(time: FloatArray | float, time_scale: FloatArray | float) -> FloatArray:
    r"""Return the variance that is left of an Ornstein–Uhlenbeck process of variance one in its mean over some time.

    Parameters
    ----------
    time : float or ndarray
        t, s.
    time_scale : float or ndarray
        τ, s.

    Returns
    -------
    left : ndarray
        0 to 1.

    Notes
    -----
    .. math:: h(t; \tau) = \frac{2\tau}{t} \left[1 - \frac{\tau}{t} (1 - e^{-t/\tau})\right] .
    """
    x = np.asarray(time, dtype=np.float64) / time_scale
    return np.asarray(2.0 / x * (1.0 - (-np.expm1(-x)) / x))


def record_scatter(depth: FloatArray, duration: float, time_scale: float) -> FloatArray:
    r"""Return the relative variance of a record's mean strength.

    Parameters
    ----------
    depth : ndarray
        D, the variance of the logarithm of the strength.
    duration : float
        Length T of the record, s.
    time_scale : float
        τ, s.

    Returns
    -------
    relative : ndarray
        Relative variance v of the mean over the record of exp(√D g − D/2), g an Ornstein–Uhlenbeck process.

    Notes
    -----
    .. math:: v = 2 \int_0^1 (1 - x) \left[\exp(D e^{-xT/\tau}) - 1\right] dx .
    """
    node, weight = _gauss()
    x = 0.5 * (node + 1.0) ** 2 / 2.0  # closer together near 0, where the correlation is
    jacobian = 0.5 * (node + 1.0)
    of = np.expm1(np.asarray(depth, dtype=np.float64)[..., None] * np.exp(-x * duration / time_scale))
    return np.asarray(2.0 * np.sum(weight * jacobian * (1.0 - x) * of, axis=-1))


@lru_cache(maxsize=1)
def _gauss() -> tuple[FloatArray, FloatArray]:
    return np.polynomial.legendre.leggauss(64)


def excess_of_blocks(duration: float, time_scale: float) -> FloatArray:
    """Return what a depth of one adds to ``block_scatter``, shape (len(BLOCKS),): M/(M − 1) [h(T/M) − h(T)]."""
    number = np.array(BLOCKS, dtype=np.float64)
    return np.asarray(
        number / (number - 1.0) * (averaged(duration / number, time_scale) - averaged(duration, time_scale))
    )


def learn_scatter(records: xr.Dataset, states: BlockStates, *, leave_out: BoolArray | None = None) -> VarianceScatter:
    r"""Learn from records how much their variances scatter beyond theory.

    Parameters
    ----------
    records : Dataset
        With ``block_scatter`` and ``block_scatter_of_beams``.
    states : BlockStates
        Theory of these records.
    leave_out : ndarray of bool, shape (n_record,), optional
        Records that nothing is learnt from, as unsteady ones, whose blocks differ by more than eddies do.

    Returns
    -------
    scatter : VarianceScatter
        Records that do not tell get what the others say.

    Notes
    -----
    The strength of the air is taken for exp(√D g − D/2) with g an Ornstein–Uhlenbeck process of the time scale τ. A
    record's scatter S_M over M blocks is then about E_M + D f_M(τ), E_M being theory's and f_M that of
    `excess_of_blocks`, times a χ² variable over its M − 1 degrees of freedom. All records share τ: it comes from
    their mean scatters at several M. The distribution of D over the records is found by expectation and maximisation on
    a grid (Kiefer and Wolfowitz 1956), with the finest blocks as data; each record has the posterior mean of its
    v(D, τ) under it. Before any record is seen, seven in ten are taken to be Gaussian.

    References
    ----------
    Kiefer and Wolfowitz (1956), Ann. Math. Stat. 27, 887–906, doi:10.1214/aoms/1177728066.
    """
    whole, of_beams = (
        np.asarray(records[name].values, dtype=np.float64) for name in ("block_scatter", "block_scatter_of_beams")
    )
    expected, expected_of_beams, n_beam = _expected(states, len(whole))
    known = np.isfinite(whole) & np.isfinite(expected) & (whole > 0.0)
    if leave_out is not None:
        known &= ~leave_out[:, None]
    finest = [column for column in range(len(BLOCKS)) if known[:, column].any()]
    rows = np.flatnonzero(known[:, finest].all(axis=1)) if finest else np.empty(0, dtype=np.int64)
    if len(rows) == 0:
        none = np.zeros(len(whole))
        return VarianceScatter(none, none, 0.0, _TYPICAL_SCALE, 1.0, 0)
    column = finest[-1]
    time_scale = _time_scale(whole[rows], expected[rows], finest, states.duration)
    gain = excess_of_blocks(states.duration, time_scale)[column]
    mean = expected[rows, column][:, None] + _DEPTHS * gain
    weights, of_record = _mixture(_log_likelihood(whole[rows, column], mean, BLOCKS[column] - 1))
    size = record_scatter(_DEPTHS, states.duration, time_scale)
    found = np.full(len(whole), float(weights @ size))
    found[rows] = of_record @ size
    shared = _shared(whole, expected, of_beams, expected_of_beams, rows, column, n_beam)
    depth = float(weights @ _DEPTHS)
    return VarianceScatter(shared * found, (1.0 - shared) * found, depth, time_scale, shared, len(rows))


def _expected(states: BlockStates, n_record: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return both expected scatters (n_record, len(BLOCKS)), and numbers of beams; NaN where nothing is compared."""
    whole, beams = np.zeros((n_record, len(BLOCKS))), np.zeros((n_record, len(BLOCKS)))
    total, n_beam = np.zeros(n_record), np.ones(n_record)
    for state, rows, weight in states.groups():
        theory = states.theory(state)
        whole[rows] += weight[:, None] * theory.scatter
        beams[rows] += weight[:, None] * theory.scatter_of_beams
        total[rows] += weight
        n_beam[rows] = state.pattern.bit_count()
    off = total == 0.0
    whole[off], beams[off] = np.nan, np.nan
    return whole, beams, n_beam


def _log_likelihood(scatter: FloatArray, mean: FloatArray, dof: int) -> FloatArray:
    """Return the log-density of scatters, up to what does not depend on their means, (n_record, n_depth)."""
    return np.asarray(-0.5 * dof * (np.log(mean) + scatter[:, None] / mean))


def _mixture(log_likelihood: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distribution of the depths over the records, and of each record, by expectation and maximisation."""
    tail = np.where(_DEPTHS > 0.0, np.exp(-_DEPTHS / _PRIOR_DEPTH), 0.0) * np.gradient(_DEPTHS)
    prior = np.where(_DEPTHS > 0.0, (1.0 - _GAUSSIAN_SHARE) * tail / tail[1:].sum(), _GAUSSIAN_SHARE)
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    weights = prior
    for _ in range(_N_STEP):
        of_record = likelihood * weights
        of_record /= of_record.sum(axis=1, keepdims=True)
        new = (_PRIOR_RECORDS * prior + of_record.sum(axis=0)) / (_PRIOR_RECORDS + len(of_record))
        change = float(np.max(np.abs(new - weights)))
        weights = new
        if change < _DONE:
            break
    of_record = likelihood * weights
    return weights, of_record / of_record.sum(axis=1, keepdims=True)


def _time_scale(whole: FloatArray, expected: FloatArray, columns: list[int], duration: float) -> float:
    """Return the posterior mean, in logarithms, of the time scale, from the mean scatters at several numbers of blocks.

    A mean scatter is taken for a gamma variable about its expectation, the depth being the likeliest for each time
    scale: a normal density with the records' own spread would believe the quiet halves of chance more than the others.
    """
    log_weight = -0.5 * (np.log(_TIME_SCALES / _TYPICAL_SCALE) / _SCALE_LOG_SD) ** 2
    enough = len(whole) >= _LEAST_RECORDS and len(columns) > 1
    if enough and np.all(whole[:, columns].mean(axis=0) > 0.0):  # blocks that are all the same tell of no time
        mean, size = whole[:, columns].mean(axis=0), expected[:, columns].mean(axis=0)
        spread = whole[:, columns].var(axis=0) / mean**2 / len(whole) / _NESTED
        precision = 1.0 / (spread + _THEORY_ERROR**2)
        for index, scale in enumerate(_TIME_SCALES.tolist()):
            about = size + _FINE_DEPTHS[:, None] * excess_of_blocks(duration, scale)[columns]
            log_weight[index] -= float(np.min((np.log(about) + mean / about) @ precision))
    weight = np.exp(log_weight - log_weight.max())
    return float(np.exp(np.sum(weight * np.log(_TIME_SCALES)) / weight.sum()))


def _shared(
    whole: FloatArray,
    expected: FloatArray,
    of_beams: FloatArray,
    expected_of_beams: FloatArray,
    rows: IntArray,
    column: int,
    n_beam: FloatArray,
) -> float:
    """Return the share of the excess that all beams have together: 1 where the beams cannot tell."""
    some = rows[np.isfinite(of_beams[rows, column]) & (n_beam[rows] > 1)]
    if len(some) < _LEAST_RECORDS:
        return 1.0
    together = (whole - expected)[some, column]
    single = (of_beams - expected_of_beams)[some, column]
    number = float(np.mean(n_beam[some]))
    # together = v [ρ + (1 − ρ)/B] and single = v, so the beams' own part v (1 − ρ) is this
    alone = (single - together) * number / (number - 1.0)
    mean, error = float(alone.mean()), float(alone.std() / np.sqrt(len(some)))
    error = float(np.hypot(error, _THEORY_ERROR * expected_of_beams[some, column].mean()))
    clear = max(mean - 2.0 * error, 0.0)
    return float(np.clip(1.0 - clear / max(float(single.mean()), 1e-12), 0.0, 1.0)) if clear > 0.0 else 1.0
