"""Which noise records get: that of their own wind speeds and directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.at_states import noise_at_states
from bayes_rs.noise.net import TOLERANCE, refined_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.store import find_shipped_noise
from bayes_rs.records.report import why_no_beam
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence

_SAME = 1e-9  # m/s, rad, and of L and Γ
_SPEEDS = (1.0, 50.0)  # m/s; lighter or stronger wind gets the noise of these
_QUICK = 60  # beams whose noise takes a quarter of a second for each state
_USUAL_SPEEDS, _USUAL_YAWS = (3.0, 25.0), (-60.0, 60.0)  # m/s and degrees


def noise_for_records(
    records: xr.Dataset,
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    length_scale: Sequence[float] | None = None,
    gamma: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    sonic: bool = False,
    cache: bool | str | Path = True,
    progress: bool | None = None,
) -> Noise:
    """Return noise for the wind speeds and directions of records.

    Parameters
    ----------
    records : xarray.Dataset
        Records, with ``wind_speed`` (m/s) and ``yaw`` (degrees), and the attribute ``duration`` (s).
    scan : Scan
        Their scan, with the beams in use only.
    turbulence : MannTurbulence
        The turbulence.
    length_scale, gamma : sequence of float, optional
        Length scales L, m, and anisotropies Γ that the noise reaches over; by default those of the records, if they
        have some, else only that of the turbulence.
    tolerance, sonic, cache, progress
        As for `calibrate`.

    Returns
    -------
    noise : Noise
        Noise of this scan.

    Raises
    ------
    InputError
        If no record has a wind speed.

    Notes
    -----
    Each record gets noise of its own wind speed and direction, interpolated in a net with an error of K of
    at most `tolerance` (`refined_noise`): the shipped net if it holds all records; else one for their range, which for
    scans of up to 60 beams reaches over 3 to 25 m/s and, for records from more than one direction, −60° to 60° at
    least, so that the cache serves other days. Wind speeds below 1 and above 50 m/s count as outside. Where all records
    have the same wind speed and direction, only that state is calculated.
    """
    speed, yaw = known_winds(records)
    if len(speed) == 0:
        raise InputError(
            "No record has a wind speed and direction, so no noise can be chosen for it: "
            f"{why_no_beam([records]) or 'give them, or a noise file'}."
        )
    duration = float(records.attrs.get("duration", 600.0))
    flow, spans = _flow_of(records, turbulence, {"length_scale": length_scale, "gamma": gamma})
    return _from_theory(scan, flow, speed, yaw, spans, duration, tolerance, sonic, cache, progress)


def known_winds(records: xr.Dataset) -> tuple[FloatArray, FloatArray]:
    """Return wind speeds, m/s, and directions, rad, of the records that have both."""
    if not {"wind_speed", "yaw"} <= set(records.variables):
        return np.empty(0), np.empty(0)
    speed, yaw = np.asarray(records["wind_speed"], dtype=np.float64), np.deg2rad(np.asarray(records["yaw"], np.float64))
    known = np.isfinite(speed) & np.isfinite(yaw) & (speed > 0.0)
    return speed[known], yaw[known]


def _flow_of(
    records: xr.Dataset, turbulence: MannTurbulence, given: dict[str, Sequence[float] | None]
) -> tuple[MannTurbulence, dict[str, list[float]]]:
    """Return the turbulence where L and Γ are one each, and the ranges of those that are not."""
    spans: dict[str, list[float]] = {}
    for name, chosen in given.items():
        values = np.asarray(records.get(name, []) if chosen is None else chosen, dtype=np.float64)
        values = values[np.isfinite(values)]
        if len(values) == 0:
            continue
        if np.ptp(values) <= _SAME * np.max(values):
            one: dict[str, Any] = {name: float(np.min(values))}
            turbulence = replace(turbulence, **one)
        else:
            spans[name] = [float(np.min(values)), float(np.max(values))]
    return turbulence, spans


def _from_theory(
    scan: Scan,
    turbulence: MannTurbulence,
    speed: FloatArray,
    yaw: FloatArray,
    spans: dict[str, list[float]],
    duration: float,
    tolerance: float,
    sonic: bool,
    cache: bool | str | Path,
    progress: bool | None,
) -> Noise:
    """Return shipped noise if it holds all records, else a net for their range."""
    speeds, yaws = np.clip(speed, *_SPEEDS), np.rad2deg(yaw)
    if not spans:
        if max(np.ptp(speed), np.ptp(yaw)) <= _SAME:
            state = RecordState(scan, float(speed[0]), float(yaw[0]), duration)
            return noise_at_states([state], turbulence, sonic=sonic, cache=cache, progress=progress)
        shipped = find_shipped_noise(scan, turbulence, duration=duration) if cache is True else None
        if shipped is not None and (shipped.has_sonic or not sonic) and _holds(shipped, speed, yaw, tolerance):
            return shipped
        if scan.n_beam <= _QUICK:
            speeds = np.append(speeds, _USUAL_SPEEDS) if np.ptp(speeds) > _SAME else speeds
            yaws = np.append(yaws, _USUAL_YAWS) if np.ptp(yaws) > _SAME else yaws
    return refined_noise(
        scan,
        turbulence,
        wind_speed=[float(np.min(speeds)), float(np.max(speeds))],
        yaw_deg=[float(np.min(yaws)), float(np.max(yaws))],
        length_scale=spans.get("length_scale"),
        gamma=spans.get("gamma"),
        duration=duration,
        tolerance=tolerance,
        cache=cache,
        sonic=sonic,
        progress=progress,
    )


def _holds(noise: Noise, speed: FloatArray, yaw: FloatArray, tolerance: float) -> bool:
    """Tell whether a net reaches over all records, with an error within the tolerance."""
    error = noise.interpolation_error
    return error is not None and error <= tolerance and not np.any(noise.locate(speed, yaw)[2])
