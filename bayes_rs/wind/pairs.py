"""Beam pairs: time series of two wind components from two beams, and what their variances are worth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_items, check_choice, check_finite, check_positive
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.scan import Scan, yaw_matrix
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.records.given import check_is_series
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

PLANES: dict[str, tuple[int, int]] = {"horizontal": (0, 1), "vertical": (0, 2)}
"""Planes of pairs, and the axes of the levelled lidar frame whose components they give."""

_COMPONENTS = ("u", "v", "w")
_SAME_DIRECTION = np.deg2rad(1.0)  # how far beams of a pair may differ in the direction that the pair leaves out
_SAME_DISTANCE = 1e-3  # of the focus distance
_LEAST_ANGLE = np.deg2rad(2.0)  # between the two beams
_TOLERANCE = 0.6  # of the scan's duration: beams half a scan apart, with some jitter


class Pair(NamedTuple):
    """Two beams, by their places in the scan, and the matrix that makes the two components of their velocities."""

    first: int
    second: int
    weights: FloatArray


def reconstruct_pairs(
    series: xr.Dataset,
    scan: Scan | str | Path,
    *,
    plane: str = "horizontal",
    pairs: Sequence[tuple[int, int]] | None = None,
    tolerance: float | None = None,
) -> xr.Dataset:
    r"""Reconstruct two wind components from pairs of beams, sample by sample.

    Parameters
    ----------
    series : xarray.Dataset
        Radial velocities, as `read` returns them.
    scan : Scan, str or Path
        The scan that measured them.
    plane : {"horizontal", "vertical"}
        ``"horizontal"``: pairs side by side give u and v; ``"vertical"``: pairs one above the other give u and w.
    pairs : sequence of tuple of int, optional
        The numbers of the two beams of each pair; by default all pairs of the scan that lie in the plane: of one focus
        distance, at least 2° apart, and within 1° of each other's direction across the plane.
    tolerance : float, optional
        Largest time between the two samples of a pair, s; six tenths of the scan's duration if not given.

    Returns
    -------
    wind : xarray.Dataset
        Over ``sample``: ``u`` and ``v`` or ``w``, m/s, along x, y and z of the levelled lidar frame (x against its
        view, y to the right of one who looks out, z up); ``time_offset``, from the first beam's sample to the second's,
        s; coordinates ``time`` (UTC), in the middle between the two, ``first_beam`` and ``second_beam``. ``attrs``
        count the samples of the pairs' beams that found no partner.

    Raises
    ------
    InputError
        If no pair lies in the plane, a beam is not the scan's, or two beams of a pair see the same direction.

    Notes
    -----
    With the components :math:`n_a, n_b` of the beams in the plane,

    .. math::
        \begin{pmatrix} \hat u \\ \hat v \end{pmatrix} = \begin{pmatrix} n_{a1} & n_{a2} \\ n_{b1} & n_{b2}
        \end{pmatrix}^{-1} \begin{pmatrix} v_a \\ v_b \end{pmatrix} .

    Samples are paired one to one, nearest in time first; nothing is interpolated. This is exact only if the wind is the
    same at both beams and both times, and if the component across the plane is not seen: it enters with n_{a3}, n_{b3}
    (horizontal pairs; n_{a2}, n_{b2} for vertical ones).

    Turbulence is not the same at both. For two beams n = (−cos φ, ±sin φ, 0) at the same time, with ρ_u and ρ_v the
    correlations of u and of v between the two places,

    .. math::
        \mathrm{Var}\,\hat u &= \tfrac12 (1 + ρ_u)\, \overline{uu} + \tfrac12 (1 - ρ_v) \tan^2 φ\; \overline{vv} , \\
        \mathrm{Var}\,\hat v &= \tfrac12 (1 + ρ_v)\, \overline{vv} + \tfrac12 (1 - ρ_u) \cot^2 φ\; \overline{uu} :

    at φ = 15° cot²φ is 14, so that a crosswind variance from pairs measures mostly what decorrelates u between the
    beams. A time offset τ is a further separation U τ along the wind. `pair_stresses` gives these expectations for any
    pair, with probe volumes. Use `fit` for stresses; pairs are for time series.

    References
    ----------
    Peña, Mann and Dimitrov (2017), Wind Energ. Sci. 2, 133–152, doi:10.5194/wes-2-133-2017: nacelle lidars' beams and
    the turbulence between them.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("2-beam"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=1, seed=1)
    >>> wind = reconstruct_pairs(series, scan)
    >>> wind.sizes["sample"], bool(abs(wind["u"].mean() - 10.0) < 1.0)
    (600, True)
    """
    scan = as_scan(scan)
    check_is_series(series)
    chosen = _pairs(scan, plane, pairs)
    longest = (
        _TOLERANCE * scan.scan_duration if tolerance is None else check_positive(tolerance, what="tolerance", unit="s")
    )
    time = series["time"].values.astype("datetime64[ns]").astype(np.int64)
    number, velocity = np.asarray(series["beam"].values), np.asarray(series["radial_velocity"].values, dtype=np.float64)
    known = np.isfinite(velocity)
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, Pair]] = []
    unpaired = 0
    for pair in chosen:
        a, b = (np.flatnonzero(known & (number == scan.beam[place])) for place in (pair.first, pair.second))
        a, b = a[np.argsort(time[a], kind="stable")], b[np.argsort(time[b], kind="stable")]
        of_a, of_b = _matched(time[a], time[b], longest)
        unpaired += len(a) + len(b) - 2 * len(of_a)
        both = np.stack([velocity[a[of_a]], velocity[b[of_b]]], axis=-1)
        parts.append((time[a[of_a]], time[b[of_b]], both @ pair.weights.T, pair))
    first, second = (np.concatenate([part[index] for part in parts]) for index in (0, 1))
    wind = np.concatenate([part[2] for part in parts])
    beams = np.concatenate([np.tile([scan.beam[p.first], scan.beam[p.second]], (len(t), 1)) for t, _, _, p in parts])
    middle = first + (second - first) // 2
    order = np.argsort(middle, kind="stable")
    names = [_COMPONENTS[axis] for axis in PLANES[plane]]
    return xr.Dataset(
        {
            **{
                name: ("sample", values[order], {"units": "m s-1", "frame": "levelled lidar"})
                for name, values in zip(names, wind.T, strict=True)
            },
            "time_offset": ("sample", ((second - first) * 1e-9)[order], {"units": "s"}),
        },
        coords={
            "time": ("sample", middle[order].astype("datetime64[ns]")),
            "first_beam": ("sample", beams[order, 0]),
            "second_beam": ("sample", beams[order, 1]),
        },
        attrs={"scan": scan.name, "plane": plane, "tolerance": longest, "samples_without_partner": unpaired},
    )


def pair_stresses(
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path,
    *,
    wind_speed: float,
    plane: str = "horizontal",
    pairs: Sequence[tuple[int, int]] | None = None,
    yaw_deg: float | None = None,
    time_offset: float | None = None,
) -> xr.Dataset:
    """Return the variances that components from beam pairs have in known turbulence, and the true ones.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, with its probe volume.
    turbulence : MannTurbulence, str or Path
        The turbulence.
    wind_speed : float
        Mean wind speed, m/s.
    plane, pairs
        As in `reconstruct_pairs`.
    yaw_deg : float, optional
        Wind direction relative to the lidar axis, degrees; the scan's own if not given.
    time_offset : float, optional
        Time from the first beam's sample to the second's, s; that of the scan's timing, taken to the nearest sample, if
        not given.

    Returns
    -------
    stresses : xarray.Dataset
        Over ``pair`` and ``stress`` (``uu, vv, uv`` or ``ww, uw``), m² s⁻², in the levelled lidar frame: ``measured``
        by the pair and ``true``, both of an infinite record; ``first_beam`` and ``second_beam`` (pair).

    Raises
    ------
    InputError
        If an argument is not valid, or no pair lies in the plane.

    Notes
    -----
    With W the matrix of `reconstruct_pairs` and C the covariance of the two beams' velocities, W C Wᵀ; the mean-wind
    frame is turned into that of the lidar for the true stresses.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("2-beam"), brs.load_turbulence("fu-2022")
    >>> found = pair_stresses(scan, flow, wind_speed=10.0)
    >>> (found["measured"] / found["true"]).sel(stress=["uu", "vv"]).values.round(2)
    array([[0.74, 7.13]])
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    yaw = scan.yaw if yaw_deg is None else np.deg2rad(check_finite(yaw_deg, what="yaw_deg", unit="°"))
    chosen = _pairs(scan, plane, pairs)
    axes = PLANES[plane]
    names = ["".join(_COMPONENTS[axis] for axis in part) for part in ((axes[0],) * 2, (axes[1],) * 2, axes)]
    direction = scan.at_yaw(yaw)
    place = scan.focus_distance[:, None] * direction
    turn = yaw_matrix(yaw)
    true = turn @ unpack_stress(turbulence.stresses()) @ turn.T
    measured = np.empty((len(chosen), 3))
    for row, pair in enumerate(chosen):
        two = np.array([pair.first, pair.second])
        offset = float(np.diff(scan.beam_time[two])[0])
        offset -= scan.scan_duration * np.round(offset / scan.scan_duration)
        if time_offset is not None:
            offset = check_finite(time_offset, what="time_offset", unit="s")
        apart = place[pair.second] - place[pair.first] - [wind_speed * offset, 0.0, 0.0]
        a, b = two[[0, 1, 0]], two[[0, 1, 1]]
        shift = np.array([[0.0] * 3, [0.0] * 3, apart])
        lengths = np.stack([scan.probe_length[a], scan.probe_length[b]], axis=-1)
        aa, bb, ab = probed_covariance(
            direction[a], direction[b], shift[:, 1:], shift[:, :1], turbulence, probe=scan.probe, lengths=lengths
        )[:, 0]
        found = pair.weights @ np.array([[aa, ab], [ab, bb]]) @ pair.weights.T
        measured[row] = found[0, 0], found[1, 1], found[0, 1]
    truth = [true[axes[0], axes[0]], true[axes[1], axes[1]], true[axes[0], axes[1]]]
    unit = {"units": "m2 s-2"}
    return xr.Dataset(
        {"measured": (("pair", "stress"), measured, unit), "true": ("stress", np.array(truth), unit)},
        coords={
            "stress": names,
            "first_beam": ("pair", scan.beam[[pair.first for pair in chosen]]),
            "second_beam": ("pair", scan.beam[[pair.second for pair in chosen]]),
        },
    )


