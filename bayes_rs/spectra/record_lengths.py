"""The length scale of records, and the instrument's noise in them, from the octaves of their variances."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_log_normal, check_non_negative
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.records.making import OCTAVES
from bayes_rs.spectra.octave_information import octave_information
from bayes_rs.spectra.octave_likelihood import Octaves, averaged
from bayes_rs.spectra.octave_theory import MOST_BEAMS, OctaveTheory, chosen_beams, length_nodes, octave_theory
from bayes_rs.spectra.pooled_lengths import PRIOR_LOG_SD, PRIOR_MEDIAN, pool_lengths
from bayes_rs.spectra.told_noise import (
    NOISE,
    NOISE_COMMON_SD,
    NOISE_REPORT,
    NOISE_SD,
    ToldNoise,
    known_noise,
    nothing_told,
)
from bayes_rs.turbulence.mann import load_turbulence

REPORT = "length_scale_report"
"""Attribute of records, JSON, that says where their length scale comes from."""
GAMMA = 3.2
"""Anisotropy Γ of the turbulence that the octaves are compared with."""
USUAL = "fu-2022"
"""Turbulence whose anisotropy stands for that of the records."""
_NAMES = ("length_scale", "length_scale_log_sd")
_HALF = np.log(1.5)  # other length scales than by half are not worth a word
_TELLS = 1.0  # decrease of the log-likelihood from its maximum to the ends, below which a record tells nothing
_SAMPLES_OFF = 1.3  # samples over what the scan gives, above which its times are not those of the scan
_MOST_PASSES = 6  # in which unsteady records are left out
_USED = 0.2  # share of records that a beam must be used in, to be looked at


def with_own_length_scale(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    length_scale_prior: tuple[float, float] = (PRIOR_MEDIAN, PRIOR_LOG_SD),
    gamma: float = GAMMA,
    instrument_noise: float | str = "records",
    unsteady: Callable[[xr.Dataset], NDArray[np.bool_]] | None = None,
) -> xr.Dataset:
    """Return records with the length scale and the instrument noise that the octaves of their variances tell.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`. Without ``octave_variance``, as records that are variances alone, nothing is told.
    scan : Scan, str or Path
        The scan that measured them, with its probe volume.
    length_scale_prior : tuple of float
        Median of the length scale L, m, and standard deviation of ln L, of a record of an unknown campaign.
    gamma : float
        Anisotropy parameter Γ.
    instrument_noise : float or str
        Variance of the instrument's noise, m² s⁻², where it is known; ``"records"``: what the records hold, or, where
        they hold none, what their octaves tell.
    unsteady : callable, optional
        Takes records with length scales, and returns which of them, shape (n_record,), change by more than eddies.
        Their spectra tell nothing, and the length scales are found anew, until no more records are found.

    Returns
    -------
    records : xarray.Dataset
        With ``length_scale`` (record), m, posterior medians, and ``length_scale_log_sd`` (record); and, where the
        records tell their noise to 5 % of their variance, or to half of itself, with ``instrument_noise``,
        ``instrument_noise_sd`` and, the part of it that all records share, ``instrument_noise_common_sd`` (record,
        beam), m² s⁻². The attribute ``length_scale_report`` counts in JSON the records that tell something,
        and says what their distribution is.

    Raises
    ------
    InputError
        If records and scan do not belong together.

    Notes
    -----
    A look-up in tables that are made once for a scan: `octave_theory`, `Octaves`, `pool_noise`, `pool_lengths`. Where
    the samples cannot tell, as 20 in ten minutes, the prior's width stays, narrowed by the other records only. What
    looks like noise because the air's spectrum has another shape than the theory's was 1 % of the variance in eleven
    kinds of air and six scans (root mean square; 6 % where L is half of the probe's length, else up to 2.4 %): its
    standard deviation is in that of the noise.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> series = brs.simulate("6-beam", "fu-2022", wind_speed=10.0, n_records=20, seed=1)  # L is 61 m
    >>> records = with_own_length_scale(brs.make_records(series, "6-beam"), "6-beam")
    >>> bool(45.0 < float(records["length_scale"].median()) < 85.0)
    True
    """
    of_records = as_scan(scan).select(records["beam"].values)
    check_non_negative(gamma, what="gamma", unit="")
    known = known_noise(records, instrument_noise)
    prior = check_log_normal(length_scale_prior, what="length_scale_prior", unit="m", width="length_scale_log_sd")
    rows, octaves = _octaves(records, of_records, gamma)
    log_density = np.zeros((records.sizes["record"], len(length_nodes())))
    told: ToldNoise | None = None
    if octaves is not None and known is None:
        told = ToldNoise.of(rows, octaves, prior)
        log_density[rows] = told.of_length()
    elif octaves is not None and known is not None:
        share = np.nan_to_num(known[rows] / octaves.variance)
        log_density[rows] = averaged(octaves.log_likelihood(share[:, np.newaxis]), np.zeros(1))
    found = _pooled(records, log_density, prior, 0, instrument_noise)
    if unsteady is not None and log_density.any():
        left_out: NDArray[np.bool_] = np.zeros(len(log_density), dtype=bool)
        for _ in range(_MOST_PASSES):
            more = unsteady(found) & ~left_out
            if not more.any():
                break
            left_out |= more
            log_density[more] = 0.0
            found = _pooled(records, log_density, prior, int(left_out.sum()), instrument_noise)
    if known is not None:
        return found
    return nothing_told(found) if told is None else told.given_to(found, json.loads(found.attrs[REPORT]))


def _pooled(
    records: xr.Dataset,
    log_density: FloatArray,
    prior: tuple[float, float],
    n_unsteady: int,
    instrument_noise: float | str,
) -> xr.Dataset:
    """Return records with their length scales, and the report on them."""
    speed = np.asarray(records["wind_speed"].values, dtype=np.float64)
    median, log_sd = (float(value) for value in prior)
    pooled = pool_lengths(log_density, speed, median=median, log_sd=log_sd)
    told = log_density.max(axis=1) - np.minimum(log_density[:, 0], log_density[:, -1]) > _TELLS
    known = speed[np.isfinite(speed) & (speed > 0.0)]
    report: dict[str, Any] = {
        "n_record": len(speed),
        "n_told": int(told.sum()),
        "length_scale": pooled.centre,
        "log_sd": pooled.centre_log_sd,
        "spread": pooled.spread,
        "slope": pooled.slope,
        "wind_speed": float(np.exp(np.mean(np.log(known)))) if len(known) else None,
        "own_log_sd": float(np.median(pooled.log_sd)),
        "prior": [median, log_sd],
        "n_unsteady": n_unsteady,
        "instrument_noise": instrument_noise if isinstance(instrument_noise, str) else float(instrument_noise),
    }
    report["words"] = _in_words(report)
    return records.assign(
        length_scale=("record", pooled.length_scale, {"units": "m", "long_name": "length scale of the turbulence"}),
        length_scale_log_sd=("record", pooled.log_sd, {"units": "1", "long_name": "standard deviation of ln L"}),
    ).assign_attrs({REPORT: json.dumps(report)})


def with_told_noise(records: xr.Dataset, scan: Scan | str | Path) -> xr.Dataset:
    """Return records with the instrument noise that their octaves tell, and their length scale as it was.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`. Where they hold ``instrument_noise``, or were asked before, they stay as they are.
    scan : Scan, str or Path
        The scan that measured them.

    Returns
    -------
    records : xarray.Dataset
        As `with_own_length_scale`.
    """
    if NOISE in records or NOISE_REPORT in records.attrs:
        return records
    if _octaves(records, as_scan(scan).select(records["beam"].values), GAMMA)[1] is None:
        return nothing_told(records)
    return _with_noise_of(records, with_own_length_scale(records.drop_vars(_NAMES, errors="ignore"), scan))


def _with_noise_of(records: xr.Dataset, own: xr.Dataset) -> xr.Dataset:
    found = records.assign({name: own[name] for name in (NOISE, NOISE_SD, NOISE_COMMON_SD) if name in own})
    return found.assign_attrs({NOISE_REPORT: own.attrs[NOISE_REPORT]}) if NOISE_REPORT in own.attrs else found


def compared_length_scale(
    records: xr.Dataset, scan: Scan | str | Path, length_scale: float, *, instrument_noise: float | str = "records"
) -> xr.Dataset:
    """Return records that say whether the length scale of their spectra contradicts that of given noise.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`; their own noise, if they say a length scale, is not changed.
    scan : Scan, str or Path
        The scan that measured them.
    length_scale : float
        L that the noise is made for, m.
    instrument_noise : float or str
        As for `with_own_length_scale`.

    Returns
    -------
    records : xarray.Dataset
        With ``spectral_length_scale`` (record), m, ``spectral_length_scale_log_sd``, and ``other_length_scale``
        (record), whether that is another one: by two standard deviations and by at least half of it. Unchanged if the
        records tell nothing. With the instrument's noise, as from `with_own_length_scale`. The report holds
        ``noise_length_scale`` and ``coverage``, what 90 % intervals hold where the data decide: 2Φ(1.645/r) − 1 with r²
        the relative variance of a variance at the records' L over that at the noise's, by theory for the middle beam.
    """
    own = with_own_length_scale(records.drop_vars(_NAMES, errors="ignore"), scan, instrument_noise=instrument_noise)
    report = json.loads(own.attrs[REPORT])
    if report["n_told"] == 0:
        return records
    apart = np.abs(np.log(own["length_scale"].values / length_scale))
    other = (apart > 2.0 * own["length_scale_log_sd"].values) & (apart > _HALF)
    centre = abs(np.log(report["length_scale"] / length_scale))
    report["noise_length_scale"] = float(length_scale)
    report["contradicts"] = bool(centre > 2.0 * report["log_sd"] and centre > _HALF)
    if report["contradicts"]:
        report["coverage"] = _coverage(records, as_scan(scan), length_scale, report)
    report["words"] = _in_words(report)
    return (
        _with_noise_of(records, own)
        .assign(
            spectral_length_scale=own["length_scale"],
            spectral_length_scale_log_sd=own["length_scale_log_sd"],
            other_length_scale=("record", other.astype(np.int8)),
        )
        .assign_attrs({REPORT: json.dumps(report)})
    )


def _coverage(records: xr.Dataset, scan: Scan, length_scale: float, report: dict[str, Any]) -> float:
    """Return what 90 % intervals of a radial variance hold that were made for another length scale."""
    middle = scan.select([scan.beam[scan.n_beam // 2]])
    common = {"wind_speed": report["wind_speed"], "duration": float(records.attrs.get("duration", 600.0))}
    flow = load_turbulence(USUAL)
    given, true = (
        float(theory_noise(middle, replace(flow, length_scale=scale), **common).covariance[0, 0, 0])
        for scale in (length_scale, report["length_scale"])
    )
    return float(scipy.special.erf(1.645 * np.sqrt(given / true) / np.sqrt(2.0)))


def length_words(records: xr.Dataset) -> str:
    """Say in one line which length scale records have, and where it comes from; empty if there is nothing to say."""
    return str(json.loads(records.attrs.get(REPORT, "{}")).get("words", ""))


def _in_words(report: dict[str, Any]) -> str:
    low, high = _ends(report["length_scale"], report["log_sd"])
    if "noise_length_scale" in report:
        if not report["contradicts"]:
            return ""
        return (
            f"noise was made for L = {report['noise_length_scale']:.0f} m, the records' spectra say "
            f"{report['length_scale']:.0f} ({low:.0f} to {high:.0f}): where the data decide, 90 % intervals hold about "
            f"{100.0 * report['coverage']:.0f} %"
        )
    left_out = f"; left out: {report['n_unsteady']} unsteady records" if report["n_unsteady"] else ""
    if report["n_told"] == 0:
        low, high = _ends(report["prior"][0], report["prior"][1])
        return (
            f"length scale: the records do not tell it, so it is anything from {low:.0f} to {high:.0f} m (90 %), which "
            f"widens the intervals{left_out}"
        )
    return (
        f"length scale from the spectra of {report['n_told']} of {report['n_record']} records: "
        f"{report['length_scale']:.0f} m ({low:.0f} to {high:.0f}) at {report['wind_speed']:.1f} m/s, different from "
        f"record to record by a factor {np.exp(report['spread']):.2g}; that of a record is known to a factor "
        f"{np.exp(report['own_log_sd']):.2g} (one standard deviation){left_out}"
    )


def _ends(median: float, log_sd: float) -> tuple[float, float]:
    """Return the ends of the 90 % interval."""
    return median * np.exp(-1.645 * log_sd), median * np.exp(1.645 * log_sd)


def _octaves(records: xr.Dataset, scan: Scan, gamma: float) -> tuple[NDArray[np.int64], Octaves | None]:
    """Return which records' octaves are looked at, and these; None where nothing is told."""
    nothing: NDArray[np.int64] = np.empty(0, dtype=np.int64)
    if OCTAVES not in records or "count" not in records:
        return nothing, None
    used = np.asarray(records["flag"].values == 0)
    speed, yaw = (np.asarray(records[name].values, dtype=np.float64) for name in ("wind_speed", "yaw"))
    known = np.isfinite(speed) & (speed > 0.0) & np.isfinite(yaw) & used.any(axis=1)
    if not known.any():
        return nothing, None
    often = np.flatnonzero(used[known].mean(axis=0) > _USED)
    beams = often[chosen_beams(len(often), MOST_BEAMS)] if len(often) else often
    if len(beams) == 0:
        return nothing, None
    rows = np.flatnonzero(known)
    angle = np.angle(np.exp(1j * np.deg2rad(yaw[rows])))
    duration = float(records.attrs.get("duration", 600.0))
    theory = octave_theory(scan.select(scan.beam[beams]), duration, gamma, yaw=(float(angle.min()), float(angle.max())))
    count = records["count"].values[np.ix_(rows, beams)]
    if not _same_times(records, theory, count, used[np.ix_(rows, beams)]):
        return nothing, None
    return rows, Octaves(
        records[OCTAVES].values[np.ix_(rows, beams)].astype(np.float64),
        count.astype(np.float64),
        used[np.ix_(rows, beams)],
        speed[rows],
        angle,
        theory,
        octave_information(theory, duration),
    )


def _same_times(records: xr.Dataset, theory: OctaveTheory, count: FloatArray, used: NDArray[np.bool_]) -> bool:
    """Tell whether the records are sampled as the scan says."""
    usual = float(np.median(count[used])) / theory.blocks.n_sample
    return records.sizes["octave"] == theory.blocks.n_octave and 1.0 / _SAMPLES_OFF**4 < usual < _SAMPLES_OFF
