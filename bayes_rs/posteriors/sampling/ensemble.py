"""emcee on many records at once: one ensemble whose walkers never leave their own record."""

from __future__ import annotations

from dataclasses import dataclass, field

import emcee
import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import StudentProposal, laplace_proposal
from bayes_rs.posteriors.sampling.candidates import Candidates, evaluate_in_blocks, resampled
from bayes_rs.posteriors.sampling.chains import (
    N_CHAIN,
    N_ENSEMBLE,
    PARETO_K_LIMIT,
    Chains,
    empty_chains,
    kept_draws,
    records_together,
)
from bayes_rs.posteriors.sampling.effort import Effort
from bayes_rs.posteriors.sampling.pareto import pareto_k
from bayes_rs.posteriors.sampling.points import draws_last, placed, rotations, student_points
from bayes_rs.posteriors.sampling.streams import RecordStreams
from bayes_rs.posteriors.sampling.walkers import N_KEPT, diagnose_walkers

N_HALF = 2 * N_ENSEMBLE
"""Half ensembles: walkers of one half move along differences of the other's, whose points are scrambled for itself."""
_DIFFERENTIAL_EVERY = 4
"""Of so many steps the first is differential evolution, the others are independent proposals."""
_PILOT = 2
"""One candidate of the proposal at the mode for so many of the one that is fitted to them, of which there is one for
each walker."""
_WORTH = 0.5
"""Least effective size of the weighted candidates, in walkers that start from them."""
_STAGE = 1000
"""Tells the points of the chain's steps from those of the candidates that it starts from."""


