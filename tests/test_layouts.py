"""Files of our own that come in changed: one line that says what, which rule, and what to do; never a traceback."""

import json
import re
import shutil
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from scenes import draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs import InputError
from bayes_rs.campaign import sampling
from bayes_rs.cli import main
from bayes_rs.layouts import Entry, Open, check_dataset, check_table, read_json
from bayes_rs.ledger import LEDGER, _line, fingerprint_of_file, read_ledger, write_ledger
from bayes_rs.noise.file import load_noise
from bayes_rs.priors import WeakPrior
from bayes_rs.readers.looking import look
from bayes_rs.records.layout import check_layout
from bayes_rs.records.record_files import open_record_files

SCAN = brs.load_scan("6-beam")
N_RECORD = 4


@pytest.fixture(scope="module")
def records():
    stress = WeakPrior(log_sd_uu=0.5).draw(N_RECORD, seed=11)
    return records_of(draw_variances(stress, SCAN, plain_noise(SCAN), np.random.default_rng(12)), SCAN)


@pytest.fixture(scope="module")
def whole(records, tmp_path_factory):
    place = tmp_path_factory.mktemp("layouts") / "out"
    options = {"sampler": "direct", "target_ess": 50, "seed": 1, "campaign": "on", "derived": ("tke",)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampling, "_BURN_IN", (10, 10))  # what it finds does not matter here
        patch.setattr(sampling, "_BLOCK", 40)
        patch.setattr(sampling._Run, "effective", lambda *_: (100.0, 1.0, True))
        brs.fit(records, SCAN, noise=plain_noise(SCAN), output=place, **options)
    return place


@pytest.fixture(scope="module")
def made():
    return brs.make_records(brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1), "2-beam")


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "out")


def seal(folder):
    """Make the list of files fit what is in the folder."""
    ledger = read_ledger(folder)
    for name in list(ledger.files):
        ledger.put(name, fingerprint_of_file(folder / name))
    write_ledger(folder, ledger, finished=True)


def refused(call):
    with pytest.raises(InputError) as found:
        call()
    assert "\n" not in str(found.value)
    return str(found.value)


DATASET = {
    "speed": Entry(("record",), unit="m s-1", positive=True),
    "flag": Entry(("record", "beam"), "whole", flags=True),
    "name": Entry(("beam",), "text", values=("a", "b")),
}
TABLE = {"record": "whole", "uu": "size", "flag": "text", "time": "time"}


class TestDatasets:
    def dataset(self, **changes):
        return xr.Dataset(
            {
                "speed": ("record", [1.0, np.nan], {"units": "m/s"}),
                "flag": (
                    ("record", "beam"),
                    np.zeros((2, 2), np.uint8),
                    {"flag_masks": [1, 2], "flag_meanings": "x y"},
                ),
                "name": ("beam", np.array(["a", "b"], dtype=object)),
                **changes,
            }
        )

    def check(self, dataset, **options):
        check_dataset(dataset, DATASET, what="The things", advice="make them", **options)

    def test_what_fits(self):
        self.check(self.dataset())
        self.check(self.dataset(other=("x", [1])), needs=("speed",))

    @pytest.mark.parametrize("unit", ["m s-1", "m/s", "m s^-1", "m s**-1", "m·s⁻¹", "meter second-1", "m.s-1", ""])
    def test_units_in_other_words(self, unit):
        self.check(self.dataset(speed=("record", [1.0, 2.0], {"units": unit})))

    @pytest.mark.parametrize("unit", ["m2 s-2", "m²/s²", "m2.s-2", "(m/s)^2", "(m/s)²", "(m s-1)**2"])
    def test_units_of_squares(self, unit):
        dataset = xr.Dataset({"variance": ("record", [1.0], {"units": unit})})
        check_dataset(dataset, {"variance": Entry(("record",), unit="m2 s-2")}, what="The records", advice="make them")

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"speed": ("record", [1.0, 2.0], {"units": "km h-1"})}, "speed is in 'km h-1', and must be in 'm s-1'"),
            ({"speed": ("record", [1.0, 2.0], {"units": 3.0})}, "speed is in 3.0"),
            ({"speed": ("record", ["1", "2"])}, "speed holds texts, and must hold numbers"),
            ({"speed": ("record", [1.0, -2.0])}, "speed holds -2.0, and must be above zero"),
            ({"speed": ("record", [1.0, np.inf])}, "speed holds inf, and must hold numbers up to 1e"),
            ({"speed": ("other", [1.0, 2.0])}, r"speed has dims ('other',), and must have ('record',)"),
            ({"flag": (("record", "beam"), np.zeros((2, 2)))}, "flag holds numbers, and must hold whole numbers"),
            ({"flag": (("beam", "record"), np.zeros((2, 2), int))}, r"flag has dims ('beam', 'record')"),
            ({"flag": (("record", "beam"), np.zeros((2, 2), int), {"flag_masks": [1]})}, "do not fit each other"),
            ({"name": ("beam", np.array(["b", "a"], dtype=object))}, "name is b, a, and must be a, b"),
            ({"name": ("beam", np.array([b"a", 3], dtype=object))}, "name holds b'a', and must hold texts"),
        ],
    )
    def test_what_does_not(self, changes, words):
        text = refused(lambda: self.check(self.dataset(**changes)))
        assert text.startswith(f"The things cannot be used: {words}") or words in text
        assert text.endswith("; make them.")

    def test_what_is_missing(self):
        dataset = self.dataset().drop_vars("speed")
        text = refused(lambda: self.check(dataset, needs=("speed",)))
        assert text == "The things have no speed with dims ('record',): make them."


