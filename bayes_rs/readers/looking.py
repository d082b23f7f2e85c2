"""A first look at files: what they are, what is in them, and what to type next; no scan is needed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_LIMIT, FileOptions
from bayes_rs.options import from_plain
from bayes_rs.quality.groups import group_moments
from bayes_rs.quality.spikes import DESPIKE, RAISED, RAISED_ONE, SPIKES, is_far_out, samples_words
from bayes_rs.readers.compressed import own_suffix, plain_file
from bayes_rs.readers.directions import CommonDirections, common_directions
from bayes_rs.readers.folders import find_files
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.look_table import LookedTable, look_at_table, most_frequent, over_phase
from bayes_rs.readers.netcdf_file import glance
from bayes_rs.readers.one_file import SUFFIXES
from bayes_rs.readers.rays import Rays, angles_of
from bayes_rs.readers.registry import FORMATS
from bayes_rs.readers.sorting import SortedFiles, sort_surveyed
from bayes_rs.readers.surveyed import rays_of, surveyed_rays
from bayes_rs.readers.table import TABLE_SUFFIXES

MOST_FILES = 20
"""Files of rays that are looked at, evenly chosen."""
_GAP = 5.0  # sampling intervals from which on a pause is a gap
_LIKELY = 0.9  # share of the largest growth with height
_BLOCKS = "▁▂▃▄▅▆▇█"
_WINDOW, _SPIKE_WINDOW = 600.0, 11  # s within which samples are compared, and samples of the running median
_N_PHASE = 50  # parts of a cone that are compared with themselves
_MOST_LISTED = 60  # directions
_PRESETS = {1: "staring", 2: "2-beam", 4: "pulsed-4-beam", 50: "zx-tm"}


@dataclass(frozen=True)
class Look:
    """What a first look at files finds.

    Parameters
    ----------
    lines : tuple of str
        What is in them, a fact a line.
    words : tuple of str
        The command to type next, word by word behind ``bayes-rs``.
    phase_deg, over_phase : ndarray, shape (n,)
        Middles of bins of the phase (or of the azimuth), degrees, and the mean velocity in them, m/s; empty where there
        is neither.
    seconds, velocity : ndarray, shape (n,)
        The first samples, s after the first and m/s, as they stand in the file; of rays positive away.
    angle : str
        Which of the two it is.
    """

    lines: tuple[str, ...]
    words: tuple[str, ...]
    phase_deg: FloatArray
    over_phase: FloatArray
    seconds: FloatArray
    velocity: FloatArray
    angle: str = "phase"


def look(files: str | Path | Sequence[str | Path], **options: Any) -> Look:
    """Say what is in files: format, options, beams or directions, gates, sampling, gaps, sign, and what to do next.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files, folders or patterns, as for `read`.
    **options
        What is known of how they are written: the fields of `bayes_rs.readers.FileOptions`.

    Returns
    -------
    look : Look
        What was found. Of many files of rays twenty are read, evenly chosen; of tables the first 200 000 rows of the
        first file. The lines say so.

    Raises
    ------
    InputError
        If there is no file, or the first can be read in no way at all.
    """
    asked = from_plain(FileOptions, options, where="the options of reading")
    check_choice(asked.file_format, tuple(FORMATS), what="file_format")
    paths = find_files(files, SUFFIXES).paths
    size = sum(path.stat().st_size for path in paths)
    head = f"{len(paths)} file{'s' * (len(paths) > 1)}, {_size(size)}; the first is {paths[0].name}"
    named = [str(files)] if isinstance(files, (str, Path)) else [str(file) for file in files]
    try:
        first = rays_of(paths[0], asked)
    except InputError as error:
        not_rays = error
    else:
        return _of_rays(head, paths, first, asked, named)
    if own_suffix(paths[0]) not in TABLE_SUFFIXES:
        return _of_netcdf(head, paths[0], asked, named, not_rays)
    with plain_file(paths[0]) as plain:
        table = look_at_table(plain, resolve_format(asked, None))
    return _of_table(head, table, asked, named, len(paths))


def sparkline(values: FloatArray) -> str:
    """Return numbers as a line of blocks, the least the lowest; a point where there is none."""
    known = values[np.isfinite(values)]
    if not len(known):
        return ""
    low, span = known.min(), max(float(np.ptp(known)), 1e-12)
    return "".join(
        "·" if not np.isfinite(value) else _BLOCKS[min(int((value - low) / span * len(_BLOCKS)), len(_BLOCKS) - 1)]
        for value in values
    )


def _of_rays(head: str, paths: Sequence[Path], first: Rays, asked: FileOptions, named: list[str]) -> Look:
    spread = np.linspace(0, len(paths) - 1, MOST_FILES // 2).round().astype(int)
    index = np.union1d(np.arange(min(len(paths), MOST_FILES // 2)), spread)
    chosen = [paths[one] for one in index.tolist()]
    rays, failed = [first], []
    for path in chosen[1:]:
        try:
            rays.append(rays_of(path, asked))
        except InputError as error:
            failed.append(f"{path.name}: {error}")
    surveyed = [surveyed_rays(one.file, one) for one in rays]
    groups = sort_surveyed(surveyed, asked.angle_tolerance_deg or 1.0)
    main, of_main = groups[0]
    members = {id(file) for file in of_main}
    own = [one for one, file in zip(rays, surveyed, strict=True) if id(file) in members]
    lines = [head]
    if len(paths) > len(chosen):
        lines.append(f"looked at {len(chosen)} of them: the first ones, and others evenly chosen")
    lines += [f"not readable: {line}" for line in failed[:3]]
    lines.append(f"format: {first.kind}, rays that say where they point; {_assumed(first)}")
    words = SortedFiles(tuple(group for group, _ in groups), {}).in_words()
    lines += [f"scan {line}" for line in words]
    time = np.concatenate([one.time for one in own])
    direction = np.concatenate([np.where(np.isnat(one.time)[:, np.newaxis], np.nan, one.direction) for one in own])
    found = common_directions(direction, asked.angle_tolerance_deg or 1.0)
    lines.append(_sampling(time, found.label, whole=len(paths) == len(chosen)))
    gate = _middle_gate(own)
    velocity = np.concatenate([one.radial_velocity[:, min(gate, one.distance.shape[1] - 1)] for one in own])
    far = float(np.nanmedian(own[0].distance[:, gate]))
    every = np.concatenate([one.radial_velocity.ravel() for one in own])
    lines.append(
        f"missing or invalid: {100.0 * np.mean(~np.isfinite(every)):.1f} % of all gates, "
        f"{100.0 * np.mean(~np.isfinite(velocity)):.1f} % at {far:g} m"
    )
    if main.kind == "beams" and len(found.rays) <= _MOST_LISTED:
        lines.append(f"mean velocity at {far:g} m, positive away from the lidar:")
        lines += _directions(found, velocity)
    lines += _spikes(time, velocity, found.label)
    azimuth, elevation = angles_of(direction)
    slant = np.isfinite(velocity) & (elevation < 85.0)
    over = (
        over_phase(np.where(slant, azimuth, np.nan), np.where(slant, velocity, np.nan)) if slant.any() else np.empty(0)
    )
    seconds, some = _beginning(time, velocity)
    height = f"{far * float(np.nanmedian(np.abs(direction[:, 2]))):.0f}"
    wanted = ["--height", height] if np.nanmin(direction[:, 2]) > 0.05 else ["--range", f"{far:g}"]
    group = [] if sum(one.kind == "beams" for one, _ in groups) <= 1 else ["--scan-group", "1"]
    next_words = ("find-scan", *named, *wanted, *group, "-o", "scan.toml")
    if main.kind != "beams":
        lines.append(
            "no scan with beams: a lidar that stares or sweeps tells no Reynolds stresses of several directions; "
            "of a stare find-scan makes a scan of one beam"
        )
    return Look(tuple(lines), next_words, _middles(over), over, seconds, some, "azimuth")


def _directions(found: CommonDirections, velocity: FloatArray) -> list[str]:
    """Say where beams point, how many rays each has, and what the mean velocity is."""
    azimuth, elevation = angles_of(found.direction)
    turns, lines = (azimuth + 0.05) % 360.0 - 0.05, []
    for index in np.lexsort((elevation.round(1), turns.round(1))):
        turn, up, rays = turns[index], elevation[index], found.rays[index]
        known = velocity[rays][np.isfinite(velocity[rays])]
        mean = f"{known.mean():7.2f}" if len(known) else "      ?"
        lines.append(f"  azimuth {turn:z6.1f}  elevation {up:z5.1f}  rays {len(rays):6d}  mean {mean} m/s")
    return lines


def _of_table(head: str, table: LookedTable, asked: FileOptions, named: list[str], n_file: int) -> Look:
    rows = f"{len(table.frame)} rows" if table.whole else f"the first {len(table.frame)} rows"
    lines = [head, f"format: a table, {len(table.headings)} columns; looked at {rows} of the first file"]
    odd = table.odd_value()
    if table.above:
        lines.append(f"{table.above} lines above the headings")
    lines += table.lines()
    time, time_format = table.times()
    velocity, beam, phase = (table.numbers(name) for name in ("radial_velocity", "beam", "phase"))
    label = table.frame[table.column("beam")] if table.column("beam") else None
    numbers: NDArray[np.int64] = np.zeros(len(time), dtype=np.int64)
    names: list[str] = []
    if label is not None:
        codes, kinds = label.mask(label.astype(str) == f"{odd:g}").factorize()
        numbers, names = codes.astype(np.int64), [str(one) for one in kinds]
        lines.append(_beams(numbers, names))
    if (~np.isnat(time)).any():
        lines.append(_sampling(time, numbers, whole=table.whole))
    elif table.column("time"):
        lines.append("times are not in ISO 8601: say how they are written with --time-format")
    pulsed = table.column("radial_velocity") == "RWS"  # as those of pulsed nacelle lidars are headed
    words = ["fit", *named, "--scan", "pulsed-4-beam" if pulsed else _PRESETS.get(len(names), "SCAN")]
    for ours, theirs in ((name, table.column(name)) for name in ("time", "beam", "radial_velocity", "phase")):
        words += ["--column", f"{ours}={theirs}"] if theirs is not None and theirs != ours else []
    words += [part for name, value in table.options.items() for part in (f"--{name}", value)]
    words += ["--time-format", time_format] if time_format else []
    words += ["--invalid", f"{odd:g}"] if np.isfinite(odd) and asked.invalid is None else []
    over = np.empty(0)
    some, seconds = np.empty(0), np.empty(0)
    if velocity is not None:
        said, sign = _sign(velocity)
        lines += said
        words += ["--positive", sign] if sign and asked.positive is None else []
        seconds, some = _beginning(time, velocity)
    told = _spikes(time, velocity, numbers if phase is None else _parts_of_cone(phase))
    lines += told
    words += ["--despike", "median"] if told else []
    lines += ["other files are not looked at: give one of them to look at it"] if n_file > 1 else []
    if phase is not None and velocity is not None:
        turns = np.nanmax(np.abs(phase)) <= 6.3
        over = over_phase(np.rad2deg(phase) if turns else phase, _believable(velocity))
        said, zero = _phase_lines(over)
        lines += said
        words[words.index("--scan") + 1] = "zx-tm"
        if asked.phase_zero_deg is None:
            words += ["--phase-zero", zero]
        if asked.phase_turns is None:
            words += ["--phase-turns", "TURNS"]
    if velocity is None:
        lines.append("no column seems to be a radial velocity: name it with --column radial_velocity=HEADING")
    if beam is None and label is None and phase is None and velocity is not None:
        lines.append("no column seems to say the beam or the phase: name it with --column beam=HEADING")
    return Look(tuple(lines), (*words, "-o", "OUT/"), _middles(over), over, seconds, some)


def _beams(numbers: NDArray[np.int64], names: list[str]) -> str:
    """Say how many samples each beam of a table has."""
    counts = np.bincount(numbers[numbers >= 0], minlength=len(names)).tolist()
    shown = ", ".join(f"{name}: {count}" for name, count in list(zip(names, counts, strict=True))[:12])
    more = " …" if len(names) > 12 else ""
    return f"{len(names)} beam{'s' * (len(names) != 1)}, samples of each: {shown}{more}"


def _of_netcdf(head: str, file: Path, asked: FileOptions, named: list[str], not_rays: InputError) -> Look:
    """Look at a NetCDF file that has no rays: its variables."""
    with plain_file(file) as plain:
        try:
            variables = glance(plain)["/"].names
        except InputError:
            raise not_rays from None
    names = sorted(map(str, variables))
    lines = [head, f"format: NetCDF without rays; {len(names)} variables: {', '.join(names[:30])}"]
    series = {"radial_velocity", "beam", "time"} <= set(names)
    lines.append(
        "a series of radial velocities, as bayes_rs writes them"
        if series
        else "no radial_velocity, beam and time in it"
    )
    del asked
    empty = np.empty(0)
    return Look(tuple(lines), ("records", *named, "--scan", "SCAN", "-o", "records.nc"), empty, empty, empty, empty)


def _assumed(rays: Rays) -> str:
    """Say which options count, and which of them the format itself says."""
    used = rays.file_format
    told = {
        "positive": used.positive,
        "velocity_unit": used.velocity_unit,
        "time_zone": used.time_zone,
        "time_stamp": used.time_stamp or "start",
        **({"invalid": ", ".join(f"{one:g}" for one in used.invalid[:3])} if used.invalid else {}),
        **({"status_valid": f"{used.status_valid:g}"} if used.status_valid is not None else {}),
    }
    assumed = [name for name in told if name in used.from_format]
    words = ", ".join(f"{name} {value}" for name, value in told.items())
    return words + (f" (by the format: {', '.join(assumed)})" if assumed else "")


def _sampling(time: NDArray[np.datetime64], label: NDArray[np.int64], *, whole: bool) -> str:
    """Say from when to when there are samples, how often, and how many gaps."""
    known = ~np.isnat(time) & (label >= 0)
    ordered = np.sort(time[known])
    if not len(ordered):
        return "no sample has a time"
    first, last = (f"{end.astype('datetime64[s]')}" for end in (ordered[0], ordered[-1]))
    steps = [
        np.diff(np.unique(time[known & (label == one)])) / np.timedelta64(1, "s") for one in np.unique(label[known])
    ]
    step = np.concatenate(steps)
    if not len(step):
        return f"{len(ordered)} samples at {first}: each beam once"
    middle = float(np.median(step))
    step_of_all = np.diff(np.unique(ordered)) / np.timedelta64(1, "s")
    what = "a beam" if len(np.unique(label[known])) > 1 else "a sample"
    pauses = step_of_all[step_of_all > _GAP * max(middle, 1e-9)]
    words = f"{len(ordered)} samples from {first} to {last} (as UTC); {what} every {middle:.4g} s, median"
    if not whole or not len(pauses):
        return f"{words}; no gap" if whole else words
    share = 1.0 - float(np.sum(pauses - middle)) / float(np.sum(step_of_all))
    many = "1 gap of" if len(pauses) == 1 else f"{len(pauses)} gaps, the longest"
    return f"{words}; {many} {np.max(pauses):.4g} s; samples in {100.0 * share:.0f} % of the time"


def _parts_of_cone(phase: FloatArray) -> NDArray[np.int64]:
    """Return which part of a cone each sample is of, from phases in degrees or radians; -1 where that is not known."""
    turn = 2.0 * np.pi if np.nanmax(np.abs(phase), initial=0.0) <= 6.3 else 360.0
    part = np.floor((phase / turn) % 1.0 * _N_PHASE)
    return np.where(np.isfinite(part), part, -1.0).astype(np.int64)


def _spikes(time: NDArray[np.datetime64], velocity: FloatArray | None, label: NDArray[np.int64]) -> list[str]:
    """Say how many samples look like spikes, if they matter: as `make_records` says it of records."""
    if velocity is None:
        return []
    known = np.flatnonzero(~np.isnat(time) & (label >= 0) & np.isfinite(_believable(velocity)))
    if not len(known):
        return []
    window = ((time[known] - time[known].min()) / np.timedelta64(1, "s") // _WINDOW).astype(np.int64)
    order = np.lexsort((time[known], window, label[known]))
    beam, values = label[known][order], velocity[known][order]
    group = np.cumsum(np.append(0, (np.diff(beam) != 0) | (np.diff(window[order]) != 0)))
    far = is_far_out(values, group, window=_SPIKE_WINDOW)
    if not far.any():
        return []
    n_group = int(group[-1]) + 1
    of_group = beam[np.flatnonzero(np.diff(group, prepend=-1))]
    every, clean = (
        np.bincount(of_group, weights=np.nan_to_num(group_moments(values[rows], group[rows], n_group)[2]))
        for rows in (np.ones(len(far), dtype=bool), ~far)
    )
    raised = np.divide(every, clean, out=np.ones_like(every), where=clean > 0.0) - 1.0
    if every.sum() <= (1.0 + RAISED) * clean.sum() and raised.max() <= RAISED_ONE:
        return []
    return [f"{samples_words(int(far.sum()), len(values))} {SPIKES}: {DESPIKE}"]


def _sign(velocity: FloatArray) -> tuple[list[str], str | None]:
    """Say what the mean velocity is, and what that means for a lidar that looks upwind."""
    believed = _believable(velocity)
    odd = np.isfinite(velocity) & ~np.isfinite(believed)
    known = believed[np.isfinite(believed)]
    lines = []
    if odd.any():
        often = most_frequent(velocity[odd])
        many = "1 velocity is" if odd.sum() == 1 else f"{int(odd.sum())} velocities are"
        lines.append(f"{many} beyond {VELOCITY_LIMIT:g} m/s, most often {often:g}")
    if not len(known):
        return [*lines, "no velocity is a number"], None
    mean, spread = float(known.mean()), float(known.std())
    empty = 100.0 * np.mean(~np.isfinite(believed))
    lines.append(f"velocity: mean {mean:.2f}, standard deviation {spread:.2f}, {empty:.2g} % missing or invalid")
    if abs(mean) < 0.5 * spread:
        lines.append("its mean is near zero: the beams look all round, or its sign is lost")
        return lines, None
    sign, how = ("away", "negative") if mean < 0.0 else ("towards", "positive")
    lines.append(f"the mean is {how}: a lidar that looks upwind then counts positive {sign}")
    return lines, sign


def _phase_lines(over: FloatArray) -> tuple[list[str], str]:
    """Draw the mean velocity over the phase, and say which phase zero makes the wind grow most with height."""
    known = np.isfinite(over)
    if known.sum() < 4:
        return ["too few phases for a mean over the cone"], "ZERO"
    angle = np.deg2rad(_middles(over))
    design = np.stack([np.ones(known.sum()), np.cos(angle[known]), np.sin(angle[known])], axis=1)
    mean, cosine, sine = np.linalg.lstsq(design, over[known], rcond=None)[0]
    lines = [
        f"mean velocity over the phase, 0 to 360 degrees, {np.nanmin(over):.2f} to {np.nanmax(over):.2f} m/s:",
        f"  {sparkline(over)}",
        f"  {'0':<9}{'90':<9}{'180':<9}270",
    ]
    strongest = float(np.rad2deg(np.arctan2(np.sign(mean) * sine, np.sign(mean) * cosine)) % 360.0)
    lines.append(f"  the wind is strongest at a phase of {strongest:.0f} degrees; as a rule it grows with height:")
    shares = {}
    for zero, (turns, way) in itertools.product((0.0, 90.0, 180.0, 270.0), (("up", 1.0), ("down", -1.0))):
        top = np.deg2rad(way * (90.0 - zero))  # the phase of the scan's angle 90, which is up
        there = np.sign(mean) * (cosine * np.cos(top) + sine * np.sin(top))
        shares[zero, turns] = 200.0 * float(there) / max(abs(float(mean)), 1e-9)
    best = max(shares.values())
    for (zero, turns), share in shares.items():
        likely = "  likely" if share > _LIKELY * best > 0.0 else ""
        lines.append(f"  --phase-zero {zero:3.0f} --phase-turns {turns:<4}  wind at the top {share:+6.1f} %{likely}")
    zeros = {zero for (zero, _), share in shares.items() if share > _LIKELY * best > 0.0}
    lines.append("which way the phase turns is not in the wind: look it up, and put up or down for TURNS")
    return lines, f"{zeros.pop():g}" if len(zeros) == 1 else "ZERO"


def _believable(velocity: FloatArray) -> FloatArray:
    return np.where(np.abs(velocity) <= VELOCITY_LIMIT, velocity, np.nan)


def _middle_gate(rays: Sequence[Rays]) -> int:
    """Return the gate with the fewest missing velocities among the lower half."""
    first = rays[0].radial_velocity
    lower = max((first.shape[1] + 1) // 2, 1)
    return int(np.argmin(np.mean(~np.isfinite(first[:, :lower]), axis=0))) if len(first) else 0


def _beginning(time: NDArray[np.datetime64], velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    known = np.flatnonzero(~np.isnat(time))[:2000]
    if not len(known):
        return np.empty(0), np.empty(0)
    order = known[np.argsort(time[known], kind="stable")]
    return np.asarray((time[order] - time[order[0]]) / np.timedelta64(1, "s")), _believable(velocity[order])


def _middles(over: FloatArray) -> FloatArray:
    return np.asarray(np.arange(len(over)) * (360.0 / max(len(over), 1)))


def _size(size: int) -> str:
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size} bytes"
