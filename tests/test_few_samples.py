"""Records with a part of their samples: their noise, and what is said of them."""

import numpy as np
import pytest
import xarray as xr

import bayes_rs as brs
from bayes_rs.fits.few_samples import scatter_of_few
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.prepare import prepare
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.gaps import gap_noise
from bayes_rs.records.ranges import stack_ranges
from bayes_rs.records.report import describe_report

DBS = brs.load_scan("wls200s-dbs@probe=point")
FLOW = brs.load_turbulence("fu-2022")
WIND = 10.0
SHARED = {
    "two bursts": lambda time: (time < 200.0) | (time >= 400.0),
    "one burst": lambda time: time < 200.0,
    "half": lambda time: time < 300.0,
    "every second cycle": lambda time: (time // DBS.scan_duration) % 2 == 0,
}


def present(scan, kept):
    time = scan.beam_time[:, np.newaxis] + scan.scan_duration * np.arange(int(np.ceil(600.0 / scan.scan_duration)))
    return kept(time) & (time < 600.0)


def records_with(count, expected, scan=DBS):
    shape = (1, scan.n_beam)
    return xr.Dataset(
        {
            "variance": (("record", "beam"), np.ones(shape)),
            "count": (("record", "beam"), np.broadcast_to(count, shape)),
            "flag": (("record", "beam"), np.zeros(shape, dtype=np.uint8)),
            "wind_speed": ("record", [WIND]),
            "yaw": ("record", [0.0]),
        },
        coords={"beam": scan.beam},
        attrs={"records_report": f'{{"samples_expected": {expected}}}', "duration": 600.0},
    )


class TestNoise:
    @pytest.mark.parametrize("kept", SHARED.values(), ids=SHARED)
    def test_is_near_that_of_the_gaps_themselves(self, kept):
        """Theory with every missing sample (`gap_noise`) against the share of the samples alone."""
        there = present(DBS, kept)
        exact = gap_noise(DBS, FLOW, there, wind_speed=WIND).relative_error[0]
        full = theory_noise(DBS, FLOW, wind_speed=WIND)
        records = records_with(there.sum(axis=1), 600.0 / DBS.scan_duration)
        used = np.ones((1, DBS.n_beam), dtype=bool)
        scatter = scatter_of_few(records, full, used)
        widened = np.sqrt((1.0 + full.relative_error[0] ** 2) * (1.0 + scatter[0]) - 1.0)
        np.testing.assert_allclose(widened.mean(), exact.mean(), rtol=0.06)  # 3 to 5 % too little where means go, too
        assert full.relative_error[0].mean() < 0.85 * exact.mean()  # as which they counted before

    def test_is_too_wide_for_close_samples_that_are_missing(self):
        scan = brs.load_scan("staring")
        there = present(scan, lambda time: time % 2.0 < 1.0)
        exact = gap_noise(scan, FLOW, there, wind_speed=WIND).relative_error[0, 0]
        full = theory_noise(scan, FLOW, wind_speed=WIND)
        scatter = scatter_of_few(records_with(300, 600.0, scan), full, np.ones((1, 1), dtype=bool))
        assert np.sqrt((1.0 + full.relative_error[0, 0] ** 2) * (1.0 + scatter[0]) - 1.0) > 1.3 * exact

    def test_of_records_with_enough_is_as_it_was(self):
        full = theory_noise(DBS, FLOW, wind_speed=WIND)
        used = np.ones((1, DBS.n_beam), dtype=bool)
        for records in (records_with(24, 30.0), records_with(33, 30.0), records_with(3, 30.0).drop_vars("count")):
            assert scatter_of_few(records, full, used) is None
        assert scatter_of_few(records_with(3, 30.0), full, ~used) is None

    def test_a_fit_counts_it(self):
        full = theory_noise(DBS, FLOW, wind_speed=WIND)
        options = FitOptions(instrument_noise=0.0, scatter="theory")
        series = brs.simulate(DBS, FLOW, wind_speed=WIND, n_records=2, seed=2)
        start = series["time"].values.astype("datetime64[s]").astype(np.int64) % 600
        few, enough = (
            brs.make_records(series.isel(sample=np.flatnonzero(start < end)), DBS, min_availability=0.3)
            for end in (200, 600)
        )
        *_, batch = prepare(few, DBS, full, options)
        assert prepare(enough, DBS, full, options)[-1].scatter is None
        relative = np.mean(full.relative_error[0] ** 2)  # of one state, which is that of all records
        share = few["count"].mean("beam").values / (600.0 / DBS.scan_duration)
        np.testing.assert_allclose(batch.scatter[:, 0], 0.0)
        np.testing.assert_allclose(batch.scatter[:, 1], relative * (1.0 / share - 1.0) / (1.0 + relative), rtol=1e-12)


class TestWords:
    @pytest.fixture(scope="class")
    @staticmethod
    def series():
        return brs.simulate(DBS, FLOW, wind_speed=WIND, n_records=3, seed=2)

    def lines(self, series, kept, **options):
        start = series["time"].values.astype("datetime64[s]").astype(np.int64) % 600
        return describe_report(brs.make_records(series.isel(sample=np.flatnonzero(kept(start))), DBS, **options))

    def short(self, series, **options):
        start = series["time"].values.astype("datetime64[s]").astype(np.int64) % 600
        return brs.make_records(series.isel(sample=np.flatnonzero(start < 120)), DBS, **options)

    def test_the_share_and_the_option_are_named(self, series):
        said = [line for line in self.lines(series, SHARED["two bursts"]) if line.startswith("beams with too few")]
        least = "beams with too few samples have 19 to 20 of 29.6 (64 to 68 %), half of them 19 or more: "
        least += (
            "min_availability=0.6 (--min-availability 0.6) takes these, with wider intervals; where time is shared "
        )
        assert said == [least + "between scans, their variances are a little too small (docs/quality.md)"]

    def test_the_option_takes_them(self, series):
        assert not any(
            line.startswith("beams with too few")
            for line in self.lines(series, SHARED["two bursts"], min_availability=0.6)
        )

    def test_fewer_than_ten_are_not_offered(self, series):
        (said,) = [
            line for line in self.lines(series, lambda time: time < 100) if line.startswith("beams with too few")
        ]
        assert "--min-availability" not in said
        assert said.endswith("fewer than min_count=10, whatever was expected")

    @pytest.mark.parametrize(
        ("options", "words", "never"),
        [
            ({}, "the most samples of one are 6, and min_count=10 asks for more", None),
            ({}, "in Python), and a lower min_availability (--min-availability), takes fewer", None),
            (
                {"min_availability": 0.01},
                "a lower min_count (records.min_count of a",
                "--min-availability",
            ),
            ({"min_count": 2}, "; a lower min_availability (--min-availability) takes fewer samples", "min_count"),
        ],
    )
    def test_where_all_have_too_few_the_rule_that_is_the_limit_is_named(self, series, options, words, never):
        with pytest.raises(brs.InputError) as caught:
            brs.fit(self.short(series, **options), DBS, seed=1)
        assert words in str(caught.value)
        assert never is None or never not in str(caught.value)

    def test_so_it_is_at_several_ranges(self, series):
        records = stack_ranges([self.short(series)] * 2, RangedScan.of(DBS, [100.0, 200.0]))
        with pytest.raises(brs.InputError, match=r"at any of the ranges can be fitted: every beam .*min_count=10 asks"):
            brs.fit(records, DBS, seed=1)

    def test_full_records_have_no_line(self, series):
        assert not any(line.startswith("beams with too few") for line in self.lines(series, lambda time: time >= 0))
