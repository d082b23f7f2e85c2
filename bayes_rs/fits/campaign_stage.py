"""The campaign as a stage of a fit, after its records: in memory, or in its folder, where it can be gone on with."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.campaign_files import ABOUT_FILE, FILES, PRIOR_FILE, TABLE_FILES, as_csv
from bayes_rs.fits.campaign_job import (
    CampaignDone,
    campaign_off,
    fit_under_campaign,
    job_of,
    learn_campaign,
    under_campaign,
)
from bayes_rs.fits.campaign_records import CampaignRecords, campaign_records
from bayes_rs.fits.columns import SUMMARY, VARIANCES
from bayes_rs.fits.fit_data import MemoryTables
from bayes_rs.fits.parts import Done, Part
from bayes_rs.fits.plan import Plan
from bayes_rs.fits.run_file import AboutCampaign
from bayes_rs.fits.tables import ADVICE, names_of_part, write_table
from bayes_rs.fits.workers import done_parts, run_serial
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.layouts import read_json
from bayes_rs.priors.campaign import CampaignPrior, load_campaign_prior
from bayes_rs.progress import progress_counter
from bayes_rs.result_folder import ResultFolder


@dataclass(frozen=True)
class Crew:
    """Who does the work, and whether that is shown."""

    workers: int = 1
    client: Any = None
    silent: bool | None = None

    def fit(self, plan: Plan, prior: CampaignPrior, parts: list[Part], *, initial: int = 0) -> Iterator[Done]:
        """Fit parts under a learnt prior; they come in the order in which they are done."""
        shared = under_campaign(plan.shared, prior)
        counter = progress_counter(
            plan.n_record, "fitting under the campaign", " records", initial=initial, disable=self.silent
        )
        with counter as bar, closing(done_parts(fit_under_campaign, shared, parts, self.workers, self.client)) as all_:
            for done in all_:
                yield done
                bar.update(done.tables[SUMMARY]["record"].nunique())


@dataclass(frozen=True)
class Campaign:
    """The campaign of a fit: what `run.json` says of it, and where there is one, its tables and its prior."""

    about: dict[str, Any]
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    prior: CampaignPrior | None = None


def campaign_in_memory(plan: Plan, tables: MemoryTables, crew: Crew) -> Campaign:
    """Learn the campaign of a fit in memory from its tables, and fit all records under its prior."""
    chosen = campaign_records(tables.read("posterior")["flag_bits"].to_numpy(dtype=np.int64), plan.shared.options)
    if not len(chosen.record):
        return Campaign(campaign_off(chosen))
    found = _learn(plan, chosen, _means(tables.read(VARIANCES if VARIANCES in tables.datasets else "summary")), crew)
    finished = sorted(crew.fit(plan, found.prior, plan.parts), key=lambda done: done.index)
    summary = pd.concat([done.tables[SUMMARY] for done in finished], ignore_index=True)
    return Campaign(found.about, {SUMMARY: summary, **found.tables}, found.prior)


def campaign_in_folder(
    folder: ResultFolder, plan: Plan, flag: NDArray[np.int64], means: Callable[[], FloatArray], crew: Crew
) -> Campaign:
    """Learn the campaign of a fit whose parts are all in a folder, and fit them under its prior, as far as is left.

    Parameters
    ----------
    folder : ResultFolder
        The folder.
    plan : Plan
        What the fit does.
    flag : ndarray of int, shape (n_record,)
        Flags of the records after the fit.
    means : callable
        Returns the posterior means of the stresses, shape (n_record, 6).
    crew : Crew
        Who does the work.

    Returns
    -------
    campaign : Campaign
        Without its tables, which are in the folder.
    """
    chosen = campaign_records(flag, plan.shared.options)
    if not len(chosen.record):
        return Campaign(campaign_off(chosen))
    if any(folder.damage(name) for name in FILES):
        _write(folder, _learn(plan, chosen, means(), crew))
    what = f"File {str(folder.path / ABOUT_FILE)!r}"
    about = read_json(AboutCampaign, folder.read(ABOUT_FILE), what=what, advice=ADVICE)
    prior = load_campaign_prior(folder.checked(PRIOR_FILE))
    left = [part for part in plan.parts if any(folder.damage(name) for name, _ in _names(part))]
    of_index = {part.index: part for part in left}
    initial = plan.n_record - sum(len(part.batch) for part in left)
    for done in crew.fit(plan, prior, left, initial=initial):
        part, table = of_index[done.index], done.tables[SUMMARY]
        for name, rows in _names(part):
            write_table(folder, name, table if rows.all() else table[table["record"].isin(part.record[rows])])
    return Campaign(about, prior=prior)


def _names(part: Part) -> list[tuple[str, NDArray[np.bool_]]]:
    return names_of_part(SUMMARY, part.index, part.time)


def _write(folder: ResultFolder, learnt: CampaignDone) -> None:
    """Write what a campaign found, and remove what was fitted under another one's prior."""
    content = (json.dumps(learnt.about, indent=2, sort_keys=True) + "\n").encode("ascii")
    before = None if folder.damage(ABOUT_FILE) else folder.read(ABOUT_FILE)
    for name, table in learnt.tables.items():
        folder.write_bytes(TABLE_FILES[name], as_csv(table))
    folder.write(PRIOR_FILE, learnt.prior.save)
    if before != content:
        for name in folder.names(f"{SUMMARY}/"):
            folder.remove(name)
    folder.write_bytes(ABOUT_FILE, content)


def _learn(plan: Plan, chosen: CampaignRecords, mean: FloatArray, crew: Crew) -> CampaignDone:
    job = job_of(plan.parts, chosen, mean, plan.shared.options.seed)
    with progress_counter(1, "learning the campaign", " campaign", disable=crew.silent):
        # with one thread, as the parts: the same numbers whatever the cores
        (done,) = run_serial(learn_campaign, plan.shared, [job])
    return done


def _means(summary: pd.DataFrame) -> FloatArray:
    """Return the posterior means of the stresses, shape (n_record, 6)."""
    rows = summary[summary["stress"].isin(STRESSES)]  # six rows a record, in the order of STRESSES
    return rows["mean"].to_numpy(dtype=np.float64).reshape(-1, len(STRESSES))
