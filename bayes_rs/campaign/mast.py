"""A campaign's prior from stresses that are known, such as those of a mast."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import as_generator, check_array
from bayes_rs.campaign.cells import make_cells
from bayes_rs.campaign.conjugate import HyperMoves
from bayes_rs.campaign.hyperprior import Hyper, draw_hyper
from bayes_rs.campaign.learning import learnt_prior
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import principal_variances
from bayes_rs.priors.campaign import CampaignPrior
from bayes_rs.priors.interface import LogRatioPrior
from bayes_rs.priors.registry import Prior, make_prior

_N_CHAIN = 16
_BURN_IN = 400
_N_SWEEP = 600


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

    Notes
    -----
    The model is that of `bayes_rs.campaign` with every record's coordinates known. The tensors' own errors (those of a
    finite period) are taken as part of what differs from record to record.
    """
    tensors = check_array(stress, (None, 6), what="stress")
    speed = check_array(wind_speed, (len(tensors),), what="wind_speed")
    if len(tensors) == 0:
        raise InputError("Invalid stress of no tensor: give one for each period.")
    base = make_prior(prior)
    if not isinstance(base, LogRatioPrior):
        raise InputError(
            f"Prior {base.name!r} cannot begin a campaign: its coordinates must be independent and standard normal; "
            "give 'weak' or 'ratio'."
        )
    with np.errstate(invalid="ignore"):
        smallest = principal_variances(tensors)[:, 0]
    bad = np.flatnonzero(~(smallest > 0.0))
    if len(bad):
        raise InputError(
            f"Invalid stress {tensors[bad[0]].tolist()} of entry {bad[0]}: it must be positive definite, and its "
            f"smallest principal variance is {smallest[bad[0]]:.3g} m² s⁻²."
        )
    rng = as_generator(seed)
    given = make_cells(speed, group)
    cells = given.in_order()
    coordinate = base.coordinate(tensors[given.order()])
    fixed = np.ascontiguousarray(np.repeat(coordinate.T[:, None, :], _N_CHAIN, axis=1))
    moves = HyperMoves(cells, rng)
    hyper = draw_hyper(_N_CHAIN, cells, rng)
    kept: list[Hyper] = []
    for sweep in range(_BURN_IN + _N_SWEEP):
        hyper = moves.move(hyper, fixed, turn=sweep, adapt=sweep < _BURN_IN)
        if sweep >= _BURN_IN and sweep % 2:
            kept.append(hyper)
    draws = Hyper(
        *(
            np.concatenate([getattr(one, name) for one in kept])
            for name in ("scatter", "speed_share", "group_share", "score")
        )
    )
    return learnt_prior(base, draws, cells)
