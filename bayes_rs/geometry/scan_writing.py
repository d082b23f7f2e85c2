"""Scans to TOML files, which `load_scan` reads back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.output import output_file
from bayes_rs.toml_file import toml_key, toml_value

_SAME = 1e-9
"""Directions, distances (m) and times (s) that agree to this are the same, as in `Scan.geometry`."""


def save_scan(scan: Scan, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a scan to a TOML file that `load_scan` reads back.

    Parameters
    ----------
    scan : Scan
        The scan. Measurement planes (all beams at the first distance, then the same beams at the next) and beams that
        share the scan's time equally are written as such; else each beam gets its own focus distance and time.
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
        If the ending is another, the file exists, or what is given is no scan.

    Examples
    --------
    >>> import tempfile
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = save_scan(load_scan("6-beam"), Path(folder) / "mine.toml")
    ...     load_scan(file).key == load_scan("6-beam").key
    True
    """
    file = Path(path)
    if file.suffix != ".toml":
        raise InputError(f"Invalid scan file {str(file)!r}: its name must end in .toml; add the ending.")
    if not isinstance(scan, Scan):
        raise InputError(
            f"Invalid scan of type {type(scan).__name__}: it must be a Scan, as load_scan or find_scan returns it."
        )
    text = scan_text(scan)
    with output_file(file, overwrite=overwrite) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return file


def scan_text(scan: Scan) -> str:
    """Return the text of a scan file; see `save_scan`."""
    planes = _planes(scan)
    lines = [f"title = {toml_value(scan.title or scan.name)}", f"source = {toml_value(scan.source or 'not given')}", ""]
    lines += ["[beams]", 'pattern = "list"']
    if planes is not None:
        n_beam, distances, order, period = planes
        lines += [f"focus_distance = {toml_value(distances.tolist())}", ""]
    else:
        n_beam, distances, order, period = scan.n_beam, scan.focus_distance[:1], "", scan.scan_duration
        lines += [""]
    for index, vector in enumerate(scan.beam_direction[:n_beam].tolist()):
        opening = float(np.rad2deg(np.arctan2(np.hypot(vector[1], vector[2]), -vector[0])))
        phase = float(np.rad2deg(np.arctan2(vector[2], vector[1])) % 360.0)
        lines += [
            f"[[beams.beam]]  # {opening:.2f} degrees from -x, its projection {phase:.2f} degrees from y",
            f"id = {int(scan.beam[index])}",
            f"vector = {toml_value(vector)}",
        ]
        if planes is None:
            lines += [
                f"focus_distance = {toml_value(float(scan.focus_distance[index]))}",
                f"time = {toml_value(float(scan.beam_time[index]))}",
            ]
        lines += [""]
    lines += ["[timing]", f"scan_duration = {toml_value(period)}"]
    lines += [f'planes = "{order}"', ""] if len(distances) > 1 else [""]
    if scan.tilt or scan.yaw:
        lines += ["[mounting]", f"tilt_deg = {toml_value(float(np.rad2deg(scan.tilt)))}"]
        lines += [f"yaw_deg = {toml_value(float(np.rad2deg(scan.yaw)))}", ""]
    if probe := scan.probe.parameters():
        lines += ["[probe]", *(f"{key} = {toml_value(value)}" for key, value in probe.items()), ""]
    if scan.file_format:
        lines += ["[file]", *(f"{toml_key(key)} = {toml_value(value)}" for key, value in scan.file_format.items()), ""]
    return "\n".join(lines)


def _planes(scan: Scan) -> tuple[int, FloatArray, str, float] | None:
    """Return the beams of a plane, the planes' distances, how planes follow each other, and the file's duration.

    None if beams have their own distances or times, or planes have other numbers than 0, 1, 2 …
    """
    distance = scan.focus_distance
    n_beam = int(np.argmax(np.abs(distance - distance[0]) > _SAME)) or scan.n_beam
    n_plane, rest = divmod(scan.n_beam, n_beam)
    if rest or (n_plane > 1 and not np.array_equal(scan.beam, np.arange(scan.n_beam))):
        return None
    direction = scan.beam_direction.reshape(n_plane, n_beam, 3)
    by_plane = distance.reshape(n_plane, n_beam)
    if np.max(np.abs(direction - direction[0])) > _SAME or np.max(np.abs(by_plane - by_plane[:, :1])) > _SAME:
        return None
    step = scan.scan_duration / n_beam
    if np.max(np.abs(scan.beam_time - np.tile(step * np.arange(n_beam), n_plane))) < _SAME:
        return n_beam, by_plane[:, 0], "simultaneous", scan.scan_duration
    if np.max(np.abs(scan.beam_time - step / n_plane * np.arange(scan.n_beam))) < _SAME:
        return n_beam, by_plane[:, 0], "sequential", scan.scan_duration / n_plane
    return None
