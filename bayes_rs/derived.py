"""Quantities that follow from the stresses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.stress import principal_variances


def turbulence_kinetic_energy(stress: FloatArray) -> FloatArray:
    """Return k = ½(uu + vv + ww), m² s⁻², of stresses (..., 6)."""
    return np.asarray(0.5 * stress[..., :3].sum(axis=-1))


def friction_velocity(stress: FloatArray) -> FloatArray:
    """Return u* = (uw² + vw²)^(1/4), m/s, of stresses (..., 6)."""
    return np.sqrt(np.hypot(stress[..., 4], stress[..., 5]))


def _invariant(order: int) -> Callable[[FloatArray], FloatArray]:
    def of(stress: FloatArray) -> FloatArray:
        variances = principal_variances(stress)
        deviation = variances / variances.sum(axis=-1, keepdims=True) - 1.0 / 3.0
        return np.asarray((deviation**order).sum(axis=-1))

    return of


DERIVED: dict[str, Callable[[FloatArray], FloatArray]] = {
    "tke": turbulence_kinetic_energy,
    "friction_velocity": friction_velocity,
    "anisotropy_2": _invariant(2),
    "anisotropy_3": _invariant(3),
}
"""Derived quantities by name, functions of stresses (..., 6): kinetic energy k (m² s⁻²), friction velocity u* (m/s),
and the invariants b_ij b_ji and b_ij b_jk b_ki of the anisotropy tensor b = R/(2k) − I/3. Turbulence intensity,
"ti", is σ_u/U and needs the wind speed beside the stresses."""


def check_derived(names: Sequence[str]) -> None:
    """Refuse names that are not derived quantities.

    Raises
    ------
    InputError
        If one is not known.
    """
    for name in names:
        check_choice(name, ("ti", *DERIVED), what="derived quantity")


def with_derived(stress: FloatArray, names: Sequence[str], wind_speed: FloatArray | None = None) -> FloatArray:
    """Append derived quantities to stresses.

    Parameters
    ----------
    stress : ndarray, shape (..., 6)
        Stresses, m² s⁻².
    names : sequence of str
        Derived quantities, from `DERIVED` or ``"ti"``.
    wind_speed : ndarray, optional
        Mean wind speed, m/s, of a shape that broadcasts with that of a stress; without it "ti" is NaN.

    Returns
    -------
    values : ndarray, shape (..., 6 + number of names)
        The stresses, then the derived quantities.
    """
    if not names:
        return stress
    more = [
        (np.full(stress.shape[:-1], np.nan) if wind_speed is None else np.sqrt(stress[..., 0]) / wind_speed)
        if name == "ti"
        else DERIVED[name](stress)
        for name in names
    ]
    return np.concatenate([stress, np.stack(more, axis=-1)], axis=-1)
