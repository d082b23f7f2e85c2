"""Radial velocities from files, read whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_rs._validation import check_choice, check_count
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.options import from_plain
from bayes_rs.readers.ahead import read_ahead
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.levels import scan_at_ranges
from bayes_rs.readers.one_file import SUFFIXES, read_file
from bayes_rs.readers.ranged_series import with_ranges
from bayes_rs.readers.registry import FORMATS
from bayes_rs.readers.samples import FilesReport, Samples, check_order, join_samples, no_sample, none_read
from bayes_rs.readers.used_options import check_used

__all__ = ["FileOptions", "checked_options", "read"]


def read(
    files: str | Path | Sequence[str | Path], scan: str | Path | Scan, *, workers: int = 1, **options: Any
) -> xr.Dataset:
    r"""Read a lidar's radial velocities from one or several files.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files in any order, also compressed (``.gz``, ``.bz2``, ``.xz``, ``.zst``, ``.zip``); folders, of which all
        files with a known suffix are read, but hidden and temporary ones; patterns such as ``2024-*/*.nc``.
    scan : Scan, str or Path
        The scan that the files were measured with, or its name or file. Beams that the files lack are reported, not
        refused.
    workers : int
        Processes that read, if there are many files of a format that is read whole (NetCDF and other files of rays).
        The result does not depend on it.
    **options
        How the files are written, and what to do with bad ones: the fields of `bayes_rs.readers.FileOptions`, as
        ``positive="towards"`` or ``columns={"radial_velocity": "RWS"}``. An option that is given counts before the
        scan's own ``[file]`` table, which counts before the default of the file's format. One that no reader of the
        files uses is refused.

    Returns
    -------
    series : xarray.Dataset
        ``radial_velocity`` (sample), m/s, positive away from the lidar, NaN where missing; coordinates ``time``
        (sample), UTC, and ``beam`` (sample), the scan's beam numbers; with the options ``range`` or ``height``, or a
        scan whose table asks for all ranges, also ``range`` (sample), m, the distance along the beam; ``cnr`` (sample),
        dB, and ``status`` (sample) where the files have them. Sorted by time, then beam. ``attrs["read_report"]``
        counts in JSON what was read and dropped, and says for each file its format, the options it was read with, and
        which of them are the format's own defaults.

    Raises
    ------
    InputError
        If a file is missing, empty or of an unknown kind, a column is missing, an entry is not a number, time or beam
        of the scan, time goes backwards, or an option is not valid. The message names file, line and column.

    Notes
    -----
    Rows without a time or a beam are dropped and counted; rows without a velocity are kept as NaN, so that
    `make_records` can count them. Rows that repeat a sample (same beam, time and velocity) are dropped and counted:
    overlapping files are welcome. A NetCDF file whose variable ``radial_velocity`` has the attribute ``positive`` (as
    those that this package writes) describes itself, and the scan's ``[file]`` table is not used for it. Nothing is
    added to times for the beam's place within the scan. Every format with its source, sign, stamp, zone and invalid
    values stands in docs/formats.md; `bayes_rs.readers.stream` reads the same without holding all in memory.

    Examples
    --------
    >>> import tempfile
    >>> lines = "time,beam,radial_velocity\n2020-09-03T19:00:00,0,-36.0\n2020-09-03T19:00:01,1,-18.0\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "day.csv"
    ...     _ = file.write_text(lines)
    ...     series = read(file, "2-beam", velocity_unit="km/h")
    >>> series["radial_velocity"].values
    array([-10.,  -5.])
    """
    of_scan = as_scan(scan)
    chosen = checked_options(options, of_scan)
    found = find_files(files, SUFFIXES)
    check_used(found.paths, of_scan, chosen)
    at_ranges = scan_at_ranges(found.paths, of_scan, chosen)
    parts: list[Samples] = []
    skipped: list[dict[str, str]] = []
    for file, samples in _in_order(found.paths, at_ranges, chosen, check_count(workers, what="workers")):
        try:
            if isinstance(samples, Exception):
                raise samples
            part = samples or read_file(file, at_ranges, chosen)
            if len(part.time) == 0:
                raise no_sample(file, part.counts.get("rows", 0), part.counts.get("rows_cut", 0))
            if part.file_format.out_of_order == "error":
                check_order(part)
        except InputError as error:
            if chosen.on_bad_file == "error":
                raise
            skipped.append({"name": file.name, "reason": str(error)})
        else:
            parts.append(part)
    if not parts:
        raise none_read(len(skipped), skipped[0]["reason"])
    report = FilesReport(skipped=skipped, passed_over=found.passed_over)
    return with_ranges(join_samples(parts, at_ranges, report=report), at_ranges)


def _in_order(
    files: Sequence[Path], scan: Scan, options: FileOptions, workers: int
) -> Iterator[tuple[Path, Samples | Exception | None]]:
    """Give the files with what others have read of them, or what is wrong; None where that is still to be done."""
    if workers == 1:
        yield from ((file, None) for file in files)
        return
    with closing(read_ahead(files, scan, options, note=str, workers=workers)) as read:
        yield from ((one.file, one.error or one.samples) for one in read)


def checked_options(options: Mapping[str, Any], scan: Scan) -> FileOptions:
    """Return the options of reading, checked by themselves and with those of a scan.

    Raises
    ------
    InputError
        If one is not known or not valid.
    """
    chosen = from_plain(FileOptions, options, where="the options of reading")
    check_choice(chosen.file_format, tuple(FORMATS), what="file_format")
    resolve_format(chosen, scan)
    return chosen
