"""emcee on many records at once: one ensemble whose walkers never leave their own record."""

from __future__ import annotations

from dataclasses import dataclass, field

import emcee
import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import DEGREES_OF_FREEDOM, StudentProposal, laplace_proposal
from bayes_rs.posteriors.sampling.chains import (
    N_CHAIN,
    N_ENSEMBLE,
    N_WALKER,
    Chains,
    Effort,
    diagnose_stress,
    kept_draws,
)
from bayes_rs.posteriors.sampling.streams import RecordStreams

N_BURN_IN = 16
"""Steps that are thrown away: the walkers start at draws of the proposal that were resampled to the posterior."""
N_CANDIDATE = 256
"""Draws of the proposal from which the walkers' first positions are resampled."""
POOR_ACCEPTANCE = 0.4
"""A record whose burn-in accepts less than this has its proposal fitted again, to the burn-in."""
_STRIDE = 2
"""Steps between draws that are kept, which is about the autocorrelation time."""
_DIFFERENTIAL_EVERY = 4
"""Every so many steps the move is differential evolution instead of an independent proposal."""


def sample_emcee(posterior: Posterior, *, streams: RecordStreams, effort: Effort) -> Chains:
    """Sample records with one emcee ensemble; double the chains of those that miss the target, up to a budget.

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
        The draws; a doubled chain is thinned to the length of the others.
    """
    n_draw = kept_draws(effort.target_ess)
    sampler = RecordSampler(posterior, effort.seed, streams)
    everyone = np.arange(posterior.n_record)
    coordinate, acceptance = sampler.run(_STRIDE * n_draw, everyone)
    coordinate = np.ascontiguousarray(coordinate[:, :, _STRIDE - 1 :: _STRIDE])
    stress = posterior.stress(coordinate)
    found, time = diagnose_stress(stress)
    chains = Chains(
        coordinate,
        stress,
        found.ess_bulk,
        found.ess_tail,
        found.r_hat,
        time * _STRIDE,
        acceptance,
        np.full(len(everyone), _STRIDE * n_draw),
        np.full(len(everyone), np.nan),
        np.full(len(everyone), "emcee", dtype="U16"),
    )
    for extension in range(effort.max_extension):
        missing = np.flatnonzero(chains.missed(effort.target_ess))
        if len(missing) == 0:
            break
        stride = _STRIDE * 2 ** (extension + 1)
        more, more_acceptance = sampler.run(n_draw * stride // 2, missing)
        # one in two of the old draws (thinned to every stride/2 steps) and one in `stride` of the new ones
        new = more[:, :, stride - 1 :: stride]
        longer = np.concatenate([chains.coordinate[missing][:, :, 1::2], new], axis=2)
        chains.coordinate[missing] = longer
        chains.acceptance[missing] = 0.5 * (chains.acceptance[missing] + more_acceptance)
        chains.n_step[missing] = n_draw * stride
        chains.stress[missing] = posterior.stress(longer)
        found, time = diagnose_stress(chains.stress[missing])
        chains.ess_bulk[missing], chains.ess_tail[missing], chains.r_hat[missing] = (
            found.ess_bulk,
            found.ess_tail,
            found.r_hat,
        )
        chains.autocorrelation_time[missing] = time * stride
    return chains


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

    Attributes
    ----------
    coordinate : ndarray, shape (n_record, N_CHAIN, n)
        Where the walkers are, in the posterior's coordinates.

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

    posterior: Posterior
    seed: int
    streams: RecordStreams
    coordinate: FloatArray = field(init=False)
    proposal: StudentProposal = field(init=False)
    burn_in_acceptance: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Find the modes, place the walkers, burn in, and mend poor proposals."""
        everyone = np.arange(self.posterior.n_record)
        self.proposal = laplace_proposal(self.posterior)
        self.coordinate = self._first_positions(everyone)
        draws, self.burn_in_acceptance = self.run(N_BURN_IN, everyone)
        poor = np.flatnonzero(self.burn_in_acceptance < POOR_ACCEPTANCE)
        if len(poor):
            draws, _ = self.run(2 * N_BURN_IN, poor)
            flat = draws.reshape(len(poor), -1, draws.shape[-1])
            centred = flat - flat.mean(axis=1, keepdims=True)
            covariance = centred.swapaxes(-1, -2) @ centred / (flat.shape[1] - 1.0)
            self.proposal = self.proposal.refitted(poor, flat.mean(axis=1), covariance)
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
        coordinate : ndarray, shape (n, N_CHAIN, n_step, k)
            Where the walkers were after each step, in the posterior's coordinates.
        acceptance : ndarray, shape (n,)
            Share of accepted proposals.
        """
        posterior, proposal = self.posterior.take(records), self.proposal.take(records)
        n, k = len(records), posterior.n_coordinate

        def log_probability(flat: FloatArray) -> FloatArray:
            return posterior.log_density(flat.reshape(n, -1, k)).ravel()

        move = _WithinRecordMove(posterior, proposal, self.streams, records, n_step)
        sampler = emcee.EnsembleSampler(n * N_CHAIN, k, log_probability, moves=move, vectorize=True)
        # the move draws from the records' own streams; emcee picks the move with its own state, so that is set too
        sampler.random_state = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(self.seed))).get_state()
        state = sampler.run_mcmc(self.coordinate[records].reshape(-1, k), n_step, skip_initial_state_check=True)
        self.coordinate[records] = state.coords.reshape(n, N_CHAIN, k)
        chain = sampler.get_chain().reshape(n_step, n, N_CHAIN, k)
        acceptance = sampler.acceptance_fraction.reshape(n, N_CHAIN).mean(axis=1)
        return np.moveaxis(chain, 0, 2), acceptance

    def _first_positions(self, records: NDArray[np.int64]) -> FloatArray:
        """Resample draws of the proposal to the posterior by systematic resampling."""
        normal = self.streams.normal(records, (N_CANDIDATE, self.posterior.n_coordinate))
        chi_square = self.streams.chi_square(records, (N_CANDIDATE,), DEGREES_OF_FREEDOM)
        candidate = self.proposal.transform(normal, chi_square)
        log_weight = self.posterior.log_density(candidate) - self.proposal.log_density_of(normal, chi_square)
        weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        level = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
        offset = (self.streams.uniform(records, (1,)) + np.arange(N_CHAIN)) / N_CHAIN
        index = np.minimum((level[:, None, :] < offset[:, :, None]).sum(axis=2), N_CANDIDATE - 1)
        # neighbours in the candidates' order are independent draws, so that ensembles may be cut out of them in order
        return np.take_along_axis(candidate, index[..., None], axis=1)


