"""Choosing the beams of a scan: the directions within given limits that tell most about R."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray, as_generator, as_items, check_count
from bayes_rs.design.beam_space import BeamSpace
from bayes_rs.design.scan_criteria import CriterionOptions, ScanCriterion, WidthCriterion
from bayes_rs.design.scan_limits import ScanLimits
from bayes_rs.design.scan_optimum import ScanOptimum, beam_angles_deg
from bayes_rs.design.scan_search import ScanSearch, SearchEnd, value_at
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan, load_scan
from bayes_rs.geometry.scan_words import looks_up
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.models import preset_names
from bayes_rs.options import from_plain, nearest, options_of, to_plain
from bayes_rs.progress import progress as shown
from bayes_rs.sizes import check_size, check_work

_STEPS = 30.0  # of a local search, each with differences for the slope
_BYTES_A_SLOPE, _BYTES_A_DRAW, _SECONDS_A_CUBE = 64.0, 400.0, 2e-9

__all__ = ["ScanOptimum", "optimize_scan", "scan_criterion"]


def optimize_scan(
    n_beams: int | Sequence[int],
    *,
    n_starts: int = 24,
    seed: int | np.random.Generator = 1,
    progress: bool | None = None,
    **options: Any,
) -> ScanOptimum:
    """Choose the directions of a scan's beams so that it tells most about R.

    Parameters
    ----------
    n_beams : int or sequence of int
        Number of beams; of several, the best is kept, and `by_number` has the others.
    n_starts : int
        Number of local searches, each from the best of 16 random scans.
    seed : int or Generator
        Same seed, same scan.
    progress : bool, optional
        Progress bar on stderr; by default only on a terminal.
    **options
        Fields of `ScanLimits`, of which ``max_angle_deg`` or ``rotor_radius`` must be given, and of `CriterionOptions`.

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
    differences for its slope; for the worst case of several states s it minimizes t subject to ln f_s ≤ t. Local
    searches from many places are no proof of a global optimum: `starts` shows how many have found it.

    "width" linearizes the posterior about the turbulence's own R, for a record with exactly the expected variances: see
    `bayes_rs.design.scan_criteria.WidthCriterion`.

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
    >>> best = optimize_scan(6, max_angle_deg=45.0, criterion="trace", n_starts=4)
    >>> round(best.value, 6)
    12.6
    """
    limits, judged = _options(options)
    scale = judged.make()
    numbers = as_items(n_beams, what="n_beams")
    tried = sorted({int(check_count(number, what="n_beams")) for number in numbers})
    if not tried:
        raise InputError("Invalid n_beams []: give at least one number of beams.")
    check_count(n_starts, what="n_starts")
    for number in tried:
        _check_search(number, limits, judged, n_starts)
    rng = as_generator(seed)
    start = int(rng.integers(0, 2**63)) if isinstance(seed, np.random.Generator) else int(seed)
    silent = None if progress is None else not progress
    found = {number: _best_scan(number, limits, scale, n_starts, start, silent) for number in tried}
    best = min(found.values(), key=lambda one: one.value)
    return replace(
        best,
        by_number={number: one.value for number, one in found.items()} if len(found) > 1 else {},
        seconds=sum(one.seconds for one in found.values()),
        details={
            **best.details,
            **_plain_details(limits, judged),
            "n_starts": n_starts,
            "seed": None if isinstance(seed, np.random.Generator) else start,
        },
    )


def _check_search(n_beams: int, limits: ScanLimits, judged: CriterionOptions, n_starts: int) -> None:
    """Refuse a search that no memory holds or no one waits for."""
    frame = limits.frame(n_beams)
    judged.check_size(frame)
    what = f"The search for {n_beams} beams from {n_starts} starts"
    advice = "choose fewer beams, fewer starts, a shorter duration or the criterion 'trace'."
    n_variable, n_pool = 2.0 * n_beams, 16.0 * n_starts
    check_size(what, _BYTES_A_SLOPE * n_variable**2 + _BYTES_A_DRAW * n_pool * frame.n_beam, advice)
    evaluations = n_starts * (16.0 + _STEPS * (1.0 + n_variable))
    check_work(what, evaluations * judged.seconds(frame) + _SECONDS_A_CUBE * _STEPS * n_starts * n_variable**3, advice)


def _best_scan(
    n_beams: int, limits: ScanLimits, scale: ScanCriterion, n_starts: int, seed: int, silent: bool | None
) -> ScanOptimum:
    """Return the best scan of so many beams."""
    began = time.perf_counter()
    search = ScanSearch(scale, limits.frame(n_beams), len(limits.distances))
    ends = _ends(search, scale.possible(limits.spaces(n_beams)), n_starts, np.random.default_rng(seed), silent)
    best = ends[0]
    if not np.isfinite(best.value):
        raise InputError(
            f"No scan of {n_beams} beams within the limits sees all six stresses, so the criterion 'trace' has no "
            "value: allow more beams, more cones or a beam along the axis, or use another criterion."
        )
    scan = replace(
        search.scan(best.direction),
        title=f"{n_beams} beams chosen for the criterion {scale.name!r}",
        source=f"bayes_rs.optimize_scan, value {best.value:.6g}; {scale.in_words()}",
    )
    by_state = scale.of(scan)
    references, outside = _references(search, best.space)
    return ScanOptimum(
        scan=scan,
        criterion=scale.name,
        meaning=scale.in_words(),
        value=float(np.max(by_state)),
        by_state=dict(zip(scale.states, by_state.tolist(), strict=True)),
        starts=np.array([end.value for end in ends]),
        references=references,
        outside=outside,
        n_evaluations=search.n_evaluation,
        seconds=time.perf_counter() - began,
        widths=_relative_widths(scale, scan),
        details={
            "n_beams": n_beams,
            "largest_angle_deg": float(np.rad2deg(limits.max_angle)),
            "seconds_a_scan": scan.scan_duration,
        },
    )


def _ends(
    search: ScanSearch, spaces: list[BeamSpace], n_starts: int, rng: np.random.Generator, silent: bool | None
) -> list[SearchEnd]:
    """Return where the searches have ended, the best first; the starts are shared among the kinds of scans."""
    counts = [n_starts // len(spaces) + (index < n_starts % len(spaces)) for index in range(len(spaces))]
    jobs = [
        (space, variables, cone)
        for space, count in zip(spaces, counts, strict=True)
        for variables, cone in search.starts(space, rng, count)
    ]
    ends = [search.descend(*job) for job in shown(jobs, len(jobs), "searching", disable=silent)]
    return sorted(ends, key=lambda end: end.value)


def _options(options: dict[str, Any]) -> tuple[ScanLimits, CriterionOptions]:
    """Sort keywords to the class that they belong to."""
    where = "the call of optimize_scan"
    known = {entry.name: cls for cls in (ScanLimits, CriterionOptions) for entry in options_of(cls)}
    for name in options:
        if name not in known:
            raise InputError(f"Unknown option {name!r} in {where}: {nearest(name, known)}")
    limits, judged = (
        {name: value for name, value in options.items() if known[name] is cls} for cls in (ScanLimits, CriterionOptions)
    )
    return from_plain(ScanLimits, limits, where=where), from_plain(CriterionOptions, judged, where=where)


def scan_criterion(scan: Scan | str | Path, criterion: str = "width", **options: Any) -> float:
    """Return the criterion of a scan, exactly as `optimize_scan` would report it.

    Parameters
    ----------
    scan : Scan, str or Path
        Any scan, or its name or file.
    criterion : str
        Name of the criterion.
    **options
        The other fields of `CriterionOptions`.

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
    >>> round(scan_criterion("6-beam@opening_angle_deg=45", "trace"), 6)
    12.6
    """
    judged = from_plain(CriterionOptions, {"criterion": criterion, **options}, where="the call of scan_criterion")
    return float(np.max(judged.make().of(as_scan(scan))))


def _references(search: ScanSearch, space: BeamSpace) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the criterion of well-known scans of as many beams, and which of them break a limit."""
    n = space.n_beams
    values: dict[str, float] = {}
    outside = []
    free, own = replace(space, cones=None, centre=False), np.arange(n)
    for name, (opening, phase) in _well_known(n, space.max_angle, upward=space.upward).items():
        variables = np.concatenate([opening, phase])
        direction = free.directions(variables, own)
        values[name] = value_at(float(np.max(search.values(direction[np.newaxis]))))
        if not free.feasible(direction, variables, own):
            outside.append(name)
    return values, tuple(outside)


