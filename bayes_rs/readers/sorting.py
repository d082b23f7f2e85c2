"""Files of rays sorted into the scans that they were measured with: beams, stares and sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.options import from_plain
from bayes_rs.readers.directions import CommonDirections, common_directions
from bayes_rs.readers.matching import directions_in_words
from bayes_rs.readers.rays import angles_of
from bayes_rs.readers.surveyed import SurveyedFile, survey_files

KINDS = ("beams", "stare", "ppi", "rhi", "sweep")
"""What files of rays hold: beams that are visited in turn; one direction; a turn of the azimuth at one elevation, of
the elevation at one azimuth; another sweep."""

RARE = 0.2
"""Directions with fewer rays than this share of the most frequent one: the scanner was on its way."""
_FEWEST = 8  # directions of an arc; a scan of fewer beams may lie on one, too
_ALIKE = 0.7  # share of a file's directions that are those of a scan; the others are on the way
_UPRIGHT = 85.0  # degrees of elevation
_LARGEST_STEP = 10.0  # degrees from one ray of a sweep to the next
_RUNNING = 1.5  # tolerances between rays that run into each other
_OPEN = 2.5  # steps of the azimuth that a circle lacks, if it is none
_RING, _SELDOM = 30, 120.0  # beams of a circle, and s; variances need them more often
_SPACING = 0.1  # share by which the spacing of gates may differ
_STAYS = 0.5  # share of the rays that look where the ray before them did, above which a scanner stares


@dataclass(frozen=True)
class ScanGroup:
    """Files that were measured with one scan.

    Parameters
    ----------
    kind : str
        ``"beams"``, visited in turn, as a scan of this package has them; ``"stare"``; ``"ppi"``, ``"rhi"`` or
        ``"sweep"``, which have no beams.
    files : tuple of Path
        The files, in the order of time.
    direction : ndarray, shape (n, 3)
        The directions that are looked along, unit vectors as in `Rays`; rare ones left out. Of a sweep four: where its
        azimuth begins and ends, clockwise, the lowest and the highest.
    n_ray : int
        Number of rays with a time and a direction.
    start, end : datetime64
        Time of the first and of the last of them, UTC.
    nearest, farthest : float
        Distance of the first and of the last gate, m; NaN if no ray has one.
    spacing : float
        Distance from one gate to the next, m; NaN if rays have one gate.
    """

    kind: str
    files: tuple[Path, ...]
    direction: FloatArray
    n_ray: int
    start: np.datetime64
    end: np.datetime64
    nearest: float
    farthest: float
    spacing: float

    def in_words(self) -> str:
        """Say what the scan is, how many files have it, and when they were measured."""
        azimuth, elevation = angles_of(self.direction)
        pointing = f"azimuth {_span(azimuth[:2])}, elevation {_span(elevation[-2:])} degrees"
        what = {
            "beams": f"{len(self.direction)} beams (azimuth, elevation) {directions_in_words(self.direction)}",
            "stare": f"stare at (azimuth, elevation) {directions_in_words(self.direction)}",
            "ppi": f"PPI, {pointing}",
            "rhi": f"RHI, {pointing}",
            "sweep": f"sweep, {pointing}",
        }[self.kind]
        n_file = f"{len(self.files)} file{'s' * (len(self.files) > 1)}"
        first, last = (str(time.astype("datetime64[s]")) for time in (self.start, self.end))
        last = last if last[:10] != first[:10] else last[11:]
        gates = f"gates {self.nearest:.5g} to {self.farthest:.5g} m"
        gates += f" every {self.spacing:.4g} m" if np.isfinite(self.spacing) else ""
        return f"{what}; {gates}; {n_file}, {self.n_ray} rays, {first} to {last}"


@dataclass(frozen=True)
class SortedFiles:
    """Files of rays by their scans, as `sort_files` returns them.

    Parameters
    ----------
    groups : tuple of ScanGroup
        Those with beams first, then stares and sweeps; of one kind the one with most rays first.
    skipped : dict of Path to str
        Files that cannot be read, with the reasons; only where ``on_bad_file="skip"`` was given.
    """

    groups: tuple[ScanGroup, ...]
    skipped: dict[Path, str]

    def in_words(self) -> list[str]:
        """Return a line for each group, numbered from 1."""
        return [f"{number}: {group.in_words()}" for number, group in enumerate(self.groups, 1)]


def sort_files(files: str | Path | Sequence[str | Path], *, tolerance_deg: float = 1.0, **options: Any) -> SortedFiles:
    """Sort files of rays into the scans that they were measured with.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files, folders or patterns, as for `read`, in a format whose rays carry azimuth and elevation.
    tolerance_deg : float
        Rays that are closer than this, degrees, have one direction.
    **options
        How the files are written, as for `read`: the fields of `bayes_rs.readers.FileOptions`.

    Returns
    -------
    found : SortedFiles
        The groups of files, and those that cannot be read.

    Raises
    ------
    InputError
        If no file can be read, or an option is not valid.

    Notes
    -----
    A file is a stare if its rays have one direction, rare ones left out. It is a sweep if eight or more rays follow
    each other in steps of up to one and a half times the tolerance, or of up to 10° along an arc that closes no circle:
    a PPI if the elevation stays within twice the tolerance, an RHI if the rays stay so near to one vertical plane. Else
    it has beams, but thirty or more along a circle that come again after more than two minutes are a PPI, too. Files
    with the same directions, or a part of a cycle of them, and the same spacing of gates are one scan. Stares in
    several directions are one scan of beams where the lidar goes from one to the next from ray to ray.

    Examples
    --------
    >>> import tempfile
    >>> import xarray as xr
    >>> def write(file, azimuth, elevation, begin):
    ...     n_ray = len(azimuth)
    ...     variables = {
    ...         "azimuth": ("time", azimuth),
    ...         "elevation": ("time", [float(elevation)] * n_ray),
    ...         "range": ("gate", [100.0, 120.0]),
    ...         "radial_wind_speed": (("time", "gate"), np.ones((n_ray, 2))),
    ...     }
    ...     times = ("time", begin + np.arange(n_ray), {"units": "seconds since 2021-05-13"})
    ...     xr.Dataset(variables, coords={"time": times}).to_netcdf(file)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write(f"{folder}/a.nc", [0.0, 90.0, 180.0, 270.0] * 3, 75.0, 0)
    ...     write(f"{folder}/b.nc", np.arange(20.0, 60.0, 2.0), 5.0, 12)
    ...     for line in sort_files(folder).in_words():
    ...         print(line)
    1: 4 beams (azimuth, elevation) (0.0, 75.0), (90.0, 75.0), (180.0, 75.0), (270.0, 75.0); gates 100 to \
