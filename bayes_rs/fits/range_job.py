"""The fit of records at several ranges: one after the other, each with its own noise, in memory or in one folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs.begin_folder import begin_inner_folder, inner_is_done
from bayes_rs.errors import InputError
from bayes_rs.fits.digest import digest, digest_parts
from bayes_rs.fits.fit_folder import ranged_fit_in
from bayes_rs.fits.fit_object import Fit, exported_summary
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions
from bayes_rs.fits.fit_writing import MOST_CSV, fit_into
from bayes_rs.fits.noise_choice import fit_inputs, noise_and_records, with_median_length_scale
from bayes_rs.fits.people_table import PEOPLE_FILE, write_people_table
from bayes_rs.fits.plan import Plan, option_parts, plain_options, plan_fit, software, version_parts, with_settings
from bayes_rs.fits.prepare import LEAST_WIND, check_noise_is_less, sound_beams
from bayes_rs.fits.ranged_fit import RangedFit, TablesOfRanges
from bayes_rs.fits.workers import done_parts
from bayes_rs.geometry.ranged_scan import RangedScan, short
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_writing import scan_text
from bayes_rs.noise.noise import Noise
from bayes_rs.output import write_csv
from bayes_rs.processor import one_thread
from bayes_rs.progress import progress_counter
from bayes_rs.records.belief import believed
from bayes_rs.records.ranges import split_ranges
from bayes_rs.records.report import why_no_beam
from bayes_rs.result_folder import ResultFolder

PROFILE_FILE = "profile.csv"
Say = Callable[[str], None]


@dataclass(frozen=True)
class RangeJob:
    """Records at several ranges, and how each is fitted.

    Parameters
    ----------
    records : Dataset, dims (range, record, beam)
        From `make_records`.
    scan : RangedScan
        The scan at these ranges.
    options : FitOptions
        Of every range; the seed of each is made of its seed and the range.
    choice : NoiseOptions
        How the noise of each range is made.
    sections : mapping
        What `run.json` says of the settings beside those of the fit.
    """

    records: xr.Dataset
    scan: RangedScan
    options: FitOptions
    choice: NoiseOptions
    sections: Mapping[str, Any]

    @property
    def key_parts(self) -> dict[str, str]:
        """The fingerprints of all that the results depend on, by what they are of."""
        return digest_parts(
            **version_parts(),
            scan=self.scan.of_one.key,
            ranges=self.scan.distance,
            **fit_inputs(self.records, None, self.choice),
            **option_parts(self.options),
        )

    def names(self) -> list[str]:
        """Return the folder of each range, as ``range-080m``."""
        height = self.scan.height
        what, values = ("range", self.scan.range) if height is None else ("height", height)
        words = short(values)
        most = max(len(word.split(".")[0]) for word in words)
        return [f"{what}-{'0' * (most - len(word.split('.')[0]))}{word}m" for word in words]

    def parts(self) -> list[tuple[xr.Dataset, Scan, FitOptions] | None]:
        """Return records, scan and options of each range; None for one without a record that can be fitted."""
        made: list[tuple[xr.Dataset, Scan, FitOptions] | None] = []
        for place, part in enumerate(split_ranges(self.records)):
            records = believed(part)
            known = (records["wind_speed"].values > LEAST_WIND) & np.isfinite(records["yaw"].values)
            if not (sound_beams(records).any(axis=1) & known).any():
                made.append(None)
                continue
            options = replace(self.options, seed=seed_of_range(self.options.seed, float(self.scan.range[place])))
            made.append((records, self.scan.at(place), with_median_length_scale(options, self.choice, records, None)))
        check_noise_is_less([part[0] for part in made if part is not None], self.options)
        if all(part is None for part in made):
            why = why_no_beam(split_ranges(self.records))
            raise InputError(
                "No record at any of the ranges can be fitted: "
                f"{why or 'none has a usable beam, a wind speed and a direction'}."
            )
        return made


def check_no_noise(noise: Noise | None, scan: RangedScan) -> None:
    """Refuse noise that was given, which is of one range, for several.

    Raises
    ------
    InputError
        If there is some.
    """
    if noise is not None:
        raise InputError(
            f"The given noise is of one range, and R is wanted at {scan.n_range} ranges: leave the noise out, and it "
            "is made for each, or fit one range (--range)."
        )


def seed_of_range(seed: int, distance: float) -> int:
    """Return the seed of the fit at a range, m: ranges share no random numbers."""
    return int(np.random.SeedSequence([seed, round(1000.0 * distance)]).generate_state(1, np.uint32)[0])


def fit_ranges(job: RangeJob, fit_one: Callable[[Plan], Fit], say: Say) -> RangedFit:
    """Fit the records of all ranges in memory.

    Parameters
    ----------
    job : RangeJob
        The records, and how they are fitted.
    fit_one : callable
        Fits the records of one range.
    say : callable
        Takes lines that tell what is being done.
    """
    fits: list[Fit | None] = []
    for name, part in zip(job.scan.names(), job.parts(), strict=True):
        if part is None:
            say(f"{name}: no record can be fitted")
            fits.append(None)
            continue
        fits.append(fit_one(_plan(job, part, named(say, name), in_folder=False)))
    return joined_ranges(job, fits)


def joined_ranges(job: RangeJob, fits: Sequence[Fit | None]) -> RangedFit:
    """Return the fits of all ranges, None for one without, as one."""
    opened = [None if one is None else partial(_same, one) for one in fits]
    run = run_of_ranges(job, [None if one is None else name for one, name in zip(opened, job.names(), strict=True)])
    return RangedFit(run, job.scan, TablesOfRanges(tuple(job.scan.range.tolist())), None, opened=tuple(opened))


def fit_ranges_into(
    folder: ResultFolder,
    job: RangeJob,
    *,
    workers: int = 1,
    client: Any = None,
    progress: bool | None = None,
    more: Mapping[str, Any] | None = None,
    say: Say,
) -> None:
    """Fit the records of all ranges into a folder, each into one in it, and finish it.

    Parameters
    ----------
    folder : ResultFolder
        From `begin_result_folder`.
    job : RangeJob
        The records, and how they are fitted.
    workers, client, progress
        As for `fit`.
    more : mapping, optional
        What else `run.json` says, of the whole.
    say : callable
        Takes lines that tell what is being done.
    """
    about: list[str | None] = []
    left: list[_Inner] = []
    for name, words, part in zip(job.names(), job.scan.names(), job.parts(), strict=True):
        about.append(None if part is None else name)
        if part is None:
            say(f"{words}: no record can be fitted")
            continue
        records, scan, options = part
        parts = digest_parts(
            **version_parts(), scan=scan.key, **fit_inputs(records, None, job.choice), **option_parts(options)
        )
        if inner_is_done(folder, name, key=digest(parts)):
            say(f"{words}: finished by an earlier run")
            continue
        folder.note_inner(name, digest(parts))
        left.append(_Inner(folder.path / name, words, parts, part))
    if client is None and 1 < workers <= len(left):  # a range each: nothing waits for the noise of another
        shared = _Shared(replace(job, records=xr.Dataset()), progress=False)
        silent = None if progress is None else not progress
        with progress_counter(len(left), "fitting", " ranges", disable=silent) as bar:
            for lines in done_parts(_fit_inner, shared, left, workers, None):
                for line in lines:
                    say(line)
                bar.update(1)
    else:
        for one in left:
            _fit_inner(_Shared(job, progress, workers, client, say), one)
    run = {**run_of_ranges(job, about), **(more or {})}
    found = ranged_fit_in(run, str(folder.path))
    if found.n_record <= MOST_CSV:
        write = partial(write_csv, found._together(exported_summary), index=False, date_format="%Y-%m-%dT%H:%M:%S")
        folder.write("summary.csv", write)
    folder.write(PEOPLE_FILE, partial(write_people_table, found.people_rows()))
    folder.write(PROFILE_FILE, partial(write_csv, found.profile(), index=False))
    counts = {"n_record": found.n_record, "n_fitted": found.n_fitted, "flags": found.flags, "words": found.words}
    folder.finish({**run, **counts})


@dataclass(frozen=True)
class _Inner:
    """A range that is to be fitted into a folder of its own."""

    path: Path
    words: str
    key_parts: dict[str, str]
    part: tuple[xr.Dataset, Scan, FitOptions]


@dataclass(frozen=True)
class _Shared:
    """What the fits of all ranges need."""

    job: RangeJob
    progress: bool | None
    workers: int = 1
    client: Any = None
    say: Say | None = None


def _fit_inner(shared: _Shared, one: _Inner) -> list[str]:
    """Fit one range into its folder; return what there is to say, where nobody hears it at once."""
    lines: list[str] = []
    say = named(shared.say or lines.append, one.words)
    with begin_inner_folder(one.path, key=digest(one.key_parts), key_parts=one.key_parts) as inner:
        plan = _plan(shared.job, one.part, say, in_folder=True)
        fit_into(inner, plan, workers=shared.workers, client=shared.client, progress=shared.progress)
    return lines


def run_of_ranges(job: RangeJob, folders: Sequence[str | None]) -> dict[str, Any]:
    """Return what `run.json` says of the whole; `folders` has the folder of each range, None where none was fitted."""
    height = job.scan.height
    return {
        **software(),
        "settings": {**job.sections, "fit": plain_options(job.options)},
        "scan": job.scan.name,
        "scan_key": job.scan.of_one.key,
        "scan_toml": scan_text(job.scan.of_one),
        "ranges": [
            {
                "range": float(job.scan.range[place]),
                "height": None if height is None else float(height[place]),
                "distance": job.scan.distance[place].tolist(),
                "folder": folder,
            }
            for place, folder in enumerate(folders)
        ],
    }


def _plan(job: RangeJob, part: tuple[xr.Dataset, Scan, FitOptions], say: Say, *, in_folder: bool) -> Plan:
    """Return the plan of one range, with noise that is made for its records."""
    records, scan, options = part
    inputs = fit_inputs(records, None, job.choice)
    with one_thread():
        noise, ready = noise_and_records(records, scan, None, options, job.choice, say)
        plan = plan_fit(ready, scan, noise, options, inputs=inputs, in_folder=in_folder)
    return with_settings(plan, **_sections_of_one(job.sections, scan))


def _sections_of_one(sections: Mapping[str, Any], scan: Scan) -> dict[str, Any]:
    """Return the settings by which the fit of one range is repeated: its own scan, which asks for no other range."""
    own = dict(sections)
    if "scan" in own:
        own["scan"] = {**dict.fromkeys(own["scan"]), "scan_toml": scan_text(scan)}
    if "files" in own:
        own["files"] = {**own["files"], "range": None, "height": None}
    return own


def named(say: Say, name: str) -> Say:
    """Return what says lines with the name of a range before them."""
    return lambda line: say(f"{name}: {line}")


def _same(fit: Fit) -> Fit:
    return fit
