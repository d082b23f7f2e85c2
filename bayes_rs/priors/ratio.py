"""Log-normal size and ratios, Fisher-normal correlations: the prior `weak`, and `ratio` with every number your own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from bayes_rs._validation import FloatArray, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.priors.interface import NormalPrior, stress_from_correlations


def _log_ratio_stress(centre: FloatArray, spread: FloatArray, coordinate: FloatArray) -> FloatArray:
    """Map standard normal coordinates by the centres and spreads of ln uu, ln vv/uu, ln ww/uu and three artanh ρ."""
    log_uu = centre[0] + spread[0] * coordinate[..., 0]
    log_vv = log_uu + centre[1] + spread[1] * coordinate[..., 1]
    log_ww = log_uu + centre[2] + spread[2] * coordinate[..., 2]
    correlation = np.tanh(spread[3:] * coordinate[..., 3:] + centre[3:])
    return stress_from_correlations(log_uu, log_vv, log_ww, correlation)


@dataclass(frozen=True)
class WeakPrior(NormalPrior):
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
    ln uu ~ N(ln 1, 2²), ln vv/uu ~ N(ln 0.64, 0.5²), ln ww/uu ~ N(ln 0.4, 0.9²), and for the correlations
    artanh ρ_uv ~ N(0, 0.35²), artanh ρ_uw ~ N(−0.3, 0.35²), artanh ρ_vw·u ~ N(0, 0.35²), where ρ_vw·u is the partial
    correlation of v and w given u. All independent. Every draw is realizable.

    The neutral surface layer, σ_u : σ_v : σ_w : u* = 2.39 : 1.92 : 1.25 : 1, has vv/uu = 0.65, ww/uu = 0.27,
    ρ_uw = −0.33; Mann spectra with Γ from 4 to 2 have vv/uu from 0.50 to 0.75, ww/uu from 0.26 to 0.62, ρ_uw from −0.47
    to −0.35; isotropic air has 1, 1 and 0. All lie within 1.1 standard deviations of the centres. Of ten candidates,
    this one was kept for its coverage and bias over neutral, stable, unstable and isotropic flow (docs/priors.md).

    References
    ----------
    Panofsky and Dutton (1984), Atmospheric Turbulence, Wiley, Table 7.1 (the ratios over flat terrain).
    """

    median_uu: float = 1.0
    log_sd_uu: float = 2.0
    ratio_vv: float = 0.64
    log_sd_vv: float = 0.5
    ratio_ww: float = 0.4
    log_sd_ww: float = 0.9
    z_uw: float = -0.3
    z_sd: float = 0.35
    name: str = "weak"

    def __post_init__(self) -> None:
        """Check the parameters."""
        for key in ("median_uu", "log_sd_uu", "ratio_vv", "log_sd_vv", "ratio_ww", "log_sd_ww", "z_sd"):
            check_positive(getattr(self, key), what=key, unit="", where="prior 'weak'")
        check_finite(self.z_uw, what="z_uw", unit="", where="prior 'weak'")

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        medians = np.log([self.median_uu, self.ratio_vv, self.ratio_ww])
        centre = np.concatenate([medians, [0.0, self.z_uw, 0.0]])
        spread = np.array([self.log_sd_uu, self.log_sd_vv, self.log_sd_ww, self.z_sd, self.z_sd, self.z_sd])
        return _log_ratio_stress(centre, spread, coordinate)

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        return (
            f"weak: uu log-normal about {self.median_uu:g} m² s⁻² "
            f"(factor {np.exp(1.96 * self.log_sd_uu):.0f} either way), "
            f"vv/uu about {self.ratio_vv:g} (factor {np.exp(1.96 * self.log_sd_vv):.1f}), "
            f"ww/uu about {self.ratio_ww:g} (factor {np.exp(1.96 * self.log_sd_ww):.1f}), "
            f"correlation of u and w about {np.tanh(self.z_uw):.2f}, the others about 0 (95 %)"
        )

    def widened(self, factor: float) -> Self:
        """Return the prior with all its standard deviations, of logarithms and Fisher transforms, times `factor`."""
        check_positive(factor, what="factor", unit="", where="prior 'weak'")
        keys = ("log_sd_uu", "log_sd_vv", "log_sd_ww", "z_sd")
        return replace(self, **{key: factor * getattr(self, key) for key in keys})


