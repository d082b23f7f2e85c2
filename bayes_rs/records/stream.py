"""Records from a series that comes in chunks: the same numbers as from the whole, with memory that does not grow."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray, check_non_negative
from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.quality.belief import add_told
from bayes_rs.quality.rules import QualityRules
from bayes_rs.quality.samples import IntArray, distinct, ends_by_beam, is_sorted
from bayes_rs.readers.ranged_series import scan_of_series, stacked
from bayes_rs.records.beam_wind import wind_of_beams
from bayes_rs.records.counts import flags_report
from bayes_rs.records.flags import BEAM_FLAGS, RECORD_FLAGS
from bayes_rs.records.grid import on_grid
from bayes_rs.records.layout import REPORT
from bayes_rs.records.making import empty_record, make_records, stack_alike, windows_of, with_cut_off
from bayes_rs.records.ranges import split_ranges
from bayes_rs.records.record_options import record_options

_OF_CHUNK = ("source_files", "read_report")
"""Attributes of a series that tell of its chunk only."""
_SUMMED = ("duplicates_dropped", "samples_used")
_OF_WIND = sum(RECORD_FLAGS.values())


@dataclass(frozen=True)
class StreamState:
    """What is known of a series after some of its chunks.

    Parameters
    ----------
    time, beam : ndarray of int, shape (n_sample,)
        Of the samples whose records are still open, in the order in which they came; ns since 1970, and beam numbers.
    columns : dict of str to ndarray, shape (n_sample,)
        Their velocities and, where the series has them, CNR, status and others.
    attributes : dict
        Those of the series, such as ``status_valid``.
    latest : int or None
        Latest time of all samples, ns; None before the first.
    latest_of_beam : dict of int to int
        The same for each beam.
    samples, out_of_order, late : int
        Samples that came in all, those earlier than one of the same beam before them, and those that came too late.
    first_late : str
        The first sample that came too late, in words; empty if there is none.
    source_files : tuple of str
        Names of the files that the chunks came from.
    """

    time: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    beam: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)
    latest: int | None = None
    latest_of_beam: Mapping[int, int] = field(default_factory=dict)
    samples: int = 0
    out_of_order: int = 0
    late: int = 0
    first_late: str = ""
    source_files: tuple[str, ...] = ()


def stream_records(
    series: Iterable[xr.Dataset],
    scan: str | Path | Scan,
    *,
    lateness: float | None = None,
    quality: QualityRules | None = None,
    **options: Any,
) -> xr.Dataset:
    """Turn radial velocities that come in chunks into records.

    Parameters
    ----------
    series : iterable of xarray.Dataset
        Chunks of radial velocities, as `make_records` takes them, in the order of time. They may end anywhere.
    scan : Scan, str or Path
        The scan they were measured with, or its name or file.
    lateness : float, optional
        How far, in seconds, a sample may come behind the latest one before it: records stay open for so long after
        their end. By default the duration of a record.
    quality : QualityRules, optional
        As for `make_records`.
    **options
        As for `make_records`: the fields of `bayes_rs.records.RecordOptions`.

    Returns
    -------
    records : xarray.Dataset
        What `make_records` returns for the whole series, bit by bit. ``attrs["records_report"]`` also counts the
        samples that came after their record was closed, ``samples_late``, and names the first.

    Raises
    ------
    InputError
        If `make_records` refuses a chunk or an option, the chunks differ in their variables, or there is no sample.

    Notes
    -----
    In memory are the records, one chunk, and the samples of open records. A sample is late if its record ended more
    than `lateness` before the latest sample that came ahead of it, so it does not matter how the series is cut. Whether
    blades pass (`QualityRules.blade_frequency`) is a matter of a whole series, and not tested here.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("2-beam"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> chunks = (series.isel(sample=slice(first, first + 1000)) for first in range(0, 2400, 1000))
    >>> stream_records(chunks, scan)["variance"].equals(brs.make_records(series, scan)["variance"])
    True
    """
    state, of_scan = StreamState(), as_scan(scan)
    blocks = []
    for chunk in series:
        of_scan = scan_of_series(chunk, of_scan)
        state, block = add_chunk(state, chunk, of_scan, lateness=lateness, quality=quality, **options)
        blocks += [] if block is None else [block]
    return join_blocks(blocks, state, of_scan, quality=quality, **options)


def add_chunk(
    state: StreamState,
    chunk: xr.Dataset,
    scan: Scan,
    *,
    lateness: float | None = None,
    quality: QualityRules | None = None,
    **options: Any,
) -> tuple[StreamState, xr.Dataset | None]:
    """Add one chunk of a series; return the new state, and the records that it completes.

    Parameters
    ----------
    state : StreamState
        After the chunks before; it is not changed.
    chunk, scan, lateness, quality, options
        As for `stream_records`.

    Returns
    -------
    state : StreamState
        With the samples of the records that are still open.
    block : Dataset or None
        The records that are complete; None if there are none.

    Raises
    ------
    InputError
        As `stream_records`.
    """
    if isinstance(scan, RangedScan):
        chunk = stacked(chunk, scan)
    window = record_options(options).window
    wait = window if lateness is None else round(check_non_negative(lateness, what="lateness", unit="s") * 1e9)
    time, beam, columns = _arrays(chunk, scan)
    if len(time) == 0:
        return state, None
    attributes = {name: value for name, value in chunk.attrs.items() if name not in _OF_CHUNK}
    if state.latest is not None:
        _check_alike(state, columns, attributes)
    before = np.maximum.accumulate(np.concatenate([[time[0] if state.latest is None else state.latest], time]))
    late = time // window < (before[:-1] - wait) // window
    on_time = ~late if late.any() else slice(None)
    out_of_order, latest_of_beam = _out_of_order(time, beam, state.latest_of_beam)
    if late.any() and not state.late:
        index = int(np.argmax(late))
        first_late = f"beam {beam[index]} at {_utc(time[index])}, after a sample of {_utc(before[index])}"
        state = replace(state, first_late=first_late)
    all_time = np.concatenate([state.time, time[on_time]])
    all_beam = np.concatenate([state.beam, beam[on_time]])
    all_columns = {
        name: np.concatenate([state.columns[name], values[on_time]]) if name in state.columns else values[on_time]
        for name, values in columns.items()
    }
    latest = int(before[-1])
    closed = all_time // window < (latest - wait) // window
    files = json.loads(chunk.attrs.get("source_files", "[]"))
    new = replace(
        state,
        time=all_time[~closed],
        beam=all_beam[~closed],
        columns={name: values[~closed] for name, values in all_columns.items()},
        attributes=attributes,
        latest=latest,
        latest_of_beam=latest_of_beam,
        samples=state.samples + len(time),
        out_of_order=state.out_of_order + out_of_order,
        late=state.late + int(np.count_nonzero(late)),
        source_files=(*state.source_files, *(name for name in files if name not in state.source_files)),
    )
    if not closed.any():
        return new, None
    done = _series(
        all_time[closed], all_beam[closed], {name: values[closed] for name, values in all_columns.items()}, attributes
    )
    return new, make_records(done, scan, quality=quality, **options)


def join_blocks(
    blocks: list[xr.Dataset],
    state: StreamState,
    scan: Scan,
    *,
    beams: IntArray | None = None,
    empty: xr.Dataset | None = None,
    later: int | None = None,
    quality: QualityRules | None = None,
    **options: Any,
) -> xr.Dataset:
    """Put the records of a stream together, those that are still open with them.

    Parameters
    ----------
    blocks : list of Dataset
        What `add_chunk` returned, in that order.
    state : StreamState
        After the last chunk.
    beams : ndarray of int, optional
        Beams that came before, of records that are no longer there.
    empty : Dataset, optional
        What `empty_record` says of such a series, if it is known.
    later : int, optional
        Number of a window behind all these samples that has one, too: the records go up to it.
    scan, quality, options
        As for `stream_records`.

    Returns
    -------
    records : Dataset
        As `stream_records` returns them.

    Raises
    ------
    InputError
        If there is no sample, or the times span too many records.
    """
    if isinstance(scan, RangedScan):
        of_all = {"beams": beams, "empty": empty, "later": later, "quality": quality, **options}
        return _join_ranges(blocks, state, scan, of_all)
    if len(state.time):
        last = _series(state.time, state.beam, state.columns, state.attributes)
        blocks = [*blocks, make_records(last, scan, quality=quality, **options)]
    if not blocks:
        raise InputError("Invalid series: it holds no sample; give files with samples.")
    chosen = record_options(options)
    window = chosen.window
    known = [] if beams is None else [beams]
    present = np.unique(np.concatenate([*known, *(block["beam"].values for block in blocks)]))
    beams = scan.beam[np.isin(scan.beam, present)]
    windows = windows_of(blocks, window, len(beams), later=later)
    if empty is None:
        some_beam = int(blocks[0]["beam"].values[0])
        empty = empty_record(state.columns, state.attributes, some_beam, scan, quality=quality, **options)
    _check_same(blocks, empty)
    records = on_grid(blocks, empty, windows=windows, beams=beams, window=window)
    # a block does not know of a beam that it lacks and others have: the wind is found again, to the last bit
    valid = (records["flag"].values & ~np.uint8(BEAM_FLAGS["record_excluded"])) == 0
    speed, yaw, of_wind = wind_of_beams(records["mean"].values, valid, scan.select(beams))
    records["wind_speed"].values[:], records["yaw"].values[:] = speed, yaw
    own = records["record_flag"].values & ~np.uint8(_OF_WIND)
    records["record_flag"].values[:] = own | of_wind
    records = with_cut_off(records, scan, chosen, later=later)
    report = _report(blocks, records, state, scan, window)
    absent = [number for number in scan.beam.tolist() if number not in beams]
    files = {"source_files": json.dumps(list(state.source_files))} if state.source_files else {}
    return records.assign_attrs({**files, "beams_absent": json.dumps(absent), "records_report": json.dumps(report)})


def _join_ranges(
    blocks: Sequence[xr.Dataset],
    state: StreamState,
    scan: RangedScan,
    options: Mapping[str, Any],
) -> xr.Dataset:
    """Put the records of a stream at several ranges together, range by range; options are those of `join_blocks`."""
    index, beam = scan.split(state.beam)
    came, making = options["beams"], {**options, "beams": None}
    place_of, beam_of = (None, None) if came is None else scan.split(came)
    parts = [split_ranges(block) for block in blocks]
    joined: dict[int, xr.Dataset] = {}
    for place in range(scan.n_range):
        # records of a range that a block only holds because others have them are told by their lack of a report
        own = [_with_samples(part[place]) for part in parts if REPORT in part[place].attrs]
        rows = index == place
        if not own and not rows.any():
            continue
        of_range = replace(
            state,
            time=state.time[rows],
            beam=beam[rows],
            columns={name: values[rows] for name, values in state.columns.items()},
            samples=int(rows.sum()) + sum(json.loads(part.attrs[REPORT])["samples"] for part in own),
        )
        if joined:  # what is counted for all ranges together stands with the first
            of_range = replace(of_range, late=0, first_late="", out_of_order=0)
        if beam_of is not None:
            making["beams"] = beam_of[place_of == place]
        joined[place] = join_blocks(own, of_range, scan.at(place), **making)
    if not joined:
        raise InputError("Invalid series: it holds no sample; give files with samples.")
    made = {name: value for name, value in options.items() if name not in ("beams", "empty", "later")}
    some_beam, empty = int(scan.of_one.beam[0]), options["empty"]
    no_sample = partial(empty_record, state.columns, state.attributes, some_beam, scan.at(0), **made)
    window = record_options({name: value for name, value in made.items() if name != "quality"}).window
    return stack_alike(joined, scan, window, no_sample if empty is None else lambda: empty)


def _with_samples(block: xr.Dataset) -> xr.Dataset:
    """Return the records of the beams that have samples, without those that others of the block's ranges have."""
    return block.isel(beam=~((block["flag"].values & BEAM_FLAGS["no_samples"]) != 0).all(axis=0))


def _report(
    blocks: list[xr.Dataset], records: xr.Dataset, state: StreamState, scan: Scan, window: int
) -> dict[str, Any]:
    """Add up the reports of the blocks; what depends on the whole is counted again."""
    reports = [json.loads(block.attrs["records_report"]) for block in blocks]
    beams = records["beam"].values
    more = {"samples_late": state.late, "first_late": state.first_late} if state.late else {}
    return {
        **reports[0],
        **{name: sum(report[name] for report in reports) for name in _SUMMED},
        "samples": state.samples,
        "samples_out_of_order": state.out_of_order,
        "dropped": {
            name: sum(report["dropped"].get(name, 0) for report in reports)
            for name in dict.fromkeys(name for report in reports for name in report["dropped"])
        },
        "by_beam": _by_beam([report["by_beam"] for report in reports], beams.tolist()),
        **_impossible(reports),
        **flags_report(records, beams, scan, window),
        "blades": [],
        **more,
    }


def _impossible(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """Add up which impossible velocities the blocks dropped."""
    some = [report for report in reports if "impossible_values" in report]
    if not some:
        return {}
    values: dict[str, int] = {}
    for report in some:
        values = add_told(values, report["impossible_values"])
    return {"impossible_values": values, "velocity_limit": some[0]["velocity_limit"]}


def _by_beam(tables: list[dict[str, list[int]]], beams: list[int]) -> dict[str, list[int]]:
    """Add up counts of samples by beam; a table lacks the beams that its block does, and filters that dropped none."""
    names = list(dict.fromkeys(name for table in tables for name in table if name != "beam"))
    total = {name: dict.fromkeys(beams, 0) for name in names}
    for table in tables:
        for name in names:
            for beam, count in zip(table["beam"], table.get(name, [0] * len(table["beam"])), strict=True):
                total[name][beam] += count
    return {"beam": beams, **{name: list(of_beam.values()) for name, of_beam in total.items()}}


def _arrays(chunk: xr.Dataset, scan: Scan) -> tuple[IntArray, IntArray, dict[str, FloatArray]]:
    """Return times, beams and columns of a chunk, checked before they are kept beside those of others."""
    for name in ("radial_velocity", "time", "beam"):
        if name not in chunk.variables or chunk[name].dims != ("sample",):
            raise InputError(
                f"Invalid chunk of a series: it needs {name!r} over the dimension 'sample'; make it with "
                "bayes_rs.readers.stream."
            )
    if not np.issubdtype(chunk["time"].dtype, np.datetime64) or bool(np.isnat(chunk["time"].values).any()):
        raise InputError("Invalid chunk of a series: every time must be a UTC time of type datetime64.")
    beam = np.asarray(chunk["beam"].values)
    foreign = np.setdiff1d(distinct(beam), scan.beam)
    if len(foreign):
        raise InputError(
            f"Unknown beam {foreign[0]} in a chunk of a series: the beams of the scan {scan.name!r} are "
            f"{scan.beam.tolist()}; give the scan that the series was read with."
        )
    columns = {str(name): values.values for name, values in chunk.data_vars.items() if values.dims == ("sample",)}
    return chunk["time"].values.astype("datetime64[ns]").astype(np.int64), beam.astype(np.int64), columns


def _check_alike(state: StreamState, columns: Mapping[str, Any], attributes: Mapping[str, Any]) -> None:
    if set(columns) != set(state.columns):
        (name, *_) = sorted(set(columns) ^ set(state.columns))
        which = "the earlier ones have" if name in state.columns else "a later one has"
        raise InputError(
            f"The chunks of a series differ: only {which} {name}: give files with the same columns, or fit them "
            "separately."
        )
    one, other = (of.get("status_valid") for of in (state.attributes, attributes))
    if one != other:
        raise InputError(
            f"The chunks of a series count different statuses as valid, {one} and {other}: give "
            "one with the option status_valid (--status-valid)."
        )


def _out_of_order(time: IntArray, beam: IntArray, latest: Mapping[int, int]) -> tuple[int, dict[int, int]]:
    """Count the samples that are earlier than one of the same beam before them; return the latest of each beam, too."""
    if is_sorted(time) and (not latest or len(time) == 0 or time[0] >= max(latest.values())):
        return 0, {**latest, **{number: end for number, (_, end) in ends_by_beam(time, beam).items()}}
    order = np.argsort(beam, kind="stable")
    edges = np.flatnonzero(np.diff(beam[order])) + 1
    count, after = 0, dict(latest)
    for part in np.split(order, edges):
        number, own = int(beam[part[0]]), time[part]
        highest = np.maximum.accumulate(own)
        if number in latest:
            highest = np.maximum(highest, latest[number])
        count += int(np.count_nonzero(own < highest))
        after[number] = int(highest[-1])
    return count, after


def _series(
    time: IntArray, beam: IntArray, columns: Mapping[str, FloatArray], attributes: Mapping[str, Any]
) -> xr.Dataset:
    return xr.Dataset(
        {name: ("sample", values) for name, values in columns.items()},
        coords={"time": ("sample", time.astype("datetime64[ns]")), "beam": ("sample", beam)},
        attrs=dict(attributes),
    )


def _check_same(blocks: Sequence[xr.Dataset], empty: xr.Dataset) -> None:
    """Refuse blocks whose variables are not those of a record, or have not as many entries as there."""
    right = _layout_of(empty)
    for block in blocks:
        found = _layout_of(block)
        wrong = sorted(name for name in right.keys() | found.keys() if right.get(name) != found.get(name))
        if wrong:
            raise InputError(
                f"Records that were made of some of the files do not go with the others, in {', '.join(wrong[:5])}: "
                "overwrite the folder to make all of them again."
            )


def _layout_of(records: xr.Dataset) -> dict[str, dict[str, int]]:
    """Return the lengths of every variable's dimensions, without records and beams, which may be fewer."""
    variables = records.variables
    return {
        str(name): {str(dim): size for dim, size in variables[name].sizes.items() if dim not in ("record", "beam")}
        for name in records.data_vars
    }


def _utc(time: int | np.signedinteger[Any]) -> str:
    return str(np.datetime64(int(time), "ns").astype("datetime64[ms]")) + "Z"
