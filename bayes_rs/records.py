"""Records: one variance, mean and count per averaging period and beam, with flags, from radial velocities."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_count, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.quality import IntArray, QualityRules, usable
from bayes_rs.scan import Scan

BEAM_FLAGS = {"too_few_samples": 1, "constant": 2, "all_missing": 4, "no_samples": 8}
RECORD_FLAGS = {"yaw_not_seen": 1, "wind_not_seen": 2, "beam_flagged": 4, "no_usable_beam": 8}

_DAY = 86_400_000_000_000  # ns
_MOST_ENTRIES = 100_000_000
_RANK_TOLERANCE = 1e-6  # of the largest singular value; beams closer than this cannot tell wind directions apart


@dataclass(frozen=True)
class _Samples:
    """The samples of a series beam after beam, each in time's order, none twice."""

    time: IntArray
    beam: IntArray
    velocity: FloatArray
    cnr: FloatArray | None
    status: FloatArray | None
    numbers: IntArray
    out_of_order: int
    duplicates: int


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

    Returns
    -------
    records : xarray.Dataset
        ``variance`` (record, beam), m² s⁻²; ``mean`` (record, beam), m/s; ``count`` and ``flag`` (record, beam);
        ``wind_speed`` (record), m/s; ``yaw`` (record), the wind direction relative to the lidar axis, degrees; ``tilt``
        (record), degrees, the scan's; ``record_flag`` (record). Coordinates ``time`` (record), the start in UTC, and
        ``beam``: those of the scan's beams that the series holds; the others stand in ``attrs["beams_absent"]``.
        Every window from the first to the last sample is there, even if empty. ``flag`` is zero for a beam to be used;
        a flagged beam keeps its numbers where they exist. ``attrs["records_report"]`` counts in JSON what was dropped.

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

    Flags of a beam (bits): 1 ``too_few_samples``; 2 ``constant``, all samples equal; 4 ``all_missing``, samples but
    none usable; 8 ``no_samples``, a gap. Flags of a record: 1 ``yaw_not_seen``; 2 ``wind_not_seen``, wind speed and
    yaw are NaN; 4 ``beam_flagged``, at least one; 8 ``no_usable_beam``.

    Examples
    --------
    >>> from bayes_rs.scan_file import load_scan
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
    samples = _sorted_samples(series, scan)
    if cnr_range is not None and samples.cnr is None:
        raise InputError(
            f"Invalid cnr_range {cnr_range!r} dB: the series has no cnr; map it with the option columns when reading, "
            "or leave cnr_range out."
        )
    rules = QualityRules(series.attrs.get("status_valid"), cnr_range, despike, despike_window, despike_threshold)

    first = int(samples.time.min()) // window
    n_record, n_beam = int(samples.time.max()) // window - first + 1, len(samples.numbers)
    _check_size(n_record, n_beam, samples.time, duration)
    group = samples.beam * n_record + samples.time // window - first
    keep, dropped = usable(samples.velocity, samples.beam, group, cnr=samples.cnr, status=samples.status, rules=rules)
    given = np.bincount(group, minlength=n_record * n_beam)
    count, mean, variance, constant = _moments(samples.velocity[keep], group[keep], n_record * n_beam)
    flag = (
        BEAM_FLAGS["too_few_samples"] * (count < needed - 1e-9)
        + BEAM_FLAGS["constant"] * constant
        + BEAM_FLAGS["all_missing"] * ((given > 0) & (count == 0))
        + BEAM_FLAGS["no_samples"] * (given == 0)
    ).astype(np.uint8)
    table = {
        name: values.reshape(n_beam, n_record).T.copy()
        for name, values in {"variance": variance, "mean": mean, "count": count, "flag": flag}.items()
    }
    start = ((first + np.arange(n_record)) * window).astype("datetime64[ns]")
    wind = _mean_wind(table["mean"], table["flag"] == 0, scan.select(samples.numbers))
    absent = [number for number in scan.beam.tolist() if number not in samples.numbers]
    report = {
        "samples": int(series.sizes["sample"]),
        "samples_out_of_order": samples.out_of_order,
        "duplicates_dropped": samples.duplicates,
        "dropped": dropped,
        "samples_used": int(keep.sum()),
        "records": n_record,
        "records_without_samples": int((table["flag"] & BEAM_FLAGS["no_samples"] > 0).all(axis=1).sum()),
        "beams_never_usable": samples.numbers[(table["count"] == 0).all(axis=0)].tolist(),
        "beam_flags": _count_flags(table["flag"], BEAM_FLAGS, start, samples.numbers),
        "record_flags": _count_flags(wind[2], RECORD_FLAGS, start, None),
        "records_with_wind_from_behind": int((np.abs(wind[1]) > 90.0).sum()),
        "samples_needed": float(needed),
        "samples_expected": expected,
        "duration": float(duration),
        "status_valid": rules.status_valid,
        "cnr_range": None if cnr_range is None else [float(bound) for bound in cnr_range],
        "despike": despike,
        "despike_window": despike_window,
        "despike_threshold": despike_threshold,
    }
    return _dataset(table, wind, start, samples.numbers, scan).assign_attrs(
        {
            **{key: series.attrs[key] for key in ("source_files", "read_report") if key in series.attrs},
            "scan_key": scan.key,
            "duration": float(duration),
            "beams_absent": json.dumps(absent),
            "records_report": json.dumps(report),
        }
    )


