"""emcee on many records at once: one ensemble whose walkers never leave their own record.

This is the only module that imports emcee.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import emcee
import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.likelihood import LogNormalLikelihood
from bayes_rs.prior import N_COORDINATE, Prior
from bayes_rs.proposal import DEGREES_OF_FREEDOM, StudentProposal, laplace_proposal, log_posterior

N_ENSEMBLE = 4
"""Independent ensembles of a record; R-hat compares them."""
N_WALKER = 8
"""Walkers of one ensemble."""
N_CHAIN = N_ENSEMBLE * N_WALKER
N_BURN_IN = 16
"""Steps that are thrown away: the walkers start at draws of the proposal that were resampled to the posterior."""
N_CANDIDATE = 256
"""Draws of the proposal from which the walkers' first positions are resampled."""
POOR_ACCEPTANCE = 0.4
"""A record whose burn-in accepts less than this has its proposal fitted again, to the burn-in."""
_DIFFERENTIAL_EVERY = 4
"""Every so many steps the move is differential evolution instead of an independent proposal."""


class RecordStreams:
    """One random stream for each record, so that a record's numbers do not depend on which others it is sampled with.

    Parameters
    ----------
    seed : int
        The seed of the whole fit.
    keys : sequence of int
        One number for each record, such as its start in nanoseconds; below zero before 1970.
    """

    def __init__(self, seed: int, keys: NDArray[np.int64]) -> None:
        self._streams = [
            np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, *divmod(int(key) % 2**64, 2**32)])))
            for key in keys
        ]

    def normal(self, records: NDArray[np.int64], shape: tuple[int, ...]) -> FloatArray:
        """Draw standard normal numbers, shape (len(records), *shape)."""
        return np.stack([self._streams[record].standard_normal(shape) for record in records])

    def chi_square(self, records: NDArray[np.int64], shape: tuple[int, ...]) -> FloatArray:
        """Draw χ² numbers with the proposal's degrees of freedom, shape (len(records), *shape)."""
        return np.stack(
            [2.0 * self._streams[record].standard_gamma(0.5 * DEGREES_OF_FREEDOM, shape) for record in records]
        )

    def uniform(self, records: NDArray[np.int64], shape: tuple[int, ...]) -> FloatArray:
        """Draw uniform numbers in [0, 1), shape (len(records), *shape)."""
        return np.stack([self._streams[record].random(shape) for record in records])


@dataclass
class RecordSampler:
    """Samples the posteriors of many records with one emcee ensemble.

    Parameters
    ----------
    likelihood : LogNormalLikelihood
        Likelihood of n_record records.
    prior : Prior
        The prior.
    seed : int
        Seed of the fit.
    keys : ndarray of int, shape (n_record,)
        What makes each record's random stream its own.

    Attributes
    ----------
    coordinate : ndarray, shape (n_record, N_CHAIN, 6)
        Where the walkers are, in the prior's coordinates.

    Notes
    -----
    The walkers of a record form `N_ENSEMBLE` ensembles. Three steps in four are independence proposals from a
    Student-t at the record's mode, accepted by Metropolis–Hastings; every fourth is differential evolution inside an
    ensemble (Nelson, Ford and Payne 2014), which needs no knowledge of the posterior. Both leave each record's
    posterior unchanged, whatever the other records do. The random numbers of a record come from its own stream.

    References
    ----------
    Foreman-Mackey et al. (2013), PASP 125, 306, doi:10.1086/670067.
    Nelson, Ford and Payne (2014), ApJS 210, 11, doi:10.1088/0067-0049/210/1/11.
    """

    likelihood: LogNormalLikelihood
    prior: Prior
    seed: int
    keys: NDArray[np.int64]
    coordinate: FloatArray = field(init=False)
    proposal: StudentProposal = field(init=False)
    streams: RecordStreams = field(init=False)
    burn_in_acceptance: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Find the modes, place the walkers, burn in, and mend poor proposals."""
        everyone = np.arange(len(self.keys))
        self.streams = RecordStreams(self.seed, self.keys)
        self.proposal = laplace_proposal(self.likelihood, self.prior)
        self.coordinate = self._first_positions(everyone)
        draws, self.burn_in_acceptance = self.run(N_BURN_IN, everyone)
        poor = np.flatnonzero(self.burn_in_acceptance < POOR_ACCEPTANCE)
        if len(poor):
            draws, _ = self.run(2 * N_BURN_IN, poor)
            self.proposal = _refitted(self.proposal, poor, draws)
            self.run(N_BURN_IN, poor)

    def run(self, n_step: int, records: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Advance the walkers of some records.

        Parameters
        ----------
        n_step : int
            Number of steps.
        records : ndarray of int, shape (n,)
            Which records.

        Returns
        -------
        coordinate : ndarray, shape (n, N_CHAIN, n_step, 6)
            Where the walkers were after each step, in the prior's coordinates.
        acceptance : ndarray, shape (n,)
            Share of accepted proposals.
        """
        likelihood, proposal = self.likelihood.take(records), self.proposal.take(records)
        n = len(records)

        def log_probability(flat: FloatArray) -> FloatArray:
            return log_posterior(likelihood, self.prior, flat.reshape(n, -1, N_COORDINATE)).ravel()

        move = _WithinRecordMove(proposal, self.streams, records, n_step)
        sampler = emcee.EnsembleSampler(n * N_CHAIN, N_COORDINATE, log_probability, moves=move, vectorize=True)
        # the move draws from the records' own streams; emcee picks the move with its own state, so that is set too
        sampler.random_state = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(self.seed))).get_state()
        state = sampler.run_mcmc(
            self.coordinate[records].reshape(-1, N_COORDINATE), n_step, skip_initial_state_check=True
        )
        self.coordinate[records] = state.coords.reshape(n, N_CHAIN, N_COORDINATE)
        chain = sampler.get_chain().reshape(n_step, n, N_CHAIN, N_COORDINATE)
        acceptance = sampler.acceptance_fraction.reshape(n, N_CHAIN).mean(axis=1)
        return np.moveaxis(chain, 0, 2), acceptance

    def _first_positions(self, records: NDArray[np.int64]) -> FloatArray:
        """Resample draws of the proposal to the posterior by systematic resampling."""
        normal = self.streams.normal(records, (N_CANDIDATE, N_COORDINATE))
        candidate = self.proposal.transform(normal, self.streams.chi_square(records, (N_CANDIDATE,)))
        log_weight = log_posterior(self.likelihood, self.prior, candidate) - self.proposal.log_density(candidate)
        weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        level = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
        offset = (self.streams.uniform(records, (1,)) + np.arange(N_CHAIN)) / N_CHAIN
        index = np.minimum((level[:, None, :] < offset[:, :, None]).sum(axis=2), N_CANDIDATE - 1)
        # neighbours in the candidates' order are independent draws, so that ensembles may be cut out of them in order
        return np.take_along_axis(candidate, index[..., None], axis=1)


