"""The report: its numbers are those of the fit, and no text of a file becomes part of the page."""

import base64
import dataclasses
import json
import re
import shutil
from html import escape
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from fit_scene import NOISE, OPTIONS, SCAN, make_records
from report_scene import EVIL, demo_records, evil_folder, result_folder, table_folder

import bayes_rs as brs
from bayes_rs import STRESSES, InputError, fit, open_fit, write_report
from bayes_rs.cli.report_command import report
from bayes_rs.fits.budget_sources import SWITCHED
from bayes_rs.fits.derived import lumley_coordinates
from bayes_rs.fits.flags import FLAG_MEANINGS, FLAGS
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.posteriors.prior_at_size import prior_interval_at_size, sizes_of
from bayes_rs.report import figures, template
from bayes_rs.report.availability import make_availability
from bayes_rs.report.beside import beside_data, beside_section, match_fits
from bayes_rs.report.budget_section import part_class
from bayes_rs.report.packing import MISSING, pack, pack_few, pack_rows, pack_steps, plain
from bayes_rs.report.reference_section import make_reference, reference_data, reference_errors, reference_section
from bayes_rs.report.report_data import NUMBERS, report_data
from bayes_rs.report.series import MOST_BINS, make_series
from bayes_rs.report.tables import flat, interval, number, table
from bayes_rs.result_folder import seal_folder
from bayes_rs.wind import sonic_stresses

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
    summaries = open_fit(tables).summary()
    places = (6 * from_record[:, None] + np.arange(6)).ravel()
    long = summaries.iloc[places].assign(record=np.repeat(np.arange(n_record), 6), time=np.repeat(start, 6))
    for name, content in (("posterior", rows), ("summary", long)):
        (folder / name).mkdir(parents=True)
        content.to_parquet(folder / name / "part-000000.parquet", index=False)
    run = json.loads((tables / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**run, "n_record": n_record, "part_records": n_record}))
    shutil.copy(tables / "prior.parquet", folder)
    records = open_fit(tables).records.isel(record=from_record).assign_coords(time=("record", start))
    records.to_netcdf(folder / "records.nc", engine="h5netcdf")
    seal_folder(folder)
    return folder


