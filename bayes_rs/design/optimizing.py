"""Choosing the beams of a scan: the directions within given limits that tell most about R."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_rs._validation import (
    FloatArray,
    as_generator,
    check_array,
    check_choice,
    check_count,
    check_finite,
    check_non_negative,
    check_positive,
)
from bayes_rs.design.scan_criteria import PosteriorCriterion, ScanCriterion, TraceCriterion, make_criterion
from bayes_rs.design.scan_limits import ScanLimits, free_arcs, largest_opening
from bayes_rs.design.scan_optimum import ScanOptimum, beam_angles_deg
from bayes_rs.design.scan_search import ScanSearch, different_ends, value_at
from bayes_rs.errors import InputError
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.models import preset_names
from bayes_rs.priors.registry import Prior
from bayes_rs.progress import progress
from bayes_rs.turbulence.mann import MannTurbulence

__all__ = ["ScanOptimum", "optimize_scan", "scan_criterion"]

AXES = ("upwind", "up")
PLANES = ("simultaneous", "sequential")
_POLISHED = 2  # the best starts, different ones, that are followed with the exact criterion


def optimize_scan(
    *,
    n_beams: int | Sequence[int],
    focus_distance: float | Sequence[float] = 98.0,
    max_angle_deg: float | None = None,
    rotor_radius: float | None = None,
    criterion: str = "width",
    turbulence: str | MannTurbulence | Sequence[str | MannTurbulence] | None = None,
    wind_speed: float = 10.0,
    duration: float = 600.0,
    yaw_deg: float | Sequence[float] | None = None,
    scan_duration: float = 1.0,
    dwell: float | None = None,
    prior: str | Prior = "weak",
    stresses: Sequence[str] | None = None,
    weights: Sequence[float] | None = None,
    cones: int | None = None,
    centre: bool | None = None,
    blocked_deg: Sequence[Sequence[float]] = (),
    min_elevation_deg: float | None = None,
    min_spread_deg: float = 0.0,
    axis: str = "upwind",
    tilt_deg: float = 0.0,
    probe: Probe | None = None,
    planes: str = "simultaneous",
    n_starts: int = 24,
    seed: int | np.random.Generator = 1,
    show_progress: bool | None = None,
) -> ScanOptimum:
    """Choose the directions of a scan's beams so that it tells most about R.

    Parameters
    ----------
    n_beams : int or sequence of int
        Number of beams; of several, the best is kept, and `by_number` has the others.
    focus_distance : float or sequence of float
        Focus distance, m; of several, all beams measure at each.
    max_angle_deg : float, optional
        Largest opening angle φ from the instrument's axis, degrees.
    rotor_radius : float, optional
        The measured points must be no farther than this from the axis, m. At least one of the two must be given.
    criterion : str
        ``"width"``: expected width of the 90 % credible intervals of the chosen stresses, over uu. ``"variance"``:
        posterior variance of R, summed over its nine elements, over the square of its trace. ``"trace"``: the total
        variance of the nine elements by least squares for equal and independent noise, which needs no turbulence.
    turbulence : str or MannTurbulence or sequence of them, optional
        The turbulence; of several, the worst case counts.
    wind_speed : float
        Mean wind speed, m/s.
    duration : float
        Length of a record, s.
    yaw_deg : float or sequence of float, optional
        Wind direction relative to the lidar axis, degrees; of several, the worst case counts. 0 if not given.
    scan_duration : float
        Time for one scan of all beams (and planes), s, which they share equally.
    dwell : float, optional
        Time that the lidar takes for one beam, s: then a scan takes that for every beam, and with more beams each is
        visited less often. It replaces `scan_duration`.
    prior : str or Prior
        The prior.
    stresses : sequence of str, optional
        For ``"width"``: which stresses count; all six if not given.
    weights : sequence of float, optional
        For ``"width"``: weights of these stresses; equal if not given.
    cones : int, optional
        How many opening angles the beams off the axis share: 1 for a single cone. One for each beam if not given.
    centre : bool, optional
        Whether one beam is along the axis. If not given, both are tried with `cones`; without, no beam is held there.
    blocked_deg : sequence of (float, float)
        Ranges of θ, degrees from y towards z, in which no beam may point; (350, 10) goes through 0.
    min_elevation_deg : float, optional
        Least angle of every beam above the horizontal, degrees.
    min_spread_deg : float
        The two beams that are farthest apart must be at least so far apart, degrees.
    axis : str
        ``"upwind"`` for a nacelle lidar, ``"up"`` for one on the ground.
    tilt_deg : float
        Tilt of the instrument, degrees; a positive one raises the beams that point upwind.
    probe : Probe, optional
        Probe volume of the beams; they see points if not given.
    planes : str
        ``"simultaneous"`` or ``"sequential"``: how several focus distances are measured.
    n_starts : int
        Number of local searches, each from the best of 16 random scans.
    seed : int or Generator
        Same seed, same scan.
    show_progress : bool, optional
        Progress bar on stderr; by default only on a terminal.

    Returns
    -------
    best : ScanOptimum
        The best scan, its criterion, what the starts have reached, and the criterion of well-known scans.

    Raises
    ------
    InputError
        If a number or a name is not valid, no scan is within the limits, or, for ``"trace"``, none sees all stresses.

    Notes
    -----
    Each start is a local search by SLSQP (sequential quadratic programming) for the logarithm of the criterion, with
    differences for its slope; for the worst case of several states s it minimizes t subject to ln f_s ≤ t. In its
    course the noise has fewer lags, and a probe volume counts in the gains only; from the best starts it goes on with
    the exact noise of `theory_noise`. All values but `starts` are exact. Local searches from many places are no
    proof of a global optimum: `starts` shows how many have found it.

    "width" and "variance" linearize the posterior about the turbulence's own R, for a record with exactly the expected
    variances: see `bayes_rs.design.scan_criteria`.

    For "trace", m ≥ 5 beams evenly spaced on a cone of angle φ and m₀ along its axis have, with c = cos²φ, s = sin²φ,

        T = 10/(m s²) + 2/(m c s) + 2c²/(m₀ s²) + 1/m₀ :

    the normal matrix ÃᵀÃ (of parameters that count off-diagonals twice) falls into blocks by the harmonic of θ, which
    do not mix for m ≥ 5. They are m s²/4 twice (harmonic 2: vv − ww and vw), m c s twice (harmonic 1: uv and uw), and
    [[m c² + m₀, m c s/√2], [m c s/√2, m s²/2]] (harmonic 0: uu and (vv + ww)/√2), whose inverse has the trace
    (m c² + m₀ + m s²/2)/(m₀ m s²/2). For six beams T = 12.6 at 45°, and T falls to 6.75 at cos²φ = 1/5, where the beams
    are the six axes of an icosahedron. No six beams have less: ÃᵀÃ has the trace n, and n/3 of it along the unit tensor
    e; since (eᵀMe)⁻¹ ≤ eᵀM⁻¹e, and the five other inverses add up to least if they are equal,
    T ≥ 3/n + 25/(2n/3) = 40.5/n.

    References
    ----------
    Sathe, Mann, Vasiljevic and Lea (2015), Atmos. Meas. Tech. 8, 729–740, doi:10.5194/amt-8-729-2015 (the criterion
    "trace", and five beams at 45° around a vertical one).

    Examples
    --------
    >>> best = optimize_scan(n_beams=6, max_angle_deg=45.0, criterion="trace", n_starts=4)
    >>> round(best.value, 6)
    12.6
    """
    if not isinstance(n_beams, (int, np.integer)):
        options = {name: value for name, value in locals().items() if name != "n_beams"}
        return _best_number(n_beams, options)
    began = time.perf_counter()
    check_count(n_beams, what="n_beams")
    check_count(n_starts, what="n_starts")
    check_choice(axis, AXES, what="axis")
    check_choice(planes, PLANES, what="planes")
    rng = as_generator(seed)
    distances = check_array(np.atleast_1d(np.asarray(focus_distance, dtype=np.float64)), (None,), what="focus_distance")
    for distance in distances.tolist():
        check_positive(distance, what="focus_distance", unit="m")
    scale = make_criterion(
        criterion,
        turbulence=turbulence,
        wind_speed=wind_speed,
        duration=duration,
        prior=prior,
        stresses=stresses,
        weights=weights,
        yaw_deg=yaw_deg,
    )
    limits = ScanLimits(
        n_beams=n_beams,
        max_angle=largest_opening(max_angle_deg, rotor_radius, distances),
        arcs=free_arcs(blocked_deg),
        min_elevation=None
        if min_elevation_deg is None
        else float(np.deg2rad(check_finite(min_elevation_deg, what="min_elevation_deg", unit="degrees"))),
        min_spread=float(np.deg2rad(check_non_negative(min_spread_deg, what="min_spread_deg", unit="degrees"))),
        upward=axis == "up",
        tilt=float(np.deg2rad(check_finite(tilt_deg, what="tilt_deg", unit="degrees"))),
    )
    if limits.min_spread > 2.0 * limits.max_angle or (limits.min_spread > 0.0 and n_beams == 1):
        raise InputError(
            f"Invalid min_spread_deg {min_spread_deg!r}: {n_beams} beams that are no more than "
            f"{np.rad2deg(limits.max_angle):.4g} degrees off the axis cannot be so far apart; give a smaller one."
        )
    shapes = _shapes(limits, cones, centre, criterion)
    if dwell is not None:
        visits = n_beams * (len(distances) if planes == "sequential" else 1)
        scan_duration = visits * check_positive(dwell, what="dwell", unit="s")
    frame = _frame(n_beams, distances, scan_duration, planes, limits, probe)
    search = ScanSearch(scale, frame, len(distances))
    per_shape = [n_starts // len(shapes) + (index < n_starts % len(shapes)) for index in range(len(shapes))]
    jobs = [
        (shape, variables, cone)
        for shape, count in zip(shapes, per_shape, strict=True)
        for variables, cone in search.starts(shape, rng, count)
    ]
    silent = None if show_progress is None else not show_progress
    ends = [search.descend(*job) for job in progress(jobs, len(jobs), "searching", disable=silent)]
    ends.sort(key=lambda end: end.value)
    if not np.isfinite(ends[0].value):
        raise InputError(
            f"No scan of {n_beams} beams within the limits sees all six stresses, so the criterion 'trace' has no "
            "value: allow more beams, more cones or a beam along the axis, or use another criterion."
        )
    if criterion == "trace":
        best, polished = ends[0], [ends[0]]
    else:
        chosen = different_ends(ends)[:_POLISHED]
        polished = [search.polish(end) for end in progress(chosen, len(chosen), "polishing", disable=silent)]
        best = min(polished, key=lambda end: end.value)
    direction = best.direction
    scan = replace(
        search.scan(direction),
        title=f"{n_beams} beams chosen for the criterion {criterion!r}",
        source=f"bayes_rs.optimize_scan, value {best.value:.6g}; {scale.in_words()}",
    )
    by_state = scale.exact(scan)
    references, outside = _references(search, limits)
    widths = {}
    if isinstance(scale, PosteriorCriterion):
        relative = scale.widths(scan) / np.array([flow.stresses()[:1] for flow in scale.turbulence])
        widths = dict(zip(STRESSES, np.max(relative, axis=0).tolist(), strict=True))
    return ScanOptimum(
        scan=scan,
        criterion=criterion,
        meaning=scale.in_words(),
        value=float(np.max(by_state)),
        by_state=dict(zip(scale.states, by_state.tolist(), strict=True)),
        starts=np.array([end.value for end in ends]),
        polished=np.array([end.value for end in polished]),
        references=references,
        outside=outside,
        n_evaluations=search.n_fast,
        n_exact=search.n_exact,
        seconds=time.perf_counter() - began,
        widths=widths,
        details={
            "n_beams": n_beams,
            "focus_distance": distances.tolist(),
            "max_angle_deg": float(np.rad2deg(limits.max_angle)),
            "rotor_radius": rotor_radius,
            "cones": cones,
            "centre": centre,
            "blocked_deg": [[float(edge) for edge in edges] for edges in blocked_deg],
            "min_elevation_deg": min_elevation_deg,
            "min_spread_deg": min_spread_deg,
            "axis": axis,
            "tilt_deg": tilt_deg,
            "probe": frame.probe.parameters(),
            "planes": planes,
            "scan_duration": scan_duration,
            "dwell": dwell,
            "n_starts": n_starts,
            "seed": None if isinstance(seed, np.random.Generator) else int(seed),
            **_scene_details(scale),
        },
    )


def _best_number(numbers: Sequence[int], options: dict[str, Any]) -> ScanOptimum:
    """Return the best scan over several numbers of beams; each is searched from the same seed."""
    tried = sorted({int(check_count(number, what="n_beams")) for number in numbers})
    if not tried:
        raise InputError("Invalid n_beams []: give at least one number of beams.")
    if isinstance(options["seed"], np.random.Generator):
        options["seed"] = int(options["seed"].integers(0, 2**63))
    found = {number: optimize_scan(n_beams=number, **options) for number in tried}
    best = min(found.values(), key=lambda one: one.value)
    return replace(
        best,
        by_number={number: one.value for number, one in found.items()},
        seconds=sum(one.seconds for one in found.values()),
    )


def scan_criterion(
    scan: Scan,
    criterion: str = "width",
    *,
    turbulence: str | MannTurbulence | Sequence[str | MannTurbulence] | None = None,
    wind_speed: float = 10.0,
    duration: float = 600.0,
    prior: str | Prior = "weak",
    stresses: Sequence[str] | None = None,
    weights: Sequence[float] | None = None,
    yaw_deg: float | Sequence[float] | None = None,
) -> float:
    """Return the criterion of a scan, exactly as `optimize_scan` would report it.

    Parameters
    ----------
    scan : Scan
        Any scan.
    criterion, turbulence, wind_speed, duration, prior, stresses, weights
        As for `optimize_scan`.
    yaw_deg : float or sequence of float, optional
        Wind directions relative to the lidar axis, degrees; the scan's own yaw if not given.

    Returns
    -------
    value : float
        The criterion; the largest over the states of turbulence. Smaller is better.

    Raises
    ------
    InputError
        If an argument is not valid.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> round(scan_criterion(load_scan("6-beam", opening_angle_deg=45.0), "trace"), 6)
    12.6
    """
    scale = make_criterion(
        criterion,
        turbulence=turbulence,
        wind_speed=wind_speed,
        duration=duration,
        prior=prior,
        stresses=stresses,
        weights=weights,
        yaw_deg=yaw_deg,
    )
    return float(np.max(scale.exact(scan)))


def _shapes(limits: ScanLimits, cones: int | None, centre: bool | None, criterion: str) -> list[ScanLimits]:
    """Return the kinds of scans to search: with and without a beam along the axis where both are to be tried."""
    if cones is not None:
        check_count(cones, what="cones")
        if cones > limits.n_beams:
            raise InputError(f"Invalid cones {cones}: there are {limits.n_beams} beams; give at most as many cones.")
    with_centre = [bool(centre)] if centre is not None else [False] if cones is None else [True, False]
    shapes = [
        replace(limits, cones=cones, centre=held)
        for held in with_centre
        if limits.n_beams - held >= (1 if cones is None else cones)
    ]
    if not shapes:
        raise InputError(
            f"Invalid cones {cones}: with a beam along the axis, {limits.n_beams - 1} beams are left; give fewer cones."
        )
    if criterion == "trace":
        if limits.n_beams < len(STRESSES):
            raise InputError(
                f"Invalid n_beams {limits.n_beams}: the criterion 'trace' needs at least {len(STRESSES)} beams to see "
                "all six stresses; use 'width' or 'variance', in which the prior helps."
            )
        shapes = [shape for shape in shapes if shape.centre or shape.cones != 1]
        if not shapes:
            raise InputError(
                "A single cone without a beam along its axis never sees all six stresses, so the criterion 'trace' has "
                "no value: allow a beam along the axis or more cones, or use 'width' or 'variance'."
            )
    return shapes


def _frame(
    n_beams: int,
    distances: FloatArray,
    scan_duration: float,
    planes: str,
    limits: ScanLimits,
    probe: Probe | None,
) -> Scan:
    """Return a scan with the right distances, times and mounting, all beams along the axis."""
    total = check_positive(scan_duration, what="scan_duration", unit="s")
    n_plane = len(distances)
    if planes == "sequential":
        times = total * np.arange(n_beams * n_plane) / (n_beams * n_plane)
    else:
        times = np.tile(total * np.arange(n_beams) / n_beams, n_plane)
    return Scan(
        name=f"optimized-{n_beams}-beam",
        beam_direction=np.tile([[0.0, 0.0, 1.0] if limits.upward else [-1.0, 0.0, 0.0]], (n_beams * n_plane, 1)),
        focus_distance=np.repeat(distances, n_beams),
        beam_time=times,
        scan_duration=total,
        tilt=limits.tilt,
        probe=PointProbe() if probe is None else probe,
    )


def _references(search: ScanSearch, limits: ScanLimits) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the criterion of well-known scans of as many beams, and which of them break a limit."""
    n, widest = limits.n_beams, limits.max_angle
    degrees = f"{np.rad2deg(widest):.4g}"
    kinds: dict[str, tuple[FloatArray, FloatArray]] = {}
    phases = 0.5 * np.pi + 2.0 * np.pi * np.arange(n) / n
    if n > 1:
        around = 0.5 * np.pi + 2.0 * np.pi * np.arange(n - 1) / (n - 1)
        kinds[f"{n - 1} around one at {degrees}°"] = (
            np.append(np.full(n - 1, widest), 0.0),
            np.append(around, 0.0),
        )
    kinds[f"one cone at {degrees}°"] = (np.full(n, widest), phases)
    if n > 3:
        half = np.where(np.arange(n) % 2 == 0, widest, 0.5 * widest)
        kinds[f"two cones at {degrees}° and half of it"] = (half, phases)
    if not limits.upward:
        for name in preset_names("scans"):
            preset = load_scan(name)
            if preset.n_beam == n and not name.endswith("-planes"):
                angles = np.deg2rad(beam_angles_deg(preset, n, "upwind"))
                kinds[f"{name} as shipped"] = (angles[:, 0], angles[:, 1])
    values: dict[str, float] = {}
    outside = []
    free, own = replace(limits, cones=None, centre=False), np.arange(n)
    for name, (opening, phase) in kinds.items():
        variables = np.concatenate([opening, phase])
        direction = free.directions(variables, own)
        height = float(np.max(search.exact(direction[np.newaxis])))
        values[name] = value_at(height)
        if not free.feasible(direction, variables, own):
            outside.append(name)
    return values, tuple(outside)


def _scene_details(scale: ScanCriterion) -> dict[str, Any]:
    if isinstance(scale, TraceCriterion) or not isinstance(scale, PosteriorCriterion):
        return {}
    return {
        "turbulence": [
            {"name": label, "dissipation": flow.dissipation, "length_scale": flow.length_scale, "gamma": flow.gamma}
            for label, flow in zip(scale.states, scale.turbulence, strict=True)
        ],
        "wind_speed": scale.wind_speed,
        "duration": scale.duration,
        "prior": scale.prior.in_words(),
        "weights": dict(zip(STRESSES, scale.weights.tolist(), strict=True)),
    }
