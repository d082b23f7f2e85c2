"""The mean wind of each record, with its uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, as_numbers, check_array, check_switch
from bayes_rs.errors import InputError
from bayes_rs.geometry.attitude import record_direction
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.records.belief import believed
from bayes_rs.records.flags import RECORD_FLAGS
from bayes_rs.records.given import warn_of_other_scan
from bayes_rs.records.least_squares import horizontal_wind, solve_wind
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence
from bayes_rs.wind.mean_error import check_records, record_mean_covariance

AXES = ("x", "y", "z")
"""Axes of the levelled lidar frame: opposite to the view, to the right of one who looks out, up."""


def mean_wind(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    turbulence: MannTurbulence | str | Path | None = None,
    scale: str = "record",
    vertical: bool = False,
    weights: ArrayLike | None = None,
    heading_deg: ArrayLike | None = None,
) -> xr.Dataset:
    r"""Solve for the mean wind of each record, and say how uncertain it is.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`; with `with_motion`, each record's own tilt and roll count.
    scan : Scan, str or Path
        The scan that measured them.
    turbulence : MannTurbulence, str or Path, optional
        The turbulence that makes the means uncertain; without it no standard deviations are given.
    scale : {"record", "turbulence"}
        Whether the size of the turbulence is that of each record's own variances, or that of `turbulence`.
    vertical : bool
        Solve for a mean vertical component, too, as for ground-based scans with steep beams; nacelle lidars do not see
        it apart from the wind along their axis.
    weights : array_like, shape (n_beam,), optional
        Weights of the squares, for the records' beams; all equal if not given.
    heading_deg : float or array_like, shape (n_record,), optional
        Where the lidar looks, degrees clockwise from north; by default the records' ``heading`` if they have one.

    Returns
    -------
    records : xarray.Dataset
        The records with ``wind_speed`` (m/s), ``yaw`` (degree) and ``record_flag`` anew, and ``velocity`` (record,
        axis), the mean wind along x, y and z of the levelled lidar frame, m/s; with a turbulence also
        ``wind_speed_sd`` (m/s), ``yaw_sd`` (degree) and ``velocity_covariance`` (record, axis, other_axis), m² s⁻²;
        with a heading also ``wind_direction``, where the wind comes from, degrees clockwise from north. Components
        and errors that the beams do not see are NaN.

    Raises
    ------
    InputError
        If records and scan do not belong together, or an option is not valid.

    Notes
    -----
    The mean wind (U_L, V_L) of a record is the least-squares solution of :math:`\bar v_b = n_{b1} U_L + n_{b2} V_L`
    (with ``vertical``, :math:`+ n_{b3} W_L`), U = √(U_L² + V_L²), ψ = atan2(−V_L, U_L), and the wind comes from
    heading + ψ. With A the matrix of that solution and M the covariance of the beams' means (`beam_mean_covariance`),

    .. math::
        C = A M A^T, \qquad \mathrm{sd}[U] = \sqrt{e \cdot C e}, \qquad
        \mathrm{sd}[\psi] = \sqrt{e_\perp \cdot C e_\perp} / U ,

    with e the horizontal unit vector along the mean wind and e⊥ that across it: first order in the errors, so U must be
    several times its standard deviation. Beams at ±φ to the side see a difference of the u of their two places as a
    crosswind, times ½ cot φ: at small opening angles this is most of the error of ψ.

    The wind is taken to be the same at all beams: shear and veer are left out (`wind_profile`). Beams that see one
    horizontal direction only leave ψ to the scan's own yaw; then U is the projection on it and sd[ψ] is NaN.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("6-beam"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> wind = mean_wind(brs.make_records(series, scan), scan, turbulence=flow, heading_deg=350.0)
    >>> wind["wind_speed"].values.round(1), wind["wind_direction"].values.round(0)
    (array([10.3, 10.2]), array([352., 348.]))
    >>> wind["wind_speed_sd"].values.round(1), wind["yaw_sd"].values.round(1)
    (array([0.4, 0.4]), array([2.4, 2.2]))
    """
    scan = as_scan(scan)
    warn_of_other_scan(records, scan)
    turbulence = None if turbulence is None else as_turbulence(turbulence)
    scan = check_records(records, scan)
    records = believed(records)
    check_switch(vertical, what="vertical")
    weight = None if weights is None else _checked_weights(weights, scan.n_beam)
    direction = record_direction(records, scan)
    mean = np.asarray(records["mean"].values, dtype=np.float64)
    valid = (records["flag"].values == 0) & np.isfinite(mean)
    usable = valid.any(axis=1)
    velocity = np.full((len(mean), 3), np.nan)
    estimator = np.zeros((len(mean), 3, scan.n_beam))
    if vertical:
        solution = solve_wind(mean, valid, direction, weights=weight, vertical=True)
        velocity, estimator, seen = solution.velocity, solution.estimator, solution.seen
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        yaw, wind_seen = np.arctan2(-velocity[:, 1], velocity[:, 0]), seen
    else:
        speed, yaw, seen, wind_seen, estimator[:, :2] = horizontal_wind(
            mean, valid, direction, scan.yaw, weights=weight
        )
        velocity[seen, 0], velocity[seen, 1] = (speed * np.cos(yaw))[seen], -(speed * np.sin(yaw))[seen]
    flag = (
        RECORD_FLAGS["beam_flagged"] * ~valid.all(axis=1)
        + RECORD_FLAGS["no_usable_beam"] * ~usable
        + RECORD_FLAGS["yaw_not_seen"] * (usable & ~seen)
        + RECORD_FLAGS["wind_not_seen"] * ~wind_seen
    ).astype(np.int64)
    known = sum(RECORD_FLAGS[name] for name in ("yaw_not_seen", "wind_not_seen", "beam_flagged", "no_usable_beam"))
    before = records.get("record_flag", xr.DataArray(np.zeros(len(mean), dtype=np.uint8), dims="record"))
    flag = (flag | (before.values.astype(np.int64) & ~known)).astype(before.dtype)
    found = (
        records.drop_vars(["wind_speed_sd", "yaw_sd", "velocity_covariance", "wind_direction"], errors="ignore")
        .assign(
            wind_speed=(
                "record",
                speed,
                {"units": "m s-1", "long_name": "mean horizontal wind speed from the beam means"},
            ),
            yaw=(
                "record",
                np.degrees(yaw),
                {"units": "degree", "long_name": "wind direction relative to the lidar axis"},
            ),
            record_flag=("record", flag, before.attrs),
            velocity=(("record", "axis"), velocity, {"units": "m s-1", "long_name": "mean wind, levelled lidar frame"}),
        )
        .assign_coords(axis=list(AXES))
    )
    if turbulence is not None:
        found = _with_errors(found, scan, turbulence, scale, estimator, seen, wind_seen, vertical)
    return _with_direction(found, heading_deg)


def _with_errors(
    records: xr.Dataset,
    scan: Scan,
    turbulence: MannTurbulence,
    scale: str,
    estimator: FloatArray,
    seen: NDArray[np.bool_],
    wind_seen: NDArray[np.bool_],
    vertical: bool,
) -> xr.Dataset:
    covariance = record_mean_covariance(records, scan, turbulence, scale=scale, estimator=estimator)
    yaw, speed = np.deg2rad(records["yaw"].values), records["wind_speed"].values
    along = np.stack([np.cos(yaw), -np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    across = np.stack([np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)], axis=-1)
    along = np.where(seen[:, None], along, [1.0, 0.0, 0.0])  # a projection stands in the first row, see HorizontalWind
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):  # a wind that is not seen, or zero: not known
        speed_sd = np.sqrt(np.einsum("ri,rij,rj->r", along, covariance, along))
        yaw_sd = np.degrees(np.sqrt(np.einsum("ri,rij,rj->r", across, covariance, across)) / speed)
    if not vertical:
        covariance[:, 2, :] = covariance[:, :, 2] = np.nan
    return records.assign(
        wind_speed_sd=("record", np.where(wind_seen, speed_sd, np.nan), {"units": "m s-1"}),
        yaw_sd=("record", np.where(seen, yaw_sd, np.nan), {"units": "degree"}),
        velocity_covariance=(
            ("record", "axis", "other_axis"),
            np.where(seen[:, None, None], covariance, np.nan),
            {"units": "m2 s-2", "long_name": "covariance of the errors of the mean wind"},
        ),
    ).assign_coords(other_axis=list(AXES))


def _with_direction(records: xr.Dataset, heading_deg: ArrayLike | None) -> xr.Dataset:
    if heading_deg is None and "heading" not in records:
        return records
    given = records["heading"].values if heading_deg is None else heading_deg
    heading = as_numbers(given, what="heading_deg")
    if heading.shape not in ((), (records.sizes["record"],)):
        raise InputError(
            f"Invalid heading_deg of shape {heading.shape}: it must be one number, or one for each of the "
            f"{records.sizes['record']} records."
        )
    if heading_deg is not None and not np.all(np.isfinite(heading)):
        raise InputError("Invalid heading_deg: every heading must be a finite angle, degrees clockwise from north.")
    about = {"units": "degree", "long_name": "where the wind comes from, clockwise from north"}
    return records.assign(wind_direction=("record", np.remainder(heading + records["yaw"].values, 360.0), about))


def _checked_weights(weights: ArrayLike, n_beam: int) -> FloatArray:
    array = check_array(weights, (n_beam,), what="weights")
    for index in np.flatnonzero(array < 0.0).tolist():
        raise InputError(f"Invalid weight {array[index]:g} of beam {index}: it must be zero or above.")
    return array
