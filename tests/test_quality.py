"""Quality rules: each catches its planted fault and nothing else, every sample is counted once, and laws hold."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import scipy.stats
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.fits.flags import flag_words
from bayes_rs.quality import BeamSamples, apply_filters, find_periodicity, in_sectors
from bayes_rs.quality.frozen import is_frozen
from bayes_rs.quality.stationarity import (
    Parts,
    beam_median,
    half_ratio,
    parts_of_records,
    share_between_parts,
    trend,
)
from bayes_rs.records.flags import BEAM_FLAGS, RECORD_FLAGS, REMARK_FLAGS
from bayes_rs.records.making import make_records
from bayes_rs.records.record_samples import sort_samples
from bayes_rs.records.report import describe_report

START = np.datetime64("2020-09-03T19:00", "ns")
SCAN = brs.load_scan("6-beam")
N_RECORD, BEAMS = 2, (0, 1, 2)
ROUNDING = 1e-12


def series_of(velocity, *, seconds=None, beam=None, **more) -> xr.Dataset:
    """Make a series of beams sampled once a second, or as given."""
    seconds = np.repeat(np.arange(len(velocity) // len(BEAMS)), len(BEAMS)) if seconds is None else seconds
    beam = np.tile(BEAMS, len(velocity) // len(BEAMS)) if beam is None else beam
    time = START + (np.asarray(seconds, dtype=float) * 1e9).astype("timedelta64[ns]")
    return xr.Dataset(
        {
            "radial_velocity": ("sample", np.asarray(velocity, dtype=float)),
            **{name: ("sample", np.asarray(values)) for name, values in more.items()},
        },
        coords={"time": ("sample", time), "beam": ("sample", np.asarray(beam, dtype=np.int64))},
    )


def sound(seed: int = 1, n_record: int = N_RECORD) -> np.ndarray:
    """Radial velocities without any fault: no two are equal, none is near zero."""
    rng = np.random.default_rng(seed)
    return -9.0 + np.clip(rng.normal(size=600 * n_record * len(BEAMS)), -4.0, 4.0)


def report_of(records: xr.Dataset) -> dict:
    return json.loads(records.attrs["records_report"])


def dropped(records: xr.Dataset) -> dict[str, int]:
    return {name: number for name, number in report_of(records)["dropped"].items() if number}


BAD = np.array([5, 600, 601, 1807, 3001])


def planted() -> dict[str, tuple[xr.Dataset, dict, np.ndarray]]:
    """Return series with one fault each, the rules that should find it, and which samples are bad, by name."""
    clean, rng = sound(), np.random.default_rng(2)
    n = len(clean)
    beam, bad = np.tile(BEAMS, n // len(BEAMS)), np.zeros(n, dtype=bool)
    bad[BAD] = True
    cnr, low = rng.uniform(-20.0, -5.0, n), (-23.0, 0.0)
    bits = np.where(bad, 4.0 + 1.0, rng.choice([0.0, 1.0, 2.0, 3.0], n))
    words = np.where(bad, 3.0, rng.choice([1.0, 2.0], n))
    angle = np.where(bad, 357.0, rng.uniform(11.0, 349.0, n))
    fast, faint = np.where(bad, 25.0, clean), np.where(bad, -30.0, cnr)
    still, bright = np.where(bad, 0.2, clean), np.where(bad, 5.0, cnr)
    still[7], bright[8] = 0.1, 5.0  # slow or bright alone is no fault
    frozen, held = clean.copy(), np.zeros(n, dtype=bool)
    for first, number, run in ((10, 0, 5), (700, 2, 9), (300, 1, 4)):  # the last is too short
        where = len(BEAMS) * (first + np.arange(run)) + number
        frozen[where], held[where] = frozen[where[0]], run >= 5
    blocked = np.where(bad, 0.0, clean)
    blocked[900] = -40.0  # a spike away from zero is no blade
    spiky = np.where(bad, clean + 30.0, clean)
    return {
        "status": (series_of(clean, status=words), {"status_valid": (1, 2)}, bad),
        "status bits": (series_of(clean, status=bits), {"status_reject_bits": 4}, bad),
        "status unknown": (series_of(clean, status=np.where(bad, np.nan, 1.0)), {"status_reject_bits": 4}, bad),
        "mask_rain": (series_of(clean, rain=bad), {"masks": ["rain"]}, bad),
        "mask_rain unknown": (series_of(clean, rain=np.where(bad, np.nan, 0.0)), {"masks": ["rain"]}, bad),
        "cnr": (series_of(clean, cnr=faint), {"cnr_range": low}, bad),
        "cnr by beam": (series_of(clean, cnr=faint), {"cnr_range": {1: low}}, bad & (beam == 1)),
        "snr": (series_of(clean, snr=np.where(bad, np.nan, cnr)), {"snr_range": low}, bad),
        "velocity": (series_of(fast), {"velocity_range": (-30.0, 0.0)}, bad),
        "velocity by beam": (
            series_of(fast),
            {"velocity_range": {0: (-30.0, 0.0), 2: (-30.0, 30.0)}},
            bad & (beam == 0),
        ),
        "hard_target": (series_of(still, cnr=bright), {"hard_target_cnr": 0.0}, bad),
        "sector_rotor_angle": (
            series_of(clean, rotor_angle=angle),
            {"blocked_sectors": {"rotor_angle": [(350, 10)]}},
            bad,
        ),
        "sector_azimuth unknown": (
            series_of(clean, azimuth=np.where(bad, np.nan, 90.0)),
            {"blocked_sectors": {"azimuth": [(350, 10)]}},
            bad,
        ),
        "frozen": (series_of(frozen), {"frozen_run": 5}, held),
        "blade": (series_of(blocked), {"blade_threshold": 6.0}, bad),
        "despike": (series_of(spiky), {"despike": "median", "despike_threshold": 6.0}, bad),
    }


FAULTS = planted()


class TestFilters:
    @pytest.mark.parametrize("fault", FAULTS)
    def test_each_finds_its_fault_and_nothing_else(self, fault):
        series, rules, bad = FAULTS[fault]
        records = make_records(series, SCAN, quality=brs.QualityRules(**rules))
        alone = make_records(series.isel(sample=~bad), SCAN)
        xr.testing.assert_equal(records, alone)  # nothing is filled: as if the bad samples were not there
        assert dropped(records) == {fault.split()[0]: bad.sum()}
        assert bad.sum() >= 1
        by_beam = report_of(records)["by_beam"]
        expected = np.bincount(np.tile(BEAMS, len(bad) // len(BEAMS))[bad], minlength=len(BEAMS))
        assert by_beam[fault.split()[0]] == expected.tolist()
        line = next(line for line in describe_report(records) if line.startswith(f"dropped by {fault.split()[0]}:"))
        assert f": {bad.sum()} samples" in line
        assert f"most of beam {BEAMS[int(np.argmax(expected))]}, {expected.max()} of 1200" in line

    @pytest.mark.parametrize("fault", FAULTS)
    def test_off_it_drops_nothing(self, fault):
        series, _, _ = FAULTS[fault]
        assert dropped(make_records(series, SCAN)) == {}

    def test_all_at_once_count_each_sample_once_in_the_stated_order(self):
        """One sample has every fault, the next all but the first, and so on: each counts for the first that is left."""
        velocity, n = sound(), len(sound())
        order = ["missing", "status", "mask_rain", "cnr", "snr", "velocity", "hard_target", "sector_rotor_angle"]
        table = {
            "status": np.ones(n),
            "rain": np.zeros(n),
            "cnr": np.full(n, -10.0),
            "snr": np.full(n, 10.0),
            "rotor_angle": np.full(n, 90.0),
        }
        for place in range(len(order)):
            index = 30 * (place + 1)
            if place <= 6:
                velocity[index] = 0.1 if place == 6 else 99.0
            table["rotor_angle"][index] = 0.0
            table["status"][index] = 0.0 if place <= 1 else 1.0
            table["rain"][index] = 1.0 if place <= 2 else 0.0
            table["cnr"][index] = 50.0 if place <= 3 else 20.0
            table["snr"][index] = -99.0 if place <= 4 else 10.0
        velocity[30] = np.nan
        rules = brs.QualityRules(
            status_valid=1,
            masks=("rain",),
            cnr_range=(-20.0, 30.0),
            snr_range=(0.0, 30.0),
            velocity_range=(-50.0, 50.0),
            hard_target_cnr=15.0,
            blocked_sectors={"rotor_angle": [(350, 10)]},
            frozen_run=3,
            blade_threshold=8.0,
            despike="median",
            despike_threshold=8.0,
        )
        report = report_of(make_records(series_of(velocity, **table), SCAN, quality=rules))
        assert list(report["dropped"]) == [*order, "frozen", "blade", "despike"]
        assert [report["dropped"][name] for name in order] == [1] * len(order)
        assert report["samples_used"] == n - len(order)

    @settings(max_examples=40, deadline=None)
    @given(st.integers(0, 2**32 - 1), st.integers(1, 400))
    def test_counts_add_up_and_order_does_not_matter(self, seed, n):
        """Came = repeated + dropped by each + used, in all and for each beam; whatever the order of the rows."""
        rng = np.random.default_rng(seed)
        series = series_of(
            np.where(
                rng.random(n) < 0.1, np.nan, rng.choice([-9.0, -8.5, -8.0, 0.1, 40.0], n) + rng.choice([0, 0.1], n)
            ),
            seconds=rng.integers(0, 1500, n),
            beam=rng.integers(0, 3, n),
            cnr=rng.choice([-30.0, -10.0, 5.0, np.nan], n, p=[0.1, 0.7, 0.1, 0.1]),
            status=rng.choice([0.0, 1.0, 2.0], n, p=[0.1, 0.8, 0.1]),
            rain=rng.random(n) < 0.1,
            azimuth=rng.uniform(-720.0, 720.0, n),
        )
        # of samples of one beam at one time the first counts, so that only those may not change places
        unique = series.isel(
            sample=np.unique(series["beam"] * 10_000 + (series["time"] - START) // 10**9, return_index=True)[1]
        )
        rules = brs.QualityRules(
            status_valid=(1,),
            masks=("rain",),
            cnr_range=(-23.0, 10.0),
            velocity_range=(-30.0, 30.0),
            hard_target_cnr=0.0,
            blocked_sectors={"azimuth": [(-10, 5), (170, 200)]},
            frozen_run=3,
            blade_threshold=3.0,
            despike="median",
        )
        report = report_of(make_records(series, SCAN, quality=rules, min_count=1))
        assert (
            report["samples"]
            == n
            == (report["duplicates_dropped"] + sum(report["dropped"].values()) + report["samples_used"])
        )
        by_beam = report["by_beam"]
        filters = [name for name in by_beam if name not in ("beam", "samples", "used")]
        for index in range(len(by_beam["beam"])):
            lost = sum(by_beam[name][index] for name in filters)
            assert by_beam["samples"][index] == lost + by_beam["used"][index]
        assert {name: sum(by_beam[name]) for name in filters} == {k: v for k, v in report["dropped"].items() if v}
        shuffled = unique.isel(sample=rng.permutation(unique.sizes["sample"]))
        one, two = (make_records(data, SCAN, quality=rules, min_count=1) for data in (unique, shuffled))
        xr.testing.assert_identical(one.drop_attrs(), two.drop_attrs())
        assert report_of(one)["dropped"] == report_of(two)["dropped"]

    @settings(max_examples=30, deadline=None)
    @given(st.integers(0, 2**32 - 1))
    def test_what_passed_passes_again(self, seed):
        """Filters that look at one sample, and that for frozen values: bad samples made missing, no more are found."""
        rng = np.random.default_rng(seed)
        velocity = rng.choice([-3.0, -2.0, -1.0, 0.0, 40.0], 300)
        cnr = rng.uniform(-30.0, 10.0, 300)
        rules = brs.QualityRules(
            cnr_range=(-23.0, 10.0), velocity_range=(-30.0, 30.0), hard_target_cnr=0.0, frozen_run=3
        )
        samples = sort_samples(series_of(velocity, cnr=cnr), SCAN, rules.needed_columns()).in_records(600 * 10**9)[0]
        keep = apply_filters(samples, rules).keep
        left = BeamSamples(
            samples.time,
            samples.beam,
            samples.group,
            np.where(keep, samples.velocity, np.nan),
            samples.columns,
            samples.numbers,
            samples.n_record,
        )
        np.testing.assert_array_equal(apply_filters(left, rules).keep, keep)

    def test_unequal_counts_go_on(self):
        series, rules, bad = FAULTS["cnr"]
        count = make_records(series, SCAN, quality=brs.QualityRules(**rules))["count"].values
        expected = [[600 - bad[i * 1800 + b : (i + 1) * 1800 : 3].sum() for b in BEAMS] for i in range(N_RECORD)]
        np.testing.assert_array_equal(count, expected)
        assert len(np.unique(count)) > 1

    def test_the_status_of_the_rules_counts_before_that_of_the_file(self):
        series = series_of(sound(), status=np.tile([1.0, 2.0, 2.0], 1200)).assign_attrs(status_valid=1.0)
        assert dropped(make_records(series, SCAN)) == {"status": 2400}
        assert dropped(make_records(series, SCAN, quality=brs.QualityRules(status_valid=2))) == {"status": 1200}


class TestFrozen:
    @settings(max_examples=100, deadline=None)
    @given(
        st.lists(st.tuples(st.integers(0, 2), st.integers(0, 1), st.booleans()), min_size=1, max_size=40),
        st.integers(2, 5),
    )
    def test_against_a_slow_one(self, rows, run):
        rows = sorted(rows, key=lambda row: row[1])
        velocity, beam, there = (np.array(column) for column in zip(*rows, strict=True))
        expected = np.zeros(len(rows), dtype=bool)
        for first in range(len(rows)):
            last = first
            while last < len(rows) and there[last] and velocity[last] == velocity[first] and beam[last] == beam[first]:
                last += 1
            if last - first >= run:
                expected[first:last] = True
        np.testing.assert_array_equal(is_frozen(velocity.astype(float), beam, there, run=run), expected)


class TestSectors:
    @pytest.mark.parametrize(
        ("sector", "inside", "outside"),
        [
            ((350, 10), (350.0, 0.0, 360.0, 10.0, -5.0, 725.0), (349.9, 10.1, 180.0)),
            ((80, 100), (80.0, 90.0, 100.0, -270.0), (79.9, 100.1, 270.0)),
            ((0, 360), (0.0, 123.0, -77.0), ()),
            ((-10, 10), (355.0, 5.0), (180.0,)),
        ],
    )
    def test_sector(self, sector, inside, outside):
        assert in_sectors(np.array(inside), [sector]).all()
        assert not in_sectors(np.array(outside, dtype=float), [sector]).any()

    def test_an_unknown_angle_lies_in_none(self):
        assert not in_sectors(np.array([np.nan]), [(0, 360)]).any()

    @given(st.floats(-720, 720), st.floats(-360, 360), st.floats(1, 359), st.integers(-3, 3))
    def test_turning_everything_changes_nothing(self, angle, first, width, turn):
        """But at the very ends, where rounding decides."""
        if min((angle - first) % 360.0, 360.0 - (angle - first) % 360.0, abs((angle - first) % 360.0 - width)) > 1e-6:
            one = in_sectors(np.array([angle]), [(first, first + width)])
            two = in_sectors(np.array([angle + 360.0 * turn]), [(first, first + width)])
            assert one == two


class TestWindSectors:
    def test_a_beam_is_left_out_in_that_wind_only(self):
        """Wind from 10° and from −20°: beam 0 stands in a wake in the first, and spoils it; the rest gives the wind."""
        scan = brs.load_scan("4-beam")
        seconds = np.repeat(np.arange(1200.0), 4)
        beam = np.tile(scan.beam, 1200)
        mean = 9.0 * scan.at_yaw(np.deg2rad([10.0, -20.0]))[:, :, 0]
        mean[0, 0] *= 0.98
        velocity = mean[(seconds // 600).astype(int), beam] + np.where(seconds % 2, 0.5, -0.5)
        series = series_of(velocity, seconds=seconds, beam=beam)
        rules = brs.QualityRules(wind_sectors={0: [(0, 30)]})
        records = make_records(series, scan, quality=rules)
        flagged = np.zeros((2, 4), dtype=np.uint8)
        flagged[0, 0] = BEAM_FLAGS["wind_sector"]
        np.testing.assert_array_equal(records["flag"], flagged)
        np.testing.assert_allclose(records["yaw"], [10.0, -20.0], atol=1e-9)
        assert records["record_flag"].values.tolist() == [RECORD_FLAGS["beam_flagged"], 0]
        assert make_records(series, scan)["yaw"].values[0] != pytest.approx(10.0, abs=0.1)
        assert any(line.startswith("flag wind_sector: 1 of 8") for line in describe_report(records))


class TestPeriodicity:
    def test_blades_are_found_at_their_frequency(self):
        """A fifth of a turn a second and three blades: 0.6 Hz, seen ten times a second, through a tenth of the turn."""
        seconds = np.arange(0.0, 600.0, 0.1)
        event = (0.6 * seconds + 0.3) % 1.0 < 0.1
        found = find_periodicity(seconds, event, frequency_range=(0.3, 1.0))
        assert found.frequency == pytest.approx(0.6, abs=1.0 / 120.0)
        assert found.p_value < 1e-12
        assert found.n_event == event.sum()

    def test_the_report_says_which_beam(self):
        rng = np.random.default_rng(6)
        velocity = sound()
        seconds = np.repeat(np.arange(1200), 3)
        beam = np.tile(BEAMS, 1200)
        phase = (0.41 * seconds) % 1.0
        velocity[(beam == 1) & (phase < 0.15)] = 0.0
        velocity[(beam == 2) & (rng.random(3600) < 0.15)] = 0.0
        rules = brs.QualityRules(blade_threshold=6.0, blade_frequency=(0.3, 0.49))
        records = make_records(series_of(velocity), SCAN, quality=rules)
        found = {one["beam"]: one for one in report_of(records)["blades"]}
        assert found[0]["events"] == 0
        assert found[0]["p_value"] is None
        assert found[1]["frequency"] == pytest.approx(0.41, abs=1.0 / 120.0)
        assert found[1]["p_value"] < 1e-6
        assert found[2]["p_value"] > 0.01
        lines = [line for line in describe_report(records) if "as blades do" in line]
        assert len(lines) == 1
        assert re.match(r"beam 1: its \d+ blocked or slow samples come at 0\.4\d* Hz", lines[0])

    @pytest.mark.parametrize("n_event", [40, 300])
    @pytest.mark.parametrize("cadence", ["even", "scanning", "uneven"])
    def test_random_events_are_not_periodic(self, cadence, n_event):
        """At a single frequency the p-value of random events is uniform, whatever the samples' own beat.

        400 draws: the share below a level has a standard error of at most 0.025, and 4.5 of them are allowed.
        """
        rng = np.random.default_rng(7)
        seconds = {
            "even": np.arange(0.0, 600.0, 1.0),
            "scanning": (np.arange(0.0, 600.0, 2.0)[:, None] + [0.0, 0.1, 0.2, 0.3]).ravel(),  # a beat at 0.5 Hz
            "uneven": np.sort(rng.uniform(0.0, 600.0, 500)),
        }[cadence]
        p_values = []
        for _ in range(400):
            event = np.zeros(len(seconds), dtype=bool)
            event[rng.choice(len(seconds), n_event, replace=False)] = True
            p_values.append(find_periodicity(seconds, event, frequency_range=(0.47, 0.4701)).p_value)
        p_values = np.array(p_values)
        for level in (0.05, 0.2, 0.5, 0.8):
            error = np.sqrt(level * (1.0 - level) / 400.0)
            assert np.mean(p_values < level) == pytest.approx(level, abs=4.5 * error)

    def test_looking_at_many_frequencies_costs(self):
        """Without the factor for the frequencies tried, nearly all of 100 random cases were below 0.05."""
        rng = np.random.default_rng(12)
        found = [
            find_periodicity(np.arange(300.0), rng.random(300) < 0.1, frequency_range=(0.1, 0.4)).p_value
            for _ in range(100)
        ]
        assert np.mean(np.array(found) < 0.05) <= 0.14  # 0.05 and four standard errors

    def test_where_the_samples_beat_nothing_is_seen(self):
        seconds = np.arange(600.0)
        event = np.random.default_rng(8).random(600) < 0.1
        found = find_periodicity(seconds, event, frequency_range=(1.0, 1.0001))
        assert np.isnan(found.p_value)

    def test_no_event_no_finding(self):
        found = find_periodicity(np.arange(600.0), np.zeros(600, dtype=bool), frequency_range=(0.3, 0.5))
        assert np.isnan(found.frequency)
        assert found.n_event == 0


def parts_of(mean, variance=None, count=None) -> Parts:
    """Parts of one record and beam."""
    mean = np.asarray(mean, dtype=float)[None, None]
    variance = np.ones(mean.shape) if variance is None else np.asarray(variance, dtype=float)[None, None]
    count = np.full(mean.shape, 10) if count is None else np.asarray(count)[None, None]
    return Parts(count, mean, variance)


class TestStationarity:
    @pytest.mark.parametrize("gaps", [[], [2], [0, 5]])
    def test_trend_against_scipy(self, gaps):
        rng = np.random.default_rng(9)
        mean = 0.3 * np.arange(8) + rng.normal(size=8)
        count = np.full(8, 10)
        count[gaps] = 0
        mean[gaps] = np.nan
        change, p_value = trend(parts_of(mean, count=count))
        there = count > 0
        place = ((np.arange(8) + 0.5) / 8)[there]
        expected = scipy.stats.linregress(place, mean[there])
        assert change[0, 0] == pytest.approx(expected.slope, rel=1e-10)  # per record: place runs from 0 to 1
        assert p_value[0, 0] == pytest.approx(expected.pvalue, rel=1e-9)

    def test_trend_needs_four_parts(self):
        change, p_value = trend(parts_of([1.0, 2.0, 3.0, np.nan], count=[5, 5, 5, 0]))
        assert np.isnan(change).all()
        assert np.isnan(p_value).all()

    def test_a_constant_has_no_trend(self):
        change, p_value = trend(parts_of([0.1] * 6))
        assert change == 0.0
        assert not (p_value < 0.05).any()

    def test_a_level_is_kept_by_independent_means(self):
        """1000 records of white noise, one beam: the share below 0.01 is within 4 standard errors, 0.0126."""
        rng = np.random.default_rng(10)
        _, p_value = trend(Parts(np.full((1000, 1, 6), 10), rng.normal(size=(1000, 1, 6)), np.ones((1000, 1, 6))))
        assert np.mean(p_value < 0.01) == pytest.approx(0.01, abs=0.0126)

    @settings(max_examples=50, deadline=None)
    @given(st.lists(st.floats(-30, 30), min_size=8, max_size=60), st.integers(2, 6))
    def test_share_against_numpy(self, values, number):
        """1 − (variance within parts)/(variance), from a plain loop over the parts."""
        values = np.array(values)
        window = 600 * 10**9
        n = len(values)
        time = np.linspace(0, window, n, endpoint=False).astype(np.int64)
        samples = BeamSamples(time, np.zeros(n, np.int64), np.zeros(n, np.int64), values, {}, np.array([0]), 1)
        parts = parts_of_records(samples, np.ones(n, dtype=bool), window=window, number=number)
        pieces = [values[(time * number // window) == k] for k in range(number)]
        np.testing.assert_array_equal(parts.count[0, 0], [len(piece) for piece in pieces])
        within = sum(len(piece) * piece.var() for piece in pieces if len(piece)) / n
        if values.var() > 1e-6:
            assert share_between_parts(parts)[0, 0] == pytest.approx(1.0 - within / values.var(), abs=1e-9)

    def test_empty_parts_do_not_count(self):
        share = share_between_parts(parts_of([1.0, np.nan, 3.0], variance=[2.0, np.nan, 2.0], count=[5, 0, 5]))
        assert share[0, 0] == pytest.approx(1.0 / 3.0)  # 1 between, 2 within

    def test_half_ratio(self):
        assert half_ratio(parts_of([0.0, 0.0], variance=[2.0, 6.0]))[0, 0] == pytest.approx(3.0)

    def test_median_over_used_beams(self):
        values = np.array([[1.0, 2.0, 9.0], [np.nan, 2.0, 4.0], [np.nan, 1.0, 1.0]])
        used = np.array([[True, True, True], [True, True, True], [True, False, False]])
        np.testing.assert_array_equal(beam_median(values, used), [2.0, 3.0, np.nan])


def with_faults() -> xr.Dataset:
    """Five records: sound, a ramp, less variance in the second half, little wind, sound but for one beam's ramp."""
    velocity = sound(seed=11, n_record=5)
    seconds = np.repeat(np.arange(3000), 3)
    beam = np.tile(BEAMS, 3000)
    number, within = seconds // 600, seconds % 600 / 600.0
    velocity = velocity + 3.0 * (within - 0.5) * (number == 1)
    velocity = np.where((number == 2) & (within < 0.5), -9.0 + 3.0 * (velocity + 9.0), velocity)
    velocity = np.where(number == 3, velocity + 8.0, velocity)
    velocity = velocity + 3.0 * (within - 0.5) * ((number == 4) & (beam == 1))
    return series_of(velocity)


