"""Local searches for the directions of a scan's beams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bayes_rs._validation import FloatArray
from bayes_rs.design.scan_criteria import ScanCriterion
from bayes_rs.design.scan_limits import ScanLimits, largest_angle
from bayes_rs.errors import NotPositiveDefiniteError
from bayes_rs.geometry.scan import Scan

_POOL = 16  # random scans that compete for each start
_STEP, _EXACT_STEP = 1e-6, 1e-3  # rad, forward differences; the exact noise is piecewise smooth only
_MOST_STEPS, _MOST_EXACT_STEPS = 300, 12
_HIGHEST = 60.0  # stands for the logarithm of an infinite criterion


@dataclass(frozen=True)
class SearchEnd:
    """Where a search has ended."""

    value: float
    limits: ScanLimits
    variables: FloatArray
    cone: NDArray[np.int64]

    @property
    def direction(self) -> FloatArray:
        """Unit vectors of the beams, shape (n_beams, 3)."""
        return self.limits.directions(self.variables, self.cone)


class ScanSearch:
    """Local searches for one criterion; counts its evaluations."""

    def __init__(self, scale: ScanCriterion, frame: Scan, n_plane: int) -> None:
        self.scale, self.frame, self.n_plane = scale, frame, n_plane
        self.n_fast = self.n_exact = 0

    def scan(self, direction: FloatArray) -> Scan:
        """Return the scan with these beams (n_beams, 3)."""
        return replace(self.frame, beam_direction=_unit(np.tile(direction, (self.n_plane, 1))))

    def fast(self, direction: FloatArray) -> FloatArray:
        """Return ln f of many scans, shape (n, n_state); directions (n, n_beams, 3)."""
        self.n_fast += len(direction)
        return _logarithm(self.scale.fast(np.tile(direction, (1, self.n_plane, 1)), self.frame))

    def exact(self, direction: FloatArray) -> FloatArray:
        """Return ln f of scans, shape (n, n_state), one after the other."""
        self.n_exact += len(direction)
        values = np.empty((len(direction), len(self.scale.states)))
        for row, one in zip(values, direction, strict=True):
            try:
                row[:] = self.scale.exact(self.scan(one))
            except NotPositiveDefiniteError:  # beams too close to each other for the tolerance of the noise
                row[:] = np.inf
        return _logarithm(values)

    def starts(
        self, limits: ScanLimits, rng: np.random.Generator, count: int
    ) -> list[tuple[FloatArray, NDArray[np.int64]]]:
        """Return the best of each 16 random scans."""
        if count == 0:
            return []
        variables, cone = limits.draw(rng, _POOL * count)
        worst = np.concatenate(
            [
                self.fast(
                    np.array(
                        [limits.directions(row, own) for row, own in zip(variables[part], cone[part], strict=True)]
                    )
                ).max(axis=1)
                for part in np.array_split(np.arange(len(variables)), max(count // 4, 1))
            ]
        )
        best = np.argmin(worst.reshape(count, _POOL), axis=1) + _POOL * np.arange(count)
        return [(variables[index], cone[index]) for index in best.tolist()]

    def descend(self, limits: ScanLimits, start: FloatArray, cone: NDArray[np.int64]) -> SearchEnd:
        """Search from a start with the fast criterion."""
        return self._run(self.fast, limits, start, cone, step=_STEP, most=_MOST_STEPS, precision=1e-13)

    def polish(self, end: SearchEnd) -> SearchEnd:
        """Go on with the exact criterion."""
        return self._run(
            self.exact,
            end.limits,
            end.variables,
            end.cone,
            step=_EXACT_STEP,
            most=_MOST_EXACT_STEPS,
            precision=1e-7,
        )

    def _run(
        self,
        values: Callable[[FloatArray], FloatArray],
        limits: ScanLimits,
        start: FloatArray,
        cone: NDArray[np.int64],
        *,
        step: float,
        most: int,
        precision: float,
    ) -> SearchEnd:
        """Minimize t subject to ln f_s(variables) ≤ t (or ln f alone for one state) by SLSQP."""
        n, n_state = len(start), len(self.scale.states)
        last: dict[str, Any] = {"at": None}
        shifts = step * np.concatenate([np.zeros((1, n)), np.eye(n)])

        def evaluate(variables: FloatArray) -> tuple[FloatArray, FloatArray]:
            if last["at"] is None or not np.array_equal(last["at"], variables):
                f = values(limits.directions(variables + shifts, cone))
                last.update(at=variables.copy(), f=f[0], g=(f[1:] - f[0]).T / step)
            return last["f"], last["g"]

        bounds = limits.bounds(start)
        rules = _limit_rules(limits, start, cone)
        lower, upper = np.array(bounds).T
        inside = np.clip(start, lower, upper)
        solve: Any = minimize  # its stubs know no constraints with slopes of several rows
        options = {"maxiter": most, "ftol": precision}
        if n_state == 1:
            done = solve(
                lambda z: (float(evaluate(z)[0][0]), evaluate(z)[1][0]),
                inside,
                jac=True,
                method="SLSQP",
                bounds=bounds,
                constraints=rules,
                options=options,
            )
        else:
            rules = [{"type": "ineq", "fun": lambda z, rule=rule: rule["fun"](z[:-1])} for rule in rules]
            rules.append(
                {
                    "type": "ineq",
                    "fun": lambda z: z[-1] - evaluate(z[:-1])[0],
                    "jac": lambda z: np.column_stack([-evaluate(z[:-1])[1], np.ones(n_state)]),
                }
            )
            done = solve(
                lambda z: (float(z[-1]), np.append(np.zeros(n), 1.0)),
                np.append(inside, np.max(evaluate(inside)[0])),
                jac=True,
                method="SLSQP",
                bounds=[*bounds, (-np.inf, np.inf)],
                constraints=rules,
                options=options,
            )
        found = np.clip(np.asarray(done.x, dtype=np.float64)[:n], lower, upper)
        ends = [
            (float(np.max(values(limits.directions(one, cone)[np.newaxis])[0])), one)
            for one in (found, inside)
            if np.all(np.isfinite(one)) and limits.feasible(limits.directions(one, cone), one, cone)
        ]
        height, best = min(ends, key=lambda pair: pair[0])
        return SearchEnd(value_at(height), limits, best, cone)


def _limit_rules(limits: ScanLimits, start: FloatArray, cone: NDArray[np.int64]) -> list[dict[str, Any]]:
    """Return the limits that are not bounds, as inequalities; the pair that spans the spread is that of the start."""
    rules: list[dict[str, Any]] = []
    if limits.min_elevation is not None:
        rules.append({"type": "ineq", "fun": lambda z: limits.elevation_margin(limits.directions(z, cone))})
    if limits.min_spread > 0.0:
        _, first, second = largest_angle(limits.directions(start, cone))
        most = np.cos(limits.min_spread)

        def spread(z: FloatArray) -> float:
            direction = limits.directions(z, cone)
            return float(most - direction[first] @ direction[second])

        rules.append({"type": "ineq", "fun": spread})
    return rules


def different_ends(ends: Sequence[SearchEnd]) -> list[SearchEnd]:
    """Leave out ends that have the value of a better one, to five digits: mostly the same scan, or its mirror image."""
    kept: list[SearchEnd] = []
    for end in ends:
        if all(abs(end.value / other.value - 1.0) > 1e-5 for other in kept):
            kept.append(end)
    return kept


def value_at(height: float) -> float:
    """Return the criterion whose logarithm a search has reached; infinite where it has none."""
    return float(np.exp(height)) if height < _HIGHEST else np.inf


def _logarithm(values: FloatArray) -> FloatArray:
    finite = np.isfinite(values) & (values > 0.0)
    return np.asarray(np.where(finite, np.log(np.where(finite, values, 1.0)), _HIGHEST))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
