"""The samples of each record and beam on evenly spaced slots, with nothing filled where there is none."""

from __future__ import annotations

import itertools
import json

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.filtering import apply_filters
from bayes_rs.quality.rules import QualityRules
from bayes_rs.records.layout import check_layout
from bayes_rs.records.record_samples import sort_samples

LARGEST_SPREAD = 0.25
"""Samples farther than this from an even spacing, root mean square in sampling intervals, have no spectrum here."""

_LEAST = 8  # samples: fewer have no spectrum worth the name


def beam_samples(series: xr.Dataset, scan: Scan, records: xr.Dataset) -> tuple[FloatArray, float, FloatArray]:
    """Return the samples that the records' variances were made of, each at its slot.

    Parameters
    ----------
    series : xarray.Dataset
        Radial velocities, as `read` and `simulate` return them.
    scan : Scan
        Their scan.
    records : xarray.Dataset
        From `make_records` of this series, or some of them.

    Returns
    -------
    velocity : ndarray, shape (n_record, n_beam, n_slot)
        Radial velocities, m/s; NaN in slots without a sample, and for flagged beams everywhere.
    interval : float
        Time between slots Δ, s: the median over records and beams of the mean time between samples.
    spread : ndarray, shape (n_record, n_beam)
        Root mean square of the distance of the samples from their slots, in Δ.

    Raises
    ------
    InputError
        If the two do not belong together, or the samples are too uneven.

    Notes
    -----
    The filters that dropped samples from the records (status, carrier-to-noise ratio, spikes) are read from the
    attribute ``records_report`` and applied again. Of several samples in one slot the first counts.
    """
    beams, start = _checked(scan, records)
    duration = float(records.attrs["duration"])
    time, number, velocity = _usable_samples(series, scan, records, duration)
    n_record, n_beam = len(start), len(beams)
    by_number = np.argsort(beams)
    known = np.isin(number, beams)
    time, number, velocity = time[known], number[known], velocity[known]
    beam = by_number[np.searchsorted(beams, number, sorter=by_number)]
    by_start = np.argsort(start)
    before = np.searchsorted(start, time, side="right", sorter=by_start) - 1
    record = by_start[np.maximum(before, 0)]
    since = (time - start[record]) / 1e9
    inside = (before >= 0) & (since < duration)
    inside &= np.asarray(records["flag"].values == 0)[record, beam]
    order = np.lexsort((time[inside], beam[inside], record[inside]))
    record, beam = record[inside][order], beam[inside][order]
    since, velocity = since[inside][order], velocity[inside][order]
    group = record * n_beam + beam
    steps = np.diff(since)[np.diff(group) == 0]
    if len(steps) == 0:
        raise InputError("No record has a beam with two usable samples, so there is no spectrum: check the flags.")
    edges = np.flatnonzero(np.diff(group, prepend=-1, append=-2))
    interval = _interval(since, edges, float(np.median(steps)))
    slot = np.full(len(since), -1, dtype=np.int64)
    spread = np.full(n_record * n_beam, np.nan)
    for first, last in itertools.pairwise(edges.tolist()):
        if last - first < _LEAST:
            continue
        place = (since[first:last] - since[first]) / interval
        place -= np.median(place - np.round(place))
        slot[first:last] = np.round(place).astype(np.int64)
        spread[group[first]] = np.sqrt(np.mean((place - slot[first:last]) ** 2))
    if np.all(np.isnan(spread)):
        raise InputError(f"No record has a beam with {_LEAST} usable samples: too few for a spectrum; check the flags.")
    typical = float(np.nanmedian(spread))
    if typical > LARGEST_SPREAD:
        raise InputError(
            f"The samples of a beam are not evenly spaced: they lie {typical:.2f} of {interval:g} s from even slots "
            f"(root mean square), more than {LARGEST_SPREAD:g}; a spectrum needs a scan that visits a beam evenly."
        )
    kept = slot >= 0
    n_slot = max(int(np.round(duration / interval)), int(slot.max()) + 1)
    out = np.full((n_record * n_beam, n_slot), np.nan)
    # the last assignment to a slot stays, so the first sample comes last
    out[group[kept][::-1], slot[kept][::-1]] = velocity[kept][::-1]
    return out.reshape(n_record, n_beam, n_slot), interval, spread.reshape(n_record, n_beam)


def _interval(since: FloatArray, edges: NDArray[np.int64], near: float) -> float:
    """Return the time between slots: the median over records and beams of their mean, `near` it."""
    found = []
    for first, last in itertools.pairwise(edges.tolist()):
        if last - first >= _LEAST:
            number = np.sum(np.maximum(np.round(np.diff(since[first:last]) / near), 1.0))
            found.append((since[last - 1] - since[first]) / number)
    return float(np.median(found)) if found else near


def _checked(scan: Scan, records: xr.Dataset) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Check the records; return their beams and starts, ns."""
    check_layout(records, "variance", "flag")
    if not {"duration", "records_report"} <= set(records.attrs) or "time" not in records.coords:
        raise InputError("The records do not say how they were made: make them with bayes_rs.make_records.")
    beams = np.asarray(records["beam"].values, dtype=np.int64)
    scan.select(beams)
    start = records["time"].values.astype("datetime64[ns]").astype(np.int64)
    if len(start) == 0 or len(np.unique(start)) != len(start):
        raise InputError("The records are none, or two of them start at the same time: give those of one series.")
    return beams, start


def _usable_samples(
    series: xr.Dataset, scan: Scan, records: xr.Dataset, duration: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Return time (ns), beam number and velocity of the samples that pass the filters of the records."""
    rules = QualityRules(**json.loads(records.attrs["records_report"]).get("quality", {}))
    samples, _ = sort_samples(series, scan, rules.needed_columns()).in_records(round(duration * 1e9))
    keep = apply_filters(samples, rules).keep
    return samples.time[keep], samples.numbers[samples.beam[keep]], samples.velocity[keep]
