"""What the uncertainty of a fit comes from, and the same data with some of it known."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from bayes_rs.fits.batch import Batch
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.noise.noise import Noise

SAMPLING, SCATTER, PRIOR, REST, COMBINED = "sampling", "scatter beyond theory", "prior", "rest", "combined"
LENGTH, INSTRUMENT, PROBE, TAILS = "length scale", "instrument noise", "probe length", "noise inflation"
COHERENCE, MAST_RATIO = "coherence", "mast elsewhere"
COORDINATES = {
    "yaw": "yaw_error",
    "tilt": "tilt_error",
    "lateral gradient": "lateral_gradient",
    "vertical gradient": "vertical_gradient",
    INSTRUMENT: "instrument_noise",
}
"""Sources that are sampled, and what their coordinates are called; the instrument's noise need not be."""
KINDS = {SAMPLING: "A", SCATTER: "A", REST: "", COMBINED: ""}
"""Type A of the GUM: the scatter of the record's own variances. All other sources are of type B."""
SWITCHED = (
    SCATTER, LENGTH, INSTRUMENT, PROBE, "yaw", "tilt", "lateral gradient", "vertical gradient", COHERENCE, MAST_RATIO,
    TAILS,
)  # fmt: skip
"""What can be switched off, in the order of the table."""


def possible_sources(batch: Batch, options: FitOptions) -> list[str]:
    """Return which sources a fit of such data could count, of `SWITCHED`."""
    mast = batch.pairs is not None and batch.pairs.has_mast
    there = {COHERENCE: options.information == "covariances", MAST_RATIO: mast}
    return [name for name in SWITCHED if there.get(name, True)]


def sources_of(batch: Batch, noise: Noise, options: FitOptions) -> list[str]:
    """Return which sources a fit of these data counts, of `SWITCHED`."""
    uncertain = options.nuisances
    several = bool(np.ptp(np.log(noise.length_scale)) > 0.0) and "length_scale" in batch.flow
    sampled = set(uncertain.names)
    there = {name: coordinate in sampled for name, coordinate in COORDINATES.items()}
    there[SCATTER] = batch.scatter is not None and bool(np.any(batch.scatter > 0.0))
    own_length = batch.length_log_sd is not None and bool(np.any(batch.length_log_sd > 0.0))
    there[LENGTH] = uncertain.length_scale_sd > 0.0 or (several and own_length)
    there[INSTRUMENT] |= batch.instrument_noise_sd is not None
    there[PROBE] = batch.probe_sd is not None
    there[COHERENCE] = options.information == "covariances" and options.coherence_log_sd > 0.0
    there[MAST_RATIO] = batch.pairs is not None and batch.pairs.has_mast and options.mast_log_sd > 0.0
    there[TAILS] = uncertain.inflation != 1.0 or bool(np.isfinite(uncertain.inflation_dof))
    return [name for name in SWITCHED if there[name]]


def known(names: Collection[str], batch: Batch, options: FitOptions) -> tuple[Batch, FitOptions]:
    """Return data and options in which sources are known, at their central values.

    Those that are sampled stay coordinates: what holds them is `frozen`.
    """
    uncertain = options.nuisances
    if SCATTER in names:
        batch = replace(batch, scatter=None)
    if LENGTH in names:
        if uncertain.length_scale is not None:
            batch = replace(batch, flow={**batch.flow, "length_scale": np.full(len(batch), uncertain.length_scale)})
        batch = replace(batch, length_log_sd=None)
        uncertain = replace(uncertain, length_scale_log_sd=0.0, length_scale=None)
    if INSTRUMENT in names:
        batch = replace(batch, instrument_noise_sd=None)
    if PROBE in names:
        batch = replace(batch, probe_sd=None)
        uncertain = replace(uncertain, probe_length_log_sd=0.0)
    if COHERENCE in names:
        options = replace(options, coherence_log_sd=0.0)
    if MAST_RATIO in names:
        options = replace(options, mast_log_sd=0.0)
    if TAILS in names:
        uncertain = replace(uncertain, inflation=1.0, inflation_dof=np.inf)
    return batch, replace(options, prior=options.made_prior, nuisances=uncertain)


def frozen(names: Collection[str], options: FitOptions) -> list[int]:
    """Return which of the nuisances' coordinates are held at zero, where these sources are known."""
    held = {COORDINATES[name] for name in names if name in COORDINATES}
    return [index for index, name in enumerate(options.nuisances.names) if name in held]
