"""Noise of variances that scatter by more than theory's: in air whose strength wanders, and of uncertain offsets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.likelihoods.reduced_noise import ReducedRecordNoise
from bayes_rs.noise.record_noise import RecordNoise, SonicNoise

_NORMAL = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # the identity, in the order of the stresses


def scattered(noise: RecordNoise, scatter: FloatArray) -> RecordNoise:
    r"""Return the noise of records whose variances scatter more.

    Parameters
    ----------
    noise : RecordNoise
        By theory.
    scatter : ndarray, shape (n_record, 2)
        Relative variances v of a factor that all beams share, and w of one that each beam has for itself.

    Returns
    -------
    noise : RecordNoise
        With the covariance of the products.

    Notes
    -----
    The factors have the mean one and are independent of the eddies, so that

    .. math:: 1 + K'_{ab} = (1 + K_{ab}) (1 + v) (1 + w \delta_{ab}) .
    """
    common, own = 1.0 + scatter[:, 0, None, None], 1.0 + scatter[:, 1, None, None]
    n_beam = noise.covariance.shape[-1]
    factor = common * np.where(np.eye(n_beam, dtype=bool), own, 1.0)
    return replace(
        noise,
        covariance=(1.0 + noise.covariance) * factor - 1.0,
        state=np.arange(len(scatter), dtype=np.int64),  # no two records need be the same
    )


def scattered_reduced(noise: ReducedRecordNoise, left: FloatArray, scatter: FloatArray) -> ReducedRecordNoise:
    r"""Return the reduced noise of records whose variances scatter more; as `scattered`.

    Parameters
    ----------
    noise : ReducedRecordNoise
        By theory.
    left : ndarray, shape (n_beam, n_seen)
        U, the basis that the covariances were reduced with.
    scatter : ndarray, shape (n_record, 2)
        v and w.

    Returns
    -------
    noise : ReducedRecordNoise
        With C' = C + ln(1 + v) 11ᵀ + ln(1 + w) I in place of C.
    """
    ones = left.sum(axis=0)
    common, own = np.log1p(scatter).T
    added = common[:, None, None] * np.outer(ones, ones) + own[:, None, None] * (left.T @ left)
    return replace(
        noise,
        covariance=noise.covariance + added,
        log_variance=noise.log_variance + (common + own)[:, None],
    )


def shifted(noise: RecordNoise, relative_sd: FloatArray) -> RecordNoise:
    r"""Return the noise of records whose variances all lie by the same unknown amount too high or too low.

    Parameters
    ----------
    noise : RecordNoise
        Without that.
    relative_sd : ndarray, shape (n_record, n_beam)
        Standard deviation t of the amount, over each beam's variance.

    Returns
    -------
    noise : RecordNoise
        With :math:`1 + K'_{ab} = (1 + K_{ab}) \exp(s_a s_b)` and :math:`s^2 = \ln(1 + t^2)`: log-normal, so that the
        covariance of ln y stays positive. What is left of an instrument's noise is such an amount: it looks like an
        isotropic part of R.
    """
    log_sd = np.sqrt(np.log1p(relative_sd**2))
    factor = np.exp(log_sd[:, :, None] * log_sd[:, None, :])
    return replace(
        noise,
        covariance=(1.0 + noise.covariance) * factor - 1.0,
        state=np.arange(len(relative_sd), dtype=np.int64),
    )


def shifted_reduced(noise: ReducedRecordNoise, left: FloatArray, relative_sd: FloatArray) -> ReducedRecordNoise:
    """Return the reduced noise of records that are all shifted; as `shifted`.

    Parameters
    ----------
    noise : ReducedRecordNoise
        Without that.
    left : ndarray, shape (n_beam, n_seen)
        U, the basis that the covariances were reduced with.
    relative_sd : ndarray, shape (n_record, n_beam)
        t.

    Returns
    -------
    noise : ReducedRecordNoise
        With C' = C + s sᵀ in place of C.
    """
    log_sd = np.sqrt(np.log1p(relative_sd**2))
    seen = log_sd @ left
    return replace(
        noise,
        covariance=noise.covariance + seen[:, :, None] * seen[:, None, :],
        log_variance=noise.log_variance + log_sd**2,
    )


def scattered_sonic(noise: SonicNoise, scatter: FloatArray) -> SonicNoise:
    """Return the joint moments with a sonic that is in the same air: it shares the factor of all beams.

    Parameters
    ----------
    noise : SonicNoise
        By theory.
    scatter : ndarray, shape (n_record, 2)
        v and w, as for `scattered`.

    Returns
    -------
    noise : SonicNoise
        The covariances of the products.
    """
    common = scatter[:, 0, None, None]
    return replace(
        noise,
        covariance=(1.0 + common) * noise.covariance + common * np.outer(_NORMAL, _NORMAL),
        beam_covariance=(1.0 + common) * noise.beam_covariance + common * _NORMAL[:, None],
        state=np.arange(len(scatter), dtype=np.int64),
    )
