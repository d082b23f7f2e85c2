"""Records of the files that a command names: read, or made of radial velocities."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from bayes_rs.cli.options import refuse_for_records
from bayes_rs.cli.voice import note

if TYPE_CHECKING:
    import xarray as xr

    from bayes_rs.fits.settings import Settings
    from bayes_rs.geometry.scan import Scan

EXIT_FLAGGED = 1
"""Exit code of what is done, with failures that are listed."""


def exit_if_doubtful(dataset: xr.Dataset) -> None:
    """Name the files that were skipped and what is not believed of the others, and exit with 1; else do nothing."""
    from bayes_rs.records.belief import doubt_lines

    skipped = json.loads(dataset.attrs.get("read_report", "{}")).get("files_skipped", [])
    for file in skipped:
        note(f"file {file['name']}: {file['reason']}")
    doubts = doubt_lines(dataset)
    for line in doubts:
        note(line)
    if skipped or doubts:
        sys.exit(EXIT_FLAGGED)


def records_and_scan(settings: Settings) -> tuple[xr.Dataset, Scan]:
    """Read records that were made before, or make them; say on stderr what was read and dropped."""
    from bayes_rs.records.record_files import open_record_files

    settings = with_scan(settings)
    scan = settings.scan.load()
    made = open_record_files(settings.files.files, scan)
    if made is not None:
        refuse_for_records(settings.files.files)
        return made, scan
    if settings.quality.blade_frequency is not None:  # whether blades pass is a matter of the whole series
        return records_of(series_of(settings, scan), scan, settings), scan
    return _finished(_records_in_pieces(settings, scan), scan, settings), scan


def _records_in_pieces(settings: Settings, scan: Scan) -> xr.Dataset:
    """Make records as `fit` does, piece by piece, with memory that does not grow with the files."""
    from bayes_rs.begin_folder import begin_result_folder
    from bayes_rs.records.record_store import store_records

    with TemporaryDirectory(prefix="bayes-rs-") as place:
        try:
            with begin_result_folder(Path(place) / "records", key="records", key_parts={}) as folder:
                return store_records(
                    list(settings.files.files),
                    scan,
                    folder,
                    reading=settings.files,
                    quality=settings.quality,
                    say=note,
                    workers=settings.output.workers,
                    **record_keywords(settings),
                ).records
        except BaseException as error:
            getattr(error, "__notes__", []).clear()  # nothing is kept that one could go on from
            raise


def record_keywords(settings: Settings) -> dict[str, Any]:
    """Return the options of records that are made of a series, as keywords."""
    from bayes_rs.options import to_plain

    return {name: value for name, value in to_plain(settings.records).items() if not name.startswith("motion")}


def with_scan(settings: Settings) -> Settings:
    """Return settings whose scan is found in their files, if it is auto; say on stderr which it is."""
    from bayes_rs.fits.found_scan import with_found_scan

    return with_found_scan(settings, note)


def series_of(settings: Settings, scan: Scan) -> xr.Dataset:
    """Read radial velocities."""
    from bayes_rs.readers.reading import read

    return read(list(settings.files.files), scan, workers=settings.output.workers, **settings.files.of_reading())


def records_of(series: xr.Dataset, scan: Scan, settings: Settings) -> xr.Dataset:
    """Make records, and say on stderr what was read and dropped."""
    from bayes_rs.records.making import make_records

    return _finished(make_records(series, scan, quality=settings.quality, **record_keywords(settings)), scan, settings)


def _finished(made: xr.Dataset, scan: Scan, settings: Settings) -> xr.Dataset:
    """Say on stderr what was read and dropped, and add the motion of the lidar."""
    from bayes_rs.records.report import describe_report
    from bayes_rs.wind.motion import add_motion

    for line in describe_report(made):
        note(line)
    made = add_motion(made, scan, settings.records, settings.files)
    if settings.records.motion:
        without = int((made["motion_count"] == 0).sum())
        note(f"tilt and roll from {len(settings.records.motion)} files; {without} records without")
    return made
