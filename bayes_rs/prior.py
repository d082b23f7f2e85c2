"""Priors on the Reynolds stress tensor, by name.

Every prior is a smooth map from six independent, unbounded coordinates to a realizable tensor, and a proper density of
those coordinates. So no draw and no proposal of the sampler can leave the realizable tensors, there is no edge to run
into, and a prior is one short class.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logit

from bayes_rs._validation import FloatArray, as_generator, check_choice, check_positive

N_COORDINATE = 6
"""Number of coordinates of a prior: one for each stress."""


class Prior(ABC):
    """The narrow interface of all priors: a name, words, independent coordinates and the map from them to stresses."""

    name: str

    @abstractmethod
    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates, shape (..., 6), to stresses, shape (..., 6), m² s⁻²."""

    @abstractmethod
    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the normalized log-density, shape (...), of coordinates, shape (..., 6); smooth, with one maximum."""

    @abstractmethod
    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior, shape (n_draw, 6)."""

    @abstractmethod
    def in_words(self) -> str:
        """Say in one line what the prior assumes."""

    def draw(self, n_draw: int, seed: int | np.random.Generator) -> FloatArray:
        """Draw stresses from the prior, shape (n_draw, 6), m² s⁻²."""
        return self.stress(self.draw_coordinate(n_draw, as_generator(seed)))


@dataclass(frozen=True)
class WeakPrior(Prior):
    """Almost nothing about the size of the turbulence, atmospheric ratios for its shape.

    Parameters
    ----------
    median_uu : float
        Median of uu, m² s⁻².
    log_sd_uu : float
        Standard deviation of ln uu. With 2, the central 95 % spans a factor of 50 to both sides of the median.
    ratio_vv, ratio_ww : float
        Medians of vv/uu and ww/uu.
    log_sd_vv, log_sd_ww : float
        Standard deviations of ln(vv/uu) and ln(ww/uu).
    z_uw : float
        Mean of the Fisher transform of the correlation of u and w; those of u and v, and of v and w given u, are 0.
    z_sd : float
        Standard deviation of all three Fisher transforms.

    Notes
    -----
    ln uu ~ N(ln 1, 2²), ln vv/uu ~ N(ln 0.5, 0.5²), ln ww/uu ~ N(ln 0.27, 0.6²), and for the correlations
    artanh ρ_uv ~ N(0, 0.35²), artanh ρ_uw ~ N(−0.3, 0.35²), artanh ρ_vw·u ~ N(0, 0.35²), where ρ_vw·u is the partial
    correlation of v and w given u. All independent. Every draw is realizable.

    The centres are near the neutral surface layer, σ_u : σ_v : σ_w : u* = 2.39 : 1.92 : 1.25 : 1, which has
    vv/uu = 0.65, ww/uu = 0.27, ρ_uw = −0.33; the widths also hold the ratios of convective and stable flow and those
    of Mann spectra with Γ from 0 to 5.

    References
    ----------
    Panofsky and Dutton (1984), Atmospheric Turbulence, Wiley, Table 7.1 (the ratios over flat terrain).
    """

    median_uu: float = 1.0
    log_sd_uu: float = 2.0
    ratio_vv: float = 0.5
    log_sd_vv: float = 0.5
    ratio_ww: float = 0.27
    log_sd_ww: float = 0.6
    z_uw: float = -0.3
    z_sd: float = 0.35
    name: str = "weak"

    def __post_init__(self) -> None:
        """Check the parameters."""
        for key in ("median_uu", "log_sd_uu", "ratio_vv", "log_sd_vv", "ratio_ww", "log_sd_ww", "z_sd"):
            check_positive(getattr(self, key), what=key, unit="", where="prior 'weak'")

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density of the coordinates, which are independent and standard normal."""
        square = np.sum(coordinate**2, axis=-1, dtype=np.float64)
        return np.asarray(-0.5 * square - 0.5 * N_COORDINATE * np.log(2.0 * np.pi))

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior."""
        return rng.standard_normal((n_draw, N_COORDINATE))

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        log_uu = np.log(self.median_uu) + self.log_sd_uu * coordinate[..., 0]
        log_vv = log_uu + np.log(self.ratio_vv) + self.log_sd_vv * coordinate[..., 1]
        log_ww = log_uu + np.log(self.ratio_ww) + self.log_sd_ww * coordinate[..., 2]
        correlation = np.tanh(self.z_sd * coordinate[..., 3:] + np.array([0.0, self.z_uw, 0.0]))
        return _stress_from_correlations(log_uu, log_vv, log_ww, correlation)

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        return (
            f"weak: uu log-normal about {self.median_uu:g} m² s⁻² "
            f"(factor {np.exp(1.96 * self.log_sd_uu):.0f} either way), "
            f"vv/uu about {self.ratio_vv:g} (factor {np.exp(1.96 * self.log_sd_vv):.1f}), "
            f"ww/uu about {self.ratio_ww:g} (factor {np.exp(1.96 * self.log_sd_ww):.1f}), "
            f"correlation of u and w about {np.tanh(self.z_uw):.2f}, the others about 0 (95 %)"
        )


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
        """Return the log-density of the coordinates: logit(σ²/bound), and artanh of the three correlations."""
        share, z = coordinate[..., :3], coordinate[..., 3:]
        of_variances = np.log(2.0) - 2.0 * np.logaddexp(0.0, -share) - np.logaddexp(0.0, share)
        log_cosh = np.logaddexp(z, -z) - np.log(2.0)
        of_correlations = np.log([2.0 / np.pi, 2.0 / np.pi, 0.5]) - np.array([3.0, 3.0, 2.0]) * log_cosh
        return np.asarray(np.sum(of_variances + of_correlations, axis=-1))

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior."""
        share = np.sqrt(rng.random((n_draw, 3)))
        rho = 2.0 * rng.beta([1.5, 1.5, 1.0], [1.5, 1.5, 1.0], (n_draw, 3)) - 1.0
        return np.concatenate([logit(share), np.arctanh(rho)], axis=-1)

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        log_variance = np.log(self.bound) - np.logaddexp(0.0, -coordinate[..., :3])
        correlation = np.tanh(coordinate[..., 3:])
        return _stress_from_correlations(log_variance[..., 0], log_variance[..., 1], log_variance[..., 2], correlation)

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        return (
            f"flat: uniform over realizable tensors with uu, vv, ww below {self.bound:g} m² s⁻² "
            "(favours large variances)"
        )


PRIORS: dict[str, Callable[..., Prior]] = {"weak": WeakPrior, "flat": FlatPrior}
"""The priors by name; each call takes the prior's own keyword arguments."""


