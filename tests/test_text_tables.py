"""Text tables two ways: the columnar parser and the careful lines give the same, and crooked files are explained."""

from __future__ import annotations

import codecs
import gzip
import json
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers import read, stream, table
from bayes_rs.readers.csv_fast import NotPlainError, fast_pieces
from bayes_rs.readers.csv_lines import MISSING, lines_of
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.table import open_table
from bayes_rs.records import describe_report, make_records

SCAN = brs.load_scan("4-beam")
HEAD = "time,beam,radial_velocity\n"
GOOD = [f"2020-09-03T19:00:{second:02d}Z,{second % 4},-{8 + 0.25 * (second % 7):.2f}" for second in range(60)]
WIDE_GOOD = [f"2020-09-03T19:00:{second:02d}Z,-8.{second:02d},-7.50" for second in range(60)]


def write(folder, lines, *, head=HEAD, end="\n", name="day.csv", encoding="utf-8"):
    file = folder / name
    file.write_bytes((head + "\n".join(lines) + end).encode(encoding))
    return file


def careful_only(monkeypatch):
    def refuse(*_args, **_options):
        raise NotPlainError(0)
        yield

    monkeypatch.setattr(table, "fast_pieces", refuse)


def report_of(series):
    return json.loads(series.attrs["read_report"])


def file_of(series):
    (file,) = report_of(series)["files"]
    return file


def frames(file, options, text, n_row):
    file_format = resolve_format(FileOptions(**options), None)
    found = open_table(file, file_format)
    try:
        return [(frame, before) for frame, before in found.pieces(found.headings, text=text, n_row=n_row)]
    except InputError as error:
        return str(error)


cells = (
    st.floats(allow_nan=True, allow_infinity=True).map(repr)
    | st.floats(-90, 90).map(lambda number: f"{number:.4f}")
    | st.integers(-(10**18), 10**18).map(str)
    | st.sampled_from(
        [*sorted(MISSING), " 1.5", "1.5 ", '"2.5"', "+1", "1e5", ".5", "5.", "1_0", "0x1", "True", "a", "é"]
    )
)
times = st.datetimes(min_value=pd.Timestamp("1980-01-01"), max_value=pd.Timestamp("2100-01-01")).map(
    lambda time: time.isoformat()
) | st.sampled_from(["2020-09-03 10:00", "2020-09-03", "2020-09-03T10:00:00+01:00", "2020-09-03 24:00:00", "NaN", ""])


