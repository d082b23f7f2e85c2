"""The noise of a job: from a file, or made for the records."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.probe_words import probe_words
from bayes_rs.posteriors.nuisance import Nuisances


def noise_of_job(
    records: xr.Dataset,
    scan: Scan,
    *,
    given: Noise | None,
    turbulence: str,
    method: str,
    sonic: bool,
    nuisances: Nuisances | None,
    say: Callable[[str], None],
) -> Noise:
    """Take the noise that is given, or make it for the records; say which it is, and what its probe volume does."""
    if given is not None:
        noise = given
    else:
        from bayes_rs.noise.calibrating import calibrate  # noqa: PLC0415 - not needed with a file

        noise = calibrate(
            scan,
            turbulence,
            records=records,
            method=method,
            sonic=sonic,
            length_scale=_length_scales(records, nuisances),
        )
        say(noise.in_words(records["wind_speed"].values, np.deg2rad(records["yaw"].values)))
    if words := about_probe(noise, records):
        say(words)
    return noise


def about_probe(noise: Noise, records: xr.Dataset) -> str:
    """Say what the noise's probe volume does in the records' winds; empty if that is not known."""
    if not {"wind_speed", "yaw"} <= set(records.variables):
        return ""
    return probe_words(noise, records["wind_speed"].values, np.deg2rad(records["yaw"].values))


def _length_scales(records: xr.Dataset, nuisances: Nuisances | None) -> list[float] | None:
    """Return the shortest and longest L that the noise must know; None if it is that of the turbulence."""
    if nuisances is None or nuisances.length_scale_log_sd == 0.0:
        own = np.asarray(records.get("length_scale", xr.DataArray([])).values, dtype=np.float64)
        own = own[np.isfinite(own)]
        return [float(own.min()), float(own.max())] if len(own) else None
    median = records.get("length_scale") if nuisances.length_scale is None else xr.DataArray(nuisances.length_scale)
    if median is None:
        return None  # not certain, but its median is not known: the fit says so
    factors = nuisances.length_scale_nodes()[0]
    return [float(median.min() * factors.min()), float(median.max() * factors.max())]
