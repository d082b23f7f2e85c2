"""What a fit hands out is the asker's, and what it was given is its own: nobody changes a fit that is done."""

import copy
import pickle
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from fit_scene import OPTIONS, make_records

import bayes_rs as brs
from bayes_rs.cli.group import commands


@pytest.fixture(scope="module")
def records():
    return make_records(4)


@pytest.fixture(scope="module")
def in_memory(records):
    return brs.fit(records, "6-beam", **OPTIONS)


@pytest.fixture(scope="module")
def folder(records, tmp_path_factory):
    place = tmp_path_factory.mktemp("own") / "fit"
    brs.fit(records, "6-beam", output=place, **OPTIONS)
    return place


@pytest.fixture(params=["memory", "folder"])
def fit(request, in_memory, folder):
    return copy.deepcopy(in_memory) if request.param == "memory" else brs.open_fit(folder)


def said(fit):
    """All that a fit says of its records: texts, and pictures of them."""
    tables = [fit.summary(), fit.summary(derived=["ti"]), fit.table("posterior"), fit.directions()]
    return [str(fit.headline()), repr(fit), fit._repr_html_(), *fit.words, *(table.to_string() for table in tables)]


def spoil(table):
    """Change a table in every way that a user does: single values, the order of rows, their number, and columns."""
    for name in table:
        if pd.api.types.is_numeric_dtype(table[name]):
            table.loc[table.index[0], name] = table[name].iloc[-1]
            table[name] = table[name].to_numpy()[::-1]
    table.loc[len(table)] = table.iloc[0]
    table["of_mine"] = 1.0
    table.pop(table.columns[0])


class TestTables:
    @pytest.mark.parametrize(
        "ask",
        [
            lambda fit: fit.summary(),
            lambda fit: fit.summary(columns=["record", "stress", "median"]),
            lambda fit: fit.summary(records=[0, 1]),
            lambda fit: fit.summary(records=slice(None)),
            lambda fit: fit.summary(derived=["ti"]),
            lambda fit: fit.table("summary"),
            lambda fit: fit.table("posterior"),
            lambda fit: fit.table("draws"),
            lambda fit: fit.directions(),
        ],
    )
    def test_a_table_is_the_askers_who_may_change_it(self, fit, ask):
        before = said(fit)
        spoil(ask(fit))
        assert said(fit) == before

    def test_what_a_fit_reads_itself_is_not_copied(self, in_memory, monkeypatch):
        fit = copy.deepcopy(in_memory)
        one, other = (fit.source.read("summary") for _ in range(2))
        assert one is other
        monkeypatch.setattr(pd.DataFrame, "copy", lambda *_, **__: pytest.fail("a whole table was copied"))
        fit.of_stresses("median")
        fit.draws(0)
        fit.covariance()


class TestRecords:
    def test_what_is_done_to_the_callers_records_leaves_the_fit_as_it_was(self, records):
        own = records.copy(deep=True)
        fit = brs.fit(own, "6-beam", **OPTIONS)
        before, of_fit = said(fit), fit.records.copy(deep=True)
        own["wind_speed"] *= 1.1
        own["variance"].values[:] = 0.0
        own["flag"].values[:] = 1
        own.attrs["duration"] = 1.0
        assert said(fit) == before
        assert fit.records.identical(of_fit)

    def test_what_the_fit_hands_out_changes_neither_it_nor_the_callers(self, fit, records):
        before, of_caller = said(fit), records.copy(deep=True)
        handed = fit.records
        handed["wind_speed"] = handed["wind_speed"] * 2.0
        handed.attrs["duration"] = 1.0
        del handed["variance"]
        with pytest.raises(ValueError, match="read-only"):
            fit.records["variance"].values[:] = 0.0
        own = fit.records.copy(deep=True)
        own["variance"].values[:] = 0.0
        assert said(fit) == before
        assert records.identical(of_caller)

    def test_records_that_wait_in_a_file_are_read_when_they_are_fitted(self, records, tmp_path):
        file = tmp_path / "records.nc"
        records.to_netcdf(file)
        with xr.open_dataset(file) as lazy:
            fit = brs.fit(lazy, "6-beam", **OPTIONS)
        np.testing.assert_array_equal(fit.records["variance"].values, records["variance"].values)

    def test_arrays_and_groups_that_are_kept_cannot_be_written(self, fit):
        before = said(fit)
        for values in (fit.flag, fit.time, fit.prior_draws, fit["posterior/stress"].values):
            with pytest.raises(ValueError, match="read-only"):
                values[:] = values[-1]
        group = fit["observed_data"]
        group["variance"] = group["variance"] * 0.0
        assert float(fit["observed_data"]["variance"].max()) > 0.0
        fit.draws(0)[:] = 0.0
        assert fit.draws(0).max() > 0.0
        assert said(fit) == before


