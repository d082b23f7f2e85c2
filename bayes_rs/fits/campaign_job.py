"""The campaign of a fit: what is learnt from all its records, and their fit under the prior that was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.campaign.record_choice import choose_records
from bayes_rs.campaign.sampling import MOST_RECORDS, sample_campaign
from bayes_rs.campaign.table import campaign_table
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch, make_posterior
from bayes_rs.fits.campaign_files import as_read
from bayes_rs.fits.campaign_records import CampaignRecords
from bayes_rs.fits.columns import HYPER, SUMMARY, TABLE
from bayes_rs.fits.covariance_states import PairData
from bayes_rs.fits.digest import digest
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.parts import FAILED, Done, Part, Shared, batch_size, fit_part
from bayes_rs.likelihoods.base import Likelihood
from bayes_rs.likelihoods.joining import join_likelihoods
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.nuisance import RecordNuisances
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.priors.campaign import CampaignPrior

SAMPLER = "direct"
"""How records are sampled under the learnt prior, which makes their posteriors compact."""


@dataclass(frozen=True)
class CampaignJob:
    """What the campaign is learnt from.

    Parameters
    ----------
    batch : Batch
        The records that are sampled.
    chosen : ndarray of int
        Their places among the records that enter.
    wind_speed : ndarray, shape (n,)
        Mean wind speeds of all records that enter, m/s.
    mean : ndarray, shape (n, 6)
        Posterior means of their stresses under the given prior, m² s⁻².
    """

    batch: Batch
    chosen: NDArray[np.int64]
    wind_speed: FloatArray
    mean: FloatArray


@dataclass(frozen=True)
class CampaignDone:
    """What a campaign found.

    Parameters
    ----------
    tables : dict of str to DataFrame
        `TABLE` and `HYPER`.
    prior : CampaignPrior
        The learnt prior.
    about : dict
        What `run.json` says of it.
    """

    tables: dict[str, pd.DataFrame]
    prior: CampaignPrior
    about: dict[str, Any]


def campaign_off(chosen: CampaignRecords) -> dict[str, Any]:
    """Return what `run.json` says of a campaign that there is not."""
    return {"on": False, "why": chosen.why_not}


def job_of(parts: Sequence[Part], chosen: CampaignRecords, mean: FloatArray, seed: int) -> CampaignJob:
    """Return what the campaign is learnt from; `mean` are the means of the records of all parts, (n_record, 6)."""
    wind_speed = np.concatenate([part.batch.wind_speed for part in parts])[chosen.record]
    some = choose_records(wind_speed, MOST_RECORDS, seed)
    number, first = chosen.record[some], 0
    batches = []
    for part in parts:  # those that are sampled are few: only they are copied
        last = first + len(part.batch)
        own = number[(number >= first) & (number < last)] - first
        if len(own):
            # what is uncertain of coherence and mast is so in all records together: their number must not shrink it
            batches.append(replace(part.batch.take(own), pairs=None))
        first = last
    return CampaignJob(join_batches(batches), some, wind_speed, mean[chosen.record])


def learn_campaign(shared: Shared, job: CampaignJob) -> CampaignDone:
    """Sample the campaign, of the variances of the beams alone."""
    options = replace(shared.options, information="variances")
    known, posterior = campaign_posterior(job.batch, shared.noise, options)
    batch, chosen = job.batch.take(known), job.chosen[known]
    found = sample_campaign(
        posterior,
        batch.wind_speed,
        group=None if batch.group is None else batch.group.tolist(),
        seed=options.seed,
        interval=options.interval,
    )
    table = campaign_table(
        found,
        prob=options.prob,
        interval=options.interval,
        wind_speed=job.wind_speed,
        stress_mean=job.mean,
        chosen=chosen,
        offset_sd=batch.noise_common_sd,
        seed=options.seed,
    )
    about = {
        "on": True,
        "n_record": len(job.wind_speed),
        "n_sampled": len(chosen),
        "n_sweep": int(found.n_sweep),
        "acceptance": {name: round(float(share), 4) for name, share in found.acceptance.items()},
        "ess": round(float(found.ess), 1),
        "r_hat": round(float(found.r_hat), 4),
        "converged": bool(found.converged),
        "prior": found.prior.in_words(),
        "prior_key": digest(found.prior),
    }
    return CampaignDone({TABLE: as_read(table), HYPER: as_read(found.hyper)}, found.prior, about)


def campaign_posterior(batch: Batch, noise: Noise, options: FitOptions) -> tuple[NDArray[np.int64], Posterior]:
    """Return the posterior of all records of a batch whose likelihood can be calculated, and which these are.

    It is made some records at a time: the covariances of many beams take memory, the likelihood that is made of them
    takes little.
    """
    size = batch_size(batch.variance.shape[1])
    rows = np.arange(len(batch))
    found: list[tuple[NDArray[np.int64], Likelihood]] = []
    for first in range(0, len(rows), size):
        found += _likelihoods(batch, rows[first : first + size], noise, options)
    if not found:
        raise InputError("No campaign is possible: the likelihood of no record can be calculated.")
    known = np.concatenate([some for some, _ in found])
    some = batch.take(known)
    nuisances = RecordNuisances(options.nuisances, some.yaw, some.median_noise(options), some.yaw_sd)
    return known, Posterior(join_likelihoods([likelihood for _, likelihood in found]), some.prior(options), nuisances)


def _likelihoods(
    batch: Batch, rows: NDArray[np.int64], noise: Noise, options: FitOptions
) -> list[tuple[NDArray[np.int64], Likelihood]]:
    try:
        return [(rows, make_posterior(batch.take(rows), noise, options)[0].likelihood)]
    except FAILED:
        if len(rows) == 1:
            return []
    return [one for half in np.array_split(rows, 2) for one in _likelihoods(batch, half, noise, options)]


def under_campaign(shared: Shared, prior: CampaignPrior) -> Shared:
    """Return what the parts need to be fitted under the learnt prior."""
    options = replace(
        shared.options,
        prior=prior,
        sampler=SAMPLER,
        draws="none",
        campaign="off",
        campaign_group=None,
        campaign_unsteady=False,
    )
    return replace(shared, options=options, keep_draws=False, alone=False)


def fit_under_campaign(shared: Shared, part: Part) -> Done:
    """Fit the records of one part under the learnt prior, and lay out their summary."""
    done = fit_part(shared, part)
    return Done(done.index, {SUMMARY: done.tables["summary"]})


def join_batches(batches: Sequence[Batch]) -> Batch:
    """Return the records of several batches, one after the other."""
    joined: dict[str, Any] = {}
    for entry in fields(Batch):
        values = [getattr(batch, entry.name) for batch in batches]
        if values[0] is None:
            joined[entry.name] = None
        elif isinstance(values[0], PairData):
            joined[entry.name] = values[0].join(values[1:])
        elif isinstance(values[0], dict):
            joined[entry.name] = {name: np.concatenate([value[name] for value in values]) for name in values[0]}
        else:
            joined[entry.name] = np.concatenate(values)
    return Batch(**joined)