ALL_CHECKS = {"trend_level": 1e-3, "sub_variance_limit": 0.3, "half_ratio_limit": 4.0, "min_wind_speed": 4.0}


class TestRemarks:
    @pytest.mark.parametrize(
        ("rules", "expected"),
        [
            ({"trend_level": 1e-3}, [0, 16, 0, 0, 0]),
            ({"sub_variance_limit": 0.3}, [0, 16, 0, 0, 0]),
            ({"half_ratio_limit": 4.0}, [0, 0, 16, 0, 0]),
            ({"min_wind_speed": 4.0}, [0, 0, 0, 32, 0]),
            (ALL_CHECKS, [0, 16, 16, 32, 0]),
        ],
    )
    def test_each_check_finds_its_fault_and_nothing_else(self, rules, expected):
        assert REMARK_FLAGS == {"not_stationary": 16, "low_wind": 32, "spikes": 64}
        records = make_records(with_faults(), SCAN, quality=brs.QualityRules(**rules))
        np.testing.assert_array_equal(records["record_flag"], expected)
        assert not records["flag"].any()  # a remark: every beam stays in use

    def test_numbers_stand_in_the_records(self):
        series = with_faults()
        records, plain = make_records(series, SCAN, quality=brs.QualityRules(**ALL_CHECKS)), make_records(series, SCAN)
        assert set(records.data_vars) - set(plain.data_vars) == {"trend", "trend_p_value", "sub_variance", "half_ratio"}
        xr.testing.assert_equal(records[list(plain.data_vars)].drop_vars("record_flag"), plain.drop_vars("record_flag"))
        np.testing.assert_allclose(records["trend"][1], 3.0, atol=0.6)  # 4 standard errors of a slope of 600 samples
        np.testing.assert_allclose(1.0 / records["half_ratio"][2], 9.0, rtol=0.5)
        lines = describe_report(records)
        assert "flag not_stationary: 2 of 5 records, first 2020-09-03T19:10:00Z" in lines
        assert "flag low_wind: 1 of 5 records, first 2020-09-03T19:30:00Z" in lines

    def test_excluded_records_stay_with_all_beams_flagged(self):
        rules = brs.QualityRules(**ALL_CHECKS, exclude=("not_stationary", "low_wind"))
        records = make_records(with_faults(), SCAN, quality=rules)
        excluded = np.array([False, True, True, True, False])
        np.testing.assert_array_equal(records["flag"], 32 * excluded[:, None] * np.ones(3))
        assert BEAM_FLAGS["record_excluded"] == 32
        assert np.isfinite(records["variance"]).all()
        assert np.isfinite(records["wind_speed"]).all()
        assert report_of(records)["beams_rarely_usable"] == []

    def test_the_result_says_so(self):
        flow = brs.load_turbulence("fu-2022")
        scan = brs.load_scan("2-beam")
        series = brs.simulate(scan, flow, wind_speed=10.0, n_records=3, seed=1)
        rules = brs.QualityRules(sub_variance_limit=1e-9, min_wind_speed=1.0)
        records = make_records(series, scan, quality=rules)
        noise = brs.noise.calibrate(scan, flow, wind_speed=10.0)
        result = brs.fit(records, scan, noise=noise, seed=1, sampler="direct", target_ess=100)
        words = [flag_words(flag) for flag in result["sample_stats/flag"].values]
        assert words == ["not_stationary"] * 3
        assert np.isfinite(result["posterior/stress"]).all()
        out = make_records(series, scan, quality=brs.QualityRules(min_wind_speed=20.0, exclude=["low_wind"]))
        flags = brs.fit(out, scan, noise=noise, seed=1)["sample_stats/flag"].values
        assert [flag_words(flag) for flag in flags] == ["low_wind;excluded"] * 3

    def test_few_samples_a_part(self):
        """Twenty samples a record, as of a slow scan: the checks know or say nothing, and raise no warning."""
        series = series_of(sound()[:120], seconds=30.0 * np.arange(120), beam=np.zeros(120))
        rules = brs.QualityRules(**ALL_CHECKS, sub_records=40)
        records = make_records(series, SCAN, expected_count=20, quality=rules)
        assert records["count"].values.ravel().tolist() == [20] * 6
        assert np.isfinite(records["trend_p_value"]).all()
        gappy = make_records(series.isel(sample=[0, 1, 2, 60]), SCAN, min_count=1, quality=rules)
        assert np.isnan(gappy["trend_p_value"]).all()
        assert (gappy["record_flag"] & REMARK_FLAGS["not_stationary"]).values.sum() <= 1

    def test_records_survive_netcdf(self, tmp_path):
        records = make_records(with_faults(), SCAN, quality=brs.QualityRules(**ALL_CHECKS, blade_frequency=(0.3, 0.4)))
        records.to_netcdf(tmp_path / "records.nc")
        with xr.open_dataset(tmp_path / "records.nc") as again:
            xr.testing.assert_equal(again, records)
            assert describe_report(again) == describe_report(records)


