"""Mann's model of turbulence: its three parameters, the stresses that they give and back, and the shipped presets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError

from bayes_rs._validation import FloatArray, check_array, check_non_negative, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES, is_realizable
from bayes_rs.html_parts import bars, card
from bayes_rs.models import find_model
from bayes_rs.toml_file import Size, Table, Text, invalid_file, read_toml
from bayes_rs.turbulence.one_point import one_point_spectra, scaled_stresses
from bayes_rs.turbulence.spectral_tensor import spectral_tensor

_LARGEST_GAMMA = 15.0
"""Where the search for Γ ends: three times what flows over land and sea have."""
_GAMMA_TOLERANCE = 1e-12  # of Γ; the stresses themselves are good to about 1e-9
_FROBENIUS = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


@dataclass(frozen=True)
class MannTurbulence:
    """Parameters of the Mann model.

    Parameters
    ----------
    dissipation : float
        αε^(2/3), m^(4/3) s⁻².
    length_scale : float
        L, m.
    gamma : float
        Anisotropy parameter Γ, 0 for isotropic turbulence.
    name, source : str
        What the turbulence is called, and where its numbers come from.

    Raises
    ------
    InputError
        If a parameter is no number, dissipation or length_scale is not positive, gamma is negative, or one of them is
        beyond what any flow has.

    References
    ----------
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886.

    Examples
    --------
    >>> MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2).gamma
    3.2
    """

    dissipation: float
    length_scale: float
    gamma: float
    name: str = "unnamed"
    source: str = ""

    def __post_init__(self) -> None:
        """Check the parameters."""
        where = f"turbulence {self.name!r}"
        for name, check, unit in (
            ("dissipation", check_positive, "m^(4/3) s^-2"),
            ("length_scale", check_positive, "m"),
            ("gamma", check_non_negative, ""),
        ):
            object.__setattr__(self, name, check(getattr(self, name), what=name, unit=unit, where=where))

    def _repr_html_(self) -> str:
        """Say in a notebook what it is, with its stresses over uu."""
        stress = self.stresses()
        rows = [
            ("dissipation αε^(2/3)", f"{self.dissipation:.4g} m^(4/3) s⁻²"),
            ("length scale L", f"{self.length_scale:.4g} m"),
            ("anisotropy Γ", f"{self.gamma:.3g}"),
            ("uu", f"{stress[0]:.3g} m² s⁻²"),
            *([("source", self.source)] if self.source else []),
        ]
        ratio = stress / stress[0]
        low, high = np.minimum(ratio, 0.0), np.maximum(ratio, 0.0)
        picture = bars(ratio, low, high, STRESSES, "stresses over uu", (-0.5, 1.0), priors=False)
        return card(f"Turbulence {self.name}", rows, picture)

    @property
    def velocity_scale(self) -> float:
        """Square root of αε^(2/3) L^(2/3), m/s: what all velocities of this turbulence are proportional to."""
        return float(np.sqrt(self.dissipation) * self.length_scale ** (1.0 / 3.0))

    def stresses(self) -> FloatArray:
        """Return the one-point stresses of the turbulence in an infinite domain.

        Returns
        -------
        stresses : ndarray, shape (6,)
            uu, vv, ww, uv, uw, vw, m² s⁻², to a relative 1e-8 of uu.

        Notes
        -----
        R_ij = ∫Φ_ij d³k = αε^(2/3) L^(2/3) r_ij(Γ); see `bayes_rs.turbulence.one_point.scaled_stresses`.

        Examples
        --------
        >>> load_turbulence("fu-2022").stresses().round(4)
        array([ 1.3731,  0.799 ,  0.4958,  0.    , -0.3602,  0.    ])
        """
        return self.velocity_scale**2 * np.array(scaled_stresses(float(self.gamma)))

    def spectral_tensor(self, wave_vector: ArrayLike) -> FloatArray:
        """Return Φ_ij(k), m⁵ s⁻²; see `bayes_rs.turbulence.spectral_tensor.spectral_tensor`."""
        return spectral_tensor(
            wave_vector, dissipation=self.dissipation, length_scale=self.length_scale, gamma=self.gamma
        )

    def spectra(self, wave_number: ArrayLike) -> FloatArray:
        """Return the two-sided one-point spectra F_ij(k₁), m³ s⁻²; see `one_point_spectra`."""
        return one_point_spectra(
            wave_number, dissipation=self.dissipation, length_scale=self.length_scale, gamma=self.gamma
        )


def fit_turbulence(stress: ArrayLike, *, length_scale: float, name: str = "fitted") -> MannTurbulence:
    """Return the turbulence whose one-point stresses are nearest to the given ones: the inverse of `stresses`.

    Parameters
    ----------
    stress : array_like, shape (6,)
        uu, vv, ww, uv, uw, vw, m² s⁻².
    length_scale : float
        L, m. One-point stresses depend on αε^(2/3) and L through αε^(2/3) L^(2/3) alone, so L must come from elsewhere.
    name : str
        Name of the result.

    Returns
    -------
    turbulence : MannTurbulence
        Its `source` states the relative misfit ‖R − R(Γ)‖ / ‖R‖ (Frobenius norm); it is 0 for the model's own stresses.

    Raises
    ------
    InputError
        If the stresses are not those of a positive semi-definite, non-zero tensor, or Γ would be above 15.

    Notes
    -----
    Least squares: minimises ‖R − s r(Γ)‖² over Γ ≥ 0 and s = αε^(2/3) L^(2/3); the best s at each Γ is ⟨R, r⟩ / ⟨r, r⟩.

    Examples
    --------
    >>> seed = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2)
    >>> found = fit_turbulence(seed.stresses(), length_scale=61.0)
    >>> round(found.gamma, 6), round(found.dissipation, 8)
    (3.2, 0.05)
    """
    wanted = check_array(stress, (len(STRESSES),), what="stress")
    check_positive(length_scale, what="length_scale", unit="m")
    norm = float(np.sqrt(np.sum(_FROBENIUS * wanted**2)))
    if norm == 0.0 or not is_realizable(wanted):
        raise InputError(
            f"Invalid stress {wanted.tolist()}: the tensor must be positive semi-definite and not zero; "
            "check the order uu, vv, ww, uv, uw, vw and the signs."
        )

    def size_at(gamma: float) -> tuple[float, FloatArray]:
        shape = np.array(scaled_stresses(gamma))
        size = float(np.sum(_FROBENIUS * wanted * shape) / np.sum(_FROBENIUS * shape * shape))
        return size, np.sqrt(_FROBENIUS) * (wanted - size * shape) / norm

    def residuals(gamma: FloatArray) -> FloatArray:
        return size_at(float(gamma[0]))[1]

    solution = scipy.optimize.least_squares(
        residuals,
        [2.0],
        bounds=([0.0], [_LARGEST_GAMMA]),
        xtol=_GAMMA_TOLERANCE,
        ftol=None,
        gtol=_GAMMA_TOLERANCE,
        diff_step=[1e-5],
    )
    gamma = float(solution.x[0])
    if gamma > 0.999 * _LARGEST_GAMMA:
        raise InputError(
            f"No turbulence fits the stress {wanted.tolist()}: gamma would be above {_LARGEST_GAMMA:g}, "
            "where the Mann model has no data behind it."
        )
    size, residual = size_at(gamma)
    misfit = float(np.sqrt(np.sum(residual**2)))
    return MannTurbulence(
        dissipation=size / length_scale ** (2.0 / 3.0),
        length_scale=float(length_scale),
        gamma=gamma,
        name=name,
        source=f"least squares on one-point stresses, relative misfit {misfit:.2g}",
    )


class _TurbulenceFile(Table):
    title: Text
    source: Text
    dissipation: Size
    length_scale: Size
    gamma: Annotated[float, Field(allow_inf_nan=False)]


def load_turbulence(name: str | Path) -> MannTurbulence:
    """Load turbulence by its name in ``models/turbulence`` or from a TOML file.

    Parameters
    ----------
    name : str or Path
        Name of a preset, or path of a ``.toml`` file.

    Returns
    -------
    turbulence : MannTurbulence
        The parameters.

    Raises
    ------
    InputError
        If there is no such preset or file, or the file is not valid.

    Examples
    --------
    >>> load_turbulence("fu-2022").length_scale
    61.0
    """
    path = find_model(name, "turbulence")
    try:
        spec = _TurbulenceFile.model_validate(read_toml(path))
    except ValidationError as error:
        raise invalid_file("turbulence", path, error) from error
    return MannTurbulence(
        dissipation=spec.dissipation,
        length_scale=spec.length_scale,
        gamma=spec.gamma,
        name=path.stem,
        source=spec.source,
    )


def as_turbulence(turbulence: MannTurbulence | str | Path) -> MannTurbulence:
    """Return the turbulence itself, or that of a name or file; see `load_turbulence`.

    Parameters
    ----------
    turbulence : MannTurbulence, str or Path
        The turbulence, its name in ``models/turbulence``, or a TOML file.

    Returns
    -------
    turbulence : MannTurbulence
        The turbulence.

    Examples
    --------
    >>> as_turbulence("fu-2022").gamma
    3.2
    """
    return turbulence if isinstance(turbulence, MannTurbulence) else load_turbulence(turbulence)


load, fit = load_turbulence, fit_turbulence
"""Their names in `bayes_rs.turbulence`."""
