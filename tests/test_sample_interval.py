"""Samples that come at another cycle than the scan's: what is said, and that gaps and rounded times are none."""

import numpy as np
import pytest

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.records.belief import doubt_lines
from bayes_rs.records.report import describe_report
from bayes_rs.records.sample_interval import INTERVAL
from bayes_rs.records.stream import stream_records

SCAN = brs.load_scan("6-beam")
SLOW = brs.Scan("slow", SCAN.beam_direction, SCAN.focus_distance, SCAN.beam_time * 5.0, 5.0)
SAID = "samples of a beam come every 5 s, and the scan says 1 s: correct the scan (scan_duration"


def simulated(scan, n_records=3):
    return brs.simulate(scan, "fu-2022", wind_speed=10.0, n_records=n_records, seed=4).drop_attrs()


@pytest.fixture(scope="module")
def slow():
    return simulated(SLOW)


@pytest.fixture(scope="module")
def usual():
    return simulated(SCAN)


class TestAnotherCycle:
    def test_records_that_are_refused_say_why(self, slow):
        with pytest.raises(InputError) as caught:
            brs.fit(brs.make_records(slow, SCAN), SCAN, seed=1)
        assert SAID in str(caught.value)
        assert "min_availability" not in str(caught.value)

    def test_the_report_does_not_advise_to_take_fewer(self, slow):
        lines = describe_report(brs.make_records(slow, SCAN))
        assert any(SAID in line for line in lines)
        assert not any("min_availability" in line for line in lines)

    def test_a_doubt_stays_where_they_are_taken_nevertheless(self, slow):
        records = brs.make_records(slow, SCAN, min_availability=0.1)
        fit = brs.fit(records, SCAN, seed=1, draws="none")
        assert any(SAID in line for line in fit.failures)
        assert SAID in fit.headline().doubtful

    def test_samples_that_come_more_often(self, usual):
        (line,) = doubt_lines(brs.make_records(usual, SLOW))
        assert line.startswith("samples of a beam come every 1 s, and the scan says 5 s")

    def test_the_same_in_pieces(self, slow):
        chunks = (slow.isel(sample=slice(first, first + 700)) for first in range(0, slow.sizes["sample"], 700))
        pieces = stream_records(chunks, SCAN)
        np.testing.assert_array_equal(pieces[INTERVAL], brs.make_records(slow, SCAN)[INTERVAL])
        assert any(SAID in line for line in doubt_lines(pieces))


class TestTheScansCycle:
    def test_no_doubt(self, slow, usual):
        for series, scan in ((slow, SLOW), (usual, SCAN)):
            records = brs.make_records(series, scan)
            np.testing.assert_allclose(records[INTERVAL], scan.scan_duration, rtol=1e-6)
            assert doubt_lines(records) == []

    @pytest.mark.parametrize("missing", [0.3, 0.6, 0.8])
    def test_samples_that_are_missing_are_no_slower_cycle(self, usual, missing):
        there = np.flatnonzero(np.random.default_rng(1).random(usual.sizes["sample"]) > missing)
        assert doubt_lines(brs.make_records(usual.isel(sample=there), SCAN)) == []

    def test_nor_is_time_that_is_shared_with_other_scans(self, usual):
        """Ten cycles, then others: as a scanner does."""
        seconds = (usual["time"].values - usual["time"].values.min()) / np.timedelta64(1, "s")
        there = np.flatnonzero(seconds % 60.0 < 10.0)
        assert doubt_lines(brs.make_records(usual.isel(sample=there), SCAN)) == []

    @pytest.mark.parametrize("cycle", [0.7, 1.3, 1.6, 2.5])
    def test_nor_are_times_in_whole_seconds(self, cycle):
        scan = brs.Scan("odd", SCAN.beam_direction, SCAN.focus_distance, SCAN.beam_time * cycle, cycle)
        series = simulated(scan, 1)
        series = series.assign_coords(time=("sample", series["time"].values.astype("datetime64[s]").astype("M8[ns]")))
        assert not any("come every" in line for line in doubt_lines(brs.make_records(series, scan)))

    def test_measured_scans(self, six_beam_hour, dbs_folder, iea_folder):
        scan = brs.find_scan(six_beam_hour, height=100.0)
        assert doubt_lines(brs.make_records(brs.read(six_beam_hour, scan), scan)) == []
        files = sorted(dbs_folder.glob("*.nc"))
        scan = brs.find_scan(files, height=300.0)
        assert doubt_lines(brs.make_records(brs.read(files, scan), scan)) == []
        scan = brs.load_scan("pulsed-4-beam")
        files = sorted(iea_folder.glob("Lidar_*_LOS?_178m.csv"))
        assert not any("come every" in line for line in doubt_lines(brs.make_records(brs.read(files, scan), scan)))