class _WithinRecordMove(emcee.moves.Move):  # type: ignore[misc]
    """Independence proposals and differential evolution, each inside a record, from the records' own streams."""

    def __init__(
        self, proposal: StudentProposal, streams: RecordStreams, records: NDArray[np.int64], n_step: int
    ) -> None:
        self._proposal = proposal
        shape = (n_step, N_CHAIN)
        self._normal = streams.normal(records, (*shape, N_COORDINATE))
        self._chi_square = streams.chi_square(records, shape)
        self._log_uniform = np.log1p(-streams.uniform(records, shape))
        self._pick = streams.uniform(records, (*shape, 2))
        self._records = len(records)
        self._step = 0

    def propose(self, model: emcee.model.Model, state: emcee.State) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Make one step of all walkers."""
        step, self._step = self._step, self._step + 1
        if step % _DIFFERENTIAL_EVERY == _DIFFERENTIAL_EVERY - 1:
            return self._differential(model, state, step)
        return self._independent(model, state, step)

    def _independent(
        self, model: emcee.model.Model, state: emcee.State, step: int
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        old = state.coords.reshape(self._records, N_CHAIN, N_COORDINATE)
        new = self._proposal.transform(self._normal[:, step], self._chi_square[:, step])
        factor = self._proposal.log_density(old) - self._proposal.log_density(new)
        return self._accept(model, state, new, factor, self._log_uniform[:, step], slice(None))

    def _differential(
        self, model: emcee.model.Model, state: emcee.State, step: int
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        half = N_WALKER // 2
        walker = np.arange(N_CHAIN).reshape(N_ENSEMBLE, N_WALKER)
        accepted = np.zeros(self._records * N_CHAIN, dtype=bool)
        for moving, resting in ((walker[:, :half], walker[:, half:]), (walker[:, half:], walker[:, :half])):
            position = state.coords.reshape(self._records, N_CHAIN, N_COORDINATE)
            index = moving.ravel()
            pick = self._pick[:, step, index]
            first = (pick[..., 0] * half).astype(np.int64)
            second = (first + 1 + (pick[..., 1] * (half - 1)).astype(np.int64)) % half
            home = resting[index // N_WALKER]  # the resting half of each moving walker's own ensemble
            rows = np.arange(self._records)[:, None]
            columns = np.arange(len(index))[None, :]
            difference = position[rows, home[columns, first]] - position[rows, home[columns, second]]
            normal = self._normal[:, step, index]
            scale = (2.38 / np.sqrt(2.0 * N_COORDINATE)) * (1.0 + 0.05 * normal[..., :1])
            new = position[:, index] + scale * difference
            state, moved = self._accept(
                model, state, new, np.zeros(new.shape[:2]), self._log_uniform[:, step, index], index
            )
            accepted |= moved
        return state, accepted

    def _accept(
        self,
        model: emcee.model.Model,
        state: emcee.State,
        new: FloatArray,
        factor: FloatArray,
        log_uniform: FloatArray,
        walkers: slice | NDArray[np.int64],
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Accept or reject the new positions of some walkers, shape (n_record, n, 6)."""
        log_probability, _ = model.compute_log_prob_fn(new.reshape(-1, N_COORDINATE))
        log_probability = log_probability.reshape(new.shape[:2])
        current = state.log_prob.reshape(self._records, N_CHAIN)
        accepted = log_uniform < log_probability - current[:, walkers] + factor
        mask = np.zeros((self._records, N_CHAIN), dtype=bool)
        mask[:, walkers] = accepted
        state.coords.reshape(self._records, N_CHAIN, N_COORDINATE)[mask] = new[accepted]
        current[mask] = log_probability[accepted]
        return state, mask.ravel()


def _refitted(proposal: StudentProposal, records: NDArray[np.int64], draws: FloatArray) -> StudentProposal:
    """Give some records a proposal with the mean and covariance of draws, shape (n, chain, step, 6)."""
    mode, factor = proposal.mode.copy(), proposal.factor.copy()
    for record, sample in zip(records, draws.reshape(len(records), -1, N_COORDINATE), strict=True):
        covariance = np.cov(sample, rowvar=False)
        if np.linalg.eigvalsh(covariance)[0] > 1e-8:  # walkers that did not spread say nothing: keep the first proposal
            mode[record] = sample.mean(axis=0)
            factor[record] = np.linalg.cholesky(np.linalg.inv(covariance)).T
    return StudentProposal(mode, factor, proposal.n_iteration)
