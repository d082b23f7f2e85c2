"""Direct sampling: independent draws of fitted proposals, corrected to the posterior by importance weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import laplace_proposal
from bayes_rs.posteriors.sampling.candidates import Candidates, resampled
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
    for start in range(0, n_record, batch):
        records = everyone[start : start + batch]
        found = Candidates(posterior.take(records), rotation[records], effort.seed)
        found.draw(proposal.take(records), min(size // PILOT, MOST_PILOT))
        found.draw(found.fitted(), size - found.total_size)
        _keep(found, records, streams, chains)
        _draw_more(found, records, streams, chains, effort, 1)
    return chains


def _draw_more(
    found: Candidates,
    records: NDArray[np.int64],
    streams: RecordStreams,
    chains: Chains,
    effort: Effort,
    extension: int,
) -> None:
    """Double the candidates of the records that fall short, and again; fewer records together, the more each has."""
    short = np.flatnonzero(chains.missed(effort.target_ess)[records])
    if len(short) == 0 or extension > effort.max_extension:
        return
    together = max(1, records_together(chains.stress.shape[2]) // 2**extension)
    for start in range(0, len(short), together):
        some = short[start : start + together]
        part = found.take(some)
        part.draw(part.fitted(), part.total_size)
        _keep(part, records[some], streams, chains)
        _draw_more(part, records[some], streams, chains, effort, extension + 1)


def _keep(found: Candidates, records: NDArray[np.int64], streams: RecordStreams, chains: Chains) -> None:
    """Fill the chains of some records from their candidates."""
    n = len(records)
    weight, log_weight = found.weight()
    n_keep = chains.stress.shape[1] * chains.stress.shape[2]
    square = np.sum(weight * weight, axis=(1, 2))
    picked = resampled(weight, streams.uniform(records, (N_ENSEMBLE,)), n_keep)
    coordinate, stress = (_picked(all_of, picked) for all_of in (found.all_coordinates(), found.all_stresses()))
    tail = pareto_k(log_weight.reshape(n, -1))
    # weights are all equal where the density is nowhere above zero: such a record has no draws of its posterior
    effective = np.where(np.isneginf(tail), np.nan, 1.0 / (square + _RESAMPLING / n_keep))
    chains.put_draws(records, coordinate, stress)
    chains.ess_bulk[records] = effective[:, None]
    chains.ess_tail[records] = effective[:, None]
    chains.r_hat[records] = _plain_r_hat(stress.reshape(n, N_ENSEMBLE, -1, 6))
    chains.acceptance[records] = 1.0 / (square * weight[0].size)
    chains.n_step[records] = weight[0].size // N_CHAIN
    chains.pareto_k[records] = tail


def _picked(candidate: FloatArray, index: NDArray[np.int64]) -> FloatArray:
    """Return the draws of indices (n_record, n) from candidates (n_record, k, n_set, size), shape (n_record, n, k)."""
    flat = candidate.reshape(*candidate.shape[:2], -1)
    kept = np.empty((*flat.shape[:2], index.shape[1]))
    for one, of_one, into in zip(flat, index, kept, strict=True):
        np.take(one, of_one, axis=1, out=into, mode="clip")  # all are inside; a mode makes it quick
    return kept.swapaxes(1, 2)


def _plain_r_hat(stress: FloatArray) -> FloatArray:
    """Return R-hat between the ensembles, shape (n_record, 6), of independent draws (n_record, n_ensemble, n, 6)."""
    n = stress.shape[2]
    within = stress.var(axis=2, ddof=1).mean(axis=1)
    between = stress.mean(axis=2).var(axis=1, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((n - 1.0) / n + between / within))
