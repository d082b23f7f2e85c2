"""The hyperprior: how a campaign's records scatter, and where their means lie, before there are data.

All arrays have the chains first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.campaign.cells import Cells
from bayes_rs.priors.interface import N_COORDINATE

ETA = 2.0
"""Exponent of the LKJ density of the correlations: 1 is flat over matrices, 2 holds them a little nearer to 0."""
MOST_SCATTER = 0.9
"""The records' own scatter is at most this share of the variance of any direction; the rest they have in common."""
LEAST_SCATTER = 1e-8
"""It is at least this share: records that differ by less than 0.0001 of the prior's width are alike."""
_AT_MOST = MOST_SCATTER * (1.0 - 1e-9)
"""So far eigenvalues come to it: what is next to it cannot be told from it, as odds cannot from infinity."""
_ORDER = np.array([1, 2, 3, 4, 5, 0])
"""The size comes last, so that the last pivot of a Cholesky factor is the variance that it has of its own."""
_HALF = 0.5 * N_COORDINATE
PARTIAL_SHAPE = ETA + 0.5 * (N_COORDINATE - 2.0 - np.arange(N_COORDINATE - 1.0))
"""a of coordinate j: ½ + ½ times the partial correlation of a later coordinate with it, given those before, has the
density Beta(a, a) (Lewandowski, Kurowicka and Joe 2009). So the last row is independent of those above it."""


def log_density_of_scatter(scatter: FloatArray) -> FloatArray:
    """Return the log-density, up to a constant, of the records' covariance Σ, shape (n,), at Σ (n, 6, 6).

    Σ = diag(τ) C diag(τ) with τ uniform on (0, 1) and C of density |C|^(η − 1) (Lewandowski, Kurowicka and Joe 2009),
    where Σ has no eigenvalue above `MOST_SCATTER`, or below `LEAST_SCATTER`; with the Jacobian of Σ in τ and C
    that is |Σ|^(η − 1) Π Σ_ii^(1 − η − 6/2).
    """
    eigenvalue = np.linalg.eigvalsh(scatter)
    inside = (eigenvalue[:, 0] > LEAST_SCATTER) & (eigenvalue[:, -1] < _AT_MOST)
    safe = np.where(inside[:, None], eigenvalue, 0.5)
    diagonal = np.where(inside[:, None], np.einsum("nii->ni", scatter), 0.5)
    density = (ETA - 1.0) * np.log(safe).sum(axis=1) - (ETA - 1.0 + _HALF) * np.log(diagonal).sum(axis=1)
    return np.where(inside, density, -np.inf)


def scatter_odds(scatter: FloatArray) -> FloatArray:
    """Return O = S (I − S)⁻¹ with S = Σ / `MOST_SCATTER`, shape (n, 6, 6): any positive definite O is of a Σ."""
    share = scatter / MOST_SCATTER
    odds = np.linalg.solve(np.eye(N_COORDINATE) - share, share)
    return np.asarray(0.5 * (odds + odds.swapaxes(-1, -2)))


