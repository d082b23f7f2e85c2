"""The report: its numbers are those of the fit, and no text of a file becomes part of the page."""

import base64
import json
import re
import shutil
from html import escape
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from bayes_rs.report.folder import NUMBERS, read_folder
from campaign_scene import make_records
from click.testing import CliRunner
from report_scene import EVIL, demo_records, evil_folder, result_folder, table_folder

from bayes_rs import STRESSES, InputError, open_result, read_summary, write_report
from bayes_rs.cli.report_command import report
from bayes_rs.fits.derived import lumley_coordinates
from bayes_rs.fits.flags import FLAGS
from bayes_rs.report import figures, page
from bayes_rs.report.availability import make_availability
from bayes_rs.report.packing import MISSING, pack, pack_rows, pack_steps, plain
from bayes_rs.report.series import MOST_BINS, make_series
from bayes_rs.report.tables import flat, interval, number, table
from bayes_rs.report.words import FLAG_MEANINGS
from bayes_rs.result_folder import seal_folder

pytestmark = pytest.mark.slow
HALF_STEP = 0.5 / 32767 * (1.0 + 1e-6)  # of the largest number in a row; and the rounding of its unit to float32


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    return result_folder(tmp_path_factory.mktemp("full") / "out")


@pytest.fixture(scope="module")
def full_page(full):
    return page_of(full)


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    return table_folder(tmp_path_factory.mktemp("tables") / "out")


@pytest.fixture(scope="module")
def with_draws(tmp_path_factory):
    return table_folder(tmp_path_factory.mktemp("draws") / "out", draws="float64")


@pytest.fixture(scope="module")
def year(tables, tmp_path_factory):
    """The tables of a year of ten minutes, made of those of 23 records."""
    folder = tmp_path_factory.mktemp("year") / "out"
    n_record, few = 52_560, 23
    start = np.datetime64("2020-01-01", "ns") + np.arange(n_record) * np.timedelta64(600, "s")
    from_record = np.arange(n_record) % few
    rows = pd.concat([pd.read_parquet(file) for file in sorted((tables / "posterior").glob("**/*.parquet"))])
    rows = rows.sort_values("record").iloc[from_record].assign(record=np.arange(n_record), time=start)
    summaries = read_summary(tables)
    places = (6 * from_record[:, None] + np.arange(6)).ravel()
    long = summaries.iloc[places].assign(record=np.repeat(np.arange(n_record), 6), time=np.repeat(start, 6))
    for name, content in (("posterior", rows), ("summary", long)):
        (folder / name).mkdir(parents=True)
        content.to_parquet(folder / name / "part-000000.parquet", index=False)
    (folder / "run.json").write_text((tables / "run.json").read_text())
    seal_folder(folder)
    return folder