class TestPersistentBlockage:
    def test_a_beam_that_is_mostly_flagged_is_named(self):
        velocity = sound(n_record=4)
        beam = np.tile(BEAMS, 2400)
        number = np.repeat(np.arange(2400), 3) // 600
        velocity[(beam == 2) & (number < 3)] = np.nan  # three of four
        velocity[(beam == 1) & (number < 2)] = np.nan  # half is not more than half
        records = make_records(series_of(velocity), SCAN)
        assert report_of(records)["beams_rarely_usable"] == [2]
        assert "beams flagged in more than half of the records: 2" in describe_report(records)

    def test_gaps_of_all_beams_do_not_count(self):
        velocity = sound(n_record=5)
        number = np.repeat(np.arange(3000), 3) // 600
        series = series_of(velocity).isel(sample=(number == 0) | (number == 4))
        assert report_of(make_records(series, SCAN))["beams_rarely_usable"] == []


class TestAvailabilityTable:
    def test_hour_by_hour(self):
        velocity = sound(n_record=8)
        beam, number = np.tile(BEAMS, 4800), np.repeat(np.arange(4800), 3) // 600
        velocity[(beam == 1) & (number < 3) & (np.arange(14400) % 1800 >= 300)] = np.nan  # 100 of 600 are left
        records = make_records(series_of(velocity), SCAN)
        table = brs.records.availability_table(records)
        assert table.columns.tolist() == ["time", "beam", "records", "usable", "samples", "availability"]
        assert (
            table["time"].tolist() == [np.datetime64("2020-09-03T19:00")] * 3 + [np.datetime64("2020-09-03T20:00")] * 3
        )
        assert table["beam"].tolist() == [0, 1, 2] * 2
        assert table["records"].tolist() == [6] * 3 + [2] * 3
        assert table["usable"].tolist() == [1.0, 0.5, 1.0, 1.0, 1.0, 1.0]
        assert table["samples"].tolist() == [3600, 2100, 3600, 1200, 1200, 1200]
        assert table["availability"].tolist() == [1.0, 2100 / 3600, 1.0, 1.0, 1.0, 1.0]

    def test_adds_up_to_the_records(self):
        series, rules, _ = FAULTS["cnr"]
        records = make_records(series, SCAN, quality=brs.QualityRules(**rules))
        day = brs.records.availability_table(records, every="1D")
        assert day["samples"].tolist() == records["count"].values.sum(axis=0).tolist()
        assert day["time"].tolist() == [np.datetime64("2020-09-03")] * 3

    @pytest.mark.parametrize("every", ["hourly", "-1h", "0s"])
    def test_a_step_that_is_none(self, every):
        with pytest.raises(InputError, match=rf"Invalid every '{every}': it must be"):
            brs.records.availability_table(make_records(series_of(sound()), SCAN), every=every)

    def test_records_of_another_kind(self):
        records = make_records(series_of(sound()), SCAN)
        with pytest.raises(InputError, match="The records have no count with dims"):
            brs.records.availability_table(records.drop_vars("count"))
        with pytest.raises(InputError, match="The records have no time with dims"):
            brs.records.availability_table(records.drop_vars("time"))
        with pytest.raises(InputError, match="The records have no records_report"):
            brs.records.availability_table(records.drop_attrs())


