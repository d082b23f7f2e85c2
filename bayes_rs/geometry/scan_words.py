"""Scans as lines of text: where their beams point, when, and what they see of R."""

from __future__ import annotations

import textwrap

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.probe import Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_card import scan_rows

RECORD = 600.0
"""Length of a record, s, for which samples are counted here."""
WIDTH = 110
_MOST_ROWS = 12  # beams of a table; of more the first and the last are shown
_MOST_SAID = 3  # differences of two scans
_SAME = 5e-10  # m, s, or of unit vectors: what the key of a scan is rounded to
_SEVERAL = 1e-6  # m and rad by which beams differ


def scan_lines(scan: Scan, width: int = WIDTH) -> list[str]:
    """Return lines that say what a scan is, what it sees of R, and where its numbers come from.

    Parameters
    ----------
    scan : Scan
        The scan.
    width : int
        Characters that a line may have.

    Returns
    -------
    lines : list of str
        Up to `width` characters each, but for the table of the beams.
    """
    seen = sight(scan)
    timing = (
        f"a cycle of {scan.scan_duration:g} s: a beam has {_count(RECORD / scan.scan_duration)} samples in "
        f"{RECORD:g} s; all beams together {_count(scan.n_beam / scan.scan_duration)} a second"
    )
    mounting = [f"tilt {np.rad2deg(scan.tilt):g} degrees"] if scan.tilt else []
    mounting += [f"yaw {np.rad2deg(scan.yaw):g} degrees"] if scan.yaw else []
    facts = [
        ("beams", f"{_beams(scan)}"),
        ("timing", timing),
        *([("mounting", ", ".join(mounting))] if mounting else []),
        ("probe", probe_in_words(scan.probe, scan.focus_distance)),
        ("R", f"{seen.in_words()} (rank {seen.rank} of 6, condition {seen.condition:.1f})"),
        ("files", ", ".join(f"{key} = {value}" for key, value in scan.file_format.items()) or "no options of reading"),
        ("source", scan.source or "not given"),
    ]
    lines = [*textwrap.wrap(f"{scan.name}: {scan.title or 'a scan'}", width), ""]
    for what, words in facts:
        lines += textwrap.wrap(words, width, initial_indent=f"{what:<10}", subsequent_indent=" " * 10)
    return [*lines, "", *beam_table(scan)]


def scan_difference(one: Scan, other: Scan) -> str:
    """Return what differs between two scans, in words.

    Parameters
    ----------
    one, other : Scan
        The scans, in the order in which their values are said.

    Returns
    -------
    words : str
        Fields with both values, such as ``tilt 0° and 5°``; that single beams differ where no field of all does.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> scan_difference(load_scan("6-beam"), load_scan("6-beam", tilt_deg=5.0, opening_angle_deg=30.0))
    'beams 6, 0 to 15° from straight ahead and 6, 0 to 30° from straight ahead, tilt 0° and 5°'
    """
    rows = [
        scan_rows(scan.beam_direction, scan.focus_distance, scan.scan_duration, scan.probe)
        | {"tilt": f"{np.rad2deg(scan.tilt):.6g}°", "numbers of the beams": str(scan.beam.tolist())}
        for scan in (one, other)
    ]
    said = [f"{name} {value} and {rows[1][name]}" for name, value in rows[0].items() if value != rows[1][name]]
    if said:
        return ", ".join(said[:_MOST_SAID])
    of_beams = {
        "directions": (one.level_direction, other.level_direction),
        "distances": (one.focus_distance, other.focus_distance),
        "times": (one.beam_time, other.beam_time),
    }
    differ = [name for name, (ours, theirs) in of_beams.items() if np.any(np.abs(ours - theirs) > _SAME)]
    return f"{' and '.join(differ) or 'directions, distances or times'} of single beams"


