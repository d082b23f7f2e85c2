"""Campbell TOA5: the series of a sonic is read back, and its stresses are those of a slow, obvious loop."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.readers import read_sonic
from bayes_rs.wind import sonic_stresses

START = np.datetime64("2012-06-07T12:45:00", "ns")
NAMES = ("TIMESTAMP", "RECORD", "Ux", "Uy", "Uz", "Ts", "diag_csat")
UNITS = ("TS", "RN", "m/s", "m/s", "m/s", "C", "")
ROUNDING = 1e-12


def wind_of(n: int, *, seed: int = 2, step: float = 0.05, mean: tuple[float, ...] = (6.0, -3.0, 0.4)) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(n, 3)) @ np.array([[1.3, 0.2, -0.3], [0.0, 1.0, 0.1], [0.0, 0.0, 0.6]])
    values = np.round(np.array(mean) + mixed, 5)
    time = START + np.round(1e9 * step * np.arange(n)).astype("timedelta64[ns]")
    return xr.Dataset(
        {name: ("time", values[:, axis]) for axis, name in enumerate("uvw")}
        | {"temperature": ("time", np.round(20.0 + rng.normal(size=n), 3)), "status": ("time", rng.integers(0, 60, n))},
        coords={"time": time},
    )


def write_toa5(file, series, *, names=NAMES, units=UNITS, process=None):
    """Write a series as a logger does: a whole second has no fraction."""
    process = ("", "", *["Smp"] * (len(names) - 2)) if process is None else process
    lines = [",".join(f'"{word}"' for word in row) for row in (
        ("TOA5", "mast", "CR3000", "6843", "CR3000.Std.22", "CPU:a,b.CR3", "24006", "ts"), names, units, process,
    )]  # fmt: skip
    for index, time in enumerate(series["time"].values):
        second, _, fraction = np.datetime_as_string(time, "us").replace("T", " ").partition(".")
        fraction = fraction.rstrip("0")
        words = [f'"{second}.{fraction}"' if fraction else f'"{second}"', str(111850400 + index)]
        for name in ("u", "v", "w", "temperature", "status"):
            value = float(series[name].values[index])
            words.append('"NAN"' if np.isnan(value) else f"{value:.12g}")
        lines.append(",".join(words[: len(names)]))
    file.write_text("\r\n".join(lines) + "\r\n")
    return file


def slow_stresses(series, duration):
    """Record by record, sample by sample: rotate, take the mean off, add up."""
    found = {}
    seconds = series["time"].values.astype("datetime64[ns]").astype(np.int64) / 1e9
    for record in sorted(set((seconds // duration).tolist())):
        rows = [i for i in range(len(seconds)) if seconds[i] // duration == record]
        vectors = [[float(series[name].values[i]) for name in "uvw"] for i in rows]
        vectors = [vector for vector in vectors if not any(np.isnan(vector))]
        mean = [sum(vector[axis] for vector in vectors) / len(vectors) for axis in range(3)]
        yaw = np.arctan2(mean[1], mean[0])
        pitch = np.arctan2(mean[2], np.hypot(mean[0], mean[1]))
        turned = []
        for u, v, w in vectors:
            along, across = u * np.cos(yaw) + v * np.sin(yaw), v * np.cos(yaw) - u * np.sin(yaw)
            turned.append(
                (along * np.cos(pitch) + w * np.sin(pitch), across, w * np.cos(pitch) - along * np.sin(pitch))
            )
        centre = [sum(vector[axis] for vector in turned) / len(turned) for axis in range(3)]
        tensor = np.zeros((3, 3))
        for vector in turned:
            for i in range(3):
                for j in range(3):
                    tensor[i, j] += (vector[i] - centre[i]) * (vector[j] - centre[j]) / len(turned)
        found[record * duration] = (brs.geometry.pack_stress(tensor), centre)
    return found


@pytest.fixture(scope="module")
def series():
    series = wind_of(900)
    series["w"][7] = np.nan
    return series


class TestReadSonic:
    def test_same_series(self, tmp_path, series):
        back = read_sonic(write_toa5(tmp_path / "a.dat", series))
        for name in ("time", "u", "v", "w", "temperature", "status"):
            np.testing.assert_array_equal(back[name], series[name], err_msg=name)
        assert (back["u"].attrs["units"], back["temperature"].attrs["units"]) == ("m s-1", "degree_Celsius")
        report = json.loads(back.attrs["read_report"])
        assert (report["rows"], report["rows_dropped"], report["duplicates_dropped"]) == (900, 0, 0)

    def test_several_files_that_overlap(self, tmp_path, series):
        write_toa5(tmp_path / "b.dat", series.isel(time=slice(0, 500)))
        write_toa5(tmp_path / "a.dat", series.isel(time=slice(400, 900)))
        back = read_sonic(tmp_path)
        np.testing.assert_array_equal(back["u"], series["u"])
        assert json.loads(back.attrs["read_report"])["duplicates_dropped"] == 100

    def test_other_names_and_a_zone(self, tmp_path, series):
        names = ("TIMESTAMP", "RECORD", "wind_A", "Uy_1", "w", "SonTemp", "diag")
        file = write_toa5(tmp_path / "a.dat", series, names=names)
        back = read_sonic(file, columns={"u": "wind_A"}, time_zone="UTC+1")
        np.testing.assert_array_equal(back["u"], series["u"])
        assert back["time"].values[0] == START - np.timedelta64(1, "h")
        np.testing.assert_array_equal(back["temperature"], series["temperature"])

    def test_samples_of_a_bad_status_are_missing_and_counted(self, tmp_path, series):
        back = read_sonic(write_toa5(tmp_path / "a.dat", series), status_most=30)
        bad = series["status"].values > 30
        assert np.isnan(back["u"].values[bad]).all()
        assert json.loads(back.attrs["read_report"])["rows_bad_status"] == bad.sum()

    def test_a_number_that_marks_a_missing_entry(self, tmp_path, series):
        """Of the series, and of a mast beside records; a zero is a velocity."""
        marked = series.copy(deep=True)
        marked["u"].values[3:9], marked["w"].values[20] = -9999.0, 0.0
        file = write_toa5(tmp_path / "a.dat", marked)
        found = read_sonic(file, invalid=(-9999, 0))
        expected = np.where(marked["u"] == -9999.0, np.nan, marked["u"])
        np.testing.assert_array_equal(found["u"], expected)
        assert found["w"].values[20] == 0.0
        lidar = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=1, seed=1)
        start = lidar["time"].values[0]
        records = brs.make_records(lidar, "2-beam")
        hour = wind_of(12000)
        hour = hour.assign_coords(time=start + (hour["time"].values - hour["time"].values[0]))
        hour["u"].values[3:9] = -9999.0
        file = write_toa5(tmp_path / "mast.dat", hour)
        beside = brs.wind.with_mast(records, str(file), position=(-98, 0, 0), invalid=-9999)
        clean = sonic_stresses(hour.assign(u=hour["u"].where(hour["u"] != -9999.0)))
        np.testing.assert_allclose(beside["mast_stress"].values[0], clean["stress"].values[0], rtol=1e-9)

    def test_a_cut_number_is_not_believed(self, tmp_path, series):
        few = series.isel(time=slice(0, 5))
        file = write_toa5(tmp_path / "a.dat", few, names=NAMES[:5], units=UNITS[:5])
        whole = file.read_bytes()
        for n in range(3, 30):  # two bytes are the newline
            file.write_bytes(whole[:-n] + b"\0\0")
            back = read_sonic(file)
            np.testing.assert_array_equal(back["w"], few["w"][:4])
            assert json.loads(back.attrs["read_report"])["rows_dropped"] == 1

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (('"TOA5"', '"TOB1"'), r"is a TOB1 file: it must be a Campbell TOA5 file .* \(CardConvert\)"),
            (('"TOA5"', '"time"'), r"does not begin with TOA5"),
            (('"Uz"', '"Uq"'), r"has no sampled column for w: its samples are 'TIMESTAMP', 'RECORD', 'Ux'"),
            (('"Smp"', '"Avg"'), r"has no sampled column for u: its samples are 'TIMESTAMP', 'RECORD'; say which"),
            (('"Ts"', '"Ux_2"'), r"has several columns that may be u, 'Ux', 'Ux_2': say which"),
            (('"m/s"', '"knots"'), r"Unknown unit 'knots' of column 'Ux' .* must be m/s"),
            (('"C"', '"F"'), r"Unknown unit 'F' of column 'Ts' .* must be C or K"),
            (('"TS","RN"', '"TS"'), r"has 7 names, 6 units and 7 kinds of processing"),
            (("2012-06-07 12:45:01,", "2012-13-07 12:45:01,"), r"Invalid time '2012-13-07 12:45:01' in column"),
        ],
    )
    def test_bad_files(self, tmp_path, series, change, message):
        file = write_toa5(tmp_path / "a.dat", series)
        text = file.read_text().replace('"2012-06-07 12:45:01"', "2012-06-07 12:45:01")
        file.write_text(text.replace(*change))
        with pytest.raises(InputError, match=message):
            read_sonic(file)

    def test_bad_options(self, tmp_path, series):
        file = write_toa5(tmp_path / "a.dat", series, names=NAMES[:6], units=UNITS[:6])
        with pytest.raises(InputError, match=r"has no status, which status_most=63 is about"):
            read_sonic(file, status_most=63)
        with pytest.raises(InputError, match=r"Unknown name 'x' in columns"):
            read_sonic(file, columns={"x": "Ux"})

    def test_files_that_differ(self, tmp_path, series):
        write_toa5(tmp_path / "a.dat", series)
        write_toa5(tmp_path / "b.dat", series, names=NAMES[:6], units=UNITS[:6])
        with pytest.raises(InputError, match=r"Files 'a.dat' and 'b.dat' differ: the one has u, v, w, temp"):
            read_sonic(tmp_path)


class TestStresses:
    @pytest.mark.parametrize("mean", [(6.0, -3.0, 0.4), (-2.0, 7.0, -1.0), (0.0, -5.0, 0.0)])
    def test_those_of_a_slow_loop(self, mean):
        series = wind_of(3000, step=0.2, mean=mean)
        series["v"][100:130] = np.nan
        found = sonic_stresses(series, duration=300.0, min_availability=0.5)
        wanted = slow_stresses(series, 300.0)
        assert found["component"].values.tolist() == list(STRESSES)
        assert len(found["time"]) == len(wanted)
        for index, (start, (stress, centre)) in enumerate(wanted.items()):
            assert found["time"].values[index].astype("datetime64[s]").astype(int) == start
            np.testing.assert_allclose(found["stress"].values[index], stress, rtol=ROUNDING, atol=ROUNDING)
            np.testing.assert_allclose(centre, [found["wind_speed"].values[index], 0.0, 0.0], atol=1e-12)

    def test_the_direction_of_the_sonic_does_not_matter(self):
        """Law: turning the sonic about the vertical, and tilting it by little, changes no stress."""
        series = wind_of(3000, step=0.2)
        turn = np.deg2rad(71.0)
        u, v = series["u"], series["v"]
        turned = series.assign(u=np.cos(turn) * u - np.sin(turn) * v, v=np.sin(turn) * u + np.cos(turn) * v)
        one, other = sonic_stresses(series), sonic_stresses(turned)
        np.testing.assert_allclose(other["stress"], one["stress"], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(other["angle"] - one["angle"], 71.0)

    def test_isotropy_stays(self):
        """Law: equal uncorrelated variances are so in every frame (five sigma of a variance of n samples)."""
        n = 20_000
        rng = np.random.default_rng(5)
        wind = {name: ("time", rng.normal(mean, 1.0, n)) for name, mean in (("u", 3.0), ("v", -4.0), ("w", 1.0))}
        time = np.datetime64("2024-01-01", "ns") + np.arange(n) * np.timedelta64(20, "ms")
        found = sonic_stresses(xr.Dataset(wind, coords={"time": time}), duration=400.0)
        np.testing.assert_allclose(found["stress"][0], [1, 1, 1, 0, 0, 0], atol=5.0 * np.sqrt(2.0 / n))

    def test_records_with_too_few_samples_have_none(self):
        series = wind_of(4500, step=0.2)  # 900 s from 12:45:00
        found = sonic_stresses(series, duration=600.0)
        assert found["count"].values.tolist() == [1500, 3000]
        assert np.isnan(found["stress"].values[0]).all()
        assert np.isfinite(found["stress"].values[1]).all()
        assert np.isfinite(found["wind_speed"].values).all()
        np.testing.assert_allclose(found["availability"], [0.5, 1.0])

    def test_they_begin_a_campaigns_prior(self):
        series = wind_of(36_000, step=0.2)
        found = sonic_stresses(series).isel(record=slice(1, 12))
        assert brs.campaign.prior_from_stresses(found["stress"].values, found["wind_speed"].values).name

    @pytest.mark.parametrize(
        ("call", "message"),
        [
            (lambda series: sonic_stresses(series.drop_vars("w")), "Invalid series without 'w': give the Dataset of"),
            (lambda series: sonic_stresses(series * np.nan), "no time has all of u, v and w"),
            (
                lambda series: sonic_stresses(series, min_availability=2.0),
                "Invalid min_availability 2.0: it must be",
            ),
            (lambda series: sonic_stresses(series, duration=0.0), "duration"),
        ],
    )
    def test_bad_input(self, call, message):
        with pytest.raises(InputError, match=message):
            call(wind_of(10))
