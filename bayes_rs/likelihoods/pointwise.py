"""The density of each datum of a record given its others: what leave-one-out cross-validation needs."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.likelihoods.base import Likelihood, half_square, log_normalizer
from bayes_rs.likelihoods.log_normal import LogNormalLikelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood


def has_beams(likelihood: Likelihood) -> bool:
    """Tell whether the data of every record are the beams that it uses, each by itself: they were not reduced.

    They are not if more beams are used than the stresses can move independently.
    """
    used = np.any(likelihood.gain != 0.0, axis=-1)
    return bool(np.all(likelihood.n_datum == np.count_nonzero(used, axis=1)))


def log_conditional(
    likelihood: Likelihood,
    stress: FloatArray,
    offset: FloatArray | None = None,
    gradient: FloatArray | None = None,
    *,
    of_beams: bool,
    joint: FloatArray | None = None,
) -> FloatArray | None:
    r"""Return the log-density of each datum of a record given all its other data and the stresses.

    Parameters
    ----------
    likelihood : Likelihood
        Of n_record records.
    stress, offset, gradient
        As `Likelihood.log_density` takes them.
    of_beams : bool
        True for a datum for each beam, the logarithm of its variance (for records of which `has_beams` is true); False
        for one for each direction, the reduced data Uᵀ ln y.
    joint : ndarray, shape (n_record, n_draw), optional
        What `Likelihood.log_density` gives for the same, if it is at hand.

    Returns
    -------
    density : ndarray, shape (n_record, n_draw, n_beam or n_direction), or None
        NaN for beams and directions that a record does not have; −inf where a tensor has likelihood zero. None for a
        likelihood that is not log-normal.

    Notes
    -----
    The data of a record are correlated, so the density of one is that given the others. For normal data of precision P
    and residuals r, with the quadratic form s = r·P r,

    .. math:: s_{-i} = s - (P r)_i^2 / P_{ii}, \quad \ln\det C_{-i} = \ln\det C + \ln P_{ii},

    are those of the data without the i-th (Sundararajan and Keerthi 2001), and the conditional density is the joint
    density over that of the others: exact for the normal, for the Student-t, whose marginals keep its degrees of
    freedom, and for mixtures of them. So that 1 / p(y_i | y_-i, R) turns the posterior into that without y_i
    (Bürkner, Gabry and Vehtari 2021).

    The log-normal's Jacobian, −ln y, is left out, as in `Likelihood.log_density`: it is the same for all models of the
    same data.

    References
    ----------
    Sundararajan and Keerthi (2001), Neural Computation 13, 1103–1118, doi:10.1162/08997660151134343.
    Bürkner, Gabry and Vehtari (2021), Computational Statistics 36, 1243–1261, doi:10.1007/s00180-020-01045-4.
    """
    if isinstance(likelihood, MixtureLikelihood):
        parts, log_weight = likelihood.parts, np.log(likelihood.weight)
    else:
        parts, log_weight = (likelihood,), np.zeros(1)
    others: list[FloatArray] = []
    for part, weight in zip(parts, log_weight, strict=True):
        if not isinstance(part, LogNormalLikelihood):
            return None
        density, there = _log_density_of_others(part, stress, offset, gradient, of_beams=of_beams)
        others.append(weight + density)
    whole = (likelihood.log_density(stress, offset, gradient) if joint is None else joint)[..., None]
    without = others[0] if len(others) == 1 else scipy.special.logsumexp(np.stack(others), axis=0)
    with np.errstate(invalid="ignore"):
        found = np.subtract(whole, without, out=without)
    np.copyto(found, -np.inf, where=np.isneginf(whole))
    np.copyto(found, np.nan, where=~there[:, None, :])
    return np.asarray(found)


def _log_density_of_others(
    part: LogNormalLikelihood,
    stress: FloatArray,
    offset: FloatArray | None,
    gradient: FloatArray | None,
    *,
    of_beams: bool,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the log-density of the data without each of them, (n_record, n_draw, n), and which there are."""
    residual = part.residual(stress, offset, gradient)
    root = part.whitening.swapaxes(-1, -2)  # of the precision of ln y, where it is as large as the data
    if not of_beams:
        # W = L⁻¹ Uᵀ with L lower triangular, so W^T = U L⁻ᵀ is a QR decomposition, and L⁻ᵀ a root of that of Uᵀ ln y
        root = np.asarray(np.linalg.qr(root, mode="r"))
    own = np.einsum("rns,rns->rn", root, root)  # P_ii
    there = own > np.finfo(np.float64).eps * own.max(axis=-1, keepdims=True)  # what is not there is zero to rounding
    own = np.where(there, own, 1.0)[:, None, :]
    with np.errstate(invalid="ignore"):
        square = np.sum(residual * residual, axis=-1)[..., None]
        less = residual @ root.swapaxes(-1, -2)  # (P r)_i; below, in its place, what the square is without each
        less *= less
        less /= own
        np.maximum(np.subtract(square, less, out=less), 0.0, out=less)
    known = log_normalizer(part.n_datum, np.zeros(part.n_record), part.dof)
    log_determinant = 2.0 * (known - part.log_normalizer)
    n_other = part.n_datum - 1
    factor = log_normalizer(n_other, log_determinant, part.dof)[:, None, None] - 0.5 * np.log(own)
    for index in range(less.shape[-1]):
        less[..., index] = half_square(less[..., index], n_other, part.dof)
    return np.asarray(np.subtract(factor, less, out=less)), there
