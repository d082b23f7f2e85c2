"""The table of a campaign: its means, spreads, ratios and turbulence intensities, each with an interval."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.campaign.campaign_posterior import CampaignPosterior


def campaign_table(
    campaign: CampaignPosterior,
    *,
    prob: float = 0.9,
    wind_speed: FloatArray | None = None,
    stress_mean: FloatArray | None = None,
    chosen: NDArray[np.int64] | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Return a campaign's numbers, each with a credible interval.

    Parameters
    ----------
    campaign : CampaignPosterior
        Result of `sample_campaign`.
    prob : float
        Probability of the intervals, which are central.
    wind_speed : ndarray, shape (n_all,), optional
        Wind speeds of all records, m/s, where only some were sampled.
    stress_mean : ndarray, shape (n_all, 6), optional
        Posterior means of the stresses of all records, one by one, m² s⁻².
    chosen : ndarray of int, shape (n_record,), optional
        Which of all records were sampled: what `choose_records` gave.
    seed : int
        Seed of the draws of the sampling error, where only some records were sampled.

    Returns
    -------
    table : pandas.DataFrame
        Columns ``quantity, bin, mean, low, high, prob, n_record, decided``. Bin ``all`` comes first, then bins of wind
        speed as ``7.5-8.5 m/s`` and the groups. Quantities: ``uu, vv, ww, uv, uw, vw, tke`` (m² s⁻²), ``ti``, ``u_star``
        (m/s), ``vv_uu``, ``ww_uu``, ``rho_uv``, ``rho_uw``, ``rho_vw`` (means over the records), ``sd_uu`` and so on
        (standard deviations over the records), and ``ti_p90``, the 90 % quantile of TI over the records.
    """
    raise NotImplementedError
