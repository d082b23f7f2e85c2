"""The headline of a fit, and the table for people."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from fit_scene import OPTIONS, SCAN, fit_to, make_records

import bayes_rs as brs
from bayes_rs.fits.columns import VARIANCES
from bayes_rs.fits.direction_table import direction_name
from bayes_rs.fits.flags import FLAGS
from bayes_rs.fits.headline import NOTHING, _doubts, decided_words, headline_of_ranges
from bayes_rs.fits.people_table import decimals_of
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors.decided import is_priors


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("headline") / "out"
    fit_to(make_records(), SCAN, folder, **OPTIONS)
    return folder


@pytest.fixture(scope="module")
def found(place):
    return brs.open_fit(place)


@pytest.fixture(scope="module")
def rows(place):
    """The table for people, each row by its headings."""
    with (place / "stresses.csv").open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


class TestHeadline:
    def test_has_three_lines_that_begin_with_the_intensity(self, found):
        lines = str(found.headline()).splitlines()
        assert [line.split(":")[0] for line in lines] == ["found", "decided", "doubtful"]
        assert lines[0].startswith("found:    TI ")
        assert lines[0].endswith(f"; {found.n_fitted} of {found.n_record} records fitted")

    def test_numbers_are_medians_of_the_summary(self, found):
        told = found.headline().to_plain()
        rows = found.summary().query("stress == 'uu'").set_index("record")
        speed = found.records["wind_speed"].values
        for name in ("median", "low", "high"):
            expected = np.nanmedian(np.sqrt(rows[name]) / speed)
            assert told["turbulence_intensity"][name] == pytest.approx(expected, rel=1e-12)  # rounding
        for name in STRESSES:
            share = found.summary().query("stress == @name")["decided"].median()
            assert told["stresses"][name]["mostly_prior"] == bool(is_priors(share))
        assert told["n_fitted"] == found.n_fitted
        json.dumps(told, allow_nan=False)  # JSON has no NaN

    def test_doubts_have_words_and_counts(self, found):
        told = found.headline()
        counts = {word: count for word, count in found.flags.items() if count}
        assert told.numbers["doubtful"]["flags"] == counts
        assert f"{counts['no_usable_beam']} of 23 records: every beam is flagged" in told.doubtful

    def test_a_fit_without_a_posterior_has_a_headline_too(self):
        records = make_records(2)
        records["flag"].values[:] = 1
        told = brs.fit(records, SCAN, **OPTIONS).headline()
        assert told.found == "0 of 2 records fitted"
        assert told.decided == "nothing: no record has a posterior"
        assert told.doubtful.startswith("2 of 2 records: every beam")

    def test_nothing_is_doubtful_where_no_record_has_a_flag(self):
        fit = brs.fit(make_records(3), SCAN, **OPTIONS)
        assert not any(fit.flags.values())
        assert fit.headline().doubtful == NOTHING

    def test_what_only_all_records_together_show_is_a_doubt(self, found):
        lines = ["all records together: beam 2 looks dead", "the beams' variances scatter 1.9 times as much: eddies"]
        clean = {"n_record": 2, "n_fitted": 0, "flag": np.zeros(2, dtype=np.int64)}
        run = {**found.run, "doubts": [], "beams": {"together": lines}}
        source = SimpleNamespace(datasets=("summary", "posterior"))
        fits = {
            k: SimpleNamespace(**clean, source=source, run={**run, "beams": {"together": lines[:k]}}) for k in (0, 1, 2)
        }
        told = headline_of_ranges({}, fits, ["80 m", "120 m", "160 m"], pd.DataFrame())
        assert told.doubtful == "all records together: the beams are not as the model has them at 2 of 3 ranges"
        assert told.numbers["doubtful"]["beams"] == [lines[0], *lines]
        alone = _doubts({}, [fits[2]])[0]
        assert alone == "all records together: beam 2 looks dead; the beams' variances scatter 1.9 times as much"

    @pytest.mark.parametrize(
        ("shares", "words"),
        [
            ([1, 1, 1, 1, 1, 1], "the beams measured all six stresses, and so TI"),
            ([0] * 6, "none of the six stresses was measured: all are mostly the prior's, and so is TI"),
            ([np.nan] * 6, "none of the six stresses was measured: all are mostly the prior's, and so is TI"),
            ([1, 1, 1, 1, 1, 0], "the beams measured uu, vv, ww, uv, uw, and so TI; vw is mostly the prior's"),
            ([0, 0, 0, 1, 0, 0], "the beams measured uv; uu, vv, ww, uw, vw are mostly the prior's, and so is TI"),
        ],
    )
    def test_who_decided_follows_the_one_rule(self, shares, words):
        assert decided_words(np.array(shares, dtype=np.float64)) == words

    def test_of_ranges_it_is_of_the_profile(self):
        """Two ranges of which one is doubtful, a third without a record."""
        shares = {0: [1, 1, 0, 0, 0, 0], 2: [1, 0, 0, 0, 0, 0]}
        fits = {
            place: SimpleNamespace(
                flag=np.array([0, FLAGS["unsteady"] * (place == 2)]),
                run={"doubts": [], "campaign": {"on": False}},
                source=SimpleNamespace(datasets=("summary", "posterior")),
                n_record=2,
                n_fitted=2,
                fitted=np.array([True, True]),
                records={"wind_speed": SimpleNamespace(values=np.array([8.0, 10.0]))},
                of_stresses=lambda _, own=own: {"decided": np.array([own, own], dtype=np.float64)},
            )
            for place, own in shares.items()
        }
        rows = [
            ("ti", 0.1 + place, 0.09, 0.12, 0.9, "equal-tailed", 1.0, "median record", float(place)) for place in fits
        ]
        columns = ["quantity", "estimate", "low", "high", "prob", "interval", "decided", "of", "range"]
        names = ["range 80 m", "range 120 m", "range 160 m"]
        told = headline_of_ranges({}, fits, names, pd.DataFrame(rows, columns=columns))
        assert told.found == (
            "TI 0.100 (0.090 to 0.120) at range 80 m to 2.100 (0.090 to 0.120) at range 160 m, 90 % interval, "
            "equal-tailed (median record); wind 8.0 to 10.0 m/s; 4 of 4 records fitted at 2 of 3 ranges"
        )
        assert told.decided == (
            "the beams measured uu at all ranges, vv at 1 of 2; ww, uv, uw, vw are mostly the prior's at all"
        )
        assert told.doubtful.startswith("1 of 3 ranges without a record that can be fitted; 1 of 4 records: the wind")


def test_of_ranges_that_speak_against_the_coherence_the_worst_is_told(monkeypatch):
    misfits = {0: 2.9, 1: 3.7, 2: 1.0}

    def of(fit):
        return SimpleNamespace(
            doubted=fit.misfit > 2.0, misfit=fit.misfit, in_words=lambda: f"the covariances scatter {fit.misfit} times"
        )

    monkeypatch.setattr("bayes_rs.fits.headline.coherence_of", of)
    source = SimpleNamespace(datasets=("summary", "pairs_pattern", VARIANCES))
    run = {"doubts": [], "campaign": {"on": False}, "settings": {"fit": {"information": "variances"}}}
    fits = [
        SimpleNamespace(flag=np.zeros(2, dtype=np.int64), run=run, source=source, misfit=one)
        for one in misfits.values()
    ]
    assert _doubts({}, fits)[0] == "at 2 of 3 ranges, here the worst: the covariances scatter 3.7 times"
    assert _doubts({}, fits[1:2])[0] == "the covariances scatter 3.7 times"


def test_a_direction_has_a_name():
    assert direction_name(np.array([0.0, 1.0, 0.0, 0.1, 0.0, 0.0])) == "vv"
    assert direction_name(np.array([-0.4, 0.65, 0.65, 0.0, 0.0, 0.0])) == "vv and ww against uu"


class TestTableForPeople:
    def test_has_a_row_for_each_record(self, rows, found):
        assert [int(row["record"]) for row in rows] == list(range(23))
        assert [row["flag"] for row in rows] == found.summary().query("stress == 'uu'")["flag"].tolist()
        for row, fitted in zip(rows, found.fitted, strict=True):
            assert (row["uu_m2_s2"] != "") == fitted
            assert (row["interval"] == "90 % equal-tailed") == fitted

    def test_rounding_moves_no_number_by_more_than_half_of_its_monte_carlo_error(self, rows, found):
        table = found.summary().set_index(["record", "stress"])
        checked = 0
        for row in rows:
            for name in STRESSES:
                own = table.loc[(int(row["record"]), name)]
                for place, words in (("median", ""), ("low", "_low"), ("high", "_high")):
                    text = row[f"{name}{words}_m2_s2"]
                    if text:
                        # a last digit of at most the error: rounding moves by half of it
                        assert abs(float(text) - own[place]) <= 0.5 * own[f"mcse_{place}"] * (1.0 + 1e-9)
                        digits = len(text.partition(".")[2])
                        assert 10.0**-digits > 0.1 * own[f"mcse_{place}"]  # and no digit more than that
                        checked += 1
        assert checked == 18 * found.n_fitted

    def test_intensity_is_the_root_of_uu_over_the_wind(self, rows, found):
        uu = found.of_stresses("median")["median"][:, 0]
        expected = np.sqrt(uu) / found.records["wind_speed"].values
        for row, wanted in zip(rows, expected, strict=True):
            if row["ti"]:
                assert float(row["ti"]) == pytest.approx(wanted, rel=0.05)  # to its Monte-Carlo error

    def test_names_the_stresses_that_are_the_priors(self, rows, found):
        priors = is_priors(found.of_stresses("decided")["decided"])
        for row, own, fitted in zip(rows, priors, found.fitted, strict=True):
            wanted = [name for name, one in zip(STRESSES, own, strict=True) if one] if fitted else []
            assert row["mostly_prior"].split() == wanted

    def test_decimals_follow_the_error(self):
        assert decimals_of(np.array([0.0099, 0.01, 1.0, 250.0])).tolist() == [3, 2, 0, -2]
        assert decimals_of(np.array([np.nan, 0.0, np.inf])).tolist() == [-99, -99, -99]
