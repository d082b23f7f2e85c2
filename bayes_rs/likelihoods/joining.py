"""Likelihoods of some records each, put together as the likelihood of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np

from bayes_rs.likelihoods.base import Likelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood


def join_likelihoods(parts: Sequence[Likelihood]) -> Likelihood:
    """Return the likelihood of the records of several likelihoods of one kind, one after the other.

    Parameters
    ----------
    parts : sequence of Likelihood
        At least one; of the same beams, and made with the same options.

    Returns
    -------
    likelihood : Likelihood
        Of all their records.
    """
    first: Any = parts[0]
    if len(parts) == 1:
        return parts[0]
    if isinstance(first, MixtureLikelihood):
        mixtures = cast("Sequence[MixtureLikelihood]", parts)
        nodes = zip(*(mixture.parts for mixture in mixtures), strict=True)
        return MixtureLikelihood(tuple(join_likelihoods(node) for node in nodes), first.weight)
    arrays = [field.name for field in fields(first) if isinstance(getattr(first, field.name), np.ndarray)]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays}
    return cast("Likelihood", replace(first, **joined))