def report_of(folder, **options):
    return report_data(open_fit(folder), **options)


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
        found = report_of(full)
        expected = open_fit(full).summary(prob=0.9, derived=("ti",))
        for name in NUMBERS:
            rows = expected[expected["stress"].isin(STRESSES)][name].to_numpy().reshape(-1, 6)
            np.testing.assert_array_equal(found.numbers[name], rows)
        ti = expected[expected["stress"] == "ti"]
        np.testing.assert_array_equal(found.derived["ti"]["low"], ti["low"])
        assert found.fitted.tolist() == [True, True, False, True, True, True]
        assert found.flag.tolist() == [0, 0, FLAGS["no_usable_beam"], 0, FLAGS["beam_left_out"], 0]

    def test_a_full_result_gives_the_numbers_in_the_csv_file(self, full):
        """Independent of `summary`: what the user sees in the folder. The file holds all digits."""
        written = pd.read_csv(full / "summary.csv")
        np.testing.assert_allclose(
            report_of(full).numbers["median"].ravel(), written[written["stress"].isin(STRESSES)]["median"], rtol=1e-12
        )

    def test_another_probability_is_computed_from_the_draws(self, full):
        half = report_of(full, prob=0.5)
        expected = open_fit(full).summary(prob=0.5)
        np.testing.assert_array_equal(half.numbers["low"].ravel(), expected["low"])
        assert "50 % interval, equal-tailed" in page_of(full, prob=0.5)

    def test_tables_give_the_numbers_of_their_summary(self, tables):
        found, expected = report_of(tables), open_fit(tables).summary()
        for name in NUMBERS:
            np.testing.assert_array_equal(found.numbers[name].ravel(), expected[name])
        assert int(found.fitted.sum()) == 16

    def test_covariances_are_those_of_the_draws(self, full, with_draws):
        flat_draws = open_fit(full).draws(1).reshape(-1, 6)
        np.testing.assert_allclose(
            report_of(full).covariance()[1], np.cov(flat_draws, rowvar=False), rtol=1e-12, atol=1e-15
        )
        found = report_of(with_draws)
        every = found.draws(10**6)[3]
        every = every[np.isfinite(every).all(axis=1)]
        np.testing.assert_allclose(found.covariance()[3], np.cov(every, rowvar=False), rtol=1e-9, atol=1e-12)

    def test_the_page_holds_the_numbers_of_each_record(self, full, full_page):
        found, data = report_of(full), data_of(full_page)
        numbers = unpack(data["records"]["numbers"], (6, 5, 6))
        columns = ("median", "low", "high", "mean", "sd")
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
        every = open_fit(full).draws(1).reshape(-1, 6)
        distance = np.abs(some[:, None] - every[None]).max(axis=-1).min(axis=1)
        assert n == min(figures.MOST_DRAWS, len(every))
        assert np.all(distance <= HALF_STEP * np.abs(some).max() * (1.0 + 1e-3))

    def test_draws_of_tables_are_those_of_their_records(self, with_draws):
        found = report_of(with_draws)
        draws = found.draws(400)
        assert np.isnan(draws[~found.fitted]).all()
        # means of 400 of 2048 draws: five standard errors of independent draws
        error = np.abs(draws.mean(axis=1) - found.numbers["mean"])[found.fitted]
        assert np.all(error <= 5.0 * found.numbers["sd"][found.fitted] / np.sqrt(400))

    def test_turbulence_intensity_of_tables_follows_from_uu(self, tmp_path):
        records = make_records()
        records["wind_speed"].values[3] = np.nan  # beside record 2: not fitted, and none to divide by
        fit(records, SCAN, output=tmp_path / "out", draws="none", **OPTIONS)
        found = report_of(tmp_path / "out")
        np.testing.assert_allclose(
            found.derived["ti"]["high"][0], np.sqrt(found.numbers["high"][0, 0]) / 10.0, rtol=1e-12
        )
        assert np.isnan(found.derived["ti"]["median"][[2, 3]]).all()
        data = figures.intensity_data(found)
        assert data["bin"] == [10]
        assert data["count"] == [15]
        assert data["points"]["median"][0] == pytest.approx(found.derived["ti"]["median"][0], rel=1e-3)

    def test_the_points_of_the_shape_are_those_of_the_summary(self, full, full_page, tables):
        data = data_of(full_page)
        table = open_fit(full).summary(derived=("lumley_xi", "lumley_eta")).dropna(subset="median")
        for name in ("xi", "eta"):
            expected = table.loc[table["stress"] == f"lumley_{name}", "median"]
            np.testing.assert_allclose(data["shape"][name], expected, rtol=1e-3)
        found = report_of(tables)  # no draws: of the posterior means
        shown = figures.shape_data(found)
        np.testing.assert_allclose(
            [shown["xi"], shown["eta"]], lumley_coordinates(found.numbers["mean"][found.fitted]), rtol=1e-3
        )
        assert data["shape"]["record"] == [0, 1, 3, 4, 5]


