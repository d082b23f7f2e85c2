"""Only times that a file states count: no word and no part of a date is filled in from the clock of the machine."""

import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from fit_scene import NOISE, make_records
from fit_scene import SCAN as SIX_BEAM
from format_files import long_frame, series_of, wide_frame, write_hpl, write_mini_raw, write_spinnerlidar, write_zx
from hypothesis import given
from hypothesis import strategies as st
from ray_files import e_windlidar, rays_of, six_beam, windcube_sweep, write_windcube

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.readers import read, read_statistics
from bayes_rs.stated_time import says_since, stated_times, states_a_date
from bayes_rs.wind.motion import read_motion

WORDS = [
    "today", "now", "Today", "NOW", "tomorrow", "T", "Z", "10:30", "10:30:00", "T10:30", "Mon", "Jan", "Jan 5", "5",
    "2020", "2020-09", "2020/09", "09-03", "--09-03", "noon", "UTC", "+01:00", "3Q2020", "now UTC",
]  # fmt: skip
PATTERNS = [None, "%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M", "%Y%m%d %H:%M:%S.%f", "%A %d %B %Y"]
SIX = six_beam(45.0, step=1.0)
ZX = brs.load_scan("zx-tm")
SPINNER = brs.load_scan("spinnerlidar")
SHORT = series_of(SIX, n_scan=8)
RAYS = rays_of(SHORT, SIX)


@pytest.fixture(scope="module")
def found():
    return brs.fit(make_records(2), SIX_BEAM, noise=NOISE, sampler="direct", seed=1)


class TestWords:
    @pytest.mark.parametrize("pattern", PATTERNS)
    def test_no_word_and_no_part_of_a_date_is_a_time(self, pattern):
        assert stated_times(pd.Series(WORDS), pattern).isna().all()

    @given(st.text(alphabet="0123456789-:/. TZtodaynwMJ+", max_size=20) | st.sampled_from(WORDS))
    def test_what_is_a_time_states_its_year_month_and_day(self, text):
        """The law: every number of the date is in the text, so no clock can be in it."""
        time = stated_times(pd.Series([text]))[0]
        if not pd.isna(time):
            zone = re.search(r"[T ].*([+-]\d{2}:?\d{0,2})$", text)
            shift = pd.Timedelta(0) if zone is None else pd.Timestamp(f"2000-01-01T00:00{zone[1]}").utcoffset()
            written = re.match(r"(\d{4})\W?(\d{1,2})\W?(\d{1,2})", text)
            local = time + shift
            assert [int(number) for number in written.groups()] == [local.year, local.month, local.day]

    @given(st.datetimes(min_value=pd.Timestamp("1700-01-01"), max_value=pd.Timestamp("2200-01-01")))
    def test_whole_times_are_what_they_state(self, time):
        for text, pattern in (
            (time.isoformat(), None),
            (time.strftime("%d.%m.%Y %H:%M:%S.%f"), "%d.%m.%Y %H:%M:%S.%f"),
        ):
            assert stated_times(pd.Series([text]), pattern)[0] == pd.Timestamp(time, tz="UTC")


CSV = {
    "long": lambda file: long_frame(SHORT).to_csv(file, index=False),
    "wide": lambda file: wide_frame(SHORT).to_csv(file, index=False),
    "spinnerlidar": lambda file: write_spinnerlidar(file, series_of(SPINNER, n_scan=1), SPINNER),
    "zx": lambda file: write_zx(file, series_of(ZX, n_scan=2), ZX),
    "zx by headings": lambda file: write_mini_raw(file, series_of(ZX, n_scan=2), ZX),
}
OPTIONS = {
    "zx": {
        "columns": {"time": "When", "phase": "Scan angle", "radial_velocity": "LOS"},
        "time_format": "%d/%m/%Y %H:%M:%S.%f",
        "phase_zero_deg": 90.0,
        "phase_turns": "down",
    },
    "zx by headings": {"phase_zero_deg": 0.0, "phase_turns": "up"},
}
SCANS = {"spinnerlidar": SPINNER, "zx": ZX, "zx by headings": ZX}


