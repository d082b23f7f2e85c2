"""The mean-wind profile over a scan's beams: shear and veer by generalised least squares."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice, check_non_negative, check_positive, check_switch
from bayes_rs.errors import InputError
from bayes_rs.geometry.attitude import record_direction
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.records.belief import believed
from bayes_rs.records.least_squares import RANK_TOLERANCE, horizontal_wind
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence
from bayes_rs.wind.mean_error import check_records, record_mean_covariance

VON_KARMAN = 0.4
"""κ of the logarithmic profile."""

_CHUNK = 2_000_000  # entries of covariances that are factored together
_MOST_STEPS = 50
_CONVERGED = 1e-9  # of the wind speed (of 1 for the shape's number): the last step


class _Law(NamedTuple):
    """One shape U(z)/U(z_ref) with one number, and what the number is called."""

    name: str
    unit: str
    shape: Callable[[FloatArray, FloatArray, float], FloatArray]
    slope: Callable[[FloatArray, FloatArray, float], FloatArray]


LAWS: dict[str, _Law] = {
    "power": _Law(
        "shear_exponent",
        "1",
        lambda number, z, ref: np.exp(number * np.log(z / ref)),
        lambda number, z, ref: np.log(z / ref) * np.exp(number * np.log(z / ref)),
    ),
    "log": _Law(
        "log_slope",
        "1",
        lambda number, z, ref: 1.0 + number * np.log(z / ref),
        lambda _, z, ref: np.log(z / ref),
    ),
    "linear": _Law("relative_shear", "m-1", lambda number, z, ref: 1.0 + number * (z - ref), lambda _, z, ref: z - ref),
}
"""The laws of the profile by name: shape and its derivative, functions of (number, height, reference height)."""


def wind_profile(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    turbulence: MannTurbulence | str | Path,
    hub_height: float,
    law: str = "power",
    veer: bool = False,
    reference_height: float | None = None,
    scale: str = "record",
    beam_sd: float = 0.01,
) -> xr.Dataset:
    r"""Fit a profile of the mean wind to the means of each record's beams.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`; with `with_motion`, each record's own tilt and roll count.
    scan : Scan, str or Path
        The scan that measured them.
    turbulence : MannTurbulence, str or Path
        The turbulence that makes the means uncertain; see `beam_mean_covariance`.
    hub_height : float
        Height of the lidar above the ground, m.
    law : {"power", "log", "linear"}
        The profile: U(z) = U_ref (z/z_ref)^α, U(z) = (u*/κ) ln(z/z₀), or U(z) = U_ref + (z − z_ref) dU/dz.
    veer : bool
        Fit a wind direction that turns with height at a constant rate, too.
    reference_height : float, optional
        z_ref, m above the ground; the hub height if not given.
    scale : {"record", "turbulence"}
        Whether the size of the turbulence is that of each record's own variances, or that of `turbulence`.
    beam_sd : float
        Standard deviation of an error of its own in each beam's mean, m/s: how far instrument and law are trusted. It
        keeps combinations of beams that see the same eddies from counting as known without error.

    Returns
    -------
    profile : xarray.Dataset
        Per record: ``wind_speed`` at the reference height (m/s) and ``yaw`` there (degree); ``shear_exponent`` for the
        power law; ``friction_velocity`` (m/s), ``roughness_length`` (m), ``log_roughness_length`` and ``log_slope``
        u*/(κ U_ref) for the logarithmic one; ``shear`` dU/dz (1/s) and ``relative_shear`` (1/m) for the linear one;
        ``veer`` (degree per m) if asked for; each with its standard deviation under the name with ``_sd``.
        ``chi_square``, ``degrees_of_freedom`` and ``p_value`` of the fit. Per record and beam: ``height`` above the
        ground (m), and ``beam_wind_speed`` and ``beam_wind_speed_sd`` (m/s), the wind speed that each beam alone gives
        for the fitted direction, to draw beside the profile. Records whose beams do not determine every number are NaN.

    Raises
    ------
    InputError
        If records and scan do not belong together, an option is not valid, or a beam measures below the ground.

    Notes
    -----
    The mean of beam b, at the height z_b = hub height + f_b n_{b3}, is

    .. math::
        \bar v_b = U(z_b) \, [n_{b1} \cos ψ(z_b) - n_{b2} \sin ψ(z_b)] + ε_b, \qquad
        ψ(z) = ψ_\mathrm{ref} + (z - z_\mathrm{ref}) \, dψ/dz ,

    in the levelled lidar frame, with ε of covariance M + beam_sd² I, M that of the beams' means
    (`beam_mean_covariance`). Minimised is χ² = ε · (M + beam_sd² I)⁻¹ ε, by Gauss and Newton's method; the errors are
    normal, with the covariance (Jᵀ (M + beam_sd² I)⁻¹ J)⁻¹ at the minimum. With the right law, χ² has the χ²
    distribution of n_beam less the number of parameters, and ``p_value`` is its upper tail.

    The standard deviations of roughness length and friction velocity are first order; that of ln z₀ is the one to use.
    A scan that covers a small part of the profile does not tell the laws apart.

    References
    ----------
    Borraccino, Schlipf, Haizmann and Wagner (2017), Wind Energ. Sci. 2, 269–283, doi:10.5194/wes-2-269-2017: fits of a
    wind model to the means of nacelle lidars' beams.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("6-beam"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=1, seed=1, shear=0.02)
    >>> profile = wind_profile(brs.make_records(series, scan), scan, turbulence=flow, hub_height=90.0, law="linear")
    >>> profile["shear"].values.round(3), profile["shear_sd"].values.round(3)
    (array([0.021]), array([0.003]))
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    chosen = LAWS[check_choice(law, tuple(LAWS), what="law of the profile")]
    check_switch(veer, what="veer")
    hub = check_positive(hub_height, what="hub_height", unit="m")
    reference = hub if reference_height is None else check_positive(reference_height, what="reference_height", unit="m")
    own = check_non_negative(beam_sd, what="beam_sd", unit="m/s")
    scan = check_records(records, scan)
    records = believed(records)
    mean = np.asarray(records["mean"].values, dtype=np.float64)
    direction = np.broadcast_to(record_direction(records, scan), (*mean.shape, 3))
    height = hub + scan.focus_distance * direction[..., 2]
    _check_heights(height, scan)
    covariance = record_mean_covariance(records, scan, turbulence, scale=scale)
    known = np.isfinite(covariance[:, 0, 0])  # all of a record's, or none
    valid = (records["flag"].values == 0) & np.isfinite(mean) & known[:, None]
    start = horizontal_wind(mean, valid, direction, scan.yaw)
    fit = _Fit(chosen, reference, veer)
    n_record, n_parameter = len(mean), 3 + veer
    result = _Found(
        np.full((n_record, n_parameter), np.nan),
        np.full((n_record, n_parameter, n_parameter), np.nan),
        np.full(n_record, np.nan),
        valid.sum(axis=1) - n_parameter,
    )
    rows = np.flatnonzero(start.yaw_seen & np.asarray(result.dof >= 0) & (start.speed > 0.0))
    for part in np.array_split(rows, int(np.ceil(len(rows) * scan.n_beam**2 / _CHUNK))) if len(rows) else ():
        first = np.zeros((len(part), n_parameter))
        first[:, 0] = (start.speed * np.cos(start.yaw))[part]
        first[:, 1] = -(start.speed * np.sin(start.yaw))[part]
        found = fit.solve(
            first,
            mean[part],
            valid[part],
            direction[part],
            height[part],
            covariance[part] + own**2 * np.eye(scan.n_beam),
        )
        for whole, values in zip(result[:3], found, strict=True):
            whole[part] = values
    beam_speed, beam_speed_sd = _of_each_beam(result.parameter, fit, mean, valid, direction, height, covariance)
    both = ("record", "beam")
    return xr.Dataset(
        {
            **_in_words(result, chosen, reference, veer),
            "chi_square": ("record", result.chi_square),
            "degrees_of_freedom": ("record", result.dof),
            "p_value": ("record", scipy.stats.chi2.sf(result.chi_square, np.where(result.dof > 0, result.dof, np.nan))),
            "height": (both, height, {"units": "m", "long_name": "height of the measured point above the ground"}),
            "beam_wind_speed": (both, beam_speed, {"units": "m s-1"}),
            "beam_wind_speed_sd": (both, beam_speed_sd, {"units": "m s-1"}),
        },
        coords=records.coords,
        attrs={
            "law": law,
            "hub_height": hub,
            "reference_height": reference,
            "beam_sd": own,
            "turbulence": turbulence.name,
            "scan": scan.name,
        },
    )


