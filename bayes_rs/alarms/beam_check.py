"""Do the beams of records agree with each other, and scatter as their noise says? For each record, and for all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.alarms.means import LASTING_FLOOR, TILT_SD, WIND
from bayes_rs.alarms.patterns import Patterns, Scores, independent_patterns, largest_tail, score_patterns
from bayes_rs.alarms.variances import FLOOR, Expected

LEVEL = 0.01
"""Probability, if nothing is wrong, of data that disagree as much; below it a record is flagged."""
CAMPAIGN_LEVEL = 1e-3
"""The same for all records together."""
FEWEST = 10
"""Records from which on all of them are looked at together."""
EXCHANGE = 6.6
"""So much, and twice the logarithm of the number of pairs, must χ² fall if two beams are exchanged to be an alarm."""
_LIKE_RECORDS = 10
"""What the theory's scatter weighs against that of the records, in records."""
_HALF_WIDTH = 1.349
"""Width of the shortest half of a standard normal."""
_UPPER = 0.75
_MOST_EXCESS = 2.5
"""No more is put down to the air than this: beyond, the beams are at fault."""
_OF_MEDIAN = 0.5 * np.pi
"""Variance of a median over that of a mean, for normal data."""
_MOST_SCATTER = 400
"""Records that the scatter is taken from: evenly of all."""
_NULL = 0.3
"""Directions of the data that flow can move by less than this, in variances over that of the noise, test the noise."""
_NOISE_FLOOR = 0.005
_N_BOOT = 400
_SOUND = 0.75


@dataclass(frozen=True)
class Block:
    """The data of some records in a row, of one kind: logarithms of variances, or means over the wind speed.

    Parameters
    ----------
    used : ndarray of bool, shape (n_record, n_beam)
        Which beams have data.
    datum : ndarray, shape (n_record, n_beam)
        The data themselves.
    expected : Expected
        Their residuals, and how these scatter.
    air, own : ndarray, shape (n_record, n_beam), optional
        Share of each variance that is not the instrument's noise, and the relative variance that this noise adds to it,
        for how the beams scatter.
    """

    used: NDArray[np.bool_]
    datum: FloatArray
    expected: Expected
    air: FloatArray | None = None
    own: FloatArray | None = None

    @property
    def noise(self) -> FloatArray:
        """Covariance of the data with the instrument's noise in them, shape (n_record, n_beam, n_beam)."""
        noise = self.expected.noise
        if self.air is None or self.own is None:
            return noise
        floor = FLOOR**2 * np.eye(noise.shape[-1])
        diluted = (noise - floor) * self.air[:, :, None] * self.air[:, None, :]
        return np.asarray(diluted + self.own[:, :, None] * np.eye(noise.shape[-1]) + floor)


@dataclass(frozen=True)
class Evidence:
    """What the data of one kind say about every record, and about all together.

    Parameters
    ----------
    excess : float
        How much larger the variance of the scores over the records is than expected, 1 at least.
    square_excess : float
        The same of χ²: the larger of that and of the median of χ² over its own.
    independent : float
        How many independent scores have the same largest as those of the patterns.
    square, count : ndarray, shape (n_record,)
        χ² and its degrees of freedom; 0 and 0 for records without such data.
    beam_score : ndarray, shape (n_record, n_beam)
        Distance of each beam from what the others predict, in standard deviations; NaN where it has no data.
    pattern : ndarray of int, shape (n_record,)
        Pattern of the largest score.
    score, shift : ndarray, shape (n_record,)
        That score, and the shift of its beams in units of the data.
    together : Scores or None
        The scores of the medians of the residuals over the records; None for few records.
    tilt : tuple of float or None
        Error of the tilt by all records, and its standard deviation, rad; None for variances.
    """

    excess: float
    square_excess: float
    independent: float
    square: FloatArray
    count: NDArray[np.int64]
    beam_score: FloatArray
    pattern: NDArray[np.int64]
    score: FloatArray
    shift: FloatArray
    together: Scores | None
    tilt: tuple[float, float] | None

    @cached_property
    def p_square(self) -> FloatArray:
        """Probability of so large a χ², shape (n_record,); NaN without data."""
        tail = scipy.special.chdtrc(np.maximum(self.count, 1), self.square / self.square_excess)
        return np.where(self.count > 1, tail, np.nan)

    @cached_property
    def p_pattern(self) -> FloatArray:
        """Probability of so large a score of any pattern, shape (n_record,); NaN without data."""
        tail = largest_tail(self.score / np.sqrt(self.excess), self.independent)
        return np.where(self.count > 1, tail, np.nan)

    def p_together(self) -> float:
        """Probability of so large a score of any pattern in the medians over the records; NaN where there are none."""
        if self.together is None:
            return np.nan
        return float(largest_tail(np.max(np.abs(self.together.score)), self.independent))


