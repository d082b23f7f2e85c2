"""Turbulence intensity against a reference: matching by time, errors as they are defined, and coverage."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from test_sonic_series import write_toa5

from bayes_rs import InputError
from bayes_rs.fits.intensity_metrics import (
    ALL_SPEEDS,
    BIAS_LIMIT,
    RRMSE_LIMIT,
    intensity_errors,
    representative_intensity,
)
from bayes_rs.fits.intensity_reference import intensity_reference
from bayes_rs.wind import sonic_stresses

START = np.datetime64("2020-09-03T19:00", "ns") + np.arange(5) * np.timedelta64(600, "s")
TI = np.array([0.10, 0.12, 0.14, 0.16, 0.18])


def table(**columns):
    return pd.DataFrame({"time": START, "ti": TI, **columns})


class TestErrors:
    def test_they_are_means_of_relative_errors_and_of_their_squares(self):
        """A slow sum, record by record, with what DNV-RP-0661 calls MRBE and RRMSE."""
        rng = np.random.default_rng(1)
        reference, speed = rng.uniform(0.05, 0.3, 60), rng.uniform(3.6, 8.4, 60)
        measured = reference * rng.normal(1.03, 0.1, 60)
        found = intensity_errors(measured, 0.9 * measured, 1.1 * measured, reference, speed)
        for row in found.to_dict("records"):
            own = [
                (one, other)
                for one, other, wind in zip(measured, reference, speed, strict=True)
                if row["bin"] == "all" or abs(wind - row["wind_speed"]) < 0.5
            ]
            error = [(one - other) / other for one, other in own]
            assert row["n_record"] == len(own)
            assert row["mrbe"] == pytest.approx(sum(error) / len(own), rel=1e-12)
            assert row["rrmse"] == pytest.approx((sum(one * one for one in error) / len(own)) ** 0.5, rel=1e-12)
            held = [0.9 * one <= other <= 1.1 * one for one, other in own]
            assert row["coverage"] == pytest.approx(sum(held) / len(own))
        assert int(found["n_record"].iloc[1:].sum()) == 60

    def test_a_constant_factor_is_all_bias_and_has_no_scatter(self):
        found = intensity_errors(1.04 * TI, TI, 1.1 * TI, TI, np.full(5, 8.0))
        assert found["mrbe"].tolist() == pytest.approx([0.04, 0.04])
        assert found["rrmse"].tolist() == pytest.approx([0.04, 0.04])
        assert found["mrbe_se"].to_numpy() == pytest.approx(0.0, abs=1e-15)  # rounding

    def test_bins_are_those_of_a_campaign(self):
        found = intensity_errors(TI, TI, TI, TI, np.array([7.4, 7.5, 8.0, 8.49, 8.5]))
        assert found["bin"].tolist() == ["all", "6.5-7.5 m/s", "7.5-8.5 m/s", "8.5-9.5 m/s"]
        assert found["n_record"].tolist() == [5, 1, 3, 1]
        assert np.isnan(found["mrbe_se"].iloc[1])

    def test_records_that_lack_a_number_are_left_out(self):
        lost = np.array([np.nan, 0.12, 0.14, 0.0, 0.18])
        assert intensity_errors(TI, TI, TI, lost, np.full(5, 8.0))["n_record"].tolist() == [3, 3]
        assert intensity_errors(TI, TI, TI, np.full(5, np.nan), np.full(5, 8.0)).empty

    def test_the_limits_are_those_that_are_quoted(self):
        assert (BIAS_LIMIT, RRMSE_LIMIT) == (0.05, 0.15)


class TestRepresentative:
    def test_it_is_the_90_percent_quantile_of_normal_intensities(self):
        """Φ(1.28) = 0.8997; a hundred thousand draws tell a quantile to 0.006 standard deviations."""
        draws = np.random.default_rng(2).normal(0.14, 0.02, 100_000)
        assert representative_intensity(draws) == pytest.approx(np.quantile(draws, 0.9), abs=4 * 0.006 * 0.02)

    def test_it_is_of_bins_and_of_two_records_at_least(self):
        rng = np.random.default_rng(3)
        reference, speed = rng.uniform(0.08, 0.2, 40), np.append(rng.uniform(6.6, 8.4, 39), 12.0)
        measured = 1.1 * reference
        found = intensity_errors(measured, measured, measured, reference, speed).set_index("bin")
        for name, low in (("6.5-7.5 m/s", 6.5), ("7.5-8.5 m/s", 7.5)):
            own = reference[(speed >= low) & (speed < low + 1.0)].tolist()
            mean = sum(own) / len(own)
            sd = (sum((one - mean) ** 2 for one in own) / (len(own) - 1)) ** 0.5
            assert found.loc[name, "reference_representative"] == pytest.approx(mean + 1.28 * sd, rel=1e-12)
            assert found.loc[name, "measured_representative"] == pytest.approx(1.1 * (mean + 1.28 * sd), rel=1e-12)
            assert found.loc[name, "representative_error"] == pytest.approx(0.1, rel=1e-12)
        columns = ["measured_representative", "reference_representative", "representative_error"]
        assert found.loc[[ALL_SPEEDS, "11.5-12.5 m/s"], columns].isna().all().all()

    def test_scatter_of_the_lidar_alone_is_an_error_of_it(self):
        """Errors without a bias leave the mean, and raise the representative intensity: √(s² + e²) in place of s."""
        rng = np.random.default_rng(4)
        reference = rng.normal(0.15, 0.015, 20_000)
        measured = reference + rng.normal(0.0, 0.02, 20_000)
        row = intensity_errors(measured, measured, measured, reference, np.full(20_000, 8.0)).iloc[1]
        assert abs(row["measured"] / row["reference"] - 1.0) < 0.005
        wanted = (0.15 + 1.28 * np.hypot(0.015, 0.02)) / (0.15 + 1.28 * 0.015) - 1.0
        assert row["representative_error"] == pytest.approx(wanted, abs=0.005)


class TestSonic:
    """The series of a sonic beside: its stresses are made for records of the same length."""

    @pytest.fixture
    def series(self):
        rng = np.random.default_rng(5)
        time = START[0] + np.arange(6000) * np.timedelta64(500, "ms")  # five records
        wind = {name: ("time", rng.normal(mean, 1.0, 6000)) for name, mean in (("u", 6.0), ("v", 8.0), ("w", 0.2))}
        return xr.Dataset(wind, coords={"time": time})

    def test_its_stresses_are_taken(self, series):
        stresses = sonic_stresses(series)
        ti, speed, _ = intensity_reference(stresses, START, 600.0)
        np.testing.assert_allclose(speed, stresses["wind_speed"].values)
        np.testing.assert_allclose(ti, np.sqrt(stresses["stress"].values[:, 0]) / speed)
        assert 0.09 < ti.mean() < 0.11  # 1 m/s in 10 m/s

    def test_a_file_and_a_folder_of_a_logger_are_read(self, series, tmp_path):
        whole = series.assign(temperature=("time", np.full(6000, 20.0)), status=("time", np.zeros(6000)))
        file = write_toa5(tmp_path / "mast.dat", whole)
        wanted = intensity_reference(sonic_stresses(series), START, 600.0)
        for source in (file, str(file), tmp_path):
            found = intensity_reference(source, START, 600.0)
            np.testing.assert_allclose(found, wanted, rtol=1e-9)  # twelve digits are written

    def test_records_of_another_length_get_stresses_of_that_length(self, series, tmp_path):
        whole = series.assign(temperature=("time", np.full(6000, 20.0)), status=("time", np.zeros(6000)))
        write_toa5(tmp_path / "mast.dat", whole)
        time = START[0] + np.arange(10) * np.timedelta64(300, "s")
        found = intensity_reference(tmp_path / "mast.dat", time, 300.0)
        np.testing.assert_allclose(found, intensity_reference(sonic_stresses(series, duration=300.0), time, 300.0))

    def test_stresses_of_another_length_are_refused(self, series):
        with pytest.raises(InputError, match="is of periods of 300 s, and the records last 600 s: make it for these"):
            intensity_reference(sonic_stresses(series, duration=300.0), START, 600.0)

    def test_another_dataset_is_refused(self, series):
        with pytest.raises(InputError, match=r"Invalid reference without 'stress': give .*sonic_stresses"):
            intensity_reference(series, START, 600.0)


class TestMatching:
    def test_rows_are_found_by_time_in_any_order(self):
        ti, speed, _ = intensity_reference(table(U=np.arange(1.0, 6.0)).iloc[[3, 0, 4, 1, 2]], START, 600.0)
        np.testing.assert_array_equal(ti, TI)
        np.testing.assert_array_equal(speed, np.arange(1.0, 6.0))

    def test_a_row_belongs_to_a_record_within_a_twentieth_of_its_length(self):
        late = [np.timedelta64(seconds, "s") for seconds in (0, 29, 31, -30, -31)]
        ti, _, _ = intensity_reference(table(), START + np.array(late), 600.0)
        assert np.isnan(ti).tolist() == [False, False, True, False, True]

    def test_sigma_over_wind_and_offsets_of_time(self, tmp_path):
        file = tmp_path / "mast.csv"
        file.write_text("Timestamp,sigma_u,U\n2020-09-03T21:00+02:00,1.0,10.0\n2020-09-03T21:10+02:00,,10\n")
        ti, speed, _ = intensity_reference(file, START, 600.0)
        assert ti[0] == pytest.approx(0.1)
        assert np.isnan(ti[1:]).all()
        assert speed[:2].tolist() == [10.0, 10.0]

    def test_rows_of_another_step_are_told(self, caplog):
        time = START[0] + np.arange(41) * np.timedelta64(60, "s")
        intensity_reference(pd.DataFrame({"time": time, "ti": 0.1}), START, 600.0)
        assert "The reference that was given has rows 60 s apart, and the records last 600 s" in caplog.text
        caplog.clear()
        intensity_reference(table(), START, 600.0)
        assert not caplog.text

    def test_records_without_a_time_have_none(self):
        time = START.copy()
        time[2] = np.datetime64("NaT")
        assert np.isnan(intensity_reference(table(), time, 600.0)[0]).tolist() == [False, False, True, False, False]

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            (
                pd.DataFrame({"when": START, "ti": TI}),
                r"has the columns 'when', 'ti', and needs time, and ti or sigma_u",
            ),
            (table().assign(ti=100.0 * TI), r"has the median 14: give σ_u/U, not per cent"),
            (table().assign(time="yesterday"), r"Row 0 of the reference that was given has the time 'yesterday'"),
            (table().assign(ti="much"), r"Row 0 of the reference that was given has ti 'much', which is no number"),
            (table().assign(time=START[0]), r"has 5 rows of 2020-09-03T19:00.*: keep one of a time"),
            (table().assign(time=START + np.timedelta64(300, "s")), r"No row of the reference .* begins with a record"),
            (table().iloc[:0], r"has 0 rows"),
            (
                table(ti=-9999.0),
                r"None of the 5 rows of the .* has a turbulence intensity above 0 and up to 1.*ti -9999",
            ),
            (table(ti=0.0), "None of the 5 rows"),
            (table(ti=np.nan), "None of the 5 rows"),
            (table(sigma_u=1.0, U=0.0).drop(columns="ti"), "None of the 5 rows .*the first has sigma_u 1.0, U 0.0"),
            (table(sigma_u=1.0, U=-9.0).drop(columns="ti"), "None of the 5 rows"),
            (table(U=-9999.0), r"None of the 5 rows .* up to 90 m/s"),
        ],
    )
    def test_what_cannot_be_matched_is_refused(self, given, words):
        with pytest.raises(InputError, match=words):
            intensity_reference(given, START, 600.0)

    @pytest.mark.parametrize("ti", [-9999.0, -0.1, 0.0, 12.0])
    def test_numbers_that_are_none_are_left_out_and_counted(self, ti):
        found, _, left_out = intensity_reference(table(ti=[0.12, ti, 0.11, np.nan, 0.1]), START, 600.0)
        np.testing.assert_array_equal(found, [0.12, np.nan, 0.11, np.nan, 0.1])
        assert left_out.tolist() == [False, True, False, False, False]  # an empty entry says itself that there is none

    def test_wind_speeds_that_are_none_are_left_out_and_counted(self):
        found, speed, left_out = intensity_reference(table(U=[8.0, -9999.0, 9999.0, np.nan, 0.0]), START, 600.0)
        assert np.isfinite(found).tolist() == np.isfinite(speed).tolist() == [True, False, False, False, False]
        assert left_out.tolist() == [False, True, True, True, True]

    def test_a_file_that_is_none(self, tmp_path):
        with pytest.raises(InputError, match=r"The reference '.*none.csv' cannot be read as CSV"):
            intensity_reference(tmp_path / "none.csv", START, 600.0)
