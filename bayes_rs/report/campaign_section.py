"""The section of the campaign: words, picture and tables."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.fits.campaign_words import ALL, campaign_words, share_words
from bayes_rs.fits.fit_object import Fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import PRIORS, is_priors
from bayes_rs.report.packing import plain
from bayes_rs.report.tables import STAR, figure, folded, interval, key, lines, number, table

_HYPER_PROB = 0.9
"""Probability of the intervals of hyperparameters."""


@dataclass(frozen=True)
class CampaignShown:
    """What the page shows of a campaign.

    Parameters
    ----------
    about : dict
        What `run.json` says of it.
    table, hyper : DataFrame
        From `Fit.campaign` and `Fit.campaign_hyper`.
    record_mean : ndarray, shape (6,)
        Average of the records' posterior means under the given prior, m² s⁻².
    prior_name : str
        Name of the given prior.
    """

    about: dict[str, Any]
    table: pd.DataFrame
    hyper: pd.DataFrame
    record_mean: FloatArray
    prior_name: str


def campaign_shown(fit: Fit) -> CampaignShown | str:
    """Return what the page shows of the campaign of a fit; or why it has none, empty if it was switched off."""
    about = dict(fit.run["campaign"])
    if not fit.has_campaign:
        return str(about["why"])

    from bayes_rs.plot.campaign_plot import record_means  # noqa: PLC0415 - matplotlib comes with it

    return CampaignShown(about, fit.campaign(), fit.campaign_hyper(), record_means(fit), str(fit.run["prior_name"]))


def campaign_data(shown: CampaignShown) -> dict[str, Any]:
    """Return what the script draws of a campaign."""
    from bayes_rs.plot.campaign_plot import speed_bins  # noqa: PLC0415 - matplotlib comes with it

    means = shown.table[shown.table["bin"] == ALL].set_index("quantity").loc[list(STRESSES)]
    hyper = shown.hyper
    low, high = (hyper[f"prior_{end}"].to_numpy(dtype=np.float64) for end in ("low", "high"))
    half = np.where(high > low, 0.5 * (high - low), 1.0)
    centre = 0.5 * (low + high)
    in_units = {end: plain((hyper[end].to_numpy(dtype=np.float64) - centre) / half) for end in ("low", "mean", "high")}
    return {
        "means": {**_ends(means), "average": plain(shown.record_mean), "prior_name": shown.prior_name},
        **{
            name: {"speed": plain(rows["speed"].to_numpy()), **_ends(rows)}
            for name in ("ti", "ti_p90")
            for rows in [speed_bins(shown.table, name)]
        },
        "hyper": {
            "name": hyper["name"].astype(str).tolist(),
            **in_units,
            "priors": is_priors(hyper["decided"]).astype(np.int64).tolist(),
            "words": [
                f"{interval(one['mean'], one['low'], one['high'], digits=2)}, {share_words(one['decided'])}"
                for one in hyper.to_dict("records")
            ],
        },
    }


def _ends(rows: pd.DataFrame) -> dict[str, Any]:
    numbers = {name: plain(rows[name].to_numpy(dtype=np.float64)) for name in ("mean", "low", "high")}
    return {**numbers, "priors": is_priors(rows["decided"]).astype(np.int64).tolist()}


def campaign_section(shown: CampaignShown | str, reference: str = "") -> str:
    """Return the content of the section; empty if the campaign was switched off.

    Parameters
    ----------
    shown : CampaignShown or str
        From `campaign_shown`.
    reference : str
        What the reference is called that stands beside; empty if there is none.
    """
    if isinstance(shown, str):
        return f'<p class="note">There is no campaign: {escape(shown)}.</p>' if shown else ""
    return _words(shown) + _pictures(shown, reference)


def _words(shown: CampaignShown) -> str:
    rows = shown.table[shown.table["bin"] == ALL].set_index("quantity")
    share = {name: float(rows["decided"][name]) for name in STRESSES}
    prior = [name for name in STRESSES if is_priors(share[name])]
    said = campaign_words(shown.about, shown.table)
    if prior:
        said.append(
            f"The data decided less than half of {', '.join(prior)}: what stands there is the given prior's, and more "
            "records do not change it."
        )
    else:
        said.append("The data decided more than half of every stress.")
    said.append(f"The new prior was {str(shown.about['prior']).removeprefix('campaign: ')}.")
    moves = "; ".join(f"{name} {100.0 * value:.0f} %" for name, value in shown.about["acceptance"].items())
    sampled = f"{shown.about['n_sampled']} of {shown.about['n_record']} records were sampled together"
    said.append(f"{sampled}, {shown.about['n_sweep']} sweeps a chain; accepted proposals: {moves}.")
    lead = (
        "What all records together say of the distribution that their stresses come from. A number here is the "
        "posterior of that very mean or quantile; an average of the records' own posterior means carries the bias of "
        "the prior."
    )
    return f"<p>{escape(lead)}</p>" + lines(f"{text[:1].upper()}{text[1:]}" for text in said)


def _pictures(shown: CampaignShown, reference: str) -> str:
    prior = key("point priors", f"hollow grey: {PRIORS}")
    called = _called(shown)
    means = (
        key("point", f"mean of the campaign, {called}")
        + prior
        + key("average", f"average of the records' own means, prior {shown.prior_name}")
    )
    intensity = (
        key("point", f"mean over the records, {called}")
        + key("point high", "their 90 % quantile")
        + prior
        + (key("reference", f"{reference}, mean of a bin") if reference else "")
    )
    hyper = (
        key("size", f"posterior, {_hyper_called(shown)}")
        + key("size priors", PRIORS)
        + key("room", "interval of the prior")
        + "Beside each: its mean and interval, and the share that the data decided."
    )
    return (
        figure("campaign-means", means, folded("Table: the campaign as a whole", _whole_table(shown)))
        + figure("campaign-speed", intensity, folded("Table: the campaign by wind speed and class", _bin_table(shown)))
        + figure("campaign-hyper", hyper, folded("Table: hyperparameters", _hyper_table(shown)))
    )


def _called(shown: CampaignShown) -> str:
    """Return the name of the intervals of the campaign's table."""
    return interval_words(float(shown.table["prob"].iloc[0]), str(shown.table["interval"].iloc[0]))


