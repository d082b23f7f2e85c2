"""The measured day: what the comparison with the masts in docs/field-day.md rests on."""

import importlib.util
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def comparison(iea_folder, tmp_path_factory):
    """Run benchmarks/field_day.py on the measured data, with a cache of its own."""
    path = Path(__file__).parents[1] / "benchmarks" / "field_day.py"
    spec = importlib.util.spec_from_file_location("field_day", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BAYES_RS_CACHE", str(tmp_path_factory.mktemp("cache")))
        return module.compare(iea_folder)


def test_every_record_of_the_day_has_a_posterior(comparison):
    merged, _ = comparison
    assert len(merged) == 144
    assert merged[["mean", "hdi_low", "hdi_high"]].notna().all(axis=None)
    assert (merged["flag"] == "").sum() == 136


def test_the_table_in_the_docs_is_the_one_that_comes_out(comparison):
    _, table = comparison
    text = (Path(__file__).parents[1] / "docs" / "field-day.md").read_text(encoding="utf-8").replace("−", "-")
    words = {"south mast": "south mast", "north mast": "north mast", "mean of both masts": "mean of both"}
    shown = table[table["records"].str.startswith("all") | table["reference"].eq("mean of both masts")]
    rows = [line for line in text.splitlines() if line.startswith("| ") and " % |" in line]
    assert len(rows) == len(shown) == 4
    for line, (_, row) in zip(rows, shown.iterrows(), strict=True):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert cells[0] == words[row["reference"]]
        # one unit in the last printed digit: rounding, and sums in another order on another processor
        assert float(cells[2]) == pytest.approx(row["bias"], abs=0.001)
        assert float(cells[3]) == pytest.approx(row["RMSE"], abs=0.001)
        assert float(cells[4].rstrip(" %")) == pytest.approx(100.0 * row["relative bias"], abs=0.1)
        assert float(cells[5].rstrip(" %")) == pytest.approx(100.0 * row["relative RMSE"], abs=0.1)
        assert float(cells[6]) == pytest.approx(row["correlation"], abs=0.01)
        assert float(cells[7]) == pytest.approx(row["share of 90 % intervals that hold it"], abs=0.015)  # two records
