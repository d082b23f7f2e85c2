"""The main job: from files and settings to a folder of results."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.errors import InputError
from bayes_rs.file_options import STANDARD_INPUT
from bayes_rs.fits.covariance_states import check_has_pairs
from bayes_rs.fits.digest import digest, digest_parts
from bayes_rs.fits.fit_folder import open_fit
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.fit_writing import fit_into
from bayes_rs.fits.fitting import noise_section
from bayes_rs.fits.found_scan import with_found_scan
from bayes_rs.fits.lidar_files import lidar_options
from bayes_rs.fits.noise_choice import fit_inputs, noise_and_records, with_median_length_scale
from bayes_rs.fits.plan import option_parts, plan_fit, version_parts, with_settings
from bayes_rs.fits.prepare import check_beside_mast, check_noise_is_less
from bayes_rs.fits.range_job import RangeJob, check_no_noise, fit_ranges_into
from bayes_rs.fits.settings import Settings
from bayes_rs.fits.workers import check_workers
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.options import to_plain
from bayes_rs.processor import one_thread
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.one_file import SUFFIXES
from bayes_rs.readers.standard_input import with_standard_input
from bayes_rs.records.layout import MAST
from bayes_rs.records.ranges import scan_of_records
from bayes_rs.records.record_files import open_record_files
from bayes_rs.records.record_options import options_of_series
from bayes_rs.records.record_store import store_records
from bayes_rs.records.report import describe_report
from bayes_rs.result_folder import ResultFolder
from bayes_rs.turbulence.mann import load_turbulence
from bayes_rs.wind.mast import add_mast, mast_of
from bayes_rs.wind.motion import add_motion, check_motion

Say = Callable[[str], None]


def fit_files(settings: Settings, *, progress: bool | None = None, say: Say = lambda line: None) -> Fit:  # noqa: ARG005
    """Read files, make records and fit them into a folder, as settings say.

    Parameters
    ----------
    settings : Settings
        Which scan, which files, and everything else. The file ``-`` is the standard input, a table of text.
    progress : bool, optional
        Progress bars on stderr; by default only on a terminal.
    say : callable
        Takes lines that tell what is being done.

    Returns
    -------
    fit : Fit
        From `open_fit`; ``fit.run["bad_files"]`` names the files that could not be used, with the reasons.

    Raises
    ------
    InputError
        If no scan, file or folder is named, an option is not valid, the folder may not be written, or no file can be
        used.
    LostResultsError
        If results that were written are gone at the end.
    WorkerError
        If worker processes die again and again.

    Notes
    -----
    First the records of all files are made, piece by piece, with memory that does not grow with the files; then the
    noise for their wind speeds and directions; then they are fitted. A file that cannot be read, or that holds anything
    that cannot be used, ends the run; with ``on_bad_file="skip"`` nothing of it counts, and it is named at the end. All
    results are the same however often the run was interrupted, bit by bit on processors of one kind. A run that is
    resumed with more files than before reads those that came since, and fits all records again.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> settings = Settings().changed(scan="6-beam@opening_angle_deg=45,focus_distance=52")
    >>> with tempfile.TemporaryDirectory() as place:
    ...     hour = settings.changed(files=[str(brs.demo_file("6-beam-45"))], output=f"{place}/hour")
    ...     fit_files(hour).n_fitted
    6
    """
    if not settings.files.files:
        raise InputError("No files are given: name files, folders or patterns of radial velocities, or of records.")
    output = settings.output.output
    if output is None:
        raise InputError("No folder is given for the results: name one with output (--output).")
    with with_standard_input(settings.files.files) as files:
        return _fit_files(settings.changed(files=tuple(files)), settings.files.files, output, progress, say)


def _fit_files(settings: Settings, named: Sequence[str], output: str | Path, progress: bool | None, say: Say) -> Fit:
    """Do what `fit_files` does with files; `named` is how they were named."""
    settings = with_found_scan(settings, say)
    scan = settings.scan.load()
    workers, client = settings.output.workers, settings.output.scheduler
    check_workers(workers, client)
    noise = given_noise(settings.noise.noise)
    if noise is not None:  # before files are read; the records may have fewer beams
        both = [beam for beam in scan.beam.tolist() if beam in noise.beam] or scan.beam
        noise.select(both).check_scan(scan.select(both))
    else:
        load_turbulence(settings.noise.flow)  # a bad file is said before hours of reading
    if settings.fit.information == "covariances":
        check_has_pairs(scan.n_beam)
    check_motion(settings.records, settings.files)
    files = list(settings.files.files)
    records = open_record_files(files, scan)
    if records is None:
        find_files(files, SUFFIXES)  # what is not there is said before a folder is made, or replaced
    mast = mast_of(settings.records, records, settings.files)  # as above
    check_beside_mast(settings.fit, there=mast is not None or (records is not None and MAST in records))
    parts = _key_parts(settings, scan, noise)
    with begin_result_folder(
        output,
        key=digest(parts),
        key_parts=parts,
        resume=settings.output.resume,
        overwrite=settings.output.overwrite,
        inputs=settings.input_files(),
    ) as folder:
        about: dict[str, Any] = {"source_files": [Path(file).name for file in files], "bad_files": {}}
        if records is None:
            records, read = _read(settings, scan, folder, progress, say)
            about |= read
        for line in describe_report(records):
            say(line)
        at_ranges = scan_of_records(records, scan)
        records = add_motion(records, scan, settings.records, settings.files, say=say)
        records = add_mast(records, mast, settings.records, say)
        if isinstance(at_ranges, RangedScan):
            check_no_noise(noise, at_ranges)
            sections = _other_sections(settings, None, named)
            job = RangeJob(records, at_ranges, settings.fit, settings.noise, sections)
            fit_ranges_into(folder, job, workers=workers, client=client, progress=progress, more=about, say=say)
            return open_fit(output)
        check_noise_is_less([records], settings.fit)
        options = with_median_length_scale(settings.fit, settings.noise, records, noise)
        inputs = fit_inputs(records, noise, settings.noise)
        with one_thread():
            found, records = noise_and_records(records, scan, noise, options, settings.noise, say)
            plan = plan_fit(records, scan, found, options, inputs=inputs, in_folder=True)
        plan = with_settings(plan, **_other_sections(settings, noise, named))
        fit_into(folder, plan, workers=workers, client=client, progress=progress, noise=noise, more=about)
    return open_fit(output)


def _read(
    settings: Settings, scan: Scan, folder: ResultFolder, progress: bool | None, say: Say
) -> tuple[xr.Dataset, Mapping[str, Any]]:
    """Make the records of files, and keep them in the folder; also return what `run.json` says of the files."""
    stored = store_records(
        list(settings.files.files),
        scan,
        folder,
        reading=lidar_options(settings, scan),
        quality=settings.quality,
        workers=settings.output.workers,
        progress=progress,
        say=say,
        **options_of_series(settings.records),
    )
    if stored.n_resumed:
        say(f"{stored.n_resumed} of {stored.n_file} files were read by an earlier run")
    report = json.loads(stored.records.attrs.get("records_report", "{}"))
    late = {name: report[name] for name in ("samples_late", "first_late") if name in report}
    return stored.records, {
        "n_file": stored.n_file,
        "source_files": json.loads(stored.records.attrs.get("source_files", "[]")),
        "bad_files": stored.bad_files,
        "read_counts": stored.counts,
        **late,
    }


def _key_parts(settings: Settings, scan: Scan, noise: Noise | None) -> dict[str, str]:
    """Return the fingerprints of all that the results depend on beside the files, by what they are of."""
    reading = {name: value for name, value in settings.files.given().items() if name != "on_bad_file"}
    return digest_parts(
        **version_parts(),
        scan=scan.key,
        noise=to_plain(settings.noise) if noise is None else noise,
        reading_options=reading,
        record_options=to_plain(settings.records),
        quality_rules=to_plain(settings.quality),
        **option_parts(settings.fit),
    )


def _other_sections(settings: Settings, noise: Noise | None, named: Sequence[str]) -> dict[str, Any]:
    """Return what `run.json` says of the settings beside those of the fit itself."""
    if STANDARD_INPUT in named:  # a file that held it is gone
        settings = settings.changed(files=tuple(named))
    plain = settings.with_whole_paths().to_plain()
    sections = {name: values for name, values in plain.items() if name not in ("fit", "output")}
    return {**sections, "noise": noise_section(settings.noise, noise)}
