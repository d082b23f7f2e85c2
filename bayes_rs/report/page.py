"""The page of a fit: what was found first, then what it rests on; each section only where there are data for it."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_rs.fits.flags import FAILURES, FLAGS
from bayes_rs.fits.headline import Headline
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.records.layout import mast_there
from bayes_rs.report import figures, words
from bayes_rs.report.availability import make_availability
from bayes_rs.report.beside import Beside, beside_data, beside_section
from bayes_rs.report.campaign_section import CampaignShown, campaign_data, campaign_section
from bayes_rs.report.diagnostics_section import diagnostics_section
from bayes_rs.report.found_sections import decided_section, intensity_section, shape_section
from bayes_rs.report.packing import pack
from bayes_rs.report.provenance_section import provenance_section
from bayes_rs.report.read_section import read_section
from bayes_rs.report.record_section import record_section
from bayes_rs.report.reference_section import Reference, reference_data, reference_section
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.series import make_series, time_axis
from bayes_rs.report.tables import pairs
from bayes_rs.report.template import FIT_SCRIPTS, framed
from bayes_rs.report.time_section import time_section
from bayes_rs.report.turbines import turbine_table

if TYPE_CHECKING:
    from bayes_rs.report.budget_section import BudgetShown

_HOUR = 3.6e6  # ms
_TEN_MINUTES = 6e5  # ms
_WITHOUT_SCRIPT = (
    '<noscript><p class="note">The pictures need JavaScript. Every picture has a table, which does not.</p></noscript>'
)


def render(
    found: ReportData,
    *,
    title: str | None = None,
    reference: Reference | None = None,
    beside: Beside | None = None,
    budget: BudgetShown | None = None,
) -> str:
    """Return the whole page.

    Parameters
    ----------
    found : ReportData
        From `report_data`.
    title : str, optional
        Heading; by default the scan and the period.
    reference : Reference, optional
        Turbulence intensity of another instrument beside it.
    beside : Beside, optional
        Another fit of the same records.
    budget : BudgetShown, optional
        The uncertainty budget.

    Returns
    -------
    html : str
        The page, with its style, its script and its data.
    """
    _, width, timed = time_axis(found)
    rows = figures.picked(found)
    covariance = found.covariance(rows)
    room, spread = figures.prior_room(found, rows, covariance)
    series = make_series(found, room)
    availability = make_availability(found.records, _HOUR / width if timed else None)
    records = figures.records_data(found, rows, covariance)
    along = figures.series_data(series)
    if reference is not None:
        records["reference"] = pack(reference.ti[rows], "f4")
        along["reference"] = figures.over_bins(found, series, reference.ti)
    campaign = found.campaign if isinstance(found.campaign, CampaignShown) else None
    data: dict[str, Any] = {
        "stresses": list(STRESSES),
        "prob": found.prob,
        "interval": found.interval,
        "timed": timed,
        "step": width,
        "duration": 1e3 * float(found.records.attrs.get("duration", width / 1e3 if timed else _TEN_MINUTES / 1e3)),
        "thinned": len(rows) < len(found.record),
        "series": along,
        "records": records,
        "room": figures.room_data(found, spread) if found.fitted.any() else None,
        "flags": FLAGS,
        "failures": FAILURES,
        "availability": figures.availability_data(availability, found),
        "decided": figures.decided_data(found),
        "intensity": figures.intensity_data(found),
        "shape": figures.shape_data(found),
        "diagnostics": figures.diagnostics_data(found),
        "campaign": None if campaign is None else campaign_data(campaign),
        "reference": None if reference is None else reference_data(found, reference),
        "beside": None if beside is None else beside_data(beside, rows),
        "budget": None if budget is None else budget.data,
    }
    named = "" if reference is None else reference.name
    compared = reference_section(found, reference) if reference is not None else ""
    sections = [
        ("stresses", "Over time", time_section(found, series, named)),
        ("turbines", "Turbines", turbine_table(found)),
        ("campaign", "Campaign", campaign_section(found.campaign, named) + compared),
        ("beside", _title(beside), "" if beside is None else beside_section(beside)),
        ("record", "One record", record_section(found, timed=timed)),
        ("intensity", "Turbulence intensity", intensity_section(found, data)),
        ("decided", "What the data said", decided_section(found, data)),
        ("budget", "Uncertainty budget", "" if budget is None else budget.content),
        ("shape", "Shape of the tensor", shape_section(found, data)),
        ("diagnostics", "Flags and diagnostics", diagnostics_section(found)),
        ("read", "What was read", read_section(found, availability)),
        ("provenance", "How it was made", provenance_section(found)),
    ]
    if title is None:
        scan = str(found.run.get("scan", "")) or "unknown scan"
        title = f"Reynolds stresses, scan {scan}" + (f", {words.period(found)}" if words.period(found) else "")
    head = headline(found.headline) + _key_numbers(found) + f'<p class="lead">{escape(_lead(found))}</p>'
    return framed(title, head, sections, data, FIT_SCRIPTS, _WITHOUT_SCRIPT)


def _title(beside: Beside | None) -> str:
    if beside is None or not beside.note:
        return "Two fits beside each other"
    return f"By {beside.names[0]} and by {beside.names[1]}"


def headline(found: Headline) -> str:
    """Return the three lines that the page begins with."""
    items = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(said)}</dd></div>" for name, said in found.rows())
    return f'<dl class="headline">{items}</dl>'


def _lead(found: ReportData) -> str:
    used = dict(found.run.get("settings", {})).get("fit", {}).get("information", "variances")
    both = "variances and covariances" if used == "covariances" else "variances"
    text = f"Bayesian estimate of the six Reynolds stresses from the {both} of a Doppler lidar's beams"
    text += " and the stresses of a mast beside" if mast_there(found.records)[found.fitted].any() else ""
    when = words.period(found)
    text += f", records from {when}" if when else ""
    text += f". Each number with its {interval_words(found.prob, found.interval)}."
    probe = str(found.run.get("probe_volume") or "")
    return f"{text} {probe[:1].upper()}{probe[1:]}." if probe else text


def _key_numbers(found: ReportData) -> str:
    fitted = int(found.fitted.sum())
    failed = int(np.count_nonzero(found.flag & FAILURES))
    remarked = int(np.count_nonzero(found.flag)) - failed
    outside = int(np.count_nonzero(found.flag & FLAGS["outside_noise"]))
    without = int(np.count_nonzero(found.flag & FLAGS["no_usable_beam"]))  # gaps are most of them in a long fit
    doubts = len(found.run.get("doubts", []))
    entries = [
        ("Records", f"{len(found.record)}"),
        ("Fitted", f"{fitted}"),
        ("Failed", f"{failed} ({without} without a usable beam)" if without else f"{failed}"),
        ("Other flags", f"{remarked}"),
        *([("Outside the noise's reach", f"{outside}")] if outside else []),
        *([("Not believed", f"{doubts}, in the report of reading")] if doubts else []),
    ]
    return pairs(entries, "key-numbers")