@dataclass(frozen=True)
class BeamCheck:
    """Whether the beams of records agree.

    Parameters
    ----------
    probability : ndarray, shape (n_record,)
        Probability, if nothing is wrong, of data that disagree as much; NaN where nothing could be looked at.
    misfit : ndarray, shape (n_record,)
        Largest distance of a beam's log-variance from what the other beams predict, in standard deviations.
    kinds : dict of str to Evidence
        ``variance`` and, where the records have means, ``mean``.
    exchange : ndarray, shape (n_record, 3)
        The two beams (their places) whose exchange makes χ² fall most, and by how much.
    exchange_together : tuple of int, int, float
        The same of the medians over the records; −1, −1, 0.0 for few records.
    scatter : tuple of float or None
        Factor by which the variance of the beams' scatter against each other is larger than the noise says, with its
        90 % interval; None where flow can move every combination of the beams, or there are few records.
    patterns : Patterns
        What the numbers of patterns mean.
    """

    probability: FloatArray
    misfit: FloatArray
    kinds: dict[str, Evidence]
    exchange: FloatArray
    exchange_together: tuple[int, int, float]
    scatter: tuple[float, float, float] | None
    patterns: Patterns
    level: float = LEVEL

    @cached_property
    def disagree(self) -> NDArray[np.bool_]:
        """Which records have beams that disagree, shape (n_record,)."""
        with np.errstate(invalid="ignore"):
            return np.asarray((self.probability < self.level) | self.exchanged)

    @cached_property
    def exchanged(self) -> NDArray[np.bool_]:
        """Which records fit clearly better with two beams exchanged, shape (n_record,)."""
        return np.asarray(self.exchange[:, 2] > self.exchange_limit)

    @property
    def exchange_limit(self) -> float:
        """By how much χ² must fall if two beams are exchanged to be an alarm."""
        n_beam = self.patterns.matrix.shape[1]
        return EXCHANGE + 2.0 * float(np.log(max(0.5 * n_beam * (n_beam - 1.0), 1.0)))


