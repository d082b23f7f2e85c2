"""The app in a real browser: sliders, pictures, names that try to be more than text, and no word on the console."""

import re
import shutil
import threading

import pytest
from report_scene import result_folder

pytest.importorskip("dash", reason="NOT TESTED: dash is not installed; pip install 'bayes_rs[app]'")

import bayes_rs as brs
from bayes_rs.app.making import make_app
from bayes_rs.app.server import serve
from bayes_rs.fits.settings import Settings

pytestmark = pytest.mark.slow
EVIL = "<img src=x onerror=\"document.title='broken'\">.parquet"
PATIENCE = 120_000
"""Milliseconds that a loaded machine may take for an answer."""


class _EndError(Exception):
    pass


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """The app with a fit and a file with a hostile name, served by a thread; it ends with the module."""
    folder = tmp_path_factory.mktemp("start")
    result_folder(folder / "hour", n_record=3)
    shutil.copy(brs.demo_file("6-beam-45"), folder / EVIL)
    site = make_app([folder], Settings().changed(scan="6-beam", opening_angle_deg=45.0, focus_distance=[52.0]))
    found, known, end = [], threading.Event(), threading.Event()

    def began(place):
        found.append(place)
        known.set()
        end.wait()
        raise _EndError

    def run():
        with pytest.raises(_EndError):
            serve(site, 0, str, began)

    thread = threading.Thread(target=run)
    thread.start()
    assert known.wait(60)
    yield found[0]
    end.set()
    thread.join(60)


@pytest.fixture
def open_page(browser, address):
    """Give a function that opens a page; nothing may be said on the console, or asked for elsewhere."""
    said, asked, contexts = [], [], []

    def opened(path, **options):
        context = browser.new_context(viewport={"width": 1280, "height": 900}, **options)
        context.set_default_timeout(PATIENCE)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(address + path)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []
    assert [url for url in asked if not url.startswith((address, "data:", "blob:"))] == []
    assert len(asked) > 10  # it would have been seen


def until(page, so):
    """Wait until something is so: charts follow a moment after what is asked of them."""
    for _ in range(PATIENCE // 100):
        if so():
            return
        page.wait_for_timeout(100)
    raise AssertionError("it never was so")


def fits(page, widths):
    page.eval_on_selector_all("details", "all => all.forEach(one => { one.open = true; })")
    for width in widths:
        page.set_viewport_size({"width": width, "height": 844})
        until(page, lambda width=width: page.evaluate("document.documentElement.scrollWidth") <= width)


def test_sliders_change_widths_and_corner(open_page):
    page = open_page("scan", color_scheme="dark")
    page.wait_for_selector("#corner .legend", state="attached")
    names = page.locator("#widths .legendtext")
    names.get_by_text("50-beam").wait_for(state="attached")  # the presets follow the first answer
    assert names.all_text_contents()[1:3] == ["4-beam", "50-beam"]
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(21, 24, 28)"
    assert page.locator("#value-opening_angle_deg").text_content() == "30°"

    def drawn():
        figures = [page.locator(f"#{name} .scatterlayer").inner_html() for name in ("widths", "corner")]
        return [*figures, page.locator("#numbers").text_content()]

    before = drawn()
    slider = page.get_by_label("Half-cone opening angle")
    slider.focus()
    for _ in range(15):
        page.keyboard.press("ArrowRight")
    page.locator("#value-opening_angle_deg", has_text="45°").wait_for()
    page.locator("#found", has_text=re.compile(r"^4\.\d of 6 stresses learnt")).wait_for()
    until(page, lambda: all(one != other for one, other in zip(before, drawn(), strict=True)))
    for content in drawn()[:2]:
        assert not re.search(r"NaN|undefined|Infinity", content)
    page.get_by_label("Beams, all").focus()
    page.keyboard.press("Home")
    page.get_by_role("alert").get_by_text("with a beam along the axis there are at least 2").wait_for()
    fits(page, (390, 320))


def test_a_fit_and_a_hostile_name(open_page):
    from playwright.sync_api import expect  # noqa: PLC0415 - where there is a browser

    page = open_page("")
    page.locator("#place").click()
    page.get_by_text(EVIL, exact=True).click()
    page.get_by_role("heading", name=EVIL).wait_for()
    page.wait_for_selector("#record-spectra[src^='data:image/png']")
    page.get_by_label("Or a path below it").fill("../elsewhere")
    page.get_by_role("button", name="Open", exact=True).click()
    page.get_by_role("alert").get_by_text("'../elsewhere' is not below").wait_for()
    page.get_by_label("Or a path below it").fill("hour")
    page.get_by_role("button", name="Open", exact=True).click()
    page.get_by_role("heading", name="hour", exact=True).wait_for()
    page.wait_for_selector("#record-corner[src^='data:image/png']")
    page.wait_for_selector("#series[src^='data:image/png']")
    expect(page.locator("dl.found dt")).to_have_text(["found", "decided", "doubtful"])
    page.locator("#availability .heatmaplayer image").wait_for(state="attached")
    first = page.locator("#record-table").text_content()
    page.get_by_label("Record", exact=True).focus()
    page.keyboard.press("ArrowRight")
    page.locator("#record-name", has_text="record 1").wait_for()
    expect(page.locator("#record-table")).not_to_have_text(first, timeout=PATIENCE)
    page.keyboard.press("ArrowRight")  # the third was not fitted
    page.get_by_role("alert").get_by_text("Record 2 was not fitted").wait_for()
    assert page.title() == "bayes-rs"
    assert page.locator("main img[src='x']").count() == 0
    fits(page, (390, 320))
