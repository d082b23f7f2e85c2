"""The likelihood of a record's variances together with the correlations between its beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.likelihoods.base import BeamData, NormalLikelihood, check_tails, factor_reduced, log_normalizer

_LOWER = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
"""The six elements of the factor of R, in the order in which they are kept."""
_PRODUCTS = tuple((i, j) for i in range(6) for j in range(i, 6))
"""The 21 products of two of them."""


@dataclass(frozen=True)
class CovarianceLikelihood(NormalLikelihood):
    r"""ln y of the beams and z = artanh of their correlations, normal about what the stresses say.

    Parameters
    ----------
    gain, offset, n_datum, dof, place
        As in `Likelihood`; those of the variances.
    form : ndarray, shape (n_record, 21, n_datum)
        Expected covariances of two views, without noise, in the products of two elements of the factor L of R = L Lᵀ.
    noise : ndarray, shape (n_record, n_view)
        The instrument's noise in the variances of the views, m² s⁻².
    view_place : ndarray or None, shape (n_record, n_view, n_gradient)
        Where the views measure; as `place`, which is that of all beams.
    seen : ndarray of bool, shape (n_record, n_datum)
        Which data a record has.
    datum : ndarray, shape (n_record, n_datum)
        ln y and z, less their bias; 0 where there is none.
    whitening : ndarray, shape (n_record, n_datum, n_datum)
        What makes the data independent, of variance 1; rows that a record does not have are zero.
    log_normalizer : ndarray, shape (n_record,)
        Log of the density's constant factor.
    systematic : ndarray, shape (n_record, n_datum, n_error)
        What errors of one standard deviation that may be the same in all records do to the whitened data.

    Notes
    -----
    The velocities are taken to be :math:`T \mathbf u` with u the model's and T lower triangular, such that
    :math:`R = T R_m T^\mathsf T`: so R is free and realizable, and only the ratio of the covariance at the beams'
    separation to that at one point comes from the model,

    .. math:: \mathrm E\, y_{ab} = \mathbf n_a^\mathsf T T C(\mathbf r_{ab}) T^\mathsf T \mathbf n_b .

    For points the variances are those of every other likelihood here, :math:`\mathbf n^\mathsf T R \mathbf n`.
    """

    gain: FloatArray
    offset: FloatArray
    form: FloatArray
    noise: FloatArray
    view_place: FloatArray | None
    seen: NDArray[np.bool_]
    datum: FloatArray
    whitening: FloatArray
    log_normalizer: FloatArray
    systematic: FloatArray
    n_datum: NDArray[np.int64]
    turn: FloatArray | None = None
    dof: float = np.inf
    place: FloatArray | None = None

    def data_means(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return ln E[y] and the artanh of the expected correlations, shape (n_record, n_draw, n_datum); 0 if not seen.

        NaN comes of stresses that give a beam no variance.
        """
        turned = stress if self.turn is None else stress @ self.turn.swapaxes(-1, -2)
        expected = factor_products(turned) @ self.form
        n_view = self.noise.shape[1]
        first, second = np.triu_indices(n_view, 1)
        own, pair = expected[..., :n_view], expected[..., n_view:]
        if self.view_place is not None and gradient is not None:
            grown = gradient @ self.view_place.swapaxes(-1, -2)
            own = own * np.exp(grown)
            pair = pair * np.exp(0.5 * (grown[..., first] + grown[..., second]))
        own = own + self.noise[:, None, :]
        if offset is not None:
            own = own + offset[:, :, None]
        with np.errstate(invalid="ignore", divide="ignore"):
            correlation = pair / np.sqrt(own[..., first] * own[..., second])
            means = np.concatenate([np.log(own), np.arctanh(correlation)], axis=-1)
        return np.where(self.seen[:, None, :], means, 0.0)

    def _whiten(
        self, stress: FloatArray, offset: FloatArray | None, gradient: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        off = self.datum[:, None, :] - self.data_means(stress, offset, gradient)
        return off @ self.whitening.swapaxes(-1, -2), self.log_normalizer[:, None]


@dataclass(frozen=True)
class ViewData:
    """The data of many records: what some instruments or beams see.

    Parameters
    ----------
    variance : ndarray, shape (n_record, n_view)
        Variances y, m² s⁻².
    used : ndarray of bool, shape (n_record, n_view)
        Which of them count.
    correlation : ndarray, shape (n_record, n_pair)
        Of the pairs of views, row by row; those that are NaN do not count, nor those of views that are not used.
    noise : ndarray, shape (n_record, n_view)
        The instrument's noise in the variances, m² s⁻².
    place : ndarray, shape (n_record, n_view, n_gradient), optional
        Where they measure, for stresses with gradients: see `Likelihood`.
    """

    variance: FloatArray
    used: NDArray[np.bool_]
    correlation: FloatArray
    noise: FloatArray
    place: FloatArray | None = None


def covariance_likelihood(
    beams: BeamData,
    views: ViewData,
    form: FloatArray,
    covariance: FloatArray,
    bias: FloatArray,
    systematic: FloatArray,
    *,
    dof: float = np.inf,
    turn: FloatArray | None = None,
) -> CovarianceLikelihood:
    """Prepare the likelihood of the variances and correlations of many records.

    Parameters
    ----------
    beams : BeamData
        All beams, for what is reported of them.
    views : ViewData
        The data.
    form : ndarray, shape (n_record, 21, n_datum)
        From `covariance_forms`.
    covariance, bias : ndarray, shapes (n_record, n_datum, n_datum) and (n_record, n_datum)
        Of ln y and z.
    systematic : ndarray, shape (n_record, n_datum, n_error)
        What errors of one standard deviation that may be the same in all records, and are counted in `covariance`, do
        to the data.
    dof : float
        Degrees of freedom of the noise, as in `log_normal_likelihood`.
    turn : ndarray, shape (n_record, 6, 6), optional
        What takes the stresses to the record's own tilt and roll.

    Returns
    -------
    likelihood : CovarianceLikelihood
        The likelihood.

    Raises
    ------
    InputError
        If a record has no datum, or a used variance is not positive.
    NotPositiveDefiniteError
        If the noise of a record is singular.
    """
    check_tails(1.0, dof)
    n_view = views.variance.shape[1]
    idle = np.flatnonzero(~views.used.any(axis=1))
    if len(idle):
        raise InputError(
            f"Record {idle[0]} has none of the beams that are correlated: leave such records out, or use information "
            "'variances'."
        )
    first, second = np.triu_indices(n_view, 1)
    there = views.used[:, first] & views.used[:, second] & (np.abs(views.correlation) < 1.0)
    seen = np.concatenate([views.used, there], axis=1)
    log_variance = np.log(np.where(views.used, views.variance, 1.0))
    z = np.arctanh(np.where(there, views.correlation, 0.0))
    datum = np.where(seen, np.concatenate([log_variance, z], axis=1) - bias, 0.0)
    masked = np.where(seen[:, :, None] & seen[:, None, :], covariance, 0.0)
    factor = factor_reduced(masked, seen, n_view, what="covariance of variances and correlations")
    whitening = np.linalg.solve(factor, np.eye(seen.shape[1]) * seen[:, None, :])
    n_datum = seen.sum(axis=1).astype(np.int64)
    log_determinant = 2.0 * np.log(np.einsum("rdd->rd", factor)).sum(axis=1)
    return CovarianceLikelihood(
        gain=beams.gain,
        offset=beams.offset,
        form=form,
        noise=np.where(views.used, views.noise, 0.0),
        view_place=views.place,
        seen=seen,
        datum=datum,
        whitening=whitening,
        log_normalizer=log_normalizer(n_datum, log_determinant, float(dof)),
        systematic=whitening @ systematic,
        n_datum=n_datum,
        turn=turn,
        place=beams.place,
        dof=float(dof),
    )


def factor_products(stress: FloatArray) -> FloatArray:
    """Return the products of every two elements of the lower triangular factor of R, shape (..., 21), m² s⁻².

    Parameters
    ----------
    stress : ndarray, shape (..., 6)
        Realizable stresses; NaN comes of others.
    """
    uu, vv, ww, uv, uw, vw = np.moveaxis(stress, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        l_uu = np.sqrt(uu)
        l_vu, l_wu = uv / l_uu, uw / l_uu
        l_vv = np.sqrt(vv - l_vu**2)
        l_wv = (vw - l_wu * l_vu) / l_vv
        l_ww = np.sqrt(ww - l_wu**2 - l_wv**2)
    element = (l_uu, l_vv, l_ww, l_vu, l_wu, l_wv)
    found = np.empty((*uu.shape, len(_PRODUCTS)))
    for place, (i, j) in enumerate(_PRODUCTS):
        np.multiply(element[i], element[j], out=found[..., place])
    return found


def covariance_forms(first: FloatArray, second: FloatArray, tensor: FloatArray, reference: FloatArray) -> FloatArray:
    r"""Return how covariances of two views depend on the factor of R, shape (..., 21, n_datum).

    Parameters
    ----------
    first, second : ndarray, shape (..., n_datum, 3)
        Directions n_a and n_b.
    tensor : ndarray, shape (..., n_datum, 6)
        The model's covariances C(r_ab).
    reference : ndarray, shape (..., 6)
        R_m, the model's stresses.

    Returns
    -------
    form : ndarray, shape (..., 21, n_datum)
        :math:`\mathbf n_a^\mathsf T L L_m^{-1} C L_m^{-\mathsf T} L^\mathsf T \mathbf n_b = \sum_k p_k(L)\, f_k`
        with the products p of `factor_products`.
    """
    root = np.linalg.cholesky(unpack_stress(reference))[..., np.newaxis, :, :]
    half = np.linalg.solve(root, unpack_stress(tensor))
    core = np.linalg.solve(root, half.swapaxes(-1, -2))  # symmetric: both sides
    form = np.zeros((*tensor.shape[:-1], len(_PRODUCTS)))
    for place, (i, j) in enumerate(_PRODUCTS):
        (row_i, column_i), (row_j, column_j) = _LOWER[i], _LOWER[j]
        value = first[..., row_i] * second[..., row_j] * core[..., column_i, column_j]
        if i != j:
            value = value + first[..., row_j] * second[..., row_i] * core[..., column_j, column_i]
        form[..., place] = value
    return form.swapaxes(-1, -2)
