"""Long tables of several ranges: the rows at the scan's distances, and never a mixture of them."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
import pytest

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers import READERS, read, stream
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.long_table import ranges_of_table
from bayes_rs.records import describe_report, make_records

FOUR = brs.load_scan("pulsed-4-beam", focus_distance=178.0)
RANGES = (80.0, 120.0, 178.0, 240.0, 300.0)
VARIANCE = dict(zip(RANGES, (0.1, 0.5, 1.0, 2.0, 3.0), strict=True))
OTHERS = {"columns": {"range": "Distance"}}


def table(*, n_scan=150, seed=1, ranges=RANGES, heading="Distance"):
    """Return ten minutes of the four-beam lidar, each range with a variance of its own."""
    rng = np.random.default_rng(seed)
    frames = []
    for scan in range(n_scan):
        for beam in range(4):
            time = pd.Timestamp("2024-03-01T10:00:00") + pd.Timedelta(seconds=4 * scan + beam)
            for distance in ranges:
                speed = -10.0 + np.sqrt(VARIANCE[distance]) * rng.standard_normal()
                frames.append((time.isoformat(), beam, distance, round(-speed, 3), -12.0, 1))
    return pd.DataFrame(frames, columns=["Timestamp", "LOSindex", heading, "RWS", "CNR", "RWSStatus"])


def independent(frame, distance):
    chosen = frame[frame.iloc[:, 2] == distance]
    return [np.var(chosen.loc[chosen["LOSindex"] == beam, "RWS"].to_numpy()) for beam in range(4)]


def counts_of(series):
    (file,) = json.loads(series.attrs["read_report"])["files"]
    return file


class TestOneDistance:
    @pytest.mark.parametrize("suffix", ["csv", "parquet", "csv.gz"])
    def test_the_variance_is_that_of_the_scans_distance(self, tmp_path, suffix):
        """The shipped preset and a file of five distances: with 80 m in place of 178 m it would be 0.1."""
        frame, file = table(), tmp_path / f"day.{suffix}"
        frame.to_parquet(file) if suffix == "parquet" else frame.to_csv(file, index=False)
        series = read(file, FOUR)
        found = make_records(series, FOUR)["variance"].values[0]
        np.testing.assert_allclose(found, independent(frame, 178.0), rtol=1e-12)
        assert 0.7 < found.mean() < 1.3
        told = counts_of(series)
        assert (told["rows"], told["rows_of_other_ranges"], told["rows_dropped"]) == (3000, 2400, 0)
        assert (told["ranges"], told["ranges_used"]) == (list(RANGES), [178.0])
        assert "; 2400 of other ranges; ranges read: 178 of 80, 120, 178, 240, 300 m" in describe_report(series)[0]

    @pytest.mark.parametrize("distance", RANGES)
    def test_each_distance(self, tmp_path, distance):
        frame = table()
        frame.to_csv(tmp_path / "day.csv", index=False)
        scan = brs.load_scan("pulsed-4-beam", focus_distance=distance)
        found = make_records(read(tmp_path / "day.csv", scan), scan)["variance"].values[0]
        np.testing.assert_allclose(found, independent(frame, distance), rtol=1e-12)

    @pytest.mark.parametrize("rows", [1, 7, 100, 5000])
    def test_pieces_give_the_same(self, tmp_path, rows):
        """A piece does not hold all ranges: the file's do count."""
        file = tmp_path / "day.csv"
        table(n_scan=20).to_csv(file, index=False)
        whole, parts = read(file, FOUR), list(stream(file, FOUR, chunk_rows=rows))
        for name in ("time", "beam", "radial_velocity", "cnr"):
            np.testing.assert_array_equal(np.concatenate([part[name].values for part in parts]), whole[name].values)
        assert sum(json.loads(part.attrs["read_report"])["rows_of_other_ranges"] for part in parts) == 320

    def test_ranges_one_after_another(self, tmp_path):
        frame = table(n_scan=20).sort_values(["Distance", "Timestamp"])
        frame.to_csv(tmp_path / "day.csv", index=False)
        assert read(tmp_path / "day.csv", FOUR).sizes["sample"] == 80

    def test_the_tolerance(self, tmp_path):
        file = tmp_path / "day.csv"
        table(n_scan=2).to_csv(file, index=False)
        near = brs.load_scan("pulsed-4-beam", focus_distance=200.0)
        assert counts_of(read(file, near))["ranges_used"] == [178.0]  # within half of 62 m
        assert counts_of(read(file, near, range_tolerance=22.0))["ranges_used"] == [178.0]
        with pytest.raises(InputError, match=r"No row of file .* is at a distance of scan 'pulsed-4-beam'"):
            read(file, near, range_tolerance=21.9)

    def test_one_range_may_be_a_twentieth_off(self, tmp_path):
        file = tmp_path / "day.csv"
        table(n_scan=2, ranges=(178.0,)).to_csv(file, index=False)
        assert read(file, brs.load_scan("pulsed-4-beam", focus_distance=187.0)).sizes["sample"] == 8
        message = (
            f"No row of file {str(file)!r} is at a distance of scan 'pulsed-4-beam': the ranges in "
            "column 'Distance' are 178 m, and the scan's distances 188 m; give the scan one of the file's as "
            "focus_distance (--focus-distance), or a larger range_tolerance (--range-tolerance)."
        )
        with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
            read(file, brs.load_scan("pulsed-4-beam", focus_distance=188.0))

    def test_rows_without_a_range(self, tmp_path):
        frame = table(n_scan=3, ranges=(178.0,))
        frame["Distance"] = frame["Distance"].where(np.arange(12) != 5)
        frame.to_csv(tmp_path / "day.csv", index=False)
        series = read(tmp_path / "day.csv", FOUR)
        assert series.sizes["sample"] == 11
        assert counts_of(series)["rows_without_range"] == 1
        assert "; 1 dropped without a range" in describe_report(series)[0]

    def test_a_column_without_a_number(self, tmp_path):
        frame = table(n_scan=3).assign(Distance=9999)
        frame.to_csv(tmp_path / "day.csv", index=False)
        with pytest.raises(InputError, match=r"has no number in its column 'Distance' of ranges: give another column"):
            read(tmp_path / "day.csv", FOUR)

    def test_a_file_without_the_column_is_read_as_before(self, tmp_path):
        table(n_scan=3, ranges=(178.0,)).drop(columns="Distance").to_csv(tmp_path / "day.csv", index=False)
        series = read(tmp_path / "day.csv", FOUR)
        assert "rows_of_other_ranges" not in counts_of(series)
        with pytest.raises(InputError, match=r"has no column 'Distance' for range"):
            read(tmp_path / "day.csv", FOUR, **OTHERS)


