"""Fit the Mann model to published spectra of stable and unstable flow: the numbers in models/turbulence.

Run from the checkout: python benchmarks/fit_presets.py; half a minute. It prints the parameters and how far the model's
variances are from those of the spectra; tests/test_presets.py runs the same fit and compares it with what is shipped.

The spectra are those of the surface layer over uniform ground, as n S(n)/u*² against f = n z/U, one-sided:

- neutral: Kaimal et al. (1972), Q. J. R. Meteorol. Soc. 98, 563, doi:10.1002/qj.49709841707;
- stable: Olesen, Larsen and Højstrup (1984), Boundary-Layer Meteorol. 29, 285;
- unstable: Højstrup (1982), J. Atmos. Sci. 39, 2239.

The formulas of the last two were read from the spectral model SMOOTH of TurbSim (OpenFAST, modules/turbsim/src/
VelocitySpectra.f90), not from the papers; tests/test_presets.py holds them to the laws that such spectra obey. No law
reaches the constants that go with z/z_i (15, 2.8 and 0.3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from bayes_rs.turbulence.mann import MannTurbulence

FloatArray = NDArray[np.float64]
Spectra = Callable[[FloatArray], FloatArray]

HEIGHT = 100.0  # m
WIND_SPEED = 10.0  # m/s
ROUGHNESS = {"onshore": 0.05, "offshore": 0.0002}  # m
OBUKHOV_LENGTH = {"stable": 150.0, "unstable": -150.0}  # m
BOUNDARY_LAYER_HEIGHT = 1000.0  # m, in unstable flow
VON_KARMAN = 0.4

# In units of 1/z (stable: φ_m/z, which is how those spectra scale), ten a decade. Over this range the fit to Kaimal's
# spectra returns the parameters that Mann (1998) gives for them within 2.5 %.
WAVE_NUMBERS = np.geomspace(0.02, 10.0, 28)


def neutral_spectra(f: FloatArray) -> FloatArray:
    """Return n S(n)/u*² of u, v, w, shape (3, f.size), by Kaimal et al. (1972)."""
    return np.array(
        [
            102.0 * f / (1.0 + 33.0 * f) ** (5 / 3),
            17.0 * f / (1.0 + 9.5 * f) ** (5 / 3),
            2.1 * f / (1.0 + 5.3 * f ** (5 / 3)),
        ]
    )


def shear(stability: float) -> float:
    """Return φ_m, the wind shear in units of u*/(κz), at z/Λ ≥ 0."""
    return 1.0 + 4.7 * stability


def dissipation_rate(stability: float) -> float:
    """Return φ_ε, the dissipation in units of u*³/(κz), at z/Λ ≥ 0, of Wyngaard and Coté (1971)."""
    return float((1.0 + 2.5 * stability**0.6) ** 1.5)


def stable_spectra(f: FloatArray, *, stability: float) -> FloatArray:
    """Return n S(n)/u*² of u, v, w by Olesen et al. (1984) at z/Λ ≥ 0."""
    x = f / shear(stability)
    level = (dissipation_rate(stability) / shear(stability)) ** (2 / 3)
    return np.array([level * a * x / (1.0 + b * x ** (5 / 3)) for a, b in ((79.0, 263.0), (13.0, 32.0), (3.5, 8.6))])


def unstable_spectra(
    f: FloatArray, *, height: float, obukhov_length: float, boundary_layer_height: float
) -> FloatArray:
    """Return n S(n)/u*² of u, v, w by Højstrup (1982) at Λ < 0: a mixed-layer part and a surface-layer part."""
    depth = height / boundary_layer_height
    mixed = f / depth
    strength = (-boundary_layer_height / obukhov_length) ** (2 / 3)
    fade = (1.0 - depth) ** 2
    wide_u, wide_v = 1.0 + 15.0 * depth, 1.0 + 2.8 * depth
    x_u, x_v = f / wide_u, f / wide_v
    crosswind = 0.95 * mixed / (1.0 + 2.0 * mixed) ** (5 / 3)
    blocking = np.sqrt((f**2 + (0.3 * depth) ** 2) / (f**2 + 0.15**2))
    return np.array(
        [
            strength * 0.5 * mixed / (1.0 + 2.2 * mixed ** (5 / 3))
            + fade * 105.0 * x_u / (1.0 + 33.0 * x_u) ** (5 / 3) / wide_u ** (2 / 3),
            strength * crosswind + fade * 17.0 * x_v / (1.0 + 9.5 * x_v) ** (5 / 3) / wide_v ** (2 / 3),
            strength * blocking * crosswind + fade * 2.0 * f / (1.0 + 5.3 * f ** (5 / 3)),
        ]
    )


def variances(spectra: Spectra) -> FloatArray:
    """Return σ²/u*² of u, v, w, shape (3,), the integrals of the spectra, to a relative 1e-5."""
    f = np.geomspace(1e-8, 1e9, 4001)  # the tails go as f below and f^(-2/3) above
    return np.asarray(np.trapezoid(spectra(f), np.log(f), axis=1))


def friction_velocity(*, obukhov_length: float, roughness: float) -> float:
    """Return u* from the wind speed: ∫φ_m dz/z of Businger and Dyer, φ_m = 1 + 4.7 z/Λ or (1 − 16 z/Λ)^(-1/4)."""
    return (
        VON_KARMAN
        * WIND_SPEED
        / (_profile(HEIGHT / obukhov_length) - _profile(roughness / obukhov_length) + float(np.log(HEIGHT / roughness)))
    )


def _profile(stability: float) -> float:
    """Return −ψ_m."""
    if stability >= 0.0:
        return 4.7 * stability
    x = (1.0 - 16.0 * stability) ** 0.25
    return float(2.0 * np.arctan(x) - np.pi / 2.0 - np.log((1.0 + x) ** 2 * (1.0 + x**2) / 8.0))


@dataclass(frozen=True)
class Fit:
    """The Mann model at z = 1 and u* = 1, and what is left of the spectra.

    Parameters
    ----------
    turbulence : MannTurbulence
        dissipation in units of u*² z^(-2/3), length_scale in units of z.
    misfit : ndarray, shape (3,)
        Relative error of the variances of u, v, w.
    residual : float
        Root mean square of the differences of the logarithms.
    """

    turbulence: MannTurbulence
    misfit: FloatArray
    residual: float

    def at(self, friction_velocity: float) -> MannTurbulence:
        """Return the turbulence at HEIGHT."""
        return MannTurbulence(
            dissipation=self.turbulence.dissipation * friction_velocity**2 / HEIGHT ** (2 / 3),
            length_scale=self.turbulence.length_scale * HEIGHT,
            gamma=self.turbulence.gamma,
        )


def fit(spectra: Spectra, *, wave_numbers: FloatArray = WAVE_NUMBERS) -> Fit:
    """Fit all three parameters to the spectra of u, v and w at once: least squares of the logarithms, all points alike.

    The covariance uw has no part in it.
    """
    # spectra over wave numbers of both signs are half of those over positive frequencies
    wanted = np.log(0.5 * spectra(wave_numbers / (2.0 * np.pi)))

    def turbulence_at(log_parameters: FloatArray) -> MannTurbulence:
        dissipation, length_scale, gamma = np.exp(log_parameters)
        return MannTurbulence(dissipation=dissipation, length_scale=length_scale, gamma=gamma)

    def residuals(log_parameters: FloatArray) -> FloatArray:
        found = turbulence_at(log_parameters).spectra(wave_numbers).real[:, :3].T * wave_numbers
        return np.asarray(np.log(found) - wanted).ravel()

    solution = optimize.least_squares(residuals, np.log([3.2, 0.59, 3.0]), xtol=1e-9, diff_step=np.array([1e-5]))
    turbulence = turbulence_at(solution.x)
    return Fit(
        turbulence=turbulence,
        misfit=turbulence.stresses()[:3] / variances(spectra) - 1.0,
        residual=float(np.sqrt(np.mean(solution.fun**2))),
    )


def fit_stability(name: str) -> Fit:
    """Return the fit of "neutral", "stable" or "unstable" flow at HEIGHT."""
    if name == "neutral":
        return fit(neutral_spectra)
    stability = HEIGHT / OBUKHOV_LENGTH[name]
    if name == "stable":
        return fit(lambda f: stable_spectra(f, stability=stability), wave_numbers=shear(stability) * WAVE_NUMBERS)
    return fit(
        lambda f: unstable_spectra(
            f, height=HEIGHT, obukhov_length=OBUKHOV_LENGTH[name], boundary_layer_height=BOUNDARY_LAYER_HEIGHT
        )
    )


def main() -> None:
    """Fit and print."""
    for stability in ("neutral", "stable", "unstable"):
        found = fit_stability(stability)
        one = found.turbulence
        print(
            f"{stability}: {one.dissipation:.4g} u*² z^(-2/3), L = {one.length_scale:.4g} z, Γ = {one.gamma:.4g}; "
            f"variances of u, v, w {', '.join(f'{error:+.1%}' for error in found.misfit)}; "
            f"rms of ln {found.residual:.2f}; uw = {one.stresses()[4]:.2f} u*²"
        )
        if stability == "neutral":
            continue
        for site, roughness in ROUGHNESS.items():
            speed = friction_velocity(obukhov_length=OBUKHOV_LENGTH[stability], roughness=roughness)
            preset = found.at(speed)
            print(
                f"  {stability}-{site}: u* = {speed:.3f} m/s, dissipation = {preset.dissipation:.4g}, "
                f"length_scale = {preset.length_scale:.1f}, gamma = {preset.gamma:.2f}, "
                f"stresses {preset.stresses().round(3)}"
            )


if __name__ == "__main__":
    main()