class TestSeries:
    def test_few_records_keep_their_own_numbers(self, full):
        found = report_of(full)
        series = make_series(found)
        assert not series.binned
        assert series.timed
        assert series.width == 600_000.0
        np.testing.assert_array_equal(series.low, found.numbers["low"])
        assert series.n_failed.tolist() == [0, 0, 1, 0, 0, 0]
        assert series.n_remarked.tolist() == [0, 0, 0, 0, 1, 0]

    def test_a_year_is_shown_in_bins_of_six_hours(self, year):
        found = report_of(year)
        series = make_series(found)
        assert series.binned
        assert series.width == 6 * 3.6e6
        assert series.count.tolist() == [36] * 1460
        assert len(series.start) <= MOST_BINS

    def test_bins_hold_medians_of_their_records(self, year):
        found = report_of(year)
        series = make_series(found)
        whole = np.arange(36 * 100, 36 * 101)
        rows = whole[found.fitted[whole]]
        for ours, theirs in (("median", "median"), ("low", "low"), ("high", "high")):
            expected = np.median(found.numbers[theirs][rows], axis=0)
            np.testing.assert_allclose(getattr(series, ours)[100], expected, rtol=1e-12)
        for ours, share in (("spread_low", 0.05), ("spread_high", 0.95)):
            expected = np.quantile(found.numbers["median"][rows], share, axis=0)
            np.testing.assert_allclose(getattr(series, ours)[100], expected, rtol=1e-12)
        failures = "no_usable_beam no_wind short_chain ensembles_differ weights_uneven likelihood_failed"
        bits = [FLAGS[name] for name in failures.split()]
        assert series.n_failed[100] == sum(any(int(flag) & bit for bit in bits) for flag in found.flag[whole])
        assert series.n_failed[100] >= 36 - len(rows) > 0

    def test_records_without_times_are_numbered(self, tmp_path):
        found = report_of(result_folder(tmp_path / "out", timed=False))
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
            "Over time",
            "One record",
            "What the data said",
            "Turbulence intensity",
            "Shape of the tensor",
            "Flags and diagnostics",
            "How it was made",
        ):
            assert f">{heading}</h2>" in text

    def test_sections_without_data_are_left_out(self, tables):
        text = page_of(tables)
        assert ">What was read</h2>" in text
        assert ">Turbulence intensity</h2>" in text
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
        start = np.datetime_as_string(report_of(full).time[4], unit="m").replace("T", " ")
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
        found = report_of(full)
        expected = interval(*(float(found.numbers[name][0, 0]) for name in ("median", "low", "high")))
        assert f'<td class="n">{expected}</td>' in full_page

    def test_one_record_all_flagged_and_unfitted(self, tmp_path):
        one = page_of(result_folder(tmp_path / "one", n_record=1))
        assert data_of(one)["series"]["median"][0][0] is not None
        none = page_of(result_folder(tmp_path / "none", flagged=True))
        assert "No record was fitted" in none
        assert ">One record</h2>" not in none
        assert ">Flags and diagnostics</h2>" in none

    def test_records_outside_the_noise_are_counted(self, tmp_path):
        """Noise of 16 m/s for records of 4 m/s: the page says so of every record."""
        records = make_records(3).assign(wind_speed=("record", np.full(3, 4.0)))
        noise = dataclasses.replace(NOISE, wind_speed=16.0)
        fit(records, SCAN, output=tmp_path / "out", **{**OPTIONS, "noise": noise})
        text = page_of(tmp_path / "out")
        row = re.search(r'<tr><th scope="row">outside_noise</th>(.*?)</tr>', text)
        cells = re.findall(r"<td[^>]*>(.*?)</td>", row.group(1))
        starts = "2020-01-01 00:00, 2020-01-01 00:10, 2020-01-01 00:20"
        assert cells == [escape(FLAG_MEANINGS["outside_noise"]), "remark", starts, "3", "100.0 %"]


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
        assert f"script-src '{template.content_hash(script[0])}';" in policy
        assert f"style-src '{template.content_hash(style)}';" in policy
        assert "unsafe" not in policy

    def test_texts_of_files_stay_texts(self, full, tmp_path):
        text = page_of(evil_folder(tmp_path / "out", full), title=EVIL)
        elements = Elements(text)
        assert [tag for tag, _ in elements.found].count("script") == 2
        assert "img" not in [tag for tag, _ in elements.found]
        assert sum(EVIL in words for words in elements.words) >= 3  # title, heading, provenance
        assert text.count('id="data"') == 1

    def test_what_is_put_in_the_template_is_not_looked_at_again(self):
        assert template.fill("{{a}} {{b}}", {"a": "{{b}}", "b": "<"}) == "{{b}} <"

    def test_data_cannot_end_their_element(self):
        text = template.as_script_data({"a": "</script><!--&"})
        assert "<" not in text
        assert json.loads(text) == {"a": "</script><!--&"}

    def test_an_hour_is_below_one_megabyte_and_a_year_below_seven_and_a_half(self, full_page, year):
        assert len(full_page) < 1e6
        assert len(page_of(year)) < 7.5e6

    def test_draws_of_any_number_of_records_stay_within_their_share(self, full):
        found = report_of(full)
        for n_record in (1, 24, 144, 1500):
            n = min(figures.MOST_DRAWS, figures.DRAW_BYTES // (16 * n_record))
            assert n >= figures.LEAST_DRAWS
            assert len(pack_rows(np.zeros((n_record, n, 6)))["values"]) <= figures.DRAW_BYTES
        assert found.draws is not None


class TestWriting:
    def test_the_default_place_is_the_folder_itself(self, tables, tmp_path):
        shutil.copytree(tables, tmp_path / "out")
        assert write_report(tmp_path / "out") == tmp_path / "out" / "report.html"
        with pytest.raises(InputError, match=r"report.html' exists: give another name, or overwrite it"):
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

    def test_a_fit_in_memory_needs_a_place(self, tmp_path):
        found = fit(make_records(2), SCAN, **OPTIONS)
        with pytest.raises(InputError, match="A fit in memory has no folder for its report: name a file to write"):
            write_report(found)
        assert "Over time" in write_report(found, tmp_path / "a.html").read_text(encoding="utf-8")

    def test_the_page_of_a_fit_in_memory_is_that_of_its_folder(self, tmp_path):
        pages = []
        for output in (None, tmp_path / "out"):
            found = fit(make_records(3), SCAN, output=output, **OPTIONS)
            pages.append(write_report(found, tmp_path / "a.html", overwrite=True).read_text(encoding="utf-8"))
        one, other = (text[: text.index('<section id="provenance"')] for text in pages)
        assert one == other

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda folder: folder, r"No folder '.*': give the output folder of a bayes-rs run"),
            (
                lambda folder: folder.mkdir(),
                r"No results in '.*': it has no fingerprints.jsonl; give the output folder",
            ),
            (
                lambda folder: (folder.mkdir(), (folder / "run.json").write_text("{}"), seal_folder(folder)),
                r"No fit in '.*': its run.json is of another command",
            ),
            (
                lambda folder: (folder.mkdir(), (folder / "run.json").write_text("{}")),
                r"No results in '.*': it has no fingerprints.jsonl; give the output folder",
            ),
        ],
    )
    def test_a_folder_of_something_else_is_refused(self, tmp_path, make, message):
        make(tmp_path / "out")
        with pytest.raises(InputError, match=message):
            write_report(tmp_path / "out")
        assert not (tmp_path / "out" / "report.html").exists()

    def test_tables_refuse_another_probability(self, tables):
        with pytest.raises(
            InputError, match=r"Invalid prob 0.5: the fit kept no draws, and .* intervals of 0.9; leave"
        ):
            report_of(tables, prob=0.5)
        with pytest.raises(InputError, match=r"Invalid prob 2.0: it must be between 0 and 1|Invalid prob 2.0: the fit"):
            report_of(tables, prob=2.0)

    @pytest.mark.parametrize("name", ["posterior", "summary", "records.nc", "prior.parquet", "run.json"])
    def test_what_was_changed_is_refused(self, tables, tmp_path, name):
        shutil.copytree(tables, tmp_path / "out")
        place = tmp_path / "out" / name
        file = place if place.is_file() else next(place.glob("**/*.parquet"))
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
        words = rf"File '.*{file.name}' was changed since it was written: resume the fit to make it again"
        with pytest.raises(InputError, match=words):
            write_report(tmp_path / "out")


