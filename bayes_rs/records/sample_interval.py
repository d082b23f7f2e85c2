"""How long it takes from a sample of a beam to the next: whether the scan's cycle is that of the samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.samples import BeamSamples

INTERVAL = "sample_interval"
"""Variable of records: the usual time between the samples of a beam, s."""
_CLEAR = 1.7
"""Factor from which on another cycle is told: times that are rounded to their own step stay below."""
_MOST = 20
"""Intervals of a beam and record that are looked at, evenly chosen."""
_LEAST = 8
_SHARE = 0.02
"""Share of the records from which on another cycle is told."""


def interval_of_records(samples: BeamSamples, cycle: float) -> dict[str, Any]:
    """Return the usual time between the samples of a beam in each record.

    Parameters
    ----------
    samples : BeamSamples
        The samples, also those that do not count: a lost velocity has its time.
    cycle : float
        Duration of the scan, s.

    Returns
    -------
    variables : dict of str to tuple
        ``sample_interval`` (record), s: the median, or where that is longer than the cycle the larger of the cycle and
        the lower decile, since samples that are missing make single intervals longer. NaN with fewer than 8.
    """
    group = samples.group
    found = np.full(samples.n_record, np.nan)
    if len(group) > 1:
        edge = np.flatnonzero(np.diff(group, prepend=-1))
        length = np.diff(np.append(edge, len(group)))
        place = np.arange(len(group)) - np.repeat(edge, length)
        every = np.repeat(np.maximum(length // _MOST, 1), length)
        chosen = np.flatnonzero((place % every == 0) & (place > 0))
        step = (samples.time[chosen] - samples.time[chosen - 1]) / 1e9
        record = group[chosen] % samples.n_record
        order = np.lexsort((step, record))
        count = np.bincount(record, minlength=samples.n_record)
        begin = np.cumsum(count) - count
        known = np.flatnonzero(count >= _LEAST)
        ranked = step[order]
        middle, low = (ranked[begin[known] + count[known] // part] for part in (2, 10))
        found[known] = np.where(middle <= cycle, middle, np.maximum(low, cycle))
    about = {"units": "s", "long_name": "usual time between samples of a beam"}
    return {INTERVAL: (("record",), found.astype(np.float32), about)}


def cycle_report(records: xr.Dataset, scan: Scan) -> dict[str, Any]:
    """Say for the report in how many records the samples come at another cycle than the scan's, if they do."""
    if INTERVAL not in records:
        return {}
    interval = np.asarray(records[INTERVAL].values, dtype=np.float64)
    interval = interval[np.isfinite(interval)]
    off = np.abs(np.log(np.maximum(interval, 1e-9) / scan.scan_duration)) > np.log(_CLEAR)
    if not off.any() or off.mean() < _SHARE:
        return {"cycle": None}
    return {
        "cycle": {
            "interval": float(np.median(interval[off])),
            "scan_duration": float(scan.scan_duration),
            "records": int(off.sum()),
            "of": len(interval),
        }
    }
