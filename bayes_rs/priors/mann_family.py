"""A prior on and near the one-point stresses of Mann turbulence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from bayes_rs._validation import FloatArray, check_non_negative, check_positive
from bayes_rs.errors import InputError
from bayes_rs.priors.interface import Prior, stress_from_correlations

LARGEST_GAMMA = 6.0
"""Where the table of shapes ends."""

# Chebyshev coefficients in 2 asinh(Γ)/asinh(6) − 1 of ln(uu/s), ln(vv/uu), ln(ww/uu) and artanh ρ_uw of the Mann model,
# s = αε^(2/3) L^(2/3); the values come from
# bayes_rs.turbulence.one_point.scaled_stresses at 22 nodes (seconds of quadrature); a test compares them with it.
_SHAPE = np.array(
    [
        [
            0.24311857,
            0.86079382,
            0.25336631,
            -0.00419645,
            -0.01467957,
            -0.00016645,
            0.00123301,
            0.00001210,
            -0.00008657,
            -0.00001707,
            0.00001174,
            0.00000238,
            -0.00000192,
            0.00000004,
            0.00000014,
            -0.00000001,
            -0.00000000,
            -0.00000000,
            0.00000000,
        ],
        [
            -0.36040271,
            -0.50184849,
            -0.15146832,
            -0.00518585,
            0.00708427,
            0.00182451,
            -0.00078303,
            -0.00027956,
            0.00012471,
            0.00002644,
            -0.00001882,
            0.00000035,
            0.00000120,
            -0.00000004,
            -0.00000001,
            -0.00000006,
            0.00000002,
            0.00000001,
            -0.00000000,
        ],
        [
            -0.68100108,
            -0.99377812,
            -0.34739252,
            -0.01483474,
            0.02283934,
            0.00039836,
            -0.00244447,
            0.00043137,
            0.00010681,
            -0.00007691,
            0.00003237,
            -0.00000768,
            -0.00000353,
            0.00000386,
            -0.00000124,
            -0.00000010,
            0.00000026,
            -0.00000011,
            0.00000002,
        ],
        [
            -0.29497076,
            -0.28633184,
            0.02286807,
            0.01571640,
            -0.00011224,
            -0.00158025,
            0.00008307,
            0.00008087,
            0.00002112,
            -0.00000752,
            -0.00000859,
            0.00000412,
            0.00000018,
            -0.00000064,
            0.00000026,
            -0.00000006,
            -0.00000000,
            0.00000002,
            -0.00000001,
        ],
    ]
)


def family_shape(gamma: FloatArray) -> FloatArray:
    """Return ln(uu/s), ln(vv/uu), ln(ww/uu) and artanh ρ_uw of the Mann model, shape (4, ...).

    Parameters
    ----------
    gamma : ndarray, shape (...)
        Anisotropy parameter Γ, from 0 to `LARGEST_GAMMA`.

    Returns
    -------
    shape : ndarray, shape (4, ...)
        The logarithms and the Fisher transform, each with an error below 1e-6; s = αε^(2/3) L^(2/3).

    Examples
    --------
    >>> family_shape(np.array(3.2)).round(4)
    array([ 0.5722, -0.5415, -1.0186, -0.4679])
    """
    return np.asarray(chebyshev.chebval(np.arcsinh(gamma) * (2.0 / np.arcsinh(LARGEST_GAMMA)) - 1.0, _SHAPE.T))


@dataclass(frozen=True, kw_only=True)
class MannPrior(Prior):
    """Stresses on or near those of Mann turbulence: any size, any Γ of a range, and a stated tolerance.

    Parameters
    ----------
    size : float
        Median of αε^(2/3) L^(2/3), m² s⁻². At Γ = 3, uu is 1.65 times this.
    sd_size : float
        Standard deviation of ln(αε^(2/3) L^(2/3)).
    gamma_low, gamma_high : float
        Γ is uniform between these, which lie between 0 and 6.
    tolerance : float
        Standard deviation of ln(vv/uu), of ln(ww/uu) and of artanh ρ_uv, artanh ρ_uw and artanh ρ_vw·u about the Mann
        model's: 0.1 lets a ratio of variances be 10 % off. It may be as small as you like.

    Raises
    ------
    InputError
        If a number is not valid, or the range of Γ is empty or leaves 0 to 6.

    Notes
    -----
    Seven independent standard normal numbers: size z₁, Γ through its distribution function, and five deviations,

        ln s = ln size + sd_size·z₁,  uu = s r_uu(Γ),  ln(vv/uu) = ln r_vv/r_uu + tolerance·z₃,  …,
        artanh ρ_uw = artanh ρ_uw(Γ) + tolerance·z₆,

    with r(Γ) the one-point stresses of the Mann model (Mann 1994). ρ_uv and the partial correlation ρ_vw·u are 0 in the
    model. The first coordinate is z₁ + ln r_uu(Γ)/sd_size: it moves uu alone, which the beams see best, so that size
    and Γ are nearly independent of each other in a posterior. It is the model of an infinite record: use it with
    ``target="ensemble"``, or allow for what the removal of the record's mean does to the ratios (uu loses the most)
    through the tolerance.

    References
    ----------
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886.

    Examples
    --------
    >>> MannPrior(tolerance=0.05).n_coordinate
    7
    """

    size: float = 0.6
    sd_size: float = 2.0
    gamma_low: float = 0.0
    gamma_high: float = 5.0
    tolerance: float = 0.1
    name: str = "mann"

    def __post_init__(self) -> None:
        """Check the parameters."""
        for key in ("size", "sd_size", "tolerance"):
            check_positive(getattr(self, key), what=key, unit="", where="prior 'mann'")
        low = check_non_negative(self.gamma_low, what="gamma_low", unit="", where="prior 'mann'")
        high = check_non_negative(self.gamma_high, what="gamma_high", unit="", where="prior 'mann'")
        if not low < high <= LARGEST_GAMMA:
            raise InputError(
                f"Invalid range of gamma {low:g} to {high:g} in prior 'mann': gamma_low must be below gamma_high, "
                f"and gamma_high at most {LARGEST_GAMMA:g}."
            )

    @property
    def n_coordinate(self) -> int:
        """Number of coordinates: size, Γ, and five deviations from the family."""
        return 7

    def gamma(self, coordinate: FloatArray) -> FloatArray:
        """Return Γ, shape (...), at coordinates, shape (..., 7)."""
        return np.asarray(self.gamma_low + (self.gamma_high - self.gamma_low) * scipy.special.ndtr(coordinate[..., 1]))

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        _, log_vv, log_ww, z_uw = family_shape(self.gamma(coordinate))
        log_uu = np.log(self.size) + self.sd_size * coordinate[..., 0]
        log_vv = log_uu + log_vv + self.tolerance * coordinate[..., 2]
        log_ww = log_uu + log_ww + self.tolerance * coordinate[..., 3]
        fisher = self.tolerance * coordinate[..., 4:]
        fisher[..., 1] += z_uw
        return stress_from_correlations(log_uu, log_vv, log_ww, np.tanh(fisher))

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density of the coordinates; the size given Γ is normal."""
        size = coordinate[..., 0] - family_shape(self.gamma(coordinate))[0] / self.sd_size
        square = size**2 + np.sum(coordinate[..., 1:] ** 2, axis=-1)
        return np.asarray(-0.5 * square - 0.5 * self.n_coordinate * np.log(2.0 * np.pi))

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior."""
        coordinate = rng.standard_normal((n_draw, self.n_coordinate))
        coordinate[:, 0] += family_shape(self.gamma(coordinate))[0] / self.sd_size
        return coordinate

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        return (
            f"mann: Mann turbulence with gamma uniform from {self.gamma_low:g} to {self.gamma_high:g}, size "
            f"αε^(2/3) L^(2/3) log-normal about {self.size:g} m² s⁻² (factor {np.exp(1.96 * self.sd_size):.3g} either "
            f"way, 95 %), ratios and correlations off the model by {self.tolerance:g} (one standard deviation)"
        )

    def widened(self, factor: float) -> Self:
        """Return the prior with the deviations and the range of Γ, about its middle, times `factor`.

        The range of Γ ends at 0 and at 6.
        """
        check_positive(factor, what="factor", unit="", where="prior 'mann'")
        middle, half = 0.5 * (self.gamma_low + self.gamma_high), 0.5 * factor * (self.gamma_high - self.gamma_low)
        return replace(
            self,
            sd_size=factor * self.sd_size,
            tolerance=factor * self.tolerance,
            gamma_low=max(middle - half, 0.0),
            gamma_high=min(middle + half, LARGEST_GAMMA),
        )
