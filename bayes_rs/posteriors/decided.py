"""What the data decided: how many stresses they told, of six, and their share of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE
from bayes_rs.priors.interface import log_ratios_from_stress

_RANK = 1e-6
"""A direction whose variance under the prior is below this share of the largest is fixed by the prior."""
_ROWS, _COLUMNS = (0, 0, 1), (1, 2, 2)
"""The two variances that each of uv, uw, vw stands between."""
_LOGARITHM, _ADDED = np.array([(0, 0, 0), (0, 1, 2)]), np.array([False, True, True])
"""ln uu, ln vv and ln ww are the first of x, to which for the last two another is added."""
PRIOR_BELOW = 0.5
"""Share below which the prior decided more of a number than the data did."""
PRIORS = "mostly the prior's: the data decided less than half"
"""What a legend says of such numbers."""
_BATCH = 16
"""Records whose draws are looked at together: they stay in the cache."""


@dataclass(frozen=True, eq=False)
class PriorRoom:
    """What a prior leaves open: what the data have to decide.

    Parameters
    ----------
    mean : ndarray, shape (6,)
        Mean of x = (ln uu, ln vv/uu, ln ww/uu, artanh ρ_uv, artanh ρ_uw, artanh ρ_vw·u).
    standard : ndarray, shape (6, n_coordinate)
        (x − mean) @ standard are uncorrelated and have variance 1 under the prior; the first is the size.
    size_sd : float
        Standard deviation of the size: of the logarithm of uu, or of the variance that the beams see best.
    room : ndarray, shape (6,)
        What the prior leaves open of each stress when the size is known: of ln uu, ln vv, ln ww; and of uv, uw, vw over
        the mean root of their two variances.

    Notes
    -----
    For `WeakPrior` and `RatioPrior` the coordinates are the prior's own, for any other prior those of the normal
    distribution with its mean and covariance. Where uu is the size, the room of vv and ww is the standard deviation of
    their logarithms where uu is known, that of uu the one where vv + ww is (or that of ln uu, if it is less). The room
    of a covariance is how far it moves with the prior's shape where uu is known. For beams that look up, ww is the
    size, and changes places with uu.
    """

    mean: FloatArray
    standard: FloatArray
    size_sd: float
    room: FloatArray

    @classmethod
    def of(cls, draws: FloatArray, size: int = 0) -> PriorRoom:
        """Return the room of a prior from draws of its stresses, shape (n, 6), and the variance that is the size."""
        inner = log_ratios_from_stress(draws)
        mean = inner.mean(axis=0)
        centred = inner - mean
        covariance = centred.T @ centred / len(centred)
        of_size = np.eye(len(STRESSES))[0]
        of_size[size] = 1.0  # ln vv = ln uu + ln vv/uu
        variance = float(of_size @ covariance @ of_size)
        on_size = covariance @ of_size / variance
        values, vectors = np.linalg.eigh(covariance - variance * np.outer(on_size, on_size))
        free = values > _RANK * np.trace(covariance)
        shape = vectors[:, free] / np.sqrt(values[free])
        shape -= np.outer(of_size, on_size @ shape)  # less what follows from the size
        size_sd = float(np.sqrt(variance))
        standard = np.concatenate([of_size[:, None] / size_sd, shape], axis=1)
        relative = draws / draws[:, size, None]
        roots = np.sqrt(relative[:, _ROWS] * relative[:, _COLUMNS]).mean(axis=0)
        quantity = np.concatenate([np.log(draws[:, :3]), relative[:, 3:] / roots], axis=1)
        moved = (centred @ standard[:, 1:]).T @ (quantity - quantity.mean(axis=0)) / len(draws)
        room = np.sqrt((moved**2).sum(axis=0))
        others = draws[:, :3].sum(axis=1) - draws[:, size]
        room[size] = min(size_sd, float(np.log(draws[:, size] / others).std()))
        return cls(mean, standard, size_sd, room)


def leading_variance(level: FloatArray) -> int:
    """Return which of uu, vv, ww (0, 1, 2) beams see best: the size that they tell; from their matrix (n_beam, 6)."""
    return int(np.argmax((level[:, :3] ** 2).sum(axis=0)))


def is_priors(decided: ArrayLike) -> NDArray[np.bool_]:
    """Tell which numbers are the prior's more than the data's.

    Parameters
    ----------
    decided : array_like
        Shares that the data decided; NaN where there is no posterior.

    Returns
    -------
    priors : ndarray of bool
        True below `PRIOR_BELOW`, and where the share is NaN.
    """
    return ~(np.asarray(decided, dtype=np.float64) >= PRIOR_BELOW)


def what_data_decided(
    stress: FloatArray, prior: PriorRoom, log_ratios: tuple[FloatArray, FloatArray] | None = None
) -> tuple[FloatArray, FloatArray]:
    r"""Return how far the data decided each stress, and how many stresses they told.

    Parameters
    ----------
    stress : ndarray, shape (n_record, n_chain, n_draw, 6)
        Draws of posteriors, m² s⁻²; n_chain a multiple of four, chains of one independent ensemble are neighbours.
    prior : PriorRoom
        Of the prior that they are compared with.
    log_ratios : tuple of ndarray, optional
        The same draws as x less something, over so much, of shape (6,): coordinates and spread of a `LogRatioPrior`.
        Where they are known, the stresses need not be turned back.

    Returns
    -------
    decided : ndarray, shape (n_record, 6)
        0: the prior's; 1: the data's. Below 0 where the posterior leans on the prior by more than the prior's own room.
    learnt : ndarray, shape (n_record,)
        Stresses learnt, of six.

    Notes
    -----
    With z the prior's standard coordinates (`PriorRoom`), Σ their posterior covariance with eigenvalues λ,

    .. math:: \mathrm{learnt} = \sum_i (1 - \lambda_i) = \mathrm{tr}(1 - \Sigma) .

    If the prior's centre is moved by one of its standard deviations along z_i, the posterior mean of a quantity q moves
    by Cov(q, z_i), exactly for a normal prior. In a weighted mean of prior and data that is the weight of the prior
    times the prior's own width. So

    .. math::
        \mathrm{decided} = 1 - \max\left( \frac{|\mathrm{Cov}(q, z_1)|}{s},
        \frac{1}{r} \sqrt{\sum_{i \ge 2} \mathrm{Cov}(q, z_i)^2} \right),

    with q = ln uu, ln vv, ln ww, and uv, uw, vw over the posterior mean of the root of their two variances. The first
    term is the weight of the prior's size (s its standard deviation), the second that of its shape (r the room).
    Noise of the data does not enter but by what the posterior leans on the prior for, so that a level alone, however
    well or badly known, decides no stress but those that the level is of.

    The sum of squares is the mean product of independent ensembles, which has no bias from Monte-Carlo errors, and is
    zero where it comes out below. With n effective draws the standard error of a share near 0 is about 1/√n, that of a
    share near 1 about that of its posterior's logarithm over r times n^(-1/2), and that of learnt √(2 Σ λ²/n).
    """
    parts = [slice(first, first + _BATCH) for first in range(0, len(stress), _BATCH)]
    inner, spread = (None, np.ones(len(STRESSES))) if log_ratios is None else log_ratios
    found = [_of_some(stress[some], None if inner is None else inner[some], spread, prior) for some in parts]
    decided, learnt = zip(*found, strict=True)
    return np.concatenate(decided), np.concatenate(learnt)


def _of_some(
    stress: FloatArray, inner: FloatArray | None, spread: FloatArray, prior: PriorRoom
) -> tuple[FloatArray, FloatArray]:
    """Return the same of so few records that their draws stay in the cache."""
    n_stress = len(STRESSES)
    of_ensemble = stress.reshape(len(stress), N_ENSEMBLE, -1, n_stress)
    n_draw = of_ensemble.shape[2]
    scale = np.concatenate([spread, np.ones(3)])
    # all that is needed are moments of x and of the covariances uv, uw, vw: ln vv and ln ww are sums of x
    joint = np.empty((len(stress), n_stress + 3, N_ENSEMBLE, n_draw))
    columns = np.moveaxis(joint, 1, -1)
    with np.errstate(invalid="ignore", divide="ignore"):  # tensors at the edge by rounding: NaN
        if inner is None:
            log_ratios_from_stress(of_ensemble, out=columns[..., :n_stress])
        else:
            columns[..., :n_stress] = inner.reshape(of_ensemble.shape)
        columns[..., n_stress:] = of_ensemble[..., 3:]
        root = np.sqrt(np.moveaxis(of_ensemble[..., :3], -1, 1).reshape(len(stress), 3, -1))
        size = (root @ root.swapaxes(-1, -2))[:, _ROWS, _COLUMNS] / root.shape[-1]
        mean = joint.mean(axis=-1)  # (record, quantity, ensemble)
        joint -= mean[..., None]
        mean = scale[:, None] * mean
        centred = joint.swapaxes(1, 2)
        covariance = centred @ centred.swapaxes(-1, -2)  # (record, ensemble, quantity, quantity)
        covariance *= scale[:, None] * scale / (n_draw - 1.0)
        of_inner = covariance[:, :, :n_stress]
        logarithms = of_inner[..., _LOGARITHM[0]] + np.where(_ADDED, of_inner[..., _LOGARITHM[1]], 0.0)
        relative = of_inner[..., n_stress:] / size[:, None, None, :]
        moved = prior.standard.T @ np.concatenate([logarithms, relative], axis=-1)
        of_size = np.abs(moved[:, :, 0].mean(axis=1)) / prior.size_sd
        products = moved[:, :, 1:].sum(axis=1) ** 2 - (moved[:, :, 1:] ** 2).sum(axis=1)
        square = products.sum(axis=1) / (N_ENSEMBLE * (N_ENSEMBLE - 1.0))
        fixed = prior.room <= np.sqrt(_RANK)
        of_shape = np.where(fixed, 1.0, np.sqrt(np.maximum(square, 0.0)) / np.where(fixed, 1.0, prior.room))
        # the covariance of all ensembles' draws: within them, and between their means
        apart = mean[:, :n_stress] - mean[:, :n_stress].mean(axis=-1, keepdims=True)
        whole = (n_draw - 1.0) * of_inner[..., :n_stress].sum(axis=1) + n_draw * apart @ apart.swapaxes(-1, -2)
        whole /= N_ENSEMBLE * n_draw - 1.0
        total = np.einsum("kp,rkl,lp->r", prior.standard, whole, prior.standard, optimize=False)
    return 1.0 - np.maximum(of_size, of_shape), prior.standard.shape[1] - total
