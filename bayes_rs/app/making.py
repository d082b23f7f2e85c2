"""The app as a whole: its two pages on one site."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from bayes_rs.app.results_page import ResultsPage
from bayes_rs.app.scan_page import ScanPage
from bayes_rs.app.site import Site
from bayes_rs.errors import InputError
from bayes_rs.fits.settings import Settings


def make_app(named: Sequence[str | Path], settings: Settings) -> Site:
    """Return the app.

    Parameters
    ----------
    named : sequence of str or Path
        A folder to look below; a folder of results or a file, which is opened at once; or several, of which the first
        is opened. Without any the app looks below the working folder.
    settings : Settings
        How files are read.

    Raises
    ------
    InputError
        If something named does not exist.
    """
    paths = [Path(one).absolute() for one in named]
    for path in paths:
        if not path.exists():
            raise InputError(f"{str(path)!r} does not exist: name a folder or files that are there, or none.")
    start, first = start_of(paths)
    site = Site()
    ResultsPage(site, start, first, settings)
    ScanPage(site)
    return site


def start_of(paths: Sequence[Path]) -> tuple[Path, str]:
    """Return the folder that the app looks below, and what it opens at once, relative to it."""
    if not paths:
        return Path.cwd(), ""
    if len(paths) == 1 and paths[0].is_dir() and not (paths[0] / "run.json").exists():
        return paths[0], ""
    start = Path(os.path.commonpath([path.parent for path in paths]))
    return start, str(paths[0].relative_to(start))
