"""The section of the campaign: words, picture and tables."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from html import escape
from typing import Any

import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.fits.campaign_words import ALL, campaign_words, share_words
from bayes_rs.fits.fit_object import Fit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.plot.campaign_plot import campaign as draw_campaign
from bayes_rs.plot.campaign_plot import record_means
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.report.tables import folded, interval, lines, number, table


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
    picture : bytes
        The picture of `bayes_rs.plot.campaign`, as PNG.
    """

    about: dict[str, Any]
    table: pd.DataFrame
    hyper: pd.DataFrame
    record_mean: FloatArray
    prior_name: str
    picture: bytes


def campaign_shown(fit: Fit) -> CampaignShown | str:
    """Return what the page shows of the campaign of a fit; or why it has none, empty if it was switched off."""
    about = dict(fit.run["campaign"])
    if not fit.has_campaign:
        return str(about["why"])
    sink = io.BytesIO()
    draw_campaign(fit).savefig(sink, format="png", dpi=100, metadata={"Software": None})
    return CampaignShown(
        about, fit.campaign(), fit.campaign_hyper(), record_means(fit), str(fit.run["prior_name"]), sink.getvalue()
    )


def campaign_section(shown: CampaignShown | str) -> str:
    """Return the content of the section; empty if the campaign was switched off."""
    if isinstance(shown, str):
        return f'<p class="note">There is no campaign: {escape(shown)}.</p>' if shown else ""
    return _words(shown) + _picture(shown) + _tables(shown)


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


def _picture(shown: CampaignShown) -> str:
    data = base64.b64encode(shown.picture).decode("ascii")
    words = (
        "Means of the stresses over the campaign beside the averages of the records' posterior means; turbulence "
        "intensity by wind speed; hyperparameters in units of their prior's intervals."
    )
    return (
        f'<figure><img class="picture" src="data:image/png;base64,{data}" alt="{escape(words, quote=True)}">'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )


def _tables(shown: CampaignShown) -> str:
    percent = f"{100.0 * float(shown.table['prob'].iloc[0]):g} %"
    return (
        folded("Table: the campaign as a whole", _whole_table(shown, percent))
        + folded("Table: the campaign by wind speed and class", _bin_table(shown, percent))
        + folded("Table: hyperparameters", _hyper_table(shown))
    )


def _whole_table(shown: CampaignShown, percent: str) -> str:
    header = ("quantity", f"mean ({percent} interval)", "decided by the data", f"records' average, {shown.prior_name}")
    average = dict(zip(STRESSES, shown.record_mean.tolist(), strict=True))
    rows = [
        (one["quantity"], _interval(one), share_words(one["decided"]), number(average.get(str(one["quantity"]))))
        for one in shown.table[shown.table["bin"] == ALL].to_dict("records")
    ]
    return table("Means over the records, m² s⁻², and what follows from them", header, rows)


def _bin_table(shown: CampaignShown, percent: str) -> str:
    header = ("bin", "quantity", f"mean ({percent} interval)", "decided by the data", "records")
    rows = [
        (one["bin"], one["quantity"], _interval(one), share_words(one["decided"]), str(one["n_record"]))
        for one in shown.table[shown.table["bin"] != ALL].to_dict("records")
    ]
    return table("The campaign in bins", header, rows, n_text=2)


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
    return interval(row["mean"], row["low"], row["high"])