def _pairs(scan: Scan, plane: str, numbers: Sequence[tuple[int, int]] | None) -> list[Pair]:
    """Return the pairs with their matrices.

    Raises
    ------
    InputError
        If there is none, a beam is not the scan's, or the matrix of a pair is singular.
    """
    axes = list(PLANES[check_choice(plane, tuple(PLANES), what="plane of pairs")])
    level = scan.level_direction
    if numbers is None:
        places = _found_pairs(scan, level, plane)
        if not places:
            raise InputError(f"Scan {scan.name!r} has no {plane} pair of beams: name the beams with pairs=[(a, b)].")
    else:
        at = {int(number): place for place, number in enumerate(scan.beam)}
        numbers = as_items(numbers, what="pairs")
        if not numbers:
            raise InputError("Invalid pairs (): name at least one, as [(0, 1)], or leave it out.")
        for pair in numbers:
            if not isinstance(pair, (tuple, list)) or len(pair) != 2 or any(number not in [*at] for number in pair):
                raise InputError(
                    f"Invalid pair {in_short(pair)} of scan {scan.name!r}: give two of its beams, {scan.beam.tolist()}."
                )
        places = [(at[first], at[second]) for first, second in numbers]
    found = []
    for first, second in places:
        rows = level[[first, second]][:, axes]
        size = np.linalg.svd(rows, compute_uv=False)
        if size[1] < 1e-6 * size[0]:
            raise InputError(
                f"The beams {scan.beam[first]} and {scan.beam[second]} of scan {scan.name!r} see the same direction in "
                f"the {plane} plane: take two that differ in it."
            )
        found.append(Pair(first, second, np.asarray(np.linalg.inv(rows), dtype=np.float64)))
    return found


