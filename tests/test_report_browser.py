"""The report in a real browser: pictures, zoom, addresses, keyboard, dark mode, narrow screens, a silent console."""

import json
import re
import shutil
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from report_scene import EVIL, evil_folder, result_folder, table_folder

from bayes_rs import open_fit, write_report
from bayes_rs.report import ranged_page
from bayes_rs.report.packing import pack_steps
from bayes_rs.result_folder import seal_folder

pytestmark = pytest.mark.slow
FILE_EVIL = EVIL.replace("/", "∕")
"""A name that tries to run as a script, as a file can have it."""
TIME_PANELS = 7
"""Turbulence intensity and the six stresses."""


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
        "fleet": with_turbines(Path(shutil.copytree(folder / "tables", folder / "fleet"))),
    }
    pages = {name: write_report(path, folder / f"{name}.html") for name, path in made.items()}
    mast = folder / f"{FILE_EVIL}.csv"
    ti = np.linspace(0.09, 0.16, 6)
    pd.DataFrame({"time": open_fit(full).time, "TI": ti, "U": np.linspace(9.0, 11.0, 6)}).to_csv(mast, index=False)
    other = shutil.copytree(full, folder / FILE_EVIL)
    return pages | {"compared": write_report(full, folder / "compared.html", reference=mast, beside=other, budget=True)}


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


def with_turbines(folder):
    """Give the first ten records to one turbine, and the others to one of a hostile name, at the same times."""
    first = 10
    records = xr.load_dataset(folder / "records.nc", engine="h5netcdf")
    start = records["time"].values.copy()
    start[first:] = start[0] + np.arange(len(start) - first) * np.timedelta64(600, "s")
    names = np.array(["T01"] * first + [EVIL] * (len(start) - first), dtype=object)
    records = records.assign_coords(time=("record", start)).assign(turbine=("record", names))
    (folder / "records.nc").unlink()
    records.to_netcdf(folder / "records.nc", engine="h5netcdf")
    for file in folder.glob("*/**/*.parquet"):
        rows = pd.read_parquet(file)
        rows["time"] = start[rows["record"].to_numpy()].astype(rows["time"].to_numpy().dtype)
        rows.to_parquet(file, index=False)
    seal_folder(folder)
    return folder


@contextmanager
def opening(browser, files):
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


@pytest.fixture
def open_page(browser, files):
    with opening(browser, files) as opened:
        yield opened


@pytest.fixture(scope="class")
def page(browser, files, name):
    """One page for the tests of a class."""
    with opening(browser, files) as opened:
        yield opened(name)


def paths(page, where="main"):
    return page.eval_on_selector_all(f"{where} svg path", "paths => paths.map(path => path.getAttribute('d'))")


def corner_drawing(page):
    return "".join(paths(page, "[data-figure=corner]"))


ALL = ("full", "one", "flagged", "untimed", "evil", "tables", "draws", "gaps", "compared")


@pytest.mark.parametrize("name", ALL, scope="class")
class TestEveryPage:
    def test_everything_is_drawn_at_finite_places(self, page, name):
        drawn = paths(page)
        assert len(drawn) > 20 or name == "flagged"
        for d in drawn:
            assert re.fullmatch(r"(?:[MLHVhvlaZ]|-?\d+(?:\.\d+)?|[ ])*", d), d
        content = page.eval_on_selector_all("main svg", "all => all.map(one => one.outerHTML).join('')")
        assert not re.search(r"NaN|undefined|Infinity|null", content)

    def test_every_picture_has_a_name_and_a_table(self, page):
        pictures = page.eval_on_selector_all(
            "main svg",
            "all => all.map(one => [one.getAttribute('role'),"
            " document.getElementById(one.getAttribute('aria-labelledby'))?.textContent.trim()])",
        )
        assert all(role == "img" and named for role, named in pictures), pictures
        figures = page.eval_on_selector_all(
            "figure",
            "all => all.map(one => [one.querySelectorAll('svg').length, one.querySelectorAll('table').length,"
            " one.querySelector('figcaption')?.textContent.trim()])",
        )
        assert figures
        assert all(n_svg >= 1 and n_table >= 1 and caption for n_svg, n_table, caption in figures), figures

    def test_the_page_is_never_wider_than_the_screen(self, page):
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


def span_of(page):
    return page.locator("#span").text_content()


def ticks_of(page, panel="uu"):
    return page.locator(f"[data-figure=stresses] svg[data-panel={panel}] text[text-anchor=middle]").all_text_contents()


