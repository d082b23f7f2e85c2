"""Samples of radial velocity from one file, and how those of several files become one series."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.format import FileFormat
from bayes_rs.scan import Scan


@dataclass(frozen=True)
class Samples:
    """What one file holds: velocities in m/s and positive away, times in UTC, beams by the scan's numbers."""

    file: Path
    kind: str
    file_format: FileFormat
    time: NDArray[np.datetime64]
    beam: NDArray[np.int64]
    radial_velocity: FloatArray
    cnr: FloatArray | None
    status: FloatArray | None
    row: NDArray[np.int64]
    """Where each sample stands in its file, as a person would count."""
    row_word: str
    counts: dict[str, int] = field(default_factory=dict)

    def where(self, index: int) -> str:
        """Say where sample `index` stands."""
        return f"{self.row_word} {self.row[index]} of file {str(self.file)!r}"


def join_samples(parts: Sequence[Samples], scan: Scan) -> xr.Dataset:
    """Sort the samples of all files into one series, drop repeated ones, and report what was done.

    Raises
    ------
    InputError
        If a file has no sample, files differ in their columns, or times go backwards.
    """
    for part in parts:
        if len(part.time) == 0:
            raise InputError(
                f"File {str(part.file)!r} has no sample with a time and a beam "
                f"({part.counts.get('rows', 0)} rows were read): check the file and the option invalid."
            )
    status_valid = _one_status(parts)
    backwards = [_count_backwards(part) for part in parts]
    time = np.concatenate([part.time for part in parts])
    beam = np.concatenate([part.beam for part in parts])
    velocity = np.concatenate([part.radial_velocity for part in parts])
    optional = {name: _join_optional(parts, name) for name in ("cnr", "status")}

    order = np.lexsort((np.isnan(velocity), beam, time))  # of two equal samples, one with a velocity comes first
    time, beam, velocity = time[order], beam[order], velocity[order]
    repeated = np.zeros(len(time), dtype=bool)
    repeated[1:] = (time[1:] == time[:-1]) & (beam[1:] == beam[:-1])
    first = np.maximum.accumulate(np.where(repeated, 0, np.arange(len(time))))
    differs = repeated & ~np.isnan(velocity) & (velocity != velocity[first])
    if differs.any() and parts[0].file_format.out_of_order == "error":
        index = int(np.argmax(differs))
        raise _two_values(parts, int(order[first[index]]), int(order[index]))
    keep = ~repeated

    variables: dict[str, Any] = {
        "radial_velocity": (
            "sample",
            velocity[keep],
            {"units": "m s-1", "positive": "away", "long_name": "radial velocity, positive away from the lidar"},
        )
    }
    attributes = {"cnr": {"units": "dB"}, "status": {"long_name": "status as in the file"}}
    for name, values in optional.items():
        if values is not None:
            variables[name] = ("sample", values[order][keep], attributes[name])
    present = np.unique(beam)
    report = {
        **{key: sum(part.counts.get(key, 0) for part in parts) for key in parts[0].counts},
        "samples": int(keep.sum()),
        "samples_without_velocity": int(np.isnan(velocity[keep]).sum()),
        "samples_out_of_order": sum(backwards),
        "duplicates_dropped": int(repeated.sum()),
        "duplicates_that_differ": int(differs.sum()),
        "beams_present": present.tolist(),
        "beams_absent": [number for number in scan.beam.tolist() if number not in present],
        "out_of_order": parts[0].file_format.out_of_order,
        "files": [
            {
                "name": part.file.name,
                "format": part.kind,
                **part.counts,
                "samples_out_of_order": count,
                "positive": part.file_format.positive,
                "velocity_unit": part.file_format.velocity_unit,
                "time_zone": part.file_format.time_zone,
                "invalid": list(part.file_format.invalid),
            }
            for part, count in zip(parts, backwards, strict=True)
        ],
    }
    series = xr.Dataset(
        variables,
        coords={"time": ("sample", time[keep]), "beam": ("sample", beam[keep])},
        attrs={
            "scan": scan.name,
            "scan_key": scan.key,
            "source_files": json.dumps([part.file.name for part in parts]),
            "read_report": json.dumps(report),
        },
    )
    if status_valid is not None:
        series.attrs["status_valid"] = status_valid
    return series


def _count_backwards(part: Samples) -> int:
    """Count samples earlier than one of the same beam above them; refuse them unless they may be sorted."""
    time = pd.Series(part.time.astype(np.int64))
    latest = time.groupby(part.beam).cummax()
    backwards = (time < latest).to_numpy()
    if part.file_format.out_of_order == "error" and backwards.any():
        index = int(np.argmax(backwards))
        before = np.flatnonzero((part.beam[:index] == part.beam[index]) & (part.time[:index] > part.time[index]))[-1]
        raise InputError(
            f"Time goes backwards in {part.where(index)}: beam {part.beam[index]} at {_utc(part.time[index])} comes "
            f"after {_utc(part.time[before])} ({part.row_word} {part.row[before]}); check the time stamps, "
            "or give out_of_order='sort' (--out-of-order sort) to sort them."
        )
    return int(backwards.sum())


def _join_optional(parts: Sequence[Samples], name: str) -> FloatArray | None:
    values = [getattr(part, name) for part in parts]
    if all(value is None for value in values):
        return None
    for part, value in zip(parts, values, strict=True):
        if value is None:
            raise InputError(
                f"File {str(part.file)!r} has no {name}, but another of the files has: read them one by one, "
                "or give files with the same columns."
            )
    return np.concatenate(values)


def _one_status(parts: Sequence[Samples]) -> float | None:
    valid = {part.file_format.status_valid for part in parts}
    if len(valid) > 1:
        raise InputError(
            f"The files count different statuses as valid, {', '.join(sorted(map(str, valid)))}: "
            "give one with the option status_valid (--status-valid), or read them one by one."
        )
    return valid.pop()


def _two_values(parts: Sequence[Samples], first: int, second: int) -> InputError:
    ends = np.cumsum([len(part.time) for part in parts])
    starts = ends - [len(part.time) for part in parts]
    one, two = (int(np.searchsorted(ends, index, side="right")) for index in (first, second))
    a, b = first - int(starts[one]), second - int(starts[two])
    return InputError(
        f"Two samples of beam {parts[one].beam[a]} at {_utc(parts[one].time[a])} differ: "
        f"{parts[one].radial_velocity[a]:g} m/s in {parts[one].where(a)} and {parts[two].radial_velocity[b]:g} m/s in "
        f"{parts[two].where(b)}; give time stamps that tell samples apart, "
        "or out_of_order='sort' (--out-of-order sort) to keep the first."
    )


def _utc(time: np.datetime64) -> str:
    return f"{pd.Timestamp(time).isoformat()}Z"
