"""Records: one variance, mean and count per averaging period and beam, with flags, from radial velocities."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_count, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.quality import Filtered, IntArray, QualityRules, apply_filters, group_moments
from bayes_rs.records.checks import blades_in, check_records, in_wind_sectors
from bayes_rs.records.least_squares import horizontal_wind
from bayes_rs.records.record_samples import SortedSamples, sort_samples
from bayes_rs.records.report import describe_report

__all__ = ["BEAM_FLAGS", "RECORD_FLAGS", "REMARK_FLAGS", "describe_report", "make_records"]

BEAM_FLAGS = {
    "too_few_samples": 1,
    "constant": 2,
    "all_missing": 4,
    "no_samples": 8,
    "wind_sector": 16,
    "record_excluded": 32,
}
RECORD_FLAGS = {"yaw_not_seen": 1, "wind_not_seen": 2, "beam_flagged": 4, "no_usable_beam": 8}
"""Flags of a record that the wind and its beams decide."""
REMARK_FLAGS = {"not_stationary": 16, "low_wind": 32}
"""Flags of a record that are remarks: it is fitted, unless the rules exclude it."""

_DAY = 86_400_000_000_000  # ns
_MOST_ENTRIES = 100_000_000
_DESPIKE = ("despike", "despike_window", "despike_threshold")
_AHEAD = 0.5
"""Mean of the beams' components along the axis from which on a scan has a front, so that wind can come from behind."""
_RARELY = 0.5
"""A beam that is flagged in more than this share of the records with samples is reported as rarely usable."""