class TestReaders:
    @pytest.mark.parametrize("word", ["today", "now", "10:30", "2020-09"])
    @pytest.mark.parametrize("kind", CSV)
    def test_tables(self, tmp_path, kind, word):
        file = tmp_path / ("a.txt" if kind == "spinnerlidar" else "a.csv")
        CSV[kind](file)
        raw = file.read_text()
        stamp = r"17092\d{5}\.\d+" if kind == "spinnerlidar" else r"\d{2,4}[-/]\d{2}[-/]\d{2,4}[T ][\d:.]+Z?"
        there = list(re.finditer(stamp, raw))[3]
        file.write_text(raw[: there.start()] + word + raw[there.end() :])
        with pytest.raises(InputError, match=f"Invalid time '{word}' in column"):
            read(file, SCANS.get(kind, SIX), **OPTIONS.get(kind, {}))

    @pytest.mark.parametrize("word", ["today", "now"])
    def test_parquet(self, tmp_path, word):
        frame = long_frame(SHORT)
        frame["time"] = frame["time"].astype(str)
        frame.loc[3, "time"] = word
        frame.to_parquet(tmp_path / "a.parquet")
        with pytest.raises(InputError, match=f"Invalid time '{word}' in column 'time', row 4"):
            read(tmp_path / "a.parquet", SIX)

    @pytest.mark.parametrize("word", ["today", "now", "", "10:30"])
    def test_halo(self, tmp_path, word):
        file = write_hpl(tmp_path / "a.hpl", SHORT, SIX)
        file.write_text(re.sub(r"Start time:\t.*", f"Start time:\t{word}", file.read_text()))
        with pytest.raises(InputError, match=f"cannot be used: .* Start time '{word}'"):
            read(file, SIX)

    @pytest.mark.parametrize("since", ["today", "now", "10:30", "1 today", "2020", "2020 10:30", "Mon"])
    def test_netcdf_units(self, tmp_path, since):
        plain = SHORT.assign_coords(
            time=("sample", np.arange(SHORT.sizes["sample"]), {"units": f"seconds since {since}"})
        )
        plain.to_netcdf(tmp_path / "plain.nc", engine="h5netcdf")
        write_windcube(tmp_path / "windcube.nc", windcube_sweep(RAYS, epoch=since))
        rays = e_windlidar(RAYS, time="units")
        rays["time"].attrs["units"] = f"seconds since {since}"
        rays.to_netcdf(tmp_path / "rays.nc", engine="h5netcdf")
        for file in ("plain.nc", "windcube.nc", "rays.nc"):
            with pytest.raises(InputError, match=r"since|cannot be read") as raised:
                read(tmp_path / file, SIX)
            assert file in str(raised.value)

    def test_text_in_netcdf(self, tmp_path):
        rays = e_windlidar(RAYS, time="text")
        rays["time"] = (
            "time",
            ["now" if number == 2 else str(time) for number, time in enumerate(rays["time"].values)],
        )
        rays.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        with pytest.raises(InputError, match="Invalid time 'now' in ray 3"):
            read(tmp_path / "a.nc", SIX)

    @pytest.mark.parametrize("word", ["today", "now"])
    def test_statistics(self, tmp_path, word):
        file = tmp_path / "Wind10.csv"
        head = "CSV Converter: v1,114;Unit: 317;Time sync: UTC\nTime and Date;Horizontal Wind Speed (m/s) at 297m\n"
        file.write_text(f"{head}13.12.2016 00:00:00;5,0\n{word};5,1\n")
        with pytest.raises(InputError, match=f"Invalid time '{word}'"):
            read_statistics(file, time_format="%d.%m.%Y %H:%M:%S")

    @pytest.mark.parametrize(("word", "form"), [("today", None), ("now", "%d.%m.%Y %H:%M:%S"), ("10:30", None)])
    def test_motion(self, tmp_path, word, form):
        file = tmp_path / "motion.csv"
        first = "2020-09-03T19:00:00" if form is None else "03.09.2020 19:00:00"
        file.write_text(f"time,tilt\n{first},5.0\n{word},4.9\n")
        with pytest.raises(InputError, match=f"Invalid time '{word}'"):
            read_motion(file, columns={"time": "time", "tilt_deg": "tilt"}, time_format=form)


class TestOptions:
    @pytest.mark.parametrize("pattern", ["%H:%M:%S", "%n", "%m-%d", "%Y", "%", "%Y-%m-%d %", "%%Y", "%Q", "%Y\0%m%d"])
    def test_patterns_state_a_date(self, tmp_path, pattern):
        assert not states_a_date(pattern)
        long_frame(SHORT).to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(
            InputError, match=r"Invalid time_format .*: it must be a pattern that can be read and states"
        ):
            read(tmp_path / "a.csv", SIX, time_format=pattern)

    @pytest.mark.parametrize("pattern", PATTERNS[1:])
    def test_whole_patterns(self, pattern):
        assert states_a_date(pattern)

    @pytest.mark.parametrize("date", ["1970-01-01", "1970-1-1 0:0:0", "0001-01-01", "2020/09/03", "20200903T101010"])
    def test_whole_dates_of_units(self, date):
        assert says_since(f"seconds since {date}")

    @pytest.mark.parametrize("word", ["today", "now", "10:30", "2020-09", ""])
    def test_the_record_of_a_fit(self, found, word):
        with pytest.raises(InputError, match=f"Invalid record '{word}': give a number or a time"):
            found.find_record(word)


def test_times_of_records_go_through_files_unchanged(tmp_path):
    series = series_of(SIX, n_scan=3)
    long_frame(series).to_csv(tmp_path / "a.csv", index=False)
    again = read(tmp_path / "a.csv", SIX)
    xr.testing.assert_equal(again["time"].reset_coords(drop=True), series["time"].reset_coords(drop=True))
