"""Records one by one, as they close: of a series that comes in chunks, on the clock or in a sliding window."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import check_count, check_non_negative, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.rules import QualityRules
from bayes_rs.quality.samples import IntArray
from bayes_rs.readers.ranged_series import scan_of_series, stacked
from bayes_rs.records.given import check_is_series
from bayes_rs.records.layout import REPORT
from bayes_rs.records.making import empty_record
from bayes_rs.records.record_options import record_options
from bayes_rs.records.stream import StreamState, add_chunk, join_blocks


@dataclass(frozen=True)
class _Lane:
    """The records that lie end to end, of all that a sliding window makes: a stream with a clock of its own."""

    offset: int
    state: StreamState = field(default_factory=StreamState)
    blocks: tuple[xr.Dataset, ...] = ()
    first: int | None = None
    """Time of the first sample on the lane's clock, ns."""
    next: int | None = None
    """Number of the first window that was not given out."""
    beams: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))


class ClosingRecords:
    """The records of a series that comes in chunks, each given out once it can change no more.

    Parameters
    ----------
    scan : Scan
        The scan that measured them.
    before : int
        So many records in a row before each are given out with it.
    every : float, optional
        A record begins every so many seconds, of which a whole number is the duration; by default one begins where the
        one before it ends.
    lateness : float
        How far, in seconds, a sample may come behind the latest one before it: records close so long after their end.
    quality : QualityRules, optional
        As for `make_records`.
    **options
        As for `make_records`.

    Raises
    ------
    InputError
        If an option is not valid.

    Notes
    -----
    A record is bit by bit what `make_records` makes of it in the whole series, with two exceptions. It has the beams
    that came so far. Whether blades pass is a matter of the whole series, and not tested. It is given out with the
    first sample that comes `lateness` after its end or later; whether the data are cut off within it is then known.
    Of several ranges records have the dimension ``range``. The first chunk says which ranges there are; one that ends
    while others go on has too few samples then, and is not said to be cut off. Those of a sliding window are the
    records of series whose clock is turned back by `every`, twice that, and so on.
    In memory are the samples of open records, and `before` records.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
    >>> closing = ClosingRecords(brs.load_scan("2-beam"))
    >>> [len(closing.add(series.isel(sample=slice(k, k + 800)))) for k in (0, 800, 1600)], len(closing.close())
    ([0, 1, 0], 1)
    """

    def __init__(
        self,
        scan: Scan,
        *,
        before: int = 0,
        every: float | None = None,
        lateness: float = 0.0,
        quality: QualityRules | None = None,
        **options: Any,
    ) -> None:
        self.scan = scan
        self.before = check_count(before, what="number of records before each", minimum=0)
        self.lateness = check_non_negative(lateness, what="lateness", unit="s")
        self._made: Mapping[str, Any] = {"quality": quality, **options}
        self._window = record_options(options).window
        self._every = self._window if every is None else _step(every, self._window)
        self._lanes = [_Lane(offset) for offset in range(0, self._window, self._every)]
        self._empty: dict[str, xr.Dataset] = {}
        self._closed = False

    def add(self, chunk: xr.Dataset) -> list[xr.Dataset]:
        """Take the next samples, and return the records that close with them.

        Parameters
        ----------
        chunk : Dataset
            Radial velocities, as `read` returns them, of any number. Repeated samples count once.

        Returns
        -------
        records : list of Dataset
            Of each record that closes, in the order of their starts, it and up to `before` records in a row before it:
            the record is the last.

        Raises
        ------
        InputError
            If the chunk is not valid, or a sample comes too late. Nothing of it is taken then.
        """
        check_is_series(chunk, ranges=True)
        if self._closed:
            raise InputError("This stream is closed and takes no more samples: begin a new one.")
        before, self.scan = self.scan, scan_of_series(chunk, self.scan)
        try:
            self._check_ranges(chunk, before)
            of_scan = stacked(chunk, self.scan) if isinstance(self.scan, RangedScan) else chunk
            lanes, found = [], []
            for lane in self._lanes:
                after, ready = self._added(lane, of_scan)
                lanes.append(after)
                found += ready
        except InputError:
            self.scan = before
            raise
        self._lanes = lanes
        return _in_order(found)

    def _check_ranges(self, chunk: xr.Dataset, before: Scan) -> None:
        """Refuse samples with ranges after others without, or the other way round."""
        began = any(lane.state.latest is not None for lane in self._lanes)
        if began and isinstance(before, RangedScan) != ("range" in chunk.variables):
            has, had = ("no", "a") if isinstance(before, RangedScan) else ("a", "no")
            raise InputError(
                f"These samples have {has} range, and those before have {had} range: give all as one scan reads them."
            )

    def close(self) -> list[xr.Dataset]:
        """Return the records that are still open, as `add` does, and take no more."""
        found = []
        for lane in self._lanes if not self._closed else []:
            if lane.state.latest is not None:
                found += self._ready(lane, lane.state, lane.state.latest // self._window + 1)
        self._closed = True
        return _in_order(found)

    def _added(self, lane: _Lane, chunk: xr.Dataset) -> tuple[_Lane, list[xr.Dataset]]:
        """Return a lane with the samples of a chunk, and the records that close."""
        shifted = _moved(chunk, -lane.offset)
        state, block = add_chunk(lane.state, shifted, self.scan, lateness=self.lateness, **self._made)
        if state.latest is None or state is lane.state:
            return lane, []
        if state.late:
            raise InputError(
                f"A sample came too late, {_said(state.first_late, lane.offset)}: its record is closed. Give a "
                "lateness (s) to wait so long with every record, or leave such samples out."
            )
        state = replace(state, source_files=())
        begin = int(shifted["time"].values.astype("datetime64[ns]").astype(np.int64).min())
        beams = np.unique(np.concatenate([lane.beams, chunk["beam"].values.astype(np.int64)]))
        lane = replace(
            lane,
            state=state,
            blocks=lane.blocks if block is None else (*lane.blocks, block),
            first=begin if lane.first is None else min(begin, lane.first),
            beams=beams,
        )
        # a record whose next window has no sample yet may still be one that the data end in
        limit = (int(state.latest or 0) - round(self.lateness * 1e9)) // self._window
        final = limit if np.any(state.time // self._window == limit) else limit - 1
        if not lane.blocks:
            return lane, []
        ready = self._ready(lane, state, final, later=int(state.time.min()) // self._window)
        if not ready:
            return lane, []
        begun = final if lane.next is None else max(final, lane.next)
        numbers = [_numbers(block, self._window) for block in lane.blocks]
        number = np.concatenate(numbers)
        before = number[number < begun - self.before]
        oldest = before.max() if len(before) else 0  # stays: it says where the empty records behind it begin
        kept = [
            block if own[0] >= oldest else block.isel(record=own >= oldest)
            for block, own in zip(lane.blocks, numbers, strict=True)
            if own[-1] >= oldest
        ]
        return replace(lane, next=begun, blocks=tuple(kept)), ready

    def _ready(self, lane: _Lane, rest: StreamState, final: int, later: int | None = None) -> list[xr.Dataset]:
        """Return the records of the windows from the next one of a lane until one that is not final.

        Those of the samples in `rest` are the last, but where these are still open: the first is in the window `later`.
        """
        first = _numbers(lane.blocks[0], self._window)[0] if lane.blocks else int(rest.time.min()) // self._window
        begin = int(first) if lane.next is None else lane.next
        # a sliding window lies within the data, to the next multiple of `every`
        start = (lane.first or 0) // self._every * self._every
        end = (int(rest.latest or 0) // self._every + 1) * self._every
        begin, final = max(begin, -(-start // self._window)), min(final, end // self._window)
        if final <= begin:
            return []
        if later is not None:
            none = {name: values[:0] for name, values in rest.columns.items()}
            rest = replace(rest, time=rest.time[:0], beam=rest.beam[:0], columns=none)
        samples = sum(_n_sample(block) for block in lane.blocks) + len(rest.time)
        joined = join_blocks(
            list(lane.blocks),
            replace(rest, samples=samples),
            self.scan,
            beams=lane.beams,
            empty=self._empty_like(rest),
            later=later,
            **self._made,
        )
        number = _numbers(joined, self._window)
        joined = _moved(joined, lane.offset)
        rows = np.flatnonzero((number >= begin) & (number < final)).tolist()
        firsts = np.searchsorted(number, number - self.before).tolist()
        return [joined.isel(record=slice(firsts[row], row + 1)) for row in rows]

    def _empty_like(self, state: StreamState) -> xr.Dataset:
        """Return a record without a sample of a series: made once, unless its columns or attributes change."""
        kinds = {name: values.dtype.str for name, values in state.columns.items()}
        key = f"{sorted(kinds.items())} {sorted(state.attributes.items())}"
        if key not in self._empty:
            scan = self.scan.at(0) if isinstance(self.scan, RangedScan) else self.scan
            some_beam = int(scan.beam[0])
            self._empty = {key: empty_record(state.columns, state.attributes, some_beam, scan, **self._made)}
        return self._empty[key]


def _step(every: float, window: int) -> int:
    """Return the time from one record of a sliding window to the next, ns."""
    step = round(check_positive(every, what="every", unit="s") * 1e9)
    if step == 0 or window % step:
        raise InputError(
            f"Invalid every {every!r} s: a whole number of it must be the duration of a record, {window / 1e9:g} s; "
            f"{window / 1e10:g} gives ten records in that time."
        )
    return step


def _numbers(block: xr.Dataset, window: int) -> IntArray:
    """Return the numbers of the windows of records, since 1970."""
    return np.asarray(block["time"].values.astype("datetime64[ns]").astype(np.int64) // window)


def _n_sample(block: xr.Dataset) -> int:
    """Return how many samples records were made of; of several ranges they are counted range by range elsewhere."""
    return int(json.loads(block.attrs[REPORT])["samples"]) if REPORT in block.attrs else 0


def _moved(dataset: xr.Dataset, offset: int) -> xr.Dataset:
    """Return samples or records whose times are later by so many ns."""
    if offset == 0:
        return dataset
    time = dataset["time"]
    return dataset.assign_coords(time=(time.dims, time.values + np.timedelta64(offset, "ns"), time.attrs))


def _in_order(found: list[xr.Dataset]) -> list[xr.Dataset]:
    return sorted(found, key=lambda records: records["time"].values[-1].astype(np.int64))


def _said(words: str, offset: int) -> str:
    """Return what `StreamState` says of a late sample of a lane, whose clock is turned back."""
    return words if offset == 0 else f"{words} (less {offset / 1e9:g} s)"
