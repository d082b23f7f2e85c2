"""What the page says in words."""

from __future__ import annotations

import numpy as np

from bayes_rs.fits.direction_table import direction_name, direction_words
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.records.layout import TURBINE
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import NO_VALUE, number

DIAGNOSTIC_WORDS = {
    "ess_bulk": "bulk ESS, least of the six",
    "ess_tail": "tail ESS, least of the six",
    "r_hat": "R-hat, largest of the six",
    "pareto_k": "Pareto k",
    "misfit": "misfit, standard deviations",
}


def when(found: ReportData, index: int) -> str:
    """Name a record by its turbine, if the records say theirs, and its start, or its number where it has none."""
    start = found.time[index]
    name = f"record {found.record[index]}" if np.isnat(start) else stamp(start)
    return f"{found.records[TURBINE].values[index]}, {name}" if TURBINE in found.records else name


def stamp(time: np.datetime64) -> str:
    """Write a time to the minute, or to the second where it is not on one."""
    text = np.datetime_as_string(time, unit="s").replace("T", " ")
    return text.removesuffix(":00")


def period(found: ReportData) -> str:
    """Say from when to when the records start; empty if they have no times."""
    known = found.time[~np.isnat(found.time)]
    if not len(known):
        return ""
    first, last = known.min(), known.max()
    return f"{stamp(first)} UTC" if first == last else f"{stamp(first)} to {stamp(last)} UTC"


def median_words(found: ReportData) -> str:
    """Return the medians over the records of each stress's posterior median, in one line."""
    middle = np.median(found.numbers["median"][found.fitted], axis=0)
    return ", ".join(f"{name} {number(value)}" for name, value in zip(STRESSES, middle, strict=True))


def decided_words(found: ReportData) -> list[str]:
    """Say what the beams see, what the prior was, how much was learnt, and who decided each stress."""
    lines = []
    if found.sight:
        lines.append(f"The scan {found.sight}.")
    if found.prior:
        lines.append(f"Prior: {found.prior}.")
    learnt = np.nanmedian(found.per_record["stresses_learnt"][found.fitted])
    lines.append(f"Stresses learnt from the data, of six: {learnt:.1f} in the median record.")
    middle = np.nanmedian(found.numbers["decided"][found.fitted], axis=0)
    data = [name for name, value in zip(STRESSES, middle, strict=True) if not is_priors(value)]
    prior = [name for name in STRESSES if name not in data]
    if data:
        lines.append(f"In the median record the data decided more than half of: {', '.join(data)}.")
    if prior:
        lines.append(f"In the median record the prior decided more than half of: {', '.join(prior)}.")
    return lines + _direction_words(found)


def hundredths(middle: float, low: float, high: float) -> str:
    """Write a share with its interval, to a hundredth."""
    texts = [f"{value:z.2f}".replace("-", "−") for value in (middle, low, high)]
    return f"{texts[0]} ({texts[1]} to {texts[2]})"


def beside_rows(found: ReportData) -> list[tuple[str, ...]]:
    """Return a row for each stress: what decided it, posterior and least squares, medians over the fitted records."""
    rows: list[tuple[str, ...]] = []
    for index, name in enumerate(STRESSES):
        low, middle, high = np.nanquantile(found.numbers["decided"][found.fitted, index], [0.05, 0.5, 0.95]).tolist()
        posterior = np.median(found.numbers["median"][found.fitted, index])
        plain, error = (found.numbers[key][found.fitted, index] for key in ("least_squares", "least_squares_se"))
        known = np.isfinite(plain)
        rows.append(
            (
                name,
                hundredths(middle, low, high),
                number(posterior),
                number(np.median(plain[known])) if known.any() else NO_VALUE,
                number(np.nanmedian(error)) if np.isfinite(error).any() else NO_VALUE,
                f"{np.count_nonzero(known)}",
            )
        )
    return rows


def direction_rows(found: ReportData) -> list[tuple[str, ...]]:
    """Return a row for each direction of R, median record: words, weight, seen or not, and contraction of shape."""
    return [
        (
            direction_words(row[list(STRESSES)].to_numpy(dtype=np.float64)),
            number(row["weight"]),
            "yes" if row["weight"] > 0.0 else "no",
            number(row["contraction_shape"], 2),
        )
        for _, row in found.directions.iterrows()
    ]


def _direction_words(found: ReportData) -> list[str]:
    names = [direction_name(row) for row in found.directions[list(STRESSES)].to_numpy(dtype=np.float64)]
    unseen = [name for name, seen in zip(names, found.directions["weight"] > 0.0, strict=True) if not seen]
    if not unseen:
        return [f"Of the six directions of R the beams see all, {names[-1]} least."]
    said = f"Of the six directions of R no beam sees {len(unseen)}: {'; '.join(unseen)}."
    return [f"{said} What the page says of them is the prior's, and what follows from the others."]
