"""What the making of records found, in plain lines."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs.geometry.ranged_scan import short
from bayes_rs.readers.unnamed_ranges import listed_ranges
from bayes_rs.records.belief import cycle_words, doubt_lines
from bayes_rs.records.flags import BEAM_FLAGS
from bayes_rs.records.layout import OF_RANGES, REPORT
from bayes_rs.records.ranges import split_ranges
from bayes_rs.records.windows import LONGEST_GAP_DAYS

_MOST_FILES = 20
"""Files up to which each has a line of its own; beyond, those that were read alike share one."""
_OPTIONS_TOLD = (
    "format",
    "positive",
    "velocity_unit",
    "time_zone",
    "time_stamp",
    "options_of_format",
    "columns",
    "gates_off",
)
_BY_HEADINGS = "zx"
"""The format whose columns are found by headings that nobody publishes: the report names them."""
_ROWS_TOLD = (
    "rows",
    "rows_invalid_value",
    "velocities_impossible",
    "rows_unset_clock",
    "rows_dropped",
    "rows_of_other_ranges",
    "rows_without_range",
    "rows_bad",
    "rows_cut",
    "samples_out_of_order",
)
LEAST_TAKEN = 10
"""Samples from which on a beam's variance is taken, whatever share they are: the default of ``min_count``."""
_SURE = 1e-3
"""p-value below which dropped samples are reported as periodic."""


def describe_report(dataset: xr.Dataset) -> list[str]:
    """Say in plain lines what was read, dropped and flagged.

    Parameters
    ----------
    dataset : xarray.Dataset
        A series or records, with ``read_report`` or ``records_report`` in its attributes.

    Returns
    -------
    lines : list of str
        One fact each; empty if the dataset carries no report.

    Examples
    --------
    >>> describe_report(xr.Dataset())
    []
    """
    lines = []
    if "read_report" in dataset.attrs:
        lines += _describe_reading(json.loads(dataset.attrs["read_report"]))
    if "records_report" in dataset.attrs:
        lines += _describe_records(json.loads(dataset.attrs["records_report"]))
    if OF_RANGES in dataset.attrs:
        return [*lines, *_describe_ranges(dataset)]
    return [*lines, *doubt_lines(dataset)]


def _describe_ranges(records: xr.Dataset) -> list[str]:
    """Say for each range how much there is of it, and once what they have in common."""
    lines, doubts = [], doubt_lines(records)
    what = "height" if "height" in records.coords else "range"
    lines.append(f"{records.sizes['record']} records of {records.attrs['duration']:g} s at each of the {what}s, m:")
    for part, value in zip(split_ranges(records), short(records[what].values), strict=True):
        own = json.loads(part.attrs.get(REPORT, "null"))
        whole = (part["flag"].values == 0).all(axis=1)
        counted = f"{np.count_nonzero(whole)} with all beams"
        lost = ", ".join(f"{name} {number}" for name, number in own["dropped"].items() if number) if own else ""
        used = f"{own['samples_used']} of {own['samples']} samples used" if own else "no sample"
        lines.append(f"  {value}: {counted}; {used}{f'; dropped: {lost}' if lost else ''}")
        doubts += [f"{what} {value} m: {line}" for line in doubt_lines(part.drop_attrs().assign_attrs(_own(part)))]
    return [*lines, *doubts]


def _own(part: xr.Dataset) -> dict[str, Any]:
    """Return what is told of one range alone: what was read is told of all together."""
    return {name: value for name, value in part.attrs.items() if name != "read_report"}


