"""Records of the files that a command names: read, or made of radial velocities."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from bayes_rs.cli.options import refuse_for_records
from bayes_rs.cli.voice import note

if TYPE_CHECKING:
    import xarray as xr

    from bayes_rs.fits.settings import Settings
    from bayes_rs.geometry.scan import Scan
    from bayes_rs.wind.mast import MastStresses

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
    from bayes_rs.wind.mast import mast_of
    from bayes_rs.wind.motion import check_motion

    check_motion(settings.records, settings.files)  # what is wrong is said before hours of reading
    settings = with_scan(settings)
    scan = settings.scan.load()
    made = open_record_files(settings.files.files, scan)
    if made is not None:
        refuse_for_records(settings)
    mast = mast_of(settings.records, made, settings.files)  # as above
    if made is None and settings.quality.blade_frequency is not None:  # whether blades pass is a matter of all samples
        made = _records_of_series(series_of(settings, scan), scan, settings)
    elif made is None:
        made = _told(_records_in_pieces(settings, scan))
    return _added(made, scan, settings, mast), scan


def _records_in_pieces(settings: Settings, scan: Scan) -> xr.Dataset:
    """Make records as `fit` does, piece by piece, with memory that does not grow with the files."""
    from bayes_rs.begin_folder import begin_result_folder
    from bayes_rs.fits.lidar_files import lidar_options
    from bayes_rs.records.record_options import options_of_series
    from bayes_rs.records.record_store import store_records

    with TemporaryDirectory(prefix="bayes-rs-") as place:
        try:
            with begin_result_folder(Path(place) / "records", key="records", key_parts={}) as folder:
                return store_records(
                    list(settings.files.files),
                    scan,
                    folder,
                    reading=lidar_options(settings, scan),
                    quality=settings.quality,
                    say=note,
                    workers=settings.output.workers,
                    **options_of_series(settings.records),
                ).records
        except BaseException as error:
            getattr(error, "__notes__", []).clear()  # nothing is kept that one could go on from
            raise


def with_scan(settings: Settings) -> Settings:
    """Return settings whose scan is found in their files, if it is auto; say on stderr which it is."""
    from bayes_rs.fits.found_scan import with_found_scan

    return with_found_scan(settings, note)


def series_of(settings: Settings, scan: Scan) -> xr.Dataset:
    """Read radial velocities."""
    from bayes_rs.fits.lidar_files import lidar_options
    from bayes_rs.readers.reading import read

    reading = lidar_options(settings, scan).of_reading()
    return read(list(settings.files.files), scan, workers=settings.output.workers, **reading)


def series_and_records(settings: Settings, scan: Scan) -> tuple[xr.Dataset, xr.Dataset]:
    """Read radial velocities and make records of them, with the lidar's motion and a mast; say what was dropped."""
    from bayes_rs.wind.mast import mast_of
    from bayes_rs.wind.motion import check_motion

    check_motion(settings.records, settings.files)  # before hours of reading
    mast = mast_of(settings.records, None, settings.files)
    series = series_of(settings, scan)
    return series, _added(_records_of_series(series, scan, settings), scan, settings, mast)


def _records_of_series(series: xr.Dataset, scan: Scan, settings: Settings) -> xr.Dataset:
    from bayes_rs.records.making import make_records
    from bayes_rs.records.record_options import options_of_series

    return _told(make_records(series, scan, quality=settings.quality, **options_of_series(settings.records)))


def _told(made: xr.Dataset) -> xr.Dataset:
    """Say on stderr what was read and dropped."""
    from bayes_rs.records.report import describe_report

    for line in describe_report(made):
        note(line)
    return made


def _added(made: xr.Dataset, scan: Scan, settings: Settings, mast: MastStresses | None) -> xr.Dataset:
    """Add the motion of the lidar, and what a mast measured."""
    from bayes_rs.wind.mast import add_mast
    from bayes_rs.wind.motion import add_motion

    made = add_motion(made, scan, settings.records, settings.files, say=note)
    return add_mast(made, mast, settings.records, note)
