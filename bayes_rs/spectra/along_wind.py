"""The spectrum of the along-wind velocity, from those of the beams and what the model says of their ratio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.spectra.lag_window import lag_windows
from bayes_rs.spectra.radial_spectrum import check_spectra


def along_wind_spectra(spectra: xr.Dataset, scan: Scan | str | Path, fit: xr.Dataset) -> xr.Dataset:
    r"""Return the spectrum of u that a point in each record's flow would show, from its beams and the fitted model.

    Parameters
    ----------
    spectra : xarray.Dataset
        From `radial_spectra`.
    scan : Scan, str or Path
        The scan that measured them, with its probe volume.
    fit : xarray.Dataset
        From `fit_spectra` of them, with ``beams="together"``.

    Returns
    -------
    along_wind : xarray.Dataset
        ``spectrum`` (record, frequency), m² s⁻² Hz⁻¹, one-sided, NaN where a record was not fitted; ``modelled``
        (record, frequency), the share of it that the beams do not measure: 1 less the mean over beams of n_x² E_u/E_b.

    Raises
    ------
    InputError
        If the three do not belong together.

    Notes
    -----
    With the fitted instrument noise s taken off, and the expected spectra E of a beam and of u at a point, sampled and
    finite as the beam's record is,

    .. math:: S_u(f_k) = \frac{1}{n} \sum_b (I_{bk} - s\,q_{0k}) \frac{E_{u,k}}{E_{b,k}} .

    The ratio puts back what the probe volume took and takes out v and w as far as the model says; for a beam along the
    wind without a probe volume it is 1. It is a conversion, not a measurement of u: two beams of one height see u and
    v, and only a model, or more beams than most scans have, tells them apart at every frequency.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> spectra = brs.radial_spectra(series, scan, brs.make_records(series, scan))
    >>> fitted = brs.fit_spectra(spectra, scan, instrument_noise_sd=0.0, progress=False)
    >>> along = along_wind_spectra(spectra, scan, fitted)
    >>> bool(np.allclose(along["spectrum"], spectra["spectrum"][:, 0]))
    True
    """
    scan = as_scan(scan)
    check_spectra(spectra)
    used = scan.select(spectra["beam"].values)
    if "length_scale" not in fit or fit["length_scale"].dims != ("record",):
        raise InputError("The fit has no length scale of each record: make it with fit_spectra(beams='together').")
    if not np.array_equal(fit["time"].values, spectra["time"].values):
        raise InputError("The fit is not of these spectra: it is of other records; fit these spectra.")
    interval, tapers = float(spectra.attrs["interval"]), int(spectra.attrs["tapers"])
    values, present = spectra["spectrum"].values, np.isfinite(spectra["radial_velocity"].values)
    n_record, _, n_slot = present.shape
    out, unmeasured = np.full((n_record, values.shape[-1]), np.nan), np.full((n_record, values.shape[-1]), np.nan)
    whole = lag_windows(np.ones(n_slot, dtype=np.bool_), interval, tapers)
    for r in np.flatnonzero(np.isfinite(fit["length_scale"].values)).tolist():
        scale, gamma = fit["length_scale"].values[r : r + 1], float(fit["gamma"].values[r])
        distance = float(spectra["wind_speed"].values[r]) * interval * np.arange(n_slot)
        line_of_sight = used.at_yaw(np.deg2rad(float(spectra["yaw"].values[r])))
        noise = float(fit["instrument_noise"].values[r])
        along = scaled_autocovariance(
            np.array([1.0, 0.0, 0.0]), distance, scale, gamma=gamma, probe=used.probe, probe_length=0.0
        )[0]
        parts, shares = [], []
        for b in np.flatnonzero(np.isfinite(values[r, :, 0])).tolist():
            windows = whole if present[r, b].all() else lag_windows(present[r, b], interval, tapers)
            beam = scaled_autocovariance(
                line_of_sight[b],
                distance,
                scale,
                gamma=gamma,
                probe=used.probe,
                probe_length=float(used.probe_length[b]),
            )[0]
            ratio = (windows @ along) / (windows @ beam)
            parts.append((values[r, b] - noise * windows[:, 0]) * ratio)
            shares.append(line_of_sight[b, 0] ** 2 * ratio)
        if parts:
            out[r], unmeasured[r] = np.mean(parts, axis=0), 1.0 - np.mean(shares, axis=0)
    both = ("record", "frequency")
    return xr.Dataset(
        {
            "spectrum": (
                both,
                out,
                {"units": "m2 s-2 Hz-1", "long_name": "one-sided spectrum of u, by the fitted model"},
            ),
            "modelled": (both, unmeasured, {"units": "1"}),
        },
        coords={"time": ("record", spectra["time"].values), "frequency": spectra["frequency"]},
        attrs={**spectra.attrs},
    )
