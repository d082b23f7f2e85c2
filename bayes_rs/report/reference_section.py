"""Turbulence intensity against a reference: errors by wind speed, bands of acceptance, and coverage."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.intensity_metrics import ALL_SPEEDS, BIAS_LIMIT, REPRESENTATIVE, RRMSE_LIMIT, intensity_errors
from bayes_rs.fits.intensity_reference import intensity_reference
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.records.layout import mast_there
from bayes_rs.report.packing import plain
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import figure, folded, key, number, table

FEW = 3
"""Records below which a bin's errors are drawn in grey."""
_SCOPE = (
    "The limits are those of DNV-RP-0661 (2023) for the verification of loads. That practice is for vertical profilers "
    "on the ground beside a mast, and leaves nacelle lidars out: the limits stand here as what is usually quoted. Each "
    "record counts with its posterior median. A reference at another place sees other eddies, which is part of the "
    "RRMSE and of what the intervals miss."
)
_AMONG_DATA = (
    "What a mast measured is among the data of this fit: against the same mast, these errors are not the lidar's own."
)
_CAPTION = f"Errors; repr. is representative TI, the mean of a bin plus {REPRESENTATIVE:g} standard deviations"
_NORMAL = 1.959964
"""Standard errors to each side of a mean that hold 95 %."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Turbulence intensity of another instrument at the records.

    Parameters
    ----------
    name : str
        What it is called.
    ti, wind_speed : ndarray, shape (n_record,)
        NaN where it has none; wind speed, m/s, is that of the lidar where the reference has none at all.
    n_left_out : int
        Records whose row has numbers that are not believed.
    """

    name: str
    ti: FloatArray
    wind_speed: FloatArray
    n_left_out: int


def make_reference(found: ReportData, source: str | Path | pd.DataFrame | xr.Dataset) -> Reference:
    """Read a reference, as `intensity_reference` does, for the records of a report.

    Raises
    ------
    InputError
        If it cannot be read or matched, the fit knows no turbulence intensity, or it has none of a record that the
        reference has one of.
    """
    if "ti" not in found.derived:
        raise InputError("The records have no wind speeds, and so no turbulence intensity to lay beside a reference.")
    duration = float(found.records.attrs.get("duration", 600.0))
    ti, speed, left_out = intensity_reference(source, found.time, duration)
    name = Path(source).name if isinstance(source, (str, Path)) else "reference"
    speed = speed if np.isfinite(speed).any() else found.wind_speed
    reference = Reference(name, ti, speed, int(left_out.sum()))
    if reference_errors(found, reference).empty:
        raise InputError(
            f"The reference has turbulence intensity of {int(np.isfinite(ti).sum())} records, and the fit has none of "
            f"these: {int(found.fitted.sum())} of {len(ti)} records were fitted. Give a reference of fitted records."
        )
    return reference


def reference_errors(found: ReportData, reference: Reference) -> pd.DataFrame:
    """Return `intensity_errors` of the records' posterior medians."""
    own = found.derived["ti"]
    return intensity_errors(own["median"], own["low"], own["high"], reference.ti, reference.wind_speed)


def reference_data(found: ReportData, reference: Reference) -> dict[str, Any]:
    """Return what the script draws of a reference."""
    rows = reference_errors(found, reference)
    bins = rows[rows["bin"] != ALL_SPEEDS]
    half = _NORMAL * bins["mrbe_se"].to_numpy()
    bias = bins["mrbe"].to_numpy()
    return {
        "name": reference.name,
        "bias_limit": round(100.0 * BIAS_LIMIT, 6),
        "rrmse_limit": round(100.0 * RRMSE_LIMIT, 6),
        "prob": round(100.0 * found.prob, 6),
        "few": FEW,
        "bins": {
            "speed": plain(bins["wind_speed"].to_numpy()),
            "count": bins["n_record"].tolist(),
            "ours": plain(bins["measured"].to_numpy()),
            "theirs": plain(bins["reference"].to_numpy()),
            "ours_high": plain(bins["measured_representative"].to_numpy()),
            "theirs_high": plain(bins["reference_representative"].to_numpy()),
            "bias": plain(100.0 * bias),
            "bias_low": plain(100.0 * (bias - half)),
            "bias_high": plain(100.0 * (bias + half)),
            "rrmse": plain(100.0 * bins["rrmse"].to_numpy()),
            "coverage": plain(100.0 * bins["coverage"].to_numpy()),
        },
    }


