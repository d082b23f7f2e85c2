"""Weighted draws of proposals that are fitted to each record, and fitted again to their own first draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import StudentProposal
from bayes_rs.posteriors.sampling.points import draws_last, placed, student_points

_BLOCK_NUMBERS = 4_000_000
"""Expected variances, of records × draws × beams, that are evaluated together: 32 MB."""
_BATCH = 32
"""Records that a block is reckoned for, so that its size does not depend on how many there are."""


@dataclass
class Candidates:
    """Draws of some records' proposals, one round of them after the other, and their weights.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records.
    rotation : ndarray, shape (n_record, n_set, k, k)
        The records' rotations, one for each set of points; the same in all rounds, whose points are scrambled anew.
    seed : int
        Seed of the fit.

    Attributes
    ----------
    proposals : list of StudentProposal
        That of each round.
    coordinate : list of ndarray, shape (n_record, k, n_set, size)
        The draws of each round.
    log_density : list of ndarray, shape (n_record, n_set, size)
        Their log-posterior.
    stress : list of ndarray, shape (n_record, 6, n_set, size)
        The stresses that they mean, m² s⁻².
    """

    posterior: Posterior
    rotation: FloatArray
    seed: int
    proposals: list[StudentProposal] = field(default_factory=list)
    coordinate: list[FloatArray] = field(default_factory=list)
    log_density: list[FloatArray] = field(default_factory=list)
    stress: list[FloatArray] = field(default_factory=list)

    def draw(self, proposal: StudentProposal, size: int) -> None:
        """Add a round of `size` draws of a proposal to each set."""
        n_set, k = self.rotation.shape[1:3]
        point, _ = student_points(n_set, k, size, self.seed, len(self.proposals))
        coordinate = placed(proposal, self.rotation, point)
        density, stress = evaluate_in_blocks(self.posterior, draws_last(coordinate))
        self.proposals.append(proposal)
        self.coordinate.append(coordinate)
        self.log_density.append(density.reshape(len(density), n_set, size))
        self.stress.append(stress.swapaxes(1, 2).reshape(len(density), -1, n_set, size))

    def log_weight(self) -> FloatArray:
        r"""Return the logarithms of the weights of all rounds, shape (n_record, n_set, n).

        Notes
        -----
        The weight is that of draws from the mixture of all rounds' proposals,

        .. math:: w(x) = p(x) / \sum_j \alpha_j q_j(x) ,

        with α_j the share of round j in the draws (Veach and Guibas 1995, the balance heuristic): no draw weighs more
        than it would with any one of the proposals and its own share of the draws.
        """
        weights = []
        for index, (coordinate, density) in enumerate(zip(self.coordinate, self.log_density, strict=True)):
            mixture = self._log_mixture(index, draws_last(coordinate))
            weights.append(density - mixture.reshape(density.shape))
        return weights[0] if len(weights) == 1 else np.concatenate(weights, axis=-1)

    def _log_mixture(self, index: int, coordinate: FloatArray) -> FloatArray:
        """Return ln Σ α_j q_j, shape (n_record, n_draw), at the draws of a round."""
        n_set, k = self.rotation.shape[1:3]
        _, own = student_points(n_set, k, self.coordinate[index].shape[-1], self.seed, index)
        parts = [
            proposal.log_density_at(own.reshape(1, -1)) if other == index else proposal.log_density(coordinate)
            for other, proposal in enumerate(self.proposals)
        ]
        if len(parts) == 1:
            return parts[0]
        for density, round_of in zip(parts, self.coordinate, strict=True):
            np.add(density, np.log(round_of.shape[-1] / self.total_size), out=density)
        largest = np.maximum.reduce(parts)
        sum_over = np.zeros(largest.shape)
        for density in parts:
            np.subtract(density, largest, out=density)
            sum_over += np.exp(density, out=density)
        largest += np.log(sum_over, out=sum_over)
        return np.asarray(largest)

    def weight(self) -> tuple[FloatArray, FloatArray]:
        """Return the weights, which sum to 1, and their logarithms up to a constant, each (n_record, n_set, n).

        A record whose density is nowhere above zero has equal weights.
        """
        log_weight = self.log_weight()
        peak = log_weight.max(axis=(1, 2), keepdims=True)
        log_weight = np.where(np.isfinite(peak), log_weight, 0.0)
        weight = np.exp(log_weight - np.where(np.isfinite(peak), peak, 0.0))
        return weight / weight.sum(axis=(1, 2), keepdims=True), log_weight

    def all_coordinates(self) -> FloatArray:
        """Return the draws of all rounds, shape (n_record, k, n_set, n)."""
        return _joined(self.coordinate)

    def all_stresses(self) -> FloatArray:
        """Return the stresses of all rounds, shape (n_record, 6, n_set, n)."""
        return _joined(self.stress)

    @property
    def total_size(self) -> int:
        """Draws of each set so far."""
        return sum(part.shape[-1] for part in self.coordinate)

    def fitted(self) -> StudentProposal:
        """Return the last proposal, fitted to all draws so far."""
        return self.fitted_with(self.weight()[0])

    def fitted_with(self, weight: FloatArray) -> StudentProposal:
        """Return the last proposal, fitted to all draws so far, whose weights are at hand."""
        return self.proposals[-1].fitted_to(draws_last(self.all_coordinates()), weight.reshape(len(weight), -1))

    def take(self, records: NDArray[np.int64]) -> Candidates:
        """Return the candidates of some of the records."""
        return Candidates(
            self.posterior.take(records),
            self.rotation[records],
            self.seed,
            [proposal.take(records) for proposal in self.proposals],
            [part[records] for part in self.coordinate],
            [part[records] for part in self.log_density],
            [part[records] for part in self.stress],
        )


def joined(parts: Sequence[Candidates], posterior: Posterior) -> Candidates:
    """Return the candidates of several groups of records, with as many rounds each, and their posterior as one."""
    if len(parts) == 1:
        return parts[0]

    def rounds(name: str) -> list[FloatArray]:
        return [np.concatenate(each) for each in zip(*(getattr(part, name) for part in parts), strict=True)]

    proposals = [
        StudentProposal(
            np.concatenate([one.mode for one in each]),
            np.concatenate([one.factor for one in each]),
            max(one.n_iteration for one in each),
        )
        for each in zip(*(part.proposals for part in parts), strict=True)
    ]
    return Candidates(
        posterior,
        np.concatenate([part.rotation for part in parts]),
        parts[0].seed,
        proposals,
        rounds("coordinate"),
        rounds("log_density"),
        rounds("stress"),
    )


def _joined(rounds: list[FloatArray]) -> FloatArray:
    return rounds[0] if len(rounds) == 1 else np.concatenate(rounds, axis=-1)


def evaluate_in_blocks(posterior: Posterior, coordinate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log-posterior and stresses in blocks of draws, whose size does not depend on the number of records."""
    n_record, n_draw = coordinate.shape[:2]
    block = max(_BLOCK_NUMBERS // (_BATCH * posterior.likelihood.gain.shape[1]), 256)
    if block >= n_draw:
        return posterior.evaluate(coordinate)
    density, stress = np.empty((n_record, n_draw)), np.empty((n_record, 6, n_draw)).swapaxes(1, 2)
    for start in range(0, n_draw, block):
        part = slice(start, start + block)
        density[:, part], stress[:, part] = posterior.evaluate(coordinate[:, part])
    return density, stress


def resampled(weight: FloatArray, offset: FloatArray, n_keep: int) -> NDArray[np.int64]:
    """Pick draws in proportion to their weights by systematic resampling within each set.

    Parameters
    ----------
    weight : ndarray, shape (n_record, n_set, size)
        Weights.
    offset : ndarray, shape (n_record, n_set)
        A uniform number for each.
    n_keep : int
        Draws to pick in all.

    Returns
    -------
    index : ndarray of int, shape (n_record, n_keep)
        Into the draws of all sets.
    """
    n_record, n_set, size = weight.shape
    each = n_keep // n_set
    level = np.cumsum(weight, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):  # a set without any weight
        level *= each / level[..., -1:]
    # number of the points offset, offset + 1, … that lie below each level; the last level holds them all
    np.ceil(np.subtract(level, offset[..., None], out=level), out=level)
    count = np.nan_to_num(level, copy=False, nan=each).astype(np.int64)
    np.clip(count, 0, each, out=count)
    count[..., -1] = each
    copies = np.diff(count, axis=-1, prepend=0)
    picked = np.repeat(np.tile(np.arange(n_set * size), n_record), copies.reshape(-1))
    return picked.reshape(n_record, n_keep)
