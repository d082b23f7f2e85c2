"""Motion of the lidar: each record's own tilt and roll, and radial velocities without what the motion adds."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_LIMIT, FileOptions
from bayes_rs.geometry.attitude import level_direction, roll_matrix
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan, tilt_matrix, yaw_matrix
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.quality.belief import MOST_ANGLE, in_words, is_impossible
from bayes_rs.readers.entries import numbers, times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.table import Column, Table, open_table
from bayes_rs.records.given import check_is_series
from bayes_rs.records.making import make_records
from bayes_rs.records.ranges import each_range, scan_of_records
from bayes_rs.records.record_options import OF_MOTION, RecordOptions
from bayes_rs.reference_table import span_words
from bayes_rs.wind.mean_vector import mean_wind

_log = logging.getLogger(__name__)
ANGLES = ("tilt_deg", "roll_deg", "heading_deg")
VELOCITIES = ("velocity_x", "velocity_y", "velocity_z")
_UNITS = {**dict.fromkeys(ANGLES, "degree"), **dict.fromkeys(VELOCITIES, "m s-1")}

_NAMES = ("time", *ANGLES, *VELOCITIES)


class _MotionFormat(FileFormat):
    """How a file of motion is written."""

    names: ClassVar[tuple[str, ...]] = _NAMES


def read_motion(
    files: str | Path | Sequence[str | Path],
    *,
    columns: Mapping[str, str],
    time_zone: str = "UTC",
    time_format: str | None = None,
    separator: str = ",",
    decimal: str = ".",
    invalid: Sequence[float] = (),
) -> xr.Dataset:
    r"""Read the motion of a lidar from columns of CSV or Parquet files, for example those of the lidar itself.

    Parameters
    ----------
    files : str, Path or sequence of them
        The files, in any order.
    columns : mapping of str to str
        The headings of ``time``, and of those of ``tilt_deg``, ``roll_deg``, ``heading_deg`` (degrees), ``velocity_x``,
        ``velocity_y`` and ``velocity_z`` (m/s) that the files have: ``{"time": "Timestamp", "tilt_deg": "Tilt"}``.
    time_zone : str
        Zone of times that carry none.
    time_format : str, optional
        How times are written if not in ISO 8601, as for `bayes_rs.read`.
    separator, decimal : str
        What separates the entries of a text file, and its decimal sign.
    invalid : sequence of float
        Numbers that mark a missing entry. No tilt or roll within ±90 degrees and no heading within ±360 is one.

    Returns
    -------
    motion : xarray.Dataset
        The variables over ``time`` (UTC), in order, one for each time: of rows with the same time, the last counts.
        Rows without a time are dropped.

    Raises
    ------
    InputError
        If a file or column cannot be read, a name is not one of those above, or an angle is beyond 720 degrees or a
        velocity beyond 90 m/s.

    Notes
    -----
    Signs are those of `with_motion`; where an instrument counts otherwise, negate the variable: nothing in a file says.

    Examples
    --------
    >>> import tempfile
    >>> lines = "Timestamp,Tilt,Roll\n2020-09-03T19:00:00,5.0,-0.1\n2020-09-03T19:00:04,4.9,0.1\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "day.csv"
    ...     _ = file.write_text(lines)
    ...     motion = read_motion(file, columns={"time": "Timestamp", "tilt_deg": "Tilt", "roll_deg": "Roll"})
    >>> motion["tilt_deg"].values
    array([5. , 4.9])
    """
    _check_columns(columns)
    file_format = _format_of(
        columns,
        invalid=invalid,
        time_zone=time_zone,
        separator=separator,
        decimal=decimal,
        time_format=time_format,
    )
    parts: dict[str, list[NDArray[np.generic]]] = {name: [] for name in columns}
    for file in [files] if isinstance(files, (str, Path)) else files:
        table = _opened(file, file_format)
        frame, _ = next(table.pieces(list(dict.fromkeys(columns.values())), text=[columns["time"]]))
        time, _ = times(table.column(frame, "time", columns["time"]), file_format)
        keep = ~np.isnat(time)
        parts["time"].append(time[keep])
        for name in columns:
            if name != "time":
                column = table.column(frame, name, columns[name])
                values = numbers(column, file_format)[0]
                _check_possible(column, values)
                parts[name].append(values[keep])
    whole = {name: np.concatenate(values) for name, values in parts.items()}
    order = np.argsort(whole["time"], kind="stable")
    time = whole.pop("time")[order]
    last = np.append(time[1:] != time[:-1], True) if len(time) else np.zeros(0, dtype=bool)
    return xr.Dataset(
        {name: ("time", values[order][last], {"units": _UNITS[name]}) for name, values in whole.items()},
        coords={"time": time[last].astype("datetime64[ns]")},
    )


def _check_columns(columns: Mapping[str, str]) -> None:
    """Refuse headings of what motion does not have, and those without time or anything that moves."""
    for name in columns:
        if name not in _NAMES:
            raise InputError(f"Unknown name {name!r} in columns: it must be one of {', '.join(_NAMES)}.")
    if "time" not in columns or len(columns) < 2:
        raise InputError(
            f"Invalid columns {dict(columns)!r}: give the heading of the time, and of what moves, as in "
            "{'time': 'Timestamp', 'tilt_deg': 'Tilt'} (--motion-column time=Timestamp --motion-column tilt_deg=Tilt)."
        )


def _format_of(columns: Mapping[str, str], *, invalid: Sequence[float] = (), **written: Any) -> _MotionFormat:
    """Return how files of motion are written."""
    return _MotionFormat(columns=dict(columns), invalid=tuple(invalid), required=frozenset(columns), **written)


def _opened(file: str | Path, file_format: _MotionFormat) -> Table:
    """Return a file of motion, which is there and has the columns."""
    if not Path(file).is_file():
        raise InputError(f"No file {str(file)!r}: check the path of the motion.")
    table = open_table(Path(file), file_format)
    for name in file_format.columns:
        if not table.has(name):
            raise table.missing(name)
    return table


def _check_possible(column: Column, values: FloatArray) -> None:
    """Refuse angles and velocities that no lidar has."""
    limit, unit = (MOST_ANGLE, "degrees") if column.name in ANGLES else (VELOCITY_LIMIT, "m/s")
    bad = is_impossible(values, limit)
    if bad.any():
        index = int(np.argmax(bad))
        shown = in_words(float(values[index]))
        raise InputError(
            f"Invalid {column.name} {shown} in {column.where(index)}, one of {np.count_nonzero(bad)}: it must be "
            f"within {limit:g} {unit}; if the number marks a missing entry, say so with invalid={shown} (--invalid "
            f"{shown})."
        )


def add_motion(
    records: xr.Dataset,
    scan: Scan | str | Path,
    options: RecordOptions,
    files: FileOptions | None = None,
    *,
    say: Callable[[str], object] | None = None,
) -> xr.Dataset:
    """Give records the lidar's own tilt and roll from the files that the options of records name.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`, also at several ranges.
    scan : Scan, str or Path
        The scan that they were measured with, its name or its file.
    options : RecordOptions
        With the files of motion and their columns.
    files : FileOptions, optional
        How the files of radial velocities are written: those of motion have the same zone, form of times, separator,
        decimal sign and numbers for missing entries, also where those of radial velocities have no use for them. What
        is not said is what `read_motion` takes it to be; numbers for missing entries are then those of the scan's
        files.
    say : callable, optional
        Takes a line: where tilt and roll are from, and how many records have them. That some have none is a warning,
        too.

    Returns
    -------
    records : xarray.Dataset
        As `with_motion` returns them; the same records if the options name no files.

    Raises
    ------
    InputError
        If a file or column cannot be read, no record is matched, or the columns name velocities of the lidar: they are
        to be taken out of radial velocities, by `remove_motion`.
    """
    if not options.motion:
        return records
    check_motion(options, files)
    scan = as_scan(scan)
    motion = read_motion(
        options.motion,
        columns=options.motion_columns,
        **{"invalid": scan.file_format.get("invalid", ())} | _as_written(files),
    )
    at_ranges = scan_of_records(records, scan)
    if isinstance(at_ranges, RangedScan):
        found = each_range(records, at_ranges, lambda part, one: _with_attitude(part, motion, one))
    else:
        found = _with_attitude(records, motion, scan)
    without = _check_matched(found, motion)
    if say is not None:
        number = found.sizes["record"]
        say(f"tilt and roll from {len(options.motion)} files, of {number - without} of {number} records")
    return found


def check_motion(options: RecordOptions, files: FileOptions | None = None) -> None:
    """Refuse files of motion that are not there, or whose columns are not, before anything else is read.

    Parameters
    ----------
    options : RecordOptions
        With the files of motion and their columns; those that name no files are right.
    files : FileOptions, optional
        How the files of radial velocities are written, as for `add_motion`.

    Raises
    ------
    InputError
        If a file or a column is not there, the columns say nothing of tilt and roll, or they name velocities, which are
        not taken out of finished records.
    """
    if not options.motion:
        return
    columns = options.motion_columns
    _check_columns(columns)
    moving = [name for name in VELOCITIES if name in columns]
    if moving:
        raise InputError(
            f"Invalid motion_columns {', '.join(moving)} (--motion-column {moving[0]}={columns[moving[0]]}): finished "
            "records take tilt_deg, roll_deg and heading_deg only. Leave it out; the lidar's velocity is taken out of "
            "radial velocities before records are made of them, in Python: bayes_rs.wind.remove_motion(series, "
            "motion, scan)."
        )
    _check_turns(columns)
    file_format = _format_of(columns, **_as_written(files))
    for file in options.motion:
        _opened(file, file_format)


def _as_written(files: FileOptions | None) -> dict[str, Any]:
    """Return how files of motion are written, as far as it is said of those of radial velocities."""
    written = {} if files is None else files.given()
    return {name: written[name] for name in OF_MOTION if name in written}


def _check_turns(names: Collection[Any]) -> None:
    """Refuse motion that says nothing of the attitude that a record has of its own."""
    if "tilt_deg" not in names and "roll_deg" not in names:
        raise InputError("The motion has neither tilt_deg nor roll_deg: give one of them, degrees.")


def _check_matched(found: xr.Dataset, motion: xr.Dataset) -> int:
    """Say how many records the motion says nothing of, and return their number; refuse motion that is of none."""
    counts = found["motion_count"]
    none = counts.max([name for name in counts.dims if name != "record"]).values == 0
    if none.all():
        raise InputError(
            f"No time of the motion ({span_words(motion['time'].values)} UTC) with a tilt or roll lies in a record "
            f"({_span_of(found['time'].values)} UTC): check its time zone, and that it is of the same days."
        )
    if none.any():
        _log.warning(
            "The motion says nothing of %d of %d records, the first of %s: they keep the scan's tilt and no roll.",
            *(none.sum(), len(none), np.datetime_as_string(found["time"].values[none][0], unit="s")),
        )
    return int(none.sum())


def _span_of(time: NDArray[np.datetime64]) -> str:
    """Return the first and the last of the times that are known, in words."""
    known = time[~np.isnat(time)]
    return span_words(known) if len(known) else "without times"


def with_motion(records: xr.Dataset, motion: xr.Dataset, scan: Scan | str | Path) -> xr.Dataset:
    """Give each record its own mean tilt and roll, and the mean wind that its beams then see.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`.
    motion : xarray.Dataset
        Over ``time`` (UTC): ``tilt_deg`` or ``roll_deg`` or both, degrees, and ``heading_deg`` if there.
    scan : Scan, str or Path
        The scan that measured the records.

    Returns
    -------
    records : xarray.Dataset
        With ``tilt`` and ``roll`` (degree), the means over each record, ``tilt_sd`` and ``roll_sd``, the standard
        deviations within it, ``heading`` (degree, clockwise from north) if the motion has one, ``motion_count``, the
        number of times that counted, and ``wind_speed``, ``yaw`` and ``record_flag`` anew (`mean_wind`). A record in
        which the motion has no time keeps the tilt of the scan and a roll of zero; its ``motion_count`` is 0 and its
        standard deviations are NaN. A warning says how many these are.

    Raises
    ------
    InputError
        If the motion has no time, no angle, or none in any record, or records and scan do not belong together.

    Notes
    -----
    Tilt is that of the lidar's axis above the horizon, as an inclinometer in the lidar shows it: it replaces the scan's
    tilt and is not added to it. A positive tilt raises the beams that look out, a positive roll those on the +y side,
    on the right of one who looks out. Beams are n · T_roll · T_tilt · T_yaw. The heading is where the lidar looks.

    `fit`, `mean_wind` and `wind_profile` use the record's own tilt and roll: the gains of the beams turn, the noise
    stays that of the scan's own attitude. What the motion adds to the variances within a record is not taken away by
    this; see `remove_motion`.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("6-beam"), brs.load_turbulence("fu-2022")
    >>> records = brs.make_records(brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1), scan)
    >>> time = records["time"].values[0] + np.arange(1200) * np.timedelta64(1, "s")
    >>> motion = xr.Dataset({"tilt_deg": ("time", np.linspace(0.0, 2.0, 1200))}, coords={"time": time})
    >>> with_motion(records, motion, scan)["tilt"].values.round(2)
    array([0.5, 1.5])
    """
    found = _with_attitude(records, motion, as_scan(scan))
    _check_matched(found, motion)
    return found


def _with_attitude(records: xr.Dataset, motion: xr.Dataset, scan: Scan) -> xr.Dataset:
    """Do what `with_motion` does, whichever records are matched."""
    time = _motion_times(motion)
    _check_turns(motion)
    if "time" not in records.coords or not np.issubdtype(records["time"].dtype, np.datetime64):
        raise InputError("The records have no times, so that no motion belongs to them: make them with make_records.")
    duration = check_positive(records.attrs.get("duration", 600.0), what="duration", unit="s", where="the records")
    start = records["time"].values.astype("datetime64[ns]").astype(np.int64)
    order = np.argsort(start)
    place = np.searchsorted(start[order], time, side="right") - 1
    record = order[np.maximum(place, 0)]
    inside = (place >= 0) & (time < start[record] + round(duration * 1e9))
    nominal = {"tilt_deg": float(np.rad2deg(scan.tilt)), "roll_deg": 0.0}
    found = records
    count = np.zeros(len(start), dtype=np.int64)
    for name, short in (("tilt_deg", "tilt"), ("roll_deg", "roll")):
        mean, sd = np.full(len(start), nominal[name]), np.full(len(start), np.nan)
        if name in motion:
            values = np.asarray(motion[name].values, dtype=np.float64)
            use = inside & np.isfinite(values)
            number = np.bincount(record[use], minlength=len(start))
            some = number > 0
            mean[some] = (np.bincount(record[use], values[use], len(start))[some]) / number[some]
            square = np.bincount(record[use], (values[use] - mean[record[use]]) ** 2, len(start))
            sd[some] = np.sqrt(square[some] / number[some])
            count = np.maximum(count, number)
        about = {"units": "degree"}
        found = found.assign({short: ("record", mean, about), f"{short}_sd": ("record", sd, about)})
    if "heading_deg" in motion:
        turn = np.deg2rad(np.asarray(motion["heading_deg"].values, dtype=np.float64))
        use = inside & np.isfinite(turn)
        east, north = (np.bincount(record[use], part(turn[use]), len(start)) for part in (np.sin, np.cos))
        seen = np.bincount(record[use], minlength=len(start)) > 0
        heading = np.where(seen, np.remainder(np.degrees(np.arctan2(east, north)), 360.0), np.nan)
        about = {"units": "degree", "long_name": "where the lidar looks, clockwise from north"}
        found = found.assign(heading=("record", heading, about))
    found = found.assign(motion_count=("record", count, {"long_name": "number of times of the motion in the record"}))
    return mean_wind(found, scan).drop_vars(["velocity", "axis"])


class _Part(NamedTuple):
    """What one cause adds to the radial velocities of the samples, m/s."""

    name: str
    added: FloatArray


def remove_motion(
    series: xr.Dataset,
    motion: xr.Dataset,
    scan: Scan | str | Path,
    *,
    duration: float = 600.0,
    shear: float = 0.0,
    max_gap: float = 2.0,
) -> xr.Dataset:
    r"""Take out of radial velocities what the motion of the lidar adds to them.

    Parameters
    ----------
    series : xarray.Dataset
        Radial velocities, as `bayes_rs.read` returns them.
    motion : xarray.Dataset
        Over ``time`` (UTC), any of: ``velocity_x``, ``velocity_y``, ``velocity_z``, the velocity of the lidar in its
        levelled frame, m/s (x against its view, y to the right of one who looks out, z up); ``tilt_deg``, ``roll_deg``,
        ``heading_deg``, degrees, as in `with_motion`.
    scan : Scan, str or Path
        The scan of the series.
    duration : float
        Length of a record, s: attitude counts as its deviation from the record's mean.
    shear : float
        Vertical gradient of the mean wind dU/dz, 1/s, through which beams that move up and down see other winds.
    max_gap : float
        Longest gap between two times of the motion across which it is interpolated, s.

    Returns
    -------
    series : xarray.Dataset
        The series with the corrected ``radial_velocity``. Samples without motion within `max_gap` are NaN, so that
        `make_records` counts them as missing; a warning says how many. ``attrs["motion_report"]`` says it in JSON, and
        for each cause the root mean square of what was taken out of each beam, m/s, with the variances within a record
        before and after (means over records, m² s⁻²).

    Raises
    ------
    InputError
        If the motion holds nothing that can be removed, no sample has motion, or an argument is not valid.

    Notes
    -----
    A lidar that moves with velocity V measures n · (u − V), positive away, so that n·V is added. A beam that at time t
    looks along n(t) and not along the record's mean n̄ measures another component of the mean wind U, at another height:

    .. math::
        v = v_\mathrm{measured} + n(t) \cdot V(t) - [n(t) - \bar n] \cdot U
            - f \, [n_3(t) - \bar n_3] \, \frac{dU}{dz} \, \frac{n(t) \cdot U}{|U|} ,

    with n(t) = n · T_roll(ρ(t)) · T_tilt(α(t)) · T_yaw(−δ(t)), δ the heading less its mean over the record, clockwise,
    and U from the means of the record's beams. A rotation about the lidar itself adds no velocity along the beam; one
    about another point is in V. Angles and velocities are interpolated linearly. The turbulence is still that of the
    places where the beams really were, and the variance is that of the mean direction to first order.

    References
    ----------
    Kelberlau, Neshaug, Lønseth, Bracchi and Mann (2020), Remote Sensing 12, 898, doi:10.3390/rs12050898: the same three
    effects for a floating lidar.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=1, seed=1)
    >>> wave = 0.5 * np.sin(0.6 * np.arange(600.0))
    >>> motion = xr.Dataset({"velocity_x": ("time", wave)}, coords={"time": series["time"].values})
    >>> moved = series.assign(radial_velocity=series["radial_velocity"] + wave)  # −n·V, since n is −x
    >>> still = remove_motion(moved, motion, scan)
    >>> bool(np.allclose(still["radial_velocity"], series["radial_velocity"]))
    True
    """
    scan = as_scan(scan)
    time = _motion_times(motion)
    check_positive(max_gap, what="max_gap", unit="s")
    gradient = check_finite(shear, what="shear", unit="1/s")
    if not any(name in motion for name in (*ANGLES, *VELOCITIES)):
        raise InputError(f"The motion holds nothing to remove: give some of {', '.join((*ANGLES, *VELOCITIES))}.")
    check_is_series(series)
    before = make_records(series, scan, duration=duration)
    at = series["time"].values.astype("datetime64[ns]").astype(np.int64)
    beam_index = {int(number): index for index, number in enumerate(scan.beam)}
    index = np.array([beam_index[int(number)] for number in series["beam"].values])
    unit = scan.beam_direction[index]
    now = {name: _interpolated(motion, name, time, at, max_gap) for name in (*ANGLES, *VELOCITIES) if name in motion}
    present = np.all([np.isfinite(values) for values in now.values()], axis=0)
    _check_present(present, series["time"].values, motion, list(now), max_gap)
    tilt = np.deg2rad(now.get("tilt_deg", np.full(len(at), np.rad2deg(scan.tilt))))
    roll = np.deg2rad(now.get("roll_deg", np.zeros(len(at))))
    direction = _row_times(unit, roll_matrix(roll) @ tilt_matrix(tilt))
    parts = []
    if any(name in now for name in ANGLES):
        angles = motion[[name for name in ANGLES if name in motion]]
        if "tilt_deg" not in angles and "roll_deg" not in angles:
            angles = angles.assign(roll_deg=("time", np.zeros(len(time))))
        own = _with_attitude(before, angles, scan)  # which samples have motion is known
        record = np.searchsorted(before["time"].values.astype("datetime64[ns]").astype(np.int64), at, side="right") - 1
        mean_direction = level_direction(scan, *(np.deg2rad(own[name].values) for name in ("tilt", "roll")))[
            record, index
        ]
        if "heading_deg" in now:
            turned = np.deg2rad(now["heading_deg"] - own["heading"].values[record])
            direction = _row_times(direction, yaw_matrix(-np.arctan2(np.sin(turned), np.cos(turned))))
        speed, yaw = own["wind_speed"].values[record], np.deg2rad(own["yaw"].values[record])
        toward = np.stack([np.cos(yaw), -np.sin(yaw), np.zeros_like(yaw)], axis=-1)
        turned_by = direction - mean_direction
        rise = scan.focus_distance[index] * turned_by[:, 2]
        parts.append(_Part("attitude", speed * np.einsum("si,si->s", turned_by, toward)))
        if gradient:
            parts.append(_Part("shear", gradient * rise * np.einsum("si,si->s", direction, toward)))
    if any(name in now for name in VELOCITIES):
        moving = np.stack([now.get(name, np.zeros(len(at))) for name in VELOCITIES], axis=-1)
        parts.append(_Part("velocity", -np.einsum("si,si->s", direction, moving)))
    velocity = series["radial_velocity"].values - sum((part.added for part in parts), np.zeros(len(at)))
    corrected = series.assign(
        radial_velocity=("sample", np.where(present, velocity, np.nan), series["radial_velocity"].attrs)
    )
    return corrected.assign_attrs(
        motion_report=json.dumps(_report(parts, present, before, corrected, scan, duration, index))
    )


def _check_present(
    present: NDArray[np.bool_], at: NDArray[np.datetime64], motion: xr.Dataset, names: Sequence[str], max_gap: float
) -> None:
    """Say how many samples have no motion; refuse motion that no sample has."""
    if present.any():
        if not present.all():
            _log.warning(
                "%d of %d samples have no motion within %g s, and count as missing.",
                *(np.count_nonzero(~present), len(present), max_gap),
            )
        return
    raise InputError(
        f"No sample ({_span_of(at)} UTC) lies between two times of the motion ({span_words(motion['time'].values)} "
        f"UTC) that have {', '.join(names)} and are at most max_gap={max_gap:g} s apart: check its time zone, or give "
        "a max_gap of its own times."
    )


def _report(
    parts: Sequence[_Part],
    present: NDArray[np.bool_],
    before: xr.Dataset,
    corrected: xr.Dataset,
    scan: Scan,
    duration: float,
    index: NDArray[np.int64],
) -> dict[str, object]:
    """Say what was taken out of each beam."""
    after = make_records(corrected, scan, duration=duration)
    removed = {}
    for part in parts:
        known = np.isfinite(part.added)
        number = np.bincount(index[known], minlength=scan.n_beam)
        square = np.bincount(index[known], part.added[known] ** 2, scan.n_beam)
        removed[part.name] = {
            str(scan.beam[beam]): float(np.sqrt(square[beam] / number[beam]))
            for beam in np.flatnonzero(number).tolist()
        }
    variances = {
        name: {
            str(number): float(values[np.isfinite(values)].mean()) if np.isfinite(values).any() else None
            for number, values in zip(made["beam"].values, made["variance"].values.T, strict=True)
        }
        for name, made in (("variance_before", before), ("variance_after", after))
    }
    return {"samples_without_motion": int((~present).sum()), "removed_rms": removed, **variances}


def _motion_times(motion: xr.Dataset) -> NDArray[np.int64]:
    """Return the times of a motion, ns.

    Raises
    ------
    InputError
        If there are none, or they do not rise.
    """
    if "time" not in motion.coords or motion["time"].dims != ("time",) or motion.sizes["time"] == 0:
        raise InputError("Invalid motion: it needs times over the dimension 'time'; make it with read_motion.")
    if not np.issubdtype(motion["time"].dtype, np.datetime64) or bool(np.isnat(motion["time"].values).any()):
        raise InputError("Invalid motion: every time must be a UTC time of type datetime64.")
    time = motion["time"].values.astype("datetime64[ns]").astype(np.int64)
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        raise InputError(
            f"Invalid motion: its times must rise, and entry {int(back[0]) + 1} is not after the one before; sort it."
        )
    for name in (*ANGLES, *VELOCITIES):
        if name in motion and motion[name].dims != ("time",):
            raise InputError(f"Invalid {name} of the motion with dims {motion[name].dims}: they must be ('time',).")
    for name, largest in (("tilt_deg", 90.0), ("roll_deg", 180.0)):
        if name in motion:
            over = np.flatnonzero(np.abs(motion[name].values) > largest)
            if len(over):
                value, when = motion[name].values[over[0]], motion["time"].values[over[0]]
                raise InputError(
                    f"Invalid {name} {value:g} of the motion at {when}: "
                    f"it must be from −{largest:g} to {largest:g} degrees; where it marks a missing entry, give it to "
                    "read_motion as invalid (--invalid)."
                )
    return time


def _interpolated(
    motion: xr.Dataset, name: str, time: NDArray[np.int64], at: NDArray[np.int64], max_gap: float
) -> FloatArray:
    """Return a variable of the motion at other times; NaN where none of its values is close enough on each side."""
    values = np.asarray(motion[name].values, dtype=np.float64)
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(at), np.nan)
    knots, heights = time[known], values[known]
    if name == "heading_deg":
        heights = np.degrees(np.unwrap(np.deg2rad(heights)))
    seconds, own = (at - knots[0]) * 1e-9, (knots - knots[0]) * 1e-9
    right = np.searchsorted(knots, at, side="left")
    exact = (right < len(knots)) & (knots[np.minimum(right, len(knots) - 1)] == at)
    between = (right > 0) & (right < len(knots))
    gap = own[np.minimum(right, len(knots) - 1)] - own[np.maximum(right - 1, 0)]
    return np.where(exact | (between & (gap <= max_gap)), np.interp(seconds, own, heights), np.nan)


def _row_times(rows: FloatArray, matrices: FloatArray) -> FloatArray:
    """Return the row vectors (n, 3) times the matrices (n, 3, 3)."""
    return np.asarray(np.einsum("si,sij->sj", rows, matrices))