class TestTables:
    def table(self, **changes):
        columns = {
            "record": pa.array([0, 1]),
            "uu": pa.array([1.0, None]),
            "flag": pa.array(["", "x"]),
            "time": pa.array([0, None], pa.timestamp("ns")),
        }
        return pa.table({**columns, **changes})

    def test_what_fits(self):
        check_table(self.table(), TABLE, what="It", advice="make it")

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"uu": pa.array([[1.0], [2.0]])}, "column 'uu' holds list"),
            ({"uu": pa.array([b"a", b"b"])}, "column 'uu' holds binary, and must hold numbers"),
            ({"uu": pa.array([1.0, -1.0])}, "column 'uu' holds -1, and must hold numbers from 0 to"),
            ({"uu": pa.array([1.0, 1e300])}, "column 'uu' holds 1e"),
            ({"record": pa.array([0, None])}, "column 'record' has 1 empty entries"),
            ({"record": pa.array([0.0, 1.0])}, "column 'record' holds double, and must hold whole numbers"),
            ({"flag": pa.array([1, 2])}, "column 'flag' holds int64, and must hold texts"),
            ({"time": pa.array([0, 1], pa.timestamp("ns", "UTC"))}, "column 'time' holds timestamp"),
        ],
    )
    def test_what_does_not(self, changes, words):
        text = refused(lambda: check_table(self.table(**changes), TABLE, what="It", advice="make it"))
        assert text.startswith(f"It cannot be used: {words}")

    def test_a_column_twice_or_never(self):
        table = self.table()
        twice = table.append_column("uu", table["uu"])
        assert "has 2 columns 'uu'" in refused(lambda: check_table(twice, TABLE, what="It", advice=""))
        none = table.drop_columns(["uu"])
        assert "has no column 'uu'" in refused(lambda: check_table(none, TABLE, what="It", advice=""))


class TestJson:
    class Thing(Open):
        number: int

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"\xff\xfe", "cannot be read as JSON"),
            (b"{", "cannot be read as JSON"),
            (b"[" * 100_000, "nested too deeply"),
            (b"9" * 6000, "cannot be read as JSON"),
            (b"[]", "its content = []: input should be a valid dictionary; make it"),
            (b'{"number": "1"}', "number = '1': input should be a valid integer"),
            (b"{}", "number: required key is missing"),
            (b'{"number": ' + b"9" * 400 + b".0}", "number = inf"),
        ],
    )
    def test_what_does_not_fit(self, content, words):
        assert words in refused(lambda: read_json(self.Thing, content, what="File", advice="make it"))

    def test_names_of_files_need_not_be_text(self):
        content = {"number": 1, "file": "\udcff", "list": json.dumps(["\udcff"])}
        assert read_json(self.Thing, json.dumps(content), what="File", advice="") == content

    def test_what_fits(self):
        assert read_json(self.Thing, b'{"number": 1, "more": [2]}', what="File", advice="") == {
            "number": 1,
            "more": [2],
        }


