"""The move of means and scatter together: a Hamiltonian trajectory that takes the records along."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.campaign.hyperprior import ETA, MOST_SCATTER, Hyper, group_root, log_density_of_scatter, mean_root
from bayes_rs.campaign.record_moves import Frame, RecordMoves, State
from bayes_rs.priors.interface import N_COORDINATE

N_POSITION = N_COORDINATE + N_COORDINATE * (N_COORDINATE + 1) // 2
_ROW, _COLUMN = np.tril_indices(N_COORDINATE, -1)
_LARGEST = 1e3
"""A trajectory that makes a τ larger than this is given up: σ I − Σ is singular then."""
_WISHED = 0.5
"""Acceptance that the step is adapted to."""


@dataclass(frozen=True, eq=False)
class _Place:
    """A point of a trajectory: where it is, what it means, and whether it is possible."""

    position: FloatArray
    hyper: Hyper
    frame: Frame
    force: FloatArray
    log_prior: FloatArray
    possible: NDArray[np.bool_]


class HyperDrift:
    """Hamiltonian moves of the common mean and of Σ.

    Parameters
    ----------
    moves : RecordMoves
        What knows the records; its axes and its expansion shape the trajectory.
    rng : numpy.random.Generator
        Source of random numbers.
    n_step : int
        Leapfrog steps of a trajectory, on average.

    Notes
    -----
    Positions are the shift of the means along the axes Q, those that the data tell most of first; then ln τ and artanh p
    with Qᵀ Ω Q = diag(τ) C diag(τ), where Ω = (I − Σ/σ)⁻¹ − I, σ = `MOST_SCATTER`, has no upper bound, and p the partial correlations that
    make the rows of the Cholesky factor of C. A density p(Σ) becomes p(Σ) |I − Σ/σ|⁷ Π τ⁷ Π (1 − p_ij²)^((6 − j)/2),
    j = 0, … (Lewandowski, Kurowicka and Joe 2009).
    The force is the gradient of the density that would hold if the likelihoods were normal, with the records
    integrated out: Σ⁻¹ Σ_k (E[z_k] − μ_k) for the means and ½ Σ⁻¹ (Σ_k E[r_k r_kᵀ] − N Σ) Σ⁻¹ for Σ. Any force leaves
    a leapfrog trajectory reversible; at its end the records' true likelihoods decide, and the records keep their
    scores in the normal approximation, as in `RecordMoves`.
    """

    def __init__(self, moves: RecordMoves, rng: np.random.Generator, *, n_step: int = 6) -> None:
        self.moves = moves
        self.rng = rng
        self.n_step = n_step
        self.log_step = np.log(0.3)
        self.root = np.eye(N_POSITION)
        self.tried, self.accepted = {"drift": 0.0}, {"drift": 0.0}

    def shape_by_information(self) -> None:
        """Take the shape of the moves from what the records' expansions tell."""
        scale = np.concatenate(
            [
                self.moves.shift_scale[::-1],
                self.moves.scale_scale[::-1],
                0.4 * np.ones(len(_ROW)),
            ]
        )
        self.root = np.diag(scale)

    def shape_by(self, positions: FloatArray) -> None:
        """Take the shape of the moves from positions (n, N_POSITION) that were visited, shrunk to their variances."""
        covariance = np.cov(positions, rowvar=False)
        n = len(positions) / 20.0  # neighbours of a chain are alike
        weight = n / (n + N_POSITION)
        covariance = weight * covariance + (1.0 - weight) * np.diag(np.diag(covariance))
        self.root = np.linalg.cholesky(covariance + 1e-9 * np.eye(N_POSITION))

    def position(self, hyper: Hyper) -> FloatArray:
        """Return positions (n, N_POSITION), with the mean over all records in place of the shift."""
        level = np.average(hyper.means(self.moves.cells), axis=1, weights=self.moves.cells.count) @ self._axes
        return np.concatenate([level, self._split(hyper.scatter)], axis=1)

    @property
    def _axes(self) -> FloatArray:
        return self.moves.axes[:, ::-1]

    def _split(self, scatter: FloatArray) -> FloatArray:
        """Return ln τ and artanh p, shape (n, 21)."""
        ratio = np.linalg.inv(MOST_SCATTER * np.eye(N_COORDINATE) - scatter) @ scatter
        lower = np.linalg.cholesky(self._axes.T @ (0.5 * (ratio + ratio.swapaxes(-1, -2))) @ self._axes)
        size = np.linalg.norm(lower, axis=2)
        unit = lower / size[:, :, None]
        room = _room(unit)
        return np.concatenate([np.log(size), np.arctanh((unit / room)[:, _ROW, _COLUMN])], axis=1)

    def _lower(self, position: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the Cholesky factor of C, the p (1 on the diagonal) and what is left of a row at p, each (n, 6, 6)."""
        partial = np.zeros((len(position), N_COORDINATE, N_COORDINATE))
        partial[:, np.arange(N_COORDINATE), np.arange(N_COORDINATE)] = 1.0
        partial[:, _ROW, _COLUMN] = np.tanh(position[:, 2 * N_COORDINATE :])
        room = np.ones_like(partial)
        room[:, :, 1:] = np.cumprod(np.sqrt(1.0 - np.tril(partial, -1)[:, :, :-1] ** 2), axis=2)
        return np.tril(partial * room), partial, room

    def _levels(self, hyper: Hyper) -> FloatArray:
        """Return the groups' means without what the wind speed makes, shape (n, n_group, 6)."""
        level = hyper.group_levels(self.moves.cells)
        level[:, :, -1] *= np.sqrt(1.0 - hyper.speed_share)[:, None]
        return np.asarray(level @ mean_root(hyper.scatter).swapaxes(-1, -2))

    def move(self, state: State, frame: Frame, *, adapt: bool) -> tuple[State, Frame]:
        """Move along a trajectory, and accept or reject its end."""
        start = state.hyper
        n_chain, n_group = len(start), self.moves.cells.n_group
        levels = self._levels(start)
        correlation = group_root(start.group_share, n_group)
        weight = np.linalg.inv(correlation @ correlation.swapaxes(-1, -2))
        position = np.concatenate([np.zeros((n_chain, N_COORDINATE)), self._split(start.scatter)], axis=1)
        now = self._place(position, start, levels, weight, frame, np.ones(n_chain, dtype=np.bool_), start)
        momentum = self.rng.standard_normal((n_chain, N_POSITION))
        energy = 0.5 * np.sum(momentum**2, axis=1)
        step = np.exp(self.log_step) * self.rng.uniform(0.4, 1.6)
        n_step = int(self.rng.integers(1, 2 * self.n_step))
        place = now
        for _ in range(n_step):
            momentum = momentum + 0.5 * step * (place.force @ self.root)
            position = place.position + step * (momentum @ self.root.T)
            place = self._place(position, place.hyper, levels, weight, None, place.possible, start)
            momentum = momentum + 0.5 * step * (place.force @ self.root)
        trial = place.frame.place(frame.score(state.coordinate))
        height = self.moves.log_likelihood(trial)
        change = height - state.height + place.frame.log_prior(trial) - frame.log_prior(state.coordinate)
        change += frame.log_volume - place.frame.log_volume
        with np.errstate(invalid="ignore"):
            log_ratio = np.sum(change, axis=1) + place.log_prior - now.log_prior
            log_ratio += energy - 0.5 * np.sum(momentum**2, axis=1)
        log_ratio = np.where(place.possible & np.isfinite(log_ratio), log_ratio, -np.inf)
        accept = np.log(self.rng.uniform(size=n_chain)) < log_ratio
        self.tried["drift"] += n_chain
        self.accepted["drift"] += float(np.count_nonzero(accept))
        if adapt:
            self.log_step += 0.15 * (float(np.exp(np.minimum(log_ratio, 0.0)).mean()) - _WISHED)
        where = accept[:, None]
        new = State(
            start.where(accept, place.hyper),
            np.where(where, trial, state.coordinate),
            np.where(where, height, state.height),
        )
        return new, frame.where(accept, place.frame)

    def _place(
        self,
        position: FloatArray,
        last: Hyper,
        levels: FloatArray,
        weight: FloatArray,
        frame: Frame | None,
        possible: NDArray[np.bool_],
        start: Hyper,
    ) -> _Place:
        """Return the point at a position; chains whose Σ is not possible stay at `last`, and are out."""
        cells = self.moves.cells
        with np.errstate(over="ignore", invalid="ignore"):
            size = np.exp(position[:, N_COORDINATE : 2 * N_COORDINATE])
            unit, partial, _ = self._lower(position)
            lower = self._axes @ (size[:, :, None] * unit)
            ratio = lower @ lower.swapaxes(-1, -2)
        usable = np.isfinite(ratio).all(axis=(1, 2)) & (size.max(axis=1) < _LARGEST)
        ratio = np.where(usable[:, None, None], ratio, np.eye(N_COORDINATE))
        scatter = MOST_SCATTER * np.linalg.solve(np.eye(N_COORDINATE) + ratio, ratio)
        scatter = 0.5 * (scatter + scatter.swapaxes(-1, -2))
        possible = possible & usable
        log_density = log_density_of_scatter(scatter)
        possible = possible & np.isfinite(log_density)
        scatter = np.where(possible[:, None, None], scatter, last.scatter)
        root = mean_root(scatter)
        mean = levels + (position[:, :N_COORDINATE] @ self._axes.T)[:, None, :]
        score = start.score.copy()
        level = np.linalg.solve(root, mean.swapaxes(-1, -2))  # (n, 6, n_group)
        level[:, -1] /= np.sqrt(1.0 - start.speed_share)[:, None]
        between = group_root(start.group_share, cells.n_group)
        own = np.linalg.solve(between, level.swapaxes(-1, -2)).swapaxes(-1, -2)
        n_level = N_COORDINATE * cells.n_group
        score[:, :n_level] = own.reshape(len(score), -1)
        # what the wind speed makes of the means stays as it is
        pivot = root[:, 0, -1]
        score[:, n_level:] *= (mean_root(start.scatter)[:, 0, -1] / pivot)[:, None]
        hyper = replace(start, scatter=scatter, score=score) if frame is None else start
        made = self.moves.frame(hyper) if frame is None else frame
        log_prior = np.where(possible, log_density, 0.0) + (N_COORDINATE + 1.0) * np.log(size).sum(axis=1)
        log_prior += np.log1p(-(partial[:, _ROW, _COLUMN] ** 2)) @ (0.5 * (N_COORDINATE - _COLUMN))
        log_prior -= 0.5 * np.sum(hyper.score**2, axis=1)
        log_prior -= cells.n_group * np.log(np.abs(np.linalg.det(root))) + cells.n_bin * np.log(pivot)
        log_prior += (N_COORDINATE + 1.0) * np.linalg.slogdet(np.eye(N_COORDINATE) - scatter / MOST_SCATTER)[1]
        square = np.sum(score[:, n_level:] ** 2, axis=1)
        force = self._force(position, scatter, mean, weight, start.speed_share, square, made)
        return _Place(position, hyper, made, np.where(possible[:, None], force, 0.0), log_prior, possible)

    def _force(
        self,
        position: FloatArray,
        scatter: FloatArray,
        mean: FloatArray,
        weight: FloatArray,
        share: FloatArray,
        speed_square: FloatArray,
        frame: Frame,
    ) -> FloatArray:
        """Return the gradient of the approximate density in the positions, shape (n, N_POSITION)."""
        square, first = frame.moments()
        precision = np.linalg.inv(scatter)
        of_scatter = 0.5 * precision @ (square - self.moves.cells.n_record * scatter) @ precision
        of_scatter += (ETA - 1.0) * precision
        diagonal = (ETA - 1.0 + 0.5 * N_COORDINATE) / np.einsum("nii->ni", scatter)
        of_scatter -= diagonal[:, :, None] * np.eye(N_COORDINATE)
        # the means are normal with covariance V − φ e eᵀ/(V⁻¹)_00 and the size with φ/(V⁻¹)_00, where V = I − Σ
        free = np.linalg.inv(np.eye(N_COORDINATE) - scatter)
        pulled = mean @ free
        weighted = weight @ pulled
        size, more = 1.0 / free[:, 0, 0], share / (1.0 - share)
        of_size = pulled[:, :, 0]  # eᵀ V⁻¹ m of each group
        weighted_size = weighted[:, :, 0]
        own = np.sum(of_size * weighted_size, axis=1)
        across = np.einsum("ng,ngi->ni", weighted_size, pulled)
        of_mean = (precision @ first[..., None])[..., 0] - weighted.sum(axis=1)
        of_mean -= (more * size * weighted_size.sum(axis=1))[:, None] * free[:, 0]
        of_scatter += 0.5 * (mean.shape[1] * free - pulled.swapaxes(-1, -2) @ weighted)
        edge = free[:, :, :1] * free[:, :1, :]
        mixed = free[:, :, :1] * across[:, None, :]
        pull = more * size**2 * own - speed_square * size + self.moves.cells.n_bin * size
        of_scatter += 0.5 * pull[:, None, None] * edge
        of_scatter -= 0.5 * (more * size)[:, None, None] * (mixed + mixed.swapaxes(-1, -2))
        tau = np.exp(position[:, N_COORDINATE : 2 * N_COORDINATE])
        unit, partial, room = self._lower(position)
        remaining = np.eye(N_COORDINATE) - scatter / MOST_SCATTER
        of_ratio = MOST_SCATTER * remaining @ of_scatter @ remaining - (N_COORDINATE + 1.0) * remaining
        slope = np.tril(2.0 * self._axes.T @ of_ratio @ self._axes @ (tau[:, :, None] * unit))
        slope *= tau[:, :, None]
        product = slope * unit
        of_tau = product.sum(axis=2) + (N_COORDINATE + 1.0)
        right = product.sum(axis=2, keepdims=True) - np.cumsum(product, axis=2)  # of the columns beyond
        of_partial = (slope * (1.0 - partial**2) * room - partial * right)[:, _ROW, _COLUMN]
        of_partial -= (N_COORDINATE - _COLUMN) * partial[:, _ROW, _COLUMN]
        return np.concatenate([of_mean @ self._axes, of_tau, of_partial], axis=1)


def _room(unit: FloatArray) -> FloatArray:
    """Return what is left of each row of unit length before each column, shape (n, 6, 6); 1 beyond the diagonal."""
    room = np.ones_like(unit)
    left = 1.0 - np.cumsum(unit**2, axis=2)[:, :, :-1]
    room[:, :, 1:] = np.sqrt(np.where(np.tril(np.ones((N_COORDINATE, N_COORDINATE - 1)), -1) > 0, left, 1.0))
    return room
