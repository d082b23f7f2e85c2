"""WindScanner text: a line for each ray, without headings, with seconds since 1904 and four entries for each gate."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.entries import numbers, times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_TEXT_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.ray_groups import check_angles, counts_of
from bayes_rs.readers.rays import Rays, direction_of
from bayes_rs.readers.text_lines import first_line, read_lines, whole_rows

SUFFIXES = (".txt", ".csv")
DEFAULTS = {"positive": "away", "separator": ";", "time_format": "labview", "time_stamp": "start", "time_zone": "UTC"}

_PER_GATE = 4  # distance, velocity, CNR, width
_MOST_BEFORE = 6  # entries before the start of the ray: numbers of the instrument's own
_EPOCH = (2.8e9, 4.4e9)  # seconds since 1904 of the years 1992 to 2043
_LONGEST = 600.0  # s, of a ray


def recognises_windscanner(file: Path, _scan: Scan, file_format: FileFormat) -> bool:
    """Say whether the first line has numbers only: two times since 1904, two angles, and four for each gate."""
    return _start_at(first_line(file), file_format.separator) is not None


def windscanner_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the rays of one ``…_wind.txt`` file.

    Parameters
    ----------
    file : Path
        Text without headings, separated by semicolons.
    file_format : FileFormat
        The reader's options.

    Returns
    -------
    rays : Rays
        One for each line. Lines at the end that are cut off are dropped and counted.

    Raises
    ------
    InputError
        If a line has another number of entries than the first, or an entry is not a number.

    Notes
    -----
    After up to six numbers of the instrument's own (scan, index, start and stop of its counter) stand the start and the
    stop of the ray, in seconds since 1904, UTC, azimuth and elevation, degrees, and for each gate its distance, m, the
    radial velocity, m/s, negative where the wind blows towards the lidar, the CNR, dB, and the width of the spectrum.
    The azimuth may count on over many turns. The time kept is the start, and the stop gives the duration.

    References
    ----------
    Columns, epoch and sign: the descriptions of the datasets of the Østerild balconies experiment (DTU,
    doi:10.11583/DTU.29046962 and doi:10.11583/DTU.29046482). Order and samples: Lidaco, the converter of the
    e-WindLidar initiative (github.com/e-WindLidar/Lidaco, ``lidaco/readers/Windscanner.py`` and ``samples``).
    """
    lines = read_lines(file)
    at = _start_at(lines.text(0), file_format.separator) if len(lines) else None
    if at is None:
        raise InputError(
            f"File {str(file)!r} does not begin with a ray as a WindScanner writes it: start and stop in seconds since "
            "1904, azimuth, elevation, and four numbers for each gate; give another file_format, or the separator."
        )
    n_field = int(lines.n_field(file_format.separator)[0])
    n_gate = (n_field - at - _PER_GATE) // _PER_GATE
    gates = at + _PER_GATE * np.arange(1, n_gate + 1)
    blocks = {"distance": gates, "radial_velocity": gates + 1, "cnr": gates + 2}
    columns = [at, at + 1, at + 2, at + 3, *np.concatenate(list(blocks.values())).tolist()]
    table = whole_rows(
        lines,
        first=0,
        separator=file_format.separator,
        n_field=[n_field],
        columns=columns,
        text=[at, at + 1],
        bad_rows=file_format.bad_rows,
    )
    start, invalid = times(table.column("time", at), file_format)
    stop, _ = times(table.column("time", at + 1), file_format)
    azimuth, bad_azimuth = numbers(table.column("azimuth", at + 2), file_format)
    elevation, bad_elevation = numbers(table.column("elevation", at + 3), file_format)
    invalid |= bad_azimuth | bad_elevation
    check_angles(azimuth, elevation, table.rows, "line", file)
    value = {}
    for name, places in blocks.items():
        value[name] = np.empty((len(table.rows), n_gate))
        for gate, place in enumerate(places.tolist()):
            value[name][:, gate], is_invalid = numbers(table.column(name, place), file_format)
            invalid |= is_invalid
    kept = table.kept()
    duration = np.where(np.isnat(stop), np.nan, (stop - start) / np.timedelta64(1, "s"))[kept]
    return Rays(
        file=file,
        kind="windscanner",
        file_format=file_format,
        time=file_format.to_start(start[kept], duration),
        direction=direction_of(azimuth[kept], elevation[kept]),
        distance=np.where(value["distance"] > 0.0, value["distance"], np.nan)[kept],
        radial_velocity=file_format.to_away(value["radial_velocity"])[kept],
        cnr=value["cnr"][kept],
        status=None,
        row=table.rows[kept],
        row_word="line",
        counts=counts_of(int(kept.sum()), invalid=int(invalid[kept].sum()), left_out=table.counts()),
        facts=table.facts(),
        accumulation_time=duration,
    )


def _start_at(line: str, separator: str) -> int | None:
    """Return which entry of a line is the start of the ray; None if it is no line of a WindScanner."""
    try:
        values = [float(word) for word in line.strip("\ufeff \r\n").split(separator)]
    except ValueError:
        return None
    for at in range(_MOST_BEFORE + 1):
        rest = len(values) - at - _PER_GATE
        if rest < _PER_GATE or rest % _PER_GATE:
            continue
        start, stop = values[at : at + 2]
        if _EPOCH[0] < start < _EPOCH[1] and 0.0 <= stop - start <= _LONGEST and values[at + _PER_GATE] > 0.0:
            return at
    return None


read_windscanner = by_rays(windscanner_rays)

READER = Reader(
    name="windscanner",
    title="WindScanner, text without headings",
    source="DTU's Østerild balconies datasets (doi:10.11583/DTU.29046962); Lidaco (github.com/e-WindLidar/Lidaco)",
    suffixes=SUFFIXES,
    recognises=recognises_windscanner,
    read=read_windscanner,
    rays=windscanner_rays,
    defaults=DEFAULTS,
    uses=(*OF_TEXT_RAYS, "separator"),
)