def beam_table(scan: Scan, more: dict[str, list[str]] | None = None) -> list[str]:
    """Return the beams of a scan as the lines of a table.

    Parameters
    ----------
    scan : Scan
        The scan.
    more : dict of str to list of str, optional
        Further columns, by their headings: an entry for each beam.

    Returns
    -------
    lines : list of str
        Headings and beams; of more than twelve the first ten and the last. Beams of a scan that looks up have azimuth
        and elevation; others the angle from the axis and its direction, as scan files write them; with the tilt of the
        mounting in the height above the lidar.
    """
    azimuth, elevation, opening, phase = _angles(scan)
    columns = {"beam": [str(number) for number in scan.beam.tolist()]}
    if looks_up(scan):
        columns |= {"azimuth°": _text(azimuth, 1), "elevation°": _text(elevation, 1)}
    else:
        columns |= {"opening°": _text(opening, 1), "phase°": _text(phase, 1)}
    columns |= {
        "distance m": _text(scan.focus_distance, 1),
        "height m": _text(scan.line_of_sight[:, 2] * scan.focus_distance, 1),
        "time s": _text(scan.beam_time, 3),
        **(more or {}),
    }
    rows = list(range(scan.n_beam))
    if len(rows) > _MOST_ROWS:
        rows = [*rows[: _MOST_ROWS - 2], -2, -1]
    wide = {name: max(len(name), *map(len, entries)) for name, entries in columns.items()}
    lines = ["  ".join(f"{name:>{wide[name]}}" for name in columns)]
    for row in rows:
        if row == -2:
            lines.append(f"… {scan.n_beam - _MOST_ROWS + 1} more beams …")
            continue
        lines.append("  ".join(f"{entries[row]:>{wide[name]}}" for name, entries in columns.items()))
    return lines


def probe_in_words(probe: Probe, focus_distance: FloatArray) -> str:
    """Say which probe volume beams have."""
    told = probe.parameters()
    if not told:
        return "none: the beams see points"
    if told["kind"] == "continuous-wave":
        return f"{probe.kind}, Rayleigh length {_range(probe.length(focus_distance))} m at {_range(focus_distance)} m"
    return f"{probe.kind}, gate of {told['gate_length']:g} m and {told['pulse']} pulse of {told['pulse_length']:g} m"


def looks_up(scan: Scan) -> bool:
    """Tell whether the beams of a scan look up rather than ahead."""
    return bool(np.mean(scan.beam_direction[:, 2]) > 0.5)


def _beams(scan: Scan) -> str:
    """Return how many beams there are, on which cone and at which distances, in words."""
    _, elevation, opening, _ = _angles(scan)
    distance = np.unique(np.round(scan.focus_distance, 3))
    angle, what = (90.0 - elevation, "the zenith") if looks_up(scan) else (opening, "the axis")
    far = [f"{one:.4g}" for one in distance.tolist()]
    far = far if len(far) <= _MOST_ROWS else [*far[:10], "…", far[-1]]
    away = f"{_range(angle)}° from {what}" if np.ptp(angle) < 90.0 else f"up to {np.max(angle):.3g}° from {what}"
    looks = "look up" if looks_up(scan) else "look ahead"
    return f"{scan.n_beam}, {away}; they {looks}, to {', '.join(far)} m"


def _angles(scan: Scan) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return azimuth, elevation, opening angle and phase of the beams, degrees, before tilt and yaw."""
    first, second, third = scan.beam_direction.T
    level = np.hypot(first, second)
    azimuth = np.where(level > _SEVERAL, np.rad2deg(np.arctan2(second, -first)), 0.0)
    across = np.hypot(second, third)
    phase = np.where(across > _SEVERAL, np.rad2deg(np.arctan2(third, second)), 0.0)
    # what is shown as 360.0 is 0.0
    azimuth, phase = ((angle + 0.05) % 360.0 - 0.05 for angle in (azimuth, phase))
    return azimuth, np.rad2deg(np.arctan2(third, level)), np.rad2deg(np.arctan2(across, -first)), phase


def _text(values: FloatArray, digits: int) -> list[str]:
    return [f"{value + 0.0:.{digits}f}" for value in np.where(np.abs(values) < 0.5 * 0.1**digits, 0.0, values)]


def _count(number: float) -> str:
    return f"{number:.0f}" if abs(number - round(number)) < 1e-6 else f"{number:.3g}"


def _range(values: FloatArray) -> str:
    low, high = f"{np.min(values):.2g}", f"{np.max(values):.2g}"
    if float(high) >= 100.0:
        low, high = f"{np.min(values):.0f}", f"{np.max(values):.0f}"
    return low if low == high else f"{low} to {high}"
