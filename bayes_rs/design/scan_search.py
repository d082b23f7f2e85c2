"""Local searches for the directions of a scan's beams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.design.beam_space import BeamSpace, largest_angle
from bayes_rs.design.scan_criteria import ScanCriterion
from bayes_rs.geometry.scan import Scan

_POOL = 16  # random scans that compete for each start
_MOST_STEPS = 300
_HIGHEST = 60.0  # stands for the logarithm of an infinite criterion


@dataclass(frozen=True)
class SearchEnd:
    """Where a search has ended."""

    value: float
    space: BeamSpace
    variables: FloatArray
    cone: NDArray[np.int64]

    @property
    def direction(self) -> FloatArray:
        """Unit vectors of the beams, shape (n_beams, 3)."""
        return self.space.directions(self.variables, self.cone)


class ScanSearch:
    """Local searches for one criterion; counts its evaluations."""

    def __init__(self, scale: ScanCriterion, frame: Scan, n_plane: int) -> None:
        self.scale, self.frame, self.n_plane = scale, frame, n_plane
        self.n_evaluation = 0

    def scan(self, direction: FloatArray) -> Scan:
        """Return the scan with these beams (n_beams, 3)."""
        return replace(self.frame, beam_direction=_unit(np.tile(direction, (self.n_plane, 1))))

    def values(self, direction: FloatArray) -> FloatArray:
        """Return ln f of many scans, shape (n, n_state); directions (n, n_beams, 3)."""
        self.n_evaluation += len(direction)
        return _logarithm(self.scale.of_many(_unit(np.tile(direction, (1, self.n_plane, 1))), self.frame))

    def starts(
        self, space: BeamSpace, rng: np.random.Generator, count: int
    ) -> list[tuple[FloatArray, NDArray[np.int64]]]:
        """Return the best of each few random scans."""
        if count == 0:
            return []
        variables, cone = space.draw(rng, _POOL * count)
        worst = self.values(
            np.array([space.directions(row, own) for row, own in zip(variables, cone, strict=True)])
        ).max(axis=1)
        best = np.argmin(worst.reshape(count, _POOL), axis=1) + _POOL * np.arange(count)
        return [(variables[index], cone[index]) for index in best.tolist()]

    def descend(self, space: BeamSpace, start: FloatArray, cone: NDArray[np.int64]) -> SearchEnd:
        """Minimize t subject to ln f_s(variables) ≤ t (or ln f alone for one state) by SLSQP."""
        bounds = space.bounds(start)
        lower, upper = np.array(bounds).T
        inside = np.clip(start, lower, upper)
        solve = self._solve_one if len(self.scale.states) == 1 else self._solve_worst
        found = np.clip(solve(space, inside, cone, bounds)[: len(start)], lower, upper)
        ends = [
            (float(np.max(self.values(space.directions(one, cone)[np.newaxis])[0])), one)
            for one in (found, inside)
            if np.all(np.isfinite(one)) and space.feasible(space.directions(one, cone), one, cone)
        ]
        height, best = min(ends, key=lambda pair: pair[0])
        return SearchEnd(value_at(height), space, best, cone)

    def _solve_one(
        self, space: BeamSpace, inside: FloatArray, cone: NDArray[np.int64], bounds: list[tuple[float, float]]
    ) -> FloatArray:
        slopes = _Slopes(self, space, cone)
        return self._slsqp(
            lambda z: (float(slopes.at(z)[0][0]), slopes.at(z)[1][0]), inside, bounds, _limit_rules(space, inside, cone)
        )

    def _solve_worst(
        self, space: BeamSpace, inside: FloatArray, cone: NDArray[np.int64], bounds: list[tuple[float, float]]
    ) -> FloatArray:
        slopes, n, n_state = _Slopes(self, space, cone), len(inside), len(self.scale.states)
        rules = [
            {"type": "ineq", "fun": lambda z, rule=rule: rule["fun"](z[:-1])}
            for rule in _limit_rules(space, inside, cone)
        ]
        rules.append(
            {
                "type": "ineq",
                "fun": lambda z: z[-1] - slopes.at(z[:-1])[0],
                "jac": lambda z: np.column_stack([-slopes.at(z[:-1])[1], np.ones(n_state)]),
            }
        )
        return self._slsqp(
            lambda z: (float(z[-1]), np.append(np.zeros(n), 1.0)),
            np.append(inside, np.max(slopes.at(inside)[0])),
            [*bounds, (-np.inf, np.inf)],
            rules,
        )

    def _slsqp(
        self,
        height: Callable[[FloatArray], tuple[float, FloatArray]],
        start: FloatArray,
        bounds: list[tuple[float, float]],
        rules: list[dict[str, Any]],
    ) -> FloatArray:
        solve: Any = scipy.optimize.minimize  # its stubs know no constraints with slopes of several rows
        options = {"maxiter": _MOST_STEPS, "ftol": self.scale.precision}
        done = solve(height, start, jac=True, method="SLSQP", bounds=bounds, constraints=rules, options=options)
        return np.asarray(done.x, dtype=np.float64)


class _Slopes:
    """ln f of each state and its slope by differences, kept for the point at which it was asked for last."""

    def __init__(self, search: ScanSearch, space: BeamSpace, cone: NDArray[np.int64]) -> None:
        self.search, self.space, self.cone = search, space, cone
        self._at: FloatArray | None = None
        self._found: tuple[FloatArray, FloatArray] = (np.empty(0), np.empty(0))

    def at(self, variables: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ln f, shape (n_state,), and its slope, shape (n_state, n_variable)."""
        if self._at is None or not np.array_equal(self._at, variables):
            step = self.search.scale.step
            shifts = step * np.concatenate([np.zeros((1, len(variables))), np.eye(len(variables))])
            f = self.search.values(self.space.directions(variables + shifts, self.cone))
            self._at, self._found = variables.copy(), (f[0], (f[1:] - f[0]).T / step)
        return self._found


def _limit_rules(space: BeamSpace, start: FloatArray, cone: NDArray[np.int64]) -> list[dict[str, Any]]:
    """Return the limits that are not bounds, as inequalities; the pair that spans the spread is that of the start."""
    rules: list[dict[str, Any]] = []
    if space.min_elevation is not None:
        rules.append({"type": "ineq", "fun": lambda z: space.elevation_margin(space.directions(z, cone))})
    if space.min_spread > 0.0:
        _, first, second = largest_angle(space.directions(start, cone))
        most = np.cos(space.min_spread)

        def spread(z: FloatArray) -> float:
            direction = space.directions(z, cone)
            return float(most - direction[first] @ direction[second])

        rules.append({"type": "ineq", "fun": spread})
    return rules


def value_at(height: float) -> float:
    """Return the criterion whose logarithm a search has reached; infinite where it has none."""
    return float(np.exp(height)) if height < _HIGHEST else np.inf


def _logarithm(values: FloatArray) -> FloatArray:
    finite = np.isfinite(values) & (values > 0.0)
    return np.asarray(np.where(finite, np.log(np.where(finite, values, 1.0)), _HIGHEST))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
