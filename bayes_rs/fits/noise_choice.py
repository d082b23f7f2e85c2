"""The noise that records get, and what records must hold for a fit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.block_checks import unsteady_records, with_block_checks
from bayes_rs.fits.block_states import STATISTICS
from bayes_rs.fits.fit_options import USUAL_TURBULENCE, FitOptions, NoiseOptions
from bayes_rs.fits.uncertain_length import NODES, length_range
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.probe_words import probe_words
from bayes_rs.options import to_plain
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.quality.samples import BoolArray
from bayes_rs.wind.mean_vector import mean_wind

NET_LENGTHS = (10.0, 320.0)
"""Length scales, m, that noise reaches over for records whose own is uncertain; beyond, it is that of the ends."""
LATER_SPEEDS = (3.0, 25.0)
"""Wind speeds, m/s, that noise is made for before it is known which wind its records have."""
LATER_TURN = 20.0
"""The same for directions: degrees to both sides of the one that is known."""
OWN_TOLERANCE = 0.02
"""Largest relative error of K in a net over the length scales of records: it moves intervals by 1 %."""
LEAVE_OUT_LEVEL = 0.01
"""Share of steady records whose spectra may be left out of the length scale, since they seem unsteady."""
LENGTH_REPORT = "length_scale_report"
"""Attribute of records whose length scale is that of their spectra."""
_OF_SPECTRA = (
    "length_scale",
    "length_scale_log_sd",
    "spectral_length_scale",
    "spectral_length_scale_log_sd",
    "other_length_scale",
)
_SAID = (
    "duration", "velocity_limit", LENGTH_REPORT, "instrument_noise_report", "correlated_beams", "mast_position",
)  # fmt: skip
"""Attributes of records that numbers depend on."""
_SAME_YAW = 1e-6  # rad; both come from the same means
Say = Callable[[str], None]


def fit_inputs(records: xr.Dataset, noise: Noise | None, choice: NoiseOptions) -> dict[str, Any]:
    """Return the records and the noise, or how it is made, as they were given: what tells fits apart.

    Nothing that is calculated of them is here: its last bits are those of one kind of processor.
    """
    from bayes_rs.noise.at_states import NOISE_VERSION  # noqa: PLC0415 - not needed with given noise
    from bayes_rs.turbulence.mann import load_turbulence  # noqa: PLC0415 - as above

    variables = {
        str(name): [list(data.dims), data.values.astype(str) if data.dtype == object else data.values]
        for name, data in records.variables.items()
    }
    said = {name: records.attrs[name] for name in _SAID if name in records.attrs}
    made = [NOISE_VERSION, to_plain(choice), load_turbulence(choice.flow)] if noise is None else noise
    return {"noise": made, "records": [variables, said]}


def with_median_length_scale(
    options: FitOptions, choice: NoiseOptions, records: xr.Dataset, noise: Noise | None
) -> FitOptions:
    """Return options whose uncertain length scale has a median: that of the turbulence, if no one says another."""
    uncertain = options.nuisances
    known = uncertain.length_scale is not None or "length_scale" in records
    if uncertain.length_scale_sd == 0.0 or known or noise is not None or choice.of_records:
        return options
    from bayes_rs.turbulence.mann import load_turbulence  # noqa: PLC0415 - seldom needed

    median = load_turbulence(choice.flow).length_scale
    return replace(options, nuisances=replace(uncertain, length_scale=median))


def noise_and_records(
    records: xr.Dataset, scan: Scan, noise: Noise | None, options: FitOptions, choice: NoiseOptions, say: Say
) -> tuple[Noise, xr.Dataset]:
    """Return the noise, given or made for the records, and records that hold all that the fit asks of them.

    Parameters
    ----------
    records : Dataset
        From `make_records`.
    scan : Scan
        The scan that measured them.
    noise : Noise or None
        From `given_noise`.
    options : FitOptions
        Of the fit: its target and nuisances say what the noise must hold.
    choice : NoiseOptions
        How the noise is made.
    say : callable
        Takes lines that tell what was done.
    """
    fixed = not choice.of_records if noise is None else bool(np.ptp(noise.length_scale) == 0.0)
    if LENGTH_REPORT in records.attrs and (fixed or _assumed_noise(records) != options.instrument_noise):
        # what another fit found of these records is not what is asked for
        records = records.drop_vars(_OF_SPECTRA, errors="ignore").copy()
        del records.attrs[LENGTH_REPORT]
    if _needs_own_lengths(records, noise, options, choice):
        records = _with_lengths_of_steady(records, scan, options)
        _say_length(records, say)
    if noise is None:
        noise = _made_noise(records, scan, options, choice, say)
    if "length_scale" not in records and np.ptp(noise.length_scale) == 0.0 and "octave_variance" in records:
        from bayes_rs.spectra.record_lengths import compared_length_scale  # noqa: PLC0415 - not needed otherwise

        records = compared_length_scale(
            records, scan, float(noise.length_scale[0]), instrument_noise=options.instrument_noise
        )
        _say_length(records, say)
    if options.instrument_noise == "records":
        from bayes_rs.spectra.record_lengths import with_told_noise  # noqa: PLC0415 - not needed otherwise
        from bayes_rs.spectra.told_noise import noise_words  # noqa: PLC0415 - as above

        records = with_told_noise(records, scan)
        if words := noise_words(records):
            say(words)
    if words := about_probe(noise, records):
        say(words)
    records = with_block_checks(records, scan, noise, options, say)
    return noise, _with_yaw_sd(records, scan, noise, options.nuisances, say)


def _assumed_noise(records: xr.Dataset) -> float | str:
    """Return the instrument's noise that the length scale of records was found with."""
    return cast("float | str", json.loads(records.attrs[LENGTH_REPORT]).get("instrument_noise", 0.0))