def sample_emcee(posterior: Posterior, *, streams: RecordStreams, effort: Effort) -> Chains:
    """Sample records with emcee ensembles of many walkers and few steps; double the steps of those that fall short.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records.
    streams : RecordStreams
        Their random streams.
    effort : Effort
        Effective sample size to reach, and how often a chain may be doubled for it.

    Returns
    -------
    chains : Chains
        The draws. A chain holds walkers of one ensemble, `N_KEPT` steps of one, then those of its neighbour. A record
        that falls short has its proposal fitted again, to its draws, and walks on: half as many steps as are then made
        are thrown away, and every second, fourth, … is kept of the others, so that the draws are as many as before.
    """
    n_draw = kept_draws(effort.target_ess)
    everyone = np.arange(posterior.n_record)
    chains = empty_chains(posterior.n_record, n_draw, posterior.n_coordinate, "emcee")
    sampler = RecordSampler(
        posterior, effort.seed, streams, n_walker=n_draw * N_CHAIN // N_KEPT, max_extension=effort.max_extension
    )
    going, batch = everyone, records_together(n_draw)
    for extension in range(effort.max_extension + 1):
        stride = 2**extension
        if extension:
            sampler.refit(going, chains.coordinate[going])
        for start in range(0, len(going), batch):
            records = going[start : start + batch]
            if extension:  # what fell short may not have begun at the posterior
                sampler.run(N_KEPT * stride // 2, records, stage=-extension)
            coordinate, acceptance = sampler.run(N_KEPT * stride, records, stage=extension, thin_by=stride)
            _keep(posterior.take(records), coordinate, acceptance, stride, records, chains)
            nowhere = records[np.isneginf(sampler.log_density[records]).any(axis=1)]
            chains.ess_bulk[nowhere] = chains.ess_tail[nowhere] = np.nan  # no draws of a posterior
        chains.pareto_k[:] = sampler.pareto_k
        going = np.flatnonzero(chains.missed(effort.target_ess))
        if len(going) == 0:
            break
    return chains


def _keep(
    posterior: Posterior,
    coordinate: FloatArray,
    acceptance: FloatArray,
    stride: int,
    records: NDArray[np.int64],
    chains: Chains,
) -> None:
    """Enter the draws of some records, (n, k, n_walker, N_KEPT), and what they say of themselves."""
    draws = draws_last(coordinate)
    stress = posterior.stress(draws)
    chains.put_draws(records, draws, stress)
    found = diagnose_walkers(stress.swapaxes(1, 2).reshape(len(records), 6, -1, N_KEPT))
    chains.ess_bulk[records], chains.ess_tail[records] = found.ess_bulk, found.ess_tail
    chains.r_hat[records], chains.drift[records] = found.r_hat, found.drift
    with np.errstate(divide="ignore", invalid="ignore"):
        chains.autocorrelation_time[records] = stride * draws.shape[1] / found.ess_bulk
    chains.acceptance[records] = acceptance
    chains.n_step[records] = stride * N_KEPT


@dataclass
class RecordSampler:
    """Samples the posteriors of many records with one emcee ensemble.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records.
    seed : int
        Seed of the fit.
    streams : RecordStreams
        The records' random streams.
    n_walker : int
        Walkers of each record: a multiple of `N_HALF`.
    max_extension : int
        How often the candidates of a record may be doubled, where the weights of those that there are do not do.

    Attributes
    ----------
    proposal : StudentProposal
        That of the independent steps.
    coordinate : ndarray, shape (n_record, k, n_walker)
        Where the walkers are, in the posterior's coordinates; those of one ensemble are neighbours.
    log_density : ndarray, shape (n_record, n_walker)
        The log-posterior there.
    pareto_k : ndarray, shape (n_record,)
        Tail of the weights of the candidates that the walkers started from.

    Notes
    -----
    The walkers start at weighted candidates, as direct draws do (`Candidates`): at the posterior, up to the error of as
    many weighted draws. Where these are worth less than half as many draws as there are walkers, or the tail of the
    weights is too heavy, candidates are doubled: few steps from a start that lacks the tails do not find them. The
    proposal is then fitted to the candidates, and stays as it is while the walkers move, so that each step leaves the
    posterior unchanged, whatever the weights were.

    The walkers of a record form `N_ENSEMBLE` ensembles. Of four steps, three are independence proposals from a
    Student-t, accepted by Metropolis–Hastings; the first is differential evolution inside an ensemble (Nelson, Ford and
    Payne 2014), which needs no knowledge of the posterior. Both leave each record's posterior unchanged, whatever the
    other records do. The independence proposals of a step are scrambled Sobol points, one for each walker and
    scrambled anew in each step, so that each walker's own are independent draws from step to step. They are shared by
    all records, and turned for each by rotations of its own. The numbers that decide about acceptance come from the
    record's stream.

    References
    ----------
    Foreman-Mackey et al. (2013), PASP 125, 306, doi:10.1086/670067.
    Nelson, Ford and Payne (2014), ApJS 210, 11, doi:10.1088/0067-0049/210/1/11.
    Tierney (1994), Ann. Statist. 22, 1701–1762, doi:10.1214/aos/1176325750 (independence proposals).
    """

    posterior: Posterior
    seed: int
    streams: RecordStreams
    n_walker: int
    max_extension: int = 0
    proposal: StudentProposal = field(init=False)
    coordinate: FloatArray = field(init=False)
    log_density: FloatArray = field(init=False)
    pareto_k: FloatArray = field(init=False)
    rotation: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Draw candidates, start the walkers from them, and fit the proposal to them."""
        n_record, k = self.posterior.n_record, self.posterior.n_coordinate
        everyone = np.arange(n_record)
        self.proposal = laplace_proposal(self.posterior)
        self.rotation = rotations(self.streams, everyone, N_HALF, k)
        self.coordinate = np.empty((n_record, k, self.n_walker))
        self.log_density = np.empty((n_record, self.n_walker))
        self.pareto_k = np.empty(n_record)
        size = self.n_walker // N_HALF
        batch = records_together(self.n_walker * N_KEPT // N_CHAIN)
        for start in range(0, n_record, batch):
            records = everyone[start : start + batch]
            found = Candidates(self.posterior.take(records), self.rotation[records], self.seed)
            found.draw(self.proposal.take(records), size // _PILOT)
            found.draw(found.fitted(), size)
            self._start(found, records, 1)

    def _start(self, found: Candidates, records: NDArray[np.int64], extension: int) -> None:
        """Start the walkers of some records from their candidates; first double those that do not do, and again."""
        weight, log_weight = found.weight()
        flat = weight.reshape(len(records), -1)
        self.pareto_k[records] = pareto_k(log_weight.reshape(flat.shape))
        too_few = np.sum(flat * flat, axis=1) > 1.0 / (_WORTH * self.n_walker)
        short = too_few | (self.pareto_k[records] > PARETO_K_LIMIT)
        if extension > self.max_extension or not short.any():
            self._enter(found, weight, records)
            return
        enough = np.flatnonzero(~short)
        if len(enough):
            self._enter(found.take(enough), weight[enough], records[enough])
        some = np.flatnonzero(short)
        for rows in np.array_split(some, -(-len(some) * 2**extension // len(records))):
            if len(rows):
                part = found.take(rows)
                part.draw(part.fitted_with(weight[rows]), part.total_size)
                self._start(part, records[rows], extension + 1)

    def _enter(self, found: Candidates, weight: FloatArray, records: NDArray[np.int64]) -> None:
        """Resample the walkers of some records from their candidates, and fit the proposal to these."""
        by_ensemble = weight.reshape(len(records), N_ENSEMBLE, -1)
        density = np.concatenate(found.log_density, axis=-1).reshape(len(records), -1)
        coordinates = found.all_coordinates().reshape(len(records), self.coordinate.shape[1], -1)
        index = resampled(by_ensemble, self.streams.uniform(records, (N_ENSEMBLE,)), self.n_walker)
        for record, one, coordinate, of_one in zip(records, index, coordinates, density, strict=True):
            np.take(coordinate, one, axis=1, out=self.coordinate[record], mode="clip")
            np.take(of_one, one, out=self.log_density[record], mode="clip")
        self._put(records, found.fitted_with(weight))

    def _put(self, records: NDArray[np.int64], fitted: StudentProposal) -> None:
        self.proposal.mode[records], self.proposal.factor[records] = fitted.mode, fitted.factor

    def refit(self, records: NDArray[np.int64], draws: FloatArray) -> None:
        """Fit the proposal of some records to draws of theirs, shape (n, …, k)."""
        flat = draws.reshape(len(records), -1, draws.shape[-1])
        weight = np.full(flat.shape[:2], 1.0 / flat.shape[1])
        self._put(records, self.proposal.take(records).fitted_to(flat, weight))

    def run(
        self, n_step: int, records: NDArray[np.int64], *, stage: int = 0, thin_by: int = 1
    ) -> tuple[FloatArray, FloatArray]:
        """Advance the walkers of some records.

        Parameters
        ----------
        n_step : int
            Number of steps.
        records : ndarray of int, shape (n,)
            Which records.
        stage : int
            What tells these steps from the records' others: their points are scrambled by it.
        thin_by : int
            Steps of which one is kept.

        Returns
        -------
        coordinate : ndarray, shape (n, k, n_walker, n_step // thin_by)
            Where the walkers were, in the posterior's coordinates.
        acceptance : ndarray, shape (n,)
            Share of accepted proposals.
        """
        posterior, k = self.posterior.take(records), self.posterior.n_coordinate

        def log_probability(flat: FloatArray) -> FloatArray:
            return posterior.log_density(flat.reshape(len(records), -1, k)).ravel()

        move = _WithinRecordMove(self, posterior, records, n_step, stage)
        sampler = emcee.EnsembleSampler(len(records) * self.n_walker, k, log_probability, moves=move, vectorize=True)
        # the move draws from the records' own streams; emcee picks the move with its own state, so that is set too
        sampler.random_state = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(self.seed))).get_state()
        start = emcee.State(_flat(self.coordinate[records]), log_prob=self.log_density[records].ravel())
        sampler.run_mcmc(start, n_step // thin_by, thin_by=thin_by, skip_initial_state_check=True)
        self.coordinate[records], self.log_density[records] = move.position, move.log_density
        chain = sampler.get_chain().reshape(n_step // thin_by, len(records), self.n_walker, k)
        return np.ascontiguousarray(chain.transpose(1, 3, 2, 0)), move.accepted / (n_step * self.n_walker)


def _flat(coordinate: FloatArray) -> FloatArray:
    """Return coordinates (n_record, k, n_walker) as emcee has them, one row a walker."""
    return coordinate.swapaxes(1, 2).reshape(-1, coordinate.shape[1])


class _WithinRecordMove(emcee.moves.Move):  # type: ignore[misc]  # emcee has no types
    """Independence proposals and differential evolution, each inside a record."""

    def __init__(
        self, sampler: RecordSampler, posterior: Posterior, records: NDArray[np.int64], n_step: int, stage: int
    ) -> None:
        n_record, n_walker, k = len(records), sampler.n_walker, posterior.n_coordinate
        self._posterior = posterior
        self._proposal = sampler.proposal.take(records)
        self.position = sampler.coordinate[records]
        self.log_density = sampler.log_density[records]
        self.accepted = np.zeros(n_record)
        self._log_uniform = np.log1p(-sampler.streams.uniform(records, (n_step, n_walker)))
        self._key = (sampler.seed, _STAGE + stage)
        self._shared = np.random.default_rng(np.random.SeedSequence([*self._key, k]))
        self._rotation = sampler.rotation[records]
        self._step = 0

    def propose(
        self,
        model: emcee.model.Model,  # noqa: ARG002 - emcee hands it over
        state: emcee.State,
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Make one step of all walkers."""
        step, self._step = self._step, self._step + 1
        moved = self._differential(step) if step % _DIFFERENTIAL_EVERY == 0 else self._independent(step)
        self.accepted += moved.sum(axis=1)
        state.coords[...] = _flat(self.position)
        state.log_prob[...] = self.log_density.ravel()
        return state, moved.ravel()

    def _independent(self, step: int) -> NDArray[np.bool_]:
        n_record, k, n_walker = self.position.shape
        point, square = student_points(N_HALF, k, n_walker // N_HALF, *self._key, step)
        new = placed(self._proposal, self._rotation, point)
        log_density, _ = evaluate_in_blocks(self._posterior, draws_last(new))
        factor = self._proposal.log_density(draws_last(self.position))
        factor -= self._proposal.log_density_at(square.reshape(1, -1))
        return self._accept(new.reshape(n_record, k, n_walker), log_density, factor, self._log_uniform[:, step])

    def _differential(self, step: int) -> NDArray[np.bool_]:
        n_record, k, n_walker = self.position.shape
        # (record, k, ensemble, half, walker): views of where the walkers are
        walkers = self.position.reshape(n_record, k, N_ENSEMBLE, 2, -1)
        density = self.log_density.reshape(n_record, N_ENSEMBLE, 2, -1)
        log_uniform = self._log_uniform[:, step].reshape(density.shape)
        moved = np.zeros(density.shape, dtype=np.bool_)
        size = walkers.shape[-1]
        for half in (0, 1):
            # each walker moves along the difference of two of the resting half, as far from its own place as all are
            first = int(self._shared.integers(size))
            second = (first + 1 + int(self._shared.integers(size - 1))) % size
            scale = 2.38 / np.sqrt(2.0 * k) * (1.0 + 0.05 * self._shared.standard_normal())
            resting = walkers[:, :, :, 1 - half]
            new = scale * (np.roll(resting, first, axis=-1) - np.roll(resting, second, axis=-1))
            new += walkers[:, :, :, half]
            log_density, _ = evaluate_in_blocks(self._posterior, draws_last(new))
            log_density = log_density.reshape(n_record, N_ENSEMBLE, size)
            with np.errstate(invalid="ignore"):  # a walker that never had a density stays where it is
                accepted = log_uniform[:, :, half] < log_density - density[:, :, half]
            np.copyto(walkers[:, :, :, half], new, where=accepted[:, None])
            np.copyto(density[:, :, half], log_density, where=accepted)
            moved[:, :, half] = accepted
        return moved.reshape(n_record, n_walker)

    def _accept(
        self, new: FloatArray, log_density: FloatArray, factor: FloatArray, log_uniform: FloatArray
    ) -> NDArray[np.bool_]:
        """Accept or reject new positions (n_record, k, n_walker) of all walkers."""
        with np.errstate(invalid="ignore"):  # as above
            accepted = np.asarray(log_uniform < log_density - self.log_density + factor)
        np.copyto(self.position, new, where=accepted[:, None])
        np.copyto(self.log_density, log_density, where=accepted)
        return accepted
