"""What a mast measured beside a lidar, with the records of that: a further block of the data of their fit."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array
from bayes_rs.errors import InputError, in_short
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.stress import STRESSES, first_impossible
from bayes_rs.quality.belief import is_mark
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.format import FileFormat, resolve_format
from bayes_rs.readers.toa5 import SUFFIXES, is_toa5, read_sonic
from bayes_rs.records.belief import NOT_BELIEVED, believed
from bayes_rs.records.layout import MAST, MAST_POSITION, check_layout, mast_there
from bayes_rs.records.record_options import RecordOptions
from bayes_rs.reference_table import check_stated, matched_rows, reference_numbers, reference_table, reference_times
from bayes_rs.wind.sonic import sonic_stresses

_log = logging.getLogger(__name__)
_OF_WIND = 90.0
"""m² s⁻², below which nines are a stress as any other."""


class MastStresses(NamedTuple):
    """What a mast measured, checked, and not yet matched with records.

    Parameters
    ----------
    start : ndarray of datetime64, shape (n,)
        Starts of its periods, UTC.
    stress : ndarray, shape (n, 6)
        Its stresses, m² s⁻²; NaN where there are none.
    where : str
        Where they are from, in words.
    """

    start: NDArray[np.datetime64]
    stress: FloatArray
    where: str


def with_mast(
    records: xr.Dataset,
    mast: xr.Dataset | pd.DataFrame | str | Path | Sequence[str | Path],
    *,
    position: ArrayLike,
    invalid: float | Sequence[float] | None = None,
) -> xr.Dataset:
    """Return records that hold what a mast measured in the same periods; a fit takes it as data beside the beams.

    Parameters
    ----------
    records : Dataset
        From `make_records`, at one range.
    mast : Dataset, DataFrame, str, Path or sequence of them
        From `sonic_stresses`; or a table, or CSV files, with the column ``time`` (start of the period, UTC if no offset
        is stated) and some of ``uu``, ``vv``, ``ww``, ``uv``, ``uw``, ``vw``, m² s⁻², in the frame of the period's mean
        wind, its mean removed. The variance of a cup anemometer is ``uu`` alone. Or the series of a sonic, TOA5 files
        (`bayes_rs.readers.read_sonic`), whose stresses are made for records of this length. Folders and patterns name
        their files.
    position : array_like, shape (3,)
        Where it measures, m from the lidar in the levelled frame of that: x against the view of a nacelle lidar, y to
        the right of one who looks out, z up. So a mast 200 m in front of it is at (-200, 0, 0).
    invalid : float or sequence of float, optional
        Numbers that mark a missing entry of a table or of a sonic's series, such as -9999. A covariance of 0, and a
        sonic's velocity of 0, is never missing.

    Returns
    -------
    records : Dataset
        With ``mast_stress`` (record, stress), NaN where there is none, and the place in
        ``attrs["mast_position"]``.

    Raises
    ------
    InputError
        If the records are at several ranges, columns are missing, a variance is not above zero, a tensor is not
        realizable (or, of one known in part, a covariance is beyond its two variances), no period with a variance is
        one of the records, most stresses are such as no atmosphere has, or the Dataset is of
        periods of another length than these.

    Notes
    -----
    A covariance is used where both its variances are beside it; a warning names one that is not.

    A table does not say how long its periods are: rows whose starts are another time apart than the records' are taken,
    and a warning says so. Stresses above 900 m² s⁻² (the square of a third of the records' ``velocity_limit``) count as
    missing, as variances of beams do, and are among the doubts of a fit. Another warning says how many records
    the mast gives nothing, if these are some.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
    >>> cup = pd.DataFrame({"time": ["2000-01-01 00:10"], "uu": [1.3]})
    >>> with_mast(brs.make_records(series, "2-beam"), cup, position=(-98, 0, 0))["mast_stress"].values[:, 0]
    array([nan, 1.3])
    """
    _check_records(records)
    found = _joined(records, read_mast(mast, _duration(records), invalid), position, _log.warning)
    there = mast_there(found)
    if not there.all():
        _log.warning("The mast has no stress of %d of %d records.", (~there).sum(), len(there))
    return found


def mast_of(options: RecordOptions, records: xr.Dataset | None, files: FileOptions) -> MastStresses | None:
    """Read what a mast measured from the files that the options of records name; None if they name none.

    Parameters
    ----------
    options : RecordOptions
        With the files of the mast.
    records : Dataset, optional
        The records, if they are there already: a sonic's stresses are made for their length.
    files : FileOptions
        How radial velocities are read, if they are not; its ``invalid`` holds for files of the mast, too.

    Raises
    ------
    InputError
        As from `with_mast`, or if the radial velocities are to be read at ranges or heights.
    """
    if not options.mast:
        return None
    if records is not None:
        _check_records(records)
    elif files.range is not None or files.height is not None:
        raise InputError(
            "A mast stands beside records of one range: read the files of radial velocities at one (--focus-distance "
            "DISTANCE, in place of --range or --height), or leave the mast out."
        )
    return read_mast(options.mast, options.duration if records is None else _duration(records), files.invalid)


def add_mast(
    records: xr.Dataset, mast: MastStresses | None, options: RecordOptions, say: Callable[[str], object]
) -> xr.Dataset:
    """Give records what `mast_of` read, and say so in a line; the same records if that is nothing."""
    if mast is None or options.mast_position is None:
        return records
    _check_records(records)
    found = _joined(records, mast, options.mast_position, say)
    say(_words(found))
    return found


def _words(records: xr.Dataset) -> str:
    """Say where the mast is, and in how many records it measured."""
    place = ", ".join(f"{number:g}" for number in json.loads(records.attrs[MAST_POSITION]))
    there = mast_there(records)
    of = f"{there.sum()} of {len(there)} records"
    return f"a mast at ({place}) m is data of the fit: it has stresses of {of} of {_duration(records):g} s"


def read_mast(
    source: xr.Dataset | pd.DataFrame | str | Path | Sequence[str | Path],
    duration: float,
    invalid: float | Sequence[float] | None = None,
) -> MastStresses:
    """Return what a mast measured, from what `with_mast` takes; of a series, over periods of a duration, s.

    Raises
    ------
    InputError
        If it is not what `with_mast` takes, or has no variance at all.
    """
    found = _read(source, duration, resolve_format(FileOptions(invalid=invalid), None))
    if not np.isfinite(found.stress[:, :3]).any():
        raise _nothing(found.where, f"{len(found.start)} row{'s' * (len(found.start) != 1)}")
    return found


def _read(
    source: xr.Dataset | pd.DataFrame | str | Path | Sequence[str | Path], duration: float, marks: FileFormat
) -> MastStresses:
    if isinstance(source, xr.Dataset):
        return _of_stresses(source, "", duration)
    if isinstance(source, pd.DataFrame):
        return _of_table(source, marks=marks)
    if not isinstance(source, (str, Path)) and not (
        isinstance(source, Sequence) and all(isinstance(file, (str, Path)) for file in source)
    ):
        raise InputError(f"Invalid mast {in_short(source)}: give files, a table, or what sonic_stresses returns.")
    files = find_files(source, SUFFIXES).paths
    series = [file for file in files if is_toa5(file)]
    first = f"mast in {str(files[0])!r}" + (f" and {len(files) - 1} more" if len(files) > 1 else "")
    if len(series) == len(files):
        return _of_stresses(
            sonic_stresses(read_sonic(files, invalid=marks.invalid), duration=duration), first, duration
        )
    if series:
        table = next(file for file in files if file not in series)
        raise InputError(
            f"The mast in {str(series[0])!r} is a sonic's series, and that in {str(table)!r} is none: give files of "
            "one kind."
        )
    tables = [_of_table(file, marks=marks) for file in files]
    if len(tables) == 1:
        return tables[0]
    start = reference_times(pd.Series(np.concatenate([table.start for table in tables])), first)
    return MastStresses(start, np.concatenate([table.stress for table in tables]), first)


def _of_stresses(stresses: xr.Dataset, where: str, duration: float) -> MastStresses:
    """Return those of the Dataset of `sonic_stresses`, over periods of a duration, s."""
    if "stress" not in stresses or stresses["stress"].dims != ("record", "component"):
        raise InputError("Invalid mast: it has no 'stress' (record, component); give what sonic_stresses returns.")
    check_stated(stresses.attrs.get("duration"), duration, where or "mast that was given")
    values = stresses["stress"].values.copy()
    still = np.any(values[:, :3] == 0.0, axis=1)
    if still.any():
        _log.warning(
            "The %s has periods in which u, v or w does not move, %d of %d: they count as missing.",
            *(where or "mast", still.sum(), len(still)),
        )
        values[still] = np.nan
    columns = dict(zip(STRESSES, values.T, strict=True))
    return _of_table(pd.DataFrame({"time": stresses["time"].values, **columns}), where)


def _of_table(source: pd.DataFrame | str | Path, where: str = "", marks: FileFormat | None = None) -> MastStresses:
    """Return those of a table, checked; `where` says where it is from, if it is no file."""
    table, found_where = reference_table(source, what="mast")
    where = where or found_where
    columns = {str(name).strip().lower(): name for name in table.columns}
    there = [name for name in STRESSES if name in columns]
    if "time" not in columns or "uu" not in there:
        found = ", ".join(repr(str(name)) for name in table.columns[:20])
        raise InputError(f"The {where} has the columns {found}, and needs time and at least uu: rename them.")
    start = reference_times(table[columns["time"]], where)
    values = np.full((len(table), len(STRESSES)), np.nan)
    for name in there:
        numbers = reference_numbers(table[columns[name]], name, where)
        missing = False if marks is None else marks.is_invalid(numbers, name)
        values[:, STRESSES.index(name)] = np.where(missing, np.nan, numbers)
    for column, (i, j) in zip((3, 4, 5), ((0, 1), (0, 2), (1, 2)), strict=True):
        unused = np.isfinite(values[:, column]) & ~np.isfinite(values[:, [i, j]]).all(axis=1)
        if unused.any():
            _log.warning(
                "The %s has %s without %s or %s beside it in %d of %d rows: it is not used there.",
                *(where, STRESSES[column], STRESSES[i], STRESSES[j], unused.sum(), len(values)),
            )
    impossible = first_impossible(values)
    if impossible is not None:
        row, words = impossible
        mark = next((f"{value:g}" for value in values[row].tolist() if abs(value) > _OF_WIND and is_mark(value)), "")
        said = f"invalid={mark} (--invalid {mark})" if mark else "invalid (--invalid)"
        raise InputError(
            f"Row {row} of the {where} {words}; leave empty what is not known, or name the number that marks it with "
            f"{said}."
        )
    return MastStresses(start, values, where)


def _joined(records: xr.Dataset, mast: MastStresses, position: ArrayLike, say: Callable[[str], object]) -> xr.Dataset:
    """Return records with the stresses of a mast, each with those of its own period."""
    place = check_array(position, (3,), what="position of the mast")
    row = matched_rows(mast.start, records["time"].values, _duration(records), mast.where, say)
    stress = np.where((row >= 0)[:, np.newaxis], mast.stress[row], np.nan)
    about = {"units": "m2 s-2", "long_name": "stresses that a mast measured"}
    attributes = dict(records.attrs)
    before = json.loads(attributes.pop(NOT_BELIEVED, "{}"))
    beside = believed(xr.Dataset({MAST: (("record", "stress"), stress, about)}, attrs=attributes))
    now = json.loads(beside.attrs.get(NOT_BELIEVED, "{}"))
    told = {**{name: of for name, of in before.items() if name != MAST}, **now}  # a mast that was there is replaced
    found = records.assign({MAST: beside[MAST]})
    found.attrs = {**attributes, MAST_POSITION: json.dumps(place.tolist())}
    if told:
        found.attrs[NOT_BELIEVED] = json.dumps(told)
    if not mast_there(found).any():
        if of := now.get(MAST):
            raise InputError(
                f"The {mast.where} has no stress that can be believed: {of['count']} of {of['of']} are beyond "
                f"{of['limit']:g} m² s⁻², which no atmosphere has; check their unit."
            )
        raise _nothing(mast.where, f"rows of {(row >= 0).sum()} of {len(row)} records")
    return found


def _nothing(where: str, rows: str) -> InputError:
    return InputError(
        f"The {where} has {rows}, and no variance in any of these: fill its columns, or give a sonic's series that "
        "covers whole records and moves in u, v and w; or leave the mast out."
    )


def _check_records(records: xr.Dataset) -> None:
    """Refuse records that a mast cannot stand beside, as those at several ranges."""
    other = records.drop_vars(MAST, errors="ignore")  # a mast that is there is replaced
    check_layout(other, "variance", "flag", "wind_speed", "yaw", "time")


def _duration(records: xr.Dataset) -> float:
    return float(records.attrs.get("duration", 600.0))
