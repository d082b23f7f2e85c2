"""The tables in docs/default-user.md are those of benchmarks/real_air.csv, and the script's cases are what it says."""

import numpy as np
import pandas as pd
import pytest
import real_air
from air import MannAir

TABLE = real_air.read_table()


def test_the_page_is_made_of_the_table():
    text = real_air.PAGE.read_text(encoding="utf-8")
    assert real_air.page_with(text, real_air.page_tables(TABLE)) == text


def test_every_case_is_known_and_whole():
    assert set(TABLE["air"] + ":" + TABLE["scan"]) <= set(real_air.cases())
    by = TABLE.groupby(["edition", "air", "scan", "seed"])["stress"]
    assert (by.count() == 6).all()
    assert (by.nunique() == 6).all()
    assert (TABLE["n_record"] >= 200).all()


def test_what_is_done_is_not_done_again():
    done = TABLE[TABLE["edition"] == "before"].iloc[0]
    name = f"{done['air']}:{done['scan']}"
    assert not list(real_air.missing("before", [name], [int(done["seed"])]))
    assert list(real_air.missing("before", [name], [987])) == [(name, 987)]


@pytest.fixture(scope="module")
def small(monkeypatch_module):
    """A case of a few records, which is no more than a run of everything."""
    monkeypatch_module.setitem(real_air.AIRS, "calm", real_air.Case("calm", MannAir(0.05, 30.0, 1.0)))
    return real_air.run_case("calm:2-beam", n_record=6, seed=1).set_index("stress")


@pytest.fixture(scope="module")
def monkeypatch_module():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


def test_a_case_holds_the_tables_against_the_truth(small):
    right = MannAir(0.05, 30.0, 1.0).stresses()
    assert small["truth"].to_numpy() == pytest.approx(right, abs=0.06 * right[0])
    assert small["truth"].iloc[0] < right[0]
    assert (small["fitted"] == 6).all()
    assert 0.5 < small.loc["uu", "campaign"] / small.loc["uu", "truth"] < 2.0
    assert small["hold"].between(0.0, 1.0).all()
    assert (small["campaign_low"] <= small["campaign_high"]).all()


def test_the_campaign_of_a_folder_counts_where_there_is_one(tmp_path):
    assert real_air._campaign(tmp_path) is None
    rows = {"quantity": ["uu", "uu", "vv"], "bin": ["all", "10", "all"], "mean": [1.0, 2.0, 3.0]}
    pd.DataFrame(rows).to_csv(tmp_path / "campaign.csv", index=False)
    found = real_air._campaign(tmp_path)
    assert found["mean"].to_dict() == {"uu": 1.0, "vv": 3.0}


def test_winds_of_a_day_are_few_and_spread():
    wind = real_air._wind("day", 200)
    assert (wind.min(), wind.max()) == (6.0, 14.0)
    assert len(np.unique(wind)) <= 17
