"""The comparison of scans: laws, the two speeds against each other, the folder and the picture."""

import json

import numpy as np
import pandas as pd
import pytest

from bayes_rs import InputError, compare, load_turbulence, plot_comparison
from bayes_rs.design.compare_job import run_compare
from bayes_rs.design.comparing import COLUMNS

FLOW = load_turbulence("fu-2022")


@pytest.fixture(scope="module")
def table():
    return compare(["4-beam", "6-beam", "6-beam@opening_angle_deg=45"], FLOW, method="both", n_records=64)


def of(table, scan, stress, column, data="fast", estimator="posterior"):
    return float(table.set_index(["scan", "stress", "data", "estimator"])[column].loc[(scan, stress, data, estimator)])


class TestTable:
    def test_columns_and_rows(self, table):
        assert list(table.columns) == list(COLUMNS)
        posterior = table[table["estimator"] == "posterior"]
        assert len(posterior) == 3 * 2 * 6
        assert posterior.drop(columns=["full_over_fast"]).notna().all(axis=None)
        assert set(posterior["rank"]) == {4, 6}

    def test_a_larger_opening_angle_knows_the_cross_wind_stresses_better(self, table):
        for stress in ("vv", "ww", "uv", "uw", "vw"):
            wide, narrow = (of(table, name, stress, "width_90") for name in ("6-beam", "6-beam@opening_angle_deg=45"))
            assert narrow < 0.8 * wide

    def test_fast_and_full_agree(self, table):
        """Widths vary by 25 % from record to record: means of 64 have 3 %; their ratio 4.4 %, and three times that."""
        ratio = table[(table["estimator"] == "posterior") & (table["data"] == "full")]["full_over_fast"]
        assert (np.abs(ratio - 1.0) < 0.13).all()

    def test_least_squares_on_the_same_records_is_not_better_than_the_posterior_at_fifteen_degrees(self, table):
        for data in ("fast", "full"):
            classic = of(table, "6-beam", "vv", "rmse", data, "lsq")
            assert classic > 3.0 * of(table, "6-beam", "vv", "rmse", data)

    def test_least_squares_gives_nothing_that_four_beams_do_not_see(self, table):
        rows = table.query("scan == '4-beam' and estimator == 'lsq'")
        assert "vv" not in set(rows["stress"])

    def test_truth_is_the_record_s_tensor_or_the_ensemble_s(self, table):
        other = compare(["4-beam"], FLOW, target="ensemble", n_records=4, estimators=[])
        np.testing.assert_allclose(other["truth"], FLOW.stresses(), rtol=1e-12)
        assert of(table, "4-beam", "uu", "truth") < FLOW.stresses()[0]

    def test_more_noise_is_wider(self):
        quick, slow = (compare(["6-beam"], FLOW, duration=T, n_records=32, estimators=[]) for T in (3600.0, 600.0))
        assert quick["width_90"].iloc[0] < 0.7 * slow["width_90"].iloc[0]

    def test_same_seed_same_table(self):
        one, two = (compare(["4-beam"], FLOW, n_records=8, seed=3).drop(columns="seconds") for _ in range(2))
        pd.testing.assert_frame_equal(one, two)

    def test_several_flows_and_priors(self):
        flows = [FLOW, load_turbulence("stable-onshore")]
        table = compare(["4-beam"], flows, prior=["weak", "flat"], n_records=4, estimators=["lsp"])
        cases = table[table["estimator"] == "posterior"].groupby(["turbulence", "prior"]).size()
        assert len(cases) == 4
        assert (table[table["estimator"] == "lsp"]["stress"] == "uu").all()


class TestScans:
    def test_changes_behind_a_name_are_in_the_label_and_in_the_scan(self):
        names = ["pulsed-4-beam", "pulsed-4-beam@probe=point"]
        table = compare(names, FLOW, n_records=4, estimators=["lsp"]).query("estimator == 'lsp'").set_index("scan")
        assert table.index.tolist() == names
        assert table.loc[names[0], "bias"] < table.loc[names[1], "bias"]  # the estimators know of no probe

    def test_nothing_to_compare(self):
        with pytest.raises(InputError, match="There is no scan to compare"):
            compare([], FLOW)

    def test_bad_options(self):
        with pytest.raises(InputError, match="method of comparison"):
            compare(["4-beam"], FLOW, method="slow")
        with pytest.raises(InputError, match="estimator"):
            compare(["4-beam"], FLOW, estimators=["magic"])


class TestPicture:
    def test_a_bar_for_every_scan_and_case(self, table):
        figure = plot_comparison(table, stresses=("uu", "vv"))
        assert len(figure.axes) == 2
        bars = figure.axes[0].patches
        widths = sorted(bar.get_width() for bar in bars)
        wanted = table[(table["estimator"] == "posterior") & (table["stress"] == "uu")]["width_ratio"]
        np.testing.assert_allclose(widths, sorted(wanted))

    def test_refusals(self, table):
        with pytest.raises(InputError, match="stress"):
            plot_comparison(table, stresses=("xx",))
        with pytest.raises(InputError, match="Not a table of scans"):
            plot_comparison(pd.DataFrame({"a": [1]}))


def test_the_folder_holds_table_figure_and_json(tmp_path):
    table, words = run_compare(["4-beam", "staring"], tmp_path / "out", n_records=8)
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        "comparison.csv",
        "comparison.json",
        "comparison.png",
        "run.json",
    ]
    content = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    assert len(content["rows"]) == len(table)
    assert content["scene"]["scans"] == ["4-beam", "staring"]
    assert any("narrowest" in line for line in words)
    with pytest.raises(InputError, match="exists"):
        run_compare(["4-beam"], tmp_path / "out", n_records=8)
