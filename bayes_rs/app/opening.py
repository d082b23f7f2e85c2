"""What can be opened: fits, spectra, and files of radial velocities below one folder; nothing there is written to."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.fits.fit_folder import open_fit
from bayes_rs.fits.fitting import fit
from bayes_rs.fits.found_scan import with_found_scan
from bayes_rs.fits.lidar_files import lidar_options
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.fits.settings import Settings
from bayes_rs.fits.words import record_name
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.readers.compressed import plain_suffix
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.readers.one_file import SUFFIXES
from bayes_rs.readers.reading import read
from bayes_rs.records.making import make_records
from bayes_rs.records.ranges import has_ranges
from bayes_rs.records.record_files import open_records
from bayes_rs.records.record_options import options_of_series
from bayes_rs.result_folder import RUN_FILE
from bayes_rs.spectra.radial_spectrum import radial_spectra
from bayes_rs.wind.mast import add_mast, mast_of
from bayes_rs.wind.motion import add_motion, check_motion

if TYPE_CHECKING:
    from bayes_rs.fits.fit_object import Fit

MOST_PLACES = 300
"""Places that are listed; others can be named."""
_DEEPEST = 4
_MOST_LOOKED_AT = 5000
_MOST_BYTES = 300_000_000
_MOST_FITTED = 300
_SPECTRA, _RECORDS = "spectra.nc", "records.nc"


def places(start: Path) -> list[str]:
    """Return what can be opened below a folder, as paths relative to it: results first, then files.

    In folders of results only other results are looked for, and hidden folders and files are left out.
    """
    results: list[str] = []
    files: list[str] = []
    for folder, names in _folders(start):
        if RUN_FILE in names:
            results.append(_relative(folder, start))
            continue
        files += [_relative(folder / name, start) for name in names if plain_suffix(Path(name)) in SUFFIXES]
    return [*results, *files][:MOST_PLACES]


def _folders(start: Path) -> Iterator[tuple[Path, list[str]]]:
    seen = 0
    for folder, inner, names in os.walk(start, onerror=None):
        here = Path(folder)
        depth = len(here.relative_to(start).parts)
        found = sorted(name for name in names if not name.startswith("."))
        inner[:] = sorted(name for name in inner if not name.startswith(".")) if depth < _DEEPEST else []
        if RUN_FILE in found:  # within results there are other results only: of ranges, or of a demo
            inner[:] = [name for name in inner if (here / name / RUN_FILE).is_file()]
        seen += 1 + len(found)
        if seen > _MOST_LOOKED_AT:
            return
        yield here, found


def _relative(path: Path, start: Path) -> str:
    return str(path.relative_to(start))


def place_below(start: Path, name: str) -> Path:
    """Return the path of what is named, which must be the start folder or below it.

    Raises
    ------
    InputError
        If it is elsewhere, also by a link, or does not exist.
    """
    if not name.strip() or "\0" in name:
        raise InputError("Nothing is named: choose something of the list, or write a path.")
    path = (start / name).resolve()
    if not path.is_relative_to(start.resolve()):
        raise InputError(f"{name!r} is not below {str(start)!r}, where the app was begun: begin it there to see it.")
    if not path.exists():
        raise InputError(f"{name!r} does not exist below {str(start)!r}: check the path.")
    return path


@dataclass(frozen=True, eq=False)
class Opened:
    """What was opened.

    Parameters
    ----------
    name : str
        What it is called.
    kind : str
        What it is, in words.
    lines : tuple of str
        Facts, a line each.
    scan : Scan or None
        The scan, if it is known.
    records : Dataset or None
        Its records.
    fit : Fit or None
        Its posteriors.
    spectra, spectra_fit : Dataset or None
        Spectra of the records, and the fit of them.
    ranges : tuple of str
        What the ranges are called, of a fit at several.
    """

    name: str
    kind: str
    lines: tuple[str, ...] = ()
    scan: Scan | None = None
    records: xr.Dataset | None = None
    fit: Fit | None = None
    spectra: xr.Dataset | None = None
    spectra_fit: xr.Dataset | None = None
    ranges: tuple[str, ...] = ()

    @property
    def n_record(self) -> int:
        """Number of records that can be looked at."""
        return 0 if self.records is None else int(self.records.sizes["record"])

    @cached_property
    def record_names(self) -> list[str]:
        """What to call the records: their numbers, and their starts where these are known."""
        if self.records is None:
            return []
        times = self.records.coords.get("time")
        known = (
            np.full(self.n_record, np.datetime64("NaT", "ns"))
            if times is None or not np.issubdtype(times.dtype, np.datetime64)
            else times.values
        )
        return [record_name(number, time) for number, time in enumerate(known)]


def open_place(path: Path, name: str, settings: Settings, scan: str, at: str) -> Opened:
    """Open a folder of results or a file of radial velocities.

    Parameters
    ----------
    path : Path
        From `place_below`.
    name : str
        What it is called in the page.
    settings : Settings
        How files are read, and records made.
    scan : str
        The scan of files: a name, ``"auto"``, or nothing for that of the settings.
    at : str
        Of a fit at several ranges, which, as in `Opened.ranges`; nothing for the first.

    Raises
    ------
    InputError
        If it is none of these, cannot be read, or is too large to be read at once.
    """
    if (path / RUN_FILE).is_file() and (path / _SPECTRA).is_file():
        return _open_spectra(path, name)
    if (path / RUN_FILE).is_file():
        return _open_fit(open_fit(path), name, at)
    return _open_files(path, name, settings, scan)


def _open_fit(found: Fit, name: str, at: str) -> Opened:
    ranges: tuple[str, ...] = ()
    if isinstance(found, RangedFit):
        by_name = {found.range_names[place]: one for place, one in found.fits.items()}
        ranges = tuple(by_name)
        if not ranges:
            raise InputError(f"No range of the fit {name!r} has a record that could be fitted.")
        one = by_name[at] if at in ranges else by_name[ranges[0]]
    else:
        one = found
    kind = f"a fit of {one.n_record} records, {one.n_fitted} of them with a posterior"
    return Opened(name, kind, tuple(one.words), one.scan, one.records, one, ranges=ranges)


def _open_spectra(path: Path, name: str) -> Opened:
    spectra, lengths = load_netcdf(path / _SPECTRA), load_netcdf(path / "fit.nc")
    records = load_netcdf(path / _RECORDS)
    run = json.loads((path / RUN_FILE).read_text(encoding="utf-8"))
    scan = None
    try:
        known = load_scan(str(run.get("scan", "")))
    except InputError:
        known = None
    if known is not None and known.key == run.get("scan_key"):
        scan = known
    median = float(lengths["length_scale"].median()) if "length_scale" in lengths else np.nan
    lines = (f"scan {run.get('scan')}", f"median length scale {median:.3g} m", f"{run.get('n_fitted')} spectra fitted")
    return Opened(name, "spectra of records", lines, scan, records, None, spectra, lengths)


def _open_files(path: Path, name: str, settings: Settings, scan: str) -> Opened:
    size = (
        path.stat().st_size if path.is_file() else sum(one.stat().st_size for one in path.rglob("*") if one.is_file())
    )
    if size > _MOST_BYTES:
        raise InputError(
            f"{name!r} holds {size / 1e6:.0f} MB, and the app reads up to {_MOST_BYTES / 1e6:.0f} at once: fit it with "
            "bayes-rs fit, and open the folder of that."
        )
    said: list[str] = []
    own = settings.changed(files=(str(path),), **({"scan": scan, "scan_toml": None} if scan else {}))
    if own.scan.scan is None and own.scan.scan_toml is None:
        raise InputError(
            f"The scan of {name!r} is not known: choose one, or auto for files whose rays say where they point."
        )
    own = with_found_scan(own, said.append)
    loaded = own.scan.load()
    records, series = open_records(path, loaded), None
    check_motion(own.records, own.files)
    mast = mast_of(own.records, records, own.files)
    if records is None:
        series = read(list(own.files.files), loaded, **lidar_options(own, loaded).of_reading())
        records = make_records(series, loaded, quality=own.quality, **options_of_series(own.records))
    records = add_motion(records, loaded, own.records, own.files, say=said.append)
    records = add_mast(records, mast, own.records, said.append)
    return _of_records(name, records, loaded, series, said)


def _of_records(name: str, records: xr.Dataset, scan: Scan, series: xr.Dataset | None, said: list[str]) -> Opened:
    if has_ranges(records):
        raise InputError(
            f"{name!r} is of several ranges: name one with --range when the app is begun, or fit it first."
        )
    spectra = None
    if series is not None:
        try:
            spectra = radial_spectra(series, scan, records)
        except InputError as error:
            said.append(f"no spectra: {error}")
    lines = (*said, f"scan {scan.name}: {scan.n_beam} beams, a cycle of {scan.scan_duration:g} s")
    return Opened(name, f"{records.sizes['record']} records", lines, scan, records, None, spectra)


def with_fit(opened: Opened, settings: Settings) -> Opened:
    """Return the same with the posteriors of its records, which are not written anywhere.

    Raises
    ------
    InputError
        If there are none to fit, too many, or the fit refuses them.
    """
    if opened.records is None or opened.scan is None or opened.fit is not None:
        raise InputError("There are no records here that could be fitted.")
    if opened.n_record > _MOST_FITTED:
        raise InputError(
            f"There are {opened.n_record} records, and the app fits up to {_MOST_FITTED}: use bayes-rs fit, and open "
            "the folder that it writes."
        )
    options = {
        **{name: getattr(settings.fit, name) for name in ("seed", "prior", "target", "prob")},
        "turbulence": settings.noise.turbulence,
    }
    found = fit(opened.records, opened.scan, progress=False, draws="float32", **options)
    return replace(opened, fit=found, lines=(*opened.lines, *found.words))
