"""What the variances of records say by themselves, beside what they say together with the covariances of beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch, RecordDraws, fit_batch, make_posterior
from bayes_rs.fits.columns import N_PAIR, PAIRS_MISFIT
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.likelihoods.covariances import CovarianceLikelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.noise.noise import Noise

_N_DRAW = 200  # draws of a record that tell what its variances leave open


def variances_alone(batch: Batch, noise: Noise, options: FitOptions) -> tuple[RecordDraws, dict[str, FloatArray]]:
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

    Notes
    -----
    With e(R) the whitened difference of the n correlations from what a draw's stresses and the record's variances
    foretell, of variance 1 if R is the truth,

    .. math:: \chi^2 = \bar e^\mathsf T (1 + \mathrm{Cov}\, e)^{-1} \bar e ,

    mean and covariance over the draws: what the variances leave open of R is not a misfit. Errors of the coherence's
    scales, within what they are given, are none either.
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
    centred = residual - mean[:, np.newaxis]
    spread = centred.swapaxes(-1, -2) @ centred / (some.shape[1] - 1.0) + np.eye(mean.shape[-1])
    n_pair = likelihood.seen[:, n_view:].sum(axis=1).astype(np.float64)
    square = np.sum(mean * np.linalg.solve(spread, mean[..., np.newaxis])[..., 0], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return draws, {PAIRS_MISFIT: np.where(n_pair > 0, square / n_pair, np.nan), N_PAIR: n_pair}
