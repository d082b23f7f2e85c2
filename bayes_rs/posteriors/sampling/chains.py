"""What every sampler returns, and how its draws are grouped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.posteriors import diagnostics

N_ENSEMBLE = 4
"""Independent ensembles of a record; R-hat compares them."""
N_CHAIN = 8 * N_ENSEMBLE
"""Chains in which the draws of a record are laid out; those of one ensemble are neighbours."""
R_HAT_LIMIT = 1.05
"""Ensembles of a record that differ by more than this have not found the same posterior."""
PARETO_K_LIMIT = 0.7
"""Importance weights with a heavier tail than this cannot be trusted (Vehtari et al. 2024)."""
LEAST_ACCEPTANCE = 0.18
"""Where less of what is proposed is accepted, or effective, proposals do not cover the posterior, and no tail of the
weights that were seen tells of what was not: measured on thin, bent posteriors, whose Pareto k passes."""
DRIFT_LIMIT = 5.0
"""Early and late steps that differ by more standard errors than this: the start was not the posterior."""
BLOCK = 16
"""Chains are a whole number of blocks long: one draw of a block predicts, and half of them stay when chains double."""

_NUMBERS = 32 * 2048
"""Draws of all records that are sampled together."""


@dataclass(frozen=True)
class Chains:
    """Draws of the posteriors of some records, with what the sampler can say of them.

    Parameters
    ----------
    coordinate : ndarray, shape (n_record, N_CHAIN, n_draw, n)
        Draws, in the posterior's coordinates; chains of one ensemble are neighbours.
    stress : ndarray, shape (n_record, N_CHAIN, n_draw, 6)
        The same as stresses, m² s⁻².
    ess_bulk, ess_tail, r_hat : ndarray, shape (n_record, 6)
        Diagnostics of the stresses.
    autocorrelation_time : ndarray, shape (n_record, 6)
        In sampler steps.
    acceptance : ndarray, shape (n_record,)
        Share of proposals that were accepted; of importance draws, the effective share.
    n_step : ndarray of int, shape (n_record,)
        Sampler steps that draws were kept from: of each walker of emcee, or draws proposed for each chain.
    pareto_k : ndarray, shape (n_record,)
        Tail shape of the importance weights, of the draws or of the start; NaN for a sampler without weights.
    drift : ndarray, shape (n_record,)
        Change from a walker's early to its late steps, in standard errors; NaN for a sampler that does not tell.
    sampler : ndarray of str, shape (n_record,)
        Which sampler made the draws.
    """

    coordinate: FloatArray
    stress: FloatArray
    ess_bulk: FloatArray
    ess_tail: FloatArray
    r_hat: FloatArray
    autocorrelation_time: FloatArray
    acceptance: FloatArray
    n_step: NDArray[np.int64]
    pareto_k: FloatArray
    drift: FloatArray
    sampler: NDArray[np.str_]

    def missed(self, target_ess: float) -> NDArray[np.bool_]:
        """Tell which records fall short of the target, shape (n_record,)."""
        return np.asarray(
            ~(self.ess_bulk.min(axis=1) >= target_ess)
            | ~(self.r_hat.max(axis=1) <= R_HAT_LIMIT)
            | self.uneven()
            | (self.drift > DRIFT_LIMIT)
        )

    def uneven(self) -> NDArray[np.bool_]:
        """Tell which records have weights, or a start from weights, that cannot be trusted, shape (n_record,)."""
        weighted = np.isfinite(self.pareto_k)
        return np.asarray((self.pareto_k > PARETO_K_LIMIT) | (weighted & (self.acceptance < LEAST_ACCEPTANCE)))

    def put_draws(self, records: NDArray[np.int64], coordinate: FloatArray, stress: FloatArray) -> None:
        """Enter draws of some records, (n, n_draw, k) and (n, n_draw, 6), chain after chain."""
        for record, some, tensors in zip(records, coordinate, stress, strict=True):  # each a copy in memory's own order
            self.coordinate[record] = some.reshape(self.coordinate.shape[1:])
            self.stress[record] = tensors.reshape(self.stress.shape[1:])

    def pick_draws(
        self, records: NDArray[np.int64], coordinate: FloatArray, stress: FloatArray, index: NDArray[np.int64]
    ) -> None:
        """Enter draws of some records that are picked by index (n, n_draw) from (n, k, …) and (n, 6, …) others."""
        for into, source in ((self.coordinate, coordinate), (self.stress, stress)):
            rows = np.moveaxis(into, -1, 1)  # how they are in memory
            for record, one, picked in zip(records, source.reshape(*source.shape[:2], -1), index, strict=True):
                # all are inside; a mode makes it quick
                np.take(one, picked, axis=1, out=rows[record].reshape(len(one), -1), mode="clip")

    def take(self, records: NDArray[np.int64]) -> Chains:
        """Return the draws of some of the records."""
        return Chains(**{name: getattr(self, name)[records] for name in self.__dataclass_fields__})

    def put(self, records: NDArray[np.int64], others: Chains) -> None:
        """Replace the draws of some records."""
        for name in self.__dataclass_fields__:
            getattr(self, name)[records] = getattr(others, name)


def empty_chains(n_record: int, n_draw: int, n_coordinate: int, sampler: str) -> Chains:
    """Return chains to be filled. In memory each coordinate and each stress of a record is a run of numbers.

    Until a sampler says otherwise, draws are independent, there are no weights, and nothing drifts.
    """
    shape = (n_record, N_CHAIN, n_draw)
    coordinate, stress = (np.empty((n_record, n, *shape[1:])) for n in (n_coordinate, 6))
    return Chains(
        np.moveaxis(coordinate, 1, -1),
        np.moveaxis(stress, 1, -1),
        np.full((n_record, 6), np.nan),
        np.full((n_record, 6), np.nan),
        np.full((n_record, 6), np.nan),
        np.ones((n_record, 6)),
        np.full(n_record, np.nan),
        np.full(n_record, n_draw),
        np.full(n_record, np.nan),
        np.full(n_record, np.nan),
        np.full(n_record, sampler, dtype="U16"),
    )


def kept_draws(target_ess: int) -> int:
    """Return how many draws of each chain are kept: twice the target in all, in whole blocks, four blocks at least."""
    return max(4 * BLOCK, BLOCK * -(-2 * target_ess // (N_CHAIN * BLOCK)))


def records_together(n_draw: int) -> int:
    """Return how many records with chains of so many draws are sampled together.

    As many as stay in the cache, and enough that what is done once for all of them costs little.
    """
    return max(1, _NUMBERS // (N_CHAIN * n_draw))


def diagnose_stress(stress: FloatArray) -> tuple[diagnostics.Diagnosis, FloatArray]:
    """Return diagnostics, and autocorrelation time in draws, of stresses (n_record, N_CHAIN, n_draw, 6)."""
    by_component = np.ascontiguousarray(np.moveaxis(stress, -1, 1))
    return diagnostics.diagnose(by_component, N_ENSEMBLE), diagnostics.autocorrelation_time(by_component)
