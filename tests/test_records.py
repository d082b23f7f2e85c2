"""Records: variances, means, counts and flags against slow and obvious computations, and the laws they obey."""

from __future__ import annotations

import csv
import json
import math
import re
import statistics
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.quality import MAD_TO_SIGMA, QualityRules, group_median, is_spike
from bayes_rs.quality.spikes import running_median
from bayes_rs.readers import read
from bayes_rs.records.flags import BEAM_FLAGS, RECORD_FLAGS
from bayes_rs.records.making import make_records
from bayes_rs.records.report import describe_report

ROUNDING = 1e-12
START = np.datetime64("2020-09-03T19:00", "ns")
SECOND = np.timedelta64(1, "s")
SCAN = load_scan("6-beam")


def series_of(seconds, beam, velocity, **more) -> xr.Dataset:
    status_valid = more.pop("status_valid", None)
    time = START + (np.asarray(seconds, dtype=float) * 1e9).astype("timedelta64[ns]")
    data = {name: ("sample", np.asarray(values, dtype=float)) for name, values in more.items()}
    series = xr.Dataset(
        {"radial_velocity": ("sample", np.asarray(velocity, dtype=float)), **data},
        coords={"time": ("sample", time), "beam": ("sample", np.asarray(beam, dtype=np.int64))},
    )
    return series if status_valid is None else series.assign_attrs(status_valid=status_valid)


def grid(n_record: int = 2, beams=(0, 1, 2), seed: int = 1, offset: float = -9.0):
    """Seconds, beams and velocities of every beam once a second."""
    rng = np.random.default_rng(seed)
    seconds = np.repeat(np.arange(600 * n_record), len(beams)) + 0.5
    beam = np.tile(beams, 600 * n_record)
    return seconds, beam, offset + rng.normal(size=len(beam)) + 0.2 * beam


def flags(records: xr.Dataset, name: str) -> np.ndarray:
    return (records["flag"].values & BEAM_FLAGS[name]) > 0


def report_of(records: xr.Dataset) -> dict:
    return json.loads(records.attrs["records_report"])


SPAN = ("first_sample", "last_sample")
"""Variables of records that know of dropped samples, too."""


