"""Options of commands that show one range of a fit at several."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from bayes_rs.cli.options import Quantity

if TYPE_CHECKING:
    from bayes_rs.fits.fit_object import Fit

_Command = TypeVar("_Command", bound=Callable[..., Any])


def range_options(command: _Command) -> _Command:
    """Give a command the options that choose a range of a fit at several."""
    for flag, name, words in (
        ("--height", "height", "Of a fit at several heights, that at this height, m."),
        ("--range", "distance", "Of a fit at several ranges, that at this range, m."),
    ):
        command = click.option(flag, name, type=Quantity(name, "m"), help=words)(command)
    return command


def fit_at_range(folder: Path, distance: float | None, height: float | None) -> Fit:
    """Open a fit, or that at one of its ranges.

    Raises
    ------
    InputError
        If a range is chosen and the fit has one only, or there is none near.
    """
    from bayes_rs.errors import InputError
    from bayes_rs.fits.fit_folder import open_fit
    from bayes_rs.fits.ranged_fit import RangedFit

    found = open_fit(folder)
    if distance is None and height is None:
        return found
    if not isinstance(found, RangedFit):
        raise InputError(f"The fit in {str(folder)!r} is of one range: leave --range and --height out.")
    return found.at(distance, height=height)