class _WithinRecordMove(emcee.moves.Move):  # type: ignore[misc]  # emcee has no types
    """Independence proposals and differential evolution, each inside a record, from the records' own streams."""

    def __init__(
        self,
        posterior: Posterior,
        proposal: StudentProposal,
        streams: RecordStreams,
        records: NDArray[np.int64],
        n_step: int,
    ) -> None:
        self._posterior = posterior
        self._proposal = proposal
        self._coordinates = posterior.n_coordinate
        shape = (n_step, N_CHAIN)
        self._normal = streams.normal(records, (*shape, self._coordinates))
        self._chi_square = streams.chi_square(records, shape, DEGREES_OF_FREEDOM)
        self._log_uniform = np.log1p(-streams.uniform(records, shape))
        self._pick = streams.uniform(records, (*shape, 2))
        self._records = len(records)
        self._step = 0

    def propose(
        self,
        model: emcee.model.Model,  # noqa: ARG002 - emcee hands it over
        state: emcee.State,
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Make one step of all walkers."""
        step, self._step = self._step, self._step + 1
        if step % _DIFFERENTIAL_EVERY == _DIFFERENTIAL_EVERY - 1:
            return self._differential(state, step)
        return self._independent(state, step)

    def _independent(self, state: emcee.State, step: int) -> tuple[emcee.State, NDArray[np.bool_]]:
        old = state.coords.reshape(self._records, N_CHAIN, self._coordinates)
        normal, chi_square = self._normal[:, step], self._chi_square[:, step]
        new = self._proposal.transform(normal, chi_square)
        factor = self._proposal.log_density(old) - self._proposal.log_density_of(normal, chi_square)
        return self._accept(state, new, factor, self._log_uniform[:, step], slice(None))

    def _differential(self, state: emcee.State, step: int) -> tuple[emcee.State, NDArray[np.bool_]]:
        half = N_WALKER // 2
        walker = np.arange(N_CHAIN).reshape(N_ENSEMBLE, N_WALKER)
        accepted = np.zeros(self._records * N_CHAIN, dtype=bool)
        for moving, resting in ((walker[:, :half], walker[:, half:]), (walker[:, half:], walker[:, :half])):
            position = state.coords.reshape(self._records, N_CHAIN, self._coordinates)
            index = moving.ravel()
            pick = self._pick[:, step, index]
            first = (pick[..., 0] * half).astype(np.int64)
            second = (first + 1 + (pick[..., 1] * (half - 1)).astype(np.int64)) % half
            home = resting[index // N_WALKER]  # the resting half of each moving walker's own ensemble
            rows = np.arange(self._records)[:, None]
            columns = np.arange(len(index))[None, :]
            difference = position[rows, home[columns, first]] - position[rows, home[columns, second]]
            normal = self._normal[:, step, index]
            scale = (2.38 / np.sqrt(2.0 * self._coordinates)) * (1.0 + 0.05 * normal[..., :1])
            new = position[:, index] + scale * difference
            state, moved = self._accept(state, new, np.zeros(new.shape[:2]), self._log_uniform[:, step, index], index)
            accepted |= moved
        return state, accepted

    def _accept(
        self,
        state: emcee.State,
        new: FloatArray,
        factor: FloatArray,
        log_uniform: FloatArray,
        walkers: slice | NDArray[np.int64],
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Accept or reject the new positions of some walkers, shape (n_record, n, k)."""
        # the density is called as an array function: emcee's own call converts it walker by walker
        log_probability = self._posterior.log_density(new)
        current = state.log_prob.reshape(self._records, N_CHAIN)
        accepted = log_uniform < log_probability - current[:, walkers] + factor
        mask = np.zeros((self._records, N_CHAIN), dtype=bool)
        mask[:, walkers] = accepted
        state.coords.reshape(self._records, N_CHAIN, self._coordinates)[mask] = new[accepted]
        current[mask] = log_probability[accepted]
        return state, mask.ravel()
