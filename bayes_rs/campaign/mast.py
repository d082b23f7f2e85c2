"""A campaign's prior from stresses that are known, such as those of a mast."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs.priors.campaign import CampaignPrior
from bayes_rs.priors.registry import Prior


def prior_from_stresses(
    stress: ArrayLike,
    wind_speed: ArrayLike,
    *,
    prior: str | Prior = "weak",
    group: Sequence[object] | None = None,
    seed: int | np.random.Generator = 0,
) -> CampaignPrior:
    """Learn the prior of a campaign from tensors that are known, such as those of the anemometers of a mast.

    Parameters
    ----------
    stress : array_like, shape (n, 6)
        uu, vv, ww, uv, uw, vw of each period, m² s⁻²; positive definite tensors.
    wind_speed : array_like, shape (n,)
        Mean wind speeds, m/s.
    prior : str or Prior
        The prior to begin with: what the tensors cannot tell stays as it is there.
    group : sequence of n, optional
        Class of each period.
    seed : int or numpy.random.Generator
        Seed.

    Returns
    -------
    prior : CampaignPrior
        The prior of another record at this place.

    Raises
    ------
    InputError
        If a tensor is not positive definite, or the prior is not one to begin with.
    """
    raise NotImplementedError
