"""emcee as most people would write it, for reference: one record at a time, stretch moves, a ball around the mode.

`register` gives it to the package as the sampler ``"emcee-plain"``.
"""

from __future__ import annotations

import emcee
import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import laplace_proposal
from bayes_rs.posteriors.sampling import SAMPLERS
from bayes_rs.posteriors.sampling.chains import N_CHAIN, N_ENSEMBLE, Chains, diagnose_stress, kept_draws
from bayes_rs.posteriors.sampling.effort import Effort
from bayes_rs.posteriors.sampling.streams import RecordStreams

N_BURN_IN = 500
"""Steps that are thrown away: about seven autocorrelation times of the stretch move in six dimensions."""
_STRIDE = 64
"""Steps between the draws that are kept of the first, shortest chain."""
N_WALKER = N_CHAIN // N_ENSEMBLE
"""Walkers of an ensemble of which one chain is made, with half of the draws from another."""
_BALL = 0.1
"""Spread of the walkers' first positions in the coordinates, in which the prior's own spread is about 1."""


def sample_plain(posterior: Posterior, *, streams: RecordStreams, effort: Effort) -> Chains:
    """Sample each record on its own with emcee's stretch move.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records.
    streams : RecordStreams
        Their random streams.
    effort : Effort
        Effective sample size to reach, and how often the chains of a record may be doubled for it; the streams hold the
        seed.

    Returns
    -------
    chains : Chains
        Draws of four ensembles; a chain is the thinned steps of one walker, then those of another.

    References
    ----------
    Goodman and Weare (2010), Comm. Appl. Math. Comp. Sci. 5, 65–80, doi:10.2140/camcos.2010.5.65.
    """
    n_draw = kept_draws(effort.target_ess)
    n_record, k = posterior.n_record, posterior.n_coordinate
    chains = Chains(
        np.empty((n_record, N_CHAIN, n_draw, k)),
        np.empty((n_record, N_CHAIN, n_draw, 6)),
        np.empty((n_record, 6)),
        np.empty((n_record, 6)),
        np.empty((n_record, 6)),
        np.empty((n_record, 6)),
        np.empty(n_record),
        np.empty(n_record, dtype=np.int64),
        np.full(n_record, np.nan),
        np.full(n_record, np.nan),
        np.full(n_record, "emcee-plain", dtype="U16"),
    )
    mode = laplace_proposal(posterior).mode
    for record in range(n_record):
        one = np.array([record])
        _sample_one(posterior.take(one), mode[record], streams.take(one), n_draw, effort, chains, one)
    return chains


def _sample_one(
    posterior: Posterior,
    mode: FloatArray,
    streams: RecordStreams,
    n_draw: int,
    effort: Effort,
    chains: Chains,
    record: np.ndarray[tuple[int], np.dtype[np.int64]],
) -> None:
    """Fill the chains of one record."""
    k = len(mode)
    n_walker = 2 * max(N_WALKER, k)  # of an ensemble; emcee asks for two for each dimension at least

    def log_probability(flat: FloatArray) -> FloatArray:
        return np.asarray(posterior.log_density(flat[None])[0])

    samplers = []
    for _ in range(N_ENSEMBLE):
        sampler = emcee.EnsembleSampler(n_walker, k, log_probability, vectorize=True)
        word = streams.uniform(np.array([0]), (4,))[0] * 2.0**32
        sequence = np.random.SeedSequence(word.astype(np.uint64).tolist())
        # emcee draws from NumPy's global state unless its own is set to the state of a RandomState
        sampler.random_state = np.random.RandomState(np.random.MT19937(sequence)).get_state()
        start = mode + _BALL * streams.normal(np.array([0]), (n_walker, k))[0]
        samplers.append((sampler, sampler.run_mcmc(start, N_BURN_IN)))
        sampler.reset()
    for extension in range(effort.max_extension + 1):
        stride = _STRIDE * 2**extension
        steps = n_draw * stride // 2  # half the draws of a chain from each of two walkers
        for index, (sampler, state) in enumerate(samplers):
            more = steps if extension == 0 else steps // 2
            samplers[index] = (sampler, sampler.run_mcmc(state, more))
        draws = np.stack([sampler.get_chain()[stride - 1 :: stride] for sampler, _ in samplers])
        walkers = np.moveaxis(draws, 2, 1)[:, : 2 * N_WALKER]  # (ensemble, walker, draw, k)
        coordinate = walkers.reshape(1, N_CHAIN, n_draw, k)
        stress = posterior.stress(coordinate)
        found, _ = diagnose_stress(stress)
        by_walker = np.moveaxis(stress.reshape(1, 2 * N_CHAIN, n_draw // 2, 6), -1, 1)
        chains.coordinate[record], chains.stress[record] = coordinate, stress
        chains.ess_bulk[record], chains.ess_tail[record], chains.r_hat[record] = (
            found.ess_bulk,
            found.ess_tail,
            found.r_hat,
        )
        chains.autocorrelation_time[record] = diagnostics.autocorrelation_time(by_walker) * stride
        chains.acceptance[record] = np.mean([sampler.acceptance_fraction for sampler, _ in samplers])
        chains.n_step[record] = steps
        if not chains.missed(effort.target_ess)[record].any():
            break


def register() -> None:
    """Let `bayes_rs.fit` find this sampler by its name, ``"emcee-plain"``."""
    SAMPLERS["emcee-plain"] = sample_plain
