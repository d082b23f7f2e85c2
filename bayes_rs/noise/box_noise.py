"""The noise of a record by simulation: a virtual lidar in boxes of Mann turbulence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray, as_generator, check_count
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import PointProbe
from bayes_rs.geometry.stress import pack_stress
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.options import described, option
from bayes_rs.progress import progress as progress_bar
from bayes_rs.simulation.boxes import BoxGrid, BoxMaker, generator_name
from bayes_rs.simulation.virtual import RecordState, beam_lines, box_seeds, grid_for, placements, sample_records
from bayes_rs.turbulence.mann import MannTurbulence

DEFAULT_SEED = 1
"""Seed of the shipped noise, and the default of `Boxes`."""


@described
@dataclass(frozen=True, kw_only=True)
class Boxes:
    """How noise is simulated in boxes of Mann turbulence: ``calibrate(..., method=Boxes(n_boxes=40))``."""

    n_boxes: int = option(100, "Number of turbulence boxes, at least 2.", flag="--boxes")
    seed: int | np.random.Generator = option(
        DEFAULT_SEED, "Same seed, same numbers. Nothing is cached with a Generator."
    )

    def __post_init__(self) -> None:
        """Check the number of boxes."""
        check_count(self.n_boxes, what="n_boxes", minimum=2)
        as_generator(self.seed)


def noise_from_boxes(
    states: Sequence[RecordState],
    turbulence: MannTurbulence,
    n_boxes: int,
    seed: int | np.random.Generator,
    progress: bool | None = None,
    *,
    grid: BoxGrid | None = None,
) -> list[Noise]:
    """Calibrate several states, also of several scans, in one pass through the same boxes.

    Parameters
    ----------
    states : sequence of RecordState
        Scans, mean winds and record lengths.
    turbulence : MannTurbulence
        The turbulence.
    n_boxes : int
        Number of boxes, at least 2.
    seed : int or numpy.random.Generator
        Same seed, same numbers.
    progress : bool, optional
        Show a progress bar; by default if stderr is a terminal.
    grid : BoxGrid, optional
        Grid of the boxes; by default the one that `choose_grid` finds for all states.

    Returns
    -------
    noise : list of Noise
        One for each state, in their order.

    Raises
    ------
    InputError
        If a record does not fit into the boxes.

    Notes
    -----
    Beams with a probe volume see it in the boxes as it is (`beam_lines`): K is that of the probed velocities, relative
    to their exact expectations in the boxes. Their gain is that of `theory_noise`, since a probe takes the small
    eddies, some of which a box does not have: what it takes from the variances of a box is less than what it takes from
    those of the air. ``probe_excess`` in the details is by how much the beams' expected variances in the boxes are
    above gain · stresses of a record in the boxes, at most. The bias is the part of the stresses, weighted by the gain,
    that the removal of a record's mean takes, in the boxes.
    """
    check_count(n_boxes, what="n_boxes", minimum=2)
    box_grid = grid_for(list(states), turbulence) if grid is None else grid
    for state in states:
        if state.records_in(box_grid) < 1:
            raise InputError(
                f"A record of {state.duration:g} s at {state.wind_speed:g} m/s does not fit into a box of "
                f"{box_grid.size[0]:g} m: choose a longer grid."
            )
    maker = BoxMaker(turbulence, box_grid)
    shift = placements(box_grid, turbulence.length_scale)
    placed = [(state, one) for one in shift for state in states]
    focus = np.concatenate([state.focus + one for state, one in placed])
    direction = np.concatenate([state.line_of_sight for state, _ in placed])
    distance = np.concatenate([state.scan.focus_distance for state, _ in placed])
    probes = list(dict.fromkeys(state.scan.probe for state in states))
    probe = np.concatenate([np.full(state.scan.n_beam, probes.index(state.scan.probe)) for state, _ in placed])
    lengths = np.concatenate([state.scan.probe_length for state, _ in placed])
    unique, line = _unique_lines(focus, np.column_stack([direction, probe, lengths]))
    of_probe = [np.flatnonzero(probe[unique] == number) for number in range(len(probes))]
    ends = np.cumsum([state.scan.n_beam for state, _ in placed])
    parts = np.split(line, ends[:-1])  # one for each placement and state
    expected = [state.expected_variance(maker) for state in states]
    tallies = [_Tally() for _ in states]
    for box_seed in progress_bar(
        box_seeds(as_generator(seed), n_boxes), n_boxes, "boxes", disable=None if progress is None else not progress
    ):
        box, lines = maker.make(box_seed), np.empty((len(unique), box_grid.shape[0]))
        for kind, rows in zip(probes, of_probe, strict=True):
            beams = unique[rows]
            lines[rows] = beam_lines(box, focus[beams], direction[beams], probe=kind, focus_distance=distance[beams])
        for number, state in enumerate(states):
            velocity = [sample_records(lines[part], state, box_grid) for part in parts[number :: len(states)]]
            tallies[number].add(np.concatenate(velocity).var(axis=-1) / expected[number] - 1.0)
    shared = {
        "generator": generator_name(),
        "grid_shape": list(box_grid.shape),
        "grid_spacing": list(box_grid.spacing),
        "n_boxes": n_boxes,
        "seed": seed if not isinstance(seed, np.random.Generator) else None,
        "n_placements": len(shift),
        **_truth(maker),
    }
    return [_noise(state, maker, expected[number], tallies[number], shared) for number, state in enumerate(states)]


def box_ingredients(states: Sequence[RecordState], turbulence: MannTurbulence, boxes: Boxes) -> dict[str, Any]:
    """Return what box noise depends on beside the states and the turbulence, as plain JSON values."""
    grid = grid_for(list(states), turbulence)
    return {
        "generator": generator_name(),
        "grid_shape": list(grid.shape),
        "grid_spacing": list(grid.spacing),
        "n_boxes": int(boxes.n_boxes),
        "seed": int(boxes.seed),  # type: ignore[arg-type] # a Generator has no key: nothing is cached with it
    }


class _Tally:
    """Gathers the relative deviations of one state's variances, box by box."""

    def __init__(self) -> None:
        self.second: list[FloatArray] = []  # per box: mean of the products of deviations, (n_beam, n_beam)
        self.first: list[FloatArray] = []  # per box: mean deviation, (n_beam,)
        self.fourth: list[FloatArray] = []  # per box: mean fourth power, (n_beam,)
        self.per_box = 0

    def add(self, deviation: FloatArray) -> None:
        self.per_box = len(deviation)
        self.first.append(deviation.mean(axis=0))
        self.second.append(deviation.T @ deviation / len(deviation))
        self.fourth.append(np.mean(deviation**4, axis=0))