def settled(page):
    """Wait for the frame in which the panels are drawn anew."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def drag(page, panel, start, end):
    where = page.locator(f"[data-figure=stresses] svg[data-panel={panel}]")
    where.scroll_into_view_if_needed()
    box = where.bounding_box()
    height = box["y"] + box["height"] / 2
    left, width = box["x"] + 46, box["width"] - 64
    page.mouse.move(left + start * width, height)
    page.mouse.down()
    page.mouse.move(left + 0.5 * (start + end) * width, height)
    page.mouse.move(left + end * width, height)
    page.mouse.up()
    settled(page)


class TestZoom:
    def test_a_brush_shows_that_part_in_all_panels_with_its_own_ticks(self, open_page):
        page = open_page("full")
        before = ticks_of(page)
        drag(page, "uw", 0.5, 1.0)  # the last half hour of an hour
        assert span_of(page) == "2000-01-01 00:30 to 2000-01-01 01:00 UTC"
        for panel in ("ti", "uu", "vw"):
            words = ticks_of(page, panel)
            assert words != before
            assert words[0] == "00:30"
            assert "00:10" not in words
        below = page.locator("[data-figure=availability] svg text[text-anchor=middle]").all_text_contents()
        assert "00:30" in below
        assert "00:10" not in below

    def test_two_clicks_and_the_button_show_all_again(self, open_page):
        page = open_page("full")
        for back in (lambda: page.locator("svg[data-panel=uu]").dblclick(), lambda: page.click("#all")):
            drag(page, "uu", 0.0, 0.5)
            assert not span_of(page).endswith("(all)")
            back()
            settled(page)
            assert span_of(page).endswith("(all)")

    def test_the_keyboard_moves_and_zooms(self, open_page):
        page = open_page("full")
        page.locator("#strip").focus()
        page.keyboard.press("+")
        settled(page)
        assert span_of(page) == "2000-01-01 00:15 to 2000-01-01 00:45 UTC"
        page.keyboard.press("ArrowRight")
        settled(page)
        assert span_of(page) == "2000-01-01 00:22:30 to 2000-01-01 00:52:30 UTC"
        assert page.get_attribute("#strip", "aria-valuetext") == span_of(page)
        page.keyboard.press("Home")
        settled(page)
        assert span_of(page) == "2000-01-01 00:00 to 2000-01-01 00:30 UTC"
        page.keyboard.press("Escape")
        settled(page)
        assert span_of(page).endswith("(all)")

    def test_two_fingers_stretch_and_one_brushes(self, open_page):
        page = open_page("full", has_touch=True)
        page.locator("svg[data-panel=uu]").evaluate(
            """svg => {
              const box = svg.getBoundingClientRect();
              const at = (share) => box.x + 46 + share * (box.width - 64);
              const fire = (kind, pointerId, share) => svg.dispatchEvent(new PointerEvent(kind, {
                bubbles: true, pointerId, pointerType: "touch", clientX: at(share), clientY: box.y + 80, button: 0,
              }));
              const holder = svg.parentElement;
              holder.setPointerCapture = () => {};  // these pointers are none of the browser's
              fire("pointerdown", 1, 0.35);
              fire("pointerdown", 2, 0.65);
              fire("pointermove", 1, 0.2);
              fire("pointermove", 2, 0.8);
              fire("pointerup", 1, 0.2);
              fire("pointerup", 2, 0.8);
            }"""
        )
        settled(page)
        assert span_of(page) == "2000-01-01 00:15 to 2000-01-01 00:45 UTC"
        assert page.locator("[data-figure=stresses]").evaluate("e => getComputedStyle(e).touchAction") == "pan-y"

    def test_a_chosen_record_comes_into_sight(self, open_page):
        page = open_page("full")
        drag(page, "uu", 0.0, 0.5)
        page.select_option("#pick", index=5)
        settled(page)
        assert "00:50" in ticks_of(page) or span_of(page).endswith("01:00 UTC")


class TestAddress:
    def test_it_opens_a_record_and_follows_the_choice(self, open_page):
        page = open_page("full")
        url = page.url
        page.goto(f"{url}#2000-01-01T00:30")
        page.reload()
        assert page.input_value("#pick") == "3"
        page.evaluate("location.hash = '#2000-01-01T00:15'")  # within the second record
        page.wait_for_function("document.getElementById('pick').value === '1'")
        page.click("#next")
        page.click("#next")
        page.click("#next")
        assert page.evaluate("location.hash") == "#2000-01-01T00:40"
        page.evaluate("location.hash = '#record-0'")
        page.wait_for_function("document.getElementById('pick').value === '0'")

    @pytest.mark.parametrize(
        ("hash_", "words"),
        [
            (
                "#2001-01-01T00:00",
                "No record here holds 2001-01-01 00:00 UTC; the nearest begins at 2000-01-01 00:50 UTC.",
            ),
            ("#T07/2000-01-01T00:00", "There is no turbine T07 in this page."),
            ("#record-99", "There is no record 99 in this page."),
            ("#<img src=x onerror=alert(1)>", "neither a section nor a record"),
            ("#%E0%A4%A", "neither a section nor a record"),
        ],
    )
    def test_a_wrong_one_is_told_in_one_line(self, open_page, hash_, words):
        page = open_page("full")
        page.evaluate("hash => { location.hash = hash; }", hash_)
        page.wait_for_function("!document.getElementById('address').hidden")
        assert words in page.locator("#address").text_content()
        assert page.locator("img").count() == 0
        page.click("#next")
        assert page.locator("#address").is_hidden()

    def test_links_to_sections_still_work(self, open_page):
        page = open_page("full")
        page.click('nav a[href="#shape"]')
        assert page.evaluate("location.hash") == "#shape"
        assert page.locator("#address").is_hidden()
        assert page.locator("#shape").evaluate("e => Math.abs(e.getBoundingClientRect().top) < innerHeight")


class TestFleet:
    def test_a_turbine_is_chosen_by_list_and_by_address(self, open_page):
        page = open_page("fleet")
        page.select_option("#turbine", label=EVIL)
        settled(page)
        assert span_of(page) == f"{EVIL}, 2020-01-01 00:00 to {EVIL}, 2020-01-01 02:00"
        page.evaluate("name => { location.hash = `#${encodeURIComponent(name)}/2020-01-01T00:50`; }", EVIL)
        page.wait_for_function("document.getElementById('pick').value === '15'")
        page.evaluate("location.hash = '#T01/2020-01-01T00:50'")
        page.wait_for_function("document.getElementById('pick').value === '5'")
        settled(page)
        assert page.locator("#turbine").evaluate("e => e.selectedOptions[0].textContent") == "T01"
        page.click("#next")
        assert page.evaluate("location.hash") == "#T01/2020-01-01T01:00"
        assert page.title() != "broken"

    def test_nothing_joins_two_turbines(self, open_page):
        """The last record of one and the first of the next stand side by side, and hours apart."""
        page = open_page("fleet")
        data = json.loads(page.locator("#data").text_content())
        median, priors = data["series"]["median"][0], data["series"]["priors"][0]
        runs, last = 0, None
        for k, value in enumerate(median):
            known = value is not None
            runs += known and (last is None or k == 10 or priors[k] != priors[k - 1])
            last = value
        line = page.eval_on_selector_all(
            "svg[data-panel=uu] path.middle", "all => all.map(one => one.getAttribute('d')).join('')"
        )
        assert line.count("M") == runs


class TestPriors:
    def test_what_is_the_priors_is_hatched_and_told(self, open_page):
        page = open_page("full")
        data = json.loads(page.locator("#data").text_content())
        for name, priors in zip(data["stresses"], data["series"]["priors"], strict=True):
            panel = page.locator(f"[data-figure=stresses] svg[data-panel={name}]")
            known = [one for one, middle in zip(priors, data["series"]["median"][0], strict=True) if middle is not None]
            assert (panel.locator("path.band.priors").count() > 0) == any(known)
            assert (panel.locator("path.band:not(.priors)").count() > 0) == (not all(known))
            assert ("mostly the prior's" in panel.text_content()) == any(known)
        assert {0, 1} <= {one for priors in data["series"]["priors"] for one in priors}
        band = page.locator("[data-figure=stresses] path.band.priors").first
        assert "hatch" in band.evaluate("e => getComputedStyle(e).fill")

    def test_the_priors_band_is_that_of_its_shape_at_the_size(self, open_page):
        """The script's own interpolation at a record, against the numbers that the page was given."""
        page = open_page("full")
        data = json.loads(page.locator("#data").text_content())
        nodes = data["room"]
        assert len(nodes["spread"]) == len(nodes["low"][0])
        assert np.all(np.asarray(nodes["high"]) > np.asarray(nodes["low"]))
        room = np.array(data["series"]["room"], dtype=float)
        assert room.shape == (2, 6, 6)
        assert np.isnan(room[:, :, 2]).all()  # not fitted