def _well_known(n: int, widest: float, *, upward: bool) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return opening angles and phases, rad, of well-known scans of n beams."""
    degrees = f"{np.rad2deg(widest):.4g}"
    kinds: dict[str, tuple[FloatArray, FloatArray]] = {}
    phases = 0.5 * np.pi + 2.0 * np.pi * np.arange(n) / n
    if n > 1:
        around = 0.5 * np.pi + 2.0 * np.pi * np.arange(n - 1) / (n - 1)
        kinds[f"{n - 1} around one at {degrees}°"] = np.append(np.full(n - 1, widest), 0.0), np.append(around, 0.0)
    kinds[f"one cone at {degrees}°"] = (np.full(n, widest), phases)
    if n > 3:
        half = np.where(np.arange(n) % 2 == 0, widest, 0.5 * widest)
        kinds[f"two cones at {degrees}° and half of it"] = (half, phases)
    for name in () if upward else preset_names("scans"):
        preset = load_scan(name)
        if preset.n_beam == n and not name.endswith("-planes") and not looks_up(preset):
            angles = np.deg2rad(beam_angles_deg(preset, n, "upwind"))
            kinds[f"{name} as shipped"] = (angles[:, 0], angles[:, 1])
    return kinds


def _relative_widths(scale: ScanCriterion, scan: Scan) -> dict[str, float]:
    """Return the widths of the stresses over uu, the largest over the states; none for a criterion without widths."""
    if not isinstance(scale, WidthCriterion):
        return {}
    relative = scale.widths(scan) / np.array([flow.stresses()[:1] for flow in scale.turbulence])
    return dict(zip(STRESSES, np.max(relative, axis=0).tolist(), strict=True))


def _plain_details(limits: ScanLimits, judged: CriterionOptions) -> dict[str, Any]:
    """Return the options as plain values; turbulences and priors by what they are."""
    named = replace(
        judged,
        turbulence=tuple(flow.name for flow in judged.flows()),
        prior=judged.prior if isinstance(judged.prior, str) else judged.prior.in_words(),
    )
    probe = limits.probe if isinstance(limits.probe, str) else str(limits.probe.parameters())
    return {**to_plain(replace(limits, probe=probe, blocked_deg=limits.blocked)), **to_plain(named)}
