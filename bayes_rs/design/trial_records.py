"""Records on which scans are tried: variances at one state of the flow, with errors that are spread evenly."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.special import ndtri
from scipy.stats import qmc

from bayes_rs._validation import FloatArray, as_generator
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.noise import Noise


def even_normals(count: int, n_dimension: int, seed: int) -> FloatArray:
    """Return standard normal numbers, shape (count, n_dimension), evenly: normal scores of Sobol points."""
    power = int(np.ceil(np.log2(count)))
    uniform = qmc.Sobol(n_dimension, rng=as_generator(seed)).random_base2(power)[:count]
    return np.asarray(ndtri(np.clip(uniform, 0.5**64, 1.0 - 0.5**53)))


def trial_records(scan: Scan, noise: Noise, variance: FloatArray) -> xr.Dataset:
    """Return records of these variances, shape (n_record, n_beam), in the wind that the noise is for."""
    count = len(variance)
    return xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.int64)),
            "wind_speed": ("record", np.full(count, noise.wind_speed[0])),
            "yaw": ("record", np.full(count, np.rad2deg(noise.yaw[0]))),
        },
        coords={"beam": scan.beam},
        attrs={"duration": noise.duration, "scan": scan.name, "scan_key": scan.key},
    )
