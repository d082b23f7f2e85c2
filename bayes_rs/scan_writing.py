"""Scans to TOML files, which `load_scan` reads back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.output import output_file
from bayes_rs.scan import Scan

_SAME = 1e-9
"""Directions, distances (m) and times (s) that agree to this are the same, as in `Scan.geometry`."""


def save_scan(scan: Scan, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a scan to a TOML file that `load_scan` reads back.

    Parameters
    ----------
    scan : Scan
        A scan whose beams share its time equally. Several focus distances must be measurement planes: all beams at the
        first distance, then the same beams at the next.
    path : str or Path
        The file, with the ending ``.toml``. Its stem is the name that the scan has when it is read.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    path : Path
        The file.

    Raises
    ------
    InputError
        If the ending is another, the file exists, or a scan file cannot hold the scan's timing, planes or numbers.

    Examples
    --------
    >>> import tempfile
    >>> from bayes_rs.scan_file import load_scan
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = save_scan(load_scan("6-beam"), Path(folder) / "mine.toml")
    ...     load_scan(file).key == load_scan("6-beam").key
    True
    """
    file = Path(path)
    if file.suffix != ".toml":
        raise InputError(f"Invalid scan file {str(file)!r}: its name must end in .toml; add the ending.")
    text = scan_text(scan)
    with output_file(file, overwrite=overwrite) as part:
        part.write_text(text, encoding="utf-8")
    return file


def scan_text(scan: Scan) -> str:
    """Return the text of a scan file; see `save_scan`."""
    direction, distances = _planes(scan)
    n_beam, n_plane = len(direction), len(distances)
    order, period = _timing(scan, n_beam, n_plane)
    if n_plane > 1 and not np.array_equal(scan.beam, np.arange(scan.n_beam)):
        raise InputError(
            f"Cannot write scan {scan.name!r}: beams of several planes are numbered 0, 1, 2 … in a file, and these are "
            f"{scan.beam.tolist()}; number them so."
        )
    lines = [f"title = {_value(scan.title or scan.name)}", f"source = {_value(scan.source or 'not given')}", ""]
    lines += ["[beams]", 'pattern = "list"', f"focus_distance = {_value(distances.tolist())}", ""]
    for number, vector in zip(scan.beam[:n_beam].tolist(), direction.tolist(), strict=True):
        opening = float(np.rad2deg(np.arctan2(np.hypot(vector[1], vector[2]), -vector[0])))
        phase = float(np.rad2deg(np.arctan2(vector[2], vector[1])) % 360.0)
        lines += [
            f"[[beams.beam]]  # {opening:.2f} degrees from -x, its projection {phase:.2f} degrees from y",
            f"id = {number}",
            f"vector = {_value(vector)}",
            "",
        ]
    lines += ["[timing]", f"scan_duration = {_value(period)}"]
    lines += [f'planes = "{order}"', ""] if n_plane > 1 else [""]
    if scan.tilt or scan.yaw:
        lines += ["[mounting]", f"tilt_deg = {_value(float(np.rad2deg(scan.tilt)))}"]
        lines += [f"yaw_deg = {_value(float(np.rad2deg(scan.yaw)))}", ""]
    if probe := scan.probe.parameters():
        lines += ["[probe]", *(f"{key} = {_value(value)}" for key, value in probe.items()), ""]
    if scan.file_format:
        lines += ["[file]", *(f"{_key(key)} = {_value(value)}" for key, value in scan.file_format.items()), ""]
    return "\n".join(lines)


def _planes(scan: Scan) -> tuple[FloatArray, FloatArray]:
    """Return the directions of one plane, and the focus distances of all."""
    distance = scan.focus_distance
    n_beam = int(np.argmax(np.abs(distance - distance[0]) > _SAME)) or scan.n_beam
    n_plane, rest = divmod(scan.n_beam, n_beam)
    whole = scan.beam_direction[: n_plane * n_beam].reshape(n_plane, n_beam, 3)
    by_plane = distance[: n_plane * n_beam].reshape(n_plane, n_beam)
    if rest or np.max(np.abs(whole - whole[0])) > _SAME or np.max(np.abs(by_plane - by_plane[:, :1])) > _SAME:
        raise InputError(
            f"Cannot write scan {scan.name!r}: its focus distances {distance.tolist()} are not planes, all beams at "
            "one distance and then the same beams at the next; write one file for each distance."
        )
    return whole[0], by_plane[:, 0]


def _timing(scan: Scan, n_beam: int, n_plane: int) -> tuple[str, float]:
    """Return how planes follow each other, and the file's duration: of one plane, if they are sequential."""
    step = scan.scan_duration / n_beam
    if np.max(np.abs(scan.beam_time - np.tile(step * np.arange(n_beam), n_plane))) < _SAME:
        return "simultaneous", scan.scan_duration
    if np.max(np.abs(scan.beam_time - step / n_plane * np.arange(scan.n_beam))) < _SAME:
        return "sequential", scan.scan_duration / n_plane
    raise InputError(
        f"Cannot write scan {scan.name!r}: in a file the beams share the scan's {scan.scan_duration:g} s equally, and "
        f"these are at {scan.beam_time.tolist()} s; give it other times."
    )


def _value(value: Any) -> str:
    """Return a plain value as TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML's basic strings are JSON's


def _key(key: str) -> str:
    return json.dumps(str(key), ensure_ascii=False)
