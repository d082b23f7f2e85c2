"""The samplers, by name: all give the same posterior.

`ensemble` is the only module that imports emcee.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling.chains import PARETO_K_LIMIT, Chains
from bayes_rs.posteriors.sampling.direct import sample_direct
from bayes_rs.posteriors.sampling.ensemble import sample_emcee
from bayes_rs.posteriors.sampling.streams import RecordStreams


def sample_auto(
    posterior: Posterior, *, streams: RecordStreams, seed: int, target_ess: int, max_extension: int
) -> Chains:
    """Draw directly, and sample with emcee the records for which that does not do; `Chains.sampler` says which.

    A record keeps its direct draws if emcee falls short of the target, too, and the weights can be trusted.
    """
    chains = sample_direct(posterior, streams=streams, seed=seed, target_ess=target_ess, max_extension=max_extension)
    left = np.flatnonzero(chains.missed(target_ess))
    if len(left):
        again = sample_emcee(
            posterior.take(left),
            streams=streams.take(left),
            seed=seed,
            target_ess=target_ess,
            max_extension=max_extension,
        )
        better = np.flatnonzero(~again.missed(target_ess) | ~(chains.pareto_k[left] <= PARETO_K_LIMIT))
        chains.put(left[better], again.take(better))
    return chains


SAMPLERS: dict[str, Callable[..., Chains]] = {
    "emcee": sample_emcee,
    "direct": sample_direct,
    "auto": sample_auto,
}
"""The samplers by name: (posterior, *, streams, seed, target_ess, max_extension) → Chains."""


def sample(
    name: str, posterior: Posterior, *, seed: int, keys: NDArray[np.int64], target_ess: int, max_extension: int
) -> tuple[Chains, RecordStreams]:
    """Sample records with the sampler of that name; also return their streams, for what is drawn after.

    Parameters
    ----------
    name : str
        One of `SAMPLERS`.
    posterior : Posterior
        Posterior of n_record records.
    seed : int
        Seed of the fit.
    keys : ndarray of int, shape (n_record,)
        What makes each record's random stream its own.
    target_ess : int
        Bulk effective sample size to reach for every stress.
    max_extension : int
        How often a record's chain may be doubled.

    Returns
    -------
    chains : Chains
        The draws.
    streams : RecordStreams
        The records' streams.
    """
    streams = RecordStreams(seed, keys)
    made = SAMPLERS[name](posterior, streams=streams, seed=seed, target_ess=target_ess, max_extension=max_extension)
    return made, streams