class TestSeveralPlanes:
    def test_a_row_goes_to_the_plane_of_its_range(self, tmp_path):
        """The label says the direction, the range the plane."""
        scan = brs.load_scan("pulsed-4-beam", focus_distance=(120.0, 240.0))
        frame = table()
        frame.to_csv(tmp_path / "day.csv", index=False)
        records = make_records(read(tmp_path / "day.csv", scan), scan)
        np.testing.assert_array_equal(records["beam"].values, np.arange(8))
        expected = independent(frame, 120.0) + independent(frame, 240.0)
        np.testing.assert_allclose(records["variance"].values[0], expected, rtol=1e-12)

    def test_planes_that_would_take_the_same_range(self, tmp_path):
        scan = brs.load_scan("pulsed-4-beam", focus_distance=(170.0, 190.0))
        table(n_scan=2).to_csv(tmp_path / "day.csv", index=False)
        with pytest.raises(InputError, match=r"at 170 and 190 m, have the same range of file .*, 178 m: give focus"):
            read(tmp_path / "day.csv", scan)


class TestRangesOfAFile:
    def test_all_of_them(self, tmp_path):
        file_format = resolve_format(FileOptions(), FOUR)
        for file in (tmp_path / "a.csv", tmp_path / "a.parquet"):
            frame = table(n_scan=3)
            frame.loc[4, "Distance"] = 9999  # marks a missing entry
            frame.to_csv(file, index=False) if file.suffix == ".csv" else frame.to_parquet(file)
            assert READERS["long"].ranges(file, file_format).tolist() == list(RANGES)
            frame.drop(columns="Distance").to_csv(file.with_suffix(".txt"), index=False)
            assert ranges_of_table(file.with_suffix(".txt"), file_format).tolist() == []

    def test_a_column_that_is_not_there(self, tmp_path):
        table(n_scan=1).drop(columns="Distance").to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match="has no column 'D' for range"):
            ranges_of_table(tmp_path / "a.csv", resolve_format(FileOptions(columns={"range": "D"}), FOUR))


