"""How the files of radial velocities are read, where options are also those of the files beside them."""

from __future__ import annotations

from bayes_rs.fits.settings import InputOptions, Settings
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.one_file import SUFFIXES
from bayes_rs.readers.used_options import without_unused
from bayes_rs.records.record_options import options_beside


def lidar_options(settings: Settings, scan: Scan | None) -> InputOptions:
    """Return how the files of radial velocities are read: without what is said for a motion or a mast beside them.

    Parameters
    ----------
    settings : Settings
        With the files. An option that those of motion or of a mast have, too, need not be one of these: times of NetCDF
        files are in UTC, and those of a table of motion beside them may not be.
    scan : Scan, optional
        The scan; None if it is looked for in the files.

    Raises
    ------
    InputError
        If there is no file.
    """
    names = options_beside(settings.records)
    if not names & set(settings.files.given()):
        return settings.files
    return without_unused(find_files(list(settings.files.files), SUFFIXES).paths, scan, settings.files, names)
