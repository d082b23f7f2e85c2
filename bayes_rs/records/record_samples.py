"""The samples that records are made of: those of a series beam after beam, sorted and without repeated ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_LIMIT
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.samples import BeamSamples, IntArray, distinct, is_sorted
from bayes_rs.records.given import check_is_series
from bayes_rs.records.windows import record_windows

OPTIONAL_COLUMNS = ("cnr", "status")
"""Variables that are taken along if the series has them."""


@dataclass(frozen=True)
class SortedSamples:
    """The samples of a series beam after beam, each in time's order, none twice.

    Parameters
    ----------
    time, beam : ndarray of int, shape (n_sample,)
        Nanoseconds since 1970-01-01 00:00 UTC; place of each sample's beam in `numbers`.
    velocity : ndarray, shape (n_sample,)
        Radial velocity, m/s.
    columns : mapping of str to ndarray, shape (n_sample,)
        Other variables, by name.
    numbers : ndarray of int, shape (n_beam,)
        The scan's numbers of the beams that the series holds, in the scan's order.
    out_of_order, duplicates : int
        Samples that came earlier than one of their beam before them, and those that were left out as repeated.
    velocity_limit : float
        Speed that no wind has, m/s.
    """

    time: IntArray
    beam: IntArray
    velocity: FloatArray
    columns: Mapping[str, FloatArray]
    numbers: IntArray
    out_of_order: int
    duplicates: int
    velocity_limit: float = VELOCITY_LIMIT

    def in_records(self, window: int) -> tuple[BeamSamples, IntArray]:
        """Return the samples with their records of `window` nanoseconds, and the records' numbers since 1970."""
        number = self.time // window
        windows = record_windows(number, window, len(self.numbers))
        n_record = len(windows)
        contiguous = n_record == int(windows[-1] - windows[0]) + 1
        place = number - windows[0] if contiguous else np.searchsorted(windows, number)
        group = self.beam * n_record + place
        samples = BeamSamples(
            self.time, self.beam, group, self.velocity, self.columns, self.numbers, n_record, self.velocity_limit
        )
        return samples, windows


def sort_samples(series: xr.Dataset, scan: Scan, needed: Mapping[str, str]) -> SortedSamples:
    """Check a series and sort its samples.

    Parameters
    ----------
    series : xarray.Dataset
        Radial velocities, as for `make_records`.
    scan : Scan
        The scan they were measured with.
    needed : mapping of str to str
        Variables beside the velocity that options ask for, each with the option.

    Returns
    -------
    samples : SortedSamples
        None is lost but repeated ones: of two of one beam at one time, one with a velocity counts.

    Raises
    ------
    InputError
        If the series lacks a variable, holds no sample or a beam that the scan does not have, or its times are none.
    """
    check_is_series(series)
    if series.sizes["sample"] == 0:
        raise InputError("Invalid series: it holds no sample; give files with samples.")
    if not np.issubdtype(series["time"].dtype, np.datetime64) or bool(np.isnat(series["time"].values).any()):
        raise InputError("Invalid series: every time must be a UTC time of type datetime64; make it with read.")
    number = np.asarray(series["beam"].values)
    present = distinct(number)
    for beam in present:
        if beam not in scan.beam:
            raise InputError(
                f"Unknown beam {beam} in the series: the beams of scan {scan.name!r} are {scan.beam.tolist()}; "
                "give the scan that the series was read with."
            )
    numbers = scan.beam[np.isin(scan.beam, present)]
    by_number = np.argsort(numbers)
    beam = by_number[np.searchsorted(numbers, number, sorter=by_number)]
    time = series["time"].values.astype("datetime64[ns]").astype(np.int64)
    velocity = series["radial_velocity"].values.astype(np.float64)
    order, repeated = _ordered(time, beam, velocity)
    wanted = dict.fromkeys([*needed, *(name for name in OPTIONAL_COLUMNS if name in series.variables)])
    return SortedSamples(
        time=time[order],
        beam=beam[order],
        velocity=velocity[order],
        columns={name: _column(series, name, needed.get(name, ""))[order] for name in wanted},
        numbers=numbers,
        out_of_order=_out_of_order(time, beam),
        duplicates=repeated,
        velocity_limit=float(series.attrs.get("velocity_limit", VELOCITY_LIMIT)),
    )


def _ordered(time: IntArray, beam: IntArray, velocity: FloatArray) -> tuple[IntArray, int]:
    """Return the order of beams and, of each, of time, without repeated samples; and how many of these there are."""
    if is_sorted(time) and len(time) and beam.max() < np.iinfo(np.int16).max:
        order = np.argsort(beam.astype(np.int16), kind="stable")
        repeated = (np.diff(time[order]) == 0) & (np.diff(beam[order]) == 0)
        if not repeated.any():
            return order, 0
    order = np.lexsort((np.isnan(velocity), time, beam))
    repeated = np.zeros(len(order), dtype=bool)
    repeated[1:] = (np.diff(time[order]) == 0) & (np.diff(beam[order]) == 0)
    return order[~repeated], int(repeated.sum())


def _out_of_order(time: IntArray, beam: IntArray) -> int:
    """Count the samples earlier than one of the same beam before them."""
    if is_sorted(time):
        return 0
    latest = pd.Series(time).groupby(beam).cummax().to_numpy()
    return int((time < latest).sum())


def _column(series: xr.Dataset, name: str, option: str) -> FloatArray:
    if name not in series.variables:
        how = "map it with the option columns when reading" if name in OPTIONAL_COLUMNS else "add it to the series"
        raise InputError(f"Invalid {option}: the series has no {name}; {how}, or leave {option.partition(' ')[0]} out.")
    variable = series[name]
    if variable.dims != ("sample",) or variable.dtype.kind not in "biuf":
        raise InputError(
            f"Invalid variable {name!r} of the series: it must hold numbers over the dimension 'sample', not "
            f"{variable.dtype} over {variable.dims}."
        )
    return np.asarray(variable.values, dtype=np.float64)