class TestNoMixture:
    """What no option names is refused: no advice leads to a wrong number."""

    @pytest.mark.parametrize("options", [{}, {"out_of_order": "sort"}])
    @pytest.mark.parametrize(
        "way", [read, lambda *a, **k: list(stream(*a, chunk_rows=70, **k))], ids=["read", "stream"]
    )
    def test_several_rows_of_one_beam_and_time(self, tmp_path, options, way):
        """With --out-of-order sort this gave the variance of the first range, 0.1 where 1.0 is right."""
        file = tmp_path / "day.csv"
        table(n_scan=30, heading="Entfernung").to_csv(file, index=False)
        with pytest.raises(InputError) as caught:
            way(file, FOUR, **options)
        assert "Two samples of beam 0 at 2024-03-01T10:00:00Z differ: " in str(caught.value)
        assert "the file seems to hold several ranges, heights or instruments at one time" in str(caught.value)
        assert "--column range=HEADING" in str(caught.value)
        assert "sort" not in str(caught.value)
        assert counts_of(read(file, FOUR, columns={"range": "Entfernung"}))["ranges_used"] == [178.0]

    @pytest.mark.parametrize("heading", ["Range", "Range (m)", "distance [m]", "Height", "Altitude (m)", "Range gate"])
    @pytest.mark.parametrize("options", [{}, {"out_of_order": "sort"}])
    def test_a_column_that_looks_like_a_range(self, tmp_path, heading, options):
        """Also where each range has times of its own, so that no sample is there twice."""
        frame = table(n_scan=3, heading=heading)
        shift = pd.to_timedelta(np.tile(np.arange(5), 12) * 10, unit="ms")
        frame["Timestamp"] = (pd.to_datetime(frame["Timestamp"]) + shift).astype(str)
        frame.to_csv(tmp_path / "day.csv", index=False)
        message = (
            f"Beam 0 has several {heading!r} in file {str(tmp_path / 'day.csv')!r}: 80, 120, 178, 240, 300, "
            f"and rows of several ranges are not one series; if {heading!r} is the distance along the beam, m, name it "
            f"with columns={{'range': {heading!r}}} (--column range={heading!r}), which takes the rows at the scan's "
            "distances; or else give a file for each, or remove the column if it says something else."
        )
        for way in (read, lambda *a, **k: list(stream(*a, chunk_rows=1, **k))):
            with pytest.raises(InputError, match=r"Beam 0 has several") as caught:
                way(tmp_path / "day.csv", FOUR, **options)
            if way is read:
                assert str(caught.value) == message
        assert read(tmp_path / "day.csv", FOUR, columns={"range": heading}).sizes["sample"] == 12

    def test_a_platform_that_moves_a_little(self, tmp_path):
        frame = table(n_scan=3, ranges=(178.0,), heading="Altitude")
        frame["Altitude"] = 100.0 + np.arange(12)
        frame.to_csv(tmp_path / "day.csv", index=False)
        assert read(tmp_path / "day.csv", FOUR).sizes["sample"] == 12

    def test_beams_that_are_numbered_by_range(self, tmp_path):
        scan = brs.load_scan("pulsed-4-beam", focus_distance=(120.0, 240.0))
        frame = table(n_scan=3, ranges=(120.0, 240.0), heading="Height")
        frame["LOSindex"] += 4 * (frame["Height"] == 240.0)
        frame.to_csv(tmp_path / "day.csv", index=False)
        assert read(tmp_path / "day.csv", scan).sizes["sample"] == 24

    def test_a_rare_coincidence_is_sorted_and_neither_is_believed(self, tmp_path):
        """As after a clock was set back: one in hundreds, and which is right nobody knows."""
        frame = table(n_scan=150, ranges=(178.0,))
        again = frame.iloc[[40]].assign(RWS=5.0)
        pd.concat([frame, again]).to_csv(tmp_path / "day.csv", index=False)
        with pytest.raises(InputError, match="Time goes backwards"):
            read(tmp_path / "day.csv", FOUR)
        series = read(tmp_path / "day.csv", FOUR, out_of_order="sort")
        report = json.loads(series.attrs["read_report"])
        assert (report["duplicates_that_differ"], report["samples_without_velocity"]) == (1, 1)
        assert series["time"].values[np.isnan(series["radial_velocity"].values)] == np.datetime64("2024-03-01T10:00:40")
        assert "1 of which differ: their samples count as missing" in describe_report(series)[-1]

    def test_the_files_name_themselves(self, tmp_path):
        frame = table(n_scan=3, ranges=(178.0,))
        for name, shift in (("a.csv", 0.0), ("b.csv", 1.0)):
            frame.assign(RWS=frame["RWS"] + shift).to_csv(tmp_path / name, index=False)
        with pytest.raises(
            InputError, match=r"and 11 more such; the files seem to be of several instruments or ranges"
        ):
            read([tmp_path / "a.csv", tmp_path / "b.csv"], FOUR, out_of_order="sort")