class _Found(NamedTuple):
    """Parameters U_L and V_L at the reference height, the shape's number, and the veer, rad/m; and their errors."""

    parameter: FloatArray
    covariance: FloatArray
    chi_square: FloatArray
    dof: NDArray[np.int64]


class _Fit(NamedTuple):
    """The model of the means."""

    law: _Law
    reference: float
    veer: bool

    def model(self, parameter: FloatArray, direction: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the expected means (record, beam) and their derivatives (record, beam, parameter)."""
        u, v, number = (parameter[:, index, None] for index in range(3))
        above = height - self.reference
        turn = parameter[:, 3, None] * above if self.veer else np.zeros_like(above)
        n_1, n_2 = direction[..., 0], direction[..., 1]
        of_u, of_v = n_1 * np.cos(turn) - n_2 * np.sin(turn), n_1 * np.sin(turn) + n_2 * np.cos(turn)
        shape, slope = self.law.shape(number, height, self.reference), self.law.slope(number, height, self.reference)
        projected = of_u * u + of_v * v
        columns = [shape * of_u, shape * of_v, slope * projected]
        if self.veer:
            columns.append(shape * above * (of_u * v - of_v * u))
        return shape * projected, np.stack(columns, axis=-1)

    def solve(
        self,
        first: FloatArray,
        mean: FloatArray,
        valid: NDArray[np.bool_],
        direction: FloatArray,
        height: FloatArray,
        covariance: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return parameters, their covariance and χ² of each record; NaN where the beams do not determine them."""
        pairs = valid[:, :, None] & valid[:, None, :]
        root = np.linalg.cholesky(np.where(pairs, covariance, np.eye(valid.shape[1])))
        parameter = first.copy()
        speed = np.hypot(first[:, 0], first[:, 1])
        size = np.ones_like(first)
        size[:, :2] = speed[:, None]
        extent = np.ptp(height, axis=1)
        per_length = 1.0 / np.where(extent > 0.0, extent, 1.0)
        size[:, 2] = 1.0 if self.law.unit == "1" else per_length
        size[:, 3:] = per_length[:, None]
        done = np.zeros(len(first), dtype=bool)
        for _ in range(_MOST_STEPS):
            expected, slope = self.model(parameter, direction, height)
            residual = np.linalg.solve(root, np.where(valid, mean - expected, 0.0)[..., None])[..., 0]
            slope = np.linalg.solve(root, np.where(valid[:, :, None], slope, 0.0)) * size[:, None, :]
            if done.all():
                break
            step = np.einsum("rpb,rb->rp", np.linalg.pinv(slope), residual)
            parameter = np.where(done[:, None], parameter, parameter + size * step)
            done |= ~(np.abs(step).max(axis=1) > _CONVERGED)  # NaN: given up
        left = np.linalg.svd(slope, compute_uv=False)
        sure = done & (left[:, -1] > RANK_TOLERANCE * left[:, 0]) & np.isfinite(parameter).all(axis=1)
        spread = np.full((len(first), first.shape[1], first.shape[1]), np.nan)
        inverse = np.linalg.inv(slope[sure].swapaxes(-1, -2) @ slope[sure])
        spread[sure] = size[sure, :, None] * inverse * size[sure, None, :]
        chi_square = np.einsum("rb,rb->r", residual, residual)
        return np.where(sure[:, None], parameter, np.nan), spread, np.where(sure, chi_square, np.nan)


def _in_words(
    found: _Found, law: _Law, reference: float, veer: bool
) -> dict[str, tuple[str, FloatArray, dict[str, str]]]:
    """Return what the parameters mean, with first-order standard deviations."""
    u, v, number = found.parameter[:, :3].T
    speed = np.hypot(u, v)
    zero, one = np.zeros_like(u), np.ones_like(u)
    more = [zero] * veer
    along = np.stack([u / speed, v / speed, zero, *more], axis=-1)
    across = np.stack([v / speed**2, -u / speed**2, zero, *more], axis=-1)
    shape = np.stack([zero, zero, one, *more], axis=-1)
    quantities = {
        "wind_speed": (speed, along, "m s-1", 1.0),
        "yaw": (np.arctan2(-v, u), across, "degree", np.rad2deg(1.0)),
        law.name: (number, shape, law.unit, 1.0),
    }
    if law.name == "log_slope":
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            rising = np.where(number > 0.0, number, np.nan)  # a wind that falls with height has no roughness length
            log_length = np.log(reference) - 1.0 / rising
            by_shape = shape / (rising**2)[:, None]
            star = VON_KARMAN * speed * rising
            quantities["friction_velocity"] = (
                star,
                VON_KARMAN * (rising[:, None] * along + speed[:, None] * shape),
                "m s-1",
                1.0,
            )
            quantities["log_roughness_length"] = (log_length, by_shape, "1", 1.0)
            quantities["roughness_length"] = (np.exp(log_length), np.exp(log_length)[:, None] * by_shape, "m", 1.0)
    if law.name == "relative_shear":
        gradient = number[:, None] * along + speed[:, None] * shape
        quantities["shear"] = (speed * number, gradient, "s-1", 1.0)
    if veer:
        of_veer = np.stack([zero, zero, zero, one], axis=-1)
        quantities["veer"] = (found.parameter[:, 3], of_veer, "degree m-1", np.rad2deg(1.0))
    variables = {}
    for name, (value, gradient, unit, factor) in quantities.items():
        variables[name] = ("record", factor * value, {"units": unit})
        sd = factor * np.sqrt(np.einsum("rp,rpq,rq->r", gradient, found.covariance, gradient))
        variables[f"{name}_sd"] = ("record", sd, {"units": unit})
    return variables


def _of_each_beam(
    parameter: FloatArray,
    fit: _Fit,
    mean: FloatArray,
    valid: NDArray[np.bool_],
    direction: FloatArray,
    height: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the wind speed that each beam alone gives for the fitted direction, and its standard deviation, m/s."""
    yaw = np.arctan2(-parameter[:, 1], parameter[:, 0])[:, None]
    if fit.veer:
        yaw = yaw + parameter[:, 3, None] * (height - fit.reference)
    along = direction[..., 0] * np.cos(yaw) - direction[..., 1] * np.sin(yaw)
    seen = valid & (np.abs(along) > RANK_TOLERANCE)
    along = np.where(seen, along, np.nan)
    return mean / along, np.sqrt(np.einsum("rbb->rb", covariance)) / np.abs(along)


def _check_heights(height: FloatArray, scan: Scan) -> None:
    low = np.argwhere(~(height > 0.0))
    if len(low):
        record, beam = (int(index) for index in low[0])
        raise InputError(
            f"Invalid height {height[record, beam]:g} m of beam {scan.beam[beam]} of scan {scan.name!r} in record "
            f"{record}: it must be above the ground; check hub_height and the tilt."
        )