def check_beams(
    blocks: Iterable[tuple[Block, Block | None]], patterns: Patterns, n_record: int, *, accuracy: float = 0.0
) -> BeamCheck:
    """Look at the beams of records: at each record by itself, and at all together.

    Parameters
    ----------
    blocks : iterable of (Block, Block or None)
        Log-variances and means of the records, some at a time and in order; None without means.
    patterns : Patterns
        Which beams may be wrong together.
    n_record : int
        Number of all records.
    accuracy : float
        Error of the covariance of log-variances, relative to its largest entry: combinations of the beams whose
        variance is less tell nothing of the scatter.

    Returns
    -------
    check : BeamCheck
        The probability of a record is the smallest of those of χ² and of the largest score, by variances and by means,
        times their number.
    """
    tallies: dict[str, list[_Seen]] = {"variance": [], "mean": []}
    swaps, some = [], []
    every, first = max(1, n_record // _MOST_SCATTER), 0
    independent: dict[str, float] = {}
    for pair in blocks:
        own = np.arange(-first % every, len(pair[0].used), every)
        total: FloatArray = np.zeros(())
        for name, block in zip(tallies, pair, strict=True):
            if block is None:
                continue
            covariance = block.expected.covariance()
            found = block.expected
            scores = score_patterns(found.residual, covariance, block.used, patterns, block.datum, found.precision)
            whole = np.asarray(block.used.all(axis=1))
            if name not in independent and whole.any():
                independent[name] = independent_patterns(covariance[int(whole.argmax())], patterns)
            tallies[name].append(_seen(block, scores, whole, own))
            total = np.asarray(total + np.where(np.isfinite(scores.swap), scores.swap, 0.0))
        swaps.append(_best_swap(total))
        found = pair[0].expected
        some.append((pair[0].noise[own], found.slope[own], found.left[own], pair[0].used[own], own + first))
        first += len(swaps[-1])
    kinds = {
        name: _evidence(seen, independent.get(name, float(len(patterns))), patterns, means=name == "mean")
        for name, seen in tallies.items()
        if seen
    }
    exchange = np.concatenate(swaps)
    exchange[:, 2] /= max(one.excess for one in kinds.values())
    probability = _probability(list(kinds.values()))
    variances = kinds["variance"]
    score = np.abs(variances.beam_score) / np.sqrt(variances.excess)
    largest = np.max(np.where(np.isfinite(score), score, 0.0), axis=1)
    return BeamCheck(
        probability,
        np.where(variances.count > 1, largest, np.nan),
        kinds,
        exchange,
        _swap_together(list(kinds.values())),
        _scatter(some, np.concatenate([one.left for one in tallies["variance"]]), ~(probability < LEVEL), accuracy),
        patterns,
    )


@dataclass(frozen=True)
class _Seen:
    """What is kept of the records of a block."""

    scores: tuple[NDArray[Any], ...]
    beam_score: FloatArray
    residual: FloatArray
    left: FloatArray
    datum: FloatArray
    slope: FloatArray
    noise: FloatArray
    n_whole: int
    some_scores: FloatArray


def _seen(block: Block, scores: Scores, whole: NDArray[np.bool_], some: NDArray[np.int64]) -> _Seen:
    used, rows = block.used, np.arange(len(block.used))
    best = np.argmax(np.abs(scores.score), axis=1)
    return _Seen(
        (scores.square, scores.count, best, scores.score[rows, best], scores.shift[rows, best]),
        np.where(used, scores.score[:, : used.shape[1]], np.nan),
        np.where(used, block.expected.residual, np.nan),
        np.where(used, block.expected.left, np.nan),
        np.where(used, block.datum, np.nan),
        block.expected.slope[whole].sum(axis=0),
        block.expected.noise[whole].sum(axis=0),
        int(whole.sum()),
        np.where(np.any(block.used[some], axis=1)[:, None], scores.score[some], np.nan),
    )


def _best_swap(total: FloatArray) -> FloatArray:
    """Return the pair of beams, and by how much χ² falls, of matrices (n_record, n_beam, n_beam)."""
    flat = total.reshape(len(total), -1)
    pair = np.argmax(flat, axis=1)
    return np.column_stack([pair // total.shape[1], pair % total.shape[1], flat[np.arange(len(flat)), pair]])


def _evidence(seen: Sequence[_Seen], independent: float, patterns: Patterns, *, means: bool) -> Evidence:
    """Put the blocks of one kind together, and look at all records."""
    square, count, pattern, score, shift = (
        np.concatenate(parts) for parts in zip(*(s.scores for s in seen), strict=True)
    )
    beam_score = np.concatenate([one.beam_score for one in seen])
    excess = _excess(np.concatenate([one.some_scores for one in seen]), count)
    together, tilt = _together(seen, patterns, excess, means=means)
    sizes = (excess, max(excess, _square_excess(square, count)))
    return Evidence(*sizes, independent, square, count, beam_score, pattern, score, shift, together, tilt)


def _excess(score: FloatArray, count: NDArray[np.int64]) -> float:
    """Return how much larger the variance of the patterns' scores over the records is than 1; never below 1.

    The width is that of the shortest half of a pattern's scores, which the other half, of faults, does not change; of
    the patterns, three in four have no more.
    """
    known = np.isfinite(score[:, 0])
    n = np.count_nonzero(count > 1)
    if known.sum() < FEWEST:
        return 1.0
    own = np.quantile([np.square(_shortest_half(one) / _HALF_WIDTH) for one in score[known].T], _UPPER)
    return float(np.clip((_LIKE_RECORDS + n * own) / (_LIKE_RECORDS + n), 1.0, _MOST_EXCESS))


def _square_excess(square: FloatArray, count: NDArray[np.int64]) -> float:
    """Return how much larger the median of χ² over the records is than that of its distribution."""
    there = count > 1
    n = np.count_nonzero(there)
    if n < FEWEST:
        return 1.0
    own = float(np.median(square[there] / scipy.stats.chi2.median(count[there])))
    return float(np.clip((_LIKE_RECORDS + n * own) / (_LIKE_RECORDS + n), 1.0, _MOST_EXCESS))


def _shortest_half(values: FloatArray) -> float:
    """Return the width of the shortest interval that holds half of the values."""
    ordered = np.sort(values)
    half = len(ordered) // 2
    return float(np.min(ordered[half:] - ordered[: len(ordered) - half]))


def _middle(seen: Sequence[_Seen]) -> tuple[NDArray[np.bool_], FloatArray, FloatArray, NDArray[np.int64]]:
    """Return which beams have enough records, medians of residuals and data, and numbers of records."""
    residual, datum = (np.concatenate([getattr(one, name) for one in seen]) for name in ("residual", "datum"))
    known = np.isfinite(residual).sum(axis=0)
    used = known >= FEWEST
    middle, level = np.zeros(len(used)), np.zeros(len(used))
    if used.any():
        middle[used], level[used] = np.nanmedian(residual[:, used], axis=0), np.nanmedian(datum[:, used], axis=0)
    return used, middle, level, known


def _together(
    seen: Sequence[_Seen], patterns: Patterns, excess: float, *, means: bool
) -> tuple[Scores | None, tuple[float, float] | None]:
    """Score the medians of the residuals over the records."""
    used, middle, level, known = _middle(seen)
    n_whole = sum(one.n_whole for one in seen)
    if n_whole < FEWEST or used.sum() < 2:
        return None, None
    slope, noise = (np.sum([getattr(one, name) for one in seen], axis=0) / n_whole for name in ("slope", "noise"))
    flow, floor = slope @ slope.T, (LASTING_FLOOR if means else FLOOR) ** 2 * np.eye(len(used))
    covariance = _OF_MEDIAN / known[used].min() * (excess * noise + flow) + floor + flow
    found = score_patterns(middle[None], covariance[None], used[None], patterns, level[None])
    if not means:
        return found, None
    column = slope[used, list(WIND).index("tilt")]
    weight = np.linalg.solve(covariance[np.ix_(used, used)], column)
    return found, (TILT_SD * float(weight @ middle[used]), TILT_SD * float(np.sqrt(max(1.0 - weight @ column, 0.0))))


def _swap_together(found: Sequence[Evidence]) -> tuple[int, int, float]:
    """Return the two beams whose exchange makes χ² of the medians over the records fall most, and by how much."""
    each = [one.together.swap for one in found if one.together is not None]
    if not each:
        return -1, -1, 0.0
    first, second, fall = _best_swap(np.asarray(sum(np.where(np.isfinite(one), one, 0.0) for one in each)))[0]
    return int(first), int(second), float(fall)


def _probability(found: Sequence[Evidence]) -> FloatArray:
    """Return the smallest probability of each record times the number of probabilities; NaN where there is none."""
    each = np.stack([p for one in found for p in (one.p_square, one.p_pattern)])
    known = np.isfinite(each).sum(axis=0)
    least = np.min(np.where(np.isfinite(each), each, np.inf), axis=0)
    return np.where(known > 0, np.minimum(known * np.where(known > 0, least, 1.0), 1.0), np.nan)


def _scatter(
    some: Sequence[tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.int64]]],
    left: FloatArray,
    sound: NDArray[np.bool_],
    accuracy: float,
) -> tuple[float, float, float] | None:
    """Return by which factor data scatter more than noise where flow cannot move them, with its 90 % interval."""
    if sound.sum() < FEWEST or sound.mean() < _SOUND:  # of few that are left, one would take those that scatter least
        return None
    known = np.isfinite(left[sound]).sum(axis=0) >= FEWEST
    middle = np.zeros(left.shape[1])
    middle[known] = np.nanmedian(left[sound][:, known], axis=0)
    noise, slope, residual, used, record = (np.concatenate(parts) for parts in zip(*some, strict=True))
    residual = residual - np.where(used, middle, 0.0)
    looked_at = sound[record] & used.any(axis=1)
    square, count = np.zeros(len(record)), np.zeros(len(record), dtype=np.int64)
    for beams in np.unique(used[looked_at], axis=0):
        rows = np.flatnonzero(looked_at & (used == beams).all(axis=1))
        own = noise[np.ix_(rows, beams, beams)]
        own_slope, own_residual = slope[np.ix_(rows, beams)], residual[np.ix_(rows, beams)]
        square[rows], count[rows] = _of_noise(own, own_slope, own_residual, accuracy)
    square, count = square[count > 0], count[count > 0]
    if len(square) < FEWEST:
        return None
    n = len(square)
    draws = np.random.default_rng(0).integers(0, n, (_N_BOOT, n))
    factor = float(square.sum() / count.sum())
    ends = np.quantile(square[draws].sum(axis=1) / count[draws].sum(axis=1), [0.05, 0.95])
    # few records drawn again scatter less than others of their kind do
    wider = np.sqrt(n / (n - 1.0)) * scipy.special.stdtrit(n - 1, 0.95) / scipy.special.ndtri(0.95)
    low, high = factor * (ends / factor) ** wider if factor > 0.0 else ends
    total = float(count.sum())  # and a few numbers, drawn again, less than χ² does
    least, most = (total * factor / float(scipy.stats.chi2.ppf(level, total)) for level in (0.95, 0.05))
    return factor, min(float(low), least), max(float(high), most)


def _of_noise(
    noise: FloatArray, slope: FloatArray, residual: FloatArray, accuracy: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return χ² of records' residuals along the directions that flow hardly moves, and how many there are.

    Of these, the ones whose variance is below the accuracy of the noise are left out: they would tell of the theory.
    """
    identity = np.eye(noise.shape[-1])
    theory = noise - FLOOR**2 * identity
    diagonal = np.einsum("rbb->rb", theory)
    # ln(1 + K) is of each variance by itself; what beams have for themselves scatters with K, relative to their level
    own = theory * np.exp(diagonal.mean(axis=1))[:, None, None] + _NOISE_FLOOR**2 * identity
    root = np.linalg.cholesky(own)
    white = np.linalg.solve(root, np.concatenate([slope, residual[:, :, np.newaxis]], axis=2))
    left, size, _ = np.linalg.svd(white[:, :, :-1], full_matrices=True)
    power = np.zeros(residual.shape)
    power[:, : size.shape[1]] = size**2
    null = power < _NULL
    if accuracy > 0.0:
        limit = accuracy * diagonal.max(axis=1)
        each = [_above(*one) for one in zip(own, root, left, null, slope, residual, limit, strict=True)]
        return np.array([one[0] for one in each]), np.array([one[1] for one in each], dtype=np.int64)
    along = (left.swapaxes(-1, -2) @ white[:, :, -1:])[..., 0]
    return np.sum(np.where(null, along**2 / (1.0 + power), 0.0), axis=1), np.count_nonzero(null, axis=1)


def _above(
    own: FloatArray,
    root: FloatArray,
    left: FloatArray,
    null: NDArray[np.bool_],
    slope: FloatArray,
    residual: FloatArray,
    limit: float,
) -> tuple[float, int]:
    """Return χ² of one record along the directions that flow hardly moves and whose variance is above a limit."""
    base = np.linalg.qr(np.linalg.solve(root.T, left[:, null]))[0]
    variance, turn = np.linalg.eigh(base.T @ own @ base)
    direction = (base @ turn)[:, variance > limit]
    moved = variance[variance > limit] + np.sum((direction.T @ slope) ** 2, axis=1)
    return float(np.sum((direction.T @ residual) ** 2 / moved)), direction.shape[1]