class TestBothWays:
    @settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        rows=st.lists(st.tuples(times, st.sampled_from(["0", "1", "10.0", "LOS1", ""]), cells, cells), min_size=1),
        plain=st.booleans(),
        n_row=st.sampled_from([None, 1, 3]),
        line_end=st.sampled_from(["\n", "\r\n"]),
    )
    def test_any_table_is_the_same(self, tmp_path, rows, plain, n_row, line_end):
        """The law of the fast way: whatever it takes, it gives what the careful way gives, bit by bit."""
        if plain:
            rows = [(time, beam, f"{index / 7:.5f}", repr(index / 3.0)) for index, (time, beam, *_) in enumerate(rows)]
        file = tmp_path / "any.csv"
        lines = ["time,beam,v,w", *(",".join(row) for row in rows)]
        file.write_bytes((line_end.join(lines) + line_end).encode())
        fast = frames(file, {}, ["time", "beam"], n_row)
        with pytest.MonkeyPatch.context() as patch:
            careful_only(patch)
            careful = frames(file, {}, ["time", "beam"], n_row)
        if isinstance(fast, str):
            assert careful == fast
            return
        assert [before for _, before in careful] == [before for _, before in fast]
        for (one, _), (other, _) in zip(fast, careful, strict=True):
            pd.testing.assert_frame_equal(one, other, check_exact=True)
            for heading in ("v", "w"):
                if one[heading].dtype == np.float64:
                    assert one[heading].to_numpy().tobytes() == other[heading].to_numpy().tobytes()

    def test_a_good_file_never_sees_the_careful_way(self, tmp_path, monkeypatch):
        """Else it would be slow, and nobody would notice."""

        def refuse(*_args, **_options):
            raise AssertionError("the careful way")

        monkeypatch.setattr(table, "careful_pieces", refuse)
        for head, rows in (
            (HEAD, GOOD),
            ("\ufeff" + HEAD, GOOD),
            (
                '"time","beam","radial_velocity"\n',
                [f'"{row.split(",")[0]}",{",".join(row.split(",")[1:])}' for row in GOOD],
            ),
            (HEAD, [row.replace("Z", "") for row in GOOD]),
            (HEAD, [row.rsplit(",", 1)[0] + "," for row in GOOD[:2]] + GOOD[2:]),
            ("time,vr_0,vr_1\n", WIDE_GOOD),
            ("note é,time,beam,radial_velocity\n", [f"ø,{row}" for row in GOOD]),
        ):
            assert read(write(tmp_path, rows, head=head), SCAN).sizes["sample"] >= 60
        file = write(tmp_path, [row.replace(".", ":").replace(",", ";").replace(":2", ",2") for row in GOOD], head=HEAD)
        rows = [";".join(row.split(",")).replace(".", ",") for row in GOOD]
        file = write(tmp_path, rows, head=HEAD.replace(",", ";"))
        assert read(file, SCAN, separator=";", decimal=",").sizes["sample"] == 60
        file = write(tmp_path, rows, head="hé,".replace(",", ";") + HEAD.replace(",", ";"), encoding="cp1252")
        rows = [f"é;{row}" for row in rows]
        file = write(tmp_path, rows, head="hé;" + HEAD.replace(",", ";"), encoding="cp1252")
        assert read(file, SCAN, separator=";", decimal=",", encoding="cp1252").sizes["sample"] == 60

    def test_the_first_odd_line_far_down(self, tmp_path):
        """What was given out before it stays, what follows is the same."""
        rows = [f"2020-09-03T{hour:02d}:{minute:02d}:{second:02d}Z,{second % 4},-8.25"
                for hour in range(20) for minute in range(60) for second in range(60)]  # fmt: skip
        rows[70_000] = rows[70_000].replace("-8.25", "+8.25")
        file = write(tmp_path, rows)
        assert file.stat().st_size > 2_000_000  # several blocks
        whole, parts = read(file, SCAN), list(stream(file, SCAN, chunk_rows=1000))
        assert whole.sizes["sample"] == 72_000
        assert whole["radial_velocity"].values[70_000] == 8.25
        for name in ("time", "beam", "radial_velocity"):
            np.testing.assert_array_equal(np.concatenate([part[name].values for part in parts]), whole[name].values)

    @settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        times=st.lists(
            st.datetimes(min_value=pd.Timestamp("2001-01-01"), max_value=pd.Timestamp("2035-01-01")),
            min_size=1,
            unique=True,
        ),
        pattern=st.sampled_from(
            [
                None,
                "%Y-%m-%d %H:%M:%S.%f",
                "%d.%m.%Y %H:%M:%S.%f",
                "%Y%m%d%H%M%S",
                "%d/%m/%Y %H:%M",
                "%m/%d/%Y %H:%M:%S",
            ]
        ),
        zone=st.sampled_from(["UTC", "UTC+1", "-03:30", "Asia/Kolkata"]),
        odd=st.booleans(),
    )
    def test_times_are_pandas(self, tmp_path, times, pattern, zone, odd):
        """An independent reference: what pandas makes of each text."""
        written = [time.isoformat() if pattern is None else time.strftime(pattern) for time in times]
        offset = {"UTC+1": "+01:00"}.get(zone, zone)
        wanted = pd.to_datetime(pd.Series(written), format=pattern or "ISO8601").dt.tz_localize(offset)
        rows = [f"{text},0,-8.00" for text in written]
        if odd:  # a space makes the file one for the careful way
            rows[0] = f" {rows[0]}"
        file = write(tmp_path, rows)
        series = read(file, SCAN, time_format=pattern, time_zone=zone, out_of_order="sort")
        expected = np.unique(wanted.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy().astype("datetime64[ns]"))
        np.testing.assert_array_equal(series["time"].values, expected)

    @pytest.mark.parametrize("bad", ["1020-12-03T19:00:00", "2400-01-01T00:00:00", "2020-02-30T00:00:00"])
    def test_times_that_are_none(self, tmp_path, bad):
        with pytest.raises(InputError, match=f"Invalid time '{bad}' in column 'time', line 4 of"):
            read(write(tmp_path, [*GOOD[:2], f"{bad},0,-8.00"]), SCAN)

    @pytest.mark.parametrize("bad", ["30.02.2020 10:00:00", "03.13.2020 10:00:00", "03.09.2020 25:00:00", "3/9/2020"])
    def test_patterns_that_do_not_fit(self, tmp_path, bad):
        rows = ["03.09.2020 10:00:00,0,-8.00", f"{bad},0,-8.25"]
        with pytest.raises(InputError, match=f"Invalid time '{bad}' in column 'time', line 3 of"):
            read(write(tmp_path, rows), SCAN, time_format="%d.%m.%Y %H:%M:%S")

    def test_variances_are_numpys(self, tmp_path):
        rng = np.random.default_rng(1)
        speed = np.round(rng.normal(-9.0, 1.0, 2400), 4)
        time = np.datetime64("2020-09-03T19:00", "ms") + 250 * np.arange(2400)
        pd.DataFrame({"time": time, "beam": np.arange(2400) % 4, "radial_velocity": speed}).to_csv(
            tmp_path / "a.csv", index=False
        )
        found = make_records(read(tmp_path / "a.csv", SCAN), SCAN)["variance"].values[0]
        np.testing.assert_allclose(found, [np.var(speed[beam::4]) for beam in range(4)], rtol=1e-13)


