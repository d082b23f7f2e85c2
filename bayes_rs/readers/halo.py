"""Halo Photonics StreamLine lidars: their ``.hpl`` text files, a header and then a block of lines for each ray."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import UNREADABLE, unreadable
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.rays import Rays, direction_of
from bayes_rs.stated_time import stated_times

SUFFIXES = (".hpl",)

_MOST_LINES = 100  # of a header; those in use have 17
_MOST_GATES = 100_000
_SHORTEST_BEAT = 12.0  # hours; times that fall back by more have passed midnight
_NUMBER = r"(\d+(?:[.,]\d+)?)"
_COMMON = re.compile(r"(?:Altitude|Range) of measurement \(center of gate\) = \(range gate \+ 0\.5\) \* Gate length")
_OVERLAPPING = re.compile(
    rf"Range of measurement \(center of gate\) = Gate length / {_NUMBER} \+ \(range gate x {_NUMBER}\)"
)


@dataclass(frozen=True)
class _Header:
    """What the lines above ``****`` say."""

    n_line: int
    start: np.datetime64
    distance: FloatArray


def halo_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the rays of one ``.hpl`` file.

    Parameters
    ----------
    file : Path
        The file, of one scan or of many.
    file_format : FileFormat
        The reader's options.

    Returns
    -------
    rays : Rays
        One for each complete block; a last block that is cut off is dropped and counted.

    Raises
    ------
    InputError
        If a line of the header is missing or a block is not as the header says. The message names the line.

    Notes
    -----
    A block is a line with the decimal hour of the day (UTC), azimuth and elevation (degrees; pitch and roll are not
    applied), and a line for each gate with its number, the Doppler velocity (m/s, positive away), the intensity (SNR +
    1) and the backscatter. ``cnr`` is 10 log₁₀(intensity − 1) dB, missing where the intensity is not above one.
    Gates stand at (gate + ½) times the gate length, or as the header's formula for overlapping gates says. Hours that
    fall back by more than half a day have passed midnight. The time stands as it is in the file: what part of a ray it
    stamps is not published.

    References
    ----------
    The layouts in use are listed by doppy, the processing of the ACTRIS network (github.com/actris-cloudnet/doppy,
    docs/formats-halo.md), whose wind retrieval counts the velocity positive away.
    """
    lines = _lines(file)
    header = _header(lines, file)
    n_gate = len(header.distance)
    body = lines[header.n_line :]
    while body and not body[-1].strip():
        body.pop()
    if body and len(body[-1].split()) < (4 if len(body) % (1 + n_gate) != 1 else 3):
        body.pop()  # cut off within a line
    n_ray, cut_off = divmod(len(body), 1 + n_gate)
    if n_ray == 0:
        raise InputError(
            f"File {str(file)!r} has no complete ray: {len(body)} lines follow the header, and a ray takes "
            f"{1 + n_gate}; the file is cut off, or the number of gates is wrong."
        )
    rows = np.arange(n_ray) * (1 + n_gate)
    first_row = header.n_line + 1
    ray = _numbers([body[row] for row in rows], 3, first_row + rows, file)
    gate_rows = np.setdiff1d(np.arange(n_ray * (1 + n_gate)), rows)
    gate = _numbers([body[row] for row in gate_rows], 4, first_row + gate_rows, file)
    off = gate[:, 0] != np.tile(np.arange(n_gate), n_ray)
    if off.any():
        index = int(np.argmax(off))
        raise InputError(
            f"Invalid gate {gate[index, 0]:g} in line {first_row + gate_rows[index]} of file {str(file)!r}: it must be "
            f"{index % n_gate}; each ray must have the {n_gate} gates that the header says."
        )
    velocity, intensity = (gate[:, column].reshape(n_ray, n_gate) for column in (1, 2))
    is_invalid = file_format.is_invalid(velocity) | ~np.isfinite(velocity)
    snr = np.where(intensity > 1.0, intensity - 1.0, np.nan)
    return Rays(
        file=file,
        kind="halo",
        file_format=file_format,
        time=file_format.to_start(_times(ray[:, 0], header, first_row + rows, file)),
        direction=direction_of(ray[:, 1], ray[:, 2]),
        distance=np.tile(header.distance, (n_ray, 1)),
        radial_velocity=file_format.to_away(np.where(is_invalid, np.nan, velocity)),
        cnr=10.0 * np.log10(snr),
        status=None,
        row=first_row + rows,
        row_word="line",
        counts={
            "rows": n_ray + (cut_off > 0),
            "rows_invalid_value": int(is_invalid.any(axis=1).sum()),
            "rows_dropped": int(cut_off > 0),
            "rows_without_time": 0,
            "rows_without_beam": 0,
        },
    )