def _describe_reading(report: Mapping[str, Any]) -> list[str]:
    lines = []
    for file in report["files"] if len(report["files"]) <= _MOST_FILES else _alike(report["files"]):
        line = f"{file['name']}: {file['rows']} rows ({file['format']})"
        line += f", positive {file['positive']}, {file['velocity_unit']}, {file['time_zone']}"
        if file.get("time_stamp"):
            line += f", times at the {file['time_stamp']} of a sample"
            if file["time_stamp"] != "start" and "time_stamp" in file.get("options_of_format", ()):
                length = file.get("sample_duration")
                line += "" if length else ", moved to its start if the file says how long it takes"
        if file.get("options_of_format"):
            line += f" (by the format: {', '.join(file['options_of_format'])})"
        for key, words in (
            ("rows_invalid_value", "with an invalid value"),
            ("velocities_impossible", "velocities that no wind has"),
            ("rows_unset_clock", "of a clock that was not set, set aside"),
            ("rows_dropped", "dropped without a time or a beam"),
            ("rows_of_other_ranges", "of other ranges"),
            ("rows_without_range", "dropped without a range"),
            ("rows_bad", "bad ones left out"),
            ("rows_cut", "cut at the end of the file, left out"),
            ("samples_out_of_order", "samples out of order, sorted"),
        ):
            line += f"; {file[key]} {words}" if file.get(key) else ""
        if "first_bad_row" in file:
            line += f"; the first bad row: {file['first_bad_row']}"
        if "ranges" in file:
            line += f"; ranges read: {listed_ranges(file['ranges_used'])} of {listed_ranges(file['ranges'])} m"
        if file.get("gates_off"):
            line += f"; gates up to {file['gates_off']:g} m from the ranges that they count for, those of another file"
        if file["format"] == _BY_HEADINGS:
            line += f"; columns read: {', '.join(f'{name} {own!r}' for name, own in file.get('columns', {}).items())}"
        lines.append(line)
    lines += _describe_reordered([file["name"] for file in report["files"] if file.get("range_rows_reordered")])
    skipped = report.get("files_skipped", [])
    lines += [f"skipped {file['name']}: {file['reason']}" for file in skipped[:_MOST_FILES]]
    lines += [f"skipped {len(skipped) - _MOST_FILES} more files"] if len(skipped) > _MOST_FILES else []
    passed = [
        f"{number} {kind.replace('_', ' ')}" for kind, number in report.get("files_passed_over", {}).items() if number
    ]
    lines += [f"passed over in folders: {', '.join(passed)}"] if passed else []
    absent = f"; absent: {_listed(report['beams_absent'])}" if report["beams_absent"] else ""
    lines.append(f"beams in the files: {_listed(report['beams_present'])}{absent}")
    line = f"{report['samples']} samples, {report['samples_without_velocity']} without a velocity"
    if report["duplicates_dropped"]:
        line += f"; {report['duplicates_dropped']} repeated ones dropped"
        differ = report["duplicates_that_differ"]
        line += f", {differ} of which differ: their samples count as missing" if differ else ""
    return [*lines, line]


def _describe_reordered(names: Sequence[str]) -> list[str]:
    """Say that files had the ranges of other rays beside their rays."""
    if not names:
        return []
    number, has, its = ("1 file", "has", "its") if len(names) == 1 else (f"{len(names)} files", "have", "their")
    line = (
        f"{number} (the first: {names[0]}) {has} the rows of {its} ranges in another order than {its} rays, as the "
        "heights of the gates say: the ranges are taken in the order in which they agree (gates_by)"
    )
    return [line]


