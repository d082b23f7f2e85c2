"""The tensor that a sonic measures in a record: random about the expected one, and correlated with the beams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.likelihoods.log_normal import Likelihood, LogNormalLikelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.noise.record_noise import SonicNoise
from bayes_rs.posteriors.nuisance import Seen
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling.chains import Chains, diagnose_stress
from bayes_rs.posteriors.sampling.streams import RecordStreams

CLIP_LIMIT = 0.05
"""An eigenvalue of Cov[g | beams] may be so far below zero, relative to the largest of Cov[g]: where beams leave
nothing open, log-normal numbers of the right first two moments do so by up to 0.02, and interpolated noise has errors
of 0.01. Such an eigenvalue is set to zero, and the result reports how far below it was."""


_CONVERGED = 1e-12  # of the moments that are matched: far below any error of theirs
_MOST_STEPS = 500

Tilt = tuple[tuple[int, float], ...]
Term = tuple[tuple[int, ...], Tilt]

# A is lower triangular with the diagonal exp(g/2) of g_0, g_1, g_2, and g_3 = A_vu, g_4 = A_wu, g_5 = A_wv below it.
# The six elements of A Aᵀ are sums of terms Π g_i · exp(Σ f_j g_j): the first tuple holds the i, the second the (j, f).
_TERMS: tuple[tuple[Term, ...], ...] = (
    (((), ((0, 1.0),)),),
    (((3, 3), ()), ((), ((1, 1.0),))),
    (((4, 4), ()), ((5, 5), ()), ((), ((2, 1.0),))),
    (((3,), ((0, 0.5),)),),
    (((4,), ((0, 0.5),)),),
    (((3, 4), ()), ((5,), ((1, 0.5),))),
)
_IDENTITY = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class SonicFactor:
    """Gaussian numbers g of the triangular factor A of A Aᵀ = L⁻¹ S L⁻ᵀ, for each of a number of records.

    Parameters
    ----------
    mean : ndarray, shape (n_record, 6)
        E[g].
    covariance : ndarray, shape (n_record, 6, 6)
        Cov[g].
    beam_covariance : ndarray, shape (n_record, 6, n_beam)
        Cov[g, ln y].

    Notes
    -----
    S is the tensor that a sonic measures in a record, R = L Lᵀ the one that it measures on average, L lower triangular.
    A is lower triangular, with the elements exp(g_0/2), exp(g_1/2), exp(g_2/2) on the diagonal and g_3, g_4, g_5 at vu,
    wu and wv. So S is realizable whatever g is, S_uu = R_uu exp(g_0) is log-normal as the beams' variances are, and for
    independent samples A would be Bartlett's factor of a Wishart matrix, whose elements below the diagonal are normal.

    References
    ----------
    Bartlett (1934), Proc. R. Soc. Edinburgh 53, 260–283, doi:10.1017/S0370164600015637.
    """

    mean: FloatArray
    covariance: FloatArray
    beam_covariance: FloatArray


def match_factor(covariance: FloatArray, beam_covariance: FloatArray, *, inflation: float = 1.0) -> SonicFactor:
    """Return the Gaussian g whose A Aᵀ has given moments with itself and with log-normal beam variances.

    Parameters
    ----------
    covariance : ndarray, shape (n_record, 6, 6)
        Covariance K of T = L⁻¹ S L⁻ᵀ.
    beam_covariance : ndarray, shape (n_record, 6, n_beam)
        Covariance D of T with the relative beam variances y / E[y].
    inflation : float
        Factor of the covariances of g, as of ln y in `log_normal_likelihood`.

    Returns
    -------
    factor : SonicFactor
        E[A Aᵀ] = 1; with an inflation of 1, Cov[A Aᵀ] = K and Cov[A Aᵀ, y / E[y]] = D, too.

    Raises
    ------
    InputError
        If S scatters so much that there is no such g.

    Notes
    -----
    The elements of A Aᵀ are sums of Π g_i exp(Σ f_j g_j), whose moments are known: the exponential shifts the mean of a
    Gaussian by Cov[g] f, and what is left is Isserlis' theorem. To first order A Aᵀ − 1 is g, so the steps

        Cov[g] ← Cov[g] + ln(1 + K) − ln(1 + Cov[A Aᵀ]),    E[g] ← E[g] + 1 − E[A Aᵀ]

    converge, the same for D; for uu they are exact. g has to be matched to second order, because ln y is: with
    Cov[g] = K beside Cov[ln y] = ln(1 + K), the joint covariance has eigenvalues below zero.

    Examples
    --------
    Only uu is random; its logarithm has the variance ln(1 + K):

    >>> import numpy as np
    >>> only_uu = np.zeros((1, 6, 6))
    >>> only_uu[0, 0, 0] = 0.06
    >>> bool(np.isclose(match_factor(only_uu, np.zeros((1, 6, 1))).covariance[0, 0, 0], np.log(1.06)))
    True
    """
    mean, own = np.zeros(covariance.shape[:-1]), covariance.copy()
    open_ = np.arange(len(own))
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_MOST_STEPS):
            first, second = _moments(mean[open_], own[open_])
            lack = covariance[open_] - second
            mean[open_] += _IDENTITY - first
            own[open_] += _log_step(lack, second)
            # each record stops by itself, so that it gets the same numbers in any company
            open_ = open_[~(np.abs(lack).max(axis=(1, 2)) + np.abs(_IDENTITY - first).max(axis=1) < _CONVERGED)]
            if len(open_) == 0:
                break
        _refuse(open_, covariance)
        across = beam_covariance.copy()
        open_ = np.arange(len(own))
        for _ in range(_MOST_STEPS):
            with_beams = _beam_moments(mean[open_], own[open_], across[open_])
            lack = beam_covariance[open_] - with_beams
            across[open_] += _log_step(lack, with_beams)
            open_ = open_[~(np.abs(lack).max(axis=(1, 2)) < _CONVERGED)]
            if len(open_) == 0:
                break
        _refuse(open_, covariance)
        if inflation != 1.0:
            own, across = inflation * own, inflation * across
            open_ = np.arange(len(own))
            for _ in range(_MOST_STEPS):
                lack = _IDENTITY - _first_moment(mean[open_], own[open_])
                mean[open_] += lack
                open_ = open_[~(np.abs(lack).max(axis=1) < _CONVERGED)]
                if len(open_) == 0:
                    break
            _refuse(open_, inflation * covariance)
    return SonicFactor(mean, own, across)


def factored_tensor(stress: FloatArray, factor: FloatArray) -> FloatArray:
    """Return S = L A Aᵀ Lᵀ.

    Parameters
    ----------
    stress : ndarray, shape (..., 6)
        R = L Lᵀ, m² s⁻².
    factor : ndarray, shape (..., 6)
        g, of which A is made; see `SonicFactor`.

    Returns
    -------
    tensor : ndarray, shape (..., 6)
        uu, vv, ww, uv, uw, vw of S, m² s⁻².

    Examples
    --------
    Four times the variance of u, and what w has in common with u grows with it:

    >>> import numpy as np
    >>> expected, factor = np.array([1.0, 0.5, 0.3, 0.0, -0.2, 0.0]), np.zeros(6)
    >>> factor[0] = np.log(4.0)
    >>> factored_tensor(expected, factor).round(3).tolist()
    [4.0, 0.5, 0.42, 0.0, -0.8, 0.0]
    """
    uu, vv, ww, uv, uw, vw = np.moveaxis(stress, -1, 0)
    l_uu = np.sqrt(uu)
    l_vu, l_wu = uv / l_uu, uw / l_uu
    # pivots below zero are rounding, R is realizable; a pivot of zero has nothing to share with the rows below
    l_vv = np.sqrt(np.maximum(vv - l_vu**2, 0.0))
    l_wv = np.divide(vw - l_wu * l_vu, l_vv, out=np.zeros_like(l_vv), where=l_vv > 0.0)
    l_ww = np.sqrt(np.maximum(ww - l_wu**2 - l_wv**2, 0.0))
    a_uu, a_vv, a_ww = np.moveaxis(np.exp(0.5 * factor[..., :3]), -1, 0)
    a_vu, a_wu, a_wv = np.moveaxis(factor[..., 3:], -1, 0)
    b_uu, b_vv, b_ww = l_uu * a_uu, l_vv * a_vv, l_ww * a_ww
    b_vu = l_vu * a_uu + l_vv * a_vu
    b_wu = l_wu * a_uu + l_wv * a_vu + l_ww * a_wu
    b_wv = l_wv * a_vv + l_ww * a_wv
    return np.stack(
        [
            b_uu**2,
            b_vu**2 + b_vv**2,
            b_wu**2 + b_wv**2 + b_ww**2,
            b_uu * b_vu,
            b_uu * b_wu,
            b_vu * b_wu + b_vv * b_wv,
        ],
        axis=-1,
    )


def draw_sonic(
    posterior: Posterior,
    chains: Chains,
    noise: Sequence[SonicNoise],
    streams: RecordStreams,
    *,
    inflation: float = 1.0,
) -> tuple[Chains, FloatArray]:
    """Draw, for each draw of R, the tensor that a sonic measured in the record.

    Parameters
    ----------
    posterior : Posterior
        Posterior of R of the records, with the log-normal likelihood.
    chains : Chains
        Its draws.
    noise : sequence of SonicNoise
        Moments of the sonic with the beams, for each length scale that the likelihood is averaged over.
    streams : RecordStreams
        Random streams of the records.
    inflation : float
        Factor of the covariance of ln y, as in the likelihood.

    Returns
    -------
    chains : Chains
        As before, with S for R as `stress`. The diagnostics are those of S; for weighted draws they stay those of R,
        since the weights, not the order of the draws, tell how much these are worth.
    clipped : ndarray, shape (n_record,)
        How far below zero the lowest eigenvalue of Cov[g | beams] was before it was set to zero, relative to the
        largest of Cov[g].

    Raises
    ------
    InputError
        If the likelihood is not log-normal.
    NotPositiveDefiniteError
        If more than `CLIP_LIMIT` would have to be clipped.

    Notes
    -----
    Given R, the whitened and reduced log-variances W (ln y + ½ diag C − ln m) = r of the record are standard normal,
    and G = Cov[g, ln y] Wᵀ is their covariance with g. So g is normal with the mean E[g] + G r and the covariance
    Cov[g] − G Gᵀ. Student-t noise is normal with a common factor λ of all covariances; given r,
    λ = (ν + |r|²) / χ²(ν + n).
    """
    parts = _log_normal_parts(posterior.likelihood)
    n_record = len(chains.stress)
    every = np.arange(n_record)
    flat = chains.coordinate.reshape(n_record, -1, chains.coordinate.shape[-1])
    seen = posterior.seen(flat)
    normal = streams.normal(every, (flat.shape[1], len(_IDENTITY)))
    factor, clipped = np.empty(normal.shape), np.zeros(n_record)
    chosen = _chosen_part(posterior.likelihood, seen, streams)
    for index, (part, moments) in enumerate(zip(parts, noise, strict=True)):
        drawn, below = _drawn_factor(part, moments, seen, normal, streams, inflation)
        factor = np.where((chosen == index)[..., np.newaxis], drawn, factor)
        clipped = np.maximum(clipped, below)
    sonic = factored_tensor(chains.stress.reshape(*normal.shape), factor).reshape(chains.stress.shape)
    drawn_chains = replace(
        chains,
        stress=sonic,
        ess_bulk=chains.ess_bulk.copy(),
        ess_tail=chains.ess_tail.copy(),
        r_hat=chains.r_hat.copy(),
        autocorrelation_time=chains.autocorrelation_time.copy(),
    )
    walked = np.flatnonzero(chains.sampler != "direct")
    if len(walked):
        found, _ = diagnose_stress(sonic[walked])
        drawn_chains.ess_bulk[walked], drawn_chains.ess_tail[walked] = found.ess_bulk, found.ess_tail
        drawn_chains.r_hat[walked] = found.r_hat
        # steps for each effective draw: as many more as there are fewer effective draws
        drawn_chains.autocorrelation_time[walked] *= chains.ess_bulk[walked] / found.ess_bulk
    return drawn_chains, clipped


def _drawn_factor(
    part: LogNormalLikelihood,
    noise: SonicNoise,
    seen: Seen,
    normal: FloatArray,
    streams: RecordStreams,
    inflation: float,
) -> tuple[FloatArray, FloatArray]:
    """Return draws of g, shape (n_record, n_draw, 6), given R and the beams, and what was clipped."""
    _, first, state = np.unique(noise.state, return_index=True, return_inverse=True)
    factor = match_factor(noise.covariance[first], noise.beam_covariance[first], inflation=inflation)
    state = state.reshape(-1)
    gain = np.einsum("rib,rsb->ris", factor.beam_covariance[state], part.whitening)
    own = factor.covariance[state]
    root, clipped = _checked_root(own - gain @ gain.swapaxes(-1, -2), own)
    residual = replace(part, dof=np.inf).whitened_residual(*seen)
    scattered = normal @ root.swapaxes(-1, -2)
    if np.isfinite(part.dof):
        square = np.einsum("rds,rds->rd", residual, residual)
        chi_square = np.concatenate(
            [
                streams.chi_square(np.array([record]), (square.shape[1],), part.dof + int(n_datum))
                for record, n_datum in enumerate(part.n_datum)
            ]
        )
        scattered *= np.sqrt((part.dof + square) / chi_square)[..., np.newaxis]
    return factor.mean[state][:, np.newaxis] + residual @ gain.swapaxes(-1, -2) + scattered, clipped


def _log_normal_parts(likelihood: Likelihood) -> tuple[LogNormalLikelihood, ...]:
    """Return the likelihood, or those that it is a mixture of, if they are log-normal."""
    parts = likelihood.parts if isinstance(likelihood, MixtureLikelihood) else (likelihood,)
    kept = tuple(part for part in parts if isinstance(part, LogNormalLikelihood))
    if len(kept) < len(parts):
        raise InputError(
            "Invalid likelihood for the target 'sonic': only for 'log-normal' is it known how the sonic and the beams "
            "scatter together."
        )
    return kept


def _chosen_part(likelihood: Likelihood, seen: Seen, streams: RecordStreams) -> NDArray[np.int64]:
    """Draw which part of a mixture each draw belongs to, shape (n_record, n_draw)."""
    if not isinstance(likelihood, MixtureLikelihood):
        return np.zeros(seen.stress.shape[:2], dtype=np.int64)
    density = np.stack([part.log_density(*seen) for part in likelihood.parts])
    density += np.log(likelihood.weight)[:, np.newaxis, np.newaxis]
    below = np.cumsum(np.exp(density - density.max(axis=0)), axis=0)
    level = below[-1] * streams.uniform(np.arange(len(seen.stress)), seen.stress.shape[1:2])
    return np.asarray((below[:-1] <= level).sum(axis=0), dtype=np.int64)


def _checked_root(left: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return square roots of what the beams leave of Cov[g], shape (n_record, 6, 6), and what was clipped of it."""
    values, vectors = np.linalg.eigh(left)
    below = np.maximum(-values[:, 0], 0.0) / np.linalg.eigvalsh(own)[:, -1]
    worst = int(np.argmax(below))
    if below[worst] > CLIP_LIMIT:
        raise NotPositiveDefiniteError(
            f"The moments of the sonic and the beams of record {worst} contradict each other: given the beams, the "
            f"sonic's covariance has the eigenvalue {values[worst, 0]:.3g}, {below[worst]:.2g} of the largest below "
            f"zero, and {CLIP_LIMIT:g} is allowed; make the noise with a smaller tolerance.",
            smallest_eigenvalue=float(values[worst, 0]),
        )
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis]), below