class TestBesides:
    def test_both_fits_and_the_reference_are_drawn(self, open_page):
        page = open_page("compared")
        assert page.locator("[data-figure=beside] svg").count() == 6
        assert page.locator("[data-figure=acceptance] svg").count() == 4
        assert page.locator("[data-figure=stresses] svg[data-panel=ti] path.reference").count() == 1
        assert page.locator("[data-figure=stresses] path.reference").count() == 1
        drag(page, "uu", 0.5, 1.0)
        words = page.locator("[data-figure=beside] svg").first.locator("text[text-anchor=middle]").all_text_contents()
        assert words[0] == "00:30"

    def test_hostile_names_stay_texts(self, open_page):
        page = open_page("compared")
        assert page.title() != "broken"
        assert page.locator("#beside").get_by_text(FILE_EVIL).count() >= 1
        assert page.locator("#campaign").get_by_text(FILE_EVIL).count() >= 1
        assert page.locator("main script").count() == 0

    @pytest.mark.parametrize("scheme", ["light", "dark"])
    def test_the_page_is_never_wider_than_a_phone(self, open_page, scheme):
        page = open_page("compared", width=390, color_scheme=scheme)
        page.eval_on_selector_all("details", "all => all.forEach(one => { one.open = true; })")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390

    def test_it_prints_all_its_pictures(self, open_page):
        page = open_page("compared", color_scheme="dark")
        page.emulate_media(media="print")
        assert not page.locator("#strip").is_visible()
        assert page.locator("[data-figure=beside] svg").first.is_visible()
        assert len(page.pdf()) > 10_000


