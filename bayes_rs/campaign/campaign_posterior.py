"""The posterior of a campaign: what was learnt of the distribution that its records' stresses come from."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.priors.campaign import CampaignPrior


@dataclass(frozen=True, eq=False)
class CampaignPosterior:
    """Draws of a campaign's records and of the distribution that they come from.

    Parameters
    ----------
    prior : CampaignPrior
        What a record of this campaign is like: the prior that the campaign has learnt.
    stress : ndarray, shape (n_chain, n_draw, n_record, 6)
        Draws of the records' stresses, m² s⁻², all records of a draw together.
    wind_speed : ndarray, shape (n_record,)
        Their wind speeds, m/s.
    group : tuple of str
        Their groups; all ``""`` where there are none.
    hyper : pandas.DataFrame
        A row for each hyperparameter: ``name, mean, low, high, prior_mean, prior_low, prior_high, interval,
        decided, ess, r_hat``; 90 % intervals. Names are as ``mean ln(vv/uu)``, ``sd ln(vv/uu)``, ``corr ln(uu),
        ln(vv/uu)``.
    acceptance : dict of str to float
        Share of the proposals that were accepted, for each kind of move.
    n_sweep : int
        Sweeps of each chain after burn-in.
    ess, r_hat : float
        The smallest effective sample size and the largest R-hat of hyperparameters and of the campaign's means.
    converged : bool
        Whether both reached what was asked for.
    prior_stress : ndarray, shape (n_prior, n_record, 6)
        The records' stresses in campaigns that the hyperprior draws, m² s⁻²: what a campaign without data says.
    """

    prior: CampaignPrior
    stress: FloatArray
    wind_speed: FloatArray
    group: tuple[str, ...]
    hyper: pd.DataFrame
    acceptance: dict[str, float]
    n_sweep: int
    ess: float
    r_hat: float
    converged: bool
    prior_stress: FloatArray

    @property
    def n_record(self) -> int:
        """Number of records that were sampled."""
        return len(self.wind_speed)
