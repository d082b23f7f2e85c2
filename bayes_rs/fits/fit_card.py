"""A fit in a few lines of text, and as a card in a notebook: what was found, and what of it is the prior's."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayes_rs.errors import InputError
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.words import record_name
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.html_parts import bars, card, intervals, some
from bayes_rs.posteriors.decided import is_priors

_MOST_READ = 20_000
"""Records up to which the numbers are read to be shown: it takes half a second."""
_PRIORS = " (the prior's)"
UNREADABLE = (InputError, OSError)
"""Errors of a folder that is gone or damaged."""


def fit_rows(fit: FitData) -> dict[str, str]:
    """Return what there is to say of a fit, by name: its time and prior, and the stresses of the median record."""
    rows = {}
    known = fit.time[~np.isnat(fit.time)]
    if len(known):
        rows["from"] = f"{str(known.min())[:16]} to {str(known.max())[:16]} (UTC)"
    rows["prior"] = str(fit.run["prior_name"])
    if not fit.n_fitted:
        return rows
    if fit.n_record > _MOST_READ:
        return {**rows, "stresses": "fit.campaign() and fit.summary(records=...) tell them"}
    found = fit.of_stresses("median", "low", "high", "decided")
    middle, low, high, decided = (np.nanmedian(found[name][fit.fitted], axis=0) for name in found)
    prob = 100.0 * float(fit.settings["fit"]["prob"])
    rows["of the median record"] = f"median and {prob:g} % interval, m² s⁻²"
    for index, name in enumerate(STRESSES):
        of_prior = _PRIORS if is_priors(decided[index]) else ""
        rows[name] = f"{middle[index]:.3g}, {low[index]:.3g} to {high[index]:.3g}{of_prior}"
    return rows


def unreadable_words(fit: FitData, error: Exception) -> str:
    """Return in one line what a fit is that cannot be read any more, as where its folder is gone."""
    where = f", in {fit.place!r}" if fit.place else ""
    return f"<{type(fit).__name__} that cannot be read, scan {fit.scan.name}{where}: {' '.join(str(error).split())}>"


def unreadable_card(fit: FitData, error: Exception) -> str:
    """Return the same as HTML."""
    title = f"{type(fit).__name__} that cannot be read, scan {fit.scan.name}"
    return card(title, [*([("folder", fit.place)] if fit.place else []), ("why", str(error))])


def fit_card(fit: FitData) -> str:
    """Return the HTML of a fit, with a picture of uu record by record."""
    title = f"Fit of {fit.n_fitted} of {fit.n_record} records, scan {fit.scan.name}"
    rows = {**fit_rows(fit), **({"folder": fit.place} if fit.place else {})}
    flagged = {word: count for word, count in fit.flags.items() if count}
    if flagged:
        rows["flags"] = ", ".join(f"{word} {count}" for word, count in flagged.items())
    if not fit.n_fitted or fit.n_record > _MOST_READ:
        return card(title, rows.items())
    found = fit.of_stresses("median", "low", "high", "decided")
    middle, low, high, decided = (np.nanmedian(values[fit.fitted], axis=0) for values in found.values())
    ends = (min(float(low.min()), 0.0), max(float(high.max()), 1e-9))
    what = "median record, m² s⁻²; hatched: the prior's"
    six = bars(middle, low, high, STRESSES, what, ends, priors=is_priors(decided))
    shown = some(fit.n_record)
    names = [""] * fit.n_record
    for number in shown.tolist():
        names[number] = record_name(number, fit.time[number])
    every = "" if len(shown) == fit.n_record else f", every {_ordinal(int(shown[1]))} record"
    middle, low, high, decided = (values[:, 0] for values in found.values())
    uu = intervals(middle, low, high, is_priors(decided), names, f"uu{every}; hatched: prior's", "m² s⁻²")
    return card(title, rows.items(), six + uu)


def _ordinal(number: int) -> str:
    return {2: "second", 3: "third"}.get(number, f"{number}th")


def ranges_card(profile: pd.DataFrame, scan: str, names: list[str]) -> str:
    """Return the HTML of a fit at several ranges, from its profile, with a picture of uu range by range."""
    title = f"Fit at {len(names)} ranges, scan {scan}"
    if profile.empty:
        return card(title, [("ranges", ", ".join(names)), ("fitted", "none")])
    rows, picture = [("ranges", ", ".join(names))], ""
    for quantity in ("ti", "uu"):
        own = profile[profile["quantity"] == quantity]
        if own.empty:
            continue
        of = " or ".join(dict.fromkeys(own["of"]))
        for at, middle, low, high in zip(own["range"], own["estimate"], own["low"], own["high"], strict=True):
            rows.append((f"{quantity} at {at:g} m", f"{middle:.3g}, {low:.3g} to {high:.3g}"))
        points = [f"range {at:g} m" for at in own["range"]]
        what = f"{quantity} by range ({of}); hatched: the prior's"
        unit = "m² s⁻²" if quantity == "uu" else "1"
        middle, low, high = (own[name].to_numpy(dtype=np.float64) for name in ("estimate", "low", "high"))
        picture = intervals(middle, low, high, is_priors(own["decided"]), points, what, unit)
    return card(title, rows, picture)
