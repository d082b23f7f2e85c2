"""A sonic's own stresses: covariances of its series in the frame of each record's mean wind."""

from __future__ import annotations

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.records.windows import record_windows

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def sonic_stresses(series: xr.Dataset, *, duration: float = 600.0, min_availability: float = 0.9) -> xr.Dataset:
    r"""Return the stresses that a sonic anemometer measured, one tensor for each record.

    Parameters
    ----------
    series : xarray.Dataset
        ``u``, ``v`` and ``w`` over ``time``, as `bayes_rs.readers.read_sonic` returns them: right-handed, w up.
    duration : float
        Length of a record, s. Records begin at whole multiples of it since 1970, as those of `make_records` do.
    min_availability : float
        Share of a full record's samples, 0 to 1, that a record needs; stresses of the others are NaN.

    Returns
    -------
    stresses : xarray.Dataset
        ``stress`` (record, component), m² s⁻², in the order of the coordinate ``component``; over ``record``
        ``wind_speed``, the length of the mean vector, m/s, ``angle``, of the mean wind from the sonic's x towards its
        y, and ``tilt``, upwards, degrees, ``count`` and ``availability``. ``time`` is the start of each record.

    Raises
    ------
    InputError
        If a variable is not there, or the series has no sample.

    Notes
    -----
    With the mean vector :math:`\bar{\boldsymbol u}` of a record, the double rotation turns the frame about z until
    :math:`\bar v = 0` and then about y until :math:`\bar w = 0`. With its rotation T and the N samples of all three
    components,

    .. math::
        R_{ij} = \frac1N \sum_n u'_{n,i} u'_{n,j} ,
        \qquad \boldsymbol u'_n = T (\boldsymbol u_n - \bar{\boldsymbol u}) .

    The record's mean is removed and the divisor is N, as for the beams' variances in `make_records`. Nothing is
    corrected for the sonic's path, flow distortion or noise. `bayes_rs.campaign.prior_from_stresses` takes the tensors.

    References
    ----------
    Kaimal and Finnigan (1994), Atmospheric Boundary Layer Flows, chapter 6.6: the rotations.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> time = np.datetime64("2024-01-01", "ns") + np.arange(6000) * np.timedelta64(100, "ms")
    >>> wind = {name: ("time", rng.normal(mean, 1.0, 6000)) for name, mean in (("u", 6.0), ("v", 8.0), ("w", 0.0))}
    >>> found = sonic_stresses(xr.Dataset(wind, coords={"time": time}))
    >>> found["wind_speed"].round(1).item(), found["angle"].round(0).item()
    (10.0, 53.0)
    """
    for name in ("time", "u", "v", "w"):
        if name not in series.variables:
            raise InputError(f"Invalid series without {name!r}: give the Dataset of read_sonic.")
    window = round(1e9 * check_positive(duration, what="duration", unit="s"))
    share = check_finite(min_availability, what="min_availability", unit="")
    if not 0.0 <= share <= 1.0:
        raise InputError(f"Invalid min_availability {min_availability!r}: it must be from 0 to 1.")
    time = series["time"].values.astype("datetime64[ns]").astype(np.int64)
    wind = np.stack([np.asarray(series[name].values, dtype=np.float64) for name in ("u", "v", "w")], axis=-1)
    known = np.isfinite(wind).all(axis=-1)
    if not known.any():
        raise InputError("Invalid series: no time has all of u, v and w; check what was read.")
    full = duration / (float(np.median(np.diff(np.sort(time)))) / 1e9) if len(time) > 1 else 1.0
    number = time[known] // window
    records = record_windows(number, window, 1)
    at = np.searchsorted(records, number)
    n_record = len(records)
    count = np.bincount(at, minlength=n_record)
    mean = _sums(wind[known], at, n_record) / np.maximum(count, 1)[:, np.newaxis]
    rotation = _double_rotation(mean)
    turned = np.einsum("nij,nj->ni", rotation[at], wind[known] - mean[at])
    products = np.stack([turned[:, i] * turned[:, j] for i, j in _PAIRS], axis=-1)
    stress = _sums(products, at, n_record) / np.maximum(count, 1)[:, np.newaxis]
    available = count / full
    enough = (count > 1) & (available >= share * (1.0 - 1e-9))
    speed = np.linalg.norm(mean, axis=-1)
    level = np.hypot(mean[:, 0], mean[:, 1])
    there = count > 0

    def of_record(values: FloatArray, where: np.ndarray, units: str) -> tuple[str, FloatArray, dict[str, str]]:
        return "record", np.where(where, values, np.nan), {"units": units}

    start = (records * window).astype("datetime64[ns]")
    return xr.Dataset(
        {
            "stress": (
                ("record", "component"), np.where(enough[:, np.newaxis], stress, np.nan), {"units": "m2 s-2"},
            ),
            "wind_speed": of_record(speed, there, "m s-1"),
            "angle": of_record(np.rad2deg(np.arctan2(mean[:, 1], mean[:, 0])), there, "degree"),
            "tilt": of_record(np.rad2deg(np.arctan2(mean[:, 2], level)), there, "degree"),
            "count": ("record", count.astype(np.int64)),
            "availability": ("record", available),
        },
        coords={"time": ("record", start), "component": list(STRESSES)},
        attrs={"duration": float(duration), "min_availability": share},
    )  # fmt: skip


def _sums(values: FloatArray, at: np.ndarray, n_record: int) -> FloatArray:
    """Return the sum of values, shape (n, k), over the rows of each record, shape (n_record, k)."""
    return np.stack([np.bincount(at, weights=column, minlength=n_record) for column in values.T], axis=-1)


def _double_rotation(mean: FloatArray) -> FloatArray:
    """Return matrices that turn vectors into the frame in which the means, shape (n, 3), are along x."""
    level = np.hypot(mean[:, 0], mean[:, 1])
    yaw, pitch = np.arctan2(mean[:, 1], mean[:, 0]), np.arctan2(mean[:, 2], level)
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    about_z = np.stack([np.cos(yaw), np.sin(yaw), zero, -np.sin(yaw), np.cos(yaw), zero, zero, zero, one], axis=-1)
    about_y = np.stack(
        [np.cos(pitch), zero, np.sin(pitch), zero, one, zero, -np.sin(pitch), zero, np.cos(pitch)], axis=-1
    )
    rotation: FloatArray = about_y.reshape(-1, 3, 3) @ about_z.reshape(-1, 3, 3)
    return rotation