def _alike(files: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Put files that were read with the same options together as one, in the order of the first of each."""
    together: dict[str, list[Mapping[str, Any]]] = {}
    for file in files:
        options = {name: file.get(name) for name in _OPTIONS_TOLD}
        options["ranges"] = [round(value) for value in file.get("ranges_used", ())]
        together.setdefault(json.dumps(options, sort_keys=True), []).append(file)
    return [
        {
            **some[0],
            "name": f"{len(some)} files, {some[0]['name']} to {some[-1]['name']}" if some[1:] else some[0]["name"],
            **{name: sum(file.get(name, 0) for file in some) for name in _ROWS_TOLD},
        }
        for some in together.values()
    ]


def _describe_records(report: Mapping[str, Any]) -> list[str]:
    dropped = ", ".join(f"{name} {number}" for name, number in report["dropped"].items())
    lines = [f"{report['records']} records of {report['duration']:g} s"]
    lines[0] += f"; {report['samples_used']} of {report['samples']} samples used"
    lines[0] += f"; dropped: duplicates {report['duplicates_dropped']}, {dropped}"
    if "by_beam" in report:
        lines += _describe_filters(report["dropped"], report["by_beam"])
    for found in report.get("blades", []):
        if found["p_value"] is not None and found["p_value"] < _SURE:
            lines.append(
                f"beam {found['beam']}: its {found['events']} blocked or slow samples come at {found['frequency']:.3g} "
                f"Hz or an alias of it, as blades do (p = {found['p_value']:.1g})"
            )
    if report["records_without_samples"]:
        lines.append(f"gaps: {report['records_without_samples']} records hold no sample of any beam")
    for last, first in report.get("long_gaps", []):
        lines.append(
            f"gap: no records between those of {last} and {first}, because no sample came for more than "
            f"{LONGEST_GAP_DAYS} days"
        )
    if report["beams_never_usable"]:
        lines.append(f"beams without a usable sample in any record: {_listed(report['beams_never_usable'])}")
    if report.get("beams_rarely_usable"):
        lines.append(f"beams flagged in more than half of the records: {_listed(report['beams_rarely_usable'])}")
    if report.get("records_with_wind_from_behind"):
        lines.append(
            f"wind from behind the lidar (more than 90° from its axis): {report['records_with_wind_from_behind']} of "
            f"{report['records']} records"
        )
    meaning = {"too_few_samples": f" (fewer than {np.ceil(report['samples_needed']):g})"}
    for kind, what in (("beam_flags", "beams of records"), ("record_flags", "records")):
        for name, counted in report[kind].items():
            if counted["count"]:
                beam = f", beam {counted['first_beam']}" if "first_beam" in counted else ""
                lines.append(
                    f"flag {name}{meaning.get(name, '')}: {counted['count']} of {counted['of']} {what}, "
                    f"first {counted['first_time']}{beam}"
                )
    return lines + _describe_few(report)


def _describe_few(report: Mapping[str, Any]) -> list[str]:
    """Say which share of the samples beams with too few have, and which option would count them."""
    few, expected = report.get("few_samples", {}), report["samples_expected"]
    if not {"least", "usual", "most"} <= few.keys() or expected <= 0.0 or few["most"] >= expected:
        return []
    shares = [f"{100.0 * few[name] / expected:.0f}" for name in ("least", "most")]
    span = f"{few['least']:g} to {few['most']:g}" if few["least"] < few["most"] else f"{few['most']:g}"
    line = (
        f"beams with too few samples have {span} of {expected:.3g} ({' to '.join(dict.fromkeys(shares))} %), half of "
        f"them {few['usual']:g} or more"
    )
    if report.get("cycle"):
        return [line]  # the doubt says why
    least = report.get("min_count") or LEAST_TAKEN
    share = np.floor(20.0 * few["usual"] / expected) / 20.0
    if few["usual"] < least:
        return [f"{line}: fewer than min_count={least}, whatever was expected"]
    if share <= 0.0:
        return [line]
    line += f": min_availability={share:g} (--min-availability {share:g}) takes these, with wider intervals; "
    return [line + "where time is shared between scans, their variances are a little too small (docs/quality.md)"]


def why_no_beam(parts: Sequence[xr.Dataset]) -> str:
    """Say which flags the beams of records have where every one of every record has one; empty otherwise.

    Parameters
    ----------
    parts : sequence of Dataset
        The records, of one range each.

    Returns
    -------
    words : str
        The flags with their counts, and the option by whose rule there are too few samples, if there are.
    """
    flags = [part["flag"].values if "flag" in part else np.zeros(1, dtype=np.uint8) for part in parts]
    flag = np.concatenate([own.ravel() for own in flags])
    if not flag.size or not flag.all():
        return ""
    counts = {name: int(np.count_nonzero(flag & bit)) for name, bit in BEAM_FLAGS.items()}
    said = ", ".join(f"{name} {count} of {flag.size}" for name, count in counts.items() if count)
    return f"every beam of every record has a flag ({said}){_what_takes_more(parts, flags)}"


def _what_takes_more(parts: Sequence[xr.Dataset], flags: Sequence[NDArray[np.uint8]]) -> str:
    """Say which option would take the beams of records with too few samples; empty if there are none."""
    few = [(own & BEAM_FLAGS["too_few_samples"]) > 0 for own in flags]
    if not any(own.any() for own in few):
        return ""
    share = "a lower min_availability (--min-availability)"
    report = json.loads(parts[0].attrs.get("records_report", "{}"))
    if report.get("cycle"):
        return f"; {cycle_words(report['cycle'])}"
    counts = [part["count"].values[own] for part, own in zip(parts, few, strict=True) if "count" in part]
    least, most = report.get("min_count"), max((int(own.max()) for own in counts if own.size), default=None)
    if least is None or most is None:
        return f"; {share}, or a lower min_count, takes fewer samples"
    if most >= least:
        return f"; {share} takes fewer samples"
    both = f", and {share}," if report["samples_needed"] > least else ""
    return (
        f"; the most samples of one are {most}, and min_count={least} asks for more: a longer duration (--duration) "
        f"has more of them; a lower min_count (records.min_count of a settings file, or in Python){both} takes fewer"
    )


def _describe_filters(dropped: Mapping[str, int], by_beam: Mapping[str, list[int]]) -> list[str]:
    """Say for each filter that dropped something which share it was, and which beam lost most by it."""
    lines = []
    total = sum(by_beam["samples"])
    for name, number in dropped.items():
        if number and name in by_beam:
            share = [lost / came if came else 0.0 for lost, came in zip(by_beam[name], by_beam["samples"], strict=True)]
            worst = max(range(len(share)), key=share.__getitem__)
            lines.append(
                f"dropped by {name}: {number} samples ({_percent(number, total)} %); most of beam "
                f"{by_beam['beam'][worst]}, {by_beam[name][worst]} of {by_beam['samples'][worst]}"
            )
    return lines


def _percent(part: int, whole: int) -> str:
    """Return a share in %, to two digits and never as a power of ten: 0.0047, 9.7, 100."""
    share = 100.0 * part / whole
    return f"{share:.0f}" if share >= 10.0 else f"{share:.2g}" if share >= 1e-4 else "below 0.0001"


def _listed(numbers: list[int]) -> str:
    return ", ".join(str(number) for number in numbers) if len(numbers) <= 12 else f"{len(numbers)} beams"
