"""Priors on the Reynolds stress tensor, by name.

Every prior is a smooth map from unbounded coordinates to a realizable tensor, and a proper density of them.
So no draw and no proposal of the sampler can leave the realizable tensors, there is no edge to run into, and a prior is
one short class; see `bayes_rs.priors.interface`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from bayes_rs._validation import check_choice
from bayes_rs.errors import InputError
from bayes_rs.priors.campaign import CampaignPrior, load_campaign_prior
from bayes_rs.priors.flat import FlatPrior
from bayes_rs.priors.gaussian import GaussianPrior
from bayes_rs.priors.interface import N_COORDINATE, Prior
from bayes_rs.priors.mann_family import MannPrior
from bayes_rs.priors.ratio import RatioPrior, WeakPrior
from bayes_rs.priors.sample import SamplePrior

__all__ = [
    "N_COORDINATE",
    "PRIORS",
    "CampaignPrior",
    "FlatPrior",
    "GaussianPrior",
    "MannPrior",
    "Prior",
    "RatioPrior",
    "SamplePrior",
    "WeakPrior",
    "load_campaign_prior",
    "make_prior",
]

PRIORS: dict[str, Callable[..., Prior]] = {"weak": WeakPrior, "flat": FlatPrior, "ratio": RatioPrior, "mann": MannPrior}
"""The priors that a name alone can mean; each call takes the prior's own keyword arguments, all of them numbers."""


def make_prior(prior: str | Prior) -> Prior:
    """Return the prior that `prior` means.

    Parameters
    ----------
    prior : str or Prior
        A name in ``PRIORS``, as ``"weak"``; a name with parameters, such as ``"weak:log_sd_vv=1"`` or
        ``"ratio:vv=0.6,sd_vv=0.3"``; ``"campaign:FILE"`` for one that a campaign has learnt and saved; or a prior,
        such as ``WeakPrior(log_sd_vv=1.0)``.

    Returns
    -------
    prior : Prior
        The prior.

    Raises
    ------
    InputError
        If the name or a parameter is not known, or a value is not a number that the prior accepts.

    Examples
    --------
    >>> make_prior("weak").draw(2, seed=1).shape
    (2, 6)
    >>> make_prior("flat:bound=10").in_words()
    'flat: uniform over realizable tensors with uu, vv, ww below 10 m² s⁻² (favours large variances)'
    """
    if isinstance(prior, Prior):
        return prior
    name, colon, rest = str(prior).partition(":")
    if name == "campaign":
        if not rest.strip():
            raise InputError("Invalid prior 'campaign': write campaign:FILE, with the file that a campaign saved.")
        return load_campaign_prior(rest.strip())
    make = PRIORS[check_choice(name, tuple(PRIORS), what="prior")]
    return make(**_parameters(make, name, rest)) if colon else make()


def _parameters(make: Callable[..., Prior], name: str, text: str) -> dict[str, float]:
    """Read ``key=value,…`` of a prior."""
    example: Any = make()
    known = tuple(entry.name for entry in fields(example) if entry.name != "name")
    found: dict[str, float] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not key:
            raise InputError(
                f"Invalid parameter {part!r} of prior {name!r}: write {name}:key=value,key=value, "
                f"such as {name}:{known[0]}={getattr(example, known[0]):g}."
            )
        check_choice(key, known, what="parameter", of=f"prior {name!r}")
        if key in found:
            raise InputError(f"Parameter {key!r} of prior {name!r} is given twice: give it once.")
        try:
            found[key] = float(value)
        except ValueError:
            raise InputError(
                f"Invalid {key} {value!r} of prior {name!r}: it must be a number, such as {getattr(example, key):g}."
            ) from None
    return found