def describe_report(dataset: xr.Dataset) -> list[str]:
    """Say in plain lines what was read, dropped and flagged.

    Parameters
    ----------
    dataset : xarray.Dataset
        A series or records, with ``read_report`` or ``records_report`` in its attributes.

    Returns
    -------
    lines : list of str
        One fact each; empty if the dataset carries no report.

    Examples
    --------
    >>> describe_report(xr.Dataset())
    []
    """
    lines = []
    if "read_report" in dataset.attrs:
        lines += _describe_reading(json.loads(dataset.attrs["read_report"]))
    if "records_report" in dataset.attrs:
        lines += _describe_records(json.loads(dataset.attrs["records_report"]))
    return lines


def _window_ns(duration: float) -> int:
    window = round(check_positive(duration, what="duration", unit="s") * 1e9)
    if window == 0 or (_DAY % window and window % _DAY):
        raise InputError(
            f"Invalid duration {duration!r} s: it must divide a day (86400 s) or be whole days, "
            "so that records start on the clock; 600 is usual."
        )
    return window


def _sorted_samples(series: xr.Dataset, scan: Scan) -> _Samples:
    for name in ("radial_velocity", "time", "beam"):
        if name not in series.variables or series[name].dims != ("sample",):
            raise InputError(
                f"Invalid series: it needs {name!r} over the dimension 'sample'; make it with read_radial_velocity."
            )
    if series.sizes["sample"] == 0:
        raise InputError("Invalid series: it holds no sample; give files with samples.")
    if not np.issubdtype(series["time"].dtype, np.datetime64) or bool(np.isnat(series["time"].values).any()):
        raise InputError(
            "Invalid series: every time must be a UTC time of type datetime64; make it with read_radial_velocity."
        )
    number = np.asarray(series["beam"].values)
    present = np.unique(number)
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
    latest = pd.Series(time).groupby(beam).cummax().to_numpy()
    order = np.lexsort((np.isnan(velocity), time, beam))
    repeated = np.zeros(len(order), dtype=bool)
    repeated[1:] = (np.diff(time[order]) == 0) & (np.diff(beam[order]) == 0)
    order = order[~repeated]
    optional = {
        name: series[name].values[order].astype(np.float64) if name in series.variables else None
        for name in ("cnr", "status")
    }
    return _Samples(
        time=time[order],
        beam=beam[order],
        velocity=velocity[order],
        cnr=optional["cnr"],
        status=optional["status"],
        numbers=numbers,
        out_of_order=int((time < latest).sum()),
        duplicates=int(repeated.sum()),
    )


def _check_size(n_record: int, n_beam: int, time: IntArray, duration: float) -> None:
    if n_record * n_beam > _MOST_ENTRIES:
        first, last = (pd.Timestamp(int(end)).isoformat() for end in (time.min(), time.max()))
        raise InputError(
            f"The series from {first} to {last} holds {n_record} records of {duration:g} s: more than {_MOST_ENTRIES} "
            "entries with all beams; check its first and last times, or give a longer duration."
        )


