"""How uncertain each record's wind direction is, for a fit that leaves it to the records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.wind.mean_vector import mean_wind

_SAME_YAW = 1e-6  # rad; both come from the same means


def with_yaw_sd(
    records: xr.Dataset,
    scan: Scan,
    noise: Noise,
    nuisances: Nuisances | None,
    say: Callable[[str], None],
) -> xr.Dataset:
    """Return records that say how uncertain their directions are, where the nuisances ask for it and they do not yet.

    Parameters
    ----------
    records : Dataset
        From `make_records`.
    scan : Scan
        The scan that measured them.
    noise : Noise
        Their noise: the deviations are those of `mean_wind` in its turbulence; of noise over several length scales, in
        that of the middle one.
    nuisances : Nuisances, optional
        What is uncertain beside R.
    say : callable
        Takes a line that tells what was done.

    Returns
    -------
    records : Dataset
        The same, or with ``yaw_sd`` (record), degrees; NaN where the beams do not see the direction.

    Raises
    ------
    InputError
        If the records' directions are not those of their beams' means.
    """
    if nuisances is None or not nuisances.yaw_sd_of_records or "yaw_sd" in records:
        return records
    flows = np.unique(np.column_stack([noise.length_scale, noise.gamma]), axis=0)
    length_scale, gamma = flows[len(flows) // 2]
    flow = replace(noise.turbulence, length_scale=float(length_scale), gamma=float(gamma))
    found = mean_wind(records, scan, turbulence=flow)
    turn = np.deg2rad(found["yaw"].values - records["yaw"].values)
    other = np.flatnonzero(np.abs(np.angle(np.exp(1j * turn))) > _SAME_YAW)
    if len(other):
        index = int(other[0])
        raise InputError(
            f"Invalid yaw {float(records['yaw'][index]):.4g} degrees of record {index}, one of {len(other)}: its "
            f"beams' means give {float(found['yaw'][index]):.4g}, so they do not say how uncertain it is; give the "
            "records a yaw_sd, or a number as yaw_sd_deg (--yaw-sd)."
        )
    known = found["yaw_sd"].values[np.isfinite(found["yaw_sd"].values)]
    middle = f"median {np.median(known):.2g}°" if len(known) else "none known"
    say(
        f"uncertainty of the wind's direction: from the beams' means, {flow.name}, {middle}; "
        f"{len(turn) - len(known)} of {len(turn)} records without one"
    )
    return records.assign(yaw_sd=found["yaw_sd"])
