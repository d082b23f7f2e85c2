"""Direct sampling: independent draws of a fitted proposal, corrected to the posterior by importance weights."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, ndtri
from scipy.stats import qmc

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import DEGREES_OF_FREEDOM, StudentProposal, laplace_proposal
from bayes_rs.posteriors.sampling.chains import N_CHAIN, N_ENSEMBLE, Chains, Effort, kept_draws
from bayes_rs.posteriors.sampling.pareto import pareto_k
from bayes_rs.posteriors.sampling.streams import RecordStreams

_RESAMPLING = 0.25
"""Largest variance of the number of copies that systematic resampling makes of one draw."""
_BATCH = 32
"""Records that are evaluated together."""
_BLOCK_NUMBERS = 4_000_000
"""Expected variances, of records × draws × beams, that are evaluated together: 32 MB."""


def sample_direct(posterior: Posterior, *, streams: RecordStreams, effort: Effort) -> Chains:
    """Draw from a Student-t fitted to each record, weigh, and resample to draws of equal weight.

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
    The proposals of an ensemble are a scrambled Sobol sequence, shared by all records and turned for each by a random
    rotation of its own, so that every record integrates with much less scatter than independent draws have. The four
    ensembles are scrambled and turned independently; R-hat compares them. Means of weighted draws are biased by the
    order of 1/n of a posterior standard deviation.

    References
    ----------
    Owen (2023), Practical Quasi-Monte Carlo Integration, Ch. 17, https://artowen.su.domains/mc/practicalqmc.pdf.
    """
    n_draw = kept_draws(effort.target_ess)
    n_keep = n_draw * N_CHAIN // N_ENSEMBLE  # of an ensemble
    n_record, k = posterior.n_record, posterior.n_coordinate
    proposal = laplace_proposal(posterior)
    chains = Chains(
        np.empty((n_record, N_CHAIN, n_draw, k)),
        np.empty((n_record, N_CHAIN, n_draw, 6)),
        np.empty((n_record, 6)),
        np.empty((n_record, 6)),
        np.empty((n_record, 6)),
        np.ones((n_record, 6)),
        np.empty(n_record),
        np.full(n_record, n_draw),
        np.empty(n_record),
        np.full(n_record, "direct", dtype="U16"),
    )
    missing = np.arange(n_record)
    log_size = int(np.ceil(np.log2(n_keep)))
    for extension in range(effort.max_extension + 1):
        mean, covariance = np.empty((len(missing), k)), np.empty((len(missing), k, k))
        size = 2 ** (log_size + extension)
        step = max(1, _BATCH * n_keep // size)
        for start in range(0, len(missing), step):
            part = slice(start, start + step)
            mean[part], covariance[part] = _draw(posterior, proposal, missing[part], streams, effort.seed, size, chains)
        short = chains.missed(effort.target_ess)[missing]
        if not short.any() or extension == effort.max_extension:
            break
        proposal = proposal.refitted(missing[short], mean[short], covariance[short])
        missing = missing[short]
    return chains


def _draw(
    posterior: Posterior,
    proposal: StudentProposal,
    records: NDArray[np.int64],
    streams: RecordStreams,
    seed: int,
    size: int,
    chains: Chains,
) -> tuple[FloatArray, FloatArray]:
    """Fill the chains of some records from `size` proposals an ensemble; return the weighted mean and covariance."""
    some, around = posterior.take(records), proposal.take(records)
    n, k = len(records), posterior.n_coordinate
    normal, chi_square = _base(k, size, seed)  # (ensemble, size, k), (ensemble, size)
    turn, triangular = np.linalg.qr(streams.normal(records, (N_ENSEMBLE, k, k)))
    turn = turn * np.sign(np.einsum("rekk->rek", triangular))[:, :, None, :]  # uniform over the rotations
    turned = (normal @ turn).reshape(n, -1, k)
    spread = np.broadcast_to(chi_square.reshape(-1), (n, N_ENSEMBLE * size))
    coordinate = around.transform(turned, spread)
    log_weight = _log_density(some, coordinate) - around.log_density_of(turned, spread)
    peak = log_weight.max(axis=1, keepdims=True)
    weight = np.exp(log_weight - np.where(np.isfinite(peak), peak, 0.0))
    weight = weight / weight.sum(axis=1, keepdims=True)
    n_keep = chains.stress.shape[1] * chains.stress.shape[2]
    effective = 1.0 / (np.sum(weight**2, axis=1) + _RESAMPLING / n_keep)
    picked = _resampled(weight.reshape(n, N_ENSEMBLE, size), streams.uniform(records, (N_ENSEMBLE,)), n_keep)
    kept = np.take_along_axis(coordinate, picked[..., None], axis=1)
    stress = posterior.stress(kept)
    chains.coordinate[records] = kept.reshape(n, *chains.coordinate.shape[1:])
    chains.stress[records] = stress.reshape(n, *chains.stress.shape[1:])
    chains.ess_bulk[records] = effective[:, None]
    chains.ess_tail[records] = effective[:, None]
    chains.r_hat[records] = _plain_r_hat(stress.reshape(n, N_ENSEMBLE, -1, 6))
    chains.acceptance[records] = 1.0 / (np.sum(weight**2, axis=1) * weight.shape[1])
    chains.n_step[records] = weight.shape[1] // N_CHAIN
    chains.pareto_k[records] = pareto_k(log_weight)
    mean = np.einsum("rd,rdk->rk", weight, coordinate)
    centred = coordinate - mean[:, None, :]
    return mean, (centred * weight[..., None]).swapaxes(-1, -2) @ centred


def _log_density(posterior: Posterior, coordinate: FloatArray) -> FloatArray:
    """Return the log-posterior in blocks of draws, whose size does not depend on the number of records."""
    n_draw = coordinate.shape[1]
    block = max(_BLOCK_NUMBERS // (_BATCH * posterior.likelihood.gain.shape[1]), 256)
    if block >= n_draw:
        return posterior.log_density(coordinate)
    parts = [posterior.log_density(coordinate[:, start : start + block]) for start in range(0, n_draw, block)]
    return np.concatenate(parts, axis=1)


@lru_cache(maxsize=8)
def _base(k: int, size: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return normal (N_ENSEMBLE, size, k) and χ² (N_ENSEMBLE, size) numbers, one scrambled sequence an ensemble."""
    normal, chi_square = np.empty((N_ENSEMBLE, size, k)), np.empty((N_ENSEMBLE, size))
    for ensemble, entropy in enumerate(np.random.SeedSequence([seed, k, size]).spawn(N_ENSEMBLE)):
        uniform = qmc.Sobol(k + 1, rng=np.random.default_rng(entropy)).random(size)
        # scrambled points have 64 random bits: none is 0, and a last one of 1 by rounding is kept inside
        uniform = np.clip(uniform, 0.5**64, 1.0 - 0.5**53)
        normal[ensemble] = ndtri(uniform[:, :k])
        chi_square[ensemble] = 2.0 * gammaincinv(0.5 * DEGREES_OF_FREEDOM, uniform[:, k])
    normal.setflags(write=False)
    chi_square.setflags(write=False)
    return normal, chi_square


