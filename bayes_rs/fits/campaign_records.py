"""Which records of a fit enter its campaign."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs.fits.fit_options import CAMPAIGN_FROM, FitOptions
from bayes_rs.fits.flags import FLAGS, UNFITTED

KEPT_OUT = ("outside_noise", "beams_disagree")
"""Flags of records that say nothing of the air that the campaign is of, or not what the noise expects."""
UNSTEADY = ("unsteady", "not_stationary")
"""Flags of records that are kept out unless they are asked for."""

LEAST = 2
"""Records that a campaign needs: one has no spread."""


@dataclass(frozen=True)
class CampaignRecords:
    """The records of a campaign.

    Parameters
    ----------
    record : ndarray of int, shape (n,)
        Numbers of the records that enter; none if there is no campaign.
    why_not : str
        Why there is no campaign, in a few words; empty if there is one, or if none was asked for.
    """

    record: NDArray[np.int64]
    why_not: str = ""


def campaign_records(flag: NDArray[np.int64], options: FitOptions) -> CampaignRecords:
    """Choose the records that enter a campaign, by their flags after the fit.

    Parameters
    ----------
    flag : ndarray of int, shape (n_record,)
        Bit masks, as in `FLAGS`.
    options : FitOptions
        Whether there is to be a campaign, and of which records.

    Returns
    -------
    chosen : CampaignRecords
        Those that were fitted and have no flag in `KEPT_OUT` or, unless they are asked for, in `UNSTEADY`.
    """
    none = np.empty(0, dtype=np.int64)
    if options.campaign == "off":
        return CampaignRecords(none)
    if options.no_campaign:
        return CampaignRecords(none, options.no_campaign)
    names = KEPT_OUT if options.campaign_unsteady else (*KEPT_OUT, *UNSTEADY)
    out = UNFITTED | int(np.bitwise_or.reduce([FLAGS.get(name, 0) for name in names]))
    record = np.flatnonzero((flag & out) == 0).astype(np.int64)
    counts = f"{len(record)} of {len(flag)} records can enter (fitted, steady, not flagged)"
    least = CAMPAIGN_FROM if options.campaign == "auto" else LEAST
    if len(record) < least:
        return CampaignRecords(none, f"{counts}, and it begins at {least}")
    return CampaignRecords(record)
