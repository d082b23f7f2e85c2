"""What was read of many files, added up from the reports of the pieces that they were read in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.belief import add_told


def add_report(total: Mapping[str, Any], report: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Add the report of a piece (``attrs["read_report"]``) to that of the pieces before it.

    Parameters
    ----------
    total : dict
        Of the pieces before; empty at first.
    report : dict
        Of the piece.
    names : dict of str to str
        What tells a file from all others, by its name in the report.

    Returns
    -------
    total : dict
        ``counts`` of samples and rows, ``beams`` that occur, ``files`` by what tells them apart, and ``out_of_order``,
        how samples were taken that are.
    """
    counts, files = dict(total.get("counts", {})), dict(total.get("files", {}))
    counted = [name for name, value in report.items() if isinstance(value, int)]
    for name in counted:
        counts[name] = counts.get(name, 0) + report[name]
    for entry in report["files"]:
        key = names.get(entry["name"], entry["name"])
        known = files.get(key, {})
        added = {name: known.get(name, 0) + entry[name] for name in counted if name in entry}
        files[key] = {**known, **entry, **added, **_facts(known, entry)}
    beams = sorted({*total.get("beams", ()), *report["beams_present"]})
    return {"counts": counts, "beams": beams, "files": files, "out_of_order": report["out_of_order"]}


def _facts(known: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    """Put together what two pieces of a file say of what is not believed in it."""
    facts: dict[str, Any] = {}
    if "impossible_values" in known or "impossible_values" in entry:
        facts["impossible_values"] = add_told(known.get("impossible_values", {}), entry.get("impossible_values", {}))
    for first in ("first_unset_clock", "first_bad_row"):
        if first in known:
            facts[first] = known[first]
    return facts


def whole_report(
    total: Mapping[str, Any],
    scan: Scan,
    *,
    order: Sequence[str],
    skipped: Sequence[Mapping[str, str]],
    passed_over: Mapping[str, int],
) -> dict[str, Any]:
    """Return the report as `read` gives it of all files together.

    Parameters
    ----------
    total : dict
        From `add_report`.
    scan : Scan
        The scan they were measured with.
    order : sequence of str
        What tells the files apart, in the order in which they were named.
    skipped : sequence of dict
        ``name`` and ``reason`` of those that could not be used.
    passed_over : dict
        From `find_files`.
    """
    return {
        **total["counts"],
        "beams_present": total["beams"],
        "beams_absent": [number for number in scan.beam.tolist() if number not in total["beams"]],
        "out_of_order": total["out_of_order"],
        "files": [total["files"][key] for key in order if key in total["files"]],
        "files_skipped": [dict(entry) for entry in skipped],
        "files_passed_over": dict(passed_over),
    }