def change_run(folder, **changes):
    run = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**run, **changes}))


def change_table(folder, pattern, change):
    (file,) = folder.glob(pattern)
    pq.write_table(change(pq.ParquetFile(file).read()), file)


class TestFolderThatWasSealedAgain:
    """A fingerprint is no promise of sense: what fits its fingerprint is checked, too."""

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"packages": "numpy 2"}, "packages = 'numpy 2'"),
            ({"n_record": "4"}, "n_record = '4'"),
            ({"n_record": 10**40}, "n_record ="),
            ({"prior_widths": [1.0, 2.0]}, "prior_widths ="),
            ({"directions": {}}, "directions.weight: required key is missing"),
            ({"campaign": {"on": True}}, "campaign = a table of 1 keys: value error, it has no acceptance"),
            ({"settings": {"fit": {"derived": []}}}, "settings.fit has no"),
            ({"doubts": "none"}, "doubts = 'none'"),
        ],
    )
    def test_run_json(self, folder, changes, words):
        change_run(folder, **changes)
        seal(folder)
        text = refused(lambda: brs.open_fit(folder))
        assert words in text
        assert "run.json" in text

    def test_run_json_that_is_no_utf8(self, folder):
        (folder / "run.json").write_bytes(b'{"n_record": "\xe9"}')
        seal(folder)
        assert "cannot be read as JSON" in refused(lambda: brs.open_fit(folder))

    def test_options_in_run_json_are_those_of_settings(self, folder):
        run = json.loads((folder / "run.json").read_text())
        run["settings"]["fit"]["prob"] = 7.0
        change_run(folder, settings=run["settings"])
        seal(folder)
        assert "Invalid prob 7.0" in refused(lambda: brs.open_fit(folder))

    @pytest.mark.parametrize(
        ("pattern", "change", "ask", "words"),
        [
            ("summary/*/*", lambda t: t.drop_columns(["mean"]), lambda f: f.summary(), "has no column 'mean'"),
            ("summary/*/*", lambda t: t.slice(1), lambda f: f.summary(), "Table 'summary' in"),
            (
                "summary/*/*",
                lambda t: t.take(pa.array(range(t.num_rows)[::-1])),
                lambda f: f.summary(),
                "in their order",
            ),
            ("posterior/*/*", lambda t: t.slice(0, 3), lambda f: f.flag, "has 3 rows, and must have 4"),
            (
                "posterior/*/*",
                lambda t: pa.concat_tables([t, t]),
                lambda f: f.covariance(),
                "has 8 rows, and must have 4",
            ),
            ("draws/*/*", lambda t: t.slice(5), lambda f: f.draws(), "Table 'draws' in"),
            (
                "draws/*/*",
                lambda t: t.filter(pa.compute.not_equal(t["record"], 2)),
                lambda f: f.draws(),
                "and must have",
            ),
            ("predicted/*/*", lambda t: t.slice(5), lambda f: f.predicted_draws(), "Table 'predicted' in"),
            (
                "prior.parquet",
                lambda t: t.rename_columns(["x", *t.column_names[1:]]),
                lambda f: f.prior_draws,
                "column 'uu'",
            ),
            ("prior.parquet", lambda t: t.slice(3), lambda f: f.prior_draws, "does not hold 10000 draws"),
        ],
    )
    def test_tables(self, folder, pattern, change, ask, words):
        change_table(folder, pattern, change)
        seal(folder)
        assert words in refused(lambda: ask(brs.open_fit(folder)))

    def test_a_table_that_is_no_parquet(self, folder):
        (file,) = folder.glob("summary/*/*")
        file.write_bytes(b"nothing")
        seal(folder)
        assert "cannot be read as Parquet" in refused(brs.open_fit(folder).summary)

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"quantity,bin\nuu", "cannot be used: CSV parse error"),
            (b"quantity,bin,mean\nuu,all,1\n", "has no column 'low'"),
            (
                b"quantity,bin,mean,low,high,prob,interval,n_record,decided\nuu,all,1,1,1,0.9,equal-tailed,4,1\n",
                "has 0 rows of vv",
            ),
        ],
    )
    def test_campaign(self, folder, content, words):
        (folder / "campaign.csv").write_bytes(content)
        seal(folder)
        assert words in refused(brs.open_fit(folder).campaign)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda d: d.drop_vars("yaw"), "have no yaw with dims"),
            (lambda d: d.isel(record=slice(2)), "the records are 2, and 4 were fitted"),
            (lambda d: d.assign(flag=d["flag"].astype(str)), "flag holds texts"),
        ],
    )
    def test_records(self, folder, records, change, words):
        change(records).to_netcdf(folder / "records.nc", engine="h5netcdf")
        seal(folder)
        assert words in refused(lambda: brs.open_fit(folder).records)

    @pytest.mark.parametrize(
        "entry",
        [
            {"path": 3, "n_byte": 1, "sha256": "a"},
            {"path": "../../elsewhere", "n_byte": 1, "sha256": "a"},
            {"path": "/etc/passwd"},
            {"key": "k"},
            {"key": 1, "key_parts": {}},
            {"n_file": "1"},
            {"path": "a", "sha256": "b", "n_byte": "c"},
            {"path": "a", "sha256": "b"},
            {"path": "a", "n_byte": 3},
        ],
    )
    def test_a_line_of_the_list(self, folder, entry):
        with (folder / LEDGER).open("ab") as file:
            file.write(_line(entry))
        assert "was changed since it was written" in refused(lambda: brs.open_fit(folder))

    def test_resume_says_one_line(self, folder, records):
        change_table(folder, "summary/*/*", lambda table: table.drop_columns(["mean"]))
        seal(folder)
        options = {"sampler": "direct", "target_ess": 50, "seed": 1, "campaign": "on", "derived": ("tke",)}
        text = refused(lambda: brs.fit(records, SCAN, noise=plain_noise(SCAN), output=folder, resume=True, **options))
        assert "has no column 'mean'" in text