def _resampled(weight: FloatArray, offset: FloatArray, n_keep: int) -> NDArray[np.int64]:
    """Pick draws in proportion to their weights by systematic resampling within each ensemble.

    Parameters
    ----------
    weight : ndarray, shape (n_record, n_ensemble, size)
        Weights.
    offset : ndarray, shape (n_record, n_ensemble)
        A uniform number for each.
    n_keep : int
        Draws to pick in all.

    Returns
    -------
    index : ndarray of int, shape (n_record, n_keep)
        Into the draws of all ensembles.
    """
    n_record, n_ensemble, size = weight.shape
    each = n_keep // n_ensemble
    level = np.cumsum(weight, axis=-1)
    level = level * (each / level[..., -1:])
    # number of the points offset, offset + 1, … that lie below each level; the last level holds them all
    count = np.ceil(level - offset[..., None]).astype(np.int64)
    count = np.maximum(np.minimum(count, each), 0)
    count[..., -1] = each
    copies = np.diff(count, axis=-1, prepend=0)
    picked = np.repeat(np.tile(np.arange(n_ensemble * size), n_record), copies.reshape(-1))
    return picked.reshape(n_record, n_keep)


def _plain_r_hat(stress: FloatArray) -> FloatArray:
    """Return R-hat between the ensembles, shape (n_record, 6), of independent draws (n_record, n_ensemble, n, 6)."""
    n = stress.shape[2]
    within = stress.var(axis=2, ddof=1).mean(axis=1)
    between = stress.mean(axis=2).var(axis=1, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((n - 1.0) / n + between / within))