class TestBadInput:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"snr_range": (3.0,)}, "Invalid snr_range (3.0,) dB: it must be a pair (low, high) with low < high."),
            ({"cnr_range": {1: (0.0, -1.0)}}, "Invalid cnr_range of beam 1 (0.0, -1.0) dB: it must be a pair"),
            ({"velocity_range": (1.0, 1.0)}, "Invalid velocity_range (1.0, 1.0) m/s: it must be a pair"),
            ({"blade_frequency": (0.0, 1.0)}, "Invalid blade_frequency 0.0 Hz in its lower end: it must be a finite"),
            (
                {"blade_frequency": (0.1, np.inf)},
                "Invalid blade_frequency inf Hz in its upper end: it must be a finite",
            ),
            ({"status_valid": ()}, "Invalid status_valid (): it must hold at least one number, or be left out."),
            ({"status_valid": ("good",)}, "Invalid status_valid 'good': it must be a finite number."),
            ({"status_reject_bits": 0}, "Invalid status_reject_bits 0: it must be a whole number of at least 1."),
            ({"masks": "rain"}, "Invalid masks 'rain': it must be a sequence of names, as ('rain',)."),
            ({"exclude": ["rain"]}, "Unknown remark in exclude 'rain': it must be one of not_stationary, low_wind."),
            ({"blade_window": 4}, "Invalid blade_window 4: it must be an odd number of samples."),
            ({"blade_threshold": 0.0}, "Invalid blade_threshold 0.0: it must be a finite number above zero."),
            ({"hard_target_cnr": "high"}, "Invalid hard_target_cnr 'high' dB: it must be a finite number."),
            ({"hard_target_speed": 0.0}, "Invalid hard_target_speed 0.0 m/s: it must be a finite number above zero."),
            ({"frozen_run": 1}, "Invalid frozen_run 1: it must be a whole number of at least 2."),
            ({"sub_records": 3}, "Invalid sub_records 3: it must be a whole number of at least 4."),
            ({"trend_level": 1.0}, "Invalid trend_level 1.0: it must be between 0 and 1; 0.01 is usual."),
            ({"half_ratio_limit": 1.0}, "Invalid half_ratio_limit 1.0: it must be above 1; 4 is usual."),
            ({"min_wind_speed": 0.0}, "Invalid min_wind_speed 0.0 m/s: it must be a finite number above zero."),
            ({"blocked_sectors": {"azimuth": [(1, 2, 3)]}}, "Invalid sectors [(1, 2, 3)]: each must be a pair"),
            ({"wind_sectors": {0: [(0, np.nan)]}}, "Invalid sectors [(0, nan)]: each must be a pair"),
            (
                {"exclude": ["low_wind"], "trend_level": 0.01},
                "Invalid exclude 'low_wind': it does nothing without min_wind_speed (--min-wind-speed); give that, or",
            ),
            (
                {"exclude": ["not_stationary"], "min_wind_speed": 3.0},
                "exclude 'not_stationary': it does nothing without trend_level (--trend-level) or sub_variance",
            ),
            (
                {"hard_target_speed": 2.0},
                "Invalid hard_target_speed 2.0: it does nothing without hard_target_cnr (--",
            ),
            ({"blade_window": 13}, "Invalid blade_window 13: it does nothing without blade_threshold (--blade"),
            ({"despike_window": 13}, "Invalid despike_window 13: it does nothing without despike (--despike); give"),
            (
                {"despike_threshold": 6.0},
                "Invalid despike_threshold 6.0: it does nothing without despike (--despike); give",
            ),
            (
                {"sub_records": 10, "half_ratio_limit": 4.0},
                "Invalid sub_records 10: it does nothing without trend_level (--trend-level) or sub_v",
            ),
        ],
    )
    def test_rules(self, options, message):
        with pytest.raises(InputError, match=re.escape(message)):
            brs.QualityRules(**options)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"masks": ("rain",)}, "Invalid masks ('rain',): the series has no rain; add it to the series, or leave"),
            ({"snr_range": (0.0, 1.0)}, "Invalid snr_range (0.0, 1.0) dB: the series has no snr; add it to the series"),
            ({"hard_target_cnr": 0.0}, "Invalid hard_target_cnr 0.0 dB: the series has no cnr; map it"),
            ({"status_valid": 1}, "Invalid status_valid 1.0: the series has no status; map it"),
            ({"masks": ("words",)}, "Invalid variable 'words' of the series: it must hold numbers over"),
            ({"wind_sectors": {9: [(0, 1)]}}, "Unknown beam 9 in quality: the beams of scan '6-beam' are [0, 1"),
            ({"cnr_range": {7: (0.0, 1.0)}}, "Unknown beam 7 in quality"),
        ],
    )
    def test_series_without_what_the_rules_need(self, options, message):
        series = series_of(sound(), words=["a"] * 3600)
        with pytest.raises(InputError, match=re.escape(message)):
            make_records(series, SCAN, quality=brs.QualityRules(**options))

    def test_rules_of_another_kind(self):
        with pytest.raises(InputError, match="it must be a QualityRules, as"):
            make_records(series_of(sound()), SCAN, quality={"despike": "median"})
