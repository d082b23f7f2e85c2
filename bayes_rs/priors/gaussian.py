"""The user's own normal distribution of the six stresses, truncated to realizable tensors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_array, check_positive
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.priors.interface import N_COORDINATE, Prior

_SEED = 6
_BATCH = 100_000
_ENOUGH = 40_000
"""Realizable draws after which the share is known well enough: to half a per cent of itself."""
_MOST = 4_000_000
_LEAST_SHARE = 1e-4
_SOFT = 0.5
"""Diagonal elements of the factor are linear above this multiple of their typical value, logarithmic below."""


@dataclass(frozen=True, eq=False, repr=False)
class GaussianPrior(Prior):
    """A normal distribution of the six stresses, truncated to realizable tensors.

    Parameters
    ----------
    mean : array_like, shape (6,)
        Mean before the truncation, in the order uu, vv, ww, uv, uw, vw, m² s⁻². It need not be realizable.
    covariance : array_like, shape (6, 6)
        Covariance before the truncation, m⁴ s⁻⁴: symmetric and positive definite.
    name : str
        What the prior is called in results.

    Attributes
    ----------
    share : float
        Probability that a draw of the normal distribution is realizable, which normalizes the density.
    share_error : float
        Standard error of `share`: it comes from draws with a fixed seed, at least 40 000 of them realizable, or from
        four million draws. The posterior does not depend on it.

    Raises
    ------
    InputError
        If an array has another shape, an entry is not finite, the covariance is not symmetric, or fewer than one draw
        in 10⁴ is realizable.
    NotPositiveDefiniteError
        If the covariance is not positive definite.

    Notes
    -----
    p(R) = N(R; mean, covariance) / share for realizable R. The map goes through the Cholesky factor
    R = L₀ M Mᵀ L₀ᵀ, L₀L₀ᵀ the mean of realizable draws and M lower triangular with the diagonal ½ ln(1 + exp(2y)), and
    ∂R/∂M has the determinant 2³ M₁₁³ M₂₂² M₃₃ |L₀|⁴. (y, off-diagonal M) = centre + factor · coordinate,
    with the mean and covariance of realizable draws, so that the coordinates are near standard normal.

    Examples
    --------
    >>> prior = GaussianPrior([1.0, 0.6, 0.4, 0.0, -0.2, 0.0], 0.01 * np.eye(6))
    >>> bool(prior.share > 0.98)
    True
    """

    mean: ArrayLike
    covariance: ArrayLike
    name: str = "gaussian"
    share: float = field(init=False)
    share_error: float = field(init=False)
    _mean: FloatArray = field(init=False, repr=False)
    _root: FloatArray = field(init=False, repr=False)
    _reference: FloatArray = field(init=False, repr=False)
    _centre: FloatArray = field(init=False, repr=False)
    _factor: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the moments, find the share of realizable tensors, and set up the map."""
        where = f"prior {self.name!r}"
        mean = check_array(self.mean, (N_COORDINATE,), what=f"mean of {where}")
        covariance = check_array(self.covariance, (N_COORDINATE, N_COORDINATE), what=f"covariance of {where}")
        if not np.allclose(covariance, covariance.T, rtol=1e-10, atol=1e-12 * np.abs(covariance).max()):
            raise InputError(
                f"Invalid covariance of {where}: it must be symmetric, and its off-diagonal entries differ."
            )
        covariance = 0.5 * (covariance + covariance.T)
        smallest = float(np.linalg.eigvalsh(covariance)[0])
        if smallest <= N_COORDINATE * np.finfo(np.float64).eps * float(np.abs(covariance).max()):
            raise NotPositiveDefiniteError(
                f"Invalid covariance of {where}: its smallest eigenvalue is {smallest:.3g} m⁴ s⁻⁴, and it must be "
                "positive definite.",
                smallest_eigenvalue=smallest,
            )
        keep = object.__setattr__
        keep(self, "mean", mean.copy())
        keep(self, "covariance", covariance)
        keep(self, "_mean", mean.copy())
        keep(self, "_root", np.linalg.cholesky(covariance))
        draws, n_tried = self._realizable(_ENOUGH, _MOST, _BATCH, np.random.default_rng(_SEED))
        share = len(draws) / n_tried
        if share < _LEAST_SHARE:
            raise InputError(
                f"Too few realizable tensors in {where}: {len(draws)} of {n_tried} draws, and at least 1 in 10 000 is "
                "needed; check the order uu, vv, ww, uv, uw, vw, or move the mean towards realizable tensors."
            )
        keep(self, "share", share)
        keep(self, "share_error", float(np.sqrt(share * (1.0 - share) / n_tried)))
        reference = np.zeros((3, 3))
        reference[_ROWS, _COLUMNS] = _cholesky(draws.mean(axis=0))
        keep(self, "_reference", reference)
        inner = self._inner_coordinate(draws)
        keep(self, "_centre", inner.mean(axis=0))
        keep(self, "_factor", np.linalg.cholesky(np.cov(inner, rowvar=False)))

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density of the coordinates: that of the stresses, times the Jacobian of the map."""
        inner = self._inner(coordinate)
        log_diagonal = np.log(_soft(inner[..., :3]))
        whitened = np.linalg.solve(self._root, (self._from_inner(inner) - self._mean)[..., None])[..., 0]
        density = -0.5 * np.sum(whitened**2, axis=-1) - 0.5 * N_COORDINATE * np.log(2.0 * np.pi)
        density -= np.log(np.diag(self._root)).sum() + np.log(self.share)
        jacobian = log_diagonal @ np.array([3.0, 2.0, 1.0]) + 3.0 * np.log(2.0)
        jacobian -= np.sum(np.logaddexp(0.0, -inner[..., :3] / _SOFT), axis=-1)  # slope of the soft positive part
        constant = 4.0 * np.log(np.diag(self._reference)).sum() + np.log(np.diag(self._factor)).sum()
        return np.asarray(density + jacobian + constant)

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior, by rejection of tensors that are not realizable."""
        batch = min(int(1.2 * n_draw / self.share) + 100, _BATCH)
        most = int(100.0 * (n_draw + 10) / self.share)  # never reached: the number that is needed is binomial
        inner = self._inner_coordinate(self._realizable(n_draw, most, batch, rng)[0][:n_draw])
        return np.asarray(np.linalg.solve(self._factor, (inner - self._centre).T).T)

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        return self._from_inner(self._inner(coordinate))

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        mean = ", ".join(f"{value:.3g}" for value in self._mean)
        spread = ", ".join(f"{value:.3g}" for value in np.sqrt(np.sum(self._root**2, axis=1)))
        return (
            f"{self.name}: normal with mean ({mean}) and standard deviation ({spread}) m² s⁻² "
            f"in uu, vv, ww, uv, uw, vw, cut to realizable tensors ({100.0 * self.share:.3g} % of it)"
        )

    def widened(self, factor: float) -> Self:
        """Return the prior with the covariance times factor²."""
        check_positive(factor, what="factor", unit="", where=f"prior {self.name!r}")
        return replace(self, covariance=factor**2 * np.asarray(self.covariance))

    def _realizable(self, n_wanted: int, n_most: int, batch: int, rng: np.random.Generator) -> tuple[FloatArray, int]:
        """Draw until `n_wanted` are realizable or too many were drawn; return those and how many were drawn."""
        kept, n_kept, n_tried = [np.empty((0, N_COORDINATE))], 0, 0
        while n_kept < n_wanted and n_tried < n_most:
            draws = self._mean + rng.standard_normal((batch, N_COORDINATE)) @ self._root.T
            n_tried += batch
            part = draws[np.all(_pivots(draws) > 0.0, axis=-1)]
            n_kept += len(part)
            kept.append(part)
        return np.concatenate(kept), n_tried

    def _inner(self, coordinate: FloatArray) -> FloatArray:
        return np.asarray(self._centre + coordinate @ self._factor.T)

    def _from_inner(self, inner: FloatArray) -> FloatArray:
        """Build stresses from (y₁₁, y₂₂, y₃₃, M₂₁, M₃₁, M₃₂)."""
        matrix = np.zeros((*inner.shape[:-1], 3, 3))
        matrix[..., _ROWS, _COLUMNS] = np.concatenate([_soft(inner[..., :3]), inner[..., 3:]], axis=-1)
        lower = self._reference @ matrix
        a, b, c, d, e, f = (lower[..., row, column] for row, column in zip(_ROWS, _COLUMNS, strict=True))
        return np.stack([a * a, b * b + d * d, c * c + e * e + f * f, a * d, a * e, d * e + b * f], axis=-1)

    def _inner_coordinate(self, stress: FloatArray) -> FloatArray:
        """Return (y₁₁, y₂₂, y₃₃, M₂₁, M₃₁, M₃₂) of realizable stresses, shape (n, 6)."""
        lower = np.zeros((*stress.shape[:-1], 3, 3))
        lower[..., _ROWS, _COLUMNS] = _cholesky(stress)
        matrix = np.linalg.solve(self._reference, lower)[..., _ROWS, _COLUMNS]
        diagonal = matrix[..., :3]
        return np.concatenate([diagonal + _SOFT * np.log(-np.expm1(-diagonal / _SOFT)), matrix[..., 3:]], axis=-1)


