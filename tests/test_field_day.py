"""The measured day: what the comparison with the masts in docs/field-day.md rests on."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import bayes_rs as brs

DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def field_day():
    """Return benchmarks/field_day.py."""
    path = DOCS.parent / "benchmarks" / "field_day.py"
    spec = importlib.util.spec_from_file_location("field_day", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Use a cache of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BAYES_RS_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def day(field_day, iea_folder):
    """Return the records and the masts."""
    return field_day.read(iea_folder)


@pytest.fixture(scope="module")
def comparison(field_day, day, cache):  # noqa: ARG001 - the cache is a setting
    """Fit the day with and without the probe; its campaign takes another half minute."""
    return field_day.compare(field_day.fits_of(day[0], campaign="off"), *day)


def rows_of_table(head):
    """Return the cells of the table whose head starts so."""
    text = (DOCS / "field-day.md").read_text(encoding="utf-8").replace("−", "-")
    lines = text[text.index(f"\n{head}") + 1 :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_every_record_of_the_day_has_a_posterior(comparison):
    for merged in comparison[0].values():
        assert len(merged) == 144
        assert merged[["mean", "low", "high"]].notna().all(axis=None)
        assert merged["flag"].str.contains("beam_left_out").sum() == 8


def test_what_the_industry_quotes_is_what_the_docs_say(field_day, comparison):
    found = field_day.as_quoted(comparison[0]["30 m", "weak"]).to_dict("records")
    rows = rows_of_table("| m/s | number | lidar | masts | MRBE |")
    assert len(rows) == len(found)
    names = ("measured", "reference", "mrbe", "rrmse", "measured_representative", "reference_representative",
             "representative_error", "coverage")  # fmt: skip
    for row, own in zip(rows, found, strict=True):
        assert row[0] == own["bin"].replace("-", " to ").replace(" m/s", "")
        assert int(row[1]) == own["n_record"]
        for cell, name in zip(row[2:], names, strict=True):
            if cell == "–":
                assert np.isnan(own[name])
                continue
            scale, step = (0.01, 0.0005) if cell.endswith("%") else (1.0, 0.0005 if name != "coverage" else 0.005)
            # rounding, and what the draws of another machine move
            assert scale * float(cell.rstrip(" %")) == pytest.approx(own[name], abs=step + 0.002)


def test_the_unsteady_records_are_those_that_the_docs_name(comparison):
    text = (DOCS / "field-day.md").read_text(encoding="utf-8")
    merged = comparison[0]["30 m", "weak"]
    times = merged.loc[merged["flag"].str.contains("unsteady"), "time"].dt.strftime("%H:%M")
    assert f"| {', '.join(times)} |" in text


def test_the_table_in_the_docs_is_the_one_that_comes_out(comparison):
    _, table = comparison
    found = table[table["records"].str.startswith("all")].set_index(["probe", "reference"])
    words = {"south mast": "south mast", "north mast": "north mast", "mean of both": "mean of both masts"}
    rows = [
        cells
        for cells in rows_of_table("| probe | reference |")
        if cells[2] == "after" and cells[0] in {"30 m", "none"}
    ]
    assert len(rows) == len(found) == 6
    for cells in rows:
        row = found.loc[(cells[0], words[cells[1]])]
        # one unit in the last printed digit: rounding, and sums in another order on another processor
        assert float(cells[3]) == pytest.approx(row["bias"], abs=0.001)
        assert float(cells[4]) == pytest.approx(row["RMSE"], abs=0.001)
        assert float(cells[5].rstrip(" %")) == pytest.approx(100.0 * row["relative bias"], abs=0.1)
        assert float(cells[6].rstrip(" %")) == pytest.approx(100.0 * row["relative RMSE"], abs=0.1)
        assert float(cells[7]) == pytest.approx(row["correlation"], abs=0.01)
        assert float(cells[8]) == pytest.approx(row["share of 90 % intervals that hold it"], abs=0.015)  # two records
        assert float(cells[9]) == pytest.approx(row["median width over mean"], abs=0.011)


def test_what_the_lidar_sees_along_the_beams_is_in_the_docs(field_day, day, cache):  # noqa: ARG001 - the cache is a setting
    found = field_day.along_beams(*day).set_index(["what", "beam"])
    for cells in rows_of_table("| | beam 2, south mast |"):
        what = cells[0].split(",")[0]
        for beam, cell in zip((2, 3), cells[1:], strict=True):
            rows = found.loc[[(what, beam)]]
            numbers = cell.split(" ± ") if what == "measured" else cell.split(", ")
            expected = rows[["left", "error"]].iloc[0] if what == "measured" else rows["left"]
            np.testing.assert_allclose([float(number) for number in numbers], expected, atol=0.0101)
    # neither a point nor a probe twice as long as the assumed one
    measured = found.loc["measured"]
    assert np.all(1.0 - measured["left"] > 4.0 * measured["error"])


def test_the_step_from_the_beams_to_the_speed_is_in_the_docs(field_day, day, cache):  # noqa: ARG001 - the cache is a setting
    records, reference = day
    points = brs.load_scan("pulsed-4-beam@probe=point")
    masts = field_day.as_the_masts_see(records, reference)
    merged = field_day.intensity(masts, reference, points, length_scale=61.0)
    found = field_day.scores(merged, "both")
    cells = rows_of_table("| case | bias |")[-1]
    assert cells[0] == "the masts' variances along the beams, no probe, L = 61 m"
    assert float(cells[1]) == pytest.approx(found["bias"], abs=0.001)
    assert float(cells[2]) == pytest.approx(found["RMSE"], abs=0.001)
    assert float(cells[3].rstrip(" %")) == pytest.approx(100.0 * found["relative bias"], abs=0.1)
