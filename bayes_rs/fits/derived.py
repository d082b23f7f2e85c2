"""Quantities that follow from the stresses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.geometry.stress import principal_variances


def turbulence_kinetic_energy(stress: FloatArray) -> FloatArray:
    """Return k = ½(uu + vv + ww), m² s⁻², of stresses (..., 6)."""
    return np.asarray(0.5 * stress[..., :3].sum(axis=-1))


def friction_velocity(stress: FloatArray) -> FloatArray:
    """Return u* = (uw² + vw²)^(1/4), m/s, of stresses (..., 6)."""
    return np.sqrt(np.hypot(stress[..., 4], stress[..., 5]))


def anisotropy_invariants(stress: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return b_ij b_ji and b_ij b_jk b_ki of the anisotropy tensor b = R/(2k) − I/3, of stresses (..., 6)."""
    variances = principal_variances(stress)
    deviation = variances / variances.sum(axis=-1, keepdims=True) - 1.0 / 3.0
    return np.asarray((deviation**2).sum(axis=-1)), np.asarray((deviation**3).sum(axis=-1))


def lumley_coordinates(stress: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ξ and η of Lumley's triangle, 6ξ³ = b_ij b_jk b_ki and 6η² = b_ij b_ji, of stresses (..., 6).

    Isotropic turbulence is at (0, 0), one component alone at (1/3, 1/3), two equal ones at (−1/6, 1/6); realizable
    tensors lie within η ≥ |ξ| and η ≤ √(1/27 + 2ξ³), where one principal variance is zero. Pope (2000), Turbulent
    Flows, Cambridge University Press, Sect. 11.3.2.
    """
    second, third = anisotropy_invariants(stress)
    return np.cbrt(third / 6.0), np.sqrt(second / 6.0)


def _correlation(index: int, one: int, other: int) -> Callable[[FloatArray], FloatArray]:
    def of(stress: FloatArray) -> FloatArray:
        return np.asarray(stress[..., index] / np.sqrt(stress[..., one] * stress[..., other]))

    return of


def _part(of: Callable[[FloatArray], tuple[FloatArray, FloatArray]], which: int) -> Callable[[FloatArray], FloatArray]:
    return lambda stress: of(stress)[which]


DERIVED: dict[str, Callable[[FloatArray], FloatArray]] = {
    "tke": turbulence_kinetic_energy,
    "friction_velocity": friction_velocity,
    "anisotropy_2": _part(anisotropy_invariants, 0),
    "anisotropy_3": _part(anisotropy_invariants, 1),
    "lumley_xi": _part(lumley_coordinates, 0),
    "lumley_eta": _part(lumley_coordinates, 1),
    "correlation_uv": _correlation(3, 0, 1),
    "correlation_uw": _correlation(4, 0, 2),
    "correlation_vw": _correlation(5, 1, 2),
}
"""Derived quantities by name, functions of stresses (..., 6): kinetic energy k (m² s⁻²), friction velocity u* (m/s),
the invariants of the anisotropy tensor and the coordinates of Lumley's triangle, and correlation coefficients, from −1
to 1."""

INTENSITIES = {"ti": 0, "ti_v": 1, "ti_w": 2}
"""Turbulence intensities σ_u/U, σ_v/U and σ_w/U, which need the wind speed beside the stresses."""


NAMES = (*INTENSITIES, *DERIVED)
"""All derived quantities."""


def check_derived(names: Sequence[str]) -> None:
    """Refuse names that are not derived quantities.

    Raises
    ------
    InputError
        If one is not known.
    """
    for name in names:
        check_choice(name, NAMES, what="derived quantity")


def with_derived(stress: FloatArray, names: Sequence[str], wind_speed: FloatArray | None = None) -> FloatArray:
    """Append derived quantities to stresses.

    Parameters
    ----------
    stress : ndarray, shape (..., 6)
        Stresses, m² s⁻².
    names : sequence of str
        Derived quantities, from `DERIVED` or `INTENSITIES`.
    wind_speed : ndarray, optional
        Mean wind speed, m/s, of a shape that broadcasts with that of a stress; without it the turbulence
        intensities are NaN.

    Returns
    -------
    values : ndarray, shape (..., 6 + number of names)
        The stresses, then the derived quantities.
    """
    if not names:
        return stress
    more = [
        DERIVED[name](stress) if name in DERIVED else _intensity(stress[..., INTENSITIES[name]], wind_speed)
        for name in names
    ]
    return np.concatenate([stress, np.stack(more, axis=-1)], axis=-1)


def _intensity(variance: FloatArray, wind_speed: FloatArray | None) -> FloatArray:
    return np.full(variance.shape, np.nan) if wind_speed is None else np.sqrt(variance) / wind_speed
