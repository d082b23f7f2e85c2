"""What all likelihoods of beam variances share: the interface, the reduction of the data, and the tails."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.forward import RANK_TOLERANCE
from bayes_rs.priors.interface import sum_of_squares

REFERENCE_STRESS = np.array([1.0, 0.5, 0.27, 0.0, -0.15, 0.0])
"""Shape of R at which the data are reduced: near neutral flow. Another choice moves weight between beams, not truth."""


class Likelihood(ABC):
    """The narrow interface of all likelihoods: many records at once, each with the same number of draws.

    A likelihood is a frozen dataclass whose arrays have the records as first dimension.

    Attributes
    ----------
    gain : ndarray, shape (n_record, n_beam, 6)
        E[y] = gain · stresses + offset; rows of beams that a record does not use are zero.
    offset : ndarray, shape (n_record, n_beam)
        Variance of the instrument's own noise, m² s⁻²; 1 for beams that a record does not use.
    n_datum : ndarray of int, shape (n_record,)
        Number of independent numbers that the record's variances were reduced to.
    dof : float
        Degrees of freedom ν of the noise. If finite, it is a multivariate Student-t with the noise's covariance as
        scale matrix: the normal, integrated over a common factor of the covariance whose prior is inverse gamma,
        ν/χ²_ν.
    place : ndarray or None, shape (n_record, n_beam, n_gradient)
        Where the beams measure, in the direction of each gradient of the stresses: a gradient c multiplies what the
        stresses give a beam by exp(place · c). None if R is the same for all beams.
    """

    gain: FloatArray
    offset: FloatArray
    n_datum: NDArray[np.int64]
    dof: float
    place: FloatArray | None

    @property
    def n_record(self) -> int:
        """Number of records."""
        return len(self.gain)

    @abstractmethod
    def log_density(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return the log-likelihood, shape (n_record, n_draw), of stresses (n_record, n_draw, 6).

        `offset`, shape (n_record, n_draw), is the variance of instrument noise (m² s⁻²) that each draw adds to all
        beams; `gradient`, shape (n_record, n_draw, n_gradient), makes the stresses differ from beam to beam by the
        factors exp(place · gradient). A tensor that gives a beam no variance, or a negative one, has likelihood zero.
        """

    @abstractmethod
    def whitened_residual(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return residuals, shape (n_record, n_draw, n_seen): half their square has the curvature of −log_density.

        The sum of their squares, halved, is −log_density but for a constant, or the logarithm of a determinant.
        """

    def expected(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return the expected variances of the beams, shape (n_record, n_draw, n_beam), m² s⁻²."""
        mean = expected_signal(stress, self.gain, self.place, gradient) + self.offset[:, None, :]
        return np.asarray(mean if offset is None else mean + offset[:, :, None])

    def take(self, records: NDArray[np.int64]) -> Self:
        """Return the likelihood of some of the records."""
        whole: Any = self
        parts = {field.name: getattr(self, field.name) for field in fields(whole)}
        arrays = {name: value[records] for name, value in parts.items() if isinstance(value, np.ndarray)}
        return cast("Self", replace(whole, **arrays))

    def records_last(self) -> Self:
        """Return the same likelihood with arrays that run along the records in memory.

        So few draws of many records are quick, if the stresses run along the records, too.
        """
        whole: Any = self
        parts = {field.name: getattr(self, field.name) for field in fields(whole)}
        arrays = {name: np.asfortranarray(value) for name, value in parts.items() if isinstance(value, np.ndarray)}
        return cast("Self", replace(whole, **arrays))


class NormalLikelihood(Likelihood):
    """A likelihood whose data are normal, or Student-t, about what the stresses say, once they are reduced."""

    @abstractmethod
    def _whiten(
        self, stress: FloatArray, offset: FloatArray | None, gradient: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return normal residuals (n_record, n_draw, n_seen) and the log of the density's factor, along the records.

        Both are NaN where a tensor gives a beam no variance, or a negative one.
        """

    def log_density(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return the log-likelihood, shape (n_record, n_draw); see `Likelihood`.

        For points, a tensor that gives a beam no variance is one of rank one across the beam, to rounding; with a probe
        volume the gain is interpolated, and is a positive form only up to the error of the interpolation.
        """
        with np.errstate(invalid="ignore"):
            residual, log_factor = self._whiten(stress, offset, gradient)
            square = sum_of_squares(residual)
            density = np.asarray(log_factor - half_square(square, self.n_datum, self.dof))
        known = np.isfinite(density)
        if not known.all():
            density[~known] = -np.inf
        return density

    def whitened_residual(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return residuals, shape (n_record, n_draw, n_seen); see `Likelihood`."""
        return with_tails(self.residual(stress, offset, gradient), self.n_datum, self.dof)

    def residual(
        self, stress: FloatArray, offset: FloatArray | None = None, gradient: FloatArray | None = None
    ) -> FloatArray:
        """Return the same residuals before their tails are shortened: independent, of variance 1 or t-distributed."""
        return self._whiten(stress, offset, gradient)[0]


def expected_signal(
    stress: FloatArray, gain: FloatArray, place: FloatArray | None, gradient: FloatArray | None
) -> FloatArray:
    """Return gain · stress (times exp(place · gradient)), shape (n_record, n_draw, n_beam): what is not noise."""
    mean = np.asarray(stress @ gain.swapaxes(-1, -2))
    if place is not None and gradient is not None:
        mean *= np.exp(gradient @ place.swapaxes(-1, -2))
    return mean


@dataclass(frozen=True)
class BeamData:
    """The checked data of many records.

    Parameters
    ----------
    gain, offset : ndarray
        As in `Likelihood`.
    used : ndarray of bool, shape (n_record, n_beam)
        Which variances count.
    variance : ndarray, shape (n_record, n_beam)
        Radial variances, m² s⁻²; 1 for beams that a record does not use.
    place : ndarray or None
        As in `Likelihood`; rows of beams that a record does not use are zero.
    """

    gain: FloatArray
    offset: FloatArray
    used: NDArray[np.bool_]
    variance: FloatArray
    place: FloatArray | None = None

    def relative_covariance(self, covariance: FloatArray) -> FloatArray:
        """Return K with zeros for beams that are not used."""
        return np.where(self.used[:, :, None] & self.used[:, None, :], covariance, 0.0)

    def seen_directions(self, scale: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return what of the data stresses and gradients can move, where E[y] is `scale`; see `seen_directions`."""
        relative = self.gain / scale[:, :, None]
        return seen_directions(relative if self.place is None else np.concatenate([relative, self.place], axis=-1))

    def reference_variance(self, reference: FloatArray | None) -> FloatArray:
        """Return expected variances to reduce the data at: given ones (n_beam,), or those of `REFERENCE_STRESS`."""
        level = self.gain @ REFERENCE_STRESS if reference is None else np.broadcast_to(reference, self.variance.shape)
        return np.where(self.used, level, 1.0)


def beam_data(
    variance: FloatArray,
    used: NDArray[np.bool_],
    gain: FloatArray,
    offset: FloatArray | float = 0.0,
    place: FloatArray | None = None,
) -> BeamData:
    """Check variances, and mask what is not used.

    Raises
    ------
    InputError
        If a record uses no beam, or a used variance is not positive.
    """
    idle = np.flatnonzero(~used.any(axis=1))
    if len(idle):
        raise InputError(f"Record {idle[0]} has no usable beam: leave such records out before the likelihood is built.")
    bad = np.argwhere(used & ~(variance > 0.0))
    if len(bad):
        record, beam = (int(i) for i in bad[0])
        raise InputError(
            f"Invalid variance {variance[record, beam]} of record {record}, beam {beam}: it must be positive; "
            "flag the beam."
        )
    return BeamData(
        gain=np.where(used[:, :, None], gain, 0.0),
        offset=np.where(used, np.broadcast_to(np.asarray(offset, dtype=np.float64), variance.shape), 1.0),
        used=used,
        variance=np.where(used, variance, 1.0),
        place=None if place is None else np.where(used[:, :, None], place, 0.0),
    )


def seen_directions(relative_gain: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return what of the data the stresses can move.

    Parameters
    ----------
    relative_gain : ndarray, shape (n_record, n_beam, 6)
        ∂ ln E[y]/∂R at some R; more columns for what else moves ln E[y].

    Returns
    -------
    left : ndarray, shape (n_record, n_beam, n)
        Orthonormal basis U of its column space; columns that a record does not need are zero.
    seen : ndarray of bool, shape (n_record, n)
        Which columns it needs.
    """
    left, singular, _ = np.linalg.svd(relative_gain, full_matrices=False)
    seen = singular > RANK_TOLERANCE * singular[:, :1]
    return left * seen[:, None, :], seen


def factor_reduced(reduced: FloatArray, seen: NDArray[np.bool_], n_beam: int, *, what: str) -> FloatArray:
    """Return Cholesky factors of the reduced data's covariances, with unit pivots for what a record does not see.

    Raises
    ------
    NotPositiveDefiniteError
        If one is singular: the noise model says that a combination of stresses is known without error.
    """
    # directions that a record does not have get a unit pivot and a zero row: no part in residual and determinant
    whole = reduced + unit_pivots(seen)
    smallest = np.min(np.linalg.eigvalsh(whole), axis=-1)
    worst = int(np.argmin(smallest))
    if smallest[worst] <= n_beam * np.finfo(np.float64).eps * np.max(np.abs(reduced[worst])):
        raise NotPositiveDefiniteError(
            f"The noise of record {worst} is singular: the smallest eigenvalue of its reduced {what} is "
            f"{smallest[worst]:.3g} and must be positive; use a noise model with more realizations, or fewer beams.",
            smallest_eigenvalue=float(smallest[worst]),
        )
    return np.asarray(np.linalg.cholesky(whole))


def whiten_reduced(
    reduced: FloatArray, left: FloatArray, seen: NDArray[np.bool_], *, what: str
) -> tuple[FloatArray, FloatArray]:
    """Return what turns data into reduced data of unit covariance, and the log-determinants of what they had.

    Parameters
    ----------
    reduced : ndarray, shape (n_record, n_seen, n_seen)
        Covariances of the reduced data leftᵀ y.
    left : ndarray, shape (n_record, n_beam, n_seen)
        What reduces them.
    seen : ndarray of bool, shape (n_record, n_seen)
        Which directions a record has.
    what : str
        Their name, for the message.

    Returns
    -------
    whitening : ndarray, shape (n_record, n_seen, n_beam)
        W: L⁻¹ leftᵀ, with L the Cholesky factor.
    log_determinant : ndarray, shape (n_record,)
        ln det of the reduced covariances.

    Raises
    ------
    NotPositiveDefiniteError
        As `factor_reduced`.
    """
    factor = factor_reduced(reduced, seen, left.shape[1], what=what)
    whitening = np.asarray(np.linalg.solve(factor, left.swapaxes(-1, -2)), dtype=np.float64)
    return whitening, np.asarray(2.0 * np.log(np.einsum("rss->rs", factor)).sum(axis=1))


def unit_pivots(seen: NDArray[np.bool_]) -> FloatArray:
    """Return diagonal matrices with 1 where a direction is not seen."""
    return np.asarray(np.eye(seen.shape[1]) * np.where(seen, 0.0, 1.0)[:, None, :])


def check_tails(inflation: float, dof: float) -> None:
    """Check the two options that widen the noise.

    Raises
    ------
    InputError
        If one is not above zero.
    """
    if not (np.isfinite(inflation) and inflation > 0.0):
        raise InputError(f"Invalid inflation {inflation!r}: it must be a finite number above zero; 1 changes nothing.")
    if not dof > 0.0:
        raise InputError(f"Invalid dof {dof!r}: it must be above zero; infinity means normal noise.")


def log_normalizer(n_datum: NDArray[np.int64], log_determinant: FloatArray, dof: float) -> FloatArray:
    """Return the log of the constant factor of the normal or Student-t; shapes as those of `log_determinant`."""
    if np.isinf(dof):
        return np.asarray(-0.5 * (log_determinant + n_datum * np.log(2.0 * np.pi)))
    of_tails = gammaln(0.5 * (dof + n_datum)) - gammaln(0.5 * dof) - 0.5 * n_datum * np.log(dof * np.pi)
    return np.asarray(of_tails - 0.5 * log_determinant)


def half_square(square: FloatArray, n_datum: NDArray[np.int64], dof: float) -> FloatArray:
    """Return ½s for the normal, ½(ν + n) ln(1 + s/ν) for the Student-t, of s (n_record, n_draw)."""
    if np.isinf(dof):
        return 0.5 * square
    return np.asarray(0.5 * (dof + n_datum[:, None]) * np.log1p(square / dof))


def with_tails(residual: FloatArray, n_datum: NDArray[np.int64], dof: float) -> FloatArray:
    """Shorten normal residuals (n_record, n_draw, n_seen) so that half their square is the Student-t's exponent."""
    if np.isinf(dof):
        return residual
    ratio = np.einsum("rds,rds->rd", residual, residual) / dof
    # ln(1 + x)/x; below 1e-8 it is 1 to rounding
    slope = np.where(ratio > 1e-8, np.log1p(ratio) / np.maximum(ratio, 1e-8), 1.0)
    return np.asarray(residual * np.sqrt((dof + n_datum[:, None]) / dof * slope)[:, :, None])
