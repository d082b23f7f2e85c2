"""Records of many files, made file by file and kept, so that what was read is not read again."""

from __future__ import annotations

import hashlib
import io
import json
import lzma
import time
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.output import write_netcdf
from bayes_rs.progress import progress_counter
from bayes_rs.quality import IntArray
from bayes_rs.readers.compressed import NOT_THE_FILE
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.registry import SUFFIXES
from bayes_rs.readers.streaming import stream_radial_velocity
from bayes_rs.records.read_counts import add_report, whole_report
from bayes_rs.records.stream import StreamState, add_chunk, join_blocks
from bayes_rs.result_folder import ResultFolder

CHUNK_ROWS = 500_000
"""Rows of a file that are read at a time."""
SAVE_SECONDS = 20.0
"""Reading that is lost at most, beside that of one file, when a run is interrupted."""
_PEEK = 1000
_HEAD = 65_536  # bytes
_STATE = "records/state.npz"
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


def store_records(
    files: str | Path | Sequence[str | Path],
    scan: Scan,
    folder: ResultFolder,
    *,
    reading: Mapping[str, Any] | None = None,
    chunk_rows: int | None = None,
    lateness: float | None = None,
    show_progress: bool | None = None,
    **options: Any,
) -> StoredRecords:
    """Make records of any number of files; what is finished is kept in a folder, and not done again.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files, folders and patterns, as for `stream_radial_velocity`.
    scan : Scan
        The scan they were measured with.
    folder : ResultFolder
        The folder of results, where parts of the records are kept below ``records``; of the same scan and options.
    reading : dict, optional
        Options of `stream_radial_velocity`.
    chunk_rows : int, optional
        Rows that are read at a time; memory, not the result, depends on it.
    lateness : float, optional
        As for `stream_records`; files may also overlap by so much, s.
    show_progress : bool, optional
        Progress bar on stderr; by default only on a terminal.
    **options
        Those of `make_records`.

    Returns
    -------
    stored : StoredRecords
        The records, and the files that could not be used.

    Raises
    ------
    InputError
        If no file can be used, or one that an earlier run has read is gone or was changed.

    Notes
    -----
    Files are taken in the order of their first samples; those that overlap by more than `lateness` are read side by
    side. A file with an error anywhere counts for nothing, so that no number depends on how it is cut into chunks.
    """
    found = find_files(files, SUFFIXES)
    paths = found.paths
    given = dict(reading or {})
    given.pop("on_bad_file", None)
    done = _load(folder)
    for name in set(folder.names("records/part-")) - {_part(index) for index in range(done.n_part)}:
        folder.remove(name)  # what no state counts: it is made again
    _check_unchanged(paths, done)
    left = [path for path in paths if _name(path) not in done.files]
    n_resumed = len(paths) - len(left)
    try:
        done = _read_all(left, scan, folder, done, given, chunk_rows or CHUNK_ROWS, lateness, options, show_progress)
    except BaseException as error:
        error.add_note(
            f"What was made of the files so far is kept in {str(folder.path)!r}: the same call with resume goes on "
            "from it."
        )
        raise
    if len(done.bad) == len(paths):
        first = next(iter(done.bad.values()))
        raise InputError(f"None of the {len(paths)} files can be used; the first: {first}")
    parts = [_open(folder, index) for index in range(done.n_part)]
    records = join_blocks(parts, done.state, scan, **options)
    if done.read:
        bad = [path for path in paths if _name(path) in done.bad]
        report = whole_report(
            done.read,
            scan,
            order=[_name(path) for path in paths],
            skipped=[{"name": path.name, "reason": done.bad[_name(path)]} for path in bad],
            passed_over=found.passed_over,
        )
        records = records.assign_attrs(read_report=json.dumps(report))
    return StoredRecords(records, dict(done.bad), len(paths), n_resumed, dict(done.read.get("counts", {})))


def _read_all(
    left: Sequence[Path],
    scan: Scan,
    folder: ResultFolder,
    done: _Progress,
    given: Mapping[str, Any],
    chunk_rows: int,
    lateness: float | None,
    options: Mapping[str, Any],
    show_progress: bool | None,
) -> _Progress:
    """Read the files that are left, and save what comes of it every now and then."""
    wait = np.timedelta64(round((float(options.get("duration", 600.0)) if lateness is None else lateness) * 1e9), "ns")
    done, queue = _by_first_time(left, scan, given, done)
    silent = None if show_progress is None else not show_progress
    blocks: list[xr.Dataset] = []
    n_byte = {path: path.stat().st_size for path in left}
    saved = time.monotonic()
    with progress_counter(sum(n_byte.values()), "reading", "B", scale=True, disable=silent) as bar:
        while queue:
            group = [queue.pop(0)[1]]
            while group:
                after = queue[0][0] + wait if queue else None
                keys = {path: _key(path) for path in group}  # before they are read: they may grow
                try:
                    read = _read(group, scan, done, given, chunk_rows, after, lateness, options)
                except _UNREADABLE as error:
                    bad = _bad_one(group, error, scan, given)
                    done = _with(done, {bad: keys[bad]}, bad={_name(bad): _in_words(error)})
                    bar.update(n_byte[bad])
                    group.remove(bad)
                    continue
                if isinstance(read, np.datetime64):  # the next files begin before these end: all are read again
                    group += [path for first, path in queue if first <= read]
                    queue = [(first, path) for first, path in queue if first > read]
                    continue
                done, more = read
                done = _with(done, keys)
                blocks += more
                bar.update(sum(n_byte[path] for path in group))
                break
            if time.monotonic() - saved >= SAVE_SECONDS:
                done, blocks = _save(folder, done, blocks, scan, options), []
                saved = time.monotonic()
    return _save(folder, done, blocks, scan, options)


