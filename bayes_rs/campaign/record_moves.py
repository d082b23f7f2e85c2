"""Moves that need the records' likelihoods: of the records, and of the hyperparameters with the records carried along.

Arrays have the many last, so that NumPy's loops are long: coordinates are (n, n_chain, n_record).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.campaign import small_matrices
from bayes_rs.campaign.cells import Cells
from bayes_rs.campaign.hyperprior import (
    Hyper,
    group_root,
    row_of_scores,
    scatter_odds,
    scatter_of_odds,
    scores_of_row,
)
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.priors.interface import N_COORDINATE

_STEP = 1e-4
"""Central difference step of the coordinates; it only shapes proposals."""
_DOF = 8.0
"""Degrees of freedom of the independence proposal."""
_UNSEEN = 1.0
"""Precision, of the prior's, up to which a direction is unseen: all records together say less than the prior does."""
_KINDS = ("shift", "pair", "spread", "row")
_SIZES = np.array([0.3, 1.0, 3.0])
"""Steps are of these sizes at random: a scatter is known better where it is large than where it is small."""
_WALKS = np.array([0.3, 1.0, 2.4])
"""The same of the records' walk, before they are divided by the root of the number of coordinates."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """Normal approximation of each record's likelihood: exp(linear · z − ½ z precision z).

    Parameters
    ----------
    precision : ndarray, shape (n, n, n_record)
        Jᵀ J, with J the Jacobian of the whitened residuals.
    linear : ndarray, shape (n, n_record)
        Linear term.
    """

    precision: FloatArray
    linear: FloatArray


def expand(posterior: Posterior, at: FloatArray) -> Expansion:
    """Expand the likelihood of each record about coordinates, shape (n, n_record)."""
    n = posterior.n_coordinate
    around = at.T[:, None, :] + _STEP * np.concatenate([np.eye(n), -np.eye(n)])
    seen = posterior.seen(around)
    residual = posterior.likelihood.whitened_residual(*seen)
    jacobian = (residual[:, :n] - residual[:, n:]) / (2.0 * _STEP)
    height = posterior.likelihood.log_density(*seen)
    with np.errstate(invalid="ignore"):  # two points without density have no slope
        gradient = (height[:, :n] - height[:, n:]) / (2.0 * _STEP)
    usable = np.asarray(np.isfinite(gradient).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2)))
    jacobian = np.where(usable[:, None, None], jacobian, 0.0)
    gradient = np.where(usable[:, None], gradient, 0.0)
    precision = jacobian @ jacobian.swapaxes(-1, -2)
    linear = gradient + (precision @ at.T[..., None])[..., 0]
    return Expansion(np.ascontiguousarray(np.moveaxis(precision, 0, -1)), np.ascontiguousarray(linear.T))


def unseen_directions(posterior: Posterior, at: FloatArray) -> FloatArray:
    """Return the directions of the coordinates that all records together do not see, orthonormal, shape (6, n_unseen).

    Parameters
    ----------
    posterior : Posterior
        Posterior of the records.
    at : ndarray, shape (n,)
        The coordinates, one point for all records: where a scan does not see a combination of the stresses, the
        likelihoods of all have no slope in the same direction there. Wind from changing directions may show it.
    """
    point = np.repeat(at[:, None], posterior.n_record, axis=1)
    told = expand(posterior, point).precision[:N_COORDINATE, :N_COORDINATE].sum(axis=-1)
    strength, direction = np.linalg.eigh(told)
    return np.asarray(direction[:, strength < _UNSEEN])


@dataclass(frozen=True, eq=False)
class Frame:
    """The normal approximation of the records' posteriors, given the hyperparameters.

    Parameters
    ----------
    mean : ndarray, shape (n, n_chain, n_record)
        Means of the records' priors.
    of_prior : ndarray, shape (n_chain, n, n)
        Precisions of the records' priors.
    log_prior_volume : ndarray, shape (n_chain,)
        ½ ln det of these.
    lower : ndarray, shape (n, n, n_chain, n_record)
        L, with L Lᵀ the precision of the approximation.
    middle : ndarray, shape (n, n_chain, n_record)
        Lᵀ m, with m its mean.
    log_volume : ndarray, shape (n_chain, n_record)
        ln det L.
    """

    mean: FloatArray
    of_prior: FloatArray
    log_prior_volume: FloatArray
    lower: FloatArray
    middle: FloatArray
    log_volume: FloatArray

    def log_prior(self, z: FloatArray) -> FloatArray:
        """Return the log-density of the records' priors, up to a constant, shape (n_chain, n_record)."""
        centred = (z - self.mean).swapaxes(0, 1)  # (n_chain, n, n_record)
        square = np.einsum("cir,cir->cr", centred, self.of_prior @ centred)
        return np.asarray(self.log_prior_volume[:, None] - 0.5 * square)

    def score(self, z: FloatArray) -> FloatArray:
        """Return Lᵀ (z − m): standard normal numbers, as far as the approximation holds."""
        return small_matrices.times_upper(self.lower, z) - self.middle

    def place(self, score: FloatArray) -> FloatArray:
        """Return z with the score that is given."""
        return small_matrices.solve_upper(self.lower, self.middle + score)