def make_records(
    series: xr.Dataset,
    scan: Scan,
    *,
    duration: float = 600.0,
    min_availability: float = 0.8,
    expected_count: float | None = None,
    min_count: int = 10,
    cnr_range: tuple[float, float] | None = None,
    despike: str | None = None,
    despike_window: int = 11,
    despike_threshold: float = 5.0,
    quality: QualityRules | None = None,
) -> xr.Dataset:
    r"""Turn radial velocities into records: the variance of each beam in each averaging period.

    Parameters
    ----------
    series : xarray.Dataset
        Radial velocities, as `read_radial_velocity` returns them: ``radial_velocity`` (sample), m/s, positive away
        from the lidar, with coordinates ``time`` and ``beam``; ``cnr`` and ``status`` if there.
    scan : Scan
        The scan they were measured with.
    duration : float
        Length of a record T, s. Records start on the clock, at whole multiples of it since 1970-01-01 00:00 UTC, so
        it must divide a day or be whole days.
    min_availability : float
        Smallest share of the expected samples, 0 to 1, below which a beam is flagged.
    expected_count : float, optional
        Samples of a beam that a full record holds; T over the scan's duration if not given.
    min_count : int
        Smallest number of samples below which a beam is flagged, whatever was expected.
    cnr_range : tuple of float, optional
        Lowest and highest carrier-to-noise ratio of a good sample, dB.
    despike : {"median"}, optional
        Rule that drops spikes: those further than ``despike_threshold`` robust standard deviations (1.4826 times the
        median absolute deviation over the record) from the running median of ``despike_window`` samples.
    despike_window : int
        Samples in the running median, odd.
    despike_threshold : float
        Robust standard deviations from the running median beyond which a sample is a spike.
    quality : QualityRules, optional
        All rules in one object: these four and many more. Then the four options above must not be given.

    Returns
    -------
    records : xarray.Dataset
        ``variance`` (record, beam), m² s⁻²; ``mean`` (record, beam), m/s; ``count`` and ``flag`` (record, beam);
        ``wind_speed`` (record), m/s; ``yaw`` (record), the wind direction relative to the lidar axis, degrees; ``tilt``
        (record), degrees, the scan's; ``record_flag`` (record). Coordinates ``time`` (record), the start in UTC, and
        ``beam``: those of the scan's beams that the series holds; the others stand in ``attrs["beams_absent"]``.
        Every window from the first to the last sample is there, even if empty. ``flag`` is zero for a beam to be used;
        a flagged beam keeps its numbers where they exist. ``attrs["records_report"]`` counts in JSON what was dropped.
        Checks of `quality` add their numbers: ``trend`` (m/s), ``trend_p_value``, ``sub_variance``, ``half_ratio``
        (record, beam).

    Raises
    ------
    InputError
        If the series lacks a variable or holds a beam that the scan does not have, or an option is not valid.

    Notes
    -----
    The variance has the divisor N, not N − 1, with the record's own mean removed, since the theory of its noise is
    about

    .. math:: s^2 = \frac{1}{N} \sum_{i=1}^{N} (v_i - \bar v)^2 .

    The wind speed and direction are the least-squares solution of the beams' means for a mean wind without vertical
    component, in the levelled lidar frame:

    .. math::
        \bar v_b = n_{b1} U_L + n_{b2} V_L, \qquad U = \sqrt{U_L^2 + V_L^2}, \qquad
        \psi = \mathrm{atan2}(-V_L, U_L) ,

    from the unflagged beams, all at one height: shear is left out. Beams that cannot see V_L (a staring lidar) leave
    ψ to the scan's own yaw, turned by 180° if the projected wind comes from behind, and set ``yaw_not_seen``. Nothing
    is filled or interpolated, no trend is removed.

    Flags of a beam (bits): 1 ``too_few_samples``, some usable, but not enough; 2 ``constant``, all samples equal; 4
    ``all_missing``, samples but none usable; 8 ``no_samples``, a gap; 16 ``wind_sector``, blocked in wind from there;
    32 ``record_excluded``, by its remarks. Flags of a record: 1 ``yaw_not_seen``; 2 ``wind_not_seen``, wind speed and
    yaw are NaN; 4 ``beam_flagged``, at least one; 8 ``no_usable_beam``; and as remarks 16 ``not_stationary``; 32
    ``low_wind``.
    Whether a beam stands in a blocked wind sector is decided by the wind of all unflagged beams; the wind is then
    found again without it.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> time = np.datetime64("2020-09-03T19:00", "ns") + np.arange(600) * np.timedelta64(1, "s")
    >>> series = xr.Dataset(
    ...     {"radial_velocity": ("sample", np.where(np.arange(600) % 2, -9.0, -11.0))},
    ...     coords={"time": ("sample", time), "beam": ("sample", np.zeros(600, dtype=int))},
    ... )
    >>> records = make_records(series, load_scan("staring"))
    >>> records["variance"].values, records["wind_speed"].values
    (array([[1.]]), array([10.]))
    """
    window = _window_ns(duration)
    expected = (
        float(duration) / scan.scan_duration
        if expected_count is None
        else check_positive(expected_count, what="expected_count", unit="")
    )
    share = check_finite(min_availability, what="min_availability", unit="")
    if not 0.0 <= share <= 1.0:
        raise InputError(f"Invalid min_availability {min_availability!r}: it must be from 0 to 1.")
    needed = max(check_count(min_count, what="min_count"), share * expected)
    rules = _rules(quality, cnr_range, despike, despike_window, despike_threshold)
    _check_named_beams(rules, scan)
    came = sort_samples(series, scan, rules.needed_columns())
    if rules.status_valid is None and series.attrs.get("status_valid") is not None:
        rules = replace(rules, status_valid=float(series.attrs["status_valid"]))

    number = came.time // window
    n_record, n_beam = int(number.max() - number.min()) + 1, len(came.numbers)
    _check_size(n_record, n_beam, came.time, duration)
    samples, first = came.in_records(window)
    filtered = apply_filters(samples, rules)
    keep = filtered.keep
    given = np.bincount(samples.group, minlength=samples.n_group)
    count, mean, variance, constant = group_moments(samples.velocity[keep], samples.group[keep], samples.n_group)
    flag = (
        BEAM_FLAGS["too_few_samples"] * ((count > 0) & (count < needed - 1e-9))
        + BEAM_FLAGS["constant"] * constant
        + BEAM_FLAGS["all_missing"] * ((given > 0) & (count == 0))
        + BEAM_FLAGS["no_samples"] * (given == 0)
    ).astype(np.uint8)
    table = {
        name: values.reshape(n_beam, n_record).T.copy()
        for name, values in {"variance": variance, "mean": mean, "count": count, "flag": flag}.items()
    }
    start = ((first + np.arange(n_record)) * window).astype("datetime64[ns]")

    def with_wind() -> xr.Dataset:
        wind = _mean_wind(table["mean"], table["flag"] == 0, scan.select(samples.numbers))
        return _dataset(table, wind, start, samples.numbers, scan)

    records = with_wind()
    if rules.wind_sectors:
        blocked = in_wind_sectors(records["yaw"].values, samples.numbers, rules)
        table["flag"][blocked] |= BEAM_FLAGS["wind_sector"]
        records = with_wind()
    remarks = check_records(
        samples, keep, rules, window=window, used=table["flag"] == 0, wind_speed=records["wind_speed"].values
    )
    records = records.assign(remarks.variables)
    for name, rows in remarks.records.items():
        records["record_flag"].values[rows] |= REMARK_FLAGS[name]
        if name in rules.exclude:
            records["flag"].values[rows] |= BEAM_FLAGS["record_excluded"]
    report = {
        **_report_of_samples(came, filtered, int(series.sizes["sample"])),
        **_report_of_records(records, came.numbers, scan),
        "blades": blades_in(samples, filtered, rules),
        "samples_needed": float(needed),
        "samples_expected": expected,
        "duration": float(duration),
        **{name: getattr(rules, name) for name in ("status_valid", "cnr_range", *_DESPIKE)},
        "quality": asdict(rules),
    }
    absent = [number for number in scan.beam.tolist() if number not in samples.numbers]
    return records.assign_attrs(
        {
            **{key: series.attrs[key] for key in ("source_files", "read_report") if key in series.attrs},
            "scan_key": scan.key,
            "duration": float(duration),
            "beams_absent": json.dumps(absent),
            "records_report": json.dumps(report),
        }
    )