def make_prior(prior: str | Prior) -> Prior:
    """Return the prior that `prior` means.

    Parameters
    ----------
    prior : str or Prior
        A name, ``"weak"`` or ``"flat"``, or a prior made with other parameters, such as ``WeakPrior(log_sd_vv=1.0)``.

    Returns
    -------
    prior : Prior
        The prior.

    Raises
    ------
    InputError
        If the name is not known.

    Examples
    --------
    >>> make_prior("weak").draw(2, seed=1).shape
    (2, 6)
    """
    if isinstance(prior, Prior):
        return prior
    return PRIORS[check_choice(prior, tuple(PRIORS), what="prior")]()


def _stress_from_correlations(
    log_uu: FloatArray, log_vv: FloatArray, log_ww: FloatArray, rho: FloatArray
) -> FloatArray:
    """Build stresses from log-variances and (ρ_uv, ρ_uw, partial ρ_vw·u); realizable for every |ρ| ≤ 1."""
    rho_uv, rho_uw, partial = rho[..., 0], rho[..., 1], rho[..., 2]
    rho_vw = rho_uv * rho_uw + partial * np.sqrt((1.0 - rho_uv**2) * (1.0 - rho_uw**2))
    stress = np.empty((*log_uu.shape, N_COORDINATE))
    stress[..., 0] = np.exp(log_uu)
    stress[..., 1] = np.exp(log_vv)
    stress[..., 2] = np.exp(log_ww)
    stress[..., 3] = rho_uv * np.exp(0.5 * (log_uu + log_vv))
    stress[..., 4] = rho_uw * np.exp(0.5 * (log_uu + log_ww))
    stress[..., 5] = rho_vw * np.exp(0.5 * (log_vv + log_ww))
    return stress
