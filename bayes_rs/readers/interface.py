"""What a reader is: the narrow interface that every format has."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import TIME_FORMATS, FileOptions, is_utc
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.rays import Rays
from bayes_rs.readers.samples import Samples

OF_EVERY_FORMAT = (
    *("file_format", "positive", "velocity_unit", "invalid", "velocity_limit", "time_zone", "time_stamp"),
    *("sample_duration", "status_valid", "range", "height", "out_of_order", "on_bad_file"),
)
"""Options that every reader uses, or refuses in words of its own where a file has nothing that they are about."""
OF_TEXT_FILES = ("separator", "skip_rows", "comment", "encoding")
"""Options of tables that only those of text use."""
OF_TABLES = (*OF_TEXT_FILES, "decimal", "time_format", "bad_rows", "columns")
OF_RAYS = ("angle_tolerance_deg", "range_tolerance")
OF_TEXT_RAYS = (*OF_RAYS, "decimal", "time_format", "bad_rows")
OF_NETCDF_RAYS = (*OF_RAYS, "columns", "gates_by")


@dataclass(frozen=True)
class Reader:
    """One file format.

    Parameters
    ----------
    name : str
        What `bayes_rs.read` calls it in ``file_format``.
    title : str
        What it is, in a few words.
    source : str
        Where its layout is described.
    suffixes : tuple of str
        Suffixes of its files, without that of a compression.
    recognises : callable
        Says of a file with one of the suffixes whether it has this format; raises InputError only for a file that
        is of this format and cannot be used.
    read : callable
        Reads the whole file.
    defaults : mapping
        Options that this format sets where neither the caller nor the scan does.
    rays : callable, optional
        Reads the rays of a file whose samples say where they point, as a survey of a scan needs them.
    pieces : callable, optional
        Reads the file so many rows at a time; without it a stream takes the file as one piece.
    ranges : callable, optional
        Returns the distinct distances along the beams of a file, m, in order, where rows rather than rays say them;
        empty if they do not.
    own_options : callable, optional
        Options that the file itself states; None if it states none. They count after the caller's, and the scan's
        ``[file]`` table is then left aside.
    must_say : tuple of str, optional
        Options of `defaults` that nothing in such a file tells, so that the caller or the scan must give them before
        velocities are read. A survey of directions needs none of them.
    in_utc : bool
        Whether times of this format are UTC whatever an option says, as those of NetCDF files are.
    uses : tuple of str, optional
        Options that it uses beside those of every format. One that the caller gives, and that no reader of the files
        uses, is refused. None if it does not say: then all count as used.
    """

    name: str
    title: str
    source: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Path, Scan, FileFormat], bool]
    read: Callable[[Path, Scan, FileFormat], Samples]
    defaults: Mapping[str, Any] = field(default_factory=dict)
    rays: Callable[[Path, FileFormat], Rays] | None = None
    pieces: Callable[[Path, Scan, FileFormat, int], Iterator[Samples]] | None = None
    ranges: Callable[[Path, FileFormat], FloatArray] | None = None
    own_options: Callable[[Path], Mapping[str, Any] | None] | None = None
    must_say: tuple[str, ...] = ()
    in_utc: bool = False
    uses: tuple[str, ...] | None = None

    def with_zone(self, file: Path, options: FileOptions, file_format: FileFormat) -> FileFormat:
        """Return how to read a file, with the zone that its times are taken in: counted times are in UTC, too.

        Raises
        ------
        InputError
            If the caller gives another zone, which would change nothing.
        """
        counted = file_format.time_format in TIME_FORMATS
        if is_utc(file_format.time_zone) or not (self.in_utc or counted):
            return file_format
        if options.time_zone is not None:
            why = f"format {self.name}" if self.in_utc else f"time_format {file_format.time_format}"
            raise InputError(
                f"Invalid time_zone {options.time_zone!r} for file {str(file)!r}: times of {why} are taken for UTC; "
                "leave it out (--time-zone). If they are in another zone, correct the file."
            )
        return replace(file_format, time_zone="UTC")
