"""The hyperparameters given all records' coordinates: the means integrated out, then drawn exactly.

All arrays have the chains first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.campaign.cells import Cells
from bayes_rs.campaign.hyperprior import Hyper, group_root
from bayes_rs.priors.interface import N_COORDINATE


@dataclass(frozen=True, eq=False)
class Sums:
    """What the hyperparameters need to know of the records' coordinates z.

    Parameters
    ----------
    square : ndarray, shape (n, 6, 6)
        Σ z zᵀ over the records.
    within : ndarray, shape (n, 6, 6)
        The same of what is left of z after the mean of its cell.
    of_group : ndarray, shape (n, n_group, 6)
        Sums of z over the groups.
    of_bin : ndarray, shape (n, n_bin, 6)
        Sums of z over the bins.
    """

    square: FloatArray
    within: FloatArray
    of_group: FloatArray
    of_bin: FloatArray


def sums_of(coordinate: FloatArray, cells: Cells) -> Sums:
    """Return the sums of coordinates, shape (6, n, n_record), of records that are sorted by cells."""
    of_cell = np.add.reduceat(coordinate, cells.first, axis=-1)  # (6, n, n_cell)
    by_chain = coordinate.swapaxes(0, 1)
    square = by_chain @ by_chain.swapaxes(-1, -2)
    chains_first = of_cell.transpose(1, 2, 0)
    scaled = chains_first / np.sqrt(cells.count)[:, None]
    within = square - scaled.swapaxes(-1, -2) @ scaled
    return Sums(square, within, cells.in_group @ chains_first, cells.in_bin @ chains_first)


@dataclass(frozen=True, eq=False)
class MeansPosterior:
    """The normal posterior of the scores of the means, given everything else.

    Parameters
    ----------
    root : ndarray, shape (n, n_score, n_score)
        Cholesky factor of its precision.
    whitened : ndarray, shape (n, n_score)
        root⁻¹ times the linear term of its log-density.
    log_marginal : ndarray, shape (n,)
        Log-density of the records' coordinates with the means integrated out, up to a constant.
    """

    root: FloatArray
    whitened: FloatArray
    log_marginal: FloatArray

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw scores, shape (n, n_score)."""
        normal = self.whitened + rng.standard_normal(self.whitened.shape)
        return np.asarray(np.linalg.solve(self.root.swapaxes(-1, -2), normal[..., None])[..., 0])


def means_posterior(hyper: Hyper, sums: Sums, cells: Cells) -> MeansPosterior:
    """Return the posterior of the scores; the matrices are small, whatever the number of records is."""
    n, n_group, n_bin = len(hyper), cells.n_group, cells.n_bin
    precision = hyper.precision
    level = hyper.root.copy()  # F, its last column for the part of the size that does not depend on the wind speed
    level[:, :, -1] *= np.sqrt(1.0 - hyper.speed_share)[:, None]
    size = np.sqrt(hyper.speed_share) * hyper.root[:, 0, -1]
    between = group_root(hyper.group_share, n_group)
    n_in_group, n_in_bin = cells.both_count.sum(axis=1), cells.both_count.sum(axis=0)
    grouped = between.swapaxes(-1, -2) @ (n_in_group[:, None] * between)
    n_level = N_COORDINATE * n_group
    n_score = n_level + n_bin
    # the lower triangle is enough; a last row for the linear term, whose factor is what whitens it
    whole = np.zeros((n, n_score + 1, n_score + 1))
    pulled = precision @ level  # Σ⁻¹ F
    of_level = level.swapaxes(-1, -2) @ pulled
    whole[:, :n_level, :n_level] = (of_level[:, :, None, :, None] * grouped[:, None, :, None, :]).reshape(
        n, n_level, n_level
    )
    across = between.swapaxes(-1, -2) @ (cells.both_count @ cells.kernel_root)
    beside = pulled[:, 0] * size[:, None]
    mixed = (beside[:, :, None, None] * across[:, None, :, :]).reshape(n, n_level, n_bin)
    whole[:, n_level:n_score, :n_level] = mixed.swapaxes(-1, -2)
    of_size = cells.kernel_root.T @ (n_in_bin[:, None] * cells.kernel_root)
    whole[:, n_level:n_score, n_level:n_score] = (precision[:, 0, 0] * size**2)[:, None, None] * of_size
    diagonal = np.arange(n_score)
    whole[:, diagonal, diagonal] += 1.0
    linear = whole[:, n_score, :n_score]
    linear[:, :n_level] = (pulled.swapaxes(-1, -2) @ sums.of_group.swapaxes(-1, -2) @ between).reshape(n, n_level)
    at_bin = (sums.of_bin @ precision[:, :, :1])[:, :, 0] * size[:, None]
    linear[:, n_level:] = at_bin @ cells.kernel_root
    # above the square of the whitened linear term, since no eigenvalue of the precision is below 1
    whole[:, n_score, n_score] = 1.0 + 2.0 * np.sum(linear**2, axis=1)
    factor = np.asarray(np.linalg.cholesky(whole), dtype=np.float64)
    whitened = factor[:, n_score, :n_score]
    log_volume = np.log(factor[:, diagonal, diagonal]).sum(axis=1)
    log_marginal = (
        -0.5 * cells.n_record * hyper.log_det
        - 0.5 * np.sum(precision * sums.square, axis=(1, 2))
        - log_volume
        + 0.5 * np.sum(whitened**2, axis=1)
    )
    return MeansPosterior(factor[:, :n_score, :n_score], whitened, np.asarray(log_marginal))


