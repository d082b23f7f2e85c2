"""Power spectra of radial velocities: of each record and beam, and averages with confidence bands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy
import xarray as xr

from bayes_rs._validation import FloatArray, check_count, check_prob
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.records.given import warn_of_other_scan
from bayes_rs.spectra.beam_samples import beam_samples
from bayes_rs.spectra.lag_window import ordinate_correlation, ordinates, taper_weights

_MOST_TAPERS = 20


def radial_spectra(series: xr.Dataset, scan: Scan | str | Path, records: xr.Dataset, *, tapers: int = 0) -> xr.Dataset:
    r"""Return the power spectral density of the radial velocity of every record and beam.

    Parameters
    ----------
    series : xarray.Dataset
        Radial velocities, as `read` and `simulate` return them.
    scan : Scan
        Their scan.
    records : xarray.Dataset
        From `make_records` of this series, or some of them: their periods, flags, filters, wind speeds and directions.
    tapers : int
        Number of sine tapers K that are averaged; 0 for the plain periodogram. Tapers lower the leakage from low to
        high frequencies and K of them the scatter, and blur K + 1 frequencies.

    Returns
    -------
    spectra : xarray.Dataset
        ``spectrum`` (record, beam, frequency), m² s⁻² Hz⁻¹, one-sided, NaN for flagged beams; ``radial_velocity``
        (record, beam, slot), m/s, the samples, NaN where there is none; ``count``, ``variance`` (m² s⁻²) and
        ``timing_spread`` (of the sampling interval) (record, beam); ``wind_speed`` and ``yaw`` (record). Coordinates
        ``frequency``, Hz; ``time``; ``beam``. Attributes ``interval`` (s), ``tapers`` and ``duration`` (s).

    Raises
    ------
    InputError
        If series and records do not belong together, or a beam is not sampled evenly.

    Notes
    -----
    With weights h whose squares sum to one over the samples that there are, at f_k = k/(NΔ), k = 1 … N/2,

    .. math:: S_k = \frac{2 Δ}{K} \sum_{i=1}^{K} \Big| \sum_j h_{ij} (v_j - \bar v) e^{-2πi k j/N} \Big|^2,

    half of it at the Nyquist frequency. Samples that are missing are left out of the sums: nothing is filled or
    interpolated. For a record without gaps and without tapers the sum of S over the frequencies, over NΔ, is the
    record's variance (Parseval). What a gap, the finite record, the removed mean and aliasing do to the expectation of
    S is known exactly, `bayes_rs.spectra.lag_window.lag_windows`, and `fit_spectra` uses that.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> records = brs.make_records(series, scan)
    >>> spectra = radial_spectra(series, scan, records)
    >>> total = spectra["spectrum"].sum("frequency") / 600.0
    >>> bool(np.allclose(total, records["variance"]))
    True
    """
    scan = as_scan(scan)
    warn_of_other_scan(series, scan)
    check_count(tapers, what="tapers", minimum=0)
    if tapers > _MOST_TAPERS:
        raise InputError(f"Invalid tapers {tapers}: at most {_MOST_TAPERS} are of use; 0 is the plain periodogram.")
    velocity, interval, spread = beam_samples(series, scan, records)
    n_record, n_beam, n_slot = velocity.shape
    number, sides = ordinates(n_slot)
    there = np.isfinite(velocity)
    count = np.count_nonzero(there, axis=-1)
    some = np.where(count > 0, count, np.nan)
    residual = np.where(there, velocity - (np.nansum(velocity, axis=-1) / some)[..., np.newaxis], 0.0)
    spectrum = np.full((n_record, n_beam, len(number)), np.nan)
    for index in np.argwhere(count > 0):
        r, b = (int(i) for i in index)
        weights = taper_weights(there[r, b], tapers)
        waves = np.fft.rfft(weights * residual[r, b], axis=-1)[:, 1:]
        spectrum[r, b] = interval * sides * np.mean(np.abs(waves) ** 2, axis=0)
    both = ("record", "beam")
    return xr.Dataset(
        {
            "spectrum": (
                (*both, "frequency"),
                spectrum,
                {"units": "m2 s-2 Hz-1", "long_name": "one-sided power spectral density of the radial velocity"},
            ),
            "radial_velocity": ((*both, "slot"), velocity, {"units": "m s-1"}),
            "count": (both, count, {"long_name": "number of samples"}),
            "variance": (both, np.sum(residual**2, axis=-1) / some, {"units": "m2 s-2"}),
            "timing_spread": (both, spread, {"long_name": "distance of samples from even times, of the interval"}),
            "wind_speed": ("record", np.asarray(records["wind_speed"].values, dtype=np.float64), {"units": "m s-1"}),
            "yaw": ("record", np.asarray(records["yaw"].values, dtype=np.float64), {"units": "degree"}),
        },
        coords={
            "frequency": ("frequency", number / (n_slot * interval), {"units": "Hz"}),
            "time": ("record", records["time"].values),
            "beam": ("beam", np.asarray(records["beam"].values)),
        },
        attrs={
            "scan": scan.name,
            "scan_key": scan.key,
            "interval": interval,
            "tapers": tapers,
            "duration": float(records.attrs["duration"]),
        },
    )


def average_spectra(
    spectra: xr.Dataset, *, bins_per_decade: int = 10, prob: float = 0.9, records: slice | None = None
) -> xr.Dataset:
    """Average spectra over records and in bins of equal width in the logarithm of frequency.

    Parameters
    ----------
    spectra : xarray.Dataset
        From `radial_spectra`.
    bins_per_decade : int
        Bins of a factor of ten in frequency; a bin with no frequency is left out.
    prob : float
        Probability of the confidence band.
    records : slice, optional
        Which records; all if not given.

    Returns
    -------
    averages : xarray.Dataset
        ``spectrum``, ``low`` and ``high`` (beam, bin), m² s⁻² Hz⁻¹; ``dof`` (beam, bin), effective degrees of freedom;
        ``frequency`` (bin), Hz, the mean of the bin's frequencies; ``n_record`` (beam).

    Raises
    ------
    InputError
        If `spectra` are not from `radial_spectra`, or an option is not valid.

    Notes
    -----
    An average S of estimates with ν degrees of freedom lies about the expectation as χ²_ν/ν, so that the band is
    S ν/χ²_ν at the two tails. ν = 2 (Σ1)²/Σ Σ c, with c the covariance of estimates that tapers correlate
    (`ordinate_correlation`), times the share of the samples that there are, and times (Σσ²)²/Σσ⁴ for records of
    unequal variances σ². The band holds the mean spectrum of these records' flow, if they are of one flow; leakage and
    the mean are not corrected here.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> averages = average_spectra(radial_spectra(series, scan, brs.make_records(series, scan)))
    >>> averages.sizes["bin"], bool((averages["low"] < averages["spectrum"]).all())
    (22, True)
    """
    check_spectra(spectra)
    check_count(bins_per_decade, what="bins_per_decade")
    check_prob(prob)
    some = spectra if records is None else spectra.isel(record=records)
    frequency = some["frequency"].values
    place = np.floor(np.log10(frequency / frequency[0]) * bins_per_decade + 1e-9).astype(np.int64)
    _, bin_of, size = np.unique(place, return_inverse=True, return_counts=True)
    n_bin = len(size)
    n_slot, tapers = some.sizes["slot"], int(some.attrs["tapers"])
    correlation = ordinate_correlation(n_slot, tapers)
    _, sides = ordinates(n_slot)
    dof = np.empty(n_bin)
    for index in range(n_bin):
        members = np.flatnonzero(bin_of == index)
        scale = np.sqrt(2.0 / sides[members])  # the Nyquist frequency has twice the relative variance
        apart = np.abs(members[:, np.newaxis] - members)
        dof[index] = 2.0 * len(members) ** 2 / np.sum(scale[:, np.newaxis] * scale * correlation[apart])
    values = some["spectrum"].values
    variance = some["variance"].values
    full = np.where(np.isfinite(values[..., 0]), some["count"].values / n_slot, 0.0)
    known = full > 0.0
    weight = np.where(known, variance, 0.0)
    squares = np.sum(weight**2, axis=0)
    effective = np.divide(
        np.sum(weight, axis=0) ** 2, squares, out=np.zeros(squares.shape), where=squares > 0.0
    ) * np.divide(full.sum(axis=0), known.sum(axis=0), out=np.zeros(squares.shape), where=known.any(axis=0))
    with np.errstate(invalid="ignore"):
        mean = np.nansum(values, axis=0) / np.where(known.any(axis=0), known.sum(axis=0), np.nan)[:, np.newaxis]
    binned: FloatArray = np.stack([mean[:, bin_of == index].mean(axis=-1) for index in range(n_bin)], axis=-1)
    freedom = effective[:, np.newaxis] * dof
    positive = np.where(freedom > 0.0, freedom, np.nan)
    tail = 0.5 * (1.0 - prob)
    both = ("beam", "bin")
    return xr.Dataset(
        {
            "spectrum": (both, binned, {"units": "m2 s-2 Hz-1"}),
            "low": (both, binned * positive / scipy.stats.chi2.ppf(1.0 - tail, positive), {"units": "m2 s-2 Hz-1"}),
            "high": (both, binned * positive / scipy.stats.chi2.ppf(tail, positive), {"units": "m2 s-2 Hz-1"}),
            "dof": (both, freedom),
            "n_record": ("beam", known.sum(axis=0)),
        },
        coords={
            "frequency": ("bin", np.bincount(bin_of, weights=frequency) / size, {"units": "Hz"}),
            "beam": ("beam", some["beam"].values),
        },
        attrs={**spectra.attrs, "prob": check_prob(prob)},
    )


def check_spectra(spectra: xr.Dataset) -> None:
    """Check that a Dataset is one of `radial_spectra`.

    Raises
    ------
    InputError
        If it is not.
    """
    for name, dims in (
        ("spectrum", ("record", "beam", "frequency")),
        ("radial_velocity", ("record", "beam", "slot")),
        ("wind_speed", ("record",)),
        ("yaw", ("record",)),
    ):
        if name not in spectra or spectra[name].dims != dims:
            raise InputError(f"The spectra have no {name} with dims {dims}: make them with bayes_rs.radial_spectra.")
    if spectra.sizes["record"] == 0:
        raise InputError("There is no record in the spectra: give at least one.")
