"""Records of many files, made file by file and kept, so that what was read is not read again."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import check_count
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.progress import progress_counter
from bayes_rs.quality.rules import QualityRules
from bayes_rs.quality.samples import IntArray
from bayes_rs.readers.ahead import read_ahead
from bayes_rs.readers.compressed import NOT_THE_FILE
from bayes_rs.readers.folders import FoundFiles, find_files
from bayes_rs.readers.levels import scan_at_ranges
from bayes_rs.readers.one_file import SUFFIXES
from bayes_rs.readers.reading import checked_options
from bayes_rs.readers.streaming import series_of_read, stream_files
from bayes_rs.readers.used_options import check_used
from bayes_rs.records.file_queue import FileQueue, NotInOrderError, Waiting
from bayes_rs.records.read_counts import add_report, whole_report
from bayes_rs.records.read_state import (
    STATE_FILE,
    UNREADABLE,
    ReadSoFar,
    check_unchanged,
    in_words,
    key_of,
    load_state,
    name_of,
    open_part,
    part_file,
    save_state,
    with_files,
)
from bayes_rs.records.record_options import RecordOptions, record_options
from bayes_rs.records.stream import add_chunk, join_blocks
from bayes_rs.result_folder import ResultFolder, going_on

CHUNK_ROWS = 500_000
"""Rows of a file that are read at a time."""
SAVE_SECONDS = 20.0
"""Reading that is lost at most, beside that of one file, when a run is interrupted."""
_SAVE_RATIO = 20.0
"""How much longer reading goes on than saving took."""
_PEEK = 1000
_LOOK_AHEAD = 512
"""Files that are looked at before their turn comes."""
_TRIES = 2
"""Times that all files are read at most, if what was kept of them is found damaged at the end."""
_LOG = logging.getLogger(__name__)


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
    of_scan = as_scan(scan)
    reading = checked_options((reading or FileOptions()).given(), of_scan)
    check_used(found.paths, of_scan, reading)
    of_scan = scan_at_ranges(found.paths, of_scan, reading)
    asked = _Asked(
        of_scan,
        reading,
        {"quality": quality, **options},
        record_options(options),
        lateness,
        chunk_rows,
        check_count(workers, what="workers"),
    )
    done = load_state(folder, say)
    distance = of_scan.distance.tolist() if isinstance(of_scan, RangedScan) else []
    if done.files and done.distance != distance:
        say("The files are read at other ranges than by an earlier run: all are read again.")
        done = ReadSoFar()
    done = replace(done, distance=distance)
    for name in set(folder.names("records/part-")) - {part_file(index) for index in range(done.n_part)}:
        folder.remove(name)  # what no state counts: it is made again
    check_unchanged(found.paths, done)
    n_resumed = sum(name_of(path) in done.files for path in found.paths)
    for _ in range(_TRIES):
        done = _read_left(found.paths, asked, folder, done, progress)
        try:
            parts = [open_part(folder, index) for index in range(done.n_part)]
            break
        except InputError:
            say(f"A part of the records in {str(folder.path)!r} was damaged meanwhile: all files are read again.")
        done, n_resumed = ReadSoFar(distance=distance), 0
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
    def of_files(self) -> FileOptions:
        """How files are read: each stops at what is bad, whatever is then to be done with it."""
        return FileOptions(**{**self.reading.given(), "on_bad_file": "error"})

    @property
    def skips(self) -> bool:
        """Whether a file that cannot be used counts for nothing."""
        return self.reading.on_bad_file == "skip"


def _read_left(
    paths: Sequence[Path], asked: _Asked, folder: ResultFolder, done: ReadSoFar, progress: bool | None
) -> ReadSoFar:
    """Read the files that are not yet read; what was made of them is kept, also if that is broken off."""
    if done.bad and not asked.skips:
        raise InputError(next(iter(done.bad.values())))
    left = [path for path in paths if name_of(path) not in done.files]
    try:
        done = _read_all(left, asked, folder, done, progress)
    except BaseException as error:
        error.add_note(f"What was made of the files so far is kept in {str(folder.path)!r}: {going_on(error)}")
        raise
    if len(done.bad) == len(paths):
        folder.remove(STATE_FILE)  # there is nothing to go on from
        first = next(iter(done.bad.values()))
        raise InputError(f"None of the {len(paths)} files can be used; the first: {first}")
    return done


def _read_report(found: FoundFiles, scan: Scan, done: ReadSoFar) -> dict[str, Any]:
    """Return the report as `read` gives it of all files together."""
    return whole_report(
        done.read,
        scan.of_one if isinstance(scan, RangedScan) else scan,
        order=[name_of(path) for path in found.paths],
        skipped=[
            {"name": path.name, "reason": done.bad[name_of(path)]} for path in found.paths if name_of(path) in done.bad
        ],
        passed_over=found.passed_over,
    )


def _read_all(
    left: Sequence[Path], asked: _Asked, folder: ResultFolder, done: ReadSoFar, progress: bool | None
) -> ReadSoFar:
    """Read the files that are left, and save what comes of it every now and then.

    They are taken for in the order of their names. If one begins before others end that had their turn, all are looked
    at first.
    """
    try:
        return _read_in_turn(left, asked, folder, done, progress, most=_LOOK_AHEAD)
    except NotInOrderError:
        for name in set(folder.names("records/part-")) - {part_file(index) for index in range(done.n_part)}:
            folder.remove(name)
        done = _save(folder, done, [], asked)
        return _read_in_turn(left, asked, folder, done, progress, most=len(left) + 1)


def _read_in_turn(
    left: Sequence[Path], asked: _Asked, folder: ResultFolder, done: ReadSoFar, progress: bool | None, *, most: int
) -> ReadSoFar:
    silent = None if progress is None else not progress
    blocks: list[xr.Dataset] = []
    n_byte = {path: path.stat().st_size for path in left}
    saved, wait = time.monotonic(), SAVE_SECONDS
    alone = 0  # files that did not go together with others
    with (
        progress_counter(sum(n_byte.values()), "reading", "B", scale=True, disable=silent) as bar,
        closing(read_ahead(left, asked.scan, asked.of_files, note=key_of, workers=asked.workers)) as read,
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
                except UNREADABLE as error:
                    if len(group) > 1 and all(one.samples is not None for one in group):
                        queue.put_back(group)
                        alone = len(group)
                        break
                    bad = _bad_one([one.path for one in group], error, asked)
                    done = with_files(done, {bad: keys[bad]}, bad={name_of(bad): in_words(error)})
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
                done = with_files(done, keys)
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


def _with_bad(done: ReadSoFar, queue: FileQueue, asked: _Asked, bar: Any, n_byte: Mapping[Path, int]) -> ReadSoFar:
    """Note the files of the queue that cannot be used, if they are to be skipped."""
    while queue.bad:
        path, key, error = queue.bad.pop(0)
        bad = _bad_one([path], error, asked)
        done = with_files(done, {bad: key}, bad={name_of(bad): in_words(error)})
        bar.update(n_byte[bad])
    return done


def _first_of(path: Path, asked: _Asked) -> np.datetime64 | Exception:
    """Return the first time of a file that is read in pieces; or what is wrong with it."""
    try:
        chunk = next(stream_files([path], asked.scan, asked.of_files, chunk_rows=_PEEK))
    except UNREADABLE as error:
        return error
    return np.datetime64(chunk["time"].values.min())


def _read(
    group: Sequence[Waiting], asked: _Asked, done: ReadSoFar, after: np.datetime64 | None
) -> tuple[ReadSoFar, list[xr.Dataset], np.datetime64] | np.datetime64:
    """Add files to the stream; or, if they reach beyond `after`, return how far, and nothing is added.

    What was added comes with the latest time in it.
    """
    state, read, blocks = done.state, done.read, []
    names = {one.path.name: name_of(one.path) for one in reversed(group)}
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
        return series_of_read(parts, asked.scan, asked.of_files, chunk_rows=asked.chunk_rows)
    return stream_files([one.path for one in group], asked.scan, asked.of_files, chunk_rows=asked.chunk_rows)


def _bad_one(group: Sequence[Path], error: BaseException, asked: _Asked) -> Path:
    """Return the file of a group that an error is about, if it is one to be skipped; else raise the error."""
    if isinstance(error, OSError) and error.errno in NOT_THE_FILE:
        raise error
    if not asked.skips:
        if isinstance(error, InputError):
            raise error
        names = ", ".join(repr(str(path)) for path in group)
        raise InputError(f"File {names} cannot be used: {in_words(error)}") from error
    for path in group:
        if len(group) == 1 or str(path) in str(error):
            return path
    for path in group:
        try:
            for _ in stream_files([path], asked.scan, asked.of_files):
                pass
        except UNREADABLE:
            return path
    return group[-1]  # each alone can be read: they do not go together


def _save(folder: ResultFolder, done: ReadSoFar, blocks: list[xr.Dataset], asked: _Asked) -> ReadSoFar:
    """Keep the new records, and what is done."""
    if not blocks:
        return save_state(folder, done, None)
    empty: IntArray = np.empty(0, dtype=np.int64)
    columns = {name: values[:0] for name, values in done.state.columns.items()}
    closed = replace(done.state, time=empty, beam=empty, columns=columns)
    return save_state(folder, done, join_blocks(blocks, closed, asked.scan, **asked.making))
