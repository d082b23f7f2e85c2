"""Samples that look like spikes and were not left out: how many each record and beam has, and what they add."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.quality.groups import group_moments
from bayes_rs.quality.samples import BeamSamples, BoolArray
from bayes_rs.quality.spikes import RAISED, RAISED_ONE, is_far_out

COUNT, ADDED = "spike_count", "spike_variance"
"""Variables of records: samples far outside the others of their beam, and what they add to the variance."""
_OF_RECORD, _OF_ONE = 0.05, 0.5
"""A record is remarked on if spikes raise the variances of its beams together, or of one beam, by these shares."""


def spikes_of_records(samples: BeamSamples, keep: BoolArray, variance: FloatArray, *, window: int) -> dict[str, Any]:
    """Return the variables that say which samples that are kept look like spikes.

    Parameters
    ----------
    samples : BeamSamples
        The samples.
    keep : ndarray of bool, shape (n_sample,)
        Those that count.
    variance : ndarray, shape (n_record, n_beam)
        Their variance, m² s⁻².
    window : int
        Samples of the running median.

    Returns
    -------
    variables : dict of str to tuple
        ``spike_count`` and ``spike_variance``, the variance less that of the other samples, m² s⁻²; both
        (record, beam), and zero where there is no spike.
    """
    velocity, group = samples.velocity[keep], samples.group[keep]
    far = is_far_out(velocity, group, window=window)
    count = np.bincount(group[far], minlength=samples.n_group)
    added = np.zeros(samples.n_group)
    if far.any():
        rest = (count[group] > 0) & ~far
        of_rest = group_moments(velocity[rest], group[rest], samples.n_group)[2]
        added = np.where(count > 0, np.nan_to_num(variance.T.ravel() - of_rest), 0.0)
    shape = (len(samples.numbers), samples.n_record)
    return {
        COUNT: (
            ("record", "beam"),
            count.reshape(shape).T.astype(np.int32),
            {"long_name": "samples used that lie far outside the others of their beam, as spikes do"},
        ),
        ADDED: (
            ("record", "beam"),
            added.reshape(shape).T.astype(np.float32),
            {"units": "m2 s-2", "long_name": "what these samples add to the variance"},
        ),
    }


def has_spikes(records: xr.Dataset) -> NDArray[np.bool_]:
    """Say in which records spikes raise the variances that are used clearly, shape (n_record,)."""
    clean, added = _used(records)
    of_all = added.sum(axis=1) > _OF_RECORD * clean.sum(axis=1)
    return np.asarray(of_all | (added > _OF_ONE * clean).any(axis=1))


def spikes_report(records: xr.Dataset) -> dict[str, Any]:
    """Count for the report the samples that look like spikes; nothing where they do not matter, or are not known."""
    if COUNT not in records:
        return {}
    clean, added = _used(records)
    count = np.where(records["flag"].values == 0, records[COUNT].values, 0)
    of_beam = added.sum(axis=0) / np.maximum(clean.sum(axis=0), 1e-300)
    raised = float(added.sum() / max(float(clean.sum()), 1e-300))
    if not count.any() or (raised <= RAISED and of_beam.max() <= RAISED_ONE):
        return {"spikes": None}
    worst = int(np.argmax(of_beam))
    used = np.where(records["flag"].values == 0, records["count"].values, 0)
    return {
        "spikes": {
            "samples": int(count.sum()),
            "of": int(used.sum()),
            "records": int(count.any(axis=1).sum()),
            "raised": raised,
            "worst_beam": int(records["beam"].values[worst]),
            "worst_samples": int(count[:, worst].sum()),
            "worst_of": int(used[:, worst].sum()),
            "worst_raised": float(of_beam[worst]),
        }
    }


def _used(records: xr.Dataset) -> tuple[FloatArray, FloatArray]:
    """Return the variances without spikes, and what these add, of the beams that are used; 0 for the others."""
    used = (records["flag"].values == 0) & np.isfinite(records["variance"].values)
    added = np.where(used, records[ADDED].values.astype(np.float64), 0.0)
    return np.where(used, records["variance"].values, 0.0) - added, added
