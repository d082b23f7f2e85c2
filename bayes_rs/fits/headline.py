"""The headline of a fit: what was found, what of it the data decided, and what is doubtful, in three lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.campaign_words import ALL, campaign_failures
from bayes_rs.fits.coherence import coherence_of
from bayes_rs.fits.columns import TABLE, VARIANCES
from bayes_rs.fits.direction_table import median_of_known
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.flags import FAILURES, FLAG_MEANINGS, FLAGS
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.records.beam_correlation import CORRELATION
from bayes_rs.records.belief import told_in_full
from bayes_rs.records.layout import mast_there

NOTHING = "nothing"
"""What is doubtful where nothing is."""
_NO_POSTERIOR = "nothing: no record has a posterior"
_COLUMNS = ("median", "low", "high", "decided")
_MOST_FLAGS = 3
"""Flags that the headline names; of more it says how many there are."""
_SPREAD = (0.05, 0.95)
"""Quantiles over the records that say how they differ."""
_TOGETHER = "all records together:"
"""How lines of the beams begin that name a beam; the others name a cause after their colon."""


@dataclass(frozen=True)
class Headline:
    """What a fit found, in three lines.

    Parameters
    ----------
    found : str
        Turbulence intensity with its interval, wind speeds, and how many records were fitted.
    decided : str
        Which stresses the beams measured, and which are mostly the prior's.
    doubtful : str
        Flags in words, with counts; or ``nothing``.
    numbers : mapping
        The same as plain numbers, by name; speeds are in m/s, stresses in m² s⁻².
    """

    found: str
    decided: str
    doubtful: str
    numbers: Mapping[str, Any]

    def __str__(self) -> str:
        """Return the three lines."""
        return "\n".join(f"{f'{name}:':<10}{words}" for name, words in self.rows())

    def rows(self) -> list[tuple[str, str]]:
        """Return the lines with what each is called."""
        return [("found", self.found), ("decided", self.decided), ("doubtful", self.doubtful)]

    def to_plain(self) -> dict[str, Any]:
        """Return lines and numbers as JSON takes them."""
        return {"headline": dict(self.rows()), **_plain(self.numbers)}


def headline_of(fit: FitData) -> Headline:
    """Return the headline of a fit at one range.

    Parameters
    ----------
    fit : FitData
        The fit.
    """
    summary = fit.of_stresses(*_COLUMNS)
    wind = _wind(fit)
    prob, kind = float(fit.settings["fit"]["prob"]), str(fit.settings["fit"]["interval"])
    doubts, doubted = _doubts(fit.run, [fit])
    numbers: dict[str, Any] = {"n_record": fit.n_record, "n_fitted": fit.n_fitted, "prob": prob, "interval": kind}
    numbers["doubtful"] = doubted
    counted = f"{fit.n_fitted} of {fit.n_record} records fitted"
    if not fit.n_fitted:
        return Headline(counted, _NO_POSTERIOR, doubts, numbers)
    intensity = _intensity(fit, summary, wind)
    numbers |= {
        "turbulence_intensity": intensity,
        "wind_speed": _wind_numbers(wind),
        "stresses": _stress_numbers(summary),
        "stresses_learnt": float(np.nanmedian(fit.of_records("stresses_learnt")["stresses_learnt"])),
    }
    shares = median_of_known(summary["decided"])
    found = f"{_intensity_words(intensity, interval_words(prob, kind), fit.n_fitted)}; {_wind_words(wind)}; {counted}"
    return Headline(found, decided_words(shares, by=measured_by(fit)) + _of_campaign(fit, shares), doubts, numbers)


def headline_of_ranges(
    run: Mapping[str, Any], fits: Mapping[int, FitData], names: Sequence[str], profile: pd.DataFrame
) -> Headline:
    """Return the headline of a fit at several ranges: of its profile.

    Parameters
    ----------
    run : mapping
        What `run.json` of the whole says.
    fits : mapping of int to FitData
        The fits by the place of their range.
    names : sequence of str
        What to call the ranges, all that there are.
    profile : DataFrame
        From `RangedFit.profile`; empty if no record was fitted.
    """
    doubts, doubted = _doubts(run, list(fits.values()))
    n_fitted, n_record = (sum(getattr(own, name) for own in fits.values()) for name in ("n_fitted", "n_record"))
    counted = f"{n_fitted} of {n_record} records fitted at {len(fits)} of {len(names)} ranges"
    if len(fits) < len(names):
        lost = f"{len(names) - len(fits)} of {len(names)} ranges without a record that can be fitted"
        doubts = lost if doubts == NOTHING else f"{lost}; {doubts}"
    numbers: dict[str, Any] = {"n_record": n_record, "n_fitted": n_fitted, "doubtful": doubted}
    if len(names) == len(fits) == 1:
        (only,) = fits.values()
        alone = headline_of(only)
        numbers = {**alone.numbers, **numbers}
        return replace(alone, found=f"{alone.found} at {names[0]}", doubtful=doubts, numbers=numbers)
    if profile.empty:
        return Headline(counted, _NO_POSTERIOR, doubts, numbers)
    prob, kind = float(profile["prob"].iloc[0]), str(profile["interval"].iloc[0])
    rows = profile[profile["quantity"] == "ti"].to_dict("records")
    wind = np.concatenate([_wind(own) for own in fits.values()])
    shares = np.array([median_of_known(own.of_stresses("decided")["decided"]) for own in fits.values()])
    numbers |= {
        "prob": prob,
        "interval": kind,
        "wind_speed": _wind_numbers(wind),
        "profile": profile.to_dict("records"),
    }
    said = [
        f"{_number(row['estimate'])} ({_pair(row)}) at {names[place]}"
        for place, row in zip(fits, rows, strict=True)
        if np.isfinite(row["estimate"])
    ]
    ends = said if len(said) < 2 else [said[0], f"to {said[-1]}"]
    found = f"TI {' '.join(ends)}, {interval_words(prob, kind)} ({rows[0]['of']})"
    return Headline(f"{found}; {_wind_words(wind)}; {counted}", _decided_at(shares), doubts, numbers)


def measured_by(fit: FitData, record: int | None = None) -> str:
    """Say whose data a fit, or one of its records, is of."""
    there = mast_there(fit.records)[fit.fitted if record is None else [record]]
    return "the beams and the mast beside" if there.any() else "the beams"


def decided_words(shares: FloatArray, *, by: str = "the beams") -> str:
    """Say which stresses the beams measured, and which are mostly the prior's.

    Parameters
    ----------
    shares : ndarray, shape (6,)
        Share that the data decided of each stress.
    by : str
        What measured.

    Returns
    -------
    words : str
        One sentence.

    Examples
    --------
    >>> decided_words(np.array([0.9, 0.2, 0.1, 0.3, 0.2, 0.0]))
    "the beams measured uu, and so TI; vv, ww, uv, uw, vw are mostly the prior's"
    """
    priors = is_priors(shares)
    measured = [name for name, prior in zip(STRESSES, priors, strict=True) if not prior]
    rest = [name for name in STRESSES if name not in measured]
    if not rest:
        return f"{by} measured all six stresses, and so TI"
    if not measured:
        return "none of the six stresses was measured: all are mostly the prior's, and so is TI"
    of_prior = f"{_listed(rest)} {'is' if len(rest) == 1 else 'are'} mostly the prior's"
    if "uu" in measured:
        return f"{by} measured {_listed(measured)}, and so TI; {of_prior}"
    return f"{by} measured {_listed(measured)}; {of_prior}, and so is TI"


def _of_campaign(fit: FitData, shares: FloatArray) -> str:
    """Say of which stresses the records together decide the mean, where one of them does not."""
    if TABLE not in fit.source.datasets:
        return ""
    table = fit.source.read(TABLE)
    means = table[table["bin"] == ALL].set_index("quantity")["decided"]
    priors = is_priors(shares)
    more = [name for name, prior in zip(STRESSES, priors, strict=True) if prior and not is_priors(means[name])]
    return f" in a record; all records together also tell the mean of {_listed(more)}" if more else ""


def _decided_at(shares: FloatArray) -> str:
    """Say the same of the ranges of a profile, shares (n_range, 6)."""
    priors = is_priors(shares)
    if (priors == priors[0]).all():
        where = " at all ranges" if len(shares) > 1 else ""
        return f"{decided_words(shares[0])}{where}"
    total, count = len(shares), (~priors).sum(axis=0)
    always = [name for name, number in zip(STRESSES, count, strict=True) if number == total]
    never = [name for name, number in zip(STRESSES, count, strict=True) if number == 0]
    some = [f"{name} at {number}" for name, number in zip(STRESSES, count, strict=True) if 0 < number < total]
    measured = [f"{_listed(always)} at all ranges"] if always else []
    parts = [f"the beams measured {', '.join([*measured, *some])} of {total}"]
    intensity = ", and so is TI" if "uu" in never else ""
    verb = "is" if len(never) == 1 else "are"
    parts += [f"{_listed(never)} {verb} mostly the prior's at all{intensity}"] if never else []
    return "; ".join(parts)


def _wind(fit: FitData) -> FloatArray:
    """Return the wind speeds of the fitted records."""
    return np.asarray(fit.records["wind_speed"].values, dtype=np.float64)[fit.fitted]


def _intensity(fit: FitData, summary: Mapping[str, FloatArray], wind: FloatArray) -> dict[str, Any]:
    """Return turbulence intensity, σ_u/U: that of the median record, how records differ, and the campaign's."""
    middle, low, high = (np.sqrt(summary[name][fit.fitted, 0]) / wind for name in ("median", "low", "high"))
    share = float(np.nanmedian(summary["decided"][fit.fitted, 0]))
    spread = np.quantile(middle, _SPREAD)
    found: dict[str, Any] = {
        "of": "record" if fit.n_record == 1 else "median record",
        "median": float(np.median(middle)),
        "low": float(np.median(low)),
        "high": float(np.median(high)),
        "records_from": float(spread[0]),
        "records_to": float(spread[1]),
        "decided": share,
    }
    if TABLE in fit.source.datasets:
        table = fit.source.read(TABLE)
        row = table[(table["bin"] == ALL) & (table["quantity"] == "ti")].iloc[0]
        found["campaign"] = {name: float(row[name]) for name in ("mean", "low", "high", "n_record")}
    return found


