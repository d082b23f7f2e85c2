"""Fleets: the records of many turbines in one fit, long fits in long parts, and what is read of them at a time."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from fit_scene import OPTIONS, SCAN, fit_to, make_records
from report_scene import table_folder

from bayes_rs import InputError, demo_file, fit, open_fit
from bayes_rs.alarms.beam_check import BeamCheck
from bayes_rs.alarms.words import CheckWords
from bayes_rs.campaign import sampling
from bayes_rs.cli.data_commands import records as records_command
from bayes_rs.fits import campaign_job, folder_tables, plan
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.folder_tables import FolderTables
from bayes_rs.fits.people_table import PeopleRows, write_people_table
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.plot import stresses_plot
from bayes_rs.records.layout import with_turbine
from bayes_rs.records.record_files import open_record_files
from bayes_rs.report.page import render
from bayes_rs.report.report_data import report_data
from bayes_rs.turbulence.interpolation import nearest_semidefinite

N_EACH, TURBINES = 6, ("T1", "T2", "T3")
PLAIN = {**OPTIONS, "campaign": "off"}


def make_turbines():
    """The records of three turbines, which have the same starts."""
    records = make_records(N_EACH * len(TURBINES))
    start = records["time"].values[:N_EACH]
    return [
        with_turbine(
            records.isel(record=slice(place * N_EACH, (place + 1) * N_EACH)).assign_coords(time=("record", start)), name
        )
        for place, name in enumerate(TURBINES)
    ]


@pytest.fixture(scope="module")
def turbines():
    return make_turbines()


@pytest.fixture(scope="module")
def files(turbines, tmp_path_factory):
    place = tmp_path_factory.mktemp("fleet")
    found = []
    for name, records in zip(TURBINES, turbines, strict=True):
        found.append(place / f"{name}.nc")
        records.to_netcdf(found[-1], engine="h5netcdf")
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder of 23 records in parts of five."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "PART_RECORDS", 5)
        return open_fit(table_folder(tmp_path_factory.mktemp("fit") / "out"))


def same(one, other):
    pd.testing.assert_frame_equal(one, other, check_exact=True)


class TestTurbines:
    def test_files_of_turbines_are_joined_though_their_starts_are_the_same(self, files):
        found = open_record_files(files, SCAN)
        assert found["turbine"].values.tolist() == np.repeat(TURBINES, N_EACH).tolist()
        assert len(np.unique(found["time"].values)) == N_EACH

    def test_folders_and_patterns_of_records_are_opened_as_their_files_are(self, files, tmp_path):
        whole = open_record_files(sorted(files), SCAN)
        for named in (files[0].parent, files[0].parent / "*.nc"):
            xr.testing.assert_identical(open_record_files([named], SCAN), whole)
        (tmp_path / "a.csv").write_text("time,beam,radial_velocity\n")
        (tmp_path / "b.nc").write_bytes(files[0].read_bytes())
        for named in (tmp_path, tmp_path / "none" / "*.nc", tmp_path / "missing.nc"):  # not all are records, and none
            assert open_record_files([named], SCAN) is None

    def test_a_turbine_has_the_numbers_that_it_has_alone(self, files, turbines):
        fleet = fit(open_record_files(files, SCAN), SCAN, **PLAIN)
        alone = fit(turbines[1], SCAN, **PLAIN)
        rows = fleet.summary(records=fleet.records["turbine"] == "T2").drop(columns="record")
        # whether beams disagree is asked of all records together; the draws are not
        same(rows.drop(columns="flag"), alone.summary().drop(columns=["record", "flag"]))

    def test_turbines_do_not_share_random_numbers(self, turbines):
        one, other = (fit(with_turbine(turbines[0], name), SCAN, **PLAIN).summary() for name in ("A", "B"))
        assert not np.any(one["mean"].to_numpy() == other["mean"].to_numpy())

    def test_the_same_turbine_twice_is_refused(self, files):
        with pytest.raises(
            InputError, match=r"^6 records start at the same time as another, the first at .*overlap\.$"
        ):
            open_record_files([files[0], files[0]], SCAN)
        records = open_record_files([files[0]], SCAN)
        with pytest.raises(InputError, match=r"^6 records start at the same time as another, .*give every record once"):
            fit(xr.concat([records, records], "record"), SCAN, **PLAIN)

    def test_records_of_which_some_have_no_start_are_refused(self, turbines, tmp_path):
        records = turbines[0].isel(record=slice(4))
        time = records["time"].values.copy()
        time[[1, 3]] = np.datetime64("NaT")
        broken = records.assign_coords(time=("record", time))
        words = (
            r"^Invalid records: 2 of 4 have no start \(time NaT\), the first is record 1: give each its start, leave"
        )
        with pytest.raises(InputError, match=words):
            fit(broken, SCAN, **PLAIN)
        broken.to_netcdf(tmp_path / "broken.nc")
        with pytest.raises(InputError, match=words):
            open_record_files([tmp_path / "broken.nc"], SCAN)
        assert fit(records.drop_vars("time"), SCAN, **PLAIN).n_fitted == 4

    def test_a_record_twice_in_one_file_is_refused(self, turbines, tmp_path):
        turbines[0].isel(record=[0, 1, 1]).to_netcdf(tmp_path / "twice.nc")
        with pytest.raises(
            InputError, match=r"^1 records start at the same time as another, .*give every record once\.$"
        ):
            open_record_files([tmp_path / "twice.nc"], SCAN)

    def test_records_without_a_name_are_told_how_to_get_one(self, turbines, tmp_path):
        for name in ("a.nc", "b.nc"):
            turbines[0].drop_vars("turbine").to_netcdf(tmp_path / name, engine="h5netcdf")
        with pytest.raises(InputError, match=r"overlap; records of several turbines need its name in each \(--turbine"):
            open_record_files([tmp_path / "a.nc", tmp_path / "b.nc"], SCAN)

    @pytest.mark.parametrize("order", [(0, 1), (1, 0)])
    def test_names_in_some_files_alone_are_refused(self, files, turbines, tmp_path, order):
        nameless = tmp_path / "nameless.nc"
        turbines[1].drop_vars("turbine").to_netcdf(nameless, engine="h5netcdf")
        both = [files[0], nameless]
        with pytest.raises(
            InputError, match=r"T1\.nc' say their turbine and those in .*nameless\.nc' do not: make the"
        ):
            open_record_files([both[place] for place in order], SCAN)

    def test_a_name_that_is_no_text_is_refused(self, turbines):
        bad = turbines[0].assign(turbine=("record", np.arange(float(N_EACH))))
        with pytest.raises(InputError, match="turbine holds numbers, and must hold texts"):
            fit(bad, SCAN, **PLAIN)

    def test_a_start_of_several_records_does_not_name_one(self, files):
        fleet = fit(open_record_files(files, SCAN), SCAN, **PLAIN)
        start = str(fleet.time[2])[:19]
        with pytest.raises(InputError, match=rf"^3 records start at {start}, as those of several turbines do: give a"):
            fleet.find_record(start)

    def test_the_command_keeps_the_name(self, tmp_path):
        words = [str(demo_file("6-beam")), "--scan", "6-beam", "--turbine", "T07", "-o", str(tmp_path / "t07.nc")]
        done = CliRunner().invoke(records_command, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        with xr.open_dataset(tmp_path / "t07.nc", engine="h5netcdf") as found:
            assert set(found["turbine"].values.tolist()) == {"T07"}

    @pytest.mark.parametrize("name", ["", "  ", "T\n7", "T\udc80"])
    def test_the_command_refuses_a_name_that_cannot_be_shown(self, tmp_path, name):
        words = [str(demo_file("6-beam")), "--scan", "6-beam", "--turbine", name, "-o", str(tmp_path / "t07.nc")]
        done = CliRunner().invoke(records_command, words)
        assert str(done.exception).startswith(f"Invalid turbine {name!r}: it must have letters or digits")
        assert not (tmp_path / "t07.nc").exists()

    @pytest.mark.parametrize("value", [float("nan"), 7])
    def test_a_name_that_is_missing_is_named(self, turbines, value):
        bad = turbines[0].assign(turbine=("record", np.array(["T1"] * (N_EACH - 1) + [value], dtype=object)))
        with pytest.raises(InputError, match=f"turbine holds {value}, and must hold texts"):
            fit(bad, SCAN, **PLAIN)

    def test_the_report_has_a_row_for_each(self, files):
        fleet = fit(open_record_files(files, SCAN), SCAN, **PLAIN)
        page = render(report_data(fleet))
        assert 'id="turbines"' in page
        for name in TURBINES:
            assert f'<th scope="row">{name}</th><td class="number">6</td>' in page or f">{name}</th>" in page


class TestMonths:
    """A part that holds the end of one turbine and the start of the next has its later months first."""

    @pytest.fixture
    def months(self, turbines, tmp_path, monkeypatch):
        monkeypatch.setattr(plan, "PART_RECORDS", 5)
        few = partial(campaign_job.sample_campaign, target_ess=10, most_sweeps=20)  # what is tested is their order
        monkeypatch.setattr(campaign_job, "sample_campaign", few)
        monkeypatch.setattr(sampling, "_BURN_IN", (10, 10))
        start = np.datetime64("2020-01-31T23:30", "ns") + np.arange(N_EACH) * np.timedelta64(600, "s")
        moved = [records.assign_coords(time=("record", start)) for records in turbines]
        fleet = xr.concat(moved, dim="record", data_vars="minimal", coords="minimal", compat="override")
        options = {**PLAIN, "draws": "float64", "campaign": "on"}
        return fit(fleet, SCAN, **options), fit_to(fleet, SCAN, tmp_path / "out", **options)

    def test_tables_are_in_the_order_of_the_records(self, months):
        memory, folder = months
        names = [file.parent.name for file in sorted((Path(folder.place) / "summary").rglob("*-000001.parquet"))]
        assert names == ["month=2020-01", "month=2020-02"]
        for name in ("summary", "posterior", "draws", "predicted", "campaign_summary", "campaign"):
            same(folder.table(name), memory.table(name))
        for name, values in memory.of_stresses("mean", "low").items():
            np.testing.assert_array_equal(folder.of_stresses(name)[name], values)
        np.testing.assert_array_equal(folder.covariance(), memory.covariance())
        np.testing.assert_array_equal(folder.draws(7), memory.draws(7))
        same(folder.summary(records=[4, 6, 7]), memory.summary(records=[4, 6, 7]))


class TestLongFits:
    def test_long_parts_hold_the_numbers_of_short_ones(self, tmp_path, monkeypatch):
        monkeypatch.setattr(plan, "PART_RECORDS", 3)
        short = fit_to(make_records(), SCAN, tmp_path / "short", **PLAIN)
        monkeypatch.setattr(plan, "LONG_FIT", 20)
        long = fit_to(make_records(), SCAN, tmp_path / "long", workers=2, **PLAIN)
        assert (short.run["part_records"], long.run["part_records"]) == (3, 24)
        for name in ("summary", "posterior"):
            same(long.table(name), short.table(name))
        count = [len(list((tmp_path / name / "summary").rglob("*.parquet"))) for name in ("short", "long")]
        assert count == [8, 1]

    def test_parts_with_draws_stay_short(self, tmp_path, monkeypatch):
        monkeypatch.setattr(plan, "PART_RECORDS", 3)
        monkeypatch.setattr(plan, "LONG_FIT", 4)
        found = fit_to(make_records(6), SCAN, tmp_path / "out", **{**PLAIN, "draws": "float32"})
        assert found.run["part_records"] == 3


class TestSelection:
    @pytest.mark.parametrize(
        ("records", "expected"),
        [
            (3, [3]),
            ([7, 2, 2], [2, 7]),
            (np.array([22]), [22]),
            (slice(4, 11), range(4, 11)),
            (slice(None, None, 10), [0, 10, 20]),
            (slice(-2, None), [21, 22]),
            (np.arange(23) % 6 == 1, [1, 7, 13, 19]),
            ([], []),
        ],
    )
    def test_the_rows_are_those_of_the_whole(self, whole, records, expected):
        every = whole.summary()
        wanted = every[every["record"].isin(list(expected))].reset_index(drop=True)
        found = whole.summary(records=records)
        same(found, wanted)
        columns = ["stress", "median", "record"]
        same(whole.summary(records=records, columns=columns), wanted[columns])

    def test_times_are_a_slice_without_its_end(self, whole):
        first, last = (str(whole.time[place])[:19] for place in (3, 8))
        same(whole.summary(records=slice(first, last)), whole.summary(records=slice(3, 8)))
        same(whole.summary(records=slice(None, last)), whole.summary(records=slice(0, 8)))
        same(whole.summary(records=slice(first, None)), whole.summary(records=slice(3, None)))

    def test_in_memory_it_is_the_same(self, whole):
        found = fit(make_records(), SCAN, **OPTIONS)
        for records in (4, slice(2, 9), np.arange(23) > 20):
            same(found.summary(records=records), whole.summary(records=records))

    def test_of_the_draws_it_is_the_same(self):
        found = fit(make_records(6), SCAN, **{**PLAIN, "draws": "float64"})
        every = found.summary(prob=0.5)
        columns = ["record", "low"]
        wanted = every[every["record"].isin([1, 4])][columns].reset_index(drop=True)
        same(found.summary(prob=0.5, records=[1, 4], columns=columns), wanted)

    def test_only_the_parts_of_the_records_are_read(self, whole, monkeypatch):
        read = []
        plain = folder_tables.read_table
        monkeypatch.setattr(
            folder_tables,
            "read_table",
            lambda folder, names, layout: read.extend(names) or plain(folder, names, layout),
        )
        whole.summary(records=[6, 8])
        assert [name.rsplit("/", 1)[-1] for name in read] == ["part-000001.parquet"]

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"records": 23}, r"^No record 23: there are 23, numbered from 0\.$"),
            ({"records": [-1]}, r"^No record -1: there are 23"),
            ({"records": [1.5]}, r"^Invalid records \[1\.5\]: give numbers, a slice of numbers or of ISO times"),
            ({"records": [True, False]}, r"^Invalid records of shape \(2,\): truth values must be one for each of 23"),
            ({"records": slice("2020", None)}, r"^Invalid time '2020' of records: give an ISO time such as"),
            ({"records": slice("2020-01-01", None, 2)}, r"^Invalid records with step 2: a slice of times has none"),
            ({"records": slice(1.0, None)}, r"^Invalid records slice\(1\.0, None, None\): give a slice of numbers"),
            (
                {"records": slice(None, None, 0)},
                r"^Invalid records slice\(None, None, 0\): the step of a slice must not",
            ),
            ({"columns": ["mode"]}, r"^Invalid column 'mode' of a summary: it has record, time, stress, mean"),
        ],
    )
    def test_messages(self, whole, options, message):
        with pytest.raises(InputError, match=message):
            whole.summary(**options)


class TestPieces:
    @pytest.fixture
    def pieces(self, monkeypatch):
        """How many records each read of a table holds."""
        monkeypatch.setattr(folder_tables, "_AT_ONCE", 10)
        plain, held = FolderTables.read, []

        def reading(self, dataset, columns=None, records=None):
            found = plain(self, dataset, columns, records)
            held.append((dataset, len(found) // (6 if dataset == "summary" else 1)))
            return found

        monkeypatch.setattr(FolderTables, "read", reading)
        return held

    @pytest.mark.parametrize(
        "made",
        [
            lambda fit: fit.words,
            Fit.headline,
            Fit.covariance,
            stresses_plot.stresses,
            report_data,
            lambda fit: write_people_table([PeopleRows(fit, fit.records, {})], Path(os.devnull)),
        ],
        ids=["words", "headline", "covariance", "picture", "report", "table for people"],
    )
    def test_no_more_records_are_read_at_a_time(self, whole, pieces, made):
        fresh = open_fit(whole.place)
        assert fresh.flag.size + fresh.time.size == 46  # these are two numbers a record
        pieces.clear()
        made(fresh)
        assert pieces
        assert max(count for _, count in pieces) == 10

    @pytest.mark.usefixtures("pieces")
    def test_the_columns_are_those_of_the_tables(self, whole):
        summary, posterior = whole.table("summary"), whole.table("posterior")
        for name, values in whole.of_stresses("mean", "high").items():
            np.testing.assert_array_equal(values, summary[name].to_numpy().reshape(-1, len(STRESSES)))
        for name, values in whole.of_records("pareto_k", "misfit").items():
            np.testing.assert_array_equal(values, posterior[name].to_numpy())

    def test_derived_quantities_are_left_out_of_the_stresses(self, tmp_path):
        found = fit_to(make_records(4), SCAN, tmp_path / "out", **{**PLAIN, "derived": ("ti", "tke")})
        table = found.summary()
        table = table[table["stress"].isin(STRESSES)]
        np.testing.assert_array_equal(found.of_stresses("sd")["sd"].ravel(), table["sd"].to_numpy())


def test_words_of_beams_are_made_for_those_that_disagree(monkeypatch):
    """Each costs a look at all records: a word for each record is what makes a million of them quadratic."""
    asked = []
    monkeypatch.setattr(CheckWords, "of_record", lambda _, index: asked.append(index) or f"fault of {index}")
    check = object.__new__(BeamCheck)
    for name, value in {"misfit": np.zeros(1000), "disagree": np.arange(1000) % 250 == 7}.items():
        check.__dict__[name] = value
    words = CheckWords(check, np.arange(6), 61.0).records
    assert asked == [7, 257, 507, 757]
    assert words[257] == "fault of 257"
    assert set(np.delete(words, asked)) == {""}


def test_the_nearest_matrices_are_those_one_by_one():
    random = np.random.default_rng(3).normal(size=(40, 5, 5))
    matrices = random @ random.swapaxes(-1, -2) - 0.5 * np.eye(5)
    nearest, below = nearest_semidefinite(matrices)
    assert 0 < np.count_nonzero(below) < 40
    for index, matrix in enumerate(matrices):
        one, one_below = nearest_semidefinite(matrix[None])
        np.testing.assert_array_equal(nearest[index], one[0])
        assert below[index] == one_below[0]
    assert nearest_semidefinite(np.empty((0, 3, 3)))[0].shape == (0, 3, 3)


def many(data, times):
    """What the report shows of so many times the records of a fit, at the starts that follow."""
    n = len(data.record)
    fill = np.arange(n * times) % n
    start = data.time[0] + np.arange(n * times) * np.timedelta64(600, "s")
    records = data.records.isel(record=fill).assign_coords(time=("record", start))
    return replace(
        data,
        records=records,
        record=np.arange(n * times),
        time=start,
        flag=data.flag[fill],
        wind_speed=data.wind_speed[fill],
        numbers={name: values[fill] for name, values in data.numbers.items()},
        derived={one: {name: values[fill] for name, values in of.items()} for one, of in data.derived.items()},
        per_record={name: values[fill] for name, values in data.per_record.items()},
        shape=replace(data.shape, middle=data.shape.middle[fill]),
        covariance=lambda rows: data.covariance()[rows % n],
    )


def test_the_report_of_many_records_does_not_grow(whole):
    """A hundred thousand made-up records, and twice as many: bins, and evenly spaced records to pick."""
    data = report_data(whole)
    sizes = [len(render(many(data, times))) for times in (4350, 8700)]
    assert sizes[1] < 1.05 * sizes[0] < 16e6


def test_the_picture_of_many_records_has_medians(whole, monkeypatch):
    monkeypatch.setattr(stresses_plot, "MOST_POINTS", 6)
    figure = stresses_plot.stresses(whole)
    line = figure.axes[0].get_lines()[0].get_ydata()[::2]  # in between are the places halfway
    median = whole.of_stresses("median")["median"][:, 0]
    expected = [np.nanmedian(some) if np.isfinite(some).any() else np.nan for some in np.split(median, range(4, 23, 4))]
    np.testing.assert_array_equal(line, expected)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any("medians over 4 records" in label for label in labels)