BAD_LINES = {
    "more entries": ("2020-09-03T19:00:10Z,2,-8.25,7", "line 12 has 4 entries, and the headings 3; check the options"),
    "fewer entries": ("2020-09-03T19:00:10Z,2", "line 12 has 2 entries, and the headings 3; check the options"),
    "headings again": (HEAD.strip(), "line 12 is the headings again; put the files together without them"),
    "NUL bytes": ("2020-09-03T19:00:10Z,2,-8.\0", "line 12 holds NUL bytes; check that the file is not damaged"),
    "units": ("UTC,-,m/s", "Invalid time 'UTC' in column 'time', line 12 of file"),
    "a footer": ("end of file", "line 12 has 1 entry, and the headings 3; check the options separator and decimal"),
    "no number": ("2020-09-03T19:00:10Z,2,fast", "Invalid radial_velocity 'fast' in column 'radial_velocity', line 12"),
    "no time": ("yesterday,2,-8.25", "Invalid time 'yesterday' in column 'time', line 12 of file"),
    "no beam": ("2020-09-03T19:00:10Z,beam,-8.25", "Unknown beam 'beam' in column 'beam', line 12 of file"),
}


class TestBadRows:
    @pytest.mark.parametrize("name", BAD_LINES)
    @pytest.mark.parametrize("kind", ["csv", "csv.gz"])
    def test_refused_or_left_out(self, tmp_path, name, kind):
        line, reason = BAD_LINES[name]
        file = write(tmp_path, [*GOOD[:10], line, *GOOD[10:]])
        if kind == "csv.gz":
            packed = tmp_path / "day.csv.gz"
            packed.write_bytes(gzip.compress(file.read_bytes()))
            file = packed
        with pytest.raises(InputError, match=re.escape(reason)) as caught:
            read(file, SCAN)
        assert repr(str(file)) in str(caught.value)
        assert str(caught.value).isprintable()
        if name != "no beam":
            assert str(caught.value).endswith(", or leave such rows out with bad_rows='drop' (--bad-rows drop).")
        good = read(write(tmp_path, GOOD, name="good.csv"), SCAN)
        for series in (read(file, SCAN, bad_rows="drop"), next(stream(file, SCAN, bad_rows="drop"))):
            np.testing.assert_array_equal(series["time"], good["time"])
            np.testing.assert_array_equal(series["radial_velocity"], good["radial_velocity"])
            told = file_of(series)
            assert (told["rows"], told["rows_bad"], told["rows_dropped"], told["rows_without_time"]) == (61, 1, 0, 0)
            assert reason in told["first_bad_row"].replace(str(file), "F")
            assert "; 1 bad ones left out; the first bad row: " in describe_report(series)[0]

    @pytest.mark.parametrize("rows", [1, 4, 1000])
    def test_in_pieces(self, tmp_path, rows):
        file = write(tmp_path, [*GOOD[:10], "x", *GOOD[10:50], "y", *GOOD[50:]])
        parts = list(stream(file, SCAN, chunk_rows=rows, bad_rows="drop"))
        assert sum(report_of(part)["rows_bad"] for part in parts if "rows_bad" in report_of(part)) == 2
        assert sum(part.sizes["sample"] for part in parts) == 60

    def test_too_many(self, tmp_path):
        bad = ["x"] * 11
        file = write(tmp_path, [*bad, *GOOD])
        message = (
            f"File {str(file)!r} has 11 bad rows of 71, more than may be left out (1% of them, or 10); the first: File "
            f"{str(file)!r} is not a table: line 2 has 1 entry, and the headings 3; check the options separator and "
            "decimal."
        )
        with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
            read(file, SCAN, bad_rows="drop")
        with pytest.raises(InputError, match="has 11 bad rows of 71"):
            list(stream(file, SCAN, chunk_rows=7, bad_rows="drop"))
        assert read(write(tmp_path, [*bad[1:], *GOOD]), SCAN, bad_rows="drop").sizes["sample"] == 60

    def test_a_beam_that_the_scan_does_not_have_is_no_bad_row(self, tmp_path):
        file = write(tmp_path, [*GOOD, "2020-09-03T19:01:10Z,7,-8.25"])
        with pytest.raises(InputError, match="Unknown beam '7'"):
            read(file, SCAN, bad_rows="drop")

    def test_wide(self, tmp_path):
        head, rows = "time,vr_0,vr_1\n", [*WIDE_GOOD[:5], "s,m/s,m/s", *WIDE_GOOD[5:]]
        file = write(tmp_path, rows, head=head)
        with pytest.raises(InputError, match=r"Invalid time 's' in column 'time', line 7 .*--bad-rows drop"):
            read(file, SCAN)
        series = read(file, SCAN, bad_rows="drop")
        assert (series.sizes["sample"], file_of(series)["rows_bad"]) == (120, 1)

    def test_parquet(self, tmp_path):
        frame = pd.DataFrame([row.split(",") for row in GOOD], columns=HEAD.strip().split(","))
        frame.loc[3, "radial_velocity"] = "fast"
        frame.to_parquet(tmp_path / "a.parquet")
        with pytest.raises(InputError, match="Invalid radial_velocity 'fast' in column 'radial_velocity', row 4 of"):
            read(tmp_path / "a.parquet", SCAN)
        series = read(tmp_path / "a.parquet", SCAN, bad_rows="drop")
        assert (series.sizes["sample"], file_of(series)["rows_bad"]) == (59, 1)