def _intensity_words(found: Mapping[str, Any], which: str, n_fitted: int) -> str:
    said = f"TI {_number(found['median'])} ({_pair(found)}; {which})"
    if n_fitted == 1:
        return said
    spread = f"{_number(found['records_from'])} to {_number(found['records_to'])} over the records"
    said += f" in the median record, {spread}"
    if "campaign" not in found:
        return said
    return f"{said}; mean of the campaign {_number(found['campaign']['mean'])} ({_pair(found['campaign'])})"


def _wind_numbers(wind: FloatArray) -> dict[str, Any]:
    return {"unit": "m/s", "low": float(wind.min()), "median": float(np.median(wind)), "high": float(wind.max())}


def _stress_numbers(summary: Mapping[str, FloatArray]) -> dict[str, Any]:
    columns = {name: median_of_known(summary[name]) for name in _COLUMNS}
    found: dict[str, Any] = {"unit": "m2 s-2", "of": "median record"}
    for place, name in enumerate(STRESSES):
        own = {column: float(values[place]) for column, values in columns.items()}
        found[name] = {**own, "mostly_prior": bool(is_priors(own["decided"]))}
    return found


def _doubts(run: Mapping[str, Any], fits: Sequence[FitData]) -> tuple[str, dict[str, Any]]:
    """Say what is doubtful, and return it as numbers: flags of records, data that are not believed, files not read."""
    none: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
    flags = np.concatenate([none, *(own.flag for own in fits)])
    counts = {word: int(np.count_nonzero(flags & bit)) for word, bit in FLAGS.items()}
    counts = {word: count for word, count in counts.items() if count}
    in_full = _in_full(fits)
    named = [word for word in counts if word != "spikes" or not in_full]
    ordered = sorted(named, key=lambda word: (not FLAGS[word] & FAILURES, -counts[word]))
    parts = [f"{counts[word]} of {len(flags)} records: {_meaning(word)}" for word in ordered[:1]]
    parts += [f"{counts[word]}: {_meaning(word)}" for word in ordered[1:_MOST_FLAGS]]
    if len(ordered) > _MOST_FLAGS:
        more = len(ordered) - _MOST_FLAGS
        parts.append(f"and {more} more flag{'s' * (more > 1)}")
    files, doubts = dict(run.get("bad_files", {})), [line for own in fits for line in own.run["doubts"]]
    late = int(run.get("samples_late", 0))
    parts += [f"{len(files)} file{'s' * (len(files) > 1)} could not be used"] if files else []
    parts += [f"{late} samples came too late for their record"] if late else []
    parts += in_full
    parts += ["some of the data are not believed"] if any(not told_in_full(line) for line in doubts) else []
    parts += ["the campaign's chains fell short"] if any(campaign_failures(own.run["campaign"]) for own in fits) else []
    parts += _of_all_records(fits)
    parts += _beside_variances(fits)
    together = [line for own in fits for line in own.run.get("beams", {}).get("together", [])]
    numbers = {"flags": counts, "bad_files": files, "samples_late": late, "doubts": doubts, "beams": together}
    return "; ".join(parts) or NOTHING, numbers


