"""Clocks that jump: every sample stands in the record of its time, or the jump is named."""

import numpy as np
import pandas as pd
import pytest

from bayes_rs import InputError, load_scan, make_records, read
from bayes_rs.records import describe_report

SCAN = load_scan("staring")
START = np.datetime64("2020-03-28T23:50", "ns")


def write(folder, times):
    velocity = 10.0 + np.sin(np.arange(len(times)))
    lines = [f"{time},0,{value:.6f}" for time, value in zip(times, velocity, strict=True)]
    file = folder / "series.csv"
    file.write_text("time,beam,radial_velocity\n" + "\n".join(lines) + "\n")
    return file


def seconds(n, *, first=START):
    return [str(first + np.timedelta64(k, "s")) for k in range(n)]


def jumping(years, *, at=300, n=600):
    return [
        str(START + np.timedelta64(k, "s") + (np.timedelta64(365 * years, "D") if k >= at else np.timedelta64(0, "s")))
        for k in range(n)
    ]


class TestJumps:
    @pytest.mark.parametrize("years", [-20, -1])
    def test_back(self, tmp_path, years):
        with pytest.raises(InputError, match=r"series\.csv"):
            read(write(tmp_path, jumping(years)), SCAN)

    def test_back_and_sorted(self, tmp_path):
        """What the clock says is what counts: the samples stand in two records a year apart, none is lost."""
        series = read(write(tmp_path, jumping(-1)), SCAN, out_of_order="sort")
        records = make_records(series, SCAN, min_availability=0.1)
        assert int(records["count"].sum()) == 600
        used = records["count"].values[:, 0] > 0
        assert (used[0], used[-1], used.sum()) == (True, True, 2)
        assert (records["flag"].values[~used] != 0).all()

    def test_forth_by_a_year(self, tmp_path):
        records = make_records(read(write(tmp_path, jumping(1)), SCAN), SCAN, min_availability=0.1)
        assert int(records["count"].sum()) == 600
        assert np.isnan(records["variance"].values[1:-1]).all()

    def test_forth_by_centuries(self, tmp_path):
        """A clock that shows no time of a measurement: its rows are set aside and told, and fill no memory."""
        series = read(write(tmp_path, jumping(230)), SCAN)
        records = make_records(series, SCAN, min_availability=0.1)
        assert records.sizes["record"] < 10
        assert int(records["count"].sum()) == 300
        assert any("line 302" in line and "2250" in line for line in describe_report(records))

    @pytest.mark.parametrize("time", ["1677-01-01T00:00:00", "2263-01-01T00:00:00", "9999-12-31T23:59:59"])
    def test_beyond_the_clock(self, tmp_path, time):
        with pytest.raises(InputError, match=rf"Invalid time '{time}' in column 'time', line 5"):
            read(write(tmp_path, [*seconds(3), time]), SCAN)


class TestTexts:
    @pytest.mark.parametrize(
        "time",
        ["2016-12-31T23:60:00", "2020-02-30T00:00:00", "2020-13-01T00:00:00", "20200101", "1e300", "-1", "12:00:00"],
    )
    def test_no_time(self, tmp_path, time):
        """A leap second, written as :60, is one; a sixtieth minute is none."""
        with pytest.raises(InputError, match=r"Invalid time .* in column 'time', line 5 of file"):
            read(write(tmp_path, [*seconds(3), time]), SCAN)

    @pytest.mark.parametrize("time", ["2020-10-25T02:30:00", "2020-03-29T02:30:00"])
    def test_the_hour_that_is_twice_or_not_at_all(self, tmp_path, time):
        with pytest.raises(InputError, match="the clock change makes it twice or not at all a time in Europe/Berlin"):
            read(write(tmp_path, [time]), SCAN, time_zone="Europe/Berlin")

    def test_across_the_change_of_clocks(self, tmp_path):
        local = pd.date_range("2020-03-29 01:59:58", periods=2, freq="s").tolist()
        local += pd.date_range("2020-03-29 03:00:00", periods=2, freq="s").tolist()
        series = read(write(tmp_path, [str(time) for time in local]), SCAN, time_zone="Europe/Berlin")
        assert (np.diff(series["time"].values) == np.timedelta64(1, "s")).all()


class TestDuplicates:
    def test_that_differ(self, tmp_path):
        with pytest.raises(InputError, match="Two samples of beam 0 at 2020-03-28T23:50:02Z differ"):
            read(write(tmp_path, [*seconds(3), *seconds(3)[2:]]), SCAN)

    def test_are_counted(self, tmp_path):
        file = write(tmp_path, seconds(600))
        lines = file.read_text().splitlines()
        file.write_text("\n".join([*lines, lines[-1]]) + "\n")
        assert read(file, SCAN).sizes["sample"] == 600
