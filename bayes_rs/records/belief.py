"""What of records is not believed: variances, winds, angles, stresses that no atmosphere has; how that is said."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.file_options import VELOCITY_LIMIT
from bayes_rs.quality.belief import MOST_ANGLE, BoolArray, Impossible, add_told, most_frequent
from bayes_rs.quality.filtering import Filtered
from bayes_rs.quality.samples import BeamSamples
from bayes_rs.quality.spikes import DESPIKE, SPIKES, samples_words
from bayes_rs.records.flags import BEAM_FLAGS, flag_attributes
from bayes_rs.records.layout import MAST

NOT_BELIEVED = "not_believed"
"""Attribute of records: in JSON, what `believed` counted as missing."""

_CYCLE = "samples of a beam come every"
_IN_FULL = (SPIKES, _CYCLE)
"""What tells the doubts of data that are used: a headline says them in full."""

_ANGLES = ("yaw", "tilt", "roll", "yaw_sd")
_WORDS = {
    "variance": "variances",
    "mean": "mean radial velocities",
    "wind_speed": "wind speeds",
    "yaw": "wind directions",
    MAST: "mast's stresses",
}
_UNITS = {"variance": "m² s⁻²", MAST: "m² s⁻²", **dict.fromkeys(_ANGLES, "degrees")}


def most_variance(velocity_limit: float) -> float:
    """Return the variance that no atmosphere has, m² s⁻²: the square of a third of the speed that no wind has."""
    return (velocity_limit / 3.0) ** 2


def impossible_in(samples: BeamSamples, filtered: Filtered) -> dict[str, Any]:
    """Return for the report which velocities the filter dropped; nothing if none.

    Raises
    ------
    InputError
        If most of the velocities are impossible, and do not stand for missing entries.
    """
    dropped = filtered.dropped_by("impossible")
    if not dropped.any():
        return {}
    found = Impossible()
    found.add(samples.velocity[dropped], int(np.count_nonzero(np.isfinite(samples.velocity) & ~dropped)))
    found.check("Invalid series: it holds radial velocities", samples.velocity_limit, hint=False)
    return {"impossible_values": found.told(), "velocity_limit": samples.velocity_limit}


def believed(records: xr.Dataset) -> xr.Dataset:
    """Return records without what no atmosphere has: such variances are flagged, all else is missing.

    Parameters
    ----------
    records : Dataset
        Records, also a user's own.

    Returns
    -------
    records : Dataset
        The same object if all can be believed. Otherwise a copy with the flag ``impossible`` of beams, NaN for winds,
        angles and a mast's stresses, and what was counted in ``attrs["not_believed"]``.

    Raises
    ------
    InputError
        If most of the variances, winds or stresses are impossible, and do not stand for missing entries.

    Notes
    -----
    Limits: a wind speed or mean above ``attrs["velocity_limit"]``, 90 m/s if the records have none; a variance, or a
    mast's stress, above the square of a third of it, 900 m² s⁻²; an angle above 720 degrees. What a flag leaves out is
    not looked at.
    """
    limit = float(records.attrs.get("velocity_limit", VELOCITY_LIMIT))
    limits = {
        "variance": most_variance(limit),
        "mean": limit,
        "wind_speed": limit,
        **dict.fromkeys(_ANGLES, MOST_ANGLE),
        MAST: most_variance(limit),
    }
    changed, told = records, {}
    for name, most in limits.items():
        if name not in records or records[name].dtype.kind not in "iuf":
            continue
        values = np.asarray(records[name].values, dtype=np.float64)
        used = ~np.isnan(values)
        if "flag" in records and records["flag"].dims == records[name].dims:
            used &= np.asarray(records["flag"].values == 0)
        bad = used & (np.abs(values) > most)
        if not bad.any():
            continue
        found = Impossible()
        found.add(values[bad], int(np.count_nonzero(used & ~bad)))
        unit = _UNITS.get(name, "m/s")
        found.check(f"The records hold {_WORDS.get(name, name)}", most, unit=unit, hint=False)
        told[name] = {"count": found.count, "of": int(np.count_nonzero(used)), "limit": most, "values": found.told()}
        changed = _without(changed, name, values, bad)
    known = json.loads(records.attrs.get(NOT_BELIEVED, "{}"))  # of what is looked at again, as with a mast added
    return changed.assign_attrs({NOT_BELIEVED: json.dumps({**known, **told})}) if told else records


def _without(records: xr.Dataset, name: str, values: FloatArray, bad: BoolArray) -> xr.Dataset:
    """Return records whose bad entries are missing, or whose beams with such are flagged."""
    if name not in ("variance", "mean") or "flag" not in records:
        return records.assign({name: (records[name].dims, np.where(bad, np.nan, values), records[name].attrs)})
    flag = records["flag"].values.copy()
    flag[bad] |= BEAM_FLAGS["impossible"]
    return records.assign(flag=(records["flag"].dims, flag, flag_attributes(BEAM_FLAGS)))


def add_not_believed(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Add up what several records say in ``attrs["not_believed"]``."""
    total: dict[str, Any] = {}
    for part in parts:
        for name, of in part.items():
            known = total.get(name, {"count": 0, "of": 0, "values": {}})
            added = {key: known[key] + of[key] for key in ("count", "of")}
            total[name] = {**of, **added, "values": add_told(known["values"], of["values"])}
    return total


