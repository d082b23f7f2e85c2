"""The registry of readers, and the way of one file from its name to its samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.compressed import COMPRESSIONS, plain_file, plain_suffix
from bayes_rs.readers.e_windlidar import e_windlidar_rays, read_e_windlidar, recognises_e_windlidar
from bayes_rs.readers.format import FileFormat, resolve_format
from bayes_rs.readers.halo import SUFFIXES as HALO_SUFFIXES
from bayes_rs.readers.halo import halo_rays, read_halo
from bayes_rs.readers.interface import Reader
from bayes_rs.readers.long_table import long_pieces, looks_long, read_long
from bayes_rs.readers.netcdf import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf import own_options, read_netcdf
from bayes_rs.readers.netcdf_check import check_netcdf
from bayes_rs.readers.samples import Samples
from bayes_rs.readers.spinnerlidar import DEFAULTS as SPINNERLIDAR_DEFAULTS
from bayes_rs.readers.spinnerlidar import SUFFIXES as SPINNERLIDAR_SUFFIXES
from bayes_rs.readers.spinnerlidar import read_spinnerlidar, recognises_spinnerlidar, spinnerlidar_rays
from bayes_rs.readers.table import CSV_SUFFIXES, PARQUET_SUFFIXES, open_table
from bayes_rs.readers.wide_table import looks_wide, read_wide, wide_pieces
from bayes_rs.readers.windcube import STATUS_VALID, read_windcube, recognises_windcube, windcube_rays
from bayes_rs.readers.zx import DEFAULTS as ZX_DEFAULTS
from bayes_rs.readers.zx import SUFFIXES as ZX_SUFFIXES
from bayes_rs.readers.zx import read_zx, recognises_zx

TABLE_SUFFIXES = (*CSV_SUFFIXES, *PARQUET_SUFFIXES)

_ALL = (
    Reader(
        name="halo",
        title="Halo Photonics StreamLine, .hpl text",
        source="doppy, the processing of the ACTRIS network (github.com/actris-cloudnet/doppy, docs/formats-halo.md)",
        suffixes=HALO_SUFFIXES,
        recognises=lambda *_: True,
        read=read_halo,
        rays=halo_rays,
        defaults={"positive": "away", "time_zone": "UTC"},
    ),
    Reader(
        name="zx",
        title="ZX TM, ZX 300 (ZephIR), line-of-sight velocities with a phase",
        source="files of ZX's converter; headings of the 50 Hz data are assumed, or named by the option columns",
        suffixes=ZX_SUFFIXES,
        recognises=recognises_zx,
        read=read_zx,
        defaults=ZX_DEFAULTS,
    ),
    Reader(
        name="spinnerlidar",
        title="DTU SpinnerLidar, text without headings",
        source="scripts of the University of Oldenburg's measurement course; columns by the option columns",
        suffixes=SPINNERLIDAR_SUFFIXES,
        recognises=recognises_spinnerlidar,
        read=read_spinnerlidar,
        rays=spinnerlidar_rays,
        defaults=SPINNERLIDAR_DEFAULTS,
    ),
    Reader(
        name="long",
        title="CSV or Parquet table, a row per sample",
        source="this package; docs/formats.md",
        suffixes=TABLE_SUFFIXES,
        recognises=lambda file, _, file_format: looks_long(open_table(file, file_format)),
        read=read_long,
        pieces=long_pieces,
    ),
    Reader(
        name="wide",
        title="CSV or Parquet table, a row per time and a column per beam",
        source="this package; docs/formats.md",
        suffixes=TABLE_SUFFIXES,
        recognises=lambda file, scan, file_format: looks_wide(open_table(file, file_format), scan),
        read=read_wide,
        pieces=wide_pieces,
    ),
    Reader(
        name="windcube",
        title="WindCube scanning lidar (100S, 200S, 400S), NetCDF with rays",
        source="the files' own CF/Radial layout, as lidarwind (doi:10.21105/joss.04852) and xradar read it",
        suffixes=NETCDF_SUFFIXES,
        recognises=lambda file, *_: recognises_windcube(file),
        read=read_windcube,
        rays=windcube_rays,
        defaults={"positive": "away", "time_stamp": "end", "status_valid": STATUS_VALID},
    ),
    Reader(
        name="e-windlidar",
        title="e-WindLidar NetCDF of IEA Wind Task 32, with rays",
        source="Lidaco, the converter of the e-WindLidar initiative (github.com/e-WindLidar/Lidaco)",
        suffixes=NETCDF_SUFFIXES,
        recognises=lambda file, *_: recognises_e_windlidar(file),
        read=read_e_windlidar,
        rays=e_windlidar_rays,
        defaults={"time_stamp": "start"},
    ),
    Reader(
        name="netcdf",
        title="NetCDF with the names of the long table, as this package writes it",
        source="CF conventions for time; docs/formats.md",
        suffixes=NETCDF_SUFFIXES,
        recognises=lambda *_: True,
        read=read_netcdf,
        own_options=own_options,
    ),
)

READERS: dict[str, Reader] = {reader.name: reader for reader in _ALL}
"""Every format by its name, the special ones before the general ones: the first that recognises a file reads it."""


class _Formats:
    """What the option file_format may be: auto, and the names of the readers that there are now."""

    def __iter__(self) -> Iterator[str]:
        return iter(("auto", *READERS))


FORMATS = _Formats()
"""The values of the option file_format."""

SUFFIXES = tuple(dict.fromkeys(suffix for reader in READERS.values() for suffix in reader.suffixes))


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
        return named(_with_status(reader.read(plain, scan, file_format), options))


def read_pieces(file: Path, scan: Scan, options: FileOptions, n_row: int) -> Iterator[Samples]:
    """Read one file about `n_row` rows at a time, or whole where its format cannot be read in pieces."""
    with _plain(file, options.file_format) as (plain, named):
        reader, file_format = _reader_of(plain, scan, options)
        if reader.pieces is None:
            yield named(_with_status(reader.read(plain, scan, file_format), options))
        else:
            for part in reader.pieces(plain, scan, file_format, n_row):
                yield named(_with_status(part, options))


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
    if kind == "auto" and suffix not in SUFFIXES:
        raise InputError(
            f"Unknown suffix {suffix!r} of file {str(file)!r}: it must be one of {', '.join(SUFFIXES)}, also "
            f"compressed ({', '.join(COMPRESSIONS)}); rename the file, or give its file_format."
        )
    with plain_file(file) as plain:
        try:
            if plain_suffix(plain) in NETCDF_SUFFIXES:
                check_netcdf(plain, guarded=True)
            yield plain, lambda samples: replace(samples, file=file)
        except InputError as error:
            if plain == file:
                raise
            raise InputError(str(error).replace(repr(str(plain)), repr(str(file)))) from error


def _reader_of(file: Path, scan: Scan, options: FileOptions) -> tuple[Reader, FileFormat]:
    reader = _find(file, scan, options) if options.file_format == "auto" else READERS[options.file_format]
    own = reader.own_options(file) if reader.own_options is not None else None
    if own is None:
        return reader, resolve_format(options, scan, defaults=reader.defaults)
    return reader, resolve_format(FileOptions(**{**own, **options.given()}), None, defaults=reader.defaults)


def _find(file: Path, scan: Scan, options: FileOptions) -> Reader:
    suffix = plain_suffix(file)
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