class TestTheEnd:
    """A file that ends within its last line: what is cut is not believed."""

    @pytest.mark.parametrize("n_cut", range(1, 25))
    def test_cut_anywhere(self, tmp_path, n_cut):
        """A number that is cut is never read: -8.2 for -8.25."""
        whole = write(tmp_path, GOOD, name="whole.csv")
        file = tmp_path / "day.csv"
        file.write_bytes(whole.read_bytes()[:-n_cut])
        n_sample = 60 if n_cut == 1 else 59  # without its line end the last number has as many decimals as the others
        for series in (read(file, SCAN), *stream(file, SCAN)):
            assert series.sizes["sample"] == n_sample
            np.testing.assert_array_equal(series["radial_velocity"], read(whole, SCAN)["radial_velocity"][:n_sample])
            assert file_of(series).get("rows_cut", 0) == 60 - n_sample
        if n_cut > 1:
            assert "; 1 cut at the end of the file, left out" in describe_report(read(file, SCAN))[0]

    @pytest.mark.parametrize("rows", [1, 7, 59, 60])
    def test_in_pieces(self, tmp_path, rows):
        parts = list(stream(write(tmp_path, [*GOOD[:-1], GOOD[-1][:-1]], end=""), SCAN, chunk_rows=rows))
        assert sum(part.sizes["sample"] for part in parts) == 59
        assert sum(report_of(part).get("rows_cut", 0) for part in parts) == 1

    def test_numbers_of_any_length(self, tmp_path):
        """Nothing says that the last of them is whole."""
        rows = [f"2020-09-03T19:00:{second:02d}Z,0,{-8.0 - second / 7.0!r}" for second in range(20)]
        assert read(write(tmp_path, rows, end=""), SCAN).sizes["sample"] == 19
        assert read(write(tmp_path, rows), SCAN).sizes["sample"] == 20

    def test_a_column_that_nobody_reads(self, tmp_path):
        rows = [f"{row},{'x' * index}" for index, row in enumerate(GOOD)]
        assert read(write(tmp_path, rows, head=HEAD.strip() + ",note\n", end=""), SCAN).sizes["sample"] == 60

    def test_the_only_row(self, tmp_path):
        file = write(tmp_path, GOOD[:1], end="")
        message = (
            f"File {str(file)!r} ends within its only row, whose last number may be cut: end the line, if it is whole."
        )
        for way in (read, lambda *args: list(stream(*args))):
            with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
                way(file, SCAN)

    def test_nul_bytes(self, tmp_path):
        """As after a crash, where the file system had the length but not the bytes."""
        file = write(tmp_path, [*GOOD[:-1], GOOD[-1][:-3]], end="\0" * 5000)
        series = read(file, SCAN)
        assert (series.sizes["sample"], file_of(series)["rows_cut"]) == (59, 1)
        file = write(tmp_path, GOOD, end="\n" + "\0" * 5000)
        series = read(file, SCAN)
        assert (series.sizes["sample"], file_of(series)["rows_cut"]) == (60, 1)


