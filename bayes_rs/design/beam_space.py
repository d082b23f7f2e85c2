"""Where the beams of a scan may point: limits, and the variables that a search moves within them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_array
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import tilt_matrix
from bayes_rs.geometry.scan_file import cone_direction

FEASIBLE = 1e-7
"""A direction counts as inside the limits if it misses them by no more than this, rad."""
_ATTEMPTS, _MOST_ATTEMPTS = 40, 400  # to find any scan within the limits, and to find enough


@dataclass(frozen=True, kw_only=True)
class BeamSpace:
    """Where beams may point, in rad, and how many cones they share.

    Parameters
    ----------
    n_beams : int
        Number of beams.
    max_angle : float
        Largest opening angle φ from the axis, rad.
    cones : int or None
        Number of opening angles that the beams off the axis share; None for one of its own for each beam.
    centre : bool
        One beam is along the axis, and the last.
    arcs : tuple of (float, float)
        Ranges of θ that are free, rad, each from lower to upper; empty for all of the circle.
    min_elevation : float or None
        Least angle of a beam above the horizontal, rad.
    min_spread : float
        Least angle between the two beams that are farthest apart, rad.
    upward : bool
        The axis is z; if not, −x.
    tilt : float
        Tilt of the instrument, rad.
    """

    n_beams: int
    max_angle: float
    cones: int | None = None
    centre: bool = False
    arcs: tuple[tuple[float, float], ...] = ()
    min_elevation: float | None = None
    min_spread: float = 0.0
    upward: bool = False
    tilt: float = 0.0

    @property
    def n_moving(self) -> int:
        """Number of beams that are not the centre beam."""
        return self.n_beams - self.centre

    @property
    def n_angle(self) -> int:
        """Number of opening angles that may vary."""
        return self.n_moving if self.cones is None else self.cones

    @property
    def n_variable(self) -> int:
        """Number of variables: opening angles, then θ of each moving beam."""
        return self.n_angle + self.n_moving

    def directions(self, variables: FloatArray, cone: NDArray[np.int64]) -> FloatArray:
        """Return beam vectors (..., n_beams, 3) in the instrument's frame; `cone` says which φ each beam has."""
        opening, phase = variables[..., cone], variables[..., self.n_angle : self.n_variable]
        if self.centre:
            nothing = np.zeros((*opening.shape[:-1], 1))
            opening, phase = np.concatenate([opening, nothing], axis=-1), np.concatenate([phase, nothing], axis=-1)
        ahead = cone_direction(opening, phase)
        if not self.upward:
            return ahead
        return np.stack([ahead[..., 1], ahead[..., 2], -ahead[..., 0]], axis=-1)

    def elevation_margin(self, direction: FloatArray) -> FloatArray:
        """Return by how much each beam's vertical part exceeds the least, shape (..., n_beams)."""
        least = -1.0 if self.min_elevation is None else np.sin(self.min_elevation)
        return np.asarray((direction @ tilt_matrix(self.tilt))[..., 2] - least)

    def bounds(self, start: FloatArray) -> list[tuple[float, float]]:
        """Return lower and upper bounds of the variables; a beam stays in the free sector in which it starts.

        Where all of the circle is free, φ may pass through zero, since φ < 0 is the beam at θ + π.
        """
        least = 0.0 if self.arcs else -self.max_angle
        angles = [(least, self.max_angle)] * self.n_angle
        if not self.arcs:
            return angles + [(-np.inf, np.inf)] * self.n_moving
        phases = start[self.n_angle : self.n_variable]
        return angles + [next(arc for arc in self.arcs if arc[0] <= phase <= arc[1]) for phase in phases.tolist()]

    def draw(self, rng: np.random.Generator, n_draw: int) -> tuple[FloatArray, NDArray[np.int64]]:
        """Draw directions within the limits: variables (n_draw, n_variable), cones of the beams (n_draw, n_moving).

        Raises
        ------
        InputError
            If none is found.
        """
        found: list[FloatArray] = []
        cones: list[NDArray[np.int64]] = []
        for attempt in range(_MOST_ATTEMPTS):
            if attempt == _ATTEMPTS and not found:
                break
            variables, cone = self._draw_any(rng, n_draw)
            inside = np.array(
                [self.feasible(self.directions(row, own), row, own) for row, own in zip(variables, cone, strict=True)]
            )
            found += list(variables[inside])
            cones += list(cone[inside])
            if len(found) >= n_draw:
                return np.array(found[:n_draw]), np.array(cones[:n_draw])
        raise InputError(
            f"Found {len(found)} scans within the limits in {(attempt + 1) * n_draw} draws, and {n_draw} are needed: "
            "they leave hardly any room; allow a larger angle, a lower elevation, a smaller spread or smaller blocked "
            "sectors."
        )

    def _draw_any(self, rng: np.random.Generator, n_draw: int) -> tuple[FloatArray, NDArray[np.int64]]:
        """Draw directions in the free sectors, which may break the other limits."""
        lengths = np.array([upper - lower for lower, upper in self.arcs or ((0.0, 2.0 * np.pi),)])
        lowers = np.array([lower for lower, _ in self.arcs or ((0.0, 0.0),)])
        # even over the cap: the solid angle between 0 and φ grows with sin²(φ/2)
        cap = np.sin(0.5 * self.max_angle) ** 2
        angle = 2.0 * np.arcsin(np.sqrt(cap * rng.random((n_draw, self.n_angle))))
        place = rng.random((n_draw, self.n_moving)) * lengths.sum()
        arc = np.minimum(np.searchsorted(np.cumsum(lengths), place), len(lengths) - 1)
        phase = lowers[arc] + place - (np.cumsum(lengths) - lengths)[arc]
        if self.cones is None:
            cone = np.broadcast_to(np.arange(self.n_moving), phase.shape)
        else:
            cone = rng.permuted(np.broadcast_to(np.arange(self.n_moving) % self.cones, phase.shape), axis=1)
        if self.min_spread > 0.0 and self.n_moving > 1:
            phase, angle = self._spread(rng, angle, phase, cone)
        if self.min_elevation is not None:
            phase, angle = self._raised(rng, angle, phase, cone)
        order = np.argsort(phase, axis=1)  # beams go round; other orders are the same beams at other times
        phase = np.take_along_axis(phase, order, axis=1)
        if self.cones is None:
            angle = np.take_along_axis(angle, order, axis=1)
        else:
            cone = np.take_along_axis(cone, order, axis=1)
        return np.concatenate([angle, phase], axis=1), cone

    def _spread(
        self, rng: np.random.Generator, angle: FloatArray, phase: FloatArray, cone: NDArray[np.int64]
    ) -> tuple[FloatArray, FloatArray]:
        """Move two beams of each scan far enough apart: wide enough, and, where all of the circle is free, opposite."""
        phase, angle = phase.copy(), angle.copy()
        row = np.arange(len(phase))
        pair = np.argsort(rng.random(phase.shape), axis=1)[:, :2]
        opening = rng.uniform(0.5 * self.min_spread, self.max_angle, len(phase))
        for beam in pair.T:
            angle[row, cone[row, beam]] = opening
        if not self.arcs:
            phase[row, pair[:, 1]] = np.mod(phase[row, pair[:, 0]] + np.pi, 2.0 * np.pi)
        return phase, angle

    def _raised(
        self, rng: np.random.Generator, angle: FloatArray, phase: FloatArray, cone: NDArray[np.int64]
    ) -> tuple[FloatArray, FloatArray]:
        """Draw again, beam by beam, what is too low; what stays too low is left to the check."""
        phase, angle = phase.copy(), angle.copy()
        bare = BeamSpace(n_beams=self.n_moving, max_angle=self.max_angle, arcs=self.arcs, upward=self.upward)
        free = np.arange(self.n_moving)
        for _ in range(50):
            opening = np.take_along_axis(angle, cone, axis=1)
            direction = bare.directions(np.concatenate([opening, phase], axis=1), free)
            low = self.elevation_margin(direction) < 0.0
            if not low.any():
                break
            if not self.arcs:
                phase[low] = 2.0 * np.pi * rng.random(int(low.sum()))
            else:
                lengths = np.array([upper - lower for lower, upper in self.arcs])
                arc = rng.choice(len(lengths), size=int(low.sum()), p=lengths / lengths.sum())
                phase[low] = np.array([lower for lower, _ in self.arcs])[arc] + lengths[arc] * rng.random(len(arc))
            if self.cones is None:
                cap = np.sin(0.5 * self.max_angle) ** 2
                angle[low] = 2.0 * np.arcsin(np.sqrt(cap * rng.random(int(low.sum()))))
        return phase, angle

    def feasible(self, direction: FloatArray, variables: FloatArray, cone: NDArray[np.int64]) -> bool:
        """Say whether all limits are kept, to `FEASIBLE`."""
        opening = np.abs(variables[cone])
        phase = np.where(variables[cone] < 0.0, np.pi, 0.0) + variables[self.n_angle : self.n_variable]
        return bool(np.all(opening <= self.max_angle + FEASIBLE)) and self.allows(direction, phase, opening)

    def allows(self, direction: FloatArray, phase: FloatArray, opening: FloatArray) -> bool:
        """Say whether elevation, spread and free sectors are kept; phase and opening angle of the moving beams."""
        if np.any(self.elevation_margin(direction) < -FEASIBLE):
            return False
        if largest_angle(direction)[0] < self.min_spread - FEASIBLE:
            return False
        if not self.arcs:
            return True
        turned = np.asarray(phase)[:, np.newaxis] - np.array([lower for lower, _ in self.arcs])
        free = np.mod(turned + FEASIBLE, 2.0 * np.pi) <= np.array([b - a for a, b in self.arcs]) + 2.0 * FEASIBLE
        return bool(np.all(np.any(free, axis=1) | (np.asarray(opening) <= FEASIBLE)))