class TestPlace:
    @pytest.mark.parametrize("how", ["fitted", "opened", "pickled"])
    def test_a_fit_is_found_from_another_directory(self, how, records, folder, tmp_path, monkeypatch):
        shutil.copytree(folder, tmp_path / "there")
        monkeypatch.chdir(tmp_path)
        fit = brs.fit(records, "6-beam", output="new", **OPTIONS) if how == "fitted" else brs.open_fit("there")
        packed = pickle.dumps(fit)
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(tmp_path / "elsewhere")
        fit = pickle.loads(packed) if how == "pickled" else fit  # noqa: S301 - our own
        assert said(fit)[:2] == [str(fit.headline()), repr(fit)]
        assert fit.summary().equals(brs.open_fit(folder).summary())
        assert fit.draws(0).shape == brs.open_fit(folder).draws(0).shape
        assert fit.records.sizes["record"] == 4
        assert brs.write_report(fit).parent == tmp_path / ("new" if how == "fitted" else "there")

    def test_what_is_written_is_told_as_the_folder_was_named(self, folder, tmp_path, monkeypatch):
        shutil.copytree(folder, tmp_path / "there")
        monkeypatch.chdir(tmp_path)
        assert brs.write_report("there") == Path("there/report.html")
        for words, file in ((["corner", "there"], "corner-0.png"), (["report", "there", "--overwrite"], "report.html")):
            done = CliRunner().invoke(commands, words)
            assert done.exit_code == 0
            assert done.output.strip().splitlines()[-1] == str(Path("there") / file)

    def test_a_fit_of_the_same_name_in_another_directory_is_another(self, folder, tmp_path, monkeypatch):
        (tmp_path / "a").mkdir()
        shutil.copytree(folder, tmp_path / "a" / "out")
        monkeypatch.chdir(tmp_path / "a")
        fit = brs.open_fit("out")
        other = make_records(4)
        other["variance"] *= 2.0
        (tmp_path / "b").mkdir()
        monkeypatch.chdir(tmp_path / "b")
        brs.fit(other, "6-beam", output="out", **OPTIONS)
        np.testing.assert_array_equal(fit.records["variance"], make_records(4)["variance"])

    @pytest.mark.parametrize("read", [False, True])
    def test_a_fit_whose_folder_is_gone_still_shows_itself(self, read, folder, tmp_path):
        place = tmp_path / "gone"
        shutil.copytree(folder, place)
        fit = brs.open_fit(place)
        if read:
            repr(fit)  # its flags are known
        shutil.rmtree(place)
        words = f"Folder {str(place)!r} was moved or removed after it was opened: open it where it is now."
        assert repr(fit) == f"<Fit that cannot be read, scan 6-beam, in {str(place)!r}: {words}>"
        assert "was moved or removed after it was opened" in fit._repr_html_()
        with pytest.raises(brs.InputError, match="was moved or removed after it was opened"):
            fit.summary()

    def test_a_damaged_fit_says_so(self, folder, tmp_path):
        place = tmp_path / "damaged"
        shutil.copytree(folder, place)
        fit = brs.open_fit(place)
        for file in place.rglob("*.parquet"):
            file.unlink()
        assert "is missing: resume the fit" in repr(fit)
        assert "\n" not in repr(fit)
        assert "is missing: resume the fit" in fit._repr_html_()
