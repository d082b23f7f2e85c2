"""A scan from the files that were measured with it: where the beams point, when, and at which gates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_count, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.options import from_plain
from bayes_rs.readers.directions import common_directions
from bayes_rs.readers.matching import directions_in_words, gates_in_words, nearest_gates
from bayes_rs.readers.rays import angles_of
from bayes_rs.readers.sorting import ScanGroup, SortedFiles, sort_surveyed
from bayes_rs.readers.surveyed import SurveyedFile, survey_files

_REGULAR = 0.2  # share by which a direction's median revisit may differ from the cycle
_TIME_DIGITS = 3  # of seconds; a median over rays knows no more
_RECORD = 600  # s
_MOST_GROUPS = 5  # scans that a message lists
_MOST_GATES = 12  # distances that are listed where none was asked for


class _Found(NamedTuple):
    """One direction that rays have in common."""

    rays: NDArray[np.int64]
    direction: FloatArray
    spread_deg: float


@dataclass(frozen=True)
class Survey:
    """What a survey of files finds: a scan, and what there is beside it.

    Parameters
    ----------
    scan : Scan
        The scan.
    files : tuple of Path
        The files that it was found in, as they were named.
    found : SortedFiles
        All scans of the files, and the files that cannot be read.
    chosen : int
        Which of them it is.
    dropped : tuple of str
        What of its own files does not count, a line each.
    n_ray : tuple of int
        Rays of each beam.
    in_record : tuple of float
        The least, the usual and the largest number of rays of a beam in ten minutes that have some, those that the
        files begin or end in left out; NaN where there are no others.
    """

    scan: Scan
    files: tuple[Path, ...]
    found: SortedFiles
    chosen: int
    dropped: tuple[str, ...]
    n_ray: tuple[int, ...]
    in_record: tuple[float, float, float]


def find_scan(
    files: str | Path | Sequence[str | Path],
    *,
    height: float | Sequence[float] | None = None,
    distance: float | Sequence[float] | None = None,
    tolerance_deg: float = 1.0,
    min_share: float = 0.2,
    group: int | None = None,
    name: str | None = None,
    probe: Probe | None = None,
    **options: Any,
) -> Scan:
    r"""Make the scan that files of rays were measured with, from the rays' own directions and times.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files, folders or patterns, as for `read`, in a format whose rays carry azimuth and elevation.
    height : float or sequence of float, optional
        Wanted height above the lidar, m: each beam gets the gate nearest to it. Several give a plane of beams each.
    distance : float or sequence of float, optional
        Wanted distance along the beams, m, instead of a height. Rays with one gate need neither.
    tolerance_deg : float
        Rays that are closer than this, degrees, have one direction.
    min_share : float
        Directions with fewer rays than this share, 0 to 1, of the most frequent one are dropped: the scanner was
        on its way.
    group : int, optional
        Which scan of the files it is, where they hold several, as `bayes_rs.readers.sort_files` lists them, from 1.
        By default the only one that has beams.
    name : str, optional
        Name of the scan; that of the first file if not given.
    probe : Probe, optional
        The probe volume of the beams, as `make_probe` returns it; none if not given.
    **options
        How the files are written, as for `read`: the fields of `bayes_rs.readers.FileOptions`, as
        ``invalid=-9999``.

    Returns
    -------
    scan : Scan
        A beam for each direction and height, numbered from 0 in the order of time, from the direction that is next to
        north, clockwise; plane by plane. Its ``source`` says how many rays it rests on and what was dropped.
        `save_scan` writes it to a file.

    Raises
    ------
    InputError
        If no file is of such a format, the files hold several scans with beams, directions run into each other or are
        seen only once, rays stay on one direction before they go to the next, or no gate is at a wanted height.

    Notes
    -----
    The duration of the scan is the median time between visits of a direction, and the median of that over directions.
    A beam's time is the median time since the last visit of the first beam. Both are rounded to 1 ms. A direction is
    the mean of its rays' unit vectors. Beams seen more or less often than once in a cycle are named in the source: the
    noise model takes them for once.

    The wanted distance along a beam of elevation :math:`\varepsilon` is :math:`h / \sin\varepsilon`; the nearest gate
    must be within half the spacing of the gates.

    Examples
    --------
    >>> import tempfile
    >>> import xarray as xr
    >>> azimuth, time = [0.0, 90.0, 180.0] * 4, np.arange(12.0)
    >>> variables = {
    ...     "azimuth": ("time", azimuth),
    ...     "elevation": ("time", [60.0] * 12),
    ...     "range": ("gate", [100.0, 120.0, 140.0]),
    ...     "radial_wind_speed": (("time", "gate"), np.ones((12, 3))),
    ... }
    >>> times = ("time", time, {"units": "seconds since 2021-05-13"})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "noon.nc"
    ...     xr.Dataset(variables, coords={"time": times}).to_netcdf(file)
    ...     scan = find_scan(file, height=105.0)
    >>> scan.focus_distance, scan.beam_time, scan.scan_duration
    (array([120., 120., 120.]), array([0., 1., 2.]), 3.0)
    """
    return survey(
        files,
        height=height,
        distance=distance,
        tolerance_deg=tolerance_deg,
        min_share=min_share,
        group=group,
        name=name,
        probe=probe,
        **options,
    ).scan


def survey(
    files: str | Path | Sequence[str | Path],
    *,
    height: float | Sequence[float] | None = None,
    distance: float | Sequence[float] | None = None,
    tolerance_deg: float = 1.0,
    min_share: float = 0.2,
    group: int | None = None,
    name: str | None = None,
    probe: Probe | None = None,
    any_gate: bool = False,
    **options: Any,
) -> Survey:
    """Return what `find_scan` finds, with all that is beside it in the files; at any gate if it does not matter."""
    wanted, what = _wanted(height, distance)
    tolerance = check_positive(tolerance_deg, what="tolerance_deg", unit="degrees")
    share = check_finite(min_share, what="min_share", unit="")
    if not 0.0 <= share <= 1.0:
        raise InputError(f"Invalid min_share {min_share!r}: it must be from 0 to 1.")
    surveyed, skipped = survey_files(files, from_plain(FileOptions, options, where="the options of reading"))
    groups = sort_surveyed(surveyed, tolerance)
    found = SortedFiles(tuple(one for one, _ in groups), skipped)
    number = _chosen(found.groups, group)
    own = surveyed if number is None or len(groups) == 1 else [file for file in surveyed if file in groups[number][1]]
    paths = [file.path for file in own]
    time, direction, gates = _join(own)
    every = _directions(direction, tolerance, paths)
    most = max(len(one.rays) for one in every)
    kept = [one for one in every if len(one.rays) >= share * most]
    rare = [one for one in every if len(one.rays) < share * most]
    if not wanted and any_gate:
        wanted, what = _nearest_gate(kept, gates)
    elif not wanted:
        wanted = [_only_gate(kept, gates)]
    kept, beam_time, duration, irregular = _timing(kept, time, tolerance, paths)
    focus = np.array([[_focus(one, gates, goal, what, paths) for one in kept] for goal in wanted])
    _check_planes(focus, kept, wanted, what)
    n_plane, n_ray = len(wanted), sum(len(one.rays) for one in kept)
    n_rays = [len(one.rays) for one in kept] * n_plane
    files_in_words = paths[0].name if len(paths) == 1 else f"{paths[0].name} and {len(paths) - 1} more files"
    dropped = []
    if rare:
        other = np.array([one.direction for one in rare])
        dropped.append(
            f"dropped {sum(len(one.rays) for one in rare)} rays in rare directions (azimuth, elevation): "
            f"{directions_in_words(other)}"
        )
    lost = len(time) - sum(len(one.rays) for one in every)
    dropped += [f"dropped {lost} rays without a time or a direction"] if lost else []
    if len(irregular):
        dropped.append(f"not visited once in each cycle: {directions_in_words(irregular)}")
    spread = max(one.spread_deg for one in kept)
    scan = Scan(
        name=name or paths[0].name.split(".")[0],
        title=f"{len(kept)} directions found in measured rays",
        source="; ".join([f"{n_ray} rays of {files_in_words}, each within {spread:.2g} degrees", *dropped]),
        beam_direction=np.tile(np.array([one.direction for one in kept]), (n_plane, 1)),
        focus_distance=focus.ravel(),
        beam_time=np.tile(beam_time, n_plane),
        scan_duration=duration,
        probe=probe or PointProbe(),
    )
    return Survey(
        scan,
        tuple(paths),
        found,
        0 if number is None else number,
        tuple(dropped),
        tuple(n_rays),
        _in_records(time, [one.rays for one in kept]),
    )


def _in_records(time: NDArray[np.datetime64], rays: Sequence[NDArray[np.int64]]) -> tuple[float, float, float]:
    """Return the least, the median and the largest number of rays of a direction in ten minutes that have some."""
    window = [time[of_beam].astype("datetime64[s]").astype(np.int64) // _RECORD for of_beam in rays]
    kinds, at = np.unique(np.concatenate(window), return_inverse=True)
    beam = np.repeat(np.arange(len(rays)), [len(of_beam) for of_beam in rays])
    count = np.zeros((len(rays), len(kinds)))
    np.add.at(count, (beam, at.ravel()), 1.0)
    whole = count[:, 1:-1]  # the first and the last may be cut
    if not whole.size:
        return np.nan, np.nan, np.nan
    return float(whole.min()), float(np.median(whole)), float(whole.max())


def _wanted(
    height: float | Sequence[float] | None, distance: float | Sequence[float] | None
) -> tuple[list[float], str]:
    """Return the wanted heights or distances, none if none was given, and which of the two they are."""
    if height is not None and distance is not None:
        raise InputError("Give height or distance (m), one of the two: they say which gates the beams take.")
    if height is None and distance is None:
        return [], "distance"
    what, given = ("height", height) if height is not None else ("distance", distance)
    goals = [check_positive(goal, what=what, unit="m") for goal in np.atleast_1d(np.asarray(given)).tolist()]
    if not goals:
        raise InputError(f"No {what} given: name at least one, in m.")
    return goals, what


def _chosen(groups: Sequence[ScanGroup], group: int | None) -> int | None:
    """Return which of the scans of files is meant; None for all files, which hold nothing but stares."""
    if group is not None:
        number = check_count(group, what="group")
        if number > len(groups):
            raise InputError(f"Invalid group {number}: the files hold {len(groups)}: {_listed(groups)}.")
        return number - 1
    if len(groups) == 1:
        return 0
    with_beams = [number for number, one in enumerate(groups) if one.kind == "beams"]
    if len(with_beams) == 1:
        return with_beams[0]
    if all(one.kind == "stare" for one in groups):
        return None
    has = f"{len(with_beams)} of them have beams" if with_beams else "none of them has beams"
    raise InputError(
        f"The files hold {len(groups)} scans, and {has}: {_listed(groups)}. Give the number of one as group "
        "(--scan-group), or its files alone."
    )


def _listed(groups: Sequence[ScanGroup]) -> str:
    words = SortedFiles(tuple(groups[:_MOST_GROUPS]), {}).in_words()
    return " | ".join(words) + (f" | and {len(groups) - _MOST_GROUPS} more" if len(groups) > _MOST_GROUPS else "")


def _only_gate(groups: Sequence[_Found], gates: FloatArray) -> float:
    """Return the distance, m, of rays with one gate; of others say which there are."""
    own = [gates[one.rays] for one in groups]
    there = [np.unique(np.round(part[np.isfinite(part)], 3)) for part in own]
    if all(len(part) == 1 for part in there) and np.ptp([part[0] for part in there]) == 0.0:
        return float(there[0][0])
    words = "no ray has one"
    for one, part in zip(groups, there, strict=True):
        if len(part):
            distances = f"distances {_some(part)} m"
            up = float(one.direction[2])
            heights = f", heights {_some(part * up)} m" if up > 0.0 else ""
            words = f"in {_in_words(one)} at {distances}{heights}"
            break
    raise InputError(
        "Give height or distance (m; --height, --range), one of the two: they say which gates the beams take. The "
        "gates that are there: "
        f"{words}."
    )


def _nearest_gate(groups: Sequence[_Found], gates: FloatArray) -> tuple[list[float], str]:
    """Return the least height, or distance if not all directions rise, at which every direction has a gate."""
    rise = [float(one.direction[2]) for one in groups]
    what = "height" if min(rise) > 0.0 else "distance"
    near = [np.nanmin(np.where(np.isfinite(gates[one.rays]), gates[one.rays], np.inf)) for one in groups]
    ends = [first * (up if what == "height" else 1.0) for first, up in zip(near, rise, strict=True)]
    return [float(max(ends))], what


def _some(values: FloatArray) -> str:
    """Return numbers as text, of many the first and the last."""
    shown = [f"{value:.4g}" for value in values]
    if len(shown) > _MOST_GATES:
        shown = [*shown[: _MOST_GATES - 1], f"… ({len(shown)} in all)", shown[-1]]
    return ", ".join(shown)


def _join(parts: Sequence[SurveyedFile]) -> tuple[NDArray[np.datetime64], FloatArray, FloatArray]:
    """Return times, directions and gates of all files; gates that a file lacks are NaN."""
    n_gate = max(part.distance.shape[1] for part in parts)
    gates = np.full((sum(len(part.time) for part in parts), n_gate), np.nan)
    first = 0
    for part in parts:
        gates[first : first + len(part.time), : part.distance.shape[1]] = part.distance
        first += len(part.time)
    return (
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.direction for part in parts]),
        gates,
    )


def _directions(direction: FloatArray, tolerance: float, paths: Sequence[Path]) -> list[_Found]:
    """Return the directions that rays have in common, none of which runs into another."""
    found = common_directions(direction, tolerance)
    for index in np.flatnonzero(found.spread_deg > tolerance).tolist():
        raise InputError(
            f"{len(found.rays[index])} rays of file {str(paths[0])!r} run into each other over "
            f"{found.spread_deg[index]:.3g} degrees from {directions_in_words(found.direction[[index]])} (azimuth, "
            f"elevation), in steps within tolerance_deg = {tolerance:g}: give a smaller tolerance_deg; rays of a "
            "scanner that sweeps are no beams."
        )
    return [_Found(*one) for one in zip(found.rays, found.direction, found.spread_deg.tolist(), strict=True)]


def _timing(
    groups: list[_Found], time: NDArray[np.datetime64], tolerance: float, paths: Sequence[Path]
) -> tuple[list[_Found], FloatArray, float, FloatArray]:
    """Return the directions in the order of time, their times, the cycle (s), and the directions out of step."""
    seconds = [np.unique(time[group.rays] - time.min()) / np.timedelta64(1, "s") for group in groups]
    for group, at in zip(groups, seconds, strict=True):
        if len(at) < 2:
            raise InputError(
                f"File {str(paths[0])!r} has one time only of {_in_words(group)}: the time of a cycle is not known; "
                "give files with more cycles."
            )
    revisit = np.array([np.median(np.diff(at)) for at in seconds])
    duration = round(float(np.median(revisit)), _TIME_DIGITS)
    order = np.argsort(np.concatenate(seconds), kind="stable")
    owner = np.repeat(np.arange(len(groups)), [len(at) for at in seconds])[order]
    if len(groups) > 1 and np.mean(owner[1:] == owner[:-1]) > 0.5:
        raise InputError(
            f"The rays of file {str(paths[0])!r} stay on one direction before they go to the next: a scan visits each "
            "of its beams once in a cycle; write the scan by hand."
        )
    azimuth, elevation = angles_of(np.array([group.direction for group in groups]))
    clockwise = np.where(elevation > 90.0 - tolerance, 360.0, (azimuth + tolerance) % 360.0)
    first = seconds[int(np.argmin(clockwise))]
    times = np.array([_since(first, at, duration) for at in seconds])
    irregular = np.abs(revisit / duration - 1.0) > _REGULAR
    ranked = np.argsort(times, kind="stable")
    out = np.array([groups[index].direction for index in np.flatnonzero(irregular)]).reshape(-1, 3)
    return [groups[index] for index in ranked], times[ranked], duration, out


def _since(first: FloatArray, times: FloatArray, duration: float) -> float:
    """Return the median time, s, from a visit of the first beam to the next of another, within the cycle."""
    last = np.searchsorted(first, times, side="right") - 1
    since = times[last >= 0] - first[last[last >= 0]]
    return round(float(np.median(since)) % duration, _TIME_DIGITS) % duration if len(since) else 0.0


def _focus(group: _Found, gates: FloatArray, goal: float, what: str, paths: Sequence[Path]) -> float:
    """Return the distance, m, of a direction's gate nearest to a wanted height or distance."""
    words = _in_words(group)
    if what == "height" and group.direction[2] <= 0.0:
        raise InputError(f"Invalid height {goal:g} m for {words}: the beam does not rise; give distance instead.")
    along = goal / float(group.direction[2]) if what == "height" else goal
    own = gates[group.rays]
    gate, good = nearest_gates(own, np.array([along]), None)
    if not good.any():
        raise InputError(
            f"No gate at {what} {goal:g} m in {words} of file {str(paths[0])!r}: that is {along:g} m along the beam, "
            f"and its gates are {gates_in_words(own)}; give another {what}."
        )
    return float(np.median(own[np.flatnonzero(good[:, 0]), gate[good[:, 0], 0]]))


def _check_planes(focus: FloatArray, groups: Sequence[_Found], wanted: Sequence[float], what: str) -> None:
    """Refuse two heights for which a direction has the same gate."""
    for column, group in enumerate(groups):
        _, first, at = np.unique(focus[:, column], return_index=True, return_inverse=True)
        repeated = np.flatnonzero(first[at.ravel()] != np.arange(len(wanted)))
        if len(repeated):
            second = int(repeated[0])
            other = wanted[int(first[at.ravel()][second])]
            raise InputError(
                f"The {what}s {other:g} and {wanted[second]:g} m have the same gate, at {focus[second, column]:g} m, "
                f"in {_in_words(group)}: give {what}s that are further apart."
            )


def _in_words(group: _Found) -> str:
    return f"direction {directions_in_words(group.direction[np.newaxis])} (azimuth, elevation)"
