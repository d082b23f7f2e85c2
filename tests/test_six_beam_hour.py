"""The measured hour of a six-beam scan: what docs/six-beam-hour.md says of it."""

import importlib.util
from pathlib import Path

import pytest

import bayes_rs as brs

ROOT = Path(__file__).parents[1]
NAMES = {"uu": "northward", "vv": "eastward", "ww": "vertical"}


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("six_beam_hour", ROOT / "benchmarks" / "six_beam_hour.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def table(benchmark, six_beam_hour, tmp_path_factory):
    """One height, with a cache of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BAYES_RS_CACHE", str(tmp_path_factory.mktemp("cache")))
        return benchmark.compare(six_beam_hour.parent, heights=(100.0,))


@pytest.fixture(scope="module")
def rows():
    """The rows of the page's tables that start with a height, as text."""
    text = (ROOT / "docs" / "six-beam-hour.md").read_text(encoding="utf-8").replace("−", "-")
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")
    ]
    return [cells for cells in lines if cells[0].isdigit()]


def test_the_plain_inversions_are_realizable_or_not_as_the_page_says(benchmark, six_beam_hour, rows):
    shown = {float(row[0]): row for row in rows if len(row) == 6}
    assert sorted(shown) == sorted(benchmark.HEIGHTS)
    total = 0
    for height, row in shown.items():
        scan = brs.find_scan(six_beam_hour, height=height)
        series = brs.read(six_beam_hour, scan)
        records = brs.make_records(series, scan)
        bad = int((~brs.estimate(records, scan)["realizable"]).sum())
        hour = brs.make_records(series, scan, duration=3600.0)
        assert (int(row[2]), row[3]) == (bad, "yes" if bool(brs.estimate(hour, scan)["realizable"][0]) else "no")
        assert float(row[1]) == pytest.approx(float(records["wind_speed"].mean()), abs=0.051)
        assert int(records["count"].min()) >= 19
        total += bad
    assert total == 21


def test_every_record_has_a_realizable_posterior_and_a_length_scale_of_its_own(table):
    assert len(table) == (6 + 1) * (6 + 1 + 6)  # records and the hour; stresses, energy, stresses in the lidar's frame
    assert table[["mean", "low", "high"]].notna().all(axis=None)
    assert (table["flag"] == "").all()
    assert table["length_scale"].between(100.0, 500.0).all()  # few eddies in a record, as the page says
    assert (table.loc[table["stress"].isin(list(NAMES)), "low"] > 0.0).all()


def test_the_table_in_the_docs_is_the_one_that_comes_out(benchmark, table, rows):
    found = benchmark.hour_and_records(table).set_index("stress")
    shown = {row[1]: row[:2] + row[3:] for row in rows if len(row) == 7 and row[0] == "100" and row[2] == "after"}
    assert sorted(shown) == sorted(NAMES.values())
    for stress, name in NAMES.items():
        low, high = shown[name][5].split(" to ")
        # 1000 effective draws: a mean to 3 % of the sd, ends of an interval to a tenth of it, on another processor
        one = found.loc[stress]
        sd = one["width"] / 3.3
        assert float(shown[name][2]) == pytest.approx(one["mean of six records"], abs=0.05 * sd + 0.006)
        assert float(shown[name][3]) == pytest.approx(one["mean width of their 90 % intervals"], rel=0.05)
        assert float(shown[name][4]) == pytest.approx(one["hour"], abs=0.1 * sd + 0.006)
        assert float(low) == pytest.approx(one["low"], abs=0.2 * sd + 0.006)
        assert float(high) == pytest.approx(one["high"], abs=0.2 * sd + 0.006)


def test_the_counts_of_the_page(benchmark, table, rows):
    one = benchmark.counts(table).iloc[0]
    row = next(row for row in rows if len(row) == 6 and row[0] == "100")
    assert int(row[4]) == pytest.approx(
        one["plain outside the 90 % interval, of 36"], abs=1
    )  # one at an interval's end
    assert one["not realizable, of 6 records"] == int(row[2])


def test_the_bound_of_the_instrument_s_noise(benchmark, six_beam_hour):
    bound = benchmark.velocity_noise(six_beam_hour.parent)
    assert bound["bound of the noise variance"].between(0.025, 0.045).all()
    assert bound["median CNR"].round().eq(-21.0).all()
