"""Which noise records get: that of their own wind speeds and directions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs.calibration import METHODS, calibrate, noise_at_states
from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.mann import MannTurbulence
from bayes_rs.noise import NoiseBank, NoiseModel
from bayes_rs.noise_store import find_shipped_noise
from bayes_rs.scan import Scan
from bayes_rs.virtual import RecordState


def noise_for_records(
    records: xr.Dataset,
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    method: str = "theory",
    progress: bool | None = None,
) -> tuple[NoiseModel | NoiseBank, str]:
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
    progress : bool, optional
        Show a progress bar; by default if stderr is a terminal.

    Returns
    -------
    noise : NoiseModel or NoiseBank
        Noise of this scan.
    words : str
        One line that says which noise it is and, for boxes, how many records are far from all of its states.

    Raises
    ------
    InputError
        If no record has a wind speed.
    MissingExtraError
        If nothing suitable is shipped or cached, and hipersim is not installed.

    Notes
    -----
    By theory, the noise is that of the state nearest to each record in a fixed net: 10 · 1.1ⁱ m/s and multiples of
    5° (10 · 1.25ⁱ m/s and 10° for scans of more than 60 beams). K goes about as 1/U, so the nearest state is off by
    at most 5 % in K, 2.5 % in its standard deviations (twice that in the coarser net). A net that does not move with
    the records lets the cache serve other days.

    By boxes, shipped noise is taken if at least nine in ten records are near one of its states: within a factor √1.5
    in wind speed and 10° in yaw. Else the noise is calibrated at those states of a net of 10 · 1.4ⁱ m/s and multiples
    of 20° that are nearest to some record. Where hipersim is not installed, shipped noise is taken however far it is,
    and the words say so.
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
    if method == "theory":
        ratio, turn = (1.1, 5.0) if scan.n_beam <= 60 else (1.25, 10.0)
        net = np.column_stack([np.round(np.log(speed / 10.0) / np.log(ratio)), np.round(np.rad2deg(yaw) / turn)])
        states = [
            RecordState(scan, 10.0 * ratio**step, float(np.deg2rad(turn * steps)), duration)
            for step, steps in np.unique(net, axis=0).tolist()
        ]
        models = tuple(noise_at_states(states, turbulence, progress=progress))
        return NoiseBank(models), _words("calculated", models, turbulence)
    noise, kept = _from_boxes(scan, turbulence, speed, yaw, duration, progress)
    models = noise.models if isinstance(noise, NoiseBank) else (noise,)
    far = int(_far(noise, speed, yaw).sum())
    words = _words(kept, models, turbulence)
    if far:
        words += f"; {far} of {len(speed)} records are far from all of them and use the nearest"
    return noise, words


def _from_boxes(
    scan: Scan, turbulence: MannTurbulence, speed: FloatArray, yaw: FloatArray, duration: float, progress: bool | None
) -> tuple[NoiseModel | NoiseBank, str]:
    """Return shipped noise where it is near the records, else calibrated noise; and which of the two it is."""
    shipped = find_shipped_noise(scan, turbulence, duration=duration)
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


def _words(kept: str, models: Sequence[NoiseModel], turbulence: MannTurbulence) -> str:
    return (
        f"noise: {kept}, {turbulence.name}, method {models[0].method}, {len(models)} state{'s' * (len(models) > 1)} "
        f"({_span([m.wind_speed for m in models])} m/s, yaw {_span([np.rad2deg(m.yaw) for m in models])}°)"
    )


def _far(noise: NoiseModel | NoiseBank, speed: FloatArray, yaw: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Tell which records are farther from every state than half a step of the shipped bank."""
    nearest = noise.for_records(speed, yaw)
    turn = np.abs(np.angle(np.exp(1j * (yaw - nearest.yaw))))
    ratio = np.abs(np.log(speed / nearest.wind_speed))
    return np.asarray((ratio > 0.5 * np.log(1.5) + 1e-9) | (turn > np.deg2rad(10.0) + 1e-9))


def _span(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
