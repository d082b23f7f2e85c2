"""Records with fewer samples than the noise was made for: by how much more their variances scatter."""

from __future__ import annotations

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.noise.noise import Noise
from bayes_rs.quality.samples import BoolArray, IntArray
from bayes_rs.records.availability import expected_samples

USUAL_SHARE = 0.8
"""Share of a full record's samples from which on noise is taken as it is: the default of ``min_availability``."""


def scatter_of_few(records: xr.Dataset, noise: Noise, used: BoolArray) -> FloatArray | None:
    r"""Return by how much the variances of records with few samples scatter beyond the noise of full records.

    Parameters
    ----------
    records : Dataset
        From `make_records`, with its report.
    noise : Noise
        That of full records.
    used : ndarray of bool, shape (n_record, n_beam)
        Which variances count.

    Returns
    -------
    scatter : ndarray, shape (n_record,), or None
        Relative variance w of a factor that each beam has for itself, 0 for records that have enough; None if all have.

    Notes
    -----
    A relative variance :math:`K_{bb}` of full records is that of :math:`K_{bb} / q` of records with the share q of the
    samples: exact where samples are far apart, as those of a scanner, and where a part of the record is all that there
    is; too much where many samples lie close together and single ones are missing. With
    :math:`1 + K_{bb} / q = (1 + K_{bb}) (1 + w)` and the means over the used beams of q and of K,

    .. math:: w = \frac{K (1/q - 1)}{1 + K} .

    Only records below `USUAL_SHARE` are widened, which a user has asked for. That such a variance is also smaller, by
    the slow eddies of the times that are missing (2 to 15 %, see docs/quality.md), is left out.
    """
    expected = expected_samples(records)
    if "count" not in records or "records_report" not in records.attrs or not np.isfinite(expected) or expected <= 0.0:
        return None
    share = np.where(used, np.minimum(records["count"].values / expected, 1.0), np.nan)
    known = used.any(axis=1)
    mean = np.full(len(share), 1.0)
    mean[known] = np.nanmean(share[known], axis=1)
    speed = np.asarray(records["wind_speed"].values, dtype=np.float64)
    yaw = np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64))
    few = known & (mean < USUAL_SHARE - 1e-9) & np.isfinite(speed) & (speed > 0.0) & np.isfinite(yaw)
    if not few.any():
        return None
    some = np.flatnonzero(few)
    of_records = noise.for_records(
        speed[some],
        yaw[some],
        length_scale=_of_some(records, "length_scale", noise.length_scale, some),
        gamma=_of_some(records, "gamma", noise.gamma, some),
    )
    own = np.einsum("rbb->rb", of_records.covariance)
    relative = np.mean(own, axis=1, where=used[some])
    scatter = np.zeros(len(share))
    scatter[some] = relative * (1.0 / mean[some] - 1.0) / (1.0 + relative)
    return scatter


def _of_some(records: xr.Dataset, name: str, of_noise: FloatArray, some: IntArray) -> FloatArray:
    """Return L or Γ of some records; the middle of the noise's where they have none."""
    middle = float(np.median(of_noise))
    if name not in records:
        return np.full(len(some), middle)
    own = np.asarray(records[name].values, dtype=np.float64)[some]
    return np.where(np.isfinite(own), own, middle)
