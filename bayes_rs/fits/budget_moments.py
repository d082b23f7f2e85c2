"""Moments of the posteriors of records with each source of uncertainty switched off, from one set of weighted draws."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.batch import Batch, posteriors
from bayes_rs.fits.budget_sources import frozen, known
from bayes_rs.fits.derived import with_derived
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_of
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.decided import PriorRoom, what_data_decided
from bayes_rs.posteriors.nuisance import Seen
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import laplace_proposal
from bayes_rs.posteriors.sampling.candidates import Candidates, resampled
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE
from bayes_rs.posteriors.sampling.points import draws_last, rotations
from bayes_rs.posteriors.sampling.streams import RecordStreams
from bayes_rs.priors.campaign import RecordsPrior
from bayes_rs.priors.interface import NormalPrior
from bayes_rs.priors.registry import Prior

_PILOT, _NARROW = 0.25, 0.25
"""Shares of the draws from the proposal at the mode, and from one fitted to the posterior with all sources known."""
_PRIOR_DRAWS, _PRIOR_SEED = 20_000, 0
ENOUGH, _EXTENSIONS = 250.0, 5
"""Effective draws that every case of a record should have, and how often its draws may be doubled for that."""
_TOGETHER = 32
"""Records that are drawn more of together, twice as many draws at a time."""
OVER_CASES = ("weight", "mean", "variance", "effective")
"""What of `Moments` has the cases as its first axis."""


@dataclass(frozen=True)
class Moments:
    """Moments of the posteriors of some records; each set of draws has its own, for the Monte-Carlo error.

    Parameters
    ----------
    weight : ndarray, shape (n_case, n_record, n_set)
        Weight of each set; they sum to 1.
    mean, variance : ndarray, shape (n_case, n_record, n_quantity, n_set)
        Of the first case, with everything uncertain, of that with each source known, and of that with all known.
    by_data : ndarray, shape (n_record, n_quantity, n_datum, n_set)
        In the last case: how far the mean moves with a standard deviation of each datum.
    by_prior : ndarray, shape (n_record, n_quantity, n_coordinate, n_set)
        The same, of the prior's centre along each of its standard coordinates.
    low, high : ndarray, shape (n_record, n_quantity)
        Ends of the interval of the first case.
    decided : ndarray, shape (n_record, 6)
        Share of each stress that the data decided, in the first case.
    effective : ndarray, shape (n_case, n_record)
        Effective numbers of draws.
    """

    weight: FloatArray
    mean: FloatArray
    variance: FloatArray
    by_data: FloatArray
    by_prior: FloatArray
    low: FloatArray
    high: FloatArray
    decided: FloatArray
    effective: FloatArray


def switched_moments(
    batch: Batch, noise: Noise, options: FitOptions, sources: Sequence[str], room: PriorRoom, n_draw: int
) -> list[tuple[NDArray[np.int64], Moments]]:
    """Return the moments of records, some together, each with the rows of the batch that they are of.

    Parameters
    ----------
    batch, noise, options
        As for `fit_batch`.
    sources : sequence of str
        What is switched off, one by one and then all together.
    room : PriorRoom
        What the prior leaves open.
    n_draw : int
        Draws of a record.

    Notes
    -----
    Draws come from Student-t proposals that are fitted to the posterior with everything uncertain, and to that with
    everything known (`Candidates`), and are weighted anew for each case: differences between cases have little of the
    draws' own scatter. A source that is sampled keeps its coordinate, which then moves nothing and is as in its prior.
    """
    cases: list[Collection[str]] = [(), *((name,) for name in sources), tuple(sources)]
    made = [posteriors(*_at(case, batch, noise, options)) for case in cases]
    found = []
    for place, (rows, full) in enumerate(made[0]):
        some = batch.take(rows)
        of_cases = [(one[place][1], frozen(case, options)) for one, case in zip(made, cases, strict=True)]
        found.append((rows, _of_posterior(some, full, of_cases, options, room, n_draw)))
    return found


def _at(case: Collection[str], batch: Batch, noise: Noise, options: FitOptions) -> tuple[Batch, Noise, FitOptions]:
    own, changed = known(case, batch, options)
    return own, noise, changed


Case = tuple[Posterior, list[int]]
"""The posterior of a case, and which coordinates of the nuisances it holds at zero."""


def _of_posterior(
    batch: Batch, full: Posterior, cases: Sequence[Case], options: FitOptions, room: PriorRoom, n_draw: int
) -> Moments:
    everyone, size = np.arange(len(batch)), n_draw // N_ENSEMBLE
    streams = RecordStreams(options.seed, batch.key)
    drawn = Candidates(full, rotations(streams, everyone, N_ENSEMBLE, full.n_coordinate), options.seed)
    offset = streams.uniform(everyone, (N_ENSEMBLE,))
    drawn.draw(laplace_proposal(full), int(_PILOT * size))
    _draw_narrow(drawn, cases, int(_NARROW * size))
    drawn.draw(drawn.fitted(), size - drawn.total_size)
    return _with_enough(batch, drawn, cases, options, room, offset, n_draw, 1)


def _with_enough(
    batch: Batch,
    drawn: Candidates,
    cases: Sequence[Case],
    options: FitOptions,
    room: PriorRoom,
    offset: FloatArray,
    n_draw: int,
    extension: int,
) -> Moments:
    """Return the moments of draws; records with too few effective ones get twice as many, and again."""
    found = _moments(batch, drawn, cases, options, room, offset, n_draw)
    short = np.flatnonzero(found.effective.min(axis=0) < ENOUGH)
    if extension > _EXTENSIONS:
        return found
    together = max(1, _TOGETHER // 2**extension)  # the fewer, the more draws each has: memory does not grow
    for few in (short[first : first + together] for first in range(0, len(short), together)):
        more, of_few = drawn.take(few), [(posterior.take(few), held) for posterior, held in cases]
        half = more.total_size // 2
        _draw_narrow(more, of_few, half)
        more.draw(more.fitted(), half)
        other = _with_enough(batch.take(few), more, of_few, options, room, offset[few], n_draw, extension + 1)
        for field in fields(Moments):
            place = (slice(None), few) if field.name in OVER_CASES else few
            getattr(found, field.name)[place] = getattr(other, field.name)
    return found


def _draw_narrow(drawn: Candidates, cases: Sequence[Case], size: int) -> None:
    """Add draws of a proposal that is fitted to the posterior with all sources known."""
    drawn.draw(drawn.fitted_with(_weights(drawn, *_densities(drawn, *cases[-1]))), size)


def _moments(
    batch: Batch,
    drawn: Candidates,
    cases: Sequence[Case],
    options: FitOptions,
    room: PriorRoom,
    offset: FloatArray,
    n_keep: int,
) -> Moments:
    stress = np.moveaxis(drawn.all_stresses(), 1, -1)
    speed = batch.wind_speed[:, np.newaxis, np.newaxis]
    value = np.moveaxis(with_derived(stress, options.derived, speed), -1, 1)  # (record, quantity, set, draw)
    weight = np.stack([_weights(drawn, *_densities(drawn, *case)) for case in cases])
    of_set = weight.sum(axis=-1)
    within = weight / np.where(of_set > 0.0, of_set, 1.0)[..., np.newaxis]
    mean = np.einsum("crsn,rqsn->crqs", within, value)
    square = np.einsum("crsn,rqsn->crqs", within, value * value)
    centred = (value - mean[-1][..., np.newaxis]) * within[-1][:, np.newaxis]
    size = n_keep // N_ENSEMBLE
    picked = resampled(weight[0], offset, size * N_ENSEMBLE)
    kept = np.take_along_axis(value.reshape(*value.shape[:2], -1), picked[:, np.newaxis], axis=-1)
    low, high = interval_of(kept, options.prob, options.interval)
    of_sets = np.moveaxis(kept[:, : len(STRESSES)], 1, -1).reshape(len(batch), N_ENSEMBLE, size, len(STRESSES))
    shape = (len(batch), N_ENSEMBLE, drawn.total_size)
    residual = _residuals(drawn, *cases[-1]).reshape(*shape, -1)
    standard = _standard(drawn.posterior.prior, draws_last(drawn.all_coordinates())).reshape(*shape, -1)
    return Moments(
        of_set,
        mean,
        square - mean * mean,
        np.einsum("rqsn,rsnk->rqks", centred, residual),
        np.einsum("rqsn,rsnk->rqks", centred, standard),
        low,
        high,
        what_data_decided(of_sets, room)[0],
        1.0 / np.sum(weight * weight, axis=(2, 3)),
    )


def _seen(posterior: Posterior, stress: FloatArray, coordinate: FloatArray, held: list[int]) -> Seen:
    """Return what the likelihood takes of draws, with some of the nuisances at their central values."""
    if posterior.nuisances.n_coordinate == 0:
        return Seen(stress)
    own = coordinate[..., posterior.prior.n_coordinate :].copy()
    own[..., held] = 0.0
    return posterior.nuisances.apply(stress, own)


def _flat(drawn: Candidates) -> tuple[FloatArray, FloatArray]:
    """Return stresses (n_record, n_draw, 6) and coordinates (n_record, n_draw, n) of all sets together."""
    return draws_last(drawn.all_stresses()), draws_last(drawn.all_coordinates())


def _densities(drawn: Candidates, posterior: Posterior, held: list[int]) -> tuple[FloatArray, FloatArray]:
    """Return the log-posterior of draws, (n_record, n_draw), in a case, and that of everything uncertain."""
    stress, coordinate = _flat(drawn)
    density = posterior.likelihood.log_density(*_seen(posterior, stress, coordinate, held))
    return density + posterior.log_prior(coordinate), np.concatenate(drawn.log_density, axis=-1)


def _weights(drawn: Candidates, density: FloatArray, whole: FloatArray) -> FloatArray:
    """Return the weights of draws in a case, shape (n_record, n_set, n), which sum to 1."""
    with np.errstate(invalid="ignore"):  # a draw that the data rule out has no weight in any case
        change = density.reshape(whole.shape) - whole
        log_weight = np.where(np.isfinite(whole), drawn.log_weight() + change, -np.inf)
    peak = log_weight.max(axis=(1, 2), keepdims=True)
    weight = np.exp(log_weight - np.where(np.isfinite(peak), peak, 0.0))
    return np.asarray(weight / weight.sum(axis=(1, 2), keepdims=True))


def _residuals(drawn: Candidates, posterior: Posterior, held: list[int]) -> FloatArray:
    """Return the data's residuals, of unit variance, at draws: shape (n_record, n_draw, n_datum)."""
    stress, coordinate = _flat(drawn)
    with np.errstate(invalid="ignore"):
        found = posterior.likelihood.whitened_residual(*_seen(posterior, stress, coordinate, held))
    return np.nan_to_num(found)  # of draws without weight


def _standard(prior: Prior, coordinate: FloatArray) -> FloatArray:
    """Return the prior's coordinates, uncorrelated and of unit variance under it, at draws (n_record, n_draw, n)."""
    own = coordinate[..., : prior.n_coordinate]
    if isinstance(prior, NormalPrior):
        return own
    if isinstance(prior, RecordsPrior):
        return np.asarray(np.linalg.solve(prior.root, (own - prior.mean[:, np.newaxis]).swapaxes(1, 2)).swapaxes(1, 2))
    drawn = prior.draw_coordinate(_PRIOR_DRAWS, np.random.default_rng(_PRIOR_SEED))
    factor = np.linalg.cholesky(np.cov(drawn, rowvar=False).reshape(prior.n_coordinate, -1))
    return np.asarray(np.linalg.solve(factor, (own - drawn.mean(axis=0)).swapaxes(-1, -2)).swapaxes(-1, -2))
