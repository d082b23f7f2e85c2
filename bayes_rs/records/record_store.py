"""Records of many files, made file by file and kept, so that what was read is not read again."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import lzma
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import xarray as xr
from pydantic import ConfigDict, Field

from bayes_rs._validation import check_count
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.layouts import Count, Entry, Open, check_dataset, read_json
from bayes_rs.output import write_netcdf
from bayes_rs.progress import progress_counter
from bayes_rs.quality.rules import QualityRules
from bayes_rs.quality.samples import IntArray
from bayes_rs.readers.ahead import read_ahead
from bayes_rs.readers.compressed import NOT_THE_FILE
from bayes_rs.readers.folders import FoundFiles, find_files
from bayes_rs.readers.levels import scan_at_ranges
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.readers.one_file import SUFFIXES
from bayes_rs.readers.streaming import series_of_read, stream
from bayes_rs.records.file_queue import FileQueue, NotInOrderError, Waiting
from bayes_rs.records.layout import OF_RANGES, REPORT, check_layout
from bayes_rs.records.read_counts import add_report, whole_report
from bayes_rs.records.record_options import RecordOptions, record_options
from bayes_rs.records.stream import StreamState, add_chunk, join_blocks
from bayes_rs.result_folder import ResultFolder

CHUNK_ROWS = 500_000
"""Rows of a file that are read at a time."""
SAVE_SECONDS = 20.0
"""Reading that is lost at most, beside that of one file, when a run is interrupted."""
_SAVE_RATIO = 20.0
"""How much longer reading goes on than saving took."""
_SAMPLE = ("sample",)
_AGAIN = "the files are read again"
_OF_PART = ("variance", "mean", "count", "flag", "wind_speed", "yaw", "record_flag", "time", "beam")
"""Variables that every part of the records has."""
_PEEK = 1000
_LOOK_AHEAD = 512
"""Files that are looked at before their turn comes."""
_HEAD = 65_536  # bytes
_STATE = "records/state.npz"
_TRIES = 2
"""Times that all files are read at most, if what was kept of them is found damaged at the end."""
_LOG = logging.getLogger(__name__)
_UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    RuntimeError,
    zlib.error,
    lzma.LZMAError,
    zipfile.BadZipFile,
    pa.ArrowException,
)
"""What libraries raise for a file that is not what it should be."""


@dataclass(frozen=True)
class StoredRecords:
    """Records of many files.

    Parameters
    ----------
    records : Dataset
        As `make_records` makes them of all files together, with the report of reading these.
    bad_files : dict of str to str
        Files that could not be used, with the reasons; nothing of them is in the records.
    n_file, n_resumed : int
        Files in all, and those that an earlier, interrupted run had read.
    counts : dict of str to int
        What was read and dropped, added up over the files.
    """

    records: xr.Dataset
    bad_files: dict[str, str]
    n_file: int
    n_resumed: int
    counts: dict[str, int]


@dataclass(frozen=True)
class _Progress:
    """What is done: the state of the stream, which files and parts it comes from, and what was read of them."""

    state: StreamState = field(default_factory=StreamState)
    n_part: int = 0
    files: Mapping[str, list[Any]] = field(default_factory=dict)
    bad: Mapping[str, str] = field(default_factory=dict)
    read: Mapping[str, Any] = field(default_factory=dict)
    distance: list[list[float]] = field(default_factory=list)
    """Distance along each beam at each of several ranges; nothing of a scan at its own."""


def store_records(
    files: str | Path | Sequence[str | Path],
    scan: str | Path | Scan,
    folder: ResultFolder,
    *,
    reading: FileOptions | None = None,
    quality: QualityRules | None = None,
    chunk_rows: int = CHUNK_ROWS,
    lateness: float | None = None,
    workers: int = 1,
    progress: bool | None = None,
    say: Callable[[str], None] = _LOG.warning,
    **options: Any,
) -> StoredRecords:
    """Make records of any number of files; what is finished is kept in a folder, and not done again.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files, folders and patterns, as for `bayes_rs.readers.stream`.
    scan : Scan, str or Path
        The scan they were measured with, or its name or file.
    folder : ResultFolder
        The folder of results, which keeps parts of the records below ``records``; of the same scan and options.
    reading : FileOptions, optional
        How the files are written. With ``on_bad_file="skip"`` a file that cannot be used counts for nothing, and is
        named in the report; otherwise it is refused.
    quality : QualityRules, optional
        As for `make_records`.
    chunk_rows : int
        Rows that are read at a time; memory, not the result, depends on it.
    lateness : float, optional
        As for `stream_records`; files may also overlap by so much, s.
    workers : int
        Processes that read files, if there are many in a format that is read whole (NetCDF and other files of rays).
        The records do not depend on it.
    progress : bool, optional
        Progress bar on stderr; by default only on a terminal.
    say : callable
        Takes a line that says why what the folder keeps is not used; by default it is logged as a warning.
    **options
        As for `make_records`: the fields of `bayes_rs.records.RecordOptions`.

    Returns
    -------
    stored : StoredRecords
        The records, and the files that could not be used.

    Raises
    ------
    InputError
        If a file cannot be used and is not to be skipped, no file can be used, or one that an earlier run has read is
        gone or was changed.

    Notes
    -----
    Files are taken in the order of their first samples; those that overlap by more than `lateness` are read side by
    side. A file with an error anywhere counts for nothing, so that no number depends on how it is cut into chunks.

    Each part of the records, and the state that counts the parts, has a fingerprint in the folder's list. If one does
    not fit, all files are read again.
    """
    found = find_files(files, SUFFIXES)
    reading = reading or FileOptions()
    of_scan = scan_at_ranges(found.paths, as_scan(scan), reading)
    asked = _Asked(
        of_scan,
        reading,
        {"quality": quality, **options},
        record_options(options),
        lateness,
        chunk_rows,
        check_count(workers, what="workers"),
    )
    done = _load(folder, say)
    distance = of_scan.distance.tolist() if isinstance(of_scan, RangedScan) else []
    if done.files and done.distance != distance:
        say("The files are read at other ranges than by an earlier run: all are read again.")
        done = _Progress()
    done = replace(done, distance=distance)
    for name in set(folder.names("records/part-")) - {_part(index) for index in range(done.n_part)}:
        folder.remove(name)  # what no state counts: it is made again
    _check_unchanged(found.paths, done)
    n_resumed = sum(_name(path) in done.files for path in found.paths)
    for _ in range(_TRIES):
        done = _read_left(found.paths, asked, folder, done, progress)
        try:
            parts = [_open(folder, index) for index in range(done.n_part)]
            break
        except InputError:
            say(f"A part of the records in {str(folder.path)!r} was damaged meanwhile: all files are read again.")
        done, n_resumed = _Progress(distance=distance), 0
    else:
        raise InputError(
            f"The records in {str(folder.path)!r} do not stay as they were written: check the disk, or give another "
            "folder."
        )
    records = join_blocks(parts, done.state, asked.scan, **asked.making)
    if done.read:
        records = records.assign_attrs(read_report=json.dumps(_read_report(found, asked.scan, done)))
    return StoredRecords(records, dict(done.bad), len(found.paths), n_resumed, dict(done.read.get("counts", {})))


@dataclass(frozen=True)
class _Asked:
    """What the records of files are made with."""

    scan: Scan
    reading: FileOptions
    making: Mapping[str, Any]
    """Keywords of `make_records`."""
    records: RecordOptions
    lateness: float | None
    chunk_rows: int
    workers: int = 1

    @property
    def wait(self) -> np.timedelta64:
        """How far files may overlap and still follow each other."""
        nanoseconds = self.records.window if self.lateness is None else round(float(self.lateness) * 1e9)
        return np.timedelta64(nanoseconds, "ns")

    @property
    def of_files(self) -> dict[str, Any]:
        """Keywords of `stream`: it stops at a bad file, whatever is then to be done with it."""
        return {**self.reading.given(), "on_bad_file": "error"}

    @property
    def skips(self) -> bool:
        """Whether a file that cannot be used counts for nothing."""
        return self.reading.on_bad_file == "skip"


def _read_left(
    paths: Sequence[Path], asked: _Asked, folder: ResultFolder, done: _Progress, progress: bool | None
) -> _Progress:
    """Read the files that are not yet read; what was made of them is kept, also if that is broken off."""
    if done.bad and not asked.skips:
        raise InputError(next(iter(done.bad.values())))
    left = [path for path in paths if _name(path) not in done.files]
    try:
        done = _read_all(left, asked, folder, done, progress)
    except BaseException as error:
        error.add_note(
            f"What was made of the files so far is kept in {str(folder.path)!r}: the same call with resume goes on "
            "from it."
        )
        raise
    if len(done.bad) == len(paths):
        folder.remove(_STATE)  # there is nothing to go on from
        first = next(iter(done.bad.values()))
        raise InputError(f"None of the {len(paths)} files can be used; the first: {first}")
    return done


def _read_report(found: FoundFiles, scan: Scan, done: _Progress) -> dict[str, Any]:
    """Return the report as `read` gives it of all files together."""
    return whole_report(
        done.read,
        scan.of_one if isinstance(scan, RangedScan) else scan,
        order=[_name(path) for path in found.paths],
        skipped=[
            {"name": path.name, "reason": done.bad[_name(path)]} for path in found.paths if _name(path) in done.bad
        ],
        passed_over=found.passed_over,
    )


def _read_all(
    left: Sequence[Path], asked: _Asked, folder: ResultFolder, done: _Progress, progress: bool | None
) -> _Progress:
    """Read the files that are left, and save what comes of it every now and then.

    They are taken for in the order of their names. If one begins before others end that had their turn, all are looked
    at first.
    """
    try:
        return _read_in_turn(left, asked, folder, done, progress, most=_LOOK_AHEAD)
    except NotInOrderError:
        for name in set(folder.names("records/part-")) - {_part(index) for index in range(done.n_part)}:
            folder.remove(name)
        done = _save(folder, done, [], asked)
        return _read_in_turn(left, asked, folder, done, progress, most=len(left) + 1)


def _read_in_turn(
    left: Sequence[Path], asked: _Asked, folder: ResultFolder, done: _Progress, progress: bool | None, *, most: int
) -> _Progress:
    silent = None if progress is None else not progress
    blocks: list[xr.Dataset] = []
    n_byte = {path: path.stat().st_size for path in left}
    saved, wait = time.monotonic(), SAVE_SECONDS
    alone = 0  # files that did not go together with others
    reading = FileOptions(**asked.of_files)
    with (
        progress_counter(sum(n_byte.values()), "reading", "B", scale=True, disable=silent) as bar,
        closing(read_ahead(left, asked.scan, reading, note=_key, workers=asked.workers)) as read,
    ):
        queue = FileQueue(read, partial(_first_of, asked=asked), asked.wait, most, asked.chunk_rows)
        while True:
            group = queue.take(*([1] if alone else []))
            done = _with_bad(done, queue, asked, bar, n_byte)
            if not group:
                break
            while group:
                following = queue.next_first()
                done = _with_bad(done, queue, asked, bar, n_byte)
                keys = {one.path: one.key for one in group}
                try:
                    added = _read(group, asked, done, None if following is None else following + asked.wait)
                except _UNREADABLE as error:
                    if len(group) > 1 and all(one.samples is not None for one in group):
                        queue.put_back(group)
                        alone = len(group)
                        break
                    bad = _bad_one([one.path for one in group], error, asked)
                    done = _with(done, {bad: keys[bad]}, bad={_name(bad): _in_words(error)})
                    bar.update(n_byte[bad])
                    group = [one for one in group if one.path != bad]
                    continue
                if isinstance(added, np.datetime64):  # the next files begin before these end
                    group += queue.take_until(added)
                    done = _with_bad(done, queue, asked, bar, n_byte)
                    continue
                done, more, latest = added
                queue.used(latest)
                alone = max(alone - len(group), 0)
                done = _with(done, keys)
                blocks += more
                bar.update(sum(n_byte[one.path] for one in group))
                break
            if time.monotonic() - saved >= wait:
                began = time.monotonic()
                done, blocks = _save(folder, done, blocks, asked), []
                saved = time.monotonic()
                # the state of a million files takes its time to write
                wait = max(SAVE_SECONDS, _SAVE_RATIO * (saved - began)) if saved - began > 1.0 else SAVE_SECONDS
    return _save(folder, done, blocks, asked)


def _with_bad(done: _Progress, queue: FileQueue, asked: _Asked, bar: Any, n_byte: Mapping[Path, int]) -> _Progress:
    """Note the files of the queue that cannot be used, if they are to be skipped."""
    while queue.bad:
        path, key, error = queue.bad.pop(0)
        bad = _bad_one([path], error, asked)
        done = _with(done, {bad: key}, bad={_name(bad): _in_words(error)})
        bar.update(n_byte[bad])
    return done


def _first_of(path: Path, asked: _Asked) -> np.datetime64 | Exception:
    """Return the first time of a file that is read in pieces; or what is wrong with it."""
    try:
        chunk = next(stream(path, asked.scan, chunk_rows=_PEEK, **asked.of_files))
    except _UNREADABLE as error:
        return error
    return np.datetime64(chunk["time"].values.min())


def _read(
    group: Sequence[Waiting], asked: _Asked, done: _Progress, after: np.datetime64 | None
) -> tuple[_Progress, list[xr.Dataset], np.datetime64] | np.datetime64:
    """Add files to the stream; or, if they reach beyond `after`, return how far, and nothing is added.

    What was added comes with the latest time in it.
    """
    state, read, blocks = done.state, done.read, []
    names = {one.path.name: _name(one.path) for one in reversed(group)}
    reached = max(one.first for one in group)
    for chunk in _chunks(group, asked):
        latest = np.datetime64(chunk["time"].values.max())
        if after is not None and latest > after:
            return latest
        reached = max(reached, latest)
        if "read_report" in chunk.attrs:
            read = add_report(read, json.loads(chunk.attrs["read_report"]), names)
        state, block = add_chunk(state, chunk, asked.scan, lateness=asked.lateness, **asked.making)
        blocks += [] if block is None else [block]
    return replace(done, state=state, read=read), blocks, reached


def _chunks(group: Sequence[Waiting], asked: _Asked) -> Iterator[xr.Dataset]:
    parts = [one.samples for one in group if one.samples is not None]
    if len(parts) == len(group):
        return series_of_read(parts, asked.scan, FileOptions(**asked.of_files), chunk_rows=asked.chunk_rows)
    return stream([one.path for one in group], asked.scan, chunk_rows=asked.chunk_rows, **asked.of_files)


def _bad_one(group: Sequence[Path], error: BaseException, asked: _Asked) -> Path:
    """Return the file of a group that an error is about, if it is one to be skipped; else raise the error."""
    if isinstance(error, OSError) and error.errno in NOT_THE_FILE:
        raise error
    if not asked.skips:
        if isinstance(error, InputError):
            raise error
        names = ", ".join(repr(str(path)) for path in group)
        raise InputError(f"File {names} cannot be used: {_in_words(error)}") from error
    for path in group:
        if len(group) == 1 or str(path) in str(error):
            return path
    for path in group:
        try:
            for _ in stream(path, asked.scan, **asked.of_files):
                pass
        except _UNREADABLE:
            return path
    return group[-1]  # each alone can be read: they do not go together


def _in_words(error: BaseException) -> str:
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


def _with(done: _Progress, keys: Mapping[Path, list[Any]], *, bad: Mapping[str, str] | None = None) -> _Progress:
    files = {**done.files, **{_name(path): key for path, key in keys.items()}}
    return replace(done, files=files, bad={**done.bad, **(bad or {})})


def _name(path: Path) -> str:
    return str(path.resolve())


def _key(path: Path) -> list[Any]:
    """Return what tells a file from a changed one: size, time of change, and a fingerprint of its first bytes."""
    try:
        status = path.stat()
        with path.open("rb") as file:
            head = hashlib.sha256(file.read(_HEAD)).hexdigest()
    except OSError:  # reading it says why
        return [0, 0, ""]
    return [status.st_size, status.st_mtime_ns, head]


def _check_unchanged(paths: Sequence[Path], done: _Progress) -> None:
    now = {_name(path): path for path in paths}
    for name, key in done.files.items():
        if name not in now:
            raise InputError(
                f"File {name!r} was read by the run that is to be resumed, and is not among the files now: give the "
                "same ones, or overwrite to begin anew."
            )
        found = _key(now[name])
        if found != key:
            what = (
                f"its size was {key[0]} and is {found[0]} bytes"
                if found[0] != key[0]
                else ("its first bytes differ" if found[2] != key[2] else "its time of change differs")
            )
            raise InputError(
                f"File {name!r} was changed since the run that is to be resumed has read it ({what}): restore it, or "
                "overwrite to begin anew."
            )


def _part(index: int) -> str:
    return f"records/part-{index:06d}.nc"


def _open(folder: ResultFolder, index: int) -> xr.Dataset:
    file = folder.checked(_part(index))
    part, what = load_netcdf(file).drop_encoding(), f"The records in {str(file)!r}"
    check_layout(part, *_OF_PART, what=what, ranges=True)
    if REPORT not in part.attrs and OF_RANGES not in part.attrs:
        raise InputError(f"{what} have no {REPORT}.")
    return part


def _save(folder: ResultFolder, done: _Progress, blocks: list[xr.Dataset], asked: _Asked) -> _Progress:
    """Write the new records as one part, then the state that counts it: a part without it is written again."""
    if blocks:
        empty: IntArray = np.empty(0, dtype=np.int64)
        columns = {name: values[:0] for name, values in done.state.columns.items()}
        closed = replace(done.state, time=empty, beam=empty, columns=columns)
        part = join_blocks(blocks, closed, asked.scan, **asked.making)
        folder.write(_part(done.n_part), lambda file: write_netcdf(part, file))
        done = replace(done, n_part=done.n_part + 1)
    arrays = ("time", "beam", "columns")
    state = {name: getattr(done.state, name) for name in StreamState.__dataclass_fields__ if name not in arrays}
    meta: dict[str, Any] = {"state": {**state, "latest_of_beam": list(done.state.latest_of_beam.items())}}
    meta.update({name: getattr(done, name) for name in ("n_part", "files", "bad", "read", "distance")})
    columns = {f"column {name}": values for name, values in done.state.columns.items()}
    text = np.array(json.dumps(meta, default=lambda value: value.tolist()).encode("ascii"))  # as text, four times that
    entries: dict[str, Any] = {"meta": text, "time": done.state.time, "beam": done.state.beam, **columns}
    folder.write(_STATE, lambda file: np.savez(file, **entries))
    return done


class _StateOfStream(Open):
    attributes: dict[str, Any]
    latest: int | None
    latest_of_beam: list[Annotated[list[int], Field(min_length=2, max_length=2)]]
    samples: Count
    out_of_order: Count
    late: Count
    first_late: str
    source_files: list[str]

    model_config = ConfigDict(extra="forbid", strict=True)


class _WasRead(Open):
    counts: dict[str, Count]
    beams: list[int]
    files: dict[str, dict[str, Any]]
    out_of_order: str


class _Meta(Open):
    """What the state of reading holds beside its arrays."""

    state: _StateOfStream
    n_part: Count
    files: dict[str, Annotated[list[int | str], Field(min_length=3, max_length=3)]]
    bad: dict[str, str]
    distance: list[list[float]]
    read: _WasRead | Annotated[dict[str, Any], Field(max_length=0)]

    model_config = ConfigDict(extra="forbid", strict=True)


def _load(folder: ResultFolder, say: Callable[[str], None]) -> _Progress:
    """Return what an interrupted run had done; nothing, if a file of it is gone or was changed."""
    if _STATE not in folder.names("records/"):
        return _Progress()
    try:
        done = _progress(folder.read(_STATE))
        for index in range(done.n_part):
            folder.checked(_part(index))
    except _UNREADABLE as error:
        say(f"What an earlier run made of the files is not used, and all are read again: {_in_words(error)}")
        return _Progress()
    return done


def _progress(content: bytes) -> _Progress:
    """Return what a state file holds."""
    with np.load(io.BytesIO(content)) as found:
        text = found["meta"]
        plain = text.item().decode("ascii", "replace") if text.dtype.kind == "S" and text.ndim == 0 else str(text)
        meta = read_json(_Meta, plain, what=f"File {_STATE}", advice=_AGAIN)
        columns = {name.removeprefix("column "): found[name] for name in found if name.startswith("column ")}
        beam_time = {"time": found["time"], "beam": found["beam"]}
    layout = {"time": Entry(_SAMPLE, "whole"), "beam": Entry(_SAMPLE, "whole")}
    layout |= {name: Entry(_SAMPLE) for name in columns}
    entries = {name: (_SAMPLE, values) for name, values in {**columns, **beam_time}.items()}
    check_dataset(xr.Dataset(entries), layout, what=f"The arrays of {_STATE}", advice=_AGAIN)
    state = meta.pop("state")
    state["latest_of_beam"] = {int(beam): int(latest) for beam, latest in state["latest_of_beam"]}
    state["source_files"] = tuple(state["source_files"])
    return _Progress(state=StreamState(**beam_time, columns=columns, **state), **meta)