class TestRecords:
    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda d: d.drop_vars("wind_speed"), "have no wind_speed with dims"),
            (lambda d: d.assign(wind_speed=d["wind_speed"].assign_attrs(units="knots")), "wind_speed is in 'knots'"),
            (lambda d: d.assign(flag=d["flag"].astype(float)), "flag holds numbers"),
            (lambda d: d.assign(part_wind=(("part", "record"), np.zeros((3, N_RECORD)))), "part_wind has dims"),
            (
                lambda d: d.assign(count=(d["variance"].dims, np.full(d["variance"].shape, -5))),
                "count holds -5, and must",
            ),
            (lambda d: d.assign(motion_count=("record", np.full(N_RECORD, -1))), "motion_count holds -1, and must"),
            (lambda d: d.assign_attrs(duration="long"), "duration = 'long'"),
            (lambda d: d.assign_attrs(records_report="{"), "records_report"),
            (lambda d: d.assign_attrs(read_report='{"files": 3}'), "read_report.files"),
        ],
    )
    def test_files(self, records, tmp_path, change, words):
        change(records).to_netcdf(tmp_path / "records.nc", engine="h5netcdf")
        text = refused(lambda: open_record_files([tmp_path / "records.nc"], SCAN))
        assert words in text
        assert "records.nc" in text

    def test_in_python_too(self, records):
        bad = records.assign(yaw=records["yaw"].assign_attrs(units="rad"))
        assert "yaw is in 'rad'" in refused(lambda: brs.fit(bad, SCAN, noise=plain_noise(SCAN), seed=1))

    @pytest.mark.parametrize(
        ("stress", "place", "words"),
        [
            ([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], None, "they have mast_stress, and no attribute mast_position"),
            ([1.0, -1.0, 1.0, 0.0, 0.0, 0.0], "[0, 0, 0]", "mast_stress of record 2 has vv -1 m² s⁻²: a variance is"),
            ([1.0, -np.inf, 1.0, 0.0, 0.0, 0.0], "[0, 0, 0]", "mast_stress of record 2 has vv -inf m² s⁻²"),
            (
                [1.0, 1.0, 1.0, 0.0, 0.0, 0.0][:5],
                "[0, 0, 0]",
                "mast_stress holds 5 numbers of a record, and must hold uu",
            ),
            ([1.0, 1.0, 1.0, 2.0, 0.0, 0.0], "[0, 0, 0]", "mast_stress of record 2 has uv 2 m² s⁻², beyond the root"),
            (
                [1.0, 1.0, 1.0, 0.9, 0.9, -0.9],
                "[0, 0, 0]",
                "mast_stress of record 2 has the smallest principal variance",
            ),
        ],
    )
    def test_a_mast_has_a_place_and_measured_what_a_wind_may_have(self, records, tmp_path, stress, place, words):
        values = np.full((N_RECORD, len(stress)), np.nan)
        values[2] = stress
        bad = records.assign(mast_stress=(("record", "stress"), values))
        bad = bad if place is None else bad.assign_attrs(mast_position=place)
        text = refused(lambda: brs.fit(bad, SCAN, noise=plain_noise(SCAN), seed=1))
        assert words in text
        assert "give the mast anew with bayes_rs.wind.with_mast" in text
        bad.to_netcdf(tmp_path / "records.nc", engine="h5netcdf")
        assert words in refused(lambda: open_record_files([tmp_path / "records.nc"], SCAN))

    def test_what_make_records_makes_fits(self, made):
        check_layout(made, "variance", "beam", "time")

    @pytest.mark.parametrize(("dim", "words"), [("blocks", "1 numbers of blocks"), ("part", "1 parts")])
    def test_parts_of_another_scan(self, made, dim, words):
        bad = made.isel({dim: slice(1)})
        assert f"The records have {words} and those of 600 s" in refused(lambda: brs.fit(bad, "2-beam", seed=1))

    @pytest.mark.parametrize("duration", [20.0, 60.0])
    def test_short_records_have_parts_that_tell_less(self, duration):
        """Of a minute two numbers of blocks are told, and of 20 s none; their parts hardly differ."""
        scan = "6-beam@opening_angle_deg=45,focus_distance=52"
        records = brs.make_records(brs.read(brs.demo_file("6-beam-45"), scan), scan, duration=duration)
        some = records.isel(record=slice(3))
        assert brs.fit(some, scan, seed=1, target_ess=50, sampler="direct", draws="none").n_fitted == 3

    def test_numbers_of_beams_may_be_floats_that_are_whole(self, records):
        """As other programs make them; bits may not."""
        options = {"noise": plain_noise(SCAN), "seed": 1, "target_ess": 50, "sampler": "direct", "draws": "none"}
        floats = records.assign_coords(beam=records["beam"].astype(float))
        one, other = (brs.fit(given, SCAN, **options).summary() for given in (records, floats))
        assert one.equals(other)
        for beam in (records["beam"] + 0.5, records["beam"] * np.inf):
            fitted = partial(brs.fit, records.assign_coords(beam=beam), SCAN, **options)
            assert "beam holds numbers, and must hold whole numbers" in refused(fitted)
        bits = records.assign(flag=records["flag"].astype(float))
        assert "flag holds numbers, and must hold whole numbers" in refused(lambda: brs.fit(bits, SCAN, **options))

    def test_no_record(self, made):
        empty = made.isel(record=slice(0))
        assert refused(lambda: brs.fit(empty, "2-beam", seed=1)).startswith("There is no record")

    def test_infinite_winds_are_not_believed(self, records):
        bad = records.assign(yaw=records["yaw"].where(np.arange(N_RECORD) != 2, np.inf))
        fit = brs.fit(bad, SCAN, noise=plain_noise(SCAN), seed=1, target_ess=50, sampler="direct", draws="none")
        assert fit.fitted.tolist() == [True, True, False, True]
        assert any("1 of 4 wind directions of the records are beyond 720 degrees" in line for line in fit.failures)