def _found_pairs(scan: Scan, level: FloatArray, plane: str) -> list[tuple[int, int]]:
    other = 2 if plane == "horizontal" else 1
    found = []
    for first in range(scan.n_beam):
        for second in range(first + 1, scan.n_beam):
            far = np.ptp(scan.focus_distance[[first, second]]) > _SAME_DISTANCE * scan.focus_distance[first]
            apart = np.arccos(np.clip(level[first] @ level[second], -1.0, 1.0))
            aside = abs(level[first, other] - level[second, other])
            if not far and apart >= _LEAST_ANGLE and aside <= np.sin(_SAME_DIRECTION):
                found.append((first, second))
    return found


def _matched(
    first: NDArray[np.int64], second: NDArray[np.int64], tolerance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Match two rising lists of times (ns) one to one, nearest first, no farther apart than `tolerance`, s.

    Entries that are each other's nearest are matched; then the same among those that are left, until none is.
    """
    left, right = np.arange(len(first)), np.arange(len(second))
    found: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    while len(left) and len(right):
        # of two equally near, the later of the second and the earlier of the first: their pair begins with the first
        to_right = _nearest(first[left], second[right], later=True)
        to_left = _nearest(second[right], first[left], later=False)
        mutual = np.flatnonzero(to_left[to_right] == np.arange(len(left)))
        gap = np.abs(second[right[to_right[mutual]]] - first[left[mutual]])
        kept = mutual[gap <= round(tolerance * 1e9)]
        if len(kept) == 0:
            break
        found.append((left[kept], right[to_right[kept]]))
        left, right = np.delete(left, kept), np.delete(right, to_right[kept])
    if not found:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    one, other = (np.concatenate([part[index] for part in found]) for index in (0, 1))
    order = np.argsort(one)
    return one[order], other[order]


def _nearest(times: NDArray[np.int64], among: NDArray[np.int64], *, later: bool) -> NDArray[np.int64]:
    """Return for each time the place of the nearest among others; of two equally near, the later or the earlier."""
    if len(among) == 1:
        return np.zeros(len(times), dtype=np.int64)
    right = np.clip(np.searchsorted(among, times), 1, len(among) - 1)
    after, before = among[right] - times, times - among[right - 1]
    return np.where((after <= before) if later else (after < before), right, right - 1)