@dataclass(frozen=True, kw_only=True)
class RatioPrior(NormalPrior):
    """The form of `WeakPrior` with every number your own: size, ratios and correlations, each with its width.

    Parameters
    ----------
    uu : float
        Median of uu, m² s⁻².
    sd_uu : float
        Standard deviation of ln uu.
    vv, ww : float
        Medians of the ratios vv/uu and ww/uu.
    sd_vv, sd_ww : float
        Standard deviations of ln(vv/uu) and ln(ww/uu).
    uv, uw, vw : float
        Medians of the correlations ρ_uv and ρ_uw, and of the partial correlation ρ_vw·u of v and w given u.
    sd_uv, sd_uw, sd_vw : float
        Standard deviations of the Fisher transforms artanh ρ of these correlations.

    Raises
    ------
    InputError
        If a number is not finite, a median or a standard deviation is not positive, or a correlation is not inside
        −1 to 1.

    Notes
    -----
    ln uu ~ N(ln uu, sd_uu²), ln vv/uu ~ N(ln vv, sd_vv²), ln ww/uu ~ N(ln ww, sd_ww²), artanh ρ ~ N(artanh uv, sd_uv²)
    and so on, all independent. The numbers that you do not give are those of `WeakPrior`.

    Examples
    --------
    >>> RatioPrior(vv=0.6, sd_vv=0.2).draw(2, seed=1).shape
    (2, 6)
    """

    uu: float = 1.0
    sd_uu: float = 2.0
    vv: float = 0.64
    sd_vv: float = 0.5
    ww: float = 0.4
    sd_ww: float = 0.9
    uv: float = 0.0
    sd_uv: float = 0.35
    uw: float = -0.2913126124515909  # tanh(−0.3)
    sd_uw: float = 0.35
    vw: float = 0.0
    sd_vw: float = 0.35
    name: str = "ratio"

    def __post_init__(self) -> None:
        """Check the parameters."""
        for key in ("uu", "vv", "ww", "sd_uu", "sd_vv", "sd_ww", "sd_uv", "sd_uw", "sd_vw"):
            check_positive(getattr(self, key), what=key, unit="", where="prior 'ratio'")
        for key in ("uv", "uw", "vw"):
            value = check_finite(getattr(self, key), what=key, unit="", where="prior 'ratio'")
            if not -1.0 < value < 1.0:
                raise InputError(
                    f"Invalid {key} {value} in prior 'ratio': it is a correlation, and must be above -1 and below 1."
                )

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        centre = np.concatenate([np.log([self.uu, self.vv, self.ww]), np.arctanh([self.uv, self.uw, self.vw])])
        spread = np.array([self.sd_uu, self.sd_vv, self.sd_ww, self.sd_uv, self.sd_uw, self.sd_vw])
        return _log_ratio_stress(centre, spread, coordinate)

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        sizes = [
            f"{what} log-normal about {middle:g} (factor {np.exp(1.96 * sd):.3g})"
            for what, middle, sd in (
                ("uu", self.uu, self.sd_uu),
                ("vv/uu", self.vv, self.sd_vv),
                ("ww/uu", self.ww, self.sd_ww),
            )
        ]
        correlations = [
            f"{what} {np.tanh(np.arctanh(middle) - 1.96 * sd):.2f} to {np.tanh(np.arctanh(middle) + 1.96 * sd):.2f}"
            for what, middle, sd in (
                ("uv", self.uv, self.sd_uv),
                ("uw", self.uw, self.sd_uw),
                ("vw given u", self.vw, self.sd_vw),
            )
        ]
        return f"ratio: {', '.join(sizes)}; correlations {', '.join(correlations)} (95 %)"

    def widened(self, factor: float) -> Self:
        """Return the prior with all its standard deviations, of logarithms and Fisher transforms, times `factor`."""
        check_positive(factor, what="factor", unit="", where="prior 'ratio'")
        keys = ("sd_uu", "sd_vv", "sd_ww", "sd_uv", "sd_uw", "sd_vw")
        return replace(self, **{key: factor * getattr(self, key) for key in keys})
