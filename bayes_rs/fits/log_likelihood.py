"""The log-likelihood of a fit's draws, of whole records and datum by datum, for cross-validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.batch import posteriors
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.parts import Part, Shared, batch_size
from bayes_rs.likelihoods.pointwise import has_beams, log_conditional
from bayes_rs.posteriors.nuisance import Seen
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.processor import one_thread

_WHOLE = "log-density of the logarithms of all variances of the record together, given the draw"
_BEAMS = "log-density of the logarithm of each beam's variance, given those of the record's other beams and the draw"
_DIRECTIONS = "the same of each of the few numbers that the beams of a record are reduced to, given the others"


def log_likelihood_of(shared: Shared, parts: Sequence[Part], fit: FitData) -> xr.Dataset:
    """Return the log-likelihood of draws.

    Parameters
    ----------
    shared : Shared
        Noise and options of the fit, whose draws are those of R: the target is not ``"sonic"``.
    parts : sequence of Part
        The data of all its records.
    fit : FitData
        With its draws.

    Returns
    -------
    group : Dataset
        ``joint`` (chain, draw, record), and datum by datum (`log_conditional`) ``variance`` (chain, draw, record,
        beam) or, if some record uses more beams than the stresses can move, ``direction`` (chain, draw, record,
        number); float32. For a likelihood that is not log-normal ``joint`` alone.
    """
    stress = fit.draws()
    nuisances = {name: fit.nuisance_draws(name) for name in fit.nuisance_names}
    with one_thread():
        found = _posteriors(shared, parts, fit.fitted)
        of_beams = all(has_beams(posterior.likelihood) for _, posterior in found)
        whole = np.full(stress.shape[:3], np.nan, dtype=np.float32)
        each: list[tuple[NDArray[np.int64], FloatArray | None]] = []
        for rows, posterior in found:
            seen = _seen(posterior, stress[rows], {name: values[rows] for name, values in nuisances.items()})
            joint = posterior.likelihood.log_density(*seen)
            whole[rows] = joint.reshape(len(rows), *stress.shape[1:3])
            each.append((rows, log_conditional(posterior.likelihood, *seen, of_beams=of_beams, joint=joint)))
    group: dict[str, Any] = {"joint": (("chain", "draw", "record"), np.moveaxis(whole, 0, 2), {"long_name": _WHOLE})}
    known = [(rows, values) for rows, values in each if values is not None]
    if known and len(known) == len(each):
        n_datum = len(shared.beam) if of_beams else max(values.shape[-1] for _, values in known)
        data = np.full((*stress.shape[:3], n_datum), np.nan, dtype=np.float32)
        for rows, values in known:
            n_own = values.shape[-1]
            data[rows, :, :, :n_own] = values.reshape(len(rows), *stress.shape[1:3], n_own)
        name, dim, words = ("variance", "beam", _BEAMS) if of_beams else ("direction", "number", _DIRECTIONS)
        group[name] = (("chain", "draw", "record", dim), np.moveaxis(data, 0, 2), {"long_name": words})
    return xr.Dataset(group)


def _posteriors(
    shared: Shared, parts: Sequence[Part], fitted: NDArray[np.bool_]
) -> list[tuple[NDArray[np.int64], Posterior]]:
    """Return the posteriors of the fitted records, some records at a time, with the numbers of their records."""
    size, found = batch_size(len(shared.beam)), []
    for part in parts:
        wanted = np.flatnonzero(fitted[part.record])
        for first in range(0, len(wanted), size):
            some = wanted[first : first + size]
            those = posteriors(part.batch.take(some), shared.noise, shared.options)
            found += [(part.record[some[rows]], posterior) for rows, posterior in those]
    return found


def _seen(posterior: Posterior, stress: FloatArray, nuisances: Mapping[str, FloatArray]) -> Seen:
    """Return what the likelihood takes at draws of some records."""
    flat = stress.reshape(len(stress), -1, stress.shape[-1])
    if not nuisances:
        return Seen(flat)
    values = {name: draws.reshape(len(stress), -1) for name, draws in nuisances.items()}
    return posterior.nuisances.apply(flat, posterior.nuisances.coordinate(values))
