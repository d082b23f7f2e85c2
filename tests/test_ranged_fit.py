"""A fit at several ranges: range by range what each is alone, in memory and in a folder."""

import base64
import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from matplotlib.figure import Figure

import bayes_rs as brs
from bayes_rs import fit, load_scan, make_records, open_fit
from bayes_rs.cli.group import commands
from bayes_rs.errors import InputError
from bayes_rs.fits.range_job import seed_of_range
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.posteriors.decided import PRIORS
from bayes_rs.records import at_range
from bayes_rs.report.writing import write_report
from bayes_rs.result_folder import seal_folder

DISTANCES = (52.0, 98.0)
SCAN = "6-beam"
QUICK = {"target_ess": 200, "turbulence": "fu-2022"}


def series_at(distances, *, n_records=3):
    """Samples of six beams at several distances, as one series."""
    scan = load_scan(SCAN, focus_distance=distances[0])
    ranged = RangedScan.of(scan, distances)
    parts = []
    for place, distance in enumerate(distances):
        part = brs.simulate(
            load_scan(SCAN, focus_distance=distance), "fu-2022", wind_speed=10.0, n_records=n_records, seed=place
        )
        parts.append(part.assign_coords(range=("sample", np.full(part.sizes["sample"], distance))))

    joined = xr.concat(parts, dim="sample").drop_attrs()
    return joined, ranged


@pytest.fixture(scope="module")
def records():
    series, ranged = series_at(DISTANCES)
    return make_records(series, ranged.of_one)


@pytest.fixture(scope="module")
def folder(records, tmp_path_factory):
    place = tmp_path_factory.mktemp("ranged") / "out"
    fit(records, SCAN, seed=3, output=place, **QUICK)
    return place


@pytest.fixture(scope="module")
def found(folder):
    return open_fit(folder)


class TestEachRange:
    def test_is_what_it_is_alone(self, records, found):
        for distance in DISTANCES:
            alone = fit(at_range(records, distance), SCAN, seed=seed_of_range(3, distance), **QUICK)
            pd.testing.assert_frame_equal(alone.summary(), found.at(distance).summary())
            np.testing.assert_array_equal(alone.draws(), found.at(distance).draws())

    def test_has_the_noise_of_its_own_distances(self, found):
        near, far = (found.at(distance) for distance in DISTANCES)
        assert near.scan.key == load_scan(SCAN, focus_distance=52.0).key
        assert far.scan.key == load_scan(SCAN, focus_distance=98.0).key

    def test_shares_no_random_numbers_with_others(self):
        assert len({seed_of_range(1, distance) for distance in (50.0, 50.001, 60.0)}) == 3

    def test_is_the_same_in_memory(self, records, found):
        held = fit(records, SCAN, seed=3, **QUICK)
        assert isinstance(held, RangedFit)
        pd.testing.assert_frame_equal(held.summary(), found.summary())