120 m every 20 m; 1 file, 12 rays, 2021-05-13T00:00:00 to 00:00:11
    2: PPI, azimuth 20.0 to 58.0, elevation 5.0 degrees; gates 100 to 120 m every 20 m; 1 file, 20 rays, \
2021-05-13T00:00:12 to 00:00:31
    """
    tolerance = check_positive(tolerance_deg, what="tolerance_deg", unit="degrees")
    surveyed, skipped = survey_files(files, from_plain(FileOptions, options, where="the options of reading"))
    return SortedFiles(tuple(group for group, _ in sort_surveyed(surveyed, tolerance)), skipped)


def sort_surveyed(files: Sequence[SurveyedFile], tolerance: float) -> list[tuple[ScanGroup, list[SurveyedFile]]]:
    """Sort files that have been surveyed; see `sort_files`.

    Raises
    ------
    InputError
        If no ray has a time and a direction.
    """
    known = [file for file in files if np.isfinite(file.direction).all(axis=1).any()]
    if not known:
        raise InputError(f"File {str(files[0].path)!r} has no ray with a time and a direction: give files with rays.")
    looks = {id(file): _look(file, tolerance) for file in known}
    found: list[tuple[str, FloatArray, list[SurveyedFile]]] = []
    # those with most directions first: a file may hold a part of a cycle
    for file in sorted(known, key=lambda file: -len(looks[id(file)][1])):
        kind, direction = looks[id(file)]
        for of_kind, known_direction, of_group in found:
            if of_kind != kind or not _same_gates(file, of_group[0]):
                continue
            if _same(kind, direction, known_direction, file, tolerance):
                of_group.append(file)
                break
        else:
            found.append((kind, direction, [file]))
    groups = [_group(kind, of_group, tolerance) for kind, of_group in _joined(found, tolerance)]
    return sorted(groups, key=lambda one: (KINDS.index(one[0].kind), -one[0].n_ray))


def _look(file: SurveyedFile, tolerance: float) -> tuple[str, FloatArray]:
    """Return the kind of a file's scan, and its directions."""
    found = common_directions(file.direction, tolerance)
    often = found.count >= RARE * found.count.max()
    sweeps = _sweeps(file, tolerance)
    if not sweeps and often.sum() == 1 and found.spread_deg[often][0] <= tolerance:
        return "stare", found.direction[often]
    if sweeps or found.count[found.spread_deg > tolerance].sum() > 0.5 * found.count.sum():
        return _kind_of_sweep(file.direction, tolerance) or "sweep", _ends(file.direction)
    return "beams", found.direction[often]


