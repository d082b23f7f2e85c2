"""Records as they close: those of the whole series, bit by bit, one by one, also of a sliding window."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from test_record_stream import OPTIONS, SCAN, SERIES, WHOLE, chunks

from bayes_rs.errors import InputError
from bayes_rs.records.closing import ClosingRecords
from bayes_rs.records.making import make_records


def closed(parts, **options):
    """Return what the chunks close, and what is left at the end."""
    closing = ClosingRecords(SCAN, **OPTIONS, **options)
    found = [closing.add(part) for part in parts]
    return [*itertools.chain.from_iterable(found), *closing.close()]


def same_record(one, whole, row):
    """Check the last record against a row of others, bit by bit; before all beams came, what is of a beam alone."""
    other = whole.isel(record=[row]).sel(beam=one["beam"].values)
    every = other.sizes["beam"] == whole.sizes["beam"]
    for name in (*one.data_vars, "time"):
        if every or "beam" in one[name].dims:
            assert one[name].values[-1:].tobytes() == other[name].values.tobytes(), name
    for name in ("wind_speed", "yaw"):  # of sums with fewer zeros
        np.testing.assert_allclose(one[name].values[-1:], other[name].values, rtol=1e-12)
    return every


class TestOnTheClock:
    @given(edges=st.lists(st.integers(0, SERIES.sizes["sample"]), max_size=30))
    @settings(max_examples=15, deadline=None)
    def test_each_is_that_of_the_whole_series(self, edges):
        found = closed(chunks(SERIES, edges))
        assert len(found) == WHOLE.sizes["record"]  # also the empty ones
        assert all(one.sizes["record"] == 1 for one in found)
        assert sum(same_record(one, WHOLE, row) for row, one in enumerate(found)) >= 4

    @pytest.mark.parametrize("lateness", [20.0, 60.0, 200.0])
    def test_also_if_samples_come_late(self, lateness):
        rng = np.random.default_rng(2)
        second = SERIES["time"].values.astype(np.int64) / 1e9
        late = np.argsort(second + rng.uniform(0.0, 0.9 * lateness, len(second)), kind="stable")
        found = closed(chunks(SERIES.isel(sample=late), range(50, 3000, 50)), lateness=lateness)
        assert len(found) == WHOLE.sizes["record"]
        for row, one in enumerate(found):
            same_record(one, WHOLE, row)

    def test_those_before_come_with_each(self):
        found = closed(chunks(SERIES, range(30, 3000, 30)), before=3)
        for row, one in enumerate(found):
            assert one.sizes["record"] == min(row, 3) + 1
            beams = one["beam"].values
            for place, before in enumerate(range(max(row - 3, 0), row + 1)):
                if before < len(found) and np.array_equal(found[before]["beam"].values, beams):
                    same_record(one.isel(record=slice(0, place + 1)), WHOLE, before)

    def test_a_record_waits_until_it_is_known_whether_the_data_go_on(self):
        """Whether the data end within it decides how its beams are flagged, and a sample may still come late."""
        time = SERIES["time"].values
        some = SERIES.isel(sample=time < np.datetime64("2020-09-03T19:05"))
        closing = ClosingRecords(SCAN, **OPTIONS, lateness=20.0)
        assert len(closing.add(some)) == 1

        def one_at(second):
            return some.isel(sample=[0]).assign_coords(time=("sample", [np.datetime64(f"2020-09-03T19:06:{second}")]))

        assert closing.add(one_at(10)) == []  # one of 19:05 may come
        assert len(closing.add(one_at(30))) == 2
        assert len(closing.close()) == 1

    def test_memory_holds_open_records_and_those_before(self):
        closing, largest = ClosingRecords(SCAN, **OPTIONS, before=2), 0
        for part in chunks(SERIES, range(50, SERIES.sizes["sample"], 50)):
            closing.add(part)
            (lane,) = closing._lanes
            largest = max(largest, sum(block.sizes["record"] for block in lane.blocks))
            assert len(lane.state.time) <= 60 * 6 + 50
        assert largest <= 3 + 1


class TestSlidingWindow:
    def test_each_is_one_of_a_series_with_another_clock(self):
        found = closed(chunks(SERIES, range(100, 3000, 100)), every=20.0)
        starts = [one["time"].values[-1] for one in found]
        assert starts == sorted(starts)
        assert set(np.diff(np.array(starts)).tolist()) == {20_000_000_000}
        shifted = {}
        for offset in (0, 20, 40):
            moved = SERIES.assign_coords(time=SERIES["time"] - np.timedelta64(offset, "s"))
            whole = make_records(moved, SCAN, **OPTIONS)
            shifted[offset] = whole.assign_coords(time=whole["time"] + np.timedelta64(offset, "s"))
        for one, start in zip(found, starts, strict=True):
            whole = shifted[int(start.astype(np.int64) // 10**9 % 60)]
            same_record(one, whole, int(np.flatnonzero(whole["time"].values == start)[0]))

    def test_it_lies_within_the_data(self):
        found = closed(chunks(SERIES, range(100, 3000, 100)), every=20.0)
        first, last = SERIES["time"].values[[0, -1]]
        assert found[0]["time"].values[-1] == first - np.timedelta64(0, "s")  # 19:03:20 is a multiple of 20 s
        end = found[-1]["time"].values[-1] + np.timedelta64(60, "s")
        assert last < end <= last + np.timedelta64(20, "s")

    def test_records_before_one_lie_end_to_end(self):
        found = closed(chunks(SERIES, range(100, 3000, 100)), every=20.0, before=2)
        steps = np.diff(found[10]["time"].values)
        assert steps.tolist() == [60_000_000_000] * 2

    @pytest.mark.parametrize("every", [7.0, 120.0, 1e-12])
    def test_the_duration_is_a_whole_number_of_it(self, every):
        with pytest.raises(InputError, match="a whole number of it must be the duration of a record, 60 s"):
            ClosingRecords(SCAN, **OPTIONS, every=every)


class TestRefused:
    def test_a_sample_of_a_closed_record(self):
        closing = ClosingRecords(SCAN, **OPTIONS)
        parts = list(chunks(SERIES, [400, 800]))
        closing.add(parts[0])
        assert len(closing.add(parts[1])) > 0
        with pytest.raises(InputError, match=r"came too late, beam . at 2020-09-03T19:0.*Give a lateness"):
            closing.add(parts[0])
        assert len([*closing.add(parts[2]), *closing.close()]) > 0  # nothing of it was taken

    def test_repeated_samples_of_an_open_record_count_once(self):
        some = SERIES.isel(sample=slice(0, 300))
        once = closed([some])
        twice = closed([some.isel(sample=slice(0, 200)), some.isel(sample=slice(150, 300))])
        same_record(twice[0], once[0], 0)

    def test_of_two_values_of_one_beam_and_time_the_first_counts(self):
        """As in records of the whole series."""
        some = SERIES.isel(sample=slice(0, 200))
        other = some.assign(radial_velocity=some["radial_velocity"] + 1.0)
        one, *_ = closed([some, other])
        whole = make_records(xr.concat([some, other], "sample"), SCAN, **OPTIONS)
        same_record(one, whole, 0)

    def test_what_comes_after_the_end(self):
        closing = ClosingRecords(SCAN, **OPTIONS)
        closing.add(SERIES)
        closing.close()
        assert closing.close() == []
        with pytest.raises(InputError, match="closed and takes no more"):
            closing.add(SERIES)

    def test_what_is_no_series(self):
        with pytest.raises(InputError, match="Invalid series"):
            ClosingRecords(SCAN, **OPTIONS).add(WHOLE)

    def test_no_sample_is_no_harm(self):
        closing = ClosingRecords(SCAN, **OPTIONS)
        assert closing.add(SERIES.isel(sample=slice(0, 0))) == []
        assert closing.close() == []
        assert isinstance(SERIES, xr.Dataset)