class TestVariance:
    @pytest.mark.parametrize("offset", [0.0, -9.0, 1e6])
    def test_against_exact_fractions(self, offset):
        """Two passes: a large mean must not cost digits, beyond those that the samples themselves have lost."""
        seconds, beam, velocity = grid(offset=offset)
        records = make_records(series_of(seconds, beam, velocity).assign_attrs(velocity_limit=2e6), SCAN)
        for record in range(2):
            for index, number in enumerate((0, 1, 2)):
                chosen = [Fraction(float(v)) for v in velocity[(seconds // 600 == record) & (beam == number)]]
                mean = sum(chosen) / len(chosen)
                variance = sum((v - mean) ** 2 for v in chosen) / len(chosen)
                assert records["count"].values[record, index] == len(chosen)
                assert records["mean"].values[record, index] == pytest.approx(float(mean), rel=1e-15)
                assert records["variance"].values[record, index] == pytest.approx(float(variance), rel=ROUNDING)

    def test_adding_a_constant_changes_no_variance(self):
        seconds, beam, velocity = grid()
        velocity = np.round(velocity * 2**20) / 2**20  # so that adding 1e6 is exact
        series = (series_of(seconds, beam, velocity + c).assign_attrs(velocity_limit=2e6) for c in (0.0, 1e6))
        low, high = (make_records(one, SCAN) for one in series)
        np.testing.assert_allclose(high["variance"], low["variance"], rtol=ROUNDING)
        np.testing.assert_allclose(high["mean"] - 1e6, low["mean"], rtol=1e-9)

    def test_sign_changes_no_variance(self):
        seconds, beam, velocity = grid()
        away, towards = (make_records(series_of(seconds, beam, sign * velocity), SCAN) for sign in (1.0, -1.0))
        np.testing.assert_array_equal(away["variance"], towards["variance"])
        np.testing.assert_array_equal(away["mean"], -towards["mean"])

    def test_order_of_samples_changes_nothing(self):
        seconds, beam, velocity = grid()
        shuffled = np.random.default_rng(2).permutation(len(beam))
        one = make_records(series_of(seconds, beam, velocity), SCAN)
        two = make_records(series_of(seconds[shuffled], beam[shuffled], velocity[shuffled]), SCAN)
        xr.testing.assert_equal(one, two)
        assert report_of(one)["samples_out_of_order"] == 0
        assert report_of(two)["samples_out_of_order"] > 0

    @settings(max_examples=60, deadline=None)
    @given(
        st.lists(
            st.tuples(st.integers(0, 4 * 3600), st.sampled_from([0, 3, 5]), st.floats(-50, 50) | st.just(math.nan)),
            min_size=1,
            max_size=60,
            unique_by=lambda row: row[:2],
        ),
        st.sampled_from([60.0, 600.0, 1800.0]),
    )
    def test_uneven_samples(self, rows, duration):
        """Unequal counts, gaps and NaN: every record equals the slow computation, and no sample is lost."""
        records = make_records(series_of(*zip(*rows, strict=True)), SCAN, duration=duration, min_count=1)
        start = (records["time"].values - START) / SECOND
        total = 0
        for record, second in enumerate(start):
            for index, number in enumerate(records["beam"].values):
                chosen = [
                    v for t, b, v in rows if second <= t < second + duration and b == number and not math.isnan(v)
                ]
                total += len(chosen)
                assert records["count"].values[record, index] == len(chosen)
                if chosen:
                    mean, variance = statistics.fmean(chosen), statistics.pvariance([Fraction(v) for v in chosen])
                    assert records["mean"].values[record, index] == pytest.approx(mean, rel=1e-12, abs=1e-12)
                    assert records["variance"].values[record, index] == pytest.approx(float(variance), abs=1e-11)
                else:
                    assert np.isnan(records["variance"].values[record, index])
        assert total == report_of(records)["samples_used"] == sum(1 for row in rows if not math.isnan(row[2]))


class TestWindows:
    @pytest.mark.parametrize(
        ("duration", "first"), [(600.0, "19:30"), (1800.0, "19:30"), (3600.0, "19:00"), (86400.0, "00:00")]
    )
    def test_on_the_clock(self, duration, first):
        seconds, beam, velocity = grid(n_record=1)
        records = make_records(series_of(seconds + 1860.0, beam, velocity), SCAN, duration=duration, min_count=1)
        assert records["time"].values[0] == np.datetime64(f"2020-09-03T{first}")

    def test_a_sample_on_the_edge_starts_a_record(self):
        records = make_records(series_of([599.999999999, 600.0], [0, 0], [1.0, 2.0]), SCAN)
        assert records["mean"].values.ravel().tolist() == [1.0, 2.0]

    def test_before_1970(self):
        series = series_of([0.0], [0], [1.0]).assign_coords(time=("sample", [np.datetime64("1969-12-31T23:55", "ns")]))
        assert make_records(series, SCAN)["time"].values[0] == np.datetime64("1969-12-31T23:50")

    def test_gaps(self):
        """Every window from the first to the last sample is there, the empty ones flagged."""
        seconds, beam, velocity = grid(n_record=5)
        kept = (seconds // 600 != 2) & ((beam != 1) | (seconds // 600 != 3))
        records = make_records(series_of(seconds[kept], beam[kept], velocity[kept]), SCAN)
        np.testing.assert_array_equal(np.diff(records["time"]) / SECOND, 600.0)
        np.testing.assert_array_equal(records["count"][:, 1], [600, 600, 0, 0, 600])
        np.testing.assert_array_equal(flags(records, "no_samples").sum(axis=1), [0, 0, 3, 1, 0])
        assert not flags(records, "too_few_samples").any()  # each flag tells its own cause
        assert np.isnan(records["variance"].values[2]).all()
        assert np.isnan(records["wind_speed"].values[2])
        assert report_of(records)["records_without_samples"] == 1
        assert "gaps: 1 records hold no sample of any beam" in describe_report(records)

    @pytest.mark.parametrize("duration", [700.0, 0.013, 90000.0])
    def test_duration_that_does_not_divide_a_day(self, duration):
        with pytest.raises(
            InputError, match=r"Invalid duration .* s: it must divide a day \(86400 s\) or be whole days"
        ):
            make_records(series_of(*grid()), SCAN, duration=duration)

    def test_a_wrong_year(self):
        seconds = 20.0 * 86400.0 * np.arange(61)
        series = series_of(seconds, np.zeros(61, dtype=int), np.arange(61.0))
        with pytest.raises(InputError, match=r"holds 103680001 records of 1 s: .* check its first and last times"):
            make_records(series, SCAN, duration=1.0)


class TestFlags:
    def test_bits_are_the_documented_ones(self):
        """They stand in files."""
        beam = ("too_few_samples", "constant", "all_missing", "no_samples", "wind_sector", "record_excluded")
        beam = (*beam, "impossible", "cut_off")
        record = ("yaw_not_seen", "wind_not_seen", "beam_flagged", "no_usable_beam")
        assert {name: 2**bit for bit, name in enumerate(beam)} == BEAM_FLAGS
        assert {name: 2**bit for bit, name in enumerate(record)} == RECORD_FLAGS

    def test_nothing_to_flag(self):
        records = make_records(series_of(*grid()), SCAN)
        assert not records["flag"].any()
        assert records["beam"].values.tolist() == [0, 1, 2]
        assert json.loads(records.attrs["beams_absent"]) == [3, 4, 5]
        assert records["flag"].attrs["flag_meanings"].split() == list(BEAM_FLAGS)
        assert records["flag"].attrs["flag_masks"].tolist() == list(BEAM_FLAGS.values())

    def test_beams_keep_the_order_of_the_scan(self):
        scan = SCAN.select([4, 0, 2])
        seconds, beam, velocity = grid(beams=(0, 2, 4))
        records = make_records(series_of(seconds, beam, velocity), scan)
        assert records["beam"].values.tolist() == [4, 0, 2]
        for index, number in enumerate((4, 0, 2)):
            first = velocity[(beam == number) & (seconds < 600)]
            assert records["mean"].values[0, index] == pytest.approx(first.mean())

    @pytest.mark.parametrize("value", [-9.0, 0.1, 0.0])
    def test_constant_beam(self, value):
        seconds, beam, velocity = grid()
        velocity[beam == 1] = value
        records = make_records(series_of(seconds, beam, velocity), SCAN)
        np.testing.assert_array_equal(flags(records, "constant"), [[False, True, False]] * 2)
        np.testing.assert_array_equal(records["variance"][:, 1], 0.0)
        np.testing.assert_array_equal(records["mean"][:, 1], value)  # exactly, whatever a sum of 600 would round to
        assert "flag constant: 2 of 6 beams of records, first 2020-09-03T19:00:00Z, beam 1" in describe_report(records)

    def test_all_nan_beam(self):
        seconds, beam, velocity = grid()
        velocity[beam == 2] = np.nan
        records = make_records(series_of(seconds, beam, velocity), SCAN)
        np.testing.assert_array_equal(flags(records, "all_missing"), [[False, False, True]] * 2)
        assert not flags(records, "too_few_samples").any()
        assert np.isnan(records["variance"].values[:, 2]).all()
        assert report_of(records)["dropped"] == {"missing": 1200, "status": 0, "cnr": 0, "despike": 0}
        assert "beams without a usable sample in any record: 2" in describe_report(records)
        assert np.isfinite(records["wind_speed"]).all()  # from the other beams

    def test_nothing_but_nan(self):
        seconds, beam, velocity = grid()
        records = make_records(series_of(seconds, beam, np.nan * velocity), SCAN)
        assert flags(records, "all_missing").all()
        assert (records["record_flag"] & RECORD_FLAGS["no_usable_beam"]).all()
        assert np.isnan(records["yaw"]).all()

    @pytest.mark.parametrize(
        ("n", "options", "flagged"),
        [
            (479, {}, True),
            (480, {}, False),
            (479, {"min_availability": 0.5}, False),
            (250, {"expected_count": 300}, False),
            (9, {"min_availability": 0.0}, True),
            (10, {"min_availability": 0.0}, False),
            (10, {"min_availability": 0.0, "min_count": 11}, True),
        ],
    )
    def test_too_few_samples(self, n, options, flagged):
        """Six beams in a second of scan: a full record holds 600 samples of a beam, and 80 % of them is 480."""
        assert SCAN.scan_duration == 1.0
        seconds, beam, velocity = grid(n_record=1)
        kept = (beam != 1) | (seconds < n)
        records = make_records(series_of(seconds[kept], beam[kept], velocity[kept]), SCAN, **options)
        assert records["count"].values[0, 1] == n
        assert flags(records, "too_few_samples")[0, 1] == flagged
        assert np.isfinite(records["variance"].values[0, 1])  # the number stays
        if flagged:
            assert any(line.startswith("flag too_few_samples (fewer than") for line in describe_report(records))


class TestManyFiles:
    @staticmethod
    def of(*files):
        common = {"rows": 10, "format": "long", "positive": "away", "velocity_unit": "m/s", "time_zone": "UTC"}
        common |= {"rows_invalid_value": 0, "rows_dropped": 0, "samples_out_of_order": 0}
        report = {
            "files": [{"name": f"{index}.csv", **common, **file} for index, file in enumerate(files)],
            "files_skipped": [],
            "beams_present": [0],
            "beams_absent": [],
            "samples": 1,
            "samples_without_velocity": 0,
            "duplicates_dropped": 0,
        }
        return describe_report(xr.Dataset(attrs={"read_report": json.dumps(report)}))[:-2]

    def test_a_stamp_by_the_format_is_moved_only_where_the_length_is_known(self):
        stamped = {"time_stamp": "end", "options_of_format": ["time_stamp"]}
        (line,) = self.of(stamped)
        assert "times at the end of a sample, moved to its start if the file says how long it takes (by" in line
        (line,) = self.of({**stamped, "sample_duration": 2.0})
        assert "times at the end of a sample (by the format: time_stamp)" in line
        (line,) = self.of({"time_stamp": "end"})
        assert line.endswith("times at the end of a sample")

    def test_columns_that_were_found_by_their_headings_are_named(self):
        (line,) = self.of({"format": "zx", "columns": {"time": "Time and Date", "phase": "Azimuth"}})
        assert line.endswith("; columns read: time 'Time and Date', phase 'Azimuth'")
        (line,) = self.of({"columns": {"time": "Timestamp"}})
        assert "columns" not in line

    def test_few_have_a_line_each(self):
        assert len(self.of(*[{}] * 20)) == 20

    def test_many_that_were_read_alike_share_one(self):
        lines = self.of(*[{}] * 19, {"positive": "towards"}, *[{"rows_dropped": 1}] * 5)
        assert lines == [
            "24 files, 0.csv to 24.csv: 240 rows (long), positive away, m/s, UTC; 5 dropped without a time or a beam",
            "19.csv: 10 rows (long), positive towards, m/s, UTC",
        ]


class TestFilters:
    def test_status(self):
        seconds, beam, velocity = grid()
        status = np.where(seconds < 30, 0.0, 1.0)
        status[-3:] = np.nan
        bad = status != 1.0
        spoilt = np.where(bad, 99.0, velocity)
        records = make_records(series_of(seconds, beam, spoilt, status=status, status_valid=1), SCAN)
        reference = make_records(series_of(seconds[~bad], beam[~bad], velocity[~bad]), SCAN)
        xr.testing.assert_equal(records.drop_vars(SPAN), reference.drop_vars(SPAN))
        assert report_of(records)["dropped"]["status"] == bad.sum()
        unknown = make_records(series_of(seconds, beam, spoilt, status=status), SCAN)
        assert report_of(unknown)["dropped"]["status"] == 0

    def test_cnr(self):
        seconds, beam, velocity = grid()
        cnr = np.random.default_rng(3).uniform(-30, 5, len(beam))
        cnr[:6] = [-23.0, -5.0, np.nan, -23.001, -4.999, -10.0]
        good = (cnr >= -23.0) & (cnr <= -5.0)
        assert good[:6].tolist() == [True, True, False, False, False, True]
        records = make_records(
            series_of(seconds, beam, velocity, cnr=cnr), SCAN, quality=QualityRules(cnr_range=(-23.0, -5.0))
        )
        reference = make_records(series_of(seconds[good], beam[good], velocity[good]), SCAN)
        xr.testing.assert_equal(records.drop_vars(SPAN), reference.drop_vars(SPAN))
        assert report_of(records)["dropped"]["cnr"] == (~good).sum()

    def test_a_sample_is_counted_once(self):
        seconds, beam, velocity = grid()
        velocity[0] = np.nan
        more = {"status": np.ones(len(beam)), "cnr": np.zeros(len(beam)), "status_valid": 1}
        more["status"][:2] = 0.0
        more["cnr"][:3] = -99.0
        records = make_records(
            series_of(seconds, beam, velocity, **more), SCAN, quality=QualityRules(cnr_range=(-23.0, 5.0))
        )
        assert report_of(records)["dropped"] == {"missing": 1, "status": 1, "cnr": 1, "despike": 0}
        assert report_of(records)["samples_used"] == len(beam) - 3

    def test_despike(self):
        """Spikes go, and nothing else in Gaussian noise; also at the ends of a beam."""
        seconds, beam, velocity = grid()
        spikes = np.array([0, 3, 700, 1801, len(beam) - 1])
        spoilt = velocity.copy()
        spoilt[spikes] += [30.0, -30.0, 30.0, -40.0, 30.0]
        records = make_records(
            series_of(seconds, beam, spoilt), SCAN, quality=QualityRules(despike="median", despike_threshold=8.0)
        )
        good = np.ones(len(beam), dtype=bool)
        good[spikes] = False
        xr.testing.assert_equal(records, make_records(series_of(seconds[good], beam[good], velocity[good]), SCAN))
        assert report_of(records)["dropped"]["despike"] == len(spikes)
        assert report_of(make_records(series_of(seconds, beam, spoilt), SCAN))["dropped"]["despike"] == 0

    @pytest.mark.parametrize("window", [3, 5, 7, 21])
    def test_running_median_of_groups_of_any_length(self, window):
        """Groups as short as one sample, mirrored again and again; the filter of SciPy fails on some of them."""
        length = np.arange(1, 2 * window)
        group = np.repeat(length, length)
        velocity = np.random.default_rng(window).standard_normal(len(group))
        expected = []
        for number in length:
            mirrored = np.pad(velocity[group == number], window // 2, mode="reflect")
            expected += [statistics.median(mirrored[i : i + window]) for i in range(number)]
        np.testing.assert_array_equal(running_median(velocity, group, window=window), expected)

    def test_despike_against_the_printed_rule(self):
        rng = np.random.default_rng(4)
        velocity = rng.standard_t(2, 300)
        group = np.repeat([0, 1, 2, 3], [60, 90, 149, 1])
        spike = is_spike(velocity, group, window=5, threshold=3.0)
        deviation = []
        for number in range(4):
            values = [float(v) for v in velocity[group == number]]
            mirrored = values[2:0:-1] + values + values[-2:-4:-1] if len(values) > 1 else 5 * values
            deviation += [abs(v - statistics.median(mirrored[i : i + 5])) for i, v in enumerate(values)]
        mad = [statistics.median(d for d, other in zip(deviation, group, strict=True) if other == g) for g in group]
        expected = [d > 3.0 * MAD_TO_SIGMA * m and m > 0 for d, m in zip(deviation, mad, strict=True)]
        assert 3 < sum(expected) < 60
        np.testing.assert_array_equal(spike, expected)

    def test_group_median(self):
        group = np.random.default_rng(5).integers(0, 12, 60)
        values = np.random.default_rng(6).normal(size=60)
        expected = [statistics.median(values[group == number].tolist()) for number in group]
        np.testing.assert_array_equal(group_median(values, group), expected)

    def test_despike_leaves_a_constant_alone(self):
        values = np.ones(50)
        values[7] = 100.0
        nothing = np.zeros(50, dtype=np.int64)
        assert not is_spike(values, nothing, window=11, threshold=5.0).any()

    def test_duplicates(self):
        seconds, beam, velocity = grid()
        again = np.r_[np.arange(len(beam)), 5, 5, 900]
        doubled = velocity[again]
        doubled[5] = np.nan  # of the three, one with a velocity counts
        records = make_records(series_of(seconds[again], beam[again], doubled), SCAN)
        xr.testing.assert_equal(records, make_records(series_of(seconds, beam, velocity), SCAN))
        assert report_of(records)["duplicates_dropped"] == 3


class TestMeanWind:
    @pytest.mark.parametrize("name", ["2-beam", "4-beam", "6-beam", "50-beam", "pulsed-4-beam", "zx-300"])
    @pytest.mark.parametrize("yaw_deg", [-170.0, -35.0, 0.0, 12.5, 90.0, 180.0])
    def test_round_trip(self, name, yaw_deg):
        """Means made from line_of_sight at a yaw give the wind speed and that yaw back."""
        scan = load_scan(name, tilt_deg=5.0)
        mean = 11.0 * scan.with_yaw(np.deg2rad(yaw_deg)).line_of_sight[:, 0]
        seconds = np.repeat(np.arange(20.0), scan.n_beam)
        wobble = np.where(seconds % 2, 1.0, -1.0)
        series = series_of(seconds, np.tile(scan.beam, 20), np.tile(mean, 20) + wobble)
        records = make_records(series, scan, expected_count=20)
        assert records["wind_speed"].values == pytest.approx(11.0, rel=ROUNDING)
        turned = (records["yaw"].values - yaw_deg + 180.0) % 360.0 - 180.0
        assert turned == pytest.approx(0.0, abs=1e-9)
        assert records["tilt"].values == pytest.approx(5.0)
        assert not records["record_flag"].any()
        behind = int(abs(yaw_deg) > 90.0 and name != "zx-300")  # which looks up, and has no front
        assert report_of(records)["records_with_wind_from_behind"] == behind
        line = "wind from behind the lidar (more than 90° from its axis): 1 of 1 records"
        assert describe_report(records).count(line) == behind

    @pytest.mark.parametrize(("n_bad", "words"), [(1200, "100 %"), (120, "10 %"), (12, "1 %"), (1, "0.083 %")])
    def test_the_share_that_was_dropped_is_no_power_of_ten(self, n_bad, words):
        bad = np.arange(1200) < n_bad
        series = series_of(np.arange(1200), np.zeros(1200), np.where(bad, np.nan, -9.0))
        records = make_records(series, load_scan("staring"))
        assert f"dropped by missing: {n_bad} samples ({words}); most of beam 0, {n_bad} of 1200" in describe_report(
            records
        )

    def test_each_record_uses_its_own_valid_beams(self):
        scan = load_scan("4-beam")
        yaw = np.deg2rad([10.0, -20.0, 30.0])
        seconds = np.repeat(np.arange(1800.0), scan.n_beam)
        beam = np.tile(scan.beam, 1800)
        mean = 9.0 * scan.at_yaw(yaw)[:, :, 0]
        velocity = mean[(seconds // 600).astype(int), beam] + np.where(seconds % 2, 0.5, -0.5)
        velocity[(seconds // 600 == 1) & (beam == 0)] = 77.0  # constant, hence flagged and not used
        records = make_records(series_of(seconds, beam, velocity), scan)
        np.testing.assert_allclose(records["yaw"], [10.0, -20.0, 30.0], atol=1e-9)
        np.testing.assert_allclose(records["wind_speed"], 9.0, rtol=ROUNDING)
        np.testing.assert_array_equal(records["record_flag"], [0, RECORD_FLAGS["beam_flagged"], 0])

    @pytest.mark.parametrize(("sign", "yaw_deg"), [(1.0, 20.0), (-1.0, -160.0)])
    def test_a_staring_lidar_sees_no_yaw(self, sign, yaw_deg):
        scan = load_scan("staring", yaw_deg=20.0, tilt_deg=3.0)
        along = scan.line_of_sight[0, 0]
        seconds = np.arange(600.0)
        series = series_of(seconds, 0 * seconds, sign * 10.0 * along + np.where(seconds % 2, 1.0, -1.0))
        records = make_records(series, scan)
        assert records["wind_speed"].values == pytest.approx([10.0], rel=ROUNDING)
        assert records["yaw"].values == pytest.approx([yaw_deg])
        assert records["record_flag"].values.tolist() == [RECORD_FLAGS["yaw_not_seen"]]

    def test_a_vertical_beam_sees_no_wind(self):
        scan = Scan("up", [[0.0, 0.0, 1.0]], focus_distance=[100.0], beam_time=[0.0], scan_duration=1.0)
        seconds = np.arange(600.0)
        records = make_records(series_of(seconds, 0 * seconds, np.sin(seconds)), scan)
        assert np.isnan(records["wind_speed"].values).all()
        assert records["record_flag"].values.tolist() == [RECORD_FLAGS["yaw_not_seen"] | RECORD_FLAGS["wind_not_seen"]]
        assert records["flag"].values.tolist() == [[0]]


class TestBadInput:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"duration": 0.0}, "Invalid duration 0.0 s: it must be a finite number above zero."),
            ({"min_availability": 1.5}, "Invalid min_availability 1.5: it must be from 0 to 1."),
            ({"min_availability": "all"}, "Invalid min_availability 'all': it must be a finite number."),
            ({"expected_count": 0}, "Invalid expected_count 0: it must be a finite number above zero."),
            ({"min_count": 0}, "Invalid min_count 0: it must be a whole number of at least 1."),
        ],
    )
    def test_options(self, options, message):
        seconds, beam, velocity = grid()
        with pytest.raises(InputError, match=re.escape(message)):
            make_records(series_of(seconds, beam, velocity, cnr=velocity), SCAN, **options)

    @pytest.mark.parametrize(
        ("rules", "message"),
        [
            ({"cnr_range": (-5.0, -23.0)}, "Invalid cnr_range (-5.0, -23.0) dB: it must be a pair (low, high)"),
            ({"cnr_range": -23.0}, "Invalid cnr_range -23.0 dB: it must be a pair (low, high)"),
            ({"despike": "mean"}, "Unknown despike 'mean': it must be one of median; did you mean 'median'?"),
            ({"despike_window": 4}, "Invalid despike_window 4: it must be an odd number of samples."),
            ({"despike_window": 1}, "Invalid despike_window 1: it must be a whole number of at least 3."),
            ({"despike_threshold": -1.0}, "Invalid despike_threshold -1.0: it must be a finite number above zero."),
        ],
    )
    def test_rules(self, rules, message):
        with pytest.raises(InputError, match=re.escape(message)):
            QualityRules(**rules)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"durations": 60.0}, "Unknown option 'durations' in the options of records: did you mean 'duration'?"),
            ({"motion": ["a.csv"]}, "The option motion is not used where records are made: give it and the records to"),
            ({"mast": "a.csv", "mast_position": [0, 0, 0]}, "The option mast is not used where records are made: give"),
            ({"mast": "a.csv", "mast_position": [0, 0]}, "position"),
            ({"motion_columns": {"tilt_deg": "Tilt"}}, "The option motion_columns is only used with motion"),
        ],
    )
    def test_options_of_something_else(self, options, message):
        with pytest.raises(InputError, match=re.escape(message)):
            make_records(series_of(*grid()), SCAN, **options)

    def test_cnr_range_without_cnr(self):
        with pytest.raises(InputError, match=r"Invalid cnr_range .* dB: the series has no cnr; map it"):
            make_records(series_of(*grid()), SCAN, quality=QualityRules(cnr_range=(-23.0, 0.0)))

    def test_series_of_another_scan(self):
        with pytest.raises(InputError, match=r"Unknown beam 2 in the series: the beams of scan '2-beam' are \[0, 1\]"):
            make_records(series_of(*grid()), load_scan("2-beam"))

    @pytest.mark.parametrize("name", ["radial_velocity", "time", "beam"])
    def test_incomplete_series(self, name):
        with pytest.raises(InputError, match=f"Invalid series: it needs '{name}' over the dimension 'sample'"):
            make_records(series_of(*grid()).drop_vars(name), SCAN)

    def test_empty_series(self):
        with pytest.raises(InputError, match="Invalid series: it holds no sample"):
            make_records(series_of([], [], []), SCAN)

    def test_times_that_are_not_times(self):
        series = series_of([1.0, 2.0], [0, 0], [1.0, 2.0])
        for time in ([1.0, 2.0], [START, np.datetime64("NaT", "ns")]):
            with pytest.raises(InputError, match="every time must be a UTC time of type datetime64"):
                make_records(series.assign_coords(time=("sample", time)), SCAN)


def test_records_survive_netcdf(tmp_path):
    records = make_records(series_of(*grid()), SCAN)
    records.to_netcdf(tmp_path / "records.nc")
    with xr.open_dataset(tmp_path / "records.nc") as again:
        xr.testing.assert_equal(again, records)
        assert describe_report(again) == describe_report(records)
        assert again.attrs["scan_key"] == SCAN.key


class TestMeasured:
    @pytest.fixture(scope="class")
    @staticmethod
    def records(iea_folder: Path) -> xr.Dataset:
        scan = load_scan("pulsed-4-beam")
        return make_records(read(sorted(iea_folder.glob("Lidar_*.csv")), scan), scan)

    def test_against_csv_and_statistics(self, records, iea_folder):
        chosen: dict[tuple[datetime, int], list[float]] = {}
        for file in iea_folder.glob("Lidar_*.csv"):
            with file.open(encoding="utf-8-sig", newline="") as lines:
                for row in csv.DictReader(lines):
                    if row["Distance"] != "9999" and row["RWSStatus"] == "1":
                        time = datetime.fromisoformat(row["Timestamp"]).replace(tzinfo=None)
                        start = time.replace(minute=time.minute // 10 * 10, second=0, microsecond=0)
                        chosen.setdefault((start, int(row["LOSindex"])), []).append(float(row["RWS"]))
        assert records["variance"].sizes == {"record": 144, "beam": 2}
        assert records["beam"].values.tolist() == [2, 3]
        assert json.loads(records.attrs["beams_absent"]) == [0, 1]
        assert report_of(records)["dropped"] == {"missing": 0, "status": 2, "cnr": 0, "despike": 0}
        n_checked = 0
        for record, time in enumerate(records["time"].values.astype("datetime64[s]").tolist()):
            for index, number in enumerate((2, 3)):
                values = chosen.get((time, number), [])
                n_checked += len(values)
                assert records["count"].values[record, index] == len(values)
                assert ((records["flag"].values[record, index] & 1) == 1) == (len(values) < 120)
                if values:
                    variance = records["variance"].values[record, index]
                    assert variance == pytest.approx(statistics.pvariance(values), rel=1e-10)
                    assert records["mean"].values[record, index] == pytest.approx(-statistics.fmean(values), rel=1e-10)
        assert n_checked == report_of(records)["samples_used"] == 21597 + 21044

    @pytest.mark.parametrize(("beam", "mast", "correlation"), [(2, "LOS_TI_South", 0.98), (3, "LOS_TI_North", 0.90)])
    def test_turbulence_intensity_follows_the_mast(self, records, iea_folder, beam, mast, correlation):
        with (iea_folder / "ReferencePulsed.csv").open(encoding="utf-8-sig", newline="") as lines:
            rows = list(csv.DictReader(lines))
        time = np.array([row["Timestamp"] for row in rows], dtype="datetime64[ns]")
        np.testing.assert_array_equal(records["time"], time)
        reference = np.array([float(row[mast]) for row in rows])
        one = records.sel(beam=beam)
        intensity = np.sqrt(one["variance"].values) / np.abs(one["mean"].values)
        usable = (one["flag"].values == 0) & np.isfinite(reference)
        assert usable.sum() > 130
        found = np.corrcoef(intensity[usable], reference[usable])[0, 1]
        assert found == pytest.approx(correlation, abs=0.015)

    def test_lines(self, records):
        lines = describe_report(records)
        assert "beams in the files: 2, 3; absent: 0, 1" in lines
        assert any("554 with an invalid value; 554 dropped without a time or a beam" in line for line in lines)
        assert any("42641 of 42643 samples used" in line and "status 2" in line for line in lines)