def _sweeps(file: SurveyedFile, tolerance: float) -> bool:
    """Tell whether rays follow each other in steps of the tolerance, or in small steps along an arc that stays open."""
    known = np.isfinite(file.direction).all(axis=1)
    ordered = file.direction[known][np.argsort(file.time[known], kind="stable")]
    step = _angle(np.diff(ordered, axis=0))
    moves = step[step > 0.1 * tolerance]
    if len(moves) < max(_FEWEST, 0.5 * len(step)):
        return False
    far = _angle(ordered - ordered[0]).max()
    if np.median(moves) <= _RUNNING * tolerance and far > _FEWEST * np.median(moves) / 2.0:
        return True
    if np.median(moves) > _LARGEST_STEP or not _kind_of_sweep(ordered, tolerance):
        return False
    azimuth = angles_of(ordered)[0]
    turn = np.abs((np.diff(azimuth) + 180.0) % 360.0 - 180.0)
    azimuth.sort()
    widest = np.diff(np.append(azimuth, azimuth[0] + 360.0)).max()
    return bool(widest > _OPEN * max(float(np.median(turn)), tolerance))


def _angle(chord: FloatArray) -> FloatArray:
    """Return the angle, degrees, of chords (..., 3) of the unit sphere."""
    return np.asarray(np.rad2deg(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(chord, axis=-1), 1.0))))


def _kind_of_sweep(direction: FloatArray, tolerance: float) -> str:
    """Return ppi or rhi; an empty text if rays stay neither at one elevation nor in one vertical plane."""
    known = direction[np.isfinite(direction).all(axis=1)]
    elevation = angles_of(known)[1]
    low, high = np.percentile(elevation, [5.0, 95.0])
    if high - low <= 2.0 * tolerance:
        return "ppi"
    level = known[:, :2]
    axis = np.linalg.eigh(level.T @ level)[1][:, 0]  # across the vertical plane that they are nearest to
    away = np.rad2deg(np.arcsin(np.minimum(np.abs(level @ axis), 1.0)))
    return "rhi" if np.percentile(away, 95.0) <= 2.0 * tolerance else ""


def _ends(direction: FloatArray) -> FloatArray:
    """Return the rays of a sweep with its first and last azimuth, clockwise, and its lowest and highest elevation."""
    known = direction[np.isfinite(direction).all(axis=1)]
    azimuth, elevation = angles_of(known)
    level = np.flatnonzero(elevation < _UPRIGHT)  # the azimuth of others says little
    level = level if len(level) else np.arange(len(known))
    order = level[np.argsort(azimuth[level], kind="stable")]
    gap = int(np.argmax(np.diff(np.append(azimuth[order], azimuth[order[0]] + 360.0))))
    chosen = [order[(gap + 1) % len(order)], order[gap], np.argmin(elevation), np.argmax(elevation)]
    return np.asarray(known[chosen])


