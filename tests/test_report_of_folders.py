"""The report of a fit of files shows what that of the same records does."""

import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from folder_scene import DURATION, FITTING, FLOW, RECORDING, run

from bayes_rs import InputError, fit, load_scan, make_records, open_fit, read, save_scan, simulate, write_report
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.file_options import FileOptions
from bayes_rs.fits import plan
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.priors.ratio import WeakPrior
from bayes_rs.records import record_store
from bayes_rs.report.report_data import report_data
from bayes_rs.result_folder import seal_folder

pytestmark = pytest.mark.slow
N_RECORD = 10
PRIOR = "weak:log_sd_vv=0.6"
DERIVED = ("ti",)
DRAWS = r'<span class="key"><span class="swatch cloud" aria-hidden="true"></span>draws of the chosen record</span> '
"""The key of what only a folder with draws shows."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Fits of files of ten short records, some rows of them dropped, one that cannot be read; a scan of one's own."""
    folder = tmp_path_factory.mktemp("place")
    own = load_scan("6-beam", opening_angle_deg=30.0, yaw_deg=10.0)
    scan = load_scan(save_scan(own, folder / "mine.toml"))
    series = simulate(scan, FLOW, wind_speed=10.0, duration=DURATION, n_records=N_RECORD, seed=5)
    frame = series.to_dataframe().reset_index()[["time", "beam", "radial_velocity"]]
    frame.loc[40:44, "radial_velocity"] = 9999.0
    frame.loc[900:1300, "radial_velocity"] = np.nan
    (folder / "year").mkdir()
    for index, part in enumerate(np.array_split(np.arange(len(frame)), 4)):
        frame.iloc[part].to_csv(folder / "year" / f"{index}.csv", index=False)
    (folder / "year" / "bad.csv").write_text("time,beam,radial_velocity\n2020-01-01T00:00:00,0,oops\n")
    (folder / "year" / "out.partial-abc").mkdir()
    (folder / "year" / "out.partial-abc" / "records.csv").write_text("half")
    calibrate(scan, FLOW, wind_speed=10.0, duration=DURATION, cache=False).save(folder / "noise.nc")
    options = {"prior": PRIOR, "derived": DERIVED, **FITTING}
    reading = {"invalid": [9999.0]}
    records = make_records(read(folder / "year", scan, on_bad_file="skip", **reading), scan, **RECORDING)
    fit(records, scan, output=folder / "at-once", noise=folder / "noise.nc", **options)
    for draws in ("none", "float64"):
        more = {"scan": str(folder / "mine.toml"), "draws": draws, **reading, **options}
        run(folder / "year", folder / draws, folder / "noise.nc", **more)
    return folder


def sections(folder):
    """Return the sections of a folder's page, by their headings, and its data."""
    text = write_report(folder, folder.parent / "page.html", overwrite=True).read_text(encoding="utf-8")
    found = dict(re.findall(r'<section id="(\w+)"[^>]*>(.*?)</section>', text, flags=re.DOTALL))
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    return found, json.loads(data.group(1))


@pytest.fixture(scope="module")
def expected(place):
    return sections(place / "at-once")


class TestSameSections:
    @pytest.mark.parametrize("draws", ["none", "float64"])
    def test_they_hold_the_same(self, place, expected, draws):
        found, data = sections(place / draws)
        assert list(found) == list(expected[0])
        assert len(found) == 9
        # without draws, a shape's point is that of the posterior mean
        for name in ("read", "stresses", "decided", "intensity", "diagnostics", *(["shape"] * (draws != "none"))):
            one, other = (re.sub(DRAWS, "", some[name]) for some in (found, expected[0]))
            assert one == other, name
        assert data["records"]["prior"] == expected[1]["records"]["prior"]

    def test_they_tell_what_was_read_and_where_the_prior_decides(self, expected):
        read, along = expected[0]["read"], expected[0]["decided"]
        assert "0.csv: " in read
        assert "5 with an invalid value" in read
        assert "skipped bad.csv: " in read
        assert "1 temporary" in read
        assert "Stresses learnt from the data, of six: " in along
        assert "least squares" in along
        assert "Directions of R: how far the data narrowed" in along
        assert "Prior: weak: " in along

    def test_the_run_file_has_what_a_reader_of_the_folder_needs(self, place, tmp_path):
        runs = [json.loads((place / name / "run.json").read_text()) for name in ("at-once", "none")]
        for one in runs:
            assert one["settings"]["fit"]["prior"] == PRIOR
            (tmp_path / "again.toml").write_text(one["scan_toml"], encoding="utf-8")
            assert load_scan(tmp_path / "again.toml").key == one["scan_key"]
        assert runs[0]["words"] == runs[1]["words"]
        assert any(line.startswith("the beams hardly see ") for line in runs[0]["words"])

    def test_directions_are_the_medians_of_those_of_the_result(self, place):
        of_records = open_fit(place / "at-once").directions()
        found = report_data(open_fit(place / "none")).directions
        expected = of_records.groupby("direction")[list(found.columns)].median()
        pd.testing.assert_frame_equal(found, expected.reset_index(drop=True), check_exact=True)
        assert found["contraction"].notna().all()


