"""Counts for the report of records: samples by what became of them, records and beams by their flags."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality.belief import of_unset_clock
from bayes_rs.quality.filtering import Filtered
from bayes_rs.quality.samples import IntArray
from bayes_rs.records.flags import BEAM_FLAGS, RECORD_FLAGS, REMARK_FLAGS, count_flags
from bayes_rs.records.record_samples import SortedSamples
from bayes_rs.records.sample_interval import cycle_report
from bayes_rs.records.spike_counts import spikes_report

_AHEAD = 0.5
"""Mean of the beams' components along the axis from which on a scan has a front, so that wind can come from behind."""
_RARELY = 0.5
"""A beam that is flagged in more than this share of the records with samples is reported as rarely usable."""


def samples_report(came: SortedSamples, filtered: Filtered, n_sample: int) -> dict[str, Any]:
    """Count the samples: n_sample = duplicates + dropped by each filter + used, in all and for each beam."""

    def by_beam(chosen: NDArray[np.bool_]) -> list[int]:
        return [int(count) for count in np.bincount(came.beam[chosen], minlength=len(came.numbers))]

    return {
        "samples": n_sample,
        "samples_out_of_order": came.out_of_order,
        "duplicates_dropped": came.duplicates,
        "dropped": filtered.counts(),
        "samples_used": int(np.count_nonzero(filtered.keep)),
        "by_beam": {
            "beam": came.numbers.tolist(),
            "samples": by_beam(np.ones(len(came.beam), dtype=bool)),
            **{name: by_beam(filtered.dropped_by(name)) for name, number in filtered.counts().items() if number},
            "used": by_beam(filtered.keep),
        },
    }


def wind_from_behind(yaw: FloatArray, scan: Scan) -> NDArray[np.bool_]:
    """Return which winds, degrees from the lidar's axis, come from behind a scan that has a front; else none."""
    looks_ahead = -scan.level_direction[:, 0].mean() > _AHEAD
    return np.asarray((np.abs(yaw) > 90.0) & looks_ahead)


def flags_report(records: xr.Dataset, numbers: IntArray, scan: Scan, window: int) -> dict[str, Any]:
    """Count records and beams by their flags; `numbers` are those of the beams, `window` is a record's length, ns."""
    flag, start = records["flag"].values, records["time"].values
    never = (records["count"].values == 0).all(axis=0)
    empty = (flag & BEAM_FLAGS["no_samples"] > 0).all(axis=1)
    whole = (flag & BEAM_FLAGS["cut_off"] == 0).all(axis=1)
    flagged = (flag[~empty & whole] & ~np.uint8(BEAM_FLAGS["record_excluded"])) != 0
    rarely = (flagged.sum(axis=0) > _RARELY * len(flagged)) & ~never
    unset = of_unset_clock(start)
    far = np.flatnonzero(np.diff(start.astype("datetime64[ns]").astype(np.int64)) > window)
    return {
        "records": len(flag),
        "records_without_samples": int(empty.sum()),
        "long_gaps": [[f"{start[index + step].astype('datetime64[s]')}Z" for step in (0, 1)] for index in far.tolist()],
        "records_of_unset_clock": {
            "count": int(np.count_nonzero(unset)),
            **({"first_time": f"{start[int(np.argmax(unset))].astype('datetime64[s]')}Z"} if unset.any() else {}),
        },
        "beams_never_usable": numbers[never].tolist(),
        "beams_rarely_usable": numbers[rarely].tolist(),
        "few_samples": _few_samples(records),
        "beam_flags": count_flags(flag, BEAM_FLAGS, start, numbers),
        "record_flags": count_flags(records["record_flag"].values, {**RECORD_FLAGS, **REMARK_FLAGS}, start, None),
        **spikes_report(records),
        **cycle_report(records, scan),
        "records_with_wind_from_behind": int(wind_from_behind(records["yaw"].values, scan).sum()),
    }


def _few_samples(records: xr.Dataset) -> dict[str, float]:
    """Return the least, the usual and the largest number of samples of beams that have too few; empty if none has."""
    few = (records["flag"].values & BEAM_FLAGS["too_few_samples"]) > 0
    few &= (records["flag"].values & BEAM_FLAGS["cut_off"]) == 0
    count = records["count"].values[few]
    if not len(count):
        return {}
    return {"least": float(count.min()), "usual": float(np.median(count)), "most": float(count.max())}
