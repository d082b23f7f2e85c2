"""Which noise records get: that of their own wind speeds and directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.calibration.bank import theory_bank
from bayes_rs.calibration.calibrating import METHODS, calibrate, noise_at_states
from bayes_rs.calibration.store import find_shipped_noise
from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.model import Noise, NoiseBank
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence

_SAME = 1e-9  # m/s, rad, and of L
_OTHER = 1e-6  # m: length scales are rounded to it
_SPEEDS = (1.0, 50.0)  # m/s; lighter or stronger wind gets the noise of these
_QUICK = 60  # beams whose noise takes a quarter of a second for each state
_USUAL_SPEEDS, _USUAL_YAWS = (3.0, 25.0), (-60.0, 60.0)  # m/s and degrees


def noise_for_records(
    records: xr.Dataset,
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    method: str = "theory",
    sonic: bool = False,
    length_scale: Sequence[float] | None = None,
    progress: bool | None = None,
) -> tuple[Noise, str]:
    """Return noise for the wind speeds and directions of records.

    Parameters
    ----------
    records : xarray.Dataset
        Records, with ``wind_speed`` (m/s) and ``yaw`` (degrees), and the attribute ``duration`` (s).
    scan : Scan
        Their scan, with the beams in use only.
    turbulence : MannTurbulence
        The turbulence.
    method : str
        ``"theory"`` or ``"boxes"``, as for `calibrate`.
    sonic : bool
        With the moments that the target ``"sonic"`` needs, as for `calibrate`.
    length_scale : sequence of float, optional
        Length scales L, m, that a bank by theory reaches over, as `Nuisances` with an uncertain one needs; by default
        only that of the turbulence.
    progress : bool, optional
        Show a progress bar; by default if stderr is a terminal.

    Returns
    -------
    noise : NoiseModel or NoiseBank
        Noise of this scan.
    words : str
        One line that says which noise it is, how well it is interpolated, and how many records are outside it.

    Raises
    ------
    InputError
        If no record has a wind speed, or boxes are asked for with a sonic or several length scales.
    MissingExtraError
        If nothing suitable is shipped or cached, and hipersim is not installed.

    Notes
    -----
    By theory, each record gets noise of its own wind speed and direction, interpolated in a bank with an error of K of
    at most 1 % (`theory_bank`): the shipped bank if it holds all records; else one for their range, which for scans of
    up to 60 beams reaches over 3 to 25 m/s and, for records from more than one direction, −60° to 60° at least, so that
    the cache serves other days. Wind speeds below 1 and above 50 m/s count as outside. Where all records have the same
    wind speed and direction, only that state is calculated.

    By boxes, shipped noise is taken if at least nine in ten records are near one of its states: within a factor √1.5
    in wind speed and 10° in yaw. Else the noise is calibrated at those states of a net of 10 · 1.4ⁱ m/s and multiples
    of 20° that are nearest to some record. States that form a net are interpolated. Where hipersim is not installed,
    shipped noise is taken however far it is, and the words say so.
    """
    speed, yaw = np.asarray(records["wind_speed"], dtype=np.float64), np.deg2rad(np.asarray(records["yaw"], np.float64))
    known = np.isfinite(speed) & np.isfinite(yaw) & (speed > 0.0)
    if not known.any():
        raise InputError(
            "No record has a wind speed and direction, so no noise can be chosen for it: give them, or a noise file."
        )
    speed, yaw = speed[known], yaw[known]
    duration = float(records.attrs.get("duration", 600.0))
    check_choice(method, tuple(METHODS), what="method of calibration")
    if sonic and method != "theory":
        raise InputError(f"Invalid noise method {method!r} for the target 'sonic': only 'theory' has its moments.")
    if length_scale is not None and method != "theory":
        raise InputError(f"Invalid noise method {method!r} for an uncertain length scale: only 'theory' spans several.")
    flow = turbulence
    if length_scale is not None and np.size(length_scale) and np.ptp(length_scale) <= _SAME * np.max(length_scale):
        flow, length_scale = replace(turbulence, length_scale=float(np.min(length_scale))), None
    if method == "theory":
        noise, kept = _from_theory(scan, flow, speed, yaw, duration, progress, sonic, length_scale)
        words = _words(kept, noise, turbulence) + ("; with the moments of a sonic" if sonic else "")
        if isinstance(noise, NoiseBank) and (out := int(np.count_nonzero(noise.locate(speed, yaw)[2]))):
            words += f"; {out} of {len(speed)} records are outside and use its edge"
        return noise, words
    noise, kept = _from_boxes(scan, turbulence, speed, yaw, duration, progress)
    far = int(_far(noise, speed, yaw).sum())
    words = _words(kept, noise, turbulence)
    if far:
        words += f"; {far} of {len(speed)} records are far from all of them and use the nearest"
    return noise, words


def _from_theory(
    scan: Scan,
    turbulence: MannTurbulence,
    speed: FloatArray,
    yaw: FloatArray,
    duration: float,
    progress: bool | None,
    sonic: bool,
    length_scale: Sequence[float] | None,
) -> tuple[Noise, str]:
    """Return shipped noise if it holds all records, else a bank for their range; and which of the two it is."""
    speeds, yaws = np.clip(speed, *_SPEEDS), np.rad2deg(yaw)
    if length_scale is not None:
        ranges = [[float(np.min(values)), float(np.max(values))] for values in (speeds, yaws)]
        bank = theory_bank(
            scan,
            turbulence,
            wind_speed=ranges[0],
            yaw_deg=ranges[1],
            length_scale=length_scale,
            duration=duration,
            sonic=sonic,
            progress=progress,
        )
        return bank, "calculated"
    if max(np.ptp(speed), np.ptp(yaw)) <= _SAME:
        state = RecordState(scan, float(speed[0]), float(yaw[0]), duration)
        return noise_at_states([state], turbulence, sonic=sonic, progress=progress)[0], "calculated"
    shipped = find_shipped_noise(scan, turbulence, duration=duration, method="theory")
    complete = isinstance(shipped, NoiseBank) and (shipped.has_sonic or not sonic)
    if isinstance(shipped, NoiseBank) and complete and not np.any(shipped.locate(speed, yaw)[2]):
        return shipped, "shipped"
    if scan.n_beam <= _QUICK:
        speeds = np.append(speeds, _USUAL_SPEEDS) if np.ptp(speeds) > _SAME else speeds
        yaws = np.append(yaws, _USUAL_YAWS) if np.ptp(yaws) > _SAME else yaws
    bank = theory_bank(
        scan,
        turbulence,
        wind_speed=[float(np.min(speeds)), float(np.max(speeds))],
        yaw_deg=[float(np.min(yaws)), float(np.max(yaws))],
        duration=duration,
        sonic=sonic,
        progress=progress,
    )
    return bank, "calculated"


def _from_boxes(
    scan: Scan, turbulence: MannTurbulence, speed: FloatArray, yaw: FloatArray, duration: float, progress: bool | None
) -> tuple[Noise, str]:
    """Return shipped noise where it is near the records, else calibrated noise; and which of the two it is."""
    shipped = find_shipped_noise(scan, turbulence, duration=duration, method="boxes")
    if shipped is not None and np.mean(_far(shipped, speed, yaw)) <= 0.1:
        return shipped, "shipped"
    level = np.round(np.log(speed / 10.0) / np.log(1.4)).astype(int)
    turn = np.round(np.rad2deg(yaw) / 20.0).astype(int)
    speeds = [round(10.0 * 1.4 ** int(step), 6) for step in np.unique(level)]
    yaws = [20.0 * int(step) for step in np.unique(turn)]
    try:
        noise = calibrate(
            scan, turbulence, wind_speed=speeds, yaw_deg=yaws, duration=duration, method="boxes", progress=progress
        )
    except MissingExtraError:
        if shipped is None:
            raise
        return shipped, "shipped"
    return noise, "calibrated"


def _words(kept: str, noise: Noise, turbulence: MannTurbulence) -> str:
    models = noise.models
    words = (
        f"noise: {kept}, {turbulence.name}, method {models[0].method}, {len(models)} state{'s' * (len(models) > 1)} "
        f"({_span([m.wind_speed for m in models])} m/s, yaw {_span([np.rad2deg(m.yaw) for m in models])}°"
    )
    scales = [model.turbulence.length_scale for model in models]
    other = max(abs(scale - turbulence.length_scale) for scale in scales) > _OTHER
    words += f", L {_span(scales)} m)" if other else ")"
    if isinstance(noise, NoiseBank) and len(models) > 1:
        if noise.net is None:
            return words + "; each record uses the nearest"
        error = noise.interpolation_error
        words += "; interpolated, with an error " + ("not measured" if error is None else f"of {100.0 * error:.2g} %")
    return words


def _far(noise: Noise, speed: FloatArray, yaw: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Tell which records are farther from every state than half a step of the shipped bank."""
    bank = noise if isinstance(noise, NoiseBank) else NoiseBank((noise,))
    speed_used, yaw_used, _ = bank.locate(speed, yaw)
    turn = np.abs(np.angle(np.exp(1j * (yaw - yaw_used))))
    ratio = np.abs(np.log(speed / speed_used))
    return np.asarray((ratio > 0.5 * np.log(1.5) + 1e-9) | (turn > np.deg2rad(10.0) + 1e-9))


def _span(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
