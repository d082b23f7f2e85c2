"""The report of a fit of a folder shows what that of the same data in one go does; older folders stay readable."""

import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from folder_scene import DURATION, FITTING, FLOW, RECORDING

from bayes_rs import InputError, fit, load_scan, make_records, read, save_scan, simulate, write_report
from bayes_rs.fits import plan as campaign_plan
from bayes_rs.fits.parts import ALONG, ALONG_SHAPE
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.priors.ratio import WeakPrior

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
    options = {"noise_file": folder / "noise.nc", "prior": PRIOR, "derived": DERIVED, "sampler": "auto", **FITTING}
    reading = {"invalid": [9999.0]}
    records = make_records(read(folder / "year", scan, on_bad_file="skip", **reading), scan, **RECORDING)
    run_fit(records, scan, folder / "at-once", **options)
    for draws in ("none", "float64"):
        run_folder_fit(
            folder / "year", scan, folder / draws, reading=reading, recording=RECORDING, draws=draws, **options
        )
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
        assert len(found) == 8
        for name in ("read", "stresses", "contraction", "intensity", "shape", "diagnostics"):
            one, other = (re.sub(DRAWS, "", some[name]) for some in (found, expected[0]))
            assert one == other, name
        assert data["records"]["prior"] == expected[1]["records"]["prior"]

    def test_they_tell_what_was_read_and_where_the_prior_decides(self, expected):
        read, along = expected[0]["read"], expected[0]["contraction"]
        assert "0.csv: " in read
        assert "5 with an invalid value" in read
        assert "skipped bad.csv: " in read
        assert "1 temporary" in read
        assert "Contraction along the directions of R" in along
        assert "Prior: weak: " in along

    def test_the_run_file_has_what_a_reader_of_the_folder_needs(self, place, tmp_path):
        runs = [json.loads((place / name / "run.json").read_text()) for name in ("at-once", "none")]
        for run in runs:
            assert run["prior_option"] == PRIOR
            (tmp_path / "again.toml").write_text(run["scan_toml"], encoding="utf-8")
            assert load_scan(tmp_path / "again.toml").key == run["scan_key"]
        assert runs[0]["words"] == runs[1]["words"]
        assert runs[0]["words"][-1].startswith("contraction along what the scan sees least, ")

    def test_directions_are_those_of_the_result(self, place):
        scan = load_scan(place / "mine.toml")
        expected = open_result(place / "at-once").directions()
        found = read_folder(place / "none").directions
        # another order of summation in the singular values, nothing else
        pd.testing.assert_frame_equal(found, expected, check_exact=False, rtol=1e-12, atol=1e-12)
        assert expected["contraction"].notna().any()


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
            stored = record_store.store_records(
                tmp_path / "year", scan, tmp_path / f"{rows}", reading=reading, chunk_rows=rows, **RECORDING
            )
            assert json.loads(stored.records.attrs["read_report"]) == whole

    def test_files_of_one_name_in_two_folders_are_two(self, place, tmp_path):
        scan = load_scan(place / "mine.toml")
        for day, name in (("a", "0.csv"), ("b", "1.csv")):
            (tmp_path / "year" / day).mkdir(parents=True)
            shutil.copy(place / "year" / name, tmp_path / "year" / day / "lidar.csv")
        stored = record_store.store_records(tmp_path / "year", scan, tmp_path / "store", **RECORDING)
        whole = read(tmp_path / "year", scan)
        assert json.loads(stored.records.attrs["read_report"]) == json.loads(whole.attrs["read_report"])
        assert len(json.loads(whole.attrs["read_report"])["files"]) == 2


class TestCampaigns:
    def test_a_prior_of_ones_own_has_its_outline_too(self, place, tmp_path):
        scan = load_scan(place / "mine.toml")
        records = xr.load_dataset(place / "none" / "records.nc", engine="h5netcdf").isel(record=slice(0, 3))
        noise = calibrate(scan, FLOW, wind_speed=10.0, duration=DURATION, cache=False)
        own = WeakPrior(log_sd_uu=0.3)
        folder = fit_campaign(records, scan, tmp_path / "out", noise=noise, prior=own, **FITTING).folder
        expected = fit(records, scan, noise=noise, prior=own, **FITTING)["prior/stress"].values.reshape(-1, 6)[:2000]
        expected = expected / expected[:, :3].sum(axis=1, keepdims=True)
        np.testing.assert_array_equal(read_folder(folder).prior_shape, expected)
        assert json.loads((folder / "run.json").read_text())["prior_option"] is None


class TestOlderFolders:
    @pytest.fixture
    def older(self, place, tmp_path):
        """A folder as it was before it kept all this."""
        folder = tmp_path / "out"
        shutil.copytree(place / "none", folder)
        (folder / "prior.parquet").unlink()
        run = json.loads((folder / "run.json").read_text())
        for name in ("scan_toml", "sight", "directions", "prior_option", "words"):
            del run[name]
        (folder / "run.json").write_text(json.dumps(run))
        for file in folder.glob("posterior/**/*.parquet"):
            pd.read_parquet(file).drop(columns=[*ALONG, *ALONG_SHAPE]).to_parquet(file, index=False)
        return folder

    def test_they_are_read(self, older, place):
        found, data = sections(older)
        assert list(found) == list(sections(place / "none")[0])
        assert "Contraction along the directions" not in found["contraction"]
        assert "prior" not in data["records"]

    def test_they_are_not_gone_on_with(self, place, tmp_path, monkeypatch):
        scan = load_scan(place / "mine.toml")
        options = {"reading": {"invalid": [9999.0]}, "recording": RECORDING, "noise_file": place / "noise.nc"}
        monkeypatch.setattr(campaign_plan, "LAYOUT", 1)
        run_folder_fit(place / "year", scan, tmp_path / "out", **options, **FITTING)
        monkeypatch.undo()
        words = "is of a run that differs in layout of the tables, so it cannot be resumed: give the same"
        with pytest.raises(InputError, match=words):
            run_folder_fit(place / "year", scan, tmp_path / "out", resume=True, **options, **FITTING)

    def test_a_scan_that_was_spoilt_is_refused(self, place, tmp_path):
        folder = tmp_path / "out"
        shutil.copytree(place / "at-once", folder)
        run = json.loads((folder / "run.json").read_text())
        (folder / "run.json").write_text(json.dumps({**run, "scan_toml": "title = 1"}))
        with pytest.raises(InputError, match=r"The scan_toml in run.json cannot be read: "):
            write_report(folder)