def _rules(
    quality: QualityRules | None,
    cnr_range: tuple[float, float] | None,
    despike: str | None,
    despike_window: int,
    despike_threshold: float,
) -> QualityRules:
    by_keyword = QualityRules(
        cnr_range=cnr_range, despike=despike, despike_window=despike_window, despike_threshold=despike_threshold
    )
    if quality is None:
        return by_keyword
    if by_keyword != QualityRules():
        raise InputError(
            "Both quality and one of cnr_range, despike, despike_window, despike_threshold are given: "
            "give it as part of quality, QualityRules(cnr_range=...)."
        )
    if not isinstance(quality, QualityRules):
        raise InputError(f"Invalid quality {quality!r}: it must be a QualityRules, as QualityRules(despike='median').")
    return quality


def _check_named_beams(rules: QualityRules, scan: Scan) -> None:
    for number in sorted(rules.named_beams()):
        if number not in scan.beam:
            raise InputError(
                f"Unknown beam {number} in quality: the beams of scan {scan.name!r} are {scan.beam.tolist()}."
            )


def _report_of_samples(came: SortedSamples, filtered: Filtered, n_sample: int) -> dict[str, Any]:
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


def _report_of_records(records: xr.Dataset, numbers: IntArray, scan: Scan) -> dict[str, Any]:
    flag, start = records["flag"].values, records["time"].values
    never = (records["count"].values == 0).all(axis=0)
    empty = (flag & BEAM_FLAGS["no_samples"] > 0).all(axis=1)
    flagged = (flag[~empty] & ~np.uint8(BEAM_FLAGS["record_excluded"])) != 0
    rarely = (flagged.mean(axis=0) > _RARELY) & ~never
    looks_ahead = -scan.level_direction[:, 0].mean() > _AHEAD
    return {
        "records": len(flag),
        "records_without_samples": int(empty.sum()),
        "beams_never_usable": numbers[never].tolist(),
        "beams_rarely_usable": numbers[rarely].tolist(),
        "beam_flags": _count_flags(flag, BEAM_FLAGS, start, numbers),
        "record_flags": _count_flags(records["record_flag"].values, {**RECORD_FLAGS, **REMARK_FLAGS}, start, None),
        "records_with_wind_from_behind": int(looks_ahead and (np.abs(records["yaw"].values) > 90.0).sum()),
    }


