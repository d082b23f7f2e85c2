"""Sample a campaign: its records and the distribution that they come from, together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_rs._validation import FloatArray, as_generator
from bayes_rs.campaign.campaign_posterior import CampaignPosterior
from bayes_rs.campaign.cells import Cells, make_cells
from bayes_rs.campaign.conjugate import HyperMoves
from bayes_rs.campaign.hyperprior import Hyper, draw_coordinates, draw_hyper
from bayes_rs.campaign.learning import hyper_table, hyper_values, learnt_prior
from bayes_rs.campaign.record_moves import RecordMoves, expand, unseen_directions
from bayes_rs.errors import InputError
from bayes_rs.intervals import EQUAL_TAILED
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import laplace_proposal
from bayes_rs.priors.interface import N_COORDINATE, LogRatioPrior, Prior

LEAST_RECORDS = 20
"""Below this number of records a campaign says little more than they do one by one."""
MOST_RECORDS = 1500
"""More records than this tell little more of the hyperparameters: `choose_records` takes a sample of them."""
N_CHAIN = 4
TARGET_ESS = 100
R_HAT_LIMIT = 1.05
N_PRIOR_CAMPAIGN = 400
"""Campaigns without data that tell what the data decided."""
MOST_KEPT = 256
"""Draws of the records that are kept of each chain: this to twice as many."""
_TOGETHER = 1200
"""Records times chains that cost little more than fewer."""
_STRIDE = 2
"""Sweeps from one kept draw of the hyperparameters to the next."""
_CARRYING = ("shift", "spread", "row", "pair", "row")
"""Moves of each sweep that carry the records along."""
_EACH_WALK = 4
"""Sweeps from one random walk of the records to the next."""
_BURN_IN = (50, 75, 100, 125)
"""Sweeps of the parts of the burn-in; the proposals are shaped anew after each."""
_START = 0.125
"""Least variance that the records have in any direction when chains begin."""
_MEMORY = 0.95
"""Correlation of an unseen level of the means from one sweep to the next: slow enough for the records to follow."""
_BLOCK = 250
"""Sweeps between two looks at the effective sample size."""


def can_learn(prior: Prior) -> bool:
    """Tell whether a campaign can begin with a prior: its coordinates must be standard normal, as those of ``weak``."""
    return isinstance(prior, LogRatioPrior)


def sample_campaign(
    posterior: Posterior,
    wind_speed: FloatArray,
    *,
    group: Sequence[object] | None = None,
    seed: int | np.random.Generator,
    target_ess: int = TARGET_ESS,
    most_sweeps: int = 8000,
    n_chain: int | None = None,
    interval: str = EQUAL_TAILED,
) -> CampaignPosterior:
    """Sample the records of a campaign together with the distribution that they come from.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records under a prior with standard normal coordinates (`can_learn`).
    wind_speed : ndarray, shape (n_record,)
        Their mean wind speeds, m/s, above zero.
    group : sequence of n_record, optional
        Class of each record: its stresses' distribution may have a mean of its own, partially pooled.
    seed : int or numpy.random.Generator
        Seed.
    target_ess : int
        Effective sample size that hyperparameters and campaign means must reach.
    most_sweeps : int
        Bound on the sweeps of a chain after burn-in.
    n_chain : int
        Independent chains; by default 4, and 8 for up to 150 records, whose chains cost little.
    interval : {"equal-tailed", "highest-density"}
        Which intervals the table of hyperparameters has.

    Returns
    -------
    campaign : CampaignPosterior
        The draws, the learnt prior, and how the sampler did.

    Raises
    ------
    InputError
        If the prior is not one to begin with, or the wind speeds or groups do not fit the records.
    """
    base = posterior.prior
    if not isinstance(base, LogRatioPrior):
        raise InputError(
            f"Prior {base.name!r} cannot begin a campaign: its coordinates must be independent and standard normal; "
            "give 'weak' or 'ratio', or switch the campaign off."
        )
    speed = np.asarray(wind_speed, dtype=np.float64)
    if speed.shape != (posterior.n_record,):
        raise InputError(
            f"Invalid wind_speed of shape {speed.shape}: there must be one for each of {posterior.n_record} records."
        )
    rng = as_generator(seed)
    if n_chain is None:
        n_chain = N_CHAIN * int(np.clip(_TOGETHER // (N_CHAIN * len(speed)), 1, 2))
    given = make_cells(speed, group)
    order, cells = given.order(), given.in_order()
    run = _Run(posterior.take(order), base, cells, rng, n_chain)
    run.burn_in()
    ess, r_hat, done = 0.0, np.inf, False
    while run.n_sweep < most_sweeps:
        run.advance(min(_BLOCK, most_sweeps - run.n_sweep))
        ess, r_hat, done = run.effective(target_ess)
        if done:
            break
    hyper = run.hyper_draws()
    values = {name: value.reshape(n_chain, -1) for name, value in hyper_values(base, hyper, cells).items()}
    back = np.argsort(order)
    kept = np.stack(run.kept, axis=1).transpose(2, 1, 3, 0)[:, :, back]  # (n_chain, n_draw, n_record, 6)
    prior = draw_hyper(N_PRIOR_CAMPAIGN, cells, rng)
    return CampaignPosterior(
        prior=learnt_prior(base, hyper, cells),
        stress=base.stress(kept.astype(np.float64)),
        wind_speed=speed,
        group=tuple("" if group is None else str(one) for one in (group if group is not None else speed)),
        hyper=hyper_table(base, values, cells, rng, interval),
        acceptance=run.acceptance(),
        n_sweep=run.n_sweep,
        ess=ess,
        r_hat=r_hat,
        converged=done,
        prior_stress=base.stress(draw_coordinates(prior, given, rng)),
    )


class _Run:
    """The chains of a campaign, and what is kept of them."""

    def __init__(
        self, posterior: Posterior, base: LogRatioPrior, cells: Cells, rng: np.random.Generator, n_chain: int
    ) -> None:
        self.posterior, self.base, self.cells, self.rng = posterior, base, cells, rng
        self.n_sweep = 0
        self.kept: list[FloatArray] = []
        self.stride = _STRIDE
        self.hypers: list[Hyper] = []
        self.means: list[FloatArray] = []
        mode = np.ascontiguousarray(laplace_proposal(posterior).mode.T)
        self.moves = RecordMoves(posterior, cells, expand(posterior, mode), rng)
        self.hyper_moves = HyperMoves(cells, rng)
        # chains begin apart: at hyperparameters of the hyperprior, and records a little off their modes; but no Σ
        # begins so narrow that the means of the bins follow the records' modes, from where it is a long way back
        hyper = draw_hyper(n_chain, cells, rng)
        hyper = hyper.with_scatter(0.5 * hyper.scatter + _START * np.eye(N_COORDINATE))
        self.unseen = unseen_directions(posterior, mode.mean(axis=1))
        self.level = rng.standard_normal((n_chain, self.unseen.shape[1]))
        mode = np.repeat(mode[:, None, :], n_chain, axis=1)
        start = mode + 0.1 * rng.standard_normal(mode.shape)
        start = np.where(np.isfinite(self.moves.log_likelihood(start)), start, mode)
        self.state = self.moves.place(hyper, start, self.moves.log_likelihood(start))

    @property
    def _tallies(self) -> tuple[RecordMoves | HyperMoves, ...]:
        return self.moves, self.hyper_moves

    def burn_in(self) -> None:
        """Let the chains forget where they began, and shape the proposals; no draw is kept."""
        for length in _BURN_IN:
            total, scatter = np.zeros(self.state.coordinate[:, 0].shape), np.zeros(N_COORDINATE)
            for sweep in range(length):
                self._sweep(sweep, adapt=True)
                total += self.state.coordinate.mean(axis=1) / length
                scatter += np.einsum("nii->i", self.state.hyper.scatter) / (length * len(self.state.hyper))
            self.moves.shape_by(expand(self.posterior, total), scatter)
        for tally in self._tallies:
            tally.tried, tally.accepted = dict.fromkeys(tally.tried, 0.0), dict.fromkeys(tally.tried, 0.0)

    def advance(self, n_sweep: int) -> None:
        """Make sweeps, and keep what is needed of them."""
        for sweep in range(n_sweep):
            self._sweep(sweep, adapt=False)
            self.n_sweep += 1
            if self.n_sweep % _STRIDE == 0:
                self.hypers.append(self.state.hyper.alone())
                stress = self.base.stress(self.state.coordinate[:N_COORDINATE].transpose(1, 2, 0))
                self.means.append(stress.mean(axis=1))
            if self.n_sweep % self.stride == 0:
                self.kept.append(self.state.coordinate[:N_COORDINATE].astype(np.float32))
                if len(self.kept) >= 2 * MOST_KEPT:
                    self.kept = self.kept[1::2]
                    self.stride *= 2

    def _sweep(self, sweep: int, *, adapt: bool) -> None:
        state = self.state
        hyper = self.hyper_moves.move(state.hyper, state.coordinate[:N_COORDINATE], turn=sweep, adapt=adapt)
        state = self.moves.place(hyper, state.coordinate, state.height)
        state = self.moves.move_records(state, walk=sweep % _EACH_WALK == 0)
        for kind in _CARRYING:
            state = self.moves.carry(state, kind, adapt=adapt)
        if self.unseen.shape[1]:
            self.level *= _MEMORY
            self.level += np.sqrt(1.0 - _MEMORY**2) * self.rng.standard_normal(self.level.shape)
            state = self.moves.release(state, self.unseen, self.level)
        self.state = state

    def hyper_draws(self) -> Hyper:
        """Return the kept hyperparameters of all chains, shape (n_chain · n_draw, …), chain by chain."""
        return Hyper(
            *(
                np.stack([getattr(one, name) for one in self.hypers], axis=1).reshape(
                    -1, *getattr(self.hypers[0], name).shape[1:]
                )
                for name in ("scatter", "speed_share", "group_share", "score")
            )
        )

    def effective(self, target_ess: float) -> tuple[float, float, bool]:
        """Return the smallest effective size and largest R-hat of all means, and whether the target is reached.

        What moves more slowly must have a quarter of the target: the standard deviations, with R-hat below 1.1, and
        the correlations.
        """
        n_chain = len(self.state.hyper)
        values = hyper_values(self.base, self.hyper_draws(), self.cells)
        means = [value.reshape(n_chain, -1) for name, value in values.items() if name.startswith("mean")]
        means += list(np.moveaxis(np.stack(self.means, axis=-1), 1, 0))  # those of stresses, (n_chain, n_draw) each
        scatter = [value.reshape(n_chain, -1) for name, value in values.items() if name.startswith("sd")]
        shape = [value.reshape(n_chain, -1) for name, value in values.items() if name.startswith("corr")]
        of_means = diagnostics.diagnose(np.stack(means), n_chain)
        of_scatter = diagnostics.diagnose(np.stack(scatter), n_chain)
        of_shape = diagnostics.diagnose(np.stack(shape), n_chain)
        ess, r_hat = float(of_means.ess_bulk.min()), float(of_means.r_hat.max())
        done = ess >= target_ess and r_hat < R_HAT_LIMIT
        done = done and bool(of_scatter.ess_bulk.min() >= 0.25 * target_ess and of_scatter.r_hat.max() < 1.1)
        done = done and bool(of_shape.ess_bulk.min() >= 0.25 * target_ess)
        return ess, r_hat, done

    def acceptance(self) -> dict[str, float]:
        """Return the accepted share of each kind of move."""
        return {
            name: tally.accepted[name] / tried
            for tally in self._tallies
            for name, tried in tally.tried.items()
            if tried
        }