def _moments(
    velocity: FloatArray, group: IntArray, n_group: int
) -> tuple[IntArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return N, mean, variance (divisor N) and whether all values are equal, of each group; `group` is sorted.

    Two passes, about the first sample of the group: a large mean costs no digits.
    """
    count = np.bincount(group, minlength=n_group)
    shift = np.zeros(n_group)
    constant = np.zeros(n_group, dtype=bool)
    filled = np.flatnonzero(count)
    if len(filled):
        start = np.flatnonzero(np.diff(group, prepend=-1))
        shift[filled] = velocity[start]
        constant[filled] = np.minimum.reduceat(velocity, start) == np.maximum.reduceat(velocity, start)
    some = np.where(count > 0, count, np.nan)
    mean_deviation = np.bincount(group, weights=velocity - shift[group], minlength=n_group) / some
    mean = shift + mean_deviation
    deviation = (velocity - shift[group]) - mean_deviation[group]
    residual = np.bincount(group, weights=deviation, minlength=n_group) / some  # zero but for rounding
    variance = np.bincount(group, weights=deviation**2, minlength=n_group) / some - residual**2
    return count.astype(np.int64), mean, variance, constant


def _mean_wind(
    mean: FloatArray, valid: NDArray[np.bool_], scan: Scan
) -> tuple[FloatArray, FloatArray, NDArray[np.uint8]]:
    """Return wind speed, m/s, yaw, degrees, and flags of each record, from the means of the valid beams."""
    n_record = len(mean)
    speed, yaw = np.full(n_record, np.nan), np.full(n_record, np.nan)
    flag = np.where(valid.all(axis=1), 0, RECORD_FLAGS["beam_flagged"]).astype(np.uint8)
    level = scan.level_direction[:, :2]
    along = scan.line_of_sight[:, 0]
    patterns, pattern_of = np.unique(valid, axis=0, return_inverse=True)
    for index, beams in enumerate(patterns):
        rows = pattern_of.ravel() == index
        if not beams.any():
            flag[rows] |= RECORD_FLAGS["no_usable_beam"] | RECORD_FLAGS["wind_not_seen"]
            continue
        seen, v = level[beams], mean[rows][:, beams]
        size = np.linalg.svd(seen, compute_uv=False)
        if len(size) == 2 and size[1] > _RANK_TOLERANCE * size[0]:
            u_level, v_level = np.linalg.pinv(seen) @ v.T
            speed[rows], yaw[rows] = np.hypot(u_level, v_level), np.degrees(np.arctan2(-v_level, u_level))
        elif np.linalg.norm(along[beams]) > _RANK_TOLERANCE:
            n = along[beams]
            projected = v @ n / (n @ n)  # least squares of v = n U
            turned = np.degrees(scan.yaw) + np.where(projected < 0.0, 180.0, 0.0)
            speed[rows], yaw[rows] = np.abs(projected), 180.0 - (180.0 - turned) % 360.0  # in (−180, 180]
            flag[rows] |= RECORD_FLAGS["yaw_not_seen"]
        else:
            flag[rows] |= RECORD_FLAGS["yaw_not_seen"] | RECORD_FLAGS["wind_not_seen"]
    return speed, yaw, flag


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
            "record_flag": ("record", record_flag, _flag_attributes(RECORD_FLAGS)),
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


def _describe_reading(report: Mapping[str, Any]) -> list[str]:
    lines = []
    for file in report["files"]:
        line = f"{file['name']}: {file['rows']} rows ({file['format']})"
        line += f", positive {file['positive']}, {file['velocity_unit']}"
        for key, words in (
            ("rows_invalid_value", "with an invalid value"),
            ("rows_dropped", "dropped without a time or a beam"),
            ("samples_out_of_order", "samples out of order, sorted"),
        ):
            line += f"; {file[key]} {words}" if file[key] else ""
        lines.append(line)
    absent = f"; absent: {_listed(report['beams_absent'])}" if report["beams_absent"] else ""
    lines.append(f"beams in the files: {_listed(report['beams_present'])}{absent}")
    line = f"{report['samples']} samples, {report['samples_without_velocity']} without a velocity"
    if report["duplicates_dropped"]:
        line += f"; {report['duplicates_dropped']} repeated ones dropped"
        line += f", {report['duplicates_that_differ']} of which differ" if report["duplicates_that_differ"] else ""
    return [*lines, line]


def _describe_records(report: Mapping[str, Any]) -> list[str]:
    dropped = ", ".join(f"{name} {number}" for name, number in report["dropped"].items())
    lines = [f"{report['records']} records of {report['duration']:g} s"]
    lines[0] += f"; {report['samples_used']} of {report['samples']} samples used"
    lines[0] += f"; dropped: duplicates {report['duplicates_dropped']}, {dropped}"
    if report["records_without_samples"]:
        lines.append(f"gaps: {report['records_without_samples']} records hold no sample of any beam")
    if report["beams_never_usable"]:
        lines.append(f"beams without a usable sample in any record: {_listed(report['beams_never_usable'])}")
    meaning = {"too_few_samples": f" (fewer than {report['samples_needed']:g})"}
    for kind, what in (("beam_flags", "beams of records"), ("record_flags", "records")):
        for name, counted in report[kind].items():
            if counted["count"]:
                beam = f", beam {counted['first_beam']}" if "first_beam" in counted else ""
                lines.append(
                    f"flag {name}{meaning.get(name, '')}: {counted['count']} of {counted['of']} {what}, "
                    f"first {counted['first_time']}{beam}"
                )
    return lines


def _listed(numbers: list[int]) -> str:
    return ", ".join(str(number) for number in numbers) if len(numbers) <= 12 else f"{len(numbers)} beams"