class TestBeside:
    def shifted(self, found, factor):
        """The same records with all numbers multiplied, in the reverse order, one of them lost."""
        rows = np.arange(len(found.record))[::-1][1:]
        numbers = {name: values[rows] * (factor if name in ("median", "low", "high") else 1.0) for name, values in
                   found.numbers.items()}  # fmt: skip
        return dataclasses.replace(
            found, record=np.arange(len(rows)), time=found.time[rows], flag=found.flag[rows], numbers=numbers
        )

    def test_records_are_matched_by_their_starts(self, tables):
        found = report_of(tables)
        beside = match_fits(found, self.shifted(found, 1.0), ("a", "b"))
        assert beside.n_start == len(found.record) - 1
        assert len(beside.rows) == int(found.fitted[:-1].sum())
        np.testing.assert_array_equal(found.time[beside.rows], beside.other.time[beside.other_rows])
        one, other = beside.numbers
        np.testing.assert_array_equal(one["median"], other["median"])
        assert not beside.apart.any()

    def test_intervals_that_do_not_overlap_are_counted_and_named(self, tables):
        found = report_of(tables)
        beside = match_fits(found, self.shifted(found, 50.0), ("a", "<b>"))
        low, high = (found.numbers[name][beside.rows] for name in ("low", "high"))
        np.testing.assert_array_equal(beside.apart, (50.0 * low > high) | (50.0 * high < low))
        assert beside.apart[:, 0].any()
        text = beside_section(beside)
        start = np.datetime_as_string(found.time[beside.rows[0]], unit="m").replace("T", " ")
        assert f"{start} (" in text
        assert "<b>" not in text
        data = beside_data(beside, np.arange(len(found.record)))
        apart = np.frombuffer(base64.b64decode(data["apart"]), dtype="<u1")
        np.testing.assert_array_equal((apart[:, None] >> np.arange(6)) & 1, beside.apart)

    def test_fits_that_share_nothing_are_refused(self, tables):
        found = report_of(tables)
        later = dataclasses.replace(found, time=found.time + np.timedelta64(3650, "D"))
        with pytest.raises(InputError, match="0 are in both fits, and none of them was fitted in both"):
            match_fits(found, later, ("a", "b"))
        with pytest.raises(InputError, match=r"The intervals of the two fits differ: 90 % interval, .*50 %"):
            match_fits(found, dataclasses.replace(found, prob=0.5), ("a", "b"))