class TestOptions:
    def test_skip_rows(self, tmp_path):
        file = write(tmp_path, GOOD, head="Lidar 7\nUnit; m/s, knots\n" + HEAD)
        assert read(file, SCAN, skip_rows=2).sizes["sample"] == 60
        with pytest.raises(InputError, match="is neither a long table"):
            read(file, SCAN)
        bad = write(tmp_path, [*GOOD, "x"], head="Lidar 7\n\n" + HEAD)
        with pytest.raises(InputError, match="line 64 has 1 entry"):
            read(bad, SCAN, skip_rows=2)
        with pytest.raises(InputError, match="is empty below the 99 lines that are skipped: give a file with headings"):
            read(file, SCAN, skip_rows=99)

    def test_comment(self, tmp_path):
        lines = ["# one", *GOOD[:10], "#2020-09-03T19:00:10Z,2,-8.25", " # three", *GOOD[10:]]
        file = write(tmp_path, lines, head="# first\n#, second, of, them\n" + HEAD)
        series = read(file, SCAN, comment="#")
        assert series.sizes["sample"] == 60
        bad = write(tmp_path, [*lines, "x"], head="# first\n#, second, of, them\n" + HEAD)
        with pytest.raises(InputError, match="line 67 has 1 entry"):
            read(bad, SCAN, comment="#")

    @pytest.mark.parametrize("encoding", ["cp1252", "latin-1", "utf-8", "utf-16-le", "utf-16-be", "cp500"])
    def test_encoding(self, tmp_path, encoding):
        file = write(tmp_path, [f"{row},Höhe" for row in GOOD], head=HEAD.strip() + ",Ort\n", encoding=encoding)
        series = read(file, SCAN, encoding=encoding)
        np.testing.assert_array_equal(series["time"], read(write(tmp_path, GOOD, name="a.csv"), SCAN)["time"])

    @pytest.mark.parametrize("mark", [codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE])
    def test_utf_16_says_so_itself(self, tmp_path, mark):
        file = tmp_path / "day.csv"
        text = HEAD + "\n".join(GOOD)
        kind = "utf-16-le" if mark == codecs.BOM_UTF16_LE else "utf-16-be"
        file.write_bytes(mark + (text + "\n").encode(kind))
        assert read(file, SCAN).sizes["sample"] == 60
        file.write_bytes(mark + text[:-1].encode(kind))
        assert read(file, SCAN).sizes["sample"] == 59  # cut within the last number

    def test_bytes_that_are_none_of_the_encoding(self, tmp_path):
        """In a column that nobody reads they do not matter."""
        rows = [f"Höhe,{row}" for row in GOOD]
        file = write(tmp_path, rows, head="Ort," + HEAD, encoding="cp1252")
        assert read(file, SCAN).sizes["sample"] == 60
        rows = [row.replace(",2,", ",zwölf,") for row in GOOD]
        file = write(tmp_path, rows, encoding="cp1252")
        message = (
            "line 4 holds bytes that are not valid in the encoding utf-8-sig; give another encoding (--encoding), such"
        )
        with pytest.raises(InputError, match=re.escape(message)):
            read(file, SCAN)
        numbers = {"0": 0, "1": 1, "zwölf": 2, "3": 3}
        assert read(file, SCAN, encoding="cp1252", beam_numbers=numbers).sizes["sample"] == 60
        file = write(tmp_path, GOOD, head="time,beam,Geschwindigkeit für v\n", encoding="cp1252")
        with pytest.raises(
            InputError, match=r"not valid in the encoding utf-8-sig: give encoding, --encoding, as cp1252"
        ):
            read(file, SCAN)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"skip_rows": -1}, "Invalid skip_rows -1: it must be a whole number, zero or above."),
            ({"comment": ""}, "Invalid comment '': it must be what such lines begin with, as '#'."),
            (
                {"encoding": "klingon"},
                "Unknown encoding 'klingon': it must be an encoding that Python knows, such as utf-8",
            ),
            (
                {"encoding": "rot13"},
                "Unknown encoding 'rot13': it must be an encoding that Python knows, such as utf-8",
            ),
            ({"bad_rows": "keep"}, "Unknown bad_rows 'keep': it must be one of error, drop."),
        ],
    )
    def test_bad_ones(self, tmp_path, options, message):
        with pytest.raises(InputError, match=re.escape(message)):
            read(write(tmp_path, GOOD), SCAN, **options)