class TestNoise:
    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (
                lambda d: d.assign_coords(wind_speed=d["wind_speed"].assign_attrs(units="km/h")),
                "wind_speed is in 'km/h'",
            ),
            (lambda d: d.transpose("stress", ...), "gain has dims"),
            (lambda d: d.assign_coords(stress=["vv", "uu", "ww", "uv", "uw", "vw"]), "stress is vv, uu"),
            (lambda d: d.assign_coords(other_beam=d["beam"].values[::-1]), "other_beam is not the same as its beam"),
            (lambda d: d.assign_coords(beam=d["beam"].astype(float) + 1e300), "beam holds numbers"),
            (lambda d: d.assign(gain=1e300 + d["gain"]), "gain holds 1e"),
        ],
    )
    def test_files(self, tmp_path, change, words):
        change(plain_noise(SCAN).to_dataset()).to_netcdf(tmp_path / "noise.nc", engine="h5netcdf")
        text = refused(lambda: load_noise(tmp_path / "noise.nc"))
        assert "is damaged" in text
        assert words in text


class TestParquetInput:
    @pytest.mark.parametrize("name", ["time", "beam", "radial_velocity"])
    @pytest.mark.parametrize("make", [lambda v: [v], lambda v: {"a": v}, lambda v: str(v).encode() + b"\xff"])
    def test_nested_and_binary_columns(self, tmp_path, name, make):
        table = pq.read_table(brs.demo_file("6-beam")).slice(0, 600)
        values = pa.array([make(value) for value in table[name].to_pylist()])
        pq.write_table(table.set_column(table.column_names.index(name), name, values), tmp_path / "data.parquet")
        text = refused(lambda: brs.read(tmp_path / "data.parquet", SCAN))
        assert re.match(
            rf"Column '{name}' of file '.*data.parquet' holds .*, and must hold one number, text or time", text
        )

    @pytest.mark.parametrize("name", ["time", "radial_velocity"])
    def test_times_of_day(self, tmp_path, name):
        # nanoseconds that Python's own times do not have
        table = pq.read_table(brs.demo_file("6-beam")).slice(0, 600)
        values = pa.array(np.arange(600, dtype=np.int64) + 1, type=pa.time64("ns"))
        pq.write_table(table.set_column(table.column_names.index(name), name, values), tmp_path / "data.parquet")
        text = refused(lambda: brs.read(tmp_path / "data.parquet", SCAN))
        assert re.match(rf"Column '{name}' of file '.*data.parquet' holds time64\[ns\], times of day without", text)
        text = refused(lambda: look(tmp_path / "data.parquet"))
        assert "data.parquet" in text


