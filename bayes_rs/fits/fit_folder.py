"""A fit in a folder: written part by part, and read as the same object."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits import campaign_stage
from bayes_rs.fits.campaign_stage import Crew, campaign_in_folder
from bayes_rs.fits.fit_object import Fit, exported_summary
from bayes_rs.fits.fit_options import MOST_KEPT
from bayes_rs.fits.folder_tables import DATASETS, FolderTables
from bayes_rs.fits.parts import Done, Part, fit_part
from bayes_rs.fits.people_table import PEOPLE_FILE, PeopleRows, write_people_table
from bayes_rs.fits.plan import LAYOUT, N_PRIOR_DRAW, Plan
from bayes_rs.fits.ranged_fit import RangedFit, TablesOfRanges
from bayes_rs.fits.run_file import RunOfFit, checked_run, checked_run_of_ranges
from bayes_rs.fits.tables import ADVICE, names_of_part, read_table, write_table
from bayes_rs.fits.workers import done_parts
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan_text
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.layouts import Open, read_json
from bayes_rs.ledger import LEDGER
from bayes_rs.noise.noise import Noise
from bayes_rs.output import write_csv, write_netcdf
from bayes_rs.priors.campaign import CampaignPrior, load_campaign_prior
from bayes_rs.priors.registry import Prior
from bayes_rs.processor import note_processor, processor_kind
from bayes_rs.progress import progress_counter
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.records.layout import check_layout
from bayes_rs.result_folder import RUN_FILE, ResultFolder, open_result_folder

PRIOR_FILE = "prior.parquet"
RECORDS_FILE = "records.nc"
NOISE_FILE = "noise.nc"
"""The noise of a fit that was given one: with it and the records the folder repeats the fit."""
GIVEN_PRIOR_FILE = "given-prior.toml"
"""The prior of a fit that was given one from a file, for the same reason."""
ARVIZ_FILE = "posterior.nc"
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
        fitted = _fit_in(folder, run, checked, plan.scan, str(folder.path))
        try:
            crew = Crew(workers, client, silent)
            run["campaign"] = campaign_in_folder(folder, plan, fitted.flag, partial(_means, fitted), crew).about
        except (InputError, OSError):
            folder.check_whole()  # a part that went while the others were made is named as lost
            raise
    except BaseException as error:
        error.add_note(
            f"{n_done} of {plan.n_record} records are finished and kept in {str(folder.path)!r}: the same call with "
            "resume goes on from there."
        )
        raise
    found = _fit_in(folder, run, checked, plan.scan, str(folder.path))
    try:
        _write_exports(folder, found, plan.records)
        counts = {"n_fitted": found.n_fitted, "n_resumed": n_resumed, "flags": found.flags, "words": found.words}
    except (InputError, OSError):
        folder.check_whole()  # a part that went while the others were made is named as lost
        raise
    seconds = {**run.get("seconds", {}), "fitting": round(time.perf_counter() - began, 3)}
    folder.finish({**run, **counts, "processors": kinds, "seconds": seconds})


def open_fit(folder: str | Path) -> Fit:
    """Open the fit in a folder; tables and draws are read when they are asked for.

    Parameters
    ----------
    folder : str or Path
        Output folder of `fit` or of ``bayes-rs fit``, or a file at its top, such as ``posterior.nc``.

    Returns
    -------
    fit : Fit
        As `fit` returned it; of a fit at several ranges a `RangedFit`. Every file is compared with its fingerprint when
        it is read.

    Raises
    ------
    InputError
        If it is not the folder of a fit, the fit has not ended, or `run.json` was changed since it was written.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> records = brs.make_records(brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1), "2-beam")
    >>> with tempfile.TemporaryDirectory() as place:
    ...     found = brs.fit(records, "2-beam", seed=1, output=f"{place}/two")
    ...     open_fit(f"{place}/two").summary().equals(found.summary())
    True
    """
    folder = _folder_of(Path(folder))
    opened = open_result_folder(folder)
    if not opened.finished:
        raise InputError(f"The fit in {str(folder)!r} has not ended: resume it, or wait for its end.")
    run = opened.run()
    if "ranges" in run:
        return ranged_fit_in(run, str(folder))
    if "settings" not in run or "n_record" not in run:
        raise InputError(f"No fit in {str(folder)!r}: its {RUN_FILE} is of another command.")
    checked = checked_run(run, str(opened.path / RUN_FILE))
    return _fit_in(opened, run, checked, load_scan_text(checked.scan_toml, name=checked.scan), str(folder))


def ranged_fit_in(run: Mapping[str, Any], place: str) -> RangedFit:
    """Return the fit at several ranges of which `run.json` says this; that of a range is opened when it is asked for.

    Parameters
    ----------
    run : mapping
        The content.
    place : str
        The folder.

    Raises
    ------
    InputError
        If the content is not as it should be.
    """
    file = str(Path(place) / RUN_FILE)
    checked = checked_run_of_ranges(run, file)
    base = load_scan_text(checked.scan_toml, name=checked.scan)
    try:
        scan = RangedScan.of(base, [one.distance for one in checked.ranges])
    except (InputError, ValueError) as error:
        raise InputError(f"File {file!r} cannot be used: its ranges are not such of its scan: {error}") from error
    opened = [None if one.folder is None else partial(open_fit, Path(place) / one.folder) for one in checked.ranges]
    return RangedFit(run, scan, TablesOfRanges(tuple(scan.range.tolist())), None, place, tuple(opened))


def _folder_of(place: Path) -> Path:
    """Return the folder of results that a file stands in, in place of the file; what else there is stays what it is."""
    return place.parent if place.is_file() and (place.parent / LEDGER).is_file() else place


def _fit_in(folder: ResultFolder, run: Mapping[str, Any], checked: RunOfFit, scan: Scan, place: str) -> Fit:
    tables = FolderTables(folder, checked, scan.beam.tolist())
    return Fit(run, scan, tables, _InFolder(folder, tables), place)


class _Mark(Open):
    """What says whose parts are in a folder."""

    key: str
    layout: int
    processors: list[str] | None = None


@dataclass(frozen=True)
class _InFolder:
    """The records and the prior's draws of a fit in a folder."""

    folder: ResultFolder
    tables: FolderTables

    def records(self) -> xr.Dataset:
        file = self.folder.checked(RECORDS_FILE)
        found = load_netcdf(file)
        what = f"The records in {str(file)!r}"
        check_layout(found, "variance", "beam", "flag", "wind_speed", "yaw", what=what, advice=ADVICE)
        for name, own, of_fit in (
            ("records", found.sizes["record"], self.tables.run.n_record),
            ("beams", found["beam"].values.tolist(), list(self.tables.beams)),
        ):
            if own != of_fit:
                raise InputError(f"{what} cannot be used: the {name} are {own}, and {of_fit} were fitted; {ADVICE}.")
        return found

    def prior_draws(self) -> FloatArray:
        table = read_table(self.folder, [PRIOR_FILE], dict.fromkeys(STRESSES, "amount"))
        if len(table) != N_PRIOR_DRAW or table.isna().to_numpy().any():
            raise InputError(
                f"File {str(self.folder.path / PRIOR_FILE)!r} does not hold {N_PRIOR_DRAW} draws; {ADVICE}."
            )
        return table.to_numpy(dtype=np.float64)

    def campaign_prior(self) -> Prior | None:
        here = campaign_stage.PRIOR_FILE in self.folder.names()
        return load_campaign_prior(self.folder.checked(campaign_stage.PRIOR_FILE)) if here else None


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
    for name in (*parts, PRIOR_FILE, RECORDS_FILE, *campaign_stage.FILES):
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
    """Return the posterior means of the stresses, shape (n_record, 6)."""
    return fitted.of_stresses("mean")["mean"]


def _write_exports(folder: ResultFolder, found: Fit, records: xr.Dataset) -> None:
    """Write what others read: the table for people, and of fits that are not too long, summary (CSV) and all groups."""
    folder.write(PEOPLE_FILE, partial(write_people_table, [PeopleRows(found, records, {})]))
    if found.n_record <= MOST_CSV:
        write = partial(write_csv, exported_summary(found), index=False, date_format="%Y-%m-%dT%H:%M:%S")
        folder.write("summary.csv", write)
    if found.has_draws and found.n_record <= MOST_KEPT:
        folder.write(ARVIZ_FILE, partial(write_netcdf, found.to_arviz()))
