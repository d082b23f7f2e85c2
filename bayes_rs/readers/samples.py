"""Samples of radial velocity from one file, and how those of several files become one series."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_LIMIT
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.format import FileFormat


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
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What else the report says of the file: what is not believed of it."""
    out_of_order: int | None = None
    """Samples earlier than one of the same beam above them in the file, where these are only a piece of it."""

    def select(self, index: NDArray[Any], *, with_counts: bool) -> Samples:
        """Return some of the samples, with the counts of the file or with none."""
        return replace(
            self,
            time=self.time[index],
            beam=self.beam[index],
            radial_velocity=self.radial_velocity[index],
            cnr=None if self.cnr is None else self.cnr[index],
            status=None if self.status is None else self.status[index],
            row=self.row[index],
            counts=self.counts if with_counts else dict.fromkeys(self.counts, 0),
            facts=self.facts if with_counts else {},
            out_of_order=self.out_of_order if with_counts else 0,
        )

    def where(self, index: int) -> str:
        """Say where sample `index` stands."""
        return f"{self.row_word} {self.row[index]} of file {str(self.file)!r}"


@dataclass(frozen=True)
class FilesReport:
    """What happened to the files as such: the bad ones that were skipped, and those of a folder passed over."""

    skipped: Sequence[Mapping[str, str]] = ()
    passed_over: Mapping[str, int] = field(default_factory=dict)


def no_sample(file: Path, n_row: int) -> InputError:
    """Return the error to raise for a file without a sample."""
    return InputError(
        f"File {str(file)!r} has no sample with a time and a beam ({n_row} rows were read): check the file and the "
        "option invalid."
    )


def none_read(n_file: int, reason: str) -> InputError:
    """Return the error to raise where every file was skipped."""
    return InputError(f"None of {n_file} files could be read; the first: {reason}")


def check_order(part: Samples) -> None:
    """Refuse a sample that is earlier than one of the same beam above it.

    Raises
    ------
    InputError
        If there is one.
    """
    backwards = _backwards(part)
    if backwards.any():
        index = int(np.argmax(backwards))
        before = np.flatnonzero((part.beam[:index] == part.beam[index]) & (part.time[:index] > part.time[index]))[-1]
        raise time_goes_backwards(part, index, part.time[before], f"{part.row_word} {part.row[before]}")


def time_goes_backwards(part: Samples, index: int, before: np.datetime64, where: str) -> InputError:
    """Return the error to raise for a sample earlier than one of its beam above it."""
    return InputError(
        f"Time goes backwards in {part.where(index)}: beam {part.beam[index]} at {as_utc(part.time[index])} comes "
        f"after {as_utc(before)} ({where}); check the time stamps, "
        "or give out_of_order='sort' (--out-of-order sort) to sort them."
    )


def join_samples(parts: Sequence[Samples], scan: Scan, *, report: FilesReport | None = None) -> xr.Dataset:
    """Sort the samples of all files into one series, drop repeated ones, and report what was done.

    Raises
    ------
    InputError
        If files differ in their columns, or one beam has two velocities at one time.
    """
    status_valid = _one_status(parts)
    backwards = [count_backwards(part) if part.out_of_order is None else part.out_of_order for part in parts]
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
    counted = {
        **{key: sum(part.counts.get(key, 0) for part in parts) for key in parts[0].counts},
        "samples": int(keep.sum()),
        "samples_without_velocity": int(np.isnan(velocity[keep]).sum()),
        "samples_out_of_order": sum(backwards),
        "duplicates_dropped": int(repeated.sum()),
        "duplicates_that_differ": int(differs.sum()),
        **_about_files(parts, scan, backwards, np.unique(beam), report or FilesReport()),
    }
    series = xr.Dataset(
        variables,
        coords={"time": ("sample", time[keep]), "beam": ("sample", beam[keep])},
        attrs={
            "scan": scan.name,
            "scan_key": scan.key,
            "source_files": json.dumps([part.file.name for part in parts]),
            "read_report": json.dumps(counted),
        },
    )
    own = {} if status_valid is None else {"status_valid": status_valid}
    limit = max(part.file_format.velocity_limit for part in parts)
    return series.assign_attrs(own if limit == VELOCITY_LIMIT else {**own, "velocity_limit": limit})


def _about_files(
    parts: Sequence[Samples], scan: Scan, backwards: Sequence[int], present: NDArray[np.int64], of_files: FilesReport
) -> dict[str, Any]:
    """Say in the report which beams occur, how each file was read, and which files were not."""
    return {
        "beams_present": present.tolist(),
        "beams_absent": [number for number in scan.beam.tolist() if number not in present],
        "out_of_order": parts[0].file_format.out_of_order,
        "files": [
            {
                "name": part.file.name,
                "format": part.kind,
                **part.counts,
                **part.facts,
                "samples_out_of_order": count,
                **_options_used(part.file_format),
            }
            for part, count in zip(parts, backwards, strict=True)
        ],
        "files_skipped": [dict(entry) for entry in of_files.skipped],
        "files_passed_over": dict(of_files.passed_over),
    }


def _options_used(file_format: FileFormat) -> dict[str, Any]:
    return {
        "positive": file_format.positive,
        "velocity_unit": file_format.velocity_unit,
        "time_zone": file_format.time_zone,
        "invalid": list(file_format.invalid),
        "time_stamp": file_format.time_stamp,
        "sample_duration": file_format.sample_duration,
        "options_of_format": sorted(file_format.from_format),
        "columns": dict(file_format.columns),
    }


def count_backwards(part: Samples, latest: Mapping[int, np.datetime64] | None = None) -> int:
    """Count the samples that are earlier than one of the same beam above them, in this piece or before (`latest`)."""
    backwards = _backwards(part)
    for beam, before in (latest or {}).items():
        backwards = backwards | (part.beam == beam) & (part.time < before)
    return int(backwards.sum())


def _backwards(part: Samples) -> NDArray[np.bool_]:
    """Say which samples are earlier than one of the same beam above them."""
    if (part.time[1:] >= part.time[:-1]).all():  # as a rule: grouping takes a millisecond
        return np.zeros(len(part.time), dtype=bool)
    time = pd.Series(part.time.astype(np.int64))
    latest = time.groupby(part.beam).cummax()
    return (time < latest).to_numpy()


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
        f"Two samples of beam {parts[one].beam[a]} at {as_utc(parts[one].time[a])} differ: "
        f"{parts[one].radial_velocity[a]:g} m/s in {parts[one].where(a)} and {parts[two].radial_velocity[b]:g} m/s in "
        f"{parts[two].where(b)}; give time stamps that tell samples apart, "
        "or out_of_order='sort' (--out-of-order sort) to keep the first."
    )


def as_utc(time: np.datetime64) -> str:
    """Write a time as ISO 8601 text."""
    return f"{pd.Timestamp(time).isoformat()}Z"