def _say_length(records: xr.Dataset, say: Say) -> None:
    """Say which length scale the records' spectra tell."""
    from bayes_rs.spectra.record_lengths import length_words  # noqa: PLC0415 - not needed otherwise

    if words := length_words(records):
        say(words)


def _with_lengths_of_steady(records: xr.Dataset, scan: Scan, options: FitOptions) -> xr.Dataset:
    """Return records with length scale and noise of their spectra; those of unsteady records tell no length.

    A front is slow, and seems to be an eddy that is longer than all others. Records that change too clearly for the
    length scales of the campaign are left out, and again for what the others tell, until no more are found. Their own
    length scale is no measure: the change is in it.
    """
    from bayes_rs.spectra.record_lengths import with_own_length_scale  # noqa: PLC0415 - not needed with given noise
    from bayes_rs.turbulence.mann import load_turbulence  # noqa: PLC0415 - as above

    usual, level = load_turbulence(USUAL_TURBULENCE), options.unsteady_level
    looked_at = [name for name in (*STATISTICS, "wind_speed", "yaw") if name in records]

    def unsteady(found: xr.Dataset) -> BoolArray:
        campaign = json.loads(found.attrs[LENGTH_REPORT])
        speed = np.asarray(found["wind_speed"].values, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            own = campaign["length_scale"] * (speed / campaign["wind_speed"]) ** campaign["slope"]
        log_sd = np.full(len(speed), np.hypot(campaign["spread"], campaign["log_sd"]))
        like_others = found[looked_at].assign(length_scale=("record", own), length_scale_log_sd=("record", log_sd))
        return unsteady_records(like_others, scan, usual, min(level, LEAVE_OUT_LEVEL))

    return with_own_length_scale(
        records,
        scan,
        instrument_noise=options.instrument_noise,
        unsteady=unsteady if level > 0.0 else None,
    )


def _needs_own_lengths(records: xr.Dataset, noise: Noise | None, options: FitOptions, choice: NoiseOptions) -> bool:
    """Tell whether records are to get the length scale of their spectra: where they and the user say none."""
    if not choice.of_records or "length_scale" in records or options.nuisances.length_scale is not None:
        return False
    return noise is None or len(np.unique(noise.length_scale)) > 1


def _made_noise(
    records: xr.Dataset,
    scan: Scan,
    options: FitOptions,
    choice: NoiseOptions,
    say: Say,
    *,
    own_lengths: bool = False,
) -> Noise:
    from bayes_rs.noise.calibrating import calibrate  # noqa: PLC0415 - not needed with a file

    noise = calibrate(
        scan,
        choice.flow,
        records=records,
        sonic=options.target == "sonic",
        length_scale=_length_scales(records, options.nuisances),
        tolerance=OWN_TOLERANCE if own_lengths or LENGTH_REPORT in records.attrs else None,
    )
    say(
        noise.in_words(
            records["wind_speed"].values,
            np.deg2rad(records["yaw"].values),
            length_scale=_lengths_of_records(records, options.nuisances),
            gamma=records["gamma"].values if "gamma" in records else None,
        )
    )
    return noise


def noise_for_later(
    records: xr.Dataset, scan: Scan, options: FitOptions, choice: NoiseOptions, say: Say
) -> Noise | None:
    """Return noise for the records that follow the last of some; None if that one has no wind.

    It is made for `LATER_SPEEDS`, for directions that differ by up to `LATER_TURN` from that of the record, and, where
    the length scale is the records' own, for `NET_LENGTHS`.
    """
    speed, yaw = (float(records[name].values[-1]) for name in ("wind_speed", "yaw"))
    if not (np.isfinite(speed) and np.isfinite(yaw) and speed > 0.0):
        return None
    ends = records.isel(record=[-1, -1, -1]).drop_vars(_OF_SPECTRA, errors="ignore")
    ends = ends.assign(
        wind_speed=("record", np.array([min(LATER_SPEEDS[0], speed), speed, max(LATER_SPEEDS[1], speed)])),
        yaw=("record", yaw + LATER_TURN * np.array([-1.0, 0.0, 1.0])),
    )
    own_lengths = choice.of_records and options.nuisances.length_scale is None
    if own_lengths:
        middle = float(np.sqrt(NET_LENGTHS[0] * NET_LENGTHS[1]))
        ends = ends.assign(length_scale=("record", np.array([NET_LENGTHS[0], middle, NET_LENGTHS[1]])))
    return _made_noise(ends, scan, options, choice, say, own_lengths=own_lengths)


def about_probe(noise: Noise, records: xr.Dataset) -> str:
    """Say what the noise's probe volume does in the records' winds; empty if that is not known."""
    if not {"wind_speed", "yaw"} <= set(records.variables):
        return ""
    own = records["length_scale"].values if "length_scale" in records else None
    return probe_words(noise, records["wind_speed"].values, np.deg2rad(records["yaw"].values), own)


def _lengths_of_records(records: xr.Dataset, nuisances: Nuisances) -> FloatArray | None:
    """Return L, m, at the nodes that the noise of each record is averaged over, (n_node, n_record); None if unknown."""
    median = records.get("length_scale")
    factors = np.ones(1)
    if nuisances.length_scale_sd > 0.0:
        factors = nuisances.length_scale_nodes()[0]
        if nuisances.length_scale is not None:
            median = xr.full_like(records["wind_speed"], nuisances.length_scale)
    elif nuisances.length_scale_sd_of_records and "length_scale_log_sd" in records:
        factors = np.exp(NODES[:, np.newaxis] * np.nan_to_num(records["length_scale_log_sd"].values))
    return None if median is None else np.asarray(median.values * factors.reshape(len(factors), -1), dtype=np.float64)


def _length_scales(records: xr.Dataset, nuisances: Nuisances) -> list[float] | None:
    """Return the shortest and longest L that the noise must know; None if it is that of the turbulence."""
    if nuisances.length_scale_sd == 0.0:
        own = np.asarray(records.get("length_scale", xr.DataArray([])).values, dtype=np.float64)
        known = np.isfinite(own)
        if nuisances.length_scale_sd_of_records and "length_scale_log_sd" in records and known.any():
            log_sd = np.nan_to_num(records["length_scale_log_sd"].values)
            return [float(np.clip(end, *NET_LENGTHS)) for end in length_range(own[known], log_sd[known])]
        return [float(own[known].min()), float(own[known].max())] if known.any() else None
    median = records.get("length_scale") if nuisances.length_scale is None else xr.DataArray(nuisances.length_scale)
    if median is None:
        return None  # not certain, but its median is not known: the fit says so
    factors = nuisances.length_scale_nodes()[0]
    return [float(median.min() * factors.min()), float(median.max() * factors.max())]


def _with_yaw_sd(
    records: xr.Dataset,
    scan: Scan,
    noise: Noise,
    nuisances: Nuisances,
    say: Say,
) -> xr.Dataset:
    """Return records that say how uncertain their directions are, where the nuisances ask for it and they do not yet.

    The deviations are those of `mean_wind` in the turbulence of the noise; of noise over several length scales, in that
    of the middle one. NaN where the beams do not see the direction.
    """
    if not nuisances.yaw_sd_of_records or "yaw_sd" in records:
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
