"""Campbell TOA5: the series of a sonic anemometer, as a reference beside a lidar's results."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import check_finite
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers.compressed import UNREADABLE, first_bytes, plain_file
from bayes_rs.readers.entries import numbers, times
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.format import FileFormat, resolve_format
from bayes_rs.readers.text_lines import TextLines, read_lines, whole_rows

SUFFIXES = (".dat", ".csv", ".txt", ".toa5")
NAMES = ("time", "u", "v", "w", "temperature", "status")

_NEEDED = ("time", "u", "v", "w")
_AFTER = r"(?:[_ ]?(?:csat(?:3[ab]?)?|sonic|wind|\(?\d+\)?))?"
_WORDS = {
    "time": re.compile(r"timestamp", re.IGNORECASE),
    **{
        name: re.compile(rf"(?:u[_ ]?{axis}|{name}|wind[_ ]?{axis}){_AFTER}", re.IGNORECASE)
        for name, axis in (("u", "x"), ("v", "y"), ("w", "z"))
    },
    "temperature": re.compile(
        rf"(?:t[_ ]?s|t[_ ]?v|t[_ ]?sonic|son(?:ic)?[_ ]?temp(?:erature)?){_AFTER}", re.IGNORECASE
    ),
    "status": re.compile(r"diag(?:[_ ]?(?:csat(?:3[ab]?)?|sonic|wind|\d+))?", re.IGNORECASE),
}
_SPEED = ("", "m/s", "m s-1", "m s^-1", "m.s-1", "ms-1", "meters/second", "metres/second", "mps")
_TEMPERATURE = {
    "": "", "c": "degree_Celsius", "deg c": "degree_Celsius", "deg_c": "degree_Celsius", "degc": "degree_Celsius",
    "celsius": "degree_Celsius", "°c": "degree_Celsius", "k": "K",
}  # fmt: skip


def read_sonic(
    files: str | Path | Sequence[str | Path],
    *,
    columns: Mapping[str, str] | None = None,
    time_zone: str = "UTC",
    status_most: float | None = None,
    invalid: float | Sequence[float] | None = None,
) -> xr.Dataset:
    """Read the wind of a sonic anemometer from a Campbell logger's TOA5 files.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files, folders or patterns, as for `read`, also compressed.
    columns : mapping of str to str, optional
        What the files call ``time``, ``u``, ``v``, ``w``, ``temperature`` and ``status``. Without it ``TIMESTAMP``,
        ``Ux``, ``Uy``, ``Uz``, ``Ts`` and ``diag…`` are looked for, and similar names.
    time_zone : str
        Zone of the times, which the files do not say.
    status_most : float, optional
        Largest status of a good sample; velocities and temperatures of the others are missing, and counted.
    invalid : float or sequence of float, optional
        Numbers that mark a missing entry, such as -9999. A 0 is never missing.

    Returns
    -------
    series : xarray.Dataset
        ``u``, ``v`` and ``w`` over ``time`` (UTC, upwards), m/s, along the sonic's own x, y and z; ``temperature``, in
        the unit of the file, and ``status`` where the files have them. NaN where missing. ``attrs["read_report"]``
        counts in JSON what was read and dropped.

    Raises
    ------
    InputError
        If a file is no TOA5 file, a column is missing or could be several, a unit is not m/s, or an entry cannot be
        used. The message names file and line.

    Notes
    -----
    A TOA5 file has four lines above its rows: the environment, the names of the columns, their units, and how each was
    processed. ``"NAN"`` is a missing number. Only samples (``Smp``, or nothing) are read: averages are no series.
    Lines at the end that are cut off, and a last one that ends in a number without a newline, are dropped and counted.
    So are samples of a time that was there before. What ``diag`` means differs from sonic to sonic: for a CSAT3 on an
    SDM bus 63 is the largest of a good sample, for a CSAT3B 0. `bayes_rs.wind.sonic_stresses` gives the stresses.

    References
    ----------
    Campbell Scientific, LoggerNet Instruction Manual, appendix "Campbell Scientific File Formats", TOA5.

    Examples
    --------
    >>> import tempfile
    >>> head = ['"TOA5","mast","CR3000","1","OS","prog","2","ts"', '"TIMESTAMP","RECORD","Ux","Uy","Uz"',
    ...         '"TS","RN","m/s","m/s","m/s"', '"","","Smp","Smp","Smp"']
    >>> rows = ['"2012-06-07 12:45:00.05",1,2.0,-1.5,"NAN"', '"2012-06-07 12:45:00.1",2,2.5,-1.25,0.5', ""]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "a.dat"
    ...     _ = file.write_text(chr(10).join([*head, *rows]))
    ...     series = read_sonic(file)
    >>> series["u"].values, series["w"].values
    (array([2. , 2.5]), array([nan, 0.5]))
    """
    for name in columns or {}:
        if name not in NAMES:
            raise InputError(f"Unknown name {name!r} in columns: it must be one of {', '.join(NAMES)}.")
    most = None if status_most is None else check_finite(status_most, what="status_most", unit="")
    file_format = resolve_format(FileOptions(time_zone=time_zone, invalid=invalid), None)
    parts, counted, names = [], [], []
    for file in find_files(files, SUFFIXES).paths:
        with plain_file(file) as plain:
            try:
                part, counts = _read_one(plain, dict(columns or {}), file_format, most)
            except InputError as error:
                raise InputError(str(error).replace(repr(str(plain)), repr(str(file)))) from error
        parts.append(part)
        counted.append(counts)
        names.append(file.name)
    _check_alike(parts, names)
    joined = parts[0] if len(parts) == 1 else xr.concat(parts, "time", combine_attrs="drop_conflicts", join="outer")
    joined = joined.sortby("time")
    time = joined["time"].values.astype("datetime64[ns]").astype(np.int64)
    first = np.append(True, np.diff(time) > 0)[: len(time)]
    told = {
        **{key: sum(int(counts[key]) for counts in counted) for key in ("rows", "rows_dropped", "rows_bad_status")},
        "duplicates_dropped": int((~first).sum()),
        "files": [{"name": name, **counts} for name, counts in zip(names, counted, strict=True)],
    }
    return joined.isel(time=first).assign_attrs(read_report=json.dumps(told))


def is_toa5(file: Path) -> bool:
    """Tell whether a file is that of a Campbell logger, as `read_sonic` reads it."""
    with suppress(*UNREADABLE):
        return first_bytes(file, 8).lstrip(b'"').startswith(b"TOA5")
    return False


def _read_one(
    file: Path, columns: Mapping[str, str], file_format: FileFormat, most: float | None
) -> tuple[xr.Dataset, dict[str, int]]:
    lines = read_lines(file, without=(b"\0", b'"'))
    names, units = _header(lines)
    place = {name: _find(name, names, columns, file) for name in NAMES}
    at = {name: index for name, index in place.items() if index is not None}
    attributes = {name: {"units": "m s-1"} for name in ("u", "v", "w")}
    for name in ("u", "v", "w"):
        if units[at[name]].lower() not in _SPEED:
            raise _unit(file, names[at[name]], units[at[name]], "m/s")
    if "temperature" in at:
        unit = units[at["temperature"]].lower().strip(".")
        if unit not in _TEMPERATURE:
            raise _unit(file, names[at["temperature"]], units[at["temperature"]], "C or K")
        attributes["temperature"] = {"units": _TEMPERATURE[unit]} if unit else {}
    table = whole_rows(
        lines, first=4, separator=",", n_field=[len(names)], columns=sorted(at.values()), text=[at["time"]]
    )
    time, _ = times(table.column("time", at["time"], names[at["time"]]), file_format)
    values: dict[str, Any] = {}
    for name, index in at.items():
        if name != "time":
            values[name], _ = numbers(table.column(name, index, names[index]), file_format)
    bad = np.zeros(len(time), dtype=bool)
    if most is not None:
        if "status" not in at:
            raise InputError(
                f"File {str(file)!r} has no status, which status_most={most:g} is about: say what the file calls it "
                "with columns={'status': 'its name'}, or leave status_most out."
            )
        bad = ~(np.asarray(values["status"]) <= most)
        values.update({name: np.where(bad, np.nan, values[name]) for name in values if name != "status"})
    known = ~np.isnat(time)
    dataset = xr.Dataset(
        {name: ("time", value[known], attributes.get(name, {})) for name, value in values.items()},
        coords={"time": ("time", time[known])},
    )
    dropped = table.n_cut + int((~known).sum())
    return dataset, {"rows": len(time) + table.n_cut, "rows_dropped": dropped, "rows_bad_status": int(bad.sum())}


def _header(lines: TextLines) -> tuple[list[str], list[str]]:
    """Return the names of the columns that may be a series, and their units; those of averages have no name."""
    first = lines.text(0).split(",")[0].strip() if len(lines) else ""
    if first != "TOA5" or len(lines) < 4:
        kind = f"is a {first} file" if first in ("TOB1", "TOB3", "TOACI1", "CSIXML") else "does not begin with TOA5"
        raise InputError(
            f"File {str(lines.file)!r} {kind}: it must be a Campbell TOA5 file with four lines above its rows; convert "
            "it with the logger's software (CardConvert)."
        )
    names, units, process = ([word.strip() for word in lines.text(row).split(",")] for row in (1, 2, 3))
    if not len(names) == len(units) == len(process):
        raise InputError(
            f"The header of file {str(lines.file)!r} has {len(names)} names, {len(units)} units and {len(process)} "
            "kinds of processing: there must be one for each column; correct the header."
        )
    kept = [name if how.lower() in ("", "smp") else "" for name, how in zip(names, process, strict=True)]
    return kept, units


def _find(name: str, names: Sequence[str], columns: Mapping[str, str], file: Path) -> int | None:
    listed = ", ".join(repr(own[:40]) for own in names if own)
    how = f"say which with columns={{{name!r}: 'its name'}}."
    if name in columns:
        found = [index for index, own in enumerate(names) if own == columns[name]]
    else:
        taken = set(columns.values())
        found = [index for index, own in enumerate(names) if _WORDS[name].fullmatch(own) and own not in taken]
    if not found and (name in _NEEDED or name in columns):
        raise InputError(f"File {str(file)!r} has no sampled column for {name}: its samples are {listed}; {how}")
    if len(found) > 1:
        own = ", ".join(repr(names[index]) for index in found)
        raise InputError(f"File {str(file)!r} has several columns that may be {name}, {own}: {how}")
    return found[0] if found else None


def _unit(file: Path, name: str, unit: str, allowed: str) -> InputError:
    return InputError(
        f"Unknown unit {unit[:40]!r} of column {name!r} of file {str(file)!r}: it must be {allowed}; correct "
        "the header."
    )


def _check_alike(parts: Sequence[xr.Dataset], names: Sequence[str]) -> None:
    """Refuse files that differ in their variables, or in the unit of the temperature."""
    for part, own in zip(parts[1:], names[1:], strict=True):
        one = {str(name): variable.attrs for name, variable in parts[0].data_vars.items()}
        other = {str(name): variable.attrs for name, variable in part.data_vars.items()}
        if one != other:
            raise InputError(
                f"Files {names[0]!r} and {own!r} differ: the one has {', '.join(one)}, the other "
                f"{', '.join(other)}, or their units differ; read them one by one."
            )
