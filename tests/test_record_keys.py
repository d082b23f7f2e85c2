"""A record is named in one way everywhere: by its number, or its start in any form in which Python holds a time."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pandas as pd
import pytest
from fit_scene import OPTIONS, make_records

import bayes_rs as brs
from bayes_rs.plot.corner_plot import corner
from bayes_rs.plot.lumley_plot import lumley

START = "2020-01-01T00:20"
"""Of record 2."""
NAMES = [
    2,
    "2",
    np.int64(2),
    np.array(2),
    START,
    "2020-01-01 00:20:00Z",
    "2020-01-01T01:20+01:00",
    np.datetime64(START),
    np.datetime64(START, "ns"),
    np.array(np.datetime64(START, "ns")),
    pd.Timestamp(START),
    pd.Timestamp(START, tz="UTC"),
    pd.Timestamp("2020-01-01T01:20", tz="Europe/Copenhagen"),
    datetime(2020, 1, 1, 0, 20),
    datetime(2020, 1, 1, 0, 20, tzinfo=UTC),
    datetime(2020, 1, 1, 2, 20, tzinfo=timezone(timedelta(hours=2))),
]


@pytest.fixture(scope="module")
def fit():
    return brs.fit(make_records(4), "6-beam", **OPTIONS)


class TestNames:
    @pytest.mark.parametrize("name", NAMES, ids=repr)
    def test_every_name_of_a_record_finds_it(self, fit, name):
        assert fit.find_record(name) == 2
        np.testing.assert_array_equal(fit.draws(name), fit.draws(2))
        assert fit.summary(records=name)["record"].unique().tolist() == [2]
        assert fit.summary(records=[name, 0])["record"].unique().tolist() == [0, 2]

    def test_the_fits_own_times_name_its_records(self, fit):
        for number in range(4):
            table = fit.summary(records=number)
            for name in (fit.time[number], fit.records["time"][number], table["time"].iloc[0]):
                assert fit.find_record(name) == number
                assert fit.summary(records=name)["record"].unique().tolist() == [number]
        for names in (fit.time[1:3], fit.records["time"][1:3], pd.DatetimeIndex(fit.time[1:3], tz="UTC")):
            assert fit.summary(records=names)["record"].unique().tolist() == [1, 2]
        between = slice(datetime(2020, 1, 1, 0, 10, tzinfo=UTC), pd.Timestamp(fit.time[3]))
        assert fit.summary(records=between)["record"].unique().tolist() == [1, 2]

    @pytest.mark.parametrize("name", [np.datetime64(START), pd.Timestamp(START)])
    def test_pictures_boxes_groups_and_budgets_take_them(self, fit, name):
        assert corner(fit, name).axes
        assert lumley(fit, name) is not None
        assert fit.to_datatree(name)["posterior"].sizes == fit.to_datatree(2)["posterior"].sizes
        assert brs.budget(fit, records=name).equals(brs.budget(fit, records=2))

    def test_of_a_fleet_a_start_is_several_records(self):
        records = make_records(4).isel(record=[0, 1, 0, 1])
        records = records.assign(turbine=("record", ["A", "A", "B", "B"]))
        fit = brs.fit(records, "6-beam", **OPTIONS)
        start = fit.time[1]
        assert fit.summary(records=start)["record"].unique().tolist() == [1, 3]
        with pytest.raises(brs.InputError, match=r"^2 records start at 2020-01-01T00:10:00, as those of several"):
            fit.draws(start)


class TestRefusals:
    @pytest.mark.parametrize(
        ("name", "message"),
        [
            (-1, r"^No record -1: there are 4, numbered from 0\.$"),
            ("4", r"^No record 4: there are 4"),
            (np.datetime64("NaT"), r"^Invalid record .*NaT.*: give a number or a time such as 2020-09-04T12:00\.$"),
            (pd.NaT, r"^Invalid record NaT: give a number or a time"),
            ("noon", r"^Invalid record 'noon': give a number or a time"),
            (1.5, r"^Invalid record"),
            (True, r"^Invalid record"),
            (None, r"^Invalid record"),
            (datetime(9999, 1, 1, tzinfo=UTC), r"^Invalid record datetime"),
            (
                pd.Timestamp("2020-01-01T00:25"),
                r"^No record starts at 2020-01-01T00:25:00: .* the last before it at 2020-01-01T00:20:00\.$",
            ),
            ("2020-01-01T00:25", r"^No record starts at 2020-01-01T00:25: the records start from"),
        ],
        ids=repr,
    )
    def test_what_names_no_record_is_refused_in_one_line(self, fit, name, message):
        with pytest.raises(brs.InputError, match=message) as error:
            fit.find_record(name)
        assert "\n" not in str(error.value)
        if name not in (1.5, True, None):  # as several they are no names of records
            with pytest.raises(brs.InputError, match=message):
                fit.summary(records=[name, name])