def _hyper_called(shown: CampaignShown) -> str:
    return interval_words(_HYPER_PROB, str(shown.hyper["interval"].iloc[0]))


def _whole_table(shown: CampaignShown) -> str:
    header = ("quantity", f"mean ({_called(shown)})", "decided by the data", f"records' average, {shown.prior_name}")
    average = dict(zip(STRESSES, shown.record_mean.tolist(), strict=True))
    rows = [
        (one["quantity"], _interval(one), share_words(one["decided"]), number(average.get(str(one["quantity"]))))
        for one in shown.table[shown.table["bin"] == ALL].to_dict("records")
    ]
    return table(f"Means over the records, m² s⁻², and what follows from them; {STAR}", header, rows)


def _bin_table(shown: CampaignShown) -> str:
    header = ("bin", "quantity", f"mean ({_called(shown)})", "decided by the data", "records")
    rows = [
        (one["bin"], one["quantity"], _interval(one), share_words(one["decided"]), str(one["n_record"]))
        for one in shown.table[shown.table["bin"] != ALL].to_dict("records")
    ]
    return table(f"The campaign in bins; {STAR}", header, rows, n_text=2)


def _hyper_table(shown: CampaignShown) -> str:
    header = ("hyperparameter", "posterior", "prior", "decided by the data", "ESS", "R-hat")
    rows = [
        (
            one["name"],
            _interval(one),
            interval(one["prior_mean"], one["prior_low"], one["prior_high"]),
            share_words(one["decided"]),
            number(one["ess"]),
            number(one["r_hat"]),
        )
        for one in shown.hyper.to_dict("records")
    ]
    return table("Hyperparameters, posterior and prior", header, rows)


def _interval(row: dict[Any, Any]) -> str:
    return interval(row["mean"], row["low"], row["high"], priors=bool(is_priors(row["decided"])))