@dataclass(frozen=True, eq=False)
class State:
    """Where all chains are.

    Parameters
    ----------
    hyper : Hyper
        Hyperparameters, one entry a chain.
    coordinate : ndarray, shape (n, n_chain, n_record)
        Coordinates of the records, nuisances last.
    height : ndarray, shape (n_chain, n_record)
        Log-likelihoods of the records.
    frame : Frame
        The normal approximation at the hyperparameters.
    score : ndarray, shape (n, n_chain, n_record)
        What the frame makes of the coordinates.
    log_prior : ndarray, shape (n_chain, n_record)
        Log-densities of the records' priors.
    """

    hyper: Hyper
    coordinate: FloatArray
    height: FloatArray
    frame: Frame
    score: FloatArray
    log_prior: FloatArray


class RecordMoves:
    """Moves that need the records' likelihoods.

    Parameters
    ----------
    posterior : Posterior
        Posterior of the records, sorted by cells; its prior gives the map to stresses alone.
    cells : Cells
        Their cells.
    expansion : Expansion
        What shapes the proposals; any is exact.
    rng : numpy.random.Generator
        Source of random numbers.
    """

    def __init__(self, posterior: Posterior, cells: Cells, expansion: Expansion, rng: np.random.Generator) -> None:
        self.posterior = posterior
        self.likelihood = posterior.likelihood.records_last()
        self.cells = cells
        self.rng = rng
        self.log_step = {kind: np.zeros((N_COORDINATE, N_COORDINATE)) for kind in _KINDS}
        self.tried = dict.fromkeys(("records, independent", "records, walk", *_KINDS), 0.0)
        self.accepted = dict.fromkeys(self.tried, 0.0)
        self.shape_by(expansion, np.full(N_COORDINATE, 0.25))

    def shape_by(self, expansion: Expansion, scatter: FloatArray) -> None:
        """Take another expansion, and typical variances (6,) of the coordinates, to shape the proposals."""
        self.expansion = expansion
        mean = expansion.precision[:N_COORDINATE, :N_COORDINATE].mean(axis=-1)
        told, self.axes = np.linalg.eigh(mean)
        spread = np.einsum("ji,j->i", self.axes**2, scatter)
        known = np.maximum(told, 0.0) * spread
        known = known / (1.0 + known)  # share of a record's scatter that its own data tell
        n_record = self.cells.n_record
        self.scale = {"shift": 1.0 / np.sqrt(1.0 + n_record * known / spread), "spread": np.ones(N_COORDINATE)}
        # what the data tell well the other moves know, too: these are for what they tell badly
        self.chance = {kind: _chances(1.0 - known) for kind in _KINDS}
        self.chance["spread"] = self.chance["row"] = _chances(1.0 - self.axes**2 @ known)
        self.pair_scale = np.sqrt(spread[:, None] / spread) / np.sqrt(4.0 + n_record * known[:, None] * known)

    def log_likelihood(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-likelihoods, shape (n_chain, n_record)."""
        return np.asarray(self.likelihood.log_density(*self.posterior.seen(coordinate.transpose(2, 1, 0))).T)

    def frame(self, hyper: Hyper, *, like: Frame | None = None) -> Frame:
        """Return the normal approximation at hyperparameters; `like` is one at the same Σ and other means."""
        d, n_chain, of_record = self.posterior.n_coordinate, len(hyper), self.cells.of_record
        of_cell = hyper.means(self.cells)
        both = np.zeros((2, d, n_chain, of_cell.shape[1]))
        both[0, :N_COORDINATE] = np.moveaxis(of_cell, -1, 0)
        both[1, :N_COORDINATE] = np.moveaxis(of_cell @ hyper.precision, -1, 0)
        mean, pulled = np.take(both, of_record, axis=-1)
        pulled += self.expansion.linear[:, None, :]
        if like is not None:
            return replace(like, mean=mean, middle=small_matrices.solve_lower(like.lower, pulled))
        of_prior = np.zeros((n_chain, d, d))
        of_prior[:, :N_COORDINATE, :N_COORDINATE] = hyper.precision
        extra = np.arange(N_COORDINATE, d)
        of_prior[:, extra, extra] = 1.0
        lower = small_matrices.factor(self.expansion.precision, np.moveaxis(of_prior, 0, -1))
        return Frame(
            mean,
            of_prior,
            -0.5 * hyper.log_det,
            lower,
            small_matrices.solve_lower(lower, pulled),
            small_matrices.log_diagonal(lower),
        )

    def place(self, hyper: Hyper, coordinate: FloatArray, height: FloatArray) -> State:
        """Return the state of these hyperparameters and records."""
        frame = self.frame(hyper)
        return State(hyper, coordinate, height, frame, frame.score(coordinate), frame.log_prior(coordinate))

    def move_records(self, state: State, *, walk: bool) -> State:
        """Move every record by itself: by the independence proposal and, if asked, by a walk of the same shape."""
        d = self.posterior.n_coordinate

        def log_proposal(score: FloatArray) -> FloatArray:
            return np.asarray(-0.5 * (_DOF + d) * np.log1p(np.einsum("icr,icr->cr", score, score) / _DOF))

        new = self.rng.standard_normal(state.score.shape)
        new *= np.sqrt(_DOF / (2.0 * self.rng.standard_gamma(0.5 * _DOF, state.height.shape)))
        state = self._settle_records("records, independent", state, new, log_proposal(state.score) - log_proposal(new))
        if walk:
            size = _one_of(_WALKS, state.height.shape, self.rng) / np.sqrt(d)
            step = self.rng.standard_normal(state.score.shape) * size
            state = self._settle_records("records, walk", state, state.score + step, 0.0)
        return state

    def _settle_records(self, what: str, state: State, score: FloatArray, log_ratio: FloatArray | float) -> State:
        """Accept or reject new scores of the records, each by itself."""
        trial = state.frame.place(score)
        height, log_prior = self.log_likelihood(trial), state.frame.log_prior(trial)
        accept = self._accept(what, log_ratio + (height - state.height) + (log_prior - state.log_prior))
        for now, then in (
            (state.coordinate, trial),
            (state.score, score),
            (state.height, height),
            (state.log_prior, log_prior),
        ):
            np.copyto(then, now, where=~accept)
        return State(state.hyper, trial, height, state.frame, score, log_prior)

    def carry(self, state: State, kind: str, *, adapt: bool) -> State:
        """Make a move that carries the records along: of the means (``"shift"``), or of Σ (the others).

        Its axis, or coordinate, is chosen at random: more often one that the data tell badly.
        """
        axis = int(np.searchsorted(np.cumsum(self.chance[kind])[:-1], self.rng.uniform()))
        if kind == "shift":
            return self.shift(state, axis, adapt=adapt)
        if kind == "row":
            return self.row(state, axis, adapt=adapt)
        return self.stretch(state, kind, axis, adapt=adapt)

    def shift(self, state: State, axis: int, *, adapt: bool) -> State:
        """Move the means, of all groups or of one, along an axis."""
        hyper, cells = state.hyper, self.cells
        n_chain = len(hyper)
        step = self._steps("shift", (axis, axis), n_chain)
        step *= self.scale["shift"][axis] * self.rng.standard_normal(n_chain)
        which = np.ones((n_chain, cells.n_group))
        if cells.n_group > 1:
            one = self.rng.integers(2 * cells.n_group, size=n_chain)  # half of the moves are of one group
            which[one < cells.n_group] = np.eye(cells.n_group)[one[one < cells.n_group]]
        # in the numbers γ, of which the means are F D γ
        change = np.linalg.solve(hyper.root, np.broadcast_to(self.axes[:, axis, None], (n_chain, 6, 1)))
        change = change[..., 0] * step[:, None]
        change[:, -1] /= np.sqrt(1.0 - hyper.speed_share)
        between = np.linalg.solve(group_root(hyper.group_share, cells.n_group), which[..., None])[..., 0]
        score = hyper.score.copy()
        score[:, : N_COORDINATE * cells.n_group] += (change[:, :, None] * between[:, None, :]).reshape(n_chain, -1)
        log_ratio = 0.5 * np.sum(hyper.score**2 - score**2, axis=1)
        moved = hyper.with_score(score)
        frame = self.frame(moved, like=state.frame)
        return self._carry("shift", (axis, axis), state, moved, frame, log_ratio, adapt=adapt)

    def release(self, state: State, directions: FloatArray, level: FloatArray) -> State:
        """Put the mean of all cells, along directions (6, k), to levels (n_chain, k) of its prior there.

        No likelihood decides: what the hyperparameters of other directions say of these is cut off. The records are
        taken along as by the other moves.
        """
        hyper, cells = state.hyper, self.cells
        n_chain = len(hyper)
        free = np.eye(N_COORDINATE) - hyper.scatter
        root = np.linalg.cholesky(directions.T @ free @ directions)
        share = cells.count / cells.count.sum()
        mean = np.einsum("ncj,c->nj", hyper.means(cells), share)
        missing = (root @ level[..., None])[..., 0] - mean @ directions
        change = np.linalg.solve(hyper.root, (missing @ directions.T)[..., None])[..., 0]
        change[:, -1] /= np.sqrt(1.0 - hyper.speed_share)
        alike = np.ones((n_chain, cells.n_group, 1))
        between = np.linalg.solve(group_root(hyper.group_share, cells.n_group), alike)[..., 0]
        score = hyper.score.copy()
        score[:, : N_COORDINATE * cells.n_group] += (change[:, :, None] * between[:, None, :]).reshape(n_chain, -1)
        moved = hyper.with_score(score)
        frame = self.frame(moved, like=state.frame)
        trial = frame.place(state.score)
        height = self.log_likelihood(trial)
        accept = np.asarray(np.isfinite(height).all(axis=1))
        return self._mixed(state, State(moved, trial, height, frame, state.score, frame.log_prior(trial)), accept)

    def stretch(self, state: State, kind: str, axis: int, *, adapt: bool) -> State:
        """Change Σ: the spread of a coordinate, or what an axis has in common with another.

        The odds O of Σ, which have no upper bound, become A O Aᵀ with A = exp(q bᵀ), q the axis and b random: A⁻¹ is as
        probable as A, and the measure of O grows by |A|⁷. The scores of the means are held fixed.

        Parameters
        ----------
        state : State
            Where the chains are.
        kind : str
            ``"pair"`` or ``"spread"``.
        axis : int
            Which axis, or coordinate.
        adapt : bool
            Whether the step is adapted.

        Returns
        -------
        state : State
            Where they are then.
        """
        hyper = state.hyper
        n_chain = len(hyper)
        basis = np.eye(N_COORDINATE) if kind == "spread" else self.axes
        other = int(self.rng.integers(N_COORDINATE)) if kind == "pair" else axis
        scale = 2.0 * self.pair_scale[axis, other] if kind == "pair" else self.scale[kind][axis]
        step = self._steps(kind, (axis, other), n_chain) * scale * self.rng.standard_normal(n_chain)
        slope = step[:, None] * basis[:, other]
        rate = slope @ basis[:, axis]
        growth = np.where(np.abs(rate) > 1e-8, np.expm1(rate) / np.where(np.abs(rate) > 1e-8, rate, 1.0), 1.0)
        matrix = np.eye(N_COORDINATE) + basis[:, axis, None] * (growth[:, None] * slope)[:, None, :]
        odds = scatter_odds(hyper.scatter)
        _, volume = scatter_of_odds(odds)
        scatter, new_volume = scatter_of_odds(matrix @ odds @ matrix.swapaxes(-1, -2))
        new = hyper.with_scatter(scatter)
        log_ratio = new.log_density - hyper.log_density + new_volume - volume + (N_COORDINATE + 1.0) * rate
        new = hyper.where(np.isfinite(log_ratio), new)
        return self._carry(kind, (axis, other), state, new, self.frame(new), log_ratio, adapt=adapt)

    def row(self, state: State, axis: int, *, adapt: bool) -> State:
        """Change the spread of a coordinate and all its correlations at once, with the steps of an autoregression.

        With the coordinate last, and the others before it in any order, its spread and partial correlations are
        independent of the rest of Σ under the hyperprior. As normal scores x they become √(1 − b²) x + b times new
        ones, which leaves the hyperprior as it is: what the data tell badly moves far (Neal 1999; Cotter et al. 2013).
        """
        hyper = state.hyper
        n_chain = len(hyper)
        order = np.append(self.rng.permutation(np.delete(np.arange(N_COORDINATE), axis)), axis)
        lower = np.asarray(np.linalg.cholesky(hyper.scatter[:, order[:, None], order]), dtype=np.float64)
        score = scores_of_row(lower[:, -1])
        size = np.minimum(self._steps("row", (axis, axis), n_chain), 1.0)[:, None]
        score = np.sqrt((1.0 - size) * (1.0 + size)) * score + size * self.rng.standard_normal(score.shape)
        lower[:, -1] = row_of_scores(score)
        scatter = np.empty_like(lower)
        scatter[:, order[:, None], order] = lower @ lower.swapaxes(-1, -2)
        new = hyper.with_scatter(scatter)
        log_ratio = np.where(np.isfinite(new.log_density), 0.0, -np.inf)
        new = hyper.where(np.isfinite(log_ratio), new)
        return self._carry("row", (axis, axis), state, new, self.frame(new), log_ratio, adapt=adapt)

    def _carry(
        self,
        kind: str,
        which: tuple[int, int],
        state: State,
        hyper: Hyper,
        frame: Frame,
        log_ratio: FloatArray,
        *,
        adapt: bool,
    ) -> State:
        """Accept or reject new hyperparameters; the records keep their scores Lᵀ (z − m) in the new approximation.

        Were the likelihoods normal, this would be a move of the hyperparameters with the records integrated out.
        """
        trial = frame.place(state.score)
        height, log_prior = self.log_likelihood(trial), frame.log_prior(trial)
        change = (height - state.height) + (log_prior - state.log_prior)
        if frame.lower is not state.frame.lower:
            change += state.frame.log_volume - frame.log_volume
        with np.errstate(invalid="ignore"):
            accept = self._accept(kind, log_ratio + np.sum(change, axis=1))
        if adapt:
            self.log_step[kind][which] += 0.5 * (accept.mean() - 0.4)
        return self._mixed(state, State(hyper, trial, height, frame, state.score, log_prior), accept)

    @staticmethod
    def _mixed(state: State, new: State, accept: NDArray[np.bool_]) -> State:
        """Return the new state of the chains that accept; what is new is written over, and not to be used again."""
        if accept.all():
            return new
        if not accept.any():
            return state
        now, then = state.frame, new.frame
        for chain in np.flatnonzero(~accept).tolist():  # one by one: an index of several copies twice
            for one, other in (
                (then.mean, now.mean),
                (then.middle, now.middle),
                (new.coordinate, state.coordinate),
            ):
                one[:, chain] = other[:, chain]
            new.height[chain], new.log_prior[chain] = state.height[chain], state.log_prior[chain]
            if then.lower is not now.lower:
                then.lower[:, :, chain] = now.lower[:, :, chain]
                then.of_prior[chain], then.log_volume[chain] = now.of_prior[chain], now.log_volume[chain]
                then.log_prior_volume[chain] = now.log_prior_volume[chain]
        return replace(new, hyper=state.hyper.where(accept, new.hyper))

    def _steps(self, kind: str, which: tuple[int, int], n_chain: int) -> FloatArray:
        """Return sizes of steps, shape (n_chain,)."""
        return np.asarray(np.exp(self.log_step[kind][which]) * _one_of(_SIZES, n_chain, self.rng))

    def _accept(self, what: str, log_ratio: FloatArray) -> NDArray[np.bool_]:
        accept = np.log(self.rng.uniform(size=log_ratio.shape)) < log_ratio
        self.tried[what] += accept.size
        self.accepted[what] += float(np.count_nonzero(accept))
        return np.asarray(accept)


def _chances(weight: FloatArray) -> FloatArray:
    """Return probabilities that are larger where the weights are, and nowhere small."""
    chance = weight + 0.1 * weight.max()
    return np.asarray(chance / chance.sum())


def _one_of(values: FloatArray, shape: int | tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Return one of the values, each as probable, for every place: as `Generator.choice`, which takes longer."""
    return np.asarray(values[rng.integers(len(values), size=shape)])
