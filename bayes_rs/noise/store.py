"""Where noise is kept: the files that are shipped, and the user's cache."""

from __future__ import annotations

import logging
import os
import stat
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bayes_rs._validation import check_choice
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.models import models_folder
from bayes_rs.noise.file import read_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.sealed import is_sealed
from bayes_rs.turbulence.mann import MannTurbulence

_log = logging.getLogger(__name__)

THEORY_SUFFIX = "-theory"
"""How the names of shipped files end whose noise is from theory; the others are from boxes."""

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_SAME = 1e-9
"""Wind speeds (m/s), yaws (rad) and durations (s) no farther apart are the same."""


def cache_folder(cache: bool | str | Path = True) -> Path:
    """Return the folder of cached noise: the one given, or the user's own.

    Parameters
    ----------
    cache : bool, str or Path
        A folder; True or False for the user's own.

    Returns
    -------
    folder : Path
        It need not exist.
    """
    if not isinstance(cache, bool):
        return Path(cache)
    if own := os.environ.get("BAYES_RS_CACHE"):
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "bayes_rs"


def find_shipped_noise(
    scan: Scan,
    turbulence: MannTurbulence,
    wind_speed: float | None = None,
    duration: float = 600.0,
    yaw: float | None = None,
    *,
    method: str = "theory",
) -> Noise | None:
    """Find the noise that is shipped in ``models/noise`` for a scan.

    Parameters
    ----------
    scan : Scan
        The scan, compared by its geometry, not its name; also some of the beams of a shipped one.
    turbulence : MannTurbulence
        The turbulence, compared by its three numbers.
    wind_speed : float, optional
        Mean wind speed that the noise must have been made for, m/s. If it is not given, any will do.
    duration : float
        Length of a record, s.
    yaw : float, optional
        Wind direction that the noise must have been made for, rad. If it is not given, any will do.
    method : str
        ``"theory"`` or ``"boxes"``: how the noise must have been made.

    Returns
    -------
    noise : Noise or None
        That state, which must be one of the shipped ones; all that is shipped if neither wind speed nor yaw is given;
        None if there is none.

    Raises
    ------
    InputError
        If a shipped file is damaged.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> noise = find_shipped_noise(load_scan("6-beam"), load_turbulence("fu-2022"))
    >>> noise.n_beam
    6
    """
    by_theory = check_choice(method, ("theory", "boxes"), what="method of shipped noise") == "theory"
    for file in sorted(models_folder("noise").glob("*.nc")):
        if file.stem.endswith(THEORY_SUFFIX) != by_theory:
            continue
        noise = _load(file, file.stat().st_mtime_ns)
        if not set(scan.beam.tolist()) <= set(noise.beam.tolist()):
            continue
        noise = noise.select(scan.beam)
        if not _fits(noise, scan, turbulence, duration):
            continue
        if wind_speed is None and yaw is None:
            return with_details(renamed(noise, scan, turbulence), origin="shipped")
        same = np.full(len(noise), True)
        if wind_speed is not None:
            same &= np.abs(noise.wind_speed - wind_speed) <= _SAME
        if yaw is not None:
            same &= np.abs(noise.yaw - yaw) <= _SAME
        for index in np.flatnonzero(same):
            return with_details(renamed(noise.state(int(index)), scan, turbulence), origin="shipped")
    return None


def from_cache(file: Path, key: str) -> tuple[Noise | None, str | None]:
    """Read cached noise; a damaged file, and one that others could have written, is reported, not raised.

    Parameters
    ----------
    file : Path
        The cached file.
    key : str
        Key that the noise must carry in its details.

    Returns
    -------
    noise : Noise or None
        None if it is not there, damaged, of an older version, belongs to another key, or is not ours alone to write.
    damage : str or None
        What is wrong with it, if it is there.
    """
    try:
        strange = _whose(file)
        if strange:
            _log.warning("The cached noise %s is not believed, %s, and is calculated again.", file, strange)
            return None, f"it is not believed, {strange}"
        if not is_sealed(file):
            raise InputError("it is not whole, or of an older version.")  # noqa: TRY301 - caught below with the others
        noise = read_noise(file, trusted=True)
    except (FileNotFoundError, NotADirectoryError):
        return None, None
    except (InputError, OSError) as error:
        _log.warning("The cached noise %s is damaged and is calculated again: %s", file, error)
        return None, str(error)
    if noise.details.get("key") != key:
        _log.warning("The cached noise %s belongs to another key and is calculated again.", file)
        return None, "it belongs to another key"
    return noise, None


def to_cache(noise: Noise, file: Path) -> None:
    """Write noise to the cache; where that cannot be done, log it and go on.

    Parameters
    ----------
    noise : Noise
        The noise.
    file : Path
        File in the cache; its folder is made.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        noise.save(file, overwrite=True)
        if hasattr(os, "geteuid"):
            file.chmod(file.stat().st_mode & ~_OTHERS_WRITE)  # or we would not believe it
    except (OSError, InputError) as error:
        _log.warning("The noise cannot be cached and will be calculated again next time: %s", error)


def renamed(noise: Noise, scan: Scan, turbulence: MannTurbulence) -> Noise:
    """Give found noise the names in use: a scan or a turbulence may be called differently than when it was made.

    Parameters
    ----------
    noise : Noise
        Noise that was found by its numbers.
    scan : Scan
        The scan in use.
    turbulence : MannTurbulence
        The turbulence in use.

    Returns
    -------
    noise : Noise
        The same noise with these names.
    """
    if noise.n_turbulence == 1:
        one = np.ones(len(noise))
        scale, gamma = turbulence.length_scale * one, turbulence.gamma * one
        return replace(noise, scan_name=scan.name, turbulence=turbulence, length_scale=scale, gamma=gamma)
    flow = replace(noise.turbulence, name=turbulence.name, source=turbulence.source)
    return replace(noise, scan_name=scan.name, turbulence=flow)


def with_details(noise: Noise, **details: Any) -> Noise:
    """Return the noise with more details, the same for all states.

    Parameters
    ----------
    noise : Noise
        The noise.
    **details
        Plain JSON values.

    Returns
    -------
    noise : Noise
        The same numbers.
    """
    return replace(noise, details={**noise.details, **details})


@lru_cache(maxsize=64)
def _load(file: Path, _modified: int) -> Noise:
    """Read a shipped file once: noise never changes."""
    return read_noise(file, trusted=True)


def _whose(file: Path) -> str:
    """Say who else can have written a file; nothing if nobody but the system's administrator."""
    if not hasattr(os, "geteuid"):
        return ""
    found = file.stat()
    if found.st_uid not in (os.geteuid(), 0):
        return f"it belongs to another user ({found.st_uid})"
    return "others may write it" if found.st_mode & _OTHERS_WRITE else ""


def _fits(noise: Noise, scan: Scan, turbulence: MannTurbulence, duration: float) -> bool:
    try:
        noise.check_scan(scan)
    except InputError:
        return False
    same = (noise.turbulence.dissipation, noise.turbulence.length_scale, noise.turbulence.gamma) == (
        turbulence.dissipation,
        turbulence.length_scale,
        turbulence.gamma,
    )
    return same and abs(noise.duration - duration) <= _SAME
