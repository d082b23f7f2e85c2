"""Sample a campaign: its records and the distribution that they come from, together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.campaign.campaign_posterior import CampaignPosterior
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.priors.interface import LogRatioPrior, Prior

LEAST_RECORDS = 20
"""Below this number of records a campaign says little more than they do one by one."""
MOST_RECORDS = 1500
"""More records than this tell little more of the hyperparameters: `choose_records` takes a sample of them."""
N_CHAIN = 4
TARGET_ESS = 400
R_HAT_LIMIT = 1.05


def can_learn(prior: Prior) -> bool:
    """Tell whether a campaign can begin with a prior: its coordinates must be standard normal, as those of ``weak``."""
    return isinstance(prior, LogRatioPrior)


def sample_campaign(
    posterior: Posterior,
    wind_speed: FloatArray,
    *,
    group: Sequence[object] | None = None,
    seed: int | np.random.Generator,
    target_ess: int = TARGET_ESS,
    most_sweeps: int = 8000,
    n_chain: int = N_CHAIN,
) -> CampaignPosterior:
    """Sample the records of a campaign together with the distribution that they come from.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records under a prior with standard normal coordinates (`can_learn`).
    wind_speed : ndarray, shape (n_record,)
        Their mean wind speeds, m/s, above zero.
    group : sequence of n_record, optional
        Class of each record: its stresses' distribution may have a mean of its own, partially pooled.
    seed : int or numpy.random.Generator
        Seed.
    target_ess : int
        Effective sample size that hyperparameters and campaign means must reach.
    most_sweeps : int
        Bound on the sweeps of a chain after burn-in.
    n_chain : int
        Independent chains.

    Returns
    -------
    campaign : CampaignPosterior
        The draws, the learnt prior, and how the sampler did.

    Raises
    ------
    InputError
        If the prior is not one to begin with, or the wind speeds or groups do not fit the records.
    """
    raise NotImplementedError