def data_of(text):
    """Return the JSON in a page."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


def page_of(folder, **options):
    file = write_report(folder, folder.parent / "page.html", overwrite=True, **options)
    return file.read_text(encoding="utf-8")


def unpack(packed, shape):
    steps = np.frombuffer(base64.b64decode(packed["values"]), dtype="<i2").astype(float)
    unit = np.frombuffer(base64.b64decode(packed["unit"]), dtype="<f4").astype(float)
    values = np.where(steps == MISSING, np.nan, steps).reshape(len(unit), -1) * unit[:, None]
    return values.reshape(shape)


class Elements(HTMLParser):
    """All elements of a page, and what is not closed."""

    VOID = frozenset({"meta", "link", "input", "br", "img"})

    def __init__(self, text):
        super().__init__()
        self.found, self.open, self.ids, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if dict(attrs).get("id"):
            self.ids.append(dict(attrs)["id"])
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


class TestNumbers:
    def test_a_full_result_gives_the_numbers_of_its_summary(self, full):
        found = read_folder(full)
        expected = open_fit(full).summary(prob=0.9, derived=("ti",))
        for name in NUMBERS:
            rows = expected[expected["stress"].isin(STRESSES)][name].to_numpy().reshape(-1, 6)
            np.testing.assert_array_equal(found.numbers[name], rows)
        ti = expected[expected["stress"] == "ti"]
        np.testing.assert_array_equal(found.derived["ti"]["low"], ti["hdi_low"])
        assert found.fitted.tolist() == [True, True, False, True, True, True]
        assert found.flag.tolist() == [0, 0, FLAGS["no_usable_beam"], 0, FLAGS["beam_left_out"], 0]

    def test_a_full_result_gives_the_numbers_in_the_csv_file(self, full):
        """Independent of `summary`: what the user sees in the folder. The file holds all digits."""
        written = pd.read_csv(full / "summary.csv")
        np.testing.assert_allclose(
            read_folder(full).numbers["median"].ravel(), written[written["stress"].isin(STRESSES)]["median"], rtol=1e-12
        )

    def test_another_probability_is_computed_from_the_draws(self, full):
        half = read_folder(full, prob=0.5)
        expected = open_fit(full).summary(prob=0.5)
        np.testing.assert_array_equal(half.numbers["hdi_low"].ravel(), expected["hdi_low"])
        assert "Intervals hold 50 % probability" in page_of(full, prob=0.5)

    def test_tables_give_the_numbers_of_their_summary(self, tables):
        found, expected = read_folder(tables), read_summary(tables)
        for name in NUMBERS:
            np.testing.assert_array_equal(found.numbers[name].ravel(), expected[name])
        assert int(found.fitted.sum()) == 16

    def test_covariances_are_those_of_the_draws(self, full, with_draws):
        flat_draws = group(open_result(full), "posterior")["stress"].isel(record=1).values.reshape(-1, 6)
        np.testing.assert_allclose(
            read_folder(full).covariance[1], np.cov(flat_draws, rowvar=False), rtol=1e-12, atol=1e-15
        )
        found = read_folder(with_draws)
        every = found.draws(10**6)[3]
        every = every[np.isfinite(every).all(axis=1)]
        np.testing.assert_allclose(found.covariance[3], np.cov(every, rowvar=False), rtol=1e-9, atol=1e-12)

    def test_the_page_holds_the_numbers_of_each_record(self, full, full_page):
        found, data = read_folder(full), data_of(full_page)
        numbers = unpack(data["records"]["numbers"], (6, 5, 6))
        columns = ("median", "hdi_low", "hdi_high", "mean", "sd")
        largest = np.max([np.abs(found.numbers[name]).max(axis=1) for name in columns], axis=0)
        for place, name in enumerate(columns):
            error = np.abs(numbers[:, place] - found.numbers[name])
            bound = HALF_STEP * largest[:, None]
            assert np.all((error <= bound) | np.isnan(found.numbers[name]))
        assert np.isnan(numbers[2]).all()  # not fitted

    def test_the_draws_in_the_page_are_draws_of_the_posterior(self, full, full_page):
        data = data_of(full_page)
        n = data["records"]["draws"]["n"]
        some = unpack(data["records"]["draws"], (6, n, 6))[1]
        every = group(open_result(full), "posterior")["stress"].isel(record=1)
        every = every.transpose("chain", "draw", "component").values.reshape(-1, 6)
        distance = np.abs(some[:, None] - every[None]).max(axis=-1).min(axis=1)
        assert n == min(figures.MOST_DRAWS, len(every))
        assert np.all(distance <= HALF_STEP * np.abs(some).max() * (1.0 + 1e-3))

    def test_draws_of_tables_are_those_of_their_records(self, with_draws):
        found = read_folder(with_draws)
        draws = found.draws(400)
        assert np.isnan(draws[~found.fitted]).all()
        # means of 400 of 2048 draws: five standard errors of independent draws
        error = np.abs(draws.mean(axis=1) - found.numbers["mean"])[found.fitted]
        assert np.all(error <= 5.0 * found.numbers["sd"][found.fitted] / np.sqrt(400))

    def test_draws_of_a_zarr_store_are_those_of_the_tables(self, with_draws, tmp_path):
        found = read_folder(table_folder(tmp_path / "out", draws="zarr"))
        np.testing.assert_allclose(found.draws(100), read_folder(with_draws).draws(100), rtol=1e-6)  # float32

    def test_turbulence_intensity_of_tables_follows_from_uu(self, tables, tmp_path):
        assert figures.intensity_data(read_folder(tables)) is None  # no records.nc, so no wind speed
        shutil.copytree(tables, tmp_path / "out")
        records = make_records()
        records["wind_speed"].values[3] = 0.0
        records.to_netcdf(tmp_path / "out" / "records.nc", engine="h5netcdf")
        found = read_folder(tmp_path / "out")
        np.testing.assert_allclose(
            found.derived["ti"]["high"][0], np.sqrt(found.numbers["hdi_high"][0, 0]) / 10.0, rtol=1e-12
        )
        assert np.isnan(found.derived["ti"]["median"][[2, 3]]).all()  # no wind speed, and none to divide by
        data = figures.intensity_data(found)
        assert data["bin"] == [10]
        assert data["count"] == [15]
        assert data["points"]["median"][0] == pytest.approx(found.derived["ti"]["median"][0], rel=1e-3)

    def test_the_shape_coordinates_are_those_of_the_means(self, full, full_page):
        found, data = read_folder(full), data_of(full_page)
        xi, eta = lumley_coordinates(found.numbers["mean"][found.fitted])
        np.testing.assert_allclose(data["shape"]["xi"], xi, rtol=1e-3)
        np.testing.assert_allclose(data["shape"]["eta"], eta, rtol=1e-3)
        assert data["shape"]["record"] == [0, 1, 3, 4, 5]


class TestSeries:
    def test_few_records_keep_their_own_numbers(self, full):
        found = read_folder(full)
        series = make_series(found)
        assert not series.binned
        assert series.timed
        assert series.width == 600_000.0
        np.testing.assert_array_equal(series.low, found.numbers["hdi_low"])
        assert series.n_failed.tolist() == [0, 0, 1, 0, 0, 0]
        assert series.n_remarked.tolist() == [0, 0, 0, 0, 1, 0]

    def test_a_year_is_shown_in_bins_of_six_hours(self, year):
        found = read_folder(year)
        series = make_series(found)
        assert series.binned
        assert series.width == 6 * 3.6e6
        assert series.count.tolist() == [36] * 1460
        assert len(series.start) <= MOST_BINS

    def test_bins_hold_medians_of_their_records(self, year):
        found = read_folder(year)
        series = make_series(found)
        rows = np.arange(36 * 100, 36 * 101)
        rows = rows[found.fitted[rows]]
        for ours, theirs in (("median", "median"), ("low", "hdi_low"), ("high", "hdi_high")):
            expected = np.median(found.numbers[theirs][rows], axis=0)
            np.testing.assert_allclose(getattr(series, ours)[100], expected, rtol=1e-12)
        for ours, share in (("spread_low", 0.05), ("spread_high", 0.95)):
            expected = np.quantile(found.numbers["median"][rows], share, axis=0)
            np.testing.assert_allclose(getattr(series, ours)[100], expected, rtol=1e-12)
        assert series.n_failed[100] == 36 - len(rows)

    def test_records_without_times_are_numbered(self, tmp_path):
        found = read_folder(result_folder(tmp_path / "out", timed=False))
        series = make_series(found)
        assert not series.timed
        assert series.start.tolist() == [0, 1, 2, 3, 4, 5]
        assert '<label for="pick">Record</label>' in page_of(tmp_path / "out")


class TestAvailability:
    def test_shares_are_counts_over_what_was_expected(self):
        records, _ = demo_records()
        records["count"].values[1, 2] = 300
        found = make_availability(records, 6.0)
        assert found.expected == 600.0
        assert found.share[2, 1] == 0.5
        np.testing.assert_allclose(found.usable, [1, 1, 0, 1, 5 / 6, 1])
        assert found.beam_usable.tolist() == [5, 5, 5, 4, 5, 5]
        assert found.beam_samples[2] == 6 * 600 - 300

    def test_many_records_are_put_together_by_whole_hours(self):
        records, _ = demo_records()
        many = records.isel(record=np.zeros(6 * 24 * 3, dtype=int)).copy(deep=True)
        many["count"].values[:6, 0] = 0
        found = make_availability(many, 6.0)
        assert np.diff(found.edges).tolist() == [6] * 72
        assert found.share[0, :2].tolist() == [0.0, 1.0]

    def test_many_beams_share_rows(self):
        records, _ = demo_records()
        wide = records.isel(beam=np.zeros(120, dtype=int)).assign_coords(beam=np.arange(120))
        found = make_availability(wide, 6.0)
        assert len(found.beam) <= 50
        assert found.beam[0] == "0–2"
        assert len(found.beam_usable) == 120


class TestSections:
    def test_all_sections_are_there_for_a_full_result(self, full_page):
        text = full_page
        for heading in (
            "What was read",
            "Stresses over time",
            "One record",
            "What the data said",
            "Turbulence intensity",
            "Shape of the tensor",
            "Diagnostics",
            "Provenance",
        ):
            assert f">{heading}</h2>" in text

    def test_sections_without_data_are_left_out(self, tables):
        text = page_of(tables)
        assert ">What was read</h2>" not in text  # fit_campaign keeps no records
        assert ">Turbulence intensity</h2>" not in text
        assert ">One record</h2>" in text
        assert "draws" not in data_of(text)["records"]

    def test_what_was_read_stands_in_the_page(self, full_page):
        text = full_page
        assert "6-beam.parquet: 21600 rows (long)" in text
        assert "Share of the expected samples" in text

    def test_the_words_say_what_the_scan_sees_and_what_the_prior_was(self, full_page):
        text = full_page
        assert "The scan sees all six stresses." in text
        assert "Prior: weak: uu log-normal" in text
        assert "Of the six directions of R the beams see all" in text

    def test_flags_are_counted_and_their_first_records_named(self, full, full_page):
        row = re.search(r'<tr><th scope="row">beam_left_out</th>(.*?)</tr>', full_page)
        assert row is not None
        cells = re.findall(r"<td[^>]*>(.*?)</td>", row.group(1))
        start = np.datetime_as_string(read_folder(full).time[4], unit="m").replace("T", " ")
        assert cells[1:] == ["remark", start, "1", "16.7 %"]

    def test_failed_records_without_a_beam_are_told_apart(self, full_page, tmp_path):
        """A gap in a long campaign is no failure of the fit."""
        assert "<dt>Failed</dt><dd>1 (1 without a usable beam)</dd>" in full_page
        whole = page_of(result_folder(tmp_path / "none", flagged=True))
        assert "<dt>Failed</dt><dd>6 (6 without a usable beam)</dd>" in whole

    def test_every_flag_has_a_meaning(self):
        assert set(FLAG_MEANINGS) >= set(FLAGS)

    def test_run_json_is_there_entry_by_entry(self, full, full_page):
        text = full_page
        for name, value in flat(json.loads((full / "run.json").read_text())):
            assert f'<th scope="row">{name}</th>' in text
            assert escape(value.split(":")[0]) in text

    def test_tables_hold_the_medians_and_intervals(self, full, full_page):
        found = read_folder(full)
        expected = interval(*(float(found.numbers[name][0, 0]) for name in ("median", "hdi_low", "hdi_high")))
        assert f'<td class="n">{expected}</td>' in full_page

    def test_one_record_all_flagged_and_unfitted(self, tmp_path):
        one = page_of(result_folder(tmp_path / "one", n_record=1))
        assert data_of(one)["series"]["median"][0][0] is not None
        none = page_of(result_folder(tmp_path / "none", flagged=True))
        assert "No record was fitted" in none
        assert ">One record</h2>" not in none
        assert ">Diagnostics</h2>" in none

    def test_an_interrupted_run_shows_what_is_finished(self, tables, tmp_path):
        folder = tmp_path / "out"
        shutil.copytree(tables, folder)
        run = json.loads((folder / "run.json").read_text())
        (folder / "run.json").write_text(json.dumps({"key": run["key"], "finished": False}))
        assert "Not finished" in page_of(folder)


class TestPage:
    def test_the_same_folder_gives_the_same_bytes(self, full, tmp_path):
        files = [write_report(full, tmp_path / name) for name in ("a.html", "b.html")]
        assert files[0].read_bytes() == files[1].read_bytes()

    @pytest.mark.parametrize("kind", ["full", "tables", "with_draws"])
    def test_elements_are_closed_and_ids_are_there_once(self, kind, request):
        elements = Elements(page_of(request.getfixturevalue(kind)))
        assert elements.open == []
        assert len(elements.ids) == len(set(elements.ids))
        links = [attributes["href"][1:] for tag, attributes in elements.found if tag == "a"]
        assert set(links) <= set(elements.ids)

    def test_nothing_is_loaded_from_elsewhere(self, full_page):
        for tag, attributes in Elements(full_page).found:
            assert "src" not in attributes
            assert attributes.get("href", "#")[0] == "#" or attributes["href"] == "data:,"
            assert "style" not in attributes
            assert not [name for name in attributes if name.startswith("on")], tag

    def test_the_policy_allows_the_scripts_and_styles_of_the_page_only(self, full_page):
        text = full_page
        policy = next(a["content"] for tag, a in Elements(text).found if a.get("http-equiv") and tag == "meta")
        style = re.search(r"<style>(.*?)</style>", text, flags=re.DOTALL).group(1)
        script = re.findall(r"<script>(.*?)</script>", text, flags=re.DOTALL)
        assert len(script) == 1
        assert policy.startswith("default-src 'none';")
        assert f"script-src '{page.content_hash(script[0])}';" in policy
        assert f"style-src '{page.content_hash(style)}';" in policy
        assert "unsafe" not in policy

    def test_texts_of_files_stay_texts(self, full, tmp_path):
        text = page_of(evil_folder(tmp_path / "out", full), title=EVIL)
        elements = Elements(text)
        assert [tag for tag, _ in elements.found].count("script") == 2
        assert "img" not in [tag for tag, _ in elements.found]
        assert sum(EVIL in words for words in elements.words) >= 3  # title, heading, provenance
        assert text.count('id="data"') == 1

    def test_what_is_put_in_the_template_is_not_looked_at_again(self):
        assert page.fill("{{a}} {{b}}", {"a": "{{b}}", "b": "<"}) == "{{b}} <"

    def test_data_cannot_end_their_element(self):
        text = page.as_script_data({"a": "</script><!--&"})
        assert "<" not in text
        assert json.loads(text) == {"a": "</script><!--&"}

    def test_an_hour_is_below_one_megabyte_and_a_year_below_seven(self, full_page, year):
        assert len(full_page) < 1e6
        assert len(page_of(year)) < 7e6

    def test_draws_of_any_number_of_records_stay_within_their_share(self, full):
        found = read_folder(full)
        for n_record in (1, 24, 144, 1500):
            n = min(figures.MOST_DRAWS, figures.DRAW_BYTES // (16 * n_record))
            assert n >= figures.LEAST_DRAWS
            assert len(pack_rows(np.zeros((n_record, n, 6)))["values"]) <= figures.DRAW_BYTES
        assert found.draws is not None


class TestWriting:
    def test_the_default_place_is_the_folder_itself(self, tables, tmp_path):
        shutil.copytree(tables, tmp_path / "out")
        assert write_report(tmp_path / "out") == tmp_path / "out" / "report.html"
        with pytest.raises(InputError, match=r"report.html' exists: give another name, or --overwrite to replace it"):
            write_report(tmp_path / "out")
        assert [path.name for path in (tmp_path / "out").glob(".*")] == []

    def test_the_command_does_the_same(self, tables, tmp_path):
        file = tmp_path / "page.html"
        done = CliRunner().invoke(report, [str(tables), "-o", str(file), "--title", "A title"])
        assert done.exit_code == 0, done.output
        assert done.output.strip() == str(file)
        assert "<h1>A title</h1>" in file.read_text(encoding="utf-8")
        again = CliRunner().invoke(report, [str(tables), "-o", str(file)])
        assert isinstance(again.exception, InputError)
        assert CliRunner().invoke(report, [str(tables), "-o", str(file), "--overwrite"]).exit_code == 0

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda folder: folder, r"No folder '.*': give the output folder of bayes-rs fit"),
            (lambda folder: folder.mkdir(), r"No fit in '.*': it has no run.json"),
            (
                lambda folder: (folder.mkdir(), (folder / "run.json").write_text("{}")),
                r"No fit in '.*': it has neither posterior.nc nor the tables summary and posterior",
            ),
            (
                lambda folder: (folder.mkdir(), (folder / "run.json").write_text("{")),
                r"File '.*run.json' cannot be read: .*; run the fit again",
            ),
            (
                lambda folder: (folder.mkdir(), (folder / "run.json").write_text("[]")),
                r"File '.*run.json' is not of a fit: it must hold an object",
            ),
        ],
    )
    def test_a_folder_of_something_else_is_refused(self, tmp_path, make, message):
        make(tmp_path / "out")
        with pytest.raises(InputError, match=message):
            write_report(tmp_path / "out")
        assert not (tmp_path / "out" / "report.html").exists()

    def test_tables_refuse_another_probability(self, tables):
        with pytest.raises(InputError, match=r"Invalid prob 0.5: the tables in '.*' hold intervals of 0.9"):
            read_folder(tables, prob=0.5)
        with pytest.raises(
            InputError, match=r"Invalid prob 2.0: it must be between 0 and 1|Invalid prob 2.0: the tables"
        ):
            read_folder(tables, prob=2.0)

    def test_records_of_another_run_are_refused(self, tables, tmp_path):
        shutil.copytree(tables, tmp_path / "out")
        demo_records()[0].to_netcdf(tmp_path / "out" / "records.nc", engine="h5netcdf")
        with pytest.raises(InputError, match=r"records.nc' holds 6 records and the fit 23: it is of another run"):
            read_folder(tmp_path / "out")

    def test_broken_tables_are_refused(self, tables, tmp_path):
        shutil.copytree(tables, tmp_path / "out")
        next((tmp_path / "out" / "posterior").glob("**/*.parquet")).write_bytes(b"PAR1")
        with pytest.raises(InputError, match=r"parquet' has 4 bytes, and \d+ were written: resume the fit to make"):
            read_folder(tmp_path / "out")


class TestPieces:
    @pytest.mark.parametrize(
        ("value", "text"),
        [
            (0.0, "0.00"),
            (1.0, "1.00"),
            (-0.5, "−0.500"),
            (0.012345, "0.0123"),
            (1234.5, "1234"),
            (123.4, "123"),
            (1e-7, "1.00e−07"),
            (float("nan"), "–"),
            (None, "–"),
        ],
    )
    def test_numbers_have_three_digits(self, value, text):
        assert number(value) == text

    def test_packed_rows_come_back_within_half_a_step(self):
        values = np.random.default_rng(1).normal(size=(7, 50)) * np.logspace(-6, 3, 7)[:, None]
        values[3, 4] = np.nan
        error = np.abs(unpack(pack_rows(values), values.shape) - values)
        bound = HALF_STEP * np.nanmax(np.abs(values), axis=1)[:, None]
        assert np.all((error <= bound) | np.isnan(values))
        assert np.isnan(unpack(pack_rows(values), values.shape)[3, 4])

    def test_rows_of_nothing_are_missing(self):
        assert np.isnan(unpack(pack_rows(np.full((2, 3), np.nan)), (2, 3))).all()
        assert unpack(pack_rows(np.zeros((1, 3))), (1, 3)).tolist() == [[0.0, 0.0, 0.0]]

    def test_packed_numbers_come_back(self):
        values = np.array([1.5, -2.0, np.nan])
        np.testing.assert_array_equal(np.frombuffer(base64.b64decode(pack(values, "f8")), dtype="<f8"), values)

    def test_even_steps_are_counted_and_others_written(self):
        assert pack_steps(np.array([5, 7, 9])) == {"first": 5.0, "step": 2.0, "n": 3}
        assert pack_steps(np.array([5])) == {"first": 5.0, "step": 0.0, "n": 1}
        assert pack_steps(np.array([5, 7, 10])) == {"values": pack(np.array([5.0, 7.0, 10.0]), "f8")}

    def test_flags_fit_in_sixteen_bits(self):
        assert max(FLAGS.values()) < 2**16

    def test_plain_numbers_have_no_nan(self):
        assert plain(np.array([[1.23456, np.nan], [np.inf, -2.0]]), 3) == [[1.23, None], [None, -2.0]]

    def test_cells_are_escaped(self):
        text = table("<b>", ("<i>", "b"), [("<u>", "&")])
        assert not re.search(r"<[biu]>", text)
        assert "&amp;" in text
