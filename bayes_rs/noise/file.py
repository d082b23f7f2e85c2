"""Reading noise files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_rs.errors import InputError, in_short
from bayes_rs.noise.layout import FILE_KIND, FILE_VERSION, noise_fields
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.sealed import is_sealed
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.netcdf_file import load_netcdf


def load_noise(path: str | Path) -> Noise:
    """Read noise from the NetCDF file that `Noise.save` wrote.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    noise : Noise
        What the file holds.

    Raises
    ------
    InputError
        If there is no such file, or it is not a noise file that this version can read.

    Examples
    --------
    >>> from bayes_rs.models import models_folder
    >>> load_noise(models_folder("noise") / "6-beam.nc").scan_name
    '6-beam'
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"Invalid noise {in_short(path)}: give a Noise, or the file of one that Noise.save wrote.")
    file = Path(path)
    if not file.is_file():
        raise InputError(f"No noise file {str(file)!r}: make one with calibrate, or give the path of another.")
    return read_noise(file)


def read_noise(file: Path, *, trusted: bool = False) -> Noise:
    """Read a noise file; see `load_noise`.

    Parameters
    ----------
    file : Path
        The file.
    trusted : bool
        That only we, or who installed this package, can have written it: if its fingerprint fits its content, it is not
        looked through first. A fingerprint alone is no signature, anybody can make one.
    """
    dataset = load_netcdf(file, trusted=is_sealed(file) and trusted)
    if str(dataset.attrs.get("kind")) != FILE_KIND:
        raise InputError(f"File {str(file)!r} is not a noise file of bayes_rs: make one with calibrate.")
    version = dataset.attrs.get("format_version", 0)
    if np.ndim(version) or isinstance(version, str) or version != FILE_VERSION:
        raise InputError(
            f"Noise file {str(file)!r} has format version {version} and this program reads {FILE_VERSION}: "
            "calibrate again."
        )
    try:
        return Noise(**noise_fields(dataset))
    except InputError as error:
        raise InputError(f"Noise file {str(file)!r} is damaged: {error}") from error
    except UNREADABLE as error:
        raise InputError(f"Noise file {str(file)!r} is damaged, {error} cannot be read: calibrate again.") from error


load = load_noise
"""Its name in `bayes_rs.noise`."""


def as_noise(noise: Noise | str | Path) -> Noise:
    """Return the noise itself, or that of a file; see `load_noise`.

    Parameters
    ----------
    noise : Noise, str or Path
        The noise, or a file that `Noise.save` wrote.

    Returns
    -------
    noise : Noise
        The noise.

    Raises
    ------
    InputError
        If it is of another kind, as a tuple, or the file is not one of noise.

    Examples
    --------
    >>> from bayes_rs.noise.by_theory import theory
    >>> noise = theory("staring", wind_speed=10.0)
    >>> as_noise(noise) is noise
    True
    """
    return noise if isinstance(noise, Noise) else load_noise(noise)
