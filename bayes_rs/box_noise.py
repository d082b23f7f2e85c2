"""The noise of a record by simulation: a virtual lidar in boxes of Mann turbulence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray, as_generator, check_count
from bayes_rs.boxes import BoxGrid, BoxMaker, generator_name
from bayes_rs.errors import InputError
from bayes_rs.forward import design_matrix
from bayes_rs.mann import MannTurbulence
from bayes_rs.noise import NoiseModel
from bayes_rs.progress import progress as progress_bar
from bayes_rs.stress import pack_stress
from bayes_rs.virtual import RecordState, beam_lines, box_seeds, grid_for, placements, sample_records


def noise_from_boxes(
    states: Sequence[RecordState],
    turbulence: MannTurbulence,
    n_boxes: int,
    seed: int | np.random.Generator,
    progress: bool | None = None,
    *,
    grid: BoxGrid | None = None,
) -> list[NoiseModel]:
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
    noise : list of NoiseModel
        One for each state, in their order.

    Raises
    ------
    InputError
        If a record does not fit into the boxes.
    """
    check_count(n_boxes, what="n_boxes", minimum=2)
    box_grid = grid_for(list(states), turbulence) if grid is None else grid
    for state in states:
        if np.any(state.scan.probe_length > 0.0):
            raise InputError(
                f"The beams of scan {state.scan.name!r} have a probe volume ({state.scan.probe.kind}), and beams in "
                'boxes are points: use method="theory", or load the scan with probe="point".'
            )
        if state.records_in(box_grid) < 1:
            raise InputError(
                f"A record of {state.duration:g} s at {state.wind_speed:g} m/s does not fit into a box of "
                f"{box_grid.size[0]:g} m: choose a longer grid."
            )
    maker = BoxMaker(turbulence, box_grid)
    shift = placements(box_grid, turbulence.length_scale)
    focus = np.concatenate([(state.focus + one) for one in shift for state in states])
    direction = np.concatenate([state.line_of_sight for _ in shift for state in states])
    unique, line = _unique_lines(focus, direction)
    ends = np.cumsum([state.scan.n_beam for _ in shift for state in states])
    parts = np.split(line, ends[:-1])  # one for each placement and state
    expected = [state.expected_variance(maker) for state in states]
    tallies = [_Tally() for _ in states]
    for box_seed in progress_bar(
        box_seeds(as_generator(seed), n_boxes), n_boxes, "boxes", disable=None if progress is None else not progress
    ):
        lines = beam_lines(maker.make(box_seed), focus[unique], direction[unique])
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
    return [_model(state, maker, expected[number], tallies[number], shared) for number, state in enumerate(states)]


def box_ingredients(
    states: Sequence[RecordState], turbulence: MannTurbulence, n_boxes: int, seed: int
) -> dict[str, Any]:
    """Return what box noise depends on beside the states and the turbulence, as plain JSON values."""
    grid = grid_for(list(states), turbulence)
    return {
        "generator": generator_name(),
        "grid_shape": list(grid.shape),
        "grid_spacing": list(grid.spacing),
        "n_boxes": int(n_boxes),
        "seed": int(seed),
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


def _model(
    state: RecordState, maker: BoxMaker, expected: FloatArray, tally: _Tally, shared: Mapping[str, Any]
) -> NoiseModel:
    root = np.sqrt(len(tally.second))
    covariance = np.mean(tally.second, axis=0)
    error = np.std(tally.second, axis=0, ddof=1) / root
    mean_error = np.std(tally.first, axis=0, ddof=1) / root
    variance = np.diag(covariance)
    spread = np.mean(tally.fourth, axis=0) - variance**2
    independent = np.median(spread / np.diag(error) ** 2)
    direction = state.line_of_sight
    details = {
        **shared,
        "records_per_box": state.records_in(maker.grid),
        "n_samples": state.n_sample,
        "n_records": tally.per_box * len(tally.second),
        "mean_deviation_sigmas": round(float(np.max(np.abs(np.mean(tally.first, axis=0)) / mean_error)), 3),
    }
    return NoiseModel(
        bias=expected / np.einsum("bi,ij,bj->b", direction, maker.tensor, direction) - 1.0,
        gain=design_matrix(direction),
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


def _unique_lines(focus: FloatArray, direction: FloatArray) -> tuple[Any, Any]:
    """Find the beams that see the same line along x in the same direction: each line is interpolated once."""
    _, unique, line = np.unique(
        np.round(np.column_stack([focus[:, 1:], direction]), 9), axis=0, return_index=True, return_inverse=True
    )
    return unique, line.ravel()
