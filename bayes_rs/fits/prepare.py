"""Records, scan and noise that belong together, as the arrays that a fit works on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch
from bayes_rs.fits.campaign_groups import campaign_groups
from bayes_rs.fits.covariance_states import pair_data
from bayes_rs.fits.few_samples import scatter_of_few
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.geometry.attitude import gain_turn
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.noise import Noise
from bayes_rs.records.layout import MAST, TURBINE, check_layout
from bayes_rs.spectra.told_noise import NOISE_COMMON_SD, mean_of_used

LEAST_NOISE = 0.5
"""Share of the instrument's noise that a beam's variance must have: below, the beam does not see what the others do."""
LEAST_WIND, LEAST_VARIANCE = 1e-6, 1e-12
"""m/s and m² s⁻²: what is below is none, and its squares and inverses are no numbers."""
LEAST_OF_USUAL = 0.25
"""Share of the mean variance of a record that each of its beams is taken to have, for the error of its noise."""


def can_be_fitted(batch: Batch) -> NDArray[np.int64]:
    """Return the numbers of the records that have a usable beam, a wind speed and a direction."""
    return np.flatnonzero(batch.used.any(axis=1) & (batch.wind_speed > LEAST_WIND) & np.isfinite(batch.yaw))


def prepare(records: xr.Dataset, scan: Scan, noise: Noise, options: FitOptions) -> tuple[Scan, Noise, Batch]:
    """Check that records, scan and noise belong together; return scan and noise of the records' beams, and the data.

    Raises
    ------
    InputError
        If they do not belong together.
    NoiseMismatchError
        If the noise was made for another scan.
    """
    scan = _checked_scan(records, scan)
    noise = noise.select(scan.beam)
    noise.check_scan(scan)
    check_duration(float(records.attrs.get("duration", noise.duration)), noise)
    uncertain = options.nuisances
    own_noise = own_noise_sd = common_sd = None
    if isinstance(options.instrument_noise, str):
        own_noise = _own_noise(records, sound_beams(records))
        if uncertain.instrument_noise_log_sd == 0.0:
            own_noise_sd = _own_noise_sd(records, sound_beams(records))
            common_sd = _common_noise_sd(records) if own_noise_sd is not None else None
        elif not np.all(own_noise[sound_beams(records) & _with_wind(records)] > 0.0):
            raise InputError(
                "Invalid instrument_noise 0 of records: its logarithm is to be uncertain, so its median must be above "
                "0 m² s⁻², and the records hold or tell none; give a number as instrument_noise."
            )
    batch = Batch(
        np.asarray(records["variance"].values, dtype=np.float64),
        used_beams(records, options.instrument_noise),
        np.asarray(records["wind_speed"].values, dtype=np.float64),
        np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64)),
        _stream_keys(records),
        {name: np.asarray(records[name].values) for name in ("length_scale", "gamma") if name in records},
        gain_turn(records, scan),
        own_noise,
        own_noise_sd,
        common_sd,
        group=campaign_groups(records, options.campaign_group),
    )
    correlations = options.information == "covariances"
    check_beside_mast(options, there=MAST in records)
    if correlations or MAST in records:
        batch = replace(batch, pairs=pair_data(records, scan, noise.duration, correlations=correlations))
    if options.scatter == "records" and "variance_scatter" in records:
        both = [records[name].values for name in ("variance_scatter", "variance_scatter_of_beams")]
        batch = replace(batch, scatter=np.stack(both, axis=-1).astype(np.float64))
    few = scatter_of_few(records, noise, batch.used)
    if few is not None:
        known = np.zeros((len(few), 2)) if batch.scatter is None else batch.scatter
        own = (1.0 + known[:, 1]) * (1.0 + few) - 1.0
        batch = replace(batch, scatter=np.stack([known[:, 0], own], axis=-1))
    if uncertain.length_scale_sd_of_records and {"length_scale", "length_scale_log_sd"} <= set(records):
        batch = replace(batch, length_log_sd=_own_length_log_sd(records))
    if uncertain.probe_length_log_sd > 0.0:
        batch = replace(batch, probe_sd=_probe_sd(batch, noise, uncertain.probe_length_log_sd))
    if uncertain.yaw_sd_of_records:
        batch = replace(batch, yaw_sd=_own_yaw_sd(records, can_be_fitted(batch), uncertain.yaw_sd_missing_deg))
    return scan, noise, batch


def used_beams(records: xr.Dataset, instrument_noise: float | str) -> NDArray[np.bool_]:
    """Return which variances of records count, shape (n_record, n_beam).

    Sound ones, but for those below half of the instrument's own noise: no beam that works has so little. Variances that
    are a little less than noise are what scatter makes, and the likelihood knows.
    """
    used = sound_beams(records)
    if not isinstance(instrument_noise, str):
        return used
    return np.asarray(used & (records["variance"].values > LEAST_NOISE * _own_noise(records, used)))


def is_all_noise(records: xr.Dataset, options: FitOptions) -> NDArray[np.bool_]:
    """Return which records have no variance above the instrument's noise, (n_record,); none that have no sound beam.

    Noise that is uncertain is taken two standard deviations below its median. Of noise that the records hold, half
    counts, as for `used_beams`: it is told by the same variances.
    """
    sound = sound_beams(records)
    if isinstance(options.instrument_noise, str):
        least: float | FloatArray = LEAST_NOISE * _own_noise(records, sound)
    else:
        least = _least_noise(options)
    above = np.asarray(records["variance"].values > least)
    return np.asarray(sound.any(axis=1) & ~(sound & above).any(axis=1))


def check_noise_is_less(parts: Sequence[xr.Dataset], options: FitOptions) -> None:
    """Refuse noise of the instrument, given as a number, that is twice every variance of all records, or more.

    Parameters
    ----------
    parts : sequence of Dataset
        The records, of one range each.
    options : FitOptions
        Of the fit.

    Raises
    ------
    InputError
        If it is.
    """
    if isinstance(options.instrument_noise, str):
        return
    noise, least = options.known_instrument_noise, LEAST_NOISE * _least_noise(options)
    most = max((float(part["variance"].values[sound_beams(part)].max(initial=0.0)) for part in parts), default=0.0)
    if 0.0 < most < least:
        raise InputError(
            f"Invalid instrument_noise {noise:g} m² s⁻² (--instrument-noise), a standard deviation of {noise**0.5:.3g} "
            f"m/s: no variance of the records is even half of it, the largest is {most:.3g} m² s⁻². Give the variance "
            "that the instrument alone adds to each, the square of the noise of its velocities in m/s, or leave it out."
        )


def _least_noise(options: FitOptions) -> float:
    return options.known_instrument_noise * float(np.exp(-2.0 * options.nuisances.instrument_noise_log_sd))


def record_yaw_sd(records: xr.Dataset, nuisances: Mapping[str, Any]) -> FloatArray | None:
    """Return how uncertain each record's direction is, degrees, where the nuisances (plain) leave it to the records."""
    if nuisances["yaw_sd_deg"] != "records":
        return None
    own = np.asarray(records["yaw_sd"].values, dtype=np.float64)
    missing = nuisances["yaw_sd_missing_deg"]
    return own if missing is None else np.where(np.isnan(own), missing, own)