class TestTogether:
    def test_the_summary_has_the_range_of_each_row(self, found):
        table = found.summary()
        assert list(table.columns[:2]) == ["range", "record"]
        assert table["range"].unique().tolist() == list(DISTANCES)
        pd.testing.assert_frame_equal(
            table[table["range"] == 98.0].drop(columns="range").reset_index(drop=True), found.at(98.0).summary()
        )

    def test_counts_are_those_of_all_ranges(self, found):
        assert (found.n_record, found.n_fitted) == (6, 6)
        assert repr(found).startswith("<RangedFit: 2 of 2 ranges, scan 6-beam")

    def test_a_fit_whose_folder_is_gone_still_shows_itself(self, folder, tmp_path, monkeypatch):
        shutil.copytree(folder, tmp_path / "there")
        monkeypatch.chdir(tmp_path)
        fit = open_fit("there")
        monkeypatch.chdir("/")
        assert repr(fit).startswith("<RangedFit: 2 of 2 ranges")
        fit = open_fit(tmp_path / "there")
        shutil.rmtree(tmp_path / "there")
        assert repr(fit).startswith("<RangedFit that cannot be read, scan 6-beam, in ")
        assert "RangedFit that cannot be read" in fit._repr_html_()

    def test_the_profile_has_intensity_and_stresses_of_each_range(self, found):
        table = found.profile()
        assert table["quantity"].tolist() == ["ti", "uu", "vv", "ww", "uv", "uw", "vw"] * 2
        assert (table["low"] < table["high"]).all()
        one = found.profile(record=1)
        own = found.at(52.0).summary()
        uu = own[(own["record"] == 1) & (own["stress"] == "uu")].iloc[0]
        rows = one[one["range"] == 52.0].set_index("quantity")
        assert rows.loc["uu", "estimate"] == uu["median"]
        speed = float(found.at(52.0).records["wind_speed"].values[1])
        assert rows.loc["ti", "low"] == pytest.approx(np.sqrt(uu["low"]) / speed)

    def test_a_record_that_one_range_lacks_has_the_profile_of_the_others(self, records):
        lost = records.copy(deep=True)
        lost["flag"].values[0, 1] = 4
        some = fit(lost, SCAN, seed=3, **QUICK)
        assert some.profile(record=1)["range"].unique().tolist() == [98.0]
        lost["flag"].values[:, 1] = 4
        with pytest.raises(InputError, match="Record 1 was not fitted"):
            fit(lost, SCAN, seed=3, **QUICK).profile(record=1)

    def test_what_is_of_one_range_is_refused_with_advice(self, found):
        of_one = (found.draws, found.covariance, found.lidar_frame, lambda: found["posterior"], lambda: found.flag)
        for ask in (*of_one, lambda: found.prior_draws):
            with pytest.raises(InputError, match=r"at 2 ranges \(52, 98 m\).*fit.at\(52\)"):
                ask()
        with pytest.raises(InputError, match="No range 300 m: there are 52, 98 m"):
            found.at(300.0)
        with pytest.raises(InputError, match="Invalid range nan m: it must be a finite number"):
            found.at(float("nan"))
        assert found.nuisance_names == ()
        with pytest.raises(InputError, match="has no heights"):
            found.at(height=50.0)

    def test_arviz_has_the_range_as_a_dimension(self, found):
        tree = found.to_datatree()
        assert tree["posterior"]["stress"].sizes["range"] == 2
        np.testing.assert_array_equal(
            tree["posterior"]["stress"].sel(range=98.0).values, found.at(98.0)["posterior"]["stress"].values
        )

    def test_the_records_are_those_that_were_fitted(self, records, found):
        np.testing.assert_array_equal(found.records["variance"].values, records["variance"].values)

    def test_words_have_a_line_for_each_range(self, found):
        table = found.profile_lines()
        assert found.words[2:] == table
        assert [line.split()[:3] for line in table[1:3]] == [["52", "m", "3"], ["98", "m", "3"]]
        assert max(map(len, table)) <= 80  # it is read on a terminal
        profile = found.profile()
        for distance, line in zip(found.ranges, table[1:3], strict=True):
            rows = profile[profile["range"] == distance].set_index("quantity")
            cells = line.rsplit(")", 1)[1].replace("*", " ").split()
            np.testing.assert_allclose(np.array(cells, float), rows.loc[list(brs.STRESSES), "estimate"], atol=0.0051)

    def test_the_headline_is_of_the_profile(self, found):
        told = found.headline()
        assert "at range 52 m to " in told.found
        assert told.found.endswith("; 6 of 6 records fitted at 2 of 2 ranges")
        assert json.dumps(told.to_plain(), allow_nan=False)

    def test_the_table_for_people_has_a_row_for_each_record_and_range(self, folder):
        table = pd.read_csv(folder / "stresses.csv")
        assert table[["range_m", "record"]].to_numpy().tolist() == [[m, k] for m in (52.0, 98.0) for k in range(3)]

    def test_noise_of_one_range_is_refused(self, records):
        with pytest.raises(InputError, match="noise is of one range, and R is wanted at 2 ranges"):
            fit(records, SCAN, seed=1, noise="models/noise/6-beam-theory.nc")


