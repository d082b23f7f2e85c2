"""Records from chunks: those of the whole series, bit by bit, wherever the chunks end."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.quality import QualityRules
from bayes_rs.records.making import make_records
from bayes_rs.records.stream import StreamState, add_chunk, join_blocks, stream_records

START = np.datetime64("2020-09-03T19:03:20", "ns")  # within a record
SCAN = load_scan("6-beam")
DURATION = 60.0


def make_series(seed=1, n_second=700):
    """Gaps of many records, a beam that is absent for long, repeated and missing samples, CNR and status."""
    rng = np.random.default_rng(seed)
    second = np.repeat(np.arange(n_second), 6)
    beam = np.tile(np.arange(6), n_second)
    velocity = -9.0 + rng.normal(size=len(beam)) + 0.2 * beam
    velocity[rng.random(len(beam)) < 0.02] = np.nan
    velocity[rng.random(len(beam)) < 0.02] += 40.0
    keep = (second < 150) | (second >= 400)  # four empty records between
    keep &= ~((beam == 3) & (second < 500))
    keep &= ~((beam == 5) & (second > 100))
    rows = np.flatnonzero(keep)
    rows = np.sort(np.concatenate([rows, rng.choice(rows, 20)]))  # some twice
    return xr.Dataset(
        {
            "radial_velocity": ("sample", velocity[rows]),
            "cnr": ("sample", rng.normal(-15.0, 5.0, len(beam))[rows]),
            "status": ("sample", (rng.random(len(beam)) < 0.95).astype(float)[rows]),
        },
        coords={
            "time": ("sample", (START + second * np.timedelta64(1, "s"))[rows]),
            "beam": ("sample", beam[rows]),
        },
        attrs={"status_valid": 1.0},
    )


SERIES = make_series()
OPTIONS = {
    "duration": DURATION,
    "min_availability": 0.5,
    "quality": QualityRules(cnr_range=(-25.0, 0.0), despike="median", despike_threshold=2.0),
}
WHOLE = make_records(SERIES, SCAN, **OPTIONS)


def chunks(series, edges):
    ends = [0, *sorted(edges), series.sizes["sample"]]
    for first, end in itertools.pairwise(ends):
        yield series.isel(sample=slice(first, end))


def same(one, other):
    """Check that records are the same, bit by bit, with their attributes and reports."""
    xr.testing.assert_identical(one.drop_attrs(deep=False), other.drop_attrs(deep=False))
    for name in (*one.data_vars, *one.coords):
        assert one[name].dtype == other[name].dtype
        assert one[name].values.tobytes() == other[name].values.tobytes()
    reports = [json.loads(of.attrs["records_report"]) for of in (one, other)]
    assert reports[0] == reports[1]
    assert {**one.attrs, "records_report": ""} == {**other.attrs, "records_report": ""}


class TestChunks:
    @given(edges=st.lists(st.integers(0, SERIES.sizes["sample"]), max_size=40))
    @settings(max_examples=60, deadline=None)
    def test_no_number_depends_on_where_they_end(self, edges):
        same(stream_records(chunks(SERIES, edges), SCAN, **OPTIONS), WHOLE)

    @pytest.mark.parametrize("size", [1, 7, 360, 100_000])
    def test_nor_on_their_size(self, size):
        some = SERIES.isel(sample=slice(0, 1500))
        edges = range(size, some.sizes["sample"], size)
        same(stream_records(chunks(some, edges), SCAN, **OPTIONS), make_records(some, SCAN, **OPTIONS))

    def test_the_series_has_what_chunks_can_spoil(self):
        report = json.loads(WHOLE.attrs["records_report"])
        assert report["records_without_samples"] == 4
        assert min(report["duplicates_dropped"], *report["dropped"].values()) > 0
        assert {name for name, counted in report["beam_flags"].items() if counted["count"]} >= {
            "too_few_samples",
            "no_samples",
        }

    def test_samples_out_of_order_are_sorted_across_chunks(self):
        rng = np.random.default_rng(2)
        second = (SERIES["time"].values - START) / np.timedelta64(1, "s")
        shuffled = SERIES.isel(sample=np.argsort(second + rng.uniform(0.0, 50.0, len(second)), kind="stable"))
        whole = make_records(shuffled, SCAN, **OPTIONS)
        assert json.loads(whole.attrs["records_report"])["samples_out_of_order"] > 100
        same(stream_records(chunks(shuffled, range(100, 3000, 100)), SCAN, **OPTIONS), whole)

    def test_memory_holds_only_open_records(self):
        state, largest = StreamState(), 0
        for chunk in chunks(SERIES, range(50, SERIES.sizes["sample"], 50)):
            state, _ = add_chunk(state, chunk, SCAN, **OPTIONS)
            largest = max(largest, len(state.time))
        assert largest <= 3 * 60 * 6  # the record of the latest sample, the one before, and what is over of a chunk

    def test_files_are_named_in_order_and_once(self):
        parts = [
            chunk.assign_attrs(source_files=json.dumps([name]))
            for chunk, name in zip(chunks(SERIES, [500, 900]), ("b.csv", "b.csv", "a.csv"), strict=True)
        ]
        assert json.loads(stream_records(parts, SCAN, **OPTIONS).attrs["source_files"]) == ["b.csv", "a.csv"]


class TestLateSamples:
    def test_they_are_counted_and_the_first_is_named(self):
        late = SERIES.isel(sample=[6, 7, 8])
        series = xr.concat([SERIES.isel(sample=slice(0, 1500)), late, SERIES.isel(sample=slice(1500, None))], "sample")
        found = [stream_records(chunks(series, edges), SCAN, **OPTIONS) for edges in ([], [1501], [3, 800, 1600])]
        report = json.loads(found[0].attrs["records_report"])
        assert report["samples_late"] == 3
        first, latest = (str(of.values.astype("datetime64[ms]")) for of in (late["time"][0], series["time"][1499]))
        assert report["first_late"] == f"beam {int(late['beam'][0])} at {first}Z, after a sample of {latest}Z"
        for other in found[1:]:
            same(found[0], other)
        np.testing.assert_array_equal(found[0]["variance"], WHOLE["variance"])

    def test_lateness_says_how_late(self):
        late = SERIES.isel(sample=slice(6, 9))
        series = xr.concat([SERIES.isel(sample=slice(0, 1500)), late, SERIES.isel(sample=slice(1500, None))], "sample")
        found = stream_records(chunks(series, range(100, 2500, 100)), SCAN, lateness=1000.0, **OPTIONS)
        same(found, make_records(series, SCAN, **OPTIONS))


class TestRefused:
    def test_no_sample(self):
        with pytest.raises(InputError, match=r"Invalid series: it holds no sample; give files with samples"):
            stream_records([], SCAN)
        with pytest.raises(InputError, match=r"Invalid series: it holds no sample"):
            stream_records([SERIES.isel(sample=[])], SCAN)

    @pytest.mark.parametrize(
        "change",
        [
            lambda block: block.rename_vars(variance="variance_x"),
            lambda block: block.isel(part=slice(2)),
            lambda block: block.drop_vars("count"),
        ],
    )
    @pytest.mark.parametrize("first", [True, False])
    def test_blocks_of_another_layout(self, change, first):
        """As one that was changed on the disk, with its fingerprint."""
        blocks = [WHOLE, change(WHOLE)] if first else [change(WHOLE), WHOLE]
        closed = StreamState(columns=dict.fromkeys(("radial_velocity", "cnr", "status"), np.empty(0)))
        with pytest.raises(InputError, match=r"do not go with the others, in .*: overwrite the folder"):
            join_blocks(blocks, closed, SCAN, **OPTIONS)

    def test_chunks_that_differ(self):
        one, other = chunks(SERIES, [500])
        with pytest.raises(
            InputError, match=r"The chunks of a series differ: only the earlier ones have cnr: give fil"
        ):
            stream_records([one, other.drop_vars("cnr")], SCAN)
        with pytest.raises(InputError, match=r"The chunks of a series differ: only a later one has cnr"):
            stream_records([one.drop_vars("cnr"), other], SCAN)
        with pytest.raises(InputError, match=r"different statuses as valid, 1.0 and 2.0: give one with the option"):
            stream_records([one, other.assign_attrs(status_valid=2.0)], SCAN)

    def test_what_is_no_series(self):
        with pytest.raises(InputError, match=r"Invalid chunk of a series: it needs 'beam' over the dimension 'sample'"):
            stream_records([SERIES.drop_vars("beam")], SCAN)
        with pytest.raises(InputError, match=r"every time must be a UTC time of type datetime64"):
            stream_records([SERIES.assign_coords(time=("sample", np.arange(SERIES.sizes["sample"])))], SCAN)
        with pytest.raises(InputError, match=r"Unknown beam 77 in a chunk of a series: the beams of the scan '6-beam'"):
            stream_records([SERIES.assign_coords(beam=SERIES["beam"].where(SERIES["beam"] != 5, 77))], SCAN)

    def test_lateness(self):
        with pytest.raises(InputError, match=r"Invalid lateness -1"):
            stream_records([SERIES], SCAN, lateness=-1.0)