def _in_full(fits: Sequence[FitData]) -> list[str]:
    """Return the doubts that say what to do by themselves: of several ranges each kind once, and where it is."""
    told = [[line for line in own.run["doubts"] if told_in_full(line)] for own in fits]
    if len(fits) == 1:
        return told[0]
    kinds: dict[str, list[str]] = {}
    for lines in told:
        for line in lines:
            kinds.setdefault(told_in_full(line), []).append(line)
    return [f"at {len(lines)} of {len(fits)} ranges, as {lines[0]}" for lines in kinds.values()]


def _of_all_records(fits: Sequence[FitData]) -> list[str]:
    """Say what the beams show over all records, though no record may tell it by itself."""
    told = [lines for own in fits if (lines := own.run.get("beams", {}).get("together", []))]
    if len(fits) == 1:
        return [line if line.startswith(_TOGETHER) else line.partition(": ")[0] for lines in told for line in lines]
    return [f"{_TOGETHER} the beams are not as the model has them at {len(told)} of {len(fits)} ranges"] if told else []


def _beside_variances(fits: Sequence[FitData]) -> list[str]:
    """Say how many records lack the covariances that were asked for, and what speaks against those that there are."""
    beside = [own for own in fits if VARIANCES in own.source.datasets]
    asked = [own for own in beside if own.run["settings"]["fit"].get("information") == "covariances"]
    known = [np.isfinite(own.records[CORRELATION].values[own.fitted]).any(axis=1) for own in asked]
    n_record, n_known = sum(map(len, known)), sum(int(np.count_nonzero(one)) for one in known)
    parts = []
    if n_known < n_record:
        parts.append(f"{n_record - n_known} of {n_record} records hold no covariances, and go by their variances alone")
    unlike = [found for own in beside if (found := coherence_of(own)) is not None and found.doubted]
    if unlike:
        at = f"at {len(unlike)} of {len(fits)} ranges, here the worst: " if len(fits) > 1 else ""
        parts.append(at + max(unlike, key=lambda found: found.misfit).in_words())
    return parts


def _meaning(word: str) -> str:
    """Return what a flag means, without what follows from it."""
    return FLAG_MEANINGS[word].partition(": ")[0].replace(";", ",")


def _pair(row: Mapping[Any, Any]) -> str:
    return f"{_number(row['low'])} to {_number(row['high'])}"


def _number(value: float) -> str:
    """Write a turbulence intensity to three decimals: no record tells it better."""
    return f"{value:.3f}"


def _wind_words(wind: FloatArray) -> str:
    low, high = f"{wind.min():.1f}", f"{wind.max():.1f}"
    return f"wind {low if low == high else f'{low} to {high}'} m/s"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)


def _plain(value: Any) -> Any:
    """Return a value as JSON takes it: a number that is not known is null."""
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
