"""Mann's model of turbulence: its three parameters, and the presets that are shipped."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bayes_rs._validation import check_non_negative, check_positive
from bayes_rs.errors import InputError
from bayes_rs.models import find_model


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
        If a parameter is not finite, dissipation or length_scale is not positive, or gamma is negative.

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
        check_positive(self.dissipation, what="dissipation", unit="m^(4/3) s^-2", where=where)
        check_positive(self.length_scale, what="length_scale", unit="m", where=where)
        check_non_negative(self.gamma, what="gamma", unit="", where=where)


class _TurbulenceFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    title: str
    source: str
    dissipation: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    length_scale: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    gamma: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


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
        spec = _TurbulenceFile.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"File {str(path)!r} is not valid TOML: {error}.") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"Invalid turbulence file {str(path)!r}: {place}: {first['msg']}.") from error
    return MannTurbulence(
        dissipation=spec.dissipation,
        length_scale=spec.length_scale,
        gamma=spec.gamma,
        name=path.stem,
        source=spec.source,
    )
