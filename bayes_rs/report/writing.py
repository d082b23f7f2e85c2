"""The report of a fit, as a file."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.fits.coherence import coherence_of
from bayes_rs.fits.columns import VARIANCES
from bayes_rs.fits.fit_folder import open_fit
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.output import as_named, output_file
from bayes_rs.report.beside import Beside, match_fits
from bayes_rs.report.page import render
from bayes_rs.report.ranged_page import render_ranges
from bayes_rs.report.reference_section import make_reference
from bayes_rs.report.report_data import NUMBERS, ReportData, report_data
from bayes_rs.result_folder import list_beside

if TYPE_CHECKING:
    from bayes_rs.report.budget_section import BudgetShown

REPORT_FILE = "report.html"


def write_report(
    fit: Fit | str | Path,
    output: str | Path | None = None,
    *,
    title: str | None = None,
    prob: float | None = None,
    reference: str | Path | pd.DataFrame | xr.Dataset | None = None,
    beside: Fit | str | Path | None = None,
    budget: bool = False,
    overwrite: bool = False,
) -> Path:
    """Write one HTML page that shows what a fit found, with its pictures and everything they are drawn from.

    Parameters
    ----------
    fit : Fit, str or Path
        A fit, or its folder.
    output : str or Path, optional
        File to write; by default ``report.html`` in the fit's folder.
    title : str, optional
        Heading of the page; by default the scan and the period.
    prob : float, optional
        Probability of the credible intervals; by default that of the fit. Another one needs the draws.
    reference : str, Path, DataFrame or Dataset, optional
        Turbulence intensity of another instrument, as a CSV file or a table: columns ``time`` (start of the period,
        UTC), and ``ti`` (σ_u/U) or ``sigma_u`` and ``U`` (m/s). Or the series of a sonic, a TOA5 file or a folder of
        them; or what `bayes_rs.wind.sonic_stresses` makes of it. The page then shows errors by wind speed.
    beside : Fit, str or Path, optional
        Another fit of the same records, or its folder: the page then shows both, matched by the starts of the records.
        A fit that uses covariances or a mast has what the variances say by themselves beside it.
    budget : bool
        Show the uncertainty budget, too: `bayes_rs.budget` of the fit's records together, which takes seconds.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    file : Path
        The page.

    Raises
    ------
    InputError
        If the folder is not of a fit, the fit is in memory and no file is named, the file exists and may not be
        replaced, prob cannot be had, the reference cannot be read or matched, the other fit shares no record, or either
        is given for a fit at several ranges; or a budget is asked for that cannot be had, or for the page of several
        ranges alone.

    Notes
    -----
    Of a fit at several ranges the page shows the profile, and leads to a page for each range in the folder of its fit;
    with `output` it stands alone.

    The page loads nothing from elsewhere, and the same folder gives the same bytes. Of more than 1000 records the
    pictures along time show bins of whole hours. Draws go with the page as far as they take less than about 2.4 MB, 100
    to 600 a record; beyond, the posterior of a record is drawn from its mean and covariance, as a Gaussian. Where a
    folder has no rows for it, turbulence intensity is √uu/U of the ends of the interval of uu.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> scan = brs.load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0)
    >>> records = brs.make_records(brs.read(brs.demo_file("6-beam-45"), scan), scan)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = write_report(brs.fit(records, scan, seed=1), f"{folder}/report.html")
    ...     file.name, "Over time" in file.read_text(encoding="utf-8")
    ('report.html', True)
    """
    found = open_fit(fit) if isinstance(fit, (str, Path)) else check_fit(fit)
    if output is None and not found.place:
        raise InputError("A fit in memory has no folder for its report: name a file to write.")
    file = Path(found.place) / REPORT_FILE if output is None else Path(output)
    if isinstance(found, RangedFit):
        if reference is not None or beside is not None:
            raise InputError(
                f"A reference, or another fit, stands beside a fit at one range: take one of the {len(found.ranges)} "
                "ranges (--range, fit.at)."
            )
        if budget and output is not None:
            raise InputError(
                f"A budget is of a fit at one range, and stands in the page of each: leave the output out, or take one "
                f"of the {len(found.ranges)} ranges (--range, fit.at)."
            )
        pages = None if output is not None else file
        html = partial(_of_ranges, found, pages, title, prob, budget=budget, overwrite=overwrite)
    else:
        data = report_data(found, prob=prob)
        compared = _alone(found, data, prob) if beside is None else _match(found, data, beside, prob)
        measured = None if reference is None else make_reference(data, reference)
        parts = _budget_of(found) if budget else None
        html = partial(render, data, title=title, reference=measured, beside=compared, budget=parts)
    read = [reference] if isinstance(reference, (str, Path)) else []
    with output_file(file, overwrite=overwrite, inputs=read) as part:
        part.write_text(html(), encoding="utf-8", newline="\n")
    if output is None:
        list_beside(file)  # it belongs to the folder, and goes with it
    return as_named(file, fit) if isinstance(fit, (str, Path)) else file


def _budget_of(fit: Fit) -> BudgetShown:
    from bayes_rs.report.budget_section import make_budget  # noqa: PLC0415 - all that fits comes with it

    return make_budget(fit)


def _alone(fit: Fit, data: ReportData, prob: float | None) -> Beside | None:
    """Return what the variances say by themselves beside a fit that uses covariances or a mast, if there is any."""
    found = coherence_of(fit)
    if found is None or prob not in (None, fit.settings["fit"]["prob"]):
        return None
    words = found.in_words()
    note = (
        f"{words[:1].upper()}{words[1:]}. {100.0 * found.share:.1f} % of the records have data beside as unlikely as "
        "one in a hundred."
    )
    alone = replace(data, numbers=fit.of_stresses(*NUMBERS, dataset=VARIANCES))
    used = " and ".join(found.data) if "covariances" in found.data else "beams and mast"
    return replace(match_fits(data, alone, (used, "variances")), note=note)


def _match(fit: Fit, data: ReportData, beside: Fit | str | Path, prob: float | None) -> Beside:
    """Return the other fit beside this one."""
    other = open_fit(beside) if isinstance(beside, (str, Path)) else check_fit(beside)
    if isinstance(other, RangedFit):
        raise InputError(f"The fit beside is at {len(other.ranges)} ranges: give that at one of them.")
    places = [Path(one.place).resolve() if one.place else None for one in (fit, other)]
    known = [one for one in places if one is not None]
    names = [one.name for one in known] if len(set(known)) > 1 else ["this fit", "the other"]
    if names[0] == names[1]:
        names = [f"{one.parent.name}/{one.name}" for one in known]
    return match_fits(data, report_data(other, prob=prob), (names[0], names[1]))


def _of_ranges(
    found: RangedFit, file: Path | None, title: str | None, prob: float | None, *, budget: bool, overwrite: bool
) -> str:
    """Return the page of a fit at several ranges; those of its ranges are written into their folders first."""
    links: dict[int, str] = {}
    if file is not None:
        for place, own in found.fits.items():
            page = write_report(own, title=title, prob=prob, budget=budget, overwrite=overwrite)
            links[place] = page.relative_to(file.parent).as_posix()
    return render_ranges(found, links, title=title)
