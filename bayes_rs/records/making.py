"""Records: one variance, mean and count per averaging period and beam, with flags, from radial velocities."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.quality.filtering import Filtered, apply_filters
from bayes_rs.quality.groups import group_moments
from bayes_rs.quality.octaves import octave_count, record_octaves
from bayes_rs.quality.rules import QualityRules
from bayes_rs.quality.samples import BeamSamples, IntArray
from bayes_rs.readers.ranged_series import scan_of_series, stacked
from bayes_rs.records.beam_correlation import beam_correlation
from bayes_rs.records.beam_wind import wind_of_beams
from bayes_rs.records.belief import impossible_in, most_variance
from bayes_rs.records.block_statistics import block_statistics
from bayes_rs.records.checks import blades_in, check_records, in_wind_sectors
from bayes_rs.records.counts import flags_report, samples_report
from bayes_rs.records.flags import BEAM_FLAGS, RECORD_FLAGS, REMARK_FLAGS, flag_attributes
from bayes_rs.records.given import check_is_series, warn_of_other_scan
from bayes_rs.records.grid import on_grid
from bayes_rs.records.layout import REPORT
from bayes_rs.records.ranges import stack_ranges
from bayes_rs.records.record_options import RecordOptions, record_options
from bayes_rs.records.record_samples import sort_samples
from bayes_rs.records.sample_interval import interval_of_records
from bayes_rs.records.spike_counts import has_spikes, spikes_of_records
from bayes_rs.records.windows import is_touched, record_windows

_FROM_SERIES = ("source_files", "read_report", "velocity_limit")
"""Attributes that records have from their series."""
OCTAVES = "octave_variance"
"""Variable that holds the octaves of the variances."""
_TOLD = ("status_valid", "cnr_range", "despike", "despike_window", "despike_threshold")
"""Rules that the report names beside all of them."""


def make_records(
    series: xr.Dataset, scan: str | Path | Scan, *, quality: QualityRules | None = None, **options: Any
) -> xr.Dataset:
    r"""Turn radial velocities into records: the variance of each beam in each averaging period.

    Parameters
    ----------
    series : xarray.Dataset
        Radial velocities, as `read` returns them: ``radial_velocity`` (sample), m/s, positive away
        from the lidar, with coordinates ``time`` and ``beam``; ``cnr`` and ``status`` if there.
    scan : Scan, str or Path
        The scan they were measured with, or its name or file.
    quality : QualityRules, optional
        Which samples count, and which records are remarked on; by default only missing samples and those with a bad
        status are dropped.
    **options
        The fields of `bayes_rs.records.RecordOptions` but those of motion, as ``duration=1800.0`` or
        ``min_availability=0.5``.

    Returns
    -------
    records : xarray.Dataset
        ``variance`` (record, beam), m² s⁻²; ``mean`` (record, beam), m/s; ``count`` and ``flag`` (record, beam);
        ``wind_speed`` (record), m/s; ``yaw`` (record), the wind direction relative to the lidar axis, degrees; ``tilt``
        (record), degrees, the scan's; ``record_flag`` (record). Coordinates ``time`` (record), the start in UTC, and
        ``beam``: those of the scan's beams that the series holds; the others stand in ``attrs["beams_absent"]``.
        Every window from the first to the last sample is there, even if empty, but for gaps of more than 30 days.
        ``first_sample`` and ``last_sample`` (record) are those of any beam, s after the start. ``flag`` is zero for a
        beam to be used; a flagged beam keeps its numbers where they exist. ``attrs["records_report"]`` counts in JSON
        what was dropped. Checks of `quality` add their numbers: ``trend`` (m/s), ``trend_p_value``, ``sub_variance``,
        ``half_ratio`` (record, beam). ``octave_variance`` (record, beam, octave), m² s⁻², is what
        halves, quarters, … down to the samples add to the variance (`bayes_rs.quality.octaves`): it tells the length
        scale. What the parts of a record tell of its steadiness and of the
        scatter of its variance stands in ``part_beams`` (record), ``part_wind``, ``part_wind_across`` (record, part),
        ``block_scatter`` and ``block_scatter_of_beams`` (record, blocks); see ``docs/quality.md``.
        ``spike_count`` and ``spike_variance`` (record, beam) are the samples that count and lie far outside the others
        of their beam, and what they add to its variance, m² s⁻². ``sample_interval`` (record), s, is the usual time
        between samples of a beam. With ``correlations=True``, ``beam_correlation``
        (record, beam_pair) is how the beams go together; see ``docs/covariances.md``.

    Raises
    ------
    InputError
        If the series lacks a variable or holds a beam that the scan does not have, an option is not valid, or most of
        the velocities are impossible.

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
    32 ``record_excluded``, by its remarks; 64 ``impossible``, a variance that no atmosphere has; 128 ``cut_off``, too
    few samples because the data begin or end within the record. Flags of a record: 1 ``yaw_not_seen``; 2
    ``wind_not_seen``, wind speed and yaw are NaN; 4 ``beam_flagged``, at least one; 8 ``no_usable_beam``; and as
    remarks 16 ``not_stationary``; 32 ``low_wind``; 64 ``spikes``.

    Velocities beyond ``attrs["velocity_limit"]`` of the series, 90 m/s if it has none, count as missing, as the filter
    ``impossible``; a variance is impossible beyond the square of a third of it, 900 m² s⁻².

    Spikes (``QualityRules(despike="median")``) are samples further than ``despike_threshold`` robust standard
    deviations (1.4826 times the median absolute deviation over the record) from the running median of
    ``despike_window`` samples.

    Whether a beam stands in a blocked wind sector is decided by the wind of all unflagged beams; the wind is then
    found again without it.

    Examples
    --------
    >>> time = np.datetime64("2020-09-03T19:00", "ns") + np.arange(600) * np.timedelta64(1, "s")
    >>> series = xr.Dataset(
    ...     {"radial_velocity": ("sample", np.where(np.arange(600) % 2, -9.0, -11.0))},
    ...     coords={"time": ("sample", time), "beam": ("sample", np.zeros(600, dtype=int))},
    ... )
    >>> records = make_records(series, "staring")
    >>> records["variance"].values, records["wind_speed"].values
    (array([[1.]]), array([10.]))
    """
    of_scan, chosen = as_scan(scan), record_options(options)
    check_is_series(series, ranges=True)
    warn_of_other_scan(series, of_scan)
    at_ranges = scan_of_series(series, of_scan)
    if isinstance(at_ranges, RangedScan):
        return _at_ranges(stacked(series, at_ranges), at_ranges, quality, options)
    rules = _rules(quality, series, of_scan)
    came = sort_samples(series, of_scan, rules.needed_columns())
    samples, windows = came.in_records(chosen.window)
    filtered = apply_filters(samples, rules)
    impossible = impossible_in(samples, filtered)
    start = (windows * chosen.window).astype("datetime64[ns]")
    records = _with_wind(_moments(samples, filtered, chosen.needed(of_scan)), start, samples, of_scan, rules)
    more: dict[str, Any] = {
        **block_statistics(samples, filtered.keep, of_scan, window=chosen.window, used=records["flag"].values == 0)
    }
    of_beams: Mapping[str, str] = {}
    if chosen.correlations:
        together, of_beams = beam_correlation(samples, filtered.keep, of_scan, needed=chosen.needed(of_scan))
        more |= together
    more |= _remarks(records, samples, filtered, rules, chosen.window)
    more |= _octaves(samples, filtered, chosen.window, octave_count(chosen.expected(of_scan)))
    more |= spikes_of_records(samples, filtered.keep, records["variance"].values, window=rules.despike_window)
    more |= interval_of_records(samples, of_scan.scan_duration)
    records = records.assign({**more, **_span(samples, chosen)})  # together: each time takes 1 ms
    records = with_cut_off(records, of_scan, chosen)
    records["record_flag"].values[has_spikes(records)] |= REMARK_FLAGS["spikes"]
    report = {
        **samples_report(came, filtered, int(series.sizes["sample"])),
        **impossible,
        **flags_report(records, came.numbers, of_scan, chosen.window),
        "blades": blades_in(samples, filtered, rules),
        **_asked(chosen, rules, of_scan),
    }
    absent = [number for number in of_scan.beam.tolist() if number not in samples.numbers]
    return records.assign_attrs(
        {
            **of_beams,
            **{key: series.attrs[key] for key in _FROM_SERIES if key in series.attrs},
            "scan_key": of_scan.key,
            "duration": chosen.duration,
            "beams_absent": json.dumps(absent),
            "records_report": json.dumps(report),
        }
    )


def _at_ranges(
    series: xr.Dataset, scan: RangedScan, quality: QualityRules | None, options: Mapping[str, Any]
) -> xr.Dataset:
    """Make the records of each range, all of the same windows and beams."""
    if series.sizes["sample"] == 0:
        raise InputError("Invalid series: it holds no sample; give files with samples.")
    index, beam = scan.split(series["beam"].values)
    made = {}
    for place in np.unique(index).tolist():
        rows = np.flatnonzero(index == place)
        own = series.isel(sample=rows).assign_coords(beam=("sample", beam[rows]))
        made[place] = make_records(own, scan.at(place), quality=quality, **options)
    columns = {str(name): values.values for name, values in series.data_vars.items() if values.dims == ("sample",)}
    no_sample = partial(
        empty_record, columns, series.attrs, int(scan.of_one.beam[0]), scan.at(0), quality=quality, **options
    )
    return stack_alike(made, scan, record_options(options).window, no_sample)


def empty_record(
    columns: Mapping[str, NDArray[Any]],
    attributes: Mapping[str, Any],
    beam: int,
    scan: Scan,
    *,
    quality: QualityRules | None = None,
    **options: Any,
) -> xr.Dataset:
    """Return what `make_records` says of a record and beam without a sample: the second of three, of one beam.

    Parameters
    ----------
    columns, attributes : mapping
        Variables over the samples, and attributes, of a series.
    beam : int
        A beam of it.
    scan, quality, options
        As for `make_records`.
    """
    window = record_options(options).window
    series = xr.Dataset(
        {name: ("sample", np.zeros(2, dtype=values.dtype)) for name, values in columns.items()},
        coords={
            "time": ("sample", np.array([0, 2 * window]).astype("datetime64[ns]")),
            "beam": ("sample", np.full(2, beam, dtype=np.int64)),
        },
        attrs=dict(attributes),
    )
    return make_records(series, scan, quality=quality, **options).isel(record=1)


def windows_of(
    blocks: Iterable[xr.Dataset], window: int, n_beam: int, *, later: int | None = None
) -> NDArray[np.int64]:
    """Return the numbers of the windows, since 1970, from the first record of some blocks to the last.

    With the number of a `later` window that has a sample, up to that one, which is not among them.
    """
    number = [block["time"].values.astype("datetime64[ns]").astype(np.int64) // window for block in blocks]
    if later is None:
        return record_windows(np.concatenate(number), window, n_beam)
    return record_windows(np.concatenate([*number, [later]]), window, n_beam)[:-1]


def stack_alike(
    made: Mapping[int, xr.Dataset], scan: RangedScan, window: int, empty: Callable[[], xr.Dataset]
) -> xr.Dataset:
    """Return records of several ranges as one dataset: all have the records, and the beams, that any of them has.

    Parameters
    ----------
    made : mapping of int to Dataset
        Records by the place of their range; ranges without a sample are not in it.
    scan : RangedScan
        The scan at these ranges.
    window : int
        Length of a record, ns.
    empty : callable
        Returns what a record and beam without a sample are, as `empty_record` does.
    """
    base = scan.of_one
    present = np.unique(np.concatenate([part["beam"].values for part in made.values()]))
    beams = base.beam[np.isin(base.beam, present)]
    windows = windows_of(made.values(), window, len(beams))
    start = (windows * window).astype("datetime64[ns]")
    absent = json.dumps([number for number in base.beam.tolist() if number not in beams])
    first = next(iter(made.values()))
    parts = []
    for place in range(scan.n_range):
        own = made.get(place)
        if own is not None and np.array_equal(own["time"].values, start) and np.array_equal(own["beam"].values, beams):
            parts.append(own)
            continue
        blocks = [first.isel(record=[], beam=[]) if own is None else own]
        part = on_grid(blocks, empty(), windows=windows, beams=beams, window=window)
        if own is None:
            part.attrs = {name: value for name, value in part.attrs.items() if name != REPORT}
        else:
            report = json.loads(own.attrs[REPORT])
            counted = flags_report(part, beams, scan.at(place), window)
            part.attrs[REPORT] = json.dumps({**report, **counted})
        parts.append(part.assign_attrs(scan_key=scan.at(place).key, beams_absent=absent))
    return stack_ranges(parts, scan)


def _rules(quality: QualityRules | None, series: xr.Dataset, scan: Scan) -> QualityRules:
    """Return the rules, checked against the scan, with the status that the series calls valid."""
    rules = QualityRules() if quality is None else quality
    if not isinstance(rules, QualityRules):
        raise InputError(f"Invalid quality {quality!r}: it must be a QualityRules, as QualityRules(despike='median').")
    for number in sorted(rules.named_beams()):
        if number not in scan.beam:
            raise InputError(
                f"Unknown beam {number} in quality: the beams of scan {scan.name!r} are {scan.beam.tolist()}."
            )
    valid = series.attrs.get("status_valid") if "status" in series else None
    return rules if rules.status_valid is not None or valid is None else replace(rules, status_valid=float(valid))


def _moments(samples: BeamSamples, filtered: Filtered, needed: float) -> dict[str, NDArray[Any]]:
    """Return variance, mean, count and flag of each record and beam, shape (n_record, n_beam)."""
    keep, n_beam = filtered.keep, len(samples.numbers)
    given = np.bincount(samples.group, minlength=samples.n_group)
    count, mean, variance, constant = group_moments(samples.velocity[keep], samples.group[keep], samples.n_group)
    flag = (
        BEAM_FLAGS["too_few_samples"] * ((count > 0) & (count < needed - 1e-9))
        + BEAM_FLAGS["constant"] * constant
        + BEAM_FLAGS["impossible"] * (variance > most_variance(samples.velocity_limit))
        + BEAM_FLAGS["all_missing"] * ((given > 0) & (count == 0))
        + BEAM_FLAGS["no_samples"] * (given == 0)
    ).astype(np.uint8)
    return {
        name: values.reshape(n_beam, samples.n_record).T.copy()
        for name, values in {"variance": variance, "mean": mean, "count": count, "flag": flag}.items()
    }


def _with_wind(
    table: dict[str, NDArray[Any]],
    start: NDArray[np.datetime64],
    samples: BeamSamples,
    scan: Scan,
    rules: QualityRules,
) -> xr.Dataset:
    """Return the records with their wind, found without the beams in blocked sectors."""
    seen = scan.select(samples.numbers)

    def found() -> xr.Dataset:
        wind = wind_of_beams(table["mean"], table["flag"] == 0, seen)
        return _dataset(table, wind, start, samples.numbers, scan)

    records = found()
    if rules.wind_sectors:
        blocked = in_wind_sectors(records["yaw"].values, samples.numbers, rules)
        table["flag"][blocked] |= BEAM_FLAGS["wind_sector"]
        records = found()
    return records


def _remarks(
    records: xr.Dataset, samples: BeamSamples, filtered: Filtered, rules: QualityRules, window: int
) -> dict[str, Any]:
    """Return the numbers of the checks; flag the records, in place, and all beams of those to exclude."""
    remarks = check_records(
        samples,
        filtered.keep,
        rules,
        window=window,
        used=records["flag"].values == 0,
        wind_speed=records["wind_speed"].values,
    )
    for name, rows in remarks.records.items():
        records["record_flag"].values[rows] |= REMARK_FLAGS[name]
        if name in rules.exclude:
            records["flag"].values[rows] |= BEAM_FLAGS["record_excluded"]
    return remarks.variables


def _span(samples: BeamSamples, chosen: RecordOptions) -> dict[str, Any]:
    """Return the times of the records' first and last samples."""
    n_record = samples.n_record
    since = (samples.time % chosen.window) / 1e9
    record = samples.group % n_record
    begin, end = np.full(n_record, np.inf), np.full(n_record, -np.inf)
    edges = np.flatnonzero(np.diff(samples.group, prepend=-1))  # each beam's samples are in time's order
    np.minimum.at(begin, record[edges], since[edges])
    lasts = np.append(edges[1:], len(since)) - 1
    np.maximum.at(end, record[lasts], since[lasts])
    there = np.isfinite(begin)
    return {
        name: ("record", np.where(there, values, np.nan), {"units": "s", "long_name": words})
        for name, values, words in (
            ("first_sample", begin, "first sample of any beam, after the start of the record"),
            ("last_sample", end, "last sample of any beam, after the start of the record"),
        )
    }