def sound_beams(records: xr.Dataset) -> NDArray[np.bool_]:
    """Return which variances of records were made of enough good samples, shape (n_record, n_beam)."""
    variance = np.asarray(records["variance"].values, dtype=np.float64)
    return np.asarray((records["flag"].values == 0) & (variance > LEAST_VARIANCE) & np.isfinite(variance))


def check_beside_mast(options: FitOptions, *, there: bool) -> None:
    """Refuse options that do not go with a mast beside the beams, or that without one are not used.

    Parameters
    ----------
    options : FitOptions
        Of the fit.
    there : bool
        Whether there is a mast.

    Raises
    ------
    InputError
        For the first of them.
    """
    if not there:
        if options.mast_log_sd != FitOptions.mast_log_sd:
            raise InputError(
                "The option mast_log_sd is only used with a mast beside the beams: give that (the option mast, or "
                "'mast_stress' of the records), or leave it out."
            )
        if options.information == "variances" and options.coherence_log_sd != FitOptions.coherence_log_sd:
            raise InputError(
                "The option coherence_log_sd is only used with information 'covariances' (--information covariances), "
                "or with a mast beside the beams: give one of them, or leave it out."
            )
        return
    if options.likelihood != "log-normal":
        raise InputError(
            f"Invalid likelihood {options.likelihood!r} with a mast beside the beams: only with 'log-normal' is it "
            "known how both scatter together."
        )
    turned = [name for name in options.nuisances.names if name != "instrument_noise"]
    if turned or options.target == "sonic":
        what = f"target {options.target!r}" if not turned else f"uncertain {turned[0]}"
        raise InputError(
            f"Invalid {what} with a mast beside the beams: it would count for the mast, too; leave it out, or the "
            "mast (the option mast, or 'mast_stress' of the records)."
        )


def _checked_scan(records: xr.Dataset, scan: Scan) -> Scan:
    """Check the records and return the scan with only the beams that they hold."""
    check_layout(records, "variance", "flag", "wind_speed", "yaw")
    return scan.select(records["beam"].values)


def _own_noise(records: xr.Dataset, used: NDArray[np.bool_]) -> FloatArray:
    """Return the instrument's noise that the records hold, shape (n_record, n_beam), m² s⁻²; 0 if they hold none."""
    if "instrument_noise" not in records:
        return np.zeros(used.shape)
    own = np.asarray(records["instrument_noise"].values, dtype=np.float64)
    bad = np.argwhere(used & ~(np.isfinite(own) & (own >= 0.0)))
    if len(bad):
        record, beam = (int(i) for i in bad[0])
        raise InputError(
            f"Invalid instrument_noise {own[record, beam]} m² s⁻² of record {record}, beam "
            f"{records['beam'].values[beam]}: it must be finite, zero or above; with_instrument_noise makes it so."
        )
    return np.where(used, own, 0.0)