def _window_ns(duration: float) -> int:
    window = round(check_positive(duration, what="duration", unit="s") * 1e9)
    if window == 0 or (_DAY % window and window % _DAY):
        raise InputError(
            f"Invalid duration {duration!r} s: it must divide a day (86400 s) or be whole days, "
            "so that records start on the clock; 600 is usual."
        )
    return window


def _check_size(n_record: int, n_beam: int, time: IntArray, duration: float) -> None:
    if n_record * n_beam > _MOST_ENTRIES:
        first, last = (pd.Timestamp(int(end)).isoformat() for end in (time.min(), time.max()))
        raise InputError(
            f"The series from {first} to {last} holds {n_record} records of {duration:g} s: more than {_MOST_ENTRIES} "
            "entries with all beams; check its first and last times, or give a longer duration."
        )


def _mean_wind(
    mean: FloatArray, valid: NDArray[np.bool_], scan: Scan
) -> tuple[FloatArray, FloatArray, NDArray[np.uint8]]:
    """Return wind speed, m/s, yaw, degrees, and flags of each record, from the means of the valid beams."""
    wind = horizontal_wind(mean, valid, scan.level_direction, scan.yaw)
    usable_beam = valid.any(axis=1)
    flag = (
        RECORD_FLAGS["beam_flagged"] * ~valid.all(axis=1)
        + RECORD_FLAGS["no_usable_beam"] * ~usable_beam
        + RECORD_FLAGS["yaw_not_seen"] * (usable_beam & ~wind.yaw_seen)
        + RECORD_FLAGS["wind_not_seen"] * ~wind.wind_seen
    ).astype(np.uint8)
    return wind.speed, np.degrees(wind.yaw), flag


def _dataset(
    table: Mapping[str, NDArray[Any]],
    wind: tuple[FloatArray, FloatArray, NDArray[np.uint8]],
    start: NDArray[np.datetime64],
    numbers: IntArray,
    scan: Scan,
) -> xr.Dataset:
    wind_speed, yaw, record_flag = wind
    both = ("record", "beam")
    variance = {"units": "m2 s-2", "long_name": "variance of the radial velocity, record mean removed, divisor N"}
    mean = {"units": "m s-1", "long_name": "mean radial velocity, positive away from the lidar"}
    count = {"long_name": "number of samples used"}
    speed = {"units": "m s-1", "long_name": "mean horizontal wind speed from the beam means"}
    angle = {"units": "degree", "long_name": "wind direction relative to the lidar axis"}
    return xr.Dataset(
        {
            "variance": (both, table["variance"], variance),
            "mean": (both, table["mean"], mean),
            "count": (both, table["count"], count),
            "flag": (both, table["flag"], _flag_attributes(BEAM_FLAGS)),
            "wind_speed": ("record", wind_speed, speed),
            "yaw": ("record", yaw, angle),
            "tilt": ("record", np.full(len(start), np.degrees(scan.tilt)), {"units": "degree"}),
            "record_flag": ("record", record_flag, _flag_attributes({**RECORD_FLAGS, **REMARK_FLAGS})),
        },
        coords={"time": ("record", start, {"long_name": "start of the record, UTC"}), "beam": ("beam", numbers)},
        attrs={"scan": scan.name},
    )


def _flag_attributes(flags: Mapping[str, int]) -> dict[str, Any]:
    return {"flag_masks": np.array(list(flags.values()), dtype=np.uint8), "flag_meanings": " ".join(flags)}


def _count_flags(
    flag: NDArray[np.uint8], meanings: Mapping[str, int], start: NDArray[np.datetime64], numbers: IntArray | None
) -> dict[str, dict[str, Any]]:
    """Count each flag, and say where it first stands."""
    counted: dict[str, dict[str, Any]] = {}
    for name, mask in meanings.items():
        where = np.argwhere(flag & mask)
        counted[name] = {"count": len(where), "of": int(flag.size)}
        if len(where):
            counted[name]["first_time"] = str(start[where[0][0]].astype("datetime64[s]")) + "Z"
            if numbers is not None:
                counted[name]["first_beam"] = int(numbers[where[0][1]])
    return counted