class TestFileOfAFolder:
    @pytest.mark.parametrize("name", ["posterior.nc", "run.json", "summary.csv"])
    def test_it_opens_the_fit(self, folder, name):
        assert brs.open_fit(folder / name).summary().equals(brs.open_fit(folder).summary())

    def test_the_command_writes_beside_it(self, folder, monkeypatch, capsys):
        monkeypatch.setattr("sys.argv", ["bayes-rs", "report", str(folder / "posterior.nc")])
        with pytest.raises(SystemExit) as end:
            main()
        assert not end.value.code
        assert capsys.readouterr().out.strip() == str(folder / "report.html")

    def test_another_file(self, tmp_path):
        (tmp_path / "posterior.nc").write_bytes(b"")
        text = refused(lambda: brs.open_fit(tmp_path / "posterior.nc"))
        assert "give the output folder of a bayes-rs run" in text


def test_report_of_a_folder_that_is_being_written(folder, monkeypatch, capsys):
    lines = (folder / LEDGER).read_bytes().splitlines(keepends=True)
    (folder / LEDGER).write_bytes(b"".join(lines[:-2]) + lines[-2][:20])  # a line is half written
    monkeypatch.setattr("sys.argv", ["bayes-rs", "report", str(folder)])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert (
        capsys.readouterr().err == f"bayes-rs: The fit in '{folder}' has not ended: resume it, or wait for its end.\n"
    )
