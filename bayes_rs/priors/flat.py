"""The uniform density over realizable tensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import numpy as np
import scipy

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.priors.interface import N_COORDINATE, Prior

_DIAGONAL = np.array([4.0, 3.0, 2.0])
"""Powers of the diagonal elements of the Cholesky factor that are uniform on (0, 1)."""
_SIDE = np.array([2.5, 2.5, 2.0])
"""The elements beside the diagonal are 2b − 1 with b Beta(power, power)."""
_SCALE = 1.0 / np.sqrt(2.0 * _SIDE)
"""Gives their coordinates a standard deviation near one."""


@cache
def _log_constant() -> float:
    """Return the log of the density's constant factor."""
    return float(np.sum(np.log(_SCALE) - scipy.special.betaln(0.5, _SIDE)) - 1.5 * np.log(2.0 * np.pi))


@dataclass(frozen=True)
class FlatPrior(Prior):
    """Uniform density over all realizable tensors whose three variances are below a bound.

    Parameters
    ----------
    bound : float
        Upper bound of uu, vv and ww, m² s⁻².

    Notes
    -----
    Flat is not weak: the room that realizable covariances have grows with the variances, so each variance has the
    marginal density 2σ²/bound², which favours large ones. With s = σ²/bound, s² is uniform on (0, 1). The correlations
    ρ_uv and ρ_uw have the density (1 − ρ²)^(1/2)·2/π, and the partial correlation ρ_vw·u is uniform on (−1, 1): that is
    the uniform density over (uv, uw, vw) given the variances (Joe 2006, d = 3, with unit exponent).

    The coordinates go through the Cholesky factor R = bound · V Vᵀ. As ∂R/∂V is proportional to v₁₁³ v₂₂² v₃₃, its rows
    are independent under the flat density: v₁₁⁴ is uniform on (0, 1); in the half disc (v₂₁, v₂₂) and in the half ball
    (v₃₁, v₃₂, v₃₃), v₂₁ and v₃₁ have the density ∝ (1 − v²)^(3/2), v₃₂ over the room that v₃₁ leaves has ∝ 1 − v², and
    v₂₂ and v₃₃ over the room that is left have uniform cubes and squares. The coordinates of the diagonal are normal
    scores of these uniform numbers, the others scaled artanh. Against coordinates by variances and correlations, more
    of an independence proposal is accepted: uv and uw are linear in v₂₁ and v₃₁ when uu is known. They serve data
    within some four decades of the bound; far below that samplers fall short, and say so: then give a lower bound.

    References
    ----------
    Joe (2006), J. Multivariate Anal. 97, 2177–2189, doi:10.1016/j.jmva.2005.05.010.
    """

    bound: float = 25.0
    name: str = "flat"

    def __post_init__(self) -> None:
        """Check the parameter."""
        check_positive(self.bound, what="bound", unit="m² s⁻²", where="prior 'flat'")

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density of the coordinates, which are independent: three normal, three of artanh of a Beta."""
        of_sides = -2.0 * _log_cosh(_SCALE * coordinate[..., 3:]) @ _SIDE
        return np.asarray(_log_constant() - 0.5 * np.sum(coordinate[..., :3] ** 2, axis=-1) + of_sides)

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior."""
        diagonal = rng.standard_normal((n_draw, 3))
        side = 2.0 * rng.beta(_SIDE, _SIDE, (n_draw, 3)) - 1.0
        return np.concatenate([diagonal, np.arctanh(side) / _SCALE], axis=-1)

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        scaled = _SCALE * coordinate[..., 3:]
        diagonal, side, room = (
            np.exp(scipy.special.log_ndtr(coordinate[..., :3]) / _DIAGONAL),
            np.tanh(scaled),
            np.exp(-_log_cosh(scaled)),
        )
        v11 = diagonal[..., 0]
        v21, v22 = side[..., 0], room[..., 0] * diagonal[..., 1]
        v31, v32 = side[..., 1], room[..., 1] * side[..., 2]
        v33 = room[..., 1] * room[..., 2] * diagonal[..., 2]
        stress = np.empty((*v11.shape, N_COORDINATE))
        stress[..., 0] = v11 * v11
        stress[..., 1] = v21 * v21 + v22 * v22
        stress[..., 2] = v31 * v31 + v32 * v32 + v33 * v33
        stress[..., 3] = v11 * v21
        stress[..., 4] = v11 * v31
        stress[..., 5] = v21 * v31 + v22 * v32
        stress *= self.bound
        return stress

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        return (
            f"flat: uniform over realizable tensors with uu, vv, ww below {self.bound:g} m² s⁻² "
            "(favours large variances)"
        )

    def widened(self, factor: float) -> Self:
        """Return the prior with its bound times `factor`."""
        check_positive(factor, what="factor", unit="", where="prior 'flat'")
        return replace(self, bound=factor * self.bound)


def _log_cosh(value: FloatArray) -> FloatArray:
    size = np.abs(value)
    return np.asarray(size + np.log1p(np.exp(-2.0 * size)) - np.log(2.0))
