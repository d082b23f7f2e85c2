"""Settings whose scan is found in the files themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from bayes_rs.errors import InputError
from bayes_rs.file_options import ALL_RANGES
from bayes_rs.fits.settings import AUTO, InputOptions, Settings

if TYPE_CHECKING:
    from bayes_rs.readers.survey import Survey

MOST_SURVEYED = 200
"""Files from which on only so many, evenly chosen, are looked at for the scan, if these hold one scan only."""


def with_found_scan(settings: Settings, say: Callable[[str], None]) -> Settings:
    """Return settings with the scan that is found in their files, where their scan is ``"auto"``; others as they are.

    Parameters
    ----------
    settings : Settings
        With files, and with the wanted heights or ranges: with one of them the scan is at it, with several it is read
        at each (see `FileOptions`).
    say : callable
        Takes lines that tell what was found.

    Returns
    -------
    settings : Settings
        Their scan is written out, so that they can be saved and repeated. Where the files hold other scans, too, only
        those of this one are named.

    Raises
    ------
    InputError
        If no scan is found; see `bayes_rs.find_scan`.
    """
    own = settings.scan
    if own.scan != AUTO or own.scan_toml is not None:
        return settings
    from bayes_rs.geometry.scan_file import load_scan_text  # noqa: PLC0415 - not needed for a scan with a name
    from bayes_rs.geometry.scan_writing import scan_text  # noqa: PLC0415 - as above

    for name in ("opening_angle_deg", "focus_distance"):
        if getattr(own, name) is not None:
            raise InputError(f"Invalid {name} with scan auto: beams are found where they are; give height or range.")
    found = _survey(settings)
    mounted = {name: getattr(own, name) for name in ("tilt_deg", "yaw_deg") if getattr(own, name) is not None}
    scan = load_scan_text(scan_text(found.scan), name=found.scan.name, **mounted)
    near, far = (f"{end:.4g}" for end in (scan.focus_distance.min(), scan.focus_distance.max()))
    say(
        f"scan found: {scan.n_beam} beams at {near if near == far else f'{near} to {far}'} m, a cycle of "
        f"{scan.scan_duration:g} s; {scan.source}"
    )
    others = [line for index, line in enumerate(found.found.in_words()) if index != found.chosen]
    for line in others:
        say(f"not of this scan, and not read: {line}")
    for path, reason in found.found.skipped.items():
        say(f"file {path.name}: {reason}")
    options = replace(own, scan=scan.name, scan_toml=scan_text(scan), scan_group=None)
    reading = settings.files
    if len(distances(reading.height) or distances(reading.range)) == 1:
        reading = replace(reading, height=None, range=None)  # the scan is there, and nowhere else
    changed = replace(settings, scan=options, files=reading)
    return changed.changed(files=[str(path) for path in found.files]) if others else changed


def distances(value: object) -> tuple[float, ...]:
    """Return the numbers that an option of distances has; none if it has a word, or nothing."""
    return tuple(value) if isinstance(value, (list, tuple)) else ()


def survey_options(reading: InputOptions) -> dict[str, Any]:
    """Return the options of reading that a survey takes, by name: where the beams are looked for is its own."""
    return {name: value for name, value in reading.of_reading().items() if name not in ("range", "height")}


def _survey(settings: Settings) -> Survey:
    from bayes_rs.readers.folders import find_files  # noqa: PLC0415 - not needed for a scan with a name
    from bayes_rs.readers.one_file import SUFFIXES  # noqa: PLC0415 - as above
    from bayes_rs.readers.survey import survey  # noqa: PLC0415 - as above

    own, files = settings.scan, list(settings.files.files)
    if not files:
        raise InputError("Scan auto is found in files, and none is given: name files, folders or patterns.")
    from bayes_rs.fits.lidar_files import lidar_options  # noqa: PLC0415 - as above

    reading = settings.files
    wanted = {
        **survey_options(lidar_options(settings, None)),
        "height": distances(reading.height)[:1] or None,
        "distance": distances(reading.range)[:1] or None,
        "any_gate": reading.range == ALL_RANGES,
        "group": own.scan_group,
    }
    every = find_files(files, SUFFIXES).paths
    if len(every) > MOST_SURVEYED:
        some = [every[round(index * (len(every) - 1) / (MOST_SURVEYED - 1))] for index in range(MOST_SURVEYED)]
        found = survey(some, **wanted)
        if len(found.found.groups) == 1:
            return found
    return survey(every, **wanted)