class TestSameBytes:
    def test_whatever_the_chunks_and_the_order_in_the_files(self, place, tmp_path, monkeypatch):
        """Samples out of order across the ends of chunks are counted as in the whole file."""
        monkeypatch.setattr(record_store, "SAVE_SECONDS", 0.0)
        scan = load_scan(place / "mine.toml")
        (tmp_path / "year").mkdir()
        for file in (place / "year").glob("?.csv"):
            frame = pd.read_csv(file)
            order = np.argsort(np.arange(len(frame)) + np.random.default_rng(3).uniform(0.0, 30.0, len(frame)))
            frame.iloc[order].to_csv(tmp_path / "year" / file.name, index=False)
        reading = {"invalid": [9999.0], "out_of_order": "sort"}
        whole = json.loads(read(tmp_path / "year", scan, **reading).attrs["read_report"])
        assert whole["samples_out_of_order"] > 100
        for rows in (40, 333, 100_000):
            options = {"reading": FileOptions(**reading), "chunk_rows": rows, **RECORDING}
            with begin_result_folder(tmp_path / f"{rows}", key="k", key_parts={}) as folder:
                stored = record_store.store_records(tmp_path / "year", scan, folder, **options)
            assert json.loads(stored.records.attrs["read_report"]) == whole

    def test_files_of_one_name_in_two_folders_are_two(self, place, tmp_path):
        scan = load_scan(place / "mine.toml")
        for day, name in (("a", "0.csv"), ("b", "1.csv")):
            (tmp_path / "year" / day).mkdir(parents=True)
            shutil.copy(place / "year" / name, tmp_path / "year" / day / "lidar.csv")
        with begin_result_folder(tmp_path / "store", key="k", key_parts={}) as folder:
            stored = record_store.store_records(tmp_path / "year", scan, folder, **RECORDING)
        whole = read(tmp_path / "year", scan)
        assert json.loads(stored.records.attrs["read_report"]) == json.loads(whole.attrs["read_report"])
        assert len(json.loads(whole.attrs["read_report"])["files"]) == 2


class TestPriorOfOnesOwn:
    def test_it_has_its_outline_too(self, place, tmp_path):
        scan = load_scan(place / "mine.toml")
        records = xr.load_dataset(place / "none" / "records.nc", engine="h5netcdf").isel(record=slice(0, 3))
        noise = calibrate(scan, FLOW, wind_speed=10.0, duration=DURATION, cache=False)
        own = WeakPrior(log_sd_uu=0.3)
        folder = tmp_path / "out"
        fit(records, scan, output=folder, noise=noise, prior=own, draws="none", **FITTING)
        expected = fit(records, scan, noise=noise, prior=own, **FITTING)["prior/stress"].values.reshape(-1, 6)[:2000]
        expected = expected / expected[:, :3].sum(axis=1, keepdims=True)
        np.testing.assert_array_equal(report_data(open_fit(folder)).prior_shape, expected)
        assert json.loads((folder / "run.json").read_text())["settings"]["fit"]["prior"] is None


class TestOtherFolders:
    def test_another_layout_is_not_gone_on_with(self, place, tmp_path, monkeypatch):
        options = {"scan": str(place / "mine.toml"), "invalid": [9999.0]}
        monkeypatch.setattr(plan, "LAYOUT", 1)
        run(place / "year", tmp_path / "out", place / "noise.nc", **options)
        monkeypatch.undo()
        words = "is of a run that differs in layout of the tables, so it cannot be resumed: give the same"
        with pytest.raises(InputError, match=words):
            run(place / "year", tmp_path / "out", place / "noise.nc", resume=True, **options)

    def test_a_scan_that_was_spoilt_is_refused(self, place, tmp_path):
        folder = tmp_path / "out"
        shutil.copytree(place / "at-once", folder)
        about = json.loads((folder / "run.json").read_text())
        (folder / "run.json").write_text(json.dumps({**about, "scan_toml": "title = 1"}))
        with pytest.raises(InputError, match=r"run.json' .*: resume the fit to make it again"):
            write_report(folder)
        seal_folder(folder)
        with pytest.raises(InputError, match=r"Invalid|cannot be read|unknown|missing"):
            write_report(folder)