@pytest.fixture(scope="module")
def budget_of_full(full):
    return brs.budget(open_fit(full), derived=("ti",))


class TestBudget:
    """The uncertainty budget stands in the page where it is asked for."""

    def test_the_page_holds_the_shares_of_the_budget(self, full, full_page, budget_of_full, tmp_path):
        text = write_report(full, tmp_path / "page.html", budget=True).read_text(encoding="utf-8")
        data = data_of(text)["budget"]
        assert data["names"] == [*STRESSES, "TI"]
        assert [one["name"] for one in data["sources"]] == list(dict.fromkeys(budget_of_full["source"]))[:-1]
        for one in data["sources"]:
            own = budget_of_full[budget_of_full["source"] == one["name"]].set_index("stress").loc[[*STRESSES, "ti"]]
            np.testing.assert_allclose(one["share"], 100.0 * own["share"], rtol=1e-3, atol=1e-6)
            cells = [f"{100 * share:z.0f} %".replace("-", "−") for share in own["share"]]
            assert "".join(f'<td class="n">{cell}</td>' for cell in cells) in text
        last = budget_of_full[budget_of_full["source"] == "combined"].set_index("stress")
        assert data["priors"] == [int(value) for value in is_priors(last.loc[[*STRESSES, "ti"], "decided"])]
        for words in ("Of 5 records together", "Taken for known: probe length, yaw", ">scatter beyond theory, type A<"):
            assert words in text
        assert text == write_report(full, tmp_path / "again.html", budget=True).read_text(encoding="utf-8")
        assert "Uncertainty budget" not in full_page
        assert data_of(full_page)["budget"] is None

    def test_the_command_asks_for_it(self, full, tmp_path):
        for words, there in (((), False), (("--budget",), True)):
            page = tmp_path / f"{there}.html"
            assert CliRunner().invoke(report, [str(full), "-o", str(page), *words]).exit_code == 0
            assert ("Uncertainty budget" in page.read_text(encoding="utf-8")) is there

    def test_every_source_has_a_colour_in_the_page_and_in_the_picture(self, budget_of_full):
        style = template.shipped("style.css")
        for source in SWITCHED:
            assert f".part.{part_class(source)} {{ --part:" in style, source
            renamed = budget_of_full.assign(source=budget_of_full["source"].replace("length scale", source))
            assert brs.plot.budget(renamed.drop_duplicates(["stress", "source"])).axes

    def test_one_that_cannot_be_had_is_refused_in_one_line(self, tmp_path):
        folder = result_folder(tmp_path / "out", n_record=2, flagged=True)
        with pytest.raises(InputError, match="No record was fitted, so there is nothing to tell"):
            write_report(folder, budget=True)
        assert not (folder / "report.html").exists()


