"""The page of a fit at several ranges: the profile of all records or of one, what each range says, and their pages."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import PRIORS, is_priors
from bayes_rs.records.report import describe_report
from bayes_rs.report.figures import bits, in_ms
from bayes_rs.report.packing import pack, pack_rows, pack_steps, plain
from bayes_rs.report.page import headline
from bayes_rs.report.tables import STAR, UNIT, figure, flat, folded, interval, key, lines, number, pairs, table
from bayes_rs.report.template import RANGES_SCRIPTS, framed
from bayes_rs.report.words import stamp

MOST_PROFILES = 30_000
"""Records times ranges whose profiles go with the page, about 2 MB; of more, evenly spaced records do."""
_QUANTITIES = ("ti", *STRESSES)
_ENDS = ("median", "low", "high")
_LEAD = (
    "Bayesian estimate of the six Reynolds stresses from the variances of a Doppler lidar's beams, each range by "
    "itself: with its own noise, length scale and campaign."
)


def render_ranges(found: RangedFit, links: Mapping[int, str], *, title: str | None = None) -> str:
    """Return the whole page.

    Parameters
    ----------
    found : RangedFit
        The fit.
    links : mapping of int to str
        Addresses of the pages of the ranges, by their places, relative to this page.
    title : str, optional
        Heading; by default the scan.

    Returns
    -------
    html : str
        The page, with its style, its script and its data.
    """
    scan = str(found.run["scan"])
    names, rows = found.range_names, found.profile()
    first = next(iter(found.fits.values()))
    records = profiles_data(found)
    picker = _picker(records)
    if records is not None:
        del records["names"]  # the options hold them
    sections = [
        ("profile", "Profile", _profile_section(rows, picker)),
        ("ranges", "Each range", _ranges(found, names, links)),
        ("doubts", "Flags and doubts", lines([*found.failures, *found.remarks]) if _doubts(found) else ""),
        ("read", "What was read", lines(describe_report(found.records))),
        ("provenance", "How it was made", folded("Settings", pairs(flat(dict(found.run["settings"])), "settings"))),
    ]
    fitted = f"{found.n_fitted} of {found.n_record} records at {len(found.fits)} of {len(found.ranges)} ranges"
    said = headline(found.headline())
    numbers = pairs([("fitted", fitted), ("scan", scan), ("prior", str(first.run["prior_name"]))], "key-numbers")
    lead = f'<p class="lead">{escape(_LEAD)} The scan {escape(str(first.run["sight"]))}.</p>'
    data = {
        "prob": float(rows["prob"].iloc[0]),
        "interval": str(rows["interval"].iloc[0]),
        "duration": 1e3 * float(first.records.attrs.get("duration", 600.0)),
        "profile": {**_together(rows), "records": records},
    }
    shown = title or f"Reynolds stresses at {len(found.ranges)} ranges, scan {scan}"
    return framed(shown, said + numbers + lead, sections, data, RANGES_SCRIPTS)


def profiles_data(found: RangedFit) -> dict[str, Any] | None:
    """Return the profiles of the records for the script; None if no record was fitted at any range.

    Records of different ranges are matched by their starts, or by their numbers where these are not known.
    """
    fits = list(found.fits.values())
    timed = not any(np.isnat(own.time).any() for own in fits)
    keys = [_keys(own, timed=timed) for own in fits]
    every = np.unique(np.concatenate(keys))
    most = max(MOST_PROFILES // len(fits), 1)
    some = every[np.unique(np.linspace(0, len(every) - 1, min(len(every), most)).round().astype(np.int64))]
    values = np.full((len(some), len(_QUANTITIES), len(fits), len(_ENDS)), np.nan)
    priors = np.ones((len(some), len(fits), len(_QUANTITIES)), dtype=np.bool_)
    for place, (own, key_of) in enumerate(zip(fits, keys, strict=True)):
        there, row = np.isin(some, key_of), np.searchsorted(key_of, some[np.isin(some, key_of)])
        values[there, :, place], priors[there, place] = _numbers_of(own, row)
    kept = np.isfinite(values[..., 0]).any(axis=(1, 2))
    if not kept.any():
        return None
    some, values = some[kept], values[kept]
    time = in_ms(some.astype("datetime64[ns]")) if timed else np.full(len(some), np.nan)
    numbers = np.flatnonzero(np.isin(every, some)) if timed else some
    return {
        "n": len(every),
        "names": [_name(at, one) for at, one in zip(time.tolist(), numbers.tolist(), strict=True)],
        "number": pack_steps(numbers),
        "time": pack_steps(time),
        "rows": pack_rows(values),
        "priors": pack(np.stack([bits(one) for one in np.moveaxis(priors[kept], 1, 0)], axis=1), "u1"),
    }


def _keys(fit: Fit, *, timed: bool) -> NDArray[np.int64]:
    """Return what the records are known by at all ranges, in order: ns since 1970, or their numbers."""
    return fit.time.astype("datetime64[ns]").astype(np.int64) if timed else np.arange(fit.n_record)


def _numbers_of(fit: Fit, rows: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return medians and ends (n, 7, 3) of some records, and whether they are the prior's (n, 7)."""
    found = fit.of_stresses(*_ENDS, "decided")
    speed = np.asarray(fit.records["wind_speed"].values, dtype=np.float64)[rows]
    values = np.stack([found[name][rows] for name in _ENDS], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):  # records that were not fitted
        ti = np.sqrt(values[:, :1]) / np.where(speed > 0.0, speed, np.nan)[:, None, None]
    priors = is_priors(found["decided"][rows])
    return np.concatenate([ti, values], axis=1), np.concatenate([priors[:, :1], priors], axis=1)