def _read(
    group: Sequence[Path],
    scan: Scan,
    done: _Progress,
    reading: Mapping[str, Any],
    chunk_rows: int,
    after: np.datetime64 | None,
    lateness: float | None,
    options: Mapping[str, Any],
) -> tuple[_Progress, list[xr.Dataset]] | np.datetime64:
    """Add files to the stream; or, if they reach beyond `after`, return how far, and nothing is added."""
    state, read, blocks = done.state, done.read, []
    names = {path.name: _name(path) for path in reversed(group)}
    for chunk in stream_radial_velocity(group, scan, chunk_rows=chunk_rows, **reading):
        latest = chunk["time"].values.max()
        if after is not None and latest > after:
            return np.datetime64(latest)
        if "read_report" in chunk.attrs:
            read = add_report(read, json.loads(chunk.attrs["read_report"]), names)
        state, block = add_chunk(state, chunk, scan, lateness=lateness, **options)
        blocks += [] if block is None else [block]
    return replace(done, state=state, read=read), blocks


def _bad_one(group: Sequence[Path], error: BaseException, scan: Scan, reading: Mapping[str, Any]) -> Path:
    """Return the file of a group that an error is about."""
    if isinstance(error, OSError) and error.errno in NOT_THE_FILE:
        raise error
    for path in group:
        if len(group) == 1 or str(path) in str(error):
            return path
    for path in group:
        try:
            for _ in stream_radial_velocity(path, scan, **reading):
                pass
        except _UNREADABLE:
            return path
    return group[-1]  # each alone can be read: they do not go together


def _by_first_time(
    paths: Sequence[Path], scan: Scan, reading: Mapping[str, Any], done: _Progress
) -> tuple[_Progress, list[tuple[np.datetime64, Path]]]:
    firsts = []
    for path in paths:
        key = _key(path)
        try:
            chunk = next(stream_radial_velocity(path, scan, chunk_rows=_PEEK, **reading))
        except _UNREADABLE as error:
            bad = _bad_one([path], error, scan, reading)
            done = _with(done, {bad: key}, bad={_name(bad): _in_words(error)})
        else:
            firsts.append((chunk["time"].values.min(), path))
    return done, sorted(firsts, key=lambda pair: pair[0])


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
    return xr.load_dataset(io.BytesIO(folder.read(_part(index))), engine="h5netcdf").drop_encoding()


def _save(
    folder: ResultFolder, done: _Progress, blocks: list[xr.Dataset], scan: Scan, options: Mapping[str, Any]
) -> _Progress:
    """Write the new records as one part, then the state that counts it: a part without it is written again."""
    if blocks:
        empty: IntArray = np.empty(0, dtype=np.int64)
        columns = {name: values[:0] for name, values in done.state.columns.items()}
        closed = replace(done.state, time=empty, beam=empty, columns=columns)
        part = join_blocks(blocks, closed, scan, **options)
        folder.write(_part(done.n_part), lambda file: write_netcdf(part, file))
        done = replace(done, n_part=done.n_part + 1)
    arrays = ("time", "beam", "columns")
    state = {name: getattr(done.state, name) for name in StreamState.__dataclass_fields__ if name not in arrays}
    meta = {"state": {**state, "latest_of_beam": list(done.state.latest_of_beam.items())}}
    meta.update({name: getattr(done, name) for name in ("n_part", "files", "bad", "read")})
    columns = {f"column {name}": values for name, values in done.state.columns.items()}
    text = np.array(json.dumps(meta, default=lambda value: value.tolist()))
    entries: dict[str, Any] = {"meta": text, "time": done.state.time, "beam": done.state.beam, **columns}
    folder.write(_STATE, lambda file: np.savez(file, **entries))
    return done


def _load(folder: ResultFolder) -> _Progress:
    """Return what an interrupted run had done; nothing, if a file of it is gone or was changed."""
    try:
        with np.load(io.BytesIO(folder.read(_STATE))) as found:
            meta = json.loads(str(found["meta"]))
            columns = {name.removeprefix("column "): found[name] for name in found if name.startswith("column ")}
            beam_time = {"time": found["time"], "beam": found["beam"]}
        for index in range(meta["n_part"]):
            folder.checked(_part(index))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return _Progress()
    state = meta.pop("state")
    state["latest_of_beam"] = {int(beam): int(latest) for beam, latest in state["latest_of_beam"]}
    state["source_files"] = tuple(state["source_files"])
    return _Progress(state=StreamState(**beam_time, columns=columns, **state), **meta)