def test_a_profile_follows_the_record_and_so_do_the_links(browser, tmp_path):
    """The page of ranges, from a small stand-in for its data: the fit itself is tested with the fits."""
    names = ("ti", "uu", "vv", "ww", "uv", "uw", "vw")
    values = np.random.default_rng(1).uniform(0.2, 1.0, (3, len(names), 2, 3))
    start = 946_684_800_000.0 + 6e5 * np.arange(3)
    whole = {name: [0.5, 0.6] for name in ("estimate", "low", "high")} | {"priors": [0, 1]}
    records = {
        "n": 3,
        "number": pack_steps(np.arange(3)),
        "time": pack_steps(start),
        "rows": ranged_page.pack_rows(values),
        "priors": ranged_page.pack(np.zeros((3, 2), dtype=np.int64), "u1"),
    }
    data = {
        "prob": 0.9,
        "interval": "equal-tailed",
        "duration": 6e5,
        "profile": {
            "upright": False, "place": [52.0, 98.0], "quantities": names, "of": "campaign", "all": [whole] * 7,
            "records": records,
        },
    }  # fmt: skip
    options = '<select id="pick"><option value="-1">all</option>' + "".join(
        f'<option value="{k}">{k}</option>' for k in range(3)
    )
    buttons = '<button id="previous">p</button><button id="next">n</button>'
    content = f"{options}</select>{buttons}" + ranged_page.figure("profile", "", '<div id="profile-table"></div>')
    link = '<a href="range-52m/report.html" data-page="range-52m/report.html">52 m</a>'
    sections = [("profile", "Profile", content), ("ranges", "Ranges", link)]
    file = tmp_path / "ranges.html"
    file.write_text(ranged_page.framed("t", "", sections, data, ranged_page.RANGES_SCRIPTS), encoding="utf-8")
    page = browser.new_page()
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    stamp = np.datetime_as_string(np.datetime64(int(start[2]), "ms"), unit="m")
    page.goto(f"{file.as_uri()}#{stamp}")
    assert page.locator("[data-figure=profile] svg").count() == len(names)
    assert page.input_value("#pick") == "2"
    assert page.get_attribute("a[data-page]", "href") == f"range-52m/report.html#{stamp}"
    row = page.locator("#profile-table tbody tr").nth(1).locator("td").nth(1).text_content()
    shown = [float(one) for one in re.findall(r"[\d.]+", row)]
    np.testing.assert_allclose(shown, values[2, 1, 1], atol=1e-3)
    page.click("#previous")
    assert page.input_value("#pick") == "1"
    page.select_option("#pick", "-1")
    assert page.get_attribute("a[data-page]", "href") == "range-52m/report.html"
    assert page.locator("[data-figure=profile] path.point.priors").count() == len(names)
    assert said == []
    page.close()


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
