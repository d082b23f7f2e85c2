"""Records' variances and correlations as a likelihood: theory, and all that makes them scatter more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.covariance_states import PairData, RecordMoments, record_moments
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.likelihoods.base import BeamData, beam_data
from bayes_rs.likelihoods.covariances import CovarianceLikelihood, ViewData, covariance_forms, covariance_likelihood
from bayes_rs.theory.beam_covariances import COHERENCE, component_weights, view_pairs

_AXES = "uvw"  # what a mast sees


def pair_likelihood(
    pairs: PairData,
    variance: FloatArray,
    used: NDArray[np.bool_],
    gain: FloatArray,
    offset: FloatArray | float,
    *,
    wind_speed: FloatArray,
    yaw: FloatArray,
    flow: tuple[FloatArray, FloatArray],
    length_log_sd: FloatArray | None,
    scatter: FloatArray | None,
    noise_sd: FloatArray | None,
    probe_sd: FloatArray | None,
    turn: FloatArray | None,
    place: FloatArray | None,
    options: FitOptions,
) -> CovarianceLikelihood:
    r"""Return the likelihood of variances and correlations of records.

    Parameters
    ----------
    pairs : PairData
        Their correlations.
    variance, used, gain, offset
        Of all beams, as in `bayes_rs.likelihoods.log_normal.log_normal_likelihood`.
    wind_speed, yaw : ndarray, shape (n_record,)
        m/s and rad.
    flow : tuple of two ndarray, shape (n_record,)
        Length scales, m, and anisotropies.
    length_log_sd : ndarray, shape (n_record,), or None
        Standard deviations of ln L.
    scatter : ndarray, shape (n_record, 2), or None
        Relative variance of the variances beyond theory: common to all beams, and each beam's own.
    noise_sd : ndarray, shape (n_record, n_beam), or None
        Standard deviation of the instrument's noise, the same error for all beams of a record, over their variances.
    probe_sd : ndarray, shape (n_record, n_beam), or None
        Standard deviation of ln y by the unknown length of the probe volume, the same error for all beams of a record;
        correlations keep theirs.
    turn : ndarray, shape (n_record, 6, 6), or None
        What takes stresses to the record's own tilt and roll.
    place : ndarray, shape (n_record, n_beam, n_gradient), or None
        Where the beams measure, for stresses with gradients.
    options : FitOptions
        Target, inflation, and how uncertain the coherence is.

    Returns
    -------
    likelihood : CovarianceLikelihood
        Its covariance is that of theory, with

        - ln(1 + v) between all ln y and ln(1 + w) of each, as variances have it; z scatters more by the factor by
          which the variances of ln y grow;
        - what the instrument's noise does to ln y and z if its variance is another one;
        - what errors of the scales of the coherence and of Γ do: with the slopes s_k of the data and standard
          deviations σ_k, Σ_k σ_k² s_k s_kᵀ, linear in the logarithms.
    """
    moments = record_moments(pairs, wind_speed, yaw, *flow, length_log_sd)
    beams = beam_data(variance, used, gain, offset, place)
    views = _views(pairs, beams, options)
    n_record, n_view = views.variance.shape
    n_beam = len(pairs.column)
    first, second = view_pairs(n_view)
    own, pair = slice(n_view), slice(n_view, None)
    covariance, bias = moments.covariance.copy(), moments.bias.copy()
    if scatter is not None:
        before = np.einsum("rdd->rd", covariance)[:, own].mean(axis=1)
        common, each = np.log1p(scatter).T
        grown = 1.0 + (common + each) / before
        covariance[:, pair] *= np.sqrt(grown)[:, None, None]
        covariance[:, :, pair] *= np.sqrt(grown)[:, None, None]
        covariance[:, own, own] += common[:, None, None] + each[:, None, None] * np.eye(n_view)
        bias[:, pair] *= grown[:, None]
    directions = moments.direction[:, first], moments.direction[:, second]
    correlation = _correlation(moments, *directions)[:, pair]
    systematic = []
    if noise_sd is not None:
        of_own = np.zeros((n_record, n_view))
        of_own[:, :n_beam] = noise_sd[:, pairs.column]
        of_pair = -0.5 * correlation / (1.0 - correlation**2)
        shift = np.concatenate([of_own, of_pair * (of_own[:, first[pair]] + of_own[:, second[pair]])], axis=1)
        systematic.append(shift)
    if probe_sd is not None:
        shift = np.zeros((n_record, len(first)))
        shift[:, :n_beam] = probe_sd[:, pairs.column]
        systematic.append(shift)
    for shift in systematic:
        covariance += shift[:, :, None] * shift[:, None, :]
    covariance *= options.nuisances.inflation
    systematic = [np.sqrt(options.nuisances.inflation) * shift for shift in systematic]
    bias[:, pair] *= options.nuisances.inflation
    bias[:, own] = -0.5 * np.einsum("rdd->rd", covariance)[:, own]
    sd = np.full((n_record, len(COHERENCE)), options.coherence_log_sd)
    sd[:, COHERENCE.index("length_scale")] = 0.0 if length_log_sd is None else length_log_sd
    spread = moments.slope * sd[:, None, :]
    ratio = np.zeros((n_record, len(first), 1))
    ratio[:, n_beam:n_view] = options.mast_log_sd
    for own_error in (spread, ratio):
        covariance += own_error @ own_error.swapaxes(-1, -2)
    reference = moments.ensemble if options.target == "ensemble" else moments.record
    return covariance_likelihood(
        beams,
        views,
        covariance_forms(*directions, moments.tensor, reference),
        covariance,
        bias,
        np.concatenate([spread, ratio, *(shift[:, :, None] for shift in systematic)], axis=-1),
        dof=options.nuisances.inflation_dof,
        turn=turn,
    )


def _views(pairs: PairData, beams: BeamData, options: FitOptions) -> ViewData:
    """Return what the chosen beams, and a mast beside them, saw."""
    column = pairs.column
    variance, used, noise = beams.variance[:, column], beams.used[:, column], beams.offset[:, column]
    place = None if beams.place is None else beams.place[:, column]
    of_beams = pairs.correlation if options.information == "covariances" else np.full_like(pairs.correlation, np.nan)
    if pairs.mast is None:
        return ViewData(variance, used, of_beams, noise, place)
    mast, n_record, n_beam = pairs.mast, len(variance), len(column)
    n_view = n_beam + len(_AXES)
    matrix = np.full((n_record, n_view, n_view), np.nan)
    first, second = np.triu_indices(n_beam, 1)
    matrix[:, first, second] = of_beams
    for place_of, (i, j) in zip((3, 4, 5), ((0, 1), (0, 2), (1, 2)), strict=True):
        matrix[:, n_beam + i, n_beam + j] = mast[:, place_of] / np.sqrt(mast[:, i] * mast[:, j])
    first, second = np.triu_indices(n_view, 1)
    there = np.isfinite(mast[:, :3])
    return ViewData(
        np.concatenate([variance, np.where(there, mast[:, :3], 1.0)], axis=1),
        np.concatenate([used, there], axis=1),
        matrix[:, first, second],
        np.concatenate([noise, np.zeros((n_record, len(_AXES)))], axis=1),
    )


def _correlation(moments: RecordMoments, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the model's correlations of views, shape (n_record, n_datum): 1 of each with itself."""
    n_view = moments.direction.shape[1]
    expected = np.sum(component_weights(first, second) * moments.tensor, axis=-1)
    a, b = view_pairs(n_view)
    return np.asarray(expected / np.sqrt(expected[:, a] * expected[:, b]))