class TestFolder:
    def test_a_range_is_opened_where_another_is_gone(self, folder, found, tmp_path):
        place = shutil.copytree(folder, tmp_path / "out")
        shutil.rmtree(place / "range-52m")
        some = open_fit(place)
        assert some.at(98.0) is some.at(98.0)
        pd.testing.assert_frame_equal(some.at(98.0).summary(), found.at(98.0).summary())
        with pytest.raises(InputError, match=r"No folder .*range-52m"):
            some.summary()

    def test_the_range_without_records_is_said(self, records, tmp_path):
        lost = records.copy(deep=True)
        lost["flag"].values[0] = 4
        said = []
        some = fit(lost, SCAN, seed=3, output=tmp_path / "out", say=said.append, **QUICK)
        assert "range 52 m: no record can be fitted" in said
        assert some.run["ranges"][0]["folder"] is None
        with pytest.raises(InputError, match="No record at range 52 m could be fitted"):
            some.at(52.0)
        assert some.words[-1] == "without a record that can be fitted: range 52 m"
        assert list(some.summary()["range"].unique()) == [98.0]

    def test_none_at_any_range_is_refused(self, records):
        lost = records.copy(deep=True)
        lost["flag"].values[:] = 4
        with pytest.raises(InputError, match="No record at any of the ranges can be fitted"):
            fit(lost, SCAN, seed=3)

    def test_it_is_resumed_and_replaced_as_a_whole(self, records, folder, tmp_path):
        place = tmp_path / "out"
        shutil.copytree(folder, place)
        before = {file.relative_to(place): file.read_bytes() for file in place.rglob("*.parquet")}
        said = []
        fit(records, SCAN, seed=3, output=place, resume=True, say=said.append, **QUICK)
        assert said.count("range 52 m: finished by an earlier run") == 1
        (place / "range-98m" / "run.json").unlink()
        fit(records, SCAN, seed=3, output=place, resume=True, **QUICK)
        assert {file.relative_to(place): file.read_bytes() for file in place.rglob("*.parquet")} == before
        write_report(place)
        fit(records, SCAN, seed=4, output=place, overwrite=True, **QUICK)
        assert open_fit(place).settings["fit"]["seed"] == 4
        assert not (place / "report.html").exists()

    def test_it_is_the_same_by_several_workers(self, records, folder, tmp_path):
        said = []
        fit(records, SCAN, seed=3, output=tmp_path / "out", workers=2, say=said.append, **QUICK)
        pd.testing.assert_frame_equal(open_fit(tmp_path / "out").summary(), open_fit(folder).summary())
        assert {line.split(":")[0] for line in said} == {"range 52 m", "range 98 m"}

    def test_a_strangers_folder_in_it_is_never_removed(self, records, folder, tmp_path):
        place = tmp_path / "out"
        shutil.copytree(folder, place)
        series, _ = series_at(DISTANCES[:1], n_records=2)
        other = make_records(series.drop_vars("range"), load_scan(SCAN, focus_distance=52.0))
        fit(other, load_scan(SCAN, focus_distance=52.0), seed=1, output=place / "mine", **QUICK)
        with pytest.raises(InputError, match="mine"):
            fit(records, SCAN, seed=4, output=place, overwrite=True, **QUICK)
        assert open_fit(place / "mine").n_record == 2
        # and not under the name of a range either
        shutil.rmtree(place / "range-52m")
        shutil.move(place / "mine", place / "range-52m")
        with pytest.raises(InputError, match="range-52m"):
            fit(records, SCAN, seed=4, output=place, overwrite=True, **QUICK)
        assert open_fit(place / "range-52m").n_record == 2

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"ranges": []}, "ranges"),
            ({"ranges": [{"range": 52.0, "distance": [52.0], "folder": "range-52m"}]}, "ranges"),
            ({"ranges": [{"range": 52.0, "distance": [52.0] * 6, "folder": "../elsewhere"}]}, "folder"),
            ({"ranges": "all"}, "ranges"),
        ],
    )
    def test_a_damaged_run_is_one_line(self, folder, tmp_path, change, words):

        place = tmp_path / "out"
        shutil.copytree(folder, place)
        run = json.loads((place / "run.json").read_text())
        (place / "run.json").write_text(json.dumps({**run, **change}))
        (place / "fingerprints.jsonl").unlink()
        seal_folder(place)
        with pytest.raises(InputError, match=words):
            open_fit(place).summary()


