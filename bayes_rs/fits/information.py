"""What the variances of records say by themselves, beside what they say together with the covariances of beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch, RecordDraws, fit_batch, make_posterior
from bayes_rs.fits.columns import N_PAIR, PAIRS_MISFIT, SAME_FOR_ALL
from bayes_rs.fits.direction_table import covariance_of
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.likelihoods.covariances import CovarianceLikelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.posterior import Posterior

_N_DRAW = 200  # draws of a record that tell what its variances leave open
_N_PRIOR = 4096  # draws of the prior, for the covariance of its coordinates


def variances_alone(
    batch: Batch, noise: Noise, options: FitOptions, posterior: Posterior | None = None
) -> tuple[RecordDraws, dict[str, FloatArray], FloatArray]:
    r"""Sample records by the variances of their beams alone, and say how well these foretell what the fit uses beside.

    Parameters
    ----------
    batch : Batch
        Records with correlations, or with what a mast measured.
    noise : Noise
        Of their beams.
    options : FitOptions
        Of the fit.
    posterior : Posterior, optional
        That of the fit of these records, where it is known.

    Returns
    -------
    draws : RecordDraws
        As `fit_batch` makes them with information ``"variances"``, without a mast.
    columns : dict of str to ndarray, shape (n_record,)
        ``pairs_misfit``, χ²/n, and ``n_pair``, n: correlations, and variances of the mast.
    pattern : ndarray, shape (n_record, n_datum)
        The record's part of the pattern, d; 0 for a datum that it does not have.

    Notes
    -----
    With e(R) the whitened difference of these n data from what a draw's stresses and the record's variances foretell,
    of variance 1 if R is the truth,

    .. math:: \chi^2 = \bar e^\mathsf T (1 + \mathrm{Cov}\, e)^{-1} \bar e ,

    mean and covariance over the draws: what the variances leave open of R is not a misfit. Errors of the coherence's
    scales and of the ratio to the mast, within what they are given, are none either.

    A pattern is what differs in the same way in all records. Of e, the part A = C_e,x Σ⁻¹ C_x,e is common to all
    records if these have the same ratios of stresses, which the prior, with covariance Σ of its coordinates x, does not
    have right; and the part B Bᵀ, of errors of the scales, of the ratio and of the instrument's noise. With the
    covariance E = 1 + Cov e of one record and M = 100,

    .. math::
        E + (M - 1) (A + B B^\mathsf T) = G G^\mathsf T, \qquad d = G^{-1} \bar e .

    If the model holds, min(N, M) times the covariance of the mean of d over N records is at most 1 in any direction, so
    that min(N, M) times its square is at most χ² with n degrees of freedom, whatever is common to the records.
    """
    if batch.pairs is None:
        raise InputError("There is nothing beside the variances to compare: fit with information 'covariances'.")
    draws = fit_batch(replace(batch, pairs=None), noise, replace(options, information="variances"), predict=False)
    if posterior is None:
        posterior = make_posterior(batch, noise, options)[0]
    likelihood = posterior.likelihood
    if isinstance(likelihood, MixtureLikelihood):
        likelihood = likelihood.parts[len(likelihood.parts) // 2]
    if not isinstance(likelihood, CovarianceLikelihood):
        raise InputError("There are no covariances to compare: fit with information 'covariances'.")
    flat = draws.chains.coordinate.reshape(len(batch), -1, draws.chains.coordinate.shape[-1])
    some = flat[:, :: max(1, flat.shape[1] // _N_DRAW)]
    beside = slice(len(batch.pairs.column), None)  # after the variances of the beams
    residual = likelihood.residual(*posterior.seen(some))[:, :, beside]
    mean = residual.mean(axis=1)
    centred = (residual - mean[:, np.newaxis]).swapaxes(-1, -2)
    spread = centred @ centred.swapaxes(-1, -2) / (some.shape[1] - 1.0) + np.eye(mean.shape[-1])
    with_state = centred @ (some - some.mean(axis=1, keepdims=True)) / (some.shape[1] - 1.0)
    shared = likelihood.systematic[:, beside]
    common = with_state @ np.linalg.solve(_prior_covariance(options, some.shape[-1]), with_state.swapaxes(-1, -2))
    common += shared @ shared.swapaxes(-1, -2)
    root = np.linalg.cholesky(spread + (SAME_FOR_ALL - 1.0) * common)
    pattern = np.linalg.solve(root, mean[..., np.newaxis])[..., 0]
    n_datum = likelihood.seen[:, beside].sum(axis=1).astype(np.float64)
    square = np.sum(mean * np.linalg.solve(spread, mean[..., np.newaxis])[..., 0], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = {PAIRS_MISFIT: np.where(n_datum > 0, square / n_datum, np.nan), N_PAIR: n_datum}
    return draws, columns, pattern


def _prior_covariance(options: FitOptions, n_coordinate: int) -> FloatArray:
    """Return the covariance of the coordinates by the prior, of nuisances, too, which are standard normal."""
    drawn = options.made_prior.draw_coordinate(_N_PRIOR, np.random.default_rng(0))
    covariance = np.eye(n_coordinate)
    covariance[: drawn.shape[1], : drawn.shape[1]] = covariance_of(drawn[np.newaxis], ddof=1)[0]
    return covariance