def _together(rows: pd.DataFrame) -> dict[str, Any]:
    """Return the profile of all records for the script."""
    upright = "height" in rows
    parts = [rows[rows["quantity"] == name] for name in _QUANTITIES]
    return {
        "upright": upright,
        "place": plain(parts[0]["height" if upright else "range"].to_numpy(dtype=np.float64), 6),
        "quantities": list(_QUANTITIES),
        "of": " or ".join(dict.fromkeys(rows["of"])),
        "all": [
            {
                **{name: plain(part[name].to_numpy(dtype=np.float64)) for name in ("estimate", "low", "high")},
                "priors": is_priors(part["decided"]).astype(np.int64).tolist(),
            }
            for part in parts
        ],
    }


def _doubts(found: RangedFit) -> bool:
    return bool(found.failures or found.remarks)


def _profile_section(rows: pd.DataFrame, picker: str) -> str:
    called = interval_words(float(rows["prob"].iloc[0]), str(rows["interval"].iloc[0]))
    caption = key("point", f"estimate, {called}") + key("point priors", f"hollow grey: {PRIORS}")
    return picker + figure("profile", caption, f'<div id="profile-table">{_table(rows)}</div>')


def _picker(records: dict[str, Any] | None) -> str:
    """Return the choice of a record; the script's order is that of the options."""
    if records is None:
        return ""
    names = records["names"]
    options = "".join(f'<option value="{place}">{escape(name)}</option>' for place, name in enumerate(names))
    few = len(names) < records["n"]
    more = f'<p class="note">{len(names)} of {records["n"]} records can be chosen here.</p>' if few else ""
    return (
        '<div class="picker" role="group" aria-label="Choose a record"><button type="button" id="previous">Previous'
        f'</button><label for="pick">Records (UTC)</label><select id="pick"><option value="-1" selected>all records'
        f'</option>{options}</select><button type="button" id="next">Next</button></div>{more}'
    )


def _name(at: float, number_of: int) -> str:
    """Name a record by its start, ms since 1970, or by its number."""
    return stamp(np.datetime64(round(at * 1e6), "ns")) if np.isfinite(at) else f"record {number_of}"


def _table(rows: pd.DataFrame) -> str:
    what = "height" if "height" in rows else "range"
    quantities = list(dict.fromkeys(rows["quantity"]))
    header = [f"{what}, m", *("TI" if name == "ti" else name for name in quantities)]
    cells = []
    for value, own in rows.groupby(what, sort=True):
        by_name = {row["quantity"]: row for row in own.to_dict("records")}
        cells.append(
            [
                number(float(str(value))),
                *(
                    interval(row["estimate"], row["low"], row["high"], priors=bool(is_priors(row["decided"])))
                    for row in (by_name[name] for name in quantities)
                ),
            ]
        )
    called = interval_words(float(rows["prob"].iloc[0]), str(rows["interval"].iloc[0]))
    of = " or ".join(dict.fromkeys(rows["of"]))
    return table(f"Turbulence intensity and stresses, {UNIT}, each with its {called} ({of}); {STAR}", header, cells)


def _ranges(found: RangedFit, names: list[str], links: Mapping[int, str]) -> str:
    items = []
    for place, name in enumerate(names):
        own = found.fits.get(place)
        if own is None:
            items.append(f"<li>{escape(name)}: no record can be fitted</li>")
            continue
        told = (own.run.get("length_scale") or {}).get("words", "")
        words = escape(f"{own.n_fitted} of {own.n_record} records{f'; {told}' if told else ''}")
        address = escape(links.get(place, ""))
        link = f'<a href="{address}" data-page="{address}">{escape(name)}</a>' if address else escape(name)
        items.append(f"<li>{link}: {words}</li>")
    return f"<ul>{''.join(items)}</ul>"