class TestPriorsPart:
    def test_the_bits_of_a_record_are_those_of_the_rule(self, full, full_page):
        found, data = report_of(full), data_of(full_page)
        bits = np.frombuffer(base64.b64decode(data["records"]["priors"]), dtype="<u1")
        expected = is_priors(found.numbers["decided"])
        np.testing.assert_array_equal((bits[:, None] >> np.arange(6)) & 1, expected)
        assert {True, False} <= set(expected[found.fitted].ravel().tolist())
        np.testing.assert_array_equal(np.array(data["series"]["priors"]).T, expected)

    def test_a_bin_is_the_priors_if_most_of_its_fitted_records_are(self, year):
        found = report_of(year)
        series = make_series(found)
        whole = np.arange(36 * 7, 36 * 8)
        rows = whole[found.fitted[whole]]
        share = is_priors(found.numbers["decided"][rows]).mean(axis=0)
        np.testing.assert_array_equal(series.priors[7], share > 0.5)

    def test_the_page_interpolates_the_priors_interval_at_a_size(self, full, full_page):
        """The script's nodes against the interval at each record's own size; 3 % is the Monte-Carlo error of an end."""
        found, nodes = report_of(full), data_of(full_page)["room"]
        rows = np.flatnonzero(found.fitted)
        mean, sd = sizes_of(found.numbers["mean"][rows], found.covariance(rows))
        ends = prior_interval_at_size(found.prior_shape, mean, sd, found.prob, found.interval)
        for name, end in zip(("low", "high"), ends, strict=True):
            for c in range(len(STRESSES)):
                at = mean * np.interp(sd / mean, nodes["spread"], nodes[name][c])
                width = ends[1][:, c] - ends[0][:, c]
                assert np.all(np.abs(at - end[:, c]) <= 0.03 * width)

    def test_stars_mark_what_is_the_priors(self, full_page):
        table = full_page.split("Posterior medians, each with its 90 % interval, equal-tailed")[2]
        row = table.split("<tbody>")[1].split("</tr>")[0]
        cells = re.findall(r'<td class="n">(.*?)</td>', row)
        assert ["*" in cell for cell in cells] == [False, False, True, True, True, False, True, False]

    def test_flags_that_do_not_occur_are_not_listed(self, full_page):
        assert "beam_left_out" in full_page.split('id="diagnostics"')[1].split("</table>")[0]
        assert "weights_uneven" not in full_page.split('id="diagnostics"')[1].split("</table>")[0]


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

    def test_few_numbers(self):
        values = np.array([0, 65536, 0, 5, 65536])
        packed = pack_few(values)
        place = np.frombuffer(base64.b64decode(packed["place"]), dtype="<u2")
        assert [packed["values"][index] for index in place] == values.tolist()

    def test_flags_fit_in_the_bits_that_a_browser_counts_with(self):
        """There & makes numbers of 32 bits with a sign."""
        assert max(FLAGS.values()) < 2**31

    def test_plain_numbers_have_no_nan(self):
        assert plain(np.array([[1.23456, np.nan], [np.inf, -2.0]]), 3) == [[1.23, None], [None, -2.0]]

    def test_cells_are_escaped(self):
        text = table("<b>", ("<i>", "b"), [("<u>", "&")])
        assert not re.search(r"<[biu]>", text)
        assert "&amp;" in text


