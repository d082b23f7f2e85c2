"""Fixtures that several test files share."""

import shutil
import warnings
from functools import partial
from pathlib import Path

import pytest

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


@pytest.fixture(scope="session")
def iea_folder() -> Path:
    """Folder of the measured nacelle-lidar data, which may not be copied into the project."""
    folder = Path(__file__).parents[1].parent / "shared" / "data" / "iea-round-robin"
    if not folder.is_dir():
        pytest.skip(f"NOT TESTED ON MEASURED DATA: no folder {folder}, see ../shared/data/iea-round-robin/README.md")
    return folder


@pytest.fixture(scope="session")
def six_beam_hour() -> Path:
    """File of the measured hour of a six-beam scan, which is not copied into the project."""
    folder = Path(__file__).parents[1].parent / "shared" / "data" / "six-beam-hour"
    if not folder.is_dir():
        pytest.skip(f"NOT TESTED ON MEASURED DATA: no folder {folder}, see ../shared/data/six-beam-hour/README.md")
    return folder / "wls200s_sixbeam_20210513T12.nc"


@pytest.fixture(scope="session")
def dbs_folder() -> Path:
    """Folder of measured DBS files whose ranges are in another order than their rays; not copied into the project."""
    folder = Path(__file__).parents[1].parent / "shared" / "data" / "dbs-2021-07-01"
    if not folder.is_dir():
        pytest.skip(f"NOT TESTED ON MEASURED DATA: no folder {folder}, see ../shared/data/dbs-2021-07-01/README.md")
    return folder


@pytest.fixture
def no_groups_file(monkeypatch):
    """Let fits in a folder write no `posterior.nc`, which takes half of the time of a small one.

    It holds what the tables hold, once more; `test_road.py` compares it with them.
    """
    monkeypatch.setattr("bayes_rs.fits.fit_writing.MOST_KEPT", 0)


@pytest.fixture
def no_pictures(monkeypatch, no_groups_file):  # noqa: ARG001 - nor that
    """Let the command `fit` draw no pictures, which take half of the time of a small fit, and write no groups."""
    monkeypatch.setattr("bayes_rs.cli.fit_commands.draw_pictures", lambda *_args, **_options: None)


@pytest.fixture
def short_campaign(monkeypatch):
    """A campaign is sampled shortly: what is tested is the way of its numbers."""
    from bayes_rs.campaign import sampling  # noqa: PLC0415 - not for every test
    from bayes_rs.fits import campaign_job  # noqa: PLC0415

    monkeypatch.setattr(sampling, "_BURN_IN", (10, 10))
    few = partial(campaign_job.sample_campaign, target_ess=10, most_sweeps=20)
    monkeypatch.setattr(campaign_job, "sample_campaign", few)


@pytest.fixture(scope="session")
def arviz():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ announces its own refactoring when it is imported
        import arviz  # noqa: PLC0415 - slow to load
    return arviz


@pytest.fixture(scope="module")
def browser():
    """A headless browser with an empty profile of its own."""
    found = next((path for path in map(shutil.which, BROWSERS) if path), None)
    if found is None:
        pytest.skip(f"NOT TESTED IN A BROWSER: none of {', '.join(BROWSERS)} is on PATH; apt-get install chromium")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="NOT TESTED IN A BROWSER: playwright is not installed; pip install playwright"
    )
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield opened
        opened.close()
