"""The variance of the instrument's own noise in each record and beam, with its uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy
import xarray as xr

from bayes_rs._validation import FloatArray, check_choice, check_count
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.spectra.mann_fit import fit_spectra
from bayes_rs.spectra.radial_spectrum import check_spectra
from bayes_rs.spectra.structure_noise import intercept_weights, structure_covariance, structure_function
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

NOISE_METHODS = ("structure", "spectrum")
"""Ways to tell the instrument's noise from the turbulence."""

GROWTHS = ("theory", "inertial")
"""How structure functions grow with the lag: as the theory says of this beam, or with its power 2/3."""

NOISE_FLAGS = {"above_variance": 1, "below_zero": 2, "not_identified": 4}
"""Flags of an estimate, bits."""

_LEAST_PAIRS = 5


def estimate_instrument_noise(
    spectra: xr.Dataset,
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path,
    *,
    method: str = "structure",
    n_lag: int = 4,
    growth: str = "theory",
) -> xr.Dataset:
    r"""Estimate the variance of the instrument's noise in each record and beam.

    Parameters
    ----------
    spectra : xarray.Dataset
        From `radial_spectra`. Its ``length_scale`` (record), if it holds one, replaces that of `turbulence`.
    scan : Scan, str or Path
        The scan that measured them, with its probe volume.
    turbulence : MannTurbulence, str or Path
        What the flow is taken to be; its dissipation has no influence.
    method : str
        ``"structure"``: structure functions at short lags, continued to lag zero. ``"spectrum"``: the floor of the
        spectrum, as `fit_spectra` finds it for each beam alone, its prior as wide as the beam's variance.
    n_lag : int
        Lags used by ``"structure"``, 2 or more.
    growth : str
        How the structure function of the turbulence is taken to grow with the lag, for ``"structure"``: ``"theory"``,
        as that of this beam, its probe volume included; ``"inertial"``, with τ^(2/3) (Lenschow et al. 2000).

    Returns
    -------
    estimate : xarray.Dataset
        ``instrument_noise`` and ``instrument_noise_sd`` (record, beam), m² s⁻², NaN where there is no spectrum;
        ``flag`` (record, beam), bits: 1 ``above_variance``, the estimate is not below the beam's variance; 2
        ``below_zero``, which half of the estimates of no noise are; 4 ``not_identified``, the standard deviation is
        above half of the beam's variance.

    Raises
    ------
    InputError
        If spectra and scan do not belong together, or an option is not valid.

    Notes
    -----
    White noise of variance s adds s to the autocovariance at lag zero and to no other, so that

    .. math:: D(m) = \tfrac12 \langle (v_{i+m} - v_i)^2 \rangle = s + a\,\gamma(mΔ), \qquad m = 1 \dots M,

    with γ ∝ τ^(2/3) in the inertial range (Lenschow, Wulfmeyer and Senff 2000, who continue the autocovariance itself);
    s and a by least squares. The standard deviation is that of these weights with the covariance of D by Isserlis'
    theorem, exact for Gaussian flow and any gaps, at the autocovariance of the turbulence that is given, of the size a,
    and the noise found. It is of sampling only: a wrong shape of γ is not in it. The noise is not clipped.

    References
    ----------
    Lenschow, Wulfmeyer and Senff (2000), J. Atmos. Oceanic Technol. 17, 1330–1347,
    doi:10.1175/1520-0426(2000)017<1330:MSTFOM>2.0.CO;2.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=20, seed=1)
    >>> noise = 0.3 * np.random.default_rng(1).standard_normal(series.sizes["sample"])
    >>> noisy = series.assign(radial_velocity=series["radial_velocity"] + noise)
    >>> spectra = brs.spectra.radial_spectra(noisy, scan, brs.make_records(noisy, scan))
    >>> found = estimate_instrument_noise(spectra, scan, flow)
    >>> float(found["instrument_noise"].mean().round(2))  # 0.09 was added
    0.09
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    check_spectra(spectra)
    used = scan.select(spectra["beam"].values)
    check_choice(method, NOISE_METHODS, what="method of the instrument's noise")
    check_choice(growth, GROWTHS, what="growth")
    check_count(n_lag, what="n_lag", minimum=2)
    variance = np.asarray(spectra["variance"].values, dtype=np.float64)
    if method == "spectrum":
        noise, sd = _from_floor(spectra, scan, turbulence)
    else:
        noise, sd = _from_structure(spectra, used, turbulence, n_lag, growth)
    known = np.isfinite(noise)
    flag = np.zeros(noise.shape, dtype=np.uint8)
    flag[known & (noise >= variance)] |= NOISE_FLAGS["above_variance"]
    flag[known & (noise < 0.0)] |= NOISE_FLAGS["below_zero"]
    flag[known & (sd > 0.5 * variance)] |= NOISE_FLAGS["not_identified"]
    both = ("record", "beam")
    return xr.Dataset(
        {
            "instrument_noise": (both, noise, {"units": "m2 s-2", "long_name": "variance of the instrument's noise"}),
            "instrument_noise_sd": (both, sd, {"units": "m2 s-2"}),
            "variance": (both, variance, {"units": "m2 s-2"}),
            "flag": (
                both,
                flag,
                {
                    "flag_masks": np.array(list(NOISE_FLAGS.values()), dtype=np.uint8),
                    "flag_meanings": " ".join(NOISE_FLAGS),
                },
            ),
        },
        coords={"time": ("record", spectra["time"].values), "beam": ("beam", spectra["beam"].values)},
        attrs={"scan": scan.name, "scan_key": scan.key, "method": method, "turbulence": turbulence.name},
    )


def with_instrument_noise(
    records: xr.Dataset, estimate: xr.Dataset, *, per: str = "instrument", known_positive: bool = True
) -> xr.Dataset:
    """Return records with the instrument's noise, which `fit` takes off their variances.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`.
    estimate : xarray.Dataset
        From `estimate_instrument_noise` of these records.
    per : str
        ``"instrument"``: one number for all records and beams; ``"beam"``: one for each beam; ``"record"``: one for
        each record and beam, which is noisy.
    known_positive : bool
        Use that a variance is not negative: the mean of the normal distribution with the estimate's mean and standard
        deviation, cut off at zero. Without, an estimate below zero stays, and `fit` refuses it.

    Returns
    -------
    records : xarray.Dataset
        With ``instrument_noise`` and ``instrument_noise_sd`` (record, beam), m² s⁻². Beams whose noise is twice
        their variance or more are left out by `fit`, and flagged. Beams without an estimate get the mean of all.

    Raises
    ------
    InputError
        If the estimate is not of these records, or holds no number.

    Notes
    -----
    Means over records are weighted by nothing but their number: weights of the standard deviations would favour records
    whose noise was estimated low. Their standard deviation is the scatter of the records' means over the root of
    their number (one record: of its own standard deviations, beams taken as one).

    Examples
    --------
    See `fit`, and docs/spectra.md.
    """
    check_choice(per, ("instrument", "beam", "record"), what="per")
    if "instrument_noise" not in estimate or estimate["instrument_noise"].dims != ("record", "beam"):
        raise InputError("The estimate has no instrument_noise of records and beams: use estimate_instrument_noise.")
    same = estimate.sizes["record"] == records.sizes["record"] and np.array_equal(
        estimate["time"].values, records["time"].values
    )
    if not same or not np.array_equal(estimate["beam"].values, records["beam"].values):
        raise InputError("The estimate is not of these records and beams: estimate the noise of these.")
    noise, sd = estimate["instrument_noise"].values, estimate["instrument_noise_sd"].values
    if not np.isfinite(noise).any():
        raise InputError("The estimate holds no number, so there is no noise to give to the records.")
    whole, whole_sd = _mean_of(noise, sd)
    if per == "instrument":
        noise, sd = np.full(noise.shape, whole), np.full(noise.shape, whole_sd)
    elif per == "beam":
        parts = [_mean_of(noise[:, b : b + 1], sd[:, b : b + 1]) for b in range(noise.shape[1])]
        table = np.array([part if np.isfinite(part[0]) else (whole, whole_sd) for part in parts])
        noise, sd = np.broadcast_to(table[:, 0], noise.shape), np.broadcast_to(table[:, 1], noise.shape)
    else:
        missing = ~np.isfinite(noise)
        noise, sd = np.where(missing, whole, noise), np.where(missing, whole_sd, sd)
    if known_positive:
        noise, sd = _cut_at_zero(noise, sd)
    both = ("record", "beam")
    return records.assign(
        instrument_noise=(
            both,
            np.array(noise),
            {"units": "m2 s-2", "long_name": "variance of the instrument's noise"},
        ),
        instrument_noise_sd=(both, np.array(sd), {"units": "m2 s-2"}),
    )


def _from_floor(spectra: xr.Dataset, scan: Scan, turbulence: MannTurbulence) -> tuple[FloatArray, FloatArray]:
    """Return the floor of the spectrum of each beam and record, and its standard deviation."""
    width = float(np.nanmax(spectra["variance"].values))
    fit = fit_spectra(
        spectra,
        scan,
        gamma=turbulence.gamma,
        length_scale_prior=(turbulence.length_scale, 0.5),
        instrument_noise_sd=width,
        beams="each",
        progress=False,
    )
    return fit["instrument_noise"].values, fit["instrument_noise_sd"].values


def _from_structure(
    spectra: xr.Dataset, scan: Scan, turbulence: MannTurbulence, n_lag: int, growth: str
) -> tuple[FloatArray, FloatArray]:
    """Return the intercept of the structure function of each beam and record, and its standard deviation."""
    velocity = spectra["radial_velocity"].values
    n_record, n_beam, n_slot = velocity.shape
    interval = float(spectra.attrs["interval"])
    speed, yaw = spectra["wind_speed"].values, np.deg2rad(spectra["yaw"].values)
    scale = np.full(n_record, turbulence.length_scale)
    if "length_scale" in spectra:
        own = np.asarray(spectra["length_scale"].values, dtype=np.float64)
        scale = np.where(np.isfinite(own) & (own > 0.0), own, scale)
    noise, sd = np.full((n_record, n_beam), np.nan), np.full((n_record, n_beam), np.nan)
    index = np.arange(n_slot + n_lag)
    for r in np.flatnonzero((speed > 0.0) & np.isfinite(yaw)).tolist():
        line_of_sight = scan.at_yaw(yaw[r])
        for b in range(n_beam):
            present = np.isfinite(velocity[r, b])
            found = structure_function(velocity[r, b], n_lag)
            if np.any(found.pairs < _LEAST_PAIRS):
                continue
            shape = scaled_autocovariance(
                line_of_sight[b],
                speed[r] * interval * index,
                scale[r : r + 1],
                gamma=turbulence.gamma,
                probe=scan.probe,
                probe_length=float(scan.probe_length[b]),
            )[0]
            model = shape[0] - shape[1 : n_lag + 1]
            rows: FloatArray = model if growth == "theory" else (interval * np.arange(1.0, n_lag + 1.0)) ** (2.0 / 3.0)
            weights = intercept_weights(rows)
            noise[r, b], slope = (float(value) for value in weights @ found.value)
            size = max(slope * float(np.sum(rows) / np.sum(model)), 0.0)
            autocovariance = size * shape
            autocovariance[0] += max(noise[r, b], 0.0)  # of a variance only: the estimate stays as it is
            covariance = structure_covariance(autocovariance, present, n_lag)
            sd[r, b] = np.sqrt(weights[0] @ covariance @ weights[0])
    return noise, sd


def _mean_of(noise: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Return the mean over records and beams, and its standard deviation; beams are not taken as independent."""
    known = np.isfinite(noise).any(axis=1)
    if not known.any():
        return np.nan, np.nan
    each, own = np.nanmean(noise[known], axis=1), np.nanmean(sd[known], axis=1)
    if len(each) == 1:
        return float(each[0]), float(own[0])
    return float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each)))


def _cut_at_zero(noise: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of normal distributions that are cut off at zero."""
    ratio = noise / sd
    hazard = np.exp(scipy.stats.norm.logpdf(ratio) - scipy.stats.norm.logcdf(ratio))
    mean = noise + sd * hazard
    spread = sd * np.sqrt(np.maximum(1.0 - hazard * (hazard + ratio), 0.0))
    return np.asarray(mean), np.asarray(spread)