def with_cut_off(records: xr.Dataset, scan: Scan, chosen: RecordOptions, *, later: int | None = None) -> xr.Dataset:
    """Flag, in place, the beams with too few samples of records that the data only touch, and no others.

    `later` is the number of a window behind all records that has a sample, too, where there is one.
    """
    flag = records["flag"].values
    flag &= ~np.uint8(BEAM_FLAGS["cut_off"])
    expected = chosen.expected(scan)
    start, first, last = (records.variables[name].values for name in ("time", "first_sample", "last_sample"))
    if later is not None:
        start = np.append(start, np.datetime64(later * chosen.window, "ns"))
        first, last = np.append(first, 0.0), np.append(last, chosen.duration)
    touched = is_touched(
        start,
        first,
        last,
        duration=chosen.duration,
        cycle=chosen.duration / expected,
        share=chosen.needed(scan) / expected,
    )[: len(flag)]
    few = BEAM_FLAGS["too_few_samples"] | BEAM_FLAGS["all_missing"] | BEAM_FLAGS["no_samples"]
    flag[touched[:, np.newaxis] & ((flag & few) != 0)] |= BEAM_FLAGS["cut_off"]
    return records


def _octaves(samples: BeamSamples, filtered: Filtered, window: int, n_octave: int) -> dict[str, Any]:
    """Return what each octave of averaging time adds to the variances of records."""
    energy = record_octaves(
        samples.velocity, samples.group, samples.time, filtered.keep, samples.n_group, window, n_octave
    )
    by_record = energy.reshape(len(samples.numbers), samples.n_record, n_octave).swapaxes(0, 1)
    about = {"units": "m2 s-2", "long_name": "part of the variance by averaging time: halves, quarters, ... samples"}
    return {OCTAVES: (("record", "beam", "octave"), by_record.astype(np.float32), about)}


def _asked(chosen: RecordOptions, rules: QualityRules, scan: Scan) -> dict[str, Any]:
    """Say in the report what was asked for."""
    return {
        "samples_needed": float(chosen.needed(scan)),
        "samples_expected": chosen.expected(scan),
        "min_count": chosen.min_count,
        "duration": chosen.duration,
        **{name: getattr(rules, name) for name in _TOLD},
        "quality": asdict(rules),
    }


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
            "flag": (both, table["flag"], flag_attributes(BEAM_FLAGS)),
            "wind_speed": ("record", wind_speed, speed),
            "yaw": ("record", yaw, angle),
            "tilt": ("record", np.full(len(start), np.degrees(scan.tilt)), {"units": "degree"}),
            "record_flag": ("record", record_flag, flag_attributes({**RECORD_FLAGS, **REMARK_FLAGS})),
        },
        coords={"time": ("record", start, {"long_name": "start of the record, UTC"}), "beam": ("beam", numbers)},
        attrs={"scan": scan.name},
    )
