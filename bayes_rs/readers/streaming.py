"""Radial velocities as a stream: series after series in time's order, with bounded memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import check_count, check_positive
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.quality.samples import ends_by_beam
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.levels import scan_at_ranges
from bayes_rs.readers.one_file import SUFFIXES, read_pieces
from bayes_rs.readers.ranged_series import with_ranges
from bayes_rs.readers.reading import checked_options
from bayes_rs.readers.samples import (
    FilesReport,
    Samples,
    as_utc,
    check_order,
    count_backwards,
    join_samples,
    no_sample,
    none_read,
    time_goes_backwards,
)
from bayes_rs.readers.used_options import check_used

HOLD_BACK = np.timedelta64(60, "s")
"""How far the samples of one file may be out of time's order, over the border of two pieces."""

_PEEK = 1000
_EVER = np.datetime64(np.iinfo(np.int64).min // 2, "ns")
_NEVER = np.datetime64(np.iinfo(np.int64).max, "ns")


def stream(
    files: str | Path | Sequence[str | Path],
    scan: str | Path | Scan,
    *,
    chunk_rows: int = 500_000,
    period: float | None = None,
    **options: Any,
) -> Iterator[xr.Dataset]:
    r"""Read a lidar's radial velocities piece by piece, in the order of time.

    Parameters
    ----------
    files : str, Path or sequence of them
        As for `read`; they may overlap, and are taken in the order of their first times.
    scan : Scan, str or Path
        The scan that the files were measured with, or its name or file.
    chunk_rows : int
        Rows of a text or Parquet file that are read at a time. A NetCDF file, or another that holds rays, is read
        whole.
    period : float, optional
        If given, in seconds, a series ends only at a whole multiple of it since 1970-01-01 00:00 UTC, so that no
        record of this duration is torn.
    **options
        How the files are written, as for `read`: the fields of `bayes_rs.readers.FileOptions`.

    Returns
    -------
    chunks : iterator of xarray.Dataset
        Series as `read` returns them, with the same attributes. No sample of a series is earlier than
        one of the series before it; put together they are what `read` returns. The counts in
        ``attrs["read_report"]`` are those of the rows that a series brings in, so that they add up. With
        ``on_bad_file="skip"`` what a file gave before its fault stays in the stream.

    Raises
    ------
    InputError
        As `read`; and if a file is so far from the order of time that a sample comes more than a
        minute after later ones in the rows read before it.

    Notes
    -----
    What is in memory is one piece of each file whose times overlap, with the part of the series that is not yet
    complete: with ``period``, at most one period more. With ``out_of_order="sort"`` samples are sorted within the
    pieces in memory.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "day.csv"
    ...     rows = [f"2020-09-03T19:{minute:02d}:00,0,{minute}\n" for minute in range(4)]
    ...     _ = file.write_text("time,beam,radial_velocity\n" + "".join(rows))
    ...     pieces = stream(file, "staring", chunk_rows=2, period=60.0)
    ...     [series["radial_velocity"].values.tolist() for series in pieces]
    [[0.0, 1.0], [2.0, 3.0]]
    """
    of_scan = as_scan(scan)
    chosen = checked_options(options, of_scan)
    n_row = check_count(chunk_rows, what="chunk_rows")
    window = None if period is None else round(check_positive(period, what="period", unit="s") * 1e9)
    if window == 0:
        raise InputError(f"Invalid period {period!r} s: it must be at least a nanosecond.")
    found = find_files(files, SUFFIXES)
    check_used(found.paths, of_scan, chosen)
    return stream_files(found.paths, of_scan, chosen, chunk_rows=n_row, window=window, passed_over=found.passed_over)


def stream_files(
    paths: Sequence[Path],
    scan: Scan,
    options: FileOptions,
    *,
    chunk_rows: int = 500_000,
    window: int | None = None,
    passed_over: Mapping[str, int] | None = None,
) -> Iterator[xr.Dataset]:
    """Give the series of files that are there, as `stream` does, with options that are right; a window is in ns."""
    at_ranges = scan_at_ranges(paths, scan, options)
    return _Merge(at_ranges, options, chunk_rows, dict(passed_over or {})).series(paths, window)


def series_of_read(
    parts: Sequence[Samples], scan: Scan, options: FileOptions, *, chunk_rows: int
) -> Iterator[xr.Dataset]:
    """Give the series of files that were read already, as `stream` gives them; at once if none overlaps the next."""
    times = [(part.time.min(), part.time.max()) for part in parts]
    if all(one[1] < other[0] for one, other in pairwise(times)):
        for part in parts:
            if part.file_format.out_of_order == "error":
                check_order(part)
        yield with_ranges(join_samples(parts, scan), scan)
        return
    merged = _Merge(scan, options, chunk_rows, {}, kept={part.file: part for part in parts})
    yield from merged.series([part.file for part in parts], None)


@dataclass
class _Source:
    """One file that is being read: its pieces, and how far it has come."""

    file: Path
    pieces: Iterator[Samples]
    reached: np.datetime64 = _EVER
    n_row: int = 0
    n_cut: int = 0
    latest: dict[int, np.datetime64] = field(default_factory=dict)


@dataclass
class _Merge:
    """The state of one stream."""

    scan: Scan
    options: FileOptions
    n_row: int
    passed_over: dict[str, int]
    held: list[Samples] = field(default_factory=list)
    kept: dict[Path, Samples] = field(default_factory=dict)
    """Short files that were read to learn their first times, and need not be read again."""
    skipped: list[dict[str, str]] = field(default_factory=list)
    given_out: np.datetime64 = _EVER

    def series(self, paths: Sequence[Path], window: int | None) -> Iterator[xr.Dataset]:
        waiting = self._by_first_time(paths)
        active: list[_Source] = []
        n_given = 0
        while waiting or active:
            while waiting and (not active or waiting[0][0] <= min(source.reached for source in active)):
                _, file = waiting.pop(0)
                source = _Source(file, self._pieces(file))
                active += [source] if self._advance(source) else []
            if active:
                slowest = min(active, key=lambda source: source.reached)
                if not self._advance(slowest):
                    active.remove(slowest)
            until = min(
                [source.reached - HOLD_BACK for source in active] + [first for first, _ in waiting[:1]],
                default=_NEVER,
            )
            series = self._give_out(until, window)
            if series is not None:
                n_given += 1
                yield series
        if n_given == 0:
            raise none_read(len(paths), self.skipped[0]["reason"])

    def _by_first_time(self, paths: Sequence[Path]) -> list[tuple[np.datetime64, Path]]:
        if len(paths) == 1:
            return [(_EVER, paths[0])]
        firsts = []
        for file in paths:
            if file in self.kept:
                firsts.append((self.kept[file].time.min() - HOLD_BACK, file))
                continue
            try:
                pieces = read_pieces(file, self.scan, self.options, _PEEK)
                part = next(pieces)
                is_whole = next(pieces, None) is None
            except InputError as error:
                self._skip(file, error)
                continue
            firsts.append((part.time.min() - HOLD_BACK if len(part.time) else _EVER, file))
            if is_whole and len(part.time) + sum(len(kept.time) for kept in self.kept.values()) <= self.n_row:
                self.kept[file] = part
        return sorted(firsts, key=lambda pair: pair[0])

    def _pieces(self, file: Path) -> Iterator[Samples]:
        if file in self.kept:
            return iter([self.kept.pop(file)])
        return read_pieces(file, self.scan, self.options, self.n_row)

    def _advance(self, source: _Source) -> bool:
        """Read the next piece of a file; False at its end."""
        try:
            part = next(source.pieces, None)
            if part is None:
                if not source.latest:
                    raise no_sample(source.file, source.n_row, source.n_cut)
                return False
            if part.file_format.out_of_order == "error":
                check_order(part)
            out_of_order = count_backwards(part, source.latest)
            self._check_order(part, source)
        except InputError as error:
            self._skip(source.file, error)
            return False
        source.n_row += part.counts.get("rows", 0)
        source.n_cut += part.counts.get("rows_cut", 0)
        self.held.append(replace(part, out_of_order=out_of_order))
        if len(part.time):
            source.reached = max(source.reached, part.time.max())
        return True

    def _check_order(self, part: Samples, source: _Source) -> None:
        early = part.time < self.given_out
        if early.any():
            index = int(np.argmax(early))
            raise InputError(
                f"Time goes backwards in {part.where(index)}: {as_utc(part.time[index])} comes after "
                f"{as_utc(self.given_out)}, which was given out; sort the file by time, or give a larger chunk_rows."
            )
        for beam, (begin, end) in ends_by_beam(part.time.astype(np.int64), part.beam).items():
            first, last = np.datetime64(begin, "ns"), np.datetime64(end, "ns")
            before = source.latest.get(beam)
            if before is not None and part.file_format.out_of_order == "error" and first < before:
                index = int(np.argmax(part.beam == beam))
                raise time_goes_backwards(part, index, before, "in the rows above")
            source.latest[beam] = last if before is None else max(before, last)

    def _give_out(self, until: np.datetime64, window: int | None) -> xr.Dataset | None:
        if not self.held:
            return None
        if window is not None and until != _NEVER:
            until = np.datetime64(int(until.astype(np.int64)) // window * window, "ns")
        ready: list[Samples] = []
        later: list[Samples] = []
        for part in self.held:
            before = part.time < until
            if before.all():
                ready.append(part)
            elif not before.any():
                later.append(part)
            else:
                ready.append(part.select(np.flatnonzero(before), with_counts=True))
                later.append(part.select(np.flatnonzero(~before), with_counts=False))
        n_sample = sum(len(part.time) for part in ready)
        if n_sample == 0 or (until != _NEVER and 2 * n_sample < self.n_row):  # many short files make one series
            return None
        self.held, self.given_out = later, until
        report = FilesReport(skipped=self.skipped, passed_over=self.passed_over)
        self.skipped, self.passed_over = [], dict.fromkeys(self.passed_over, 0)
        return with_ranges(join_samples(ready, self.scan, report=report), self.scan)

    def _skip(self, file: Path, error: InputError) -> None:
        if self.options.on_bad_file == "error":
            raise error
        self.skipped.append({"name": file.name, "reason": str(error)})