class TestPictures:
    def test_profiles(self, found):
        figure = brs.plot.profile(found)
        assert isinstance(figure, Figure)
        assert len(figure.axes) == 7
        assert figure.axes[-1].get_xlabel() == "range [m]"
        assert brs.plot.profile(found, record=0).axes[0].get_ylabel() == "TI, σ_u/U [1]"
        with pytest.raises(InputError, match="is of one range, and has no profile"):
            brs.plot.profile(found.at(52.0))
        with pytest.raises(InputError, match="at 2 ranges"):
            brs.plot.stresses(found)

    @pytest.mark.parametrize("share", [0.49, 0.51])
    def test_what_is_the_priors_is_hollow(self, found, monkeypatch, share):
        own = RangedFit.profile
        monkeypatch.setattr(RangedFit, "profile", lambda self, record=None: own(self, record).assign(decided=share))
        figure = brs.plot.profile(found)
        marks = [bars.lines[0] for bars in figure.axes[3].containers if len(bars.lines[0].get_xdata())]
        assert {line.get_markerfacecolor() == "white" for line in marks} == {share < 0.5}
        words = " ".join(text.get_text() for text in figure.legends[0].get_texts())
        assert (PRIORS in words) == (share < 0.5)
        assert "90 % interval, equal-tailed" in words

    def test_the_page_leads_to_those_of_the_ranges(self, folder, tmp_path):
        place = tmp_path / "out"
        shutil.copytree(folder, place)
        page = write_report(place)
        text = page.read_text(encoding="utf-8")
        for name in ("range-52m/report.html", "range-98m/report.html"):
            assert f'href="{name}"' in text
            assert (place / name).is_file()
        data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text).group(1))[
            "profile"
        ]
        assert data["place"] == [52.0, 98.0]
        own, of_all = open_fit(place), data["all"][1]
        rows = own.profile()
        np.testing.assert_allclose(of_all["estimate"], rows[rows["quantity"] == "uu"]["estimate"], rtol=1e-3)
        packed = data["records"]
        steps = np.frombuffer(base64.b64decode(packed["rows"]["values"]), dtype="<i2").astype(float)
        unit = np.frombuffer(base64.b64decode(packed["rows"]["unit"]), dtype="<f4").astype(float)
        values = steps.reshape(len(unit), 7, 2, 3) * unit[:, None, None, None]
        number = next(iter(own.fits.values())).find_record(0)
        one = own.profile(record=number).set_index(["quantity", "range"])
        for place_of, distance in enumerate((52.0, 98.0)):
            for quantity, name in enumerate(("ti", "uu", "vv")):
                expected = one.loc[(name, distance), ["estimate", "low", "high"]].to_numpy(dtype=float)
                np.testing.assert_allclose(values[0, quantity, place_of], expected, atol=2e-5 * values[0].max())
        assert text == write_report(place, overwrite=True).read_text(encoding="utf-8")
        alone = write_report(place, tmp_path / "alone.html").read_text(encoding="utf-8")
        assert 'href="range-52m' not in alone

    def test_each_range_has_its_budget_in_its_page(self, folder, tmp_path):
        place = tmp_path / "out"
        shutil.copytree(folder, place)
        write_report(place, budget=True)
        for name in ("range-52m", "range-98m"):
            assert "Uncertainty budget" in (place / name / "report.html").read_text(encoding="utf-8")
        with pytest.raises(brs.InputError, match="A budget is of a fit at one range, and stands in the page of each"):
            write_report(place, tmp_path / "alone.html", budget=True)


class TestCommands:
    def test_one_range_is_shown(self, folder, tmp_path):
        place = tmp_path / "out"
        shutil.copytree(folder, place)
        result = CliRunner().invoke(commands, ["corner", str(place)])
        assert "take one" in str(result.exception)
        result = CliRunner().invoke(commands, ["boxes", str(place), "-o", str(tmp_path / "boxes")])
        assert "take one" in str(result.exception)
        result = CliRunner().invoke(commands, ["corner", str(place), "--range", "98"])
        assert (result.exit_code, result.output.strip()) == (0, str(place / "range-98m" / "corner-0.png"))
        result = CliRunner().invoke(commands, ["corner", str(place / "range-98m"), "--range", "98"])
        assert "is of one range" in str(result.exception)


def test_spikes_at_one_range_are_told_in_the_headline():
    """A doubt that says what to do is said once, with the number of ranges."""
    series, ranged = series_at(DISTANCES)
    rng = np.random.default_rng(1)
    bad = (series["range"].values == DISTANCES[-1]) & (rng.random(series.sizes["sample"]) < 0.01)
    random = rng.uniform(-30.0, 30.0, series.sizes["sample"])
    records = make_records(series.assign(radial_velocity=series["radial_velocity"].where(~bad, random)), ranged.of_one)
    fitted = fit(records, SCAN, seed=3, draws="none", **QUICK)
    doubtful = fitted.headline().doubtful
    assert f"at 1 of {len(DISTANCES)} ranges, as " in doubtful
    assert doubtful.count("despike='median'") == 1
    assert sum("despike='median'" in line for line in fitted.failures) == 1
