"""The campaign of a fit: what is learnt from all its records, and their fit under the prior that was learnt."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.campaign import CampaignPosterior, campaign_table, choose_records, sample_campaign
from bayes_rs.errors import NotPositiveDefiniteError
from bayes_rs.fits.batch import Batch, make_posterior
from bayes_rs.fits.campaign_records import CampaignRecords
from bayes_rs.fits.columns import HYPER, SUMMARY, TABLE
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.parts import Done, Part, Shared, batch_size, fit_part
from bayes_rs.likelihoods.joining import join_likelihoods
from bayes_rs.noise.noise import Noise
from bayes_rs.output import write_csv
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
        All records of the fit.
    time : ndarray, shape (n_record,)
        Their starts.
    record : ndarray of int
        Numbers of those that enter.
    mean : ndarray, shape (n_record, 6)
        Posterior means of the stresses under the given prior, m² s⁻²; NaN for records that were not fitted.
    """

    batch: Batch
    time: NDArray[np.datetime64]
    record: NDArray[np.int64]
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


def job_of(parts: Sequence[Part], chosen: CampaignRecords, mean: FloatArray) -> CampaignJob:
    """Return what the campaign of the records of all parts is learnt from."""
    batch = join_batches([part.batch for part in parts])
    return CampaignJob(batch, np.concatenate([part.time for part in parts]), chosen.record, mean)


def learn_campaign(shared: Shared, job: CampaignJob) -> CampaignDone:
    """Sample the campaign."""
    options = shared.options
    wind_speed, group = job.batch.wind_speed, job.batch.group
    some = choose_records(wind_speed[job.record], job.time[job.record], seed=options.seed)
    rows, posterior = campaign_posterior(job.batch, job.record[some], shared.noise, options)
    found: CampaignPosterior = sample_campaign(
        posterior, wind_speed[rows], group=None if group is None else group[rows], seed=options.seed
    )
    table = campaign_table(found, wind_speed[job.record], mean=job.mean[job.record], prob=options.prob)
    about = {"on": True, "n_record": len(job.record), "n_sampled": len(rows), **found.about}
    return CampaignDone({TABLE: as_read(table), HYPER: as_read(found.hyper)}, found.prior, about)


def campaign_posterior(
    batch: Batch, rows: NDArray[np.int64], noise: Noise, options: FitOptions
) -> tuple[NDArray[np.int64], Posterior]:
    """Return the joint posterior of some records of a batch, and which they are: those whose likelihood there is."""
    size = batch_size(batch.variance.shape[1])
    found: list[tuple[NDArray[np.int64], Posterior]] = []
    for first in range(0, len(rows), size):
        found += _posteriors(batch, rows[first : first + size], noise, options)
    used = np.concatenate([some for some, _ in found])
    likelihood = join_likelihoods([posterior.likelihood for _, posterior in found])
    # the nuisances are those of all the records at once: they hold no more than their numbers
    from bayes_rs.posteriors.nuisance import RecordNuisances

    some = batch.take(used)
    nuisances = RecordNuisances(options.nuisances, some.yaw, some.median_noise(options), some.yaw_sd)
    return used, Posterior(likelihood, options.made_prior, nuisances)


def _posteriors(
    batch: Batch, rows: NDArray[np.int64], noise: Noise, options: FitOptions
) -> list[tuple[NDArray[np.int64], Posterior]]:
    try:
        return [(rows, make_posterior(batch.take(rows), noise, options)[0])]
    except (NotPositiveDefiniteError, np.linalg.LinAlgError, FloatingPointError):
        if len(rows) == 1:
            return []
    return [one for half in np.array_split(rows, 2) for one in _posteriors(batch, half, noise, options)]


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
    return replace(shared, options=options, keep_draws=False)


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
        elif isinstance(values[0], dict):
            joined[entry.name] = {name: np.concatenate([value[name] for value in values]) for name in values[0]}
        else:
            joined[entry.name] = np.concatenate(values)
    return Batch(**joined)


def as_csv(table: pd.DataFrame) -> bytes:
    """Return a table as it is written."""
    sink = io.BytesIO()
    write_csv(table, sink, index=False)  # type: ignore[arg-type] # pandas writes to one as to a file
    return sink.getvalue()


def of_csv(content: bytes) -> pd.DataFrame:
    """Return a table as it is read: every number as it was written."""
    return pd.read_csv(io.BytesIO(content), float_precision="round_trip", keep_default_na=False, na_values=[""])


def as_read(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table as it will be read from its file."""
    return of_csv(as_csv(table))
