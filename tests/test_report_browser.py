"""The report in a real browser: pictures, picker, keyboard, dark mode, narrow screens, and no word on the console."""

import json
import re
import shutil
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from report_scene import EVIL, evil_folder, result_folder, table_folder

from bayes_rs import write_report
from bayes_rs.result_folder import seal_folder

pytestmark = pytest.mark.slow
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
TIME_PANELS = 7
"""Turbulence intensity and the six stresses."""


@pytest.fixture(scope="module")
def browser():
    found = next((path for path in map(shutil.which, BROWSERS) if path), None)
    if found is None:
        pytest.skip(f"NOT TESTED IN A BROWSER: none of {', '.join(BROWSERS)} is on PATH; apt-get install chromium")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="NOT TESTED IN A BROWSER: playwright is not installed; pip install playwright"
    )
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=found, args=ARGUMENTS)  # with an empty profile of its own
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Pages of all kinds of folders, by their names."""
    folder = tmp_path_factory.mktemp("pages")
    full, one = result_folder(folder / "full"), result_folder(folder / "one", n_record=1)
    made = {
        "full": full,
        "one": one,
        "flagged": result_folder(folder / "flagged", flagged=True),
        "untimed": result_folder(folder / "untimed", timed=False),
        "evil": evil_folder(folder / "evil", one),
        "tables": table_folder(folder / "tables"),
        "draws": table_folder(folder / "draws", draws="float32"),
        "gaps": with_gaps(Path(shutil.copytree(full, folder / "gaps"))),
    }
    return {name: write_report(path, folder / f"{name}.html") for name, path in made.items()}


def with_gaps(folder):
    """Leave numbers out: wind speeds, and diagnostics of a record."""
    records = xr.load_dataset(folder / "records.nc", engine="h5netcdf")
    records["wind_speed"].values[[0, 3]] = np.nan
    (folder / "records.nc").unlink()
    records.to_netcdf(folder / "records.nc", engine="h5netcdf")
    (part,) = folder.glob("posterior/**/*.parquet")
    rows = pd.read_parquet(part)
    rows.loc[1, "misfit"] = np.nan
    rows.to_parquet(part, index=False)
    seal_folder(folder)
    return folder


@pytest.fixture
def open_page(browser, files):
    """Give a function that opens a page; at the end, nothing may have been said or asked for on the way."""
    said, asked, contexts = [], [], []

    def opened(name, *, width=1200, **options):
        context = browser.new_context(viewport={"width": width, "height": 900}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(files[name].as_uri())
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []
    assert [url for url in asked if not url.startswith(("file://", "data:"))] == []
    assert len(asked) >= len(contexts)  # the pages themselves: it would have been seen


def paths(page, where="main"):
    return page.eval_on_selector_all(f"{where} svg path", "paths => paths.map(path => path.getAttribute('d'))")


def corner_drawing(page):
    return "".join(paths(page, "[data-figure=corner]"))


ALL = ("full", "one", "flagged", "untimed", "evil", "tables", "draws", "gaps")


@pytest.mark.parametrize("name", ALL)
class TestEveryPage:
    def test_everything_is_drawn_at_finite_places(self, open_page, name):
        page = open_page(name)
        drawn = paths(page)
        assert len(drawn) > 20 or name == "flagged"
        for d in drawn:
            assert re.fullmatch(r"(?:[MLHVhvlaZ]|-?\d+(?:\.\d+)?|[ ])*", d), d
        content = page.eval_on_selector_all("main svg", "all => all.map(one => one.outerHTML).join('')")
        assert not re.search(r"NaN|undefined|Infinity|null", content)

    def test_every_picture_has_a_name_and_a_table(self, open_page, name):
        page = open_page(name)
        pictures = page.locator("main svg").all()
        for picture in pictures:
            assert picture.get_attribute("role") == "img"
            named = picture.get_attribute("aria-labelledby")
            assert page.locator(f"#{named}").text_content().strip()
        for figure in page.locator("figure").all():
            assert figure.locator("svg").count() >= 1
            assert figure.locator("table").count() >= 1
            assert figure.locator("figcaption").text_content().strip()

    def test_the_page_is_never_wider_than_the_screen(self, open_page, name):
        page = open_page(name, width=320)
        page.eval_on_selector_all("details", "all => all.forEach(one => { one.open = true; })")
        for width in (320, 360, 768):
            page.set_viewport_size({"width": width, "height": 800})
            assert page.evaluate("document.documentElement.scrollWidth") <= width


class TestPictures:
    def test_there_are_as_many_as_there_are_data_for(self, open_page):
        page = open_page("full")
        counts = {
            figure: page.locator(f"[data-figure={figure}] svg").count()
            for figure in ("availability", "stresses", "decided", "intensity", "corner", "shape", "diagnostics")
        }
        assert counts.pop("diagnostics") >= 3
        assert counts.pop("stresses") == TIME_PANELS
        assert set(counts.values()) == {1}

    def test_a_corner_has_fifteen_clouds_and_six_histograms(self, open_page):
        page = open_page("full")
        assert page.locator("[data-figure=corner] path.dot.draws").count() == 15
        assert page.locator("[data-figure=corner] path.band").count() == 6
        assert page.locator("[data-figure=corner] path.band.priors").count() == 4
        assert page.locator("[data-figure=corner] path.prior").count() == 21

    def test_without_draws_a_corner_has_ellipses(self, open_page):
        page = open_page("tables")
        assert page.locator("[data-figure=corner] path.draws").count() == 0
        assert page.locator("[data-figure=corner] path.band").count() == 21
        assert "Gaussian" in page.locator("#corner-words").text_content()

    def test_the_prior_is_drawn_with_and_without_draws(self, open_page):
        page = open_page("tables")
        assert page.locator("[data-figure=corner] path.prior").count() == 21
        assert "prior at the posterior's size" in page.locator("#corner-words").text_content()

    def test_the_picture_holds_the_numbers(self, open_page):
        """The median's line of uu against the axis: its ticks say where the numbers are."""
        page = open_page("full")
        panel = page.locator("[data-figure=stresses] svg[data-panel=uu]")
        ticks = panel.evaluate(
            "svg => [...svg.querySelectorAll('text[text-anchor=end]')]"
            ".map(tick => [tick.textContent, +tick.getAttribute('y') - 4])"
        )
        ticks = [(float(words.replace("−", "-")), y) for words, y in ticks if re.fullmatch(r"−?[\d.]+", words)]
        (one, at_one), (other, at_other) = ticks[0], ticks[-1]
        line = panel.locator("path.middle").get_attribute("d")
        assert line.count("M") == 2  # a gap where record 2 was not fitted
        drawn = [float(y) for _, y in re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", line)]
        data = json.loads(page.locator("#data").text_content())
        expected = [value for value in data["series"]["median"][0] if value is not None]
        found = [one + (y - at_one) * (other - one) / (at_other - at_one) for y in drawn]
        # places are rounded to 0.01 of about 100 pixels
        assert found == pytest.approx(expected, abs=2e-4 * abs(other - one) + 1e-3)

    def test_a_failed_record_is_marked(self, open_page):
        page = open_page("full")
        assert page.locator("[data-figure=stresses] path.failed").count() == TIME_PANELS
        assert page.locator("[data-figure=stresses] path.remarked").count() == TIME_PANELS

    def test_a_day_without_a_fit_says_so(self, open_page):
        page = open_page("flagged")
        assert page.locator("[data-figure=corner]").count() == 0
        assert "No record was fitted" in page.locator("#stresses").text_content()

    def test_pictures_follow_the_width(self, open_page):
        page = open_page("full")
        before = page.locator("[data-figure=corner] svg").get_attribute("viewBox")
        page.set_viewport_size({"width": 360, "height": 800})
        page.wait_for_function(
            "before => document.querySelector('[data-figure=corner] svg').getAttribute('viewBox') !== before",
            arg=before,
        )


class TestPicker:
    def test_a_list_changes_the_picture(self, open_page):
        page = open_page("full")
        before = corner_drawing(page)
        page.select_option("#pick", index=3)
        assert corner_drawing(page) != before
        assert ", record 3;" in page.locator("#chosen").text_content()

    def test_arrow_keys_change_the_picture(self, open_page):
        page = open_page("full")
        before = corner_drawing(page)
        page.locator("#pick").focus()
        page.keyboard.press("ArrowDown")
        assert corner_drawing(page) != before
        assert ", record 1;" in page.locator("#chosen").text_content()

    def test_buttons_by_mouse_and_by_keyboard(self, open_page):
        page = open_page("full")
        page.click("#next")
        assert page.input_value("#pick") == "1"
        page.locator("#previous").focus()
        page.keyboard.press("Enter")
        page.keyboard.press("Enter")
        assert page.input_value("#pick") == "0"
        page.click("#next-flagged")
        assert page.input_value("#pick") == "2"

    def test_a_record_that_was_not_fitted_says_why(self, open_page):
        page = open_page("full")
        page.select_option("#pick", index=2)
        assert "This record was not fitted: no_usable_beam." in page.locator("[data-figure=corner]").text_content()

    def test_a_click_on_a_panel_chooses_the_record_there(self, open_page):
        page = open_page("full")
        panel = page.locator("[data-figure=stresses] svg").nth(4)
        size = panel.bounding_box()
        panel.click(position={"x": size["width"] - 30, "y": size["height"] / 2})
        assert page.input_value("#pick") == "5"

    def test_the_pointer_reads_the_values(self, open_page):
        page = open_page("full")
        page.locator("[data-figure=stresses] svg[data-panel=uu]").hover(position={"x": 60, "y": 60})
        words = page.locator("[data-figure=stresses] svg[data-panel=uu] .readout").text_content()
        written = page.locator("#stresses details tbody tr").first.locator("td").nth(1).text_content()
        # the script has whole steps of 1.5e-5 of a record's largest number: a last digit may be the next one
        shown, table = (re.findall(r"[\d.]+", one) for one in (words.rpartition(": ")[2], written))
        assert len(shown) == 3
        for one, other in zip(shown, table, strict=True):
            assert abs(Decimal(one) - Decimal(other)) <= Decimal(1).scaleb(Decimal(other).as_tuple().exponent)

    def test_the_table_beneath_is_that_of_the_chosen_record(self, open_page):
        page = open_page("full")
        page.select_option("#pick", index=4)
        cells = page.locator("#chosen-table tbody tr").first.locator("td").all_text_contents()
        written = page.locator("#stresses details tbody tr").nth(4).locator("td").nth(1).text_content()
        assert f"{cells[0]} ({cells[1]} to {cells[2]})" == written

    def test_the_tab_key_meets_the_picker_in_its_order(self, open_page):
        page = open_page("full")
        met = []
        for _ in range(60):
            page.keyboard.press("Tab")
            met.append(page.evaluate("document.activeElement.id || document.activeElement.className"))
        assert met[0] == "skip"
        places = [met.index(name) for name in ("previous", "pick", "next", "next-flagged")]
        assert places == sorted(places)

    def test_the_skip_link_leads_to_the_results(self, open_page):
        page = open_page("full")
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.id") == "main"

    def test_records_are_chosen_by_time_where_there_are_many(self, open_page, files, monkeypatch, tmp_path):
        from bayes_rs.report import record_section as module  # noqa: PLC0415 - slow to load

        monkeypatch.setattr(module, "MOST_OPTIONS", 2)
        files["by time"] = write_report(files["full"].parent / "full", tmp_path / "page.html")
        page = open_page("by time")
        assert page.get_attribute("#pick", "type") == "datetime-local"
        first = page.input_value("#pick")
        page.click("#next")
        second = page.input_value("#pick")
        assert second != first
        before = corner_drawing(page)
        page.fill("#pick", first)
        page.locator("#pick").blur()
        assert corner_drawing(page) != before
        assert ", record 0;" in page.locator("#chosen").text_content()


class TestLook:
    def test_dark_mode_changes_page_and_pictures(self, open_page):
        colours = {}
        for scheme in ("light", "dark"):
            page = open_page("full", color_scheme=scheme)
            colours[scheme] = [
                page.evaluate("getComputedStyle(document.body).backgroundColor"),
                page.locator("[data-figure=stresses] path.band").first.evaluate("e => getComputedStyle(e).fill"),
                page.locator("[data-figure=corner] path.middle").first.evaluate("e => getComputedStyle(e).stroke"),
                page.locator("[data-figure=shape] text").first.evaluate("e => getComputedStyle(e).fill"),
            ]
        assert all(one != other for one, other in zip(colours["light"], colours["dark"], strict=True))

    def test_it_prints_dark_on_white_whatever_the_screen(self, open_page):
        page = open_page("full", color_scheme="dark")
        page.emulate_media(media="print")
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert not any(one.is_visible() for one in page.locator(".picker, .window").all())
        page.set_viewport_size({"width": 700, "height": 1000})  # A4 between its margins
        assert page.evaluate("document.documentElement.scrollWidth") <= 700
        assert page.locator("[data-figure=corner] svg").is_visible()

    @pytest.mark.parametrize("scheme", ["light", "dark"])
    def test_texts_stand_out_from_the_paper(self, open_page, scheme):
        """Contrast of at least 4.5, as WCAG 2 asks of normal text."""
        page = open_page("full", color_scheme=scheme)
        variables = page.evaluate(
            "['paper', 'raised', 'ink', 'quiet', 'link'].map(n => getComputedStyle(document.documentElement)"
            ".getPropertyValue(`--${n}`).trim())"
        )
        paper, raised, *inks = [luminance(colour) for colour in variables]
        for ink in inks:
            for ground in (paper, raised):
                assert (max(ink, ground) + 0.05) / (min(ink, ground) + 0.05) >= 4.5

    def test_without_scripts_the_tables_are_there(self, open_page):
        page = open_page("full", java_script_enabled=False)
        assert page.locator("noscript").count() == 1
        assert page.locator("main table").count() >= 8


def luminance(colour):
    """Relative luminance of #rrggbb, WCAG 2."""
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


def test_texts_of_files_run_nothing(open_page):
    page = open_page("evil")
    assert page.title() != "broken"
    assert page.locator("img").count() == 0
    assert page.locator("#provenance").get_by_text(EVIL).count() >= 1


def test_a_script_that_is_put_in_afterwards_does_not_run(browser, files, tmp_path):
    """The policy refuses it: the check that this file's other tests would notice a policy that does nothing."""
    text = files["one"].read_text(encoding="utf-8")
    (tmp_path / "page.html").write_text(text.replace("</main>", "<script>document.title = 'broken'</script></main>"))
    page = browser.new_page()
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.goto((tmp_path / "page.html").as_uri())
    assert page.title() != "broken"
    assert any("Content Security Policy" in text for text in said)
    page.close()
