"""What a sampler is asked to do."""

from __future__ import annotations

from dataclasses import dataclass

ESS_MARGIN = 1.25
"""R is sampled by so much more than asked for: S has an effective sample size of its own, estimated anew."""


@dataclass(frozen=True)
class Effort:
    """How much a sampler does, and from which seed.

    Parameters
    ----------
    seed : int
        Seed of the fit.
    target_ess : int
        Bulk effective sample size to reach for every stress.
    max_extension : int
        How often what a record has, of chains or proposals, may be doubled.
    """

    seed: int
    target_ess: int
    max_extension: int
