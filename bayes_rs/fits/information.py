"""What the variances of records say by themselves, beside what they say together with the covariances of beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch, RecordDraws, fit_batch, make_posterior
from bayes_rs.fits.coherence import SAME_FOR_ALL
from bayes_rs.fits.columns import N_PAIR, PAIRS_MISFIT
from bayes_rs.fits.direction_table import covariance_of
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.likelihoods.covariances import CovarianceLikelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.noise.noise import Noise

_N_DRAW = 200  # draws of a record that tell what its variances leave open
_N_PRIOR = 4096  # draws of the prior, for the covariance of its coordinates


def variances_alone(
    batch: Batch, noise: Noise, options: FitOptions
) -> tuple[RecordDraws, dict[str, FloatArray], FloatArray]:
    r"""Sample records by their variances alone, and say how well these foretell the covariances.

    Parameters
    ----------
    batch : Batch
        Records with correlations.
    noise : Noise
        Of their beams.
    options : FitOptions
        Of the fit, with information ``"covariances"``.

    Returns
    -------
    draws : RecordDraws
        As `fit_batch` makes them with information ``"variances"``.
    columns : dict of str to ndarray, shape (n_record,)
        ``pairs_misfit``, χ²/n, and ``n_pair``, n.
    pattern : ndarray, shape (n_record, n_pair)
        The record's part of the pattern, d; NaN where a pair is missing, and for records with a mast.

    Notes
    -----
    With e(R) the whitened difference of the n correlations from what a draw's stresses and the record's variances
    foretell, of variance 1 if R is the truth,

    .. math:: \chi^2 = \bar e^\mathsf T (1 + \mathrm{Cov}\, e)^{-1} \bar e ,

    mean and covariance over the draws: what the variances leave open of R is not a misfit. Errors of the coherence's
    scales, within what they are given, are none either.

    A pattern is what differs in the same way in all records. Of e, the part A = C_e,x Σ⁻¹ C_x,e is common to all
    records if these have the same ratios of stresses, which the prior, with covariance Σ of its coordinates x, does not
    have right; and the part B Bᵀ, of errors of the scales and of the instrument's noise. With the covariance
    E = 1 + Cov e of one record and M = 100,

    .. math::
        E + (M - 1) (A + B B^\mathsf T) = G G^\mathsf T, \qquad d = G^{-1} \bar e .

    If the model holds, min(N, M) times the covariance of the mean of d over N records is at most 1 in any direction, so
    that min(N, M) times its square is at most χ² with n degrees of freedom, whatever is common to the records.
    """
    of_mast = batch.pairs is not None and batch.pairs.mast is not None
    by_variances = batch if of_mast else replace(batch, pairs=None)
    draws = fit_batch(by_variances, noise, replace(options, information="variances"), predict=False)
    posterior = make_posterior(batch, noise, options)[0]
    likelihood = posterior.likelihood
    if isinstance(likelihood, MixtureLikelihood):
        likelihood = likelihood.parts[len(likelihood.parts) // 2]
    if not isinstance(likelihood, CovarianceLikelihood):
        raise InputError("There are no covariances to compare: fit with information 'covariances'.")
    flat = draws.chains.coordinate.reshape(len(batch), -1, draws.chains.coordinate.shape[-1])
    some = flat[:, :: max(1, flat.shape[1] // _N_DRAW)]
    n_view = likelihood.noise.shape[1]
    residual = likelihood.residual(*posterior.seen(some))[:, :, n_view:]
    mean = residual.mean(axis=1)
    centred = (residual - mean[:, np.newaxis]).swapaxes(-1, -2)
    spread = centred @ centred.swapaxes(-1, -2) / (some.shape[1] - 1.0) + np.eye(mean.shape[-1])
    with_state = centred @ (some - some.mean(axis=1, keepdims=True)) / (some.shape[1] - 1.0)
    shared = likelihood.systematic[:, n_view:]
    common = with_state @ np.linalg.solve(_prior_covariance(options, some.shape[-1]), with_state.swapaxes(-1, -2))
    common += shared @ shared.swapaxes(-1, -2)
    root = np.linalg.cholesky(spread + (SAME_FOR_ALL - 1.0) * common)
    pattern = np.linalg.solve(root, mean[..., np.newaxis])[..., 0]
    whole = np.full(len(batch), False) if of_mast else np.all(likelihood.seen, axis=1)
    n_pair = likelihood.seen[:, n_view:].sum(axis=1).astype(np.float64)
    square = np.sum(mean * np.linalg.solve(spread, mean[..., np.newaxis])[..., 0], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = {PAIRS_MISFIT: np.where(n_pair > 0, square / n_pair, np.nan), N_PAIR: n_pair}
    return draws, columns, np.where(np.expand_dims(whole, 1), pattern, np.nan)


def _prior_covariance(options: FitOptions, n_coordinate: int) -> FloatArray:
    """Return the covariance of the coordinates by the prior, of nuisances, too, which are standard normal."""
    drawn = options.made_prior.draw_coordinate(_N_PRIOR, np.random.default_rng(0))
    covariance = np.eye(n_coordinate)
    covariance[: drawn.shape[1], : drawn.shape[1]] = covariance_of(drawn[np.newaxis], ddof=1)[0]
    return covariance