def _noise(
    state: RecordState, maker: BoxMaker, expected: FloatArray, tally: _Tally, shared: Mapping[str, Any]
) -> Noise:
    root = np.sqrt(len(tally.second))
    covariance = np.mean(tally.second, axis=0)
    error = np.std(tally.second, axis=0, ddof=1) / root
    mean_error = np.std(tally.first, axis=0, ddof=1) / root
    variance = np.diag(covariance)
    spread = np.mean(tally.fourth, axis=0) - variance**2
    independent = np.median(spread / np.diag(error) ** 2)
    gain, about_probe = design_matrix(state.line_of_sight), {}
    record = pack_stress(state.record_tensor(maker))
    if not isinstance(state.scan.probe, PointProbe):
        gain = _probe_gain(state, maker.turbulence)
        about_probe = {"probe_excess": float(np.max(expected / (gain @ record) - 1.0))}
    details = {
        **shared,
        "records_per_box": state.records_in(maker.grid),
        "n_samples": state.n_sample,
        "n_records": tally.per_box * len(tally.second),
        "mean_deviation_sigmas": round(float(np.max(np.abs(np.mean(tally.first, axis=0)) / mean_error)), 3),
        **about_probe,
    }
    return Noise(
        bias=(gain @ record) / (gain @ pack_stress(maker.tensor)) - 1.0,
        gain=gain,
        covariance=0.5 * (covariance + covariance.T),
        beam=state.scan.beam,
        scan_name=state.scan.name,
        scan_geometry=state.scan.geometry(),
        wind_speed=float(state.wind_speed),
        yaw=float(state.yaw),
        duration=float(state.duration),
        turbulence=maker.turbulence,
        method="boxes",
        n_realizations=float(min(independent, tally.per_box * len(tally.second))),
        standard_error=_round_to_10_bits(0.5 * (error + error.T)),
        details=details,
    )


def _round_to_10_bits(values: FloatArray) -> FloatArray:
    """Keep three digits: a standard error deserves no more, and zeros need no room in a file."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 1024.0) / 1024.0, exponent)


def _truth(maker: BoxMaker) -> dict[str, Any]:
    """Say what the boxes hold, and what of the turbulence they lack."""
    held = pack_stress(maker.tensor)
    truth: dict[str, Any] = {"stresses_box": held.tolist()}
    stresses = getattr(maker.turbulence, "stresses", None)
    if stresses is not None:
        infinite = np.asarray(stresses(), dtype=np.float64)
        lost = 1.0 - held[:3] / infinite[:3]
        truth.update(stresses_infinite=infinite.tolist(), variance_lost=lost.tolist())
    return truth


def _probe_gain(state: RecordState, turbulence: MannTurbulence) -> FloatArray:
    """Return the gain of `theory_noise`: that of all eddies, also of those too small for a box."""
    duration = state.n_sample * state.scan.scan_duration
    alone = [
        theory_noise(
            state.scan.select([beam]),
            turbulence,
            wind_speed=state.wind_speed,
            duration=duration,
            yaw=state.yaw,
            probe_tolerance=0.0,
        )
        for beam in state.scan.beam
    ]
    return np.concatenate([one.gain[0] for one in alone])


def _unique_lines(focus: FloatArray, seen: FloatArray) -> tuple[Any, Any]:
    """Find the beams that see the same of the same line along x: each line is calculated once."""
    _, unique, line = np.unique(
        np.round(np.column_stack([focus[:, 1:], seen]), 9), axis=0, return_index=True, return_inverse=True
    )
    return unique, line.ravel()
