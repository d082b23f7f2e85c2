"""The error of a beam's mean: the variance of means over a finite record, and their covariance between beams."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice, check_finite, check_positive
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.records.layout import check_layout
from bayes_rs.theory.pairs import distinct_pairs
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.theory.sampling_times import sample_counts
from bayes_rs.turbulence.interpolation import find_net
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

SCALES = ("record", "turbulence")
"""How large the turbulence is taken to be: as a record's own variances say, or as the turbulence says."""

_CHUNK = 1_500_000  # covariances held at a time: some 100 MiB of working arrays
_BLOCK = 4_000_000  # entries of the covariances of records that are worked on together: 32 MB
_LOG_STEP, _YAW_STEP = 0.5 * np.log(2.0), np.deg2rad(20.0)  # of the net of states; measured in the tests
_LOG_ANCHOR = np.log(10.0)


class MeanMoments(NamedTuple):
    """Covariance of the means and expected variances of the beams of one state, m² s⁻²."""

    covariance: FloatArray
    variance: FloatArray


def beam_mean_covariance(
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path,
    *,
    wind_speed: float,
    duration: float = 600.0,
    yaw_deg: float | None = None,
    tolerance: float = 1e-3,
) -> FloatArray:
    r"""Return the covariance of the beams' means over one record, by theory.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, with its timing and probe volume.
    turbulence : MannTurbulence, str or Path
        The turbulence; the covariance is proportional to its dissipation.
    wind_speed : float
        Mean wind speed U, m/s.
    duration : float
        Length of the record T, s.
    yaw_deg : float, optional
        Wind direction relative to the lidar axis, degrees; the scan's own if not given.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.

    Returns
    -------
    covariance : ndarray, shape (n_beam, n_beam)
        Cov[v̄_a, v̄_b], m² s⁻².

    Raises
    ------
    InputError
        If an argument is not valid, or a beam has fewer than two samples.

    Notes
    -----
    With C_ab(τ) the covariance of the radial velocities of two beams at a lag τ (`radial_covariance`, probe volumes
    included), the mean of N_a samples of one and N_b of the other have

    .. math::
        \mathrm{Cov}[\bar v_a, \bar v_b] = \frac{1}{N_a N_b} \sum_{i=1}^{N_a} \sum_{j=1}^{N_b} C_{ab}(t_{bj} - t_{ai})
        \;\longrightarrow\; \frac{1}{T} \int_{-T}^{T} \Bigl(1 - \frac{|\tau|}{T}\Bigr) C_{ab}(\tau) \, d\tau
        \;\longrightarrow\; \frac{2 T_i}{T} \sigma^2 ,

    the first limit for dense sampling, the second for a record much longer than the integral time scale
    :math:`T_i = \int_0^\infty C(\tau) d\tau / \sigma^2` and a = b (Lenschow, Mann and Kristensen 1994). The sum is what
    is computed. The eddies that the mean takes are those that the variance lacks: E s² = σ² − Var[v̄].

    It is the error about the mean of an infinite record in stationary, frozen turbulence. What weather adds to that on
    time scales beyond the model's is left out, as is the instrument's own noise, which N samples divide by N.

    References
    ----------
    Lenschow, Mann and Kristensen (1994), J. Atmos. Ocean. Technol. 11, 661–673,
    doi:10.1175/1520-0426(1994)011<0661:HLILEW>2.0.CO;2.

    Examples
    --------
    >>> from bayes_rs import load_scan, load_turbulence
    >>> covariance = beam_mean_covariance(load_scan("staring"), load_turbulence("fu-2022"), wind_speed=10.0)
    >>> float(np.sqrt(covariance[0, 0]).round(2))
    0.41
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    yaw = scan.yaw if yaw_deg is None else np.deg2rad(check_finite(yaw_deg, what="yaw_deg", unit="°"))
    return mean_moments(scan, turbulence, wind_speed, float(yaw), duration, tolerance).covariance


def record_mean_covariance(
    records: xr.Dataset,
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    scale: str = "record",
    estimator: FloatArray | None = None,
) -> FloatArray:
    """Return the covariance of the beams' means of each record, or of what is made of them.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`.
    scan : Scan, str or Path
        The scan, with the records' beams only.
    turbulence : MannTurbulence, str or Path
        The turbulence.
    scale : {"record", "turbulence"}
        ``"record"``: the turbulence's dissipation is scaled so that the mean of the expected variances of the used
        beams is that of the record's own. ``"turbulence"``: it is taken as it is.
    estimator : ndarray, shape (n_record, n, n_beam), optional
        Matrix A of each record; the covariance is then that of A times the means.

    Returns
    -------
    covariance : ndarray, shape (n_record, n_beam, n_beam), or (n_record, n, n)
        M, or A M Aᵀ, m² s⁻²; NaN where the wind is not seen.

    Raises
    ------
    InputError
        If the records or an option are not valid.

    Notes
    -----
    `beam_mean_covariance` at the states of a net in ln U and ψ, interpolated to third order at each record's wind speed
    and direction. Relative to the variances, the interpolation is in error by less than 1 %. With an estimator, memory
    does not grow with the square of the beams times the records.
    """
    check_choice(scale, SCALES, what="scale")
    duration = check_positive(records.attrs.get("duration", 600.0), what="duration", unit="s", where="the records")
    speed = np.asarray(records["wind_speed"].values, dtype=np.float64)
    yaw = np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64))
    known = (speed > 0.0) & np.isfinite(yaw)
    size = scan.n_beam if estimator is None else estimator.shape[1]
    covariance = np.full((len(speed), size, size), np.nan)
    if not known.any():
        return covariance
    axes = (_nodes(np.log(speed[known]), _LOG_ANCHOR, _LOG_STEP), _nodes(yaw[known], 0.0, _YAW_STEP))
    states = np.array([(u, psi) for u in axes[0] for psi in axes[1]])
    made = [mean_moments(scan, turbulence, float(np.exp(u)), float(psi), duration, 1e-3) for u, psi in states]
    means, variances = (np.stack(part) for part in zip(*made, strict=True))
    net = find_net(states)
    points = np.column_stack([np.log(speed[known]), yaw[known]])
    weights = np.ones((len(points), 1)) if net is None else net.weights(points)[0]
    rows, block = np.flatnonzero(known), max(1, _BLOCK // scan.n_beam**2)
    for first in range(0, len(rows), block):
        some = rows[first : first + block]
        own = np.einsum("rs,sab->rab", weights[first : first + block], means)
        covariance[some] = own if estimator is None else estimator[some] @ own @ estimator[some].swapaxes(-1, -2)
    if scale == "record":
        expected = np.full((len(speed), scan.n_beam), np.nan)
        expected[known] = np.einsum("rs,sb->rb", weights, variances)
        used = usable_variance(records)
        total = np.where(used, records["variance"].values, 0.0).sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):  # no usable beam: not known
            covariance *= (total / np.where(used, expected, 0.0).sum(axis=1))[:, None, None]
    return covariance


def usable_variance(records: xr.Dataset) -> NDArray[np.bool_]:
    """Return which beams of which records count, shape (n_record, n_beam)."""
    return np.asarray((records["flag"].values == 0) & (records["variance"].values > 0.0))


def check_records(records: xr.Dataset, scan: Scan) -> Scan:
    """Return the scan with only the records' beams, if the records have what a mean wind needs.

    Raises
    ------
    InputError
        If a variable is missing, or a beam is not the scan's.
    """
    check_layout(records, "mean", "variance", "flag")
    return scan.select(records["beam"].values)


def _nodes(values: FloatArray, anchor: float, step: float) -> FloatArray:
    """Return the nodes anchor + step · (whole number) that reach over the values; two at least where they differ."""
    place = (values - anchor) / step
    first, last = int(np.floor(place.min() + 1e-9)), int(np.ceil(place.max() - 1e-9))
    return np.asarray(anchor + step * np.arange(first, max(last, first) + 1), dtype=np.float64)


def mean_moments(
    scan: Scan, turbulence: MannTurbulence, wind_speed: float, yaw: float, duration: float, tolerance: float
) -> MeanMoments:
    """Return the covariance of the means and the expected variances of the beams, at one wind speed and yaw (rad)."""
    count = sample_counts(scan, duration)
    pairs = distinct_pairs(scan, scan.at_yaw(yaw), count, wind_speed)
    mean, at_zero = np.empty(len(pairs.across)), np.empty(len(pairs.across))
    for samples in np.unique(pairs.samples, axis=0):
        members = np.flatnonzero(np.all(pairs.samples == samples, axis=1))
        n_a, n_b = int(samples[0]), int(samples[1])
        offset = np.arange(-(n_a - 1), n_b)
        weight = (np.minimum(n_a, n_b - offset) - np.maximum(0, -offset)) / (n_a * n_b)
        for part in np.array_split(members, int(np.ceil(len(members) * len(offset) / _CHUNK))):
            covariance = probed_covariance(
                pairs.first[part],
                pairs.second[part],
                pairs.across[part],
                pairs.along[part, np.newaxis] - wind_speed * scan.scan_duration * offset,
                turbulence,
                probe=scan.probe,
                lengths=pairs.lengths[part],
                tolerance=tolerance,
            )
            mean[part], at_zero[part] = covariance @ weight, covariance[:, n_a - 1]
    whole = np.empty((scan.n_beam, scan.n_beam))
    whole[pairs.row, pairs.column] = mean[pairs.distinct]
    whole[pairs.column, pairs.row] = mean[pairs.distinct]
    own = pairs.distinct[pairs.row == pairs.column]
    return MeanMoments(whole, at_zero[own] - mean[own])