def _lines(file: Path) -> list[str]:
    try:
        return file.read_bytes().replace(b"\0", b"").decode("utf-8", errors="replace").split("\n")
    except UNREADABLE as error:
        raise unreadable(file, error) from error


def _header(lines: list[str], file: Path) -> _Header:
    fields: dict[str, str] = {}
    scale: tuple[float, float] | None = None  # gate length over the first, plus gate number times the second
    end = next((index for index, line in enumerate(lines[:_MOST_LINES]) if line.startswith("****")), None)
    if end is None:
        raise InputError(
            f"File {str(file)!r} has no line of '****' that ends the header of an .hpl file: check that it is one."
        )
    for line in lines[:end]:
        text = line.strip()
        name, colon, value = text.partition(":")
        if colon:
            fields[name.strip().lower()] = value.strip()
        overlapping = _OVERLAPPING.fullmatch(text)
        if overlapping is not None:
            scale = (_as_float(overlapping[1]), _as_float(overlapping[2]))
        elif _COMMON.fullmatch(text) is not None:
            scale = (2.0, np.nan)
    length = _field(fields, "range gate length (m)", file)
    n_gate = _field(fields, "number of gates", file)
    start = fields.get("start time", "").replace(",", ".")
    parsed = stated_times(pd.Series([start]), "%Y%m%d %H:%M:%S.%f").dt.tz_localize(None)[0]
    if not (n_gate.is_integer() and 0 < n_gate <= _MOST_GATES and length > 0.0) or pd.isna(parsed) or scale is None:
        raise InputError(
            f"The header of file {str(file)!r} cannot be used: Number of gates {n_gate:g}, Range gate length "
            f"{length:g} m, Start time {start!r}, formula of the range {'found' if scale else 'unknown'}; check that "
            "it is the header of an .hpl file."
        )
    step = length if np.isnan(scale[1]) else scale[1]
    if not (scale[0] > 0.0 and step > 0.0):
        raise InputError(f"The formula of the range in the header of file {str(file)!r} has a zero: correct it.")
    distance = length / scale[0] + step * np.arange(int(n_gate), dtype=np.float64)
    return _Header(end + 1, parsed.to_datetime64().astype("datetime64[ns]"), distance)


def _field(fields: dict[str, str], name: str, file: Path) -> float:
    value = _as_float(fields.get(name, ""))
    if not np.isfinite(value):
        raise InputError(
            f"The header of file {str(file)!r} has no number for {name!r} ({fields.get(name)!r}): check that it is the "
            "header of an .hpl file."
        )
    return value


def _as_float(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return np.nan


def _numbers(lines: list[str], least: int, row: NDArray[np.int64], file: Path) -> FloatArray:
    """Return the first `least` numbers of each line, (n_line, least)."""
    words = [line.replace(",", ".").split(None, least)[:least] for line in lines]
    try:
        return np.array(words, dtype=np.float64).reshape(len(lines), least)
    except ValueError:
        for line, parts, number in zip(lines, words, row.tolist(), strict=True):
            if len(parts) < least or any(np.isnan(_as_float(part)) and part.lower() != "nan" for part in parts):
                shown = "".join(character if character.isprintable() else "?" for character in line.strip()[:60])
                raise InputError(
                    f"Line {number} of file {str(file)!r} is {shown!r}: it must start with {least} numbers; each ray "
                    "must have as many gates as the header says."
                ) from None
        raise


def _times(hour: FloatArray, header: _Header, row: NDArray[np.int64], file: Path) -> NDArray[np.datetime64]:
    bad = ~((hour >= 0.0) & (hour <= 24.0))
    if bad.any():
        index = int(np.argmax(bad))
        raise InputError(
            f"Invalid time {hour[index]:g} in line {row[index]} of file {str(file)!r}: it must be a decimal hour "
            "from 0 to 24."
        )
    day = header.start.astype("datetime64[D]")
    first = (header.start - day) / np.timedelta64(1, "h")
    days = np.cumsum(np.diff(hour, prepend=first) < -_SHORTEST_BEAT)
    since = np.round((hour + 24.0 * days) * 3.6e9).astype("timedelta64[us]")
    time: NDArray[np.datetime64] = day.astype("datetime64[ns]") + since
    return time


read_halo = by_rays(halo_rays)

READER = Reader(
    name="halo",
    title="Halo Photonics StreamLine, .hpl text",
    source="doppy, the processing of the ACTRIS network (github.com/actris-cloudnet/doppy, docs/formats-halo.md)",
    suffixes=SUFFIXES,
    recognises=lambda *_: True,
    read=read_halo,
    rays=halo_rays,
    defaults={"positive": "away", "time_zone": "UTC"},
    in_utc=True,
    uses=OF_RAYS,
)
