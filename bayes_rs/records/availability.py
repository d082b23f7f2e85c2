"""Availability: how many of the samples and records of each beam count, hour by hour or day by day."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs.errors import InputError, in_short
from bayes_rs.records.layout import check_layout


def availability_table(records: xr.Dataset, *, every: str = "1h") -> pd.DataFrame:
    """Return the availability of each beam in each hour or day.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`.
    every : str
        Length of the steps, as pandas writes it: ``"1h"``, ``"1D"``.

    Returns
    -------
    table : pandas.DataFrame
        A row per step and beam, in time's order: ``time``, the start of the step, UTC; ``beam``; ``records``, those
        that start in the step; ``usable``, the share of them in which the beam is not flagged; ``samples`` that count;
        ``availability``, their share of the samples that full records would hold, which may be above 1.

    Raises
    ------
    InputError
        If the records lack times, counts, flags or a report, or the step is none that pandas knows.

    Notes
    -----
    Steps are counted from midnight UTC. Steps within the records' span that hold no record do not occur, since records
    have no holes: one without samples is there and counts as zero.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("2-beam"), brs.load_turbulence("fu-2022")
    >>> records = brs.make_records(brs.simulate(scan, flow, wind_speed=10.0, n_records=8, seed=1), scan)
    >>> table = availability_table(records)
    >>> table[["beam", "records", "usable", "samples", "availability"]].values.tolist()[:2]
    [[0.0, 6.0, 1.0, 3600.0, 1.0], [1.0, 6.0, 1.0, 3600.0, 1.0]]
    """
    check_layout(records, "count", "flag", "time")
    if "records_report" not in records.attrs:
        raise InputError("The records have no records_report, which says how many samples to expect: make them again.")
    try:
        step = pd.Timedelta(every)
    except (OverflowError, TypeError, ValueError) as error:
        raise InputError(f"Invalid every {in_short(every)}: it must be a length of time, as '1h' or '1D'.") from error
    if not step > pd.Timedelta(0):
        raise InputError(f"Invalid every {in_short(every)}: it must be longer than zero, as '1h' or '1D'.")
    n_record, n_beam = records.sizes["record"], records.sizes["beam"]
    rows = pd.DataFrame(
        {
            "time": np.repeat(pd.DatetimeIndex(records["time"].values).floor(step), n_beam),
            "beam": np.tile(records["beam"].values, n_record),
            "usable": (records["flag"].values == 0).ravel(),
            "samples": records["count"].values.ravel(),
        }
    )
    found = rows.groupby(["time", "beam"], sort=True)
    table = found.agg(records=("usable", "size"), usable=("usable", "mean"), samples=("samples", "sum")).reset_index()
    table["availability"] = table["samples"] / (table["records"] * expected_samples(records))
    return table


def expected_samples(records: xr.Dataset) -> float:
    """Return how many samples a full record of a beam holds: what `make_records` expected, or the most there are.

    Parameters
    ----------
    records : xarray.Dataset
        Records, with or without a report and counts.

    Returns
    -------
    number : float
        NaN if it is not known.
    """
    if "records_report" in records.attrs:
        return float(json.loads(records.attrs["records_report"])["samples_expected"])
    if "count" in records and records["count"].size and records["count"].values.max() > 0:
        return float(records["count"].values.max())
    return float("nan")
