"""Files read ahead of those that are being used, in their order, by one process or by several."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loky import ProcessPoolExecutor

from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.processor import end_with, one_thread
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.one_file import read_if_whole
from bayes_rs.readers.samples import Samples, no_sample

_FEWEST = 500
"""Files for which other processes are started: that takes some seconds."""
_SHARE = 16
"""Files that a process reads at a time: handing over one costs as much as reading it."""
_AHEAD = 2
"""Shares that a process has waiting."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ReadFile:
    """A file that was read whole.

    Parameters
    ----------
    file : Path
        The file.
    before : object
        What was noted of it before it was read.
    samples : Samples or None
        What it holds; None if its format is read in pieces, or if it cannot be used.
    error : Exception or None
        What is wrong with it.
    """

    file: Path
    before: Any
    samples: Samples | None
    error: Exception | None = None


def read_ahead(
    files: Sequence[Path],
    scan: Scan,
    options: FileOptions,
    *,
    note: Callable[[Path], Any],
    workers: int = 1,
) -> Generator[ReadFile, None, None]:
    """Read files whole, those whose format is not read in pieces.

    Parameters
    ----------
    files : sequence of Path
        The files.
    scan : Scan
        The scan they were measured with.
    options : FileOptions
        How they are written.
    note : callable
        What is to be noted of a file before it is read; defined in a module.
    workers : int
        Processes that share the work, if there are many files; with one, this process reads each file when it is asked
        for.

    Yields
    ------
    read : ReadFile
        The files in their order, whoever has read them: the results are the same for any number of workers. What is in
        memory is a few dozen files for each worker.
    """
    if workers == 1 or len(files) < _FEWEST:
        yield from (_read(file, scan, options, note) for file in files)
        return
    shares = iter([files[start : start + _SHARE] for start in range(0, len(files), _SHARE)])
    waiting: deque[tuple[Sequence[Path], Future[list[ReadFile]]]] = deque()
    # loky: its processes start clean, and need no guard in the user's script
    pool = ProcessPoolExecutor(workers, initializer=end_with, initargs=(os.getpid(),))
    try:
        while True:
            while len(waiting) < _AHEAD * workers and (share := next(shares, None)) is not None:
                waiting.append((share, pool.submit(_read_share, share, scan, options, note)))
            if not waiting:
                break
            try:
                done = waiting[0][1].result()
            except BrokenProcessPool:
                _log.warning("A process that reads files died; this one reads those that are left.")
                left = [*(share for share, _ in waiting), *shares]
                yield from (_read(file, scan, options, note) for share in left for file in share)
                break
            waiting.popleft()
            yield from done
    finally:
        pool.shutdown(kill_workers=True)


def _read_share(files: Sequence[Path], scan: Scan, options: FileOptions, note: Callable[[Path], Any]) -> list[ReadFile]:
    with one_thread():
        return [_read(file, scan, options, note) for file in files]


def _read(file: Path, scan: Scan, options: FileOptions, note: Callable[[Path], Any]) -> ReadFile:
    before = note(file)
    try:
        samples = read_if_whole(file, scan, options)
        if samples is not None and len(samples.time) == 0:
            raise no_sample(file, samples.counts.get("rows", 0))
    except UNREADABLE as error:
        return ReadFile(file, before, None, error)
    return ReadFile(file, before, samples)
