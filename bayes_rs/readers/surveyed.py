"""What a survey takes of a file of rays: where they point, when, and at which gates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers.compressed import own_suffix, plain_file
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.netcdf_file import SUFFIXES as NETCDF_SUFFIXES
from bayes_rs.readers.netcdf_file import glance
from bayes_rs.readers.not_read import why_not
from bayes_rs.readers.rays import Rays
from bayes_rs.readers.registry import READERS
from bayes_rs.readers.used_options import NO_SCAN, check_used

RAY_READERS = {name: reader for name, reader in READERS.items() if reader.rays is not None}
"""The formats whose rays say where they point."""


@dataclass(frozen=True, eq=False)
class SurveyedFile:
    """The rays of one file without their velocities.

    Parameters
    ----------
    path : Path
        The file.
    time : ndarray of datetime64, shape (n_ray,)
        UTC.
    direction : ndarray, shape (n_ray, 3)
        Unit vectors, as in `Rays`; NaN also where the time is not known.
    distance : ndarray, shape (n_ray, n_gate)
        Gates, m; a view of one row where all rays have the same.
    """

    path: Path
    time: NDArray[np.datetime64]
    direction: FloatArray
    distance: FloatArray


def survey_files(
    files: str | Path | Sequence[str | Path], options: FileOptions
) -> tuple[list[SurveyedFile], dict[Path, str]]:
    """Return the rays of files without their velocities, and the files that cannot be read with the reasons.

    Raises
    ------
    InputError
        If there is no file, the format is none of rays, no file can be read, or one cannot and is not to be skipped.
    """
    check_choice(options.file_format, ("auto", *RAY_READERS), what="file_format")
    suffixes = [suffix for reader in RAY_READERS.values() for suffix in reader.suffixes]
    found: list[SurveyedFile] = []
    skipped: dict[Path, str] = {}
    paths = find_files(files, suffixes).paths
    check_used(paths, None, options)
    for path in paths:
        try:
            found.append(_surveyed(path, options))
        except InputError as error:
            if options.on_bad_file == "error":
                raise
            skipped[path] = str(error)
    if not found:
        raise InputError(
            f"None of {len(skipped)} files has rays that can be read; the first: {next(iter(skipped.values()))}"
        )
    return found, skipped


def rays_of(path: Path, options: FileOptions) -> Rays:
    """Return the rays of one file, in the first format that recognises it.

    Raises
    ------
    InputError
        If it is in none of the formats whose rays say where they point, or cannot be used.
    """
    kind = options.file_format
    reason = why_not(path)
    if reason is not None:
        raise InputError(reason)
    with plain_file(path) as plain:
        try:
            suffix = own_suffix(plain)
            for name, reader in RAY_READERS.items():
                resolved = resolve_format(options, None, defaults=reader.defaults)
                fits = suffix in reader.suffixes
                if name == kind or (kind == "auto" and fits and reader.recognises(plain, NO_SCAN, resolved)):
                    return reader.rays(plain, reader.with_zone(plain, options, resolved))  # type: ignore[misc]  # those of RAY_READERS are not None
            if suffix in NETCDF_SUFFIXES:
                glance(plain)  # a damaged one says so: no reader recognises it
        except InputError as error:
            raise InputError(str(error).replace(repr(str(plain)), repr(str(path)))) from error
    raise InputError(
        f"File {str(path)!r} is in none of the formats whose rays say where they point ({', '.join(RAY_READERS)}): "
        "give other files, or write the scan by hand."
    )


def _surveyed(path: Path, options: FileOptions) -> SurveyedFile:
    rays = rays_of(path, options)
    return surveyed_rays(path, rays)


def surveyed_rays(path: Path, rays: Rays) -> SurveyedFile:
    """Return what a survey takes of rays."""
    gates = rays.distance
    if len(gates) and np.array_equal(gates, np.broadcast_to(gates[:1], gates.shape), equal_nan=True):
        gates = np.broadcast_to(gates[:1].copy(), gates.shape)
    direction = np.where(np.isnat(rays.time)[:, np.newaxis], np.nan, rays.direction)
    return SurveyedFile(path, rays.time, direction, gates)
