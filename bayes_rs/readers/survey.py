"""A scan from the files that were measured with it: where the beams point, when, and at which gates."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from bayes_rs._validation import FloatArray, check_choice, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.options import from_plain
from bayes_rs.readers.compressed import plain_file, plain_suffix
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.matching import directions_in_words, gates_in_words, nearest_gates
from bayes_rs.readers.not_read import why_not
from bayes_rs.readers.rays import Rays, angles_of
from bayes_rs.readers.registry import READERS

RAY_READERS = {name: reader for name, reader in READERS.items() if reader.rays is not None}
"""The formats whose rays say where they point."""

_GRID = 20  # steps of the tolerance; directions nearer than one are compared once
_REGULAR = 0.2  # share by which a direction's median revisit may differ from the cycle
_TIME_DIGITS = 3  # of seconds; a median over rays knows no more


class _Found(NamedTuple):
    """One direction that rays have in common."""

    rays: NDArray[np.int64]
    direction: FloatArray
    spread_deg: float


def find_scan(
    files: str | Path | Sequence[str | Path],
    *,
    height: float | Sequence[float] | None = None,
    distance: float | Sequence[float] | None = None,
    tolerance_deg: float = 1.0,
    min_share: float = 0.2,
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
        Wanted distance along the beams, m, instead of a height.
    tolerance_deg : float
        Rays that are closer than this, degrees, have one direction.
    min_share : float
        Directions with fewer rays than this share, 0 to 1, of the most frequent one are dropped: the scanner was
        on its way.
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
        If no file is of such a format, directions run into each other or are seen only once, rays stay on one
        direction before they go to the next, or no gate is at a wanted height.

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
    wanted, what = _wanted(height, distance)
    tolerance = check_positive(tolerance_deg, what="tolerance_deg", unit="degrees")
    share = check_finite(min_share, what="min_share", unit="")
    if not 0.0 <= share <= 1.0:
        raise InputError(f"Invalid min_share {min_share!r}: it must be from 0 to 1.")
    asked = from_plain(FileOptions, options, where="the options of reading")
    check_choice(asked.file_format, ("auto", *RAY_READERS), what="file_format")
    suffixes = [suffix for reader in RAY_READERS.values() for suffix in reader.suffixes]
    paths = find_files(files, suffixes).paths
    parts = [_rays(path, asked) for path in paths]
    time, direction, gates = _join(parts)
    found = _directions(direction, tolerance, paths)
    most = max(len(group.rays) for group in found)
    kept = [group for group in found if len(group.rays) >= share * most]
    dropped = [group for group in found if len(group.rays) < share * most]
    kept, beam_time, duration, irregular = _timing(kept, time, tolerance, paths)
    focus = np.array([[_focus(group, gates, goal, what, paths) for group in kept] for goal in wanted])
    _check_planes(focus, kept, wanted, what)
    n_plane, n_ray = len(wanted), sum(len(group.rays) for group in kept)
    files_in_words = paths[0].name if len(paths) == 1 else f"{paths[0].name} and {len(paths) - 1} more files"
    source = f"{n_ray} rays of {files_in_words}, each within {max(group.spread_deg for group in kept):.2g} degrees"
    if dropped:
        other = np.array([group.direction for group in dropped])
        source += (
            f"; dropped {sum(len(group.rays) for group in dropped)} rays in rare directions (azimuth, elevation): "
            f"{directions_in_words(other)}"
        )
    lost = len(time) - sum(len(group.rays) for group in found)
    source += f"; dropped {lost} rays without a time or a direction" if lost else ""
    source += f"; not visited once in each cycle: {directions_in_words(irregular)}" if len(irregular) else ""
    return Scan(
        name=name or paths[0].name.split(".")[0],
        title=f"{len(kept)} directions found in measured rays",
        source=source,
        beam_direction=np.tile(np.array([group.direction for group in kept]), (n_plane, 1)),
        focus_distance=focus.ravel(),
        beam_time=np.tile(beam_time, n_plane),
        scan_duration=duration,
        probe=probe or PointProbe(),
    )


def _wanted(
    height: float | Sequence[float] | None, distance: float | Sequence[float] | None
) -> tuple[list[float], str]:
    if (height is None) == (distance is None):
        raise InputError("Give height or distance (m), one of the two: they say which gates the beams take.")
    what, given = ("height", height) if height is not None else ("distance", distance)
    goals = [check_positive(goal, what=what, unit="m") for goal in np.atleast_1d(np.asarray(given)).tolist()]
    if not goals:
        raise InputError(f"No {what} given: name at least one, in m.")
    return goals, what


def _rays(path: Path, options: FileOptions) -> Rays:
    kind = options.file_format
    reason = why_not(path)
    if reason is not None:
        raise InputError(reason)
    nothing = Scan("none", np.array([[0.0, 0.0, 1.0]]), np.ones(1), np.zeros(1), scan_duration=1.0)
    with plain_file(path) as plain:
        try:
            for name, reader in RAY_READERS.items():
                resolved = resolve_format(options, None, defaults=reader.defaults)
                fits = plain_suffix(plain) in reader.suffixes
                if name == kind or (kind == "auto" and fits and reader.recognises(plain, nothing, resolved)):
                    return reader.rays(plain, resolved)  # type: ignore[misc]  # those of RAY_READERS are not None
        except InputError as error:
            raise InputError(str(error).replace(repr(str(plain)), repr(str(path)))) from error
    raise InputError(
        f"File {str(path)!r} is in none of the formats whose rays say where they point ({', '.join(RAY_READERS)}): "
        "give other files, or write the scan by hand."
    )


def _join(parts: Sequence[Rays]) -> tuple[NDArray[np.datetime64], FloatArray, FloatArray]:
    """Return times, directions and gates of all files; gates that a file lacks are NaN."""
    n_gate = max(part.distance.shape[1] for part in parts)
    gates = [
        np.pad(part.distance, ((0, 0), (0, n_gate - part.distance.shape[1])), constant_values=np.nan) for part in parts
    ]
    return (
        np.concatenate([part.time for part in parts]),
        np.concatenate([np.where(np.isnat(part.time)[:, np.newaxis], np.nan, part.direction) for part in parts]),
        np.concatenate(gates),
    )


def _directions(direction: FloatArray, tolerance: float, paths: Sequence[Path]) -> list[_Found]:
    """Return the directions that rays have in common: those linked by steps within the tolerance."""
    known = np.flatnonzero(np.isfinite(direction).all(axis=1))
    if len(known) == 0:
        raise InputError(f"File {str(paths[0])!r} has no ray with a time and a direction: give files with rays.")
    reach = 2.0 * np.sin(0.5 * np.deg2rad(min(tolerance, 180.0)))
    cell, at = np.unique(np.round(direction[known] * (_GRID / reach)), axis=0, return_inverse=True)
    total = np.stack([np.bincount(at.ravel(), weights=part) for part in direction[known].T], axis=1)
    centre = total / np.linalg.norm(total, axis=1, keepdims=True)
    pairs = cKDTree(centre).query_pairs(reach, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cell), len(cell)))
    label = connected_components(links, directed=False)[1][at.ravel()]
    found = []
    for number in range(int(label.max()) + 1):
        rays = known[label == number]
        mean = direction[rays].mean(axis=0)
        length = float(np.linalg.norm(mean))
        mean = mean / length if length > 0.0 else direction[rays[0]]
        chord = np.linalg.norm(direction[rays] - mean, axis=1).max()
        spread = float(np.rad2deg(2.0 * np.arcsin(min(0.5 * chord, 1.0))))
        if spread > tolerance:
            raise InputError(
                f"{len(rays)} rays of file {str(paths[0])!r} run into each other over {spread:.3g} degrees from "
                f"{directions_in_words(mean[np.newaxis])} (azimuth, elevation), in steps within tolerance_deg = "
                f"{tolerance:g}: give a smaller tolerance_deg; rays of a scanner that sweeps are no beams."
            )
        found.append(_Found(rays, mean, spread))
    return found


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