def largest_angle(direction: FloatArray) -> tuple[float, int, int]:
    """Return the angle between the two beams farthest apart, rad, and which they are; direction (n_beam, 3)."""
    cosine = direction @ direction.T
    first, second = np.unravel_index(int(np.argmin(cosine)), cosine.shape)
    return float(np.arccos(np.clip(cosine[first, second], -1.0, 1.0))), int(first), int(second)


def free_arcs(blocked_deg: Sequence[Sequence[float]]) -> tuple[tuple[float, float], ...]:
    """Return the ranges of θ, rad, that blocked ranges leave free; empty if none is blocked.

    Parameters
    ----------
    blocked_deg : sequence of (float, float)
        From and to, degrees, counted from y towards z; (350, 10) goes through 0.

    Returns
    -------
    arcs : tuple of (float, float)
        Free ranges; the first begins in [0, 2π).

    Raises
    ------
    InputError
        If a range is no pair of numbers, is empty, or nothing is left.

    Examples
    --------
    >>> [tuple(round(float(np.rad2deg(end))) for end in arc) for arc in free_arcs([(200, 340)])]
    [(340, 560)]
    """
    if len(blocked_deg) == 0:
        return ()
    edges = check_array(np.asarray(blocked_deg), (None, 2), what="blocked_deg")
    starts = np.mod(edges[:, 0], 360.0)
    widths = np.mod(edges[:, 1] - edges[:, 0], 360.0)
    for index in np.flatnonzero(widths == 0.0).tolist():
        raise InputError(
            f"Invalid blocked_deg {edges[index].tolist()}: from and to must differ, by less than 360 degrees."
        )
    order = np.argsort(starts)
    arcs = []
    reach = float(np.max((starts + widths)[order] - 360.0))  # what blocked ranges through 0 cover
    first = max(reach, 0.0)
    reach = first
    for start, width in zip(starts[order].tolist(), widths[order].tolist(), strict=True):
        if start > reach:
            arcs.append((reach, start))
        reach = max(reach, start + width)
    if reach < 360.0 + first:
        end = 360.0 + first
        if arcs and first == 0.0 and arcs[0][0] == 0.0:  # the free range through 0 is one
            arcs[0] = (reach - 360.0, arcs[0][1])
        else:
            arcs.append((reach, end))
    if not arcs:
        raise InputError(f"Invalid blocked_deg {edges.tolist()}: together they block all directions; leave some free.")
    shifted = [(lower + 360.0, upper + 360.0) if lower < 0.0 else (lower, upper) for lower, upper in arcs]
    return tuple((float(np.deg2rad(lower)), float(np.deg2rad(upper))) for lower, upper in shifted)
