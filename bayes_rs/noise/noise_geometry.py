"""Which scan noise belongs to: its geometry, and in what another scan differs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_array
from bayes_rs.errors import InputError, NoiseMismatchError
from bayes_rs.geometry.probe import probe_difference
from bayes_rs.geometry.scan import Scan

_GEOMETRY_TOLERANCE = 2e-6
"""Two scans are the same if directions, distances (m) and times (s) differ by no more than this."""


def check_geometry(geometry: Mapping[str, Any], beam: NDArray[np.int64], where: str) -> dict[str, Any]:
    """Return the geometry in plain numbers if it is complete and belongs to these beams."""
    missing = [
        key for key in ("beam", "direction", "focus_distance", "beam_time", "scan_duration") if key not in geometry
    ]
    if missing:
        raise InputError(f"Invalid scan_geometry in {where}: {missing[0]!r} is missing; take it from Scan.geometry().")
    if list(geometry["beam"]) != beam.tolist():
        raise InputError(
            f"Invalid beam {beam.tolist()} in {where}: its scan_geometry has the beams {list(geometry['beam'])}."
        )
    return {
        "beam": beam.tolist(),
        "direction": check_array(geometry["direction"], (len(beam), 3), what=f"direction in {where}").tolist(),
        "focus_distance": check_array(
            geometry["focus_distance"], (len(beam),), what=f"focus_distance in {where}"
        ).tolist(),
        "beam_time": check_array(geometry["beam_time"], (len(beam),), what=f"beam_time in {where}").tolist(),
        "scan_duration": float(geometry["scan_duration"]),
        **({"probe": dict(geometry["probe"])} if geometry.get("probe") else {}),
    }


def geometry_difference(noise: Mapping[str, Any], scan: Mapping[str, Any]) -> str:
    """Say in words what differs first between two geometries, the noise's and a scan's; empty if nothing does."""
    if list(noise["beam"]) != list(scan["beam"]):
        return f"the beams are {_short(noise['beam'])} in the noise and {_short(scan['beam'])} in the scan"
    for key, word, unit in (
        ("direction", "direction", ""),
        ("focus_distance", "focus distance", " m"),
        ("beam_time", "time within the scan", " s"),
    ):
        have, want = np.asarray(noise[key]), np.asarray(scan[key])
        gap = np.abs(have - want).reshape(len(have), -1).max(axis=1)
        for index in np.flatnonzero(gap > _GEOMETRY_TOLERANCE):
            return (
                f"the {word} of beam {noise['beam'][index]} is {_number(have[index])}{unit} in the noise and "
                f"{_number(want[index])}{unit} in the scan"
            )
    if abs(noise["scan_duration"] - scan["scan_duration"]) > _GEOMETRY_TOLERANCE:
        return f"the scan takes {noise['scan_duration']:g} s in the noise and {scan['scan_duration']:g} s in the scan"
    return probe_difference(noise.get("probe"), scan.get("probe"))


def check_same_scan(name: str, geometry: Mapping[str, Any], scan: Scan) -> None:
    """Refuse noise whose scan has another geometry than `scan`, naming the first difference."""
    difference = geometry_difference(geometry, scan.geometry())
    if difference:
        raise NoiseMismatchError(
            f"The noise of scan {name!r} was not made for scan {scan.name!r}: {difference}. "
            "Run calibrate for this scan, or select the beams that both have.",
            difference=difference,
        )


def _short(numbers: list[int]) -> str:
    return str(list(numbers)) if len(numbers) <= 8 else f"{len(numbers)} from {numbers[0]} to {numbers[-1]}"


def _number(value: FloatArray) -> str:
    return f"{float(value):g}" if value.ndim == 0 else "(" + ", ".join(f"{item:.4f}" for item in value) + ")"