class TestTimes:
    @pytest.mark.parametrize(
        ("text", "pattern", "expected"),
        [
            ("2020-09-03T24:00:00", None, "2020-09-04T00:00:00"),
            ("2020-12-31 24:00", None, "2021-01-01T00:00:00"),
            ("2020-09-03T24:00:00.000Z", None, "2020-09-04T00:00:00"),
            ("2016-12-31T23:59:60Z", None, "2016-12-31T23:59:59.999999"),
            ("2016-12-31T23:59:60.25Z", None, "2016-12-31T23:59:59.999999"),
            ("2017-01-01T00:59:60+01:00", None, "2016-12-31T23:59:59.999999"),
            ("31.12.2020 24:00:00", "%d.%m.%Y %H:%M:%S", "2021-01-01T00:00:00"),
            ("31.12.2016 23:59:60", "%d.%m.%Y %H:%M:%S", "2016-12-31T23:59:59.999999"),
            ("03.09.2020 10:00:01", "%d.%m.%Y %H:%M:%S.%f", "2020-09-03T10:00:01"),
            ("03.09.2020 10:00:01.5", "%d.%m.%Y %H:%M:%S.%f", "2020-09-03T10:00:01.5"),
            ("2020-09-03 10:00:01 +0100", "%Y-%m-%d %H:%M:%S.%f %z", "2020-09-03T09:00:01"),
            ("1599159600500", "unix-ms", "2020-09-03T19:00:00.5"),
            ("1599159600500250", "unix-us", "2020-09-03T19:00:00.50025"),
            ("1599159600500250125", "unix-ns", "2020-09-03T19:00:00.50025"),
        ],
    )
    def test_what_they_are(self, tmp_path, text, pattern, expected):
        series = read(write(tmp_path, [f"{text},0,-8.25"]), SCAN, time_format=pattern)
        assert series["time"].values[0] == np.datetime64(expected)

    @pytest.mark.parametrize("pattern", [None, "%Y-%m-%dT%H:%M:%S"])
    @pytest.mark.parametrize(
        "text",
        [
            "2020-09-03T24:00:01",
            "2020-09-03T24:01",
            "2020-09-03T25:00:00",
            "2020-09-03T10:00:60",
            "2020-02-30T24:00:00",
            "2020-09-03T23:59:61",
        ],
    )
    def test_what_they_are_not(self, tmp_path, text, pattern):
        with pytest.raises(InputError, match=f"Invalid time '{text}'"):
            read(write(tmp_path, [f"{text},0,-8.25"]), SCAN, time_format=pattern)

    @pytest.mark.parametrize(
        ("number", "name"),
        [
            (1599159600.5, "unix"),
            (1599159600500, "unix-ms"),
            (1599159600500000, "unix-us"),
            (1599159600500000000, "unix-ns"),
        ],
    )
    def test_the_size_says_the_unit(self, tmp_path, number, name):
        file = write(tmp_path, [f"{number},0,-8.25"])
        for options in ({}, {"time_format": "unix"}):
            if options and name == "unix":
                continue
            with pytest.raises(InputError, match=rf"by its size it is '{name}' \(--time-format {name}\)"):
                read(file, SCAN, **options)
        assert read(file, SCAN, time_format=name)["time"].values[0] == np.datetime64("2020-09-03T19:00:00.5")

    def test_beside_rows_without_a_time(self, tmp_path):
        rows = ["2020-09-03T24:00:00,0,-8.25", ",0,-8.25", "2020-09-03T23:00:00,0,-8.25"]
        assert read(write(tmp_path, rows), SCAN, out_of_order="sort").sizes["sample"] == 2

    def test_a_beam_with_decimals(self, tmp_path):
        rows = [row.replace(f",{index % 4},", f",{index % 4}.0,") for index, row in enumerate(GOOD)]
        assert read(write(tmp_path, rows), SCAN)["beam"].values.tolist() == [index % 4 for index in range(60)]


