"""How long the app takes from a slider's move to the new figures: in the server, in the browser, and on the clock.

    python benchmarks/app_latency.py [MOVES]

Processor time does not depend on what else the machine does; the clock does. Needs the extra `app`, playwright and
chromium.
"""

import shutil
import statistics
import sys
import threading
import time
from collections.abc import Callable

from playwright.sync_api import sync_playwright

from bayes_rs.app.making import make_app
from bayes_rs.app.scan_page import ScanPage
from bayes_rs.app.server import serve
from bayes_rs.fits.settings import Settings

SLIDERS = ("opening_angle_deg", "n_beams", "duration", "wind_speed", "length_scale", "gamma", "uu")
_WATCH = """() => {
  window.moved = {};
  document.addEventListener('input', () => { window.moved = {at: performance.now()}; }, true);
  for (const id of ['widths', 'corner'])
    document.querySelector(`#${id} .js-plotly-plot`).on('plotly_afterplot', () => {
      if (window.moved.at) window.moved[id] = performance.now() - window.moved.at;
    });
}"""


def server_times() -> list[float]:
    """Have every answer of the page note its processor time, s."""
    times: list[float] = []

    def timed(answer: Callable[..., object]) -> Callable[..., object]:
        def noting(self: ScanPage, *values: object) -> object:
            began = time.thread_time()
            try:
                return answer(self, *values)
            finally:
                times.append(time.thread_time() - began)

        return noting

    for name in ("follow", "posterior"):
        setattr(ScanPage, name, timed(getattr(ScanPage, name)))
    return times


def main(moves: int) -> None:
    """Move every slider, and print medians and the largest values."""
    server = server_times()
    known = threading.Event()
    address: list[str] = []

    def began(place: str) -> None:
        address.append(place)
        known.set()

    site = make_app([], Settings())
    threading.Thread(target=serve, args=(site, 0, print, began), daemon=True).start()
    known.wait()
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(bypass_csp=True, viewport={"width": 1280, "height": 900})
        page.set_default_timeout(120_000)
        page.goto(f"{address[0]}scan")
        page.wait_for_selector("#corner .legend", state="attached")
        page.wait_for_timeout(20_000)  # the stresses of every Γ are made meanwhile
        page.evaluate(_WATCH)
        metrics = page.context.new_cdp_session(page)
        metrics.send("Performance.enable", {"timeDomain": "threadTicks"})
        print("slider              server CPU ms    browser CPU ms    widths ms    corner ms   (median, largest)")
        for name in SLIDERS:
            rows = []
            for _ in range(moves):
                del server[:]
                before = busy(metrics)
                page.focus(f"#{name}")
                page.keyboard.press("ArrowRight")
                page.wait_for_function("window.moved.widths && window.moved.corner")
                moved = page.evaluate("window.moved")
                page.wait_for_timeout(1500)  # presets in a new flow follow
                rows.append((1e3 * sum(server), 1e3 * (busy(metrics) - before), moved["widths"], moved["corner"]))
            shown = [f"{statistics.median(one):6.0f} {max(one):6.0f}" for one in zip(*rows, strict=True)]
            print(f"{name:20s}{'    '.join(shown)}", flush=True)
        browser.close()


def busy(metrics: object) -> float:
    """Return the processor time of the page's main thread, s."""
    found = metrics.send("Performance.getMetrics")["metrics"]  # type: ignore[attr-defined]
    return float(next(one["value"] for one in found if one["name"] == "TaskDuration"))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
