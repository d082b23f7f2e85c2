"""Samples of radial velocity from one file, and how those of several files become one series."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
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
from bayes_rs.quality.samples import distinct, is_sorted
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.unnamed_ranges import several_in_words

ROWS_AT_ONCE = 500_000
"""Rows of a table that are read at a time, if nobody says how many: they take less memory than all."""
_FEW = 3
_RARE = 0.01
"""Samples, and their share, that may be of one beam and time and differ, as after a clock was set back: sorting has to
choose there."""


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
    like_ranges: tuple[str, ...] = ()
    """Headings of the file that look like ranges and are not in use."""
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


def joined(parts: Iterable[Samples]) -> Samples:
    """Return the pieces of one file as one."""
    pieces = list(parts)
    counts = {
        name: sum(part.counts.get(name, 0) for part in pieces)
        for name in dict.fromkeys(name for part in pieces for name in part.counts)
    }

    def whole(name: str) -> Any:
        values = [getattr(part, name) for part in pieces]
        return values[0] if len(values) == 1 or values[0] is None else np.concatenate(values)

    return replace(
        pieces[0],
        **{name: whole(name) for name in ("time", "beam", "radial_velocity", "cnr", "status", "row")},
        counts=counts,
        facts={name: value for part in reversed(pieces) for name, value in part.facts.items()},
    )


def no_sample(file: Path, n_row: int, n_cut: int = 0) -> InputError:
    """Return the error to raise for a file without a sample, also where its last row is not believed."""
    if n_cut and n_cut == n_row:
        return InputError(
            f"File {str(file)!r} ends within its only row, whose last number may be cut: end the line, if it is whole."
        )
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
        If files differ in their columns, or one beam has two velocities at one time; with ``out_of_order="sort"``
        only if that is more than a rare coincidence. Of such samples none is believed: they have no velocity.
    """
    status_valid = _one_status(parts)
    backwards = [count_backwards(part) if part.out_of_order is None else part.out_of_order for part in parts]
    time = np.concatenate([part.time for part in parts])
    beam = np.concatenate([part.beam for part in parts])
    velocity = np.concatenate([part.radial_velocity for part in parts])
    optional = {name: _join_optional(parts, name) for name in ("cnr", "status")}

    chosen: slice | NDArray[np.int64] = slice(None)
    n_repeated = n_differ = 0
    if not _in_order(time, beam):
        chosen, velocity, n_repeated, n_differ = _sorted(parts, time, beam, velocity)
    time, beam, velocity = time[chosen], beam[chosen], velocity[chosen]

    variables: dict[str, Any] = {
        "radial_velocity": (
            "sample",
            velocity,
            {"units": "m s-1", "positive": "away", "long_name": "radial velocity, positive away from the lidar"},
        )
    }
    attributes = {"cnr": {"units": "dB"}, "status": {"long_name": "status as in the file"}}
    for name, values in optional.items():
        if values is not None:
            variables[name] = ("sample", values[chosen], attributes[name])
    counted = {
        **{
            key: sum(part.counts.get(key, 0) for part in parts)
            for key in dict.fromkeys(key for part in parts for key in part.counts)
        },
        "samples": len(time),
        "samples_without_velocity": int(np.count_nonzero(np.isnan(velocity))),
        "samples_out_of_order": sum(backwards),
        "duplicates_dropped": n_repeated,
        "duplicates_that_differ": n_differ,
        **_about_files(parts, scan, backwards, distinct(beam), report or FilesReport()),
    }
    series = xr.Dataset(
        variables,
        coords={"time": ("sample", time), "beam": ("sample", beam)},
        attrs={
            "scan": scan.name,
            "scan_key": scan.key,
            "source_files": json.dumps([file.name for file in dict.fromkeys(part.file for part in parts)]),
            "read_report": json.dumps(counted),
        },
    )
    own = {} if status_valid is None else {"status_valid": status_valid}
    limit = max(part.file_format.velocity_limit for part in parts)
    return series.assign_attrs(own if limit == VELOCITY_LIMIT else {**own, "velocity_limit": limit})


def _sorted(
    parts: Sequence[Samples], time: NDArray[np.datetime64], beam: NDArray[np.int64], velocity: FloatArray
) -> tuple[NDArray[np.int64], FloatArray, int, int]:
    """Return the order of time and beams without repeated samples, the velocities that are believed, and two counts.

    These are of samples that were repeated, and of those of them that differ.
    """
    order = np.lexsort((np.isnan(velocity), beam, time))  # of two equal samples, one with a velocity comes first
    in_time, of_beam, values = time[order], beam[order], velocity[order]
    repeated = np.zeros(len(time), dtype=bool)
    repeated[1:] = (in_time[1:] == in_time[:-1]) & (of_beam[1:] == of_beam[:-1])
    first = np.maximum.accumulate(np.where(repeated, 0, np.arange(len(time))))
    differs = repeated & ~np.isnan(values) & (values != values[first])
    n_differ, n_sample = int(differs.sum()), int((~repeated).sum())
    if n_differ:
        rare = n_differ <= max(_FEW, _RARE * n_sample) and 10 * n_differ <= n_sample
        if parts[0].file_format.out_of_order == "error" or not rare:
            index = int(np.argmax(differs))
            raise _two_values(parts, int(order[first[index]]), int(order[index]), n_differ)
        velocity = velocity.copy()
        velocity[order[first[differs]]] = np.nan  # which of them is right, nobody knows
    return order[~repeated], velocity, int(repeated.sum()), n_differ


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
    if latest and len(part.time) and part.time.min() < max(latest.values()):
        for beam, before in latest.items():
            backwards = backwards | (part.beam == beam) & (part.time < before)
    return int(backwards.sum())


def _backwards(part: Samples) -> NDArray[np.bool_]:
    """Say which samples are earlier than one of the same beam above them."""
    count = part.time.astype(np.int64)
    if is_sorted(count):
        return np.zeros(len(count), dtype=bool)
    time = pd.Series(count)
    latest = time.groupby(part.beam).cummax()
    return (time < latest).to_numpy()


def _in_order(time: NDArray[np.datetime64], beam: NDArray[np.int64]) -> bool:
    """Say whether samples are in the order of time, those of one time in that of their beams, and none is twice."""
    later = time[1:] > time[:-1]
    return bool(later.all()) or bool((later | ((time[1:] == time[:-1]) & (beam[1:] > beam[:-1]))).all())


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


def _two_values(parts: Sequence[Samples], first: int, second: int, n_differ: int) -> InputError:
    ends = np.cumsum([len(part.time) for part in parts])
    starts = ends - [len(part.time) for part in parts]
    one, two = (int(np.searchsorted(ends, index, side="right")) for index in (first, second))
    a, b = first - int(starts[one]), second - int(starts[two])
    if parts[one].file == parts[two].file and parts[one].kind != "long":
        advice = "give time stamps that tell samples apart"
    elif parts[one].file == parts[two].file:
        advice = several_in_words(parts[one].like_ranges)
    else:
        advice = "the files seem to be of several instruments or ranges, or one is another's correction: read one alone"
    return InputError(
        f"Two samples of beam {parts[one].beam[a]} at {as_utc(parts[one].time[a])} differ: "
        f"{parts[one].radial_velocity[a]:g} m/s in {parts[one].where(a)} and {parts[two].radial_velocity[b]:g} m/s in "
        f"{parts[two].where(b)}{f', and {n_differ - 1} more such' if n_differ > 1 else ''}; {advice}."
    )


def as_utc(time: np.datetime64) -> str:
    """Write a time as ISO 8601 text."""
    return f"{pd.Timestamp(time).isoformat()}Z"