@pytest.mark.parametrize("kind", ["csv", "parquet", "careful"])
def test_no_column_is_of_python_objects(tmp_path, kind):
    """An object for each entry is what makes reading slow."""
    frame = pd.DataFrame([row.split(",") for row in GOOD], columns=HEAD.strip().split(","))
    frame["radial_velocity"] = frame["radial_velocity"].astype(float)
    frame["kind"] = pd.Categorical(["a", "b"] * 30)
    frame["number"] = np.arange(60)
    file = tmp_path / f"a.{'parquet' if kind == 'parquet' else 'csv'}"
    frame.to_parquet(file) if kind == "parquet" else frame.to_csv(file, index=False)
    if kind == "careful":
        file.write_text(file.read_text().replace(",-", ", -"))
    found = open_table(file, resolve_format(FileOptions(), None))
    for rows in (None, 7):
        for part, _ in found.pieces(found.headings, text=["time", "beam", "kind"], n_row=rows):
            assert "O" not in {dtype.kind for dtype in part.dtypes if isinstance(dtype, np.dtype)}


def test_the_fast_way_reads_only_what_is_used(tmp_path):
    """Columns that nobody needs may hold anything."""
    file = write(tmp_path, [f"{row},{index},x{index}" for index, row in enumerate(GOOD)], head=HEAD.strip() + ",a,b\n")
    file_format = resolve_format(FileOptions(), None)
    wanted = ["time", "radial_velocity"]
    headings = ("time", "beam", "radial_velocity", "a", "b")
    (found,) = fast_pieces(file, lines_of(file, file_format, 0), headings, wanted, text=["time"], n_row=None)
    assert found.column_names == wanted
    assert [str(kind) for kind in found.schema.types] == ["string", "double"]
