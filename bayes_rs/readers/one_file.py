"""The way of one file from its name to its samples: by the first of the formats that recognises it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.beam_ranges import no_range
from bayes_rs.readers.belief import believed
from bayes_rs.readers.compressed import COMPRESSIONS, own_suffix, plain_file, plain_suffix
from bayes_rs.readers.format import FileFormat, resolve_format
from bayes_rs.readers.interface import Reader
from bayes_rs.readers.netcdf_file import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.not_read import why_not
from bayes_rs.readers.registry import READERS
from bayes_rs.readers.samples import Samples
from bayes_rs.readers.table import PARQUET_SUFFIXES, open_table

SUFFIXES = tuple(dict.fromkeys(suffix for reader in READERS.values() for suffix in reader.suffixes))
"""Suffixes of the files of all formats."""


def read_file(file: Path, scan: Scan, options: FileOptions) -> Samples:
    """Read one file whole.

    Parameters
    ----------
    file : Path
        The file, also compressed.
    scan : Scan
        The scan that it was measured with.
    options : FileOptions
        How it is written.

    Returns
    -------
    samples : Samples
        As in the file, in its order.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    with _plain(file, options.file_format) as (plain, named):
        reader, file_format = _reader_of(plain, scan, options)
        (samples,) = believed([named(_with_status(reader.read(plain, scan, file_format), options))])
        return samples


def read_if_whole(file: Path, scan: Scan, options: FileOptions) -> Samples | None:
    """Read one file whole, as `read_file` does, if its format cannot be read in pieces; else return None."""
    with _plain(file, options.file_format) as (plain, named):
        reader, file_format = _reader_of(plain, scan, options)
        if reader.pieces is not None:
            return None
        (samples,) = believed([named(_with_status(reader.read(plain, scan, file_format), options))])
        return samples


def read_pieces(file: Path, scan: Scan, options: FileOptions, n_row: int) -> Iterator[Samples]:
    """Read one file about `n_row` rows at a time, or whole where its format cannot be read in pieces."""
    with _plain(file, options.file_format) as (plain, named):
        reader, file_format = _reader_of(plain, scan, options)
        pieces = reader.pieces or (lambda *asked: iter((reader.read(*asked[:3]),)))
        yield from believed(named(_with_status(part, options)) for part in pieces(plain, scan, file_format, n_row))


def found_reader(file: Path, scan: Scan, options: FileOptions) -> tuple[Reader, bool]:
    """Return the reader of a file, and whether the file is text rather than Parquet or NetCDF.

    Raises
    ------
    InputError
        If no reader recognises it.
    """
    with _plain(file, options.file_format) as (plain, _):
        reader = _find(plain, scan, options) if options.file_format == "auto" else READERS[options.file_format]
        return reader, own_suffix(plain) not in (*PARQUET_SUFFIXES, *NETCDF_SUFFIXES)


@contextmanager
def opened_reader(file: Path, scan: Scan, options: FileOptions) -> Iterator[tuple[Reader, Path, FileFormat]]:
    """Give the reader of a file, the unpacked file, and the options that it is read with."""
    with _plain(file, options.file_format) as (plain, _):
        reader, file_format = _reader_of(plain, scan, options)
        yield reader, plain, file_format


def _with_status(samples: Samples, options: FileOptions) -> Samples:
    """Return the samples; refuse those without a status if the caller says which status is good."""
    if options.status_valid is not None and samples.status is None:
        raise InputError(
            f"File {str(samples.file)!r} has no status, which status_valid={options.status_valid:g} is about: say "
            "what the file calls it with columns={'status': 'its heading'} (--column status=HEADING), or leave "
            "status_valid out."
        )
    return samples


@contextmanager
def _plain(file: Path, kind: str) -> Iterator[tuple[Path, Callable[[Samples], Samples]]]:
    """Unpack a file; samples and errors then name the file that the user knows."""
    suffix = plain_suffix(file)
    reason = why_not(file)
    if reason is not None:
        raise InputError(reason)
    if kind == "auto" and suffix not in SUFFIXES and own_suffix(file) not in SUFFIXES:
        raise InputError(
            f"Unknown suffix {suffix!r} of file {str(file)!r}: it must be one of {', '.join(SUFFIXES)}, also "
            f"compressed ({', '.join(COMPRESSIONS)}); rename the file, or give its file_format."
        )
    with plain_file(file) as plain:
        try:
            yield plain, lambda samples: replace(samples, file=file)
        except InputError as error:
            if plain == file:
                raise
            raise InputError(str(error).replace(repr(str(plain)), repr(str(file)))) from error


def _reader_of(file: Path, scan: Scan, options: FileOptions) -> tuple[Reader, FileFormat]:
    reader = _find(file, scan, options) if options.file_format == "auto" else READERS[options.file_format]
    if isinstance(scan, RangedScan) and reader.rays is None and reader.ranges is None:
        raise no_range(file)
    own = reader.own_options(file) if reader.own_options is not None else None
    if own is None:
        file_format = resolve_format(options, scan, defaults=reader.defaults)
        _check_said(file, reader, file_format)
        return reader, reader.with_zone(file, options, file_format)
    try:
        file_format = resolve_format(FileOptions(**{**own, **options.given()}), None, defaults=reader.defaults)
    except InputError as error:
        raise InputError(f"File {str(file)!r} says of itself what cannot be used: {error}") from error
    return reader, reader.with_zone(file, options, file_format)


def _check_said(file: Path, reader: Reader, file_format: FileFormat) -> None:
    """Refuse a file of a format that leaves open what the caller must say, such as the sign of the velocity."""
    for name in reader.must_say:
        if name in file_format.from_format:
            raise InputError(
                f"File {str(file)!r} does not say in which direction it counts radial velocities positive, and a wrong "
                "sign turns the wind, and with it uw and vw: give positive='away' or positive='towards' (--positive)."
            )


def _find(file: Path, scan: Scan, options: FileOptions) -> Reader:
    suffix = own_suffix(file)
    for reader in READERS.values():
        if suffix in reader.suffixes:
            file_format = resolve_format(options, scan, defaults=reader.defaults)
            if reader.recognises(file, scan, file_format):
                return reader
    file_format = resolve_format(options, scan)
    table = open_table(file, file_format)
    raise InputError(
        f"File {str(file)!r} is neither a long table (columns {file_format.column('time')!r}, "
        f"{file_format.column('beam')!r}, {file_format.column('radial_velocity')!r}) nor a wide one (a column "
        f"per beam, headed by its number or vr_<number>): {table.found()}; "
        "map names with the options columns and beam_numbers (--column OURS=THEIRS, --beam-number THEIRS=OURS)."
    )