def reference_section(found: ReportData, reference: Reference) -> str:
    """Return the part of the campaign's section that lays the reference beside it."""
    rows = reference_errors(found, reference)
    called = interval_words(found.prob, found.interval)
    of_priors = is_priors(found.numbers["decided"][found.fitted, 0])
    whole = rows.iloc[0]
    mrbe, rrmse = float(whole["mrbe"]), float(whole["rrmse"])
    within = "within" if abs(mrbe) <= BIAS_LIMIT else "outside"
    below = "within" if rrmse <= RRMSE_LIMIT else "above"
    numbers = (
        f"Over {whole['n_record']} records the mean relative bias error (MRBE) is {_percent(mrbe)} (standard error "
        f"{_percent(whole['mrbe_se'])}), {within} ±{100 * BIAS_LIMIT:g} %, and the relative root mean square error "
        f"(RRMSE) {_percent(rrmse)}, {below} {100 * RRMSE_LIMIT:g} %. The {called}, holds the reference in "
        f"{100.0 * whole['coverage']:.0f} % of the records."
    )
    verdict = [numbers, *_left_out_words(reference.n_left_out), *_representative_words(rows), _SCOPE]
    if mast_there(found.records)[found.fitted].any():
        verdict.insert(0, _AMONG_DATA)
    if 2 * of_priors.sum() > len(of_priors):
        verdict.append("In most records uu, and so turbulence intensity, is mostly the prior's.")
    caption = (
        key("middle", "lidar, mean of the posterior medians")
        + key("reference", reference.name)
        + key("middle dashed", f"lidar, representative: mean + {REPRESENTATIVE:g} sd of a bin")
        + key("reference dashed", f"{reference.name}, representative")
        + key("accepted", "band of acceptance")
        + key("point", "error of a bin of 1 m/s, with 95 % by its standard error")
        + key("point priors", f"fewer than {FEW} records")
    )
    header = (
        "wind speed", "records", "lidar TI", "reference TI", "MRBE", "its standard error", "RRMSE",
        "repr. lidar", "repr. reference", "repr. error",
        f"{100.0 * found.prob:g} % intervals that hold it",
    )  # fmt: skip
    cells = [
        (
            row["bin"],
            f"{row['n_record']}",
            number(row["measured"]),
            number(row["reference"]),
            _percent(row["mrbe"]),
            _percent(row["mrbe_se"]),
            _percent(row["rrmse"]),
            number(row["measured_representative"]),
            number(row["reference_representative"]),
            _percent(row["representative_error"]),
            f"{100.0 * row['coverage']:.0f} %",
        )
        for row in rows.to_dict("records")
    ]
    return (
        f"<h3>Turbulence intensity against {escape(reference.name)}</h3>"
        + "".join(f"<p>{escape(text)}</p>" for text in verdict)
        + figure("acceptance", caption, folded("Table: errors by wind speed", table(_CAPTION, header, cells)))
    )


def _left_out_words(n_left_out: int) -> list[str]:
    """Say how many records were left out for what their row of the reference holds; nothing if none was."""
    if not n_left_out:
        return []
    many = "1 record is" if n_left_out == 1 else f"{n_left_out} records are"
    rule = "a turbulence intensity that is not above 0, or is above 1, or a wind speed that is none"
    return [f"{many} left out, since the row of the reference has {rule}."]


def _representative_words(rows: pd.DataFrame) -> list[str]:
    """Say how far the representative turbulence intensity of the bins is off; nothing without bins that tell."""
    bins = rows[(rows["bin"] != ALL_SPEEDS) & (rows["n_record"] >= FEW)]
    if bins.empty:
        return []
    error = bins["representative_error"].to_numpy()
    several = f", median of {len(bins)} bins ({_percent(error.min())} to {_percent(error.max())})"
    words = (
        f"Representative TI, the mean of a bin plus {REPRESENTATIVE:g} standard deviations of its records (IEC "
        f"61400-1: the 90 % quantile, if they are normal), is off by {_percent(float(np.median(error)))}"
        f"{several if len(bins) > 1 else ''}, in bins with at least {FEW} records."
    )
    return [words]


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{100.0 * value:.1f} %".replace("-", "−")