def _same(kind: str, new: FloatArray, known: FloatArray, file: SurveyedFile, tolerance: float) -> bool:
    """Tell whether a file of a kind with the directions `new` belongs to a group with the directions `known`."""
    if kind == "sweep":
        return True
    if kind in ("ppi", "rhi"):
        angle = 1 if kind == "ppi" else 0
        turn = (np.median(angles_of(new[:2])[angle]) - np.median(angles_of(known[:2])[angle]) + 90.0) % 180.0 - 90.0
        return bool(abs(turn) <= 2.0 * tolerance)
    common = int(np.count_nonzero(_angle(new[:, np.newaxis] - known).min(axis=1) <= tolerance))
    if common < _ALIKE * len(new):
        return False
    return 2 * common >= len(known) or len(file.time) <= len(known)  # half a cycle or more, or a part of one


def _same_gates(one: SurveyedFile, other: SurveyedFile) -> bool:
    """Tell whether two files have the same spacing of gates; with one gate only there is none."""
    spacing = np.array([_spacing(one), _spacing(other)])
    return bool(not np.isfinite(spacing).all() or abs(spacing[1] / spacing[0] - 1.0) < _SPACING)


def _spacing(file: SurveyedFile) -> float:
    step = np.abs(np.diff(file.distance[:1], axis=1))
    step = step[np.isfinite(step) & (step > 0.0)]
    return float(np.median(step)) if len(step) else np.nan


def _joined(
    groups: list[tuple[str, FloatArray, list[SurveyedFile]]], tolerance: float
) -> list[tuple[str, list[SurveyedFile]]]:
    """Join stares that are one scan: the lidar goes from one direction to the next from ray to ray."""
    files = [file for kind, _, of_group in groups if kind == "stare" for file in of_group]
    others = [(kind, of_group) for kind, _, of_group in groups if kind != "stare"]
    stares = [(kind, of_group) for kind, _, of_group in groups if kind == "stare"]
    if len(stares) < 2:
        return others + stares
    time, direction = np.concatenate([file.time for file in files]), np.concatenate([file.direction for file in files])
    owner = common_directions(direction, tolerance).label[np.argsort(time, kind="stable")]
    owner = owner[owner >= 0]
    stays = np.mean(owner[1:] == owner[:-1]) > _STAYS
    return others + (stares if stays else [("beams", files)])


def _group(kind: str, files: list[SurveyedFile], tolerance: float) -> tuple[ScanGroup, list[SurveyedFile]]:
    """Return a group with its files in the order of time."""

    def times(file: SurveyedFile) -> NDArray[np.datetime64]:
        return file.time[np.isfinite(file.direction).all(axis=1)]

    ordered = sorted(files, key=lambda file: times(file).min())
    every = np.concatenate([file.direction for file in files])
    if kind in ("beams", "stare"):
        found = common_directions(every, tolerance)
        direction = found.direction[found.count >= RARE * found.count.max()]
        if len(direction) >= _RING and _kind_of_sweep(every, tolerance) == "ppi" and _revisit(found, files) > _SELDOM:
            kind = "ppi"
    if kind not in ("beams", "stare"):
        direction = _ends(every)
    gates = [(np.nanmin(file.distance), np.nanmax(file.distance)) for file in files if np.isfinite(file.distance).any()]
    group = ScanGroup(
        kind=kind,
        files=tuple(file.path for file in ordered),
        direction=direction,
        n_ray=sum(len(times(file)) for file in files),
        start=times(ordered[0]).min(),
        end=max(times(file).max() for file in files),
        nearest=float(min((near for near, _ in gates), default=np.nan)),
        farthest=float(max((far for _, far in gates), default=np.nan)),
        spacing=_spacing(ordered[0]),
    )
    return group, ordered


def _revisit(found: CommonDirections, files: Sequence[SurveyedFile]) -> float:
    """Return the median time, s, after which a direction is looked along again; infinite if none is."""
    time = np.concatenate([file.time for file in files])
    again = [np.diff(np.unique(time[rays])) / np.timedelta64(1, "s") for rays in found.rays]
    every = np.concatenate(again)
    return float(np.median(every)) if len(every) else np.inf


def _span(angles: FloatArray) -> str:
    first, last = (f"{angle:.1f}" for angle in angles[[0, -1]].tolist())
    return first if first == last else f"{first} to {last}"
