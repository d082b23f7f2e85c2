"""Galion lidars: their ``.scn`` text files, a header and then a line for each gate of each ray."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_rs.errors import InputError
from bayes_rs.readers.entries import numbers
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.interface import OF_TEXT_RAYS, Reader
from bayes_rs.readers.matching import by_rays
from bayes_rs.readers.ray_groups import GateRows, rays_of_rows
from bayes_rs.readers.rays import Rays
from bayes_rs.readers.row_times import times_of_rays
from bayes_rs.readers.text_lines import TextLines, read_lines, whole_rows

SUFFIXES = (".scn",)
HEADINGS = ("range gate", "doppler", "intensity", "ray time", "az", "el", "pitch", "roll")

_MOST_LINES = 100  # of a header; those in use have six
_GATE, _VELOCITY, _INTENSITY, _TIME, _AZIMUTH, _ELEVATION = range(6)


def galion_rays(file: Path, file_format: FileFormat) -> Rays:
    """Return the rays of one ``.scn`` file.

    Parameters
    ----------
    file : Path
        The file, of one scan or of several.
    file_format : FileFormat
        The reader's options; ``gate_length`` must be given, because the file only numbers its gates.

    Returns
    -------
    rays : Rays
        One for each time and direction. Lines at the end that are cut off are dropped and counted.

    Raises
    ------
    InputError
        If there is no line of headings, no gate length, or an entry cannot be used. The message names the line.

    Notes
    -----
    A line has the number of the gate, from 0, the Doppler velocity, m/s, the intensity (SNR + 1), the time of the ray,
    azimuth and elevation, degrees, pitch and roll, which are not applied. Gates stand at (gate + ½) times the gate
    length. ``cnr`` is 10 log₁₀(intensity − 1) dB, missing where the intensity is not above one. The zone of the times
    and what part of a ray they stamp are not published.

    References
    ----------
    Headings and a file: the samples of Lidaco (github.com/e-WindLidar/Lidaco, ``samples/Galion``). Gates and sign,
    positive away as for a StreamLine: github.com/longlostjames/doppy, ``docs/formats-galion.md`` and its wind product.
    """
    if file_format.gate_length is None:
        raise InputError(
            f"File {str(file)!r} numbers its gates and does not say how long they are: give gate_length in m "
            "(--gate-length); 30 m is usual."
        )
    lines = read_lines(file)
    first = _below_headings(lines)
    table = whole_rows(
        lines,
        first=first,
        separator="\t",
        n_field=[len(HEADINGS)],
        columns=list(range(6)),
        text=[_TIME],
        bad_rows=file_format.bad_rows,
    )
    value, invalid = {}, np.zeros(len(table.rows), dtype=bool)
    for name, index in (
        ("gate", _GATE),
        ("radial_velocity", _VELOCITY),
        ("cnr", _INTENSITY),
        ("azimuth", _AZIMUTH),
        ("elevation", _ELEVATION),
    ):
        value[name], is_invalid = numbers(table.column(name, index, HEADINGS[index]), file_format)
        invalid |= is_invalid
    time, bad_time = times_of_rays(table.column("time", _TIME, HEADINGS[_TIME]), file_format)
    intensity = value["cnr"]
    rows = GateRows(
        time=time,
        azimuth=value["azimuth"],
        elevation=value["elevation"],
        distance=(value["gate"] + 0.5) * file_format.gate_length,
        radial_velocity=value["radial_velocity"],
        cnr=10.0 * np.log10(np.where(intensity > 1.0, intensity - 1.0, np.nan)),
        status=None,
        invalid=invalid | bad_time,
        row=table.rows,
    )
    kept = table.kept()
    return rays_of_rows(
        rows if kept.all() else rows.select(kept),
        file,
        file_format,
        kind="galion",
        row_word="line",
        left_out=table.counts(),
        facts=table.facts(),
    )


def _below_headings(lines: TextLines) -> int:
    for index in range(min(len(lines), _MOST_LINES)):
        words = [word.strip().lower() for word in lines.text(index).split("\t")]
        if tuple(words) == HEADINGS:
            return index + 1
    raise InputError(
        f"File {str(lines.file)!r} has no line of headings {', '.join(HEADINGS)}, separated by tabs: check that it is "
        "a Galion's .scn file."
    )


read_galion = by_rays(galion_rays)

READER = Reader(
    name="galion",
    title="Galion, .scn text",
    source="samples of Lidaco (github.com/e-WindLidar/Lidaco); github.com/longlostjames/doppy, docs/formats-galion.md",
    suffixes=SUFFIXES,
    recognises=lambda *_: True,
    read=read_galion,
    rays=galion_rays,
    defaults={"positive": "away"},
    uses=(*OF_TEXT_RAYS, "gate_length"),
)