class TestReference:
    """A mast beside: what the page says and draws is what `intensity_errors` tells."""

    def shown(self, full, ti):
        data = report_data(open_fit(full))
        return data, make_reference(data, pd.DataFrame({"time": open_fit(full).time, "ti": ti}))

    def test_the_page_is_not_written_over_the_reference(self, full, tmp_path):
        file = tmp_path / "mast.csv"
        pd.DataFrame({"time": open_fit(full).time, "ti": 0.12}).to_csv(file, index=False)
        before = file.read_bytes()
        with pytest.raises(InputError, match="is one of the files that are read"):
            write_report(full, file, reference=file, overwrite=True)
        assert file.read_bytes() == before

    def test_the_representative_intensity_is_told_and_drawn(self, full):
        data, reference = self.shown(full, np.linspace(0.09, 0.16, 6))
        rows = reference_errors(data, reference)
        bins = rows[rows["bin"] != "all"]
        drawn = reference_data(data, reference)
        for name, column in (("ours_high", "measured_representative"), ("theirs_high", "reference_representative")):
            np.testing.assert_allclose(np.array(drawn["bins"][name], dtype=float), bins[column], rtol=1e-3)
        np.testing.assert_allclose(drawn["bins"]["coverage"], 100.0 * bins["coverage"], atol=0.005)  # four digits
        html = reference_section(data, reference)
        some = bins[bins["n_record"] >= 3]
        assert len(some) > 0
        error = f"{100.0 * np.median(some['representative_error']):.1f} %".replace("-", "−")
        assert f"is off by {error}" in html
        assert "leaves nacelle lidars out" in html
        assert "repr. error" in html

    def test_rows_that_are_left_out_are_counted(self, full):
        data, reference = self.shown(full, np.array([0.1, -9999.0, 12.0, 0.11, 0.12, 0.13]))
        html = reference_section(data, reference)
        assert "2 records are left out, since the row of the reference has a turbulence intensity" in html
        assert "left out" not in reference_section(*self.shown(full, np.linspace(0.09, 0.16, 6)))

    def test_a_reference_of_no_fitted_record_is_refused(self, full):
        data = report_data(open_fit(full))
        median = np.where(np.arange(6) == 0, np.nan, data.derived["ti"]["median"])
        data = dataclasses.replace(data, derived={"ti": {**data.derived["ti"], "median": median}})
        one = pd.DataFrame({"time": open_fit(full).time[:1], "ti": 0.1})
        with pytest.raises(
            InputError, match=r"of 1 records, and the fit has none of these: 5 of 6 records were fitted"
        ):
            make_reference(data, one)

    def test_a_sonic_is_a_reference(self, full, tmp_path):
        fit = open_fit(full)
        step = np.timedelta64(2, "s")
        time = np.concatenate([start + np.arange(300) * step for start in fit.time])
        rng = np.random.default_rng(1)
        wind = {
            name: ("time", rng.normal(mean, 1.2, len(time))) for name, mean in (("u", 10.0), ("v", 0.0), ("w", 0.0))
        }
        stresses = sonic_stresses(xr.Dataset(wind, coords={"time": time}))
        page = write_report(fit, tmp_path / "sonic.html", reference=stresses)
        assert "Turbulence intensity against reference" in page.read_text(encoding="utf-8")
