"""A fit that is written into a folder, part by part."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from functools import partial
from typing import Any

import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits import campaign_files
from bayes_rs.fits.campaign_stage import Crew, campaign_in_folder
from bayes_rs.fits.columns import VARIANCES
from bayes_rs.fits.fit_folder import ARVIZ_FILE, PRIOR_FILE, RECORDS_FILE, fit_in
from bayes_rs.fits.fit_object import Fit, exported_summary
from bayes_rs.fits.fit_options import MOST_KEPT
from bayes_rs.fits.folder_tables import DATASETS
from bayes_rs.fits.groups import GROUPS, tree_of, with_places
from bayes_rs.fits.log_likelihood import log_likelihood_of
from bayes_rs.fits.parts import Done, Part, fit_part
from bayes_rs.fits.people_table import PEOPLE_FILE, PeopleRows, write_people_table
from bayes_rs.fits.plan import LAYOUT, Plan
from bayes_rs.fits.run_file import checked_run
from bayes_rs.fits.tables import ADVICE, names_of_part, write_table
from bayes_rs.fits.workers import done_parts
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.layouts import Open, read_json
from bayes_rs.noise.noise import Noise
from bayes_rs.output import write_csv, write_netcdf
from bayes_rs.priors.campaign import CampaignPrior
from bayes_rs.processor import note_processor, processor_kind
from bayes_rs.progress import progress_counter
from bayes_rs.result_folder import RUN_FILE, ResultFolder, going_on

NOISE_FILE = "noise.nc"
"""The noise of a fit that was given one: with it and the records the folder repeats the fit."""
GIVEN_PRIOR_FILE = "given-prior.toml"
"""The prior of a fit that was given one from a file, for the same reason."""
PLAN_FILE = "fit-key.json"
"""Says of which data the parts in a folder are: files can be added to those that a run has read."""
MOST_CSV = 20_000
"""Records up to which the summary is written as CSV, too."""


def fit_into(
    folder: ResultFolder,
    plan: Plan,
    *,
    workers: int = 1,
    client: Any = None,
    progress: bool | None = None,
    noise: Noise | None = None,
    more: Mapping[str, Any] | None = None,
) -> None:
    """Do what a plan has left to do in a folder, and finish it.

    Parameters
    ----------
    folder : ResultFolder
        From `begin_result_folder`.
    plan : Plan
        From `plan_fit`.
    workers, client, progress
        As for `fit`.
    noise : Noise, optional
        Noise that was given, which is kept in the folder.
    more : mapping, optional
        What else `run.json` says.

    Raises
    ------
    LostResultsError
        If files that were written are gone, or are not what was written.
    WorkerError
        If worker processes die again and again.
    OSError
        If a part cannot be written, as on a full disk.
    """
    began = time.perf_counter()
    kinds = _only_of(plan, folder)
    run = {**plan.run, **(more or {})}
    given_prior = plan.shared.options.made_prior
    if isinstance(given_prior, CampaignPrior) and run["settings"]["fit"]["prior"] is not None:
        of_fit = {**run["settings"]["fit"], "prior": f"campaign:{GIVEN_PRIOR_FILE}"}
        run["settings"] = {**run["settings"], "fit": of_fit}
    folder.write_run(run)
    left = [part for part in plan.parts if any(folder.damage(name) for name in _names(plan, part))]
    n_resumed = n_done = plan.n_record - sum(len(part.batch) for part in left)
    silent = None if progress is None else not progress
    of_index = {part.index: part for part in left}
    if left:
        _note(kinds, processor_kind(), plan, folder)
    try:
        if folder.damage(PRIOR_FILE):
            write_table(folder, PRIOR_FILE, pd.DataFrame(plan.prior_draws, columns=list(STRESSES)))
        if noise is not None and folder.damage(NOISE_FILE):
            folder.write(NOISE_FILE, noise.save)
        if isinstance(given_prior, CampaignPrior) and folder.damage(GIVEN_PRIOR_FILE):
            folder.write(GIVEN_PRIOR_FILE, given_prior.save)
        if folder.damage(RECORDS_FILE):
            folder.write(RECORDS_FILE, partial(write_netcdf, plan.records))
        with (
            progress_counter(plan.n_record, "fitting", " records", initial=n_resumed, disable=silent) as bar,
            closing(done_parts(fit_part, plan.shared, left, workers, client)) as finished,
        ):
            for done in finished:
                _note(kinds, done.processor, plan, folder)
                _write_part(folder, done, of_index[done.index])
                n_done += len(done.tables["posterior"])
                bar.update(len(done.tables["posterior"]))
        checked = checked_run(run, str(folder.path / RUN_FILE))
        fitted = fit_in(folder, run, checked, plan.scan, str(folder.path))
        try:
            crew = Crew(workers, client, silent)
            run["campaign"] = campaign_in_folder(folder, plan, fitted.flag, partial(_means, fitted), crew).about
        except (InputError, OSError):
            folder.check_whole()  # a part that went while the others were made is named as lost
            raise
    except BaseException as error:
        error.add_note(
            f"{n_done} of {plan.n_record} records are finished and kept in {str(folder.path)!r}: {going_on(error)}"
        )
        raise
    found = fit_in(folder, run, checked, plan.scan, str(folder.path))
    try:
        _write_exports(folder, found, plan)
        counts = {"n_fitted": found.n_fitted, "n_resumed": n_resumed, "flags": found.flags, "words": found.words}
    except (InputError, OSError):
        folder.check_whole()  # a part that went while the others were made is named as lost
        raise
    seconds = {**run.get("seconds", {}), "fitting": round(time.perf_counter() - began, 3)}
    folder.finish({**run, **counts, "processors": kinds, "seconds": seconds})


class _Mark(Open):
    """What says whose parts are in a folder."""

    key: str
    layout: int
    processors: list[str] | None = None


def _only_of(plan: Plan, folder: ResultFolder) -> list[str]:
    """Remove the parts of other data, of fewer files, and say whose come now; return which processors made them."""
    if not folder.damage(PLAN_FILE):
        with suppress(InputError):  # whose it is cannot be told: all is made again
            mark = read_json(
                _Mark, folder.read(PLAN_FILE), what=f"File {str(folder.path / PLAN_FILE)!r}", advice=ADVICE
            )
            if (mark["key"], mark["layout"]) == (plan.key, LAYOUT):
                return list(mark.get("processors") or [])
    parts = [part for dataset in DATASETS for part in folder.names(f"{dataset}/")]
    for name in (*parts, PRIOR_FILE, RECORDS_FILE, *campaign_files.FILES):
        folder.remove(name)
    kinds = [processor_kind()]
    _mark(plan, folder, kinds)
    return kinds


def _mark(plan: Plan, folder: ResultFolder, kinds: list[str]) -> None:
    mark = {"key": plan.key, "layout": LAYOUT, "processors": kinds}
    folder.write_text(PLAN_FILE, json.dumps(mark) + "\n")


def _note(kinds: list[str], kind: str, plan: Plan, folder: ResultFolder) -> None:
    """Note the kind of processor that numbers in the folder come from, before they are there."""
    if note_processor(kinds, kind):
        _mark(plan, folder, kinds)


def _names(plan: Plan, part: Part) -> list[str]:
    return [name for dataset in plan.datasets for name, _ in names_of_part(dataset, part.index, part.time)]


def _write_part(folder: ResultFolder, done: Done, part: Part) -> None:
    for dataset, table in done.tables.items():
        for name, rows in names_of_part(dataset, part.index, part.time):
            write_table(folder, name, table if rows.all() else table[table["record"].isin(part.record[rows])])


def _means(fitted: Fit) -> FloatArray:
    """Return the posterior means of the stresses by the variances, shape (n_record, 6)."""
    alone = VARIANCES if VARIANCES in fitted.source.datasets else "summary"
    return fitted.of_stresses("mean", dataset=alone)["mean"]


def _write_exports(folder: ResultFolder, found: Fit, plan: Plan) -> None:
    """Write what others read: the table for people, and of fits that are not too long, summary (CSV) and all groups."""
    folder.write(PEOPLE_FILE, partial(write_people_table, [PeopleRows(found, plan.records, {})]))
    if found.n_record <= MOST_CSV:
        write = partial(write_csv, exported_summary(found), index=False, date_format="%Y-%m-%dT%H:%M:%S")
        folder.write("summary.csv", write)
    if found.has_draws and found.n_record <= MOST_KEPT:
        groups = {name: found[name] for name in GROUPS if name != "log_likelihood"}
        if found.settings["fit"]["target"] != "sonic":
            groups["log_likelihood"] = with_places(found, log_likelihood_of(plan.shared, plan.parts, found))
        folder.write(ARVIZ_FILE, partial(write_netcdf, tree_of(groups, found.attrs)))