def _log_step(lack: FloatArray, have: FloatArray) -> FloatArray:
    """Return ln(1 + have + lack) − ln(1 + have); not below ln 0.1, so that no step goes too far."""
    return np.asarray(np.log1p(np.maximum(lack / (1.0 + have), -0.9)))


def _refuse(records: NDArray[np.int64], covariance: FloatArray) -> None:
    """Refuse records whose moments could not be matched."""
    if len(records):
        spread = float(np.sqrt(np.max(np.einsum("rii->ri", covariance[records]))))
        raise InputError(
            f"A sonic's stresses scatter too much for the target 'sonic', by {100.0 * spread:.0f} % from record to "
            "record: use longer records."
        )


def _moments(mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (n, 6) and covariance (n, 6, 6) of the elements of A Aᵀ."""
    first = _first_moment(mean, covariance)
    second = np.empty(covariance.shape)
    for row, terms in enumerate(_TERMS):
        for column in range(row, len(_TERMS)):
            product = sum(
                _expectation(left + right, tilt + other, mean, covariance)
                for left, tilt in terms
                for right, other in _TERMS[column]
            )
            second[:, row, column] = second[:, column, row] = product - first[:, row] * first[:, column]
    return first, second


def _first_moment(mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the mean of the elements of A Aᵀ, shape (..., 6)."""
    return np.stack([sum(_expectation(*term, mean, covariance) for term in terms) for terms in _TERMS], axis=-1)


def _beam_moments(mean: FloatArray, covariance: FloatArray, across: FloatArray) -> FloatArray:
    """Return the covariance of A Aᵀ with y / E[y], shape (n, 6, n_beam): what exp(ln y) of mean one shifts."""
    shifted = _first_moment(mean[:, np.newaxis] + across.swapaxes(-1, -2), covariance[:, np.newaxis])
    return np.asarray((shifted - _first_moment(mean, covariance)[:, np.newaxis]).swapaxes(-1, -2))


def _expectation(indices: tuple[int, ...], tilt: Tilt, mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return E[Π g_i exp(Σ f_j g_j)] of Gaussians with means (..., 6) and covariances (..., 6, 6)."""
    shift, exponent = np.zeros(mean.shape), np.zeros(mean.shape[:-1])
    for index, size in tilt:
        shift += size * covariance[..., index]
    for index, size in tilt:
        exponent += size * (mean[..., index] + 0.5 * shift[..., index])
    return np.asarray(np.exp(exponent) * _product_mean(indices, mean + shift, covariance))


def _product_mean(indices: tuple[int, ...], mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return E[Π g_i] by Isserlis' theorem, shape (...)."""
    if not indices:
        return np.ones(mean.shape[:-1])
    first, rest = indices[0], indices[1:]
    total = mean[..., first] * _product_mean(rest, mean, covariance)
    for place, other in enumerate(rest):
        total = total + covariance[..., first, other] * _product_mean(
            rest[:place] + rest[place + 1 :], mean, covariance
        )
    return np.asarray(total)
