"""The sampler that draws directly, and falls back to emcee."""

from __future__ import annotations

import numpy as np

from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling.chains import Chains
from bayes_rs.posteriors.sampling.direct import sample_direct
from bayes_rs.posteriors.sampling.effort import Effort
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
        better = np.flatnonzero(~again.missed(effort.target_ess) | chains.uneven()[left])
        chains.put(left[better], again.take(better))
    return chains