def scatter_of_odds(odds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Σ of odds O, shape (n, 6, 6), and ln |dΣ/dO|, up to a constant: −7 ln |I + O|."""
    more = np.eye(N_COORDINATE) + odds
    scatter = MOST_SCATTER * np.linalg.solve(more, odds)
    log_volume = -(N_COORDINATE + 1.0) * np.linalg.slogdet(more)[1]
    return 0.5 * (scatter + scatter.swapaxes(-1, -2)), np.asarray(log_volume)


def draw_scatter(n: int, rng: np.random.Generator) -> FloatArray:
    """Draw covariances Σ from the hyperprior, shape (n, 6, 6), by rejection."""
    found: list[FloatArray] = []
    missing = n
    while missing > 0:
        scatter = _draw_untruncated(2 * missing + 16, rng)
        eigenvalue = np.linalg.eigvalsh(scatter)
        scatter = scatter[(eigenvalue[:, 0] > LEAST_SCATTER) & (eigenvalue[:, -1] < _AT_MOST)][:missing]
        found.append(scatter)
        missing -= len(scatter)
    return np.concatenate(found)


def _draw_untruncated(n: int, rng: np.random.Generator) -> FloatArray:
    """Draw diag(τ) C diag(τ), shape (n, 6, 6), by the partial correlations of C."""
    root = np.zeros((n, N_COORDINATE, N_COORDINATE))
    root[:, 0, 0] = 1.0
    for i in range(1, N_COORDINATE):
        left = np.ones(n)
        for j in range(i):
            partial = 2.0 * rng.beta(PARTIAL_SHAPE[j], PARTIAL_SHAPE[j], n) - 1.0
            root[:, i, j] = partial * np.sqrt(left)
            left -= root[:, i, j] ** 2
        root[:, i, i] = np.sqrt(left)
    root *= rng.uniform(size=(n, N_COORDINATE))[:, :, None]
    return np.asarray(root @ root.swapaxes(-1, -2))


def scores_of_row(row: FloatArray) -> FloatArray:
    """Return normal scores of the partial correlations and the spread of a coordinate, shape (n, 6).

    Parameters
    ----------
    row : ndarray, shape (n, 6)
        The last row of the Cholesky factor of Σ, with this coordinate last.

    Returns
    -------
    score : ndarray, shape (n, 6)
        Independent and standard normal under the hyperprior without its bounds of eigenvalues; the spread is last.
    """
    spread = np.sqrt(np.sum(row**2, axis=1))
    left = np.cumsum(row[:, ::-1] ** 2, axis=1)[:, :0:-1]  # what the coordinates before leave of its variance
    partial = row[:, :-1] / np.sqrt(left)
    tail = scipy.special.betainc(PARTIAL_SHAPE, PARTIAL_SHAPE, 0.5 * (1.0 - np.abs(partial)))
    score = -np.copysign(1.0, partial) * scipy.special.ndtri(tail)
    return np.concatenate([score, scipy.special.ndtri(spread)[:, None]], axis=1)


def row_of_scores(score: FloatArray) -> FloatArray:
    """Return the row of `scores_of_row`, shape (n, 6)."""
    tail = scipy.special.betaincinv(PARTIAL_SHAPE, PARTIAL_SHAPE, scipy.special.ndtr(-np.abs(score[:, :-1])))
    partial = np.copysign(1.0 - 2.0 * tail, score[:, :-1])
    row = np.empty_like(score)
    left = np.cumprod(2.0 * np.sqrt(tail * (1.0 - tail)), axis=1)  # √(1 − partial²), one after the other
    row[:, 0] = partial[:, 0]
    row[:, 1:-1] = partial[:, 1:] * left[:, :-1]
    row[:, -1] = left[:, -1]
    return np.asarray(row * scipy.special.ndtr(score[:, -1:]))


_FIELDS = ("scatter", "speed_share", "group_share", "score")
_OF_SCATTER = ("precision", "root", "log_det", "log_density")
"""What `Hyper` calculates of its Σ when it is first asked for."""


@dataclass(frozen=True, eq=False)
class Hyper:
    """Hyperparameters of n campaigns, or chains.

    Parameters
    ----------
    scatter : ndarray, shape (n, 6, 6)
        Covariance Σ of the records' coordinates about their means.
    speed_share : ndarray, shape (n,)
        φ: share of the size's own variance that depends on the wind speed.
    group_share : ndarray, shape (n,)
        κ: share of the means' variance that differs from group to group; 0 where there is one group.
    score : ndarray, shape (n, 6 n_group + n_bin)
        Independent standard normal numbers of which the means are made.

    Notes
    -----
    With V = I − Σ = F Fᵀ, where the last column of F moves the size alone, the mean of the records of bin b and group g
    is F u, and all six numbers u have variance 1: u = γ_g, but for the last, which is √(1 − φ) γ_g + √φ f_b. The γ of
    two groups have the correlation 1 − κ, the f of two bins that of `size_correlation`. So a record's coordinates have
    the covariance V + Σ = I, whatever the hyperparameters are.
    """

    scatter: FloatArray
    speed_share: FloatArray
    group_share: FloatArray
    score: FloatArray

    def __len__(self) -> int:
        """Return the number of campaigns."""
        return len(self.scatter)

    @cached_property
    def precision(self) -> FloatArray:
        """Σ⁻¹, shape (n, 6, 6)."""
        return np.asarray(np.linalg.inv(self.scatter))

    @cached_property
    def root(self) -> FloatArray:
        """F, shape (n, 6, 6), of V = F Fᵀ."""
        return mean_root(self.scatter)

    @cached_property
    def log_det(self) -> FloatArray:
        """Logarithm of the determinant of Σ, shape (n,)."""
        return np.asarray(np.linalg.slogdet(self.scatter)[1])

    @cached_property
    def log_density(self) -> FloatArray:
        """Log-density of Σ, shape (n,); see `log_density_of_scatter`."""
        return log_density_of_scatter(self.scatter)

    def means(self, cells: Cells) -> FloatArray:
        """Return the means of the cells, shape (n, n_cell, 6)."""
        root = self.root
        level = self.group_levels(cells)[:, cells.group_of]
        size = self.size_levels(cells)[:, cells.bin_of]
        level[:, :, -1] *= np.sqrt(1.0 - self.speed_share)[:, None]
        level[:, :, -1] += np.sqrt(self.speed_share)[:, None] * size
        return np.asarray(level @ root.swapaxes(-1, -2))

    def group_levels(self, cells: Cells) -> FloatArray:
        """Return γ, shape (n, n_group, 6)."""
        score = self.score[:, : N_COORDINATE * cells.n_group].reshape(len(self), N_COORDINATE, cells.n_group)
        return np.asarray(group_root(self.group_share, cells.n_group) @ score.swapaxes(-1, -2))

    def size_levels(self, cells: Cells) -> FloatArray:
        """Return f, shape (n, n_bin)."""
        return np.asarray(self.score[:, N_COORDINATE * cells.n_group :] @ cells.kernel_root.T)

    def where(self, accept: NDArray[np.bool_], other: Hyper) -> Hyper:
        """Return `other` where `accept`, and this elsewhere."""
        if accept.all():
            return other
        if not accept.any():
            return self

        def mixed(now: FloatArray, then: FloatArray) -> FloatArray:
            if now is then:
                return now
            return np.where(accept.reshape(-1, *(1,) * (now.ndim - 1)), then, now)

        found = Hyper(*(mixed(getattr(self, name), getattr(other, name)) for name in _FIELDS))
        for name in _OF_SCATTER:  # what both have calculated need not be calculated again
            if name in vars(self) and name in vars(other):
                vars(found)[name] = mixed(vars(self)[name], vars(other)[name])
        return found

    def alone(self) -> Hyper:
        """Return the same without what was calculated of it, to be kept."""
        return Hyper(self.scatter, self.speed_share, self.group_share, self.score)

    def with_score(self, score: FloatArray) -> Hyper:
        """Return the same with other scores."""
        return self._with_same_scatter(self.speed_share, self.group_share, score)

    def with_shares(self, speed_share: FloatArray, group_share: FloatArray) -> Hyper:
        """Return the same with other shares."""
        return self._with_same_scatter(speed_share, group_share, self.score)

    def with_scatter(self, scatter: FloatArray) -> Hyper:
        """Return the same with other covariances."""
        return Hyper(scatter, self.speed_share, self.group_share, self.score)

    def _with_same_scatter(self, speed_share: FloatArray, group_share: FloatArray, score: FloatArray) -> Hyper:
        found = Hyper(self.scatter, speed_share, group_share, score)
        vars(found).update({name: vars(self)[name] for name in _OF_SCATTER if name in vars(self)})
        return found


def draw_hyper(n: int, cells: Cells, rng: np.random.Generator) -> Hyper:
    """Draw hyperparameters of n campaigns."""
    group_share = rng.uniform(size=n) if cells.n_group > 1 else np.zeros(n)
    score = rng.standard_normal((n, N_COORDINATE * cells.n_group + cells.n_bin))
    return Hyper(draw_scatter(n, rng), rng.uniform(size=n), group_share, score)


def draw_coordinates(hyper: Hyper, cells: Cells, rng: np.random.Generator) -> FloatArray:
    """Draw the coordinates of all records, shape (n, n_record, 6)."""
    root = np.linalg.cholesky(hyper.scatter)
    normal = rng.standard_normal((len(hyper), len(cells.of_record), N_COORDINATE))
    return np.asarray(hyper.means(cells)[:, cells.of_record] + normal @ root.swapaxes(-1, -2))


def mean_root(scatter: FloatArray) -> FloatArray:
    """Return F, shape (n, 6, 6), with F Fᵀ = I − Σ; its last column moves the size alone."""
    free = np.eye(N_COORDINATE) - scatter
    root = np.empty_like(scatter)
    root[:, _ORDER] = np.linalg.cholesky(free[:, _ORDER[:, None], _ORDER])
    return root


def group_root(group_share: FloatArray, n_group: int) -> FloatArray:
    """Return the symmetric roots of the correlation (1 − κ) + κ δ_gh between groups, shape (n, n_group, n_group)."""
    if n_group == 1:
        return np.ones((len(group_share), 1, 1))
    own = np.sqrt(group_share)
    common = (np.sqrt(group_share + n_group * (1.0 - group_share)) - own) / n_group
    return np.asarray(common[:, None, None] + own[:, None, None] * np.eye(n_group))
