"""What a campaign found, in lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words

ALL = "all"
"""The bin of the rows that are of all records."""


def no_campaign_words(about: Mapping[str, Any]) -> list[str]:
    """Say why there is no campaign; nothing if it was switched off."""
    return [f"no campaign: {about['why']}"] if about["why"] else []


def campaign_words(about: Mapping[str, Any], table: pd.DataFrame) -> list[str]:
    """Say what a campaign found, and what of it the data decided, in three lines.

    Parameters
    ----------
    about : mapping
        What `run.json` says of it.
    table : DataFrame
        From `Fit.campaign`.

    Returns
    -------
    lines : list of str
        The means of the stresses, turbulence intensity with the shares that the data decided, and how the sampler did.
    """
    rows = table[table["bin"] == ALL].set_index("quantity")
    which = interval_words(float(rows["prob"].iloc[0]), str(rows["interval"].iloc[0]))
    middle = ", ".join(f"{name} {_interval(rows.loc[name])}" for name in STRESSES)
    shares = ", ".join(f"{name} {share_words(float(rows['decided'][name]))}" for name in STRESSES)
    high = f"its 90 % quantile over the records {_interval(rows.loc['ti_p90'])}"
    return [
        f"campaign of {about['n_record']} records, means, each with its {which}, m² s⁻²: {middle}",
        f"of these means the data decided (the rest is the prior's): {shares}",
        f"turbulence intensity {_interval(rows.loc['ti'])}, {high}; {sampler_words(about)}",
    ]


def sampler_words(about: Mapping[str, Any]) -> str:
    """Say how the campaign's chains did."""
    said = f"R-hat {about['r_hat']:.2f}, least effective sample size {about['ess']:.0f}"
    return said if about["converged"] else f"{said}, which does not do"


def campaign_failures(about: Mapping[str, Any]) -> list[str]:
    """Return a line if the campaign's chains fell short."""
    if not about["on"] or about["converged"]:
        return []
    short = f"campaign: its chains fell short after {about['n_sweep']} sweeps ({sampler_words(about)})"
    return [f"{short}: take its numbers, and those of the records under it, with care"]


def share_words(share: float) -> str:
    """Write a share as a percentage; a dash where it is not known."""
    return f"{100.0 * min(max(share, 0.0), 1.0):.0f} %" if np.isfinite(share) else "–"


def _interval(row: Any) -> str:
    return f"{row['mean']:.3g} ({row['low']:.3g} to {row['high']:.3g})"
