"""Nets of states, by theory, that are just fine enough for the noise between them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bayes_rs._validation import FloatArray, check_array, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.at_states import noise_key
from bayes_rs.noise.flow_theory import FlowTheory
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.store import cache_folder, from_cache, renamed, to_cache, with_details
from bayes_rs.noise.turned import Turn, find_turn
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.theory.kept_lines import many_speeds
from bayes_rs.turbulence.interpolation import find_net, interpolate_covariance
from bayes_rs.turbulence.mann import MannTurbulence

BANK_VERSION = 4
"""Counts the changes of this module that change its numbers."""

TOLERANCE = 0.01
"""Largest relative error of K between states, where no other is asked for."""

_MOST_STATES = 1000
"""A net is not refined beyond this many states; then its error may be above the tolerance, and its details say so."""
_NO_EXTENT = 1e-9  # of ln U, degrees, ln L and Γ


class _Axis(NamedTuple):
    """One axis of the nets: its nodes are anchor + step · (whole number) / 2^halvings."""

    anchor: float
    step: float


_AXES = (  # ln U, yaw in degrees, ln L, Γ
    _Axis(float(np.log(10.0)), float(np.log(2.0))),
    _Axis(0.0, 20.0),
    _Axis(float(np.log(10.0)), float(np.log(2.0))),
    _Axis(0.0, 1.5),
)


def refined_noise(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: Sequence[float],
    yaw_deg: Sequence[float] | None = None,
    length_scale: Sequence[float] | None = None,
    gamma: Sequence[float] | None = None,
    duration: float = 600.0,
    tolerance: float = TOLERANCE,
    error_beams: int = 16,
    cache: bool | str | Path = True,
    sonic: bool = False,
    progress: bool | None = None,
) -> Noise:
    """Return the noise of a scan by theory over a range of wind speeds and directions, in a net that is interpolated.

    Parameters
    ----------
    scan : Scan
        The scan.
    turbulence : MannTurbulence
        The turbulence.
    wind_speed : sequence of float
        Mean wind speeds of the records, m/s: the net reaches from the lowest to the highest.
    yaw_deg : sequence of float, optional
        Wind directions of the records relative to the lidar axis, degrees; by default the scan's own yaw.
    length_scale, gamma : sequence of float, optional
        Length scales L, m, and anisotropies Γ that the net reaches over, too; by default only those of `turbulence`.
    duration : float
        Length of a record, s.
    tolerance : float
        Largest relative error of K between the states that is asked for.
    error_beams : int
        The error is measured with so many of the beams, evenly chosen: their covariances are a part of K.
    cache : bool, str or Path
        True to use the user's cache folder, False for none, or another folder.
    sonic : bool
        Add the joint moments with the stresses of a sonic at the rotor's centre, which the target ``"sonic"`` of `fit`
        needs. The error is then that of the joint covariance of the beams and the sonic.
    progress : bool, optional
        Show progress bars; by default if stderr is a terminal.

    Returns
    -------
    noise : Noise
        Its details hold ``interpolation_errors``, ‖δK‖/‖K‖ (Frobenius) against theory in the middle of every cell of
        the net, the last axis fastest; ``interpolation_error``, the largest of them; ``interpolation_error_beams`` and
        ``interpolation_tolerance``.

    Raises
    ------
    InputError
        If an argument is not valid.

    Notes
    -----
    The nodes are 10 · 2ⁱ m/s, multiples of 20°, 10 · 2ⁱ m and multiples of 1.5 in Γ. They do not move with the records,
    so that the cache serves other days. While the error is above the tolerance, the axis with the largest error of its
    own at the worst cell, measured between its nodes on the edges of that cell, gets twice as many intervals. A range
    without extent is one node, where it is.

    Where a turn of the wind by one part of the circle only permutes the beams (the upward cone of a profiler), the
    directions' nodes are multiples or parts of that turn (21.6° for 50 beams), and states that differ by such turns
    are calculated once, and permuted. The error is then measured with all beams.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> noise = refined_noise(load_scan("staring"), load_turbulence("fu-2022"), wind_speed=[6.0, 12.0], cache=False)
    >>> len(noise), noise.interpolation_error < 0.01
    (3, True)
    """
    check_positive(tolerance, what="tolerance", unit="")
    ranges = [
        np.log(_range(wind_speed, "wind_speed", above=0.0)),
        _range([np.rad2deg(scan.yaw)] if yaw_deg is None else yaw_deg, "yaw_deg"),
        np.log(_range([turbulence.length_scale] if length_scale is None else length_scale, "length_scale", above=0.0)),
        _range([turbulence.gamma] if gamma is None else gamma, "gamma"),
    ]
    if all(span[1] - span[0] <= _NO_EXTENT for span in ranges[2:]):  # it is this flow's net, whatever was given
        scale = turbulence.length_scale if length_scale is None else float(np.min(length_scale))
        turbulence = replace(turbulence, length_scale=scale, gamma=float(ranges[3][0]))
    count = max(min(int(error_beams), scan.n_beam), 1)
    some = scan.select(scan.beam[np.unique(np.linspace(0, scan.n_beam - 1, count).round().astype(int))])
    turn = find_turn(scan)
    some, count = (some, count) if turn is None else (scan, scan.n_beam)
    axis_kinds = _axis_kinds(turn)
    key = _key(scan, turbulence, ranges, axis_kinds, duration, tolerance, count, sonic)
    file = cache_folder(cache) / f"{key}.nc" if cache is not False else None
    if file is not None:
        found, _ = from_cache(file, key)
        if found is not None:
            return renamed(found, scan, turbulence)
    with many_speeds():
        theory = FlowTheory(some, turbulence, duration, progress, sonic=sonic, turn=turn)
        axes, errors = _refined(theory, axis_kinds, ranges, tolerance)
        if count < scan.n_beam:
            theory = FlowTheory(scan, turbulence, duration, progress, sonic=sonic)
        states = theory.states(_points(axes))
    noise = with_details(
        Noise.join(states),
        interpolation_error=float(np.max(errors)),
        interpolation_errors=[float(f"{error:.3g}") for error in errors],
        interpolation_error_beams=count,
        interpolation_tolerance=tolerance,
        key=key,
        origin="calculated",
    )
    if file is not None:
        to_cache(noise, file)
    return noise


def measure_interpolation(noise: Noise, scan: Scan, *, progress: bool | None = None) -> float:
    """Return the largest relative error of K between the states of a net by theory, measured with all its beams.

    Parameters
    ----------
    noise : Noise
        Noise by theory whose states form a net.
    scan : Scan
        Its scan.
    progress : bool, optional
        Show a progress bar; by default if stderr is a terminal.

    Returns
    -------
    error : float
        max ‖K_interpolated − K_theory‖ / ‖K_theory‖ (Frobenius) in the middle of every cell; 0 if there is no cell.

    Raises
    ------
    InputError
        If the states form no net, or the scan is another.
    """
    noise.check_scan(scan)
    if noise.net is None:
        raise InputError("The states of this noise form no net, so nothing is interpolated between them.")
    axes = [noise.net.axes[0], np.rad2deg(noise.net.axes[1]), noise.net.axes[2], noise.net.axes[3]]
    middle = _points(_middles(axes))
    truth = FlowTheory(scan, noise.turbulence, noise.duration, progress).covariances(middle)
    between = noise.for_records(
        np.exp(middle[:, 0]), np.deg2rad(middle[:, 1]), length_scale=np.exp(middle[:, 2]), gamma=middle[:, 3]
    )
    return float(np.max(_distance(between.covariance, truth)))


def _refined(
    theory: FlowTheory, kinds: tuple[_Axis, ...], ranges: list[FloatArray], tolerance: float
) -> tuple[list[FloatArray], FloatArray]:
    """Return the axes of the coarsest net that keeps the tolerance, and its error in the middle of each cell."""
    halvings = [0] * len(kinds)
    while True:
        axes = [_nodes(axis, span, halved) for axis, span, halved in zip(kinds, ranges, halvings, strict=True)]
        middles = _middles(axes)
        errors = _errors(theory, axes, _points(middles))
        count = [len(axis) for axis in axes]
        sizes = [np.prod([2 * n - 1 if i == index else n for i, n in enumerate(count)]) for index in range(len(count))]
        if (
            np.max(errors) <= tolerance
            or min(size for size, n in zip(sizes, count, strict=True) if n > 1) > _MOST_STATES
        ):
            return axes, errors
        cell = np.unravel_index(int(np.argmax(errors)), [len(middle) for middle in middles])
        edges = [axis[at : at + 2] for axis, at in zip(axes, cell, strict=True)]
        trials = []
        for index, axis in enumerate(axes):
            between = [*edges[:index], middles[index][cell[index]][np.newaxis], *edges[index + 1 :]]
            trials.append(float(np.max(_errors(theory, axes, _points(between)))) if len(axis) > 1 else -1.0)
        worst = int(np.argmax(trials))
        if sizes[worst] > _MOST_STATES:
            return axes, errors
        halvings[worst] += 1


def _errors(theory: FlowTheory, axes: list[FloatArray], points: FloatArray) -> FloatArray:
    """Return the relative error of K that a net has at points."""
    nodes = _points(axes)
    net = find_net(nodes)
    if net is None:  # one state
        return np.zeros(len(points))
    between, _ = interpolate_covariance(theory.covariances(nodes), net.weights(points)[0])
    return _distance(between, theory.covariances(points))


def _distance(have: FloatArray, want: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(have - want, axis=(-2, -1)) / np.linalg.norm(want, axis=(-2, -1)))


def _axis_kinds(turn: Turn | None) -> tuple[_Axis, ...]:
    """Return the axes of the nets of a scan: where a turn permutes its beams, directions are parts of it."""
    if turn is None:
        return _AXES
    each = _AXES[1].step / turn.step_deg
    step = turn.step_deg * round(each) if each >= 1.0 else turn.step_deg / np.ceil(1.0 / each)
    return (_AXES[0], _Axis(0.0, float(step)), *_AXES[2:])


def _nodes(axis: _Axis, span: FloatArray, halvings: int) -> FloatArray:
    """Return the nodes of one axis that hold a range."""
    if span[1] - span[0] <= _NO_EXTENT:
        return span[:1]
    first, last = _ends(axis, span)
    return np.asarray(axis.anchor + axis.step * np.linspace(first, last, (last - first) * 2**halvings + 1))


def _ends(axis: _Axis, span: FloatArray) -> tuple[int, int]:
    """Return the first and the last node of the coarsest net."""
    steps = (span - axis.anchor) / axis.step
    return int(np.floor(steps[0] + 1e-9)), int(np.ceil(steps[1] - 1e-9))


def _middles(axes: list[FloatArray]) -> list[FloatArray]:
    return [0.5 * (axis[1:] + axis[:-1]) if len(axis) > 1 else axis for axis in axes]


def _points(axes: list[FloatArray]) -> FloatArray:
    return np.array(list(product(*axes)), dtype=np.float64)


def _range(values: Sequence[float], name: str, above: float | None = None) -> FloatArray:
    numbers = check_array(np.atleast_1d(values), (None,), what=name)
    if len(numbers) == 0 or (above is not None and np.min(numbers) <= above):
        raise InputError(f"Invalid {name} {values!r}: give numbers above zero, of which the net takes the range.")
    return np.array([np.min(numbers), np.max(numbers)])


def _key(
    scan: Scan,
    turbulence: MannTurbulence,
    ranges: list[FloatArray],
    kinds: tuple[_Axis, ...],
    duration: float,
    tolerance: float,
    error_beams: int,
    sonic: bool,
) -> str:
    """Return the key of a net: that of theory at one state, and everything that fixes the net."""
    state = RecordState(scan, 10.0, 0.0, duration)
    spans = [
        [float(round(span[0], 9))] if span[1] - span[0] <= _NO_EXTENT else list(_ends(axis, span))
        for axis, span in zip(kinds, ranges, strict=True)
    ]
    everything = {
        "bank_version": BANK_VERSION,
        "theory": noise_key([state], turbulence, sonic=sonic),
        "axes": kinds,
        "spans": spans,
        "tolerance": tolerance,
        "error_beams": error_beams,
        "most_states": _MOST_STATES,
    }
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()[:40]