def _own_noise_sd(records: xr.Dataset, used: NDArray[np.bool_]) -> FloatArray | None:
    """Return how uncertain the instrument's noise is that records hold, over the variances; None if they do not say."""
    if "instrument_noise_sd" not in records:
        return None
    sd = np.asarray(records["instrument_noise_sd"].values, dtype=np.float64)
    variance = np.asarray(records["variance"].values, dtype=np.float64)
    told = used & np.isfinite(sd) & (sd > 0.0)
    if not told.any():
        return None
    # over what a beam should have: a beam that sees nothing is not for that all uncertain
    usual = np.sum(np.where(used, variance, 0.0), axis=1) / np.maximum(np.count_nonzero(used, axis=1), 1)
    least = np.maximum(variance, LEAST_OF_USUAL * usual[:, np.newaxis])
    return np.where(told, sd / np.where(told, least, 1.0), 0.0)


def _common_noise_sd(records: xr.Dataset) -> FloatArray:
    """Return the error of the instrument's noise that all records have in common, (n_record,), m² s⁻².

    Of noise that records do not say this of, all of its error is taken for common.
    """
    name = NOISE_COMMON_SD if NOISE_COMMON_SD in records else "instrument_noise_sd"
    return mean_of_used(records, name)


def _with_wind(records: xr.Dataset) -> NDArray[np.bool_]:
    """Return which records have a wind, (n_record, 1)."""
    known = (records["wind_speed"].values > LEAST_WIND) & np.isfinite(records["yaw"].values)
    return np.asarray(known[:, np.newaxis])


def _own_yaw_sd(records: xr.Dataset, fitted: NDArray[np.int64], missing_deg: float | None) -> FloatArray:
    """Return how uncertain the records say that their directions are, shape (n_record,), degrees."""
    if "yaw_sd" not in records:
        raise InputError(
            "The records have no yaw_sd with dims ('record',): add it with mean_wind(records, scan, turbulence=...), "
            "or give a number as yaw_sd_deg."
        )
    own = np.asarray(records["yaw_sd"].values, dtype=np.float64)
    if missing_deg is not None:
        own = np.where(np.isnan(own), missing_deg, own)
    bad = fitted[~(np.isfinite(own[fitted]) & (own[fitted] >= 0.0))]
    if len(bad):
        start = f" ({str(records['time'].values[bad[0]])[:16]})" if "time" in records.coords else ""
        raise InputError(
            f"Invalid yaw_sd {own[bad[0]]} degrees of record {bad[0]}{start}, one of {len(bad)}: it must be finite, "
            "zero or above; give yaw_sd_missing_deg (--yaw-sd-missing) for these, or one yaw_sd_deg (--yaw-sd) for all."
        )
    return own


def _own_length_log_sd(records: xr.Dataset) -> FloatArray:
    """Return how uncertain the records say that ln L is, shape (n_record,); 0 where they do not."""
    own = np.asarray(records["length_scale_log_sd"].values, dtype=np.float64)
    return np.where(np.isfinite(own) & (own > 0.0), own, 0.0)


def _probe_sd(batch: Batch, noise: Noise, log_sd: float) -> FloatArray:
    """Return how uncertain ln y is where the length of the probe volume is, shape (n_record, n_beam)."""
    if not noise.scan_geometry.get("probe"):
        raise InputError(
            f"Invalid probe_length_log_sd {log_sd:g}: the beams of scan {noise.scan_name!r} are points, which have no "
            "length; leave it out (--probe-length-sd), or name a scan with a probe volume."
        )
    from bayes_rs.noise.probe_length import probe_slope  # noqa: PLC0415 - seldom needed

    return log_sd * probe_slope(noise, batch.wind_speed, batch.yaw, batch.flow.get("length_scale"))


def check_duration(duration: float, noise: Noise) -> None:
    """Check that records of a duration, s, can be fitted with a noise.

    Raises
    ------
    InputError
        If the noise is for records of another one.
    """
    if not np.isclose(duration, noise.duration):
        raise InputError(
            f"The records last {duration:g} s and the noise is for records of {noise.duration:g} s: "
            "calibrate the noise for the records' duration."
        )


def _stream_keys(records: xr.Dataset) -> NDArray[np.int64]:
    """Return what makes each record's random stream its own: its start, or its number where there is no time.

    Of a fleet it is the start and the turbine's name: a turbine's numbers do not depend on those beside it.
    """
    if "time" in records.coords and np.issubdtype(records["time"].dtype, np.datetime64):
        starts = records["time"].values.astype("datetime64[ns]").astype(np.int64)
        if TURBINE in records:
            names, place = np.unique(records[TURBINE].values.astype(str), return_inverse=True)
            starts = starts ^ np.array([_key_of(name) for name in names.tolist()], dtype=np.int64)[place]
        if len(np.unique(starts)) == len(starts):
            return starts
    return np.arange(records.sizes["record"], dtype=np.int64)


def _key_of(name: str) -> int:
    """Return a whole number from 0 below 2^62 for a name, the same everywhere."""
    return int.from_bytes(hashlib.sha256(name.encode("utf-8")).digest()[:8], "little") >> 2