def doubt_lines(dataset: xr.Dataset) -> list[str]:
    """Say what of a series or of records is not believed, and which option says what it stands for.

    Parameters
    ----------
    dataset : xarray.Dataset
        A series or records.

    Returns
    -------
    lines : list of str
        One doubt each; empty if all is believed.
    """
    attributes = dataset.attrs
    lines = []
    if "read_report" in attributes:
        lines += _of_reading(json.loads(attributes["read_report"]))
    if "records_report" in attributes:
        lines += _of_making(json.loads(attributes["records_report"]))
    for name, of in json.loads(attributes.get(NOT_BELIEVED, "{}")).items():
        value, times = most_frequent(of["values"])
        lines.append(
            f"{of['count']} of {of['of']} {_WORDS.get(name, name)} of the records are beyond {of['limit']:g} "
            f"{_UNITS.get(name, 'm/s')}, which no atmosphere has, and are not used; the most frequent is {value} "
            f"({_times(times)}): if it marks a missing entry, write NaN there"
        )
    return lines


def told_in_full(line: str) -> str:
    """Return what tells a doubt that a headline says in full: of data that are used; empty for others."""
    return next((words for words in _IN_FULL if words in line), "")


def _of_reading(report: Mapping[str, Any]) -> list[str]:
    lines = []

    def named(files: Sequence[Mapping[str, Any]]) -> str:
        return f"file {files[0]['name']}" if len(files) == 1 else f"{len(files)} files (the first: {files[0]['name']})"

    files = [file for file in report["files"] if file.get("velocities_impossible")]
    if files:
        values: dict[str, int] = {}
        for file in files:
            for value, number in file.get("impossible_values", {}).items():
                values[value] = values.get(value, 0) + number
        value, times = most_frequent(values)
        limit = max(float(file.get("velocity_limit", VELOCITY_LIMIT)) for file in files)
        lines.append(
            f"{sum(file['velocities_impossible'] for file in files)} radial velocities in {named(files)} are beyond "
            f"{limit:g} m/s, which no wind is, and count as missing; the most frequent is {value} ({_times(times)}): "
            f"if it marks a missing entry, say so with invalid={value} (--invalid {value})"
        )
    files = [file for file in report["files"] if file.get("rows_unset_clock")]
    if files:
        n_row = sum(file["rows_unset_clock"] for file in files)
        lines.append(
            f"{n_row} rows of {named(files)} have the time of a clock that was not set, and are set aside: the first "
            f"is {files[0].get('first_unset_clock', '')}"
        )
    return lines


def _of_making(report: Mapping[str, Any]) -> list[str]:
    lines = []
    count = report["dropped"].get("impossible", 0)
    if count:
        value, times = most_frequent(report["impossible_values"])
        lines.append(
            f"{count} of {report['samples']} samples are beyond {report['velocity_limit']:g} m/s, which no wind is, "
            f"and count as missing; the most frequent is {value} ({_times(times)}): if it marks a missing entry, write "
            "NaN there"
        )
    variances = report["beam_flags"].get("impossible", {"count": 0})
    if variances["count"]:
        lines.append(
            f"{variances['count']} of {variances['of']} variances are larger than any atmosphere's, and are not used; "
            f"the first is that of {variances['first_time']}, beam {variances['first_beam']}"
        )
    if report.get("cycle"):
        lines.append(cycle_words(report["cycle"]))
    if report.get("spikes"):
        lines.append(_of_spikes(report))
    unset = report.get("records_of_unset_clock", {"count": 0})
    if unset["count"]:
        lines.append(
            f"{unset['count']} of {report['records']} records are of a clock that was not set, the first of "
            f"{unset['first_time']}: leave out the files that they come from, or correct their times"
        )
    return lines


def cycle_words(found: Mapping[str, Any]) -> str:
    """Say that samples come at another cycle than the scan's, and what to do."""
    some = "" if found["records"] == found["of"] else f" in {found['records']} of {found['of']} records"
    return (
        f"{_CYCLE} {found['interval']:.3g} s{some}, and the scan says {found['scan_duration']:.3g} s: correct the scan "
        "(scan_duration under timing in its file, and the time of beams that are listed): noise and bias go with it"
    )


def _of_spikes(report: Mapping[str, Any]) -> str:
    """Say how many samples look like spikes, what they do, and what leaves them out."""
    found = report["spikes"]
    line = f"{samples_words(found['samples'], found['of'])} {SPIKES} and raise the variances by "
    line += f"{_percent(found['raised'])} %"
    if found["worst_of"] < found["of"]:
        line += f" (those of beam {found['worst_beam']} by {_percent(found['worst_raised'])} %)"
    if (report.get("quality") or {}).get("despike") is None:
        return f"{line}: {DESPIKE}"
    return f"{line}: a lower despike_threshold leaves more of them out"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f}" if share >= 0.01 else f"{100.0 * share:.1f}"


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"
