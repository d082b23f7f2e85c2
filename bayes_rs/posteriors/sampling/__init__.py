"""The samplers, by name: all give the same posterior.

`ensemble` is the only module that imports emcee.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling.chains import PARETO_K_LIMIT, Chains, Effort
from bayes_rs.posteriors.sampling.direct import sample_direct
from bayes_rs.posteriors.sampling.ensemble import sample_emcee
from bayes_rs.posteriors.sampling.streams import RecordStreams


def sample_auto(posterior: Posterior, *, streams: RecordStreams, effort: Effort) -> Chains:
    """Draw directly, and sample with emcee the records for which that does not do; `Chains.sampler` says which.

    A record keeps its direct draws if emcee falls short of the target, too, and the weights can be trusted.
    """
    chains = sample_direct(posterior, streams=streams, effort=effort)
    left = np.flatnonzero(chains.missed(effort.target_ess))
    if len(left):
        again = sample_emcee(posterior.take(left), streams=streams.take(left), effort=effort)
        better = np.flatnonzero(~again.missed(effort.target_ess) | ~(chains.pareto_k[left] <= PARETO_K_LIMIT))
        chains.put(left[better], again.take(better))
    return chains


SAMPLERS: dict[str, Callable[..., Chains]] = {
    "emcee": sample_emcee,
    "direct": sample_direct,
    "auto": sample_auto,
}
"""The samplers by name: (posterior, *, streams, effort) → Chains."""


def sample(name: str, posterior: Posterior, *, keys: NDArray[np.int64], effort: Effort) -> tuple[Chains, RecordStreams]:
    """Sample records with the sampler of that name; also return their streams, for what is drawn after.

    Parameters
    ----------
    name : str
        One of `SAMPLERS`.
    posterior : Posterior
        Posterior of n_record records.
    keys : ndarray of int, shape (n_record,)
        What makes each record's random stream its own.
    effort : Effort
        Seed of the fit, effective sample size to reach, and how often a record's chain may be doubled for it.

    Returns
    -------
    chains : Chains
        The draws.
    streams : RecordStreams
        The records' streams.
    """
    streams = RecordStreams(effort.seed, keys)
    made = SAMPLERS[name](posterior, streams=streams, effort=effort)
    return made, streams
