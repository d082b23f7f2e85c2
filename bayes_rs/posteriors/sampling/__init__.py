"""The samplers, by name: all give the same posterior.

`ensemble` is the only module that imports emcee.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from bayes_rs.registry import Registry

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bayes_rs.posteriors.posterior import Posterior
    from bayes_rs.posteriors.sampling.chains import Chains
    from bayes_rs.posteriors.sampling.effort import Effort
    from bayes_rs.posteriors.sampling.streams import RecordStreams

SAMPLERS: Registry[Callable[..., Chains]] = Registry(
    {
        "emcee": "bayes_rs.posteriors.sampling.ensemble:sample_emcee",
        "direct": "bayes_rs.posteriors.sampling.direct:sample_direct",
        "auto": "bayes_rs.posteriors.sampling.auto:sample_auto",
    }
)
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
    from bayes_rs.posteriors.sampling.streams import RecordStreams  # noqa: PLC0415 - the names alone are light

    streams = RecordStreams(effort.seed, keys)
    made = SAMPLERS[name](posterior, streams=streams, effort=effort)
    return made, streams