_ROWS = np.array([0, 1, 2, 1, 2, 2])
_COLUMNS = np.array([0, 1, 2, 0, 0, 1])


def _pivots(stress: FloatArray) -> FloatArray:
    """Return the squares of the diagonal of the Cholesky factor, shape (..., 3): all positive if R is definite."""
    with np.errstate(invalid="ignore", divide="ignore"):  # after a pivot that is not positive the next mean nothing
        uu, vv, ww, uv, uw, vw = np.moveaxis(stress, -1, 0)
        second = vv - uv * uv / uu
        third = ww - uw * uw / uu - (vw - uv * uw / uu) ** 2 / second
    return np.stack([uu, second, third], axis=-1)


def _cholesky(stress: FloatArray) -> FloatArray:
    """Return the Cholesky factor as (L₁₁, L₂₂, L₃₃, L₂₁, L₃₁, L₃₂), shape (..., 6), of definite tensors."""
    diagonal = np.sqrt(_pivots(stress))
    l21 = stress[..., 3] / diagonal[..., 0]
    l31 = stress[..., 4] / diagonal[..., 0]
    l32 = (stress[..., 5] - l21 * l31) / diagonal[..., 1]
    return np.concatenate([diagonal, np.stack([l21, l31, l32], axis=-1)], axis=-1)


def _soft(value: FloatArray) -> FloatArray:
    """Soft positive part ½ ln(1 + exp(2y))."""
    return np.asarray(_SOFT * np.logaddexp(0.0, value / _SOFT))