class HyperMoves:
    """Moves of the hyperparameters with the records' coordinates held fixed.

    Parameters
    ----------
    cells : Cells
        The cells of the records.
    rng : numpy.random.Generator
        Source of random numbers.

    Notes
    -----
    The target is p(Σ, φ, κ | z) with the means integrated out; the means are drawn from their normal posterior then.
    Σ has two moves: an inverse Wishart of the scatter within cells, which does not depend on the chain's Σ, and
    Σ → L W Lᵀ with L Lᵀ = Σ and W a Wishart matrix of mean 1. Logits of φ and κ walk.
    """

    def __init__(self, cells: Cells, rng: np.random.Generator) -> None:
        self.cells = cells
        self.rng = rng
        self.log_dof = float(np.log(60.0 + 2.0 * cells.n_record))
        self.tried = {"scatter, independent": 0.0, "scatter, walk": 0.0, "shares": 0.0}
        self.accepted = dict.fromkeys(self.tried, 0.0)

    def move(self, hyper: Hyper, coordinate: FloatArray, *, turn: int, adapt: bool) -> Hyper:
        """Move all hyperparameters; coordinates are (6, n, n_record), sorted by cells.

        Σ by its two moves in turns, and the shares in every second turn: they forget within a few.
        """
        sums = sums_of(coordinate, self.cells)
        now = self._posterior(hyper, sums)
        if turn % 2:
            now, hyper, _ = self._independent(now, hyper, sums)
        else:
            now, hyper, share = self._walk(now, hyper, sums)
            if adapt:
                self.log_dof = float(np.clip(self.log_dof - 0.3 * (share - 0.3), np.log(12.0), np.log(1e6)))
        if turn % 2:
            now, hyper = self._shares(now, hyper, sums)
        return hyper.with_score(now.draw(self.rng))

    def _posterior(self, hyper: Hyper, sums: Sums) -> MeansPosterior:
        return means_posterior(hyper, sums, self.cells)

    def _settle(
        self, what: str, now: MeansPosterior, hyper: Hyper, new: Hyper, log_ratio: FloatArray, sums: Sums
    ) -> tuple[MeansPosterior, Hyper, float]:
        """Accept or reject; `log_ratio` is what comes beside the marginal density of the coordinates."""
        possible = np.isfinite(log_ratio)
        safe = hyper.where(possible, new)
        if safe is hyper:
            self.tried[what] += len(hyper)
            return now, hyper, 0.0
        then = self._posterior(safe, sums)
        log_ratio = np.where(possible, log_ratio, -np.inf) + then.log_marginal - now.log_marginal
        accept = np.log(self.rng.uniform(size=len(hyper))) < log_ratio
        self.tried[what] += len(hyper)
        self.accepted[what] += float(accept.sum())
        kept = MeansPosterior(
            np.where(accept[:, None, None], then.root, now.root),
            np.where(accept[:, None], then.whitened, now.whitened),
            np.where(accept, then.log_marginal, now.log_marginal),
        )
        return kept, hyper.where(accept, safe), float(accept.mean())

    def _independent(self, now: MeansPosterior, hyper: Hyper, sums: Sums) -> tuple[MeansPosterior, Hyper, float]:
        dof = self.cells.n_record - len(self.cells.count) - 1.0
        if dof < 2.0 * N_COORDINATE:
            return now, hyper, 0.0
        root = np.linalg.cholesky(sums.within)
        wishart = _wishart_root(len(hyper), dof, self.rng)
        # Σ = A Aᵀ with A = L B⁻ᵀ and B Bᵀ a standard Wishart matrix: inverse Wishart of scale L Lᵀ
        half = root @ np.linalg.inv(wishart).swapaxes(-1, -2)
        new = hyper.with_scatter(half @ half.swapaxes(-1, -2))

        def density(one: Hyper) -> FloatArray:
            trace = np.sum(one.precision * sums.within, axis=(1, 2))
            return np.asarray(-0.5 * (dof + N_COORDINATE + 1.0) * one.log_det - 0.5 * trace)

        log_ratio = new.log_density - hyper.log_density + density(hyper) - density(new)
        return self._settle("scatter, independent", now, hyper, new, log_ratio, sums)

    def _walk(self, now: MeansPosterior, hyper: Hyper, sums: Sums) -> tuple[MeansPosterior, Hyper, float]:
        dof = np.exp(self.log_dof)
        wishart = _wishart_root(len(hyper), dof, self.rng) / np.sqrt(dof)
        half = np.linalg.cholesky(hyper.scatter) @ wishart
        new = hyper.with_scatter(half @ half.swapaxes(-1, -2))
        log_det = 2.0 * np.log(np.einsum("nii->ni", wishart)).sum(axis=1)
        inverse = np.linalg.inv(wishart)
        change = np.sum(inverse**2, axis=(1, 2)) - np.sum(wishart**2, axis=(1, 2))
        # p(Σ') q(Σ | Σ') over p(Σ) q(Σ' | Σ), both under the invariant measure |Σ|^(−7/2) dΣ, where W⁻¹ leads back
        log_ratio = (
            new.log_density
            - hyper.log_density
            + 0.5 * (N_COORDINATE + 1.0) * log_det
            - dof * log_det
            - 0.5 * dof * change
        )
        return self._settle("scatter, walk", now, hyper, new, log_ratio, sums)

    def _shares(self, now: MeansPosterior, hyper: Hyper, sums: Sums) -> tuple[MeansPosterior, Hyper]:
        speed_share, change = _logit_walk(hyper.speed_share, self.rng)
        group_share = hyper.group_share
        if self.cells.n_group > 1:
            group_share, more = _logit_walk(hyper.group_share, self.rng)
            change = change + more
        new = hyper.with_shares(speed_share, group_share)
        now, hyper, _ = self._settle("shares", now, hyper, new, change, sums)
        return now, hyper


def _logit_walk(share: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Walk shares of uniform density on the logit scale; return them and the logs of the ratios of the Jacobians."""
    step = rng.choice([0.3, 1.0, 2.5], len(share)) * rng.standard_normal(len(share))
    odds = share / (1.0 - share) * np.exp(step)
    new = odds / (1.0 + odds)
    valid = (new > 1e-12) & (new < 1.0 - 1e-12)
    new = np.where(valid, new, share)
    change = np.log(new * (1.0 - new)) - np.log(share * (1.0 - share))
    return new, np.where(valid, change, -np.inf)


def _wishart_root(n: int, dof: float, rng: np.random.Generator) -> FloatArray:
    """Draw lower triangular roots of standard Wishart matrices (Bartlett), shape (n, 6, 6)."""
    root = np.tril(rng.standard_normal((n, N_COORDINATE, N_COORDINATE)), -1)
    diagonal = np.sqrt(rng.chisquare(dof - np.arange(N_COORDINATE), (n, N_COORDINATE)))
    root[:, np.arange(N_COORDINATE), np.arange(N_COORDINATE)] = diagonal
    return np.asarray(root)
