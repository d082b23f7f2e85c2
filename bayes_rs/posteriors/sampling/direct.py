"""Direct sampling: independent draws of fitted proposals, corrected to the posterior by importance weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import laplace_proposal
from bayes_rs.posteriors.sampling.candidates import Candidates, joined, resampled
from bayes_rs.posteriors.sampling.chains import N_CHAIN, N_ENSEMBLE, Chains, empty_chains, kept_draws, records_together
from bayes_rs.posteriors.sampling.effort import Effort
from bayes_rs.posteriors.sampling.pareto import pareto_k
from bayes_rs.posteriors.sampling.points import rotations
from bayes_rs.posteriors.sampling.streams import RecordStreams

PILOT = 4
"""One in so many of the first draws comes from the proposal at the mode; the others, from one fitted to those."""
MOST_PILOT = 1024
"""Draws of an ensemble's pilot, at most."""
_RESAMPLING = 0.25
"""Largest variance of the number of copies that systematic resampling makes of one draw."""


def sample_direct(posterior: Posterior, *, streams: RecordStreams, effort: Effort) -> Chains:
    """Draw from Student-t distributions fitted to each record, weigh, and resample to draws of equal weight.

    Parameters
    ----------
    posterior : Posterior
        Posterior of n_record records.
    streams : RecordStreams
        Their random streams.
    effort : Effort
        Effective sample size to reach, and how often the number of a record's proposals may be doubled for it; its
        proposal is fitted again each time.

    Returns
    -------
    chains : Chains
        Independent draws; how they are shared out over chains means nothing. The effective sample size is
        1/(Σ wᵢ² + ¼/n) for normalized weights w and n draws kept, which holds for independent proposals.

    Notes
    -----
    A quarter of the first draws, the pilot, comes from the proposal at the record's mode. The proposal is then fitted
    to these draws, and all draws weigh as ones of the mixture of both (`Candidates`). Draws that were evaluated are
    kept when there are to be more.

    The proposals of an ensemble are scrambled Sobol sequences, shared by all records and turned for each by a random
    rotation of its own, so that every record integrates with much less scatter than independent draws have. The four
    ensembles are scrambled and turned independently; R-hat compares them. Means of weighted draws are biased by the
    order of 1/n of a posterior standard deviation.

    References
    ----------
    Owen (2023), Practical Quasi-Monte Carlo Integration, Ch. 17, https://artowen.su.domains/mc/practicalqmc.pdf.
    Veach and Guibas (1995), SIGGRAPH 95, 419–428, doi:10.1145/218380.218498 (several proposals).
    """
    n_draw = kept_draws(effort.target_ess)
    size = n_draw * N_CHAIN // N_ENSEMBLE  # of an ensemble
    n_record, k = posterior.n_record, posterior.n_coordinate
    everyone = np.arange(n_record)
    proposal = laplace_proposal(posterior)
    rotation = rotations(streams, everyone, N_ENSEMBLE, k)
    chains = empty_chains(n_record, n_draw, k, "direct")
    batch = records_together(n_draw)
    rest = _Rest(posterior, streams, effort, chains, [[] for _ in range(effort.max_extension)])
    for start in range(0, n_record, batch):
        records = everyone[start : start + batch]
        found = Candidates(posterior.take(records), rotation[records], effort.seed)
        found.draw(proposal.take(records), min(size // PILOT, MOST_PILOT))
        found.draw(found.fitted(), size - found.total_size)
        rest.keep(found, records, 0)
    rest.finish()
    return chains


@dataclass
class _Rest:
    """Records whose candidates fall short: they wait until there are enough of them to be doubled together.

    Parameters
    ----------
    posterior : Posterior
        Posterior of all records.
    streams : RecordStreams
        Their random streams.
    effort : Effort
        Effective sample size to reach.
    chains : Chains
        What is made of the candidates.
    waiting : list of list
        Records, candidates and weights of those that were doubled 0, 1, … times.
    """

    posterior: Posterior
    streams: RecordStreams
    effort: Effort
    chains: Chains
    waiting: list[list[tuple[NDArray[np.int64], Candidates, FloatArray]]]

    def keep(self, found: Candidates, records: NDArray[np.int64], extension: int) -> None:
        """Fill the chains of some records from candidates that were doubled so often; those that fall short wait."""
        weight = _keep(found, records, self.streams, self.chains)
        short = np.flatnonzero(self.chains.missed(self.effort.target_ess)[records])
        if len(short) == 0 or extension >= len(self.waiting):
            return
        self.waiting[extension].append((records[short], found.take(short), weight[short]))
        if sum(len(some) for some, _, _ in self.waiting[extension]) >= self._together(extension):
            self._double(extension)

    def finish(self) -> None:
        """Double those that wait, and again."""
        for extension in range(len(self.waiting)):
            self._double(extension)

    def _together(self, extension: int) -> int:
        """Return how many records are doubled together: fewer, the more candidates each has."""
        return max(1, records_together(self.chains.stress.shape[2]) >> (extension + 1))

    def _double(self, extension: int) -> None:
        waiting, self.waiting[extension] = self.waiting[extension], []
        if not waiting:
            return
        records, parts, weights = zip(*waiting, strict=True)
        numbers, weight = np.concatenate(records), np.concatenate(weights)
        found = joined(parts, self.posterior.take(numbers))
        together = self._together(extension)
        for start in range(0, len(numbers), together):
            some = np.arange(start, min(start + together, len(numbers)))
            part = found.take(some)
            part.draw(part.fitted_with(weight[some]), part.total_size)
            self.keep(part, numbers[some], extension + 1)


def _keep(found: Candidates, records: NDArray[np.int64], streams: RecordStreams, chains: Chains) -> FloatArray:
    """Fill the chains of some records from their candidates, and return the weights of these."""
    n = len(records)
    weight, log_weight = found.weight()
    n_keep = chains.stress.shape[1] * chains.stress.shape[2]
    square = np.sum(weight * weight, axis=(1, 2))
    picked = resampled(weight, streams.uniform(records, (N_ENSEMBLE,)), n_keep)
    tail = pareto_k(log_weight.reshape(n, -1))
    # weights are all equal where the density is nowhere above zero: such a record has no draws of its posterior
    effective = np.where(np.isneginf(tail), np.nan, 1.0 / (square + _RESAMPLING / n_keep))
    chains.pick_draws(records, found.all_coordinates(), found.all_stresses(), picked)
    chains.ess_bulk[records] = effective[:, None]
    chains.ess_tail[records] = effective[:, None]
    chains.r_hat[records] = _plain_r_hat(np.moveaxis(chains.stress, -1, 1)[records])
    chains.acceptance[records] = 1.0 / (square * weight[0].size)
    chains.n_step[records] = weight[0].size // N_CHAIN
    chains.pareto_k[records] = tail
    return weight


def _plain_r_hat(stress: FloatArray) -> FloatArray:
    """Return R-hat between the ensembles, shape (n_record, 6), of independent draws (n_record, 6, …): of each in turn.

    The draws are overwritten.
    """
    by_ensemble = stress.reshape(*stress.shape[:2], N_ENSEMBLE, -1)
    n = by_ensemble.shape[-1]
    mean = by_ensemble.mean(axis=-1)
    by_ensemble -= mean[..., None]
    within = np.sum(np.square(by_ensemble, out=by_ensemble), axis=(-2, -1)) / (N_ENSEMBLE * (n - 1.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((n - 1.0) / n + mean.var(axis=-1, ddof=1) / within))
